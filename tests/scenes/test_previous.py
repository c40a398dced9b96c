"""The comparison of a measurement with the one that is kept."""

from __future__ import annotations

import pytest
from previous import compare


def row(option: str = "coarse", time: float = 2.0, error: float = 0.1, negligible: float = 0.0) -> dict:
    errors = {"gloss": {"value": error, "negligible": negligible}}
    return {"choice": "grid", "option": option, "relative_time": {"build": time}, "errors": errors}


def test_the_same_measurement_is_not_worse():
    assert compare([row()], [row()]) == []


@pytest.mark.parametrize(
    ("now", "expected"),
    [
        (row(time=2.9), None),
        (row(time=3.1), "grid, coarse: build takes 3.1 times its reference, before 2 times"),
        (row(time=0.1), None),
        (row(error=0.109), None),
        (row(error=0.111), "grid, coarse: gloss is 0.111, before 0.1"),
        (row(error=0.0), None),
        (row(error=0.13, negligible=0.05), None),
        (row(error=0.16, negligible=0.05), "grid, coarse: gloss is 0.16, before 0.1"),
    ],
)
def test_an_option_is_named_that_became_slower_or_less_accurate(now, expected):
    assert compare([row()], [now]) == ([] if expected is None else [expected])


def test_an_error_that_was_nothing_is_named_once_it_is_something():
    assert compare([row(error=0.0)], [row(error=1e-9)]) == ["grid, coarse: gloss is 1e-09, before 0"]


def test_an_error_that_is_not_a_number_is_named():
    assert compare([row()], [row(error=float("nan"))]) == ["grid, coarse: gloss is nan, before 0.1"]


def test_options_are_matched_by_name_and_new_ones_are_not_judged():
    others = [row("fine", time=50.0), row(time=2.0)]
    assert compare([row()], others) == []


def test_what_is_no_longer_measured_is_named():
    without = row() | {"relative_time": {}, "errors": {}}
    assert compare([row()], []) == ["grid, coarse: no longer measured"]
    assert compare([row()], [without]) == [
        "grid, coarse: the time of build is no longer measured",
        "grid, coarse: the error gloss is no longer measured",
    ]
