"""What `brdfpipe verify` and `brdfpipe build` do with every damage to every kind of file: the table of docs/nightly.md.

The kinds of results are those that the stages and formats declare: each damage is done to the file of one kind in a material of its own, so
that no repair is that of a file upstream. The stages are fake ones; nothing here depends on what is in a file.
"""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

import pytest
from killed_build import contents

from brdfpipe.errors import BrdfpipeError
from brdfpipe.exchange.registry import WRITTEN
from brdfpipe.jobs.build import build
from brdfpipe.jobs.index import INDEX, Index, with_checksum
from brdfpipe.releases.verification import verify_results
from brdfpipe.stages import STAGES

PROJECT = Path(__file__).parents[2]
DOCUMENT, EXAMPLES = PROJECT / "docs" / "nightly.md", PROJECT / "examples"
MARKS = "<!-- damages -->\n", "<!-- end of damages -->\n"

SCAN = "surface: {file: raw.txt, unit: um, pitch: 1"
COLOUR = "spectrum: {lab: [50, 0, 0], illuminant: D65, observer: 10, geometry: sci}\n"
FORMS = f"exports: [{', '.join(WRITTEN)}]\n"
TEMPLATES = {
    "t-map": f"{SCAN}, scans: [{{file: further.txt}}]}}\nindex: 1.5\n{COLOUR}{FORMS}texture: {{pixel: 1}}\n",
    "t-sheet": f"{SCAN}}}\nindex: 1.5\nslab: {{thickness: 2, back: {{file: further.txt, unit: um, pitch: 1}}}}\n{FORMS}",
    "t-gloss": f"surface: {{distribution: measured-gloss}}\nmeasured: {{gloss: {{20: 3.1, 60: 22.4, 85: 48}}}}\nindex: 1.5\n{COLOUR}",
    "t-coat": f"{SCAN}}}\nindex: 1.5\n{COLOUR}coat: {{thickness: 0.04, base: {{index: {{file: raw.txt}}, surface: {{file: further.txt, unit: um, pitch: 1}}}}}}\n",
    "t-paint": "multiangle: {colours: [{geometry: '45:-30', lab: [40, 0, 0]}, {geometry: '45:0', lab: [20, 0, 0]}, "
    "{geometry: '45:65', lab: [9, 0, 0]}], illuminant: D65, observer: 10, model: flake}\n"
    "texture: {pictures: [{file: raw.png, geometry: diffuse}], pixel: 20}\n",
    "t-table": "table: {file: raw.txt, format: zemax}\n",
    "t-rig": f"surface: {{distribution: ggx, a: 0.3}}\nindex: 1.5\n{COLOUR}"
    "rig: {plan: plan.yaml, emulate: {truth: truth, seed: 1, session: 1}, calibration: bench}\n",
    "t-traced": f"{SCAN}}}\nindex: 1.5\n{COLOUR}model: {{truth: use}}\n",
    "t-planned": f"{SCAN}}}\nindex: 1.5\n{COLOUR}scene: gloss-sheet\n",
    "t-colour": f"{COLOUR}scene: gloss-sheet\n",
    "t-grid": f"{COLOUR}scene: luminaire-raytrace\n",
}
"""Descriptions of which each stage has a job in one. The damaged materials are copies."""

RESULTS = "dataset, page, picture or exported file of a material"
INTERMEDIATE = "dataset that only other stages of a rig need, calibration"
RUNS = "journal or frame of an emulated rig"
INDEX_ROW = "`.index.jsonl`"
NOTE_ROW = "`.snakemake/code.json`, logs"

FRAMES = """
journal_alone = main
def main(input, output, params):
    journal_alone(input, output, params)
    frame = Path(output["journal"]).parent / "frames" / "00001.fits"
    frame.parent.mkdir(exist_ok=True)
    frame.write_text("counts of " + params["material"])
"""
"""What the fake emulator writes beside its journal."""

MAPS = """
texture_alone = main
def main(input, output, params):
    texture_alone(input, output, params)
    picture = Path(output["texture"]).parent / "exports" / (params["material"] + ".height.png")
    picture.parent.mkdir(exist_ok=True)
    picture.write_text("heights of " + params["material"])
"""
"""What the fake stage of textures writes beside its dataset."""

