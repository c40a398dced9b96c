"""Datasets of one material, for the tests of pages and catalogue."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from typing import Any

import pytest
import rig_primary
import samples
import xarray as xr
from material_datasets import Datasets, full_material, surface_line

from brdfpipe.bsdf.measured import completion, smoothing


@pytest.fixture(scope="session")
def full() -> Datasets:
    """Everything that the workflow can know of one material."""
    return full_material()


@pytest.fixture(scope="session")
def line() -> xr.Dataset:
    """A line profile."""
    return surface_line()


@pytest.fixture(scope="session")
def smoothed_on_rig() -> xr.Dataset:
    """A plastic that a rig measured at 10, 30 and 60 degree."""
    truth = rig_primary.of_model(samples.beckmann_bsdf(0.1, n=1.5).bsdf.nonspectral())
    return smoothing.smooth(rig_primary.measured(truth, (10.0, 30.0, 60.0), (500.0, 550.0), noise=0.01))


@pytest.fixture(scope="session")
def on_rig(smoothed_on_rig: xr.Dataset) -> xr.Dataset:
    """The same in all directions."""
    return completion.complete(smoothed_on_rig).assign_attrs(route="measured")


@pytest.fixture(scope="session")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """Headless Chromium, without a network; its log has the console and every request."""
    webdriver = pytest.importorskip("selenium.webdriver", reason="selenium is not installed: make peers")
    chromium, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if not chromium or not driver:
        pytest.skip("chromium and chromedriver are not installed: make browser")
    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    flags = (
        "--headless --no-sandbox --disable-gpu --no-first-run --disable-background-networking --disable-component-update "
        f"--disable-sync --disable-dev-shm-usage --window-size=1280,1400 --user-data-dir={tmp_path_factory.mktemp('profile')}"
    )
    for flag in flags.split():
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    opened = webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))
    opened.set_script_timeout(300)
    opened.set_page_load_timeout(300)
    yield opened
    opened.quit()
