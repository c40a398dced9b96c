"""Kirchhoff's diffraction integral on height maps, against the series of a Gaussian surface and conservation of energy."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import random_surfaces
import samples
from scipy.integrate import cumulative_trapezoid
from scipy.special import gammaln, jv

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


@cache
def spectrum_of(sigma: float, seed: int = 1):
    """That of a map of 512² heights up to normal incidence."""
    return phase_spectrum(gaussian_map(sigma, seed), 4 * np.pi / WAVELENGTH)


def series(phase: float, sigma: float, frequency, length: float = LENGTH):
    """Spectrum U [um2] of the field of an infinite Gaussian surface (Beckmann & Spizzichino 1963, ch. 5)."""
    g = (phase * sigma) ** 2
    m = np.arange(1, int(g + 8 * np.sqrt(g) + 16))[:, None]
    logarithm = m * np.log(g) - gammaln(m + 1) - np.log(m) - (np.pi * length * frequency) ** 2 / m
    return np.exp(-g) * np.pi * length**2 * np.exp(logarithm).sum(axis=0)


def light_within(found, row: int, frequency=np.inf):
    """∫ U d²f [1] within a frequency, by default all; the spectrum is linear between the rings."""
    fine = np.linspace(0, found.frequency[-1], 50_001)
    number = [np.arcsinh(one / found.frequency_scale) for one in (fine, found.frequency)]
    values = np.interp(*number, found.spectrum[row])
    return np.interp(frequency, fine, cumulative_trapezoid(2 * np.pi * fine * values, fine, initial=0))


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
    found = [spectrum_of(sigma, seed) for seed in range(seeds)]
    frequency = found[0].frequency
    for row in (0, found[0].phase.size // 2, -1):
        expected = series(found[0].phase[row], sigma, frequency)
        # Where the spectrum falls steeply, a ring of 5 % holds more than its middle; near the highest frequency the field is undersampled.
        compared = (expected > 0.05 * expected[0]) & (frequency > 0.02) & (frequency < 0.6 * frequency[-1])
        # The rings of another map may be closer.
        single, single_u = (
            [np.interp(frequency, one.frequency, getattr(one, name)[row]) for one in found]
            for name in ("spectrum", "relative_u")
        )
        ratio = np.mean(single / expected, axis=0)[compared]
        stated = np.sqrt(np.mean(np.square(single_u), axis=0) / seeds)[compared]
        np.testing.assert_allclose(ratio.mean(), 1, atol=0.03)
        assert np.sqrt(np.mean(((ratio - 1) / stated) ** 2)) < 2


def test_the_spectrum_has_no_step_between_the_mirrored_and_the_faded_field():
    # From 8 to 24 waves along 256 um.
    ratios = []
    for one in [spectrum_of(0.05, seed) for seed in range(3)]:
        ratio, waves = one.spectrum[-1] / series(one.phase[-1], 0.05, one.frequency), one.frequency * 256
        bands = ((4, 8), (8, 14), (14, 24), (24, 40))
        ratios.append([ratio[(waves >= low) & (waves < high)].mean() for low, high in bands])
    np.testing.assert_allclose(np.mean(ratios, axis=0), 1, atol=0.06)


def test_coherent_and_diffracted_light_are_all_the_light():
    found = spectrum_of(0.05)
    for row in range(found.phase.size):
        assert light_within(found, row) + found.coherent[row] == pytest.approx(1, abs=0.01)
    # The sum is 1 by scaling, which adds next to nothing.
    np.testing.assert_allclose(found.scaling, 1, atol=0.01)


def test_the_coherent_share_falls_with_the_variance_of_the_phase():
    for sigma in (0.013, 0.08):
        found = spectrum_of(sigma)
        # A map of 3000 independent patches of heights has a share that scatters by 2 %.
        np.testing.assert_allclose(found.coherent, np.exp(-((found.phase * sigma) ** 2)), rtol=0.05, atol=2e-3)


def test_a_rough_map_has_no_coherent_light_by_chance():
    assert spectrum_of(0.4).coherent[-1] < 1e-4


def test_light_spreads_as_by_facets_where_the_phase_varies_much():
    # Stationary phase: U → (2π/q)² P22(p) at the slope p = 2π f/q.
    sigma = 0.4
    found = spectrum_of(sigma)
    slope = np.sqrt(2) * sigma / LENGTH
    at = 2 * np.pi * found.frequency / found.phase[-1]
    facets = (2 * np.pi / found.phase[-1]) ** 2 * np.exp(-(at**2) / (2 * slope**2)) / (2 * np.pi * slope**2)
    compared = (found.frequency > 0.05) & (at < 1.5 * slope)
    assert np.mean(found.spectrum[-1, compared] / facets[compared]) == pytest.approx(1, abs=0.05)  # one map


def orders_of_light(found, period: float):
    """Light of the orders 0, ±1, ±2, … at the largest q, with the coherent light in the first."""
    light = np.diff(light_within(found, -1, (np.arange(6) + 0.5) / period), prepend=0.0)
    return light + found.coherent[-1] * (np.arange(6) == 0)


@pytest.mark.parametrize("period", [128 / 7.3, 128 / 3], ids=["seven waves", "three waves"])
@pytest.mark.parametrize("azimuth", [0.0, 30.0])
def test_a_grating_diffracts_into_the_orders_of_bessel(period, azimuth):
    x, angle = np.arange(128) + 0.5, np.radians(azimuth)
    along = x * np.cos(angle) + x[:, None] * np.sin(angle)
    height = 0.1 * np.sin(2 * np.pi * along / period + 0.7)
    found = phase_spectrum(samples.surface(height), 4 * np.pi / WAVELENGTH)
    order = np.arange(6)
    expected = np.where(order > 0, 2, 1) * jv(order, found.phase[-1] * 0.1) ** 2
    # A map of few waves is no whole number of them.
    np.testing.assert_allclose(orders_of_light(found, period), expected, atol=0.03)
    assert light_within(found, -1) + found.coherent[-1] == pytest.approx(1, abs=1e-3)
    np.testing.assert_allclose(found.scaling, 1, atol=0.02)


@pytest.mark.parametrize("depth", [0.15, 0.25])
def test_leaning_ridges_diffract_into_the_orders_of_a_blazed_grating(depth):
    # The mirror image leans to the other side; the mean over azimuth is the same.
    ridges = depth * (np.arange(256) / 32 % 1 - 0.5)
    found = phase_spectrum(samples.surface(np.tile(ridges, (256, 1)), (0.5, 0.5)), 4 * np.pi / WAVELENGTH)
    blaze, order = found.phase[-1] * depth / (2 * np.pi), np.arange(6)
    expected = np.where(order > 0, 1, 0.5) * (np.sinc(blaze - order) ** 2 + np.sinc(blaze + order) ** 2)
    np.testing.assert_allclose(orders_of_light(found, 16.0), expected, atol=0.035)


def test_light_of_waves_a_third_of_the_map_long_is_the_series():
    # The rms frequency of the heights is 1/(π 7 µm), on maps of 64 µm.
    sigma, length, maps = 0.14, 7.0, 12
    spectrum = random_surfaces.gaussian(sigma, length)
    heights = [random_surfaces.heights(spectrum, (128, 128), (PITCH, PITCH), seed) for seed in range(maps)]
    found = [phase_spectrum(samples.surface(height, (PITCH, PITCH)), 4 * np.pi / WAVELENGTH) for height in heights]
    fine = np.linspace(0, 0.6, 3001)
    for incidence in (20, 60, 85):
        wanted = 4 * np.pi / WAVELENGTH * np.cos(np.radians(incidence))
        light, expected = [], []
        np.testing.assert_allclose([one.scaling[[0, -1]] for one in found], 1, atol=0.06)
        for one in found:
            row = int(np.argmin(np.abs(one.phase - wanted)))
            lobe = 2 * np.pi * fine * series(one.phase[row], sigma, fine, length)
            halo = cumulative_trapezoid(lobe, fine, initial=0)
            within = np.interp(np.array([0.25, 0.5, 0.75]) * halo[-1], halo, fine)
            light.append(light_within(one, row, within) + one.coherent[row])
            expected.append(np.interp(within, fine, halo) + np.exp(-((one.phase[row] * sigma) ** 2)))
        error = np.array(light) - expected
        noise = error.std(axis=0, ddof=1) / np.sqrt(maps)
        assert (noise < 0.06 * np.mean(expected, axis=0)).all()
        assert (np.abs(error.mean(axis=0)) < 2.5 * noise).all()


def test_blocks_with_missing_heights_are_left_out():
    surface = gaussian_map(0.05)
    surface["height"][100:110, 200:230] = np.nan
    found = phase_spectrum(surface, 4 * np.pi / WAVELENGTH)
    assert found.coherent[-1] == pytest.approx(np.exp(-((found.phase[-1] * 0.05) ** 2)), rel=0.1)


def test_no_group_of_blocks_changes_a_ring_by_more_than_its_light():
    # The first ring of a block holds one mode, and the mirror image takes more from it here than there is.
    height = random_surfaces.heights(random_surfaces.gaussian(0.013, 5.0), (256, 256), (0.5, 0.5), 303)
    found = phase_spectrum(samples.surface(height, (0.5, 0.5)), 4 * np.pi / WAVELENGTH)
    assert np.abs(found.changes).max() < 1


@pytest.mark.parametrize(
    ("size", "missing"), [(256, 0.003), (256, 0.01), pytest.param(1024, 5e-4, marks=pytest.mark.slow)]
)
def test_isolated_missing_heights_leave_the_light_of_the_complete_map(size, missing):
    # No eighth of the map is complete.
    surface = gaussian_map(0.03, size=size)
    complete = phase_spectrum(surface, 4 * np.pi / WAVELENGTH)
    surface["height"].values[np.random.default_rng(1).random((size, size)) < missing] = np.nan
    found = phase_spectrum(surface, 4 * np.pi / WAVELENGTH)
    np.testing.assert_allclose(found.coherent, complete.coherent, atol=2e-3)
    np.testing.assert_allclose(found.scaling, complete.scaling, atol=0.01)
    assert (found.relative_u > 0).all()
    assert np.isfinite(found.relative_u).all()
    for within in (0.02, 0.1):
        light, expected = (light_within(one, -1, within) for one in (found, complete))
        # Missing heights scatter as much light as they are, everywhere.
        assert light == pytest.approx(expected, abs=0.02 * expected + missing)


def test_unusable_maps_are_refused():
    with pytest.raises(HeightMapError, match=r"more than π between .* trace rays"):
        phase_spectrum(samples.gaussian_surface(128, sigma=0.3), 4 * np.pi / WAVELENGTH)
    with pytest.raises(HeightMapError, match="perfectly flat"):
        phase_spectrum(samples.surface(np.zeros((128, 128))), 20.0)
    with pytest.raises(HeightMapError, match="perfectly flat"):
        # Levelling it leaves rounding.
        phase_spectrum(samples.surface(np.tile(np.linspace(0, 0.2, 128), (128, 1))), 20.0)
    holes = gaussian_map(0.05, size=128)
    holes["height"][::16, ::16] = np.nan
    with pytest.raises(HeightMapError, match="without gaps, and two are needed"):
        phase_spectrum(holes, 20.0)
    corner = gaussian_map(0.05, size=128)
    corner["height"][16:] = np.nan
    corner["height"][:, 40:] = np.nan
    with pytest.raises(HeightMapError, match="measured in 3 of 64 parts of the map"):
        phase_spectrum(corner, 20.0)


@pytest.mark.parametrize("sigma", [5e-4, 2e-3, 6e-3])
def test_a_polished_surface_keeps_its_light_in_the_mirror_direction(sigma):
    found = phase_spectrum(gaussian_map(sigma, size=128), 4 * np.pi / WAVELENGTH)
    # Enough nodes for the splines of its BSDF.
    assert found.phase.size >= 5
    assert found.coherent == pytest.approx(np.exp(-((found.phase * sigma) ** 2)), abs=2e-3)


@pytest.mark.parametrize("sigma", [1e-4, 1e-5, 1e-6])
def test_the_light_that_the_smoothest_maps_scatter_is_their_mean_square_phase(sigma):
    # Of one surface, higher and lower: what is not coherent is proportional to its mean square height.
    found, rougher = (phase_spectrum(gaussian_map(one, size=128), 4 * np.pi / WAVELENGTH) for one in (sigma, 1e-3))
    lost, expected = ((1 - one.coherent) / np.square(one.phase) for one in (found, rougher))
    np.testing.assert_allclose(lost / expected, (sigma / 1e-3) ** 2, rtol=1e-3)
    np.testing.assert_allclose(found.scaling, rougher.scaling, rtol=1e-3)
