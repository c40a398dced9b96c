"""What was measured on other materials: errors and costs of candidates for a scene, by the features of the material.

``make tradeoff`` measures them and writes one file for each scene into ``config/scenes/experience``.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, lru_cache
from pathlib import Path

import numpy as np

from brdfpipe import store
from brdfpipe.errors import BrdfpipeError
from brdfpipe.geometry import Array
from brdfpipe.scenes.error_regression import LEAST, Regression, expected_parameters
from brdfpipe.scenes.features import in_spreads
from brdfpipe.scenes.ladders import FULLEST, LADDERS, Candidate


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
    """Error that the fullest candidate has at least, against rays or diffraction on the height map, in the unit of the metric; None where unknown"""

    @cached_property
    def in_spreads(self) -> Array:
        """Its features, (features,), in units of their spread."""
        return in_spreads(self.features)


NEGLIGIBLE = 0.01
"""Error over the tolerance of the scene, below which errors count as equal."""

CERTAINTY = 2.33
"""Standard deviations of a regression above the expected value, below which 99 % of normally distributed ones are."""

MODEL_ERROR = "model error"
"""Key of the parameters of :attr:`Known.model_error`."""


@dataclass(frozen=True)
class Experience:
    """Materials on which the candidates of a scene were tried."""

    metric: str
    scene: str
    """Digest of what of a scene decides errors (:attr:`brdfpipe.scenes.scene.Scene.errors_of`)"""
    materials: tuple[Known, ...] = ()
    least_error: float = 1e-6
    """Errors below it count as it, in the unit of the metric"""
    deviations: float = CERTAINTY
    """Standard deviations above the expected error at which its bound is; more than for normally distributed errors, where materials that are
    left out show that these are not enough"""
    parameters: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    """Parameters of the regression of each quantity; those that are expected where a quantity has none"""

    def error(self, candidate: Candidate) -> Regression | None:
        """Regression of the error of a candidate; None where it was tried on too few materials."""
        return self._regression(
            f"error {candidate.key}", lambda: self.tried(candidate), lambda known: known.trials[candidate].error
        )

    def cost(self, candidate: Candidate) -> Regression | None:
        """Regression of the cost of a candidate; None where it was tried on too few materials."""
        return self._regression(
            f"cost {candidate.key}", lambda: self.tried(candidate), lambda known: known.trials[candidate].cost
        )

    @property
    def model_error(self) -> Regression | None:
        """Regression of the error that the fullest model itself has at least; None where it is known of too few materials."""
        return self._regression(
            MODEL_ERROR,
            lambda: [known for known in self.materials if known.model_error is not None],
            lambda known: known.model_error or 0.0,
        )

    def tried(self, candidate: Candidate) -> list[Known]:
        """The materials on which a candidate was tried."""
        return [known for known in self.materials if candidate in known.trials]

    def fitted(self) -> Experience:
        """With the parameters of the regressions fitted to the materials."""
        candidates = dict.fromkeys(candidate for known in self.materials for candidate in known.trials)
        found: dict[str, tuple[float, ...]] = {}
        for key, regression in (
            *((f"error {one.key}", self.error(one)) for one in candidates if one != FULLEST),
            *((f"cost {one.key}", self.cost(one)) for one in candidates),
            (MODEL_ERROR, self.model_error),
        ):
            if regression is not None:
                fitted = Regression.fitted(regression.features, np.exp(regression.logarithms))
                found[key] = tuple(round(value, 3) for value in fitted.parameters)
        return replace(self, parameters=found)

    def _regression(
        self, key: str, materials: Callable[[], Sequence[Known]], value: Callable[[Known], float]
    ) -> Regression | None:
        if key not in self._regressions:
            self._regressions[key] = self._regression_of(key, materials(), value)
        return self._regressions[key]

    def _regression_of(
        self, key: str, materials: Sequence[Known], value: Callable[[Known], float]
    ) -> Regression | None:
        if len(materials) < LEAST:
            return None
        features = np.stack([known.in_spreads for known in materials])
        least = 0.0 if key.startswith("cost") else self.least_error
        logarithms = np.log([max(value(known), least) for known in materials])
        return Regression(features, logarithms, self.parameters.get(key, expected_parameters(features.shape[1])))

    @cached_property
    def _regressions(self) -> dict[str, Regression | None]:
        """Those that were asked for: each solves its equations once, for all materials that are planned."""
        return {}

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
        parameters = ",\n".join(f"{json.dumps(key)}: {json.dumps(values)}" for key, values in self.parameters.items())
        known = ("metric", "scene", "least_error", "deviations")
        head = json.dumps({name: getattr(self, name) for name in known})[:-1]
        store.write_text(path, f'{head}, "parameters": {{\n{parameters}\n}}, "materials": [\n{lines}\n]}}\n')


NONE = Experience("", "")
"""No material was tried."""


def read(path: Path) -> Experience:
    """The experience of a file; the same object for the same content.

    Raises
    ------
    BrdfpipeError : a file that ``make tradeoff`` did not write.
    """
    try:
        return _parsed(path.read_text(encoding="utf-8"))
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise BrdfpipeError(
            f"{path}: is not a file of measured errors ({error}); write it anew with `make tradeoff`"
        ) from error


@lru_cache(8)
def _parsed(text: str) -> Experience:
    content = json.loads(text)
    materials = tuple(
        Known(
            row["name"],
            row["features"],
            {candidate_of(key): Trial(*pair) for key, pair in row["trials"].items()},
            row["model_error"],
        )
        for row in content["materials"]
    )
    parameters = {key: tuple(map(float, values)) for key, values in content["parameters"].items()}
    least, deviations = (float(content[name]) for name in ("least_error", "deviations"))
    return Experience(content["metric"], content["scene"], materials, least, deviations, parameters)


@cache
def candidate_of(key: str) -> Candidate:
    """The candidate of a key. Raises ValueError: an unknown rung."""
    rungs: Sequence[str] = key.split("/")
    for (name, ladder), rung in zip(LADDERS.items(), rungs, strict=True):
        if rung not in [one.name for one in ladder]:
            raise ValueError(f"unknown rung {rung!r} of {name}")
    return Candidate(*rungs)
