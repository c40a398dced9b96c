from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from brdfpipe.report.plots.svg import Axis, Line, _thinned, chart, linear_ticks, path, power_of_ten


@given(st.floats(-1e3, 1e3), st.floats(1e-3, 1e6))
def test_linear_ticks_are_on_the_axis_and_few(low: float, span: float) -> None:
    high = low + span
    ticks = linear_ticks(low, high)
    assert len(ticks) <= 8
    assert all(low - 1e-6 * span <= value <= high + 1e-6 * span for value, _ in ticks)


@given(st.integers(-12, 12), st.floats(0.31, 14))
def test_log_ticks_have_distinct_labels_on_the_axis(start: int, decades: float) -> None:
    axis = Axis("", 10.0**start, 10.0 ** (start + decades), log=True)
    labels = [label for _, label in axis.ticks()]
    assert labels
    assert len(set(labels)) == len(labels) <= 9
    assert all(-1e-3 <= float(axis.fraction(value)) <= 1 + 1e-3 for value, _ in axis.ticks())


def test_a_log_axis_puts_zero_far_below_and_keeps_missing_values_missing() -> None:
    placed = Axis("", 1.0, 100.0, log=True).fraction([0.0, 1.0, 100.0, np.nan])
    assert placed[0] < -1
    np.testing.assert_allclose(placed[1:3], [0, 1])
    assert np.isnan(placed[3])


def test_missing_values_break_a_path() -> None:
    assert path([0, 1, 2, 3, 4, 5], [0, 1, np.nan, 3, 4, 5], "l").count("M") == 2


def test_thinning_stays_within_a_pixel_fraction_of_the_curve() -> None:
    x = np.linspace(0, 400, 2000)
    y = 100 * np.sin(x / 40)
    thin_x, thin_y = _thinned(x, y)
    assert thin_x.size < 300
    # Five passes of 0.06 units each bound the error; a unit is about a pixel.
    assert np.abs(np.interp(x, thin_x, thin_y) - y).max() < 0.3


def test_thinning_keeps_a_spike() -> None:
    y = np.zeros(101)
    y[50] = 1.0
    assert _thinned(np.arange(101.0), y)[1].max() == 1.0


def test_text_in_a_chart_is_escaped() -> None:
    svg = chart('"<x>', Axis("<b>", 0, 1), Axis("&", 0, 1), [Line([0, 1], [0, 1])])
    assert "<b>" not in svg
    assert "<x>" not in svg


@pytest.mark.parametrize(("exponent", "text"), [(0, "1"), (-2, "0.01"), (3, "1000"), (-4, "10⁻⁴"), (12, "10¹²")])
def test_decades_are_written_as_people_do(exponent: int, text: str) -> None:
    assert power_of_ten(exponent) == text