SHARED = ("catalogue.nc", "catalogue.csv", "index.html", "catalogue.lock.json")
"""Results of the whole catalogue."""

NOTES = (
    INDEX,
    ".snakemake/code.json",
    "logs/build.log",
    "logs/build.json",
    "logs/paint/bsdf.log",
    "logs/paint/bsdf.json",
)
"""What builds keep for themselves."""


class Kind(NamedTuple):
    """A file of one kind."""

    template: str
    """The material, or the calibration, that has it."""
    pattern: str
    """Path in the results, with the name of the owner as ``{}``."""
    format: str | None = None
    """The format whose export writes it."""

    @property
    def description(self) -> str:
        """That of the template, without the exports that do not write this file: each would be a job more in every build."""
        return TEMPLATES[self.template].replace(FORMS, f"exports: [{self.format}]\n" if self.format else "")

    @property
    def owner(self) -> str:
        """The copy of the template of which this file is damaged."""
        return f"{self.template}-{re.sub('[^a-z0-9]+', '-', self.pattern).strip('-')}"

    @property
    def path(self) -> str:
        return self.pattern.replace("{}", self.owner)

    @property
    def row(self) -> str:
        """The row of the table."""
        if "/run/" in self.pattern:
            return RUNS
        stage = STAGES.get(Path(self.pattern).stem.split("-")[0])
        return INTERMEDIATE if self.template == "bench" or (stage and stage.intermediate) else RESULTS

    @property
    def source(self) -> str:
        return self.pattern.replace("{}", self.template)


# --- damages


def truncate(path: Path, others: Path) -> None:
    os.truncate(path, path.stat().st_size // 2)


def flip_one_bit(path: Path, others: Path) -> None:
    """With the former time of the file; that of its inode is another."""
    status, content = path.stat(), bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))


def empty(path: Path, others: Path) -> None:
    os.truncate(path, 0)


def delete(path: Path, others: Path) -> None:
    path.unlink()


def put_another(path: Path, others: Path) -> None:
    """The file of another material, or of another catalogue; the same kind."""
    shutil.copy(others, path)


def put_other_kind(path: Path, others: Path) -> None:
    path.write_bytes(b"CDF\x01 a dataset of another kind")


def make_unreadable(path: Path, others: Path) -> None:
    """A loop of links: nobody can read it, a superuser included."""
    path.unlink()
    path.symlink_to(path.name)


def rot(path: Path, others: Path) -> None:
    """One bit flipped by a failing disk: size, times and inode stay. A test cannot set the time of an inode, so the index gets it instead."""
    results = next(folder for folder in path.parents if (folder / INDEX).is_file())
    name = str(path.relative_to(results))
    known = Index(results).digest(name)
    flip_one_bit(path, others)
    status = path.stat()
    stamp = status.st_size, status.st_mtime_ns, status.st_ctime_ns, status.st_ino
    with (results / INDEX).open("a") as index:
        index.write(with_checksum(json.dumps({"file": name, "is": [*stamp, known]})) + "\n")


DAMAGES: Mapping[str, Callable[[Path, Path], None]] = {
    "truncated": truncate,
    "one bit flipped": flip_one_bit,
    "emptied": empty,
    "deleted": delete,
    "of another material": put_another,
    "of another kind": put_other_kind,
    "unreadable": make_unreadable,
    "rotten": rot,
}


# --- catalogues of fake stages


def write_material(folder: Path, name: str, text: str) -> None:
    material = folder / name
    material.mkdir(parents=True)
    (material / "material.yaml").write_text(text)
    for file in ("raw.txt", "further.txt", "raw.png"):
        if file in text:
            (material / file).write_text(f"{name} {file}")
    if "rig:" in text:
        for file in ("rig.yaml", "fibres.csv", "plan.yaml"):
            shutil.copy(EXAMPLES / "milk-glass" / file, material)


def write_calibration(folder: Path, name: str) -> None:
    shutil.copytree(EXAMPLES / "calibrations" / "bench-1", folder / "calibrations" / name)


