"""Code digests: a stage's changes with its own code, and only with it."""

from __future__ import annotations

import json
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import samples
import small_rig

from brdfpipe import catalogue, exchange, installation, store
from brdfpipe.jobs import code
from brdfpipe.stages import STAGES, Stage

Files = dict[str, Any]
"""Name → path or paths."""


class Step(NamedTuple):
    """One run of a stage's script."""

    stage: str
    inputs: Files
    outputs: Files
    params: dict[str, Any]


SCRIPTS = Path(__file__).parents[2] / "workflow" / "scripts"


def script(stage: Stage) -> Path:
    return SCRIPTS / f"{stage.script}.py"


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A package of the same name, small enough to reason about."""
    package = tmp_path / "brdfpipe"
    (package / "optics").mkdir(parents=True)
    (package / "optics" / "tables").mkdir()
    (package / "__init__.py").write_text("def __getattr__(name):\n    return name\n")
    (package / "store.py").write_text('"""Stores."""\nimport numpy\n\ndef save():\n    return 1\n')
    (package / "facets.py").write_text("def estimate():\n    from brdfpipe.optics import fresnel\n    return fresnel\n")
    (package / "optics" / "__init__.py").write_text("from .fresnel import f\n")
    (package / "optics" / "fresnel.py").write_text("from brdfpipe import store\nf = 1\n")
    (package / "optics" / "tables" / "n.csv").write_text("1,2\n")
    (package / "other.py").write_text("import PIL\nx = 1\n")
    (package / "jobs.py").write_text("x = 1\n")
    (tmp_path / "stage.py").write_text(
        "from typing import TYPE_CHECKING\n\nfrom brdfpipe import facets\n\nif TYPE_CHECKING:\n    from brdfpipe import other\n\n"
        "def main():\n    import brdfpipe.jobs.x\n"
    )
    return tmp_path


def digest(root: Path, also: tuple[str, ...] = ()) -> str:
    code._parsed.clear()
    code._bytes_digest.cache_clear()
    return code.digest(root / "stage.py", root, also)


def test_imports_are_followed_into_functions_and_packages(root: Path) -> None:
    assert code.modules(root / "stage.py", root) == (
        "brdfpipe",
        "brdfpipe.facets",
        "brdfpipe.optics",
        "brdfpipe.optics.fresnel",
        "brdfpipe.store",
    )


@pytest.mark.parametrize(
    ("file", "text"),
    [
        ("stage.py", "from brdfpipe import facets\n\ndef main():\n    return 2\n"),
        ("brdfpipe/facets.py", "def estimate():\n    from brdfpipe.optics import fresnel\n    return 2\n"),
        ("brdfpipe/store.py", "def save():\n    return 2\n"),
        ("brdfpipe/optics/fresnel.py", "f = 2\n"),
        ("brdfpipe/optics/tables/n.csv", "1,3\n"),
    ],
)
def test_the_digest_changes_with_what_the_stage_uses(root: Path, file: str, text: str) -> None:
    before = digest(root)
    (root / file).write_text(text)
    assert digest(root) != before


@pytest.mark.parametrize(
    ("file", "text"),
    [
        ("brdfpipe/other.py", "x = 2\n"),
        ("brdfpipe/jobs.py", "x = 2\n"),
        ("brdfpipe/store.py", '"""Keeps."""\n\nimport numpy\n\n\ndef save():\n    # why\n    return 1\n'),
        ("brdfpipe/new.py", "x = 2\n"),
    ],
)
def test_the_digest_ignores_what_the_stage_does_not_use(root: Path, file: str, text: str) -> None:
    before = digest(root)
    (root / file).write_text(text)
    assert digest(root) == before


def test_modules_that_are_imported_by_a_run_time_name_count_where_the_stage_declares_them(root: Path) -> None:
    before = digest(root), digest(root, ("brdfpipe.other",))
    (root / "brdfpipe" / "other.py").write_text("x = 2\n")
    after = digest(root), digest(root, ("brdfpipe.other",))
    assert (before[0] == after[0], before[1] == after[1]) == (True, False)


def test_the_libraries_of_a_stage_are_those_that_its_modules_import_with_what_these_compute_with(root: Path) -> None:
    script = root / "stage.py"
    assert code.libraries(script, root) == ("numpy",)
    assert code.libraries(script, root, ("brdfpipe.other",)) == ("numpy", "pillow")
    (root / "brdfpipe" / "facets.py").write_text("def estimate():\n    import xarray.core\n    from . import store\n")
    assert code.libraries(script, root) == ("netCDF4", "numpy", "pandas", "xarray")


def test_the_digest_changes_with_the_version_of_a_library_that_the_stage_uses_and_of_no_other(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = digest(root)
    versions = {"numpy": "0"}
    monkeypatch.setattr(code, "version", lambda library: versions.get(library, version(library)))
    assert digest(root) != before
    versions = {"pillow": "0"}
    assert digest(root) == before


def test_a_library_that_is_not_installed_counts_as_absent(root: Path) -> None:
    (root / "brdfpipe" / "store.py").write_text("def save():\n    import no_such_library\n")
    absent = digest(root)
    (root / "brdfpipe" / "store.py").write_text("def save():\n    import numpy\n")
    assert len(absent) == 32
    assert digest(root) != absent


def test_the_reader_of_instruments_files_counts_with_its_library(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from brdfpipe.surfaces import instruments

    assert {instruments.__name__: instruments.LIBRARY} == code.OPTIONAL
    assert instruments.LIBRARY in code.libraries(script(STAGES["surface"]), code.SOURCE)
    before = digest(root)
    monkeypatch.setattr(code, "OPTIONAL", {"brdfpipe.optics.fresnel": "scipy"})
    assert digest(root) != before
    monkeypatch.setattr(code, "OPTIONAL", {"brdfpipe.other": "scipy"})
    assert digest(root) == before


def test_unchanged_modules_are_parsed_once_for_all_builds(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = root / "parsed.json"
    with code.remember_parsed(file):
        before = digest(root)
    with monkeypatch.context() as patched, code.remember_parsed(file):
        patched.delattr(code.ast, "parse")
        assert digest(root) == before
    (root / "brdfpipe" / "store.py").write_text("def save():\n    return 2\n")
    with code.remember_parsed(file):
        after = digest(root)
    assert after != before
    without_import = file.read_text().replace("store", "other")
    assert without_import != file.read_text()
    for damaged in ("", "{}", '["key"]', without_import):
        file.write_text(damaged)
        with code.remember_parsed(file):
            assert digest(root) == after


@pytest.mark.parametrize("stage", STAGES.values(), ids=list(STAGES))
def test_every_library_that_a_stage_may_use_is_known_by_its_distribution(stage: Stage) -> None:
    optional = {"SurfaceTopography", "openpyxl", "alpyca"}
    for library in code.libraries(script(stage), code.SOURCE, stage.modules):
        assert library in optional or version(library)


def test_a_page_template_engine_reruns_reports_alone() -> None:
    users = {
        stage.name for stage in STAGES.values() if "jinja2" in code.libraries(script(stage), code.SOURCE, stage.modules)
    }
    assert users == {"report", "summary", "catalogue"}


def test_the_digests_of_all_stages_ask_once_for_each_library_and_the_next_build_asks_again(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    alone, asked = digest(root), list[str]()
    monkeypatch.setattr(code, "version", lambda library: asked.append(library) or version(library))
    for _ in range(2):
        with code.remember_parsed(root / "parsed.json"):
            assert digest(root) == digest(root) == alone
    assert asked == ["numpy", "numpy"]


@pytest.mark.parametrize("stage", STAGES.values(), ids=list(STAGES))
def test_every_stage_has_a_digest_of_its_own(stage: Stage) -> None:
    assert len(code.digest(script(stage), extra_modules=stage.modules)) == 32


RUN_STAGES = """
import json, os, runpy, sys
import astropy.io.fits, jinja2, netCDF4, numba, numpy, pandas, PIL, pydantic, scipy.interpolate, scipy.optimize, scipy.special, scipy.stats
import serial, xarray, yaml
with numpy.printoptions():
    import colour

