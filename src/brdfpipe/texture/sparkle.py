"""Sparkle and graininess of a texture of unit mean.

Sparkles are points of light that are much brighter than what surrounds them, under light from one direction; graininess is the perceived contrast of the irregular pattern of
light and dark in diffuse light: so CIE JTC 12 defines the terms. The measures, with their background, threshold and filter, are this package's: they do not reproduce the scales
that the CIE discusses, nor those of instruments, whose procedures are not published.

References
----------
Ferrero et al. 2021 (Opt. Express 29, 7589), the scales under discussion; Ferrero et al. 2013 (Opt. Express 21, 26812), a model of both textures.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from brdfpipe.geometry import Array
from brdfpipe.texture.eye import blur_width

THRESHOLD = 1.0
"""Least contrast of a sparkle: twice as bright as the background."""

VIEWING_DISTANCE = 0.5
"""Distance of graininess [m]."""

_COARSE = 10.0
"""Width of the background of grains, in widths of the eye."""


class Sparkle(NamedTuple):
    """Points of light on the background of a picture."""

    density: float
    """Number per area [mm-2]."""
    area: float
    """Mean area [um2]; 0 without any."""
    contrast: float
    """Mean of their peaks over the background, less 1; 0 without any."""

    @property
    def visibility(self) -> float:
        """Contrast times the root of the density [mm-1]: it rises with both."""
        return self.contrast * np.sqrt(self.density)


def sparkle(values: Array, pixel: float, threshold: float = THRESHOLD) -> Sparkle:
    """Sparkles of a picture.

    Parameters
    ----------
    values : (rows, columns) light in any unit, without a gradient of the illumination
    pixel : side of a pixel [um]
    threshold : least contrast

    Notes
    -----
    The background is the median. A sparkle is a set of neighbouring pixels, diagonally too, of a contrast value/background − 1 above the threshold. Contrasts do not depend on the
    exposure, and the density does not depend on the size of the picture.
    """
    from scipy import ndimage

    contrast = values / np.median(values) - 1
    label, count = ndimage.label(contrast > threshold, structure=np.ones((3, 3)))
    if count == 0:
        return Sparkle(0.0, 0.0, 0.0)
    peaks = ndimage.maximum(contrast, label, np.arange(1, count + 1))
    area = values.size * pixel**2
    return Sparkle(count / (area * 1e-6), float(np.sum(label > 0)) * pixel**2 / count, float(np.mean(peaks)))


def graininess(values: Array, pixel: float, distance: float = VIEWING_DISTANCE) -> float:
    """Rms contrast of the pattern that an eye sees at a distance.

    Parameters
    ----------
    values : (rows, columns) light in any unit, without a gradient of the illumination
    pixel : side of a pixel [um]
    distance : of the eye [m]

    Notes
    -----
    The picture over its mean, blurred by a Gaussian as wide as an eye resolves (one minute of arc, full width at half maximum), less the same ten times as wide.
    """
    from scipy.ndimage import gaussian_filter

    width = blur_width(distance) / pixel
    relative = values / values.mean()
    fine, coarse = (gaussian_filter(relative, one, mode="wrap") for one in (width, _COARSE * width))
    return float(np.std(fine - coarse))
