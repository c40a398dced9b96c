"""Vector refraction and the flake angle."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from brdfpipe.errors import BrdfpipeError
from brdfpipe.flakes import directions, flake_angle, flake_normal, refract
from brdfpipe.flakes.refraction import largest_flake_angle
from brdfpipe.geometry import unit_vector

ANGLE, TURN, INDEX = st.floats(0, 90), st.floats(-360, 360), st.floats(1.01, 3)


def test_the_patents_geometries_have_its_flake_angles():
    # US 7,991,596 prints 4.25, 13.82 and 32.07 degree (its geometry 45:75 is a misprint of 45:65); n = 1.524.
    angles = [float(flake_angle(*directions(name), 1.524)) for name in ("45:-30", "45:0", "45:65")]
    assert angles == pytest.approx([4.245880, 13.822141, 32.067415], abs=5e-7)


@given(ANGLE, TURN, ANGLE, TURN, INDEX)
def test_the_flake_angle_is_that_of_the_sum_of_the_refracted_vectors(theta_i, phi_i, theta_o, phi_o, index):
    normal = flake_normal(theta_i, phi_i, theta_o, phi_o, index)
    expected = np.degrees(np.arctan2(np.hypot(normal[0], normal[1]), normal[2]))
    assert flake_angle(theta_i, phi_i, theta_o, phi_o, index) == pytest.approx(expected, abs=1e-9)


@given(ANGLE, TURN, INDEX)
def test_refraction_keeps_snells_law_and_the_length(theta, phi, index):
    inside = refract(unit_vector(theta, phi), index)
    assert np.linalg.norm(inside) == pytest.approx(1, abs=1e-12)
    assert np.hypot(inside[0], inside[1]) * index == pytest.approx(np.sin(np.radians(theta)), abs=1e-12)


@given(ANGLE, TURN, ANGLE, TURN, INDEX)
def test_the_flake_angle_is_the_same_both_ways_and_never_beyond_the_critical_angle(
    theta_i, phi_i, theta_o, phi_o, index
):
    angle = flake_angle(theta_i, phi_i, theta_o, phi_o, index)
    assert angle == pytest.approx(flake_angle(theta_o, phi_o, theta_i, phi_i, index), abs=1e-9)
    assert 0 <= angle <= largest_flake_angle(index) + 1e-9


@given(st.floats(0, 89.9), TURN, INDEX)
def test_the_mirror_direction_needs_a_level_flake(theta, phi, index):
    assert flake_angle(theta, phi, theta, phi + 180, index) == pytest.approx(0, abs=1e-9)


def test_the_angle_of_a_nearly_level_flake_is_accurate():
    # Half of 1e-7 degree inside a coat, times cos θ / cos θ' / n: arccos of the normal would see nothing below 1e-6.
    angle = float(flake_angle(45, 0, 45 + 1e-7, 180, 1.5))
    inner = np.sqrt(1 - (np.sin(np.radians(45)) / 1.5) ** 2)
    # The offset itself has 1e-14 / 1e-7 of relative rounding.
    assert angle == pytest.approx(0.5e-7 * np.cos(np.radians(45)) / inner / 1.5, rel=1e-6)


def test_grazing_directions_meet_at_the_critical_angle():
    assert flake_angle(90, 0, 90, 0, 1.5) == pytest.approx(largest_flake_angle(1.5))


@pytest.mark.parametrize("index", [0.9, 0.0, -1.5, float("nan")])
def test_a_coat_that_would_reflect_totally_is_refused(index):
    with pytest.raises(BrdfpipeError, match="refractive index of the clear coat is"):
        flake_angle(80, 0, 10, 0, index)
    with pytest.raises(BrdfpipeError, match="accepted: 1 or above"):
        refract(unit_vector(80, 0), index)


@pytest.mark.parametrize("index", [1.0, 1 + 1e-9, 1.5, 4.0])
@pytest.mark.parametrize(("theta_i", "theta_o"), [(89.999, 89.998), (89.9, 30.0), (45.0, 45.000001)])
def test_the_flake_angle_keeps_its_digits_at_grazing_angles(index, theta_i, theta_o):
    with mpmath.workdps(50):
        sines = [mpmath.sin(mpmath.radians(mpmath.mpf(angle))) / index for angle in (theta_i, theta_o)]
        normal = sum(mpmath.sqrt(1 - sine**2) for sine in sines)
        expected = float(mpmath.degrees(mpmath.atan(abs(sines[0] - sines[1]) / normal)))
    # A degree near 90 becomes radian to 1e-16, of which a difference of 0.001° keeps eleven digits.
    assert float(flake_angle(theta_i, 0, theta_o, 180, index)) == pytest.approx(expected, rel=1e-9, abs=1e-13)
