"""Scaled roughness spectra, beside spectra of scaled heights."""

from __future__ import annotations

import numpy as np
import pytest
import relief_maps
import samples

from brdfpipe import psd, vocabulary

FACTOR = 1.7


def test_the_spectrum_of_scaled_heights_is_the_scaled_spectrum() -> None:
    spectrum = 0.01 * np.exp(-np.hypot(*np.meshgrid(np.fft.fftfreq(256, 0.5), np.fft.fftfreq(256, 0.5))) * 20)
    heights = relief_maps.of_spectrum(spectrum, 0.5, 4)
    found, larger = (psd.estimate(samples.surface(factor * heights, (0.5, 0.5))) for factor in (1.0, FACTOR))
    scaled = vocabulary.validate(psd.scaled(found, FACTOR), "psd")
    assert set(scaled.variables) == set(larger.variables)
    # Both are known at the same phases, and so at others per height.
    known = scaled.sel(phase_per_height=slice(float(larger["phase_per_height"][0]), None))
    for name in ("coherent_sigma", "coherent_sigma_u"):
        between = larger[name].interp(phase_per_height=known["phase_per_height"], method="cubic")
        assert between.size > 20
        np.testing.assert_allclose(known[name], between, rtol=1e-4, err_msg=name)
    for name in scaled.variables.keys() - {"coherent_sigma", "coherent_sigma_u", "phase_per_height"}:
        # The fit of the form ends within its own tolerance.
        relative = 1e-3 if name.startswith("fit_") else 1e-6
        np.testing.assert_allclose(scaled[name], larger[name], rtol=relative, atol=1e-12, err_msg=name)


@pytest.mark.parametrize("factor", [0.0, -1.0, np.nan, np.inf])
def test_an_impossible_factor_is_refused(factor: float) -> None:
    with pytest.raises(psd.PsdError, match="cannot be scaled"):
        psd.scaled(psd.analytic("gaussian", sigma=0.1, length=5.0), factor)
