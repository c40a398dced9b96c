"""Differences of two releases, in lines for a terminal and as plain values for JSON."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any

from brdfpipe.releases.differences import ADDED, CHANGED, REMOVED, UNCHANGED, Difference

_GLOSS = ("gloss_20", "gloss_60", "gloss_85")


def lines(differences: Sequence[Difference]) -> list[str]:
    """A line for each scene, below it one for each material that differs, and below that one for each cause."""
    text = []
    for scene in dict.fromkeys(item.scene for item in differences):
        of_scene = [item for item in differences if item.scene == scene]
        counts = Counter(item.status for item in of_scene)
        listed = ", ".join(f"{counts[status]} {status}" for status in (CHANGED, ADDED, REMOVED, UNCHANGED))
        text.append(f"{scene or 'catalogue'}: {listed}")
        for item in of_scene:
            if item.status != UNCHANGED:
                text.append(f"  {item.material}: {'; '.join(findings(item)) or 'no quantity of the table differs'}")
                text += [f"    {cause.kind} ({cause.stage or 'material'}): {cause.text}" for cause in item.causes]
    return text


def plain(differences: Sequence[Difference]) -> list[dict[str, Any]]:
    """The differences as plain values, unchanged materials left out."""
    return [asdict(item) for item in differences if item.status != UNCHANGED]


def findings(item: Difference) -> Iterator[str]:
    """What changed for a material, in short phrases."""
    if item.status != CHANGED:
        yield item.status if item.built[1] or item.status == REMOVED else f"{item.status}, not built: {item.failure}"
        return
    if item.built == (True, False):
        yield f"not built any more: {item.failure}"
    elif item.built == (False, True):
        yield "built again"
    elif not item.built[0]:
        yield f"still not built, for another reason: {item.failure}"
    if item.colour:
        yield f"ΔE00 {item.colour:.3g}"
    for name in _GLOSS:
        if name in item.quantities:
            yield f"{name} {_change(item.quantities[name])}"
    if item.brdf:
        yield f"BRDF {item.brdf['rms']:.2%} rms, {item.brdf['percentile_95']:.2%} at the 95th percentile"
    if item.verdict[0] != item.verdict[1]:
        yield f"verdict {item.verdict[0] or 'none'} → {item.verdict[1] or 'none'}"
    others = [name for name in item.quantities if name not in (*_GLOSS, *"Lab")]
    if others:
        yield f"{len(others)} further quantit{'y' if len(others) == 1 else 'ies'} differ{'s' if len(others) == 1 else ''}"
    if item.problem:
        yield f"not compared: {item.problem}"


def _change(values: tuple[float | None, float | None]) -> str:
    return " → ".join("none" if value is None else f"{value:.4g}" for value in values)
