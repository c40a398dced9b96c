"""Which of several predictions of the same material is its BSDF."""

from __future__ import annotations

from collections.abc import Container

PREDICTIONS = ("reference", "wave", "sheet", "coated", "predicted")
"""Stages that predict a BSDF. Some start from the result of another: of a material the first one of this list holds."""


def best_prediction(stages: Container[str]) -> str | None:
    """The stage whose dataset is the predicted BSDF of a material that has these stages; None without a prediction."""
    return next((name for name in PREDICTIONS if name in stages), None)
