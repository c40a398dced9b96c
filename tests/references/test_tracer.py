"""Rays traced over height maps, against closed forms, conservation of energy and the counted facets."""

from __future__ import annotations

import numpy as np
import pytest
import relief_maps
import samples

from brdfpipe.bsdf.microfacet.builder import build
from brdfpipe.bsdf.registry import representation
from brdfpipe.errors import VocabularyError
from brdfpipe.facets.estimation import estimate
from brdfpipe.geometry import angles_of
from brdfpipe.masking.visibility_choice import choose
from brdfpipe.optics.fresnel_equations import fresnel
from brdfpipe.references.height_mesh import HeightMapError, HeightMesh
from brdfpipe.references.tracer import SlopeBins, trace

PERIOD = 16


def grooves(slope: float, cells: int = 64):
    """Symmetric V-grooves along y, of 16 samples."""
    return samples.surface(np.tile(slope * np.abs((np.arange(cells + 1) % PERIOD) - PERIOD / 2), (cells + 1, 1)))


def peak_errors(height, theta_i: float, rays: int, **options) -> tuple[float, float]:
    """Predicted over traced light less 1 where the prediction exceeds 0.3 of its peak: of one reflection, and of all."""
    surface = samples.surface(height)
    mesh = HeightMesh.of(surface, "periodic")
    bins = SlopeBins.of(mesh.typical_slope)
    traced = trace(mesh, theta_i, index=1.5, bins=bins, rays=rays)
    options = {"index": 1.5, "multiple_scattering": "none"} | options
    predicted, brdf = predicted_light(build(estimate(surface, isotropic=True), **options), theta_i, bins)
    peak = brdf > 0.3 * brdf.max()
    by_order = traced.power.mean(axis=1)[:, bins.half :]
    return tuple(predicted[peak].sum() / light[peak].sum() - 1 for light in (by_order[0], by_order.sum(axis=0)))


