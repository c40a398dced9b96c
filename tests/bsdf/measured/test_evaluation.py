"""The representation ``rig`` as a BSDF: values, uncertainties, quality and checks."""

from __future__ import annotations

import json

import numpy as np
import pytest
import rig_accuracy as accuracy
import rig_emulated
import rig_primary
import samples
import xarray as xr

from brdfpipe import store, vocabulary
from brdfpipe.bsdf import microfacet
from brdfpipe.bsdf.measured import completion, coordinates, evaluation, node_errors, node_interpolation, smoothing
from brdfpipe.bsdf.registry import representation
from brdfpipe.errors import VocabularyError
from brdfpipe.facets.analytic_distributions import analytic
from brdfpipe.rig.reduction.cells import cells_of
from brdfpipe.specular_directions import cos_view

INCIDENCES = (10.0, 30.0, 60.0)
WAVELENGTHS = (450.0, 550.0, 650.0)


def paint(incidence, theta, phi, wavelength):
    body = np.interp(wavelength, [450, 650], [0.02, 0.2])[:, None]
    return body + rig_primary.gaussian(theta, 3) * 5 / np.cos(np.radians(incidence))


def film(incidence, theta, phi, wavelength):
    return np.interp(wavelength, [450, 650], [0.5, 0.3])[:, None] * (0.1 + rig_primary.gaussian(theta, 8))


@pytest.fixture(scope="module")
def bsdf():
    return completion.complete(smoothing.smooth(rig_primary.measured(paint, INCIDENCES, WAVELENGTHS)))


@pytest.fixture(scope="module")
def verdicts(bsdf):
    return json.loads(bsdf.bsdf.check().attrs["verdicts"])


@pytest.fixture(scope="module")
def translucent():
    reflected = smoothing.smooth(rig_primary.measured(paint, INCIDENCES, WAVELENGTHS))
    passed = smoothing.smooth(rig_primary.measured(film, (0.0, 20.0, 50.0), WAVELENGTHS, side="transmission"))
    return completion.complete(reflected, passed)


def lanes(count=40, seed=0, low=0.0, high=89.0):
    random = np.random.default_rng(seed)
    return (
        random.uniform(0, 89, count),
        random.uniform(-180, 180, count),
        random.uniform(low, high, count),
        random.uniform(0, 360, count),
    )


def test_the_accessor_gives_values_and_uncertainties(bsdf):
    brdf = bsdf.bsdf.evaluate(30, 0, [10, 30, 50], 180, [500, 600])
    u = bsdf.bsdf.uncertainty(30, 0, [10, 30, 50], 180, [500, 600])
    assert brdf.dims == u.dims == ("direction", "wavelength")
    assert (u.name, u.attrs["units"]) == ("brdf_u", "sr-1")
    assert (u / brdf > 0.001).all()
    assert (u / brdf < 0.1).all()


@pytest.mark.parametrize(("name", "low", "high"), [("bsdf", 0, 89), ("translucent", 91, 180)])
def test_one_direction_is_evaluated_as_several_are(request, name, low, high):
    accessor, angles = request.getfixturevalue(name).bsdf, lanes(5, low=low, high=high)
    alone = [accessor.evaluate(*map(float, pair)).values for pair in zip(*angles, strict=True)]
    np.testing.assert_allclose(alone, accessor.evaluate(*angles).values, rtol=1e-13)
    assert not accessor.evaluate(120.0, 0.0, 130.0, 0.0).values.any()


@pytest.mark.parametrize("about", ["half", "mirror"])
@pytest.mark.parametrize("isotropic", [True, False])
def test_compiled_values_are_those_of_the_basis_functions(about, isotropic):
    primary = rig_primary.measured(paint, INCIDENCES, WAVELENGTHS)
    smoothed = smoothing.smooth(primary, about=about, isotropic=isotropic, mirror_symmetric=isotropic)
    side = node_interpolation.Side.of(completion.complete(smoothed), False, slice(None))
    theta_i, _, theta_o, phi = lanes(2000, high=89.999)
    theta_o[:50], phi[:50] = theta_i[:50], 180.0  # the mirror direction
    theta_i[50:60], theta_o[55:65] = 0.0, 0.0
    theta_i[65:75], theta_o[70:80], phi[75:85] = INCIDENCES[-1], side.horizon[-1], 0.0
    theta_i[85:90] = 89.9999999
    expected = node_interpolation.path_values(side, node_interpolation.path_directions(side, theta_i, theta_o, phi))
    np.testing.assert_allclose(node_interpolation.side_values(side, theta_i, theta_o, phi), expected, rtol=1e-11)


