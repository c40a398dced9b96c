"""The BSDF of traced rays: its light is that of the rays, and it has the properties of every BSDF."""

from __future__ import annotations

import json
from functools import cache

import numpy as np
import pytest
import samples

from brdfpipe import vocabulary
from brdfpipe.appearance import gloss
from brdfpipe.bsdf.accessor import open_dataset
from brdfpipe.bsdf.checks import check
from brdfpipe.bsdf.microfacet.builder import build as build_microfacet
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.traced import build
from brdfpipe.facets.estimation import estimate
from brdfpipe.references.height_mesh import HeightMapError
from brdfpipe.store import save_dataset


def rough_map(sigma: float = 0.2, size: int = 128):
    return samples.gaussian_surface(size, sigma=sigma, correlation=8.0)


@cache
def traced(spectral: bool = False):
    spectrum = samples.spectrum(np.linspace(0.1, 0.5, samples.WAVELENGTH.size)) if spectral else None
    return build(rough_map(), index=1.5, spectrum=spectrum, rays=20_000)


def test_the_bsdf_reflects_the_light_that_the_rays_returned():
    bsdf = traced()
    of_rays = bsdf["reflected"].sum("order").values
    incidence = bsdf["traced_incidence"].values
    of_bsdf = representation(bsdf).albedo(incidence, np.zeros_like(incidence), None)[:, 0]
    # The mean of both directions of light smooths the noise; near grazing the bins are wide for what they hold.
    np.testing.assert_allclose(of_bsdf[:-1], of_rays[:-1], rtol=0.02)
    np.testing.assert_allclose(of_bsdf[-1], of_rays[-1], rtol=0.1)


def test_the_account_of_the_light_is_complete():
    bsdf = traced()
    total = bsdf["reflected"].sum("order") + bsdf["refracted"].sum("order") + bsdf["lost"]
    np.testing.assert_allclose(total, 1, atol=1e-12)


def test_it_agrees_with_counted_facets_where_light_is_reflected_once():
    bsdf, facet_model = (
        traced(),
        build_microfacet(estimate(rough_map(), isotropic=True), index=1.5, multiple_scattering="none"),
    )
    theta_o = np.array([0.0, 10.0, 20.0, 30.0])
    angles = np.full_like(theta_o, 10.0), np.zeros(4), theta_o, np.full_like(theta_o, 180.0)
    once = representation(representation(bsdf).single_reflection())
    values, predicted = (model.evaluate(*angles, None)[:, 0] for model in (once, representation(facet_model)))
    uncertainty = representation(bsdf).uncertainty(*angles, None)[:, 0]
    assert (uncertainty < 0.4 * values).all()
    # The facet model smooths the same noise of a small map.
    assert np.all(np.abs(values - predicted) < 3 * uncertainty)


def test_all_checks_pass():
    verdicts = json.loads(check(traced()).attrs["verdicts"])
    assert {entry["verdict"] for entry in verdicts.values()} == {"pass"}, verdicts


def test_the_total_reflectance_is_that_of_the_spectrum():
    bsdf = traced(spectral=True)
    reflectance = representation(bsdf).albedo(np.array([8.0]), np.zeros(1), None)[0]
    np.testing.assert_allclose(reflectance, bsdf["total_reflectance"], rtol=1e-9)
    integrated = representation(bsdf).integrate(np.array([45.0]), np.zeros(1), np.array([550.0]))
    closed = representation(bsdf).albedo(np.array([45.0]), np.zeros(1), np.array([550.0]))
    assert integrated.value[0, 0] == pytest.approx(closed[0, 0], abs=1e-3)


def test_samples_have_the_density_they_state():
    drawn = representation(traced()).sample(4000, 1, 30.0, 0.0, None)
    reflectance = representation(traced()).albedo(np.array([30.0]), np.zeros(1), None)[0, 0]
    mean_u = drawn["weight"].std() / np.sqrt(4000)
    assert abs(float(drawn["weight"].mean()) - reflectance) < 4 * float(mean_u) + 1e-4


def test_it_is_stored_and_read_and_has_gloss(tmp_path):
    save_dataset(traced(), tmp_path / "traced.nc", stage="predicted", material="test")
    again = open_dataset(tmp_path / "traced.nc")
    np.testing.assert_array_equal(gloss(again, [60]).values, gloss(traced(), [60]).values)


def test_the_same_seed_gives_the_same_bytes():
    one, other = (build(rough_map(size=32), index=1.5, rays=64, seed=3, threads=threads) for threads in (1, 2))
    assert one.identical(other)


@pytest.mark.slow
def test_stated_uncertainty_is_the_scatter_of_maps_of_one_surface():
    maps = [samples.gaussian_surface(96, sigma=0.2, correlation=6.0, seed=seed) for seed in range(8)]
    datasets = [build(one, index=1.5, rays=4096) for one in maps]
    angles = np.full(5, 30.0), np.zeros(5), np.array([10.0, 20.0, 30.0, 40.0, 50.0]), np.full(5, 180.0)
    values = [representation(one).evaluate(*angles, None)[:, 0] for one in datasets]
    stated = [representation(one).uncertainty(*angles, None)[:, 0] for one in datasets]
    ratio = np.sqrt(np.mean(np.square(stated)) / np.mean(np.var(values, axis=0, ddof=1)))
    # Eight maps know their scatter to a quarter; interpolation between nodes averages some noise.
    assert 0.7 < ratio < 2.2


def test_a_metal_keeps_its_colour_at_every_reflection():
    index = samples_index(np.array([400.0, 550.0, 700.0]), n=[1.4, 0.4, 0.2], k=[1.9, 2.4, 3.8])
    bsdf = build(rough_map(0.4, 64), index=index, rays=4096)
    values = representation(bsdf).evaluate(*np.array([[60.0], [0.0], [70.0], [180.0]]), None)[0]
    assert values.shape == (3,)
    assert values[0] < values[1] < values[2]


def samples_index(wavelength, n, k):
    import xarray as xr

    index = xr.Dataset({"n": ("wavelength", n), "k": ("wavelength", k)}, {"wavelength": wavelength}, {"source": "test"})
    return vocabulary.label(index, "index")


def test_a_lay_and_missing_heights_are_reported():
    surface = rough_map(0.6, 64)
    height = surface["height"].values
    brushed = samples.surface(np.repeat(height[::4], 4, axis=0)[:64], (1.0, 1.0))
    brushed["height"][::6, ::6] = np.nan
    warnings = vocabulary.warnings(build(brushed, index=1.5, rays=640))
    assert any("does not show the lay" in text for text in warnings)
    assert any("lost on missing heights" in text for text in warnings)


def test_steps_of_quantised_heights_are_reported():
    height = rough_map(0.1, 64)["height"].values
    warnings = vocabulary.warnings(build(samples.surface(np.round(height / 0.05) * 0.05), index=1.5, rays=640))
    assert any("heights are quantised" in text for text in warnings)


def test_a_flat_surface_is_refused():
    with pytest.raises(HeightMapError, match="perfectly flat"):
        build(samples.surface(np.zeros((32, 32))), index=1.5)
