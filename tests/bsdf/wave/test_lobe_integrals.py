"""The integrals over a lobe by compiled code, against sums of what the surface reflects into single directions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mirror_halo import halo_of_mirrors

from brdfpipe import facets, psd
from brdfpipe.bsdf import wave
from brdfpipe.bsdf.microfacet import evaluation_kernel
from brdfpipe.bsdf.wave import halo_kernel
from brdfpipe.bsdf.wave.builder import ENERGY_NODES, _closure_corners, _directions
from brdfpipe.bsdf.wave.lobe_integrals import LobeIntegrals
from brdfpipe.bsdf.wave.two_scale import RoughSurface
from brdfpipe.optics.index import refractive_index


@pytest.fixture(params=["isotropic", "ghs", "metal", "finer roughness"], scope="module")
def built(request):
    """A surface that passes from waves to facets."""
    options = {"ghs": {"form": "ghs"}, "finer roughness": {"cut": 0.3}}.get(request.param, {})
    index = refractive_index({"n": 1.2, "k": 4.0}) if request.param == "metal" else 1.5
    roughness = psd.analytic("gaussian", sigma=0.4, length=4.0)
    given = facets.analytic("beckmann", a=0.2)
    return wave.build(roughness, facets=given, index=index, optics="auto", wavelength=[450.0, 550.0, 650.0], **options)


@pytest.mark.parametrize("theta", [0.0, 40.0, 80.0, 89.9])
def test_the_sums_are_those_of_single_directions(built, theta):
    surface, count = RoughSurface.of(built), built.sizes["closure_incidence"]
    wavelength, n, k = (built[name].values for name in ("wavelength", "n", "k"))
    (weight, angles), *_ = _directions(built, np.zeros(1), ENERGY_NODES)(theta)
    corners = _closure_corners(built, angles, count, 1)
    found = LobeIntegrals(surface, wavelength, n, k, count)(weight, angles, corners, closes=True, scatters=True)

    mirrors = halo_of_mirrors(surface, angles, wavelength)
    np.testing.assert_allclose(found.first_order, weight @ mirrors[..., 2], rtol=1e-10)
    by_node = np.zeros((count, wavelength.size))
    for node, share in zip(*(part.T for part in corners), strict=True):
        np.add.at(by_node, node, (share * weight)[:, None] * mirrors[..., :2].sum(axis=-1))
    np.testing.assert_allclose(found.mirror, by_node, rtol=1e-10, atol=1e-14)
    # The factors of the closure are linear in those of the nodes.
    assert surface.closure is not None
    factors = built["halo_closure"].values
    of_incidence = surface.closure.of_halo(np.cos(np.radians([theta])), np.zeros(1), wavelength)[0]
    expected = weight @ surface.evaluate(angles, wavelength, n, k)
    both = of_incidence * (factors * found.halo).sum(axis=0) + found.facets
    np.testing.assert_allclose(both, expected, rtol=1e-10)
    assert found.halo.max() > 0
    assert found.facets.max() > 0


def test_a_part_of_the_sums_is_that_of_all(built):
    surface, count = RoughSurface.of(built), built.sizes["closure_incidence"]
    integrals = LobeIntegrals(surface, *(built[name].values for name in ("wavelength", "n", "k")), count)
    (weight, angles), *_ = _directions(built, np.zeros(1), ENERGY_NODES)(60.0)
    corners = _closure_corners(built, angles, count, 1)
    both = integrals(weight, angles, corners, closes=True, scatters=True)
    closing, scattering = (integrals(weight, angles, corners, **{part: True}) for part in ("closes", "scatters"))
    np.testing.assert_array_equal(closing.mirror, both.mirror)
    np.testing.assert_array_equal(scattering.facets, both.facets)
    np.testing.assert_array_equal(scattering.halo, both.halo)
    without = replace(integrals, wavelength=integrals.wavelength[:1], n=integrals.n[:1], k=integrals.k[:1])
    np.testing.assert_allclose(
        without(weight, angles, corners, scatters=True).halo[:, 0], both.halo[:, 0], rtol=1e-12, atol=1e-16
    )


def test_where_facets_reflect_all_light_the_halo_has_none(built):
    surface = replace(RoughSurface.of(built), facet_sigma=1e3)
    wavelength, n, k = (built[name].values for name in ("wavelength", "n", "k"))
    (weight, angles), *_ = _directions(built, np.zeros(1), ENERGY_NODES)(20.0)
    node, share = _closure_corners(built, angles, built.sizes["closure_incidence"], 1)
    pair = evaluation_kernel.half_vectors(*angles)
    lobe = halo_kernel.Lobe(surface.compiled_pairs(pair, angles), weight, node, share)
    body = surface.compiled_body(pair, angles, wavelength, n, k)
    assert (body.facet_share == 1).all()
    if not body.polarisation.size:
        # Compiled code that reads beyond an array finds what is there in memory.
        body = body._replace(polarisation=np.full(body.facet_share.shape, np.nan)[:0])
    sums = halo_kernel.lobe_sums(
        lobe, *surface.order_tables, wavelength, built.sizes["closure_incidence"], body, closes=True, generalised=False
    )
    np.testing.assert_array_equal(sums.halo, 0)
    assert np.isfinite(sums.facets).all()
    assert sums.facets.min() > 0
