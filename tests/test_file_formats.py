"""Which format a file has."""

from __future__ import annotations

import mimetypes
from pathlib import Path

import pytest

from brdfpipe import file_formats
from brdfpipe.errors import InputError
from brdfpipe.file_formats import FileFormat, extensions, format_of, media_type

FORMATS = {
    "table": FileFormat("table", (".txt", ".csv"), "numbers"),
    "scan": FileFormat("scan", (".sur",), "heights"),
    "named": FileFormat("named", (), "heights under the extension of another format"),
}


def test_the_extension_selects_the_format_in_either_case() -> None:
    assert format_of(Path("a.CSV"), None, FORMATS, "surface.format") is FORMATS["table"]


def test_a_name_overrides_the_extension() -> None:
    assert format_of(Path("a.txt"), "named", FORMATS, "surface.format") is FORMATS["named"]


def test_extensions_of_all_formats_are_sorted() -> None:
    assert extensions(FORMATS) == (".csv", ".sur", ".txt")


@pytest.mark.parametrize(
    ("file", "name", "message"),
    [
        (
            "a.raw",
            None,
            r"^a\.raw: unknown file extension; found \.raw; accepted: \.csv, \.sur, \.txt; .*`spectrum\.format`",
        ),
        ("raw", None, "found no extension"),
        ("a.txt", "raw", "unknown format; found 'raw'; accepted: table, scan, named; set `spectrum.format`"),
    ],
)
def test_an_unknown_format_is_refused_with_the_known_ones(file: str, name: str | None, message: str) -> None:
    with pytest.raises(InputError, match=message):
        format_of(Path(file), name, FORMATS, "spectrum.format")


def test_media_types_do_not_depend_on_the_machine(tmp_path, request) -> None:
    (tmp_path / "mime.types").write_text("application/machine csv sur\n")
    request.addfinalizer(mimetypes.init)
    mimetypes.init([str(tmp_path / "mime.types")])
    assert mimetypes.types_map[".csv"] == "application/machine"
    file_formats._media_types.cache_clear()
    found = [media_type(name) for name in ("a/b.nc", "c.CSV", "d.astm", "README.txt", "scan.sur")]
    assert found == ["application/x-netcdf", "text/csv", "text/plain", "text/plain", "application/octet-stream"]
