"""Kirchhoff's diffraction integral on height maps, against the series of a Gaussian surface and conservation of energy."""

from __future__ import annotations

import numpy as np
import pytest
import samples
from scipy.interpolate import CubicSpline
from scipy.special import gammaln

from brdfpipe.references.height_mesh import HeightMapError
from brdfpipe.references.phase_spectrum import phase_spectrum

LENGTH, PITCH = 5.0, 0.5
"""Correlation length and pitch [um]"""
WAVELENGTH = 0.55


def gaussian_map(sigma: float, seed: int = 1, size: int = 512):
    """A periodic map of rms height ``sigma`` [um] and correlation exp(−r²/ℓ²)."""
    surface = samples.gaussian_surface(size, correlation=LENGTH / PITCH, seed=seed)
    height = surface["height"].values
    return samples.surface(height / height.std() * sigma, pitch=(PITCH, PITCH))


def series(phase: float, sigma: float, frequency):
    """Spectrum U [um2] of the field of an infinite Gaussian surface (Beckmann & Spizzichino 1963, ch. 5)."""
    g = (phase * sigma) ** 2
    m = np.arange(1, int(g + 8 * np.sqrt(g) + 16))[:, None]
    logarithm = m * np.log(g) - gammaln(m + 1) - np.log(m) - (np.pi * LENGTH * frequency) ** 2 / m
    return np.exp(-g) * np.pi * LENGTH**2 * np.exp(logarithm).sum(axis=0)


def lobe_light(found, row: int) -> float:
    """∫ U d²f [1]."""
    frequency = np.linspace(0, found.frequency[-1], 20_001)
    values = np.exp(CubicSpline(found.frequency, np.log(found.spectrum[row]))(frequency))
    return float(np.trapezoid(2 * np.pi * frequency * values, frequency))


@pytest.mark.parametrize(
    ("sigma", "seeds"),
    [
        (0.05, 3),
        pytest.param(0.013, 6, marks=pytest.mark.slow),
        pytest.param(0.12, 6, marks=pytest.mark.slow),
        pytest.param(0.4, 6, marks=pytest.mark.slow),
    ],
)
def test_the_spectrum_of_gaussian_maps_is_the_series(sigma, seeds):
    found = [phase_spectrum(gaussian_map(sigma, seed), 4 * np.pi / WAVELENGTH) for seed in range(seeds)]
    frequency = found[0].frequency
    for row in (0, found[0].phase.size // 2, -1):
        expected = series(found[0].phase[row], sigma, frequency)
        # Where the spectrum falls steeply, a ring of 5 % holds more than its middle; near the highest frequency the field is undersampled.
        compared = (expected > 0.05 * expected[0]) & (frequency > 0.02) & (frequency < 0.6 * frequency[-1])
        ratio = np.mean([one.spectrum[row] / expected for one in found], axis=0)[compared]
        stated = np.sqrt(np.mean([one.relative_u[row] ** 2 for one in found], axis=0) / seeds)[compared]
        np.testing.assert_allclose(ratio.mean(), 1, atol=0.03)
        assert np.sqrt(np.mean(((ratio - 1) / stated) ** 2)) < 2


def test_coherent_and_diffracted_light_are_all_the_light():
    found = phase_spectrum(gaussian_map(0.05), 4 * np.pi / WAVELENGTH)
    for row in range(found.phase.size):
        assert lobe_light(found, row) + found.coherent[row] == pytest.approx(1, abs=0.01)


def test_the_coherent_share_falls_with_the_variance_of_the_phase():
    for sigma in (0.013, 0.08):
        found = phase_spectrum(gaussian_map(sigma), 4 * np.pi / WAVELENGTH)
        # A map of 3000 independent patches of heights has a share that scatters by 2 %.
        np.testing.assert_allclose(found.coherent, np.exp(-((found.phase * sigma) ** 2)), rtol=0.05, atol=2e-3)


def test_a_rough_map_has_no_coherent_light_by_chance():
    assert phase_spectrum(gaussian_map(0.4), 4 * np.pi / WAVELENGTH).coherent[-1] < 1e-4


def test_light_spreads_as_by_facets_where_the_phase_varies_much():
    # Stationary phase: U → (2π/q)² P22(p) at the slope p = 2π f/q.
    sigma = 0.4
    found = phase_spectrum(gaussian_map(sigma), 4 * np.pi / WAVELENGTH)
    slope = np.sqrt(2) * sigma / LENGTH
    at = 2 * np.pi * found.frequency / found.phase[-1]
    facets = (2 * np.pi / found.phase[-1]) ** 2 * np.exp(-(at**2) / (2 * slope**2)) / (2 * np.pi * slope**2)
    compared = (found.frequency > 0.05) & (at < 1.5 * slope)
    assert np.mean(found.spectrum[-1, compared] / facets[compared]) == pytest.approx(1, abs=0.05)  # one map


def test_patches_with_missing_heights_are_left_out():
    surface = gaussian_map(0.05)
    surface["height"][100:110, 200:230] = np.nan
    found = phase_spectrum(surface, 4 * np.pi / WAVELENGTH)
    assert found.coherent[-1] == pytest.approx(np.exp(-((found.phase[-1] * 0.05) ** 2)), rel=0.1)


def test_unusable_maps_are_refused():
    with pytest.raises(HeightMapError, match=r"more than π between .* trace rays"):
        phase_spectrum(samples.gaussian_surface(128, sigma=0.3), 4 * np.pi / WAVELENGTH)
    with pytest.raises(HeightMapError, match="perfectly flat"):
        phase_spectrum(samples.surface(np.zeros((128, 128))), 20.0)
    holes = gaussian_map(0.05, size=128)
    holes["height"][::16, ::16] = np.nan
    with pytest.raises(HeightMapError, match="without gaps, and two are needed"):
        phase_spectrum(holes, 20.0)


@pytest.mark.parametrize("sigma", [5e-4, 2e-3, 6e-3])
def test_a_polished_surface_keeps_its_light_in_the_mirror_direction(sigma):
    found = phase_spectrum(gaussian_map(sigma, size=128), 4 * np.pi / WAVELENGTH)
    # Enough nodes for the splines of its BSDF.
    assert found.phase.size >= 5
    assert found.coherent == pytest.approx(np.exp(-((found.phase * sigma) ** 2)), abs=2e-3)
