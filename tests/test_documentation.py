"""Every Python example of the documentation runs as it stands."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import xarray as xr

from brdfpipe import flakes, spectra, store
from brdfpipe.bsdf import flake, lambert_gauss
from brdfpipe.spectra import colorimetry

PROJECT = Path(__file__).parents[1]


def examples(document: str) -> list[str]:
    text = (PROJECT / document).read_text(encoding="utf-8")
    return re.findall(r"^```python\n(.*?)^```$", text, flags=re.MULTILINE | re.DOTALL)


def run(document: str, names: dict[str, object]) -> list[str]:
    codes = examples(document)
    for code in codes:
        exec(compile(code, document, "exec"), names)
    return codes


def diffuser() -> xr.Dataset:
    return lambert_gauss.lambertian(spectra.recover([48, 34, 22], illuminant="D65", observer=10))


def paint(darker: float) -> xr.Dataset:
    labs = {"45as15": [33.9 - darker, -7.6, -36.6], "45as45": [12.3, 1.2, -25.8], "45as110": [3.1, 2.1, -13.2]}
    listed = [{"geometry": name, "lab": lab} for name, lab in labs.items()]
    return flake.build(flakes.ingest({"colours": listed, "illuminant": "D65", "observer": 10}))


def test_the_examples_of_the_readme_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    place = tmp_path / "results" / "abs-grain" / "bsdf.nc"
    place.parent.mkdir(parents=True)
    store.save_dataset(diffuser(), place, stage="bsdf", material="abs-grain", inputs={}, parameters={})
    (tmp_path / "examples").symlink_to(PROJECT / "examples")
    monkeypatch.chdir(tmp_path)
    codes = run("README.md", {})
    for name in ("gloss", "gloss_with_uncertainty", "reflectance_haze", "flop_index", "recover", "read_spectrum"):
        assert any(f".{name}(" in code for code in codes), name


def test_the_examples_of_a_paint_run() -> None:
    assert run("docs/materials.md", {"bsdf": paint(0.0), "other": paint(2.0)})


def test_the_documentation_lists_the_illuminants_that_are_known() -> None:
    text = (PROJECT / "docs/materials.md").read_text(encoding="utf-8")
    listed = text.split("## Illuminants")[1].split("in Python: ")[1].split(", in any case")[0].split(", ")
    assert sorted(listed) == sorted(colorimetry.illuminants())
