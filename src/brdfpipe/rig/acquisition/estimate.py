"""What a plan will take before it is begun: frames, bytes, hours; and what its bracket will not reach.

Hours are an estimate: exposures are the plan's, what lies between them is taken as below.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

from brdfpipe.rig import frames
from brdfpipe.rig.description import Rig
from brdfpipe.rig.plan import Plan, Shot

READOUT = 1.0
"""Seconds from the end of an exposure to the next command, the frame being on the disk."""

SLEW = 50.0
"""Nanometres per second of a monochromator that goes as fast as it can."""

WHEEL = 1.5
"""Seconds of a move of the wheel."""

ARRANGING = 300.0
"""Seconds in which an operator moves mirrors and sample."""

RANGE = 2500 / 0.01
"""Brightest over darkest BRDF a rig of this kind is known for."""

SNR = 50.0
"""Signal over noise of a fibre's spot that counts as measured."""


@dataclass(frozen=True)
class Estimate:
    """What a plan takes."""

    title: str
    counts: Mapping[str, int]
    """Frames by purpose."""
    seconds: Mapping[str, float]
    """Time by purpose, with the moves before each frame."""
    size: int
    """Bytes of all frames."""
    arrangements: int
    """How often mirrors or sample are moved by hand."""
    warnings: tuple[str, ...]

    @property
    def frames(self) -> int:
        return sum(self.counts.values())

    @property
    def hours(self) -> float:
        """All in all, arranging included."""
        return (sum(self.seconds.values()) + self.arrangements * ARRANGING) / 3600

    @property
    def text(self) -> str:
        lines = [f"{self.title}: {self.frames} frames, {self.size / 1e6:.1f} MB, about {self.hours:.1f} h"]
        lines += [
            f"  {purpose:<8}{count:6d} frames  {self.seconds[purpose] / 3600:5.2f} h"
            for purpose, count in self.counts.items()
        ]
        by_hand = self.arrangements * ARRANGING / 3600
        lines.append(f"  by hand {self.arrangements:6d} arrangements of mirrors and sample  {by_hand:5.2f} h")
        return "\n".join([*lines, *(f"warning: {warning}" for warning in self.warnings)])


def estimate(plan: Plan) -> Estimate:
    """Judge a plan without a device."""
    seconds: dict[str, float] = {}
    for before, shot in zip((None, *plan.shots), plan.shots, strict=False):
        seconds[shot.purpose] = seconds.get(shot.purpose, 0.0) + duration(shot, before, plan.rig)
    counts = Counter(shot.purpose for shot in plan.shots)
    return Estimate(
        title=f"{plan.sample} on {plan.rig.name}",
        counts=dict(counts),
        seconds=seconds,
        size=len(plan.shots) * frames.size(plan),
        arrangements=len(plan.arrangements),
        warnings=tuple(_bracket_warnings(plan)),
    )


def duration(shot: Shot, before: Shot | None, rig: Rig) -> float:
    """Seconds an exposure takes with the moves of the devices before it, but not what is done by hand."""
    speed = rig.monochromator.speed / 60 or SLEW
    moved = 0.0 if before is None else abs(shot.wavelength - before.wavelength) / speed
    turned = 0.0 if before is None or before.position == shot.position else WHEEL
    return moved + turned + shot.exposure + READOUT


def frame_range(rig: Rig) -> float:
    """Brightest over darkest signal of fibres that one frame holds: from the end of the linear range down to :data:`SNR`.

    A spot of m pixels with N electrons in each has SNR √m N/√(N + r²), r being the read noise.
    """
    pixels = max(1.0, math.pi * (rig.screen.fibre_radius * rig.screen.scale) ** 2)
    least = SNR**2 / pixels
    darkest = (least + math.sqrt(least**2 + 4 * least * rig.camera.read_noise**2)) / 2
    return min(rig.camera.linear_to, rig.camera.gain * rig.camera.full) / darkest


def _bracket_warnings(plan: Plan) -> list[str]:
    held = frame_range(plan.rig)
    gains = sorted(
        (step.exposure * plan.rig.transmittance(step.position).transmittance, number)
        for number, step in enumerate(plan.bracket, start=1)
    )
    found = [
        f"bracket steps {one} and {other} do not overlap: {brighter / darker:.3g} times the light, and one frame holds 1 : {held:.0f}; "
        "add a step between them"
        for (darker, one), (brighter, other) in pairwise(gains)
        if brighter / darker >= held
    ]
    reached = gains[-1][0] / gains[0][0] * held
    if reached < RANGE:
        found.append(
            f"the bracket spans BRDFs of 1 : {reached:.3g}; 0.01 to 2500 needs 1 : {RANGE:.3g}: add darker or brighter steps, "
            "unless the sample needs less"
        )
    return found
