"""The page of changes: every change is on it, text of users is no markup, and the charts show the numbers."""

from __future__ import annotations

import re

import numpy as np
import pytest

from brdfpipe.releases.causes import Cause
from brdfpipe.releases.differences import Difference
from brdfpipe.releases.history import History
from brdfpipe.releases.page import changes_page, sparkline

NAN = np.nan


def points(values: list[float]) -> list[list[tuple[float, float]]]:
    """The points of each line of a chart."""
    lines = re.findall(r'points="([^"]*)"', str(sparkline(np.array(values))))
    return [[tuple(map(float, point.split(","))) for point in line.split()] for line in lines]  # type: ignore[misc]


def test_a_chart_rises_with_its_numbers_and_spans_all_releases() -> None:
    (line,) = points([1.0, 2.0, 4.0])
    x, y = zip(*line, strict=True)
    assert np.diff(x) == pytest.approx([57, 57])
    assert (y[0] - y[1]) * 2 == pytest.approx(y[1] - y[2], abs=0.2)  # rounded to a tenth of a pixel


@pytest.mark.parametrize(
    ("values", "lengths"),
    [([1.0, NAN, 2.0, 3.0], [1, 2]), ([NAN, 5.0], [1]), ([2.0, 2.0], [2]), ([7.0], [1])],
)
def test_gaps_break_the_line_and_constants_are_level(values: list[float], lengths: list[int]) -> None:
    lines = points(values)
    assert [len(line) for line in lines] == lengths
    assert all(0 <= x <= 120 and 0 <= y <= 28 for line in lines for x, y in line)


def test_text_of_users_is_no_markup() -> None:
    attack = "<script>alert(1)</script>\u202e"
    item = Difference(attack, attack, "changed", causes=(Cause("key", attack, attack),), problem=attack)
    html = changes_page([item], {}, [attack, attack])
    assert "<script" not in html
    assert "\u202e" not in html


def test_changes_causes_and_history_are_shown_and_unchanged_materials_are_not() -> None:
    item = Difference(
        "black", "", "changed", quantities={"gloss_60": (20.0, 25.0)}, causes=(Cause("key", "surface", "a: 1 → 2"),)
    )
    history = {("", "black"): History(np.array([20.0, 25.0]), np.array([0.0, 1.5]))}
    html = changes_page([item, Difference("grey", "", "unchanged")], history, ["monday", "tuesday"])
    for words in (
        "gloss_60 20.0 → 25.0",
        "a: 1 → 2",
        "20 to 25",
        "0 to 1.5",
        "1 changed",
        "1 unchanged",
        "monday",
        "tuesday",
    ):
        assert words in html
    assert html.count("<svg") == 2
    assert "grey" not in html


def test_a_page_in_the_results_links_to_their_pages_and_shows_their_pictures() -> None:
    items = [Difference("a b", "gloss-sheet", "changed"), Difference("gone", "", "removed", (True, False))]
    pictures = {("gloss-sheet", "a b"): "data:image/webp;base64,AA"}
    html = changes_page(items, {}, ["monday", "out"], pictures=pictures, linked=True)
    assert '<a href="scenes/gloss-sheet/a%20b/report.html">' in html
    assert html.count('src="data:image/webp;base64,AA"') == 1
    assert 'href="index.html"' in html
    assert "gone/report.html" not in html
    assert "href" not in changes_page(items, {}, ["monday", "tuesday"])