def test_a_representation_without_uncertainties_names_those_with_them():
    with pytest.raises(
        VocabularyError, match="'microfacet' states no uncertainty; those that do: kirchhoff, rig, traced"
    ):
        samples.beckmann_bsdf(0.1).bsdf.uncertainty(30, 0, 30, 180)


def test_wavelengths_are_interpolated_linearly(bsdf):
    at = lanes()
    own = bsdf.bsdf.evaluate(*at).values
    brdf = bsdf.bsdf.evaluate(*at, [450.0, 475.0, 650.0]).values
    assert brdf == pytest.approx(np.stack([own[:, 0], 0.75 * own[:, 0] + 0.25 * own[:, 1], own[:, 2]], axis=1))
    with pytest.raises(VocabularyError, match="cover 450 to 650 nm"):
        bsdf.bsdf.evaluate(30, 0, 30, 180, 700)


def test_one_wavelength_is_enough(bsdf):
    primary = rig_primary.measured(paint, INCIDENCES, [550.0])
    alone = completion.complete(smoothing.smooth(primary))
    assert alone.bsdf.evaluate(30, 0, [10, 50], 180, 550.0).shape == (2, 1)


def test_only_the_difference_of_azimuths_counts(bsdf):
    theta_i, phi_i, theta_o, phi_o = lanes()
    turned = bsdf.bsdf.evaluate(theta_i, phi_i + 33, theta_o, phi_o + 33)
    assert turned.values == pytest.approx(bsdf.bsdf.evaluate(theta_i, phi_i, theta_o, phi_o).values, rel=1e-8)
    assert representation(bsdf).isotropic


def test_a_basis_that_is_even_in_the_azimuth_gives_a_symmetric_bsdf(bsdf):
    assert representation(bsdf).mirror_symmetric
    theta_o, turn = np.array([20.0, 50.0, 70.0]), np.array([10.0, 100.0, 170.0])
    left, right = (bsdf.bsdf.evaluate(40.0, 30.0, theta_o, 30.0 + side * turn).values for side in (-1, 1))
    assert left == pytest.approx(right, rel=1e-12)


def test_there_is_no_light_at_and_below_the_horizon(bsdf):
    assert (bsdf.bsdf.evaluate([90, 30, 30, 120], 0, [30, 90, 120, 30], 0).values == 0).all()
    assert (bsdf.bsdf.uncertainty([90, 30, 30, 120], 0, [30, 90, 120, 30], 0).values == 0).all()


def test_a_measured_bsdf_passes_its_checks(verdicts):
    assert {verdict["verdict"] for verdict in verdicts.values()} == {"pass"}, verdicts


def test_a_material_that_reflects_too_much_fails_its_checks():
    def bright(incidence, theta, phi, wavelength):
        return np.full((wavelength.size, theta.size), 1.2 / np.pi)

    bsdf = completion.complete(smoothing.smooth(rig_primary.measured(bright, INCIDENCES, [550.0])))
    assert bsdf.bsdf.albedo(30.0).item() == pytest.approx(1.2, rel=0.01)


def sheet(reflectance, u):
    """A diffuser with a common uncertainty."""

    def even(incidence, theta, phi, wavelength):
        return np.full((wavelength.size, theta.size), reflectance / np.pi)

    primary = rig_primary.measured(even, INCIDENCES, [550.0], noise=0.005)
    primary["brdf_u_noise"] = primary["brdf_u"].assign_attrs(correlation="independent")
    primary["brdf_u_certificate"] = (u * primary["brdf"]).assign_attrs(correlation="common")
    primary["brdf_u"] = np.hypot(primary["brdf_u_noise"], primary["brdf_u_certificate"])
    return completion.complete(smoothing.smooth(vocabulary.label(primary, "primary")))


