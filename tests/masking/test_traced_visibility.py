"""Visibility of facets traced on maps, against V-grooves, traced light, Smith's limits, reciprocity and energy."""

from __future__ import annotations

import numpy as np
import pytest
import samples
from hypothesis import given, settings
from hypothesis import strategies as st

from brdfpipe import vocabulary
from brdfpipe.bsdf.microfacet import energy
from brdfpipe.bsdf.microfacet.builder import build, with_visibility
from brdfpipe.bsdf.microfacet.microsurface import Microsurface, ModelError
from brdfpipe.bsdf.registry import representation
from brdfpipe.facets.analytic_distributions import analytic, flat
from brdfpipe.facets.estimation import estimate
from brdfpipe.geometry import half_vector
from brdfpipe.masking.facet_sample import FacetSample
from brdfpipe.masking.traced_visibility import mirrored_pairs, tabulate
from brdfpipe.masking.visibility import SingleVisibility, VisibilityRatio
from brdfpipe.references.height_mesh import HeightMesh
from brdfpipe.references.tracer import SlopeBins, trace

POLAR = st.floats(0, 90, exclude_max=True)
AZIMUTH = st.floats(-360, 360)
BECKMANN = analytic("beckmann", 0.3 * np.sqrt(2))


def random_table(seed: int, spread: float = 0.5):
    return samples.visibility_table(np.exp(spread * np.random.default_rng(seed).normal(size=(6, 7, 5))))


SMITH = build(BECKMANN, index=1.5, multiple_scattering="none")


def with_ratio(table, **options):
    options = {"multiple_scattering": "none"} | options
    return build(BECKMANN, index=1.5, visibility=table, masking="measured", **options)


def brdf(bsdf, *angles):
    return representation(bsdf).evaluate(*map(np.atleast_1d, angles), None)


# --- tracing


@pytest.mark.parametrize("zeta", [10.0, 40.0, 55.0, 60.0])
def test_facets_of_grooves_are_visible_as_blinn_says(zeta):
    # Symmetric V-grooves: G2 = min(1, 2 cos α cos θ / cos ζ) of the more grazing direction, in the plane across them.
    slope, cells = 0.5, 64
    height = np.tile(slope * np.abs((np.arange(cells + 1) % 16) - 8.0), (cells + 1, 1))
    mesh = HeightMesh.of(samples.surface(height))
    facets = FacetSample.of(mesh, 20_000, 0)
    p, q = facets.slopes
    assert np.abs(p) == pytest.approx(slope, abs=1e-12)
    assert facets.facet[:, 0] == pytest.approx(slope * np.abs((facets.position[:, 0] % 16) - 8) - slope * 4, abs=0.3)
    _, directions = mirrored_pairs(p, q, np.radians(zeta), 1.0)
    visible = facets.visible(*directions)
    tilt = np.arctan(slope)
    grazing = np.cos(tilt + np.radians(zeta))
    expected = min(1.0, 2 * np.cos(tilt) * grazing / np.cos(np.radians(zeta))) if grazing > 0 else 0.0
    assert visible.mean() == pytest.approx(expected, abs=0.012)


@pytest.fixture(scope="module")
def gaussian_map():
    return samples.gaussian_surface(256, sigma=0.3, correlation=12)


@pytest.fixture(scope="module")
def traced(gaussian_map):
    return vocabulary.label(tabulate(HeightMesh.of(gaussian_map), samples=2**12), "visibility")


def test_perfect_mirrors_reflect_what_traced_rays_reflect_once(gaussian_map, traced):
    facets = estimate(gaussian_map, isotropic=True)
    surface = Microsurface.of(
        build(facets, index=1.5, visibility=traced, masking="measured", multiple_scattering="none")
    )
    mesh = HeightMesh.of(gaussian_map)
    for theta in (30.0, 60.0, 75.0):
        light = trace(mesh, theta, index=complex(np.inf), bins=SlopeBins.of(0.3), rays=2**17)
        measured = energy.mirror_albedo(surface, "measured", np.array([theta]))[0]
        assert measured == pytest.approx(light.reflected[0].mean(), abs=0.006)


def test_nothing_is_masked_towards_the_normals_of_gentle_facets(traced):
    ratio = traced["visibility_ratio"].isel(grazing=0, steepness=slice(0, 4))
    assert ratio.values == pytest.approx(1, abs=2e-3)
    extrapolated = traced["visibility_ratio_quality"].values == vocabulary.quality("extrapolated")
    assert 0 < extrapolated.mean() < 0.3


def test_the_table_does_not_depend_on_the_unit_of_length_or_the_seed_beyond_its_noise(gaussian_map, traced):
    finer = samples.surface(gaussian_map["height"].values / 100, pitch=(0.01, 0.01))
    scaled = tabulate(HeightMesh.of(finer), samples=2**12)
    np.testing.assert_allclose(scaled["visibility_ratio"], traced["visibility_ratio"], rtol=0.05)
    other = tabulate(HeightMesh.of(gaussian_map), samples=2**12, seed=1000)
    for name in ("visibility_ratio", "single_ratio"):
        z = (other[name] - traced[name]) / np.hypot(other[f"{name}_u"], traced[f"{name}_u"])
        counted = (traced[f"{name}_quality"] == vocabulary.quality("measured")).values
        assert 0.2 < np.sqrt(np.mean(z.values[counted] ** 2)) < 1.3


