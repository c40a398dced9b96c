"""What frames themselves tell of the rig: how steady the lamp is, and where the neutral filters stand.

Both look at the reference spot, into which the splitter sends its share of the light.

Notes
-----
Behind two filters of transmittances T₁ and T₂ the light of the sample over that of the reference differs by T₁/T₂ where the filters
stand in the sample's beam alone, by 1 where both pass them, and by T₂/T₁ where the reference alone does. A description that says the
one where the other holds thus makes values of one bracket disagree by T₁/T₂, or even (T₁/T₂)².

References
----------
Voloboy et al., Keldysh Institute preprint (2005), §3.2 against §4.1, which do not agree on where the filters stand.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import combinations
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe.geometry import Array
from brdfpipe.rig import screen
from brdfpipe.rig.description import Rig

Mask = NDArray[np.bool_]

CLEARANCE = 2.0
"""Pixels about the reference spot that belong to neither it nor the rest: the point spread smears its rim."""

LEAST_PIXELS = 30
"""Pixels well exposed behind both filters that a comparison needs."""

HOT = 3.0
"""Dark signal over the read noise, beyond that of most pixels, from which a pixel is hot."""

LEAST_SNR = 10.0
"""Signal over read noise from which a pixel, or all of the reference spot, is well exposed."""

LEAST_CONTRAST = 1.5
"""Ratio of transmittances from which two filters can tell where they stand."""

FORESEEN = 0.02
"""Relative deviation that glare and the lamp's flicker alone may cause."""

_EXPONENT = {"sample": 1, "reference": 0}
"""By which power of T₁/T₂ the light of the sample over that of the reference differs, by ``nd_location``."""

_FOUND = {1: "sample", 0: "reference"}
_REFERENCE_ALONE = "the reference's beam alone"


@dataclass(frozen=True)
class Overlap:
    """Two frames of one bracket behind different filters, in which the same pixels are well exposed."""

    positions: tuple[int, int]
    wavelength: float
    """Nanometres."""
    expected: float
    """T₁/T₂ of the description."""
    sample: float
    """Light per second of the first over that of the second, where the sample is seen."""
    reference: float
    """The same of the reference spot."""

    @property
    def exponent(self) -> float:
        """Power of T₁/T₂ by which the light of the sample over that of the reference differs: 1, 0 or −1 but for errors."""
        return math.log(self.sample / self.reference) / math.log(self.expected)


@dataclass(frozen=True)
class OverlapCheck:
    """What the overlaps of brackets say of the filters."""

    overlaps: tuple[Overlap, ...]
    nd_location: str
    """Where the filters stand: ``sample``, ``reference``, or empty if there is no overlap to tell or it fits neither."""
    warnings: tuple[str, ...]


def overlap_check(frames: xr.Dataset, rig: Rig) -> OverlapCheck:
    """Compare the frames of each bracket that were taken behind different filters.

    Parameters
    ----------
    frames : kind ``frames``, its dark frames included
    rig : as described

    Returns
    -------
    The overlaps, and warnings where ``nd_location`` or a transmittance of the description does not agree with them.
    """
    overlaps = tuple(_overlaps(frames, rig))
    if not overlaps:
        return OverlapCheck((), "", ())
    exponent = float(np.median([overlap.exponent for overlap in overlaps]))
    nearest = round(exponent)
    if nearest == _EXPONENT[rig.nd_location]:
        return OverlapCheck(overlaps, rig.nd_location, tuple(_wrong_filters(overlaps, rig)))
    return OverlapCheck(overlaps, _FOUND.get(nearest, ""), (_wrong_location(overlaps, exponent, rig),))


def reference_signal(counts: NDArray[np.uint16], dark: Array, rig: Rig) -> float:
    """Electrons of the reference spot, NaN where one of its pixels is beyond the linear range.

    Parameters
    ----------
    counts : one frame
    dark : mean of the dark frames of its exposure [counts]
    rig : as described
    """
    inside, _ = spots(rig)
    electrons = rig.camera.gain * (counts[inside] - dark[inside])
    return math.nan if electrons.max() > _linear(rig) else float(electrons.sum())


