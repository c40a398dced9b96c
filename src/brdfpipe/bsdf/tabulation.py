"""From any BSDF to a table: only what a scene or an exchange format asks for."""

from __future__ import annotations

import json
from collections.abc import Mapping

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from brdfpipe import vocabulary
from brdfpipe.bsdf import approximation_error as comparison
from brdfpipe.bsdf.grids import AZIMUTHS, GRIDS, Grid, kind_of
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.representations.table import AXES, Table
from brdfpipe.errors import VocabularyError
from brdfpipe.geometry import Array, check_angles

WARN_LIMIT, FAIL_LIMIT = 0.05, 0.5
"""Relative difference between the reflectance of the grid and of the model above which a table warns, or fails."""

_OFFSETS = np.array([0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 7.0, 10.0, 15.0])
_LAST_ABOVE = 89.9
"""Where nodes below the horizon take their value from, so that what lies above is not interpolated towards 0 [degree]."""
_ROUND = np.arange(0.0, 360.0, 30.0)
_PLAIN_INCIDENCES = np.array([0.0, 15.0, 30.0, 45.0, 60.0, 75.0])
_MOST_INCIDENCES = 6


def tabulate(bsdf: xr.Dataset, grid: Mapping[str, ArrayLike]) -> xr.Dataset:
    """Evaluate a BSDF on a grid.

    Parameters
    ----------
    bsdf : kind ``bsdf``
    grid : increasing lists [degree] of the axes of one of the layouts of :mod:`brdfpipe.bsdf.grids`: ``theta_i``, ``theta_o``, ``phi_o``
        (uniform), ``theta_i``, ``theta_s``, ``phi_s`` (specular-centred) or ``theta_h``, ``theta_d``, ``phi_d`` (half-angle); for a
        surface with a lay ``phi_i`` (``phi_h``) too. Polar angles of a uniform grid may go beyond 90 where the BSDF transmits. Between
        the nodes the table is interpolated linearly, so a lobe narrower than the steps is lost: the table says how much

    Returns
    -------
    Dataset of kind ``bsdf``, representation ``table``: ``brdf`` on the axes[, wavelength]; the reflectance of the grid
        ``grid_albedo(theta_i[, wavelength])`` and of the model ``model_albedo``, so that their difference tells what the grid
        leaves out; and the errors of interpolation, see :func:`with_interpolation_error`

    Raises
    ------
    VocabularyError : an axis is missing, unknown, not increasing or out of range; or ``phi_o`` (``phi_s``, ``phi_d``) covers neither a full
        turn of 360 nor, without a lay, 0 to 180.
    """
    vocabulary.validate(bsdf, "bsdf")
    layout = GRIDS[kind_of(set(grid))]
    _check_keys(grid, layout)
    even = representation(bsdf).isotropic
    axes = {name: _axis(grid, name, bsdf) for name in layout.named(layout.azimuth in grid)}
    _check_circles(axes, even)
    averaged = not even and layout.azimuth not in axes
    brdf = _averaged(bsdf, layout, axes) if averaged else _on_nodes(bsdf, layout, axes)
    spectral = ("wavelength",) if "wavelength" in bsdf.coords else ()
    made = xr.Dataset(
        {"brdf": ((*axes, *spectral), brdf if spectral else brdf[..., 0])},
        coords={**axes, **({"wavelength": bsdf["wavelength"].values} if spectral else {})},
        attrs={"representation": Table.name, "source_representation": representation(bsdf).name},
    )
    kept = ["total_reflectance", "theta_m"]
    if representation(bsdf).transmits and "theta_o" in axes and axes["theta_o"][-1] > 90:
        made.attrs["transmission"] = bsdf.attrs["transmission"]
        kept.append("n")
    for name in kept:
        if name in bsdf:
            made[name] = bsdf[name].drop_vars("theta_i", errors="ignore")
    made = _with_albedo(made, bsdf, axes, spectral)
    made = vocabulary.label(with_interpolation_error(made, bsdf, averaged), "bsdf")
    made = _with_verdict(made)
    return vocabulary.add_warning(made, *_left_out(bsdf, layout, made, averaged))


def _on_nodes(bsdf: xr.Dataset, layout: Grid, axes: Mapping[str, Array], turned: float = 0.0) -> Array:
    """The BSDF on the nodes, (axes…, wavelength), the whole arrangement turned by an azimuth."""
    nodes = dict(zip(axes, np.meshgrid(*axes.values(), indexing="ij"), strict=True))
    theta_i, phi_i, theta_o, phi_o = layout.directions(nodes)
    if layout is not GRIDS["uniform"]:
        above = axes.get("theta_i", np.zeros(1))[-1] <= 90
        theta_i, theta_o = (np.minimum(angle, _LAST_ABOVE) if above else angle for angle in (theta_i, theta_o))
    evaluator = representation(bsdf)
    return np.asarray(evaluator.evaluate(theta_i, phi_i + turned, theta_o, phi_o + turned, None))


