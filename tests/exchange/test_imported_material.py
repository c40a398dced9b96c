"""A table of another program as a material: from its file to gloss, colours, page and files for further programs."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import samples

from brdfpipe import exchange, store
from brdfpipe.appearance import gloss
from brdfpipe.jobs.build import build


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of a coloured table, and of a file that is damaged."""
    folder = tmp_path_factory.mktemp("imported")
    for name in ("grain", "damaged"):
        (folder / "catalogue" / name).mkdir(parents=True)
        (folder / "catalogue" / name / "material.yaml").write_text("table: {file: grain.bsdf}\nexports: [integra]\n")
    red = samples.beckmann_bsdf(0.3, reflectance=0.05 + 0.005 * (samples.WAVELENGTH - 360) / 4.2)
    target = folder / "catalogue" / "grain" / "grain.zemax.bsdf"
    exchange.write(red, target, tolerance=0.05, albedo_tolerance=0.02, colour=True)
    text = target.rename(target.with_name("grain.bsdf")).read_text()
    (folder / "catalogue" / "damaged" / "grain.bsdf").write_text(text[: len(text) // 2])
    settings = folder / "settings.yaml"
    settings.write_text(
        "preview: false\nlambert_gauss: {theta_i: [0, 45]}\nappearance: {haze: []}\n"
    )  # no test reads them
    summary = build(folder / "catalogue", folder / "results", cores=1, config=settings)
    assert list(summary.failures) == ["damaged"]
    return folder / "results"


def test_the_bsdf_is_that_of_the_file(built: Path) -> None:
    bsdf = store.open_dataset(built / "grain" / "bsdf.nc", "bsdf")
    assert bsdf.attrs["route"] == "imported"
    source = json.loads((built.parent / "catalogue" / "grain" / "grain.zemax.bsdf.json").read_text())
    assert source["error"]["percentile_95"] < 0.06
    red = samples.beckmann_bsdf(0.3, reflectance=0.05 + 0.005 * (samples.WAVELENGTH - 360) / 4.2)
    assert gloss(bsdf, [60.0]).values == pytest.approx(gloss(red, [60.0]).values, rel=0.05)


def test_the_page_says_where_the_brdf_comes_from_and_what_it_lacks(built: Path) -> None:
    page = (built / "grain" / "report.html").read_text(encoding="utf-8")
    assert "Imported from a table (zemax)" in page
    assert "The BRDF is the table of a file" in page
    assert "The file has colours, no spectra" in page
    assert "assumed finish" not in page
    assert "Set `spectrum`" not in page


def test_it_leaves_in_other_formats(built: Path) -> None:
    assert (built / "grain" / "exports" / "grain.ddr").stat().st_size > 1000
