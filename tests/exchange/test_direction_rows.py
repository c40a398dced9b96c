"""Rows of pairs of directions as grids: azimuths, symmetry, and directions at the normal."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from brdfpipe.errors import InputError
from brdfpipe.exchange.direction_rows import Rows, gridded_rows

PATH = Path("x.astm")


def rows(theta_i, phi_i, theta_o, phi_o, value) -> Rows:
    """Rows of all combinations, shuffled; ``value`` is a function of the four angles."""
    angles = [axis.ravel() for axis in np.meshgrid(*map(np.asarray, (theta_i, phi_i, theta_o, phi_o)), indexing="ij")]
    order = np.random.default_rng(0).permutation(angles[0].size)
    theta_i, phi_i, theta_o, phi_o = (axis[order].astype(float) for axis in angles)
    return Rows(theta_i, phi_i, theta_o, phi_o, np.asarray(value(theta_i, phi_i, theta_o, phi_o), dtype=float)[:, None])


def test_one_azimuth_of_incidence_counts_as_0():
    grid = gridded_rows(rows([0, 30], [90], [0, 40], [0, 90, 180, 270], lambda *at: at[3]), PATH)
    assert grid.axes["phi_o"].tolist() == [0, 90, 180, 270, 360]
    assert grid.values[0, 0, :, 0].tolist() == [90, 180, 270, 0, 90]


@pytest.mark.parametrize("given", [[0, 60, 180], [0, 180, 300], [180, 300, 360]])
def test_azimuths_on_one_side_are_those_from_0_to_180(given):
    grid = gridded_rows(rows([0, 30], [0], [0, 40], given, lambda *at: np.cos(np.radians(at[3]))), PATH)
    assert grid.axes["phi_o"].tolist() == [0, 60, 180]
    assert grid.values[1, 1, :, 0] == pytest.approx([1, 0.5, -1])
    assert "one side" in grid.notes[0]


def test_ends_of_a_half_circle_without_rows_have_no_value():
    grid = gridded_rows(rows([0, 30], [0], [20, 40], [30, 60, 150], lambda *at: at[3]), PATH)
    assert grid.axes["phi_o"].tolist() == [0, 30, 60, 150, 180]
    assert np.isnan(grid.values[0, 0, :, 0]).tolist() == [True, False, False, False, True]


def test_a_scan_in_the_plane_of_incidence_says_so_and_negative_angles_are_its_other_side():
    grid = gridded_rows(rows([10, 30], [0], [-40, -20, 0, 20, 40], [180], lambda *at: at[2]), PATH)
    assert grid.axes["theta_o"].tolist() == [0, 20, 40]
    assert grid.axes["phi_o"].tolist() == [0, 180]
    assert grid.values[0, :, :, 0].tolist() == [[0, 0], [-20, 20], [-40, 40]]
    assert "negative" in grid.notes[0]
    assert "plane of incidence alone" in grid.notes[1]


def test_a_gap_of_half_a_turn_or_more_is_a_cell_without_a_value():
    grid = gridded_rows(rows([10, 30], [0], [20, 40], [100, 180, 260], lambda *at: at[3]), PATH)
    assert grid.axes["phi_o"].tolist() == [0, 100, 180, 260, 360]
    assert np.isnan(grid.values[..., 0, 0]).all()


def test_at_the_normal_one_row_stands_for_all_azimuths():
    given = rows([0, 30], [0, 90, 180, 270], [0, 40], [0, 90, 180, 270], lambda *at: at[2] + at[0] * (1 + at[1]))
    keep = ((given.theta_o > 0) | (given.phi_o == 0)) & ((given.theta_i > 0) | (given.phi_i == 0))
    grid = gridded_rows(
        Rows(*(getattr(given, name)[keep] for name in ("theta_i", "phi_i", "theta_o", "phi_o", "values"))), PATH
    )
    whole = gridded_rows(given, PATH)
    assert grid.values == pytest.approx(whole.values)
    assert np.isfinite(grid.values).all()


def test_several_azimuths_of_incidence_have_relative_azimuths_of_scatter():
    def value(theta_i, phi_i, theta_o, phi_o):
        return (phi_o - phi_i) % 360 + 1000 * phi_i

    grid = gridded_rows(rows([0.5, 30], [0, 90, 180, 270], [10, 40], [0, 90, 180, 270], value), PATH)
    assert list(grid.axes) == ["phi_i", "theta_i", "theta_o", "phi_o"]
    assert grid.axes["phi_i"].tolist() == [0, 90, 180, 270, 360]
    assert grid.values[1, 0, 0, :, 0].tolist() == [90000, 90090, 90180, 90270, 90000]


def test_azimuths_of_scatter_that_do_not_fit_those_of_incidence_are_interpolated():
    def value(theta_i, phi_i, theta_o, phi_o):
        return np.cos(np.radians(phi_o - phi_i))

    grid = gridded_rows(rows([1, 30], [0, 95, 180, 270], [10, 40], np.arange(0, 360, 10), value), PATH)
    assert "interpolated" in grid.notes[0]
    # Cosines between nodes 10 degree apart err by at most 0.4 %.
    assert grid.values[1, 1, 1, :, 0] == pytest.approx(np.cos(np.radians(grid.axes["phi_o"])), abs=0.004)


def test_of_a_doubled_direction_the_first_row_holds():
    one = rows([0, 30], [0], [0, 40], [0, 180, 90], lambda *at: at[2])
    doubled = Rows(
        *(np.append(getattr(one, name), getattr(one, name)[:1]) for name in ("theta_i", "phi_i", "theta_o", "phi_o")),
        np.append(one.values, [[7.0]], axis=0),
    )
    grid = gridded_rows(doubled, PATH)
    assert grid.values == pytest.approx(gridded_rows(one, PATH).values)
    assert "1 rows repeat" in grid.notes[0]


def test_scattered_directions_are_no_grid():
    generator = np.random.default_rng(5)
    angles = generator.uniform(0, 80, (4, 500))
    with pytest.raises(InputError, match="no grid about the normal"):
        gridded_rows(Rows(*angles, np.ones((500, 1))), PATH)


def test_half_a_circle_of_a_surface_with_a_lay_is_refused():
    with pytest.raises(InputError, match="no circle"):
        gridded_rows(rows([0, 30], [0, 90], [0, 40], [0, 90, 180], lambda *at: at[2]), PATH)
