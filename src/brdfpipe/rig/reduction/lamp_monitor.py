"""Monitor readings of the lamp: its drift during a run, and how well light repeats over its reference."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import xarray as xr

from brdfpipe.geometry import Array
from brdfpipe.rig.description import Rig
from brdfpipe.rig.reduction import brackets
from brdfpipe.rig.reduction.brackets import DarkFrames, ReferenceSpot

REPEAT_U = 0.01 / 3**0.5
"""Assumed relative standard uncertainty of light over its reference before a run shows how well it repeats: a uniform distribution over ±1 %,
the better end of the 1 to 3 % stated for such a rig (Voloboy et al. 2005)."""

_FEWEST_REPETITIONS = 2  # degrees of freedom from which the observed scatter replaces the assumption


def lamp_monitor_readings(
    frames: xr.Dataset, chosen: xr.Dataset, darks: DarkFrames, spot: ReferenceSpot, rig: Rig
) -> dict[str, tuple[str, Array]]:
    """Light of the lamp in the monitor frames through the entrance of the arrangement, with any load in the holder.

    Variables of dimension ``look``: ``drift_reference`` [e⁻/s], its uncertainty, ``drift_elapsed`` [s] and ``drift_wavelength`` [nm].
    """
    matching = frames["purpose"].values == "drift"
    for name in ("side", "incidence"):
        matching &= frames[name].values == chosen[name].values[0]
    if not matching.any():
        return {}
    monitor = frames.isel(frame=matching)
    bracket = brackets.read_bracket(monitor, darks, rig)
    reference, relative_u = brackets.reference_light(bracket, spot)
    rate = reference / brackets.reference_exposure(bracket, rig)
    readings = {"reference": rate, "reference_u": rate * relative_u}
    readings |= {name: monitor[name].values for name in ("elapsed", "wavelength")}
    return {f"drift_{name}": ("look", values) for name, values in readings.items()}


def lamp_repeatability(frames: xr.Dataset, darks: DarkFrames, spot: ReferenceSpot, rig: Rig) -> tuple[float, list[str]]:
    """Relative scatter of light over its reference between frames of the same settings, and warnings.

    A monitor reading repeats a frame of its arrangement. All repetitions in the run count, with any load in the holder, if they are bright
    enough to show less than :data:`REPEAT_U`, which counts as one of them. The part of the scatter that is photon and read noise is subtracted.
    """
    squares, freedom, readings = 0.0, 0, 0
    for repeated in _repeated_frames(frames, darks):
        readings += repeated.sizes["frame"]
        bracket = brackets.read_bracket(repeated, darks, rig)
        reference, relative_u = brackets.reference_light(bracket, spot)
        lit = bracket.usable.all(axis=0) & spot.outside & (bracket.light.mean(axis=0) > np.sqrt(bracket.floor.mean()))
        light = np.where(lit, bracket.light, 0.0).sum(axis=(1, 2), dtype=float)
        if not ((light > 0) & np.isfinite(reference)).all():
            continue
        noise = float(((light + lit.sum() * bracket.floor) / light**2 + relative_u**2).mean())
        if noise < REPEAT_U**2:
            ratio, more = light / reference, light.size - 1
            squares += more * (float(ratio.var(ddof=1) / ratio.mean() ** 2) - noise)
            freedom += more
    u = float(np.sqrt((max(squares, 0.0) + REPEAT_U**2) / (freedom + 1)))
    if freedom >= _FEWEST_REPETITIONS:
        return u, []
    warning = (
        f"Lamp repeatability is uncertain: only {freedom} usable repetition{'' if freedom == 1 else 's'} among {readings} frames of equal settings. "
        f"Assumed {u:.1%} (k = 1). Take more readings (`drift.every`) or a brighter frame (`drift.step`)."
    )
    return u, [warning]


def _repeated_frames(frames: xr.Dataset, darks: DarkFrames) -> Iterator[xr.Dataset]:
    """Frames of the same settings: monitor readings, and the frame of the bracket that they repeat."""
    names = ("load", "side", "incidence", "wavelength", "nd_position", "exposure")
    settings = list(zip(*(frames[name].values.tolist() for name in names), strict=True))
    purpose = frames["purpose"].values
    for monitored in sorted({settings[frame] for frame in np.flatnonzero(purpose == "drift")}):
        same = np.array([setting == monitored for setting in settings]) & (purpose != "dark")
        if same.sum() > 1 and monitored[-1] in darks.by_exposure:
            yield frames.isel(frame=same)
