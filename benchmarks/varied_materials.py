"""Varied small materials of every route to a BRDF, as many as asked for: the catalogue on which the machinery is measured.

Each is small, so that its stages take little and the machinery shows: maps of 96² heights, lines of 1024, rigs of two wavelengths. None has a
lay: one such surface takes as long as fifty of the others. Sheets and rigs, which take five times as long as the others, are one in 63 each.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

PROJECT = Path(__file__).resolve().parents[1]

MAP, LINE = 96, 1024
"""Heights along an axis of a map, and of a line."""

PLAN = """\
rig: rig.yaml
sample: {sample}
incidences: [10]
wavelengths: [500, 600]
bracket: [{{exposure: 2, position: 2}}, {{exposure: 2, position: 1}}, {{exposure: 10, position: 1}}]
runs: [target, {load}]
side: [reflection]
"""
"""The shortest plan that gives a BSDF: one incidence at two wavelengths."""

Write = Callable[[Path, np.random.Generator], str]
"""Writes the raw files of a material into its folder, and returns its description."""


def write_varied(folder: Path, count: int) -> list[Path]:
    """Write materials of all routes in turn, ``map-0000``, ``line-0001``, …; the same bytes for the same number.

    Parameters
    ----------
    folder : of the catalogue; must not exist
    count : of materials

    Returns
    -------
    Their folders
    """
    written = []
    _write_calibration(folder)
    for number in range(count):
        turn, place = divmod(number, len(ROUTES))
        route = list(ROUTES)[place]
        if route in COSTLY and turn % EVERY:
            route = "colour"
        material = folder / f"{route}-{number:04d}"
        material.mkdir()
        text = ROUTES[route](material, np.random.default_rng([number, 5]))
        (material / "material.yaml").write_text(text, encoding="utf-8")
        written.append(material)
    return written


def _map(material: Path, random: np.random.Generator) -> str:
    np.save(material / "map.npy", _heights(random, (MAP, MAP)))
    return f"surface: {{file: map.npy, unit: um, pitch: 1.0}}\nindex: {random.uniform(1.4, 1.6):.3f}\n{_colour(random)}"


def _line(material: Path, random: np.random.Generator) -> str:
    np.savetxt(material / "line.txt", _heights(random, (LINE,)), fmt="%.5f", header="unit: um")
    scan = "file: line.txt, layout: line, pitch: 1.0, isotropic: true"
    return f"surface: {{{scan}}}\nindex: PP\n{_colour(random)}"


def _finish(material: Path, random: np.random.Generator) -> str:
    return f"surface: {{distribution: ggx, a: {random.uniform(0.05, 0.4):.3f}}}\nindex: 1.5\n{_colour(random)}"


def _colour_alone(material: Path, random: np.random.Generator) -> str:
    return _colour(random)


def _effect_paint(material: Path, random: np.random.Generator) -> str:
    level, fall, blue = random.uniform(25, 60), random.uniform(0.3, 0.7), random.uniform(-20, -5)
    colours = "".join(
        f"    - {{geometry: '{geometry}', lab: [{level * factor:.1f}, 1.0, {blue * factor:.1f}]}}\n"
        for geometry, factor in (("45:-30", 1.0), ("45:0", fall), ("45:65", fall * 0.5))
    )
    return f"multiangle:\n  colours:\n{colours}  illuminant: D65\n  observer: 10\n  model: flake\n"


def _clear_sheet(material: Path, random: np.random.Generator) -> str:
    front = f"surface: {{distribution: beckmann, slope_rms: {random.uniform(0.03, 0.3):.3f}}}"
    return f"{front}\nindex: PMMA\nslab: {{thickness: {random.uniform(1, 5):.2f}, internal_transmittance: 0.95}}\n"


def _metal(material: Path, random: np.random.Generator) -> str:
    index = f"{{n: {random.uniform(0.2, 2):.3f}, k: {random.uniform(2, 6):.3f}}}"
    return f"surface: {{distribution: beckmann, slope_rms: {random.uniform(0.05, 0.3):.3f}}}\nindex: {index}\n"


def _table(material: Path, random: np.random.Generator) -> str:
    """A matt lobe about the mirror direction on a diffuse part, as comma-separated values; reciprocal."""
    incidence, scatter, azimuth = (np.radians(axis) for axis in ([0, 30, 60], range(0, 86, 5), range(0, 360, 15)))
    theta_i, theta_o, phi_o = (axis.ravel() for axis in np.meshgrid(incidence, scatter, azimuth, indexing="ij"))
    theta_i, theta_o, phi_o = (axis[(theta_o > 0) | (phi_o == 0)] for axis in (theta_i, theta_o, phi_o))
    sine = np.sin(theta_i) ** 2 + np.sin(theta_o) ** 2 + 2 * np.sin(theta_i) * np.sin(theta_o) * np.cos(phi_o)
    value = random.uniform(0.02, 0.2) + random.uniform(0.05, 0.2) * np.exp(-sine / random.uniform(0.05, 0.2))
    np.savetxt(
        material / "table.samples.csv",
        np.column_stack([*np.degrees([theta_i, 0 * theta_i, theta_o, phi_o]), value]),
        fmt="%.6g",
        delimiter=",",
        header="theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg,bsdf_per_sr",
        comments="",
    )
    return "table: {file: table.samples.csv}\n"


def _rig(material: Path, random: np.random.Generator) -> str:
    """A run of the emulated rig over the first material that is a colour alone, which is quick to emulate."""
    for file in ("rig.yaml", "fibres.csv"):
        shutil.copy(PROJECT / "examples" / "milk-glass" / file, material)
    (material / "plan.yaml").write_text(PLAN.format(sample=material.name, load="sample"))
    truth = f"colour-{list(ROUTES).index('colour'):04d}"
    emulate = f"{{truth: {truth}, seed: {random.integers(1, 1000)}, session: 1}}"
    return f"rig: {{plan: plan.yaml, emulate: {emulate}, calibration: bench-1}}\n"


ROUTES: dict[str, Write] = {
    "map": _map,
    "line": _line,
    "finish": _finish,
    "colour": _colour_alone,
    "paint": _effect_paint,
    "sheet": _clear_sheet,
    "metal": _metal,
    "table": _table,
    "rig": _rig,
}
"""Route → what writes a material of it."""

COSTLY, EVERY = ("sheet", "rig"), 7
"""Routes that only the first of so many rounds has; a colour takes their place in the others."""


def _write_calibration(folder: Path) -> None:
    bench = folder / "calibrations" / "bench-1"
    shutil.copytree(PROJECT / "examples" / "calibrations" / "bench-1", bench)
    (bench / "plan.yaml").write_text(PLAN.format(sample="none", load="etalon") + "etalon_entrances: [10]\n")


def _heights(random: np.random.Generator, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Gaussian heights of a random rms slope, um, at a pitch of 1 um."""
    frequencies = np.meshgrid(*map(np.fft.fftfreq, shape), indexing="ij")
    filtered = np.exp(-((np.pi * random.uniform(2, 4)) ** 2) / 2 * sum(f * f for f in frequencies))
    height = np.fft.ifftn(np.fft.fftn(random.standard_normal(shape)) * filtered).real
    height *= random.uniform(0.04, 0.3) / np.diff(height).std()
    return np.round(height, 5).astype(np.float32)


def _colour(random: np.random.Generator) -> str:
    a, b = random.uniform(-10, 10, 2)
    lab = f"[{random.uniform(45, 85):.1f}, {a:.1f}, {b:.1f}]"
    return f"spectrum: {{lab: {lab}, illuminant: D65, observer: 10, geometry: sci}}\n"
