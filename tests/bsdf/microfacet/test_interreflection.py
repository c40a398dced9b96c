"""Light that a height map reflects more than once: its table against rays on the map, or on another one, with Jones matrices."""

from __future__ import annotations

import numpy as np
import pytest
import relief_maps
import samples
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.bsdf.microfacet.builder import build, interreflection_of
from brdfpipe.bsdf.microfacet.interreflection import choose
from brdfpipe.bsdf.microfacet.microsurface import ModelError
from brdfpipe.bsdf.microfacet.model import with_reflections
from brdfpipe.bsdf.microfacet.second_reflection import SecondReflection
from brdfpipe.bsdf.registry import representation
from brdfpipe.comparison.lobe_bins import LobeBins
from brdfpipe.facets.analytic_distributions import flat
from brdfpipe.facets.estimation import estimate
from brdfpipe.geometry import Array
from brdfpipe.masking.modes import MULTIPLE_SCATTERING_ADVISED
from brdfpipe.references.height_mesh import HeightMapError, HeightMesh
from brdfpipe.references.tracer import SlopeBins, trace

METAL = 1.0 + 3.0j


def index(*values: complex) -> xr.Dataset:
    """Refractive indices at wavelengths from 400 nm."""
    fields = {"n": ("wavelength", np.real(values)), "k": ("wavelength", np.imag(values))}
    wavelength = 400.0 + 100 * np.arange(len(values))
    return vocabulary.label(xr.Dataset(fields, {"wavelength": wavelength}, {"source": "test"}), "index")


BOTH = index(1.5, METAL)


@pytest.fixture(scope="module")
def rough() -> tuple[xr.Dataset, xr.Dataset, xr.Dataset]:
    """A Gaussian map of slope 0.5, its facets, and its light of a plastic and of a metal."""
    surface = samples.surface(relief_maps.gaussian(0.5, 256, 0))
    facets = estimate(surface, isotropic=True)
    return surface, facets, choose(surface, facets, index=BOTH, rays=2**14)


def quarters(theta_i: float, bins: SlopeBins, by_bin: Array) -> Array:
    """Light in the quarters of azimuth forward, beside on both sides, and back, of light by bins of the half vector's slope."""
    p, q = np.meshgrid(bins.centres, bins.centres[bins.half :])
    normal = np.stack([-p, -q, np.ones_like(p)], axis=-1) / np.sqrt(1 + p * p + q * q)[..., None]
    incident = np.array([np.sin(np.radians(theta_i)), 0.0, np.cos(np.radians(theta_i))])
    outgoing = 2 * (normal @ incident)[..., None] * normal - incident
    turn = np.degrees(np.abs(np.arctan2(outgoing[..., 1], -outgoing[..., 0])))
    return np.array([by_bin[(turn >= low) & (turn < high)].sum() for low, high in ((0, 45), (45, 135), (135, 181))])


def traced_quarters(mesh: HeightMesh, theta_i: float, material: complex, rays: int) -> tuple[Array, Array, float]:
    """Light reflected more than once, traced with Jones matrices, its standard uncertainty, and all reflected light."""
    bins = SlopeBins.of(0.07, step=0.1)
    light = trace(mesh, theta_i, index=material, bins=bins, rays=rays, seed=11)
    several = light.power.mean(axis=1)[1:].sum(axis=0)[bins.half :]
    variance = light.uncertainty[1][bins.half :] ** 2
    return (
        quarters(theta_i, bins, several),
        np.sqrt(quarters(theta_i, bins, variance)),
        float(light.reflected.mean(axis=1).sum()),
    )


def tabulated_quarters(traced: xr.Dataset, theta_i: float) -> Array:
    """The same light of the table, (quarter, wavelength)."""
    light, _, turn = SecondReflection.of(traced, traced["second_reflection"].values).light(np.array([theta_i]))
    angle = np.degrees(turn[0])
    limits = (0, 45), (45, 135), (135, 181)
    return np.stack([light[0][(angle >= low) & (angle < high)].sum(axis=0) for low, high in limits])


@pytest.mark.parametrize("theta_i", [30.0, 65.0])
def test_the_light_of_each_quarter_is_that_of_rays_with_jones_matrices(rough, theta_i):
    # Other rays on the same map.
    mesh = HeightMesh.of(rough[0])
    tabulated = tabulated_quarters(rough[2], theta_i)
    for column, material in enumerate((1.5, METAL)):
        traced, u, reflected = traced_quarters(mesh, theta_i, material, 2**16)
        seen = traced > 2e-3 * reflected
        assert seen[0]
        # Noise of 2¹⁴ rays an incidence, of which a tenth is reflected more than once.
        np.testing.assert_allclose(tabulated[seen, column], traced[seen], rtol=0.15, atol=3 * u.max())
        assert tabulated[:, column].sum() == pytest.approx(traced.sum(), rel=0.05)


