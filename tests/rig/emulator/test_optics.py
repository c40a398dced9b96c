"""The light of the emulated rig: an ideal rig against closed forms, and each effect alone against its size."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import synthetic
from hypothesis import given
from hypothesis import strategies as st
from rig_truths import WAVELENGTHS, lobe, with_fibres

from brdfpipe import specular_directions
from brdfpipe.bsdf.registry import representation
from brdfpipe.errors import VocabularyError
from brdfpipe.rig import screen
from brdfpipe.rig.description import Fibre, Target
from brdfpipe.rig.emulator.camera_view import fibre_efficiency, in_entrance_hole, overlap_area, true_screen
from brdfpipe.rig.emulator.effects import Effects, EmulationError
from brdfpipe.rig.emulator.illumination import MIDDLE_WAVELENGTH, SPLIT, Illumination
from brdfpipe.rig.emulator.optics import REFERENCE_RATE, SAMPLE_RATE, Optics, PointSpread, halo
from brdfpipe.rig.emulator.sample_holder import Etalon, Setup

IDEAL = Effects.none()
ETALON = Etalon()


def optics(rig, truth=None, effects=IDEAL, *, seed=0, session=0):
    truth = lobe(0.6) if truth is None else truth
    return Optics(rig, representation(truth), effects, seed=seed, session=session, etalon=ETALON)


def at_fibres(rig, picture):
    """Light of the pixel in the middle of each fibre's end."""
    places = np.array([[fibre.x, fibre.y] for fibre in rig.fibres])
    column, row = (np.rint(coordinate).astype(int) for coordinate in screen.to_pixel(rig.screen, *places.T))
    return picture[row, column]


def at_reference(rig, picture):
    column, row = (int(np.rint(coordinate)) for coordinate in screen.to_pixel(rig.screen, *rig.screen.reference_centre))
    return picture[row, column]


def directions(rig):
    return np.array([[fibre.theta_s, fibre.phi_s] for fibre in rig.fibres]).T


def disc_directions(rig, within=9.0):
    """Pixels (row, column) of the disc and their directions, of a rig as described."""
    row, column = np.mgrid[: rig.camera.height, : rig.camera.width]
    theta, phi = screen.disc_direction(rig.screen, *screen.to_position(rig.screen, column, row))
    inside = theta < within
    return row[inside], column[inside], theta[inside], phi[inside]


# --- the ideal rig


@pytest.mark.parametrize("sigma", [10.0, 20.0, 45.0])
def test_an_ideal_rig_shows_the_cosine_of_view_over_that_of_the_etalon(rig, sigma):
    rig = with_fibres(rig)
    model = optics(rig)
    sample, etalon = model.rates(Setup(sigma), 550, 1), model.rates(Setup(10.0, "etalon"), 550, 1)
    cosine, cosine_etalon = (
        specular_directions.cos_view(sigma, *directions(rig)),
        specular_directions.cos_view_etalon(10, *directions(rig)),
    )
    angle = np.degrees(np.arccos(cosine_etalon))
    expected = 0.6 / np.pi * cosine / (0.9 / np.pi * (1 - 0.05 * (angle / 60) ** 2) * cosine_etalon)
    valid = (cosine > 0) & (cosine_etalon > 0.05)
    assert valid.sum() > 20
    ratio = at_fibres(rig, sample) / at_reference(rig, sample) * at_reference(rig, etalon)
    assert ratio[valid] == pytest.approx((expected * at_fibres(rig, etalon))[valid], rel=1e-9)


def test_an_ideal_disc_shows_the_cosine_of_view_and_of_the_solid_angle(rig):
    row, column, theta, phi = disc_directions(rig)
    sample = optics(rig).rates(Setup(20.0), 550, 1)[row, column]
    expected = (
        SAMPLE_RATE
        * (1 - SPLIT)
        * 0.6
        / np.pi
        * specular_directions.cos_view(20, theta, phi)
        * np.cos(np.radians(theta)) ** 3
    )
    # A pixel is 0.13 degree wide: the mean over it differs from its middle by the second derivative, 1e-6.
    assert sample == pytest.approx(expected, rel=1e-5)


