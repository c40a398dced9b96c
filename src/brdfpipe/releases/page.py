"""The page of what changed since the last release, with a chart of each changed material over all releases."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any
from urllib.parse import quote

import numpy as np
from markupsafe import Markup

from brdfpipe.geometry import Array
from brdfpipe.releases.differences import ADDED, CHANGED, REMOVED, UNCHANGED, Difference
from brdfpipe.releases.history import History
from brdfpipe.releases.words import findings
from brdfpipe.report.rendering import render
from brdfpipe.scenes.scene import FOLDER

_WIDTH, _HEIGHT, _MARGIN = 120, 28, 3


def changes_page(
    differences: Sequence[Difference],
    histories: Mapping[tuple[str, str], History],
    names: Sequence[str],
    *,
    pictures: Mapping[tuple[str, str], str] | None = None,
    linked: bool = False,
) -> str:
    """The page, one HTML file that requests nothing from elsewhere.

    Parameters
    ----------
    differences : between the last two releases
    histories : (scene, material) → numbers over all releases
    names : of the releases, the oldest first
    pictures : (scene, material) → small picture of the material now, a data URI
    linked : whether the page will be in the folder of the last release, and so links to its catalogue and the pages of its materials
    """
    shown = pictures or {}
    counts = Counter(item.status for item in differences)
    return render(
        "changes.html.j2",
        names=list(names),
        counts=[(counts[status], status) for status in (CHANGED, ADDED, REMOVED, UNCHANGED)],
        linked=linked,
        rows=[
            _row(item, histories)
            | {"picture": shown.get((item.scene, item.material), ""), "link": _link(item) if linked else ""}
            for item in differences
            if item.status != UNCHANGED
        ],
    )


def _row(item: Difference, histories: Mapping[tuple[str, str], History]) -> dict[str, Any]:
    history = histories.get((item.scene, item.material))
    charts = [] if history is None else [("gloss 60°, GU", history.gloss_60), ("ΔE00 from the first", history.colour)]
    return {
        "material": item.material,
        "scene": item.scene,
        "status": item.status,
        "verdict": item.verdict[1],
        "findings": list(findings(item)),
        "causes": item.causes,
        "charts": [(label, sparkline(values), _span(values)) for label, values in charts if np.isfinite(values).any()],
    }


def _link(item: Difference) -> str:
    """The page of a material, if it is built, in relation to the results."""
    folder = f"{FOLDER}/{quote(item.scene, safe='')}/" if item.scene else ""
    return f"{folder}{quote(item.material, safe='')}/report.html" if item.built[1] and item.status != REMOVED else ""


def sparkline(values: Array) -> Markup:
    """A line over releases, without axes, as inline SVG; a single value is a point, and a gap a missing value.

    Parameters
    ----------
    values : (n,), NaN where there is none
    """
    known = np.flatnonzero(np.isfinite(values))
    low, high = values[known].min(), values[known].max()
    level = np.full(known.size, 0.5) if high == low else (values[known] - low) / (high - low)
    x = _MARGIN + known / max(values.size - 1, 1) * (_WIDTH - 2 * _MARGIN)
    y = _HEIGHT - _MARGIN - level * (_HEIGHT - 2 * _MARGIN)
    runs = np.split(np.arange(known.size), np.flatnonzero(np.diff(known) > 1) + 1)
    lines = [" ".join(f"{x[k]:.1f},{y[k]:.1f}" for k in run) for run in runs]
    marks = "".join(f'<polyline class="l c0" points="{points}"/>' for points in lines)
    last = f'<circle class="s c0" cx="{x[-1]:.1f}" cy="{y[-1]:.1f}" r="2.5"/>'
    return Markup(
        f'<svg width="{_WIDTH}" height="{_HEIGHT}" viewBox="0 0 {_WIDTH} {_HEIGHT}" aria-hidden="true">{marks}{last}</svg>'
    )


def _span(values: Array) -> str:
    known = values[np.isfinite(values)]
    low, high = f"{known.min():.3g}", f"{known.max():.3g}"
    return low if low == high else f"{low} to {high}"
