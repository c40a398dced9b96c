"""A coat on an opaque body: closed forms of smooth faces, energy, an uncoated body, and an independent path tracer."""

from __future__ import annotations

import numpy as np
import pytest
import samples
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from sheet_tracer import CoatTracer, Traced

from brdfpipe import facets, hemisphere, optics, vocabulary
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


@pytest.mark.parametrize(("coat", "base"), [(0.0, 0.0), (0.03, 0.3)])
def test_a_spectrum_without_the_specular_gives_the_same_body(coat, base):
    """The trap takes the mirrored light, and what is scattered within 5° of it."""
    options = {"coat_index": 1.5, "index": 1.6, "internal_transmittance": 0.9}
    given = coated.build(finish(coat), finish(base), spectrum=samples.spectrum(0.4), **options)
    model = representation(given)
    theta, phi, weight = hemisphere.around_mirror(8.0, 0.03, 5.0)
    in_trap = weight @ model.evaluate(np.full_like(theta, 8.0), 0 * phi, theta, phi, None)
    seen = 0.4 - (in_trap + model.specular(np.array([8.0]), np.zeros(1), None)[0][0])
    excluded = samples.spectrum(0.4, geometry="sce")
    excluded["total_reflectance"] = excluded["total_reflectance"] * 0 + seen
    found = coated.build(finish(coat), finish(base), spectrum=vocabulary.label(excluded, "spectrum"), **options)
    # The trap is integrated by another rule.
    assert found["body_weight"].values == pytest.approx(given["body_weight"].values, rel=1e-4)
    assert found["total_reflectance"].values == pytest.approx(0.4, rel=1e-4)
    assert not vocabulary.warnings(found)


@pytest.mark.parametrize("coat", [0.0, 0.002, 0.2])
def test_a_rough_face_between_equal_indices_does_not_show(coat):
    """Nor does it stop the model, which balanced the light that such a face reflects: none."""
    options = {"coat_index": 1.5, "index": 1.5, "spectrum": samples.spectrum(0.4)}
    with_face, without = coated.build(finish(coat), finish(0.1), **options), coated.build(finish(coat), **options)
    at = np.array([10.0, 45.0]), 0.0, np.array([30.0, 45.0]), np.array([180.0, 170.0])
    assert with_face.bsdf.evaluate(*at).values == pytest.approx(without.bsdf.evaluate(*at).values, rel=2e-3)


def test_a_thin_coat_warns_of_interference():
    thin = coated.build(finish(0), coat_index=1.5, index=1.6, thickness=0.002, wavelength=[550.0])
    assert "2 µm thick: below 10 µm the light of both faces interferes" in vocabulary.warnings(thin)[0]


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
    ],
)
def test_impossible_coats_are_refused(options, words):
    with pytest.raises(ModelError, match=words):
        coated.build(finish(0), **{"coat_index": 1.5, "index": 1.6, "spectrum": samples.spectrum(0.3), **options})


@pytest.mark.slow
@pytest.mark.parametrize(
    ("coat", "base", "coat_index", "index", "inside", "reflectance"),
    [
        (0.3, 0.0, 1.5, 1.8, 0.9, 0.6),
        (0.0, 0.3, 1.4, 1.9, 0.9, 0.6),
        (0.3, 0.3, 1.5, 2.2, 1.0, 0.3),
        (0.2, 0.0, 1.5, 1.5, 0.7, 0.9),
    ],
)
def test_photons_traced_one_by_one_leave_as_the_operators_say(coat, base, coat_index, index, inside, reflectance):
    """The body is given by the total reflectance at 8° that the photons have; all else follows."""
    photons, theta_i = 500_000, 50.0
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
    lit = np.array([theta_i])
    traced = Traced(travel, weight, who, photons)
    mean, error = traced.share(np.ones(weight.size, dtype=bool))
    # The total at 8° has as large an error.
    assert albedo(bsdf, lit)[0, 0] == pytest.approx(mean, abs=5 * error + 0.005 * mean)
    for sector, predicted, mean, error in traced.beside(bsdf, theta_i):
        assert predicted == pytest.approx(mean, abs=3 * error + 0.01 * mean), sector
