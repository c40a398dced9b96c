"""Measure the evaluator: BRDF values a second, against other implementations and against one exponential.

``python benchmarks/evaluator.py`` writes ``benchmarks/results/evaluator.json``. Every case runs in a process of its own, on one
core. The material is isotropic, its facets counted on a rough map, its index constant, its diffuse part coupled, at one
wavelength; the directions are random over the hemisphere. One requirement is judged: 10 million evaluations a second.

The peers evaluate what comes nearest: pySCATMECH its facets from a table of as many slopes with shadowing, one pair of
directions a call, in double precision; Mitsuba its rough plastic with a Beckmann density and a coupled diffuse part, in bulk
through LLVM, in single precision. ``make peers`` installs them; LLVM has to be there.
"""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import numpy as np
import profiling
import xarray as xr
from profiling import best, profile
from surfaces import SLOPE_RMS, rough_map

from brdfpipe import facets, optics, vocabulary
from brdfpipe.bsdf import microfacet

PROJECT = Path(__file__).resolve().parents[1]
WANTED = 10e6
INDEX = 1.5
REFLECTANCE = 0.3
WAVELENGTH = 550.0

Record = dict[str, Any]
Directions = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


@click.command()
@click.option("--pairs", default=4_000_000, show_default=True, help="Pairs of directions.")
@click.option("--repeats", default=5, show_default=True, help="The best of so many runs counts.")
@click.option("--out", type=click.Path(path_type=Path), default=PROJECT / "benchmarks" / "results" / "evaluator.json")
@click.option("--case", type=click.Choice(["brdfpipe", "pySCATMECH", "mitsuba"]), hidden=True)
def main(pairs: int, repeats: int, out: Path, case: str | None) -> None:
    """Time the evaluator and its peers, and say where the time goes."""
    if case is not None:
        if hasattr(os, "sched_setaffinity"):
            os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
        print(json.dumps(CASES[case](pairs, repeats)))
        return
    machine = f"{platform.machine()}, Python {platform.python_version()}, numpy {np.__version__}, one core"
    summary: Record = {"machine": machine, "pairs": pairs}
    summary |= {name: in_own_process(name, pairs, repeats) for name in CASES}
    summary["speed_met"] = summary["brdfpipe"]["per_second"] >= WANTED
    print(as_text(summary))
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    if not summary["speed_met"]:
        sys.exit("the requirement is not met")


def in_own_process(case: str, pairs: int, repeats: int) -> Record:
    """One case, alone in a fresh process, on one core."""
    command = [sys.executable, __file__, "--case", case, "--pairs", str(pairs), "--repeats", str(repeats)]
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    done = subprocess.run(command, capture_output=True, text=True, check=False, env={**os.environ, **threads})
    if done.returncode:
        sys.exit(done.stderr)
    record: Record = json.loads(done.stdout.splitlines()[-1])
    return record


# --- what is measured


def directions(pairs: int) -> Directions:
    """Pairs of directions, uniform over the hemisphere [degree]."""
    rng = np.random.default_rng(1)
    theta_i, theta_o = np.degrees(np.arccos(1 - rng.random((2, pairs))))
    phi_i, phi_o = 360 * rng.random((2, pairs))
    return theta_i, phi_i, theta_o, phi_o


def counted_facets() -> xr.Dataset:
    """The facets of a rough map of 1024² heights."""
    return facets.estimate(rough_map(1024), isotropic=True)


def material() -> xr.Dataset:
    """The material that is evaluated."""
    spectrum = xr.Dataset(
        {"total_reflectance": ("wavelength", np.array([REFLECTANCE]))},
        coords={"wavelength": [WAVELENGTH]},
        attrs={"geometry": "sci", "theta_i": 8.0, "method": "synthetic", "residual_delta_e": 0.0},
    )
    index = optics.refractive_index(INDEX)
    return microfacet.build(counted_facets(), index=index, spectrum=vocabulary.label(spectrum, "spectrum"))


