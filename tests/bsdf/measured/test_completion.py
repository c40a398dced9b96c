"""Completion of incidences that were not measured, and reciprocity."""

from __future__ import annotations

import numpy as np
import pytest
import rig_primary
import samples

from brdfpipe import facets, optics, vocabulary
from brdfpipe.bsdf import microfacet
from brdfpipe.bsdf.measured import basis as bases
from brdfpipe.bsdf.measured import completion, evaluation, smoothing
from brdfpipe.bsdf.measured.coordinates import cell_angles, outgoing
from brdfpipe.bsdf.measured.node_interpolation import interpolation_abscissa
from brdfpipe.bsdf.measured.reciprocity import contradictions, reciprocity
from brdfpipe.errors import VocabularyError

INCIDENCES = (10.0, 20.0, 30.0, 45.0, 60.0)
WAVELENGTHS = (500.0, 600.0)


def lean(incidence, theta, phi, wavelength):
    """Even in σ except the terms odd in cos φ, as every isotropic surface."""
    sigma = np.radians(incidence)
    logarithm = np.log(0.3) + 0.8 * sigma**2 + 0.5 * sigma * np.sin(np.radians(theta)) * np.cos(np.radians(phi))
    return np.broadcast_to(np.exp(logarithm), (wavelength.size, theta.size))


@pytest.fixture(scope="module")
def paint():
    """A glossy paint of facets, without wavelengths."""
    return samples.beckmann_bsdf(0.05, n=1.5).bsdf.nonspectral()


@pytest.fixture(scope="module")
def smoothed_paint(paint):
    return smoothing.smooth(rig_primary.measured(rig_primary.of_model(paint), INCIDENCES, WAVELENGTHS, noise=0.01))


@pytest.fixture(scope="module")
def completed_paint(smoothed_paint):
    """Without the reversed path, and with it."""
    return {way: completion.complete(smoothed_paint, reciprocity=way) for way in (False, True)}


def directions(low, high, lowest, highest, count=600, seed=0):
    """Pairs with θ_i and θ_o within limits, uniform in azimuth."""
    random = np.random.default_rng(seed)
    return (
        random.uniform(low, high, count),
        np.zeros(count),
        random.uniform(lowest, highest, count),
        random.uniform(0, 360, count),
    )


def relative_error(bsdf, truth, at):
    return np.abs(bsdf.bsdf.evaluate(*at, 500.0).values[:, 0] / truth.bsdf.evaluate(*at).values - 1)


def test_normal_incidence_is_the_even_quadratic_of_the_first_two():
    primary = rig_primary.measured(lean, INCIDENCES, WAVELENGTHS, noise=0)
    smoothed = smoothing.smooth(primary, about="mirror")
    bsdf = completion.complete(smoothed, reciprocity=False)
    value = bsdf.bsdf.evaluate(0.0, 0.0, [0.0, 20.0, 50.0], [0.0, 70.0, 200.0]).values
    # Even in σ, so that the quadratic through ±10 and ±20 is exact.
    assert value == pytest.approx(0.3, rel=2e-3)
    f10, f20 = (smoothing.evaluate(smoothed, 20.0, np.arange(0.0, 360, 5)).values[k, 0] for k in (0, 1))
    mean = [np.exp(np.log(f).mean()) for f in (f10, f20)]
    assert value[1, 0] == pytest.approx(mean[0] ** (4 / 3) * mean[1] ** (-1 / 3), rel=1e-3)
    printed = completion.complete(smoothed, reciprocity=False, normal="linear")
    assert printed.bsdf.evaluate(0.0, 0.0, 20.0, 70.0, 500.0).values[0] == pytest.approx(
        mean[0] ** 2 / mean[1], rel=1e-3
    )
    assert "completed from 10 and 20 degree (even-quadratic" in bsdf.attrs["history"]


def test_a_linear_fit_is_extrapolated_linearly():
    primary = rig_primary.measured(lean, INCIDENCES, WAVELENGTHS, noise=0)
    smoothed = smoothing.smooth(primary, "keldysh")
    bsdf = completion.complete(smoothed, reciprocity=False)
    mean = smoothing.evaluate(smoothed, 20.0, np.arange(0.0, 360, 5)).values[:2, 0].mean(axis=1)
    expected = (4 * mean[0] - mean[1]) / 3
    assert bsdf.bsdf.evaluate(0.0, 0.0, 20.0, 70.0, 500.0).values[0] == pytest.approx(expected, rel=1e-3)


