"""Tables of a BSDF on a grid of directions, for scenes and exchange formats."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from brdfpipe import vocabulary
from brdfpipe.bsdf import approximation_error
from brdfpipe.bsdf.change_variables import NOT_STATED
from brdfpipe.bsdf.grids import AZIMUTHS, GRIDS, Grid, layout_of
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.representations.table import AXES, Table
from brdfpipe.bsdf.source_changes import SourceChanges, uncertain
from brdfpipe.errors import VocabularyError
from brdfpipe.geometry import Array, check_angles

WARN_LIMIT, FAIL_LIMIT = 0.05, 0.5
"""Relative difference between the reflectance of the grid and of the model, or rms error of the interpolation, above which a table warns, or fails."""

_OFFSETS = np.array([0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 7.0, 10.0, 15.0])
_LAST_ABOVE = 89.9
"""Polar angle whose values nodes below the horizon take, so that those above are not interpolated towards 0 [degree]."""
_AZIMUTHS = np.arange(0.0, 360.0, 30.0)
"""Azimuths of incidence over which a surface with a lay is averaged [degree]."""
_INCIDENCES_WITHOUT_AXIS = np.array([0.0, 15.0, 30.0, 45.0, 60.0, 75.0])
"""Incidences at which a table without the axis ``theta_i`` is compared with its model [degree]."""
_MOST_INCIDENCES = 6


def tabulate(bsdf: xr.Dataset, grid: Mapping[str, ArrayLike]) -> xr.Dataset:
    """Evaluate a BSDF, and its uncertainty where that is known, on a grid.

    Parameters
    ----------
    bsdf : kind ``bsdf``
    grid : increasing lists [degree] of the axes of one of the layouts of :mod:`brdfpipe.bsdf.grids`: ``theta_i``, ``theta_o``, ``phi_o``
        (uniform), ``theta_i``, ``theta_s``, ``phi_s`` (specular-centred) or ``theta_h``, ``theta_d``, ``phi_d`` (half-angle); for a
        surface with a lay also ``phi_i`` (``phi_h``). Polar angles of a uniform grid may exceed 90 if the BSDF transmits. The table is
        interpolated linearly between the nodes, so a lobe narrower than the steps is lost

    Returns
    -------
    Dataset of kind ``bsdf``, representation ``table``: ``brdf`` on the axes[, wavelength], and ``brdf_u`` to three digits if the BSDF has an
        uncertainty, of each value by itself (the errors of values are correlated); the reflectance of the grid
        ``grid_albedo(theta_i[, wavelength])`` and of the model ``model_albedo``, whose difference is lost by the grid; and the
        interpolation errors, see :func:`with_interpolation_error`

    Raises
    ------
    VocabularyError : an axis is missing, unknown, not increasing or out of range; or ``phi_o`` (``phi_s``, ``phi_d``) covers neither a full
        turn of 360 nor, without a lay, 0 to 180.
    """
    return _with_uncertainty(_of_values(bsdf, grid), bsdf)


def _of_values(
    bsdf: xr.Dataset, grid: Mapping[str, ArrayLike], remedy: str = ", or `table.refine: true`"
) -> xr.Dataset:
    """The table without its uncertainty; ``remedy`` follows the advice to use finer steps if the grid is too coarse."""
    vocabulary.validate(bsdf, "bsdf")
    model, layout = representation(bsdf), layout_of(grid)
    known = layout.named(lay=True)
    unknown = sorted(str(name) for name in set(grid) - set(known))
    if unknown:
        raise VocabularyError(
            f"unknown axis of the grid: {', '.join(map(repr, unknown))}; accepted: {', '.join(known)}"
        )
    axes = {name: _axis(grid, name, bsdf) for name in layout.named(layout.azimuth in grid)}
    _check_circles(axes, model.isotropic)
    averaged = not model.isotropic and layout.azimuth not in axes
    brdf = values_on_nodes(model.evaluate, layout, axes, averaged, model.mirror_symmetric)
    spectral = ("wavelength",) if "wavelength" in bsdf.coords else ()
    table = xr.Dataset(
        {"brdf": ((*axes, *spectral), brdf if spectral else brdf[..., 0])},
        coords={**axes, **({"wavelength": bsdf["wavelength"].values} if spectral else {})},
        attrs={"representation": Table.name, "source_representation": model.name},
    )
    copied = ["total_reflectance", "theta_m"]
    if model.transmits and "theta_o" in axes and axes["theta_o"][-1] > 90:
        table.attrs["transmission"] = bsdf.attrs["transmission"]
        copied.append("n")
    for name in copied:
        if name in bsdf:
            table[name] = bsdf[name].drop_vars("theta_i", errors="ignore")
    table = _with_albedo(table, bsdf, axes, spectral)
    table = vocabulary.label(with_interpolation_error(table, bsdf, averaged), "bsdf")
    table = _with_verdict(table, remedy)
    if averaged:
        table = vocabulary.add_warning(
            table,
            "the surface has a lay, and the table holds the mean over the azimuth of incidence: add "
            f"`{layout.azimuth}` to the grid to resolve the azimuth",
        )
    table = vocabulary.add_warning(table, *approximation_error.lost_specular(bsdf, "table"))
    if model.transmits and "transmission" not in table.attrs:
        text = "the table holds reflection alone, and the material transmits: give a uniform grid `theta_o` beyond 90 degree"
        table = vocabulary.add_warning(table, text)
    return table


def values_on_nodes(
    evaluate: Callable[..., Array], layout: Grid, axes: Mapping[str, Array], averaged: bool, symmetric: bool
) -> Array:
    """A BSDF on the nodes, (axes…, wavelength), or its mean over the azimuth of incidence."""
    name = layout.axes[-1]
    around = axes[name]
    if symmetric and around[-1] == 360 and np.array_equal(around, 360 - around[::-1]):
        # Both sides of the plane of incidence have the same values.
        one_side = {**axes, name: around[around <= 180]}
        values = values_on_nodes(evaluate, layout, one_side, averaged, symmetric)
        other_side = np.flatnonzero(around < 180)[::-1]
        return np.concatenate([values, values.take(other_side, axis=-2)], axis=-2)
    nodes = dict(zip(axes, np.meshgrid(*axes.values(), indexing="ij"), strict=True))
    theta_i, phi_i, theta_o, phi_o = layout.directions(nodes)
    if layout is not GRIDS["uniform"] and axes.get("theta_i", np.zeros(1))[-1] <= 90:
        theta_i, theta_o = np.minimum(theta_i, _LAST_ABOVE), np.minimum(theta_o, _LAST_ABOVE)
    turns = _AZIMUTHS if averaged else np.zeros(1)
    return np.asarray(sum(evaluate(theta_i, phi_i + turn, theta_o, phi_o + turn, None) for turn in turns) / turns.size)


def _with_uncertainty(table: xr.Dataset, bsdf: xr.Dataset) -> xr.Dataset:
    """Add the standard uncertainty of each value, if the BSDF has one."""
    dims = table["brdf"].dims
    layout = layout_of(dims)
    axes = {name: table[name].values for name in layout.named(layout.azimuth in dims)}
    averaged = not representation(bsdf).isotropic and layout.azimuth not in axes
    if uncertain(bsdf):
        changes = SourceChanges.of(bsdf)
        symmetric = changes.given.mirror_symmetric
        if averaged:
            given = table["brdf"].values if "wavelength" in dims else table["brdf"].values[..., None]
            variance = np.zeros_like(given)
            # One change at a time: all together may not fit into the memory.
            for changed in changes.changed:
                values = values_on_nodes(changed.evaluate, layout, axes, averaged, symmetric)
                variance += np.square(np.nan_to_num(values - given))
        else:
            variance = values_on_nodes(changes.variance, layout, axes, averaged, symmetric)
        u = np.sqrt(variance)
    elif representation(bsdf).states_uncertainty:
        model = representation(bsdf)
        u = values_on_nodes(model.uncertainty, layout, axes, averaged, model.mirror_symmetric)
    else:
        return table
    # An uncertainty that does not depend on wavelength has one value for all of them.
    u = np.broadcast_to(u, table["brdf"].shape) if "wavelength" in dims else u[..., 0]
    if NOT_STATED in bsdf.attrs:
        table = table.assign_attrs({NOT_STATED: bsdf.attrs[NOT_STATED]})
    return vocabulary.label(table.assign(brdf_u=(dims, _to_three_digits(u))), "bsdf")


def _to_three_digits(values: Array) -> NDArray[np.float32]:
    """Rounded to 10 bits, so that a file of them is small."""
    bits = values.astype(np.float32).view(np.uint32)
    return ((bits + np.uint32(1 << 12)) & np.uint32(0xFFFFE000)).view(np.float32)


def _with_albedo(
    table: xr.Dataset, bsdf: xr.Dataset, axes: Mapping[str, Array], spectral: tuple[str, ...]
) -> xr.Dataset:
    """Add the reflectance of the grid and of the model, means over the azimuth of incidence."""
    theta_i = axes.get("theta_i", _INCIDENCES_WITHOUT_AXIS)
    if tuple(axes) == AXES:
        of_grid = _grid_albedo(table["brdf"].values, axes["theta_i"], axes["theta_o"], axes["phi_o"])
        of_grid = of_grid if spectral else of_grid[..., None]
    else:
        of_grid = _mean_albedo(table, theta_i)
    albedos = {
        "grid_albedo": (of_grid, "directional reflectance of the grid, by its own trapezoidal integral"),
        "model_albedo": (
            _mean_albedo(bsdf, theta_i),
            "directional reflectance of the model, without a perfectly specular part",
        ),
    }
    table = table.assign_coords(theta_i=theta_i)
    for name, (values, text) in albedos.items():
        values = np.broadcast_to(values, (theta_i.size, max(1, table.sizes.get("wavelength", 1))))
        attrs = {"units": "1", "long_name": text}
        table[name] = (("theta_i", *spectral), values if spectral else values[:, 0], attrs)
    return table


def _mean_albedo(bsdf: xr.Dataset, theta_i: Array) -> Array:
    """Reflectance without the perfectly specular part, which no grid holds."""
    turns = np.zeros(1) if representation(bsdf).isotropic else _AZIMUTHS
    polar, azimuth = np.meshgrid(theta_i, turns, indexing="ij")
    mirrored = representation(bsdf).specular(polar, azimuth, None)[0]
    return np.asarray((representation(bsdf).albedo(polar, azimuth, None) - mirrored).mean(axis=1))


def with_interpolation_error(table: xr.Dataset, bsdf: xr.Dataset, averaged: bool = False) -> xr.Dataset:
    """Compare a table with its model between the nodes.

    Returns
    -------
    The table with ``interpolation_rms`` and ``interpolation_max``, worst of incidences midway between the nodes, and
    ``interpolation_rms_on_nodes``, worst of incidences on the nodes: see :class:`brdfpipe.bsdf.approximation_error.Misfit`. A table
    that is averaged over the azimuth of incidence is compared with the average.

    Notes
    -----
    At the middle wavelength, at outgoing directions of a quadrature of the hemisphere that is graded towards the lobe, weighted by
    projected solid angle.
    """
    nodes = table["theta_i"].values
    nodes = nodes[nodes < 89]
    between = (nodes[1:] + nodes[:-1]) / 2 if nodes.size > 1 else nodes
    off = [_interpolation_misfit(table, bsdf, angle, averaged) for angle in _some(between)]
    on = off
    if "theta_i" in table["brdf"].dims:
        on = [_interpolation_misfit(table, bsdf, angle, averaged) for angle in _some(nodes)]
    errors = {
        "interpolation_rms": (
            max(error.rms for error in off),
            "rms, worst incidence midway between those of the table",
        ),
        "interpolation_max": (
            max(error.largest for error in off),
            "largest error over the larger of the BRDF and that of a Lambertian of the same reflectance",
        ),
        "interpolation_rms_on_nodes": (max(error.rms for error in on), "rms, worst of the table's own incidences"),
    }
    prefix = "error of the table between its nodes: "
    return table.assign(
        {name: ((), value, {"units": "1", "long_name": prefix + text}) for name, (value, text) in errors.items()}
    )


def _some(angles: Array) -> Array:
    return angles[np.unique(np.linspace(0, angles.size - 1, min(angles.size, _MOST_INCIDENCES)).round().astype(int))]


def _interpolation_misfit(
    table: xr.Dataset, bsdf: xr.Dataset, theta_i: float, averaged: bool
) -> approximation_error.Misfit:
    rule = approximation_error.directions(bsdf, theta_i)
    middle = bsdf["wavelength"].values[[bsdf.sizes["wavelength"] // 2]] if "wavelength" in bsdf.coords else None
    # Between the nodes of the azimuth as well.
    phi_i = float(table["phi_i"].values[:2].mean()) if "phi_i" in table["brdf"].dims else 0.0

    def brdf(dataset: xr.Dataset) -> Array:
        turned = (phi_i + turn for turn in (_AZIMUTHS if averaged else np.zeros(1)))
        rules = ((phi, rule._replace(phi=rule.phi + phi)) for phi in turned)
        return np.asarray(sum(approximation_error.brdf_at(dataset, theta_i, *at, middle) for at in rules))[:, 0]

    return approximation_error.misfit(rule.weight, brdf(table), brdf(bsdf))


def faithful_table(bsdf: xr.Dataset, grid: Mapping[str, ArrayLike]) -> xr.Dataset:
    """A table on the grid, or on a refined grid (:func:`refined`) if the grid is too coarse for the lobe."""
    table = _of_values(bsdf, grid)
    if verdict_of(table) != "pass":
        table = _of_values(bsdf, refined(bsdf, grid), "; `table.refine: true` was not enough")
    return _with_uncertainty(table, bsdf)


def table_for(bsdf: xr.Dataset, spec: Mapping[str, Any]) -> xr.Dataset:
    """The table that the configuration, and a scene with other bands or a smaller domain, ask for.

    Parameters
    ----------
    bsdf : kind ``bsdf``
    spec : the configuration's ``table``; ``refine``, whether nodes are added where its angles are too coarse; of a scene also ``wavelength``, its
        bands [nm], without which values are averaged with V(λ)·D65; ``incidence``, ranges [low, high] that it needs [degree]; and ``side``,
        ``reflection`` where it needs no other

    Returns
    -------
    As :func:`tabulate`. The grid of all wavelengths is that of the average; verdict and warnings are those of the worst wavelength

    Raises
    ------
    VocabularyError : as :func:`tabulate`; a wavelength that the BSDF does not have.
    """
    grid, make = grid_for(bsdf, spec), faithful_table if spec["refine"] else tabulate
    bands = spec.get("wavelength")
    if bands is None or "wavelength" not in bsdf.coords:
        return make(nonspectral(bsdf), grid)
    known = bsdf["wavelength"].values
    if missing := [f"{band:g}" for band in bands if not known[0] <= band <= known[-1]]:
        raise VocabularyError(
            f"the BSDF is known from {known[0]:g} to {known[-1]:g} nm, and not at {', '.join(missing)} nm; change `bands` of the scene, or "
            "measure spectrum and index there"
        )
    shared = _axes_of(make(nonspectral(bsdf), grid)) if spec["refine"] else grid
    tables = [tabulate(nonspectral(bsdf, _hat(known, band)), shared) for band in bands]
    worst = max(tables, key=lambda table: float(table["interpolation_rms"]))
    joined = {
        str(name): worst[name]
        if not worst[name].dims
        else xr.concat([table[name] for table in tables], "wavelength").transpose(..., "wavelength")
        for name in worst.data_vars
        if name not in ("total_reflectance", "n")
    }
    coords = {name: worst[name] for name in worst.coords} | {"wavelength": np.asarray(bands, dtype=float)}
    result = xr.Dataset(joined, coords, worst.attrs)
    for name in ("total_reflectance", "n"):
        if name in bsdf:
            field = bsdf[name].drop_vars("theta_i", errors="ignore")
            result[name] = field.interp(wavelength=result["wavelength"]) if "wavelength" in field.dims else field
    return vocabulary.label(result, "bsdf")


def _axes_of(table: xr.Dataset) -> dict[str, ArrayLike]:
    return {str(name): table[name].values for name in table["brdf"].dims}


def _hat(known: Array, wavelength: float) -> Array:
    """Weights of a linear interpolation between known wavelengths."""
    above = int(np.clip(np.searchsorted(known, wavelength), 1, known.size - 1)) if known.size > 1 else 0
    weight = np.zeros(known.size)
    if known.size == 1:
        return weight + 1
    share = (wavelength - known[above - 1]) / (known[above] - known[above - 1])
    weight[above - 1], weight[above] = 1 - share, share
    return weight


def relative_loss(table: xr.Dataset) -> xr.DataArray:
    """Relative difference between the reflectance of the grid and of the model; 0 for a black material."""
    difference = abs(table["grid_albedo"] - table["model_albedo"])
    # Smaller differences are rounding.
    return (difference / table["model_albedo"]).where(difference > 1e-12, 0.0)


def verdict_of(table: xr.Dataset) -> str:
    """``pass``, ``warn`` or ``fail``, by the reflectance of a table and by its interpolation, beside those of its model."""
    return str(json.loads(table.attrs["verdicts"])["table"]["verdict"])


def refined(bsdf: xr.Dataset, grid: Mapping[str, ArrayLike]) -> dict[str, Array]:
    """A grid with nodes added about the mirror directions, on the scale of the BSDF's lobe.

    Parameters
    ----------
    bsdf : kind ``bsdf``; without a known lobe width the grid is not changed
    grid : ``theta_i``, ``theta_o``, ``phi_o`` [degree], phi_o a full circle; ``phi_i`` is not changed

    Returns
    -------
    dict of the same axes. A facet of slope s turns the mirror direction by 2s in the plane of incidence and by 2s cot θ_i in
    azimuth. The first added node is at half that for a typical slope, the next ones at increasing steps. If the grid goes beyond
    90 degree, nodes are also added about the transmitted directions.
    """
    axes = {name: _axis(grid, name, bsdf) for name in GRIDS["uniform"].named("phi_i" in grid)}
    scale = representation(bsdf).lobe_slope
    if scale is None:
        return axes
    half = np.degrees(scale)
    steps = np.concatenate([-half * _OFFSETS[::-1], [0.0], half * _OFFSETS])
    mirror = axes["theta_i"][:, None] + steps
    theta_o = np.concatenate([axes["theta_o"], mirror[(mirror > 0) & (mirror < 89.9)]])
    if axes["theta_o"][-1] > 90:
        transmitted = representation(bsdf).refracted(axes["theta_i"])[:, None] + steps
        theta_o = np.concatenate([theta_o, transmitted[(transmitted > 90.1) & (transmitted < 180)]])
    steepest = np.radians(max(axes["theta_i"].max(), 1.0))
    narrowest = np.degrees(2 * scale / np.tan(steepest)) * _OFFSETS[0]
    count = max(2, int(np.ceil(np.log(60 / narrowest) / np.log(1.6))))
    azimuths = np.concatenate([[0.0], np.geomspace(narrowest, 60, count)])
    phi_o = np.concatenate([axes["phi_o"], 180 - azimuths, 180 + azimuths]) if narrowest < 30 else axes["phi_o"]
    return axes | {"theta_o": _distinct(theta_o, half / 8), "phi_o": _distinct(phi_o, narrowest / 2)}


def _distinct(nodes: Array, step: float) -> Array:
    """Sorted nodes, without those closer to their neighbour than ``step``, which is limited to 0.0005 to 0.2 degree."""
    ordered = np.unique(np.round(nodes, 4))
    keep = np.concatenate([[True], np.diff(ordered) > min(max(step, 5e-4), 0.2)])
    keep[-1] = True
    return ordered[keep]


def grid_for(bsdf: xr.Dataset, spec: Mapping[str, Any]) -> dict[str, ArrayLike]:
    """The uniform grid of a BSDF, from the configuration's ``table``.

    Parameters
    ----------
    bsdf : kind ``bsdf``
    spec : ``theta_i``, ``theta_o`` below 90, ``phi_o`` from 0 to 180, and ``phi_i`` from the lay [degree]; of a scene also ``incidence`` and ``side``

    Returns
    -------
    dict of ``theta_i``, about the ranges of ``incidence``; ``theta_o``, mirrored beyond 90 if the BSDF transmits and ``side`` is not ``reflection``; ``phi_o``, mirrored to 360; and ``phi_i``, counted
    from the lay, if the surface has one
    """
    above = np.asarray(spec["theta_o"], dtype=float)
    both = representation(bsdf).transmits and spec.get("side") != "reflection"
    theta_o = np.concatenate([above, 180 - above[::-1]]) if both else above
    theta_i = (
        _about(np.asarray(spec["theta_i"], dtype=float), spec["incidence"]) if "incidence" in spec else spec["theta_i"]
    )
    grid: dict[str, ArrayLike] = {"theta_i": theta_i, "theta_o": theta_o, "phi_o": full_circle(spec["phi_o"])}
    if not representation(bsdf).isotropic:
        grid["phi_i"] = (representation(bsdf).lay or 0.0) + np.asarray(spec["phi_i"], dtype=float)
    return grid


def _about(nodes: Array, ranges: Sequence[Sequence[float]]) -> Array:
    """The nodes between which ranges of angles lie: those within, and the next on either side; two at least."""
    used = np.zeros(nodes.size, dtype=bool)
    for low, high in ranges:
        first = int(np.clip(np.searchsorted(nodes, low, side="right") - 1, 0, max(nodes.size - 2, 0)))
        last = max(int(np.searchsorted(nodes, high)), first + 1)
        used[first : last + 1] = True
    return nodes[used]


def full_circle(half: ArrayLike) -> Array:
    """Azimuths from 0 to 180 degree, mirrored about the plane of incidence to 360.

    Raises VocabularyError: they do not increase from 0 to 180.
    """
    phi = check_angles("phi_o", half, 0, 180)
    if phi.ndim != 1 or phi.size < 2 or phi[0] != 0 or phi[-1] != 180 or not (np.diff(phi) > 0).all():
        raise VocabularyError("phi_o of the grid must increase from 0 to 180; change `table.phi_o` in config.yaml")
    return np.concatenate([phi, 360 - phi[-2::-1]])


def _axis(grid: Mapping[str, ArrayLike], name: str, bsdf: xr.Dataset) -> Array:
    if name not in grid:
        raise VocabularyError(f"the grid has no axis {name!r}; found: {', '.join(grid)}; add it")
    polar = 180 if representation(bsdf).transmits or name == "theta_s" else 90
    low, high = (-360, 360) if name.startswith("phi") else (0, 90 if name in ("theta_h", "theta_d") else polar)
    values = check_angles(name, grid[name], low, high)
    if values.ndim != 1 or values.size < 2 or not (np.diff(values) > 0).all():
        raise VocabularyError(f"{name} of the grid must be an increasing list of at least two angles")
    return values


def _check_circles(axes: Mapping[str, Array], isotropic: bool) -> None:
    """Refuse less than a full circle, or than the half circle of an isotropic surface."""
    accepted = "from 0 to 180, or a full turn of 360"
    if not isotropic:
        accepted = "a full turn of 360, because the surface has a lay and is not symmetric about the plane of incidence"
    for name in set(AZIMUTHS) & set(axes):
        first, last = axes[name][0], axes[name][-1]
        if last - first != 360 and not (isotropic and (first, last) == (0, 180)):
            raise VocabularyError(
                f"{name} of the grid runs from {first:g} to {last:g} degree; accepted: {accepted}; change `{name}` of the grid"
            )


def _grid_albedo(brdf: Array, theta_i: Array, theta_o: Array, phi_o: Array) -> Array:
    """∫ BRDF |cos θ_o| dω_o over the side of incidence by the trapezoidal rule on the nodes, completed to a full circle.

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


def _with_verdict(table: xr.Dataset, remedy: str) -> xr.Dataset:
    """Add the verdict on the grid's own integral and on its interpolation, which programs that read a table rely on."""
    lost = relative_loss(table)
    by_incidence = lost.max("wavelength") if "wavelength" in lost.dims else lost
    worst, angle = float(by_incidence.max()), float(by_incidence.idxmax("theta_i"))
    between = float(table["interpolation_rms"])
    text = (
        f"its own integral differs from the model's reflectance by up to {worst:.1%} (at {angle:g}° incidence), and its interpolation between "
        f"incidences from the model by up to {between:.1%} (rms)"
    )
    largest = max(worst, between)
    verdict = "fail" if largest > FAIL_LIMIT else "warn" if largest > WARN_LIMIT else "pass"
    table.attrs["verdicts"] = json.dumps({"table": {"verdict": verdict, "text": text}}, ensure_ascii=False)
    if verdict == "pass":
        return table
    return vocabulary.add_warning(
        table,
        f"the grid of the table is too coarse for the lobe: {text}; use finer steps in the configuration's `table`{remedy}",
    )