def build_templates(project: Path, base: Path) -> list[Kind]:
    """Build a material of each template; the kinds of files that its jobs wrote, each for the first template that has it."""
    shutil.copytree(PROJECT / "config" / "scenes" / "experience", project / "config" / "scenes" / "experience")
    for stage, beside in (("rig_run", FRAMES), ("texture", MAPS)):
        script = project / "workflow" / "scripts" / f"{stage}.py"
        script.write_text(script.read_text() + beside)
    for name, text in {"truth": COLOUR, **TEMPLATES}.items():
        write_material(base / "catalogue", name, text)
    write_calibration(base / "catalogue", "bench")
    assert build(base / "catalogue", base / "results", cores=2).failures == {}
    found: dict[str, Kind] = {}
    for job in Index(base / "results").jobs.values():
        format = next(filter(None, map(format_of_export, job.outputs)), None)
        for path in job.outputs:
            for template in (name for name in (*TEMPLATES, "bench") if name in re.split("[/.]", path)):
                pattern = path.replace(template, "{}")
                found.setdefault(re.sub(r"-\d+\.nc$", "", pattern), Kind(template, pattern, format))
    return sorted(found.values(), key=lambda kind: kind[:2])


def format_of_export(path: str) -> str | None:
    """The format of an export's record (``astm`` of ``export_astm_transmission.nc``); ``None`` for other files."""
    name = Path(path).stem.partition("export_")[2].replace("_", "-")
    return max((format for format in WRITTEN if name.startswith(format)), key=len, default=None)


def write_copies(folder: Path, kinds: Iterable[Kind]) -> None:
    """A copy of its template for each kind; a copy of a calibration has a material that is measured with it."""
    for kind in kinds:
        if kind.template == "bench":
            write_calibration(folder, kind.owner)
            text = TEMPLATES["t-rig"].replace("calibration: bench", f"calibration: {kind.owner}")
            write_material(folder, f"by-{kind.owner}", text)
        else:
            write_material(folder, kind.owner, kind.description)


def outcomes(
    folder: Path, results: Path, damaged: Path, harm: Callable[[Path, Path], None], files: Mapping[str, Path]
) -> dict[str, str]:
    """Do one damage to some files of a copy of results; file → what the commands did: ``named`` and ``mended``, or not.

    ``files``: path → the file of another material.
    """
    undamaged = contents(results)
    problems = list[str]()
    for command in ("verify", "build"):
        shutil.rmtree(damaged, ignore_errors=True)
        shutil.copytree(results, damaged)
        for path, other in files.items():
            harm(damaged / path, other)
        if command == "verify":
            try:
                problems = verify_results(damaged)
            except BrdfpipeError as refusal:
                problems = [str(refusal)]
    build(folder, damaged, cores=2)
    mended = {path for path in files if as_before(damaged, path, undamaged)}
    if mended != files.keys():
        verify_results(damaged)
        build(folder, damaged, cores=2)
    later = {path for path in files if as_before(damaged, path, undamaged)}
    after = contents(damaged)
    assert all(after.get(path) == content for path, content in undamaged.items() if path not in files)
    return {
        path: f"{'named' if any(line.startswith(f'{path}: ') for line in problems) else 'not named'}, "
        f"{'mended' if path in mended else 'mended after `verify`' if path in later else 'not mended'}"
        for path in files
    }


def as_before(results: Path, path: str, undamaged: Mapping[str, bytes]) -> bool:
    return contents(results).get(path) == undamaged[path]


def outcomes_of_note(folder: Path, results: Path, damaged: Path, harm: Callable[[Path, Path], None], note: str) -> str:
    """Do one damage to a note of the builds: no result changes, and the builds after it know again what is current."""
    shutil.rmtree(damaged, ignore_errors=True)
    shutil.copytree(results, damaged)
    other = damaged / "another"
    other.write_bytes((results / note).read_bytes()[::-1])
    harm(damaged / note, other)
    other.unlink()
    try:
        problems = verify_results(damaged)
    except BrdfpipeError as refusal:
        problems = [str(refusal)]
    build(folder, damaged, cores=2)
    assert contents(damaged) == contents(results)
    assert build(folder, damaged, cores=2).jobs == 0
    return f"{'named' if problems else 'not named'}, without effect"


