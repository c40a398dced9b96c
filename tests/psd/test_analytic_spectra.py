from __future__ import annotations

import numpy as np
import pytest
from scipy.special import j0, kv

from brdfpipe import vocabulary
from brdfpipe.errors import BrdfpipeError
from brdfpipe.psd import FORMS, analytic
from brdfpipe.psd.k_correlation import KCorrelation


def ring_integral(spectrum, r: float = 0.0) -> float:
    """2π ∫ S J0(2πfr) f df: the autocovariance at a distance."""
    log_f, f = np.log(spectrum["frequency"].values), spectrum["frequency"].values
    return float(np.trapezoid(2 * np.pi * spectrum["psd"].values * j0(2 * np.pi * f * r) * f**2, log_f))


@pytest.mark.parametrize(("form", "missing"), [("gaussian", 1e-7), ("k-correlation", 2e-5)])
def test_the_spectrum_integrates_to_the_square_of_sigma(form: str, missing: float) -> None:
    # Beyond the grid, 1e4/ℓ, the K-correlation of slope 3 has 1/(2π 1e4) of its variance.
    spectrum = vocabulary.validate(analytic(form, sigma=0.013, length=5.0), "psd")
    assert ring_integral(spectrum) == pytest.approx(0.013**2, rel=missing)


def test_the_autocovariance_of_a_gaussian_falls_to_1_over_e_at_its_length() -> None:
    assert ring_integral(analytic("gaussian", sigma=0.2, length=5.0), r=5.0) == pytest.approx(0.04 / np.e, rel=1e-5)


def test_the_autocovariance_of_slope_3_is_exponential() -> None:
    # The integral oscillates beyond the grid's resolution: as many as the grid follows are summed, to 1 %.
    spectrum = analytic("k-correlation", sigma=0.2, length=5.0)
    spectrum = spectrum.sel(frequency=slice(None, 4.0))
    for r in (1.0, 5.0, 10.0):
        assert ring_integral(spectrum, r) == pytest.approx(0.04 * np.exp(-r / 5), rel=0.01)


@pytest.mark.parametrize("slope", [2.5, 3.0, 4.7])
def test_the_autocovariance_of_any_slope_is_the_published_bessel_function(slope: float) -> None:
    from scipy.integrate import quad
    from scipy.special import gamma

    # Order ν = (C - 1)/2 of K, in x = 2πr/B; the Hankel transform back gives S(f) in closed form.
    model, nu, f = KCorrelation(0.2, 5.0, slope), slope / 2 - 1, 0.05
    scale = 0.04 * 2 ** (1 - nu) / gamma(nu)
    s, _ = quad(lambda r: scale * (r / 5) ** nu * kv(nu, r / 5) * j0(2 * np.pi * f * r) * r, 0, 300, limit=400)
    assert 2 * np.pi * s == pytest.approx(float(model.areal(np.array(f))), rel=1e-6)


def test_the_variance_beyond_a_frequency_is_the_integral_from_there() -> None:
    spectrum, model = analytic("k-correlation", sigma=0.2, length=5.0, slope=3.5), KCorrelation(0.2, 5.0, 3.5)
    above = spectrum.sel(frequency=slice(0.1, None))
    start = float(above["frequency"][0])
    # The trapezoidal rule in log f has 128 points a decade.
    assert ring_integral(above) == pytest.approx(model.variance_beyond(start), rel=1e-3)
    assert model.variance_beyond(0.0) == pytest.approx(0.04)


@pytest.mark.parametrize("form", FORMS)
def test_a_flat_surface_has_no_spectrum(form: str) -> None:
    assert not analytic(form, sigma=0.0, length=5.0)["psd"].any()


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"form": "fractal"}, "accepted: gaussian, k-correlation"),
        ({"sigma": -1.0}, "`sigma`.* is -1 um; accepted: 0 to"),
        ({"sigma": float("nan")}, "is nan um"),
        ({"length": 0.0}, "length .* is 0 um; accepted: 1e-06 to"),
        ({"slope": 2.0}, "slope .* is 2; accepted: above 2 to 12"),
    ],
)
def test_an_impossible_spectrum_is_refused(given: dict[str, object], words: str) -> None:
    with pytest.raises(BrdfpipeError, match=words):
        analytic(**({"form": "k-correlation", "sigma": 0.1, "length": 1.0} | given))
