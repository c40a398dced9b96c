"""A catalogue of attacks: each is refused in one line, nothing runs or is written outside the results, and the good material is built."""

from __future__ import annotations

import io
import os
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from brdfpipe.jobs.build import build
from brdfpipe.jobs.summary import Summary

COLOUR = "spectrum: {lab: [50, 0, 0], illuminant: D65, observer: 10, geometry: sci}\n"
SCAN = "index: 1.5\nsurface: {file: %s, unit: um, pitch: 1}\n"
PAYLOAD = "$(touch pwned)`touch pwned`; touch pwned\n<script>alert(1)</script>"

Attack = Callable[[Path], str]
"""Writes the raw files of a material into its folder, and returns its description."""


def scan(content: bytes, name: str = "a.txt") -> Attack:
    """A scan with some content."""

    def write(folder: Path) -> str:
        (folder / name).write_bytes(content)
        return SCAN % name

    return write


def link(target: str) -> Attack:
    """A raw file that is a link."""

    def write(folder: Path) -> str:
        (folder / "a.txt").symlink_to(target)
        return SCAN % "a.txt"

    return write


def text(description: str) -> Attack:
    """A description without raw files."""
    return lambda folder: description


def pipe(folder: Path) -> str:
    os.mkfifo(folder / "a.txt")
    return SCAN % "a.txt"


def pipe_as_description(folder: Path) -> str:
    os.mkfifo(folder / "material.yaml")
    return ""


def zip_bomb() -> bytes:
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("main.xml", b" " * 2**27)
    return archive.getvalue()


def archive_of(xml: str) -> bytes:
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w") as file:
        file.writestr("main.xml", xml)
    return archive.getvalue()


def numpy_header(shape: str) -> bytes:
    header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}}}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header.encode()


def numpy_pickle() -> bytes:
    header = "{'descr': '|O', 'fortran_order': False, 'shape': (1,)}".ljust(117) + "\n"
    return (
        b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header.encode() + b"cos\nsystem\n(S'touch pwned'\ntR."
    )


ENTITIES = '<!DOCTYPE x [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;">]><x>&b;</x>'

ATTACKS: dict[str, Attack] = {
    "name-outside": text(COLOUR + "name: ../../outside"),
    "name-absolute": text(COLOUR + "name: /tmp/outside"),
    "name-command": text(COLOUR + "name: 'a; touch pwned'"),
    "path-outside": text(SCAN % "../../secret.txt"),
    "path-absolute": text(SCAN % "/etc/passwd"),
    "path-wildcard": text(SCAN % "'{material}.txt'"),
    "link-outside": link("../../secret.txt"),
    "link-device": link("/dev/zero"),
    "link-loop": link("a.txt"),
    "pipe": pipe,
    "tag": text("spectrum: !!python/object/apply:os.system ['touch pwned']"),
    "aliases": text("a: &a [x, x]\nb: &b [*a, *a]\nc: [*b, *b]\n"),
    "depth": text("[" * 100_000),
    "size": text("#" * 2_000_000),
    "number": text("index: 1" + "0" * 5000 + "\nspectrum: 1\n"),
    "scene": text(COLOUR + "scene: ../../secret.yaml\n"),
    "scene-null": text(COLOUR + 'scene: "../\\0.yaml"\n'),
    "zip-bomb": scan(zip_bomb(), "a.x3p"),
    "entities": scan(archive_of(ENTITIES), "a.x3p"),
    "header": scan(numpy_header("(1000000000, 1000000000)"), "a.npy"),
    "pickle": scan(numpy_pickle(), "a.npy"),
    "binary": scan(bytes(range(256)) * 16),
    "command": scan(PAYLOAD.encode()),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A catalogue of all attacks and one good material, beside files that are none of its business."""
    root = tmp_path_factory.mktemp("hostile")
    (root / "secret.txt").write_text("password: swordfish\n")
    (root / "secret.yaml").write_text("password: swordfish\n")
    for name, attack in ATTACKS.items():
        material = root / "catalogue" / name
        material.mkdir(parents=True)
        (material / "material.yaml").write_text(attack(material))
    good = root / "catalogue" / "good"
    good.mkdir()
    description = PAYLOAD.replace("\n", " ") + " =cmd|calc\u202e"
    (good / "material.yaml").write_text(f"description: |\n  {description}\n{COLOUR}")
    hang = root / "catalogue" / "pipe-as-description"
    hang.mkdir()
    pipe_as_description(hang)
    return root


@pytest.fixture(scope="module")
def summary(folder: Path) -> Summary:
    return build(folder / "catalogue", folder / "results", cores=2)


def test_the_good_material_is_built(summary: Summary) -> None:
    assert summary.built == ("good",)


@pytest.mark.parametrize("name", ATTACKS)
def test_each_attack_is_refused_in_one_line_that_quotes_no_other_file(summary: Summary, name: str) -> None:
    message = summary.failures[name]
    assert "\n" not in message
    assert len(message) < 1000
    assert "swordfish" not in message
    assert "Traceback" not in message


def test_nothing_is_written_outside_the_results(summary: Summary, folder: Path) -> None:
    assert sorted(path.name for path in folder.iterdir()) == ["catalogue", "results", "secret.txt", "secret.yaml"]
    assert not [path for path in folder.rglob("*pwned*") if "pwned" in path.name]
    assert not Path("pwned").exists()


def test_the_pages_and_tables_hold_no_markup_formula_or_secret(summary: Summary, folder: Path) -> None:
    results = folder / "results"
    for page in (results / "index.html", results / "good" / "report.html"):
        html = page.read_text(encoding="utf-8")
        assert "<script>alert" not in html
        assert "\u202e" not in html
        assert "swordfish" not in html
    table = (results / "catalogue.csv").read_text(encoding="utf-8")
    assert "swordfish" not in table
    assert set(ATTACKS) <= {line.split(",")[0].strip('"') for line in table.splitlines()}
