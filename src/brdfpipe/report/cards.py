"""Cards of a page beside figures: tables; and its sections, which are lists of cards."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from brdfpipe.appearance.verdicts import Verdict
from brdfpipe.report.plots.svg import Figure

WORDS = ("Definition", "Description", "Error", "Not in the file", "Of")
"""Titles of columns of sentences, which are broken into lines."""

_HALF_PAGE, _GAP = 70, 2
"""Characters of a row of half the width of the page, and between columns."""
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
