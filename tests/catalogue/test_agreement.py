"""Descriptions with mistakes: ``brdfpipe check`` and the plan of ``brdfpipe build`` refuse the same; none ends in a traceback."""

from __future__ import annotations

import random
import re
from pathlib import Path

import pytest
from click.testing import CliRunner

from brdfpipe.cli.main import main
from brdfpipe.errors import BrdfpipeError
from brdfpipe.jobs.build import build

COAT = """\
surface: {distribution: beckmann, slope_rms: 0.1}
index: 1.5
coat:
  thickness: 0.04
  absorption: 0.5
  transmittance_uncertainty: 0.01
  base:
    index: ABS
    surface: {distribution: ggx, a: 0.2}
spectrum: {lab: [40, 5, 5], illuminant: D65, observer: 10, geometry: sci}
"""
DEFAULTS = """\
index: ABS
index_uncertainty: 0.005
surface: {form: plane, lambda_s: 2.5, lambda_c: 80, outliers: report, isotropic: true}
spectrum:
  geometry: sci
  incidence: 8
  scale: percent
  illuminant: D65
  observer: 10
  reflectance_uncertainty: 0.01
exports: [astm]
scene: gloss-sheet
"""
COLOUR = "spectrum: {lab: [40, 5, 5], illuminant: D65, observer: 10, geometry: sci}\nindex: 1.5\n"
MATERIALS = {
    "scan": "surface: {file: p.txt, unit: um, pitch: 5}\nspectrum: {file: s.txt}\n",
    "colour": "surface: {distribution: ggx, a: 0.1}\nspectrum: {lab: [40, 5, 5]}\n",
    "pair": "surface: {distribution: flat}\nspectrum: {sci: {file: s.txt}, sce: {file: s.txt}}\n",
}
VALUES = [
    "0", "-1", "1e9", ".nan", ".inf", "null", "true", "[]", "{}", '""', "[1, 2]", "{n: 1.5}", "{n: 1.2, k: 7}", "{file: a.txt}", "../x",
    "1,5", "0.5", "1", "same", "flat", "&a [*a]", "!!python/object:os.system x", "2026-01-31", "99999999999999999999",
    "{file: ../../etc/passwd}", "ä", '"\\0"', "D65", "PMMA",
]  # fmt: skip
KEYS = [
    "thickness",
    "absorption",
    "internal_transmittance",
    "base",
    "index",
    "surface",
    "scale",
    "lab",
    "file",
    "scene",
]
A_VALUE = re.compile(r": ([^:{}\[\],]+)(?=[,}]|$)")


def mutated(text: str, choose: random.Random) -> str:
    """A description with one to three values, keys, characters or lines changed."""
    lines = text.splitlines()
    for _ in range(choose.choice([1, 1, 1, 2, 3])):
        place = choose.randrange(len(lines))
        line = lines[place]
        kind, values, keys = choose.randrange(6), list(A_VALUE.finditer(line)), re.findall(r"\w+(?=:)", line)
        if kind <= 1 and values:
            found = choose.choice(values)
            lines[place] = line[: found.start(1)] + choose.choice(VALUES) + line[found.end(1) :]
        elif kind == 2 and len(lines) > 2:
            del lines[place]
        elif kind == 3:
            lines.insert(place, choose.choice(lines))
        elif kind == 4 and line:
            at = choose.randrange(len(line))
            lines[place] = line[:at] + choose.choice(" :{}[],\"'\t#&*!|>%@-0aµ\x00\x85") + line[at + 1 :]
        elif keys:
            lines[place] = line.replace(choose.choice(keys), choose.choice([*KEYS, "unknown"]), 1)
    return "\n".join(lines) + "\n"


def write(folder: Path, text: str) -> None:
    folder.mkdir(parents=True)
    (folder / "material.yaml").write_text(text, encoding="utf-8")
    (folder / "a.txt").write_text("".join(f"{nm} {0.5 + nm / 5000}\n" for nm in range(380, 781, 10)))
    (folder / "s.txt").write_text("".join(f"{nm} 40.0\n" for nm in range(380, 781, 10)))
    (folder / "p.txt").write_text(
        "".join(" ".join(f"{(3 * i + 5 * k) % 7 / 10}" for k in range(32)) + "\n" for i in range(32))
    )


def refused_by_check(folder: Path) -> set[str] | None:
    """Names that ``check`` refuses; None if it refuses the whole catalogue."""
    result = CliRunner().invoke(main, ["check", str(folder)])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exc_info
    assert "Traceback" not in result.output
    if result.exit_code == 2:
        return None
    lines = [line for line in result.output.splitlines() if re.match(r"\w+: ", line)]
    assert re.search(r"\d+ ok, \d+ wrong", result.output)
    return {line.partition(":")[0] for line in lines if ": ok (" not in line} & {item.name for item in folder.iterdir()}


