"""From any BSDF to a table: only what a scene or an exchange format asks for."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from brdfpipe import vocabulary
from brdfpipe.bsdf import representations
from brdfpipe.bsdf.table import AXES
from brdfpipe.errors import VocabularyError
from brdfpipe.geometry import Array, check_angles


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
    return vocabulary.label(_with_warning(table), "bsdf")


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


def _with_warning(table: xr.Dataset) -> xr.Dataset:
    lost = abs(table["grid_albedo"] / table["model_albedo"].where(table["model_albedo"] > 0) - 1)
    by_incidence = lost.max("wavelength") if "wavelength" in lost.dims else lost
    worst = float(by_incidence.max())
    if worst <= 0.05:
        return table
    angle = float(by_incidence.idxmax("theta_i"))
    return vocabulary.add_warning(
        table,
        f"the table's own integral differs from the model's reflectance by up to {worst:.1%} (at {angle:g}° incidence): the grid is "
        "too coarse for the lobe; use finer steps in the configuration's `table`",
    )
