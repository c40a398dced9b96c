"""The recipes of CONTRIBUTING.md: what is added by the steps of a recipe is found wherever it belongs.

A copy of the project gets a toy format, reader, representation, quantity, key and stage, and builds one material with all of them.
"""

from __future__ import annotations

import csv
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from brdfpipe.exchange.registry import WRITTEN

PROJECT = Path(__file__).parents[1]
PACKAGE = Path("src", "brdfpipe")

FORMAT = '''
"""Text files with one number."""

from brdfpipe import store
from brdfpipe.bsdf.registry import representation
from brdfpipe.exchange.registry import Format

FORMAT = Format(
    description="the number of wavelengths, as text",
    files={"reflection": {"write": (".toy.txt",)}},
    options={"greeting": "wavelengths:"},
)


def write(bsdf, path, *, greeting):
    store.write_text(path, f"{greeting} {representation(bsdf).total_reflectance()[0].size}")
'''

SPECTRUM_READER = '''
"""Spectra that are the same number at all wavelengths."""

import numpy as np

from brdfpipe.spectra.formats.base import FRACTION, Sample, SpectrumFormat


def _read(path):
    wavelength = np.arange(380.0, 781, 10)
    return [Sample("toy", wavelength, np.full(wavelength.size, float(path.read_text())), (FRACTION,))], []


FORMAT = SpectrumFormat("toy", (".toy",), "one number", _read)
'''

SURFACE_READER = '''
"""Heights drawn at random from a seed."""

import numpy as np

from brdfpipe.surfaces.heights import Heights, SurfaceFormat


def _read(path, *, unit="um"):
    return Heights(np.random.default_rng(int(path.read_text())).normal(0, 0.1, (64, 64)), 0.5, 0.5)


FORMATS = (SurfaceFormat("toy", (".seed",), "a seed", _read, ("unit",)),)
'''

REPRESENTATION = '''
"""A surface that is equally bright in all directions."""

import numpy as np

from brdfpipe import vocabulary
from brdfpipe.bsdf.base import Representation


class Toy(Representation):
    name = "toy"
    kind = vocabulary.Kind({"lambert": vocabulary.SCALAR})

    def evaluate(self, theta_i, phi_i, theta_o, phi_o, wavelength):
        reflected = (theta_i < 90) & (theta_o < 90)
        return np.where(reflected, float(self.dataset["lambert"]) / np.pi, 0.0)[..., None]

    def nonspectral(self, weight):
        return self.dataset
'''

QUANTITY = """

register(
    AppearanceQuantity(
        "toy_sparkle", "Toy sparkle", "S", "1", 2, "sparkle of the toy", "Toy standard 1", compute=lambda bsdf: 12.345
    )
)
"""

KEY = '    toy_level: float = key("reflectance of the toy", default=0.25, ge=0, le=1)\n'

STAGE = '    Stage("toy", "a toy that is equally bright", keys=_keys("toy_level"), kind="bsdf"),\n'

RULE = """

use rule stage_template as toy with:
    input:
        **results_of("bsdf"),
    output:
        toy="{material}/toy.nc",
"""

SCRIPT = '''
import xarray as xr

from brdfpipe import store, vocabulary


def main(input, output, params):
    """A toy that is equally bright in all directions."""
    bsdf = store.open_dataset(input["bsdf"], "bsdf")
    toy = xr.Dataset({"lambert": params["spec"]["toy_level"]}, attrs={"representation": "toy"})
    store.save_dataset(
        vocabulary.label(toy, "bsdf"),
        output["toy"],
        stage="toy",
        material=params["material"],
        inputs={"bsdf": bsdf},
        parameters=params["spec"],
    )
'''

NEW_FILES = {
    PACKAGE / "exchange" / "toy_text.py": FORMAT,
    PACKAGE / "spectra" / "formats" / "toy.py": SPECTRUM_READER,
    PACKAGE / "surfaces" / "toy.py": SURFACE_READER,
    PACKAGE / "bsdf" / "representations" / "toy.py": REPRESENTATION,
    Path("workflow", "scripts", "toy.py"): SCRIPT,
}

