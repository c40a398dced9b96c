"""The workflow on real measurements: a rubber scan under a white PVC spectrum, and materials that cannot be built beside it."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import brdfpipe
from brdfpipe import hemisphere, spectra, surfaces
from brdfpipe.jobs.build import build as build_catalogue

GOOD = """\
description: Rubber under white PVC
surface: {file: KautschukInfiniteFocus.x3p}
index: 1.52
spectrum: {file: pvc_white_de.csv, geometry: sci}
exports: [astm]
texture: {pixel: 11.4, size: 128, method: structure}
"""

BAD = {
    "typo": (GOOD.replace("geometry", "geometri"), "did you mean 'geometry'"),
    "lost": (GOOD.replace("pvc_white_de", "pvc_weiss"), "no such file"),
    "short": ("spectrum: {file: short.txt, geometry: sci}\n", "590–700 nm is missing"),
    "unitless": ("surface: {file: height.txt, isotropic: true, pitch: 0.5}\nindex: PP\n", "`surface.unit`"),
}


@pytest.fixture(scope="module")
def built(shared_data: Path, made_once: Callable[[str, Callable[[Path], None]], Path]) -> tuple[Path, dict[str, str]]:
    """The folder of the results, and material → failure."""
    base = made_once("real", lambda base: build_real(base, shared_data))
    return base / "results", json.loads((base / "failures.json").read_text())


def build_real(base: Path, shared_data: Path) -> None:
    for name, text in {"rubber": GOOD, **{name: text for name, (text, _) in BAD.items()}}.items():
        folder = base / "catalogue" / name
        folder.mkdir(parents=True)
        (folder / "material.yaml").write_text(text)
        if "Kautschuk" in text:
            shutil.copy(shared_data / "surfaces" / "KautschukInfiniteFocus.x3p", folder)
            shutil.copy(shared_data / "spectra" / "pvc_white_de.csv", folder)
    rng = np.random.default_rng(1)
    np.savetxt(base / "catalogue" / "short" / "short.txt", [(nm, 50.0) for nm in range(400, 600, 10)])
    np.savetxt(base / "catalogue" / "unitless" / "height.txt", rng.normal(size=500))
    summary = build_catalogue(base / "catalogue", base / "results", cores=2)
    assert summary.built == ("rubber",)
    (base / "failures.json").write_text(json.dumps(summary.failures))


def test_the_scan_is_the_known_one(built):
    surface = brdfpipe.open_dataset(built[0] / "rubber" / "surface.nc")
    facets = brdfpipe.open_dataset(built[0] / "rubber" / "facets.nc")
    parameters = surfaces.parameters(surface)
    assert float(parameters["Sq"]) == pytest.approx(3.40, rel=0.02)
    assert float(parameters["missing_fraction"]) == pytest.approx(0.0097, rel=0.02)
    assert float(facets["slope_rms"]) == pytest.approx(0.136, rel=0.02)
    assert float(facets["anisotropy"]) == pytest.approx(1.03, rel=0.02)


@pytest.mark.parametrize(("stage", "error"), [("predicted", 1e-6), ("bsdf", 5e-5)])
def test_the_stored_brdf_integrates_to_the_measured_spectrum(built, shared_data, stage, error):
    # The passage from waves to facets is no polynomial: the quadratures of model and test differ by up to 4e-5.
    bsdf = brdfpipe.open_dataset(built[0] / "rubber" / f"{stage}.nc")
    measured = spectra.read_spectrum(shared_data / "spectra" / "pvc_white_de.csv", geometry="sci")
    rule = hemisphere.around_mirror(8.0, 0.1, order=12, turns=48)
    integrated = rule.weight @ bsdf.bsdf.evaluate(8.0, 0.0, rule.theta, rule.phi).values
    assert integrated == pytest.approx(measured["total_reflectance"].values, abs=error)


def test_the_exported_reflectance_is_the_measured_one(built, shared_data):
    exported = pd.read_csv(built[0] / "rubber" / "exports" / "rubber.total_reflectance.csv", comment="#")
    measured = spectra.read_spectrum(shared_data / "spectra" / "pvc_white_de.csv", geometry="sci")
    assert exported["total_reflectance"].values == pytest.approx(measured["total_reflectance"].values, abs=1e-8)


def test_the_colour_is_that_of_white_pvc(built):
    lab = brdfpipe.open_dataset(built[0] / "rubber" / "appearance.nc")["lab"].sel(geometry="8:total").values
    assert lab == pytest.approx([85.0, -0.7, 4.3], abs=0.1)


class _Text(HTMLParser):
    def __init__(self, page: Path) -> None:
        super().__init__()
        self.words: list[str] = []
        self.tags: set[str] = set()
        self.feed(page.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)

    def handle_data(self, data):
        self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())


def test_the_report_shows_what_was_measured(built):
    page = _Text(built[0] / "rubber" / "report.html")
    assert {"svg", "table", "image"} <= page.tags
    for words in ("rubber", "3.40", "0.136", "85.0", "Slope density", "Masking", "Provenance", "missing heights"):
        assert words in page.text


def test_the_rubber_has_a_texture_whose_map_with_the_rest_is_its_brdf(built):
    rest = brdfpipe.open_dataset(built[0] / "rubber" / "unresolved.nc")
    # The light of the white body, which the map hardly changes, is part of both.
    assert 0 < rest.attrs["mean_difference"] < 0.02
    assert 0 < rest.attrs["lay_difference"] < 0.02
    page = _Text(built[0] / "rubber" / "report.html")
    for words in ("Visible structure", "Map with the rest, from afar", "Under a spot at 45as15", "In diffuse light"):
        assert words in page.text


@pytest.mark.parametrize("name", BAD)
def test_a_bad_material_is_one_clear_line_for_itself(built, name):
    failure = built[1][name]
    assert BAD[name][1] in failure
    assert "\n" not in failure


def test_the_good_material_is_built_and_the_page_lists_the_rest(built):
    results, failures = built
    assert set(failures) == set(BAD)
    page = _Text(results / "index.html")
    assert "rubber" in page.text
    for name in BAD:
        assert name in page.text
    rows = pd.read_csv(results / "catalogue.csv", index_col="material")
    assert set(rows.index) == {"rubber", *BAD}
    assert (rows["status"] == "failed").sum() == len(BAD)
