from __future__ import annotations

import numpy as np
import pytest

from brdfpipe.psd.k_correlation import KCorrelation, PsdError, fit
from brdfpipe.psd.line_inversion import invert
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