def test_the_reference_receives_eight_percent_of_the_lamp_for_every_load(rig):
    model = optics(rig)
    for setup in (Setup(20.0), Setup(10.0, "etalon"), Setup(45.0, "dark-trap")):
        assert at_reference(rig, model.rates(setup, 480, 1)) == pytest.approx(0.08 * REFERENCE_RATE)


def test_a_dark_trap_leaves_the_screen_dark(rig):
    picture = optics(rig).rates(Setup(20.0, "dark-trap"), 550, 1)
    assert (at_fibres(rig, picture) == 0).all()
    assert picture[120, 160] == 0


def test_the_mean_over_a_pixel_of_a_narrow_lobe_is_right(rig):
    # Sixteen by sixteen points of a lobe of 1.5 degree, in pixels on its flank.
    truth = lobe(0.0, 300.0, 1.5)
    rows, columns = np.arange(100, 140), np.arange(140, 180)
    fine = (np.arange(16) + 0.5) / 16 - 0.5
    row, column = np.meshgrid(rows[:, None] + fine, columns[:, None] + fine, indexing="ij")
    theta, phi = screen.disc_direction(rig.screen, *screen.to_position(rig.screen, column, row))
    brdf = truth.bsdf.evaluate(20, 0, *specular_directions.outgoing(20, theta, phi)).values
    bright = brdf * specular_directions.cos_view(20, theta, phi) * np.cos(np.radians(theta)) ** 3
    expected = SAMPLE_RATE * (1 - SPLIT) * bright.reshape(40, 16, 40, 16).mean(axis=(1, 3))
    light = optics(rig, truth).rates(Setup(20.0), 550, 1)[100:140, 140:180]
    assert np.abs(light - expected).max() < 1e-4 * expected.max()
    assert light == pytest.approx(expected, rel=1e-3)


def test_nothing_is_seen_below_the_horizon_of_the_sample(rig):
    rig = with_fibres(rig)
    cosine = specular_directions.cos_view(45, *directions(rig))
    assert 5 < (cosine <= 0).sum() < 55
    light = at_fibres(rig, optics(rig).rates(Setup(45.0), 550, 1))
    assert (light[cosine <= 0] == 0).all()
    assert (light[cosine > 0] > 0).all()


def test_transmission_shows_the_other_side_of_the_sample(rig, monkeypatch):
    rig = with_fibres(rig)

    def btdf(w_i, w_o):
        return np.where(w_i[..., 2] * w_o[..., 2] < 0, 0.25 + 0.1 * w_o[..., 0], 0.0)

    truth = synthetic.register(monkeypatch, btdf, through="slab")
    light = at_fibres(rig, optics(rig, truth).rates(Setup(30.0, side="transmission"), 550, 1))
    theta, phi = directions(rig)
    theta_o, phi_o = specular_directions.outgoing(30, theta, phi, side="transmission")
    x = np.sin(np.radians(theta_o)) * np.cos(np.radians(phi_o))
    cosine = np.maximum(specular_directions.cos_view(30, theta, phi), 0)
    assert light == pytest.approx(SAMPLE_RATE * (1 - SPLIT) * cosine * (0.25 + 0.1 * x), rel=1e-9)
    assert (at_fibres(rig, optics(rig, truth).rates(Setup(20.0), 550, 1)) == 0).all()


# --- wavelengths


def test_any_wavelength_shows_the_truth_there(rig):
    truth = lobe(0.2 + 0.001 * (WAVELENGTHS - 380))
    model = optics(rig, truth)
    for wavelength in (380.0, 546.074, 779.5):
        light = model.rates(Setup(0.0), wavelength, 1)[120, 100]
        grey = optics(rig, lobe(0.2 + 0.001 * (wavelength - 380))).rates(Setup(0.0), wavelength, 1)[120, 100]
        assert light == pytest.approx(grey, rel=1e-6)


