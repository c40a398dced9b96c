"""Samples follow their pdf, and their weights add up to the light."""

from __future__ import annotations

import numpy as np
import pytest
import samples
import synthetic
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from brdfpipe import facets, vocabulary
from brdfpipe.bsdf import lambert_gauss, microfacet, sphere_cubature
from brdfpipe.bsdf.registry import representation
from brdfpipe.errors import VocabularyError

N = 20_000
GLOSS = dict.fromkeys(["index"], 1.55)


def table():
    grid = {"theta_i": np.arange(0, 81, 10.0), "theta_o": np.arange(0, 90, 4.0), "phi_o": np.arange(0, 361, 10.0)}
    return samples.beckmann_bsdf(0.2).bsdf.nonspectral().bsdf.tabulate(grid)


CASES = {
    "rough": (lambda: microfacet.build(facets.analytic("beckmann", 0.4), **GLOSS), 30.0, 20.0),
    "narrow": (lambda: microfacet.build(facets.analytic("beckmann", 0.01), **GLOSS), 45.0, 0.0),
    "normal": (lambda: microfacet.build(facets.analytic("beckmann", 0.01), **GLOSS), 0.0, 0.0),
    "grazing": (lambda: microfacet.build(facets.analytic("ggx", 0.1), **GLOSS), 88.0, -50.0),
    "over a base": (lambda: samples.beckmann_bsdf(0.05).bsdf.nonspectral(), 60.0, 0.0),
    "with a lay": (lambda: samples.brushed_bsdf(0.05, 0.3), 50.0, 40.0),
    "interface": (lambda: microfacet.build(facets.analytic("beckmann", 0.1), index=1.5, transparent=True), 40.0, 0.0),
    "from within": (
        lambda: microfacet.build(facets.analytic("beckmann", 0.1), index=1.5, transparent=True),
        155.0,
        0.0,
    ),
    "table": (table, 35.0, 10.0),
    "Lambert": (lambda: lambert_gauss.lambertian(samples.spectrum(0.5)).bsdf.nonspectral(), 70.0, 0.0),
}


@pytest.fixture(scope="module", params=CASES)
def case(request):
    make, theta_i, phi_i = CASES[request.param]
    return make(), theta_i, phi_i


def bins_about(bsdf, theta_i, phi_i):
    """Edges of bins of about equal counts, from other samples than those tested."""
    pilot = bsdf.bsdf.sample(4000, 999, theta_i, phi_i)
    relative = (pilot["phi_o"].values - phi_i) % 360
    theta = np.quantile(pilot["theta_o"].values, np.linspace(0, 1, 13)[1:-1])
    phi = np.quantile(relative, np.linspace(0, 1, 9)[1:-1])
    highest = 180.0 if representation(bsdf).transmits else 90.0
    lowest = 0.0
    return np.concatenate([[lowest], theta, [highest]]), np.concatenate([[0.0], phi, [360.0]])


def expected_counts(bsdf, theta_i, phi_i, theta, phi):
    """N ∫ pdf dω of every bin: the density is constant over cells, so their overlaps with the bins give it exactly."""
    density = representation(bsdf).distribution(theta_i, phi_i, None)
    low, high = density.mesh.low[density.leaves], density.mesh.high[density.leaves]
    middle = (low + high) / 2
    # `pdf` finds the cells by itself.
    value = density.pdf(middle[:, 0], middle[:, 1])
    cosine, edges = np.cos(np.radians(theta)), np.cos(np.radians(np.stack([low[:, 0], high[:, 0]])))
    along = np.maximum(np.minimum(cosine[:-1, None], edges[0]) - np.maximum(cosine[1:, None], edges[1]), 0)
    around = np.zeros((phi.size - 1, low.shape[0]))
    for turn in (-360, 0, 360):
        first, last = low[:, 1] - phi_i + turn, high[:, 1] - phi_i + turn
        around += np.maximum(np.minimum(phi[1:, None], last) - np.maximum(phi[:-1, None], first), 0)
    return N * np.einsum("tc,pc,c->tp", along, np.radians(around), value)


