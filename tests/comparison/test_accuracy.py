"""A small version of the comparison of all models, and its page. ``make accuracy`` runs all of it."""

from __future__ import annotations

import accuracy
import numpy as np
import pytest
import samples


def test_a_model_is_measured_and_a_refusal_is_stated(tmp_path, monkeypatch):
    monkeypatch.setattr(accuracy, "REFERENCE_RAYS", 60_000)
    monkeypatch.setattr(accuracy, "DIRECTIONS", 2_000)
    surface = samples.gaussian_surface(96, sigma=0.3, correlation=8.0)
    facets, diffraction = (accuracy.measure(rung, surface, tmp_path) for rung in ("facets", "kirchhoff"))
    assert min(facets.build, facets.rate, facets.size) > 0
    assert abs(facets.peak[0]) < 0.05
    assert np.isfinite(facets.gloss[:2]).all()
    assert "π between" in diffraction.refusal
    page = accuracy.report({"rough": [facets, diffraction], accuracy.SMOOTH_MAP: [facets, diffraction]})
    assert "| kirchhoff | – | – | – | refused | refused |" in page
    assert "- **kirchhoff** is refused: the phase of reflected light" in page
    assert "| kirchhoff | – | – | – | – | – | – |" in page


def test_the_summary_states_the_worst_error_and_the_highest_cost_over_the_maps():
    def row(build: float, rate: float, peak: tuple[float, ...], refusal: str = "") -> accuracy.Measured:
        return accuracy.Measured("facets", build, rate, 1.0, np.array(peak), np.array([0.5, np.nan, -0.7]), refusal)

    maps = {"cells": [row(0.2, 8.0, (0.01, -0.04, np.nan))], "ridges": [row(3.0, 1.0, (0.02, 0.03, 0.01))]}
    refused = {"grooves": [row(np.nan, np.nan, (np.nan,) * 3, "too steep")]}
    smooth = {accuracy.SMOOTH_MAP: [row(0.1, 9.0, (0.2, 0.1, -0.3))]}
    page = accuracy.report(maps | refused | smooth)
    assert "| facets | 3 | 1 | −4.0 (2 of 3 maps) | −0.70 | −30.0 | −0.70 |" in page


@pytest.mark.parametrize(
    "rung",
    [
        "Lambert + Gauss, fitted to facets",
        "facets, masking measured, second reflections directional",
        "composite",
        "auto, one reflection",
    ],
)
def test_every_kind_of_model_is_built_from_the_heights(rung):
    surface = samples.gaussian_surface(96, sigma=0.3, correlation=8.0)
    assert accuracy.RUNGS[rung](surface).attrs["kind"] == "bsdf"