def test_beyond_its_wavelengths_the_truth_is_constant(rig):
    truth = lobe(0.2 + 0.001 * (WAVELENGTHS - 380)).isel(wavelength=slice(5, 20))
    model = optics(rig, truth)
    assert model.rates(Setup(0.0), 385, 1)[120, 100] == model.rates(Setup(0.0), 430, 1)[120, 100]


def test_wavelengths_evaluated_together_equal_those_evaluated_alone(rig):
    truth = lobe(0.2 + 0.001 * (WAVELENGTHS - 380))
    together = optics(rig, truth)
    together.rates(Setup(20.0), 400, 1)
    alone = optics(rig, truth)
    assert np.array_equal(together.rates(Setup(20.0), 650, 1), alone.rates(Setup(20.0), 650, 1))


def test_a_monochromator_at_rest_sends_no_light(rig):
    model = optics(rig, effects=dataclasses.replace(IDEAL, xenon=True))
    assert model.rates(Setup(20.0), 0.0, 1).max() < 1e-3


def test_the_band_of_the_slit_has_the_moments_of_a_triangle(rig):
    nodes, light = Illumination(rig, dataclasses.replace(IDEAL, slit=True), 0, 0).band(500.0)
    offset = nodes - 500
    assert light.sum() == pytest.approx(1)
    assert (light * offset).sum() == pytest.approx(0, abs=1e-12)
    assert (light * offset**2).sum() == pytest.approx(rig.slit**2 / 6)
    assert (light * offset**4).sum() == pytest.approx(rig.slit**4 / 15)


def test_a_xenon_lamp_has_its_lines_in_the_blue_and_beyond_the_red(rig):
    source = Illumination(rig, dataclasses.replace(IDEAL, xenon=True), 0, 0)

    def light(wavelength):
        return float(source.band(wavelength)[1].sum())

    assert light(MIDDLE_WAVELENGTH) == 1
    assert light(467.1) > 1.15 * light(510)
    assert light(882) > 2 * light(865)
    assert 0.2 < light(390) < 0.5


def test_the_splitters_slope_is_per_hundred_nanometres(rig):
    source = Illumination(rig, dataclasses.replace(IDEAL, splitter_slope=0.02), 0, 0)
    assert float(source.split_ratio(660)) == pytest.approx(0.08 * 1.02)
    assert float(source.split_ratio(MIDDLE_WAVELENGTH)) == 0.08


# --- filters, lamp, paths


def test_a_filter_in_the_samples_beam_leaves_the_reference_alone(rig):
    model = optics(rig)
    open_, filtered = (model.rates(Setup(20.0), 550, position) for position in (1, 3))
    assert at_fibres(rig, filtered) == pytest.approx(0.01 * at_fibres(rig, open_))
    assert at_reference(rig, filtered) == at_reference(rig, open_)


def test_a_wrong_location_of_the_filters_is_wrong_by_the_ratio_of_two(rig):
    # Where the filters weaken the reference too, L/L′ does not depend on them; dividing it by T is wrong by T₁/T₂ between two frames.
    model = optics(dataclasses.replace(rig, nd_location="reference"))
    light = [model.rates(Setup(20.0), 550, position) for position in (2, 3)]
    taken = [
        at_fibres(rig, image)[0] / at_reference(rig, image) / t for image, t in zip(light, (0.1, 0.01), strict=True)
    ]
    assert taken[1] / taken[0] == pytest.approx(0.1 / 0.01)


