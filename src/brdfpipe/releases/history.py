"""Numbers of each material over a series of releases."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from brdfpipe.geometry import Array
from brdfpipe.releases.differences import Releases
from brdfpipe.spectra.colorimetry import delta_e_00


@dataclass(frozen=True)
class History:
    """One material over releases; NaN where a release does not have the material or the number."""

    gloss_60: Array
    """(releases,) gloss at 60° [GU]."""
    colour: Array
    """(releases,) difference of the colour from that of the first release that has one [ΔE00]."""


def histories(releases: Sequence[Releases]) -> dict[tuple[str, str], History]:
    """(scene, material) → its numbers over the releases.

    Parameters
    ----------
    releases : results of builds, the oldest first
    """
    values: dict[tuple[str, str], Array] = {}
    for number, scenes in enumerate(releases):
        for folder, release in scenes.items():
            for name, row in release.rows.items():
                series = values.setdefault((Path(folder).name, name), np.full((len(releases), 4), np.nan))
                for column, quantity in enumerate(("gloss_60", "L", "a", "b")):
                    if quantity in row:
                        series[number, column] = row[quantity]
    return {key: _history(series) for key, series in values.items()}


def _history(series: Array) -> History:
    lab = series[:, 1:]
    known = np.flatnonzero(np.isfinite(lab).all(axis=1))
    colour = np.full(len(series), np.nan)
    if known.size:
        colour[known] = delta_e_00(lab[known], np.broadcast_to(lab[known[0]], (known.size, 3)))
    return History(series[:, 0], colour)
