"""Rms of the normal heights that reflect as much light coherently as measured ones."""

from __future__ import annotations

import numpy as np
import pytest

from brdfpipe.psd.coherent_height import coherent_height


def test_normal_heights_have_their_rms_at_every_phase():
    height = np.random.default_rng(0).normal(3.0, 0.05, (400, 300))
    found = coherent_height(height, 0.0)["coherent_sigma"].values
    # 120 000 heights: the rms is known to 0.2 %, the mean of the phases to 0.003.
    assert found[:30] == pytest.approx(np.full(30, height.std()), rel=5e-3)


def test_the_stated_uncertainty_is_the_scatter_of_independent_heights():
    # Of n independent normal heights σ scatters by σ/√(2n), and the tiles know that to 1/√126.
    found = coherent_height(np.random.default_rng(4).normal(0.0, 0.02, (320, 320)), 0.0)
    assert found["coherent_sigma_u"].values[:5] == pytest.approx(0.02 / np.sqrt(2 * 320**2), rel=0.25)


def test_two_levels_have_the_share_of_their_cosine():
    height = np.where(np.arange(64 * 50) % 2, 0.02, -0.02)
    found = coherent_height(height, 0.0)
    q, sigma = found["phase_per_height"].values, found["coherent_sigma"].values
    # |⟨exp(iqh)⟩| = |cos(qh)|; heights are known to a phase of 0.01.
    assert np.exp(-((q * sigma) ** 2)) == pytest.approx(np.cos(0.02 * q) ** 2, abs=4e-3)


def test_noise_is_left_out_and_missing_heights_do_not_count():
    rng = np.random.default_rng(1)
    height = rng.normal(0.0, 0.03, (300, 300)) + rng.normal(0.0, 0.02, (300, 300))
    height[rng.random(height.shape) < 0.1] = np.nan
    assert coherent_height(height, 0.02)["coherent_sigma"].values[:20] == pytest.approx(np.full(20, 0.03), rel=0.02)


@pytest.mark.parametrize("height", [np.zeros((64, 64)), np.full(70, 0.5)])
def test_flat_heights_are_all_coherent(height):
    assert coherent_height(height, 0.0)["coherent_sigma"].values == pytest.approx([0.0])


def test_rough_heights_hold_their_last_value():
    height = np.random.default_rng(2).normal(0.0, 5.0, (200, 200))
    found = coherent_height(height, 0.0)
    assert float(found["phase_per_height"][-1]) == pytest.approx(0.8, rel=0.02)
    assert found["coherent_sigma"].values == pytest.approx(np.full(48, 5.0), rel=0.15)
