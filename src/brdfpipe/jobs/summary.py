"""Summary of a build in words: materials built and not built, verdicts of their checks, notices."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from brdfpipe.catalogue.catalogue import ignored
from brdfpipe.errors import BrdfpipeError
from brdfpipe.jobs.cleanup import STALE
from brdfpipe.store import opened

_BAD_VERDICTS = {"warn": ("warn", "fail"), "fail": ("fail",)}

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
        """Whether a material was not built, or meets one of the conditions.

        Parameters
        ----------
        conditions : ``fail``, a verdict fail; ``warn``, a verdict other than pass; ``budget``, a material over the budget of its scene
        """
        worst = {verdict for word, verdicts in _BAD_VERDICTS.items() if word in conditions for verdict in verdicts}
        over_budget = "budget" in conditions and bool(self.over_budget)
        return bool(self.failures) or over_budget or not worst.isdisjoint(self.verdicts.values())

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


def read_verdicts(folders: Iterable[Path], names: Iterable[str]) -> dict[str, tuple[str, str]]:
    """Material → verdict and its reasons in one line, from the tables of the catalogues in some folders; empty where there is none."""
    found: dict[str | None, Mapping[str, str]] = {}
    for folder in folders:
        with suppress(OSError), (folder / "catalogue.csv").open(encoding="utf-8", newline="") as table:
            found |= {row.get("material"): row for row in csv.DictReader(table)}
    return {
        name: (verdict, found[name].get("verdict_text") or "")
        for name in names
        if (verdict := found.get(name, {}).get("verdict"))
    }


def read_own_verdicts(rows: Mapping[str, Path]) -> dict[str, tuple[str, str]]:
    """The same from the row of each material, name → its dataset: after a build of some materials the tables are of an earlier one."""
    found = {}
    for name, path in rows.items():
        with suppress(BrdfpipeError), opened({name: path}) as datasets:
            row = datasets[name].isel(material=0)
            found[name] = str(row["verdict"].values), str(row["verdict_text"].values)
    return {name: verdict for name, verdict in found.items() if verdict[0]}


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
