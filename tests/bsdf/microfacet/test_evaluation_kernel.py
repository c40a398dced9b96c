"""The compiled kernel: its elementary functions, and its BRDF against the arrays of numpy and against closed forms."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import samples
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import RectBivariateSpline
from scipy.special import erf

from brdfpipe import facets, vocabulary
from brdfpipe.bsdf.microfacet import evaluation_kernel as kernel
from brdfpipe.bsdf.microfacet import model
from brdfpipe.bsdf.microfacet.anisotropic_quadrature import azimuth_to_arc
from brdfpipe.bsdf.microfacet.builder import build
from brdfpipe.bsdf.microfacet.microsurface import Microsurface
from brdfpipe.bsdf.microfacet.model import Model
from brdfpipe.bsdf.microfacet.second_reflection import with_second_reflection
from brdfpipe.bsdf.registry import representation
from brdfpipe.facets.planar_density import Ellipse
from brdfpipe.geometry import half_vector
from brdfpipe.masking.visibility import VisibilityRatio
from brdfpipe.optics.fresnel_equations import fresnel

COUNT = 1500
"""Pairs of directions; several blocks of the kernel, and not a whole number of them."""


def directions(seed: int = 0, count: int = COUNT) -> list[np.ndarray]:
    """Random pairs, and those at the edges of the domain."""
    random = np.random.default_rng(seed)
    theta = np.degrees(np.arccos(1 - random.random((2, count))))
    theta[:, :8] = [[0, 0, 90, 89.9999999, 45, 45, 120, 0], [0, 90, 90, 89.9999999, 45, 45 + 1e-9, 30, 180]]
    phi = random.uniform(-720, 720, (2, count))
    phi[:, :8] = [[0, 0, 0, 0, 30, 30, 0, 0], [0, 0, 180, 180, 210, 210, 0, 0]]
    return [theta[0], phi[0], theta[1], phi[1]]


def spectral_index(n, k) -> xr.Dataset:
    wavelength = np.linspace(400.0, 700.0, np.size(n))
    values = {name: ("wavelength", np.asarray(value, dtype=float)) for name, value in (("n", n), ("k", k))}
    return vocabulary.label(xr.Dataset(values, {"wavelength": wavelength}, {"source": "test"}), "index")


def by_both(bsdf: xr.Dataset, angles) -> tuple[np.ndarray, np.ndarray]:
    """Values of the kernel, and of numpy."""
    prepared = Model.of(bsdf, None)
    assert prepared._has_kernel
    return prepared._compiled(angles), by_numpy(prepared, angles)


def by_numpy(prepared: Model, angles) -> np.ndarray:
    """The arrays of numpy, for so few directions at once that the kernel is not used."""
    few = (model.MANY_VALUES - 1) // prepared._width
    parts = [[angle[start : start + few] for angle in angles] for start in range(0, angles[0].size, few)]
    return np.concatenate([prepared.evaluate(*part) for part in parts])


def assert_same(bsdf: xr.Dataset, angles) -> None:
    """The kernel agrees with numpy within 1e-12, or within what the rounding of the angles changes."""
    compiled, expected = by_both(bsdf, angles)
    allowed = 1e-12 + 4 * sensitivity(bsdf, angles)
    # Values too small to be written with all digits are only small.
    assert (np.abs(compiled - expected) <= allowed * expected + 1e-290).all()


def sensitivity(bsdf: xr.Dataset, angles) -> np.ndarray:
    """Relative change of the BRDF when each angle changes by its rounding, (directions, wavelength)."""
    prepared = Model.of(bsdf, None)
    values, change = by_numpy(prepared, angles), 0.0
    for which, angle in enumerate(angles):
        for towards in (-np.inf, np.inf):
            moved = [*angles]
            moved[which] = np.where(angle == 0, 0.0, np.nextafter(angle, towards))
            change = change + np.abs(by_numpy(prepared, moved) - values)
    return change / np.maximum(values, 1e-300)


# --- elementary functions


def of_each(function, *columns):
    return np.array([function(*map(float, row)) for row in zip(*columns, strict=True)])


def test_elementary_functions_are_those_of_numpy():
    random = np.random.default_rng(1)
    x = np.concatenate([random.uniform(-700, 700, 500), random.uniform(-1, 1, 500), [0.0, -745.0, -np.inf]])
    # At -745 one bit is left.
    np.testing.assert_allclose(of_each(kernel._exponential, x), np.exp(x), rtol=2e-15, atol=1e-322)
    positive = 10.0 ** random.uniform(-300, 300, 500)
    np.testing.assert_allclose(of_each(kernel._logarithm, positive), np.log(positive), rtol=5e-16, atol=5e-16)
    slope = np.concatenate([10.0 ** random.uniform(-20, 140, 500), [0.0]])
    for sign in (1, -1):
        np.testing.assert_allclose(
            of_each(kernel._inverse_sinh, sign * slope), np.arcsinh(sign * slope), rtol=1e-15, atol=4e-16
        )
    vector = random.normal(size=(2, 500)) * 10.0 ** random.uniform(-8, 8, (2, 500))
    np.testing.assert_allclose(of_each(kernel._angle, *vector), np.arctan2(*vector), rtol=5e-16)
    tangent = np.append(random.uniform(-0.09, 0.09, 500), [0.0, 1e-9])
    np.testing.assert_allclose(of_each(kernel._small_angle, tangent), np.arctan(tangent), rtol=5e-16)
    degrees = np.concatenate([random.uniform(-1440, 1440, 500), np.arange(-1440, 1441, 45.0)])
    sine, cosine = of_each(kernel._of_degrees, degrees).T
    np.testing.assert_allclose(sine, np.sin(np.radians(degrees)), atol=5e-15)
    np.testing.assert_allclose(cosine, np.cos(np.radians(degrees)), atol=5e-15)
    quarters = np.arange(-1440, 1441, 90.0)
    assert set(np.abs(of_each(kernel._of_degrees, quarters)).ravel()) == {0.0, 1.0}


@pytest.mark.parametrize("ratio", [1.0, 0.5, 0.01])
def test_arcs_of_an_ellipse_are_the_elliptic_integral(ratio):
    ellipse = Ellipse(0.3 * ratio, 0.3, 20.0)
    # Many of one azimuth are computed once.
    azimuths = np.append(np.random.default_rng(0).uniform(-720, 720, 600), np.full(1200, 33.0))
    arcs = kernel.arcs(ellipse, azimuths)
    difference = (arcs - azimuth_to_arc(ellipse, azimuths) + 180) % 360 - 180
    assert np.abs(difference).max() < 1e-10


@given(n=st.floats(1, 4), cosine=st.floats(0, 1))
@settings(max_examples=200)
def test_reflectance_of_dielectrics_is_fresnels(n, cosine):
    assert kernel._transparent(cosine, n) == pytest.approx(float(fresnel(cosine, n).mean), rel=1e-12, abs=1e-40)


@given(n=st.floats(0.02, 10), k=st.floats(0, 10) | st.just(1e9), cosine=st.floats(0, 1))
@settings(max_examples=200)
def test_reflectance_of_metals_is_fresnels(n, k, cosine):
    if k == 0 and n < 1:  # light within a body, which the kernel is not given
        return
    assert kernel._absorbing(cosine, n, k) == pytest.approx(float(fresnel(cosine, n, k).mean), rel=1e-12, abs=1e-40)


# --- the BRDF


def traced_visibility() -> xr.Dataset:
    """A ratio that varies at random between the nodes, with both more and fewer facets visible than Smith's."""
    return samples.visibility_table(np.exp(0.5 * np.random.default_rng(5).normal(size=(6, 7, 5))))