def test_at_measured_incidences_the_bsdf_is_the_fit(smoothed_paint, completed_paint):
    bsdf = completed_paint[False]
    theta, phi = np.array([0.0, 3.0, 12.0, 40.0]), np.array([0.0, 100.0, 250.0, 30.0])
    expected, u = (quantity(smoothed_paint, theta, phi) for quantity in (smoothing.evaluate, smoothing.uncertainty))
    for k, incidence in enumerate(INCIDENCES):
        theta_o, phi_o = rig_primary.outgoing(incidence, theta, phi)
        seen = theta_o < 84
        at = (incidence, 0.0, theta_o[seen], phi_o[seen])
        assert bsdf.bsdf.evaluate(*at).values == pytest.approx(expected.values[k].T[seen], rel=1e-6)
        assert bsdf.bsdf.uncertainty(*at).values == pytest.approx(u.values[k].T[seen], rel=1e-4)


def test_between_the_incidences_a_glossy_paint_is_known_to_a_percent(paint, completed_paint):
    bsdf = completed_paint[True]
    error = relative_error(bsdf, paint, directions(0, 60, 0, 75))
    assert np.median(error) < 0.01
    assert np.quantile(error, 0.95) < 0.04
    # The lobe itself, half way between incidences.
    peak = np.array([5.0, 15.0, 25.0, 37.0, 52.0])
    error = relative_error(bsdf, paint, (peak, 0 * peak, peak, 180 + 0 * peak))
    assert (error < 0.04).all()


def test_the_reversed_path_gives_the_bsdf_beyond_the_last_incidence(paint, completed_paint):
    at = directions(62, 80, 5, 58)
    error = {way: np.median(relative_error(bsdf, paint, at)) for way, bsdf in completed_paint.items()}
    assert error[True] < 0.015
    assert error[True] < error[False] / 3


def test_the_reversed_path_does_not_make_measured_values_worse(paint, completed_paint):
    at = directions(12, 58, 12, 58)
    one, both = (np.sqrt(np.mean(relative_error(completed_paint[way], paint, at) ** 2)) for way in (False, True))
    assert both < one


def test_the_stated_uncertainty_covers_completed_values(paint):
    z = []
    for seed in range(4):
        primary = rig_primary.measured(rig_primary.of_model(paint), INCIDENCES, WAVELENGTHS, noise=0.01, seed=seed)
        bsdf = completion.complete(smoothing.smooth(primary))
        at = directions(0, 60, 0, 75, seed=seed)
        difference = bsdf.bsdf.evaluate(*at, 500.0).values[:, 0] - paint.bsdf.evaluate(*at).values
        z.append(difference / bsdf.bsdf.uncertainty(*at, 500.0).values[:, 0])
    assert 0.8 < np.sqrt(np.mean(np.square(z))) < 1.5


@pytest.mark.cases(3)
@pytest.mark.parametrize("sigma", [0.05, 0.1, 0.25, 0.5])
@pytest.mark.parametrize("beyond_both", [(60, 70, 60, 70), (70, 80, 60, 80)])
def test_the_stated_uncertainty_covers_directions_beyond_the_last_incidence_on_both_sides(sigma, beyond_both):
    truth = samples.beckmann_bsdf(sigma, n=1.5).bsdf.nonspectral()
    bsdf = completion.complete(
        smoothing.smooth(rig_primary.measured(rig_primary.of_model(truth), INCIDENCES, (500.0,), noise=0.01))
    )
    at = directions(*beyond_both)
    value, u = bsdf.bsdf.evaluate(*at, 500.0).values[:, 0], bsdf.bsdf.uncertainty(*at, 500.0).values[:, 0]
    assert np.sqrt(np.mean(((value - truth.bsdf.evaluate(*at).values) / u) ** 2)) < 1.3


