"""A coat on an opaque body: closed forms of smooth faces, energy, an uncoated body, and an independent path tracer."""

from __future__ import annotations

import numpy as np
import pytest
import samples
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from sheet_tracer import CoatTracer

from brdfpipe import facets, optics, vocabulary
from brdfpipe.bsdf import microfacet
from brdfpipe.bsdf.microfacet.microsurface import ModelError
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.slab import coated
from brdfpipe.hemisphere import panel_rule

THETA = np.array([0.0, 8.0, 30.0, 60.0, 80.0, 89.0])


def finish(a):
    return facets.flat() if a == 0 else facets.analytic("beckmann", a)


def metal(wavelength, n, k):
    data = {"n": ("wavelength", np.asarray(n, float)), "k": ("wavelength", np.asarray(k, float))}
    return vocabulary.label(
        xr.Dataset(data, {"wavelength": wavelength}, {"source": "test", "dispersion": "table"}), "index"
    )


def albedo(bsdf, theta=THETA):
    return representation(bsdf).albedo(theta, np.zeros_like(theta), None)


def specular(bsdf, theta=THETA):
    return representation(bsdf).specular(theta, np.zeros_like(theta), None)[0]


def inner_cosine(theta, index):
    return np.sqrt(1 - (np.sin(np.radians(theta)) / index) ** 2)


@pytest.mark.parametrize(("n", "k"), [(1.5, 0.0), (1.8, 0.0), (1.2, 0.0), (0.9, 4.0)])
@pytest.mark.parametrize("inside", [1.0, 0.7, 0.0])
def test_smooth_faces_reflect_as_the_incoherent_sum_of_s_and_p(n, k, inside):
    base = metal([400.0, 700.0], [n, n], [k, k])
    bsdf = coated.build(finish(0), coat_index=1.5, index=base, internal_transmittance=inside, wavelength=[500.0])
    cosine = inner_cosine(THETA, 1.5)
    outer, lower = optics.fresnel(np.cos(np.radians(THETA)), 1.5), optics.fresnel(cosine, n / 1.5, k / 1.5)
    expected = np.zeros_like(THETA)
    for f, g in zip(outer[:2], lower[:2], strict=True):
        passed = inside ** (2 / cosine) * g
        expected += (f + (1 - f) ** 2 * passed / (1 - f * passed)) / 2
    assert specular(bsdf)[:, 0] == pytest.approx(expected, abs=1e-9)
    assert albedo(bsdf)[:, 0] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(("reflectance", "inside"), [(0.9, 1.0), (0.5, 0.8), (0.05, 1.0)])
def test_a_lambertian_body_below_a_smooth_coat_looks_as_saunderson_says(reflectance, inside):
    """Of equal indices; the coat absorbs along each path, which the exponential integral over the directions sums."""
    theta, weight = panel_rule(np.linspace(0, np.pi / 2, 65), 8)
    share = weight * np.sin(2 * theta)
    back = optics.fresnel(np.cos(theta), 1 / 1.5).mean
    internal = share @ (back * inside ** (2 / np.cos(theta)))
    escaping = share @ ((1 - back) * inside ** (1 / np.cos(theta)))
    f = optics.fresnel(np.cos(np.radians(THETA)), 1.5).mean
    entering = (1 - f) * inside ** (1 / inner_cosine(THETA, 1.5))
    total = f + entering * reflectance * escaping / (1 - reflectance * internal)
    given_at = samples.spectrum(np.interp(8.0, THETA, total))
    bsdf = coated.build(finish(0), coat_index=1.5, index=1.5, internal_transmittance=inside, spectrum=given_at)
    assert albedo(bsdf)[:-1, 0] == pytest.approx(total[:-1], rel=2e-5)
    assert not vocabulary.warnings(bsdf)


COATS = [(0.0, 0.0, 1.5, 1.8), (0.1, 0.0, 1.5, 1.5), (0.3, 0.3, 1.5, 1.7), (0.05, 0.5, 1.4, 2.2)]


