"""Cards of a page beside figures: tables; and its sections, which are lists of cards."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from brdfpipe.appearance.verdicts import Verdict
from brdfpipe.report.plots.svg import Figure


@dataclass(frozen=True)
class Table:
    """A table; cells are text, the first column heads its row."""

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""
    remark: str = ""
    """Highlighted text above the note."""


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