def test_both_directions_of_light_agree_within_their_uncertainties_before_averaging_and_exactly_after(completed_paint):
    bsdf = completed_paint[True]
    pairs = reciprocity(bsdf)
    assert pairs.sizes["pair"] == 10
    z = (pairs["forward"] - pairs["backward"]) / np.hypot(pairs["forward_u"], pairs["backward_u"])
    assert 0.3 < float(np.sqrt((z**2).mean())) < 2
    # The average is between the two, and less uncertain than either alone.
    inside = (pairs["averaged"] - pairs["forward"]) * (pairs["averaged"] - pairs["backward"])
    assert (inside <= 1e-12 * pairs["averaged"] ** 2).all()
    assert float((pairs["averaged_u"] / np.minimum(pairs["forward_u"], pairs["backward_u"])).median()) < 1
    at = directions(1, 85, 1, 85)
    forward, backward = bsdf.bsdf.evaluate(*at), bsdf.bsdf.evaluate(at[2], at[3], at[0], at[1])
    assert forward.values == pytest.approx(backward.values, rel=1e-10)


def beyond(smoothed, incidences):
    """About the mirror direction at incidences, (incidence, direction)."""
    bsdf = completion.complete(smoothed, reciprocity=False)
    theta, phi = np.array([0.0, 1.0, 4.0]), np.array([0.0, 90.0, 0.0])
    values = []
    for incidence in incidences:
        theta_o, phi_o = outgoing(smoothed.attrs["about"], np.full(3, incidence), theta, phi)
        values.append(bsdf.bsdf.evaluate(incidence, 0.0, theta_o, phi_o).values[:, 0])
    return bsdf, np.array(values)


def test_beyond_the_last_incidence_a_linear_fit_is_constant_about_the_mirror_direction(paint):
    primary = rig_primary.measured(rig_primary.of_model(paint), INCIDENCES, WAVELENGTHS, noise=0.01)
    bsdf, (last, *others) = beyond(smoothing.smooth(primary, "keldysh"), (60.0, 70.0, 80.0))
    for value in others:
        assert value == pytest.approx(last, rel=1e-6)
    assert "beyond 60 degree completed: constant about the mirror direction" in bsdf.attrs["history"]


def test_beyond_the_last_incidence_the_logarithm_continues_its_trend(smoothed_paint):
    abscissa = interpolation_abscissa(np.array([45.0, 60.0]))
    steps = np.array([1.0, 3.0, 4.0, 6.0])
    beyond_ = np.degrees(np.arccos(np.exp(-(abscissa[1] + steps * (abscissa[1] - abscissa[0])))))
    bsdf, values = beyond(smoothed_paint, (45.0, 60.0, *beyond_))
    before, last, *after = np.log(values[:, 0])
    # But for what bends it towards grazing, which goes with the outgoing angle.
    for number, value in zip((1, 3, 4, 4), after, strict=True):
        assert value - last == pytest.approx(number * (last - before), rel=0.1)
    assert f"beyond 60 degree completed: trend continued to {beyond_[2]:.0f} degree" in bsdf.attrs["history"]
    assert float(bsdf["incidence"][-1]) == pytest.approx(beyond_[2])


@pytest.mark.parametrize("sigma", [0.05, 0.25])
def test_the_lobe_beyond_the_last_incidence_is_nearer_the_truth_by_its_trend(sigma):
    truth = samples.beckmann_bsdf(sigma, n=1.5).bsdf.nonspectral()
    smoothed = smoothing.smooth(rig_primary.measured(rig_primary.of_model(truth), INCIDENCES, (500.0,), noise=0.01))
    bsdf = completion.complete(smoothed)
    mirror = np.array([62.0, 65.0, 70.0])
    at = (mirror, 0 * mirror, mirror, 180 + 0 * mirror)
    expected, value, u = (
        field.values.ravel()
        for field in (truth.bsdf.evaluate(*at), bsdf.bsdf.evaluate(*at), bsdf.bsdf.uncertainty(*at))
    )
    stays = float(truth.bsdf.evaluate(60.0, 0.0, 60.0, 180.0).values.squeeze())
    assert (np.abs(value - expected) < np.abs(stays - expected)).all()
    assert (np.abs(value - expected) < u).all()