def _averaged(bsdf: xr.Dataset, layout: Grid, axes: Mapping[str, Array]) -> Array:
    return np.asarray(sum(_on_nodes(bsdf, layout, axes, turn) for turn in _ROUND) / _ROUND.size)


def _with_albedo(
    made: xr.Dataset, bsdf: xr.Dataset, axes: Mapping[str, Array], spectral: tuple[str, ...]
) -> xr.Dataset:
    """Add the reflectance of the grid and of the model, means over the azimuth of incidence."""
    theta_i = axes.get("theta_i", _PLAIN_INCIDENCES)
    of_model = _mean_albedo(bsdf, theta_i)
    if tuple(axes) == AXES:
        of_grid = _grid_albedo(made["brdf"].values, axes["theta_i"], axes["theta_o"], axes["phi_o"])
        of_grid = of_grid if spectral else of_grid[..., None]
    else:
        of_grid = _mean_albedo(made, theta_i)
    reflectance = {"units": "1"}
    told = {
        "grid_albedo": (of_grid, "directional reflectance of the grid, by its own trapezoidal integral"),
        "model_albedo": (of_model, "directional reflectance of the model, without a perfectly specular part"),
    }
    made = made.assign_coords(theta_i=theta_i)
    for name, (values, words) in told.items():
        values = np.broadcast_to(values, (theta_i.size, max(1, made.sizes.get("wavelength", 1))))
        made[name] = (("theta_i", *spectral), values if spectral else values[:, 0], {**reflectance, "long_name": words})
    return made


def _mean_albedo(bsdf: xr.Dataset, theta_i: Array) -> Array:
    """What a grid can hold of the reflectance: all but the perfectly specular part."""
    turns = np.zeros(1) if representation(bsdf).isotropic else _ROUND
    polar, azimuth = np.meshgrid(theta_i, turns, indexing="ij")
    mirrored = representation(bsdf).specular(polar, azimuth, None)[0]
    return np.asarray((representation(bsdf).albedo(polar, azimuth, None) - mirrored).mean(axis=1))


def with_interpolation_error(made: xr.Dataset, bsdf: xr.Dataset, averaged: bool = False) -> xr.Dataset:
    """Compare a table with its model between the nodes.

    Returns
    -------
    The table with ``interpolation_rms`` and ``interpolation_max``, worst of incidences midway between its own, and
    ``interpolation_rms_on_nodes``, of incidences that it holds: see :class:`brdfpipe.bsdf.approximation_error.Misfit`. A table of a surface
    with a lay that was averaged over the azimuth is compared with the average.

    Notes
    -----
    At each incidence the outgoing directions are those of a rule over the hemisphere that is graded towards the lobe, and weigh
    their projected solid angles. At the middle wavelength.
    """
    nodes = made["theta_i"].values
    nodes = nodes[nodes < 89]
    own = "theta_i" in made["brdf"].dims
    between = (nodes[1:] + nodes[:-1]) / 2 if nodes.size > 1 else nodes
    told = {
        "interpolation_rms": "rms, worst incidence midway between those of the table",
        "interpolation_max": "largest error over the larger of the BRDF and that of a Lambertian of the same reflectance",
        "interpolation_rms_on_nodes": "rms, worst of the table's own incidences",
    }
    off = [_interpolation_misfit(made, bsdf, angle, averaged) for angle in _some(between)]
    on = [_interpolation_misfit(made, bsdf, angle, averaged) for angle in _some(nodes)] if own else off
    values = [max(each.rms for each in off), max(each.largest for each in off), max(each.rms for each in on)]
    words = "error of the table between its nodes: "
    return made.assign(
        {
            name: ((), value, {"units": "1", "long_name": words + text})
            for (name, text), value in zip(told.items(), values, strict=True)
        }
    )


def _some(angles: Array) -> Array:
    return angles[np.unique(np.linspace(0, angles.size - 1, min(angles.size, _MOST_INCIDENCES)).round().astype(int))]


