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
    page = accuracy.report({"rough": [facets, diffraction]})
    assert "| kirchhoff | – | – | – | refused | refused |" in page
    assert "- **kirchhoff** is refused: the phase of reflected light" in page


@pytest.mark.parametrize(
    "rung", ["Lambert + Gauss, fitted to facets", "facets, both", "composite", "auto (the default)"]
)
def test_every_kind_of_model_is_built_from_the_heights(rung):
    surface = samples.gaussian_surface(96, sigma=0.3, correlation=8.0)
    assert accuracy.RUNGS[rung](surface).attrs["kind"] == "bsdf"
