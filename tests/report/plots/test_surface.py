from __future__ import annotations

import io
import re
from base64 import b64decode

import numpy as np
import pytest
import xarray as xr
from PIL import Image

from brdfpipe import vocabulary
from brdfpipe.report.plots import surface
from brdfpipe.report.plots.raster import viridis


def _map(height: np.ndarray) -> xr.Dataset:
    rows, columns = height.shape
    coords = {"x": np.arange(columns) * 1.0, "y": np.arange(rows) * 1.0}
    return vocabulary.label(xr.Dataset({"height": (("y", "x"), height)}, coords=coords), "surface")


def _picture(svg: str) -> np.ndarray:
    data = re.search(r"data:image/png;base64,([^\"]+)", svg)
    assert data is not None
    return np.asarray(Image.open(io.BytesIO(b64decode(data[1]))).convert("RGB"))


def test_the_map_has_y_upwards() -> None:
    height = np.zeros((64, 64))
    height[:32] = 1.0  # high at small y
    picture = _picture(surface.height_map(_map(height)).svg).astype(int)
    yellow, violet = viridis(np.array([1.0, 0.0])).astype(int)
    assert np.abs(picture[-1, 0] - yellow).max() <= 2
    assert np.abs(picture[0, 0] - violet).max() <= 2


def test_missing_heights_have_a_colour_of_their_own() -> None:
    height = np.random.default_rng(0).normal(size=(64, 64))
    height[-8:, :8] = np.nan
    picture = _picture(surface.height_map(_map(height)).svg)
    assert (picture[0, 0] == [240, 90, 120]).all()
    assert not (picture[-1, -1] == [240, 90, 120]).all()


def test_a_large_map_is_reduced() -> None:
    picture = _picture(surface.height_map(_map(np.random.default_rng(0).normal(size=(1000, 1500)))).svg)
    assert max(picture.shape[:2]) <= 300
    assert picture.shape[0] / picture.shape[1] == pytest.approx(1000 / 1500, rel=0.02)


def test_a_single_spike_does_not_flatten_the_colours_of_the_rest() -> None:
    height = np.tile(np.linspace(0, 1, 100), (100, 1))
    height[50, 50] = 1e4
    picture = _picture(surface.height_map(_map(height)).svg)
    assert len(np.unique(picture[0], axis=0)) > 50


def test_the_note_on_a_long_narrow_map_states_that_it_is_not_to_scale() -> None:
    assert "not to the same scale" in surface.height_map(_map(np.random.default_rng(0).normal(size=(32, 1000)))).note


@pytest.mark.parametrize(("rows", "columns"), [(100, 1000), (500, 50)])
def test_a_wide_or_tall_map_is_to_scale(rows: int, columns: int) -> None:
    figure = surface.height_map(_map(np.random.default_rng(0).normal(size=(rows, columns))))
    assert "scale" not in figure.note
    wide, tall = map(float, re.search(r'<image [^>]*width="([\d.]+)" height="([\d.]+)"', figure.svg).groups())
    assert wide / tall == pytest.approx((columns - 1) / (rows - 1), rel=0.02)


@pytest.mark.parametrize("height", [np.zeros((40, 40)), np.full((40, 40), 5.0)])
def test_a_flat_map_is_still_a_picture(height: np.ndarray) -> None:
    assert _picture(surface.height_map(_map(height)).svg).shape == (40, 40, 3)


def test_a_long_profile_keeps_its_peak() -> None:
    height = np.zeros(20_000)
    height[12_345] = 7.0
    _, shown = surface._envelope(np.arange(20_000.0), height)
    assert shown.size < 1000
    assert shown.max() == 7.0


def test_viridis_runs_from_violet_to_yellow_and_gets_lighter_all_the_way() -> None:
    colours = viridis(np.linspace(0, 1, 64)).astype(float)
    assert (np.diff(colours @ [0.2126, 0.7152, 0.0722]) > 0).all()
