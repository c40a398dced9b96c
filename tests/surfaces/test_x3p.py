"""X3P: every variant of the standard that holds one height map, and every damage refused in words."""

from __future__ import annotations

import hashlib
import io
import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from brdfpipe.errors import InputError
from brdfpipe.surfaces import level, parameters, read_surface, write_x3p

METRES = 1e-6


def document(
    shape: tuple[int, int] = (40, 50),
    *,
    code: str = "D",
    feature: str = "SUR",
    cz: str = "<AxisType>A</AxisType>",
    data: str = "<DataLink><PointDataLink>bindata/data.bin</PointDataLink></DataLink>",
    size_z: int = 1,
    cx: str = "<AxisType>I</AxisType><Increment>5e-7</Increment>",
    prolog: str = "",
    p: str = "",
) -> str:
    """A ``main.xml`` of 0.5 x 0.7 um pitch; ``p`` is a namespace prefix for every element."""
    text = f"""<?xml version="1.0" encoding="UTF-8"?>{prolog}
<q:ISO5436_2 xmlns:q="http://www.opengps.eu/2008/ISO5436_2">
<Record1><FeatureType>{feature}</FeatureType><Axes><CX>{cx}</CX>
<CY><AxisType>I</AxisType><Increment>7e-7</Increment></CY><CZ>{cz}<DataType>{code}</DataType></CZ></Axes></Record1>
<Record3><MatrixDimension><SizeX>{shape[1]}</SizeX><SizeY>{shape[0]}</SizeY><SizeZ>{size_z}</SizeZ></MatrixDimension>
{data}</Record3></q:ISO5436_2>"""
    if p:
        text = text.replace("</", "\0").replace("<", f"<{p}").replace("\0", f"</{p}").replace(f"{p}q:", "q:")
        text = text.replace(f"<{p}?", "<?")
    return text


def pack(folder: Path, entries: Mapping[str, str | bytes], name: str = "map.x3p") -> Path:
    path = folder / name
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for entry, content in entries.items():
            archive.writestr(entry, content)
    return path


def binary(surface: xr.Dataset, dtype: str = "<f8") -> bytes:
    return (surface.height.values * METRES).astype(dtype).tobytes()


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_written_map_reads_back_in_the_same_orientation(
    tmp_path: Path, asymmetric: xr.Dataset, dtype: type[np.floating]
) -> None:
    surface = asymmetric.astype(dtype)
    write_x3p(surface, tmp_path / "map.x3p")
    read_back = read_surface(tmp_path / "map.x3p")
    assert read_back.height.dtype == dtype
    # Micrometres to metres and back costs a rounding or two.
    np.testing.assert_allclose(read_back.height, surface.height, rtol=4 * np.finfo(dtype).eps)
    assert (read_back.attrs["pitch_x"], read_back.attrs["pitch_y"]) == pytest.approx((0.5, 0.7), rel=1e-12)


def test_the_root_element_of_older_files_is_accepted_in_a_folder_of_the_archive(
    tmp_path: Path, asymmetric: xr.Dataset
) -> None:
    xml = document().replace("ISO5436_2", "ISO5436")
    path = pack(tmp_path, {"scan/main.xml": xml, "scan/bindata/data.bin": binary(asymmetric)})
    np.testing.assert_allclose(read_surface(path).height, asymmetric.height, rtol=1e-12)


def test_a_wrong_unit_inside_the_file_asks_for_no_key_that_does_not_apply(
    tmp_path: Path, asymmetric: xr.Dataset
) -> None:
    entries = {"bindata/data.bin": binary(asymmetric)}
    for change, problem in ((("5e-7", "5e-1"), "implausible pitch"), (("5e-7", "5e-10"), "implausible")):
        path = pack(tmp_path, {"main.xml": document().replace(*change), **entries})
        with pytest.raises(InputError, match=problem) as refused:
            read_surface(path)
        assert "surface." not in str(refused.value)
        assert "the file states its units" in str(refused.value)


def test_a_written_line_reads_back_as_a_line(tmp_path: Path, line: xr.Dataset) -> None:
    write_x3p(line, tmp_path / "line.x3p")
    surface = read_surface(tmp_path / "line.x3p")
    assert surface.height.dims == ("x",)
    assert "pitch_y" not in surface.attrs
    np.testing.assert_allclose(surface.height, line.height, rtol=1e-15)


def test_writing_twice_gives_the_same_bytes(tmp_path: Path, asymmetric: xr.Dataset) -> None:
    write_x3p(asymmetric, tmp_path / "a.x3p")
    write_x3p(asymmetric, tmp_path / "b.x3p")
    assert (tmp_path / "a.x3p").read_bytes() == (tmp_path / "b.x3p").read_bytes()
    with zipfile.ZipFile(tmp_path / "a.x3p") as archive:
        assert {entry.date_time for entry in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}
        assert {entry.compress_type for entry in archive.infolist()} == {zipfile.ZIP_STORED}


