"""From any BSDF to a table: only what a scene or an exchange format asks for."""

from __future__ import annotations

import json
from collections.abc import Mapping

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from brdfpipe import vocabulary
from brdfpipe.bsdf import representations
from brdfpipe.bsdf.table import AXES
from brdfpipe.errors import VocabularyError
from brdfpipe.geometry import Array, check_angles

WARN_LIMIT, FAIL_LIMIT = 0.05, 0.5
"""Relative difference between the reflectance of the grid and of the model above which a table warns, or fails."""

_OFFSETS = np.array([0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 7.0, 10.0, 15.0])


def tabulate(bsdf: xr.Dataset, grid: Mapping[str, ArrayLike]) -> xr.Dataset:
    """Evaluate an isotropic BSDF on a grid.

    Parameters
    ----------
    bsdf : kind ``bsdf``
    grid : ``theta_i``, ``theta_o`` [degree, 0 to 90], ``phi_o`` [degree, about phi_i = 0]: increasing lists. Between the nodes
        the table is interpolated linearly, so a lobe narrower than the steps is lost: the table says how much

    Returns
    -------
    Dataset of kind ``bsdf``, representation ``table``: ``brdf(theta_i, theta_o, phi_o[, wavelength])``, the reflectance of
        the grid ``grid_albedo(theta_i[, wavelength])`` and of the model ``model_albedo``, so that their difference tells
        what the grid leaves out

    Raises
    ------
    VocabularyError : an axis is missing, not increasing or out of range.
    """
    vocabulary.validate(bsdf, "bsdf")
    axes = {name: _axis(grid, name) for name in AXES}
    theta_i, theta_o, phi_o = np.meshgrid(*axes.values(), indexing="ij")
    module = representations.representation(bsdf)
    brdf = module.evaluate(bsdf, theta_i, np.zeros_like(theta_i), theta_o, phi_o, None)
    of_model = representations.albedo(bsdf, axes["theta_i"], np.zeros_like(axes["theta_i"]), None)
    of_grid = _grid_albedo(brdf, axes["theta_o"], axes["phi_o"])
    spectral = ("wavelength",) if "wavelength" in bsdf.coords else ()
    if not spectral:
        brdf, of_model, of_grid = brdf[..., 0], of_model[..., 0], of_grid[..., 0]
    reflectance = {"units": "1"}
    table = xr.Dataset(
        {
            "brdf": ((*AXES, *spectral), brdf),
            "grid_albedo": (
                ("theta_i", *spectral),
                of_grid,
                {**reflectance, "long_name": "directional reflectance of the grid, by its own trapezoidal integral"},
            ),
            "model_albedo": (
                ("theta_i", *spectral),
                of_model,
                {**reflectance, "long_name": "directional reflectance of the model"},
            ),
        },
        coords=axes,
        attrs={"representation": "table", "source_representation": bsdf.attrs["representation"]},
    )
    for name in ("total_reflectance", "theta_m"):
        if name in bsdf:
            table[name] = bsdf[name].drop_vars("theta_i", errors="ignore")
    return vocabulary.label(_with_verdict(table), "bsdf")


def faithful_table(bsdf: xr.Dataset, grid: Mapping[str, ArrayLike]) -> xr.Dataset:
    """A table on the grid, or, where the grid is too coarse for the lobe, on one refined about the mirror directions."""
    table = tabulate(bsdf, grid)
    return table if verdict_of(table) == "pass" else tabulate(bsdf, refined(bsdf, grid))


def relative_loss(table: xr.Dataset) -> xr.DataArray:
    """Relative difference between the reflectance of the grid and of the model; 0 where there is none to reflect."""
    difference = abs(table["grid_albedo"] - table["model_albedo"])
    return (difference / table["model_albedo"]).where(difference > 0, 0.0)


def verdict_of(table: xr.Dataset) -> str:
    """``pass``, ``warn`` or ``fail``: how well a table holds the reflectance of its model."""
    return str(json.loads(table.attrs["verdicts"])["table"]["verdict"])


