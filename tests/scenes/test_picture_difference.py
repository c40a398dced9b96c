"""ΔE_ITP of pictures whose luminance is known."""

from __future__ import annotations

import numpy as np
import pytest
import samples

from brdfpipe.appearance.lights import lights
from brdfpipe.appearance.preview import channels_of, radiance
from brdfpipe.appearance.preview_geometry import panel, sphere
from brdfpipe.appearance.transport import Table
from brdfpipe.bsdf.lambert_gauss import lambertian
from brdfpipe.scenes.picture_difference import WHITE_LUMINANCE, picture_differences


def perceptual_quantiser(luminance):
    """The inverse of the curve of SMPTE ST 2084, for cd/m²."""
    power = (luminance / 10_000) ** (2610 / 16384)
    return ((3424 / 4096 + 2413 / 128 * power) / (1 + 2392 / 128 * power)) ** (2523 / 32)


def test_greys_differ_by_the_quantised_luminance_of_their_pixels():
    """A grey has no chroma, so that ΔE_ITP is 720 times the difference of the coded luminance."""
    light_grey, dark_grey = (lambertian(samples.spectrum(r)) for r in (0.4, 0.3))
    found = picture_differences(light_grey, dark_grey, side=16)
    table = Table.of(light_grey, *channels_of(light_grey))
    for light, (mean, u) in found.items():
        expected, weight = [], []
        for shot in (sphere(16), panel(16)):
            luminance = WHITE_LUMINANCE * radiance(table, shot, lights(light)).mean(axis=1)
            expected.append(720 * (perceptual_quantiser(luminance) - perceptual_quantiser(0.75 * luminance)))
            weight.append(shot.coverage[shot.coverage > 0])
        # The grey is neutral to the rounding of the matrices, about 1e-4 of chroma.
        assert mean == pytest.approx(np.average(np.concatenate(expected), weights=np.concatenate(weight)), rel=1e-3)
        assert 0 <= u < 0.1 * mean