def test_x_runs_fastest_in_the_file(tmp_path: Path, asymmetric: xr.Dataset) -> None:
    # A map written by hand, not by our own writer, whose mistakes our reader would share.
    path = pack(tmp_path, {"main.xml": document(), "bindata/data.bin": binary(asymmetric)})
    np.testing.assert_allclose(read_surface(path).height, asymmetric.height, rtol=1e-15)


@pytest.mark.parametrize(("code", "dtype", "tolerance"), [("I", "<i2", 5e-5), ("L", "<i4", 5e-10)])
def test_integers_are_scaled_shifted_and_masked(
    tmp_path: Path, asymmetric: xr.Dataset, code: str, dtype: str, tolerance: float
) -> None:
    step, offset = 2 * tolerance, 0.25
    valid = ~np.isnan(asymmetric.height.values)
    raw = np.round((np.nan_to_num(asymmetric.height.values) - offset) / step).astype(dtype)
    cz = f"<AxisType>I</AxisType><Increment>{step * METRES!r}</Increment><Offset>{offset * METRES!r}</Offset>"
    link = (
        "<DataLink><PointDataLink>bindata/data.bin</PointDataLink>"
        "<ValidPointsLink>bindata/valid.bin</ValidPointsLink></DataLink>"
    )
    # The first point is the lowest bit of the first byte, as openGPS writes it.
    mask = np.packbits(valid.ravel(), bitorder="little").tobytes()
    entries = {
        "main.xml": document(code=code, cz=cz, data=link),
        "bindata/data.bin": raw.tobytes(),
        "bindata/valid.bin": mask,
    }
    surface = read_surface(pack(tmp_path, entries))
    # Rounding leaves half a step.
    np.testing.assert_allclose(surface.height, asymmetric.height, rtol=0, atol=1.01 * tolerance)


def test_heights_in_the_xml_are_read(tmp_path: Path, asymmetric: xr.Dataset) -> None:
    values = asymmetric.height.values.ravel() * METRES
    data = "".join("<Datum/>" if np.isnan(z) else f"<Datum>;;{float(z)!r}</Datum>" for z in values)
    path = pack(tmp_path, {"main.xml": document(data=f"<DataList>{data}</DataList>")})
    np.testing.assert_allclose(read_surface(path).height, asymmetric.height, rtol=1e-15)


def test_infinite_heights_are_missing(tmp_path: Path, asymmetric: xr.Dataset) -> None:
    raw = np.where(np.isnan(asymmetric.height), np.inf, asymmetric.height * METRES)
    surface = read_surface(pack(tmp_path, {"main.xml": document(), "bindata/data.bin": raw.tobytes()}))
    assert int(np.isnan(surface.height).sum()) == 1
    assert "infinite heights" in surface.attrs["history"]


def test_a_sub_folder_is_accepted(tmp_path: Path, asymmetric: xr.Dataset) -> None:
    path = pack(tmp_path, {"part 1/main.xml": document(), "part 1/bindata/data.bin": binary(asymmetric)})
    assert read_surface(path).height.shape == (40, 50)


def test_all_elements_may_be_in_the_namespace(tmp_path: Path, asymmetric: xr.Dataset) -> None:
    path = pack(tmp_path, {"main.xml": document(p="q:"), "bindata/data.bin": binary(asymmetric)})
    assert read_surface(path).height.shape == (40, 50)