def as_table(cells: Mapping[str, Mapping[str, Iterable[str]]]) -> str:
    """Rows and damages as a table of Markdown."""
    lines = [f"| Damaged | {' | '.join(DAMAGES)} |", "|---|" + "---|" * len(DAMAGES)]
    for row, by_damage in cells.items():
        texts = (" or ".join(sorted(set(by_damage[damage]))) or "–" for damage in DAMAGES)
        lines.append(f"| {row} | {' | '.join(texts)} |")
    return "\n".join(lines) + "\n"


@pytest.fixture
def small(project: Path, tmp_path: Path) -> Path:
    """A catalogue of one material, and its results."""
    write_material(tmp_path / "catalogue", "paint", COLOUR)
    build(tmp_path / "catalogue", tmp_path / "results", cores=2)
    return tmp_path


@pytest.mark.parametrize("damage", ["one bit flipped", "unreadable"])
def test_damaged_results_are_named_and_mended(small: Path, damage: str) -> None:
    """The representative of the table."""
    paths = dict.fromkeys(("paint/bsdf.nc", "catalogue.csv"), small / "results" / "paint" / "checks.nc")
    found = outcomes(small / "catalogue", small / "results", small / "damaged", DAMAGES[damage], paths)
    assert set(found.values()) == {"named, mended"}


def test_the_files_that_an_emulated_rig_wrote_beside_its_journal_are_guarded(project: Path, tmp_path: Path) -> None:
    kinds = [kind for kind in build_templates(project, tmp_path) if kind.pattern.endswith(".fits")]
    assert len(kinds) == 2, "of a material and of a calibration"
    results = tmp_path / "results"
    assert verify_results(results) == []
    files = {kind.source: results / "truth" / "bsdf.nc" for kind in kinds}
    found = outcomes(tmp_path / "catalogue", results, tmp_path / "damaged", flip_one_bit, files)
    assert set(found.values()) == {"named, mended"}


@pytest.mark.parametrize("note", NOTES)
def test_a_damaged_note_of_the_builds_changes_no_result(small: Path, note: str) -> None:
    outcomes_of_note(small / "catalogue", small / "results", small / "damaged", put_other_kind, note)


@pytest.mark.slow
def test_every_damage_to_every_kind_of_file_is_in_the_documentation(project: Path, small: Path, tmp_path: Path) -> None:
    base = tmp_path / "kinds"
    kinds, results = build_templates(project, base), base / "results"
    titles = {path.stem for path in (results / "logs").rglob("*.log")}
    for stage in STAGES.values():
        assert any(re.fullmatch(re.sub("{.*?}", ".+", stage.job_title), title) for title in titles), stage.name
    write_copies(base / "catalogue", kinds)
    assert build(base / "catalogue", results, cores=2).failures == {}
    cells: dict[str, dict[str, list[str]]] = {}

    def note(row: str, damage: str, outcome: str) -> None:
        cells.setdefault(row, {name: [] for name in DAMAGES})[damage].append(outcome)

    for damage, harm in DAMAGES.items():
        files = {kind.path: results / kind.source for kind in kinds}
        found = outcomes(base / "catalogue", results, tmp_path / "damaged", harm, files)
        for kind in kinds:
            note(kind.row, damage, found[kind.path])
        for path in SHARED:
            other = {path: small / "results" / "paint" / "bsdf.nc"}
            found = outcomes(small / "catalogue", small / "results", small / "damaged", harm, other)
            note(", ".join(f"`{name}`" for name in SHARED), damage, found[path])
        for path in NOTES if damage != "rotten" else ():
            outcome = outcomes_of_note(small / "catalogue", small / "results", small / "damaged", harm, path)
            note(INDEX_ROW if path == INDEX else NOTE_ROW, damage, outcome)
    text = DOCUMENT.read_text(encoding="utf-8").partition(MARKS[0])[2].partition(MARKS[1])[0]
    assert text == as_table(cells), f"docs/nightly.md should have\n{as_table(cells)}"
