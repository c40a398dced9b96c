"""Verdicts of a material: those of its checks and its table, and ``warn`` for every stage with a warning.

The checks judge the BRDF alone. They pass a BRDF from a scan that hardly resolves its facets; the warning of the facets stage says so.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from brdfpipe import vocabulary
from brdfpipe.appearance.origin import PREDICTION_INPUTS, Datasets, is_measured
from brdfpipe.appearance.validity import validity

VERDICTS = ("fail", "warn", "pass")
"""Worst first."""

_BY_PRODUCTS = ("preview", "table", "lambert_gauss")
"""Stages whose warnings concern a by-product and not the BRDF."""


@dataclass(frozen=True)
class Verdict:
    """The outcome of a check, or of the warnings of a stage."""

    name: str
    verdict: str
    """One of :data:`VERDICTS`."""
    text: str
    of: str = "check"
    """What gave it: ``check``, ``condition`` of the model, or ``stage`` with warnings."""


def verdicts(datasets: Datasets) -> list[Verdict]:
    """Verdicts of the checks and of the table, ``warn`` for every stage that the BRDF rests on and that has a warning, and ``warn`` or
    ``fail`` for every condition of the model that the surface meets in part, or does not meet."""
    unmet = [
        Verdict(
            _lowered(judgement.condition),
            judgement.verdict,
            ". ".join(filter(None, (judgement.finding, judgement.advice))),
            "condition",
        )
        for judgement in ([] if is_measured(datasets) else validity(datasets))
        if judgement.verdict in ("fail", "warn")
    ]
    return [*check_verdicts(datasets), *unmet, *_warning_verdicts(datasets)]


def overall(datasets: Datasets) -> tuple[str, list[Verdict]]:
    """The verdict of a material, and the entries that it is for; no entries for pass, and an empty verdict where nothing was checked."""
    outcomes = verdicts(datasets)
    verdict = worst(outcomes)
    return verdict, [] if verdict in ("", "pass") else [entry for entry in outcomes if entry.verdict == verdict]


def check_verdicts(datasets: Datasets) -> list[Verdict]:
    """Verdicts of the checks and of the table."""
    results: dict[str, Verdict] = {}
    for dataset in (datasets[stage] for stage in ("checks", "table") if stage in datasets):
        for name, entry in json_object(dataset.attrs.get("verdicts")).items():
            outcome = entry if isinstance(entry, dict) else {"verdict": entry}
            verdict, text = (str(outcome.get(key, "")) for key in ("verdict", "text"))
            results[name] = Verdict(name.replace("_", " "), verdict, text)
    return list(results.values())


def worst(outcomes: Sequence[Verdict]) -> str:
    """The worst verdict; empty where nothing was checked."""
    return next((verdict for verdict in VERDICTS if any(entry.verdict == verdict for entry in outcomes)), "")


def stage_warnings(datasets: Datasets) -> list[tuple[str, str]]:
    """(stage, warning) of all stages. A warning that later stages repeat counts once, for the first stage."""
    first_stage: dict[str, str] = {}
    for stage, dataset in datasets.items():
        for text in vocabulary.warnings(dataset):
            first_stage.setdefault(text, stage)
    return [(stage, text) for text, stage in first_stage.items()]


def stage_title(datasets: Datasets, stage: str) -> str:
    """A stage in words; inputs of the prediction that a measurement is compared with are marked."""
    title = stage.replace("_", " ")
    return f"{title} (of the prediction)" if is_measured(datasets) and stage in PREDICTION_INPUTS else title


def _lowered(condition: str) -> str:
    """A condition inside a sentence; abbreviations keep their capitals."""
    return condition[:1].lower() + condition[1:]


def json_object(text: object) -> dict[str, Any]:
    """An attribute that holds a JSON object; empty where it is missing or holds something else."""
    value = json.loads(text) if isinstance(text, str) and text else {}
    return value if isinstance(value, dict) else {}


def _warning_verdicts(datasets: Datasets) -> list[Verdict]:
    texts: dict[str, list[str]] = {}
    own = {stage: dataset for stage, dataset in datasets.items() if stage not in _BY_PRODUCTS}
    for stage, text in stage_warnings(own):
        texts.setdefault(stage, []).append(text.strip().removesuffix("."))
    return [Verdict(stage_title(datasets, stage), "warn", "; ".join(lines), "stage") for stage, lines in texts.items()]