@cache
def material(surface: str, base: str) -> xr.Dataset:
    density = {
        "isotropic": lambda: facets.analytic("ggx", 0.2),
        "lay": lambda: facets.analytic("beckmann", a_x=0.05, a_y=0.4, azimuth=25.0),
        "counted": lambda: facets.estimate(samples.gaussian_surface(128), isotropic=True),
    }[surface]()
    count = samples.WAVELENGTH.size
    wavy = samples.spectrum(np.linspace(0.2, 0.9, count))
    colours = {
        "one value": {"index": 1.5},
        "constant index": {"index": 1.5, "spectrum": wavy},
        "dispersion": {"index": spectral_index(np.linspace(1.6, 1.4, 30), np.zeros(30)), "spectrum": wavy},
        "metal": {"index": spectral_index(np.linspace(0.2, 1.5, 7), np.linspace(3.0, 5.0, 7))},
        "metal and dielectric": {"index": spectral_index([1.0, 1.3, 1.5], [0.0, 0.0, 0.2])},
        "compensated": {"index": 1.5, "spectrum": wavy, "multiple_scattering": "compensated"},
        "separable": {"index": 1.5, "spectrum": wavy, "masking": "separable"},
        "measured": {"index": 1.5, "spectrum": wavy, "masking": "measured", "visibility": traced_visibility()},
        "directional": {"index": 1.5, "spectrum": samples.spectrum(0.5), "multiple_scattering": "directional"},
    }
    return build(density, **({"multiple_scattering": "none"} | colours[base]))


