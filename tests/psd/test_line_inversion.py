from __future__ import annotations

import numpy as np
import pytest

from brdfpipe.psd.k_correlation import Gaussian, KCorrelation, PsdError, fit
from brdfpipe.psd.line_inversion import invert, with_variance_of
from brdfpipe.psd.periodograms import Rings


@pytest.mark.parametrize("slope", [2.3, 3.0, 5.0])
def test_the_inverse_of_a_line_spectrum_is_the_plane_spectrum(slope: float) -> None:
    model, frequency = KCorrelation(0.1, 5.0, slope), np.geomspace(1e-3, 2, 67)
    found = invert(Rings(frequency, model.line(frequency), 0.01 * model.line(frequency)))
    # Twenty rings a decade: the power between two rings is its mean to second order.
    np.testing.assert_allclose(found.density, model.areal(found.frequency), rtol=7e-3)


def test_the_line_spectrum_is_the_projection_of_the_plane_spectrum() -> None:
    from scipy.integrate import quad

    model = KCorrelation(0.1, 5.0, 3.4)
    for frequency in (0.003, 0.05, 0.7):
        projected = 2 * quad(lambda fy, fx=frequency: float(model.areal(np.hypot(fx, fy))), 0, np.inf, epsrel=1e-10)[0]
        assert float(model.line(np.array(frequency))) == pytest.approx(projected, rel=1e-7)


def test_the_uncertainty_of_the_inverse_is_that_of_repeated_lines() -> None:
    model, frequency, rng = KCorrelation(0.1, 5.0, 3.0), np.geomspace(0.02, 2, 21), np.random.default_rng(1)
    line = model.line(frequency)
    found = invert(Rings(frequency, line, 0.05 * line))
    noisy = [line * (1 + 0.05 * rng.standard_normal(line.size)) for _ in range(150)]
    scatter = np.std([invert(Rings(frequency, values, 0.05 * line)).density for values in noisy], axis=0)
    # A scatter of 150 is known to 6 %. The power beyond the last ring is that of the last three, and makes the last rings' scatter less linear.
    np.testing.assert_allclose(found.uncertainty, scatter, rtol=0.3)


def test_exact_spectra_are_fitted_exactly() -> None:
    model, frequency = KCorrelation(0.1, 5.0, 3.4), np.geomspace(1e-3, 2, 30)
    for line, density in ((False, model.areal(frequency)), (True, model.line(frequency))):
        found = fit(frequency, density, 1e-6 * density, line=line)
        np.testing.assert_allclose(found.model, model, rtol=1e-6)
        assert found.residual < 1e-6


def test_a_fit_needs_four_rings() -> None:
    with pytest.raises(PsdError, match="only 3 frequencies"):
        fit(np.arange(1.0, 4.0), np.ones(3), np.ones(3))


@pytest.mark.parametrize("line", [False, True])
def test_the_spectrum_of_a_gaussian_surface_is_fitted_as_a_gaussian(line: bool) -> None:
    model, frequency = Gaussian(0.1, 5.0), np.geomspace(1e-3, 0.2, 30)
    density = model.line(frequency) if line else model.areal(frequency)
    found = fit(frequency, density, 1e-6 * density, line=line)
    assert found.model[:2] == pytest.approx(model[:2], rel=1e-6)
    assert np.isnan(found.model.slope)


@pytest.mark.parametrize("model", [Gaussian(0.1, 5.0), KCorrelation(0.1, 5.0, 3.4), KCorrelation(0.1, 5.0, 2.4)])
def test_a_plane_spectrum_with_the_variance_of_the_line_stays(model: Gaussian | KCorrelation) -> None:
    frequency = np.geomspace(1e-3, 0.2 if isinstance(model, Gaussian) else 2, 67)
    line, areal = model.line(frequency), model.areal(frequency)
    found = with_variance_of(Rings(frequency, line, 0.1 * line), Rings(frequency, areal, 0.1 * areal))
    np.testing.assert_allclose(found.density, areal, rtol=0.02)


def test_a_wrong_part_of_a_plane_spectrum_is_adjusted_to_the_variance_of_the_line() -> None:
    model, frequency = KCorrelation(0.1, 5.0, 3.4), np.geomspace(1e-3, 2, 67)
    line, true = model.line(frequency), model.areal(frequency)
    wrong = np.where(frequency < 0.03, 1.5 * true, true)
    uncertainty = np.where(frequency < 0.03, 0.3, 1e-3) * wrong
    found = with_variance_of(Rings(frequency, line, 0.05 * line), Rings(frequency, wrong, uncertainty))
    np.testing.assert_allclose(found.density[frequency > 0.03], true[frequency > 0.03], rtol=0.01)
    power = 2 * np.pi * frequency**2
    rms = [np.sqrt(np.trapezoid(power * density, np.log(frequency))) for density in (found.density, true, wrong)]
    assert rms[0] == pytest.approx(rms[1], rel=0.01)
    assert rms[2] > 1.05 * rms[1]
    # The change counts in the uncertainty.
    assert (found.uncertainty[0] / found.density[0]) > 0.3
