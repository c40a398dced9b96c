"""The data that a chart carries, against what it was drawn from."""

from __future__ import annotations

import json
import re
from html import unescape

import numpy as np
import pytest

from brdfpipe.report.plots.figure_data import ERROR, UPPER
from brdfpipe.report.plots.svg import Axis, Band, Line, Points, chart

AXES = Axis("angle, degree", 0.0, 90.0), Axis("BRDF, sr⁻¹", 1e-4, 10.0, log=True)


def carried(*marks):
    found = re.findall(r"<metadata>(.*?)</metadata>", chart("A chart", *AXES, marks))
    return json.loads(unescape(found[0])) if found else None


def test_every_defined_value_of_a_curve_is_there_to_four_digits() -> None:
    x = np.linspace(0, 90, 181)
    y = np.exp(-((x / 20) ** 2)) / 3
    y[40] = np.nan
    data = carried(Line(x, y, label="measured"))
    assert data["columns"] == ["curve", "angle, degree", "BRDF, sr⁻¹"]
    [[name, across, values]] = data["curves"]
    assert name == "measured"
    assert across == pytest.approx(np.delete(x, 40), rel=5e-5)
    assert values == pytest.approx(np.delete(y, 40), rel=5e-4)


def test_curves_over_the_same_x_share_it_and_others_do_not() -> None:
    x = np.array([0.0, 30.0, 60.0])
    data = carried(Line(x, x + 1, label="a"), Line(x, x + 2, label="b"), Line(x[1:], x[1:], label="c"))
    assert [curve[1] for curve in data["curves"]] == [[0, 30, 60], None, [30, 60]]


def test_areas_and_error_bars_have_a_column_more() -> None:
    x = np.array([0.0, 30.0])
    assert carried(Band(x, x, x + 1))["columns"][3] == UPPER
    points = carried(Points(x, x + 1, np.array([0.5, np.nan])), Line(x, x))
    assert points["columns"][3] == ERROR
    assert points["curves"][0] == ["", [0, 30], [1, 31], [0.5, None]]
    assert len(carried(Points(x, x + 1))["columns"]) == 3


def test_no_label_ends_the_element() -> None:
    label = "</metadata><script>alert(1)</script>&amp;"
    svg = chart("A chart", *AXES, [Line([0, 1], [1, 2], label=label)])
    assert "<script" not in svg
    assert json.loads(re.search("<metadata>(.*?)</metadata>", svg)[1])["curves"][0][0] == label


def test_a_chart_without_a_value_carries_nothing() -> None:
    assert carried(Line([0.0, 1.0], [np.nan, np.nan])) is None