def test_a_filters_true_transmittance_is_within_its_uncertainty(rig):
    errors = []
    for seed in range(100):
        source = Illumination(rig, dataclasses.replace(IDEAL, filters=1.0), seed, 0)
        errors.append([source.filter_transmittance(2, wavelength) / 0.1 - 1 for wavelength in (390, 560, 730)])
        assert source.filter_transmittance(1, 560) == 1  # stated without an error
        assert source.filter_transmittance(5, 560) == 1  # no filter
    assert 0.01 < np.abs(errors).max() <= 0.02
    assert np.ptp(errors, axis=1).min() > 0


def test_the_lamp_warms_up_and_wanders_by_its_figures(rig):
    time = np.arange(0, 400_000, 100.0)
    warm = Illumination(rig, dataclasses.replace(IDEAL, warm_up=0.05), 0, 0).lamp([0, 1e6])
    assert warm == pytest.approx([0.95, 1])
    wander = Illumination(rig, dataclasses.replace(IDEAL, drift=0.01), 0, 0).lamp(time)
    assert wander.std() == pytest.approx(0.01, rel=0.02)
    assert np.abs(np.diff(wander)).max() < 0.004


def test_the_lamp_wanders_otherwise_in_another_session(rig):
    effects = dataclasses.replace(IDEAL, drift=0.01)
    first, same, other = (Illumination(rig, effects, 3, session).lamp(5000.0) for session in (0, 0, 1))
    assert first == same != other


def test_paths_belong_to_entrances_and_stay(rig):
    source = Illumination(rig, dataclasses.replace(IDEAL, paths=0.05), 1, 0)
    paths = [float(source.path_factor(entrance, 500)) for entrance in (0, 10, 20, 30, 45, 60)]
    assert len(set(paths)) == 6
    assert 0.01 < np.std(paths) < 0.15
    other_day = Illumination(rig, dataclasses.replace(IDEAL, paths=0.05), 1, 7)
    assert paths == [other_day.path_factor(entrance, 700) for entrance in (0, 10, 20, 30, 45, 60)]


def test_the_mirrors_of_each_entrance_have_their_own_spectrum(rig):
    source = Illumination(rig, dataclasses.replace(IDEAL, path_slope=0.01), 1, 0)
    slopes = [np.diff(source.path_factor(entrance, [460.0, 560.0, 660.0])) for entrance in (0, 10, 20, 30, 45, 60)]
    assert np.ptp(slopes, axis=1) == pytest.approx(np.zeros(6), abs=1e-12)
    assert 0.003 < np.std(slopes) < 0.03
    assert [source.path_factor(entrance, 560.0) for entrance in (0, 60)] == [1, 1]


# --- fibres and screen


def test_efficiencies_vignetting_and_spectrum_cancel_in_the_ratio_to_the_etalon(rig):
    rig = with_fibres(rig)
    effects = dataclasses.replace(IDEAL, fibres=0.15, vignetting=0.3, splitter_slope=0.02, xenon=True)

    def ratio(model):
        sample, etalon = (
            model.rates(Setup(20.0), 550, 1),
            model.rates(Setup(10.0, "etalon"), 550, 1),
        )
        lit = specular_directions.cos_view_etalon(10, *directions(rig)) > 0.1
        return at_fibres(rig, sample)[lit] / at_fibres(rig, etalon)[lit]

    assert ratio(optics(rig, effects=effects)) == pytest.approx(ratio(optics(rig)), rel=1e-12)


def test_fibres_differ_by_fifteen_percent_and_two_percent_are_dead():
    efficiency = fibre_efficiency(150, Effects(), 5)
    alive = efficiency[efficiency > 0]
    assert efficiency.size - alive.size == 3
    assert 0.85 <= alive.min() < 0.87
    assert 1.13 < alive.max() <= 1.15
    assert np.array_equal(efficiency, fibre_efficiency(150, Effects(), 5))
    assert not np.array_equal(efficiency, fibre_efficiency(150, Effects(), 6))


