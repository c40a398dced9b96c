"""Slope rms behind a low-pass filter: exact for a Gaussian surface, and the marks that help to choose a cutoff."""

from __future__ import annotations

import numpy as np
import pytest
import samples
from random_surfaces import gaussian, heights

from brdfpipe.psd import estimate
from brdfpipe.report.material.roughness import roughness_section
from brdfpipe.report.plots.cutoffs import slope_by_cutoff, slope_rms_behind
from brdfpipe.surfaces import low_pass
from brdfpipe.surfaces.filtering import ALPHA
from brdfpipe.surfaces.texture_parameters import parameters


def test_the_slopes_of_a_gaussian_surface_fall_as_in_closed_form() -> None:
    sigma, length, cutoff = 0.1, 8.0, np.array([1e-3, 2.0, 10.0, 50.0])
    frequency = np.linspace(1e-5, 1.0, 20_001)
    density = np.pi * (sigma * length) ** 2 * np.exp(-((np.pi * length * frequency) ** 2))
    # Autocovariance σ² exp(−r²/ℓ²): slope rms 2σ/ℓ; the filter adds 2π (α λs)² to the exponent (π ℓ)² of the spectrum.
    expected = 2 * sigma / length / (1 + 2 * np.pi * (ALPHA * cutoff / (np.pi * length)) ** 2)
    assert slope_rms_behind(frequency, density, cutoff) == pytest.approx(expected, rel=1e-5)


def test_the_curve_is_that_of_the_filtered_heights() -> None:
    surface = samples.surface(heights(gaussian(0.1, 8.0), (256, 256), (1.0, 1.0), 3))
    psd = estimate(surface)
    for cutoff in (6.0, 12.0):
        behind = float(slope_rms_behind(psd["frequency"].values, psd["psd"].values, np.array([cutoff]))[0])
        # The band of the spectrum ends below the longest waves, which carry few slopes; one map of a thousand grains scatters by 3 %.
        assert behind == pytest.approx(float(parameters(low_pass(surface, cutoff)).Sdq), rel=0.1)


def test_pitch_least_cutoff_wavelength_and_chosen_filters_are_marked() -> None:
    clean = heights(gaussian(0.1, 8.0), (256, 256), (1.0, 1.0), 3)
    noisy = samples.surface(clean + np.random.default_rng(4).normal(scale=0.01, size=clean.shape))
    psd = estimate(noisy)
    assert "half a wavelength of light" in [label for _, _, label in slope_by_cutoff(psd, noisy).legend], "of any pitch"
    entries = [label for _, _, label in slope_by_cutoff(psd, noisy.assign_attrs(lambda_s=9.0)).legend]
    assert {"half a wavelength of light", "surface", "with noise", "pitch", "4 pitches, the least λs", "λs in use"} <= {
        *entries
    }
    titles = [figure.title for figure in roughness_section({"psd": psd, "surface": noisy}).figures]
    assert titles == ["Roughness spectrum", "Slopes by cutoff"]
    assert [figure.title for figure in roughness_section({"psd": psd}).figures] == ["Roughness spectrum"]
