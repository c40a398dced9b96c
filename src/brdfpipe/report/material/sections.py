"""A section of a page."""

from __future__ import annotations

from dataclasses import dataclass, field

from brdfpipe.appearance.verdicts import Verdict
from brdfpipe.report.cards import Table
from brdfpipe.report.plots.svg import Figure


@dataclass
class Section:
    """A section of the page: figures, then verdicts, then tables."""

    title: str
    figures: list[Figure] = field(default_factory=list)
    tables: list[Table] = field(default_factory=list)
    verdicts: list[Verdict] = field(default_factory=list)

    def __bool__(self) -> bool:
        return bool(self.figures or self.tables or self.verdicts)
