"""Which materials cost more than the budget of their scene, and what would have to be given up."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from brdfpipe.catalogue.catalogue import Catalogue
from brdfpipe.scenes.scene import Scene
from brdfpipe.stages import STAGES, Subject

_NAMED_FILES = 3
"""Largest files that are named."""


def exceeded(results: Path, catalogue: Catalogue, names: Iterable[str]) -> Iterator[tuple[str, str]]:
    """(material, sentence) of each budget of its scene that a material exceeds; the sentence names the results that would have to be given up.

    The time is that of the last run of each job, by the clock; both include what the scene shares with others.
    """
    for name in names:
        scene = catalogue.scene_of(name)
        budget = scene.content.get("budget", {})
        places = list(dict.fromkeys(["", scene.folder])) if budget else []
        if "seconds" in budget:
            records = [path for place in places for path in (results / "logs" / place / name).glob("*.json")]
            costs = {path.stem: seconds for path in records if (seconds := _recorded_seconds(path)) is not None}
            subject = Subject(catalogue[name], catalogue.config, (), scene)
            seconds = _cost(subject, costs)
            if seconds > budget["seconds"]:
                yield (
                    name,
                    f"took {seconds:.1f} s; the budget of the scene {scene.name} is {budget['seconds']:g} s; "
                    f"{_without(subject, costs, budget['seconds'])}",
                )
        if "bytes" in budget:
            files = [path for place in places for path in (results / place / name).rglob("*") if path.is_file()]
            sizes = {path.relative_to(results).as_posix(): path.stat().st_size for path in files}
            size = sum(sizes.values())
            if size > budget["bytes"]:
                largest = sorted(sizes, key=lambda file: -sizes[file])[:_NAMED_FILES]
                yield (
                    name,
                    f"takes {size} bytes; the budget of the scene {scene.name} is {budget['bytes']}; largest: "
                    f"{', '.join(f'{file} ({sizes[file]})' for file in largest)}",
                )


def _recorded_seconds(record: Path) -> float | None:
    """The time of a job; None where its record is damaged: it is no result, and the job does not run again for it."""
    try:
        return float(json.loads(record.read_text(encoding="utf-8"))["wall_s"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _without(subject: Subject, costs: Mapping[str, float], budget: float) -> str:
    """Which results of the scene to give up for a budget of time, the dearest first.

    Kept are results in the order of the time that each adds, because several may need the same job.
    """
    given_up, kept = _results(subject), list[str]()
    seconds = least = _cost(_with_results(subject, kept), costs)
    while given_up:
        totals = {name: _cost(_with_results(subject, [*kept, name]), costs) for name in given_up}
        given_up = sorted(totals, key=lambda name: -totals[name])
        cheapest = given_up[-1]
        if totals[cheapest] > max(budget, least):
            break
        seconds = totals[cheapest]
        kept.append(given_up.pop())
    if not given_up:
        return f"no result of the scene can be given up for it: raise `budget.seconds` to {seconds:.2g}"
    words = f"without {', '.join(f'`{name}`' for name in given_up)} it would take {seconds:.2g} s"
    return words if seconds <= budget else f"{words}, still too long: raise `budget.seconds`"


def _results(subject: Subject) -> list[str]:
    return [] if subject.scene is None else list(subject.scene.content["results"])


def _with_results(subject: Subject, results: Sequence[str]) -> Subject:
    assert subject.scene is not None
    return replace(subject, scene=Scene(subject.scene.name, {**subject.scene.content, "results": list(results)}))


def _cost(subject: Subject, costs: Mapping[str, float]) -> float:
    """Time of the jobs that ran, without those that other scenes alone have."""
    others = _titles(replace(subject, scene=None)) - _titles(subject)
    return sum(cost for title, cost in costs.items() if title not in others)


def _titles(subject: Subject) -> set[str]:
    return {stage.job_title.format(**wildcards) for stage in STAGES.values() for wildcards in stage.jobs(subject)}