def ours(pairs: int, repeats: int) -> Record:
    """The accessor, from plain arrays to a labelled result; and one exponential over as many numbers."""
    bsdf, where = material(), directions(pairs)
    exponents = np.linspace(-20, 0, pairs)
    evaluate_s = best(lambda: bsdf.bsdf.evaluate(*where), repeats)
    return {
        "per_second": round(pairs / evaluate_s),
        "evaluate_s": round(evaluate_s, 4),
        "exponential_s": round(best(lambda: np.exp(exponents), repeats), 5),
        "goes_to": profile(lambda: bsdf.bsdf.evaluate(*where)),
    }


def scatmech(pairs: int, repeats: int) -> Record | None:
    """pySCATMECH, through its compiled entry: half a microsecond of Python an evaluation is not its own."""
    try:
        import SCATPY
        from pySCATMECH.brdf import BRDF_Model
    except ImportError:
        return None
    counted = counted_facets()
    model = BRDF_Model("Shadowed_Facet_BRDF_Model", wavelength=WAVELENGTH / 1000, substrate=f"({INDEX},0)")
    model.setParameters(shadow={None: "Smith_Shadow_Function", "w": SLOPE_RMS})
    with tempfile.NamedTemporaryFile("w", suffix=".txt") as table:
        np.savetxt(table, np.stack([counted["slope"], counted["slope_density"]], axis=1))
        table.flush()
        model.setParameters(sdf={None: "Table_Slope_Distribution_Function", "T": table.name})
    theta_i, phi_i, theta_o, phi_o = np.radians(directions(min(pairs, 100_000)))
    rows = np.stack([theta_i, theta_o, phi_o - phi_i], axis=1).tolist()

    def evaluate() -> None:
        for polar_i, polar_o, azimuth in rows:
            SCATPY.BRDF(model.handle, polar_i, polar_o, azimuth, 0.0, "psps")

    return {"per_second": round(len(rows) / best(evaluate, repeats))}


def mitsuba(pairs: int, repeats: int) -> Record | None:
    """Mitsuba's rough plastic, vectorised; directions are handed over before the clock starts."""
    try:
        import drjit
        import mitsuba

        mitsuba.set_variant("llvm_ad_mono")
        drjit.set_thread_count(1)
        theta_i, phi_i, theta_o, phi_o = np.radians(directions(pairs))
        w_i, w_o = (
            mitsuba.Vector3f(*np.float32([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)]))
            for theta, phi in ((theta_i, phi_i), (theta_o, phi_o))
        )
    except (ImportError, RuntimeError):
        return None
    plastic = {"type": "roughplastic", "distribution": "beckmann", "alpha": SLOPE_RMS * 2**0.5, "int_ior": INDEX}
    bsdf = mitsuba.load_dict(plastic | {"diffuse_reflectance": REFLECTANCE})
    interaction = drjit.zeros(mitsuba.SurfaceInteraction3f, pairs)
    interaction.wi = w_i
    drjit.eval(interaction, w_o)
    drjit.sync_thread()

    def evaluate() -> None:
        drjit.eval(bsdf.eval(mitsuba.BSDFContext(), interaction, w_o))
        drjit.sync_thread()

    return {"per_second": round(pairs / best(evaluate, repeats))}


CASES: dict[str, Callable[[int, int], Record | None]] = {"brdfpipe": ours, "pySCATMECH": scatmech, "mitsuba": mitsuba}


# --- what a person reads


def as_text(summary: Record) -> str:
    """The table a person reads."""
    own = summary["brdfpipe"]
    lines = profiling.lines(own["goes_to"])
    lines.append(f"{'':24}{'million/s':>10}{'brdfpipe is':>14}")
    for name in CASES:
        record = summary[name]
        if record is None:
            lines.append(f"{name:24}{'not there':>10}")
        else:
            ratio = own["per_second"] / record["per_second"]
            lines.append(f"{name:24}{record['per_second'] / 1e6:10.2f}{ratio:9.2f} times")
    lines.append(
        f"one evaluation takes as long as {own['evaluate_s'] / own['exponential_s']:.0f} exponentials of numpy"
    )
    met = "met" if summary["speed_met"] else "NOT met"
    lines.append(f"{own['per_second'] / 1e6:.1f} million a second, at least {WANTED / 1e6:.0f}: {met}")
    return "\n".join([*lines, summary["machine"]])


if __name__ == "__main__":
    main()
