"""The part of a scan that counts: rectangles, polygons and pictures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from PIL import Image

from brdfpipe import vocabulary
from brdfpipe.errors import InputError
from brdfpipe.surfaces import ingest, read_surface, write_x3p

X, Y = np.meshgrid(np.arange(50) * 0.5, np.arange(60) * 0.7)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    np.save(tmp_path / "map.npy", 0.5 * np.sin(X / 3) + 0.2 * np.cos(Y / 2) + 0.001 * X * Y)
    return tmp_path / "map.npy"


def read(path: Path, **options: Any) -> xr.Dataset:
    return read_surface(path, unit="um", pitch=[0.5, 0.7], **options)


@pytest.mark.parametrize(
    ("region", "rows", "columns"),
    [
        ({"x": [2, 20]}, slice(0, 60), slice(4, 40)),
        ({"x": [2.1, 20.1], "y": [7, 35], "unit": "um"}, slice(10, 50), slice(5, 41)),
        ({"y": [3, 43], "unit": "pixels"}, slice(3, 43), slice(0, 50)),
        ({"x": [0, 25], "y": [0, 42]}, slice(0, 60), slice(0, 50)),
    ],
)
def test_a_region_is_the_points_from_its_first_position_up_to_its_last(
    path: Path, region: dict[str, Any], rows: slice, columns: slice
) -> None:
    whole, part = read(path), read(path, region=region)
    np.testing.assert_array_equal(part.height, whole.height[rows, columns])
    assert (part.attrs["pitch_x"], part.attrs["pitch_y"], float(part.x[0])) == (0.5, 0.7, 0.0)
    assert "as surface.region says" in part.attrs["history"]


@pytest.mark.parametrize("region", [{"x": [0, 30]}, {"x": [-1, 20]}, {"y": [0, 61], "unit": "pixels"}])
def test_a_region_beyond_the_scan_is_refused(path: Path, region: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=r"the region leaves the scan; found .*accepted: two rising numbers from 0 to"):
        read(path, region=region)


@pytest.mark.parametrize("limits", [[20, 2], [3, 3]])
def test_a_region_that_does_not_rise_is_called_that(path: Path, limits: list[float]) -> None:
    with pytest.raises(
        InputError, match=r"ends where it begins, or before; found .*two rising numbers from 0 to 25 um"
    ):
        read(path, region={"x": limits})


def test_a_region_of_too_few_points_names_the_region(path: Path) -> None:
    with pytest.raises(InputError, match=r"too few points .*found 60 x 10; .*set `surface\.region`"):
        read(path, region={"x": [5, 10]})


def test_a_line_has_a_stretch_and_no_y(tmp_path: Path) -> None:
    np.save(tmp_path / "line.npy", np.sin(np.arange(300) / 5))
    options = {"unit": "um", "pitch": 0.5}
    part = read_surface(tmp_path / "line.npy", region={"x": [10, 60]}, **options)
    np.testing.assert_array_equal(part.height, read_surface(tmp_path / "line.npy", **options).height[20:120])
    with pytest.raises(InputError, match=r"a line has no y.*`surface\.region\.y`"):
        read_surface(tmp_path / "line.npy", region={"x": [0, 60], "y": [0, 5]}, **options)
    with pytest.raises(InputError, match=r"a mask needs a map.*`surface\.mask`"):
        read_surface(tmp_path / "line.npy", mask={"polygons": [[[0, 0], [5, 0], [0, 5]]]}, **options)


def test_the_inside_of_polygons_is_left_out(path: Path) -> None:
    triangle, square = [[1.1, 1.1], [15.3, 1.3], [2.2, 20.4]], [[18.1, 30.1], [24.1, 30.1], [24.1, 40.1], [18.1, 40.1]]
    surface = read(path, mask={"polygons": [triangle, square]})

    def side(a: list[float], b: list[float]) -> np.ndarray:
        """Left of the edge from a to b."""
        return (b[0] - a[0]) * (Y - a[1]) - (b[1] - a[1]) * (X - a[0]) > 0

    inside = side(*triangle[:2]) & side(*triangle[1:]) & side(triangle[2], triangle[0])
    inside |= (X > 18.1) & (X < 24.1) & (Y > 30.1) & (Y < 40.1)
    np.testing.assert_array_equal(np.isnan(surface.height), inside)
    in_points = [[[x / 0.5, y / 0.7] for x, y in corners] for corners in (triangle, square)]
    same = read(path, mask={"polygons": in_points, "unit": "pixels"})
    np.testing.assert_array_equal(same.height, surface.height)


def test_a_polygon_around_a_hole_leaves_the_hole(path: Path) -> None:
    outer, hole = [[1, 1], [21, 1], [21, 21], [1, 21]], [[8, 8], [8, 14], [14, 14], [14, 8]]
    surface = read(path, mask={"polygons": [[*outer, outer[0], hole[0], *hole[1:], hole[0]]]})
    assert np.isnan(float(surface.height.sel(x=4, y=10.5, method="nearest")))
    assert np.isfinite(float(surface.height.sel(x=11, y=10.5, method="nearest")))


@pytest.mark.parametrize("suffix", ["png", "tif", "bmp"])
def test_dark_points_of_a_picture_are_left_out_upper_edge_first(path: Path, suffix: str) -> None:
    picture = np.full((60, 50), 255, np.uint8)
    picture[:10, :20] = 0  # the upper left corner as one sees it
    Image.fromarray(picture).save(path.with_name(f"mask.{suffix}"))
    surface = ingest(
        path,
        {"unit": "um", "pitch": [0.5, 0.7], "form": "none", "mask": {"file": f"mask.{suffix}"}},
        path.with_name(f"mask.{suffix}"),
    )
    np.testing.assert_array_equal(np.isnan(surface.height), (np.arange(60)[:, None] >= 50) & (np.arange(50) < 20))


def levels(share: np.ndarray, dtype: str) -> np.ndarray:
    """Grey values of a type of whole numbers, from shares of its range."""
    return np.round(share * np.iinfo(dtype).max).astype(dtype)


DARK, GREY, PALE = 0.016, 0.4, 0.6
"""Shares of white: a dark grey below the 8-bit range of 16 bits, and one on either side of the limit."""
SHADES = np.full((60, 50), 1.0)
SHADES[:10, :20], SHADES[20:30, :20], SHADES[40:50, :20] = DARK, GREY, PALE
MASKED = (SHADES < 0.5)[::-1]
SEE_THROUGH = (np.arange(60)[:, None] < 55) & (np.arange(50) >= 30)


def palette() -> Image.Image:
    """Shades by their place in a list of colours that runs from white to black."""
    image = Image.fromarray(255 - levels(SHADES, "u1")).convert("P")
    image.putpalette([255 - place for place in range(256) for _ in range(3)])
    return image


def with_alpha(mode: str) -> Image.Image:
    """The shades, opaque, beside black that is transparent."""
    grey = np.where(SEE_THROUGH, 0, levels(SHADES, "u1")).astype("u1")
    alpha = np.where(SEE_THROUGH, 0, 255).astype("u1")
    return Image.merge(mode, [Image.fromarray(part) for part in (*[grey] * (len(mode) - 1), alpha)])


PICTURES = {
    "1.png": lambda: Image.fromarray(SHADES >= 0.5),
    "L.png": lambda: Image.fromarray(levels(SHADES, "u1")),
    "L.bmp": lambda: Image.fromarray(levels(SHADES, "u1")),
    "P.png": palette,
    "P.bmp": palette,
    "RGB.png": lambda: Image.fromarray(levels(SHADES, "u1")).convert("RGB"),
    "RGB.bmp": lambda: Image.fromarray(levels(SHADES, "u1")).convert("RGB"),
    "CMYK.tif": lambda: Image.fromarray(levels(SHADES, "u1")).convert("RGB").convert("CMYK"),
    "LA.png": lambda: with_alpha("LA"),
    "LA.tif": lambda: with_alpha("LA"),
    "RGBA.png": lambda: with_alpha("RGBA"),
    "RGBA.tif": lambda: with_alpha("RGBA"),
    "I;16.png": lambda: Image.fromarray(levels(SHADES, "u2")),
    "I;16.tif": lambda: Image.fromarray(levels(SHADES, "u2")),
    "I;16B.tif": lambda: Image.fromarray(levels(SHADES, "u2").astype(">u2")),
}
"""Pictures of the shades by Pillow's mode and extension."""


