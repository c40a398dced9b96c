"""What was measured on other materials: errors and costs of candidates for a scene, by the features of the material.

``make tradeoff`` measures them and writes one file for each scene into ``config/scenes/experience``.
"""

from __future__ import annotations

import json
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from brdfpipe import store
from brdfpipe.errors import BrdfpipeError
from brdfpipe.scenes.features import distance
from brdfpipe.scenes.ladders import LADDERS, Candidate


@dataclass(frozen=True)
class Trial:
    """What one candidate gave on one material."""

    error: float
    """In the unit of the metric, against the fullest candidate"""
    cost: float
    """Processor time of its build, without what all candidates share [s]"""


@dataclass(frozen=True)
class Known:
    """A material on which candidates were tried."""

    name: str
    features: Mapping[str, float]
    trials: Mapping[Candidate, Trial]
    model_error: float | None = None
    """What the fullest candidate errs by at least against rays or diffraction on the height map, in the unit of the metric; None where unknown"""


@dataclass(frozen=True)
class Experience:
    """Materials on which the candidates of a scene were tried."""

    metric: str
    scene: str
    """Digest of what of the scene changes errors: domain, bands and polarisation"""
    materials: tuple[Known, ...] = ()

    def nearest(self, features: Mapping[str, float], candidate: Candidate, radius: float) -> list[tuple[float, Trial]]:
        """Distance and trial of the materials within a radius on which the candidate was tried, the nearest first."""
        found = [
            (distance(features, known.features), known.trials[candidate])
            for known in self.materials
            if candidate in known.trials
        ]
        return sorted((pair for pair in found if pair[0] <= radius), key=lambda pair: pair[0])

    def model_error(self, features: Mapping[str, float], radius: float, least: int) -> float:
        """Median of what the fullest model itself errs by at least on like materials; 0 where it is known of fewer than ``least``."""
        found = [
            known.model_error
            for known in self.materials
            if known.model_error is not None and distance(features, known.features) <= radius
        ]
        return statistics.median(found) if len(found) >= least else 0.0

    def write(self, path: Path) -> None:
        """Write the file, whole or not at all."""
        rows = [
            {
                "name": known.name,
                "features": {name: round(value, 4) for name, value in known.features.items()},
                "model_error": known.model_error and float(f"{known.model_error:.3g}"),
                "trials": {
                    candidate.key: [float(f"{trial.error:.3g}"), float(f"{trial.cost:.3g}")]
                    for candidate, trial in known.trials.items()
                },
            }
            for known in self.materials
        ]
        lines = ",\n".join(json.dumps(row) for row in rows)
        head = json.dumps({"metric": self.metric, "scene": self.scene})[:-1]
        store.write_text(path, f'{head}, "materials": [\n{lines}\n]}}\n')


NONE = Experience("", "")
"""No material was tried."""


def read(path: Path) -> Experience:
    """The experience of a file.

    Raises
    ------
    BrdfpipeError : a file that ``make tradeoff`` did not write.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        materials = tuple(
            Known(
                row["name"],
                row["features"],
                {candidate_of(key): Trial(*pair) for key, pair in row["trials"].items()},
                row["model_error"],
            )
            for row in content["materials"]
        )
        return Experience(content["metric"], content["scene"], materials)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise BrdfpipeError(
            f"{path}: is not a file of measured errors ({error}); write it anew with `make tradeoff`"
        ) from error


def candidate_of(key: str) -> Candidate:
    """The candidate of a key. Raises ValueError: an unknown rung."""
    rungs: Sequence[str] = key.split("/")
    for (name, ladder), rung in zip(LADDERS.items(), rungs, strict=True):
        if rung not in [one.name for one in ladder]:
            raise ValueError(f"unknown rung {rung!r} of {name}")
    return Candidate(*rungs)