EDITS = {
    PACKAGE / "spectra" / "formats" / "registry.py": [
        ("from brdfpipe.spectra.formats import cgats, ", "from brdfpipe.spectra.formats import toy, cgats, "),
        ("for module in (text, ", "for module in (toy, text, "),
    ],
    PACKAGE / "surfaces" / "reading.py": [
        ("from brdfpipe.surfaces import ", "from brdfpipe.surfaces import toy, "),
        ("for module in (text, ", "for module in (toy, text, "),
    ],
    PACKAGE / "bsdf" / "registry.py": [
        ("from brdfpipe.errors ", "from brdfpipe.bsdf.representations.toy import Toy\nfrom brdfpipe.errors "),
        (", Traced, Wave)", ", Toy, Traced, Wave)"),
    ],
    PACKAGE / "catalogue" / "material_keys.py": [("    slab: Slab = key(\n", f"{KEY}    slab: Slab = key(\n")],
    PACKAGE / "stages.py": [
        ("    *(export.stage for export in EXPORTS),\n", f"{STAGE}    *(export.stage for export in EXPORTS),\n")
    ],
}
"""The lines that name a new module, and the entries of a key and a stage."""

ADDITIONS = {
    PACKAGE / "appearance" / "quantities.py": QUANTITY,
    Path("workflow", "rules", "outputs.smk"): RULE,
}

MATERIAL = """\
surface: {file: heights.seed, unit: um, form: none}
index: 1.5
spectrum: {file: reflectance.toy, geometry: sci}
toy_level: 0.5
model: {masking: height-correlated, optics: facets, truth: none}
exports: [toy-text]
"""

UNKNOWN = {
    "a-spectrum": "spectrum: {file: a.unknown, geometry: sci}\n",
    "b-surface": "surface: {file: a.unknown}\nindex: 1.5\n",
}

CONFIGURATION = """\
preview: false
gloss_angles: [60]
appearance: {haze: []}
table: {theta_i: [0, 45], theta_o: [0, 30, 45, 60], phi_o: [0, 90, 180], refine: false}
lambert_gauss: {theta_i: [0, 45]}
"""

DOCUMENT = """
import runpy
runpy.run_module("brdfpipe.catalogue.generated_files", run_name="__main__")
runpy.run_path("benchmarks/stages.py", run_name="__main__")
"""
"""Writes the generated files and docs/stages.md."""

EVALUATE = """
import json, sys
import brdfpipe
toy = brdfpipe.open_dataset(sys.argv[1])
sample = toy.bsdf.sample(n=100, seed=1, theta_i=45)
print(json.dumps({
    "value": float(toy.bsdf.evaluate(30, 0, 40, 90)),
    "albedo": float(toy.bsdf.albedo(60)),
    "weights": sample["weight"].values.ravel().tolist(),
    "verdicts": toy.bsdf.check().attrs["verdicts"],
    "table": float(toy.bsdf.tabulate({"theta_i": [0, 45], "theta_o": [0, 60], "phi_o": [0, 180, 360]})["brdf"].max()),
}))
"""


@pytest.fixture(scope="module")
def extended(made_once: Callable[[str, Callable[[Path], None]], Path]) -> Path:
    """A copy of the project with all toys, its generated files, and one material built with it."""
    return made_once("extended", extend)


def extend(folder: Path) -> None:
    for part in ("src", "workflow", "config", "docs", "benchmarks"):
        # Compiled code is copied too, but not the files that another process writes it to before it renames them.
        shutil.copytree(PROJECT / part, folder / part, ignore=shutil.ignore_patterns("results", "*.pyc.*", "*.tmp.*"))
    shutil.copy(PROJECT / "Snakefile", folder)
    for path, text in NEW_FILES.items():
        assert not (folder / path).exists()
        (folder / path).write_text(text)
    for path, replacements in EDITS.items():
        text = (folder / path).read_text()
        for old, new in replacements:
            assert text.count(old) == 1, (path, old)
            text = text.replace(old, new)
        (folder / path).write_text(text)
    for path, text in ADDITIONS.items():
        (folder / path).write_text((folder / path).read_text() + text)
    material = folder / "catalogue" / "m"
    material.mkdir(parents=True)
    (material / "material.yaml").write_text(MATERIAL)
    (material / "heights.seed").write_text("1")
    (material / "reflectance.toy").write_text("0.25")
    (folder / "own.yaml").write_text(CONFIGURATION)
    run(folder, "-c", DOCUMENT)
    run(folder, "-m", "brdfpipe.cli", "build", "catalogue", "--config", "own.yaml", "--cores", "2")


def run(folder: Path, *arguments: str, code: int = 0) -> str:
    """What a Python program prints that uses the package of the copy and exits with a code."""
    environment = {**os.environ, "PYTHONPATH": str(folder / "src"), "PYTHONIOENCODING": "utf-8"}
    command = [sys.executable, *arguments]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, encoding="utf-8", check=False)
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout


def schema(folder: Path) -> dict[str, dict[str, object]]:
    """Definitions of the editor schema of material.yaml, and its keys as ``Material``."""
    content = json.loads((folder / "config" / "schemas" / "material.schema.json").read_text())
    return {**content["$defs"], "Material": content}


