from __future__ import annotations

import numpy as np
import pytest
import samples
from random_surfaces import gaussian, heights

from brdfpipe.psd import analytic, estimate
from brdfpipe.report.material.page import material_page
from brdfpipe.report.material.roughness import roughness_section
from brdfpipe.report.plots.roughness_spectrum import instrument_frequencies, roughness_spectrum


@pytest.fixture(scope="module")
def measured():
    clean = heights(gaussian(0.1, 8.0), (256, 256), (1.0, 1.0), 3)
    noise = np.random.default_rng(4).normal(scale=0.01, size=clean.shape)
    return estimate(samples.surface(clean + noise))


def test_the_figure_has_spectrum_noise_and_fit(measured) -> None:
    entries = [label for _, _, label in roughness_spectrum(measured).legend]
    assert {"surface", "noise, subtracted", "Gaussian, fitted", "with noise, all frequencies"} <= set(entries)


def test_the_page_compares_the_rms_of_heights_and_spectrum(measured) -> None:
    section = roughness_section({"psd": measured})
    rows = {row[0]: row[1] for row in section.tables[0].rows}
    # Both are 100 nm, but for the chance of one map of a thousand grains.
    for name in ("rms height of the levelled heights", "rms height of the spectrum"):
        assert float(rows[name].split()[0]) == pytest.approx(100, rel=0.15)
    assert rows["Noise of the heights"].startswith(("9.", "10."))
    assert "Roughness spectrum" in material_page({"psd": measured.assign_attrs(stage="psd", material="m")})


def test_a_gaussian_has_no_exponent_and_a_flat_surface_no_section() -> None:
    section = roughness_section({"psd": analytic("gaussian", sigma=0.01, length=5.0)})
    assert "Exponent of the decay" not in [row[0] for row in section.tables[0].rows]
    assert not roughness_section({"psd": analytic("gaussian", sigma=0.0, length=5.0)})
    assert not roughness_section({})


def test_frequencies_of_instruments_follow_from_the_grating_equation() -> None:
    frequency = dict(instrument_frequencies())
    # cos 20° · 0.9° / 0.55 µm, to the curvature of the sine.
    assert frequency["edge of the receptor, gloss 20°"] == pytest.approx(
        np.cos(np.radians(20)) * np.radians(0.9) / 0.55, rel=5e-3
    )
    assert frequency["grazing, normal incidence: 1/λ"] == pytest.approx(1 / 0.55)