BASES = (
    "one value",
    "constant index",
    "dispersion",
    "metal",
    "metal and dielectric",
    "compensated",
    "separable",
    "directional",
)


@pytest.mark.cases(4)
@pytest.mark.parametrize("base", BASES)
def test_isotropic_values_are_those_of_numpy(base):
    bsdf, angles = material("isotropic", base), directions()
    assert_same(bsdf, angles)
    # Away from the horizon the rounding of angles changes next to nothing.
    away = [angle[(angles[0] < 89) & (angles[2] < 89)] for angle in angles]
    np.testing.assert_allclose(*by_both(bsdf, away), rtol=1e-12, atol=1e-290)


@pytest.mark.cases(1)
@pytest.mark.parametrize("base", ["dispersion", "one value", "compensated"])
def test_values_of_counted_facets_are_those_of_numpy(base):
    assert_same(material("counted", base), directions())


@pytest.mark.cases(4)
@pytest.mark.parametrize(
    ("surface", "base", "planes", "turns"),
    [
        ("isotropic", "one value", 1, 0),
        ("isotropic", "constant index", 1, 0),
        ("isotropic", "dispersion", 1, 0),
        ("isotropic", "metal", 1, 0),
        ("isotropic", "measured", 1, 0),
        ("lay", "one value", 4, 0),
        ("lay", "constant index", 1, 6),
        ("lay", "metal", 4, 0),
    ],
)
def test_light_reflected_more_than_once_is_that_of_numpy(surface, base, planes, turns):
    bsdf = material(surface, base)
    second = samples.random_second_reflection(planes, turns, max(bsdf["n"].size, 1))
    assert_same(with_second_reflection(bsdf, second), directions())


def test_values_of_a_traced_masking_are_those_of_numpy():
    assert_same(material("isotropic", "measured"), directions())


@pytest.mark.cases(1)
@pytest.mark.parametrize("base", ["constant index", "compensated", "dispersion", "one value", "metal", "separable"])
def test_values_of_a_lay_are_those_of_numpy(base):
    assert_same(material("lay", base), directions())


@pytest.mark.cases(3)
@pytest.mark.parametrize("slope", [1e-6, 1e-3, 0.1, 1.0, 10.0])
def test_values_differ_by_no_more_than_the_rounding_of_angles_explains(slope):
    bsdf = build(facets.analytic("beckmann", slope), index=1.5, multiple_scattering="none")
    # Near the mirror direction, where narrow lobes are.
    random = np.random.default_rng(3)
    theta = random.uniform(0, 89.9, COUNT)
    width = np.degrees(min(slope, 0.5))
    angles = [
        theta,
        np.zeros(COUNT),
        np.clip(theta + width * random.normal(size=COUNT), 1e-3, 89.99),
        180 + width * random.normal(size=COUNT),
    ]
    assert_same(bsdf, angles)
    # Angles are rounded by a share of the width of the lobe: the test is not empty.
    assert (by_numpy(Model.of(bsdf, None), angles) > 1e-6).sum() > COUNT / 10