def test_a_format_is_one_module(extended: Path) -> None:
    assert (extended / "results" / "m" / "exports" / "m.toy.txt").read_text() == "wavelengths: 41"
    listed = schema(extended)["Material"]["properties"]["exports"]["items"]["enum"]
    assert listed == sorted([*WRITTEN, "toy-text"])
    stages = (extended / "docs" / "stages.md").read_text()
    row = "| `toy-text` | the number of wavelengths, as text | `<material>.toy.txt` | reflection | no | bsdf | `greeting`: wavelengths: |"
    assert row in stages
    assert "| `export_toy_text` |" in stages
    assert "toy-text: the number of wavelengths, as text" in (extended / "docs" / "materials.md").read_text()


def test_a_reader_is_one_module_and_its_name_in_the_registry(extended: Path, tmp_path: Path) -> None:
    from brdfpipe import store

    spectrum, surface = (
        store.open_dataset(extended / "results" / "m" / f"{name}.nc") for name in ("spectrum", "surface")
    )
    assert (spectrum["total_reflectance"] == 0.25).all()
    assert np.array_equal(surface["height"], np.random.default_rng(1).normal(0, 0.1, (64, 64)))
    for block in ("MeasuredSpectrum", "MeasuredSurface"):
        assert "toy" in schema(extended)[block]["properties"]["format"]["enum"]
    materials = (extended / "docs" / "materials.md").read_text()
    assert "| `toy` | `.toy` | one number |" in materials
    assert "| `toy` | `.seed` | a seed |" in materials
    for name, text in UNKNOWN.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "material.yaml").write_text(text)
        (tmp_path / name / "a.unknown").write_text("1")
    spectra, surfaces, _ = run(extended, "-m", "brdfpipe.cli", "check", str(tmp_path), code=1).splitlines()
    assert ".toy" in spectra.partition("unknown file extension; found .unknown; accepted: ")[2]
    assert ".seed" in surfaces.partition("unknown file extension; found .unknown; accepted: ")[2]


def test_a_representation_is_one_class_and_its_name_in_the_registry(extended: Path) -> None:
    evaluated = json.loads(run(extended, "-c", EVALUATE, "results/m/toy.nc"))
    assert evaluated["value"] == pytest.approx(0.5 / np.pi, rel=1e-12)
    assert evaluated["albedo"] == pytest.approx(0.5, rel=1e-6)
    assert np.mean(evaluated["weights"]) == pytest.approx(0.5, rel=0.05)
    assert evaluated["table"] == pytest.approx(0.5 / np.pi, rel=1e-12)
    assert {check["verdict"] for check in json.loads(evaluated["verdicts"]).values()} == {"pass"}


def test_an_appearance_quantity_is_one_entry_of_its_table(extended: Path) -> None:
    with (extended / "results" / "catalogue.csv").open(newline="") as table:
        (row,) = csv.DictReader(table)
    assert float(row["toy_sparkle"]) == 12.345
    assert "Toy sparkle" in (extended / "results" / "index.html").read_text()
    assert "<dt>Toy sparkle</dt>" in (extended / "results" / "m" / "report.html").read_text()
    assert "| `toy_sparkle` | Toy sparkle | S | 1 | 2 |" in (extended / "docs" / "quantities.md").read_text()


def test_a_key_is_one_declaration(extended: Path) -> None:
    declared = schema(extended)["Material"]["properties"]["toy_level"]
    assert declared == {
        "type": "number",
        "minimum": 0,
        "maximum": 1,
        "default": 0.25,
        "description": "reflectance of the toy",
    }
    row = "| `toy_level` | a number from 0 to 1 | `0.25` | Reflectance of the toy. |"
    assert row in (extended / "docs" / "materials.md").read_text()


def test_a_stage_is_an_entry_a_rule_and_a_script(extended: Path) -> None:
    from brdfpipe import store

    results = extended / "results"
    attrs = store.open_dataset(results / "m" / "toy.nc").attrs
    assert (attrs["stage"], attrs["material"], attrs["parameters"]) == ("toy", "m", '{"toy_level":0.5}')
    assert attrs["digest"] == json.loads((results / "catalogue.lock.json").read_text())["m"]["toy"]
    assert attrs["digest"][:8] in (results / "m" / "report.html").read_text()
    assert (results / "logs" / "m" / "toy.log").read_text().startswith("toy of m\n")
    row = "| `toy` | a toy that is equally bright | `bsdf` | any | `toy_level` |  | bsdf |"
    assert row in (extended / "docs" / "stages.md").read_text()