@pytest.mark.cases(2)
@pytest.mark.parametrize("reflectance", [0.95, None])
@pytest.mark.parametrize("incidences", [INCIDENCES, (10.0, 30.0, 50.0, 70.0)])
def test_no_trend_violates_energy_conservation(reflectance, incidences):
    if reflectance is None:  # a metal, of which the lobe alone is seen
        surface = facets.analytic("beckmann", 0.05 * np.sqrt(2))
        index = optics.refractive_index({"n": 1.0, "k": 7.0})
        truth = microfacet.build(surface, index=index, spectrum=None, multiple_scattering="none").bsdf.nonspectral()
    else:
        truth = samples.beckmann_bsdf(0.05, n=1.5, reflectance=reflectance).bsdf.nonspectral()
    primary = rig_primary.measured(rig_primary.of_model(truth), incidences, (500.0,), noise=0.02, dark=1e-4)
    bsdf = completion.complete(smoothing.smooth(primary))
    for incidence in (65.0, 70.0, 75.0, 80.0, 85.0, 89.0):
        assert float(bsdf.bsdf.albedo(incidence).max()) <= 1, incidence


@pytest.mark.cases(5)
@pytest.mark.parametrize("mode", smoothing.MODES)
@pytest.mark.parametrize("incidences", [(45.0,), (30.0, 60.0), (0.0, 10.0, 45.0), INCIDENCES])
def test_every_direction_has_a_finite_value_that_is_not_negative_and_an_uncertainty(mode, incidences):
    lobe = rig_primary.lobe("peak 10 sr-1, 3 degree")
    bsdf = completion.complete(smoothing.smooth(rig_primary.measured(lobe, incidences, [500.0]), mode))
    edges = np.array([0.0, 1e-6, 10.0, 45.0, 60.0, 77.0, 89.0, 89.99, 89.9999999])
    theta_i, theta_o, phi = (axis.ravel() for axis in np.meshgrid(edges, edges, [0.0, 90.0, 180.0, 359.0]))
    value, u = (quantity(theta_i, 0.0, theta_o, phi) for quantity in (bsdf.bsdf.evaluate, bsdf.bsdf.uncertainty))
    assert np.isfinite(value).all()
    assert (value >= 0).all()
    assert np.isfinite(u).all()
    assert (u >= 0).all()
    # Nowhere more than twice of what was measured.
    assert float(value.max()) < 22 or mode != "pspline"


def test_a_spectrum_without_a_value_is_filled_from_the_incidences_next_to_it(paint, smoothed_paint):
    primary = rig_primary.measured(rig_primary.of_model(paint), INCIDENCES, WAVELENGTHS, noise=0.01)
    primary["brdf"][2, 1] = np.nan
    bsdf = completion.complete(smoothing.smooth(primary))
    flags = bsdf["coefficient_quality"].values
    assert flags[3, 1] == vocabulary.quality("completed")
    assert flags[3, 0] == vocabulary.quality("measured")
    at = (np.full(20, 30.0), np.zeros(20), np.linspace(0, 70, 20), np.linspace(0, 180, 20))
    expected = paint.bsdf.evaluate(*at).values
    assert bsdf.bsdf.evaluate(*at, 600.0).values[:, 0] == pytest.approx(expected, rel=0.06)
    assert "1 missing spectra of reflection interpolated" in bsdf.attrs["history"]


def test_an_incidence_without_any_value_counts_as_unmeasured(smoothed_paint):
    primary = rig_primary.measured(rig_primary.lobe("peak 10 sr-1, 3 degree"), (10.0, 20.0, 45.0), WAVELENGTHS)
    primary["brdf"][1] = np.nan
    bsdf = completion.complete(smoothing.smooth(primary))
    assert list(bsdf["incidence"].values[:3]) == [0.0, 10.0, 45.0]


def test_a_wavelength_without_any_measurement_is_refused():
    primary = rig_primary.measured(rig_primary.lobe("peak 10 sr-1, 3 degree"), (10.0, 20.0), WAVELENGTHS)
    primary["brdf"][:, 1] = np.nan
    with pytest.raises(VocabularyError, match="nothing was measured at 600 nm"):
        completion.complete(smoothing.smooth(primary))


def test_reflection_and_transmission_must_be_of_one_rig_and_plan(smoothed_paint):
    with pytest.raises(VocabularyError, match="smoothed data of transmission, found 'reflection'"):
        completion.complete(smoothed_paint, smoothed_paint)
    lobe = rig_primary.lobe("peak 10 sr-1, 3 degree")
    other = smoothing.smooth(rig_primary.measured(lobe, (30.0,), [500.0], side="transmission"))
    with pytest.raises(VocabularyError, match="differ in 'wavelength'"):
        completion.complete(smoothed_paint, other)
    with pytest.raises(VocabularyError, match="smoothed data of reflection, found 'transmission'"):
        completion.complete(other)


