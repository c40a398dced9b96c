"""Reflectance haze: light that additional receptors of a gloss meter receive beside the mirror image of its source.

H = 100 · (light in windows on both sides of the mirror direction) ÷ (light that black glass of index 1.567 mirrors), so that haze
and gloss share one scale. Light that a polished surface mirrors never reaches a window.

References
----------
ISO 13803 and ASTM E430 B (20°, windows at 18.1° and 21.9°); ASTM E430 A (30°, windows at 28° or 32°, and at 25° or 35°) and C (30°,
at 28° or 32°, and at 15°). Conformance is not claimed: results are "ISO 13803-style".

The standards are sold, not published. Public sources confirm these angles, the receptors of ISO 13803 on both sides of that of 20°
gloss, which is 1.8° wide, and the ratio to the light that the reference of gloss mirrors. They do not confirm the width of the
windows (here as wide as the receptor of gloss) or the tolerances (here those of 20° gloss). The logarithmic unit and the correction
for the luminance of the coating, which instruments offer, are not implemented.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from brdfpipe.appearance import apertures
from brdfpipe.appearance.apertures import Beam, Rule, Sample, Window, centred, half_width
from brdfpipe.appearance.gloss_meter import AXIS_TOLERANCE, RECEPTOR_TOLERANCE, SOURCE_TOLERANCE
from brdfpipe.appearance.tolerances import labelled, standard_uncertainty
from brdfpipe.bsdf.source_changes import Reflector
from brdfpipe.errors import BrdfpipeError
from brdfpipe.geometry import Array

_ENDS = _SIDES = (-1, 1)

_CLEARANCE = apertures.SOURCE[0] / 2 + 0.125
"""Offset from the mirror direction at which a source image at the upper end of its tolerance ends [degree]."""


class HazeError(BrdfpipeError):
    """Impossible window of a haze meter."""


class HazeWindow(NamedTuple):
    """A pair of receptors beside the mirror direction."""

    angle: float
    """Incidence [degree]."""
    offset: float
    """Offset of the axes of the receptors from the mirror direction, in the plane of incidence, on both sides [degree]."""
    aperture: tuple[float, float]
    """Full angles in the plane of incidence and across it [degree]."""

    @property
    def title(self) -> str:
        return f"{self.angle:g}° ± {self.offset:g}°, {self.aperture[0]:g}° × {self.aperture[1]:g}°"


WINDOWS = (HazeWindow(20.0, 1.9, (1.8, 3.6)),)
"""Window of ISO 13803 and ASTM E430 B: beside the receptor of 20° gloss, 18.1° and 21.9°; as wide as it, which is not confirmed."""


def reflectance_haze(
    bsdf: xr.Dataset, windows: Sequence[HazeWindow | Mapping[str, Any]] = WINDOWS, *, azimuth: float | None = None
) -> xr.DataArray:
    """Light beside the mirror image of the source, in gloss units.

    Parameters
    ----------
    bsdf : kind ``bsdf``; averaged with V(λ)·D65 where it depends on wavelength
    windows : or mappings with ``angle``, ``offset`` and ``aperture``
    azimuth : of the plane of incidence [degree]; by default the mean over all azimuths, for surfaces with a lay

    Returns
    -------
    DataArray ``reflectance_haze(haze_window)`` [1]

    Raises
    ------
    HazeError : a window that covers part of the mirror image of the source, or extends below the surface.
    """
    sample, checked = apertures.sample_of(bsdf, azimuth), [checked_window(window) for window in windows]
    return _labelled("reflectance_haze", [_haze(sample, window)[1].mean() for window in checked], checked)


def reflectance_haze_with_uncertainty(
    bsdf: xr.Dataset, windows: Sequence[HazeWindow | Mapping[str, Any]] = WINDOWS, *, azimuth: float | None = None
) -> tuple[xr.DataArray, xr.DataArray]:
    """Reflectance haze, and its standard uncertainty from the tolerances of instruments.

    Parameters
    ----------
    bsdf, windows, azimuth : as for :func:`reflectance_haze`, which states the errors raised

    Returns
    -------
    ``reflectance_haze(haze_window)``, ``reflectance_haze_u(haze_window)`` [1]

    Notes
    -----
    As :func:`brdfpipe.appearance.gloss_with_uncertainty`, with its tolerances at 20°: full angles of the source (common to both
    windows), full angles and axis of each window, and the angle of incidence. Each of the nine rectangular distributions is
    evaluated at both ends.
    """
    sample, checked = apertures.sample_of(bsdf, azimuth), [checked_window(window) for window in windows]
    values, uncertainties = [], []
    for window in checked:
        azimuths, haze_by_azimuth = _haze(sample, window)
        values.append(haze_by_azimuth.mean())
        uncertainties.append(_uncertainty(sample, window, azimuths[apertures.first_half(azimuths)]))
    title = "standard uncertainty of haze beside the mirror direction, from tolerances"
    haze_u = _labelled("reflectance_haze_u", uncertainties, checked).assign_attrs(long_name=title)
    return _labelled("reflectance_haze", values, checked), haze_u


def _labelled(name: str, values: Sequence[float], windows: Sequence[HazeWindow]) -> xr.DataArray:
    return labelled(name, values, haze_window=np.array([window.title for window in windows], dtype=object))


def checked_window(window: HazeWindow | Mapping[str, Any]) -> HazeWindow:
    """A window, or the mapping that describes it, checked.

    Raises HazeError: the window covers part of the mirror image of the source, or extends below the surface.
    """
    if isinstance(window, Mapping):
        along, across = window["aperture"]
        window = HazeWindow(float(window["angle"]), float(window["offset"]), (float(along), float(across)))
    inner, outer = window.offset - window.aperture[0] / 2, window.offset + window.aperture[0] / 2
    if not inner >= _CLEARANCE:
        raise HazeError(
            f"haze window {window.title}: covers part of the source's image; accepted: an inner edge of at least "
            f"{_CLEARANCE:g}°, found {inner:g}°; change `appearance.haze`"
        )
    if not (window.angle >= 0 and window.angle + outer < 90 and window.aperture[1] < 90):
        raise HazeError(
            f"haze window {window.title}: extends below the surface; accepted: an outer edge below 90°, found "
            f"{window.angle + outer:g}°; change `appearance.haze`"
        )
    return window


def _haze(sample: Sample, window: HazeWindow) -> tuple[Array, Array]:
    """Azimuths of the plane of incidence, and the haze at each."""

    def measure(azimuths: Array, rule: Rule) -> Array:
        return haze_units(sample, window, azimuths, rule)

    return apertures.over_azimuths(sample, measure, apertures.QUICK)


def haze_units(
    sample: Sample, window: HazeWindow, azimuths: Array, rule: Rule, reflector: Reflector | None = None
) -> Array:
    """Haze at azimuths of the plane of incidence [degree], (azimuths,); of the sample, or of a ``reflector`` in its place."""
    beams = beams_of(window, rule)
    return haze_of(beams, apertures.received(sample, beams, azimuths, reflector))


def beams_of(window: HazeWindow, rule: Rule) -> list[Beam]:
    """From the source into the windows on both sides."""
    light = apertures.source(window.angle, rule)
    return [Beam(window.angle, light, _rectangle(window, side), rule.window) for side in _SIDES]


def haze_of(beams: Sequence[Beam], scattered: Sequence[Array]) -> Array:
    """Haze at azimuths, from the light that the windows on both sides have received (:func:`.apertures.received`)."""
    units = [apertures.gloss_units_of(beam.light, flux) for beam, flux in zip(beams, scattered, strict=True)]
    return np.asarray(np.sum(units, axis=0))


def _rectangle(window: HazeWindow, side: int, shift: float = 0.0) -> Window:
    """The window in the tangent plane of the mirrored axis, where angles away from the axis are stretched; ``shift`` in degree."""
    offset = window.offset + shift
    low, high = sorted(side * (offset + end * window.aperture[0] / 2) for end in _ENDS)
    half_v = half_width(window.aperture[1]) / np.cos(np.radians(offset))
    return Window(float(np.tan(np.radians(low))), float(np.tan(np.radians(high))), -half_v, half_v)


# --- tolerances


def _uncertainty(sample: Sample, window: HazeWindow, azimuths: Array) -> float:
    """Standard uncertainty from the tolerances; for a surface with a lay, of the mean over its azimuths."""
    common, own = _common_beams(window), _window_beams(window)
    flux = apertures.received(sample, [*common, *own], azimuths)
    haze = [
        float(apertures.gloss_units_of(beam.light, part).mean())
        for beam, part in zip([*common, *own], flux, strict=True)
    ]
    # Common tolerances move both windows together, (tolerance, end, side); those of each window move it alone.
    both = np.array(haze[: len(common)]).reshape(-1, 2, 2).sum(axis=2)
    alone = np.array(haze[len(common) :]).reshape(-1, 2)
    return float(standard_uncertainty(np.concatenate([np.diff(both, axis=1), np.diff(alone, axis=1)]) / 2, axis=None))


def _common_beams(window: HazeWindow) -> list[Beam]:
    """Both windows at either end of the tolerances of the source and of the incidence."""
    (full_u, full_v), (more_u, more_v) = apertures.SOURCE, SOURCE_TOLERANCE
    lights = [
        *((window.angle, centred(full_u + end * more_u, full_v)) for end in _ENDS),
        *((window.angle, centred(full_u, full_v + end * more_v)) for end in _ENDS),
        *((abs(window.angle + end * AXIS_TOLERANCE), centred(full_u, full_v)) for end in _ENDS),
    ]
    return [
        Beam(
            angle,
            apertures.source(angle, apertures.QUICK, image),
            _rectangle(window, side),
            apertures.UNCERTAINTY_ORDER,
        )
        for angle, image in lights
        for side in _SIDES
    ]


def _window_beams(window: HazeWindow) -> list[Beam]:
    """Each window at either end of its own tolerances."""
    (along, across), (more_u, more_v) = window.aperture, RECEPTOR_TOLERANCE[20.0]
    light = apertures.source(window.angle, apertures.QUICK)
    rectangles = [
        _rectangle(window._replace(aperture=aperture), side, shift)
        for side in _SIDES
        for aperture, shift in (
            *(((along + end * min(more_u, along / 2), across), 0.0) for end in _ENDS),
            *(((along, across + end * min(more_v, across / 2)), 0.0) for end in _ENDS),
            *((window.aperture, end * AXIS_TOLERANCE) for end in _ENDS),
        )
    ]
    return [Beam(window.angle, light, rectangle, apertures.UNCERTAINTY_ORDER) for rectangle in rectangles]