@cache
def spots(rig: Rig) -> tuple[Mask, Mask]:
    """Pixels (row, column) of the reference spot, and pixels of disc and fibres; the rims count to neither."""
    rows, columns = np.mgrid[: rig.camera.height, : rig.camera.width]
    places = screen.to_place(rig.screen, columns, rows)
    rim = CLEARANCE / rig.screen.scale

    def within(centre: tuple[float, float], radius: float) -> Mask:
        return np.hypot(places.x - centre[0], places.y - centre[1]) <= radius

    reference = within(rig.screen.reference, max(rig.screen.reference_radius, 0.5 / rig.screen.scale))
    sample = within(rig.screen.disc, rig.screen.disc_radius - rim)
    for fibre in rig.fibres:
        sample |= within((fibre.x, fibre.y), rig.screen.fibre_radius)
    return reference, sample & ~within(rig.screen.reference, rig.screen.reference_radius + rim)


@dataclass(frozen=True)
class Look:
    """One look at the lamp."""

    shot: int
    elapsed: float
    """Seconds since the start of the run."""
    signal: float
    """Electrons of the reference spot."""


def drift_warnings(looks: Sequence[Look], wavelength: float, tolerance: float) -> list[str]:
    """Where the lamp changed by more than the tolerance since the first look, or since the last change warned of.

    Parameters
    ----------
    looks : in order
    wavelength : of the looks [nm], for the message
    tolerance : relative
    """
    found = []
    usable = [look for look in looks if look.signal > 0]
    if len(usable) < len(looks):
        blind = [str(look.shot) for look in looks if look not in usable]
        found.append(
            f"the lamp cannot be judged in frame {', '.join(blind[:5])}: the reference spot is too bright or dark; "
            "choose another frame of the bracket as `drift.step` of the plan"
        )
    before = usable[0] if usable else None
    for look in usable:
        assert before is not None
        change = look.signal / before.signal - 1
        if abs(change) > tolerance:
            minutes = (look.elapsed - before.elapsed) / 60
            advice = (
                "let the lamp warm up for longer before a run" if change > 0 else "check the lamp's supply and its age"
            )
            found.append(
                f"the lamp changed by {change:+.1%} in the {minutes:.0f} min before frame {look.shot} ({wavelength:g} nm, "
                f"tolerance {tolerance:.1%}); {advice}, or raise `drift.tolerance` of the plan: what changes all wavelengths "
                "alike divides out, for every frame has its own reference"
            )
            before = look
    return found


def _linear(rig: Rig) -> float:
    return min(rig.camera.linear_to, rig.camera.gain * rig.camera.full)


def _overlaps(frames: xr.Dataset, rig: Rig) -> Iterator[Overlap]:
    kinds = frames["purpose"].values
    lights = np.flatnonzero(np.isin(kinds, ("sample", "etalon")))
    keys = ("purpose", "side", "incidence", "wavelength")
    groups: dict[tuple[Any, ...], list[int]] = {}
    for place in lights:
        groups.setdefault(tuple(frames[key].values[place].item() for key in keys), []).append(int(place))
    darks = {
        exposure: frames["counts"].values[(kinds == "dark") & (frames["exposure"].values == exposure)].mean(axis=0)
        for exposure in np.unique(frames["exposure"].values[kinds == "dark"])
    }
    for group in groups.values():
        rates = {place: _electrons(frames, place, darks, rig) for place in group}
        for one, other in combinations(group, 2):
            overlap = _overlap(frames, (one, other), (rates[one], rates[other]), rig)
            if overlap is not None:
                yield overlap


def _electrons(frames: xr.Dataset, place: int, darks: dict[float, Array], rig: Rig) -> Array | None:
    """Electrons of a frame, NaN in hot pixels; none without a dark frame of its exposure."""
    dark = darks.get(frames["exposure"].values[place])
    if dark is None:
        return None
    hot = rig.camera.gain * (dark - np.median(dark)) > HOT * max(rig.camera.read_noise, rig.camera.gain)
    return np.where(hot, np.nan, rig.camera.gain * (frames["counts"].values[place] - dark))