@pytest.mark.cases(9)
def test_samples_follow_their_pdf(case):
    bsdf, theta_i, phi_i = case
    theta, phi = bins_about(bsdf, theta_i, phi_i)
    expected = expected_counts(bsdf, theta_i, phi_i, theta, phi)
    assert expected.sum() == pytest.approx(N, rel=1e-9)
    values = []
    for seed in (1, 2, 3):
        drawn = bsdf.bsdf.sample(N, seed, theta_i, phi_i)
        azimuth = (drawn["phi_o"].values - phi_i) % 360
        counts, _, _ = np.histogram2d(drawn["theta_o"].values, azimuth, bins=(theta, phi))
        enough = expected > 5
        observed = np.append(counts[enough], counts[~enough].sum())
        wanted = np.append(expected[enough], expected[~enough].sum())
        observed, wanted = observed[wanted > 0], wanted[wanted > 0]
        values.append(stats.chisquare(observed, wanted * observed.sum() / wanted.sum()).pvalue)
    # Of three seeds the worst at 1e-3 has a chance of 3e-3 to fail; these seeds do not.
    assert min(values) > 1e-3


def test_the_mean_weight_is_the_share_of_the_light_that_leaves(case):
    bsdf, theta_i, phi_i = case
    drawn = bsdf.bsdf.sample(N, 7, theta_i, phi_i)
    leaves = float(bsdf.bsdf.albedo(theta_i, phi_i) + bsdf.bsdf.transmittance(theta_i, phi_i))
    deviation = np.sqrt(float(drawn["weight_variance"]) / N)
    assert abs(float(drawn["weight"].mean()) - leaves) < 4 * deviation
    assert float(drawn["weight_variance"]) == pytest.approx(drawn["weight"].values.var(ddof=1))
    # Importance sampling: the weights scatter by less than a half of their mean.
    assert np.sqrt(float(drawn["weight_variance"])) < 0.5 * leaves


def test_the_light_in_any_part_of_the_sphere_is_that_of_the_bsdf(case):
    # Independent of the pdf: sums of weights over a half of the sphere against the model integrated there.
    bsdf, theta_i, phi_i = case
    drawn = bsdf.bsdf.sample(N, 8, theta_i, phi_i)
    same_side = (drawn["theta_o"].values > 90) == (theta_i > 90)
    part = drawn["weight"].values * same_side
    reflected = float(bsdf.bsdf.albedo(theta_i, phi_i))
    assert abs(part.mean() - reflected) < 4 * part.std() / np.sqrt(N) + 1e-3 * (theta_i > 90)


def test_the_pdf_of_a_sample_is_the_pdf_at_its_direction(case):
    bsdf, theta_i, phi_i = case
    drawn = bsdf.bsdf.sample(500, 3, theta_i, phi_i)
    density = bsdf.bsdf.pdf(theta_i, phi_i, drawn["theta_o"].values, drawn["phi_o"].values)
    assert density.values == pytest.approx(drawn["pdf"].values, rel=1e-12)


def test_the_pdf_is_positive_wherever_there_is_light(case):
    bsdf, theta_i, phi_i = case
    rng = np.random.default_rng(5)
    theta_o, phi_o = np.degrees(np.arccos(rng.uniform(-1, 1, 2000))), rng.uniform(0, 360, 2000)
    light = bsdf.bsdf.evaluate(theta_i, phi_i, theta_o, phi_o).values > 0
    assert (bsdf.bsdf.pdf(theta_i, phi_i, theta_o, phi_o).values[light] > 0).all()


def test_the_same_seed_gives_the_same_samples_and_another_one_others():
    bsdf = samples.beckmann_bsdf(0.1, reflectance=None)
    first, again, other = (bsdf.bsdf.sample(100, seed, 30.0) for seed in (1, 1, 2))
    assert first.identical(again)
    assert not first.equals(other)
    vocabulary.validate(first, "samples")


@given(theta_i=st.floats(0, 89.99), a=st.floats(1e-3, 3), n=st.floats(1.01, 3))
@settings(max_examples=20, deadline=None)
def test_every_sample_is_above_the_surface_with_a_finite_weight(theta_i, a, n):
    with samples.coarse_albedo_tables():
        bsdf = microfacet.build(facets.analytic("beckmann", a), index=n, multiple_scattering="none")
    drawn = bsdf.bsdf.sample(200, 1, theta_i)
    assert (drawn["theta_o"].values < 90).all()
    assert np.isfinite(drawn["weight"].values).all()
    assert (drawn["pdf"].values > 0).all()


