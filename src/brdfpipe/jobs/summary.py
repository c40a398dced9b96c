"""Summary of a build in words: materials built and not built, verdicts of their checks, notices."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from brdfpipe.catalogue.catalogue import ignored
from brdfpipe.errors import BrdfpipeError
from brdfpipe.exchange.registry import REFUSAL_ADVICE
from brdfpipe.jobs.cleanup import STALE
from brdfpipe.store import opened

_BAD_VERDICTS = {"warn": ("warn", "fail"), "fail": ("fail",)}

_COLUMNS = ("verdict", "verdict_text", "refused_exports")

_LISTED = 5
"""Names in a notice."""


@dataclass(frozen=True)
class Summary:
    """Result of a build."""

    built: tuple[str, ...]
    """Materials for which something was computed, and which are complete."""
    current: tuple[str, ...]
    """Materials that were up to date."""
    failures: Mapping[str, str]
    """Material that could not be built → reason, in one line."""
    jobs: int
    page: Path | None
    """Of the catalogue; of the first material, where only some were built; None if there is no such page."""
    seconds: float
    dry_run: bool = False
    verdicts: Mapping[str, str] = field(default_factory=dict)
    """Built material → worst verdict of its checks: pass, warn or fail."""
    fail_reasons: Mapping[str, str] = field(default_factory=dict)
    """Built material with the verdict fail → the checks and conditions of the model that failed, with their findings, in one line."""
    pages: Mapping[str, Path] = field(default_factory=dict)
    """Material → its page, where it has one."""
    refused_exports: Mapping[str, str] = field(default_factory=dict)
    """Built material → why formats of other programs were not written, in one line; without those that were."""
    over_budget: tuple[tuple[str, str], ...] = ()
    """(built material, what it took and the budget of its scene), one for each budget that is exceeded."""
    notices: tuple[str, ...] = ()
    """Notices for the user that are no failures."""

    @property
    def plain(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return asdict(self) | {
            "page": str(self.page) if self.page else None,
            "pages": {name: str(page) for name, page in self.pages.items()},
        }

    def has_failed(self, conditions: Collection[str] = ()) -> bool:
        """Whether a material was not built, an export was refused, or a material meets one of the conditions.

        Parameters
        ----------
        conditions : ``fail``, a verdict fail; ``warn``, a verdict other than pass; ``budget``, a material over the budget of its scene
        """
        worst = {verdict for word, verdicts in _BAD_VERDICTS.items() if word in conditions for verdict in verdicts}
        over_budget = "budget" in conditions and bool(self.over_budget)
        incomplete = bool(self.failures or self.refused_exports)
        return incomplete or over_budget or not worst.isdisjoint(self.verdicts.values())

    @property
    def text(self) -> str:
        """Lines for the terminal."""
        not_built = [f"  {name}: not built: {message}" for name, message in sorted(self.failures.items())]
        if self.dry_run:
            total = len(self.built) + len(self.current)
            planned = f"{self.jobs} jobs would run, for {len(self.built)} of {total} materials"
            return "\n".join([planned, *(f"  {name}" for name in self.built), *not_built, *self.notices])
        total = len(self.built) + len(self.current) + len(self.failures)
        counts = (
            f"{_count(total, 'material')}: {len(self.built)} built, {len(self.current)} up to date, "
            f"{len(self.failures)} not built ({_count(self.jobs, 'job')} in {self.seconds:.1f} s)"
        )
        over_budget = [f"{name}: {sentence}" for name, sentence in self.over_budget]
        return "\n".join(
            [
                counts,
                *not_built,
                *(f"  {name}: built, but {reason}" for name, reason in sorted(self.refused_exports.items())),
                *([f"  {REFUSAL_ADVICE}"] if self.refused_exports else []),
                *self._verdict_lines,
                *over_budget,
                *self.notices,
                *([f"Open {self.page}"] if self.page else []),
            ]
        )

    @property
    def _verdict_lines(self) -> list[str]:
        counts = Counter(self.verdicts.values())
        if not (counts["fail"] or counts["warn"]):
            return []
        return [
            f"Verdicts of the checks: {counts['fail']} fail, {counts['warn']} warn; the reports say why",
            *(
                f"  {name}: verdict fail{f': {reason}' if reason else ''}{f' ({self.pages[name]})' if name in self.pages else ''}"
                for name, reason in sorted(self.fail_reasons.items())
            ),
        ]


class Row(NamedTuple):
    """What the summary says of a built material."""

    verdict: str
    reasons: str
    """Of the verdict, in one line."""
    refused_exports: str
    """Why formats of other programs were not written, in one line; empty where all were."""


def read_rows(folders: Iterable[Path], names: Iterable[str]) -> dict[str, Row]:
    """The rows of materials, from the tables of the catalogues in some folders; without materials that have none."""
    found: dict[str | None, Mapping[str, str]] = {}
    for folder in folders:
        with suppress(OSError), (folder / "catalogue.csv").open(encoding="utf-8", newline="") as table:
            found |= {row.get("material"): row for row in csv.DictReader(table)}
    return {
        name: Row(*(found[name].get(column) or "" for column in _COLUMNS))
        for name in names
        if found.get(name, {}).get("status") == "built"
    }


def read_own_rows(rows: Mapping[str, Path]) -> dict[str, Row]:
    """The same from the row of each material, name → its dataset: after a build of some materials the tables are of an earlier one."""
    found = {}
    for name, path in rows.items():
        with suppress(BrdfpipeError), opened({name: path}) as datasets:
            row = datasets[name].isel(material=0)
            found[name] = Row(*(str(row[column].values) for column in _COLUMNS))
    return found


def notices(folder: Path, deleted: Sequence[str], replaced: Sequence[str], stale: Sequence[str]) -> Iterator[str]:
    """Damaged and changed files that were made anew, results of materials that left the catalogue, ignored folders."""
    if deleted:
        yield f"{_count(len(deleted), 'damaged or lost file')} made anew: {', '.join(deleted)}"
    if changed := [name for name in replaced if name not in deleted]:
        yield f"{_count(len(changed), 'result')} changed since the build wrote them, and made anew: {_listed(changed)}"
    if stale:
        yield f"{_count(len(stale), 'folder')} of materials that are no longer in the catalogue, marked by {STALE}: {_listed(stale)}"
    for name, reason in ignored(folder).items():
        yield f"{name}: ignored: {reason}"


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:_LISTED]) + (", …" if len(names) > _LISTED else "")


def _count(number: int, word: str) -> str:
    return f"{number} {word}{'s' if number != 1 else ''}"
