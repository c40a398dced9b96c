"""A table takes the width that its columns need, and cards leave no half of the page empty."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st
from markupsafe import Markup

from brdfpipe.report.cards import Card, Table, _lines, rows
from brdfpipe.report.plots.svg import Figure


@pytest.mark.parametrize(
    ("header", "row", "broad"),
    [
        (("Quantity", "Value"), ("Gloss 60°", "100.2"), False),
        (("Parameter", "Value", "Definition"), ("Sq", "0.943 µm", 80 * "x"), False),
        (
            ("Incidence", "g", "Reference", "Peak", "Shoulder", "Rest"),
            ("75°", "30", "Traced rays", *["−10.0 % ± 1.0 %"] * 3),
            True,
        ),
        (("Incidence", *"abcdefghi"), ("0°", *["100 %"] * 9), True),
        (("Files", "Error"), ("grain.parameters.json", 900 * "x"), False),
    ],
)
def test_a_table_of_many_or_long_columns_is_as_wide_as_the_page(
    header: tuple[str, ...], row: tuple[str, ...], broad: bool
) -> None:
    assert Table("", header, [row]).broad is broad


def test_a_table_without_rows_or_columns_is_narrow() -> None:
    assert not Table("", (), []).broad


def figure(height: int = 300, *, full: bool = False) -> Figure:
    return Figure("A chart", Markup(f'<svg class="fig" viewBox="0 0 560 {height}"></svg>'), full=full)


CARDS = st.one_of(
    st.builds(figure, st.integers(150, 500), full=st.booleans()),
    st.builds(lambda count: Table("", ("Quantity", "Value"), [("Gloss", "1")] * count), st.integers(0, 15)),
)


@given(st.lists(CARDS, max_size=14))
def test_every_card_has_one_place_and_none_stands_alone_beside_nothing(cards: list[Card]) -> None:
    arranged = rows(cards)
    placed = [entry for row in arranged for column in row for entry in column]
    assert sorted(place for place, _ in placed) == list(range(len(cards)))
    assert all(cards[place] is card for place, card in placed)
    for row in arranged:
        assert all(row)
        assert len(row) == 2 or len(row[0]) == 1
        for column in row:
            assert [place for place, _ in column] == sorted(place for place, _ in column)
    # Cards as wide as the page keep their place between the others.
    for before, after in itertools.pairwise(arranged):
        assert max(p for column in before for p, _ in column) < min(p for column in after for p, _ in column)


def test_the_columns_of_a_row_are_about_equally_long() -> None:
    # A short card stands below another, not a long one.
    spectrum, slopes, frequencies = figure(300), figure(380), Table("", ("Direction", "1/µm"), [("edge", "1")] * 5)
    [row] = rows([spectrum, slopes, frequencies])
    assert [[place for place, _ in column] for column in row] == [[0, 2], [1]]
    lengths = [sum(_lines(card) for _, card in column) for column in rows([figure(300)] * 4)[0]]
    assert lengths[0] == lengths[1]


def test_charts_of_one_size_stand_side_by_side() -> None:
    [row] = rows([figure(300)] * 6)
    assert [[place for place, _ in column] for column in row] == [[0, 2, 4], [1, 3, 5]]


def test_a_lone_card_is_as_wide_as_the_page() -> None:
    assert [len(row) for row in rows([figure(), figure(full=True), figure(), figure()])] == [1, 1, 2]