for step, (script, *arguments) in enumerate(json.load(sys.stdin)):
    child = os.fork()
    if child:
        assert os.waitpid(child, 0)[1] == 0, script
        continue
    runpy.run_path(script)["main"](*arguments)
    with open(f"{step}.loaded", "w") as file:
        json.dump([name for name in sys.modules if name.split(".")[0] == "brdfpipe"], file)
    os._exit(0)
"""
"""Runs each stage in a process that has loaded libraries but no module of the package, and lists the modules that it loads."""

RIG_PLAN = small_rig.PLAN.replace("incidences: [20]", "incidences: [20, 45]\nruns: [etalon, sample]")


def loaded_modules(steps: list[Step], folder: Path) -> list[set[str]]:
    """Run the scripts one after the other; the modules of the package that each loads and that can change its results."""
    commands = [(str(script(STAGES[step.stage])), step.inputs, step.outputs, step.params) for step in steps]
    command = [sys.executable, "-c", RUN_STAGES]
    subprocess.run(command, cwd=folder, input=json.dumps(commands), text=True, check=True)
    loaded = [json.loads((folder / f"{number}.loaded").read_text()) for number in range(len(steps))]
    return [{name for name in names if not f"{name}.".startswith(code.MODULES_WITHOUT_EFFECT)} for names in loaded]


def check_modules(steps: list[Step], folder: Path) -> None:
    """Every module that a script loads is in the digest of its stage."""
    for step, loaded in zip(steps, loaded_modules(steps, folder), strict=True):
        assert len(loaded) > 3
        stage = STAGES[step.stage]
        assert loaded <= set(code.modules(script(stage), extra_modules=stage.modules)), step.stage


def test_the_digests_of_the_stages_of_a_colour_cover_every_module_that_their_runs_load(tmp_path: Path) -> None:
    """The representative of the next test."""
    specs: dict[str, dict[str, Any]] = {
        "index": {"index": 1.5},
        "facets": {"distribution": "ggx", "a": 0.3},
        "spectrum": {"lab": [50, 0, 0], "illuminant": "D65", "observer": 10, "geometry": "sci"},
        "predicted": {"multiple_scattering": "none"},
        "bsdf": {"route": "predicted"},
        "checks": {},
    }
    inputs = {
        "spectrum": ["index"],
        "predicted": ["facets", "index", "spectrum"],
        "bsdf": ["predicted"],
        "checks": ["bsdf"],
    }
    steps = [
        Step(stage, {name: name for name in inputs.get(stage, [])}, {stage: stage}, {"material": "paint", "spec": spec})
        for stage, spec in specs.items()
    ]
    check_modules(steps, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("solution", ["kirchhoff", "traced"])
def test_the_digest_of_a_stage_covers_every_module_that_its_run_loads(tmp_path: Path, solution: str) -> None:
    """Every script, from raw files to the catalogue; the rig of 26 small frames is emulated."""
    example = installation.project_folder() / "examples" / "abs-grain"
    examples = catalogue.load(example.parent)
    certificate = example.parent / "calibrations" / "bench-1" / "certificate.yaml"
    plan = small_rig.write(tmp_path / "bench", RIG_PLAN)
    steps: list[Step] = []

    def run(stage: str, inputs: Files, outputs: Files, spec: dict[str, Any] | None = None, of: str = "abs-grain"):
        spec = examples.spec(of, stage) if spec is None else spec
        steps.append(Step(stage, inputs, outputs, {"material": of, "spec": spec}))

    def same(*names: str) -> Files:
        return {name: name for name in names}

    raw = {"raw": str(example / "grain.x3p")}
    (tmp_path / "reflectance.txt").write_text("nm %\n" + "".join(f"{nm} 5\n" for nm in range(380, 781, 20)))
    run("surface", raw, same("surface"))
    run("back_surface", raw, {"surface": "back_surface"}, examples.spec("abs-grain", "surface"))
    run("index", {}, same("index"))
    run("interior", {}, same("interior"), {"thickness": 2.0, "internal_transmittance": 0.95})
    run("facets", same("surface"), same("facets"))
    run("spectrum", {"raw": "reflectance.txt", **same("index")}, same("spectrum"))
    by_gloss = {"gloss": {"20": 44.0, "60": 79.0}, "slopes": "beckmann"}
    run("gloss_facets", same("index", "spectrum"), {"facets": "gloss_facets"}, by_gloss)
    traced = {"multiple_scattering": "measured"}
    run("interreflection", same("surface", "facets", "index", "spectrum"), same("interreflection"), traced)
    run("predicted", same("facets", "index", "spectrum"), same("predicted"))
    # The module of further reflections is loaded without them too; the stages that read a BSDF then take half the time.
    run("predicted", same("facets", "index", "spectrum"), {"predicted": "plain"}, {"multiple_scattering": "none"})
    run("psd", same("surface"), {"psd": "measured_psd"})
    run("psd", {}, same("psd"), {"distribution": "beckmann", "slope_rms": 0.1, "length": 5.0})
    waves = {"optics": "auto", "diffuse": "coupled", "halo": "ssa1"}
    run("wave", {"predicted": "plain", **same("psd", "facets", "index", "spectrum")}, same("wave"), waves)
    run("visibility", same("surface", "facets"), same("visibility"))
    run("facets", {}, {"facets": "flat_facets"}, {"distribution": "flat"})
    faces = {"facets": "flat_facets", **same("psd", "interior", "index")}
    run("sheet", faces, same("sheet"), {"masking": "height-correlated", "optics": "auto"})
    run("sheet_uncertainty", faces | same("sheet"), same("sheet_uncertainty"))
    run("base_surface", raw, {"surface": "base_surface"}, examples.spec("abs-grain", "surface"))
    run("base_facets", {}, {"facets": "base_facets"}, {"distribution": "flat"})
    run("base_index", {}, {"index": "base_index"}, {"index": 1.8})
    body = {**same("interior", "index", "spectrum", "base_facets", "base_index"), "facets": "flat_facets"}
    run("coated", body, same("coated"), {"masking": "height-correlated"})
    run("coated_uncertainty", body | same("coated"), same("coated_uncertainty"), {})
    run("model_error", same("surface", "facets", "predicted"), same("model_error"))
    if solution == "kirchhoff":
        height = samples.gaussian_surface(64, correlation=10)["height"].values
        np.save(tmp_path / "smooth.npy", height / height.std() * 0.05)
        run("surface", {"raw": "smooth.npy"}, {"surface": "smooth"}, {"file": "smooth.npy", "unit": "um", "pitch": 0.5})
    relief = {"kirchhoff": "smooth", "traced": "surface"}[solution]
    run("reference", {"surface": relief, **same("index", "spectrum")}, same("reference"), {"diffuse": "coupled"})
    run("uncertainty", same("predicted", "facets", "psd", "index", "spectrum", "model_error"), same("uncertainty"))
    exchange.write(samples.beckmann_bsdf(0.3), tmp_path / "grain.zemax.bsdf", tolerance=0.1, albedo_tolerance=0.1)
    run("imported", {"raw": "grain.zemax.bsdf"}, same("imported"), {})
    run("multiangle", {}, same("multiangle"), of="metallic-blue")
    run("flake", same("multiangle"), same("flake"), of="metallic-blue")
    run("flake_uncertainty", same("multiangle", "flake"), same("flake_uncertainty"), of="metallic-blue")
    journal = {"journal": "run/journal.jsonl"}
    run("rig_run", {"sources": [str(plan)], "truth": "predicted"}, journal, {"emulate": {"seed": 1}})
    arrangements = [("etalon", 10.0), ("sample", 20.0), ("sample", 45.0)]
    files = [f"reduced-{load}-{incidence:g}" for load, incidence in arrangements]
    for (load, incidence), file in zip(arrangements, files, strict=True):
        run("reduced", journal, {"reduced": file}, {"load": load, "incidence": incidence})
    run("calibration", {"reduced": files[:1], "certificate": str(certificate)}, same("calibration"), {})
    run("primary", {"reduced": files[1:], **same("calibration")}, same("primary"), {})
    run("smoothed", same("primary"), same("smoothed"), {"smoothing": {}})
    run("measured", {"smoothed": ["smoothed"]}, same("measured"), {})
    run("comparison", {"predicted": "plain", **same("primary", "facets", "index", "spectrum")}, same("comparison"))
    run("bsdf", {"predicted": "plain", **same("uncertainty")}, same("bsdf"))
    scene = {"scene": "gloss-sheet", "metric": "gloss", "unit": "GU", "tolerance": 1.0, "errors_of": ""}
    run("plan", same("facets", "psd", "index", "spectrum"), same("plan"), scene)
    run("planned", same("facets", "psd", "index", "spectrum", "plan"), {"bsdf": "planned"}, {})
    run("checks", same("bsdf"), same("checks"))
    run("appearance", same("bsdf"), same("appearance"))
    read = {
        "measured": {"gloss": {"20": 1.0, "60": 5.0}},
        "doubtful": {"index_u": 0.02, "slope_u": 0.1, "diffuse_u": 0.05},
    }
    run("readings", same("bsdf", "predicted", "facets", "index", "spectrum"), same("readings", "csv"), read)
    run("preview", same("bsdf"), same("preview", "png"))
    run("table", same("bsdf"), same("table"))
    run("lambert_gauss", same("bsdf"), same("lambert_gauss", "csv"))
    of_map = {"pixel": 4.0, "size": 32}
    run("texture", same("surface", "facets"), same("texture"), of_map)
    run("unresolved", {**same("texture", "index", "spectrum"), "bsdf": "plain"}, same("unresolved"), {"formats": []})
    paint = example.parent / "sparkling-texture"
    pictures = {"pictures": [str(paint / f"{name}.png") for name in ("45as15", "45as45", "diffuse")]}
    pictures |= {"bsdf": "plain"}
    run("picture_texture", pictures, {"texture": "picture_texture"}, of="sparkling-texture")
    seen = {**same("texture", "unresolved"), "bsdf": "plain"}
    run("texture_preview", seen, {"preview": "texture_preview"}, {"distance": 0.05})
    run("export_astm", same("bsdf"), {"export": "export_astm.nc"})
    run("report", same("facets", "bsdf"), same("page"))
    run("summary", same("facets", "bsdf"), same("summary"))
    run("catalogue", {"summaries": ["summary"]}, same("dataset", "csv", "lock", "page"), {"failures": {}})
    assert {script(STAGES[step.stage]) for step in steps} == set(SCRIPTS.glob("*.py"))

    check_modules(steps, tmp_path)
    assert store.open_dataset(tmp_path / "reference").attrs["representation"] == solution
