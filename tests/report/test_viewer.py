"""The directional viewer: its data against the BSDF, and the page in a browser against both."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import samples
import xarray as xr
from browser_pages import console_and_requests, opened_page
from material_datasets import Datasets

from brdfpipe import facets
from brdfpipe.bsdf import slab
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


READ = """
const done = arguments[arguments.length - 1], root = document.getElementById("viewer"), part = (name) => root.querySelector(`[data-part=${name}]`);
requestAnimationFrame(() => requestAnimationFrame(() => done({
  incidence: +part("incidence").value, zoom: 2 ** +part("zoom").value, value: root.dataset.value, words: part("value").textContent })));
"""
CHOOSE = """
const field = document.querySelector(`[data-part=${arguments[0]}]`);
field.value = arguments[1];
field.dispatchEvent(new Event("change"));
"""
SAVED = """
let href;
HTMLAnchorElement.prototype.click = function () { href = this.href; };
document.querySelector("[data-part=save]").click();
return decodeURIComponent(href);
"""


class _Viewer:
    """The viewer of a page, by its mouse and keys."""

    def __init__(self, browser: Any, bsdf: xr.Dataset, folder: Path) -> None:
        self.browser = browser
        (folder / "report.html").write_text(material_page({"bsdf": bsdf.assign_attrs(material="tried")}))
        opened_page(browser, folder / "report.html")

    def part(self, name: str) -> Any:
        return self.browser.find_element("css selector", f"[data-part={name}]")

    def read(self) -> dict[str, Any]:
        return dict(self.browser.execute_async_script(READ))

    def choose(self, name: str, value: str) -> None:
        self.browser.execute_script(CHOOSE, name, value)

    def on_map(self, x: float, y: float = 0.0) -> tuple[int, int]:
        """Offset from the middle of the map, in whole pixels, of direction cosines on the whole hemisphere."""
        size = self.part("map").size
        radius = min(size["width"] - 70, size["height"] - 34) / 2
        return round(radius + 8 + x * radius - size["width"] / 2), round(-y * radius)

    def move(self, *path: tuple[int, int], name: str = "map", held: bool = False) -> None:
        from selenium.webdriver.common.action_chains import ActionChains

        chain, element = ActionChains(self.browser, duration=20), self.part(name)
        chain.move_to_element_with_offset(element, *path[0])
        if held:
            chain.click_and_hold()
        for place in path[1:]:
            chain.move_to_element_with_offset(element, *place)
        (chain.release() if held else chain).perform()

    def cut(self) -> tuple[np.ndarray, np.ndarray]:
        lines = [line.split(",") for line in self.browser.execute_script(SAVED).splitlines()[2:]]
        angle, value = zip(*[(float(a), float(v)) for a, v in lines if v], strict=True)
        return np.array(angle), np.array(value)

    def is_silent(self) -> None:
        messages, requests = console_and_requests(self.browser)
        assert messages == []
        assert [one for one in requests if not one.startswith(("file:", "data:"))] == []


@pytest.mark.slow
def test_the_light_is_dragged_and_directions_are_read_with_the_pointer(browser: Any, tmp_path: Path) -> None:
    bsdf = samples.beckmann_bsdf(0.2, n=1.5)
    viewer_page, plane = _Viewer(browser, bsdf, tmp_path), bsdf_sections.planes(bsdf)[0]
    viewer_page.move(*(viewer_page.on_map(-np.sin(np.radians(angle))) for angle in (45, 40, 30)), held=True)
    incidence = viewer_page.read()["incidence"]
    assert incidence == pytest.approx(30, abs=1.0)  # a pixel of the map is 0.5 degree
    viewer_page.move(viewer_page.on_map(0.3, 0.2), viewer_page.on_map(0.5, 0.3))
    read = viewer_page.read()
    theta, turn = (float(one) for one in re.findall(r"θ ([\d.]+)°, φ (-?\d+)°", read["words"])[0])
    assert np.sin(np.radians(theta)) == pytest.approx(np.hypot(0.5, 0.3), abs=0.02)
    true = float(bsdf_sections.value(bsdf, plane, incidence, theta, turn))
    assert float(read["value"]) == pytest.approx(true, rel=0.05)  # the direction is written to 0.1 and 1 degree
    before = viewer_page.read()["incidence"]
    size = viewer_page.part("polar").size
    radius, down = min(size["width"] / 2 - 26, size["height"] - 64), size["height"] / 2 - 22
    places = [
        (round(-radius * np.sin(np.radians(a))), round(down - radius * np.cos(np.radians(a)))) for a in (before, 50, 60)
    ]
    viewer_page.move(*places, name="polar", held=True)
    assert viewer_page.read()["incidence"] == pytest.approx(60, abs=1.0)
    viewer_page.is_silent()


@pytest.mark.slow
def test_the_map_zooms_to_a_narrow_lobe_and_the_keys_move_the_point(browser: Any, tmp_path: Path) -> None:
    from selenium.webdriver.common.keys import Keys

    bsdf = samples.beckmann_bsdf(0.003, n=1.5)
    viewer_page, plane = _Viewer(browser, bsdf, tmp_path), bsdf_sections.planes(bsdf)[0]
    viewer_page.part("lobe").click()
    zoom = viewer_page.read()["zoom"]
    assert zoom > 40  # the lobe of 0.2 degree fills the map
    viewer_page.part("map").send_keys(Keys.ARROW_RIGHT * 10)
    read = viewer_page.read()
    x = np.sin(np.radians(45)) + 10 * 0.02 / zoom
    true = float(bsdf_sections.value(bsdf, plane, 45.0, np.degrees(np.arcsin(x)), 0.0))
    peak = float(bsdf_sections.value(bsdf, plane, 45.0, 45.0, 0.0))
    assert true < 0.98 * peak
    assert float(read["value"]) == pytest.approx(true, rel=0.02)
    viewer_page.part("map").send_keys("+")
    assert viewer_page.read()["zoom"] == pytest.approx(
        1.5 * zoom, rel=0.05
    )  # the slider has steps of a tenth of an octave
    viewer_page.part("whole").click()
    assert viewer_page.read()["zoom"] == 1
    viewer_page.part("incidence").send_keys(Keys.ARROW_RIGHT)
    assert viewer_page.read()["incidence"] == 45.5
    viewer_page.is_silent()


@pytest.mark.slow
def test_transmitted_light_is_shown_on_its_own_side(browser: Any, tmp_path: Path) -> None:
    sheet = slab.build(facets.flat(), facets.analytic("beckmann", 0.1), index=1.5, internal_transmittance=0.9)
    viewer_page, plane = _Viewer(browser, sheet, tmp_path), bsdf_sections.planes(sheet)[0]
    viewer_page.choose("side", "transmitted")
    angle, value = viewer_page.cut()
    true = bsdf_sections.value(sheet, plane, 45.0, *bsdf_sections.in_plane(angle, through=True))
    lit = true > 1e-3 * true.max()
    assert np.median(np.abs(value[lit] / true[lit] - 1)) < 0.02
    assert viewer_page.read()["words"].startswith("BTDF")
    pixels = """
    const canvas = document.querySelector("[data-part=solid]"), pen = canvas.getContext("2d"), rows = [0, 0];
    const all = pen.getImageData(0, 0, canvas.width, canvas.height).data;
    for (let k = 0; k < all.length; k += 4) if (all[k + 3] && all[k + 1] > all[k] + 40) rows[Math.floor(k / 4 / canvas.width) < 0.56 * canvas.height ? 0 : 1]++;
    return rows;
    """
    viewer_page.read()
    above, below = browser.execute_script(pixels)
    assert below > 5 * above  # the bright part of the lobe points down
    viewer_page.is_silent()


@pytest.mark.slow
def test_along_and_across_a_lay_the_viewer_shows_the_right_plane(browser: Any, tmp_path: Path) -> None:
    bsdf = samples.brushed_bsdf(0.03, 0.2, 30.0)
    viewer_page, planes = _Viewer(browser, bsdf, tmp_path), bsdf_sections.planes(bsdf)
    for k, plane in enumerate(planes):
        viewer_page.choose("plane", str(k))
        angle, value = viewer_page.cut()
        true = bsdf_sections.value(bsdf, plane, 45.0, *bsdf_sections.in_plane(angle))
        lit = true > 1e-3 * true.max()
        assert np.median(np.abs(value[lit] / true[lit] - 1)) < 0.02
        # Nothing is drawn where the BSDF is below what was sampled, and no hole is in the lobe.
        assert np.all(np.diff(angle[value > 1e-4 * value.max()]) <= 1.0 + 1e-6)
    viewer_page.is_silent()


def test_a_direction_without_light_beside_a_lobe_has_the_least_value_not_a_hole() -> None:
    bsdf = samples.brushed_bsdf(0.03, 0.2)
    for plane in bsdf_sections.planes(bsdf):
        sampled = viewer.sample(bsdf, plane)
        assert np.isfinite(sampled.logs).all()
        assert sampled.floor == pytest.approx(np.nanmin(sampled.logs))
    matt = samples.beckmann_bsdf(0.4, n=1.5)
    assert viewer.sample(matt, bsdf_sections.planes(matt)[0]).floor is None
