"""The directions of the fibres, from pictures of a mirror that is turned by known angles.

The mirror scatters the light into a lobe of some degrees. What a fibre sees of it depends on the angle γ between the half vector of light and fibre and the
normal of the mirror: ln signal = a(fibre) + c(aim) − ln cos θ_i + p(γ). The shape p of the lobe, the same for all, the sensitivities a and the directions of the
fibres follow from all aims together; the levels c, and a turn of the mount, are known but for small errors. The cells of the disc, whose directions the
angular target gives, tie the turn of the mount to the mirror direction. Facets make this exact: Fresnel's reflectance depends on the fibre alone.

References
----------
Walter et al. 2007 (EGSR), reflection by facets; Rusinkiewicz 1998, half vector.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from brdfpipe.geometry import Array, angles_of, unit_vector
from brdfpipe.rig.turned_mirror import half_vectors, normals, towards_light

LEVEL_U = 0.01
"""Relative standard uncertainty of the light of one aim: evenness of the mirror, repeatability of the reference."""

_TURN_U = np.radians(1.0)  # of the mount, before the disc's cells are seen
_LEAST_NOISE = 0.003  # relative, of a signal: evenness of the lobe
_REACH = np.radians(14.0)  # largest γ that is used
_LEAST_COSINE = 0.2  # of view and incidence, on the mirror: beyond, masking changes the lobe
_FEWEST = 4  # aims that a direction needs
_INTERVALS, _DEGREE = 7, 3  # of the spline of the lobe
_OWN_UNKNOWNS = 3  # of a fibre: its direction and sensitivity
_PASSES = 8
_LARGEST_STEP = np.radians(0.7)
_LARGEST_U = 0.5  # standard uncertainty above which a direction counts as not found [degree]


class Directions(NamedTuple):
    """Directions about the mirror direction that the fit finds."""

    theta_s: Array
    """(fibre,) degree; as described where none is found."""
    phi_s: Array
    """(fibre,) degree."""
    u: Array
    """(fibre,) root mean square angle of the true direction from this one [degree]; missing where none is found."""
    turn: float
    """Of the mount against the disc [degree]."""
    misfit: float
    """Relative, root mean square."""

    @property
    def found(self) -> NDArray[np.bool_]:
        return np.isfinite(self.u)


class _Pairs(NamedTuple):
    """Signals that are used: of an aim and a cell each."""

    aim: NDArray[np.int64]
    cell: NDArray[np.int64]
    logarithm: Array
    """Of signal times cos θ_i."""
    u: Array


def fit_directions(
    entrance: float,
    aims: tuple[Array, Array],
    described: tuple[Array, Array],
    fixed: NDArray[np.bool_],
    signal: Array,
    signal_u: Array,
    *,
    fixed_u: float = 0.0,
) -> Directions:
    """Directions of fibres from their signals under a turned mirror.

    Parameters
    ----------
    entrance : of the light [degree]
    aims : theta_s and phi_s to which the mirror sends the light, (aim,) degree
    described : theta_s and phi_s of fibres and cells of the disc, (cell,) degree; those of fibres within some degrees
    fixed : (cell,) whose directions are known: cells of the disc
    signal, signal_u : (aim, cell) relative to the reference, and its standard uncertainty; missing where there is none
    fixed_u : standard uncertainty that the fixed directions have in common [degree]

    Raises
    ------
    ValueError : no cell is seen from enough aims.
    """
    light = towards_light(entrance)
    normal, direction = normals(entrance, *aims), unit_vector(*described)
    pairs = _pairs(light, normal, direction, signal, signal_u)
    free = np.setdiff1d(np.unique(pairs.cell), np.flatnonzero(fixed))
    if not pairs.cell.size:
        raise ValueError("no fibre is lit from enough directions of the mirror")
    model = _Model(light, normal, pairs, free, direction.shape[0])
    turn = np.zeros(3)
    for _ in range(_PASSES):
        rows, residual = model.linearised(direction, turn)
        moved, turned = model.step(np.asarray(np.linalg.lstsq(rows, residual)[0], dtype=float))
        size = np.linalg.norm(moved, axis=1)
        moved *= np.minimum(1.0, _LARGEST_STEP / np.maximum(size, 1e-12))[:, None]
        direction[free] += np.einsum("fa,fax->fx", moved, _tangents(direction[free]))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        turn = turn + turned
    rows, residual = model.linearised(direction, turn)
    left = residual - rows @ np.linalg.lstsq(rows, residual)[0]
    freedom = max(residual.size - np.linalg.matrix_rank(rows), 1)
    covariance = np.linalg.pinv(rows.T @ rows) * max(float((left**2).sum()) / freedom, 1.0)
    u = np.full(direction.shape[0], np.nan)
    u[free] = np.degrees(np.sqrt(np.diag(covariance)[model.moves].reshape(-1, 2).sum(axis=1)))
    # A cell that fits worse than the others is known worse.
    own = np.bincount(pairs.cell, left[: pairs.u.size] ** 2, direction.shape[0])
    count = np.bincount(pairs.cell, minlength=direction.shape[0])
    u *= np.sqrt(np.maximum(own / np.maximum(count - _OWN_UNKNOWNS, 1), 1.0))
    u = np.hypot(u, fixed_u)
    u[u > _LARGEST_U] = np.nan
    theta, phi = angles_of(direction)
    lost = np.isnan(u)
    theta[lost], phi[lost] = described[0][lost], described[1][lost]
    misfit = float(np.sqrt((left[: pairs.u.size] ** 2 * pairs.u**2).mean()))
    return Directions(theta, phi, u, float(np.degrees(np.linalg.norm(turn))), misfit)


def _pairs(light: Array, normal: Array, direction: Array, signal: Array, signal_u: Array) -> _Pairs:
    """The pairs of an aim and a cell that is well lit, of cells with enough of them."""
    half = half_vectors(light, direction)
    seen = (direction @ normal.T).T > _LEAST_COSINE
    seen &= (normal @ light > _LEAST_COSINE)[:, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        relative = signal_u / signal
        used = seen & (signal > 0) & (relative < 0.02) & (np.arccos(np.clip(normal @ half.T, -1, 1)) < _REACH)
    used &= used.sum(axis=0) >= _FEWEST
    aim, cell = np.nonzero(used)
    logarithm = np.log(signal[aim, cell] * (normal @ light)[aim])
    return _Pairs(aim, cell, logarithm, np.hypot(relative[aim, cell], _LEAST_NOISE))


def _tangents(direction: Array) -> Array:
    """Two unit vectors (cell, 2, 3) across each direction."""
    theta, phi = angles_of(direction)
    return np.stack([unit_vector(theta + 90, phi), unit_vector(np.full_like(phi, 90.0), phi + 90)], axis=1)


class _Model:
    """The unknowns: sensitivity of each cell, level of each aim, shape of the lobe, turn of the mount, and moves of the free cells."""

    def __init__(self, light: Array, normal: Array, pairs: _Pairs, free: NDArray[np.int64], cells: int) -> None:
        self._light, self._normal, self._pairs = light, normal, pairs
        self._place = np.full(cells, -1)
        self._place[free] = np.arange(free.size)
        edges = np.linspace(0, 1.15 * _REACH, _INTERVALS + 1)
        self._knots = np.concatenate([np.zeros(_DEGREE), edges, np.full(_DEGREE, edges[-1])])
        own, numbers = np.unique(pairs.cell, return_inverse=True)
        self._numbers = numbers
        sizes = [own.size, normal.shape[0], _INTERVALS + _DEGREE, 3, 2 * free.size]
        starts = np.cumsum([0, *sizes])
        self._sensitivity, self._level, self._lobe, self._turn, self._moves = map(slice, starts[:-1], starts[1:])
        self._size = int(starts[-1])
        self._coefficient = np.zeros(sizes[2])

    @property
    def moves(self) -> slice:
        """Unknowns that move the free cells."""
        return self._moves

    def step(self, solution: Array) -> tuple[Array, Array]:
        """Moves (free cell, 2) and turn (3,) [radian] of a solution, whose lobe is kept for the next slopes."""
        self._coefficient = solution[self._lobe]
        return solution[self._moves].reshape(-1, 2), solution[self._turn]

    def linearised(self, direction: Array, turn: Array) -> tuple[Array, Array]:
        """Rows and values of the least squares about directions and a turn of the mount, each over its uncertainty; priors last."""
        pairs = self._pairs
        normal = self._normal + np.cross(turn, self._normal)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        own_normal, own = normal[pairs.aim], direction[pairs.cell]
        half = half_vectors(self._light, own)
        cosine = np.clip((half * own_normal).sum(axis=1), -1, 1)
        gamma = np.minimum(np.arccos(cosine), self._knots[-1] * (1 - 1e-9))
        design = BSpline.design_matrix(gamma, self._knots, _DEGREE).toarray()
        slope = self._slope(gamma)
        rows = np.zeros((pairs.u.size, self._size))
        at = np.arange(pairs.u.size)
        rows[at, self._sensitivity.start + self._numbers] = 1
        rows[at, self._level.start + pairs.aim] = 1
        rows[:, self._lobe] = design
        # dγ = −(h dn + n dh)/sin γ
        sine = np.maximum(np.sin(gamma), 1e-3)
        rows[:, self._turn] = -(slope / sine)[:, None] * np.cross(own_normal, half)
        across = own_normal - cosine[:, None] * half
        length = np.linalg.norm(self._light + own, axis=1)
        along = np.einsum("px,pax->pa", across, _tangents(own)) * (-slope / sine / length)[:, None]
        place = self._place[pairs.cell]
        moved = place >= 0
        for axis in range(2):
            rows[at[moved], self._moves.start + 2 * place[moved] + axis] = along[moved, axis]
        aims = self._normal.shape[0]
        levels, turns = np.zeros((aims, self._size)), np.zeros((3, self._size))
        levels[:, self._level] = np.eye(aims) / LEVEL_U
        turns[:, self._turn] = np.eye(3) / _TURN_U
        values = np.concatenate([pairs.logarithm / pairs.u, np.zeros(aims), -turn / _TURN_U])
        return np.concatenate([rows / pairs.u[:, None], levels, turns]), values

    def _slope(self, gamma: Array) -> Array:
        """Slope of the lobe's logarithm over γ; before the first solution that of slopes of 0.1."""
        if not self._coefficient.any():
            return -gamma / 0.1**2
        return np.asarray(BSpline(self._knots, self._coefficient, _DEGREE)(gamma, 1))
