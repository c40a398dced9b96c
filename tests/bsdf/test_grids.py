"""Layouts of tables: there and back again, and what their angles mean."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from brdfpipe.bsdf import grids
from brdfpipe.geometry import half_vector, unit_vector

polar, azimuth = st.floats(0, 89.99), st.floats(-180, 180)


@pytest.mark.parametrize("kind", grids.GRIDS)
@given(theta_i=polar, phi_i=azimuth, theta_o=polar, phi_o=azimuth)
def test_coordinates_convert_back_to_directions(kind, theta_i, phi_i, theta_o, phi_o):
    asked = tuple(np.array([angle]) for angle in (theta_i, phi_i, theta_o, phi_o))
    returned = grids.GRIDS[kind].directions(grids.GRIDS[kind].coordinates(*asked))
    for k in (0, 2):
        # Compared as vectors: azimuths are periodic, and undefined at the pole.
        assert unit_vector(returned[k], returned[k + 1]) == pytest.approx(unit_vector(asked[k], asked[k + 1]), abs=1e-9)


def test_the_mirror_direction_is_the_origin_of_the_specular_layout():
    theta_s, _ = grids.specular_angles(np.array([30.0]), np.array([20.0]), np.array([30.0]), np.array([200.0]))
    assert theta_s[0] == pytest.approx(0, abs=1e-12)


def test_azimuth_zero_about_the_mirror_direction_points_to_the_normal():
    # cos γ = sin ϑ cos φ sin σ + cos ϑ cos σ (Voloboy et al. 2005): σ = 45, (20, 30) gives .8739067326.
    theta_o, _ = grids.from_mirror(np.array([45.0]), np.array([0.0]), np.array([20.0]), np.array([30.0]))
    assert np.cos(np.radians(theta_o[0])) == pytest.approx(0.8739067326, abs=1e-10)


def test_the_half_angles_are_those_of_the_facet_between():
    # CRF's example (30, 60, 90): ζ = 32.17054686, α = 36.20602311.
    angles = grids.half_angles(*(np.array([angle]) for angle in (30.0, 0.0, 60.0, 90.0)))
    assert angles["theta_d"][0] == pytest.approx(32.17054686, abs=5e-9)
    assert angles["theta_h"][0] == pytest.approx(36.20602311, abs=5e-9)
    assert np.tan(np.radians(angles["theta_h"][0])) ** 2 == pytest.approx(half_vector(30, 0, 60, 90).slope_squared)


@given(theta_i=polar, theta_o=polar, phi=st.floats(1, 179))
def test_the_two_ways_of_a_pair_lie_half_a_turn_apart(theta_i, theta_o, phi):
    there = grids.half_angles(*(np.array([angle]) for angle in (theta_i, 0.0, theta_o, phi)))
    back = grids.half_angles(*(np.array([angle]) for angle in (theta_o, phi, theta_i, 0.0)))
    if there["theta_d"][0] > 1e-3:
        assert abs(np.cos(np.radians(there["phi_d"] - back["phi_d"]))[0] + 1) < 1e-6
