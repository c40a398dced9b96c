"""Reflectance haze: the light that a gloss meter's further receptors find beside the mirror image of its source.

H = 100 · (light in windows on both sides of the mirror direction) ÷ (light that black glass of index 1.567 mirrors), so that haze
and gloss share one scale. What a polished surface mirrors never reaches a window.

References
----------
ISO 13803 and ASTM E430 B (20°, windows at 18.1° and 21.9°); ASTM E430 A and C (30°, windows 2°, 5° and 15° off). The scale is not
theirs, which haze standards set, and conformance is not claimed: results are "ISO 13803-style".
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.appearance.apertures import QUICK, SOURCE, Beam, Window, half_width, lobe_scale, received, source
from brdfpipe.bsdf import representations
from brdfpipe.errors import BrdfpipeError
from brdfpipe.geometry import Array

_AZIMUTHS = np.arange(0.0, 360.0, 360 / 16)


class HazeError(BrdfpipeError):
    """A window of a haze meter cannot be."""


class HazeWindow(NamedTuple):
    """A pair of receptors beside the mirror direction."""

    angle: float
    """Incidence [degree]."""
    offset: float
    """Of their axes from the mirror direction, in the plane of incidence, on both sides [degree]."""
    aperture: tuple[float, float]
    """Full angles in the plane of incidence and across it [degree]."""

    @property
    def title(self) -> str:
        return f"{self.angle:g}° ± {self.offset:g}°, {self.aperture[0]:g}° × {self.aperture[1]:g}°"


WINDOWS = (HazeWindow(20.0, 1.9, (1.8, 3.6)),)
"""As of ISO 13803 and ASTM E430 B: beside the receptor for 20° gloss and as wide, 18.1° and 21.9°."""


def reflectance_haze(
    bsdf: xr.Dataset, windows: Sequence[HazeWindow | Mapping[str, Any]] = WINDOWS, *, azimuth: float | None = None
) -> xr.DataArray:
    """Light beside the mirror image of the source, in gloss units.

    Parameters
    ----------
    bsdf : kind ``bsdf``; averaged with V(λ)·D65 where it depends on wavelength
    windows : or mappings with ``angle``, ``offset`` and ``aperture``
    azimuth : of the plane of incidence [degree]; by default the mean over 16 azimuths, which matters to a surface with a lay

    Returns
    -------
    DataArray ``reflectance_haze(haze_window)`` [1]

    Raises
    ------
    HazeError : a window that covers part of the mirror image of the source, or reaches below the surface.
    """
    vocabulary.validate(bsdf, "bsdf")
    checked = [_checked(window) for window in windows]
    reduced = representations.nonspectral(bsdf)
    turns = _AZIMUTHS if azimuth is None and not representations.isotropic(reduced) else np.array([azimuth or 0.0])
    quantity = vocabulary.QUANTITIES["reflectance_haze"]
    return xr.DataArray(
        np.array([_haze(reduced, window, turns) for window in checked], dtype=float),
        dims="haze_window",
        coords={"haze_window": np.array([window.title for window in checked], dtype=object)},
        name="reflectance_haze",
        attrs={"units": quantity.units, "long_name": quantity.long_name},
    )


def _checked(window: HazeWindow | Mapping[str, Any]) -> HazeWindow:
    if isinstance(window, Mapping):
        along, across = window["aperture"]
        window = HazeWindow(float(window["angle"]), float(window["offset"]), (float(along), float(across)))
    inner, outer = window.offset - window.aperture[0] / 2, window.offset + window.aperture[0] / 2
    # A source at the upper end of its tolerance must still be clear of the window.
    if not inner >= SOURCE[0] / 2 + 0.125:
        raise HazeError(
            f"haze window {window.title}: covers part of the source's image; accepted: an inner edge of at least "
            f"{SOURCE[0] / 2 + 0.125:g}°, found {inner:g}°; mend `appearance.haze`"
        )
    if not (window.angle >= 0 and window.angle + outer < 90 and window.aperture[1] < 90):
        raise HazeError(
            f"haze window {window.title}: does not lie above the surface; accepted: an outer edge below 90°, found "
            f"{window.angle + outer:g}°; mend `appearance.haze`"
        )
    return window


def _haze(bsdf: xr.Dataset, window: HazeWindow, turns: Array) -> float:
    light, scale = source(window.angle, QUICK), lobe_scale(bsdf, window.angle, float(turns[0]))
    beams = [Beam(window.angle, light, _rectangle(window, side), QUICK.receptor) for side in (-1, 1)]
    flux = np.mean([np.sum(received(bsdf, beams, float(turn), scale), axis=0) for turn in turns], axis=0)
    return float(100 * (light.weight @ flux) / (light.weight @ light.glass))


def _rectangle(window: HazeWindow, side: int) -> Window:
    """The window in the tangent plane of the mirrored axis, where what lies off the axis is larger."""
    low, high = sorted(side * (window.offset + end * window.aperture[0] / 2) for end in (-1, 1))
    half_v = half_width(window.aperture[1]) / np.cos(np.radians(window.offset))
    return Window(float(np.tan(np.radians(low))), float(np.tan(np.radians(high))), -half_v, half_v)