def test_a_fibre_sees_the_mean_over_its_field(rig):
    # Of a lobe of standard deviation s, the mean over a small disc of radius r about its peak is 1 − r²/4s² + O(r⁴).
    truth, fibre = lobe(0.0, 1.0, 15.0), Fibre("A", 0.0, 0.0, 40.0, 0.0)
    rig = dataclasses.replace(rig, fibres=(fibre,))
    narrow, wide = (
        at_fibres(rig, optics(rig, truth, dataclasses.replace(IDEAL, fibre_field=field)).rates(Setup(45.0), 550, 1))[0]
        for field in (0.0, 0.6)
    )
    sigma = 15 / 2.3548200450
    # The cosine of view adds −r²/8 [radian], with r² in radian.
    expected = 1 - 0.6**2 / (4 * sigma**2) - np.radians(0.6) ** 2 / 4
    assert wide / narrow == pytest.approx(expected, abs=2e-5)


def test_corners_and_rim_of_the_disc_lose_the_share_of_vignetting(rig):
    plain, lossy = (
        optics(rig, effects=dataclasses.replace(IDEAL, vignetting=loss)).rates(Setup(0.0), 550, 1) for loss in (0, 0.3)
    )
    row, column, theta, _ = disc_directions(rig)
    corner = (column - 159.5) ** 2 + (row - 119.5) ** 2
    rim = np.degrees(np.arctan(26.4 / 150))
    expected = (1 - 0.3 * corner / (159.5**2 + 119.5**2)) * (1 - 0.3 * (theta / rim) ** 2)
    assert lossy[row, column] / plain[row, column] == pytest.approx(expected, rel=1e-4)


def test_entrances_return_no_light_except_those_moved_out_of_the_lens(rig):
    effects = dataclasses.replace(IDEAL, holes=3.0)

    def blind(entrance, theta, phi, transmission=False):
        return bool(
            in_entrance_hole(rig, effects, entrance, np.array([theta]), np.array([phi]), transmission=transmission)[0]
        )

    assert blind(20.0, 90.0, 0.0)  # the entrance of 45 degree
    assert blind(20.0, 87.1, 0.0)
    assert not blind(20.0, 86.9, 0.0)
    assert blind(20.0, 40.0, 4.0)  # the illuminated entrance, 2.6 degree away
    assert not blind(20.0, 40.0, 180.0)
    assert blind(0.0, 1.0, 70.0)  # light that comes through the lens
    assert not blind(20.0, 1.0, 70.0)
    assert not blind(0.0, 1.0, 70.0, transmission=True)
    assert not bool(in_entrance_hole(rig, IDEAL, 20.0, np.array([40.0]), np.zeros(1), transmission=False)[0])


def test_stray_light_is_all_that_a_dark_trap_shows(rig):
    rig = dataclasses.replace(rig, fibres=rig.fibres[:1])
    picture = optics(rig, effects=dataclasses.replace(IDEAL, stray=2e-5)).rates(Setup(20.0, "dark-trap"), 550, 1)
    assert at_fibres(rig, picture) == pytest.approx(SAMPLE_RATE * (1 - SPLIT) * 2e-5)


def test_the_disc_is_off_by_a_tenth_of_a_degree_and_the_picture_moves_between_sessions(rig):
    screens = [true_screen(rig, Effects(), 4, session) for session in range(200)]
    away = np.hypot(*np.subtract(screens[0].disc_centre, rig.screen.disc_centre))
    assert np.degrees(np.arctan(away / 150)) == pytest.approx(0.1)
    assert abs(screens[0].radial - rig.screen.radial) == pytest.approx(5e-7)
    assert len({(true.disc_centre, true.radial) for true in screens}) == 1
    shifts = np.array([true.centre for true in screens]) - rig.screen.centre
    # Standard error of a standard deviation of 400 numbers: 3.5 %.
    assert shifts.std() == pytest.approx(0.3, rel=0.14)
    assert true_screen(rig, IDEAL, 4, 1) == rig.screen


