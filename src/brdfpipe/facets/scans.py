"""Whether several scans show one surface alike, so that their facets may be counted together."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.facets.counting import FacetError
from brdfpipe.geometry import Array

_TOLERANCE = 1.01
_WELL_SAMPLED = 8.0
"""Pitches to a cutoff λs from which the filter alone decides: slopes then lose less than 3 % of their rms to the pitch."""


def check_alike(scans: Sequence[xr.Dataset]) -> None:
    """Refuse scans that do not hold the same waves: what a finer pitch or other filters let through would pass for one finish.

    Parameters
    ----------
    scans : kind ``surface``, all maps or all lines

    Raises
    ------
    FacetError : a cutoff differs by more than 1 % from that of the first scan, or only one of them was filtered; or a pitch
        does, and no common λs of at least 8 pitches makes up for it; or one scan is given twice.
    """
    first = scans[0].attrs
    pitches = [name for name in ("pitch_x", "pitch_y") if name in first]
    for number, scan in enumerate(scans[1:], start=2):
        pair = first, scan.attrs
        enough = _WELL_SAMPLED * max(float(each[name]) for each in pair for name in pitches)
        filtered = min(float(each.get("lambda_s", 0.0)) for each in pair) >= enough
        for name in ("lambda_s", "lambda_c", *([] if filtered else pitches)):
            values = [float(each.get(name, 0.0)) for each in pair]
            if max(values) > _TOLERANCE * min(values):
                raise FacetError(
                    f"scans 1 and {number} of the surface do not hold the same waves: {name} is "
                    + " and ".join(f"{value:.4g} um" if value else "not set" for value in values)
                    + "; accepted: filters and pitches within 1 %; measure alike and filter alike (`surface.lambda_s`, "
                    f"`surface.lambda_c`): with one λs of at least {enough:.4g} um pitches may differ"
                )
    for (one, a), (two, b) in combinations(enumerate(scans, start=1), 2):
        if _identical(a, b):
            raise FacetError(
                f"scans {one} and {two} of the surface hold the same heights, which would count as twice the evidence; accepted: "
                "each scan once; take one of them out of `surface.scans`"
            )


def _identical(a: xr.Dataset, b: xr.Dataset) -> bool:
    first, second = (np.atleast_2d(each["height"].values) for each in (a, b))
    # A line may stand for two directions. Row by row: two maps mostly differ in the first.
    return (
        first.shape == second.shape
        and a.attrs.get("azimuth", 0.0) == b.attrs.get("azimuth", 0.0)
        and all(np.array_equal(*rows, equal_nan=True) for rows in zip(first, second, strict=True))
    )


def with_roughness_warning(facets: xr.Dataset, scan_rms: Array) -> xr.Dataset:
    """Warn where scans differ clearly in their slope rms (scans,): they may show two finishes, or one may be worn or out of focus."""
    smooth, rough = int(np.argmin(scan_rms)), int(np.argmax(scan_rms))
    if scan_rms[rough] <= _ALIKE * scan_rms[smooth]:
        return facets
    return vocabulary.add_warning(
        facets,
        f"scan {smooth + 1} has the slope rms {scan_rms[smooth]:.3g} and scan {rough + 1} {scan_rms[rough]:.3g}: the result is of neither; "
        "check that both show one finish, or take one out of `surface.scans`",
    )


_ALIKE = 1.2
"""Rougher over smoother scan above which chance hardly makes them differ."""
