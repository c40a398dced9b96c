"""The directional viewer: its data against the BSDF, and the page in a browser against both."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import samples
from browser_pages import console_and_requests, opened_page
from material_datasets import Datasets

from brdfpipe.bsdf.registry import representation
from brdfpipe.report import material_page, rendering, viewer
from brdfpipe.report.plots import bsdf_sections

CASES = {
    "mirror-like": (lambda: samples.beckmann_bsdf(0.003, n=1.5), 0.02),
    "glossy": (lambda: samples.beckmann_bsdf(0.05, n=1.5), 0.02),
    "matt": (lambda: samples.beckmann_bsdf(0.4, n=1.5), 0.02),
}
"""A bound of two percent is what a printed value of three digits and a colour of the map can hide."""


@pytest.mark.parametrize("name", CASES)
def test_values_between_the_nodes_are_those_of_the_bsdf(name: str) -> None:
    make, bound = CASES[name]
    bsdf = make()
    plane = bsdf_sections.planes(bsdf)[0]
    sampled = viewer.sample(bsdf, plane)
    slope = representation(bsdf).lobe_slope
    assert slope is not None
    random = np.random.default_rng(3)
    incidence = random.uniform(0, 75, 200)
    # Within the lobe, where a coarse grid would miss the peak.
    theta = np.abs(incidence + np.degrees(slope) * random.uniform(-2, 2, 200))
    turn = np.degrees(slope) * random.uniform(-2, 2, 200)
    true = bsdf_sections.value(bsdf, plane, incidence, theta, turn)
    shown = 10 ** viewer.interpolated(sampled, incidence, theta, turn)
    lit = true > 1e-6 * true.max()
    error = np.abs(shown[lit] / true[lit] - 1)
    assert np.percentile(error, 95) < bound


def test_a_coarser_grid_would_exceed_the_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    bsdf = samples.beckmann_bsdf(0.003, n=1.5)
    plane = bsdf_sections.planes(bsdf)[0]
    monkeypatch.setattr(viewer, "DISTANCES", 9)
    _, high = viewer.interpolation_error(bsdf, plane, viewer.sample(bsdf, plane))
    assert high > 0.02


def test_data_of_a_page_is_small_and_states_its_error(full: Datasets) -> None:
    data = viewer.viewer_data(full)
    assert data is not None
    assert len(rendering.as_json(data)) < 400_000
    for one in data["sets"]:
        assert one["error"][1] is None or 0 <= one["error"][1] < 0.2


def test_json_cannot_end_its_element() -> None:
    assert "<" not in rendering.as_json({"name": "</script><script>alert(1)</script>"})


def test_without_a_bsdf_there_is_no_viewer() -> None:
    assert viewer.viewer_data({}) is None


def test_a_measured_bsdf_is_shown_beside_the_last_prediction_of_its_surface(monkeypatch: pytest.MonkeyPatch) -> None:
    measured = samples.beckmann_bsdf(0.1).assign_attrs(route="measured")
    facets, waves = samples.beckmann_bsdf(0.2), samples.beckmann_bsdf(0.3)
    compared: dict[str, Any] = {}

    def one_set(name, bsdf, *_):
        compared[name] = bsdf
        return {"high": None}

    monkeypatch.setattr(viewer, "_set", one_set)
    viewer.viewer_data({"bsdf": measured, "predicted": facets, "wave": waves})
    assert compared["measured"] is measured
    assert compared["predicted"] is waves
    viewer.viewer_data({"bsdf": measured, "predicted": facets})
    assert compared["predicted"] is facets


def test_a_page_carries_the_licence_of_the_library_in_it() -> None:
    page = material_page({"bsdf": samples.beckmann_bsdf(0.4)})
    assert "Leon Sorokin" in page
    assert "Permission is hereby granted" in page


# --- in a browser

SCRIPT = """
const done = arguments[arguments.length - 1], [name, value] = arguments, root = document.getElementById("viewer");
const element = root.querySelector(`[data-part=${name}]`);
element.value = value;
element.dispatchEvent(new Event("input"));
requestAnimationFrame(() => requestAnimationFrame(() => done([root.dataset.value, root.querySelector("[data-part=value]").textContent])));
"""


def test_the_viewer_shows_the_values_of_the_bsdf_at_every_incidence(browser: Any, tmp_path: Path) -> None:
    bsdf = samples.beckmann_bsdf(0.05, n=1.5).assign_attrs(material="<img src=x onerror=alert(1)>")
    (tmp_path / "report.html").write_text(material_page({"bsdf": bsdf}, description="<script>alert(2)</script>"))
    opened_page(browser, tmp_path / "report.html")
    plane = bsdf_sections.planes(bsdf)[0]
    for incidence in (0.0, 22.5, 45.0, 71.5):
        shown, words = browser.execute_async_script(SCRIPT, "incidence", incidence)
        true = float(bsdf_sections.value(bsdf, plane, incidence, incidence, 0.0))
        assert float(shown) == pytest.approx(true, rel=0.02)
        assert f"θ {incidence:.1f}°" in words
    messages, requests = console_and_requests(browser)
    assert messages == []
    assert [one for one in requests if not one.startswith(("file:", "data:"))] == []
