"""One choice: its options, what each leaves out, its errors and its processor time; as JSON rows and as a table."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

_SHORT, _RUNS_OF_SHORT = 0.2, 5
"""Processor time up to which an action is repeated [s], and how often at most."""

Result = TypeVar("Result")


@dataclass(frozen=True)
class Metric:
    """What an error of a choice is."""

    unit: str
    """``%`` for a relative error, whose values are shares of 1; empty for a number"""
    negligible: float = 0.0
    """Change of the error that says nothing: rounding, or twice the noise of the reference"""


@dataclass(frozen=True)
class Option:
    """What was measured of one option."""

    name: str
    leaves_out: str
    """Empty for the fullest option"""
    errors: Mapping[str, float]
    """Magnitude by name of the metric"""
    seconds: Mapping[str, float]
    """Processor time by name of the action [s]"""
    size: float | None = None
    """Bytes, where they matter"""


@dataclass(frozen=True)
class Choice:
    """The measured options of one choice."""

    name: str
    measured: str
    """What was measured, on what, and against what"""
    metrics: Mapping[str, Metric]
    reference: str
    """Name of the option whose time the others are compared with"""
    options: Sequence[Option]
    sources: Sequence[str] = ()
    """Names of the options that a source chose"""
    ours: str = ""
    """Name of the option that takes their place; the reference if it is left out"""
    judged_by: str = ""
    """Name of the metric that tells them apart"""

    def as_json(self) -> dict[str, Any]:
        """The choice with rows as :func:`previous.compare` reads them."""
        reference = next(option for option in self.options if option.name == self.reference)
        rows = [
            {
                "choice": self.name,
                "option": option.name,
                "leaves_out": option.leaves_out,
                "errors": {
                    name: {"value": _rounded(option.errors[name]), "unit": metric.unit, "negligible": metric.negligible}
                    for name, metric in self.metrics.items()
                },
                "seconds": {action: _rounded(value) for action, value in option.seconds.items()},
                "relative_time": {
                    action: _rounded(value / reference.seconds[action]) for action, value in option.seconds.items()
                },
                "bytes": None if option.size is None else round(option.size),
            }
            for option in self.options
        ]
        of_sources = {"sources": list(self.sources), "ours": self.ours or self.reference, "judged_by": self.judged_by}
        return {"name": self.name, "measured": self.measured, "reference": self.reference, **of_sources, "rows": rows}


def table(choice: Mapping[str, Any]) -> list[str]:
    """Lines of Markdown of a choice as :meth:`Choice.as_json` gives it."""
    rows = choice["rows"]
    errors, actions = list(rows[0]["errors"]), list(rows[0]["seconds"])
    sized = any(row["bytes"] is not None for row in rows)
    units = [rows[0]["errors"][name]["unit"] for name in errors]
    head = ["Option", "leaves out"]
    head += [f"{name}, {unit}" if unit else name for name, unit in zip(errors, units, strict=True)]
    head += [f"{action}, ms (ratio)" for action in actions] + ["kB"] * sized
    lines = [f"### {choice['name']}", "", choice["measured"], "", _line(head), "|---" * len(head) + "|"]
    for row in rows:
        name = f"**{row['option']}**" if row["option"] == choice["reference"] else row["option"]
        cells = [name, row["leaves_out"] or "–"]
        cells += [_error(row["errors"][error]) for error in errors]
        cells += [f"{_figures(1e3 * row['seconds'][one])} ({_figures(row['relative_time'][one])})" for one in actions]
        cells += ["–" if row["bytes"] is None else _figures(row["bytes"] / 1e3)] * sized
        lines.append(_line(cells))
    return lines


def summary_of_sources(choices: Iterable[Mapping[str, Any]]) -> list[str]:
    """Lines of Markdown: what a source chose, beside what takes its place."""
    head = ["Choice", "a source's", "ours", "error", "a source's", "ours", "time, a source's over ours"]
    lines = [_line(head), "|---" * len(head) + "|"]
    for choice in choices:
        rows = {row["option"]: row for row in choice["rows"]}
        ours = rows[choice["ours"]]
        for name in choice["sources"]:
            errors = [row["errors"][choice["judged_by"]] for row in (rows[name], ours)]
            unit = f", {errors[0]['unit']}" if errors[0]["unit"] else ""
            times = [
                f"{action} {_figures(rows[name]['seconds'][action] / seconds)}"
                for action, seconds in ours["seconds"].items()
            ]
            cells = [choice["name"], name, choice["ours"], choice["judged_by"] + unit, *map(_error, errors)]
            lines.append(_line([*cells, ", ".join(times)]))
    return lines


def timed(action: Callable[[], Result], repeats: int = 1) -> tuple[Result, float]:
    """The result of an action, and its least processor time [s] of several runs; a short action is run a few times in any case.

    Other work on the machine slows a short action by up to a factor of two, though its time is that of the processor.
    """
    times: list[float] = []
    while len(times) < repeats or (sum(times) < _SHORT and len(times) < _RUNS_OF_SHORT):
        start = time.process_time()
        result = action()
        times.append(time.process_time() - start)
    return result, min(times)


def largest(errors: Sequence[float]) -> float:
    """The largest magnitude."""
    return float(np.max(np.abs(errors)))


def rms(errors: Sequence[float]) -> float:
    """The root of the mean square."""
    return float(np.sqrt(np.mean(np.square(errors))))


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _error(error: Mapping[str, Any]) -> str:
    return _figures(error["value"] * (100 if error["unit"] == "%" else 1))


def _figures(value: float) -> str:
    """Three digits; very small and very large numbers with an exponent."""
    if value != 0 and not 1e-3 <= abs(value) < 1e5:
        return f"{value:.1e}"
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"


def _rounded(value: float) -> float:
    """Four digits, enough for every comparison."""
    return float(f"{value:.4g}")
