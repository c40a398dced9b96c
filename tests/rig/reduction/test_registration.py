"""Shifts, scales and centres of known size are recovered within their stated uncertainty."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import rig_truths
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy import ndimage

from brdfpipe import specular_directions
from brdfpipe.rig import screen
from brdfpipe.rig.description import Rig, Screen
from brdfpipe.rig.emulator.camera_view import overlap_area
from brdfpipe.rig.reduction import registration

BLUR, NOISE = 0.7, 0.01
ROWS, COLUMNS = np.mgrid[:240, :320]
SPOTS = ((0.0, *(3.0,) * 4, *(6.0,) * 4, *(9.0,) * 4), (0.0, *(0.0, 90.0, 180.0, 270.0) * 2, 45.0, 135.0, 225.0, 315.0))

fixture = settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture
def rig(rig: Rig) -> Rig:
    return rig_truths.with_fibres(rig, 60)


def spots(column, row, radius, light=1.0):
    """Round spots on the pixels."""
    picture = np.zeros((240, 320))
    for x, y, bright in zip(np.ravel(column), np.ravel(row), np.broadcast_to(light, np.size(column)), strict=True):
        near = np.s_[max(int(y) - 12, 0) : int(y) + 13, max(int(x) - 12, 0) : int(x) + 13]
        picture[near] += bright * overlap_area(COLUMNS[near] - x, ROWS[near] - y, radius)
    return picture


def photographed(rig: Rig, true: Screen, seed: int, fibres=True, lamp=True):
    """A picture of the ends of the fibres and of the reference, and its variance."""
    picture = np.zeros((240, 320))
    if fibres:
        ends = screen.to_pixel(true, [fibre.x for fibre in rig.fibres], [fibre.y for fibre in rig.fibres])
        efficiency = np.random.default_rng(3).uniform(0.85, 1.15, len(rig.fibres))
        picture += spots(*ends, true.fibre_radius * true.scale, efficiency)
    if lamp:
        picture += spots(*screen.to_pixel(true, *true.reference_centre), true.reference_radius * true.scale)
    return noisy(picture, seed)


def noisy(picture, seed):
    picture = ndimage.gaussian_filter(picture, BLUR)
    variance = NOISE**2 * (1 + np.maximum(picture, 0))
    return picture + np.sqrt(variance) * np.random.default_rng(seed).standard_normal(picture.shape), variance


@fixture
@given(
    dx=st.floats(-2, 2),
    dy=st.floats(-2, 2),
    stretch=st.floats(0.995, 1.005),
    radial=st.floats(-1e-6, 3e-6),
    seed=st.integers(0, 100),
)
def test_a_known_shift_scale_and_distortion_are_found_within_their_uncertainty(rig, dx, dy, stretch, radial, seed):
    known = rig.screen
    centre = (known.centre[0] + dx, known.centre[1] + dy)
    true = replace(known, centre=centre, scale=known.scale * stretch, radial=radial)
    registered = registration.register(rig, *photographed(rig, true, seed))
    assert registered.spots == 61
    error = np.subtract(registered.shift(rig), (dx, dy))
    assert registered.shift_u < 0.01
    assert np.abs(error).max() < 4.5 * registered.shift_u
    # Anywhere on the disc.
    edge = [-26.0, 26.0, 0.0, 18.0], [0.0, 0.0, 26.0, -18.0]
    off = np.subtract(screen.to_pixel(registered.screen, *edge), screen.to_pixel(true, *edge))
    assert np.abs(off).max() < 0.05


def test_errors_of_shifts_agree_with_their_stated_uncertainty(rig):
    errors = []
    for seed in range(30):
        shift = np.random.default_rng(seed).normal(0, 0.5, 2)
        true = replace(rig.screen, centre=tuple(np.add(rig.screen.centre, shift)))
        registered = registration.register(rig, *photographed(rig, true, seed))
        errors += list(np.subtract(registered.shift(rig), shift) / registered.shift_u)
    # The uneven response that the uncertainty allows for is not in these pictures.
    assert 0.1 < np.sqrt(np.mean(np.square(errors))) < 1.3


def test_the_blur_of_the_camera_follows_from_the_spots(rig):
    registered = registration.register(rig, *photographed(rig, rig.screen, 0))
    assert registered.blur == pytest.approx(BLUR, abs=0.05)


def test_the_reference_alone_gives_only_a_shift(rig):
    true = replace(rig.screen, centre=(160.3, 118.8))
    registered = registration.register(rig, *photographed(rig, true, 0, fibres=False))
    assert registered.spots == 1
    assert registered.shift(rig) == pytest.approx((0.8, -0.7), abs=0.02)
    assert registered.screen.scale == rig.screen.scale
    # Its position depends on a scale that it does not determine.
    assert registered.shift_u > 0.1


def test_the_reference_gives_the_shift_against_pictures_of_the_same_lens(rig):
    true = replace(rig.screen, centre=(159.1, 119.9), scale=3.01, radial=2e-6)
    lens = registration.register(rig, *photographed(rig, true, 0)).screen
    moved = replace(true, centre=(159.6, 119.2))
    registered = registration.register(rig, *photographed(rig, moved, 1, fibres=False), lens)
    assert registered.screen.centre == pytest.approx(moved.centre, abs=0.03)
    assert registered.screen.scale == lens.scale
    assert registered.shift_u < 0.05


def test_without_a_spot_the_screen_is_as_described_with_a_large_uncertainty(rig):
    registered = registration.register(rig, *photographed(rig, rig.screen, 0, fibres=False, lamp=False))
    assert registered.screen == rig.screen
    assert registered.spots == 0
    assert registered.shift_u == 0.5
    assert registered.blur == 0


def test_spots_that_are_dead_or_beyond_the_picture_are_left_out(rig):
    column, row = np.array([50.0, 100.0, 3.0, 330.0, 50.0]), np.array([50.0, 100.0, 100.0, 100.0, 236.0])
    picture, variance = noisy(spots(column[:1], row[:1], 3.0), 0)
    seen = registration.centroids(picture, variance, column, row, 3.0)
    assert np.isfinite(seen.u).tolist() == [True, False, False, False, False]
    assert seen.column[1:].tolist() == column[1:].tolist()


@fixture
@given(dx=st.floats(-2.5, 2.5), dy=st.floats(-2.5, 2.5), slope=st.floats(0, 0.005))
def test_a_centroid_is_that_of_the_spot_on_any_even_slope(rig, dx, dy, slope):
    picture, variance = noisy(spots([100.0 + dx], [80.0 + dy], 3.0) + 0.3 + slope * (COLUMNS - 100), 0)
    seen = registration.centroids(picture, variance, [100.0], [80.0], 3.0)
    # A slope of half a percent a pixel draws it by so much of the second moment of its window.
    assert seen.column[0] == pytest.approx(100 + dx, abs=4.5 * seen.u[0] + 20 * slope)
    assert seen.row[0] == pytest.approx(80 + dy, abs=4.5 * seen.u[0])


# --- the angular target


def target(true: Screen, seed: int, falloff=1.0):
    places = screen.disc_position(true, *SPOTS)
    sharp = spots(*screen.to_pixel(true, *places), np.radians(0.3) * true.focal_length * true.scale)
    return noisy(falloff * sharp, seed)


@fixture
@given(x=st.floats(-0.5, 0.5), y=st.floats(-0.5, 0.5), focal=st.floats(0.99, 1.01), seed=st.integers(0, 100))
def test_the_centre_of_the_disc_is_found_within_its_uncertainty(rig, x, y, focal, seed):
    true = replace(rig.screen, disc_centre=(x, y), focal_length=150 * focal)
    start = registration.Registration(rig.screen, 0.002, registration.DIRECTION_U, 61)
    registered = registration.fit_disc(start, *target(true, seed), *SPOTS, 0.3)
    assert registered.direction_u < 0.01
    millimetres = np.radians(registered.direction_u) * 150
    assert np.abs(np.subtract(registered.screen.disc_centre, (x, y))).max() < 4.5 * millimetres
    assert registered.screen.focal_length == pytest.approx(150 * focal, rel=2e-3)


def test_errors_of_the_scale_of_angles_agree_with_their_stated_uncertainty(rig):
    start = registration.Registration(rig.screen, 0.002, registration.DIRECTION_U, 61)
    assert start.scale_u == registration.SCALE_U
    off, random = [], np.random.default_rng(0)
    for seed in range(40):
        # Anywhere on the pixels: spots in rows along them would all be off alike.
        true = replace(
            rig.screen, disc_centre=tuple(random.uniform(-0.5, 0.5, 2)), focal_length=random.uniform(148, 152)
        )
        registered = registration.fit_disc(start, *target(true, seed), *SPOTS, 0.3)
        off.append((registered.screen.focal_length / true.focal_length - 1) / registered.scale_u)
    # Counted with an uneven sensor, which these pictures do not have.
    assert 0.3 < np.sqrt(np.mean(np.square(off))) < 1.2


def test_the_falloff_of_a_lens_does_not_shorten_the_focal_length(rig):
    true, start = rig.screen, registration.Registration(rig.screen, 0.002, registration.DIRECTION_U, 61)
    place = screen.to_position(true, COLUMNS, ROWS)
    falloff = 1 - 0.3 * ((place.x**2 + place.y**2) / true.disc_radius**2)
    theta, phi = screen.disc_direction(true, place.x, place.y)
    etalon = falloff * specular_directions.cos_view_etalon(10.0, theta, phi)
    fitted = registration.fit_falloff(start, etalon, 10.0)
    assert (registration.fit_falloff(start, np.zeros_like(etalon), 10.0) == 1).all()
    inside = np.hypot(place.x, place.y) < 0.9 * true.disc_radius
    np.testing.assert_allclose(fitted[inside], falloff[inside], rtol=2e-3)
    # As it would be without the lens, in which the centroids are drawn by nothing.
    plain, drawn, right = (
        registration.fit_disc(start, *target(true, 0, light), *SPOTS, 0.3, lens).screen.focal_length
        for light, lens in ((1.0, None), (np.maximum(falloff, 0.1), None), (np.maximum(falloff, 0.1), fitted))
    )
    assert 1 - drawn / plain > 1e-4
    assert right == pytest.approx(plain, rel=3e-5)


def test_an_invisible_target_changes_nothing(rig):
    start = registration.Registration(rig.screen, 0.002, registration.DIRECTION_U, 61)
    dark = noisy(np.zeros((240, 320)), 0)
    assert registration.fit_disc(start, *dark, *SPOTS, 0.3) == start
