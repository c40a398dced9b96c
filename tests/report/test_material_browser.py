"""The page of a material in a browser: what a reader switches, and what paper shows."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import samples
from browser_pages import console_and_requests, opened_page

from brdfpipe.appearance.preview import preview
from brdfpipe.report import material_page

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    bsdf = samples.beckmann_bsdf(0.1, reflectance=0.3)
    path = tmp_path_factory.mktemp("page") / "report.html"
    path.write_text(material_page({"bsdf": bsdf, "preview": preview(bsdf, side=64)}), "utf-8")
    return path


OVERLAPS = """
const found = [];
for (const svg of document.querySelectorAll("svg.fig")) {
  const boxes = [...svg.querySelectorAll("text")].map((e) => [e.textContent, e.getBoundingClientRect()]);
  boxes.forEach(([a, p], k) => boxes.slice(k + 1).forEach(([b, q]) => {
    const wide = Math.min(p.right, q.right) - Math.max(p.left, q.left), tall = Math.min(p.bottom, q.bottom) - Math.max(p.top, q.top);
    if (wide > 1 && tall > 0.35 * Math.min(p.height, q.height)) found.push(`${svg.getAttribute("aria-label").slice(0, 40)}: ${a} over ${b}`);
  }));
}
return found;
"""
"""Labels of charts of which one covers the other."""


def visible(browser: Any) -> list[str]:
    """Descriptions of the pictures that are shown."""
    return browser.execute_script(
        "return [...document.querySelectorAll('.look img')].filter(e => e.offsetWidth > 0).map(e => e.alt.split(' in the light of ')[1])"
    )


def test_the_light_of_the_preview_is_chosen_by_pointer_and_by_keys(browser: Any, page: Path) -> None:
    from selenium.webdriver.common.keys import Keys

    opened_page(browser, page)
    assert set(visible(browser)) == {"three soft boxes and a dim sky, D65"}
    assert len(visible(browser)) == 3
    browser.find_element("css selector", "label[for=light-2]").click()
    assert len(visible(browser)) == 3
    assert "one lamp" in visible(browser)[0]
    browser.find_element("id", "light-2").send_keys(Keys.ARROW_RIGHT)
    assert len(visible(browser)) == 3
    assert "four rows of tubes, FL11" in visible(browser)[0]
    messages, requests = console_and_requests(browser)
    assert messages == []
    assert [address for address in requests if not address.startswith(("file:", "data:"))] == []


@pytest.mark.parametrize("title", ["BRDF, Cartesian", "BRDF, goniometric"])
def test_a_chart_saves_the_values_it_was_drawn_from(browser: Any, page: Path, title: str) -> None:
    opened_page(browser, page)
    text = browser.execute_async_script(
        """
        const [title, done] = arguments, create = URL.createObjectURL;
        URL.createObjectURL = (blob) => (blob.text().then(done), create.call(URL, blob));
        const figures = [...document.querySelectorAll("figure.card")];
        figures.find((e) => e.textContent.includes(title)).querySelector("button.save").click();
        """,
        title,
    )
    header, *rows = csv.reader(io.StringIO(text))
    assert header == ["curve", "angle of view θₒ, degree (positive: away from the source)", "BRDF, sr⁻¹"]
    at_45 = np.array([[float(x), float(y)] for name, x, y in rows if name == "45°"])
    theta, value = at_45[(at_45[:, 0] > 0) & (at_45[:, 0] < 85)].T
    bsdf = samples.beckmann_bsdf(0.1, reflectance=0.3).bsdf
    expected = bsdf.evaluate(45.0, 180.0, theta, 0.0, 550.0).values.ravel()
    assert value == pytest.approx(expected, rel=6e-4)


def test_maps_and_charts_are_named_for_those_who_do_not_see_them(browser: Any, page: Path) -> None:
    opened_page(browser, page)
    unnamed = browser.execute_script(
        """
        const named = (e) => e.getAttribute("aria-label") || e.getAttribute("alt") || e.textContent.trim() || e.labels?.length;
        return [...document.querySelectorAll("svg[role=img], img, button, input, select, [role=region]")]
            .filter((e) => !named(e)).map((e) => e.outerHTML.slice(0, 80));
        """
    )
    assert unnamed == []


@pytest.mark.parametrize("width", [400, 900, 1400])
def test_nothing_is_wider_than_the_window(browser: Any, page: Path, width: int) -> None:
    browser.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride", {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    )
    try:
        opened_page(browser, page)
        assert browser.execute_script("return document.documentElement.scrollWidth") <= width
        # No label of a chart covers another.
        assert browser.execute_script(OVERLAPS) == []
    finally:
        browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
