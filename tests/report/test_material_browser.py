"""The page of a material in a browser: what a reader switches, and what paper shows."""

from __future__ import annotations

from pathlib import Path
from typing import Any

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


@pytest.mark.parametrize("width", [400, 900, 1400])
def test_nothing_is_wider_than_the_window(browser: Any, page: Path, width: int) -> None:
    browser.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride", {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    )
    try:
        opened_page(browser, page)
        assert browser.execute_script("return document.documentElement.scrollWidth") <= width
    finally:
        browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
