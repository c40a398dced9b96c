"""What each choice costs in accuracy and saves in time: those of the sources, and ladders that no planner of scenes climbs.

``python benchmarks/choices.py`` measures every choice (some four minutes of processor time), writes ``benchmarks/results/choices.json`` and the tables of
``docs/tradeoff.md``, and names what became slower or less accurate than in the measurement that was kept before.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import json
import platform
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import click
import colour_choices
import masking_choices
import numpy as np
import quadrature_choices
import resolution_choices
import rig_choices
import surface_choices
from choice_table import Choice, summary_of_sources, table
from previous import LESS_ACCURATE, SLOWER, compare

from brdfpipe.descriptions.rendering import with_section

PROJECT = Path(__file__).resolve().parents[1]
RECORD = PROJECT / "benchmarks" / "results" / "choices.json"
PAGE = PROJECT / "docs" / "tradeoff.md"

CHOICES: Mapping[str, Callable[[], Choice]] = {
    "spectrum": colour_choices.spectrum_of_a_colour,
    "model": surface_choices.model_of_a_surface,
    "masking": masking_choices.masking,
    "line": surface_choices.slopes_of_a_line,
    "diffuse": surface_choices.diffuse_part,
    "flakes": colour_choices.effect_paint,
    "smoothing": rig_choices.smoothing_of_a_rig,
    "normal-incidence": rig_choices.normal_incidence_of_a_rig,
    "table": resolution_choices.grid_of_a_table,
    "gloss": quadrature_choices.quadrature_of_gloss,
    "albedo": quadrature_choices.quadrature_of_albedo,
    "precision": resolution_choices.precision,
    "scan": resolution_choices.share_of_a_scan,
}
"""Short name → measurement, in the order of the page."""

Record = dict[str, Any]


@click.command(help=__doc__)
@click.option("--only", multiple=True, type=click.Choice(list(CHOICES)), help="A choice; default all.")
@click.option("--record", type=click.Path(path_type=Path), default=RECORD, help="File of the measurement that is kept.")
@click.option("--page", type=click.Path(path_type=Path), default=PAGE, help="Page whose tables are written.")
def main(only: tuple[str, ...], record: Path, page: Path) -> None:
    kept: Record = json.loads(record.read_text(encoding="utf-8")) if record.exists() else {}
    before: dict[str, Any] = kept.get("choices", {})
    measured = {}
    for name in only or CHOICES:
        click.echo(name)
        measured[name] = CHOICES[name]().as_json()
        measured[name]["worse"] = compare(before[name]["rows"], measured[name]["rows"]) if name in before else None
    choices = {name: measured.get(name, before.get(name)) for name in CHOICES if name in measured or name in before}
    machine = f"{platform.machine()}, Python {platform.python_version()}, numpy {np.__version__}, one core"
    summary: Record = {"machine": machine, "choices": choices}
    record.write_text(json.dumps(summary, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    page.write_text(with_tables(page.read_text(encoding="utf-8"), summary), encoding="utf-8")
    click.echo("\n".join(_against_before(summary)))


def tables(summary: Record) -> list[str]:
    """Lines of Markdown of a record."""
    lines = [
        f"Machine: {summary['machine']}.",
        "",
        "### What the sources chose",
        "",
        *summary_of_sources(summary["choices"].values()),
    ]
    for choice in summary["choices"].values():
        lines += ["", *table(choice)]
    return [*lines, "", "### Against the measurement before", "", *_against_before(summary)]


def _against_before(summary: Record) -> list[str]:
    """What became worse, of the choices that were measured before."""
    compared = [choice["worse"] for choice in summary["choices"].values() if choice["worse"] is not None]
    limits = f"slower by more than {SLOWER:g} × or less accurate by more than {LESS_ACCURATE - 1:.0%}"
    if not compared:
        return ["There is no measurement before."]
    worse = [text for texts in compared for text in texts]
    if not worse:
        return [f"No option became {limits}."]
    return [f"These became {limits}, or their reference faster:", "", *(f"- {text}" for text in worse)]


def with_tables(page: str, summary: Record) -> str:
    """The page with its tables renewed."""
    return with_section(page, "choices", "\n".join(["", *tables(summary), ""]))


if __name__ == "__main__":
    main()