def test_the_spots_of_the_target_are_at_their_true_positions(rig):
    effects = dataclasses.replace(Effects(), holes=0, vignetting=0, dead_fibres=0, stray=0, halo=0)
    target = Target((0.0, 5.0, 5.0, 5.0, 8.0), (0.0, 30.0, 120.0, -100.0, 10.0), 0.3)
    rig = dataclasses.replace(rig, target=target)
    picture = optics(rig, effects=effects, seed=2).rates(Setup(20.0, "target"), 550, 1)
    true = true_screen(rig, effects, 2, 0)
    y, x = np.mgrid[: rig.camera.height, : rig.camera.width]
    for theta, phi in zip(target.theta_s, target.phi_s, strict=True):
        column, row = screen.to_pixel(true, *screen.disc_position(true, theta, phi))
        near = (x - column) ** 2 + (y - row) ** 2 < 8**2
        light = picture[near] / picture[near].sum()
        assert (light * x[near]).sum() == pytest.approx(float(column), abs=0.03)
        assert (light * y[near]).sum() == pytest.approx(float(row), abs=0.03)


def test_a_certificate_errs_for_a_session_by_its_figure(rig):
    small = dataclasses.replace(rig, camera=dataclasses.replace(rig.camera, width=16, height=16))
    small = dataclasses.replace(
        small, screen=dataclasses.replace(rig.screen, centre=(7.5, 7.5), reference_centre=(2.0, 2.0))
    )

    def bright(effects, session):
        return optics(small, effects=effects, session=session).rates(Setup(10.0, "etalon"), 550, 1)[8, 8]

    wrong = dataclasses.replace(IDEAL, certificate=0.005)
    errors = np.array([bright(wrong, session) for session in range(60)]) / bright(IDEAL, 0) - 1
    # Standard error of a standard deviation of 60 numbers: 9 %.
    assert errors.std() == pytest.approx(0.005, rel=0.36)
    assert bright(wrong, 3) == bright(wrong, 3)


# --- areas and spread


@given(st.floats(0.3, 20), st.floats(-1, 1), st.floats(-1, 1))
def test_the_pixels_of_a_spot_share_its_area(radius, x, y):
    reach = int(radius) + 3
    row, column = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    covered = overlap_area(column - x, row - y, radius)
    assert covered.sum() == pytest.approx(np.pi * radius**2, rel=1e-7)
    assert covered.min() >= 0
    assert covered.max() <= 1


def test_a_pixel_covered_in_part_is_covered_as_much_as_its_points():
    fine = (np.arange(400) + 0.5) / 400 - 0.5
    for x, y, radius in ((3, 0, 3.2), (2.4, 2.2, 3), (-2.7, 1.9, 3), (0.2, 0.1, 0.4), (0.3, -0.4, 0.55), (5, 0, 4.4)):
        inside = (x + fine) ** 2 + (y + fine[:, None]) ** 2 < radius**2
        assert float(overlap_area(np.array(x), np.array(y), radius)) == pytest.approx(inside.mean(), abs=2e-4)


SHAPE = (60, 80)


def point(row=30, column=40):
    picture = np.zeros(SHAPE)
    picture[row, column] = 1.0
    return picture


@pytest.mark.parametrize("share", [0.0, 0.005, 0.2])
def test_light_is_lost_only_beyond_the_edges_of_the_image(share):
    # Of the halo of a point in the middle, what falls outside of a rectangle is known: corners of solid angles seen from height R.
    spread = PointSpread(SHAPE, 0.7, share, 5.0)(point())
    a, b = np.meshgrid([30.5, 29.5], [40.5, 39.5])
    inside = np.arctan(a * b / (5.0 * np.sqrt(a**2 + b**2 + 5.0**2))).sum() / (2 * np.pi)
    assert spread.sum() == pytest.approx(1 - share * (1 - inside), abs=1e-4 * share + 1e-12)