def _interpolation_misfit(made: xr.Dataset, bsdf: xr.Dataset, theta_i: float, averaged: bool) -> comparison.Misfit:
    rule = comparison.directions(bsdf, theta_i)
    middle = bsdf["wavelength"].values[[bsdf.sizes["wavelength"] // 2]] if "wavelength" in bsdf.coords else None
    # Between the nodes of the azimuth, too.
    phi_i = float(made["phi_i"].values[:2].mean()) if "phi_i" in made["brdf"].dims else 0.0
    turns = _ROUND if averaged else np.array([0.0])
    model, found = (
        sum(
            comparison.brdf_at(each, theta_i, phi_i + turn, rule._replace(phi=rule.phi + phi_i + turn), middle)
            for turn in turns
        )
        for each in (bsdf, made)
    )
    return comparison.misfit(rule.weight, np.asarray(found)[:, 0], np.asarray(model)[:, 0])


def _left_out(bsdf: xr.Dataset, layout: Grid, made: xr.Dataset, averaged: bool) -> list[str]:
    """What the model has and the table has not."""
    warnings = []
    if averaged:
        warnings.append(
            f"the surface has a lay, and the table holds the mean over the azimuth of incidence: add `{layout.azimuth}` to the grid to keep it"
        )
    at = np.array([45.0]), np.zeros(1)
    if any(part.any() for part in representation(bsdf).specular(*at, None)):
        warnings.append(
            "the perfectly specular part of the surface is not on the grid: take it from the BSDF itself, or give the surface a roughness"
        )
    if representation(bsdf).transmits and "transmission" not in made.attrs:
        warnings.append(
            "the table holds reflection alone, and the material transmits: give a uniform grid `theta_o` beyond 90 degree"
        )
    return warnings


def faithful_table(bsdf: xr.Dataset, grid: Mapping[str, ArrayLike]) -> xr.Dataset:
    """A table on the grid, or, where the grid is too coarse for the lobe, on one refined about the mirror directions."""
    table = tabulate(bsdf, grid)
    return table if verdict_of(table) == "pass" else tabulate(bsdf, refined(bsdf, grid))


def relative_loss(table: xr.Dataset) -> xr.DataArray:
    """Relative difference between the reflectance of the grid and of the model; 0 where there is none to reflect."""
    difference = abs(table["grid_albedo"] - table["model_albedo"])
    # What rounding leaves of a difference of reflectances is no reflectance.
    return (difference / table["model_albedo"]).where(difference > 1e-12, 0.0)


def verdict_of(table: xr.Dataset) -> str:
    """``pass``, ``warn`` or ``fail``: how well a table holds the reflectance of its model."""
    return str(json.loads(table.attrs["verdicts"])["table"]["verdict"])


def refined(bsdf: xr.Dataset, grid: Mapping[str, ArrayLike]) -> dict[str, Array]:
    """A grid with nodes added about the mirror directions, on the scale of the BSDF's lobe.

    Parameters
    ----------
    bsdf : kind ``bsdf``; one whose lobe is not known leaves the grid as it is
    grid : ``theta_i``, ``theta_o``, ``phi_o`` [degree], phi_o a full circle; ``phi_i`` stays as it is

    Returns
    -------
    dict of the same axes. A facet of slope s turns the mirror direction by 2s in the plane of incidence and by 2s cot θ_i in
    azimuth; nodes lie at half that for a typical slope, and at steps that widen from there. Where the grid goes beyond 90 degree,
    nodes are added about the transmitted directions too.
    """
    axes = {name: _axis(grid, name, bsdf) for name in GRIDS["uniform"].named("phi_i" in grid)}
    scale = representation(bsdf).lobe_slope
    if scale is None:
        return axes
    half = np.degrees(scale)
    steps = np.concatenate([[0.0], half * _OFFSETS])
    mirror = axes["theta_i"][:, None] + np.concatenate([-steps[:0:-1], steps])
    theta_o = np.concatenate([axes["theta_o"], mirror[(mirror > 0) & (mirror < 89.9)]])
    if axes["theta_o"][-1] > 90:
        through = representation(bsdf).refracted(axes["theta_i"])[:, None] + np.concatenate([-steps[:0:-1], steps])
        theta_o = np.concatenate([theta_o, through[(through > 90.1) & (through < 180)]])
    steepest = np.radians(max(axes["theta_i"].max(), 1.0))
    narrowest = np.degrees(2 * scale / np.tan(steepest)) * _OFFSETS[0]
    about = np.concatenate(
        [[0.0], np.geomspace(narrowest, 60, max(2, int(np.ceil(np.log(60 / narrowest) / np.log(1.6)))))]
    )
    phi_o = np.concatenate([axes["phi_o"], 180 - about, 180 + about]) if narrowest < 30 else axes["phi_o"]
    return axes | {
        "theta_o": _distinct(theta_o, half / 8),
        "phi_o": _distinct(phi_o, narrowest / 2),
    }


def _distinct(nodes: Array, apart: float) -> Array:
    """Nodes in order, without those closer to their neighbour than ``apart`` or than half a thousandth of a degree."""
    ordered = np.unique(np.round(nodes, 4))
    keep = np.concatenate([[True], np.diff(ordered) > min(max(apart, 5e-4), 0.2)])
    keep[-1] = True
    return ordered[keep]


def grid_for(bsdf: xr.Dataset, spec: Mapping[str, ArrayLike]) -> dict[str, ArrayLike]:
    """The uniform grid that a BSDF needs, from the configuration's ``table``.

    Parameters
    ----------
    bsdf : kind ``bsdf``
    spec : ``theta_i``, ``theta_o`` below 90, ``phi_o`` from 0 to 180, and ``phi_i`` from the lay [degree]

    Returns
    -------
    dict of ``theta_i``; ``theta_o``, mirrored beyond 90 where the BSDF transmits; ``phi_o``, mirrored to 360; and ``phi_i``, from
    the lay, where the surface has one
    """
    above = np.asarray(spec["theta_o"], dtype=float)
    theta_o = np.concatenate([above, 180 - above[::-1]]) if representation(bsdf).transmits else above
    grid: dict[str, ArrayLike] = {"theta_i": spec["theta_i"], "theta_o": theta_o, "phi_o": full_circle(spec["phi_o"])}
    if not representation(bsdf).isotropic:
        grid["phi_i"] = (representation(bsdf).lay or 0.0) + np.asarray(spec["phi_i"], dtype=float)
    return grid


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


def _axis(grid: Mapping[str, ArrayLike], name: str, bsdf: xr.Dataset) -> Array:
    if name not in grid:
        raise VocabularyError(f"the grid needs {name!r}; found {', '.join(grid)}")
    polar = 180 if representation(bsdf).transmits or name == "theta_s" else 90
    low, high = (-360, 360) if name.startswith("phi") else (0, 90 if name in ("theta_h", "theta_d") else polar)
    values = check_angles(name, grid[name], low, high)
    if values.ndim != 1 or values.size < 2 or not (np.diff(values) > 0).all():
        raise VocabularyError(f"{name} of the grid must be an increasing list of at least two angles")
    return values


def _check_keys(grid: Mapping[str, ArrayLike], layout: Grid) -> None:
    known = layout.named(lay=True)
    unknown = sorted(str(name) for name in set(grid) - set(known))
    if unknown:
        raise VocabularyError(f"the grid knows no {', '.join(map(repr, unknown))}; accepted: {', '.join(known)}")


def _check_circles(axes: Mapping[str, Array], even: bool) -> None:
    """Refuse less than a full circle, or than the half that mirror symmetry completes."""
    for name in set(AZIMUTHS) & set(axes):
        first, last = axes[name][0], axes[name][-1]
        if last - first == 360 or (even and (first, last) == (0, 180)):
            continue
        accepted = (
            "from 0 to 180, or a full turn of 360"
            if even
            else "a full turn of 360: the surface has a lay, and the halves of a circle differ"
        )
        raise VocabularyError(
            f"{name} of the grid runs from {first:g} to {last:g} degree; accepted: {accepted}; mend `{name}` of the grid"
        )


def _grid_albedo(brdf: Array, theta_i: Array, theta_o: Array, phi_o: Array) -> Array:
    """∫ BRDF |cos θ_o| dω_o by the trapezoidal rule on the nodes of the side the light comes from, completed to a full circle.

    The last polar node before the horizon extends to it.
    """
    upper, lower = theta_o <= 90, theta_o >= 90
    by_side = [
        _trapezoid(brdf[:, upper], theta_o[upper], phi_o),
        _trapezoid(brdf[:, lower][:, ::-1], 180 - theta_o[lower][::-1], phi_o),
    ]
    below = (theta_i > 90).reshape(-1, *(1,) * (brdf.ndim - 3))
    return np.where(below, by_side[1], by_side[0])


def _trapezoid(brdf: Array, theta_o: Array, phi_o: Array) -> Array:
    if theta_o.size == 0:
        return np.zeros((brdf.shape[0], *brdf.shape[3:]))
    theta = np.radians(np.append(theta_o, 90.0) if theta_o[-1] < 90 else theta_o)
    share = (np.sin(np.radians(theta_o)) * np.cos(np.radians(theta_o))).reshape(-1, *(1,) * (brdf.ndim - 2))
    projected = brdf * share
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