def refused_by_plan(folder: Path) -> set[str] | None:
    """Names that the plan of a build refuses; None if it refuses the whole catalogue."""
    try:
        summary = build(folder, folder.parent / f"{folder.name}-results", cores=1, dry_run=True)
    except BrdfpipeError:
        return None
    assert all("\n" not in reason for reason in summary.failures.values())
    return set(summary.failures)


@pytest.mark.parametrize("count", [3, pytest.param(40, marks=pytest.mark.slow)])
def test_a_build_accepts_the_coats_that_check_accepts(tmp_path: Path, count: int) -> None:
    choose = random.Random(7)
    for number in range(count):
        write(tmp_path / "c" / f"m{number:03d}", mutated(COAT, choose))
    write(tmp_path / "c" / "whole", COAT)
    refused = refused_by_check(tmp_path / "c")
    assert refused
    assert "whole" not in refused
    assert refused_by_plan(tmp_path / "c") == refused


@pytest.mark.parametrize("count", [2, pytest.param(40, marks=pytest.mark.slow)])
def test_a_build_accepts_the_defaults_that_check_accepts(tmp_path: Path, count: int) -> None:
    choose, whole = random.Random(8), 0
    for number in range(count):
        folder = tmp_path / f"c{number:03d}"
        for name, text in MATERIALS.items():
            write(folder / name, text)
        text = mutated(DEFAULTS, choose)
        (folder / "catalogue.yaml").write_text(text, encoding="utf-8")
        refused, planned = refused_by_check(folder), refused_by_plan(folder)
        assert refused == planned, text
        whole += refused is not None
    assert count < 10 or 0 < whole < count


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("surface: {file: x.x3p, unit: um}\nindex: 1.5\n", "x.x3p, surface.unit: this key does not apply to the format"),
        ("surface: {file: x.x3p, pitch: 2}\nindex: 1.5\n", "surface.pitch: this key does not apply"),
        ("surface: {file: x.x3p, layout: grid}\nindex: 1.5\n", "surface.layout: this key does not apply"),
        ("surface: {file: p.txt, unit: um, pitch: 5, channel: a}\nindex: 1.5\n", "surface.channel: this key does not apply"),
        ("surface: {file: p.txt, unit: um, pitch: 5, scans: [{file: x.x3p, unit: um}]}\nindex: 1.5\n", "x.x3p, surface.unit"),
        ("surface: {file: p.txt, unit: um, pitch: 5, lambda_s: 50, lambda_c: 40}\nindex: 1.5\n", "not above the low-pass filter"),
        ("surface: {file: p.txt, unit: um, pitch: 5, region: {x: [30, 10]}}\nindex: 1.5\n", "ends where it begins, or before"),
        (
            "surface: {file: p.txt, unit: um, pitch: 5, layout: line, isotropic: true, region: {y: [0, 9]}}\nindex: 1.5\n",
            "a line has no y",
        ),
        (
            "surface: {file: p.txt, unit: um, pitch: 5, layout: line, isotropic: true, mask: {polygons: [[[0, 0], [5, 0], [0, 5]]]}}\nindex: 1.5\n",
            "a mask needs a map",
        ),
        ("surface: {file: p.txt, unit: um, pitch: 5, layout: grid, azimuth: 30}\nindex: 1.5\n", "line profiles only"),
        ("spectrum: {file: s.txt, geometry: sci, scale: percent, specular_trap: 4}\n", "a gloss trap needs"),
        ("spectrum: {lab: [40, 5, 5], illuminant: D99, observer: 10, geometry: sci}\n", "D99"),
        ("spectrum: {lab: [0, 100, 100], illuminant: D65, observer: 10, geometry: sci}\n", "L\\*a\\*b\\*|no spectrum"),
        ("surface: {distribution: flat}\nindex: unobtainium\n", "unobtainium"),
        ("spectrum: {file: s.xyz, geometry: sci, scale: percent}\n", "unknown file extension"),
        ("spectrum: {file: empty.txt, geometry: sci, scale: percent}\n", "an empty file"),
        (COLOUR + "measured: {lab: [{geometry: 'sideways', lab: [1, 0, 0], illuminant: D65, observer: 10}]}\n", "sideways"),
    ],
)  # fmt: skip
def test_what_the_description_alone_shows_is_refused_before_a_build(tmp_path: Path, text: str, words: str) -> None:
    write(tmp_path / "c" / "m", text)
    for name in ("x.x3p", "s.xyz"):
        (tmp_path / "c" / "m" / name).write_bytes(b"a file that is not read")
    (tmp_path / "c" / "m" / "empty.txt").write_bytes(b"")
    result = CliRunner().invoke(main, ["check", str(tmp_path / "c")])
    assert re.search(words, result.output), result.output
    planned = build(tmp_path / "c", tmp_path / "results", cores=1, dry_run=True)
    assert re.search(words, planned.failures["m"])