@pytest.mark.cases(1)
@pytest.mark.parametrize(
    ("reflectance", "verdict"), [pytest.param(0.97, "pass", marks=pytest.mark.slow), (1.004, "warn"), (1.05, "fail")]
)
def test_more_light_than_arrives_is_a_failure_where_the_uncertainty_does_not_explain_it(reflectance, verdict):
    energy = json.loads(sheet(reflectance, 0.01).bsdf.check().attrs["verdicts"])["energy"]
    assert energy["verdict"] == verdict, energy
    assert ("within its uncertainty" in energy["text"]) == (verdict == "warn")


def test_the_uncertainty_of_the_reflectance_is_that_of_its_common_errors():
    bsdf = sheet(0.5, 0.01)
    u = evaluation.albedo_uncertainty(bsdf, np.array([30.0]), np.zeros(1), None)
    assert u.item() == pytest.approx(0.005, rel=0.3)


def test_averaged_reciprocity_is_judged_by_the_measured_values(verdicts):
    sound = verdicts["reciprocity"]
    assert sound["verdict"] == "pass"
    assert "the BSDF is their average, and the measured ones differ by up to" in sound["text"]
    primary = rig_primary.measured(rig_primary.lobe("peak 10 sr-1, 3 degree"), INCIDENCES, [550.0])
    leaning = completion.complete(smoothing.smooth(primary))
    assert json.loads(leaning.bsdf.check().attrs["verdicts"])["reciprocity"]["verdict"] == "warn"


def test_the_mean_over_wavelengths_is_exact(bsdf):
    at, weight = lanes(), np.array([1.0, 2.0, 1.0]) / 4
    mean = bsdf.bsdf.nonspectral(weight)
    vocabulary.validate(mean, "bsdf")
    assert mean.bsdf.evaluate(*at).values == pytest.approx(bsdf.bsdf.evaluate(*at).values @ weight)
    u = mean.bsdf.uncertainty(*at).values
    assert (u <= bsdf.bsdf.uncertainty(*at).values @ weight * (1 + 1e-9)).all()
    assert evaluation.nonspectral(mean, weight) is mean


def test_transmitted_light_continues_straight_from_either_side(translucent):
    theta = np.array([0.0, 20.0, 50.0])
    btdf = translucent.bsdf.evaluate(theta, 0, 180 - theta, 180, 450.0).values[:, 0]
    assert btdf == pytest.approx(0.55, rel=0.02)
    theta_i, phi_i, theta_o, phi_o = lanes(low=91, high=180)
    there = translucent.bsdf.evaluate(theta_i, phi_i, theta_o, phi_o)
    back = translucent.bsdf.evaluate(theta_o, phi_o, theta_i, phi_i)
    assert (there == back).all()
    # Light that comes from below was not measured, and is not reflected.
    assert (translucent.bsdf.evaluate(150, 0, [120, 150], 180).values == 0).all()
    assert (translucent.bsdf.uncertainty(30, 0, [150, 140], 180).values > 0).all()
    assert translucent.bsdf.transmittance(20.0, 0.0, 450.0).item() > 0.1


def test_transmission_does_not_change_reflection(bsdf, translucent):
    at = lanes()
    assert translucent.bsdf.evaluate(*at).values == pytest.approx(bsdf.bsdf.evaluate(*at).values)


def quality(bsdf, *at):
    flags = evaluation.quality(bsdf, *(np.atleast_1d(np.asarray(angle, dtype=float)) for angle in at))
    return [vocabulary.QUALITY_FLAGS[flag] for flag in flags]


