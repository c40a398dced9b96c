"""Location and transmittances of the neutral filters, verified by bracket frames that overlap behind different filters.

Compare two frames behind filters of transmittances T₁ and T₂. The ratio of sample light to reference light changes by T₁/T₂ if the
filters are in the sample beam alone, by 1 if both beams pass them, and by T₂/T₁ if only the reference beam does. A wrong
``nd_location`` therefore makes the values of one bracket disagree by T₁/T₂, or even (T₁/T₂)².

Reference: Voloboy et al., Keldysh Institute preprint (2005), §3.2 and §4.1, which contradict each other on the location of the filters.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
import xarray as xr

from brdfpipe.geometry import Array
from brdfpipe.rig.description import Rig
from brdfpipe.rig.screen import linear_limit, spot_masks

MIN_PIXELS = 30
"""Well exposed pixels behind both filters that a comparison needs."""

HOT_PIXEL = 3.0
"""A pixel is hot if its dark signal exceeds the median by this multiple of the read noise."""

MIN_SNR = 10.0
"""Ratio of signal to read noise from which a pixel, or the whole reference spot, is well exposed."""

MIN_CONTRAST = 1.5
"""Ratio of transmittances from which two filters reveal their location."""

OTHER_ERRORS = 0.02
"""Relative deviation that glare and the flicker of the lamp can cause."""

_EXPONENTS = {"sample": 1, "reference": 0}
"""``nd_location`` → power of T₁/T₂ by which the ratio of sample light to reference light changes."""

_LOCATIONS = {exponent: location for location, exponent in _EXPONENTS.items()}


@dataclass(frozen=True)
class Overlap:
    """Two frames of one bracket behind different filters, in which the same pixels are well exposed."""

    positions: tuple[int, int]
    wavelength: float
    """Nanometres."""
    expected: float
    """T₁/T₂ of the description."""
    sample: float
    """Ratio of the light per second in the pixels of disc and fibres, first frame to second."""
    reference: float
    """The same in the reference spot."""

    @property
    def exponent(self) -> float:
        """Power of T₁/T₂ by which the ratio of sample light to reference light changes: 1, 0 or −1 apart from errors."""
        return math.log(self.sample / self.reference) / math.log(self.expected)


@dataclass(frozen=True)
class OverlapCheck:
    """Location of the filters found from overlapping frames."""

    overlaps: tuple[Overlap, ...]
    nd_location: str
    """``sample``, ``reference``, or empty if there is no overlap or it agrees with neither."""
    warnings: tuple[str, ...]


def check_overlaps(frames: xr.Dataset, rig: Rig) -> OverlapCheck:
    """Compare the frames of each bracket that were taken behind different filters.

    Returns the overlaps, and warnings where they contradict ``nd_location`` or a transmittance of the description.
    ``frames`` are of kind ``frames``, with their dark frames.
    """
    overlaps = tuple(_overlaps(frames, rig))
    if not overlaps:
        return OverlapCheck((), "", ())
    exponent = float(np.median([overlap.exponent for overlap in overlaps]))
    nearest = round(exponent)
    if nearest == _EXPONENTS[rig.nd_location]:
        return OverlapCheck(overlaps, rig.nd_location, tuple(_transmittance_warnings(overlaps, rig)))
    return OverlapCheck(overlaps, _LOCATIONS.get(nearest, ""), (_location_warning(overlaps, exponent, rig),))


def _overlaps(frames: xr.Dataset, rig: Rig) -> Iterator[Overlap]:
    purposes = frames["purpose"].values
    keys = ("purpose", "side", "incidence", "wavelength")
    brackets = defaultdict[tuple[Any, ...], list[int]](list)
    for number in np.flatnonzero(np.isin(purposes, ("sample", "etalon"))):
        brackets[tuple(frames[key].values[number].item() for key in keys)].append(int(number))
    darks = {
        exposure: frames["counts"].values[(purposes == "dark") & (frames["exposure"].values == exposure)].mean(axis=0)
        for exposure in np.unique(frames["exposure"].values[purposes == "dark"])
    }
    for bracket in brackets.values():
        electrons = {number: _electrons(frames, number, darks, rig) for number in bracket}
        for pair in combinations(bracket, 2):
            overlap = _compare(frames, pair, (electrons[pair[0]], electrons[pair[1]]), rig)
            if overlap is not None:
                yield overlap


def _electrons(frames: xr.Dataset, number: int, darks: dict[float, Array], rig: Rig) -> Array | None:
    """Electrons of a frame, NaN in hot pixels; None without a dark frame of its exposure time."""
    dark = darks.get(frames["exposure"].values[number])
    if dark is None:
        return None
    hot = rig.camera.gain * (dark - np.median(dark)) > HOT_PIXEL * max(rig.camera.read_noise, rig.camera.gain)
    return np.where(hot, np.nan, rig.camera.gain * (frames["counts"].values[number] - dark))


def _compare(
    frames: xr.Dataset, pair: tuple[int, int], electrons: tuple[Array | None, Array | None], rig: Rig
) -> Overlap | None:
    """Compare two frames if their filters differ enough and enough pixels are well exposed in both."""
    first, second = electrons
    transmittances, seconds = (frames[key].values[list(pair)] for key in ("nd_transmittance", "exposure"))
    expected = float(transmittances[0] / transmittances[1])
    if first is None or second is None or abs(math.log(expected)) < math.log(MIN_CONTRAST):
        return None
    gain = expected * float(seconds[0] / seconds[1])
    bright, dim, step = (first, second, gain) if gain > 1 else (second, first, 1 / gain)
    reference, sample = spot_masks(rig)
    noise, limit = rig.camera.read_noise, linear_limit(rig)
    # Selected by the brighter frame alone: selecting by the darker one too would favour pixels that its own noise raised.
    well_exposed = sample & (bright > step * MIN_SNR * noise) & (bright < limit) & (dim < limit)
    spots = [frame[reference & np.isfinite(frame)] for frame in (first, second)]
    too_dim = min(spot.sum() for spot in spots) < MIN_SNR * noise * math.sqrt(np.count_nonzero(reference))
    if np.count_nonzero(well_exposed) < MIN_PIXELS or too_dim or max(spot.max() for spot in spots) >= limit:
        return None
    positions = frames["nd_position"].values[list(pair)]
    return Overlap(
        positions=(int(positions[0]), int(positions[1])),
        wavelength=float(frames["wavelength"].values[pair[0]]),
        expected=expected,
        sample=float(first[well_exposed].sum() / second[well_exposed].sum() * seconds[1] / seconds[0]),
        reference=float(spots[0].sum() / spots[1].sum() * seconds[1] / seconds[0]),
    )


def _location_warning(overlaps: Sequence[Overlap], exponent: float, rig: Rig) -> str:
    described, widest = rig.nd_location, max(overlaps, key=lambda overlap: abs(math.log(overlap.expected)))
    nearest = round(exponent)
    location = f"`nd_location: {_LOCATIONS[nearest]}`" if nearest in _LOCATIONS else "the reference beam alone"
    power = abs(nearest - _EXPONENTS[described])
    first, second = widest.positions if widest.expected > 1 else widest.positions[::-1]
    factor = max(widest.expected, 1 / widest.expected) ** power
    ratio = f"(T{first}/T{second})²" if power == 2 else f"T{first}/T{second}"
    return (
        f"wrong `nd_location: {described}`: {len(overlaps)} pairs of overlapping frames indicate {location}; the ratio of sample "
        f"light to reference light follows the transmittance to the power {exponent:.2f}. With filters {first} and {second}, values "
        f"of one bracket would disagree by {factor:.3g} = {ratio}; correct `nd_location` in rig.yaml, or the positions of `filters`"
    )


def _transmittance_warnings(overlaps: Sequence[Overlap], rig: Rig) -> Iterator[str]:
    """Pairs of filters whose transmittances deviate from the description by more than three standard uncertainties."""
    deviations = defaultdict[tuple[int, int], list[float]](list)
    for overlap in overlaps:
        # The reference cancels changes of the lamp between the two frames.
        light = overlap.sample / (overlap.reference if rig.nd_location == "sample" else 1.0)
        deviations[overlap.positions].append(light / overlap.expected)
    for (first, second), ratios in sorted(deviations.items()):
        deviation = float(np.median(ratios)) - 1
        u = math.hypot(rig.filter_at(first).u, rig.filter_at(second).u, OTHER_ERRORS)
        if abs(deviation) > 3 * u:
            yield (
                f"filters {first} and {second}: the measured ratio of transmittances deviates by {deviation:+.1%} from the description, "
                f"more than three standard uncertainties ({u:.1%} each); measure the filters and correct `filters` in rig.yaml"
            )