@pytest.mark.parametrize("name", PICTURES)
def test_dark_is_below_half_of_the_range_in_every_mode(path: Path, name: str) -> None:
    mode, suffix = name.split(".")
    picture = path.with_name(f"mask.{suffix}")
    PICTURES[name]().save(picture)
    with Image.open(picture) as image:
        assert image.mode == mode
    surface = read(path, mask={"file": picture.name}, picture=picture)
    np.testing.assert_array_equal(np.isnan(surface.height), MASKED)


@pytest.mark.parametrize("name", ["L.png", "P.png", "RGB.png", "I;16.png"])
def test_a_transparent_colour_is_bright(path: Path, name: str) -> None:
    picture = path.with_name("mask.png")
    image = PICTURES[name]()
    dark = image.getpixel((0, 0))
    image.save(picture, transparency=dark)
    surface = read(path, mask={"file": "mask.png"}, picture=picture)
    np.testing.assert_array_equal(np.isnan(surface.height), (SHADES == GREY)[::-1])


@pytest.mark.parametrize(("dtype", "mode"), [("i4", "I"), ("i2", "I"), ("f4", "F")])
def test_a_picture_whose_white_is_not_known_is_refused(path: Path, dtype: str, mode: str) -> None:
    picture = path.with_name("mask.tif")
    Image.fromarray((255 * (SHADES > 0.5)).astype(dtype)).save(picture)
    message = rf"^mask\.tif: cannot tell dark points; found a picture of mode {mode}, .*accepted: grey or colour of 8 bits, or grey of 16 bits.*`surface\.mask\.file`"
    with pytest.raises(InputError, match=message):
        read(path, mask={"file": "mask.tif"}, picture=picture)


