"""The accuracy and the cost of every model of a surface: each rung of the ladder from Lambert + Gauss to traced rays, on four own maps.

``python benchmarks/accuracy.py`` builds every rung from the same heights, compares it with a reference solution of many rays, or with
diffraction where rays do not hold, and writes ``docs/accuracy.md``. Times are of the processor, of one thread, after compilation.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np
import xarray as xr

from brdfpipe import installation, store, vocabulary
from brdfpipe.bsdf import kirchhoff, traced
from brdfpipe.bsdf.lambert_gauss_fit import fit_lambert_gauss
from brdfpipe.bsdf.microfacet import interreflection
from brdfpipe.bsdf.microfacet.builder import build as build_facets
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.wave.builder import build as build_wave
from brdfpipe.comparison.model_error import model_error
from brdfpipe.errors import BrdfpipeError
from brdfpipe.facets.estimation import estimate
from brdfpipe.geometry import Array
from brdfpipe.masking.visibility_choice import choose
from brdfpipe.psd.estimation import estimate as roughness_spectrum

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import relief_maps
import samples

INDEX = 1.5
SIZE = 256
REFERENCE_RAYS = 600_000
"""Rays of the reference, of six incidences together."""
DIRECTIONS = 200_000
PEAK_ANGLES, GLOSS_ANGLES = (0.0, 60.0, 75.0), (20.0, 60.0, 85.0)


def _smooth(size: int) -> xr.Dataset:
    height = relief_maps.gaussian(0.1, size, 0, length=10.0)
    return samples.surface(height / height.std() * 0.05, (0.5, 0.5))


SMOOTH_MAP = "smooth: σ = 50 nm, ℓ = 5 µm"
"""The map whose heights are a fraction of the wavelength: a surface of waves, not of facets"""

MAPS: Mapping[str, Callable[[int], xr.Dataset]] = {
    "rough: Gaussian, slope 0.3": lambda size: samples.surface(relief_maps.gaussian(0.3, size, 0)),
    "cells with valleys": lambda size: samples.surface(relief_maps.cells(size, 0)),
    "ridges with a lay": lambda size: samples.surface(relief_maps.ridges(size, 0)),
    SMOOTH_MAP: _smooth,
}


def _facets(surface: xr.Dataset, **modes: str) -> xr.Dataset:
    facets = estimate(surface)
    return build_facets(facets, index=INDEX, interreflection=_reflections(surface, facets, modes), **modes)


def _reflections(surface: xr.Dataset, facets: xr.Dataset, modes: Mapping[str, str]) -> xr.Dataset | None:
    """Light reflected more than once, traced on the map, if the modes ask for it."""
    mode = modes.get("multiple_scattering", "auto")
    if mode not in ("auto", "measured"):
        return None
    return interreflection.choose(surface, facets, index=INDEX, multiple_scattering=mode)


def _measured_masking(surface: xr.Dataset, **modes: str) -> xr.Dataset:
    facets = estimate(surface)
    visibility = choose(surface, facets, masking="measured")
    return build_facets(facets, index=INDEX, masking="measured", visibility=visibility, **modes)


def _lambert_gauss(surface: xr.Dataset) -> xr.Dataset:
    fitted = fit_lambert_gauss(
        _facets(surface, multiple_scattering="none"), np.array([0.0, 10, 20, 30, 40, 50, 60, 70, 75, 80, 85])
    )
    return vocabulary.label(fitted.assign(n=INDEX, k=0.0), "bsdf")


def _waves(surface: xr.Dataset, optics: str, **modes: str) -> xr.Dataset:
    spectrum = roughness_spectrum(surface)
    if optics == "wave":
        return build_wave(spectrum, index=INDEX, optics=optics)
    facets = estimate(surface)
    visibility = choose(surface, facets)
    traced_light = _reflections(surface, facets, modes)
    predicted = build_facets(facets, index=INDEX, visibility=visibility, interreflection=traced_light, **modes)
    return build_wave(spectrum, index=INDEX, facets=facets, predicted=predicted, visibility=visibility, optics=optics)


RUNGS: Mapping[str, Callable[[xr.Dataset], xr.Dataset]] = {
    "Lambert + Gauss, fitted to facets": _lambert_gauss,
    "facets": partial(_facets, multiple_scattering="none"),
    "facets, masking measured": partial(_measured_masking, multiple_scattering="none"),
    "facets, second reflections directional": partial(_facets, multiple_scattering="directional"),
    "facets, second reflections measured": partial(_facets, multiple_scattering="measured"),
    "facets, masking measured, second reflections directional": partial(
        _measured_masking, multiple_scattering="directional"
    ),
    "wave": partial(_waves, optics="wave"),
    "composite": partial(_waves, optics="composite", multiple_scattering="none"),
    "auto (the default)": partial(_waves, optics="auto"),
    "auto, one reflection": partial(_waves, optics="auto", multiple_scattering="none"),
    "auto, second reflections directional": partial(_waves, optics="auto", multiple_scattering="directional"),
    "traced, 10⁴ rays an incidence": partial(traced.build, index=INDEX, rays=10**4, seed=7),
    "traced, 10⁵ rays": partial(traced.build, index=INDEX, rays=10**5, seed=7),
    "traced, 3·10⁵ rays": partial(traced.build, index=INDEX, rays=3 * 10**5, seed=7),
    "kirchhoff": partial(kirchhoff.build, index=INDEX),
}

KEYS: Mapping[str, str] = {
    "Lambert + Gauss, fitted to facets": "the file `lambert_gauss.csv`",
    "facets": "`optics: facets`, `masking: height-correlated`, `multiple_scattering: none`",
    "facets, masking measured": "`optics: facets`, `masking: measured`, `multiple_scattering: none`",
    "facets, second reflections directional": "`optics: facets`, `masking: height-correlated`, `multiple_scattering: directional`",
    "facets, second reflections measured": "`optics: facets`, `masking: height-correlated`, `multiple_scattering: measured`",
    "facets, masking measured, second reflections directional": "`optics: facets`, `masking: measured`, `multiple_scattering: directional`",
    "wave": "`optics: wave`",
    "composite": "`optics: composite`, `multiple_scattering: none`",
    "auto (the default)": "none, or `optics: auto`, `masking: auto`, `multiple_scattering: auto`",
    "auto, one reflection": "`multiple_scattering: none`",
    "auto, second reflections directional": "`multiple_scattering: directional`",
    "traced": "`truth: use`, where rays hold; of 10⁶ rays an incidence",
    "kirchhoff": "`truth: use`, where diffraction holds and rays do not",
}
"""Rung → keys of ``model`` in material.yaml."""


class Measured(NamedTuple):
    """One rung on one map."""

    rung: str
    build: float = np.nan
    """s"""
    rate: float = np.nan
    """million directions/s, one wavelength"""
    size: float = np.nan
    """kB"""
    peak: Array = np.full(len(PEAK_ANGLES), np.nan)
    """Relative error of the light in the peak, the largest of the planes of incidence"""
    gloss: Array = np.full(len(GLOSS_ANGLES), np.nan)
    """Error in gloss units, the same"""
    refusal: str = ""


def measure(rung: str, surface: xr.Dataset, folder: Path) -> Measured:
    """Build one rung, evaluate it, store it, and compare it with the reference solution that holds."""
    start = time.process_time()
    try:
        bsdf = vocabulary.validate(RUNGS[rung](surface), "bsdf")
    except BrdfpipeError as error:
        return Measured(rung, refusal=str(error))
    build = time.process_time() - start
    file = folder / "bsdf.nc"
    # The index that makes a fit comparable is not part of its file.
    stored = bsdf.drop_vars(["n", "k"]) if bsdf.attrs["representation"] == "lambert_gauss" else bsdf
    store.save_dataset(stored, file, stage="bsdf", material="map")
    reduced = nonspectral(bsdf)
    result = model_error(surface, reduced, rays=REFERENCE_RAYS, seed=1000)
    return Measured(rung, build, _rate(reduced), file.stat().st_size / 1e3, *_errors(result))


def _rate(bsdf: xr.Dataset) -> float:
    rng, evaluator = np.random.default_rng(0), representation(bsdf)
    theta_i, theta_o = np.degrees(np.arccos(rng.random((2, DIRECTIONS))))
    phi_i, phi_o = 360 * rng.random((2, DIRECTIONS))
    times = []
    for _ in range(4):
        start = time.process_time()
        evaluator.evaluate(theta_i, phi_i, theta_o, phi_o, None)
        times.append(time.process_time() - start)
    return DIRECTIONS / min(times) / 1e6


def _errors(result: xr.Dataset) -> tuple[Array, Array]:
    """Largest errors over the planes of incidence, of traced rays where they hold, else of diffraction."""

    def chosen(name: str, valid: str) -> xr.DataArray:
        values = result[name].where(result[valid] > 0)
        by_rays, by_diffraction = (values.sel(reference=one, drop=True) for one in ("traced", "kirchhoff"))
        either = by_rays.fillna(by_diffraction)
        largest = abs(either).fillna(-1.0).argmax("plane")
        return either.isel(plane=largest)

    light = chosen("light_error", "valid").sel(region="peak", theta_i=list(PEAK_ANGLES))
    return light.values, chosen("gloss_error", "gloss_valid").sel(gloss_angle=list(GLOSS_ANGLES)).values


def report(results: Mapping[str, list[Measured]], size: int = SIZE) -> str:
    """The page of the documentation."""
    lines = [
        "# Accuracy and cost of the models",
        "",
        f"`make accuracy` writes this page. Every model is built from the same heights ({size}² of them, n = {INDEX:g}, no diffuse part), and compared with "
        f"{REFERENCE_RAYS / 6e6:g} million rays an incidence, or with diffraction on the map where rays do not hold.",
        "",
        "- Errors: predicted less reference. Peak: light above 0.3 of the largest predicted value, %. Gloss: gloss units. On ridges, the larger of along and across.",
        "- Build: from the heights, processor seconds of one core after compilation. Evaluation: million directions a second, one wavelength. The machine was in use.",
        "- The models `traced` meet a reference of other rays on the same map: their error is that of their number and table. – : no reference holds.",
        "",
        "[How a model is chosen](model.md#how-far-a-prediction-can-be-trusted) and [where a reference holds](model.md#the-error-of-a-model) say which to take.",
        "",
        "## Speed against accuracy",
        "",
        f"Each figure is the worst of its maps: the error furthest from 0 (peak at {_degrees(PEAK_ANGLES)}, gloss at {_degrees(GLOSS_ANGLES)}), the longest build and the "
        "slowest evaluation. Rough maps are those of facets, the smooth one is that of waves.",
        "",
        "| Model | Build, s | Evaluation, 10⁶/s | Peak, rough | Gloss, rough | Peak, smooth | Gloss, smooth |",
        "|---|---|---|---|---|---|---|",
        *_summary(results),
    ]
    lines += ["", "| Model | Keys of `model` in material.yaml |", "|---|---|"]
    lines += [f"| {rung} | {keys} |" for rung, keys in KEYS.items()]
    for name, rows in results.items():
        lines += ["", f"## {name[0].upper()}{name[1:]}", ""]
        lines += [
            "| Model | Build, s | Evaluation, 10⁶/s | File, kB | Peak, 0 / 60 / 75° | Gloss, 20 / 60 / 85° |",
            "|---|---|---|---|---|---|",
        ]
        lines += [_row(row) for row in rows]
        refused = [f"- **{row.rung}** is refused: {row.refusal}." for row in rows if row.refusal]
        lines += ["", *refused] if refused else []
    return "\n".join(lines) + "\n"


def _degrees(angles: tuple[float, ...]) -> str:
    return " / ".join(f"{angle:g}" for angle in angles) + "°"


def _summary(results: Mapping[str, list[Measured]]) -> Iterator[str]:
    """One row for each model: its cost, and its worst errors on the rough maps and on the smooth one."""
    for number, rung in enumerate(row.rung for row in next(iter(results.values()), [])):
        built = {name: rows[number] for name, rows in results.items() if not rows[number].refusal}
        smooth = [row for name, row in built.items() if name == SMOOTH_MAP]
        rough = [row for name, row in built.items() if name != SMOOTH_MAP]
        errors = []
        for rows in (rough, smooth):
            peak, gloss = ([value for row in rows for value in getattr(row, what)] for what in ("peak", "gloss"))
            errors += [_worst(100 * np.array(peak), 1), _worst(np.array(gloss), 2)]
        all_rough = len(results) - (SMOOTH_MAP in results)
        if 0 < len(rough) < all_rough:
            errors[0] += f" ({len(rough)} of {all_rough} maps)"
        cost = (
            f"{max(row.build for row in built.values()):.2g} | {min(row.rate for row in built.values()):.2g}"
            if built
            else "– | –"
        )
        yield f"| {rung} | {cost} | {' | '.join(errors)} |"


def _worst(errors: Array, decimals: int) -> str:
    """The error that is furthest from 0."""
    known = errors[np.isfinite(errors)]
    return _signed(known[np.abs(known).argmax()] if known.size else np.nan, decimals)


def _row(row: Measured) -> str:
    if row.refusal:
        return f"| {row.rung} | – | – | – | refused | refused |"
    peak = " / ".join(_signed(100 * value, 1) for value in row.peak)
    gloss = " / ".join(_signed(value, 2) for value in row.gloss)
    return f"| {row.rung} | {row.build:.2g} | {row.rate:.2g} | {row.size:.0f} | {peak} | {gloss} |"


def _signed(value: float, decimals: int) -> str:
    return "–" if not np.isfinite(value) else f"{value:+.{decimals}f}".replace("-", "−")


@click.command(help=__doc__)
@click.option("--size", default=SIZE, show_default=True, help="Heights along each axis of a map.")
@click.option("--only", multiple=True, help="Part of the name of a map; default all.")
@click.option("--page", type=click.Path(path_type=Path), help="File to write; default docs/accuracy.md.")
def main(size: int, only: tuple[str, ...], page: Path | None) -> None:
    results: dict[str, list[Measured]] = {}
    warm = samples.gaussian_surface(64)
    for rung in ("facets, masking measured", "facets, second reflections measured", "traced, 10⁴ rays an incidence"):
        RUNGS[rung](warm)
    for name, make in MAPS.items():
        if only and not any(part in name for part in only):
            continue
        surface = make(size)
        with tempfile.TemporaryDirectory() as folder:
            results[name] = []
            for rung in RUNGS:
                results[name].append(measure(rung, surface, Path(folder)))
                click.echo(f"{name}: {_row(results[name][-1])}")
    (page or installation.project_folder() / "docs" / "accuracy.md").write_text(report(results, size), encoding="utf-8")


if __name__ == "__main__":
    main()
