"""Directions and half vectors, to the reference values and through the corners."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st

from brdfpipe import geometry
from brdfpipe.errors import VocabularyError

polar = st.floats(0, 89.9)
azimuth = st.floats(-360, 360)


def test_half_vector_of_the_reference_directions():
    # Reference: (30, 60, 90) gives ζ = 32.17054686 and α = 36.20602311.
    half = geometry.half_vector(30, 0, 60, 90)
    assert np.degrees(np.arccos(half.cos_zeta)) == pytest.approx(32.17054686, abs=5e-9)
    assert np.degrees(np.arctan(np.sqrt(half.slope_squared))) == pytest.approx(36.20602311, abs=5e-9)


@given(polar, azimuth, polar, azimuth)
def test_half_vector_is_that_of_the_plain_vectors(theta_i, phi_i, theta_o, phi_o):
    half = geometry.half_vector(theta_i, phi_i, theta_o, phi_o)
    total = geometry.unit_vector(theta_i, phi_i) + geometry.unit_vector(theta_o, phi_o)
    # Vectors lose digits near the mirror direction, hence absolute.
    assert half.cos_zeta == pytest.approx(np.linalg.norm(total) / 2, abs=1e-12)
    assert half.slope_squared * total[2] ** 2 == pytest.approx(total[0] ** 2 + total[1] ** 2, abs=1e-12)


@given(polar, azimuth, polar, azimuth)
def test_half_vector_is_symmetric_in_both_directions(theta_i, phi_i, theta_o, phi_o):
    forward = geometry.half_vector(theta_i, phi_i, theta_o, phi_o)
    backward = geometry.half_vector(theta_o, phi_o, theta_i, phi_i)
    assert np.stack(forward[:2]) == pytest.approx(np.stack(backward[:2]), rel=1e-13, abs=1e-30)
    assert np.array_equal(np.stack(forward[2:4]), np.stack(backward[4:]))


@pytest.mark.parametrize("theta", [0.0, 30.0, 60.0, 89.0])
def test_slopes_are_resolved_next_to_the_mirror_direction(theta):
    # Tilting the view by 2δ in the plane of incidence tilts the facet by δ; the textbook form loses δ below 1e-8.
    delta = 1e-10
    half = geometry.half_vector(theta, 0, theta + 2 * np.degrees(delta), 180)
    assert np.sqrt(half.slope_squared) == pytest.approx(delta, rel=1e-4)


def test_plain_angles_of_different_lengths_are_refused_by_name():
    with pytest.raises(VocabularyError, match=r"theta_i \(2,\), theta_o \(3,\); give equal lengths"):
        geometry.broadcast(theta_i=np.zeros(2), phi_i=np.zeros(()), theta_o=np.zeros(3))


def test_labelled_angles_of_different_coordinates_are_refused():
    first = xr.DataArray([0.0, 10.0, 20.0], coords={"x": [0, 1, 2]}, dims="x")
    for second in (first.assign_coords(x=[1, 2, 3]), first[:2].drop_vars("x")):
        with pytest.raises(VocabularyError, match="differ in coordinates or size"):
            geometry.broadcast(theta_i=first, theta_o=second)
    with pytest.raises(VocabularyError, match="dimension 'wavelength'"):
        geometry.broadcast(theta_i=first.rename(x="wavelength"))


def test_angles_and_vectors_are_inverse():
    theta, phi = np.array([0.0, 10.0, 90.0, 170.0]), np.array([0.0, -40.0, 120.0, 60.0])
    assert np.allclose(geometry.angles_of(geometry.unit_vector(theta, phi)), [theta, phi], atol=1e-12)


def test_angles_labelled_as_radians_are_refused():
    angle = xr.DataArray([0.5], attrs={"units": "rad"})
    with pytest.raises(VocabularyError, match="theta_i is in 'rad'; accepted: degree"):
        geometry.check_angles("theta_i", angle, 0, 180)


@pytest.mark.parametrize(("angle", "message"), [(-1.0, "spans"), (181.0, "spans"), (np.nan, "not finite")])
def test_angles_out_of_range_are_refused(angle, message):
    with pytest.raises(VocabularyError, match=message):
        geometry.check_angles("theta_o", angle, 0, 180)


def test_empty_angles_are_accepted():
    assert geometry.check_angles("theta_i", [], 0, 90).size == 0