@pytest.mark.parametrize("feature", ["PRF", "SUR"])
def test_one_row_is_a_line(tmp_path: Path, line: xr.Dataset, feature: str) -> None:
    path = pack(tmp_path, {"main.xml": document((1, 200), feature=feature), "bindata/data.bin": binary(line)})
    assert read_surface(path).height.dims == ("x",)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"size_z": 2}, "several heights per point"),
        ({"cx": "<AxisType>A</AxisType>"}, "absolute positions"),
        ({"cx": "<AxisType>I</AxisType>"}, "CX/Increment is missing"),
        ({"cx": "<AxisType>I</AxisType><Increment>wide</Increment>"}, "not a number"),
        ({"cx": "<AxisType>I</AxisType><Increment>0.5</Increment>"}, "implausible pitch along x"),
        ({"code": "X"}, "unknown type of heights"),
        ({"feature": "PCL"}, "not a matrix"),
        ({"feature": "PRF"}, "several profiles"),
        ({"shape": (40, 51)}, "size of the data does not match the matrix"),
        ({"shape": (40, 0)}, "not a count"),
        ({"shape": (10**8, 10**8)}, "too many points"),
        ({"shape": (-40, -50)}, "not a count"),
        ({"data": "<DataList><Datum>1</Datum></DataList>"}, "size of the data does not match the matrix"),
        ({"data": "<DataList>" + "<Datum>high</Datum>" * 2000 + "</DataList>"}, "not a number"),
        (
            {"data": "<DataLink><PointDataLink>../data.bin</PointDataLink></DataLink>"},
            "unsafe entry name outside the archive",
        ),
        (
            {"data": "<DataLink><PointDataLink>/etc/hostname</PointDataLink></DataLink>"},
            "unsafe entry name outside the archive",
        ),
        (
            {"data": "<DataLink><PointDataLink>C:\\data.bin</PointDataLink></DataLink>"},
            "unsafe entry name outside the archive",
        ),
        ({"data": "<DataLink><PointDataLink>other.bin</PointDataLink></DataLink>"}, "missing entry in the archive"),
    ],
)
def test_other_and_broken_contents_are_refused_in_words(
    tmp_path: Path, asymmetric: xr.Dataset, options: dict[str, object], message: str
) -> None:
    path = pack(tmp_path, {"main.xml": document(**options), "bindata/data.bin": binary(asymmetric)})  # type: ignore[arg-type]
    with pytest.raises(InputError, match=message):
        read_surface(path)


def test_a_list_of_points_is_refused(tmp_path: Path) -> None:
    xml = document().replace("MatrixDimension", "ListDimension")
    with pytest.raises(InputError, match="a list of points, not a matrix"):
        read_surface(pack(tmp_path, {"main.xml": xml}))


def test_a_wrong_checksum_is_refused_and_a_right_one_accepted(tmp_path: Path, asymmetric: xr.Dataset) -> None:
    points = binary(asymmetric)
    link = "<DataLink><PointDataLink>bindata/data.bin</PointDataLink><MD5ChecksumPointData>{}</MD5ChecksumPointData></DataLink>"
    right = hashlib.md5(points, usedforsecurity=False).hexdigest().upper()
    for name, md5 in (("right.x3p", right), ("wrong.x3p", "0" * 32)):
        pack(tmp_path, {"main.xml": document(data=link.format(md5)), "bindata/data.bin": points}, name)
    assert read_surface(tmp_path / "right.x3p").height.shape == (40, 50)
    with pytest.raises(InputError, match="wrong checksum of the data"):
        read_surface(tmp_path / "wrong.x3p")


def test_a_document_edited_after_writing_is_warned_of(tmp_path: Path, asymmetric: xr.Dataset) -> None:
    write_x3p(asymmetric, tmp_path / "map.x3p")
    with zipfile.ZipFile(tmp_path / "map.x3p") as archive:
        entries = {name: archive.read(name) for name in archive.namelist()}
    assert "warnings" not in read_surface(tmp_path / "map.x3p").attrs
    entries["main.xml"] = entries["main.xml"].replace(b"<Revision>", b"<Revision> ")
    assert "was changed" in read_surface(pack(tmp_path, entries, "edited.x3p")).attrs["warnings"]


@pytest.mark.parametrize(
    "prolog",
    [
        '<!DOCTYPE x [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>',
        '<!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/hostname">]>',
        '<!DOCTYPE x SYSTEM "http://127.0.0.1/x.dtd">',
    ],
)
def test_entities_and_document_types_are_refused(tmp_path: Path, asymmetric: xr.Dataset, prolog: str) -> None:
    path = pack(tmp_path, {"main.xml": document(prolog=prolog), "bindata/data.bin": binary(asymmetric)})
    with pytest.raises(InputError, match="document type or entities"):
        read_surface(path)


@pytest.mark.parametrize("name", ["../evil.txt", "/evil.txt", "a/../../evil.txt", "..\\evil.txt", "C:/evil.txt"])
def test_names_that_leave_the_archive_are_refused_and_nothing_is_written(
    tmp_path: Path, asymmetric: xr.Dataset, name: str
) -> None:
    folder = tmp_path / "inside"
    folder.mkdir()
    path = pack(folder, {"main.xml": document(), "bindata/data.bin": binary(asymmetric), name: "evil"})
    with pytest.raises(InputError, match="unsafe entry name"):
        read_surface(path)
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["inside", "map.x3p"]


def test_a_zip_bomb_is_refused_before_it_is_inflated(tmp_path: Path) -> None:
    shape = (2000, 2000)
    path = pack(tmp_path, {"main.xml": document(shape), "bindata/data.bin": bytes(8 * shape[0] * shape[1])})
    assert path.stat().st_size < 100_000
    with pytest.raises(InputError, match="suspiciously large"):
        read_surface(path)


def test_a_huge_document_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="suspiciously large"):
        read_surface(pack(tmp_path, {"main.xml": b" " * (2**26 + 1)}))


