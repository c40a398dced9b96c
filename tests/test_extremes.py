"""Every stage at the extremes of its inputs, as docs/extremes.md lists them."""

from __future__ import annotations

import extremes as benchmark
import mpmath
import pytest

CASES = {f"{case.stage}: {case.name}": case for case in benchmark.cases()}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] if case.slow else []) for name, case in CASES.items()]
)
def test_an_extreme_is_right_or_refused(name: str) -> None:
    with mpmath.workdps(50):
        outcome = CASES[name].outcome()
    assert outcome.kind != "wrong", f"{outcome.text}; {outcome.limit}"


def test_the_page_lists_every_case() -> None:
    rows = [
        line.split(" | ")
        for line in (benchmark.installation.project_folder() / benchmark.PAGE).read_text("utf-8").splitlines()
    ]
    listed = [f"{row[0].removeprefix('| ')}: {row[1]}" for row in rows if len(row) == 4][1:]
    assert listed == [name.replace("*", "\\*") for name in CASES], "run `make extremes`"


def test_what_is_wrong_is_found() -> None:
    assert benchmark.relative([1.0], [mpmath.mpf(2)], 0.1).kind == "wrong"
    assert benchmark.relative([float("nan")], [mpmath.mpf(2)], 0.1).kind == "wrong"
    assert benchmark.bounded([0.5, -0.1], 0, 1, "share").kind == "wrong"
    assert benchmark.bounded([], 0, 1, "share").kind == "wrong"
    assert benchmark.refused(lambda: 1).kind == "wrong"
    assert (
        benchmark.Case("stage", "an error of its own", lambda: benchmark.Outcome("range", str(1 / 0))).outcome().kind
        == "wrong"
    )
