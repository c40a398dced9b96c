"""A project whose stages are a few lines of text, to prove the machinery without the physics."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from brdfpipe import installation

Write = Callable[..., Path]

STAGES = [path.stem for path in (Path(__file__).parents[2] / "workflow" / "scripts").glob("*.py")]

FAKE_STAGE = '''
"""A stage that writes what it was given, and misbehaves when the raw file says so."""
import hashlib, json, os, signal, time
from pathlib import Path
from brdfpipe.errors import InputError

def damage(path):
    status = path.stat()
    path.write_text("damaged".ljust(status.st_size)[: status.st_size])
    os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))

def main(input, output, params):
    texts = []
    for value in input.values():
        for path in [value] if isinstance(value, str) else value:
            texts.append(Path(path).read_text())
    raw = " ".join(texts) if "raw" in input else ""
    if "refuse" in raw:
        raise InputError("raw.txt", "not fit to use", found="refuse")
    if "crash" in raw:
        raise KeyError("a bug")
    if raw.startswith("lose "):
        Path(raw.removeprefix("lose ")).unlink(missing_ok=True)
    if raw.startswith("damage ") and not Path("damaged").exists():
        Path("damaged").touch()
        damage(Path(raw.removeprefix("damage ")))
    if "abort" in raw or any("damaged" in text for text in texts):
        os.abort()
    if "die" in raw:
        os.kill(os.getpid(), signal.SIGKILL)
    if "stumble" in raw and not Path("stumbled").exists():
        Path("stumbled").touch()
        os.kill(os.getpid(), signal.SIGKILL)
    while "wait" in raw and not Path("gate").exists():
        time.sleep(0.02)
    given = hashlib.sha256("".join(texts).encode()).hexdigest()
    content = json.dumps([Path(__file__).stem, params["material"], params["spec"], given], sort_keys=True)
    if Path(__file__).stem == "catalogue":
        content = json.dumps(params["spec"])
    for value in output.values():
        for path in [value] if isinstance(value, str) else value:
            Path(path).write_text(content)
    if "export" in output:
        from brdfpipe.exchange.registry import FORMATS
        folder = Path(output["export"]).parent / "exports"
        folder.mkdir(exist_ok=True)
        for suffix in FORMATS[params["spec"]["format"]].suffixes(params["spec"]["side"]):
            (folder / (params["material"] + suffix)).write_text(content)
'''


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The project's own rules and configuration, with fake stages."""
    source = Path(__file__).parents[2]
    folder = tmp_path / "project"
    folder.mkdir()
    shutil.copy(source / "Snakefile", folder)
    shutil.copytree(source / "config", folder / "config", ignore=shutil.ignore_patterns("experience"))
    for part in ("rules", "profiles"):
        shutil.copytree(source / "workflow" / part, folder / "workflow" / part)
    (folder / "workflow" / "scripts").mkdir()
    for stage in STAGES:
        (folder / "workflow" / "scripts" / f"{stage}.py").write_text(FAKE_STAGE)
    monkeypatch.setattr(installation, "project_folder", lambda: folder)
    return folder


@pytest.fixture
def write() -> Write:
    """Writes a material with a measured surface and spectrum into a catalogue."""
    return _write_material


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A catalogue of two materials."""
    made = tmp_path / "catalogue"
    for name in ("first", "second"):
        _write_material(made, name)
    return made


def _write_material(catalogue_folder: Path, name: str, raw: str = "1 2 3", description: str = "a test") -> Path:
    material = catalogue_folder / name
    material.mkdir(parents=True, exist_ok=True)
    (material / "raw.txt").write_text(raw)
    (material / "reflectance.txt").write_text("spectrum")
    (material / "material.yaml").write_text(
        f"description: {description}\n"
        "surface: {file: raw.txt, unit: um, pitch: 1}\n"
        "index: 1.5\n"
        "spectrum: {file: reflectance.txt, geometry: sci}\n"
        "exports: [astm]\n"
    )
    return material
