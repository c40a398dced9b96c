"""Files of height and normal maps."""

from __future__ import annotations

import json

import numpy as np
import pytest
import relief_maps
import samples
from PIL import Image

from brdfpipe import facets
from brdfpipe.texture.exr import exr_bytes
from brdfpipe.texture.map_files import write_maps
from brdfpipe.texture.scan_texture import normals_of, of_scan


@pytest.fixture(scope="module")
def texture():
    surface = samples.surface(relief_maps.two_scales(256, 1) * 0.4)
    return of_scan(surface, facets.estimate(surface), pixel=4.0, size=96, seed=1)


@pytest.fixture(scope="module")
def written(texture, tmp_path_factory):
    folder = tmp_path_factory.mktemp("maps")
    return folder, write_maps(texture, folder, "panel")


def test_files_hold_heights_and_normals_with_the_first_row_at_the_upper_edge(texture, written):
    folder, record = written
    assert json.loads((folder / "panel.maps.json").read_text()) == record
    with Image.open(folder / "panel.height.png") as picture:
        read = np.asarray(picture).astype(float)
    span = record["height"]["um_at_65535"] - record["height"]["um_at_0"]
    heights = record["height"]["um_at_0"] + read[::-1] / 65535 * span
    assert heights == pytest.approx(texture["height"].values, abs=span / 65535)
    with Image.open(folder / "panel.normal.png") as picture:
        assert picture.size == (96, 96)
        # Pillow reads the upper 8 bits of 16-bit colours.
        coarse = np.asarray(picture)[::-1] / 255 * 2 - 1
    assert coarse == pytest.approx(normals_of(texture), abs=0.02)


def test_another_program_reads_the_same_from_every_file(texture, written):
    """Mitsuba reads PNG and OpenEXR by libraries of their own."""
    mitsuba = pytest.importorskip("mitsuba", reason="Mitsuba is not there: make peers")
    before = mitsuba.variant()
    mitsuba.set_variant("scalar_rgb")
    try:
        folder, _ = written

        def read(name):
            return np.array(mitsuba.Bitmap(str(folder / name)), dtype=float)[::-1]

        normals = normals_of(texture)
        assert read("panel.normal.exr") == pytest.approx(normals, abs=1e-7)
        assert read("panel.height.exr").squeeze() == pytest.approx(texture["height"].values, abs=1e-6)
        assert read("panel.normal.png") / 65535 * 2 - 1 == pytest.approx(normals, abs=1.1 / 65535)
    finally:
        if before is not None:
            mitsuba.set_variant(before)


def test_an_exr_file_is_laid_out_as_its_description_says():
    values = np.arange(6.0).reshape(2, 3)
    content = exr_bytes({"Y": values}, "two rows")
    assert content[:4] == bytes([0x76, 0x2F, 0x31, 0x01])
    # After the header: offsets of the rows, and of each row its number, its size and its values.
    offsets = np.frombuffer(content[-2 * (8 + 12) - 16 : -2 * (8 + 12)], "<u8")
    for row, offset in enumerate(offsets):
        number, size = np.frombuffer(content[offset : offset + 8], "<i4")
        assert (number, size) == (row, 12)
        assert np.frombuffer(content[offset + 8 : offset + 20], "<f4").tolist() == values[row].tolist()