@pytest.mark.parametrize(
    "entries", [{}, {"readme.txt": "x"}, {"a/b/main.xml": "x"}, {"a/main.xml": "", "b/main.xml": ""}]
)
def test_another_archive_is_refused(tmp_path: Path, entries: dict[str, str]) -> None:
    with pytest.raises(InputError, match="not an X3P archive"):
        read_surface(pack(tmp_path, entries))


@pytest.mark.parametrize(
    "xml", [b"", b"<a>", b"<html/>", b"\xff\xfe\x00", b'<?xml version="1.0" encoding="martian"?><a/>']
)
def test_a_broken_document_is_refused(tmp_path: Path, xml: bytes) -> None:
    with pytest.raises(InputError, match=r"main\.xml: (the XML is damaged|not an X3P document)"):
        read_surface(pack(tmp_path, {"main.xml": xml}))


@pytest.mark.parametrize("content", [b"", b"PK", b"1;2;3\n" * 99, np.random.default_rng(3).bytes(5000)])
def test_a_file_that_is_not_an_archive_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "map.x3p"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"not an X3P file.*`surface\.format`"):
        read_surface(path)


def test_a_renamed_file_is_not_guessed(tmp_path: Path, asymmetric: xr.Dataset) -> None:
    write_x3p(asymmetric, tmp_path / "map.x3p")
    renamed = (tmp_path / "map.x3p").rename(tmp_path / "map.txt")
    with pytest.raises(InputError, match="binary, not text"):
        read_surface(renamed, unit="um", pitch=1)
    assert read_surface(renamed, "x3p").height.shape == (40, 50)


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(data=st.data())
def test_damaged_bytes_are_refused_or_leave_the_heights_alone(
    tmp_path: Path, asymmetric: xr.Dataset, data: st.DataObject
) -> None:
    whole = io.BytesIO()
    with zipfile.ZipFile(whole, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("main.xml", document())
        archive.writestr("bindata/data.bin", binary(asymmetric))
    content = bytearray(whole.getvalue())
    if data.draw(st.booleans(), "truncate"):
        content = content[: data.draw(st.integers(0, len(content) - 1), "length")]
    else:
        content[data.draw(st.integers(0, len(content) - 1), "place")] ^= data.draw(st.integers(1, 255), "bits")
    path = tmp_path / "damaged.x3p"
    path.write_bytes(content)
    try:
        surface = read_surface(path)
    except InputError:
        return
    # Times and comments of the archive are not protected, heights are, by the CRC.
    np.testing.assert_allclose(surface.height, asymmetric.height, rtol=1e-15)


@pytest.mark.parametrize(
    ("name", "sq", "sdq", "missing", "shape", "dtype"),
    [
        ("KautschukInfiniteFocus.x3p", 3.40, 0.136, 0.0097, (634, 860), np.float32),
        ("x3p-2.x3p", 0.077, 0.062, 0, (650, 650), np.float64),
    ],
)
def test_real_maps_give_the_known_roughness(
    shared_data: Path, name: str, sq: float, sdq: float, missing: float, shape: tuple[int, int], dtype: type
) -> None:
    surface = read_surface(shared_data / "surfaces" / name)
    assert surface.height.shape == shape
    assert surface.height.dtype == dtype
    texture = parameters(level(surface))
    # Reference values, levelled by a plane and taken over four triangles, are given to two or three digits.
    assert float(texture.Sq) == pytest.approx(sq, rel=0.01)
    assert float(texture.Sdq) == pytest.approx(sdq, rel=0.01)
    assert float(texture.missing_fraction) == pytest.approx(missing, abs=5e-5)


def test_damaged_names_of_entries_are_cut_in_the_message(tmp_path: Path, asymmetric: xr.Dataset) -> None:
    write_x3p(asymmetric, tmp_path / "map.x3p")
    content = bytearray((tmp_path / "map.x3p").read_bytes())
    # The length of the first entry's name, in its own header.
    content[26:28] = (5000).to_bytes(2, "little")
    (tmp_path / "map.x3p").write_bytes(content)
    with pytest.raises(InputError, match="the archive is damaged") as refusal:
        read_surface(tmp_path / "map.x3p")
    assert len(str(refusal.value)) < 300


def test_a_truncated_real_map_is_refused(shared_data: Path, tmp_path: Path) -> None:
    content = (shared_data / "surfaces" / "x3p-2.x3p").read_bytes()
    for share in (0.1, 0.5, 0.99):
        (tmp_path / "cut.x3p").write_bytes(content[: int(share * len(content))])
        with pytest.raises(InputError, match=r"cut\.x3p: not an X3P file, or truncated"):
            read_surface(tmp_path / "cut.x3p")
