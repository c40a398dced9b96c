"""Reflectance haze: the light that a gloss meter's further receptors find beside the mirror image of its source.

H = 100 · (light in windows on both sides of the mirror direction) ÷ (light that black glass of index 1.567 mirrors), so that haze
and gloss share one scale. What a polished surface mirrors never reaches a window.

References
----------
ISO 13803 and ASTM E430 B (20°, windows at 18.1° and 21.9°); ASTM E430 A (30°, windows at 28° or 32°, and at 25° or 35°) and C (30°,
at 28° or 32°, and at 15°). Conformance is not claimed: results are "ISO 13803-style".

The standards are sold, not published. Confirmed by public sources: these angles; receptors of ISO 13803 on both sides of that of
20° gloss, which is 1.8° wide; the ratio to the light that the reference of gloss mirrors. Not confirmed: how wide the windows are,
here as the receptor of gloss is; the tolerances, none of which is taken into account; the logarithmic unit and the correction for
the luminance of the coating, which instruments offer and this module does not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.appearance.apertures import (
    QUICK,
    SOURCE,
    Beam,
    Rule,
    Window,
    all_round,
    half_width,
    lobe_scale,
    mean_rule,
    received,
    source,
)
from brdfpipe.bsdf import representations
from brdfpipe.errors import BrdfpipeError
from brdfpipe.geometry import Array


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
"""As of ISO 13803 and ASTM E430 B: beside the receptor for 20° gloss, 18.1° and 21.9°; as wide as it, which is not confirmed."""


def reflectance_haze(
    bsdf: xr.Dataset, windows: Sequence[HazeWindow | Mapping[str, Any]] = WINDOWS, *, azimuth: float | None = None
) -> xr.DataArray:
    """Light beside the mirror image of the source, in gloss units.

    Parameters
    ----------
    bsdf : kind ``bsdf``; averaged with V(λ)·D65 where it depends on wavelength
    windows : or mappings with ``angle``, ``offset`` and ``aperture``
    azimuth : of the plane of incidence [degree]; by default the mean over all azimuths, which matters to a surface with a lay

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
    scale = lobe_scale(reduced)
    quantity = vocabulary.QUANTITIES["reflectance_haze"]
    return xr.DataArray(
        np.array([_haze(reduced, window, azimuth, scale) for window in checked], dtype=float),
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


def _haze(bsdf: xr.Dataset, window: HazeWindow, azimuth: float | None, scale: float) -> float:
    def read(azimuths: Array, rule: Rule) -> Array:
        light = source(window.angle, rule)
        beams = [Beam(window.angle, light, _rectangle(window, side), rule.receptor) for side in (-1, 1)]
        below, above = received(bsdf, beams, azimuths, scale)
        return np.asarray(100 * ((below + above) @ light.weight) / (light.weight @ light.glass))

    if azimuth is None and not representations.isotropic(bsdf):
        return float(all_round(lambda azimuths: read(azimuths, mean_rule(scale)), bsdf)[1].mean())
    return float(read(np.array([azimuth or 0.0]), QUICK)[0])


def _rectangle(window: HazeWindow, side: int) -> Window:
    """The window in the tangent plane of the mirrored axis, where what lies off the axis is larger."""
    low, high = sorted(side * (window.offset + end * window.aperture[0] / 2) for end in (-1, 1))
    half_v = half_width(window.aperture[1]) / np.cos(np.radians(window.offset))
    return Window(float(np.tan(np.radians(low))), float(np.tan(np.radians(high))), -half_v, half_v)
