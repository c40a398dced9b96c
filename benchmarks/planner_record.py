"""The record of what the planner chose for random materials (benchmarks/results/planner.json), and its tables in docs/tradeoff.md."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from planner_figures import NEARLY_CHEAPEST, Figures, Outcome, figures
from scipy.stats import binomtest

from brdfpipe import store
from brdfpipe.descriptions.rendering import with_section

PAGE = Path(__file__).resolve().parents[1] / "docs" / "tradeoff.md"
RECORD = Path(__file__).parent / "results" / "planner.json"
LEFT_OUT, NEW_MATERIALS = "planner", "new materials"
"""Sections of the page: materials that the experience knows, each planned from the others, and materials that it does not know."""
CONFIDENCE = 0.95
COLUMNS = (
    "Scene",
    "Materials",
    "Held",
    f"{100 * CONFIDENCE:g} % interval",
    "Held where cheaper",
    "Cheaper",
    "Cost",
    f"Within {NEARLY_CHEAPEST:g}",
    "Saved",
    "Possible",
    "Planning",
)


class SceneOutcomes(NamedTuple):
    """For a scene."""

    tolerance: float
    outcomes: Sequence[Outcome]


Sections = Mapping[str, Mapping[str, SceneOutcomes]]
"""By section of the page and name of the scene."""


def read() -> dict[str, dict[str, SceneOutcomes]]:
    """The record; empty without a file."""
    content: dict[str, Any] = json.loads(RECORD.read_text()) if RECORD.exists() else {}
    return {
        section: {
            name: SceneOutcomes(one["tolerance"], [Outcome(*row) for row in one["outcomes"]])
            for name, one in scenes.items()
        }
        for section, scenes in content.items()
        if section != "columns"
    }


def write(sections: Sections) -> None:
    """Write the record: a line for each outcome, numbers with four digits."""
    scenes = {
        section: [
            f'{json.dumps(name)}: {{"tolerance": {one.tolerance!r}, "outcomes": [\n'
            + ",\n".join(json.dumps([_rounded(value) for value in outcome]) for outcome in one.outcomes)
            + "\n]}"
            for name, one in of_section.items()
        ]
        for section, of_section in sections.items()
    }
    parts = [f'"columns": {json.dumps(Outcome._fields)}']
    parts += [f"{json.dumps(section)}: {{\n" + ",\n".join(lines) + "\n}" for section, lines in scenes.items()]
    store.write_text(RECORD, "{\n" + ",\n".join(parts) + "\n}\n")


def _rounded(value: float | str | None) -> float | str | None:
    return float(f"{value:.4g}") if isinstance(value, float | int) else value


def renewed(section: str, scenes: Mapping[str, SceneOutcomes]) -> None:
    """Renew a section of the record, and the tables of the page from it."""
    write(read() | {section: dict(scenes)})
    store.write_text(PAGE, with_tables(PAGE.read_text()))


def with_tables(page: str) -> str:
    """The page with the tables of the record."""
    for section, scenes in read().items():
        page = with_section(page, section, table(scenes))
    return page


def table(scenes: Mapping[str, SceneOutcomes]) -> str:
    """A row for each scene."""
    rows = [f"| {' | '.join(COLUMNS)} |", "|---" * len(COLUMNS) + "|"]
    for name, one in scenes.items():
        found = figures(one.outcomes, one.tolerance)
        rows.append(f"| `{name}` | {' | '.join(_cells(found))} |")
    return "\n".join(rows)


def _cells(found: Figures) -> list[str]:
    low, high = binomtest(found.held, found.materials).proportion_ci(CONFIDENCE, method="exact")
    refused = f", {found.refused} refused" if found.refused else ""
    return [
        f"{found.materials}{refused}",
        f"{found.held / found.materials:.1%}",
        f"{low:.1%} to {high:.1%}",
        f"{found.cheaper_held} of {found.cheaper}",
        f"{found.cheaper / found.materials:.0%}",
        f"{found.cost:.2f}",
        f"{found.nearly_cheapest:.0%}",
        f"{found.saved:.0%}",
        f"{found.possible:.0%}",
        "–" if found.planning is None else f"{found.planning:.1%}",
    ]
