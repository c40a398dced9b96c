"""Code digests: a stage's changes with its own code, and only with it."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from brdfpipe import catalogue, installation
from brdfpipe.jobs import code

SCRIPTS = Path(__file__).parents[2] / "workflow" / "scripts"


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
    (package / "other.py").write_text("x = 1\n")
    (package / "jobs.py").write_text("x = 1\n")
    (tmp_path / "stage.py").write_text("from brdfpipe import facets\n\ndef main():\n    import brdfpipe.jobs.x\n")
    return tmp_path


def digest(root: Path) -> str:
    code._read.cache_clear()
    code._bytes_digest.cache_clear()
    return code.digest(root / "stage.py", root)


def test_imports_are_followed_into_functions_and_packages(root: Path) -> None:
    found = code.modules(root / "stage.py", root)
    assert found == ("brdfpipe", "brdfpipe.facets", "brdfpipe.optics", "brdfpipe.optics.fresnel", "brdfpipe.store")


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


def test_the_digest_changes_with_the_libraries(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = digest(root)
    monkeypatch.setattr(code, "version", lambda library: "0")
    assert digest(root) != before


def test_the_digest_changes_with_an_optional_library_of_a_module_the_stage_uses(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = digest(root)
    monkeypatch.setattr(code, "EXTRAS", {"brdfpipe.optics.fresnel": "no-such-library", "brdfpipe.other": "numpy"})
    absent = digest(root)
    monkeypatch.setattr(code, "EXTRAS", {"brdfpipe.optics.fresnel": "numpy"})
    assert len({before, absent, digest(root)}) == 3
    monkeypatch.setattr(code, "EXTRAS", {"brdfpipe.other": "numpy"})
    assert digest(root) == before


def test_the_reader_of_instruments_files_counts_with_its_library() -> None:
    from brdfpipe.surfaces import instruments

    expected = {instruments.__name__: instruments.LIBRARY, "brdfpipe.spectra.colour_science": "colour-science"}
    assert expected == code.EXTRAS


@pytest.mark.parametrize("stage", sorted(path.stem for path in SCRIPTS.glob("*.py")))
def test_every_stage_has_a_digest_of_its_own(stage: str) -> None:
    assert len(code.digest(SCRIPTS / f"{stage}.py")) == 32


def test_the_digest_of_a_stage_covers_every_module_that_its_run_loads(tmp_path: Path) -> None:
    """Run each stage of the examples in one fresh process a stage and compare what was imported."""
    root = Path(catalogue.__file__).parents[2]
    program = (
        "import sys, runpy, json; sys.argv = sys.argv[1:]; runpy.run_path(sys.argv[0], run_name='__main__');"
        "print(json.dumps(sorted(m for m in sys.modules if m.split('.')[0] == 'brdfpipe')))"
    )
    material = tmp_path / "m"
    folder = installation.project_folder() / "examples" / "abs-grain"
    examples = catalogue.load(folder.parent)
    steps = {
        "surface": ({"raw": folder / "grain.x3p"}, ["surface"]),
        "index": ({}, ["index"]),
        "facets": ({"surface": material / "surface"}, ["facets"]),
        "spectrum": ({"raw": folder / "reflectance.txt", "index": material / "index"}, ["spectrum"]),
        "predicted": ({part: material / part for part in ("facets", "index", "spectrum")}, ["predicted"]),
        "bsdf": ({"predicted": material / "predicted"}, ["bsdf"]),
        "checks": ({"bsdf": material / "bsdf"}, ["checks"]),
        "appearance": ({"bsdf": material / "bsdf"}, ["appearance"]),
        "preview": ({"bsdf": material / "bsdf"}, ["preview", "png"]),
        "table": ({"bsdf": material / "bsdf"}, ["table"]),
        "lambert_gauss": ({"bsdf": material / "bsdf"}, ["lambert_gauss", "csv"]),
        "export_astm": ({"table": material / "table", "bsdf": material / "bsdf"}, ["astm", "total_reflectance"]),
        "report": ({"facets": material / "facets", "bsdf": material / "bsdf"}, ["page", "summary"]),
    }
    from brdfpipe.store import canonical_json

    for stage, (inputs, outputs) in steps.items():
        command = [sys.executable, "-c", program, str(SCRIPTS / f"{stage}.py"), "--material", "abs-grain"]
        command += ["--spec", canonical_json(examples.spec("abs-grain", stage))]
        command += ["--input", *(f"{name}={path}" for name, path in inputs.items())] if inputs else []
        command += ["--output", *(f"{name}={material / name}" for name in outputs)]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        loaded = {name for name in json.loads(done.stdout) if not f"{name}.".startswith(code.UNFOLLOWED)}
        assert loaded <= set(code.modules(SCRIPTS / f"{stage}.py", root)), stage
