"""What the header of a table states about its rows."""

from __future__ import annotations

import numpy as np
import pytest

from brdfpipe.stated_counts import contradictions

NM = np.arange(400.0, 701, 10)


@pytest.mark.parametrize(
    "line",
    [
        "Number of points: 31",
        "points = 31",
        "Wavelengths;31;",
        "Anzahl der Werte: 31",
        "Start wavelength: 400 nm",
        "end [nm]: 700,0",
        "Wavelength range: 400 - 700 nm",
        "range (nm): 400 to 700",
        "Interval: 10 nm",
        "Step size; 10",
    ],
)
def test_a_lost_row_contradicts_its_header_and_the_whole_does_not(line: str) -> None:
    assert contradictions([line], NM) == []
    assert contradictions([line], NM / 1000) == []
    (doubt, *_) = contradictions([line], NM[1:-1:2])
    assert doubt.startswith("the header states")


def test_lines_about_other_things_are_left_alone() -> None:
    others = [
        "Instrument range: 360 - 740 nm",
        "Sample 12: 45",
        "Points of view: 3 of 4",
        "Step: slow",
        "Date range: 1-2",
    ]
    assert contradictions(others, NM) == []
