"""Differences of two releases, in lines for a terminal and as plain values for JSON."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any

from brdfpipe.appearance.quantities import quantities, quantities_on_request, quantity
from brdfpipe.releases.differences import ADDED, CHANGED, REMOVED, UNCHANGED, Difference

_GLOSS = ("gloss_20", "gloss_60", "gloss_85")

_NAMED = 3
"""Other quantities of a material that are named, in the order of the table."""

_LEAST_BRDF = 5e-5
"""Relative difference of BRDFs that is written: less is 0.00 %."""


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
                text.append(
                    f"  {item.material}: {'; '.join(findings(item)) or 'nothing differs within the digits of the table'}"
                )
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
    # The figures below the digits that the table has are rounding and are in the JSON alone.
    if item.colour and item.colour >= 0.5 * 10.0 ** -quantity("L").decimals:
        yield f"ΔE00 {item.colour:.3g}"
    changes = {name: change for name, values in item.quantities.items() if (change := _change(name, *values))}
    yield from (f"{name} {changes[name]}" for name in _GLOSS if name in changes)
    # The light of a narrow lobe may change while fewer than 5 % of the directions do.
    if max(item.brdf.get("rms", 0), item.brdf.get("percentile_95", 0)) >= _LEAST_BRDF:
        yield f"BRDF {item.brdf['rms']:.2%} rms, {item.brdf['percentile_95']:.2%} at the 95th percentile"
    if item.verdict[0] != item.verdict[1]:
        yield f"verdict {item.verdict[0] or 'none'} → {item.verdict[1] or 'none'}"
    yield from _further([f"{name} {text}" for name, text in changes.items() if name not in (*_GLOSS, *"Lab")])
    if item.problem:
        yield f"not compared: {item.problem}"


def _further(changes: Sequence[str]) -> Iterator[str]:
    """Other quantities, the first few by name."""
    yield from changes[:_NAMED]
    if (number := len(changes) - _NAMED) > 0:
        yield f"{number} further quantit{'y differs' if number == 1 else 'ies differ'}"


def _change(name: str, was: float | None, now: float | None) -> str:
    """The values before and now in the digits that the result carries; empty where they are the same in these."""
    before, after = (_digits(name, value) for value in (was, now))
    return "" if before == after else f"{before} → {after}"


def _digits(name: str, value: float | None) -> str:
    """A value as the catalogue writes it: with the decimals of its quantity, an uncertainty with two digits, others with four."""
    if value is None:
        return "none"
    if name in {one.u_name for one in (*quantities(), *quantities_on_request())}:
        return f"{value:.2g}"
    decimals = next((one.decimals for one in (*quantities(), *quantities_on_request()) if one.name == name), None)
    return f"{value:.4g}" if decimals is None else f"{value:z.{decimals}f}"
