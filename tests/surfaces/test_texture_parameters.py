"""ISO parameters against surfaces whose values are known in closed form."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import xarray as xr

from brdfpipe.errors import BrdfpipeError
from brdfpipe.surfaces import level, parameters
from brdfpipe.surfaces.heights import Heights, surface_dataset
from brdfpipe.vocabulary import validate


def sine(count: int = 64, periods: int = 4, pitch: float = 0.5) -> np.ndarray:
    """A sine of amplitude 1 over whole periods, so that means over the points are exact."""
    return np.sin(2 * np.pi * periods * np.arange(count) / count)


def test_the_heights_of_a_sine_have_their_textbook_moments() -> None:
    texture = parameters(surface_dataset(Heights(np.tile(sine(), (40, 1)), 0.5, 0.5)))
    assert float(texture.Sq) == pytest.approx(0.5**0.5)
    assert float(texture.Sz) == pytest.approx(2)
    assert float(texture.Ssk) == pytest.approx(0, abs=1e-12)
    assert float(texture.Sku) == pytest.approx(1.5)
    # <|sin|> over 16 points a period is cot(π/16)/8, against 2/π.
    assert float(texture.Sa) == pytest.approx(1 / np.tan(np.pi / 16) / 8)


def test_a_tilted_plane_has_its_own_slope_and_area() -> None:
    x, y = np.arange(40) * 0.5, np.arange(50)[:, None] * 0.7
    texture = parameters(surface_dataset(Heights(0.3 * x + 0.4 * y, 0.5, 0.7)))
    assert float(texture.Sdq) == pytest.approx(0.5)
    assert float(texture.Sdr) == pytest.approx(1.25**0.5 - 1)


def test_the_area_of_a_nearly_flat_plane_does_not_cancel() -> None:
    x = np.arange(40) * np.ones((40, 1))
    texture = parameters(surface_dataset(Heights(1e-6 * x, 1.0, 1.0)))
    assert float(texture.Sdr) == pytest.approx(5e-13, rel=1e-9)


def test_gradients_are_those_of_the_triangles_of_both_diagonals(asymmetric: xr.Dataset) -> None:
    # Built anew from corner points and cross products, without the edge sums of the implementation.
    z = asymmetric.height.values
    corners = np.array([[0, 0], [0, 1], [1, 1], [1, 0]])
    slopes, areas = [], []
    for i, j in itertools.product(range(z.shape[0] - 1), range(z.shape[1] - 1)):
        cell = np.array([[(j + c) * 0.5, (i + r) * 0.7, z[i + r, j + c]] for r, c in corners])
        for left_out in range(4):
            a, b, c = np.delete(cell, left_out, axis=0)
            normal = np.cross(b - a, c - a)
            if not np.isnan(normal).any():
                slopes.append((normal[0] ** 2 + normal[1] ** 2) / normal[2] ** 2)
                areas.append(np.linalg.norm(normal) / abs(normal[2]))
    # A missing height takes three triangles from each of its four cells.
    assert len(slopes) == 4 * 39 * 49 - 12
    texture = parameters(asymmetric)
    assert float(texture.Sdq) == pytest.approx(np.mean(slopes) ** 0.5, rel=1e-12)
    assert float(texture.Sdr) == pytest.approx(np.mean(areas) - 1, rel=1e-10)


def test_line_slopes_of_a_sine_follow_their_transfer_functions() -> None:
    periods, count, pitch = 40, 6400, 0.5
    texture = parameters(surface_dataset(Heights(sine(count, periods), pitch)))
    w = 2 * np.pi * periods / count
    true = w / pitch / 2**0.5
    forward = np.sin(w / 2) / (w / 2)
    seven = (45 * np.sin(w) - 9 * np.sin(2 * w) + np.sin(3 * w)) / (30 * w)
    # The open end leaves out a few of 6400 slopes.
    assert float(texture.Rdq) == pytest.approx(true * forward, rel=5e-4)
    assert float(texture.Rdq_7point) == pytest.approx(true * seven, rel=5e-4)


def test_a_line_has_line_parameters_with_named_formulas(line: xr.Dataset) -> None:
    texture = parameters(level(line))
    assert set(texture) == {"Ra", "Rq", "Rz", "Rsk", "Rku", "Rdq", "Rdq_7point", "missing_fraction"}
    assert "forward difference" in texture.Rdq.attrs["long_name"]
    assert "7-point" in texture.Rdq_7point.attrs["long_name"]
    assert all("units" in variable.attrs for variable in texture.values())
    validate(texture, "parameters")


def test_missing_heights_are_counted_and_left_out(asymmetric: xr.Dataset) -> None:
    texture = parameters(asymmetric)
    assert float(texture.missing_fraction) == pytest.approx(1 / 2000)
    assert float(texture.Sq) == pytest.approx(np.nanstd(asymmetric.height.values))


def test_heights_with_no_neighbours_have_no_gradient(line: xr.Dataset) -> None:
    height = line.height.values.copy()
    height[::2] = np.nan
    texture = parameters(line.assign(height=line.height.copy(data=height)))
    assert np.isnan(float(texture.Rdq))
    assert float(texture.Rq) > 0


def test_a_surface_without_a_valid_height_is_refused(line: xr.Dataset) -> None:
    with pytest.raises(BrdfpipeError, match="no valid height"):
        parameters(line.assign(height=line.height * np.nan).assign_attrs(line.attrs))
