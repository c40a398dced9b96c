"""Frames, bytes and hours of a plan before it is started, and the limits of its bracket.

Hours are an estimate: exposure times are the plan's, the times between them are the constants below.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

from brdfpipe.rig.description import Rig
from brdfpipe.rig.frame_file import frame_size
from brdfpipe.rig.plan import Plan, Shot
from brdfpipe.rig.screen import linear_limit

READOUT = 1.0
"""Seconds from the end of an exposure to the next command, with the frame on disk."""

SLEW_SPEED = 50.0
"""Nanometres per second of a monochromator at full speed."""

WHEEL_MOVE = 1.5
"""Seconds of one move of the filter wheel."""

ARRANGEMENT_TIME = 300.0
"""Seconds in which an operator moves mirrors and sample."""

DYNAMIC_RANGE = 2500 / 0.01
"""Ratio of the largest to the smallest BRDF for which rigs of this kind are known."""

FIBRE_SNR = 50.0
"""Signal-to-noise ratio from which the spot of a fibre counts as measured."""


@dataclass(frozen=True)
class Estimate:
    """Frames, bytes and time of a plan."""

    title: str
    counts: Mapping[str, int]
    """Frames by purpose."""
    seconds: Mapping[str, float]
    """Time by purpose, moves before each frame included."""
    size: int
    """Bytes of all frames."""
    arrangements: int
    """Number of manual arrangements of mirrors and sample."""
    warnings: tuple[str, ...]

    @property
    def frames(self) -> int:
        return sum(self.counts.values())

    @property
    def hours(self) -> float:
        """Total time, manual arrangements included."""
        return (sum(self.seconds.values()) + self.arrangements * ARRANGEMENT_TIME) / 3600

    @property
    def text(self) -> str:
        lines = [f"{self.title}: {self.frames} frames, {self.size / 1e6:.1f} MB, about {self.hours:.1f} h"]
        for purpose, count in self.counts.items():
            lines.append(f"  {purpose:<8}{count:6d} frames  {self.seconds[purpose] / 3600:5.2f} h")
        manual = self.arrangements * ARRANGEMENT_TIME / 3600
        lines.append(f"  manual  {self.arrangements:6d} arrangements of mirrors and sample  {manual:5.2f} h")
        return "\n".join([*lines, *(f"warning: {warning}" for warning in self.warnings)])


def estimate(plan: Plan) -> Estimate:
    """Estimate a plan without its devices."""
    seconds = defaultdict[str, float](float)
    for shot, duration in durations(plan).items():
        seconds[shot.purpose] += duration
    return Estimate(
        title=f"{plan.sample} on {plan.rig.name}",
        counts=Counter(shot.purpose for shot in plan.shots),
        seconds=seconds,
        size=len(plan.shots) * frame_size(plan),
        arrangements=len(plan.arrangements),
        warnings=tuple(_bracket_warnings(plan)),
    )


def durations(plan: Plan) -> dict[Shot, float]:
    """Seconds of each exposure with the preceding moves of the devices, without manual arrangements."""
    speed = plan.rig.monochromator.speed / 60 or SLEW_SPEED
    seconds = {}
    for previous, shot in zip((plan.shots[0], *plan.shots), plan.shots, strict=False):
        slewing = abs(shot.wavelength - previous.wavelength) / speed
        turning = 0.0 if previous.position == shot.position else WHEEL_MOVE
        seconds[shot] = slewing + turning + shot.exposure + READOUT
    return seconds


def frame_range(rig: Rig) -> float:
    """Dynamic range of the fibre signals in one frame: from the end of the linear range down to :data:`FIBRE_SNR`.

    A spot of m pixels with N electrons each has a signal-to-noise ratio of √m N/√(N + r²) at the read noise r.
    """
    pixels = max(1.0, math.pi * (rig.screen.fibre_radius * rig.screen.scale) ** 2)
    ratio = FIBRE_SNR**2 / pixels
    darkest = (ratio + math.sqrt(ratio**2 + 4 * ratio * rig.camera.read_noise**2)) / 2
    return linear_limit(rig) / darkest


def _bracket_warnings(plan: Plan) -> list[str]:
    range_of_frame = frame_range(plan.rig)
    gains = sorted(
        (step.exposure * plan.rig.filter_at(step.position).transmittance, number)
        for number, step in enumerate(plan.bracket, start=1)
    )
    warnings = [
        f"bracket steps {first} and {second} do not overlap: {brighter / darker:.3g} times the light, but one frame covers "
        f"1 : {range_of_frame:.0f}; add a step between them"
        for (darker, first), (brighter, second) in pairwise(gains)
        if brighter / darker >= range_of_frame
    ]
    bracket_range = gains[-1][0] / gains[0][0] * range_of_frame
    if bracket_range < DYNAMIC_RANGE:
        warnings.append(
            f"the bracket covers BRDFs of 1 : {bracket_range:.3g}; 0.01 to 2500 needs 1 : {DYNAMIC_RANGE:.3g}: add darker or brighter "
            "steps, unless the sample needs less"
        )
    return warnings
