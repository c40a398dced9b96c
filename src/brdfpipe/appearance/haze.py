"""Reflectance haze: the light that a gloss meter's further receptors find beside the mirror image of its source.

H = 100 · (light in windows on both sides of the mirror direction) ÷ (light that black glass of index 1.567 mirrors), so that haze
and gloss share one scale. What a polished surface mirrors never reaches a window.

References
----------
ISO 13803 and ASTM E430 B (20°, windows at 18.1° and 21.9°); ASTM E430 A (30°, windows at 28° or 32°, and at 25° or 35°) and C (30°,
at 28° or 32°, and at 15°). Conformance is not claimed: results are "ISO 13803-style".

The standards are sold, not published. Confirmed by public sources: these angles; receptors of ISO 13803 on both sides of that of
20° gloss, which is 1.8° wide; the ratio to the light that the reference of gloss mirrors. Not confirmed: how wide the windows are,
here as the receptor of gloss is; the tolerances, for which those of 20° gloss stand in; the logarithmic unit and the correction for
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
    centred,
    half_width,
    lobe_scale,
    mean_rule,
    received,
    source,
)
from brdfpipe.appearance.gloss_meter import AXIS_TOLERANCE, RECEPTOR_TOLERANCE, SOURCE_TOLERANCE
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.registry import representation
from brdfpipe.errors import BrdfpipeError
from brdfpipe.geometry import Array

_ORDER = 3
"""Points in each panel of a window, for an uncertainty."""
_ENDS = (-1, 1)
_SIDES = (-1, 1)


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
    reduced, checked, scale = _prepared(bsdf, windows)
    return _named([float(_read(reduced, window, azimuth, scale)[1].mean()) for window in checked], checked)


def reflectance_haze_with_uncertainty(
    bsdf: xr.Dataset, windows: Sequence[HazeWindow | Mapping[str, Any]] = WINDOWS, *, azimuth: float | None = None
) -> tuple[xr.DataArray, xr.DataArray]:
    """Reflectance haze, and the standard uncertainty that the tolerances of instruments leave.

    Parameters
    ----------
    bsdf, windows, azimuth : as of :func:`reflectance_haze`, which tells what is refused

    Returns
    -------
    ``reflectance_haze(haze_window)``, ``reflectance_haze_u(haze_window)`` [1]

    Notes
    -----
    As of :func:`brdfpipe.appearance.gloss.gloss_with_uncertainty`, with its tolerances at 20°: full angles of the source (common to
    both windows), full angles and axis of each window, and the angle of incidence, nine rectangular distributions. Each is
    evaluated at both its ends.
    """
    reduced, checked, scale = _prepared(bsdf, windows)
    values, spreads = [], []
    for window in checked:
        azimuths, units = _read(reduced, window, azimuth, scale)
        values.append(float(units.mean()))
        # Either half of the azimuths is evenly spaced too; a spread needs no more.
        spreads.append(_spread(reduced, window, azimuths[: -(-azimuths.size // 2)], scale))
    title = "standard uncertainty of haze beside the mirror direction, from tolerances"
    return _named(values, checked), _named(spreads, checked).rename("reflectance_haze_u").assign_attrs(long_name=title)


def _prepared(
    bsdf: xr.Dataset, windows: Sequence[HazeWindow | Mapping[str, Any]]
) -> tuple[xr.Dataset, list[HazeWindow], float]:
    vocabulary.validate(bsdf, "bsdf")
    checked = [checked_window(window) for window in windows]
    reduced = nonspectral(bsdf)
    return reduced, checked, lobe_scale(reduced)


def _named(values: Sequence[float], windows: Sequence[HazeWindow]) -> xr.DataArray:
    quantity = vocabulary.QUANTITIES["reflectance_haze"]
    return xr.DataArray(
        np.array(values, dtype=float),
        dims="haze_window",
        coords={"haze_window": np.array([window.title for window in windows], dtype=object)},
        name="reflectance_haze",
        attrs={"units": quantity.units, "long_name": quantity.long_name},
    )


def checked_window(window: HazeWindow | Mapping[str, Any]) -> HazeWindow:
    if isinstance(window, Mapping):
        along, across = window["aperture"]
        window = HazeWindow(float(window["angle"]), float(window["offset"]), (float(along), float(across)))
    inner, outer = window.offset - window.aperture[0] / 2, window.offset + window.aperture[0] / 2
    # A source at the upper end of its tolerance must still be clear of the window.
    if not inner >= SOURCE[0] / 2 + 0.125:
        raise HazeError(
            f"haze window {window.title}: covers part of the source's image; accepted: an inner edge of at least "
            f"{SOURCE[0] / 2 + 0.125:g}°, found {inner:g}°; change `appearance.haze`"
        )
    if not (window.angle >= 0 and window.angle + outer < 90 and window.aperture[1] < 90):
        raise HazeError(
            f"haze window {window.title}: extends below the surface; accepted: an outer edge below 90°, found "
            f"{window.angle + outer:g}°; change `appearance.haze`"
        )
    return window


def _read(bsdf: xr.Dataset, window: HazeWindow, azimuth: float | None, scale: float) -> tuple[Array, Array]:
    """Azimuths of the plane of incidence, and the haze at each."""

    def read(azimuths: Array, rule: Rule) -> Array:
        light = source(window.angle, rule)
        beams = [Beam(window.angle, light, _rectangle(window, side), rule.receptor) for side in _SIDES]
        return np.sum([_units(beam, flux) for beam, flux in _received(bsdf, beams, azimuths, scale)], axis=0)

    if azimuth is None and not representation(bsdf).isotropic:
        return all_round(lambda azimuths: read(azimuths, mean_rule(scale)), bsdf)
    one = np.array([azimuth or 0.0])
    return one, read(one, QUICK)


def _received(bsdf: xr.Dataset, beams: Sequence[Beam], azimuths: Array, scale: float) -> list[tuple[Beam, Array]]:
    return list(zip(beams, received(bsdf, beams, azimuths, scale), strict=True))


def _units(beam: Beam, flux: Array) -> Array:
    return np.asarray(100 * (flux @ beam.light.weight) / (beam.light.weight @ beam.light.glass))


def _rectangle(window: HazeWindow, side: int, moved: float = 0.0) -> Window:
    """The window in the tangent plane of the mirrored axis, where what lies off the axis is larger."""
    offset = window.offset + moved
    low, high = sorted(side * (offset + end * window.aperture[0] / 2) for end in (-1, 1))
    half_v = half_width(window.aperture[1]) / np.cos(np.radians(offset))
    return Window(float(np.tan(np.radians(low))), float(np.tan(np.radians(high))), -half_v, half_v)


# --- tolerances


def _spread(bsdf: xr.Dataset, window: HazeWindow, azimuths: Array, scale: float) -> float:
    """Standard uncertainty from the tolerances; of a surface with a lay, of the mean over its azimuths."""
    common, own = _common_ends(window), _own_ends(window)
    haze = [float(_units(*reading).mean()) for reading in _received(bsdf, [*common, *own], azimuths, scale)]
    # What is common moves both windows together, (tolerance, end, side); what is each one's own, alone.
    both = np.array(haze[: len(common)]).reshape(-1, 2, 2).sum(axis=2)
    alone = np.array(haze[len(common) :]).reshape(-1, 2)
    ranges = np.concatenate([np.diff(both, axis=1), np.diff(alone, axis=1)]) / 2
    return float(np.sqrt(np.sum(ranges**2) / 3))


def _common_ends(window: HazeWindow) -> list[Beam]:
    """Both windows at either end of the tolerances of the source and of the incidence."""
    (full_u, full_v), (more_u, more_v) = SOURCE, SOURCE_TOLERANCE
    lights = [
        *((window.angle, centred(full_u + end * more_u, full_v)) for end in _ENDS),
        *((window.angle, centred(full_u, full_v + end * more_v)) for end in _ENDS),
        *((abs(window.angle + end * AXIS_TOLERANCE), centred(full_u, full_v)) for end in _ENDS),
    ]
    return [
        Beam(angle, source(angle, QUICK, image), _rectangle(window, side), _ORDER)
        for angle, image in lights
        for side in _SIDES
    ]


def _own_ends(window: HazeWindow) -> list[Beam]:
    """Each window at either end of its own tolerances."""
    (along, across), (more_u, more_v) = window.aperture, RECEPTOR_TOLERANCE[20.0]
    light = source(window.angle, QUICK)
    rectangles = [
        _rectangle(window._replace(aperture=aperture), side, moved)
        for side in _SIDES
        for aperture, moved in (
            *(((along + end * min(more_u, along / 2), across), 0.0) for end in _ENDS),
            *(((along, across + end * min(more_v, across / 2)), 0.0) for end in _ENDS),
            *((window.aperture, end * AXIS_TOLERANCE) for end in _ENDS),
        )
    ]
    return [Beam(window.angle, light, rectangle, _ORDER) for rectangle in rectangles]
