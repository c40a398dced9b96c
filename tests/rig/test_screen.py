"""Directions and pixels: closed forms, and round trips over the whole screen."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import small_rig
from hypothesis import given
from hypothesis import strategies as st

from brdfpipe import specular_directions
from brdfpipe.geometry import unit_vector
from brdfpipe.rig import screen
from brdfpipe.rig.description import Screen
from brdfpipe.rig.plan import Plan

SCREEN = Screen(150.0, 26.4, (1.0, -2.0), (48.0, 34.0), 1.0, 1.5, 3.0, (159.5, 119.5), 2e-6)


def test_the_cosines_have_the_reference_values_of_the_physics_sheet():
    assert float(specular_directions.cos_view(45, 20, 30)) == pytest.approx(0.8739067326, abs=5e-11)
    assert float(specular_directions.cos_view_etalon(10, 20, 30)) == pytest.approx(0.9843279494, abs=5e-11)


@given(st.floats(-53, 53), st.floats(-40, 40), st.floats(-2e-5, 2e-5))
def test_to_pixel_and_to_position_are_inverse(x, y, radial):
    bent = dataclasses.replace(SCREEN, radial=radial)
    place = screen.to_position(bent, *screen.to_pixel(bent, x, y))
    assert float(place.x) == pytest.approx(x, abs=1e-9)
    assert float(place.y) == pytest.approx(y, abs=1e-9)


def test_up_on_the_screen_is_up_in_the_picture():
    column, row = screen.to_pixel(SCREEN, [0, 0, 10], [0, 10, 0])
    assert row[1] < row[0] == row[2]
    assert column[2] > column[0] == column[1]


@given(st.floats(0, 30), st.floats(-179.9, 179.9))
def test_directions_and_positions_on_the_disc_are_inverse(theta, phi):
    found_theta, found_phi = screen.disc_direction(SCREEN, *screen.disc_position(SCREEN, theta, phi))
    assert unit_vector(found_theta, found_phi) == pytest.approx(unit_vector(theta, phi), abs=1e-9)


def test_the_solid_angle_of_the_disc_is_that_of_a_cone():
    # The integral of cos³ϑ / f² over the disc out to ϑ is 2π (1 − cos ϑ).
    edge = np.linspace(0, 30, 3001)
    theta = (edge[1:] + edge[:-1]) / 2
    radius = SCREEN.focal_length * np.tan(np.radians(edge))
    total = (screen.disc_solid_angle(SCREEN, theta) * np.pi * np.diff(radius**2)).sum()
    assert total == pytest.approx(2 * np.pi * (1 - np.cos(np.radians(30))), rel=1e-6)


@given(st.floats(0, 89), st.floats(0, 180), st.floats(-180, 180))
def test_the_outgoing_direction_has_the_cosine_of_view(sigma, theta, phi):
    out, _ = specular_directions.outgoing(sigma, theta, phi)
    assert np.cos(np.radians(out)) == pytest.approx(float(specular_directions.cos_view(sigma, theta, phi)), abs=1e-12)


@given(st.floats(0, 89), st.floats(0, 180), st.floats(-180, 180))
def test_the_angle_from_the_mirror_direction_is_theta_s(sigma, theta, phi):
    mirror, out = unit_vector(sigma, 180.0), unit_vector(*specular_directions.outgoing(sigma, theta, phi))
    assert mirror @ out == pytest.approx(np.cos(np.radians(theta)), abs=1e-12)


def test_azimuth_0_leads_towards_the_normal():
    out, azimuth = specular_directions.outgoing(45, 20, 0)
    assert (float(out), abs(float(azimuth))) == (pytest.approx(25), pytest.approx(180))


def test_light_that_passes_straight_is_the_centre_in_transmission():
    out, azimuth = specular_directions.outgoing(30, 0, 0, side="transmission")
    assert (float(out), abs(float(azimuth))) == (pytest.approx(150), pytest.approx(180))


def test_spot_masks_cover_the_described_spots(tmp_path):
    plan = Plan.load(small_rig.write(tmp_path))
    reference, sample = screen.spot_masks(plan.rig)
    column, row = screen.to_pixel(plan.rig.screen, *plan.rig.screen.reference_centre)
    rows, columns = np.nonzero(reference)
    assert np.hypot(columns - column, rows - row).max() <= 3 * 0.9 + 1e-9
    assert not (reference & sample).any()
    disc = screen.to_pixel(plan.rig.screen, 0, 0)
    assert sample[round(float(disc[1])), round(float(disc[0]))]
    for fibre in plan.rig.fibres:
        column, row = screen.to_pixel(plan.rig.screen, fibre.x, fibre.y)
        assert sample[round(float(row)), round(float(column))]
