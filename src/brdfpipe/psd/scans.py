"""What the scans of a surface are for: those whose slopes are counted, those that extend the spectrum, and repeats that show the noise."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import xarray as xr

from brdfpipe.psd.k_correlation import PsdError
from brdfpipe.psd.noise_floor import NoiseFloor, from_repeats, given
from brdfpipe.psd.periodograms import Scan

WELL_SAMPLED = 8.0
"""Pitches to a cutoff λs from which the filter alone decides: slopes then lose less than 3 % of their rms to the pitch."""

_OTHER_MAGNIFICATION = 1.5
"""Ratio of pitches from which two scans are of different magnification."""


class SortedScans(NamedTuple):
    """Scans of one surface by what they are for."""

    counted: list[xr.Dataset]
    """The first scan, and those of its magnification."""
    extending: list[xr.Dataset]
    """Those of another magnification: they extend the roughness spectrum alone."""
    noise: NoiseFloor | None
    """White height noise of the counted scans: given, from repeats, or None, not known beforehand."""


def sort_scans(
    scans: Sequence[xr.Dataset], noise: float | None = None, noise_uncertainty: float | None = None
) -> SortedScans:
    """Sort the scans of a surface by what they are for.

    Parameters
    ----------
    scans : kind ``surface``, at least one. Those whose attribute ``repeat`` is true are of the same place as the first
    noise : rms of white height noise of the scans that are counted [um]
    noise_uncertainty : its standard uncertainty [um]

    Raises
    ------
    PsdError : noise is given although there are repeats, for filtered heights, or not below the rms of the heights; an uncertainty without
        noise or above it; a repeat of other shape or pitch, or identical.
    """
    first = scans[0]
    repeats = [scan for scan in scans[1:] if scan.attrs.get("repeat")]
    others = [scan for scan in scans[1:] if not scan.attrs.get("repeat")]
    extending = [scan for scan in others if _of_other_magnification(first, scan)]
    counted = [first, *(scan for scan in others if not any(scan is other for other in extending))]
    if noise is None and noise_uncertainty is not None:
        raise PsdError(
            "the uncertainty of the height noise is given without the noise; accepted: `surface.noise_uncertainty` beside `surface.noise`"
        )
    if not repeats:
        return SortedScans(counted, extending, _given(counted, noise, noise_uncertainty or 0.0))
    if noise is not None:
        raise PsdError(
            "the height noise is given, and scans repeat the first; accepted: one of `surface.noise` and `surface.scans.repeat`"
        )
    if "lambda_s" in first.attrs:
        raise PsdError(
            f"a scan repeats the first, and the heights were smoothed with λs = {first.attrs['lambda_s']:g} um, after which noise is not white; "
            "accepted: one of `surface.scans.repeat` and `surface.lambda_s`"
        )
    floor = from_repeats(Scan.of(first), [Scan.of(scan) for scan in repeats])
    return SortedScans(counted, extending, floor)


def _given(scans: Sequence[xr.Dataset], noise: float | None, uncertainty: float) -> NoiseFloor | None:
    """A given noise, which must be possible for each scan."""
    if noise is None:
        return None
    floors = [given(Scan.of(scan), noise, float(scan.attrs.get("lambda_s", 0.0)), uncertainty) for scan in scans]
    return floors[0]


def commonly_filtered(one: xr.Dataset, other: xr.Dataset) -> bool:
    """Whether a low-pass filter, and not the pitch, limits the waves of two scans."""
    pair = one.attrs, other.attrs
    pitches = [float(attrs[name]) for attrs in pair for name in ("pitch_x", "pitch_y") if name in attrs]
    return min(float(attrs.get("lambda_s", 0.0)) for attrs in pair) >= WELL_SAMPLED * max(pitches)


def _of_other_magnification(first: xr.Dataset, other: xr.Dataset) -> bool:
    """All pitches of one are much finer than those of the other."""
    one, two = ([float(scan.attrs[f"pitch_{axis}"]) for axis in scan["height"].dims] for scan in (first, other))
    apart = max(min(one) / max(two), min(two) / max(one)) >= _OTHER_MAGNIFICATION
    return apart and not commonly_filtered(first, other)