@pytest.mark.cases(2)
@pytest.mark.parametrize(("coat", "base", "coat_index", "index"), COATS)
def test_a_body_that_absorbs_nothing_returns_all_light(coat, base, coat_index, index):
    white = samples.spectrum(1.0)
    bsdf = coated.build(finish(coat), finish(base), coat_index=coat_index, index=index, spectrum=white)
    assert albedo(bsdf) == pytest.approx(1.0, abs=2e-4)
    at = np.array([30.0]), np.zeros(1), np.array([550.0])
    lobes = representation(bsdf).integrate(*at, relative=1e-4).value + representation(bsdf).specular(*at)[0]
    assert lobes == pytest.approx(1.0, abs=1e-3)


def test_without_another_index_below_it_is_the_uncoated_body():
    """The models share the facets alone: the light from below is summed by operators here, and a product of two albedos there."""
    finish_of_both, spectrum = finish(0.05), samples.spectrum(0.4)
    bsdf = coated.build(finish_of_both, coat_index=1.5, index=1.5, spectrum=spectrum)
    uncoated = microfacet.build(finish_of_both, index=1.5, spectrum=spectrum)
    at = (
        np.repeat([10.0, 45.0, 60.0], 4),
        0.0,
        np.tile([0.0, 20.0, 45.0, 60.0], 3),
        np.tile([180.0, 170.0, 90.0, 0.0], 3),
    )
    assert bsdf.bsdf.evaluate(*at).values == pytest.approx(uncoated.bsdf.evaluate(*at).values, rel=2e-3)


@given(
    coat=st.sampled_from([0.0, 0.2]),
    base=st.sampled_from([0.0, 0.3]),
    index=st.floats(1.05, 2.5),
    inside=st.floats(0.0, 1.0),
    reflectance=st.floats(0.0, 1.0),
)
@settings(deadline=None, max_examples=6)
def test_any_coat_is_reciprocal_positive_and_conserves_energy(coat, base, index, inside, reflectance):
    bsdf = coated.build(
        finish(coat),
        finish(base),
        coat_index=1.5,
        index=index,
        internal_transmittance=inside,
        spectrum=samples.spectrum(reflectance),
    )
    there, back = np.array([0.0, 20.0, 50.0, 89.9]), np.array([70.0, 20.0, 89.0, 0.0])
    forward = bsdf.bsdf.evaluate(there, 0.0, back, [180.0, 180.0, 40.0, 0.0]).values
    assert (forward >= 0).all()
    assert forward == pytest.approx(bsdf.bsdf.evaluate(back, [180.0, 180.0, 40.0, 0.0], there, 0.0).values, rel=1e-12)
    assert (albedo(bsdf) <= 1 + 1e-9).all()
    assert bsdf.bsdf.evaluate(30.0, 0.0, [90.0, 120.0], 0.0).values == pytest.approx(0.0)


def test_a_total_reflectance_that_no_body_gives_is_the_nearest_possible_with_a_warning():
    for reflectance, expected in ((0.01, 0.04), (0.99, None)):
        bsdf = coated.build(
            finish(0), coat_index=1.5, index=1.5, internal_transmittance=0.9, spectrum=samples.spectrum(reflectance)
        )
        assert "the nearest of these" in vocabulary.warnings(bsdf)[0]
        assert (bsdf["diffuse_quality"].values == vocabulary.quality("clamped")).all()
        if expected:
            assert albedo(bsdf)[1] == pytest.approx(expected, abs=1e-3)
        else:
            assert (albedo(bsdf)[1] < 0.97).all()