def _overlap(
    frames: xr.Dataset, pair: tuple[int, int], electrons: tuple[Array | None, Array | None], rig: Rig
) -> Overlap | None:
    """Compare two frames, if their filters differ enough and enough pixels are well exposed in both."""
    first, second = electrons
    transmittances, seconds = (frames[key].values[list(pair)] for key in ("nd_transmittance", "exposure"))
    expected = float(transmittances[0] / transmittances[1])
    if first is None or second is None or abs(math.log(expected)) < math.log(LEAST_CONTRAST):
        return None
    gain = expected * float(seconds[0] / seconds[1])
    bright, dim, step = (first, second, gain) if gain > 1 else (second, first, 1 / gain)
    reference, sample = spots(rig)
    noise, linear = rig.camera.read_noise, _linear(rig)
    # Chosen by the brighter frame alone: where its own noise lifts a pixel of the darker one over a threshold, that would count double.
    good = sample & (bright > step * LEAST_SNR * noise) & (bright < linear) & (dim < linear)
    seen = [each[reference & np.isfinite(each)] for each in (first, second)]
    faint = min(each.sum() for each in seen) < LEAST_SNR * noise * math.sqrt(np.count_nonzero(reference))
    if np.count_nonzero(good) < LEAST_PIXELS or faint or max(each.max() for each in seen) >= linear:
        return None
    positions = frames["nd_position"].values[list(pair)]
    return Overlap(
        positions=(int(positions[0]), int(positions[1])),
        wavelength=float(frames["wavelength"].values[pair[0]]),
        expected=expected,
        sample=float(first[good].sum() / second[good].sum() * seconds[1] / seconds[0]),
        reference=float(seen[0].sum() / seen[1].sum() * seconds[1] / seconds[0]),
    )


def _wrong_location(overlaps: Sequence[Overlap], exponent: float, rig: Rig) -> str:
    said, widest = rig.nd_location, max(overlaps, key=lambda overlap: abs(math.log(overlap.expected)))
    nearest = round(exponent)
    place = f"`nd_location: {_FOUND[nearest]}`" if nearest in _FOUND else _REFERENCE_ALONE
    power = abs(nearest - _EXPONENT[said])
    one, other = widest.positions if widest.expected > 1 else widest.positions[::-1]
    factor = max(widest.expected, 1 / widest.expected) ** power
    return (
        f"the neutral filters are not where the description says (`nd_location: {said}`): "
        f"{len(overlaps)} pairs of frames that overlap show {place}, the light of sample over reference going as the "
        f"{exponent:.2f}th power of the transmittance; with filters {one} and {other} values of one bracket would disagree "
        f"by {factor:.3g}, which is {f'(T{one}/T{other})²' if power == 2 else f'T{one}/T{other}'}; correct `nd_location` in "
        "rig.yaml, or the positions of `filters`"
    )


def _wrong_filters(overlaps: Sequence[Overlap], rig: Rig) -> Iterator[str]:
    """Pairs of filters whose transmittances do not agree with the description within three standard uncertainties."""
    pairs: dict[tuple[int, int], list[float]] = {}
    for overlap in overlaps:
        # The reference divides out what the lamp did between the frames.
        light = overlap.sample / (overlap.reference if rig.nd_location == "sample" else 1.0)
        pairs.setdefault(overlap.positions, []).append(light / overlap.expected)
    for (one, other), ratios in sorted(pairs.items()):
        deviation = float(np.median(ratios)) - 1
        u = math.hypot(rig.transmittance(one).u, rig.transmittance(other).u, FORESEEN)
        if abs(deviation) > 3 * u:
            yield (
                f"filters {one} and {other}: the ratio of their transmittances is {deviation:+.1%} from the description's, "
                f"beyond three times its uncertainty ({u:.1%}); measure them, and correct `filters` in rig.yaml"
            )