def test_a_gaussian_surface_of_perfect_mirrors_has_its_closed_form():
    a = 0.4
    theta_i, phi_i, theta_o, phi_o = angles = [angle[8:] for angle in directions(2)]
    mirrors = {"index": spectral_index([1.0], [1e9]), "multiple_scattering": "none"}
    values = Model.of(build(facets.analytic("beckmann", a), **mirrors), None)._compiled(angles)
    i, o = (
        np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)])
        for t, p in np.radians([(theta_i, phi_i), (theta_o, phi_o)])
    )
    h = (i + o) / np.linalg.norm(i + o, axis=0)
    density = np.exp(-((h[0] / h[2]) ** 2 + (h[1] / h[2]) ** 2) / a**2) / (np.pi * a**2 * h[2] ** 4)

    def smith(cosine):
        v = cosine / np.sqrt(1 - cosine**2) / a
        return (np.exp(-(v**2)) / (v * np.sqrt(np.pi)) - 1 + erf(v)) / 2

    expected = density / (4 * i[2] * o[2] * (1 + smith(i[2]) + smith(o[2])))
    seen = expected > 1e-6 * expected.max()
    # The density and Smith's function are tables of a few hundred nodes, of which the masking of the tail is the coarsest.
    np.testing.assert_allclose(values[seen, 0], expected[seen], rtol=2e-6)


@pytest.mark.parametrize(
    ("surface", "base"), [("isotropic", "constant index"), ("isotropic", "directional"), ("lay", "constant index")]
)
def test_exchanged_directions_give_the_same_bits(surface, base):
    theta_i, phi_i, theta_o, phi_o = directions(4)
    compiled = Model.of(material(surface, base), None)._compiled
    if surface == "isotropic":
        np.testing.assert_array_equal(
            compiled([theta_i, phi_i, theta_o, phi_o]), compiled([theta_o, phi_o, theta_i, phi_i])
        )
    else:
        np.testing.assert_allclose(
            compiled([theta_i, phi_i, theta_o, phi_o]), compiled([theta_o, phi_o, theta_i, phi_i]), rtol=1e-12
        )


def test_values_do_not_depend_on_their_neighbours():
    angles = directions(5)
    compiled = Model.of(material("isotropic", "dispersion"), None)._compiled
    together = compiled(angles)
    for first, last in ((0, 1), (510, 515), (1000, 1499)):
        np.testing.assert_array_equal(compiled([angle[first:last] for angle in angles]), together[first:last])


def test_directions_that_are_not_numbers_or_out_of_range_read_no_table():
    wrong = np.array([np.nan, -1.0, 1e300, -np.inf, np.inf])
    for surface, base in (("isotropic", "constant index"), ("isotropic", "directional"), ("lay", "constant index")):
        compiled = Model.of(material(surface, base), None)._compiled
        for which in range(4):
            angles = [np.full(wrong.size, 30.0) for _ in range(4)]
            angles[which] = wrong
            assert compiled(angles).shape == (wrong.size, samples.WAVELENGTH.size)
        assert (compiled([np.full(3, angle) for angle in (np.nan, 0.0, 30.0, 0.0)]) == 0).all()


def test_many_values_are_computed_by_the_kernel(monkeypatch):
    bsdf = material("isotropic", "one value")
    below_89 = np.minimum(directions(), [[89.0], [720.0], [89.0], [720.0]])
    angles = [np.resize(angle, model.MANY_VALUES) for angle in below_89]
    values = representation(bsdf).evaluate(*angles, None)
    np.testing.assert_array_equal(values, Model.of(bsdf, None)._compiled(angles))
    monkeypatch.setattr(Model, "_compiled", None)
    few = representation(bsdf).evaluate(*(angle[:-1] for angle in angles), None)
    np.testing.assert_allclose(values[:-1], few, rtol=1e-12)


@pytest.mark.cases(3)
@pytest.mark.parametrize(
    "options",
    [
        {"transparent": True},
        {"masking": "blinn"},
        {"diffuse": "crf", "spectrum": samples.spectrum(0.5)},
    ],
)
def test_other_models_are_left_to_numpy(options):
    assert not Model.of(build(facets.analytic("beckmann", 0.2), index=1.5, **options), None)._has_kernel


@pytest.mark.parametrize("surface", ["isotropic", "lay"])
def test_a_repeated_incidence_gives_the_same_values_bit_by_bit(surface):
    bsdf, (_, _, theta_o, phi_o) = material(surface, "one value"), directions()
    alone, among_others = np.full((2, COUNT), 50.0), np.full((2, COUNT), 50.0)
    among_others[0, 1::64] = 20.0
    evaluate = Model.of(bsdf, None)._compiled
    repeated, varied = (evaluate([angles[0], angles[1], theta_o, phi_o]) for angles in (alone, among_others))
    same = among_others[0] == 50
    np.testing.assert_array_equal(repeated[same], varied[same])


