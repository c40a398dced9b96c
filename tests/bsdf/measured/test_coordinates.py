"""Angles about the mirror direction, their inverse, and their use."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from brdfpipe.bsdf.measured import coordinates
from brdfpipe.geometry import unit_vector
from brdfpipe.specular_directions import outgoing


def angles(about, theta_i, theta_o, phi):
    return tuple(
        float(angle[0])
        for angle in coordinates.angles(about, *(np.array([angle]) for angle in (theta_i, theta_o, phi)))
    )


@pytest.mark.parametrize("about", coordinates.ABOUT)
@given(st.floats(0, 89), st.floats(0, 89), st.floats(-180, 180))
def test_outgoing_directions_return(about, theta_i, theta_o, phi):
    incidence = np.array([theta_i])
    there = coordinates.angles(about, incidence, np.array([theta_o]), np.array([phi]))
    back = coordinates.outgoing(about, incidence, *there)
    assert unit_vector(*back) == pytest.approx(unit_vector([theta_o], [phi]), abs=1e-7)


@pytest.mark.parametrize("about", coordinates.ABOUT)
def test_the_mirror_direction_is_the_centre_and_the_normal_is_at_azimuth_0(about):
    assert angles(about, 40.0, 40.0, 180.0)[0] == pytest.approx(0, abs=1e-9)
    theta, phi = angles(about, 40.0, 25.0, 180.0)
    assert (theta, phi) == (pytest.approx(15), pytest.approx(0, abs=1e-9))
    theta, phi = angles(about, 40.0, 55.0, 180.0)
    assert (theta, abs(phi)) == (pytest.approx(15), pytest.approx(180))


@pytest.mark.parametrize("about", coordinates.ABOUT)
def test_angles_of_cells_are_those_of_their_outgoing_directions(about):
    theta_s, phi_s = np.array([0.0, 5.0, 20.0, 60.0]), np.array([0.0, 70.0, -120.0, 10.0])
    theta_o, phi_o = outgoing(30.0, theta_s, phi_s)
    expected = coordinates.angles(about, np.full(4, 30.0), theta_o, phi_o)
    values = coordinates.cell_angles(about, 30.0, theta_s, phi_s)
    assert unit_vector(*values) == pytest.approx(unit_vector(*expected), abs=1e-9)


def test_facets_of_one_tilt_are_a_circle_in_the_coordinates_of_the_half_vector():
    phi = np.arange(0.0, 360.0, 30.0)
    theta_o, phi_o = coordinates.outgoing("half", np.full(12, 60.0), np.full(12, 4.0), phi)
    half = unit_vector(60.0, 0.0) + unit_vector(theta_o, phi_o)
    tilt = np.degrees(np.arctan2(np.hypot(half[:, 0], half[:, 1]), half[:, 2]))
    assert tilt == pytest.approx(2.0)
    # About the mirror direction at 60° they are an ellipse, twice as long in the plane of incidence as across.
    about_mirror, _ = coordinates.angles("mirror", np.full(12, 60.0), theta_o, phi_o)
    assert about_mirror.max() / about_mirror.min() == pytest.approx(2, rel=0.01)


@pytest.mark.parametrize("about", coordinates.ABOUT)
def test_directions_below_the_horizon_have_finite_angles(about):
    values = coordinates.angles(about, np.full(3, 60.0), np.array([95.0, 120.0, 120.0]), np.array([180.0, 0.0, 180.0]))
    assert np.isfinite(values).all()
