"""Uncertainties of one side of a measured BSDF: of its coefficients, of interpolation between incidences, and beyond what was measured."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from brdfpipe.bsdf.measured import node_kernel
from brdfpipe.bsdf.measured.node_arrays import ErrorLimits
from brdfpipe.bsdf.measured.node_interpolation import (
    MARGIN,
    TINY,
    LobeCoordinates,
    PathDirection,
    Side,
    coordinates_at_node,
    interpolation_abscissa,
    lobe_coordinates,
    node_contributions,
    node_weights,
    path_directions,
    path_values,
)
from brdfpipe.geometry import Array

LIMITS = ErrorLimits(largest=20.0, horizon_error=0.5, horizon_rise=0.02, error_range=10.0)


def side_uncertainties(side: Side, theta_i: Array, theta_o: Array, phi: Array) -> Array:
    """Standard uncertainty (directions, wavelength) in sr⁻¹."""
    if side.arrays and side.covariances:
        return node_kernel.uncertainties(side.arrays, side.covariances, theta_i, theta_o, phi, LIMITS)
    return path_uncertainties(side, theta_i, theta_o, phi)


def path_uncertainties(side: Side, theta_i: Array, theta_o: Array, phi: Array) -> Array:
    """The same by NumPy's arrays, for every basis; what is compiled is compared with it."""
    paths = path_directions(side, theta_i, theta_o, phi)
    rows: dict[int, Array] = {}
    odd = side.basis.harmonic % 2 == 1
    for part in node_contributions(side, paths):
        # A coefficient may contribute to both path directions: its errors add before they are squared.
        total = rows.setdefault(part.node, np.zeros((theta_i.size, side.coefficient.shape[2])))
        total[part.pairs] += side.basis.rows(*part.coordinates) * np.where(odd, part.odd[:, None], part.even[:, None])
    variance = np.zeros((theta_i.size, side.coefficient.shape[1]))
    common = np.zeros((side.common.shape[0], *variance.shape))
    for node, total in rows.items():
        for wavelength, factor in enumerate(side.factor[node]):
            variance[:, wavelength] += ((total @ factor) ** 2).sum(axis=1)
        if common.size:
            common += total @ np.swapaxes(side.common[:, node], 1, 2)
    variance += (common**2).sum(axis=0)
    # Both path directions may have the same error: in the mirror direction they coincide.
    error = np.sum([path.weight[:, None] * _model_error(side, path) for path in paths], axis=0)
    error = np.minimum(np.hypot(error, _disagreement(side, paths)), LIMITS.largest)
    value = path_values(side, paths)
    # Of a logarithm the value may be far too low: the error is that to the larger side, up to the largest value that was measured.
    above = np.minimum(value * np.expm1(error), np.maximum(_ceiling(side, paths) - value, 0.0))
    model_error = np.maximum(above, -value * np.expm1(-error))
    spread = np.sqrt(variance)
    return np.hypot(value * np.expm1(np.minimum(spread, LIMITS.largest)) if side.logarithmic else spread, model_error)


def _ceiling(side: Side, paths: list[PathDirection]) -> Array:
    """Largest plausible value: the largest one of the nodes beside it (directions, wavelength)."""
    highest = np.zeros((paths[0].theta_i.size, side.coefficient.shape[1]))
    for path in paths:
        for node in range(side.incidence.size):
            near = np.maximum(*node_weights(side, node, path.theta_i)) > 0
            highest[near] = np.maximum(highest[near], _exponential_of(side, side.highest[node]))
    return highest


def _exponential_of(side: Side, fitted: Array) -> Array:
    """The BSDF of a fitted quantity, with the margin of a logarithm."""
    return np.exp(fitted + MARGIN) if side.logarithmic else fitted


def _disagreement(side: Side, paths: list[PathDirection]) -> Array | float:
    """Error of the logarithm of the mean of two path directions that disagree by more than they are uncertain (directions, wavelength)."""
    if len(paths) == 1:
        return 0.0
    forward, backward = (
        np.log(np.maximum(path_values(side, [path._replace(weight=np.ones_like(path.weight))]), TINY)) for path in paths
    )
    expected = (paths[0].error ** 2 + paths[1].error ** 2)[:, None]
    weight = (paths[0].weight * paths[1].weight)[:, None]
    return np.sqrt(weight * np.maximum((forward - backward) ** 2 - expected, 0.0))