def test_an_unknown_completion_is_refused(smoothed_paint):
    with pytest.raises(VocabularyError, match="accepted: even-quadratic, linear"):
        completion.complete(smoothed_paint, normal="cubic")


def test_warnings_of_the_smoothed_data_are_passed_on():
    primary = vocabulary.add_warning(
        rig_primary.measured(rig_primary.lobe("peak 10 sr-1, 3 degree"), (10.0, 45.0)), "the lamp is old"
    )
    bsdf = completion.complete(smoothing.smooth(primary))
    assert "the lamp is old" in vocabulary.warnings(bsdf)
    assert "smoothed by pspline" in bsdf.attrs["history"]


def test_common_errors_of_both_directions_of_light_add_up(paint):
    primary = rig_primary.measured(rig_primary.of_model(paint), INCIDENCES, WAVELENGTHS, noise=0.01)
    primary["brdf_u_noise"] = primary["brdf_u"].assign_attrs(correlation="independent")
    primary["brdf_u_certificate"] = (3 * primary["brdf_u"]).assign_attrs(correlation="common")
    bsdf = completion.complete(smoothing.smooth(vocabulary.label(primary, "primary")))
    at = directions(10, 60, 10, 60, count=100)
    u = evaluation.uncertainty(bsdf, *at, None) / evaluation.evaluate(bsdf, *at, None)
    assert np.median(u) == pytest.approx(0.03, rel=0.15)


def test_the_peak_that_the_entrance_hides_at_normal_incidence_follows_from_the_next_incidences():
    def narrow(incidence, theta, phi, wavelength):
        brdf = 0.1 + 300 * rig_primary.gaussian(theta, 1.5) / np.cos(np.radians(incidence))
        return np.broadcast_to(brdf, (wavelength.size, theta.size))

    primary = rig_primary.measured(narrow, (0.0, *INCIDENCES), WAVELENGTHS, noise=0.01)
    hidden = primary["theta_s"].values < 4
    primary["brdf"].values[0, :, hidden] = np.nan
    smoothed = smoothing.smooth(primary)
    bsdf = completion.complete(smoothed, reciprocity=False)
    theta = np.array([0.0, 1.0, 2.5, 6.0, 12.0, 40.0])
    expected = narrow(0.0, theta, 0 * theta, np.ones(1))[0]
    value, u = (
        quantity(0.0, 0.0, theta, 0.0, 500.0).values[:, 0] for quantity in (bsdf.bsdf.evaluate, bsdf.bsdf.uncertainty)
    )
    assert value == pytest.approx(expected, rel=0.06)
    assert (np.abs(value - expected) < 2 * u)[:3].all()
    assert 0.01 < u[0] / value[0] < 0.1
    first = primary["theta_s"].values[~hidden].min()
    assert f"within {first:.1f} degree of the mirror direction completed from 10 degree on" in bsdf.attrs["history"]
    # Where cells looked, they have the last word; without the others the peak is missed by far.
    alone = smoothing.evaluate(smoothed, theta, 0.0).values[0, 0]
    assert value[3:] == pytest.approx(alone[3:], rel=0.02)
    assert not 0.5 < alone[0] / expected[0] < 1.5


def test_terms_odd_in_the_incidence_vanish_towards_normal_incidence():
    primary = rig_primary.measured(lean, INCIDENCES, WAVELENGTHS, noise=0)
    bsdf = completion.complete(smoothing.smooth(primary, about="mirror"), reciprocity=False)
    theta, phi = np.array([60.0, 60.0, 60.0]), np.array([0.0, 90.0, 180.0])
    for incidence in (3.0, 5.0, 15.0):
        at = rig_primary.outgoing(incidence, theta, phi)
        expected = lean(incidence, theta, phi, np.ones(1))[0]
        assert bsdf.bsdf.evaluate(incidence, 0.0, *at, 500.0).values[:, 0] == pytest.approx(expected, rel=4e-3)