def test_what_is_masked_is_not_lost_by_the_measurement(path: Path) -> None:
    half = {"polygons": [[[-1, -1], [13, -1], [13, 50], [-1, 50]]]}
    masked = read(path, mask=half)
    assert float(np.isnan(masked.height).mean()) > 0.5
    assert vocabulary.warnings(masked) == []
    assert vocabulary.warnings(read(path, mask=half, region={"x": [5, 25]})) == []
    gappy = np.load(path)
    gappy[:2] = np.nan
    np.save(path, gappy)
    # 2 of 60 rows are missing, of those that are not masked too.
    assert any("3.3% of the heights are missing" in text for text in vocabulary.warnings(read(path, mask=half)))


def test_a_region_that_is_masked_whole_is_refused(path: Path) -> None:
    with pytest.raises(InputError, match=r"leaves out all of the region.*`surface\.mask`"):
        read(path, mask={"polygons": [[[-1, -1], [13, -1], [13, 50], [-1, 50]]]}, region={"x": [0, 10]})


def test_a_mask_counts_from_the_file_and_a_region_of_it_is_read(path: Path) -> None:
    mask = {"polygons": [[[0, 0], [5, 0], [5, 5], [0, 5]]]}
    both = read(path, mask=mask, region={"x": [2, 25], "y": [0, 42]})
    np.testing.assert_array_equal(both.height, read(path, mask=mask).height[:, 4:])


def test_pictures_that_do_not_fit_or_are_damaged_are_refused(path: Path) -> None:
    picture = path.with_name("mask.png")
    Image.fromarray(np.zeros((50, 60), np.uint8)).save(picture)
    with pytest.raises(
        InputError, match=r"^mask\.png: the picture has another size than the map; found 60 x 50; accepted: 50 x 60"
    ):
        read(path, mask={"file": "mask.png"}, picture=picture)
    Image.fromarray(np.zeros((60, 50), np.uint8)).save(picture)
    with pytest.raises(InputError, match="leaves out all or nothing; found every height"):
        read(path, mask={"file": "mask.png"}, picture=picture)
    for content in (b"", b"\x89PNG\r\n\x1a\n", picture.read_bytes()[:60]):
        picture.write_bytes(content)
        with pytest.raises(InputError, match=r"^mask\.png: not a picture, or damaged"):
            read(path, mask={"file": "mask.png"}, picture=picture)
    with pytest.raises(InputError, match="no picture for this scan"):
        read(path, mask={"file": "mask.png"})


def test_other_formats_are_selected_from_too(tmp_path: Path, asymmetric: xr.Dataset) -> None:
    write_x3p(asymmetric, tmp_path / "map.x3p")
    part = read_surface(tmp_path / "map.x3p", region={"x": [4, 50], "y": [2, 40], "unit": "pixels"})
    np.testing.assert_allclose(part.height, asymmetric.height[2:, 4:], rtol=1e-12)
