"""Cuts through the lobe of a BRDF at angles that all materials share, by which the catalogue compares them."""

from __future__ import annotations

from base64 import b64encode

import numpy as np
import xarray as xr

from brdfpipe.errors import BrdfpipeError
from brdfpipe.report.plots import bsdf_sections
from brdfpipe.report.plots.svg import Array

INCIDENCES = np.array([20.0, 45.0, 75.0])
"""Angles of incidence [degree]."""

_ONE_SIDE = [0.1, 0.2, 0.4, 0.7, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 11.0, 15.0, 20.0, 30.0, 45.0, 60.0, 80.0]

OFFSETS = np.array([*(-one for one in reversed(_ONE_SIDE)), 0.0, *_ONE_SIDE])
"""Angles from the mirror direction [degree], negative towards the normal: dense at the lobe."""

_GRAZING = 88.0
_LOWEST, _HIGHEST, _LEVELS = -7.0, 9.0, 65535
"""Decades [sr-1] that 16 bits span: a level is 0.06 %."""


def lobe_cut(bsdf: xr.Dataset | None) -> Array:
    """The BRDF [sr-1] at :data:`INCIDENCES` and :data:`OFFSETS`, at the wavelength of the figures.

    With a lay, light comes along it. NaN without a BSDF, without light, beyond 88° from the normal, and all NaN for a table that does not
    cover the directions.
    """
    cut = np.full((INCIDENCES.size, OFFSETS.size), np.nan)
    if bsdf is None:
        return cut
    theta = INCIDENCES[:, None] + OFFSETS
    inside = np.abs(theta) <= _GRAZING
    incidence = np.broadcast_to(INCIDENCES[:, None], theta.shape)[inside]
    try:
        plane = bsdf_sections.planes(bsdf)[0]
        values = bsdf_sections.value(bsdf, plane, incidence, *bsdf_sections.in_plane(theta[inside]))
    except BrdfpipeError:  # a table may not cover the directions
        return cut
    cut[inside] = np.where(values > 0, values, np.nan)
    return cut


def packed(cuts: Array) -> str:
    """Sixteen bits a value, little-endian, of the logarithm; 0 for no light."""
    with np.errstate(invalid="ignore"):
        share = (np.log10(cuts) - _LOWEST) / (_HIGHEST - _LOWEST)
    levels = 1 + (np.clip(share, 0, 1) * (_LEVELS - 1)).round()
    return b64encode(np.where(np.isfinite(levels), levels, 0).astype("<u2").tobytes()).decode()


def scale() -> dict[str, object]:
    """What a script needs to read :func:`packed` values."""
    return {
        "incidences": INCIDENCES.tolist(),
        "offsets": OFFSETS.tolist(),
        "decades": [_LOWEST, _HIGHEST],
    }
