"""Verdicts of a material: those of its checks, its table and its readings, and ``warn`` for every stage with a warning.

The checks judge the BRDF alone. They pass a BRDF from a scan that hardly resolves its facets; the warning of the facets stage says so.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.appearance.origin import PREDICTION_INPUTS, Datasets, is_measured
from brdfpipe.appearance.validity import Judgement, validity

VERDICTS = ("fail", "warn", "pass")
"""Worst first."""

ACCEPTED = "accepted"
"""In place of ``warn`` where the description of the material accepts the warning; it makes no verdict worse."""

Acceptances = Sequence[Mapping[str, str]]
"""Warnings that a description accepts: ``warning``, a part of its text in any case of letters, and ``reason``."""

_BY_PRODUCTS = ("preview", "table", "lambert_gauss", "texture", "picture_texture", "unresolved", "texture_preview")
"""Stages whose warnings concern a by-product and not the BRDF; exports too, which are recognised by their kind."""


@dataclass(frozen=True)
class Verdict:
    """The outcome of a check, or of the warnings of a stage."""

    name: str
    verdict: str
    """One of :data:`VERDICTS`, or :data:`ACCEPTED`."""
    text: str
    of: str = "check"
    """What gave it: ``check``, ``condition`` of the model, ``stage`` with warnings, or an ``acceptance`` without a warning."""


def verdicts(
    datasets: Datasets, accepted: Acceptances = (), conditions: Sequence[Judgement] | None = None
) -> list[Verdict]:
    """Verdicts of the checks, of the table and of readings, ``warn`` for every stage that the BRDF rests on and that has a warning, and ``warn`` or
    ``fail`` for every condition of the model that the surface meets in part, or does not meet.

    A ``warn`` that the description accepts is :data:`ACCEPTED`, with the reason; ``fail`` cannot be accepted. An acceptance without a
    warning is a warning. ``conditions`` are those of :func:`.validity.validity`, if they are known already.
    """
    if conditions is None:
        conditions = [] if is_measured(datasets) else validity(datasets)
    unmet = [
        Verdict(
            _lowered(judgement.condition),
            judgement.verdict,
            ". ".join(filter(None, (judgement.finding, judgement.advice))),
            "condition",
        )
        for judgement in conditions
        if judgement.verdict in ("fail", "warn")
    ]
    outcomes = [*check_verdicts(datasets), *unmet]
    judged = [_accepted_entry(entry, accepted) for entry in outcomes]
    return [*judged, *_warning_verdicts(datasets, accepted), *_unused(datasets, outcomes, accepted)]


def overall(datasets: Datasets, accepted: Acceptances = ()) -> tuple[str, list[Verdict]]:
    """The verdict of a material, and the entries that it is for; no entries for pass, and an empty verdict where nothing was checked."""
    return decisive(verdicts(datasets, accepted))


def decisive(outcomes: Sequence[Verdict]) -> tuple[str, list[Verdict]]:
    """As :func:`overall`, of the :func:`verdicts` of a material."""
    verdict = worst(outcomes)
    return verdict, [] if verdict in ("", "pass") else [entry for entry in outcomes if entry.verdict == verdict]


def check_verdicts(datasets: Datasets) -> list[Verdict]:
    """Verdicts of the checks, of the table and of readings of instruments."""
    results: dict[str, Verdict] = {}
    for dataset in (datasets[stage] for stage in ("checks", "table", "readings") if stage in datasets):
        for name, entry in json_object(dataset.attrs.get("verdicts")).items():
            outcome = entry if isinstance(entry, dict) else {"verdict": entry}
            verdict, text = (str(outcome.get(key, "")) for key in ("verdict", "text"))
            results[name] = Verdict(name.replace("_", " "), verdict, text)
    return list(results.values())


def worst(outcomes: Sequence[Verdict]) -> str:
    """The worst verdict; empty where nothing was checked."""
    found = {entry.verdict for entry in outcomes}
    return next((verdict for verdict in VERDICTS if verdict in found), "pass" if ACCEPTED in found else "")


def reason_to_accept(text: str, accepted: Acceptances) -> str | None:
    """Why a warning is accepted; None if it is not."""
    return next((item["reason"] for item in accepted if item["warning"].casefold() in text.casefold()), None)


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


def _accepted_entry(entry: Verdict, accepted: Acceptances) -> Verdict:
    reason = reason_to_accept(entry.text, accepted) if entry.verdict == "warn" else None
    return entry if reason is None else replace(entry, verdict=ACCEPTED, text=f"{entry.text} (accepted: {reason})")


def refused_exports(datasets: Datasets, accepted: Acceptances = ()) -> list[str]:
    """Why formats of other programs were not written; without refusals that the description accepts."""
    exports = (dataset for dataset in datasets.values() if _is_export(dataset))
    texts = (text for dataset in exports for text in vocabulary.warnings(dataset))
    return [text for text in texts if reason_to_accept(text, accepted) is None]


def _is_export(dataset: xr.Dataset) -> bool:
    return dataset.attrs.get("kind") == "export"


def _own_warnings(datasets: Datasets) -> list[tuple[str, str]]:
    return stage_warnings(
        {stage: dataset for stage, dataset in datasets.items() if stage not in _BY_PRODUCTS and not _is_export(dataset)}
    )


def _warning_verdicts(datasets: Datasets, accepted: Acceptances) -> Iterator[Verdict]:
    """For each stage with warnings ``warn``, and :data:`ACCEPTED` for those that are accepted."""
    texts: dict[tuple[str, str], list[str]] = {}
    for stage, warning in _own_warnings(datasets):
        text, reason = warning.strip().removesuffix("."), reason_to_accept(warning, accepted)
        entry = ("warn", text) if reason is None else (ACCEPTED, f"{text} (accepted: {reason})")
        texts.setdefault((stage, entry[0]), []).append(entry[1])
    for (stage, verdict), lines in texts.items():
        yield Verdict(stage_title(datasets, stage), verdict, "; ".join(lines), "stage")


def _unused(datasets: Datasets, outcomes: Sequence[Verdict], accepted: Acceptances) -> Iterator[Verdict]:
    """``warn`` for each acceptance without a warning: it would hide the next one like it."""
    texts = [entry.text for entry in outcomes if entry.verdict == "warn"]
    texts += [text for _, text in stage_warnings(datasets)]
    for item in accepted:
        if not any(item["warning"].casefold() in text.casefold() for text in texts):
            text = f"{item['warning']!r} is accepted and no warning has this text; remove it from `accept` in material.yaml"
            yield Verdict("accepted warnings", "warn", text, "acceptance")