def test_the_core_has_its_width_and_the_halo_its_share():
    spread = PointSpread(SHAPE, 0.7, 0.0, 0.0)(point())
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]]
    assert (spread * (row - 30) ** 2).sum() == pytest.approx(0.49, rel=5e-3)
    glare = PointSpread(SHAPE, 0.0, 0.005, 40.0)(point())
    assert glare[30, 40] == pytest.approx(0.995, abs=1e-5)
    away = np.hypot(row - 30, column - 40)
    assert glare[away > 0] == pytest.approx(0.005 * halo(away[away > 0], 40.0), rel=1e-4)


def test_half_a_percent_of_the_light_goes_into_the_halo():
    radius = np.linspace(0, 3000, 300_001)
    within = np.trapezoid(2 * np.pi * radius * halo(radius, 40.0), radius)
    assert within == pytest.approx(1 - 1 / np.hypot(1, 3000 / 40), rel=1e-6)
    assert Effects().halo == 0.005


def test_light_that_leaves_on_one_side_does_not_come_back_on_the_other():
    glare = PointSpread(SHAPE, 0.0, 0.1, 3.0)(point(30, 0))
    assert glare[30, -1] == pytest.approx(0.1 * float(halo(np.array(79.0), 3.0)), rel=1e-3)


def test_the_dark_beside_a_very_bright_lobe_is_not_made_of_rounding():
    picture = 1e-6 * np.ones(SHAPE) + point() * 2500
    spread = PointSpread(SHAPE, 0.7, 0.0, 0.0)(picture)
    assert spread[0, 0] == pytest.approx(1e-6, rel=0.5)
    assert (PointSpread(SHAPE, 0.7, 0.005, 40.0)(picture) > 0).all()


# --- refusals


@pytest.mark.parametrize(
    ("setup", "says"),
    [
        (Setup(30.0), "no entrance at 30 degree; accepted: 0, 10, 20, 45"),
        (Setup(20.0, "lens"), "accepted: sample, etalon, target, mirror, dark-trap, line-lamp"),
        (Setup(20.0, "mirror"), "direction to which the mirror sends the light"),
        (Setup(20.0, "mirror", "transmission", (0.0, 0.0)), "transmits no light"),
        (Setup(20.0, side="back"), "accepted: reflection, transmission"),
        (Setup(20.0, "etalon", "transmission"), "transmits no light"),
        (Setup(20.0, "target"), "describe it under `target`"),
        (Setup(95.0, side="transmission"), "0 to below 90"),
        (Setup(float("nan"), side="transmission"), "0 to below 90"),
    ],
)
def test_an_impossible_setup_is_refused(rig, setup, says):
    with pytest.raises(EmulationError, match=says):
        optics(rig).rates(setup, 550, 1)


def test_a_mirror_is_refused(rig, monkeypatch):
    def specular(_bsdf, theta_i, _phi_i, _wavelength):
        return np.full((*np.shape(theta_i), 1), 0.04), np.zeros((*np.shape(theta_i), 1))

    truth = synthetic.register(monkeypatch, lambda w_i, _w_o: np.zeros(w_i.shape[:-1]), specular=specular)
    with pytest.raises(EmulationError, match="use a rough surface"):
        optics(rig, truth).rates(Setup(20.0), 550, 1)


def test_a_dataset_that_is_not_a_bsdf_is_refused(rig):
    with pytest.raises(VocabularyError):
        optics(rig, lobe(0.5).assign_attrs(representation="guess"))


@pytest.mark.parametrize("wrong", [{"halo": 1.5}, {"drift": -1.0}, {"dark": float("nan")}, {"halo_radius": 0.0}])
def test_an_effect_out_of_range_is_refused(wrong):
    with pytest.raises(EmulationError, match=next(iter(wrong))):
        Effects(**wrong)
