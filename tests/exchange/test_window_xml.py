"""The document of WINDOW and Radiance: which files are refused before their values are read."""

from __future__ import annotations

import pytest

from brdfpipe.errors import InputError
from brdfpipe.exchange import window_xml

RECORD = {"material": "<a & b>", "digest": "abc", "left_out": {}}
RECORD["error"] = {"percentile_95": 0.1, "albedo": 0.01, "directions": 10, "reading": "one value for each cell"}


def written(tmp_path, *names):
    block = window_xml.Block("<AngleBasis>x</AngleBasis>", b"1 2 3\n")
    path = tmp_path / "x.xml"
    path.write_bytes(b"".join(window_xml.document(RECORD, "Columns", "", dict.fromkeys(names, block))))
    return path


def test_blocks_are_found_by_the_names_of_their_sides(tmp_path):
    path = written(tmp_path, "Reflection Back", "Transmission Back")
    blocks, notes = window_xml.from_above(path, window_xml.layer(path))
    assert list(blocks) == ["Reflection Back", "Transmission Back"]
    assert window_xml.text(blocks["Reflection Back"], "ScatteringData") == "1 2 3"
    assert window_xml.text(window_xml.layer(path), "Material/Name") == "<a & b>"
    assert notes == ()


def test_a_file_without_reflection_or_with_two_is_refused(tmp_path):
    path = written(tmp_path, "Transmission Back")
    with pytest.raises(InputError, match="no reflection"):
        window_xml.from_above(path, window_xml.layer(path))
    path.write_text(
        path.read_text().replace("</Layer>", path.read_text().split("</Material>")[1].split("</Layer>")[0] + "</Layer>")
    )
    with pytest.raises(InputError, match="occurs twice"):
        window_xml.from_above(path, window_xml.layer(path))


def test_entities_are_refused(tmp_path):
    lines = "".join(f'<!ENTITY a{n} "&a{n - 1};&a{n - 1};">' for n in range(1, 40))
    (tmp_path / "x.xml").write_text(f'<!DOCTYPE x [<!ENTITY a0 "ha">{lines}]><WindowElement>&a39;</WindowElement>')
    with pytest.raises(InputError, match="entities"):
        window_xml.layer(tmp_path / "x.xml")