def test_the_decrease_towards_grazing_follows_the_true_outgoing_angle_and_not_that_at_the_node():
    def falling(incidence, theta, phi, wavelength):
        cosine = np.maximum(rig_primary.cos_view(incidence, theta, phi), 0)
        return np.broadcast_to(0.2 * np.exp(-0.8 * np.exp(-cosine / 0.1)), (wavelength.size, theta.size))

    bsdf = completion.complete(
        smoothing.smooth(rig_primary.measured(falling, INCIDENCES, WAVELENGTHS, noise=0.003)), reciprocity=False
    )
    # On the side of the source, where the same place about the mirror direction is at 71° and 86° for the incidences around.
    theta_o = np.array([60.0, 70.0, 79.0])
    value = bsdf.bsdf.evaluate(37.0, 0.0, theta_o, 15.0, 500.0).values[:, 0]
    expected = 0.2 * np.exp(-0.8 * np.exp(-np.cos(np.radians(theta_o)) / 0.1))
    assert value == pytest.approx(expected, rel=0.02)


def test_beyond_its_cells_a_fit_is_limited_to_twice_their_values():
    lobe = rig_primary.lobe("peak 300 sr-1, 1.5 degree")
    primary = rig_primary.measured(lobe, (30.0, 45.0), [500.0], noise=0.01)
    disc = primary["theta_s"].values < 6
    primary["brdf"].values[:, :, ~disc] = np.nan
    smoothed = smoothing.smooth(primary)
    seen = smoothing.evaluate(smoothed, primary["theta_s"].values[disc], primary["phi_s"].values[disc])
    value = completion.complete(smoothed).bsdf.evaluate(*directions(0, 89, 0, 89), 500.0).values
    assert value.min() >= float(seen.min()) / 2 * (1 - 1e-9)
    assert value.max() <= float(seen.max()) * 2 * (1 + 1e-9)
    # Without that bound it would: the lobe goes on falling.
    assert float(smoothing.evaluate(smoothed, 60.0, 0.0).min()) < float(seen.min()) / 100


# --- what contradicts itself, and what is not known


def z_of(bsdf, truth, at, wavelength=500.0):
    """Errors over their stated uncertainties."""
    value, u = (quantity(*at, wavelength).values[:, 0] for quantity in (bsdf.bsdf.evaluate, bsdf.bsdf.uncertainty))
    return (value - truth.bsdf.evaluate(*at).values) / u


def test_an_incidence_that_contradicts_the_others_is_named_and_more_uncertain(paint):
    primary = rig_primary.measured(rig_primary.of_model(paint), INCIDENCES, WAVELENGTHS, noise=0.01)
    sound = completion.complete(smoothing.smooth(primary))
    assert not any("Reciprocity is violated" in text for text in vocabulary.warnings(sound))
    assert float(contradictions(sound).max()) < 2
    primary["brdf"][-1] *= 1.3
    bsdf = completion.complete(smoothing.smooth(primary))
    (warning,) = (text for text in vocabulary.warnings(bsdf) if "Reciprocity is violated" in text)
    assert "60° (" in warning
    assert "45°" not in warning
    at = directions(59.6, 60.0, 5, 55)
    assert np.sqrt(np.mean(z_of(bsdf, paint, at) ** 2)) < 2
    near = (30.0, 0.0, 20.0, 60.0)
    assert float(bsdf.bsdf.uncertainty(*near, 500.0).squeeze()) < 1.5 * float(
        sound.bsdf.uncertainty(*near, 500.0).squeeze()
    )


def even(incidence, theta, phi, wavelength):
    return np.full((wavelength.size, theta.size), 0.3)