def test_every_value_has_a_flag_of_its_origin(bsdf, translucent):
    assert quality(bsdf, 30, 0, [10, 30, 60], 180) == ["measured"] * 3
    assert quality(bsdf, 20, 0, [20, 22, 50], 180) == ["interpolated"] * 3
    # Neither the incidence nor, on the reversed path, the outgoing angle is among those measured.
    assert quality(bsdf, 5, 0, 5, 180) == ["completed"]
    assert quality(bsdf, 75, 0, 75, 180) == ["completed"]
    # The reversed path gives incidences beyond the last.
    assert quality(bsdf, 75, 0, 30, 180) == ["measured"]
    assert quality(bsdf.assign_attrs(reciprocity="none"), 75, 0, 30, 180) == ["completed"]
    assert quality(bsdf, 45, 0, 89, 90) == ["extrapolated"]
    assert quality(translucent, 20, 0, [160, 150], 180) == ["measured"] * 2
    assert quality(translucent, 70, 0, 110, 180) == ["completed"]


def test_directions_without_a_cell_are_extrapolated():
    primary = rig_primary.measured(paint, (30.0,), [550.0])
    hole = (primary["theta_s"] > 40) & (primary["theta_s"] < 70) & (np.abs(primary["phi_s"] - 90) < 40)
    hole = hole | ((primary["theta_s"] > 40) & (primary["theta_s"] < 70) & (np.abs(primary["phi_s"] - 270) < 40))
    primary["brdf"] = primary["brdf"].where(~hole)
    bsdf = completion.complete(smoothing.smooth(primary), reciprocity=False)
    theta_o, phi_o = rig_primary.outgoing(30.0, np.array([55.0, 55.0]), np.array([90.0, 0.0]))
    assert quality(bsdf, 30, 0, theta_o, phi_o) == ["extrapolated", "measured"]


def test_the_width_of_the_lobe_is_given_as_a_slope(bsdf):
    # A Gaussian of 3° standard deviation about the mirror direction is that of facets tilted half as much.
    assert representation(bsdf).lobe_slope == pytest.approx(np.tan(np.radians(1.5)), rel=0.1)


def test_weights_of_samples_add_up_to_the_albedo(bsdf):
    drawn = bsdf.bsdf.sample(4000, 1, 30.0, wavelength=550.0)
    assert float(drawn["weight"].mean()) == pytest.approx(bsdf.bsdf.albedo(30.0, 0.0, 550.0).item(), rel=0.02)


def test_it_is_stored_and_read_back_the_same(bsdf, translucent, tmp_path):
    at = lanes(low=0, high=180)
    for dataset in (bsdf, translucent, bsdf.bsdf.nonspectral()):
        store.save_dataset(dataset, tmp_path / "bsdf.nc", stage="bsdf", material="paint")
        again = store.open_dataset(tmp_path / "bsdf.nc")
        store.verify_digest(again, "bsdf.nc")
        assert (again.bsdf.evaluate(*at).values == dataset.bsdf.evaluate(*at).values).all()
        assert (again.bsdf.uncertainty(*at).values == dataset.bsdf.uncertainty(*at).values).all()


def test_shapes_of_any_dimensions_and_none_are_accepted(bsdf):
    assert bsdf.bsdf.evaluate(30, 0, np.empty(0), 0).shape == (0, 3)
    assert bsdf.bsdf.uncertainty(np.full((2, 3), 30.0), 0, 40, 0).shape == (2, 3, 3)


def test_many_directions_at_once_are_those_one_at_a_time(bsdf, monkeypatch):
    at = lanes(60)
    whole = bsdf.bsdf.evaluate(*at).values, bsdf.bsdf.uncertainty(*at).values
    monkeypatch.setattr(evaluation, "_CHUNK", 7)
    assert bsdf.bsdf.evaluate(*at).values == pytest.approx(whole[0], rel=1e-12)
    assert bsdf.bsdf.uncertainty(*at).values == pytest.approx(whole[1], rel=1e-9)


@pytest.mark.parametrize("theta", [0.0, 30.0, 63.0, 85.0])
def test_its_albedo_is_its_integral(bsdf, theta):
    at = np.array([theta]), np.zeros(1), np.array([550.0])
    integral = representation(bsdf).integrate(*at)
    assert representation(bsdf).albedo(*at) == pytest.approx(integral.value, rel=2e-4)