def test_light_of_the_map_is_reciprocal_and_its_albedo_is_the_integral(rough):
    _, facets, traced = rough
    model = representation(build(facets, index=BOTH, multiple_scattering="measured", interreflection=traced))
    rng = np.random.default_rng(2)
    theta_i, theta_o, phi_i, phi_o = (rng.uniform(0, high, 300) for high in (89.9, 89.9, 360, 360))
    forth = model.evaluate(theta_i, phi_i, theta_o, phi_o, None)
    assert forth == pytest.approx(model.evaluate(theta_o, phi_o, theta_i, phi_i, None), rel=1e-10)
    assert forth.min() > 0
    theta = np.array([10.0, 70.0])
    integral = model.integrate(theta, np.zeros(2), None).value
    assert model.albedo(theta, np.zeros(2), None) == pytest.approx(integral, rel=5e-5)


def test_perfect_mirrors_reflect_no_more_than_they_receive(rough):
    surface, facets, _ = rough
    mirror = index(1e9, 1e9)
    traced = choose(surface, facets, index=mirror, rays=2**10)
    bsdf = build(facets, index=mirror, multiple_scattering="measured", interreflection=traced)
    albedo = representation(bsdf).albedo(np.array([0.0, 30.0, 60.0, 75.0]), np.zeros(4), None)
    assert albedo.max() <= 1 + 1e-4
    # What Smith's masking and the noise of few rays leave open.
    assert albedo.min() > 0.95


def test_the_uncertainty_covers_other_rays(rough):
    surface, facets, traced = rough
    other = choose(surface, facets, index=BOTH, rays=2**14, seed=5)
    z = (traced["second_share"] - other["second_share"]) / np.hypot(traced["second_share_u"], other["second_share_u"])
    # Blocks differ by their heights as well as by their rays.
    assert 0.05 < float(np.sqrt((z**2).mean())) < 1.3
    assert traced["second_reflection_u"].values.min() > 0


def test_a_mean_over_wavelength_has_the_mean_light(rough):
    _, facets, traced = rough
    bsdf = build(facets, index=BOTH, multiple_scattering="measured", interreflection=traced)
    reduced = representation(bsdf).nonspectral(np.array([0.25, 0.75])) if "total_reflectance" not in bsdf else None
    assert reduced is not None
    expected = bsdf["second_reflection"].values @ [0.25, 0.75]
    np.testing.assert_allclose(reduced["second_reflection"].values, expected, rtol=1e-9)


@pytest.mark.parametrize("mode", ["none", "directional", "measured", "compensated"])
def test_light_of_several_reflections_is_the_same_without_the_table_of_the_albedo(rough, mode):
    _, facets, traced = rough
    given = {"index": 1.5, "interreflection": traced, "multiple_scattering": mode}
    complete, alone = build(facets, **given), with_reflections(build(facets, **given, surface_alone=True), 8.0)
    assert ("directional_albedo" in alone) == (mode == "compensated")
    for name in ("second_reflection", "compensation"):
        assert (name in alone) == (name in complete)
        if name in alone:
            np.testing.assert_array_equal(alone[name].values, complete[name].values)


def test_another_index_scales_the_light_by_the_squared_reflectance(rough):
    _, facets, traced = rough
    bsdf = build(facets, index=BOTH, multiple_scattering="measured", interreflection=traced)
    again = build(facets, index=BOTH, multiple_scattering="measured", interreflection=interreflection_of(bsdf))
    np.testing.assert_allclose(again["second_reflection"].values, bsdf["second_reflection"].values, rtol=1e-9)
    darker = build(facets, index=index(1.4, METAL), multiple_scattering="measured", interreflection=traced)
    ratio = darker["second_reflection"].values / bsdf["second_reflection"].values
    # ((1.4 − 1)/(1.4 + 1))⁴ / ((1.5 − 1)/(1.5 + 1))⁴ at normal incidence, closer to 1 in the mean over the hemisphere.
    assert 0.48 < ratio[..., 0].max() < 0.8
    # Values are at least 1e-30 of the largest one.
    lit = bsdf["second_reflection"].values[..., 1] > 1e-20 * bsdf["second_reflection"].values.max()
    np.testing.assert_allclose(ratio[lit, 1], 1, rtol=1e-9)


