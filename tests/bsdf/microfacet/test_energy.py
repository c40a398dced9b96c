"""Directional albedos: printed values, the furnace, tables that never lie below the integral."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import samples
from hypothesis import given, settings
from hypothesis import strategies as st

from brdfpipe import facets, hemisphere, vocabulary
from brdfpipe.bsdf import microfacet
from brdfpipe.bsdf.microfacet import energy
from brdfpipe.bsdf.microfacet.albedo_table import AlbedoTable
from brdfpipe.bsdf.microfacet.microsurface import Microsurface
from brdfpipe.bsdf.registry import representation
from brdfpipe.geometry import Array
from brdfpipe.masking.visibility import VisibilityRatio

ONE, NONE = np.ones(1), np.zeros(1)


def mirrors(surface: Microsurface, theta, masking: str = "height-correlated") -> Array:
    theta = np.atleast_1d(np.asarray(theta, dtype=float))
    return energy.mirror_albedo(surface, masking, theta)


def gaussian(sigma: float) -> Microsurface:
    return Microsurface.of(facets.analytic("beckmann", sigma * np.sqrt(2)))


@pytest.mark.parametrize(("sigma", "printed"), [(0.1, 1.0278), (0.3, 1.8088), (0.5, 2.6246)])
def test_the_patents_masking_reflects_more_than_it_receives_at_85_degrees_as_printed(sigma, printed):
    assert mirrors(gaussian(sigma), 85, "crf")[0] == pytest.approx(printed, abs=5e-5)


@pytest.mark.parametrize("masking", ["height-correlated", "separable", "blinn"])
@pytest.mark.parametrize("a", [1e-3, 0.3, 2.0])
def test_other_maskings_of_perfect_mirrors_keep_energy(a, masking):
    # V-grooves have a kink where one wall begins to hide the other: within a degree of grazing it costs the integral 1e-3.
    theta = np.array([0, 30, 60, 80, 85] if masking == "blinn" else [0, 30, 60, 80, 85, 89, 89.9, 89.99])
    assert mirrors(Microsurface.of(facets.analytic("beckmann", a)), theta, masking).max() <= 1 + 1e-9


@given(a=st.floats(1e-3, 5), n=st.floats(1.0001, 4), k=st.sampled_from([0.0, 0.5, 7.0, 100.0]))
@settings(max_examples=8, deadline=None)
def test_the_table_is_an_upper_bound_of_the_integral(a, n, k):
    surface = Microsurface.of(facets.analytic("beckmann", a))

    def albedo(theta, phi):
        return energy.directional_albedo(surface, "height-correlated", n * ONE, k * ONE, theta, phi)

    table = energy.tabulated(surface, albedo, np.array([8.0]))
    theta = np.concatenate([np.linspace(0, 90, 91), 90 - np.geomspace(1e-4, 10, 60)])
    excess = table(theta) - albedo(theta, 0 * theta)
    # The integral itself has a noise of a few 1e-9 where its panels open and close.
    assert excess.min() >= -1e-8
    assert excess.max() <= 1e-6


@pytest.mark.parametrize("a", [0.05, pytest.param(0.3, marks=pytest.mark.slow)])
def test_the_table_with_traced_visibility_is_an_upper_bound_but_for_the_noise_of_its_integral(a):
    ratio = 0.8 + 0.2 * np.random.default_rng(4).random((17, 12, 6))
    ratio = VisibilityRatio.of(samples.visibility_table(ratio))
    surface = replace(Microsurface.of(facets.analytic("beckmann", a)), ratio=ratio)

    def albedo(theta, phi):
        return energy.directional_albedo(surface, "measured", 1.5 * ONE, NONE, theta, phi)

    table = energy.tabulated(surface, albedo, np.array([8.0]))
    theta = np.concatenate([np.linspace(0, 90, 91), 90 - np.geomspace(1e-4, 10, 60)])
    excess = table(theta) - albedo(theta, 0 * theta)
    # The ratio is linear between its nodes: at its kinks the integral has a noise of 1e-5.
    assert excess.min() >= -1e-5
    assert excess.max() <= 1e-4


def test_dispersion_needs_few_nodes_and_is_exact_to_a_billionth():
    surface, n = gaussian(0.2), np.linspace(1.48, 1.56, 40)
    together = energy.directional_albedo(surface, "height-correlated", n, 0 * n, np.array([8.0, 70.0]))
    alone = [
        energy.directional_albedo(surface, "height-correlated", one_index * ONE, NONE, np.array([8.0, 70.0]))
        for one_index in n
    ]
    assert together == pytest.approx(np.concatenate(alone, axis=1), abs=1e-9)


@pytest.mark.cases(2)
@pytest.mark.parametrize(("theta", "phi"), [(0.0, 0.0), (45.0, 10.0), (70.0, 100.0), (85.0, 60.0)])
def test_the_albedo_of_a_lay_is_that_of_its_brdf_over_the_hemisphere(theta, phi):
    surface = facets.analytic("beckmann", a_x=0.1, a_y=0.3, azimuth=30)
    bsdf = microfacet.build(surface, index=1.5, multiple_scattering="none")
    rule = hemisphere.around_mirror(theta, 0.3, turns=96)
    # The rule covers one side of the plane of incidence; a lay sees both differently.
    sides = [rule.weight @ bsdf.bsdf.evaluate(theta, phi, rule.theta, phi + side * rule.phi).values for side in (1, -1)]
    # The rule over the hemisphere is good to parts in 10⁵.
    assert np.mean(sides) == pytest.approx(float(bsdf.bsdf.albedo(theta, phi)), abs=3e-5)


@pytest.mark.parametrize("azimuth", [0.0, 30.0])
def test_equal_widths_have_the_albedo_of_the_isotropic_surface(azimuth):
    surfaces = (
        facets.analytic("beckmann", 0.2),
        facets.analytic("beckmann", a_x=0.2, a_y=0.2, azimuth=azimuth),
    )
    round_, lay = (microfacet.build(surface, index=1.5, multiple_scattering="none") for surface in surfaces)
    theta = np.array([0.0, 30.0, 60.0, 80.0, 89.0])
    assert lay.bsdf.albedo(theta, 77.0).values == pytest.approx(round_.bsdf.albedo(theta).values, abs=1e-5)
    assert float(lay.mean_albedo) == pytest.approx(float(round_.mean_albedo), abs=5e-5)


LAYS = [("ggx", {"a_x": 0.3, "a_y": 0.3}), ("beckmann", {"a_x": 0.01, "a_y": 0.5, "azimuth": 20.0})]


def net() -> tuple[Array, Array]:
    theta = np.array([0.0, 8.0, 21.0, 45.0, 63.0, 78.0, 85.0, 88.0, 89.3, 89.9, 89.99])
    phi = np.concatenate([np.arange(0.0, 360.0, 35.0), [20.5, 109.0, 110.0]])
    polar, around = np.meshgrid(theta, phi)
    return polar.ravel(), around.ravel()


@pytest.mark.cases(1)
@pytest.mark.parametrize(("distribution", "widths"), LAYS)
def test_a_white_surface_with_a_lay_reflects_all_light_and_no_more(distribution, widths):
    white = samples.spectrum(1.0).isel(wavelength=[0, -1])
    bsdf = microfacet.build(
        facets.analytic(distribution, **widths), index=1.5, spectrum=vocabulary.label(white, "spectrum")
    )
    theta, phi = net()
    total = bsdf.bsdf.albedo(theta, phi, 550.0).values[..., 0]
    assert total.max() <= 1 + 1e-6
    # The base is kept back by what the table may err by: parts in 10⁵ but within a degree of grazing.
    assert total[theta <= 85].min() >= 1 - 1e-4


@pytest.mark.cases(1)
@pytest.mark.parametrize(("distribution", "widths"), LAYS)
def test_compensated_perfect_mirrors_with_a_lay_reflect_everything(distribution, widths):
    surface = facets.analytic(distribution, **widths)
    bsdf = microfacet.build(surface, index=1.5, multiple_scattering="compensated").assign(
        n=np.inf, k=0.0, compensation=1.0
    )
    theta, phi = net()
    total = bsdf.bsdf.albedo(theta, phi).values
    assert total.max() <= 1 + 1e-6
    assert total[theta <= 85].min() >= 1 - 3e-4


def test_the_inner_albedo_of_a_lay_near_total_reflection_is_the_integral_of_its_brdf():
    bsdf = microfacet.build(facets.analytic("beckmann", a_x=0.08, a_y=0.5, azimuth=25.0), index=1.5, transparent=True)
    at = np.array([135.0]), np.array([115.0])
    reflected = representation(bsdf).integrate(*at, None, relative=1e-4).value
    assert representation(bsdf).albedo(*at, None) == pytest.approx(reflected, abs=1e-4)


@pytest.mark.cases(3)
@pytest.mark.parametrize("a", [0.1, 0.5, 2.0])
@pytest.mark.parametrize("distribution", facets.DISTRIBUTIONS)
def test_compensated_perfect_mirrors_reflect_everything(distribution, a):
    # n so large that F = 1: the furnace.
    bsdf = microfacet.build(facets.analytic(distribution, a), index=1.5, multiple_scattering="compensated").assign(
        n=np.inf, k=0.0, compensation=1.0
    )
    theta = np.array([0, 20, 45, 60, 75, 85, 89])
    # The table of perfect mirrors is raised by its error, and only that is missing.
    assert bsdf.bsdf.albedo(theta).values == pytest.approx(1.0, abs=1e-7 if distribution == "beckmann" else 2e-5)
    rule = hemisphere.around_mirror(60.0, a, order=8, turns=48)
    integral = rule.weight @ bsdf.bsdf.evaluate(60.0, 0.0, rule.theta, rule.phi).values
    assert integral == pytest.approx(1.0, abs=1e-4)


def test_compensation_adds_to_the_plain_model_and_nothing_to_a_smooth_one():
    for a, gained in ((1e-3, False), (1.0, True)):
        table = facets.analytic("beckmann", a)
        plain, more = (
            microfacet.build(table, index=1.5, multiple_scattering=mode).bsdf.albedo(45.0)
            for mode in ("none", "compensated")
        )
        assert (float(more - plain) > 1e-4) is gained
        assert float(more) >= float(plain) - 1e-12


@pytest.mark.parametrize("masking", ["height-correlated", "separable", "measured"])
@pytest.mark.parametrize(
    ("n", "k"),
    [
        (np.array([1.5]), np.zeros(1)),
        (np.linspace(1.45, 1.55, 20), np.zeros(20)),
        (np.array([0.4]), ONE),
        (np.linspace(0.3, 1.4, 6), np.linspace(2.0, 6.0, 6)),
        (np.linspace(1.0, 1.0 + 1e-6, 6), np.zeros(6)),
    ],
)
def test_compiled_code_gives_the_albedo_of_numpy(masking, n, k, monkeypatch):
    surface = gaussian(0.3)
    random = np.random.default_rng(2)
    ratio = VisibilityRatio(
        np.log(random.uniform(0.7, 1.4, (9, 8, 7))), (0.96, 2.0), np.array([0.0, 0.5, 1.0]), random.random(3)
    )
    surface = replace(surface, ratio=ratio)
    theta = np.concatenate([np.linspace(0.0, 89.0, 15), [89.99, 90.0]])
    monkeypatch.setattr(energy, "_MANY_FACETS", 1)
    found = energy.directional_albedo(surface, masking, n, k, theta, mirrors=True)
    monkeypatch.setattr(energy, "_MANY_FACETS", 10**9)
    # Numpy interpolates between many indices, but not a single one.
    each = [
        energy.directional_albedo(surface, masking, *one, theta, mirrors=True)
        for one in zip(n[:, None], k[:, None], strict=True)
    ]
    expected = np.concatenate([*(columns[:, :1] for columns in each), each[0][:, 1:]], axis=1)
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-15)


def test_the_mean_albedo_is_twice_the_integral_over_the_cosine():
    theta = np.linspace(0, 90, 91)
    table = AlbedoTable(theta, np.cos(np.radians(theta))[:, None])
    assert table.mean()[0] == pytest.approx(2 / 3, abs=1e-7)


def test_a_table_with_a_part_that_is_not_smooth_is_the_spline_of_the_rest_and_that_part():
    second = samples.random_second_reflection(wavelengths=2)
    theta = np.linspace(0, 90, 40)
    smooth = np.cos(np.radians(theta))[:, None] * [0.4, 0.5]
    with_second = AlbedoTable(theta, smooth + second.albedo(theta), second=lambda: second.albedo_pieces)
    between = np.append(np.random.default_rng(0).uniform(0, 90, 200), [0, second.theta[3], theta[7], 90])
    expected = AlbedoTable(theta, smooth)(between) + second.albedo(between)
    np.testing.assert_allclose(with_second(between), expected, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize(
    "anisotropy", [24.0, *(pytest.param(ratio, marks=pytest.mark.slow) for ratio in (1.0, 4.0, 12.0, 30.0))]
)
def test_facets_with_a_lay_reflect_light_from_the_normal_alike_at_all_azimuths(anisotropy):
    surface = facets.analytic("beckmann", a_x=0.3 / anisotropy, a_y=0.3, azimuth=20.0)
    with samples.coarse_albedo_tables():
        bsdf = microfacet.build(surface, index=1.5, spectrum=samples.spectrum(0.06), multiple_scattering="none")
    around = bsdf.bsdf.albedo(theta_i=0.0, phi_i=np.arange(0.0, 360.0, 15.0), wavelength=550.0).values
    assert around == pytest.approx(0.06, abs=1e-3)
    model, nm = representation(bsdf), np.array([550.0])
    at = np.zeros(1), np.zeros(1)
    assert around == pytest.approx(model.integrate(*at, nm, relative=1e-4).value.item(), abs=1e-3)