def test_spline_axes_find_the_span_of_every_number():
    knots = np.concatenate([np.zeros(4), [0.5, 0.50001, 3.0, 9.0], np.full(4, 10.0)])
    axis = kernel.SplineAxis.of(knots)
    x = np.sort(np.concatenate([np.random.default_rng(0).uniform(0, 10, 2000), knots, np.nextafter(knots[4:8], 0)]))
    expected = np.clip(np.searchsorted(knots[3:-3], x, side="right") - 1, 0, 4)
    np.testing.assert_array_equal([kernel._span(float(value), axis) for value in x], expected)


def test_a_uniform_surface_is_the_spline_between_its_nodes():
    random = np.random.default_rng(0)
    spline = RectBivariateSpline(np.linspace(0.2, 3, 9), np.linspace(-20, 380, 12), random.normal(size=(9, 12)))
    surface = kernel.UniformSurface.of(spline)
    x, y = (
        np.append(random.uniform(0.2, 3, 300), [0.2, 3, 3, 0.2]),
        np.append(random.uniform(-20, 380, 300), [-20, 380] * 2),
    )
    row, column = (
        (at - first) * scale for at, first, scale in zip((x, y), surface.first, surface.nodes_a_unit, strict=True)
    )
    values = np.empty(x.size)
    rows = tuple(np.empty((9, x.size)))
    kernel._uniform_values(np.clip(column, 0, 11), np.clip(row, 0, 8), surface.coefficients, rows, values)
    np.testing.assert_allclose(values, spline.ev(x, y), rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("masking", ["height-correlated", "separable", "measured"])
def test_visible_facets_are_those_of_numpy(masking):
    random = np.random.default_rng(3)
    ratio = VisibilityRatio(
        np.log(random.uniform(0.7, 1.4, (9, 8, 7))), (0.96, 2.0), np.array([0.0, 0.5, 1.0]), random.random(3)
    )
    surface = replace(Microsurface.of(facets.analytic("ggx", 0.3)), ratio=ratio)
    theta, phi = np.degrees(np.arccos(random.uniform(0.01, 1, (2, 700)))), random.uniform(0, 360, (2, 700))
    check_facets(surface, masking, kernel.FacetTables.of(surface, masking), theta, phi)


def check_facets(surface, masking, tables, theta, phi):
    """Visibility and density of the facets of pairs of directions are those of numpy."""
    pair = half_vector(theta[0], phi[0], theta[1], phi[1])
    visible, density = kernel.facets(tables, (theta[0], phi[0], theta[1], phi[1]))
    spread = (1 + pair.slope_squared) ** 2
    np.testing.assert_allclose(visible, spread * surface.visibility(pair, *phi, masking) / 4, rtol=1e-11)
    np.testing.assert_allclose(density, surface.p22(pair, *phi), rtol=1e-11)


@pytest.mark.parametrize("masking", ["height-correlated", "separable"])
@pytest.mark.parametrize("incidences", [1, 700])
def test_visible_facets_with_a_lay_are_those_of_numpy(masking, incidences):
    random, surface = np.random.default_rng(3), Microsurface.of(facets.analytic("ggx", a_x=0.1, a_y=0.4, azimuth=20))
    theta, phi = np.degrees(np.arccos(random.uniform(0.01, 1, (2, 700)))), random.uniform(0, 360, (2, 700))
    theta[0], phi[0] = np.resize(theta[0, :incidences], 700), np.resize(phi[0, :incidences], 700)
    check_facets(surface, masking, kernel.LayFacetTables.of(surface, masking), theta, phi)


@pytest.mark.parametrize("k", [0.0, 0.01, 3.0])
def test_the_reflectance_is_that_of_fresnel(k):
    cosine, n = np.append(np.linspace(1e-9, 1, 200), 1e-5), np.array([1.0, 1.3, 1.5, 2.5])
    n, k = (n, np.full(4, k)) if k < 1 else (np.append(n, 0.3), np.full(5, k))
    np.testing.assert_allclose(
        kernel.reflectances(cosine, n, k), fresnel(cosine[:, None], n, k).mean, rtol=1e-12, atol=1e-16
    )
