"""Measure the evaluator: BRDF values a second and the time of a single call, against other implementations and against numpy.

``python benchmarks/evaluator.py`` writes ``benchmarks/results/evaluator.json``. Every case runs in a process of its own, on one
core. The material compared with the peers is isotropic, its facets counted on a rough map, its index constant, its diffuse part coupled,
at one wavelength; the directions are random over the hemisphere. Other materials have a lay, or an index and a diffuse part at 43 and at 85
wavelengths. The same directions, in calls of few enough for the arrays of numpy, are the floor on the same machine. A call with numbers
is timed for every representation, beside an exponential of numpy of an array of one number.

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
import rig_smoothing
import xarray as xr
from profiling import best, profile
from surfaces import SLOPE_RMS, rough_map

from brdfpipe import facets, flakes, optics, psd, vocabulary
from brdfpipe.bsdf import flake, kirchhoff, lambert_gauss, microfacet, slab, traced, wave
from brdfpipe.bsdf.measured import completion, smoothing

PROJECT = Path(__file__).resolve().parents[1]
WANTED = {"isotropic": 30e6, "with a lay": 5e6, "43 wavelengths": 100e6, "85 wavelengths": 100e6}
"""Values a second by material: directions times wavelengths."""
CALL_WANTED_MS = 0.3
ONE_PAIR = 30.0, 0.0, 30.0, 180.0
CALLS = 100
CORRELATION_LENGTH = 5.0
"""Of the roughness that scatters as waves do [um]."""
LAB = {"45:-30": (33.90, -7.58, -36.61), "45:0": (12.29, 1.19, -25.77), "45:65": (3.07, 2.09, -13.24)}
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
    speeds = summary["brdfpipe"]["materials"]
    summary["speed_met"] = all(speeds[name]["values_per_second"] >= least for name, least in WANTED.items())
    calls = summary["brdfpipe"]["one_call_ms"]
    summary["call_met"] = all(milliseconds <= CALL_WANTED_MS for milliseconds in calls.values())
    print(as_text(summary))
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    if not (summary["speed_met"] and summary["call_met"]):
        sys.exit("a requirement is not met")


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


def material(surface: xr.Dataset, wavelengths: int = 1) -> xr.Dataset:
    """A material of these facets, which reflect once; index and diffuse part depend on the wavelength if there are several."""
    wavelength = np.linspace(400.0, 700.0, wavelengths) if wavelengths > 1 else np.array([WAVELENGTH])
    spectrum = xr.Dataset(
        {"total_reflectance": ("wavelength", np.linspace(REFLECTANCE, 0.5, wavelengths))},
        coords={"wavelength": wavelength},
        attrs={"geometry": "sci", "theta_i": 8.0, "method": "synthetic", "residual_delta_e": 0.0},
    )
    index = optics.refractive_index(INDEX)
    if wavelengths > 1:
        cauchy = {"n": ("wavelength", 1.48 + 5000 / wavelength**2), "k": ("wavelength", np.zeros(wavelengths))}
        index = vocabulary.label(xr.Dataset(cauchy, {"wavelength": wavelength}, {"source": "synthetic"}), "index")
    labelled = vocabulary.label(spectrum, "spectrum")
    return microfacet.build(surface, index=index, spectrum=labelled, multiple_scattering="none")


def other_materials() -> dict[str, Callable[[], xr.Dataset]]:
    """A small material of each other representation; waves at three wavelengths."""
    rough, smooth, surface = facets.analytic("beckmann", a=0.3), facets.flat(), rough_map(128)
    spectrum = vocabulary.label(
        xr.Dataset(
            {"total_reflectance": ("wavelength", np.linspace(REFLECTANCE, 0.5, 3))},
            coords={"wavelength": [400.0, 550.0, 700.0]},
            attrs={"geometry": "sci", "theta_i": 8.0, "method": "synthetic", "residual_delta_e": 0.0},
        ),
        "spectrum",
    )

    def waves(sigma: float, **given: Any) -> xr.Dataset:
        slopes = facets.analytic("beckmann", a=2 * sigma / CORRELATION_LENGTH)
        heights = psd.analytic("gaussian", sigma=sigma, length=CORRELATION_LENGTH)
        return wave.build(heights, facets=slopes, index=INDEX, spectrum=spectrum, **{"optics": "auto", **given})

    def measured() -> xr.Dataset:
        return completion.complete(smoothing.smooth(rig_smoothing.sample().isel(wavelength=slice(5, None, 12))))

    def paint() -> xr.Dataset:
        colours = [{"geometry": name, "lab": list(lab)} for name, lab in LAB.items()]
        return flake.build(flakes.ingest({"colours": colours, "illuminant": "D65", "observer": 10}))

    angles = {"theta_i": np.arange(0, 90, 10.0), "theta_o": np.arange(0, 90, 5.0), "phi_o": np.arange(0, 361, 15.0)}
    return {
        "smooth": lambda: microfacet.build(smooth, index=INDEX, spectrum=spectrum),
        "waves": lambda: waves(0.013),
        "waves and facets": lambda: waves(0.2),
        "facets with finer roughness": lambda: waves(0.4, optics="composite"),
        "slab": lambda: slab.build(rough, smooth, index=INDEX, internal_transmittance=0.8),
        "flake": paint,
        "lambert_gauss": lambda: lambert_gauss.lambertian(spectrum),
        "kirchhoff": lambda: kirchhoff.build(
            surface.assign(height=surface["height"] * 0.05), index=INDEX, spectrum=spectrum
        ),
        "traced": lambda: traced.build(surface, index=INDEX, spectrum=spectrum, rays=20_000),
        "table": lambda: microfacet.build(
            rough, index=INDEX, spectrum=spectrum, multiple_scattering="none"
        ).bsdf.tabulate(angles),
        "rig": measured,
    }


def one_call(bsdf: xr.Dataset, repeats: int) -> float:
    """Processor time of a call with the angles of one pair of directions as numbers [ms]."""

    def calls() -> None:
        for _ in range(CALLS):
            bsdf.bsdf.evaluate(*ONE_PAIR)

    calls()
    return round(best(calls, repeats) / CALLS * 1e3, 4)


def ours(pairs: int, repeats: int) -> Record:
    """The accessor, from plain arrays to a labelled result; the same by numpy; and one exponential over as many numbers."""
    counted, brushed = counted_facets(), facets.analytic("beckmann", a_x=0.1, a_y=0.3, azimuth=25.0)
    materials = {
        "isotropic": material(counted),
        "with a lay": material(brushed),
        "43 wavelengths": material(counted, 43),
        "85 wavelengths": material(counted, 85),
    }
    where, exponents, one = directions(pairs), np.linspace(-20, 0, pairs), np.zeros(1)
    calls = {name: one_call(bsdf, repeats) for name, bsdf in materials.items()}
    calls |= {name: one_call(build(), repeats) for name, build in other_materials().items()}
    exponential = best(lambda: [np.exp(one) for _ in range(10 * CALLS)], repeats) / (10 * CALLS)
    speeds = {name: speed(bsdf, where, repeats) for name, bsdf in materials.items()}
    isotropic = materials["isotropic"]
    return {
        "per_second": speeds["isotropic"]["values_per_second"],
        "materials": speeds,
        "one_call_ms": calls,
        "one_exponential_us": round(exponential * 1e6, 3),
        "exponential_s": round(best(lambda: np.exp(exponents), repeats), 5),
        "goes_to": profile(lambda: isotropic.bsdf.evaluate(*where)),
    }


def speed(bsdf: xr.Dataset, where: Directions, repeats: int) -> Record:
    """Values a second of the kernel and of numpy's arrays."""
    wavelengths = bsdf.sizes["wavelength"]
    pairs = where[0].size // wavelengths
    several = tuple(angle[:pairs] for angle in where)
    few = tuple(angle[: 2**16 // wavelengths] for angle in where)
    bsdf.bsdf.evaluate(*several)  # compiled, or loaded from the compiler's cache
    seconds = best(lambda: bsdf.bsdf.evaluate(*several), repeats)
    by_numpy = best(lambda: bsdf.bsdf.evaluate(*few), 5 * repeats)
    return {
        "values_per_second": round(pairs * wavelengths / seconds),
        "numpy_values_per_second": round(few[0].size * wavelengths / by_numpy),
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
    lines.append(f"{'':24}{'million values/s':>18}{'wanted':>8}{'by numpy':>10}")
    for name, least in WANTED.items():
        record = own["materials"][name]
        found, by_numpy = (record[key] / 1e6 for key in ("values_per_second", "numpy_values_per_second"))
        lines.append(f"{name:24}{found:18.1f}{least / 1e6:8.0f}{by_numpy:10.1f}")
    lines += [f"{name:28}{found:10.3f} ms for one call" for name, found in own["one_call_ms"].items()]
    lines.append(f"one exponential of an array of one number takes {own['one_exponential_us']:.2f} us")
    lines.append(f"one exponential of numpy takes {own['exponential_s'] / summary['pairs'] * 1e9:.1f} ns")
    met = ["NOT met", "met"]
    lines.append(
        f"speed: {met[summary['speed_met']]}; a call of at most {CALL_WANTED_MS} ms: {met[summary['call_met']]}"
    )
    return "\n".join([*lines, summary["machine"]])


if __name__ == "__main__":
    main()