def test_a_bsdf_that_leans_to_one_side_is_integrated_over_both_sides():
    def leaning(incidence, theta, phi, wavelength):
        brdf = 0.1 * (1 + 0.5 * np.sin(np.radians(theta)) * np.sin(np.radians(phi)))
        return np.broadcast_to(brdf, (wavelength.size, theta.size))

    smoothed = smoothing.smooth(
        rig_primary.measured(leaning, (30.0, 50.0), [550.0]), mirror_symmetric=False, isotropic=False
    )
    bsdf = completion.complete(smoothed, reciprocity=False)
    # What leans to one side is missing on the other.
    assert bsdf.bsdf.albedo(40.0).item() == pytest.approx(0.1 * np.pi, rel=0.02)
    left, right = bsdf.bsdf.evaluate(40, 0, 40, [90, 270]).values[:, 0]
    assert abs(left - right) > 0.02


# --- between wavelengths


def edge(incidence, theta, phi, wavelength):
    """A red edge at 592 nm, as of a pigment."""
    body = 0.03 + 0.2 / (1 + np.exp((592 - wavelength) / 6))[:, None]
    return body + rig_primary.gaussian(theta, 8) * 0.5


@pytest.fixture(scope="module")
def pigment():
    wavelengths = np.arange(450.0, 701.0, 25.0)
    return completion.complete(smoothing.smooth(rig_primary.measured(edge, (10.0, 30.0), wavelengths, noise=0.005)))


def test_an_edge_between_two_wavelengths_is_within_the_uncertainty(pigment):
    between = np.arange(455.0, 700.0, 5.0)
    theta_o, phi_o = np.linspace(20.0, 60.0, 12), np.full(12, 90.0)
    value, u = (
        getattr(evaluation, name)(pigment, np.full(12, 30.0), np.zeros(12), theta_o, phi_o, between)
        for name in ("evaluate", "uncertainty")
    )
    theta, phi = coordinates.angles("mirror", np.full(12, 30.0), theta_o, phi_o)
    z = (value - edge(30.0, theta, phi, between).T) / u
    # Without the term, z reaches 20 at 575 and 600 nm.
    assert 0.3 < np.sqrt(np.mean(z**2)) < 1.3
    assert np.abs(z).max() < 6


def test_at_the_measured_wavelengths_nothing_is_added(pigment):
    own, all_ = np.array([500.0, 600.0]), pigment["wavelength"].values
    at = np.array([30.0]), np.zeros(1), np.array([40.0]), np.array([90.0])
    everywhere = evaluation.uncertainty(pigment, *at, None)[:, np.isin(all_, own)]
    assert evaluation.uncertainty(pigment, *at, own) == pytest.approx(everywhere, rel=1e-12)


def test_between_only_two_wavelengths_the_change_between_them_is_uncertain():
    smoothed = smoothing.smooth(rig_primary.measured(edge, (10.0, 30.0), (570.0, 610.0), noise=0.005))
    bsdf = completion.complete(smoothed)
    at = np.array([30.0]), np.zeros(1), np.array([40.0]), np.array([90.0])
    low, high = evaluation.evaluate(bsdf, *at, None)[0]
    (u,) = evaluation.uncertainty(bsdf, *at, np.array([590.0]))[0]
    assert u == pytest.approx((high - low) / 4, rel=0.05)


# --- uncertainties


@pytest.mark.parametrize("about", ["half", "mirror"])
def test_compiled_uncertainties_are_those_of_the_arrays(about):
    primary = rig_primary.measured(paint, (0.0, *INCIDENCES, 70.0), WAVELENGTHS)
    primary["brdf_u_noise"] = primary["brdf_u"].assign_attrs(correlation="independent")
    primary["brdf_u_path"] = (0.01 * primary["brdf"]).assign_attrs(correlation="common")
    smoothed = smoothing.smooth(primary, about=about)
    side = node_interpolation.Side.of(completion.complete(smoothed), False, slice(None))
    assert side.covariances is not None
    theta_i, _, theta_o, phi = lanes(500, high=89.99)
    theta_o[:50], phi[:50] = theta_i[:50], 180.0
    theta_i[50:70], theta_o[60:80] = INCIDENCES[1], INCIDENCES[2]
    expected = node_errors.path_uncertainties(side, theta_i, theta_o, phi)
    np.testing.assert_allclose(node_errors.side_uncertainties(side, theta_i, theta_o, phi), expected, rtol=1e-8)


