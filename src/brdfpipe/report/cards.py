"""Cards of a page beside figures: tables; and its sections, which are lists of cards."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise, product

from brdfpipe.appearance.verdicts import Verdict
from brdfpipe.report.plots.svg import Figure

WORDS = ("Definition", "Description", "Error", "Not in the file", "Of", "Setting")
"""Titles of columns of sentences, which are broken into lines."""

_HALF_PAGE, _GAP = 70, 2
"""Characters of a row of half the width of the page, and between columns."""
_LINE = 72
"""Characters of a line of a note in half the width of the page."""
_HARDLY_EMPTY = 6
"""Lines that one column may be shorter than the other without a difference to the eye."""
_MOST_TOGETHER = 8
"""Cards that are parted between two columns together; more are parted in groups."""
_LONGEST_FIRST, _LONGEST_WORDS = 24, 80
"""Characters above which the first column, and a column of sentences, is broken into lines."""


@dataclass(frozen=True)
class Table:
    """A table; cells are text, the first column heads its row."""

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""
    remark: str = ""
    """Highlighted text above the note."""

    @property
    def broad(self) -> bool:
        """Whether the table needs the width of the page: half of it would cut columns off, or leave one word a line."""
        columns = [self.header, *self.rows]
        longest = [max(len(row[k]) for row in columns) for k in range(len(self.header))]
        longest = [
            min(length, _LONGEST_WORDS) // 2 if title in WORDS else length
            for title, length in zip(self.header, longest, strict=True)
        ]
        longest[:1] = [min(length, _LONGEST_FIRST) for length in longest[:1]]
        return sum(length + _GAP for length in longest) > _HALF_PAGE


@dataclass
class Section:
    """A section of the page: figures, then verdicts, then tables."""

    title: str
    figures: list[Figure] = field(default_factory=list)
    tables: list[Table] = field(default_factory=list)
    verdicts: list[Verdict] = field(default_factory=list)

    def __bool__(self) -> bool:
        return bool(self.figures or self.tables or self.verdicts)

    @property
    def cards(self) -> list[Card]:
        """All cards in their order, tables as wide as the page last."""
        tables = sorted(self.tables, key=lambda table: table.broad)
        return [*self.figures, *([Verdicts(self.verdicts)] if self.verdicts else []), *tables]


@dataclass(frozen=True)
class Verdicts:
    """A card of verdicts."""

    entries: Sequence[Verdict]


Card = Figure | Table | Verdicts


def rows(cards: Sequence[Card]) -> list[list[list[tuple[int, Card]]]]:
    """Cards in rows of one column as wide as the page, or of two whose lengths are nearly equal; each card with its place in the order.

    Of the ways to part cards between two columns, the first in which neighbours stand side by side is taken, among those that leave least empty.
    """
    result: list[list[list[tuple[int, Card]]]] = []
    half: list[tuple[int, Card]] = []
    for place, card in enumerate(cards):
        if _full(card):
            result += [*_in_columns(half), [[(place, card)]]]
            half = []
        else:
            half.append((place, card))
    return [*result, *_in_columns(half)]


def _in_columns(cards: Sequence[tuple[int, Card]]) -> list[list[list[tuple[int, Card]]]]:
    if len(cards) < 2:
        return [[list(cards)]] if cards else []
    if len(cards) > _MOST_TOGETHER:
        return [*_in_columns(cards[:_MOST_TOGETHER]), *_in_columns(cards[_MOST_TOGETHER:])]
    lengths = [_lines(card) for _, card in cards]

    def badness(right: tuple[int, ...]) -> tuple[int, int, tuple[int, ...]]:
        empty = abs(sum(length * (1 - 2 * side) for length, side in zip(lengths, right, strict=True)))
        return round(empty / _HARDLY_EMPTY), sum(a == b for a, b in pairwise(right)), right

    best = min(((0, *rest) for rest in product((0, 1), repeat=len(cards) - 1) if any(rest)), key=badness)
    return [[[card for card, side in zip(cards, best, strict=True) if side == column] for column in (0, 1)]]


def _full(card: Card) -> bool:
    return card.broad if isinstance(card, Table) else isinstance(card, Figure) and card.full


def _lines(card: Card) -> float:
    """About how many lines of text a card of half the width of the page is long."""
    if isinstance(card, Verdicts):
        return 3 + sum(1 + len(entry.text) / _LINE for entry in card.entries)
    words = 3 + len(card.note) / _LINE
    if isinstance(card, Figure):
        drawn = sum(float(height) for height in re.findall(r'class="fig" viewBox="0 0 [\d.]+ ([\d.]+)"', card.svg))
        return words + 0.05 * drawn + sum(4 + len(label) for _, _, label in card.legend) / _LINE
    wrapped = sum(1 + len(row[-1]) // _HALF_PAGE * (card.header[-1] in WORDS) for row in card.rows)
    return words + 1.5 * (1 + wrapped) + len(card.remark) / _LINE


@dataclass(frozen=True)
class Chapter:
    """One of the two long sections of the page, the rig measurement and the comparison: with notices, and its cards in a given order."""

    title: str
    kind: str
    """Class of the section, ``rig`` or ``comparison``."""
    warnings_of: str
    """Origin of the warnings, for their heading."""
    warnings: Sequence[str]
    parts: Sequence[Figure | Table]
    findings: Sequence[str] = ()
    emulated: str = ""
    """Notice that frames are simulated, else empty."""
