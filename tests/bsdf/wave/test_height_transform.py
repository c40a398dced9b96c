"""Transforms of the phases of a surface: series against Hankel transforms and against arithmetic of 40 digits."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
from scipy.fft import fht, fhtoffset
from scipy.interpolate import CubicSpline
from scipy.ndimage import map_coordinates
from scipy.special import j0

from brdfpipe import hemisphere
from brdfpipe.bsdf.wave import height_transform
from brdfpipe.bsdf.wave.halo import Halo
from brdfpipe.bsdf.wave.height_transform import gaussian, k_correlation

FREQUENCY = np.concatenate([[0.0], np.geomspace(1e-3, 5.0, 60)])
LENGTH = 5.0
CORRELATIONS = {
    "gaussian": (gaussian(LENGTH), lambda r: np.exp(-((r / LENGTH) ** 2))),
    "exponential": (k_correlation(LENGTH, 3.0), lambda r: np.exp(-r / LENGTH)),
}


@pytest.mark.parametrize("name", CORRELATIONS)
@pytest.mark.parametrize("g", [1e-6, 0.09, 3.0, 60.0, 900.0])
def test_a_series_is_the_hankel_transform(name, g):
    series, of_distance = CORRELATIONS[name]
    by_transform = series._replace(form="any", of_distance=of_distance)
    expected = height_transform._by_series(series, g, FREQUENCY)
    found = height_transform._by_hankel_transform(by_transform, np.array([g]), FREQUENCY)[0]
    error = np.abs(np.exp(found) - np.exp(expected)) / np.exp(expected.max())
    assert error.max() < (1e-6 if g < 100 else 2e-5)


def test_the_series_has_the_values_of_forty_digits():
    mpmath = pytest.importorskip("mpmath")
    mpmath.mp.dps = 40
    g, f = mpmath.mpf("0.0874"), mpmath.mpf("0.25")
    length = mpmath.mpf(5)

    def order(m: int, name: str) -> mpmath.mpf:
        if name == "gaussian":
            of_power = mpmath.pi * length**2 / m * mpmath.exp(-((mpmath.pi * length * f) ** 2) / m)
        else:
            of_power = (
                2 * mpmath.pi * (length / m) ** 2 / (1 + (2 * mpmath.pi * length * f / m) ** 2) ** mpmath.mpf(1.5)
            )
        return mpmath.exp(-g) * g ** (m - 1) / mpmath.factorial(m) * of_power

    for name, (series, _) in CORRELATIONS.items():
        expected = float(mpmath.fsum(order(m, name) for m in range(1, 80)))
        assert np.exp(height_transform._by_series(series, float(g), np.array([float(f)])))[0] == pytest.approx(
            expected, rel=1e-13
        )


@pytest.mark.parametrize("slope", [2.5, 3.0, 4.5])
def test_the_autocorrelation_of_a_spectrum_is_the_closed_one(slope):
    closed = k_correlation(LENGTH, slope)
    assert closed.of_distance is not None
    distance = LENGTH * np.exp((np.arange(8192) - 4095.5) * 20 * np.log(10) / 8192)
    middle = (distance > 1e-2 * LENGTH) & (distance < 20 * LENGTH)
    found = height_transform._autocorrelation(closed._replace(of_distance=None), distance)
    # The spectrum of slope 2.5 falls slowly: the logarithmic transform misses 1e-4 of its fine end.
    assert found[middle] == pytest.approx(closed.of_distance(distance)[middle], abs=2e-4 if slope < 3 else 1e-6)


def test_a_measured_spectrum_is_continued_by_its_fitted_form():
    truth = k_correlation(LENGTH, 3.5)
    frequency = np.geomspace(0.0002, 0.6, 200)
    found, sigma = height_transform.measured(frequency, 1e-4 * truth.spectrum(frequency), truth)
    assert sigma == pytest.approx(1e-2, rel=1e-4)
    everywhere = np.geomspace(0.0002, 50, 200)
    # Linear between logarithms of 200 values.
    assert found.spectrum(everywhere) == pytest.approx(truth.spectrum(everywhere), rel=2e-3)
    table = height_transform.tabulated(found, 0.1, 4.0)
    asked = table["halo_frequency"].values
    # Below its first frequency the spectrum falls to 0, and light of higher orders alone is left.
    inside = (asked > frequency[0]) & (asked < 4.0)
    expected = height_transform.log_transform(truth, table["phase_variance"].values, asked[inside])
    assert np.abs(table["log_halo"].values[:, inside] - expected).max() < 3e-3


def test_a_smooth_surface_ends_where_its_gaussian_form_is_below_all_numbers():
    # exp(−(π · 20 · 0.5)²) is below 1e-428; the window of the measurement leaves 1e-12 of the peak there.
    truth, frequency = gaussian(20.0), np.geomspace(0.0005, 0.5, 400)
    floor = 1e-12 * truth.spectrum(np.zeros(1))
    found, sigma = height_transform.measured(frequency, 1e-4 * (truth.spectrum(frequency) + floor), truth)
    assert truth.spectrum(frequency[-1:]) == 0
    assert sigma == pytest.approx(1e-2, rel=1e-3)
    everywhere = np.geomspace(0.0005, 0.04, 100)
    # Linear between logarithms of 400 values.
    assert found.spectrum(everywhere) == pytest.approx(truth.spectrum(everywhere), rel=5e-3)
    assert np.isfinite(height_transform.tabulated(found, 0.1, 4.0)["log_halo"]).all()


def test_a_measured_spectrum_has_no_heights_below_its_band():
    # A steep spectrum that its fitted form would continue to heights of many micrometres.
    steep = k_correlation(400.0, 4.6)
    frequency = np.geomspace(0.03, 1.0, 100)
    values = 1e-3 * (frequency / 0.03) ** -4.6
    found, sigma = height_transform.measured(frequency, values, steep)
    in_band = np.sqrt(2 * np.pi * 1e-3 * 0.03**2 / 2.6)
    assert sigma == pytest.approx(in_band, rel=0.06)
    assert found.spectrum(np.array([0.02]))[0] < 1e-3 * found.spectrum(np.array([0.03]))[0]


def test_orders_above_the_first_are_those_of_the_exponential():
    g, rho = np.array([[1e-6], [1e-3], [0.5], [40.0]]), np.array([1.0, 0.9, 1e-3, 2e-6, -2e-5, 1e-12, 0.0])
    for columns in (slice(None), slice(0, 1), slice(5, 7)):
        with mpmath.workdps(40):
            exact = [
                [mpmath.exp(-a) * (mpmath.expm1(a * b) - a * b) for b in map(mpmath.mpf, rho[columns])]
                for a in map(mpmath.mpf, g[:, 0])
            ]
        found = height_transform._higher_orders(g, rho[columns])
        np.testing.assert_allclose(found, np.array(exact, dtype=float), rtol=1e-9, atol=1e-300)


def test_a_spline_through_the_nodes_about_some_places_is_that_through_all():
    nodes, values = np.linspace(0, 10, 1001), np.random.default_rng(0).standard_normal((3, 1001))
    for at in (np.array([0.5]), np.array([5.003]), np.linspace(4.0, 9.5, 77)):
        expected = CubicSpline(nodes, values, axis=1)(at)
        np.testing.assert_allclose(height_transform._interpolated(nodes, values, at), expected, atol=1e-13)


def test_the_table_is_the_integral_where_long_waves_meet_the_band():
    # 300 times more of the spectrum below the band than above it.
    frequency, lowest = np.geomspace(0.012, 0.1, 40), 0.01
    long_waves = height_transform.LongWaves(0.4, 0.018, lowest)
    found, sigma = height_transform.measured(frequency, np.exp(-((np.pi * 8 * frequency) ** 2)), None, long_waves)
    f, of_frequency = _panels(np.concatenate([np.linspace(0, 0.016, 81), np.geomspace(0.016, 0.4, 80)[1:]]), 4)
    r, of_distance = _panels(np.concatenate([np.linspace(0, 40, 61), np.linspace(40, 1500, 361)[1:]]), 4)
    rho = 2 * np.pi * j0(2 * np.pi * r[:, None] * f) @ (found.spectrum(f) * f * of_frequency)
    asked = lowest * np.array([0.3, 0.8, 0.9, 0.95, 1.0, 1.05, 1.1, 1.2, 1.5])
    hankel = 2 * np.pi * j0(2 * np.pi * asked[:, None] * r) * r * of_distance
    table = height_transform.tabulated(found, 40.0, 2.0)
    halo = Halo.of_table(*(table.variables[name].values for name in _OF_TABLE), np.array(sigma), "ssa1")
    for g in (0.5, 4.0):
        expected = np.exp(-g) * (found.spectrum(asked) + hankel @ (np.expm1(g * rho) - g * rho) / g)
        place = [
            np.full(asked.size, np.log(g / table["phase_variance"].values[0]) / halo.phase_step),
            np.arcsinh(asked / halo.scale) / halo.frequency_step,
        ]
        values = np.exp(map_coordinates(halo.spline, place, order=3, mode="mirror", prefilter=False))
        assert values == pytest.approx(expected, abs=2e-4 * expected.max())


@pytest.mark.parametrize("relative", [0.05, 0.5, 0.69])
def test_long_waves_have_their_rms_height_and_slope(relative):
    waves = height_transform.LongWaves(0.5, relative * 2 * np.pi * 0.5 * 0.01, 0.01)
    f, weight = _panels(np.linspace(0, 0.03, 400), 4)
    variance, square = (2 * np.pi * waves.spectrum()(f) * f * part @ weight for part in (np.ones_like(f), f**2))
    assert np.sqrt(variance) == pytest.approx(0.5, rel=1e-3)
    assert 2 * np.pi * np.sqrt(square) == pytest.approx(waves.slope, rel=1e-3)


_OF_TABLE = ("log_halo", "phase_variance", "halo_frequency", "frequency_scale")


def _panels(edges, order):
    return (part.ravel() for part in hemisphere.panel_rule(edges, order))


def test_the_hankel_transform_is_that_of_scipy():
    step, values = 0.01, np.random.default_rng(1).normal(size=(3, 512))
    offset = fhtoffset(step, mu=0.0)
    np.testing.assert_allclose(
        height_transform.hankel_transform(values, step, offset), fht(values, step, 0.0, offset=offset), atol=1e-12
    )