@pytest.fixture(scope="module")
def plastic():
    """The BSDF of facets on a diffuse body, which brighten grazing light on the far side of the normal, and its truth."""
    truth = microfacet.build(
        analytic("ggx", a=0.12), index=1.5, spectrum=samples.spectrum(), multiple_scattering="none"
    )

    def brdf(incidence, theta, phi, wavelength):
        theta_o, phi_o = rig_primary.outgoing(incidence, theta, phi)
        return truth.bsdf.evaluate(incidence, 0.0, np.minimum(theta_o, 89.99), phi_o, wavelength).values.T

    primary = rig_primary.measured(brdf, (12.0, 35.0, 55.0, 70.0), [550.0], noise=0.005)
    return completion.complete(smoothing.smooth(primary)), truth


def test_towards_the_horizon_there_is_no_bias(plastic):
    bsdf, truth = plastic
    theta_i, theta_o, phi = (
        angle.ravel()
        for angle in np.meshgrid([12, 23, 35, 45, 55, 62, 70], [80, 82.5, 85, 87, 89], np.arange(0, 181, 15.0))
    )
    value, u, true = (
        quantity(theta_i, 0.0, theta_o, phi, 550.0).values[:, 0]
        for quantity in (bsdf.bsdf.evaluate, bsdf.bsdf.uncertainty, truth.bsdf.evaluate)
    )
    # Functions of cos θ_o alone, for all azimuths, are 11 % too bright on average, and 180 % at most.
    assert abs(np.mean(value / true - 1)) < 0.05
    assert np.abs(value / true - 1).max() < 1
    z = (value - true) / u
    assert 0.5 < np.sqrt(np.mean(z**2)) < 1.3
    assert np.abs(z).max() < 6


@pytest.mark.parametrize("incidence", [12.0, 55.0, 70.0])
@pytest.mark.parametrize("azimuth", [0.0, 90.0, 180.0])
def test_the_uncertainty_does_not_jump_at_the_horizon(plastic, incidence, azimuth):
    theta_o = np.arange(80.0, 89.6, 0.1)
    value, u = (
        quantity(incidence, 0.0, theta_o, azimuth).values[:, 0]
        for quantity in (plastic[0].bsdf.evaluate, plastic[0].bsdf.uncertainty)
    )
    # An error that grows as the logarithm of the cosine grows by 0.1 within a tenth of a degree.
    assert np.abs(np.diff(u / value)).max() < 0.05


def test_both_directions_of_light_are_weighted_by_their_uncertainty_in_that_direction(plastic):
    """A measured incidence keeps its own values where light leaves at an angle that was not measured."""
    bsdf, truth = plastic
    one_way = bsdf.assign_attrs(reciprocity="none")
    theta, phi = rig_primary.dense(35.0, 0.3)
    near = theta < 8
    theta_o, phi_o = rig_primary.outgoing(35.0, theta[near], phi[near])
    true = truth.bsdf.evaluate(35.0, 0.0, theta_o, phi_o, 550.0).values
    errors = [
        np.abs(each.bsdf.evaluate(35.0, 0.0, theta_o, phi_o, 550.0).values / true - 1) for each in (bsdf, one_way)
    ]
    assert np.median(errors[0]) < 1.3 * np.median(errors[1])
    assert np.percentile(errors[0], 95) < 1.3 * np.percentile(errors[1], 95)
    # Beyond the last incidence the reverse direction is better.
    beyond = np.full(60, 80.0), np.zeros(60), *np.meshgrid(np.linspace(10.0, 65.0, 12), np.linspace(0, 180, 5))
    at = beyond[0], beyond[1], beyond[2].ravel(), beyond[3].ravel(), 550.0
    averaged, alone = (
        np.abs(each.bsdf.evaluate(*at).values / truth.bsdf.evaluate(*at).values - 1) for each in (bsdf, one_way)
    )
    assert np.median(averaged) < np.median(alone)