def predicted_light(bsdf, theta_i: float, bins: SlopeBins):
    """(across, along): the light that a BSDF sends into each bin of the half vector's slope, and its mean BRDF there."""
    points = 4
    at = bins.step * (np.arange(-bins.half, bins.half)[:, None] + (np.arange(points) + 0.5) / points).ravel()
    p, width = bins.width * np.sinh(at), bins.width * np.cosh(at) * bins.step / points
    q = p[p.size // 2 :, None]
    normal = np.stack(np.broadcast_arrays(-p, -q, 1.0), axis=-1)
    cos_alpha = 1 / np.linalg.norm(normal, axis=-1)
    incident = np.array([np.sin(np.radians(theta_i)), 0.0, np.cos(np.radians(theta_i))])
    cos_zeta = normal @ incident * cos_alpha
    outgoing = 2 * (cos_zeta * cos_alpha)[..., None] * normal - incident
    above = (outgoing[..., 2] > 1e-9) & (cos_zeta > 0)
    theta_o, phi_o = angles_of(outgoing[above])
    brdf = np.zeros(above.shape)
    incidence = np.full_like(theta_o, theta_i), np.zeros_like(theta_o)
    brdf[above] = representation(bsdf).evaluate(*incidence, theta_o, phi_o, None)[:, 0]
    solid_angle = np.where(
        above, outgoing[..., 2] * 8 * cos_zeta * cos_alpha**3 * width * width[p.size // 2 :, None], 0.0
    )
    shape = (bins.half, points, 2 * bins.half, points)
    light, area = ((values).reshape(shape).sum(axis=(1, 3)) for values in (brdf * solid_angle, solid_angle))
    return light, light / np.maximum(area, 1e-300)


@pytest.mark.parametrize("index", [1.5, 0.2 + 3.4j])
@pytest.mark.parametrize("theta_i", [0.0, 75.0, 89.0])
def test_reflected_refracted_and_lost_light_add_up_to_the_incident_light(index, theta_i):
    mesh = HeightMesh.of(samples.gaussian_surface(64, sigma=0.4))
    light = trace(mesh, theta_i, index=index, bins=SlopeBins.of(0.4), rays=4096)
    total = light.reflected.sum(axis=0) + light.refracted.sum(axis=0) + light.lost
    np.testing.assert_allclose(total, 1, atol=1e-12)  # of either polarisation
    np.testing.assert_allclose(light.power.sum(axis=(2, 3)), light.reflected, atol=1e-12)


@pytest.mark.parametrize("theta_i", [0.0, 60.0, 85.0])
def test_perfect_mirrors_return_all_light(theta_i):
    mesh = HeightMesh.of(samples.gaussian_surface(64, sigma=0.5))
    light = trace(mesh, theta_i, index=complex(np.inf), bins=SlopeBins.of(0.5), rays=8192)
    np.testing.assert_allclose(light.reflected.sum(axis=0), 1, atol=1e-12)
    assert light.reflected[1:].sum() > 0.01


def test_the_number_of_threads_does_not_change_a_bit():
    mesh = HeightMesh.of(samples.gaussian_surface(64, sigma=0.3))
    one, two = (trace(mesh, 60.0, index=1.5, bins=SlopeBins.of(0.3), rays=4096, threads=n) for n in (1, 2))
    for field, other in zip(one, two, strict=True):
        np.testing.assert_array_equal(field, other)


def test_another_seed_gives_other_rays_within_the_stated_noise():
    mesh = HeightMesh.of(samples.gaussian_surface(64, sigma=0.3))
    bins = SlopeBins.of(0.3, step=0.5)
    one, other = (trace(mesh, 45.0, index=1.5, bins=bins, rays=2**15, seed=seed) for seed in (0, 1))
    noise = np.hypot(one.ray_noise, other.ray_noise)
    z = (one.power - other.power).mean(axis=1).sum(axis=0)[noise > 0] / noise[noise > 0]
    # Even spacing of the rays makes the scatter smaller than that of independent rays.
    assert 0.05 < np.sqrt(np.mean(z**2)) < 1.2


def test_right_angled_grooves_return_light_after_two_reflections_with_its_polarisation():
    # At normal incidence both reflections are at 45 degree in one plane: s stays s, and a depolarised mean would give F².
    mesh = HeightMesh.of(grooves(1.0))
    light = trace(mesh, 0.0, 0.0, index=1.5, bins=SlopeBins.of(0.1), rays=4096)
    s, p, _ = fresnel(np.cos(np.pi / 4), 1.5)
    np.testing.assert_allclose(light.reflected[1], [s**2, p**2], rtol=1e-9)
    np.testing.assert_allclose(light.reflected[[0, 2]], 0, atol=1e-12)


def test_polarisation_is_turned_with_the_plane_of_incidence():
    # Light polarised across the grooves' normal plane arrives half s and half p if its own plane is turned by 45 degree.
    mesh = HeightMesh.of(grooves(1.0))
    light = trace(mesh, 0.0, 45.0, index=1.5, bins=SlopeBins.of(0.1), rays=4096)
    s, p, _ = fresnel(np.cos(np.pi / 4), 1.5)
    np.testing.assert_allclose(light.reflected[1], (s**2 + p**2) / 2, rtol=1e-9)


def test_a_single_reflection_is_counted_at_the_slope_of_its_facet():
    slope = 0.2
    mesh, bins = HeightMesh.of(grooves(slope)), SlopeBins.of(0.1)
    light = trace(mesh, 10.0, 0.0, index=1.5, bins=bins, rays=4096)
    across, along = np.nonzero(light.power[0].sum(axis=0))
    edges = bins.edges
    assert {int(np.searchsorted(edges, sign * slope)) - 1 for sign in (1, -1)} == set(along.tolist())
    assert set(across.tolist()) <= {bins.half - 1, bins.half}
    # Facets of slope ±0.2 receive light in proportion to their projected area; F changes little between 1 and 21 degree.
    tilt = np.degrees(np.arctan(slope))
    expected = [
        0.5 * (1 + sign * slope * np.tan(np.radians(10))) * fresnel(np.cos(np.radians(10 + sign * tilt)), 1.5).mean
        for sign in (1, -1)
    ]
    towards = light.power[0].mean(axis=0).sum(axis=0)
    np.testing.assert_allclose([towards[: bins.half].sum(), towards[bins.half :].sum()], expected, rtol=0.01)


def test_light_goes_on_in_the_mirror_image_of_a_map():
    height = samples.gaussian_surface(64, sigma=0.2)["height"].values
    whole = np.block([[height, height[:, -2:0:-1]], [height[-2:0:-1], height[-2:0:-1, -2:0:-1]]])
    meshes = HeightMesh.of(samples.surface(height)), HeightMesh.of(samples.surface(whole), "periodic")
    bins = SlopeBins.of(0.2)
    for theta_i in (60.0, 85.0):
        one, other = (trace(mesh, theta_i, index=1.5, bins=bins, rays=2**16) for mesh in meshes)
        # Rays at other places: their noise is about 1/√65536 of the spread of F.
        np.testing.assert_allclose(one.reflected.sum(axis=0), other.reflected.sum(axis=0), rtol=0.01)
        np.testing.assert_allclose(one.reflected[1].mean(), other.reflected[1].mean(), rtol=0.05)


def test_light_that_meets_missing_heights_is_lost():
    surface = samples.gaussian_surface(64, sigma=0.4)
    surface["height"][20:30, 20:30] = np.nan
    light = trace(HeightMesh.of(surface), 75.0, index=complex(np.inf), bins=SlopeBins.of(0.4), rays=8192)
    assert light.rays < 8192
    assert 0 < light.lost.mean() < 0.05
    np.testing.assert_allclose(light.reflected.sum(axis=0) + light.lost, 1, atol=1e-12)


def test_a_tilt_is_removed():
    height = samples.gaussian_surface(64, sigma=0.2)["height"].values
    tilted = height + 0.3 * np.arange(64)
    levelled, unlevelled = (HeightMesh.of(samples.surface(values)) for values in (height, tilted))
    slopes = [np.mean(mesh.slopes()[0]) for mesh in (levelled, unlevelled)]
    np.testing.assert_allclose(slopes, 0, atol=2e-3)


def test_typical_slope_is_that_of_a_gaussian_surface_and_ignores_spikes():
    surface = samples.gaussian_surface(256, sigma=0.15)
    spiky = surface.copy(deep=True)
    spiky["height"][::64, ::64] += 50
    for given in (surface, spiky):
        assert HeightMesh.of(given).typical_slope == pytest.approx(0.15, rel=0.03)
    assert HeightMesh.of(surface).anisotropy == pytest.approx(1, abs=0.05)


def test_unusable_maps_and_options_are_refused():
    rough = samples.gaussian_surface(32)
    with pytest.raises(HeightMapError, match="line profile"):
        HeightMesh.of(samples.surface(np.zeros(100)))
    with pytest.raises(HeightMapError, match="16 × 16"):
        HeightMesh.of(samples.gaussian_surface(8))
    with pytest.raises(HeightMapError, match="edges 'torn'; accepted: mirrored"):
        HeightMesh.of(rough, "torn")
    with pytest.raises(HeightMapError, match="no complete cell"):
        HeightMesh.of(rough.assign(height=rough["height"] * np.nan))
    with pytest.raises(VocabularyError, match="kind 'surface'"):
        HeightMesh.of(samples.spectrum())
    mesh, bins = HeightMesh.of(rough), SlopeBins.of(0.1)
    with pytest.raises(HeightMapError, match="incidence angle 90"):
        trace(mesh, 90.0, index=1.5, bins=bins)
    with pytest.raises(HeightMapError, match="refractive index"):
        trace(mesh, 0.0, index=0.9, bins=bins)
    with pytest.raises(HeightMapError, match="number of rays 0"):
        trace(mesh, 0.0, index=1.5, bins=bins, rays=0)


def test_counted_facets_predict_the_traced_light_of_low_slopes():
    height = samples.gaussian_surface(256, sigma=0.1, correlation=16.0)["height"].values
    single, total = peak_errors(height, 30.0, 2**17)
    assert abs(single) < 0.01  # the noise of the rays and of the estimated density
    assert total <= single


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sigma", "theta_i", "single", "total"),
    [
        (0.1, 0, 0.0, 0.0),
        (0.1, 30, 0.0, 0.0),
        (0.1, 60, -0.002, -0.008),
        (0.1, 75, -0.008, -0.094),
        (0.3, 0, -0.004, -0.007),
        (0.3, 30, -0.022, -0.054),
        (0.3, 60, 0.007, -0.078),
        (0.3, 75, 0.064, -0.017),
    ],
)
def test_errors_of_the_facet_model_are_those_of_an_independent_tracer(sigma, theta_i, single, total):
    # Maps of other seeds scatter by up to 0.01 at 60 degree and 0.03 at 75, where few facets are seen.
    height = samples.gaussian_surface(1024, sigma=sigma, correlation=16.0)["height"].values
    tolerance = {0: 0.004, 30: 0.012, 60: 0.03, 75: 0.03}[theta_i]
    np.testing.assert_allclose(peak_errors(height, theta_i, 2**21), [single, total], atol=tolerance)


def test_reflections_from_facet_to_facet_are_those_of_the_rays():
    height = samples.gaussian_surface(256, sigma=0.1, correlation=8.0)["height"].values
    _, lost = peak_errors(height, 75.0, 2**17)
    _, directional = peak_errors(height, 75.0, 2**17, multiple_scattering="directional")
    assert lost < -0.06
    assert abs(directional) < 0.03


@pytest.mark.slow
@pytest.mark.parametrize("sigma", [0.1, 0.3, 0.6])
@pytest.mark.parametrize(("theta_i", "limit"), [(0, 0.05), (30, 0.05), (60, 0.05), (75, 0.1)])
def test_reflections_from_facet_to_facet_predict_the_traced_light_of_gaussian_maps(sigma, theta_i, limit):
    height = samples.gaussian_surface(1024, sigma=sigma, correlation=16.0)["height"].values
    _, total = peak_errors(height, theta_i, 2**20, multiple_scattering="directional")
    assert abs(total) < limit


@pytest.mark.slow
def test_a_grain_with_valleys_and_its_negative_are_told_apart():
    height = relief_maps.cells(512, 0)
    with_valleys, with_ridges = (peak_errors(sign * height, 75.0, 2**20)[0] for sign in (1, -1))
    # The prediction, which knows slopes alone, is the same for both.
    assert with_valleys < -0.1
    assert with_ridges > 0.1


@pytest.mark.slow
@pytest.mark.parametrize("sign", [1, -1])
def test_masking_traced_on_the_map_tells_cells_from_their_negative(sign):
    surface = samples.surface(sign * relief_maps.cells(1024, 0))
    facets = estimate(surface, isotropic=True)
    once = {"index": 1.5, "multiple_scattering": "none"}
    smith, measured = (build(facets, **once, **traced) for traced in ({}, {"visibility": choose(surface, facets)}))
    mesh = HeightMesh.of(surface)
    bins = SlopeBins.of(mesh.typical_slope)
    traced = trace(mesh, 75.0, index=1.5, bins=bins, rays=10**6).power.mean(axis=1)[0, bins.half :]
    errors = []
    for bsdf in (smith, measured):
        predicted, brdf = predicted_light(bsdf, 75.0, bins)
        peak = brdf > 0.3 * brdf.max()
        errors.append(predicted[peak].sum() / traced[peak].sum() - 1)
    assert abs(errors[0]) > 0.25
    assert abs(errors[1]) < 0.1
