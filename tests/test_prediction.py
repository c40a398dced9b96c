"""``brdfpipe.predict`` gives the numbers of a build, and refuses in the user's words."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import samples
import xarray as xr
from built_examples import EXAMPLES, PROJECT, build_examples

import brdfpipe
from brdfpipe import store
from brdfpipe.catalogue import material_keys
from brdfpipe.descriptions import reading
from brdfpipe.errors import InputError
from brdfpipe.prediction import RAW, READS, _Datasets, predict


def arguments(folder: Path) -> dict[str, object]:
    """The keys of a material as arguments, its files by their paths."""
    content = reading.read(folder / "material.yaml", material_keys.Material)
    keys = {name: content[name] for name in ("surface", "index", "spectrum", "multiangle", "model") if name in content}
    for value in keys.values():
        if isinstance(value, dict) and "file" in value:
            value["file"] = folder / str(value["file"])
    return keys


@pytest.mark.cases(2)
@pytest.mark.parametrize("name", EXAMPLES)
def test_the_numbers_are_those_of_a_build(made_once, name: str) -> None:  # type: ignore[no-untyped-def]
    base = made_once("workflow", build_examples)
    built = store.open_dataset(base / "results" / name / "bsdf.nc")
    called = predict(**arguments(base / "catalogue" / name))  # type: ignore[arg-type]
    xr.testing.assert_identical(called.drop_attrs(), built.drop_attrs())
    provenance = {"digest", "inputs", "material", "parameters"}
    assert {key: called.attrs[key] for key in called.attrs.keys() - provenance} == {
        key: built.attrs[key] for key in built.attrs.keys() - provenance
    }


def test_every_stage_reads_what_its_rule_reads() -> None:
    rules = {path.stem: path.read_text(encoding="utf-8") for path in (PROJECT / "workflow" / "rules").glob("*.smk")}
    before = [text for name, text in rules.items() if name in ("predicted", "flake", "imported")]
    stages = re.findall(r"use rule stage_template as (\w+) with:", "".join(before))
    assert {*stages, "bsdf"} == set(READS)
    text = "".join(rules.values())
    for stage, read in READS.items():
        rule = text.split(f"use rule stage_template as {stage} with:")[1].split("output:")[0]
        named = re.search(r"results_of\((.*?)\)", rule, re.DOTALL)
        words = re.findall(r'(?:(\w+)=)?"([\w-]+)"', named[1]) if named else []
        expected = {f"{name}={source}" if name else source for name, source in words}
        assert set(read) == expected - ({"measured"} if stage == "bsdf" else set()), stage
        raw = dict(re.findall(r'(\w+)=raw_file\("([^"]+)"\)', rule))
        assert RAW.get(stage, {}) == raw, stage


def test_a_dataset_stands_for_its_file(tmp_path: Path) -> None:
    surface = samples.gaussian_surface(64)
    spectrum = samples.spectrum(0.4)
    bsdf = predict(surface, 1.5, spectrum, uncertainty=False, model={"truth": "none", "masking": "height-correlated"})
    assert bsdf.attrs["route"] == "predicted"
    assert bsdf.bsdf.albedo(8.0, wavelength=550).item() == pytest.approx(0.4, abs=1e-6)


def test_keys_that_later_stages_read_are_accepted_beside_a_dataset(tmp_path: Path) -> None:
    surface = samples.surface(np.zeros((4, 4)))
    given = {"file": surface, "isotropic": False, "noise": 0.001, "scans": [{"file": surface}]}
    written = _Datasets(tmp_path).stored(given, "surface")
    assert written == {**given, "file": written["file"], "scans": [{"file": written["scans"][0]["file"]}]}
    assert Path(written["file"]).is_file()
    given["scans"] = [{"file": surface, "azimuth": 90}]
    with pytest.raises(InputError, match=r"surface\.scans: .*found azimuth; accepted: the dataset alone"):
        _Datasets(tmp_path).stored(given, "surface")


def test_a_finish_and_a_colour_need_no_file() -> None:
    bsdf = predict(
        {"distribution": "ggx", "a": 0.2},
        "ABS",
        {"lab": [50, 10, 10], "illuminant": "D65", "observer": 10, "geometry": "sci"},
    )
    assert set(bsdf.bsdf.uncertainty_sources) <= {"index", "facets", "spectrum"}
    assert 0.1 < bsdf.bsdf.albedo(8.0, wavelength=550).item() < 0.3


def test_a_spectrum_alone_is_a_perfect_diffuser() -> None:
    bsdf = brdfpipe.predict(spectrum=samples.spectrum(0.3), uncertainty=False)
    np.testing.assert_allclose(bsdf.bsdf.evaluate(30, 0, [0, 60], 90, wavelength=550), 0.3 / np.pi, rtol=1e-9)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"surface": "grain.xyz3", "index": 1.5}, "predict, surface: no such file; found 'grain.xyz3'"),
        ({"surface": {"distribution": "ggx", "a": 0.2}}, "index"),
        (
            {"surface": {"distribution": "ggx", "a": 0.2}, "index": 0.5},
            "predict, index: .*found 0.5; accepted: a number from 1 to 5",
        ),
        ({"surfaces": "grain.x3p"}, "unknown key 'surfaces'"),
        ({"spectrum": samples.surface(np.zeros((4, 4)))}, "spectrum: .*kind 'surface'; accepted: kind 'spectrum'"),
        (
            {"surface": {"file": samples.surface(np.zeros((4, 4))), "lambda_s": 20}},
            "surface: .*used as it is.*found lambda_s",
        ),
        (
            {"spectrum": {"sci": {"file": samples.spectrum(0.3)}, "sce": {"file": samples.spectrum(0.2)}}},
            "spectrum.sci: no dataset is accepted here; found a dataset; accepted: the path of a file",
        ),
        ({"coat": {"base": {"surface": samples.surface(np.zeros((4, 4)))}}}, "coat.base.surface: .*the path of a file"),
        ({"slab": {"back": {"file": samples.surface(np.zeros((4, 4)))}}}, "slab.back: .*the path of a file"),
        ({"rig": {}}, "brdfpipe build"),
        ({}, "surface"),
    ],
)
def test_a_mistake_is_refused_in_words(
    given: dict[str, object], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=words):
        predict(**given)  # type: ignore[arg-type]


def test_a_file_that_lacks_its_unit_names_the_argument(tmp_path: Path) -> None:
    np.savetxt(tmp_path / "map.txt", samples.gaussian_surface(16)["height"])
    with pytest.raises(InputError, match=r"give `surface=\{…, '(unit|pitch)': …\}` to `predict`"):
        predict(tmp_path / "map.txt", 1.5)