def test_a_value_that_is_far_too_low_is_within_its_uncertainty():
    """The error of a logarithm is that to the larger side, up to the largest value that was measured."""

    def bright(incidence, theta, phi, wavelength):
        # From 60° on the lobe is a thousand times as bright as the trend of smaller incidences lets expect.
        brdf = 0.05 + rig_primary.gaussian(theta, 3) * np.interp(incidence, [30.0, 45.0, 60.0], [5.0, 0.05, 50.0])
        return np.broadcast_to(brdf, (wavelength.size, theta.size))

    primary = rig_primary.measured(bright, (10.0, 30.0, 45.0), [550.0], side="reflection")
    bsdf = completion.complete(smoothing.smooth(primary, about="mirror"))
    value, u = (quantity(60.0, 0.0, 60.0, 180.0).item() for quantity in (bsdf.bsdf.evaluate, bsdf.bsdf.uncertainty))
    assert value < 0.1
    # Limited to ten times the value, the uncertainty was below 1.
    assert u > 2


def at_rig_cells(incidence, brdf, u):
    """Values with noise at the cells of a rig; ``brdf`` and relative ``u`` of ϑ and φ from the mirror direction."""
    cells = cells_of(rig_emulated.plan().rig)
    theta, phi = cells.theta_s, cells.phi_s
    above = cos_view(incidence, theta, phi) > 0.02
    theta, phi = theta[above], phi[above]
    true, size = brdf(theta, phi), u(theta, phi)
    values = true * (1 + size * np.random.default_rng(0).standard_normal(true.size))
    dims = ("incidence", "wavelength", "cell")
    primary = xr.Dataset(
        {"brdf": (dims, values[None, None]), "brdf_u": (dims, (size * true)[None, None])},
        {"incidence": [incidence], "wavelength": [550.0], "theta_s": ("cell", theta), "phi_s": ("cell", phi)},
        {"side": "reflection"},
    )
    return vocabulary.label(primary, "primary")


def rms_of_z(smoothed, brdf, theta, phi):
    """With the components by what cells do not tell, and without."""
    error = smoothing.evaluate(smoothed, theta, phi).values[0, 0] - brdf(theta, phi)
    return [
        np.sqrt(np.mean((error / smoothing.uncertainty(dataset, theta, phi).values[0, 0]) ** 2))
        for dataset in (smoothed, smoothed.drop_dims("component"))
    ]


def test_a_lobe_that_the_cells_do_not_resolve_is_uncertain_between_them():
    def narrow(theta, phi):
        return 0.05 + 3 * rig_primary.gaussian(theta, 5.9) + 300 * rig_primary.gaussian(theta, 0.64)

    primary = at_rig_cells(35.0, narrow, lambda theta, phi: np.full(theta.size, 0.004))
    theta = np.arange(0.0, 8.0, 0.1)
    with_it, without = rms_of_z(smoothing.smooth(primary, about="mirror"), narrow, theta, np.full(theta.size, 90.0))
    assert without > 4
    assert with_it < 0.5 * without


def test_light_that_rises_towards_the_horizon_on_the_far_side_is_uncertain_where_few_cells_see_it():
    truth = accuracy.SAMPLES[accuracy.EDGE]()  # dark at 500 nm

    def facets(theta, phi):
        theta_o, phi_o = rig_primary.outgoing(30.0, theta, phi)
        return truth.bsdf.evaluate(30.0, 0.0, np.minimum(theta_o, 89.9), phi_o, 500.0).values[:, 0]

    # The darker the light on the frame, the larger is the noise.
    primary = at_rig_cells(30.0, facets, lambda theta, phi: 0.01 / cos_view(30.0, theta, phi))
    theta_o = np.arange(80.0, 88.5, 0.5)
    theta, phi = theta_o - 30, np.full(theta_o.size, 180.0)
    with_it, without = rms_of_z(smoothing.smooth(primary), facets, theta, phi)
    assert without > 4
    assert with_it < 0.5 * without
