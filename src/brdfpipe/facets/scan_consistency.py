"""Check that several scans of one surface are comparable, so that their facets may be counted together."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.facets.slope_histogram import FacetError
from brdfpipe.geometry import Array

_TOLERANCE = 1.01
_WELL_SAMPLED = 8.0
"""Pitches to a cutoff λs from which the filter alone decides: slopes then lose less than 3 % of their rms to the pitch."""


def check_consistent(scans: Sequence[xr.Dataset]) -> None:
    """Refuse scans of different bandwidth (pitch, filters), whose slopes are not comparable.

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
        required = _WELL_SAMPLED * max(float(attrs[name]) for attrs in pair for name in pitches)
        filtered = min(float(attrs.get("lambda_s", 0.0)) for attrs in pair) >= required
        for name in ("lambda_s", "lambda_c", *([] if filtered else pitches)):
            values = [float(attrs.get(name, 0.0)) for attrs in pair]
            if max(values) > _TOLERANCE * min(values):
                raise FacetError(
                    f"scans 1 and {number} of the surface have different bandwidths: {name} is "
                    + " and ".join(f"{value:.4g} um" if value else "not set" for value in values)
                    + "; accepted: cutoffs and pitches equal within 1 %; measure at one pitch and set one `surface.lambda_s` and "
                    f"`surface.lambda_c` (with λs of at least {required:.4g} um, pitches may differ)"
                )
    for (one, a), (two, b) in combinations(enumerate(scans, start=1), 2):
        if _identical(a, b):
            raise FacetError(
                f"scans {one} and {two} of the surface have identical heights; accepted: "
                "each scan once; remove one of them from `surface.scans`"
            )


def _identical(a: xr.Dataset, b: xr.Dataset) -> bool:
    first, second = (np.atleast_2d(scan["height"].values) for scan in (a, b))
    # One line may be given for two directions. Compared row by row: two maps mostly differ in the first.
    return (
        first.shape == second.shape
        and a.attrs.get("azimuth", 0.0) == b.attrs.get("azimuth", 0.0)
        and all(np.array_equal(*rows, equal_nan=True) for rows in zip(first, second, strict=True))
    )


def with_roughness_warning(facets: xr.Dataset, scan_rms: Array) -> xr.Dataset:
    """Warn if the slope rms (scans,) differs clearly: the scans may show two finishes, or one may be worn or out of focus."""
    smooth, rough = int(np.argmin(scan_rms)), int(np.argmax(scan_rms))
    if scan_rms[rough] <= _RMS_RATIO_LIMIT * scan_rms[smooth]:
        return facets
    return vocabulary.add_warning(
        facets,
        f"the slope rms differs between scans: {scan_rms[smooth]:.3g} in scan {smooth + 1}, {scan_rms[rough]:.3g} in scan {rough + 1}; the "
        "facet distribution averages both. Check that they show the same finish, or remove one from `surface.scans`",
    )


_RMS_RATIO_LIMIT = 1.2
"""Ratio of slope rms between scans that is unlikely to arise by chance."""
