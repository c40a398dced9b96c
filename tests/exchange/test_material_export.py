"""A refused export is named and leaves no file; the material, its page and its other exports are built."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import samples
import xarray as xr
from click.testing import CliRunner

from brdfpipe import store, vocabulary
from brdfpipe.cli.main import main
from brdfpipe.exchange.material_export import export
from brdfpipe.exchange.registry import FORMATS
from brdfpipe.jobs.build import build


def test_an_export_lists_its_files_with_their_digests_and_records(tmp_path: Path) -> None:
    found = export(samples.beckmann_bsdf(0.3), tmp_path, "m", "klems", "reflection")
    vocabulary.validate(found, "export")
    files, records = (json.loads(found.attrs[name]) for name in ("files", "records"))
    assert (
        set(files)
        == {path.name for path in tmp_path.iterdir()}
        == {f"m{one}" for one in FORMATS["klems"].suffixes("reflection")}
    )
    assert all(store.file_digest(tmp_path / name) == digest for name, digest in files.items())
    assert next(iter(records.values()))["error"]["albedo"] < 0.05
    assert vocabulary.warnings(found) == []


def test_a_refused_export_deletes_earlier_files_and_says_why(tmp_path: Path) -> None:
    (tmp_path / "m.gltf").write_text("of an earlier BSDF")
    (tmp_path / "m.astm").write_text("of another format")
    found = export(samples.brushed_bsdf(0.4, 0.2), tmp_path, "m", "gltf", "reflection")
    assert [path.name for path in tmp_path.iterdir()] == ["m.astm"]
    (reason,) = vocabulary.warnings(found)
    assert reason.startswith("export gltf not written: ")
    assert "lay" in reason
    assert json.loads(found.attrs["files"]) == {}


def test_a_file_of_several_that_was_written_before_a_refusal_is_deleted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from brdfpipe.exchange import rgl
    from brdfpipe.exchange.registry import ExchangeError

    def refuse(bsdf: xr.Dataset, path: Path, **options: object) -> None:
        raise ExchangeError("no such spectrum")

    writers = list(FORMATS["rgl"].files["reflection"])
    monkeypatch.setattr(rgl, writers[0], lambda bsdf, path, **options: path.write_text("first") and {})
    monkeypatch.setattr(rgl, writers[-1], refuse)
    export(samples.beckmann_bsdf(0.3), tmp_path, "m", "rgl", "reflection")
    assert len(writers) > 1
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_is_no_refusal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*at: object, **options: object) -> None:
        raise store.StoreError("the disk is full")

    monkeypatch.setattr(store, "write_text", fail)
    with pytest.raises(store.StoreError, match="full"):
        export(samples.beckmann_bsdf(0.3), tmp_path, "m", "merl", "reflection")


@pytest.fixture(scope="module")
def catalogue(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A brushed surface, two exports of which its lay forbids, and a material beside it."""
    folder = tmp_path_factory.mktemp("refused") / "catalogue"
    for name in ("brushed", "plain"):
        (folder / name).mkdir(parents=True)
    np.save(folder / "brushed" / "scan.npy", _brushed())
    (folder / "brushed" / "material.yaml").write_text(
        "surface: {file: scan.npy, unit: um, pitch: 1, isotropic: false}\nindex: 1.5\n"
        "model: {optics: facets, truth: none}\nexports: [openmaterial, samples, gltf]\n"
    )
    (folder / "plain" / "material.yaml").write_text("surface: {distribution: beckmann, slope_rms: 0.3}\nindex: 1.5\n")
    return folder


def settings(catalogue: Path) -> Path:
    """A configuration without pictures and haze, which take longest of a lay and are not the question here."""
    path = catalogue.parent / "settings.yaml"
    path.write_text("preview: false\nappearance: {haze: []}\n")
    return path


def _brushed() -> np.ndarray:
    return np.random.default_rng(5).normal(size=(96, 1)) @ np.ones((1, 96)) + 0.3 * np.random.default_rng(6).normal(
        size=(96, 96)
    )


@pytest.fixture(scope="module")
def results(catalogue: Path) -> Path:
    out = catalogue.parent / "out"
    summary = build(catalogue, out, cores=2, config=settings(catalogue))
    assert summary.failures == {}
    assert set(summary.built) == {"brushed", "plain"}
    assert list(summary.refused_exports) == ["brushed"]
    assert summary.has_failed()
    return out


def test_a_material_with_refused_exports_is_built_with_its_page_and_other_exports(results: Path) -> None:
    files = {path.name for path in (results / "brushed" / "exports").iterdir()}
    assert {"brushed.samples.csv", "brushed.samples.csv.json"} <= files
    assert not [name for name in files if "gltf" in name or "xompt" in name]
    page = (results / "brushed" / "report.html").read_text(encoding="utf-8")
    assert "export gltf not written" in page
    assert "export openmaterial not written" in page
    row = pd.read_csv(results / "catalogue.csv", index_col="material", keep_default_na=False).loc["brushed"]
    assert row["status"] == "built"
    assert row["refused_exports"].count("not written") == 2
    assert not (results / "failures").exists() or not list((results / "failures").iterdir())


def test_an_unchanged_catalogue_exports_nothing_again_and_says_the_same(catalogue: Path, results: Path) -> None:
    again = build(catalogue, results, cores=2, config=settings(catalogue))
    assert again.jobs == 0
    assert list(again.refused_exports) == ["brushed"]


def test_check_says_beforehand_which_exports_a_lay_forbids(catalogue: Path) -> None:
    answer = CliRunner().invoke(main, ["check", str(catalogue)])
    assert answer.exit_code == 1
    assert "export gltf will not be written" in answer.output
    assert "export samples" not in answer.output
    assert "2 ok, 0 wrong, 2 exports refused" in answer.output


@pytest.mark.slow
def test_an_accepted_refusal_is_no_failure(catalogue: Path, tmp_path: Path) -> None:
    import shutil

    shutil.copytree(catalogue, tmp_path / "catalogue")
    with (tmp_path / "catalogue" / "brushed" / "material.yaml").open("a") as file:
        file.write("accept: [{warning: not written, reason: the other formats do}]\n")
    summary = build(tmp_path / "catalogue", tmp_path / "out", cores=2)
    assert summary.refused_exports == {}
    assert not summary.has_failed()