@pytest.mark.parametrize(("name", "expected"), [("path", np.hypot(1.8, 0.8)), ("certificate", 1.0)])
def test_errors_of_single_entrances_add_up_differently_from_a_common_error(name, expected):
    """Normal incidence from 20 and 30 degree, (900 η₂₀ − 400 η₃₀)/500: 5 % of either entrance are 9.85 %, 5 % of both alike are 5 %."""
    primary = rig_primary.measured(even, (20.0, 30.0), (500.0,), noise=1e-3)
    primary["brdf_u_noise"] = primary["brdf_u"].assign_attrs(correlation="independent")
    primary[f"brdf_u_{name}"] = (0.05 * primary["brdf"]).assign_attrs(correlation="common")
    primary["brdf_u"] = np.hypot(primary["brdf_u_noise"], primary[f"brdf_u_{name}"])
    bsdf = completion.complete(smoothing.smooth(vocabulary.label(primary, "primary")), reciprocity=False)
    at_normal = bsdf["incidence"].values == 0
    common = bsdf["coefficient_common"].values[:, at_normal][:, 0, 0]
    theta, phi = np.array([5.0, 10.0, 20.0]), np.zeros(3)
    seen = cell_angles(bsdf.attrs["about"], 0.0, theta, phi)
    rows = bases.from_json(bsdf.attrs["basis"]).rows(*seen, np.cos(np.radians(theta)))
    assert np.linalg.norm(rows @ common.T, axis=1) == pytest.approx(np.full(3, 0.05 * expected), rel=0.02)


def test_of_three_incidences_the_one_that_contradicts_both_others_is_named(paint):
    primary = rig_primary.measured(rig_primary.of_model(paint), (10.0, 30.0, 60.0), (500.0,), noise=0.01)
    primary["brdf"][-1] *= 1.3
    bsdf = completion.complete(smoothing.smooth(primary))
    (warning,) = (text for text in vocabulary.warnings(bsdf) if "Reciprocity is violated" in text)
    assert "at 60° (" in warning
    assert "10°" not in warning


def test_two_pictures_that_were_exchanged_contradict_the_rest(paint):
    primary = rig_primary.measured(rig_primary.of_model(paint), INCIDENCES, WAVELENGTHS, noise=0.01)
    primary["brdf"][[2, 4]] = primary["brdf"].values[[4, 2]]
    bsdf = completion.complete(smoothing.smooth(primary))
    assert any("Reciprocity is violated" in text for text in vocabulary.warnings(bsdf))


def test_reciprocity_is_not_averaged_for_a_surface_with_a_lay(paint):
    primary = rig_primary.measured(rig_primary.of_model(paint), INCIDENCES, WAVELENGTHS, noise=0.01)
    bsdf = completion.complete(smoothing.smooth(primary, mirror_symmetric=False, isotropic=False))
    assert bsdf.attrs["reciprocity"] == "none"
    assert any("Measure the rotated sample" in text for text in vocabulary.warnings(bsdf))


def test_a_spectrum_missing_at_one_incidence_is_as_uncertain_as_its_interpolation(paint):
    primary = rig_primary.measured(rig_primary.of_model(paint), INCIDENCES, WAVELENGTHS, noise=0.01)
    whole = completion.complete(smoothing.smooth(primary))
    primary["brdf"][3, 1] = np.nan
    bsdf = completion.complete(smoothing.smooth(primary))
    at = directions(44.8, 45.2, 0, 75)
    assert np.sqrt(np.mean(z_of(bsdf, paint, at, 600.0) ** 2)) < 2
    u, before = (dataset.bsdf.uncertainty(*at, [500.0, 600.0]).values for dataset in (bsdf, whole))
    assert np.median(u[:, 1] / before[:, 1]) > 1.5 * np.median(u[:, 0] / before[:, 0])


@pytest.mark.parametrize("sigma", [0.05, 0.25])
def test_between_three_incidences_the_stated_uncertainty_covers_the_error(sigma):
    truth = samples.beckmann_bsdf(sigma, n=1.5).bsdf.nonspectral()
    primary = rig_primary.measured(rig_primary.of_model(truth), (10.0, 30.0, 60.0), (500.0,), noise=0.01)
    bsdf = completion.complete(smoothing.smooth(primary))
    assert np.sqrt(np.mean(z_of(bsdf, truth, directions(0, 60, 0, 75, 2000)) ** 2)) < 2


@pytest.mark.parametrize("sigma", [0.05, 0.25])
def test_beyond_the_last_cell_the_uncertainty_grows_towards_the_horizon(sigma):
    truth = samples.beckmann_bsdf(sigma, n=1.5).bsdf.nonspectral()
    bsdf = completion.complete(
        smoothing.smooth(rig_primary.measured(rig_primary.of_model(truth), INCIDENCES, (500.0,), noise=0.01))
    )
    for low, high in ((84, 86), (86, 88), (88, 89.5)):
        assert np.sqrt(np.mean(z_of(bsdf, truth, directions(0, 60, low, high)) ** 2)) < 2
