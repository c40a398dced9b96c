"""Lamp stability from the reference spot, which receives the splitter's share of the light in every frame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from brdfpipe.geometry import Array
from brdfpipe.rig.description import Rig
from brdfpipe.rig.raw_frame import Counts
from brdfpipe.rig.screen import linear_limit, spot_masks


@dataclass(frozen=True)
class LampReading:
    """One lamp monitor reading."""

    shot: int
    elapsed: float
    """Seconds since the start of the run."""
    signal: float
    """Electrons of the reference spot."""


def reference_signal(counts: Counts, dark: Array, rig: Rig) -> float:
    """Electrons of the reference spot, NaN if one of its pixels exceeds the linear range; ``dark``: mean of dark frames [counts]."""
    reference, _ = spot_masks(rig)
    electrons = rig.camera.gain * (counts[reference] - dark[reference])
    return math.nan if electrons.max() > linear_limit(rig) else float(electrons.sum())


def drift_warnings(readings: Sequence[LampReading], wavelength: float, tolerance: float) -> list[str]:
    """Warn where the lamp changed by more than a relative tolerance since the first reading, or since the last change warned of.

    The readings are in the order they were taken, at one wavelength [nm].
    """
    warnings = []
    usable = [reading for reading in readings if reading.signal > 0]
    if unusable := [str(reading.shot) for reading in readings if not reading.signal > 0]:
        warnings.append(
            f"lamp monitor reading unusable in frame {', '.join(unusable[:5])}: the reference spot is saturated or dark; "
            "choose another bracket step as `drift.step` of the plan"
        )
    base: LampReading | None = None
    for reading in usable:
        base = base or reading
        change = reading.signal / base.signal - 1
        if abs(change) > tolerance:
            minutes = (reading.elapsed - base.elapsed) / 60
            cure = (
                "let the lamp warm up longer before a run"
                if change > 0
                else "check the lamp's power supply and its age"
            )
            warnings.append(
                f"lamp drift: {change:+.1%} in the {minutes:.0f} min before frame {reading.shot} ({wavelength:g} nm, "
                f"tolerance {tolerance:.1%}); {cure}, or raise `drift.tolerance` of the plan: drift that is equal at all "
                "wavelengths cancels, because every frame has its own reference"
            )
            base = reading
    return warnings
