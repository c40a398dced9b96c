"""Measure the emulated rig: a whole sample of 875 frames, against the noise of as many pixels.

``python benchmarks/rig_emulator.py`` writes ``benchmarks/results/rig_emulator.json``. The rig is the one of ``brdfpipe rig new``, with 150
fibres and all effects; the sample is a plastic with a coloured body. 35 wavelengths × 5 incidences × 5 frames of a bracket, on one
core, without serial lines and files. Two requirements are judged:

* at most 20 s of processor time;
* at most 3 times as long as drawing the photons and the read noise of frames of the same brightness, which no emulator can spare.
"""

from __future__ import annotations

import json
import os
import platform
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import click
import numpy as np
import profiling
import xarray as xr

from brdfpipe import facets, vocabulary
from brdfpipe.bsdf import microfacet
from brdfpipe.bsdf.base import Representation
from brdfpipe.bsdf.registry import representation
from brdfpipe.rig.emulator.effects import Effects
from brdfpipe.rig.emulator.emulated_rig import EmulatedRig
from brdfpipe.rig.plan import Plan
from brdfpipe.rig.templates import start

PROJECT = Path(__file__).resolve().parents[1]
SECONDS_LIMIT = 20.0
FLOORS_LIMIT = 3.0
FIBRES = 150
FLOOR_EVERY = 25

Record = dict[str, Any]


@click.command()
@click.option(
    "--out", type=click.Path(path_type=Path), default=PROJECT / "benchmarks" / "results" / "rig_emulator.json"
)
def main(out: Path) -> None:
    """Time a sample's frames, and say where the time goes."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    with tempfile.TemporaryDirectory() as folder:
        plan = Plan.load(start(Path(folder), FIBRES))
    summary: Record = {
        "machine": f"{platform.machine()}, Python {platform.python_version()}, numpy {np.__version__}, one core"
    }
    summary |= measure(plan)
    summary["goes_to"] = profile(plan)
    summary["seconds_met"] = summary["seconds"] <= SECONDS_LIMIT
    summary["floors_met"] = summary["floors"] <= FLOORS_LIMIT
    print(as_text(summary))
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    if not (summary["seconds_met"] and summary["floors_met"]):
        sys.exit("a requirement is not met")


# --- what is measured


def sample() -> Representation:
    """A plastic of slope rms 0.1 per axis with a reflectance that rises towards the red."""
    wavelength = np.arange(380.0, 741.0, 5.0)
    spectrum = xr.Dataset(
        {"total_reflectance": ("wavelength", 0.1 + 0.001 * (wavelength - 380))},
        coords={"wavelength": wavelength},
        attrs={"geometry": "sci", "theta_i": 8.0, "method": "synthetic", "residual_delta_e": 0.0},
    )
    slopes = facets.analytic("beckmann", a=0.1 * 2**0.5)
    labelled = vocabulary.label(spectrum, "spectrum")
    return representation(microfacet.build(slopes, index=1.5, spectrum=labelled, multiple_scattering="none"))


def measure(plan: Plan) -> Record:
    """Processor time of all frames, the first of each incidence included; and of their noise alone."""
    truth, noise = sample(), np.random.default_rng(1)
    begin = time.process_time()
    stand = EmulatedRig(plan.rig, truth)
    total, floor, frames, drawn = time.process_time() - begin, 0.0, 0, 0
    for incidence in plan.incidences:
        stand.set_entrance(incidence)
        for wavelength in plan.wavelengths:
            for step in plan.bracket:
                begin = time.process_time()
                stand.monochromator.restore(wavelength)
                stand.wheel.restore(step.position)
                counts = stand.camera.expose(step.exposure).counts
                total += time.process_time() - begin
                frames += 1
                if frames % FLOOR_EVERY == 0:
                    electrons = plan.rig.camera.gain * np.maximum(counts - Effects().bias, 0.0)
                    begin = time.process_time()
                    _ = noise.poisson(electrons) + noise.standard_normal(electrons.shape)
                    floor += time.process_time() - begin
                    drawn += 1
    floor *= frames / drawn
    return {
        "frames": frames,
        "seconds": round(total, 2),
        "frames_per_second": round(frames / total, 1),
        "floor_s": round(floor, 2),
        "floors": round(total / floor, 2),
    }


def profile(plan: Plan) -> list[Record]:
    """The package's functions that take the most time in one incidence. Element-wise numpy counts as their own."""
    stand = EmulatedRig(plan.rig, sample())
    stand.set_entrance(plan.incidences[0])

    def frames() -> None:
        for wavelength in plan.wavelengths:
            for step in plan.bracket:
                stand.monochromator.restore(wavelength)
                stand.wheel.restore(step.position)
                stand.camera.expose(step.exposure)

    return profiling.profile(frames)[: profiling.MOST]


# --- what a person reads


def as_text(summary: Record) -> str:
    """The table a person reads."""
    met = {True: "met", False: "NOT met"}
    lines = profiling.lines(summary["goes_to"])
    lines.append(
        f"{summary['frames']} frames in {summary['seconds']:.1f} s, {summary['frames_per_second']:.0f} a second, "
        f"at most {SECONDS_LIMIT:.0f} s: {met[summary['seconds_met']]}"
    )
    lines.append(
        f"their noise alone takes {summary['floor_s']:.1f} s; {summary['floors']:.1f} times that, "
        f"at most {FLOORS_LIMIT:.0f}: {met[summary['floors_met']]}"
    )
    return "\n".join([*lines, summary["machine"]])


if __name__ == "__main__":
    main()