def test_the_default_follows_the_map_else_smith_and_smooth_surfaces_have_none(rough):
    surface, facets, traced = rough
    assert traced.attrs["multiple_scattering"] == "measured"
    for inputs, mode, advised in (
        ({"interreflection": traced}, "measured", True),
        ({}, "directional", True),
        ({"multiple_scattering": "none"}, "none", False),
        ({"masking": "separable"}, "none", False),
        ({"masking": "blinn"}, "none", False),
        ({"diffuse": "crf"}, "none", False),
        ({"recipe": "crf"}, "none", False),
    ):
        attrs = build(facets, index=BOTH, **inputs).attrs
        assert (attrs["multiple_scattering"], MULTIPLE_SCATTERING_ADVISED in attrs) == (mode, advised), inputs
    gentle = surface.assign(height=surface["height"] / 50)
    smooth = estimate(gentle, isotropic=True)
    none = choose(gentle, smooth, index=1.5)
    assert none.attrs["multiple_scattering"] == "none"
    assert "mirrors" in none.attrs["reason"]
    assert build(smooth, index=1.5).attrs["multiple_scattering"] == "none"
    assert choose(gentle, flat(), index=1.5).attrs["reason"] == "the surface is flat"


def test_lines_and_noise_are_left_to_smiths_surface(rough):
    surface, facets, _ = rough
    line = samples.surface(surface["height"].values[0])
    chosen = choose(line, facets, index=1.5)
    assert chosen.attrs["multiple_scattering"] == "directional"
    assert "no light was traced" in chosen.attrs["reason"]
    with pytest.raises(HeightMapError, match="line profile"):
        choose(line, facets, index=1.5, multiple_scattering="measured")
    noisy = vocabulary.label(facets.assign(noise_sigma=0.2), "facets")
    with pytest.raises(HeightMapError, match="is noise"):
        choose(surface, noisy, index=1.5, multiple_scattering="measured")
    with pytest.raises(ModelError, match="give `interreflection`"):
        build(facets, index=1.5, multiple_scattering="measured")


def test_a_lay_has_its_light_by_plane():
    surface = samples.surface(relief_maps.ridges(256, 0))
    facets = estimate(surface)
    traced = choose(surface, facets, index=1.5, rays=2**14)
    table = SecondReflection.of(traced, traced["second_reflection"].values[..., None])
    mesh, lay = HeightMesh.of(surface), float(facets["lay"])
    bins = SlopeBins.of(mesh.typical_slope)
    across = LobeBins.of(bins, 60.0, lay + 90)
    several = across.total(table(60.0, lay + 90, across.theta, across.phi)[:, 0])
    light = trace(mesh, 60.0, lay + 90, index=1.5, bins=bins, rays=2**16).power.mean(axis=1)[1:].sum(axis=0).ravel()
    # Planes are 11 degree apart, and a sixteenth of the rays is incident in each.
    assert several.sum() == pytest.approx(light.sum(), rel=0.2)
    mirror_like = np.hypot(*np.meshgrid(bins.centres, bins.centres)).ravel() < 0.15
    assert several[mirror_like].sum() == pytest.approx(light[mirror_like].sum(), rel=0.3)
    assert table.albedo(np.array([60.0]), np.array([lay + 90]))[0, 0] == pytest.approx(several.sum(), rel=0.03)
    rng = np.random.default_rng(2)
    theta_i, theta_o, phi_i, phi_o = (rng.uniform(0, high, 200) for high in (89.9, 89.9, 360, 360))
    assert table(theta_i, phi_i, theta_o, phi_o) == pytest.approx(table(theta_o, phi_o, theta_i, phi_i), rel=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("slope", [0.1, 0.3, 0.6])
def test_another_map_of_the_same_surface_has_the_same_light_in_each_quarter(slope):
    surface = samples.surface(relief_maps.gaussian(slope, 1024, 0))
    traced = choose(surface, estimate(surface, isotropic=True), index=BOTH)
    other = HeightMesh.of(samples.surface(relief_maps.gaussian(slope, 1024, 1)))
    for theta_i in (0.0, 30.0, 60.0, 75.0):
        tabulated = tabulated_quarters(traced, theta_i)
        for column, material in enumerate((1.5, METAL)):
            light, u, reflected = traced_quarters(other, theta_i, material, 2**19)
            seen = (light > 1e-3 * reflected) & (u < 0.05 * light)
            np.testing.assert_allclose(tabulated[seen, column], light[seen], rtol=0.15)