def refined(bsdf: xr.Dataset, grid: Mapping[str, ArrayLike]) -> dict[str, Array]:
    """A grid with nodes added about the mirror directions, on the scale of the BSDF's lobe.

    Parameters
    ----------
    bsdf : kind ``bsdf``; one whose lobe is not known leaves the grid as it is
    grid : ``theta_i``, ``theta_o``, ``phi_o`` [degree], phi_o a full circle

    Returns
    -------
    dict of the same axes. A facet of slope s turns the mirror direction by 2s in the plane of incidence and by 2s cot θ_i in
    azimuth; nodes lie at half that for a typical slope, and at steps that widen from there.
    """
    axes = {name: _axis(grid, name) for name in AXES}
    scale = representations.lobe_slope(bsdf)
    if scale is None:
        return axes
    half = np.degrees(scale)
    steps = np.concatenate([[0.0], half * _OFFSETS])
    mirror = axes["theta_i"][:, None] + np.concatenate([-steps[:0:-1], steps])
    theta_o = np.concatenate([axes["theta_o"], mirror[(mirror > 0) & (mirror < 89.9)]])
    steepest = np.radians(max(axes["theta_i"].max(), 1.0))
    narrowest = np.degrees(2 * scale / np.tan(steepest)) * _OFFSETS[0]
    about = np.concatenate(
        [[0.0], np.geomspace(narrowest, 60, max(2, int(np.ceil(np.log(60 / narrowest) / np.log(1.6)))))]
    )
    phi_o = np.concatenate([axes["phi_o"], 180 - about, 180 + about]) if narrowest < 30 else axes["phi_o"]
    return {
        "theta_i": axes["theta_i"],
        "theta_o": _distinct(theta_o, half / 8),
        "phi_o": _distinct(phi_o, narrowest / 2),
    }


def _distinct(nodes: Array, apart: float) -> Array:
    """Nodes in order, without those closer to their neighbour than ``apart`` or than half a thousandth of a degree."""
    ordered = np.unique(np.round(nodes, 4))
    keep = np.concatenate([[True], np.diff(ordered) > min(max(apart, 5e-4), 0.2)])
    keep[-1] = True
    return ordered[keep]


def full_circle(half: ArrayLike) -> Array:
    """Azimuths from 0 to 180 degree, mirrored about the plane of incidence to 360.

    Raises
    ------
    VocabularyError : they do not increase from 0 to 180.
    """
    phi = check_angles("phi_o", half, 0, 180)
    if phi.ndim != 1 or phi.size < 2 or phi[0] != 0 or phi[-1] != 180 or not (np.diff(phi) > 0).all():
        raise VocabularyError("phi_o of the grid must increase from 0 to 180; set `table.phi_o` in the configuration")
    return np.concatenate([phi, 360 - phi[-2::-1]])


def _axis(grid: Mapping[str, ArrayLike], name: str) -> Array:
    if name not in grid:
        raise VocabularyError(f"the grid needs {name!r}; found {', '.join(grid)}")
    low, high = (-360, 360) if name == "phi_o" else (0, 90)
    values = check_angles(name, grid[name], low, high)
    if values.ndim != 1 or values.size < 2 or not (np.diff(values) > 0).all():
        raise VocabularyError(f"{name} of the grid must be an increasing list of at least two angles")
    return values


def _grid_albedo(brdf: Array, theta_o: Array, phi_o: Array) -> Array:
    """∫ BRDF cos θ_o dω_o by the trapezoidal rule on the grid, completed to a full circle; the last polar node extends to 90."""
    theta = np.radians(np.append(theta_o, 90.0) if theta_o[-1] < 90 else theta_o)
    projected = brdf * (np.sin(np.radians(theta_o)) * np.cos(np.radians(theta_o)))[:, None, None]
    if theta.size > theta_o.size:
        projected = np.concatenate([projected, np.zeros_like(projected[:, :1])], axis=1)
    over_phi = np.trapezoid(projected, np.radians(phi_o), axis=2) * (360 / (phi_o[-1] - phi_o[0]))
    return np.asarray(np.trapezoid(over_phi, theta, axis=1))


def _with_verdict(table: xr.Dataset) -> xr.Dataset:
    """Say how well the grid holds the model: programs that read a table believe its own integral."""
    lost = relative_loss(table)
    by_incidence = lost.max("wavelength") if "wavelength" in lost.dims else lost
    worst, angle = float(by_incidence.max()), float(by_incidence.idxmax("theta_i"))
    text = f"its own integral differs from the model's reflectance by up to {worst:.1%} (at {angle:g}° incidence)"
    verdict = "fail" if worst > FAIL_LIMIT else "warn" if worst > WARN_LIMIT else "pass"
    table.attrs["verdicts"] = json.dumps({"table": {"verdict": verdict, "text": text}}, ensure_ascii=False)
    if verdict == "pass":
        return table
    return vocabulary.add_warning(
        table,
        f"the table's own integral differs from the model's reflectance by up to {worst:.1%} (at {angle:g}° incidence): the grid is "
        "too coarse for the lobe; use finer steps in the configuration's `table`, or `table.refine: true`",
    )
