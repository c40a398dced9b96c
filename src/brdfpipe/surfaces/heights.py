"""Heights on a constant-pitch grid: their dataset, and plausibility checks.

The checks find a wrong unit, a channel other than height, or a file of another kind that a reader happened to open. Their limits
are far from any finish of a plastic, paint or film.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe.errors import InputError
from brdfpipe.file_formats import FileFormat
from brdfpipe.surfaces import placeholders
from brdfpipe.vocabulary import add_history, add_warning, label

PITCH_RANGE = (1e-3, 1e3)  # accepted pitch [um]
EXTENT_MAX = 1e6  # an extent from this on is refused [um]
GRID_MIN = 32  # fewest points of a map along either axis
LINE_MIN = 64  # fewest points of a line profile
SLOPE_RANGE = (1e-4, 3.0)  # accepted rms slope, mean slope removed [1]
LEVELS_MIN = 16  # fewest distinct heights
MISSING_WARN = 0.01  # share of missing heights above which a warning follows
MISSING_MAX = 0.5  # share of missing heights above which the file is refused
PITCH_RATIO_WARN = 2.0  # ratio of the wider to the narrower pitch of a map, above which a warning follows
STEP_WARN = 30.0  # slope between two neighbours above which a warning follows [1]
PEAKED_WARN = 6.0  # rms over median slope above which a warning follows


@dataclass(frozen=True)
class Heights:
    """Heights and pitches that a reader returns.

    Parameters
    ----------
    height : (y, x) or (x,), um, NaN where missing
    pitch_x, pitch_y : um; ``pitch_y`` is None for a line
    history : corrections, in words
    warnings : doubts; each says what to do
    unit : of the heights in the file [um], for formats whose unit a key may state
    left_out : of the shape of ``height``, true where a mask leaves heights out, which are NaN too; None without a mask
    """

    height: NDArray[np.floating]
    pitch_x: float
    pitch_y: float | None = None
    history: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    unit: float = 1.0
    left_out: NDArray[np.bool_] | None = None


@dataclass(frozen=True)
class SurfaceFormat(FileFormat):
    """A format of surface files."""

    read: Callable[..., Heights]
    options: tuple[str, ...] = ()
    """Keyword arguments of the reader, keys of ``surface``."""
    orientation: str = "first row at y = 0"
    """Which edge of the map comes first, and how that is known, for the documentation."""


LINES, UNCONFIRMED = "line profiles", "upper edge first, unconfirmed"
"""Orientations of formats: of those without maps, and of those for which neither a description nor a second reader says it."""


UNSTATED = ("unit", "lateral_unit", "pitch")
"""Options of formats that do not state unit and pitch."""


def infinite_as_missing(height: NDArray[np.floating]) -> tuple[str, ...]:
    """Mark infinite heights as missing, in place; return a note for the history if there are any."""
    infinite = np.isinf(height)
    height[infinite] = np.nan
    return (f"{np.count_nonzero(infinite)} infinite heights taken as missing.",) if infinite.any() else ()


def surface_dataset(heights: Heights) -> xr.Dataset:
    """The dataset of kind ``surface`` of the heights from a reader, not levelled."""
    steps = {"x": heights.pitch_x} if heights.pitch_y is None else {"y": heights.pitch_y, "x": heights.pitch_x}
    pitches = {f"pitch_{dim}": steps[dim] for dim in ("x", "y") if dim in steps}
    surface = xr.Dataset(
        {"height": (tuple(steps), heights.height, {"long_name": "height, not levelled"})},
        {dim: np.arange(count) * step for (dim, step), count in zip(steps.items(), heights.height.shape, strict=True)},
        {**pitches, "levelling": "none", "band": band(pitches)},
    )
    return add_warning(add_history(label(surface, "surface"), *heights.history), *heights.warnings)


def band(attrs: Mapping[str, Any]) -> str:
    """Bandwidth of a surface in words, from its attributes ``pitch_x``, ``pitch_y``, ``lambda_s``, ``lambda_c`` [um]."""
    pitch_x, pitch_y = attrs["pitch_x"], attrs.get("pitch_y")
    square = pitch_y is None or abs(pitch_y - pitch_x) < 1e-3 * pitch_x
    pitch = f"{pitch_x:.4g}" if square else f"{pitch_x:.4g} x {pitch_y:.4g}"
    filters = [
        f"{symbol} {attrs[name]:.4g} um" if name in attrs else f"no {symbol}"
        for symbol, name in (("λs", "lambda_s"), ("λc", "lambda_c"))
    ]
    return f"{pitch} um pitch; {', '.join(filters)} filter"


def examine(
    surface: xr.Dataset,
    file: Path,
    keys: Collection[str] = (*UNSTATED, "layout"),
    unit: float = 1.0,
    left_out: NDArray[np.bool_] | None = None,
    declared: Sequence[float] = (),
) -> xr.Dataset:
    """Refuse implausible heights; warn about doubtful ones.

    Parameters
    ----------
    surface : kind ``surface``
    file : raw file, for messages
    keys : keys of ``surface`` that apply to the format of the file, and ``region`` where it was cropped: messages suggest no other
    unit : of the heights in the file [um], for messages
    left_out : where a mask leaves heights out, which then do not count as missing from the measurement
    declared : values that already count as missing, in the unit of the file, for messages

    Returns
    -------
    The surface, with warnings for more than 1 % missing heights, for sections of unequal pitch (ratio above 2), for spikes
    (slopes above 30 between two neighbours), and slopes dominated by a few steps (rms over 6 times the median; of a Gaussian
    it is 1.5, of GGX over 10⁶ heights 4.3).

    Raises
    ------
    InputError : pitch outside 1 nm to 1 mm; extent of 1 m or more; fewer than 32 x 32 (areal) or 64 (line) points; infinite
        heights; more than 50 % missing; values that look like marks of missing heights; fewer than 16 distinct heights; rms
        slope, mean slope removed, outside [1e-4, 3].
    """
    height = surface.height.values
    pitches = [surface.attrs[f"pitch_{dim}"] for dim in surface.height.dims]
    _check_grid(height.shape, pitches, file, keys)
    missing = np.isnan(height)
    fraction = float(missing.mean() if left_out is None else missing[~left_out].mean())
    if fraction > MISSING_MAX:
        accepted = "at most 50 %; measure again, or export a part with fewer gaps"
        raise InputError(file, "more than half of the heights are missing", found=f"{fraction:.1%}", accepted=accepted)
    _check_placeholders(height, file, unit, declared)
    steepest, peaked = _check_heights(height, pitches, file, keys)
    return add_warning(surface, *_doubts(fraction, pitches, steepest, peaked))


def _applicable(key: str, keys: Collection[str]) -> dict[str, str]:
    """The key to set, for a message, if it applies to the format of the file."""
    return {"key": f"surface.{key}"} if key in keys else {}


_ELSEWHERE = "; the file states its units: correct them in the instrument's software, or export it as text"
"""What remains where no key applies."""


def _check_grid(shape: tuple[int, ...], pitches: list[float], file: Path, keys: Collection[str]) -> None:
    for dim, pitch, count in zip("yx"[-len(shape) :], pitches, shape, strict=True):
        extent, problem = pitch * count, ""
        if not PITCH_RANGE[0] <= pitch <= PITCH_RANGE[1]:
            problem, found, accepted = "implausible pitch", f"{pitch:g} um", "1 nm to 1 mm"
        elif extent >= EXTENT_MAX:
            problem, found, accepted = "implausible extent", f"{extent / 1e6:g} m", "less than 1 m"
        if problem:
            named = _applicable("lateral_unit", keys)
            accepted += "" if named else _ELSEWHERE
            raise InputError(file, f"{problem} along {dim}", found=found, accepted=accepted, **named)
    least = LINE_MIN if len(shape) == 1 else GRID_MIN
    if min(shape) < least:
        raise InputError(
            file,
            "too few points for a slope distribution",
            found=" x ".join(map(str, shape)),
            accepted=f"{LINE_MIN} or more along a line, {GRID_MIN} x {GRID_MIN} or more of an area",
            **_applicable("region" if "region" in keys else "layout", keys),
        )


def _check_placeholders(height: NDArray[np.floating], file: Path, unit: float, declared: Sequence[float]) -> None:
    found = placeholders.find(height)
    if not found:
        return
    values = [f"{mark.value / unit:.7g}" for mark in found]
    known = [f"{value:.7g}" for value in declared]
    listed = ", ".join((*known, *values))
    one = len(found) == 1
    raise InputError(
        file,
        f"{'one value lies' if one else f'{len(found)} values lie'} far from all other heights, as if marking missing ones",
        found=", ".join(f"{value} in {mark.times}" for value, mark in zip(values, found, strict=True))
        + f" of {np.count_nonzero(~np.isnan(height))} heights",
        accepted=f"`missing: {listed if one and not known else f'[{listed}]'}` if {'it does' if one else 'they do'}; else heights without {'it' if one else 'them'}",
        key="surface.missing",
    )


def _check_heights(
    height: NDArray[np.floating], pitches: list[float], file: Path, keys: Collection[str]
) -> tuple[float, float]:
    """Refuse implausible heights; return the steepest slope between two neighbours, and rms over median slope."""
    if np.isinf(height).any():
        found, accepted = int(np.isinf(height).sum()), "numbers; NaN, *** or an empty field where a height is missing"
        raise InputError(file, "infinite heights", found=f"{found} of them", accepted=accepted)
    sample = _sample(height)
    levels = np.unique(sample[~np.isnan(sample)]).size
    if levels < LEVELS_MIN:
        raise InputError(
            file,
            "the heights are quantised to a few levels",
            found=f"{levels} distinct values",
            accepted=f"{LEVELS_MIN} or more: a height channel (not intensity), exported with more digits",
        )
    slope, steepest, peaked = _slopes(height, pitches)
    if not SLOPE_RANGE[0] <= slope <= SLOPE_RANGE[1]:
        accepted, named = f"{SLOPE_RANGE[0]:g} to {SLOPE_RANGE[1]:g}", _applicable("unit", keys)
        problem = "implausible rms slope of a surface finish"
        problem += "; check the unit of the heights, and that of the distances, `surface.lateral_unit`" if named else ""
        accepted += "" if named else _ELSEWHERE
        raise InputError(file, problem, found=f"{slope:.3g}", accepted=accepted, **named)
    return steepest, peaked


def _slopes(height: NDArray[np.floating], pitches: list[float]) -> tuple[float, float, float]:
    """rms slope of the forward differences about their mean, the steepest, and the larger rms over median of an axis.

    0 where no two neighbours are valid.
    """
    variance, steepest, peaked = 0.0, 0.0, 0.0
    # Damaged files may contain any number; slopes that overflow are refused later.
    with np.errstate(over="ignore", invalid="ignore"):
        for axis, pitch in enumerate(pitches):
            steps = np.diff(height, axis=axis)
            if np.isnan(height).any():
                steps = steps[~np.isnan(steps)]
            if steps.size:
                squared = float(steps.var(dtype=np.float64))
                variance += squared / pitch**2
                steepest = max(steepest, float(steps.max()) / pitch, -float(steps.min()) / pitch)
                median = float(np.median(np.abs(_sample(steps) - steps.mean(dtype=np.float64))))
                # Coarsely quantised or flat heights have no median step to compare with.
                peaked = max(peaked, math.sqrt(squared) / median if median > 0 else 0.0)
    return math.sqrt(variance), steepest, peaked


def _sample(values: NDArray[np.floating]) -> NDArray[np.floating]:
    """Evenly spaced sample: sorting all values of a large map would take longer than reading it."""
    return values.ravel()[:: max(1, values.size // 20011)]


def _doubts(missing: float, pitches: list[float], steepest: float, peaked: float) -> list[str]:
    doubts = []
    if peaked > PEAKED_WARN and steepest <= STEP_WARN:
        doubts.append(
            f"A few steps dominate the rms slope ({peaked:.2g} times the median): dust, scratches, an edge or "
            "damaged heights. Inspect the height map and mark them as missing, or measure another spot."
        )
    if steepest > STEP_WARN:
        doubts.append(
            f"Slope of {steepest:.3g} between two neighbouring heights: a spike or a damaged height; "
            "mark it as missing in the instrument's software, or measure again."
        )
    if missing > MISSING_WARN:
        doubts.append(
            f"{missing:.1%} of the heights are missing, probably on the steepest facets, and slopes may be understated; "
            "measure with higher aperture or at several tilts."
        )
    ratio = max(pitches) / min(pitches)
    if ratio > PITCH_RATIO_WARN:
        doubts.append(
            f"The pitches along x and y differ by a factor {ratio:.2g}: slopes across the wider one are smoothed; "
            "measure with equal pitches."
        )
    return doubts
