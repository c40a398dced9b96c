"""The compiled halo: its table, its polarisation factor and its half vectors, against the arrays of numpy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from brdfpipe.bsdf.microfacet import evaluation_kernel
from brdfpipe.bsdf.wave import halo_kernel, two_scale
from brdfpipe.bsdf.wave.halo import Halo, Stretch, amplitudes, polarisation_factor
from brdfpipe.bsdf.wave.two_scale import RoughSurface
from brdfpipe.geometry import HalfVector, half_vector


def directions(count: int = 400) -> tuple[np.ndarray, ...]:
    """Random pairs above the horizon, and some in the mirror direction and near grazing."""
    random = np.random.default_rng(2)
    theta = np.degrees(np.arccos(1 - random.random((2, count))))
    phi = random.uniform(-360, 360, (2, count))
    theta[:, :4], phi[:, :4] = [[0, 30, 89.9, 89.999], [0, 30, 89.9, 5]], [[0, 10, 0, 50], [0, 190, 180, 0]]
    return theta[0], phi[0], theta[1], phi[1]


def halo(form: str, stretch: Stretch | None) -> Halo:
    """A table of random coefficients, the last frequency of which many pairs exceed."""
    shape = (9, 12) if stretch is None else (9, 12, 14)
    spline = np.random.default_rng(3).normal(size=shape)
    return Halo(0.02, form, spline, -3.0, 0.4, 0.05, 0.25, None, stretch)


@pytest.mark.parametrize("form", ["ssa1", "rayleigh-rice"])
@pytest.mark.parametrize("stretch", [None, Stretch(30.0, 1.5)])
def test_the_table_is_read_as_by_scipy(form, stretch):
    numpy_halo, angles = halo(form, stretch), directions()
    pair, azimuths, wavelength = half_vector(*angles), (angles[1], angles[3]), np.array([400.0, 550.0, 700.0])
    expected = numpy_halo.strength(pair, azimuths, wavelength)
    found = replace(numpy_halo, compiled=True).strength(pair, azimuths, wavelength)
    # Half of the pairs are beyond the last frequency, where the table goes on as its mirror image.
    assert ((np.sqrt(pair.slope_squared) * (pair.cos_i + pair.cos_o) / 0.55) > 0.05 * np.sinh(0.25 * 11)).mean() > 0.5
    np.testing.assert_allclose(found, expected, rtol=1e-11)


@pytest.mark.parametrize("k", [0.0, 0.01, 3.0])
def test_the_polarisation_factor_is_that_of_the_amplitudes(k):
    angles, n = directions(), np.array([1.0, 1.3, 1.5, 2.5])
    n, k = (n, np.full(4, k)) if k < 1 else (np.append(n, 0.3), np.full(5, k))
    pair, azimuth = half_vector(*angles), angles[3] - angles[1]
    found = polarisation_factor(pair, azimuth, n, k, compiled=True)
    np.testing.assert_allclose(found, amplitudes(pair, azimuth, n, k).mean, rtol=1e-12, atol=1e-16)


@pytest.mark.parametrize("slope", [0.1, 0.3, 0.5])
def test_the_compiled_share_of_facets_is_that_of_numpy(slope):
    surface = RoughSurface(halo("ssa1", None), None, 0.3, slope, passage=10.0)
    cosines, wavelength = np.append(np.linspace(1e-6, 2.0, 50), 1e-12), np.array([400.0, 550.0, 700.0])
    found = halo_kernel.facet_share(surface.passage_of_pairs, cosines, wavelength)
    expected = two_scale.facet_share_at(0.3, slope, 10.0, cosines, wavelength)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14)
    assert 0 == found.min() < found.max() == 1


def test_compiled_half_vectors_are_those_of_numpy():
    angles = directions()
    for name, found, expected in zip(
        HalfVector._fields, evaluation_kernel.half_vectors(*angles), half_vector(*angles), strict=True
    ):
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-16, err_msg=name)


def test_many_values_are_those_of_few(monkeypatch):
    surface = RoughSurface(halo("ssa1", None), None, 0.0, 0.0)
    arguments = directions(), np.array([550.0]), np.array([1.5]), np.zeros(1)
    few = surface.evaluate(*arguments)
    monkeypatch.setattr(two_scale, "MANY_VALUES", 1)
    np.testing.assert_allclose(surface.evaluate(*arguments), few, rtol=1e-11)
