"""What an eye resolves at a viewing distance."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from brdfpipe.texture.eye import eye_blur, resolved_size


def test_what_an_eye_resolves_is_a_minute_of_arc():
    assert resolved_size(1.0) == pytest.approx(291, abs=1)


def test_the_blur_of_an_eye_is_a_gaussian_of_that_width():
    light = np.random.default_rng(1).random((64, 64))
    sigma = resolved_size(0.06) / np.sqrt(8 * np.log(2)) / 2.0
    assert eye_blur(light, 2.0, 0.06) == pytest.approx(
        gaussian_filter(light, sigma, mode="wrap", truncate=8), abs=1e-12
    )
    assert eye_blur(light, 2.0, 0.06).mean() == pytest.approx(light.mean())
