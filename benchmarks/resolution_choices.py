"""What a finer grid of a table, more digits and more of a scan cost in time and bytes, and give in accuracy."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import xarray as xr
from choice_table import Choice, Metric, Option, largest, rms, timed

from brdfpipe.appearance.gloss_meter import gloss
from brdfpipe.bsdf import approximation_error
from brdfpipe.bsdf.microfacet.builder import build as build_facets
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.tabulation import refined, tabulate
from brdfpipe.facets.estimation import estimate
from brdfpipe.geometry import Array
from brdfpipe.masking.visibility_choice import choose

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import relief_maps
import samples

GLOSS_ANGLES = (20.0, 60.0, 85.0)


def facet_bsdf(slope: float) -> xr.Dataset:
    """Facets of normally distributed slopes of an rms along one axis over a diffuse base, without wavelength."""
    return nonspectral(samples.beckmann_bsdf(slope, n=1.5, reflectance=0.3))


# --- the grid of a table

_NEAR = (0.0, 20.0, 45.0, 65.0)
"""Incidences next to which tables are compared, midway between their own nodes [degree]."""


def grid_of_a_table() -> Choice:
    """The angular step of a table."""
    slopes = (0.03, 0.1, 0.3)
    grids: dict[str, Callable[[xr.Dataset], Mapping[str, Array]]] = {
        f"{step:g}° in all angles": lambda bsdf, step=step: _even_grid(step) for step in (10.0, 5.0, 2.5, 1.25)
    }
    grids["2.5°, refined about the mirror directions"] = lambda bsdf: refined(bsdf, _even_grid(2.5, turn=360.0))
    grids["specular-centred, 40 × 25 nodes an incidence"] = lambda bsdf: _specular_grid(2.5)
    grids["half-angle, 45 × 37 × 37 nodes"] = lambda bsdf: _half_grid()
    found: dict[str, list[tuple[float, float, float]]] = {name: [] for name in grids}
    # The first call of so many directions loads compiled code.
    tabulate(facet_bsdf(slopes[0]), _even_grid(1.25))
    seconds: dict[str, float] = dict.fromkeys(grids, 0.0)
    sizes: dict[str, float] = dict.fromkeys(grids, 0.0)
    for slope in slopes:
        bsdf = facet_bsdf(slope)
        units = gloss(bsdf, GLOSS_ANGLES).values
        for name, grid in grids.items():
            table, took = timed(lambda grid=grid, bsdf=bsdf: tabulate(bsdf, grid(bsdf)))
            misfits = [
                _misfit(table, bsdf, angle)
                for angle in _between_nodes(grid(bsdf).get("theta_i", _even_grid(2.5)["theta_i"]))
            ]
            found[name].append(
                (
                    rms([one.rms for one in misfits]),
                    largest([one.reflectance for one in misfits]),
                    largest(gloss(table, GLOSS_ANGLES).values - units),
                )
            )
            seconds[name] += took / len(slopes)
            sizes[name] += table["brdf"].nbytes / len(slopes)
    options = []
    for name in grids:
        errors = {}
        for slope, (shape, _albedo, units) in zip(slopes, found[name], strict=True):
            errors |= {
                f"slope {slope:g}: BRDF·cos θ": shape,
                f"slope {slope:g}: gloss": units,
            }
        errors["albedo"] = largest([albedo for _, albedo, _ in found[name]])
        options.append(Option(name, "the lobe between the nodes", errors, {"tabulate": seconds[name]}, sizes[name]))
    return Choice(
        "Grid of a table",
        f"Tables of facets of normal slopes (rms along one axis as named) over a diffuse base, at incidences midway between the nodes above {', '.join(f'{angle:g}' for angle in _NEAR)}°, "
        "against the BSDF itself: error weighted with light, over the BRDF so weighted; rms; the largest relative error of the albedo of the three slopes; the largest error of gloss "
        "at 20, 60 and 85°, of which most grids have nodes. The time includes the comparison of the table with its model that every table has.",
        {name: Metric("GU", 0.01) if name.endswith("gloss") else Metric("%", 1e-4) for name in options[0].errors},
        "2.5° in all angles",
        options,
    )


def _even_grid(step: float, turn: float = 180.0) -> dict[str, Array]:
    polar = np.append(np.arange(0.0, 89.0, step), 89.0)
    return {"theta_i": polar, "theta_o": polar, "phi_o": np.arange(0.0, turn + step / 2, step)}


def _between_nodes(nodes: Array) -> list[float]:
    first = np.searchsorted(nodes, _NEAR, side="right") - 1
    return list((nodes[first] + nodes[first + 1]) / 2)


def _specular_grid(step: float) -> dict[str, Array]:
    away = np.append(0.0, np.geomspace(0.25, 160.0, 39))
    return {"theta_i": _even_grid(step)["theta_i"], "theta_s": away, "phi_s": np.linspace(0.0, 180.0, 25)}


def _half_grid() -> dict[str, Array]:
    return {
        "theta_h": 90 * np.linspace(0.0, 1.0, 45) ** 2,
        "theta_d": np.append(np.arange(0.0, 89.0, 2.5), 89.0),
        "phi_d": np.linspace(0.0, 180.0, 37),
    }


def _misfit(candidate: xr.Dataset, reference: xr.Dataset, theta_i: float) -> approximation_error.Misfit:
    rule = approximation_error.directions(reference, theta_i)
    values = (approximation_error.brdf_at(one, theta_i, 0.0, rule)[:, 0] for one in (candidate, reference))
    return approximation_error.misfit(rule.weight, *values)


# --- precision


def precision() -> Choice:
    """What is lost by storing a table, a BSDF or angles in fewer digits."""
    bsdf = facet_bsdf(0.1)
    rng = np.random.default_rng(0)
    number = 2**20
    theta_i, theta_o = np.degrees(np.arccos(rng.random((2, number))))
    phi_i, phi_o = 360 * rng.random((2, number))
    # Half of the directions close to the mirror direction, where the BRDF is steep.
    near = slice(None, number // 2)
    theta_o[near] = np.clip(theta_i[near] + 8 * rng.standard_normal(number // 2), 0, 89.9)
    phi_o[near] = phi_i[near] + 180 + 8 * rng.standard_normal(number // 2)
    lowest = np.minimum(90 - theta_i, 90 - theta_o) > 1
    at = tuple(angle[lowest] for angle in (theta_i, phi_i, theta_o, phi_o))
    table = tabulate(bsdf, _even_grid(2.5))
    forms = {
        "BSDF, 64 bits": ("", bsdf, at),
        "BSDF whose file has 32 bits": (
            "digits of the density, of masking and of albedo",
            _rounded(bsdf, np.float32),
            at,
        ),
        "BSDF at angles of 32 bits": (
            "digits of the directions",
            bsdf,
            tuple(np.float32(angle).astype(float) for angle in at),
        ),
        "table, 64 bits (used)": ("what the grid leaves out, not counted here", table, at),
        "table, 32 bits": ("the same, and digits", _rounded(table, np.float32), at),
        "table, 16 bits": ("the same, and digits", _rounded(table, np.float16), at),
    }
    values = {name: representation(one).evaluate(*angles, None)[:, 0] for name, (_, one, angles) in forms.items()}
    options = []
    for name, (text, one, angles) in forms.items():
        exact = values["table, 64 bits (used)" if name.startswith("table") else "BSDF, 64 bits"]
        bits = next(int(word) for word in name.replace(",", "").split() if word.isdigit())
        error = np.abs(values[name] / exact - 1)
        seconds = timed(lambda one=one, angles=angles: representation(one).evaluate(*angles, None), 5)[1]
        size = one.nbytes if "angles" in name else one.nbytes * bits / 64
        errors = {"rms": rms(error), "largest": largest(error)}
        options.append(Option(name, text, errors, {"10⁶ directions": seconds * 1e6 / len(at[0])}, size))
    return Choice(
        "Precision",
        "Every evaluation is in 64 bits: there is no evaluator of 32, so that fewer bits save bytes alone, and the times differ by the representation. Relative error "
        "of the BRDF of facets (slope 0.1) over a diffuse base at random pairs of directions more than 1° above the horizon, half of them near the mirror direction; tables against "
        "the table in 64 bits. Bytes in memory of that many bits.",
        {name: Metric("", 1e-15) for name in ("rms", "largest")},
        "BSDF, 64 bits",
        options,
    )


def _rounded(dataset: xr.Dataset, kind: type) -> xr.Dataset:
    """The dataset as it returns from a file with fewer bits."""
    numbers = {name: one.astype(kind).astype(float) for name, one in dataset.data_vars.items() if one.dtype.kind == "f"}
    return dataset.assign(numbers)


# --- the share of a scan that is read

SCAN = 1024
_PLACES = 12


def share_of_a_scan() -> Choice:
    """Parts of a scan beside the whole."""
    maps = {
        "slope 0.1": relief_maps.gaussian(0.1, SCAN, 3),
        "GGX": relief_maps.ggx_like(SCAN, 3),
        "cells": relief_maps.cells(SCAN, 3),
    }
    shares = {"1": (1, 1), "1/2": (2, 1), "1/4": (2, 2), "1/16": (4, 4)}
    rng, whole = np.random.default_rng(5), {}
    options = []
    for name, (rows, columns) in shares.items():
        errors, seconds = {}, []
        for kind, height in maps.items():
            found = []
            for place in range(1 if name == "1" else _PLACES):
                size = SCAN // rows, SCAN // columns
                row, column = (int(rng.integers(SCAN - one + 1)) for one in size)
                part = height[row : row + size[0], column : column + size[1]]
                surface = samples.surface(part - part.mean())
                facets, density = timed(lambda surface=surface: estimate(surface))
                bsdf = build_facets(facets, index=1.5, masking="height-correlated", multiple_scattering="none")
                found.append(gloss(bsdf, GLOSS_ANGLES).values)
                if place == 0:
                    traced = timed(lambda surface=surface, facets=facets: choose(surface, facets, masking="measured"))[
                        1
                    ]
                    seconds.append((density, traced))
            whole.setdefault(kind, found[0])
            errors[f"{kind}: gloss, rms"] = rms(np.concatenate(found) - np.tile(whole[kind], len(found)))
        density, traced = np.mean(seconds, axis=0)
        times = {"slope density": float(density), "visibility": float(traced)}
        size = 8 * SCAN**2 / np.prod((rows, columns))
        options.append(Option(name, "" if name == "1" else "what is elsewhere", errors, times, float(size)))
    return Choice(
        "Share of the scan that is read",
        f"Connected parts of scans of {SCAN}² heights, correlated over 12, 10 to 60 and some 45 of them, at {_PLACES} random places; gloss at 20, 60 and 85° after Smith "
        "against that of the whole scan. The visibility is traced for as many facets of every share.",
        {name: Metric("GU", 0.01) for name in options[0].errors},
        "1",
        options,
    )