def _model_error(side: Side, path: PathDirection) -> Array:
    """Error of the logarithm by interpolation and extrapolation over incidence, and below the horizon (directions, wavelength)."""
    lobe = lobe_coordinates(side, path)
    below_horizon = np.zeros((path.theta_i.size, side.coefficient.shape[1]))
    for node in range(side.incidence.size):
        weight = node_weights(side, node, path.theta_i)[0]
        pairs = np.flatnonzero(weight > 0)
        clamped, below = coordinates_at_node(side, node, lobe.select(pairs))
        changed = np.flatnonzero(below)
        if changed.size:
            continued, _ = coordinates_at_node(side, node, lobe.select(pairs[changed]), clamped=False)
            change = np.abs(_logarithm(side, node, continued) - _logarithm(side, node, clamped.select(changed)))
            lost = np.maximum(np.cos(np.radians(side.horizon[node])) - lobe.cosine[pairs[changed]], 0.0)
            change = np.hypot(
                change,
                (LIMITS.horizon_error * lost / (lost + lobe.cosine[pairs[changed]] + LIMITS.horizon_rise))[:, None],
            )
            below_horizon[pairs[changed]] += weight[pairs[changed], None] * change
    over_incidence = _interpolation_error(side, path, lobe)
    return np.hypot(below_horizon, over_incidence)


def _interpolation_error(side: Side, path: PathDirection, lobe: LobeCoordinates) -> Array:
    """Error of the logarithm between and beyond the measured incidences (directions, wavelength)."""
    nodes = np.flatnonzero(side.measured.any(axis=1))
    logarithms = np.stack(
        [_logarithm(side, node, coordinates_at_node(side, node, lobe)[0]) for node in map(int, nodes)]
    )
    error = np.empty(logarithms.shape[1:])
    # A wavelength without a measurement at an incidence is interpolated there.
    for known in np.unique(side.measured[nodes], axis=1).T:
        wavelengths = (side.measured[nodes] == known[:, None]).all(axis=0)
        own = logarithms[known][:, :, wavelengths]
        error[:, wavelengths] = _newton_remainder(side, nodes[known], own, path.theta_i)
    return error


def _newton_remainder(side: Side, nodes: NDArray[np.int64], logarithms: Array, theta_i: Array) -> Array:
    """Next term of Newton's formula (directions, wavelength), from the logarithms of some nodes (node, directions, wavelength)."""
    nodes_x, x = side.abscissa[nodes], interpolation_abscissa(theta_i)
    if nodes.size < 2:
        # A wavelength that no incidence was measured at is as uncertain as one measured at normal incidence alone.
        known = side.incidence[nodes[0]] if nodes.size else 0.0
        distance = np.abs(theta_i - known) / LIMITS.error_range
        return np.broadcast_to(distance[:, None], logarithms.shape[1:])
    slope = np.diff(logarithms, axis=0) / np.diff(nodes_x)[:, None, None]
    first = np.clip(np.searchsorted(nodes_x, x, side="right") - 1, 0, nodes.size - 2)
    index = np.arange(x.size)
    if nodes.size == 2:
        bend = np.abs(slope[0]) / (nodes_x[1] - nodes_x[0])
    else:
        bends = np.diff(slope, axis=0) / (nodes_x[2:] - nodes_x[:-2])[:, None, None]
        before, after = np.maximum(first - 1, 0), np.minimum(first, nodes.size - 3)
        bend = np.maximum(np.abs(bends[before, index]), np.abs(bends[after, index]))
    error = np.abs((x - nodes_x[first]) * (x - nodes_x[first + 1]))[:, None] * bend
    if nodes.size > 3:  # beyond the last node the next term can be as large
        change = np.abs(bends[-1] - bends[-2]) / (nodes_x[-1] - nodes_x[-4])
        error += (np.maximum(x - nodes_x[-1], 0.0) * np.prod(x[:, None] - nodes_x[-3:-1], axis=1))[:, None] * change
    # Beyond the last node the BSDF is constant, and the continued trend is the error.
    return np.asarray(error + np.maximum(x - side.abscissa[-1], 0.0)[:, None] * np.abs(slope[-1]))


def _logarithm(side: Side, node: int, lobe: LobeCoordinates) -> Array:
    """Logarithm of the BSDF of a node (directions, wavelength)."""
    one = np.ones_like(lobe.theta)
    value = side.basis.sums(side.coefficient[node].T, *lobe, one, one)
    return value if side.logarithmic else np.log(np.maximum(value, 1e-6 * np.abs(value).max(initial=TINY)))