def test_weights_are_spectral_where_the_bsdf_is():
    bsdf = samples.beckmann_bsdf(0.1, reflectance=np.linspace(0.1, 0.6, samples.WAVELENGTH.size))
    drawn = bsdf.bsdf.sample(2000, 1, 30.0, wavelength=[450, 650])
    assert drawn["weight"].dims == ("sample", "wavelength")
    reflectance, wanted = drawn["weight"].mean("sample").values, bsdf.bsdf.albedo(30.0, wavelength=[450, 650]).values
    assert reflectance == pytest.approx(wanted, rel=0.06)


@pytest.mark.parametrize("theta_i", [0.0, 40.0, 120.0, 160.0])
def test_a_smooth_interface_sends_rays_in_two_directions(theta_i):
    bsdf = microfacet.build(facets.flat(), index=1.5, transparent=True)
    drawn = bsdf.bsdf.sample(2000, 1, theta_i, 10.0)
    assert drawn["specular"].values.all()
    assert np.isnan(drawn["pdf"].values).all()
    assert drawn["phi_o"].values == pytest.approx(190.0)
    # R + T = 1, and each ray carries an equal share.
    assert drawn["weight"].values == pytest.approx(1.0, rel=1e-9)
    mirrored = np.isclose(drawn["theta_o"].values, theta_i)
    reflectance = float(bsdf.bsdf.albedo(theta_i))
    assert mirrored.mean() == pytest.approx(reflectance, abs=4 * np.sqrt(0.25 / 2000) * (reflectance < 1))


def test_a_smooth_surface_over_a_base_mixes_rays_and_scatter():
    bsdf = microfacet.build(facets.flat(), index=1.5, spectrum=samples.spectrum(0.3)).bsdf.nonspectral()
    drawn = bsdf.bsdf.sample(N, 1, 50.0)
    specular = drawn["specular"].values
    assert drawn["theta_o"].values[specular] == pytest.approx(50.0)
    mirror = float(bsdf.bsdf.specular(50.0)[0])
    scatter = np.sqrt((drawn["weight"].values * specular).var() / N)
    assert (drawn["weight"].values * specular).mean() == pytest.approx(mirror, abs=4 * scatter)


def test_black_is_sampled_uniformly_with_zero_weight():
    bsdf = lambert_gauss.lambertian(samples.spectrum(0.0)).bsdf.nonspectral()
    drawn = bsdf.bsdf.sample(100, 1, 30.0)
    assert (drawn["weight"].values == 0).all()
    assert drawn["pdf"].values == pytest.approx(1 / (2 * np.pi), rel=1e-9)


def test_a_lobe_away_from_the_mirror_direction_is_sampled_too(monkeypatch):
    bsdf = synthetic.register(monkeypatch, synthetic.cap_lobe(20.0, 100.0, 1000.0))
    drawn = bsdf.bsdf.sample(5000, 1, 60.0)
    assert float(drawn["weight"].mean()) == pytest.approx(1.0, abs=4 * np.sqrt(float(drawn["weight_variance"]) / 5000))
    assert float(drawn["weight_variance"]) < 0.3


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0, 1, 30.0), "integer >= 1"),
        ((10.5, 1, 30.0), "integer >= 1"),
        ((True, 1, 30.0), "integer >= 1"),
        ((10, 1, 120.0), "theta_i spans 120"),
        ((10, 1, [30.0, 40.0]), "one incidence at a time"),
    ],
)
def test_unusable_arguments_are_refused(arguments, message):
    with pytest.raises(VocabularyError, match=message):
        samples.beckmann_bsdf(0.1, reflectance=None).bsdf.sample(*arguments)


def test_cells_cover_the_hemisphere_once():
    low, high = sphere_cubature.rectangles(
        sphere_cubature.theta_edges(np.array([45.0]), False), sphere_cubature.phi_edges(225.0)
    )
    assert sphere_cubature.solid_angle(low, high).sum() == pytest.approx(2 * np.pi, rel=1e-12)
    assert sphere_cubature.solid_angle(low, high).min() > 0