def test_a_facet_is_seen_from_one_direction_as_smith_says_on_a_gaussian_map(traced):
    level = traced.sel(steepness_towards=slice(-0.3, None))
    gentle = level.where((level["single_ratio_u"] < 0.02) & (level["grazing"] < 0.6))["single_ratio"]
    assert gentle.count() > 60
    # Smith's heights are independent of the slopes, those of a map are not quite.
    assert float(gentle.mean()) == pytest.approx(1, abs=0.02)
    assert float(np.abs(gentle - 1).max()) < 0.1


def test_the_visibility_from_one_direction_is_interpolated(traced):
    single = SingleVisibility.of(traced)
    grazing, steepness = single.grazing[[3, 8]], single.steepness[[4, 9]]
    cot = 0.3 * (1 / grazing - 1)
    assert single(cot, 0.3 * np.sinh(steepness), 0.3) == pytest.approx(single.ratio[[3, 8], [4, 9]], rel=1e-12)
    assert single(0.0, 1e9, 0.3) == pytest.approx(single.ratio[-1, -1])
    assert single(np.inf, 0.0, 0.3) == pytest.approx(1, abs=1e-2)


@pytest.mark.slow
def test_the_stated_uncertainty_covers_the_scatter_between_maps():
    maps = [samples.gaussian_surface(256, sigma=0.3, correlation=6, seed=seed) for seed in range(8)]
    tables = [tabulate(HeightMesh.of(rough), samples=2**13) for rough in maps]
    # Of other maps the steepest facets give other numbers of nodes.
    common = {"steepness": slice(None, 1.5), "steepness_towards": slice(-1.5, 1.5)}
    for name in ("visibility_ratio", "single_ratio"):
        ratio, u, flag = (
            np.stack([table.sel(common)[f"{name}{end}"].values for table in tables]) for end in ("", "_u", "_quality")
        )
        counted = np.all(flag == 0, axis=0) & (u.mean(axis=0) > 0.002)
        over = ratio.std(axis=0, ddof=1)[counted] / np.sqrt(np.mean(u**2, axis=0))[counted]
        assert 0.7 < np.sqrt(np.mean(over**2)) < 1.5


# --- evaluation


def test_a_ratio_of_one_is_smiths_masking():
    angles = np.meshgrid([0.0, 20, 60, 85, 89.9], [0.0], [0.0, 30, 75, 89.99], [0.0, 90, 180])
    smith = brdf(SMITH, *(angle.ravel() for angle in angles))
    measured = brdf(with_ratio(samples.visibility_table(1.0)), *(angle.ravel() for angle in angles))
    np.testing.assert_allclose(measured, smith, rtol=1e-4)


RANDOM_RATIO = VisibilityRatio.of(random_table(1))


@settings(max_examples=60, deadline=None)
@given(POLAR, AZIMUTH, POLAR, AZIMUTH)
def test_exchanged_directions_are_equally_visible(theta_i, phi_i, theta_o, phi_o):
    there = half_vector(theta_i, phi_i, theta_o, phi_o)
    back = half_vector(theta_o, phi_o, theta_i, phi_i)
    one, other = RANDOM_RATIO(there, 0.3), RANDOM_RATIO(back, 0.3)
    assert np.isfinite(one)
    assert one > 0
    assert other == pytest.approx(one, rel=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_perfect_mirrors_never_gain_light(seed):
    bsdf = with_visibility(SMITH, random_table(seed))
    surface = Microsurface.of(bsdf)
    theta = np.linspace(0, 89.99, 61)
    assert energy.mirror_albedo(surface, "measured", theta).max() <= 1 + 1e-6
    assert "the traced visibility was reduced by up to" in bsdf.attrs["history"]
    assert vocabulary.warnings(bsdf) == []


def test_the_horizon_is_reached_without_a_jump():
    surface = Microsurface.of(with_visibility(SMITH, random_table(2)))
    values = [
        float(surface.reflected(half_vector(*angles), 0.0, 180.0, "measured"))
        for angles in ((60.0, 0.0, 90.0 - 1e-9, 180.0), (60.0, 0.0, 90.0, 180.0), (90.0, 0.0, 60.0, 180.0))
    ]
    assert np.isfinite(values).all()
    assert values == pytest.approx([values[0]] * 3, rel=1e-6)


def test_the_total_reflectance_closes_with_compensation():
    table = samples.visibility_table(0.9)
    bsdf = with_ratio(table, spectrum=samples.spectrum(0.4), multiple_scattering="compensated")
    albedo = representation(bsdf).albedo(np.array([8.0]), np.zeros(1), None)[0]
    assert albedo == pytest.approx(0.4, abs=1e-8)


# --- what is refused


def test_models_without_traced_visibility_are_refused():
    with pytest.raises(ModelError, match=r"needs the visibility of the facets.*set `model.masking: height-correlated`"):
        build(BECKMANN, index=1.5, masking="measured")
    with pytest.raises(ModelError, match="is not defined for transmission"):
        with_ratio(random_table(0), transparent=True)


def test_a_flat_surface_needs_no_visibility():
    assert build(flat(), index=1.5, masking="measured").attrs["representation"] == "smooth"