def test_the_mean_over_wavelength_is_the_mean_of_the_model():
    wavelength = np.linspace(400.0, 700.0, 7)
    index = metal(wavelength, np.linspace(1.54, 1.52, 7), np.zeros(7))
    silver = metal(wavelength, np.linspace(0.5, 1.5, 7), np.linspace(4, 7, 7))
    bsdf = coated.build(finish(0.1), finish(0.2), coat_index=index, index=silver)
    mean = nonspectral(bsdf)
    at = np.array([30.0, 30.0, 60.0]), 0.0, np.array([30.0, 50.0, 20.0]), np.array([180.0, 170.0, 150.0])
    values = bsdf.bsdf.evaluate(*at).values
    low, high = values.min(axis=1), values.max(axis=1)
    found = mean.bsdf.evaluate(*at).values
    assert ((found >= 0.999 * low) & (found <= 1.001 * high)).all()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"masking": "liu"}, "Smith's maskings"),
        ({"coat_index": metal([400.0, 700.0], [1.5, 1.5], [0.1, 0.1])}, "coat absorbs"),
        ({"index": metal([400.0, 700.0], [1.0, 1.0], [5.0, 5.0])}, "below the face of a metal"),
        ({"internal_transmittance": 1.5}, "accepted: 0 to 1"),
        ({"spectrum": samples.spectrum(0.3, geometry="sce")}, "accepted: sci"),
    ],
)
def test_impossible_coats_are_refused(options, words):
    with pytest.raises(ModelError, match=words):
        coated.build(finish(0), **{"coat_index": 1.5, "index": 1.6, "spectrum": samples.spectrum(0.3), **options})


BINS = [(0, 20), (20, 45), (45, 70), (70, 90)]


def share_in(bsdf, theta_i, low, high, forward):
    """∫ f cos θ_o dω_o over polar angles and the half of the azimuths towards, or away from, the mirror direction."""
    theta, d_theta = panel_rule(np.linspace(low, high, 13), 6)
    phi, d_phi = panel_rule(np.linspace(90, 180, 13) if forward else np.linspace(0, 90, 7), 6)
    values = representation(bsdf).evaluate(theta_i, 0.0, theta[:, None], phi, None)[..., 0]
    return 2 * float((np.radians(d_theta) * np.sin(2 * np.radians(theta)) / 2) @ values @ np.radians(d_phi))


@pytest.mark.cases(1)
@pytest.mark.parametrize(
    ("coat", "base", "coat_index", "index", "inside", "reflectance"),
    [
        (0.3, 0.0, 1.5, 1.8, 0.9, 0.6),
        pytest.param(0.0, 0.3, 1.4, 1.9, 0.9, 0.6, marks=pytest.mark.slow),
        pytest.param(0.3, 0.3, 1.5, 2.2, 1.0, 0.3, marks=pytest.mark.slow),
        pytest.param(0.2, 0.0, 1.5, 1.5, 0.7, 0.9, marks=pytest.mark.slow),
    ],
)
def test_photons_traced_one_by_one_leave_as_the_operators_say(coat, base, coat_index, index, inside, reflectance):
    """The body is given by the total reflectance at 8° that the photons have; all else follows."""
    photons, theta_i = 200_000, 50.0
    tracer = CoatTracer(coat, base, coat_index, index, inside, reflectance, seed=3)
    _, at_8, _ = tracer.trace(8.0, photons)
    travel, weight, who = tracer.trace(theta_i, photons)
    bsdf = coated.build(
        finish(coat),
        finish(base),
        coat_index=coat_index,
        index=index,
        internal_transmittance=inside,
        spectrum=samples.spectrum(at_8.sum() / photons),
    )
    theta_o, forward = np.degrees(np.arccos(np.clip(travel[:, 2], -1, 1))), travel[:, 0] < 0

    def traced(where):
        by_photon = np.bincount(who, np.where(where, weight, 0.0), photons)
        return by_photon.mean(), by_photon.std() / np.sqrt(photons)

    mean, error = traced(np.ones(weight.size, dtype=bool))
    # The total at 8° has as large an error.
    assert albedo(bsdf, np.array([theta_i]))[0, 0] == pytest.approx(mean, abs=6 * error + 1e-3)
    mirrored = specular(bsdf, np.array([theta_i]))[0, 0]
    for low, high in BINS:
        for ahead in (True, False):
            mean, error = traced((theta_o >= low) & (theta_o < high) & (forward == ahead))
            wanted = share_in(bsdf, theta_i, low, high, ahead) + (mirrored if ahead and low <= theta_i < high else 0.0)
            assert wanted == pytest.approx(mean, abs=5 * error + 0.01 * mean + 2e-4), (low, high, ahead)
