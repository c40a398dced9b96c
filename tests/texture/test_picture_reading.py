"""Pictures of a paint as linear values."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from brdfpipe.errors import InputError
from brdfpipe.texture.picture_reading import read_picture


def values(size=80):
    return np.random.default_rng(1).random((size, size))


def saved(path, array):
    Image.fromarray(array).save(path)
    return path


def test_sixteen_bits_and_floats_are_proportional_to_the_light_with_the_lower_row_first(tmp_path):
    light = values()
    for name, array in (
        ("a.png", (light * 65535).astype(np.uint16)),
        ("a.tif", (light * 7).astype(np.float32)),
    ):
        picture = read_picture(saved(tmp_path / name, array))
        assert picture.warnings == ()
        assert picture.values / picture.values.mean() == pytest.approx(light[::-1] / light.mean(), abs=1e-4)


def test_eight_bits_are_taken_as_srgb_with_a_warning_and_stated_curves_without(tmp_path):
    light = values()
    encoded = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    path = saved(tmp_path / "a.png", np.minimum(encoded * 255, 254).round().astype(np.uint8))
    picture = read_picture(path)
    assert any("texture.curve" in text for text in picture.warnings)
    assert picture.values[::-1] == pytest.approx(light, abs=0.01)
    assert read_picture(path, "srgb").warnings == ()
    linear = read_picture(path, "linear")
    assert linear.values[::-1] == pytest.approx(encoded, abs=0.01)


def test_colours_become_luminance(tmp_path):
    colour = np.zeros((70, 70, 3), dtype=np.uint8)
    colour[..., 1] = 128
    assert read_picture(saved(tmp_path / "a.png", colour), "linear").values == pytest.approx(0.7152 * 128 / 255)


def test_saturated_sparkles_are_warned_of(tmp_path):
    light = (values() * 40000).astype(np.uint16)
    light[3:5, 3:5] = 65535
    picture = read_picture(saved(tmp_path / "a.png", light))
    assert any("4 of 6400 values are saturated" in text for text in picture.warnings)
    assert picture.stored == "grey of 16 bits, linear"


def test_what_is_no_picture_of_a_paint_is_refused(tmp_path):
    (tmp_path / "text.png").write_text("no picture")
    (tmp_path / "cut.png").write_bytes(
        saved(tmp_path / "whole.png", (values() * 255).astype(np.uint8)).read_bytes()[:900]
    )
    saved(tmp_path / "small.png", np.zeros((8, 900), np.uint8))
    saved(tmp_path / "black.png", np.zeros((80, 80), np.uint8))
    saved(tmp_path / "clear.png", np.zeros((80, 80, 4), np.uint8))
    bad = values().astype(np.float32)
    bad[0, 0] = np.nan
    saved(tmp_path / "missing.tif", bad)
    saved(tmp_path / "dark.tif", np.full((80, 80), -0.5, np.float32))
    Image.new("L", (80, 80)).save(tmp_path / "lossy.jpg")
    for name, words in (
        ("text.png", "not a picture"),
        ("cut.png", "not a picture"),
        ("small.png", "too small"),
        ("black.png", "found 0 everywhere"),
        ("clear.png", "kind of the picture"),
        ("missing.tif", "found 1 of 6400 not finite"),
        ("dark.tif", "found 6400 of 6400 below 0, down to -0.5"),
        ("lossy.jpg", "not a picture"),
        ("absent.png", "not a picture"),
    ):
        with pytest.raises(InputError, match=words):
            read_picture(tmp_path / name)


def test_a_small_file_of_a_huge_picture_is_refused_before_it_is_unpacked(tmp_path):
    """A bomb: a megabyte of file, gigabytes of pixels; its header alone is read."""
    import struct
    import zlib

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    for side, found in ((8_500, "8500 x 8500"), (12_000, "more pixels"), (60_000, "more pixels")):
        header = struct.pack(">IIBBBBB", side, side, 8, 0, 0, 0, 0)
        path = tmp_path / "bomb.png"
        path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", b"") + chunk(b"IEND", b""))
        with pytest.raises(InputError, match=found):
            read_picture(path)
