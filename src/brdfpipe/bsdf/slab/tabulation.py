"""Resolution of the lobes of a slab, and the table of the light that has been inside it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.interpolate import make_interp_spline

from brdfpipe.bsdf.microfacet.microsurface import Microsurface
from brdfpipe.bsdf.slab import adding_doubling, face
from brdfpipe.bsdf.slab.adding_doubling import Sheet
from brdfpipe.bsdf.slab.face import Azimuths, Nodes
from brdfpipe.bsdf.slab.lobe_table import PATH_ENDS, LobeGrid, grazing_factor
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.geometry import Array

MOST_NODES, MOST_BEYOND, MOST_MODES = 160, 96, 400
NARROWEST_THROUGH, NARROWEST_WITHIN = 0.018, 0.02
"""Half width of a transmitted lobe outside, and slope of a face seen from inside, below which a lobe is taken as specular [1]."""

_MODES_AT_ONCE = 8
_STOKES_MODES = 32
"""Fourier modes with all of I, Q, U and V; a multiple of those at once. Higher ones have I and Q alone, because light of narrow lobes
hardly turns its plane of polarisation. Measured on faces of a = 0.05 to 1 and n = 1.5 and 2.4, this changes at most 2e-4 of the
scattered light of an incidence."""
_FLOOR = 1e-9
_LEAST_SHARE = 0.01
_CHECKED = 3


class Resolution(NamedTuple):
    """Numbers of nodes for a slab, and the lobes that are too narrow for them."""

    outside: int
    beyond: int
    modes: int
    scale: float
    """Half width of the narrowest resolved lobe [radian]."""
    sharp: tuple[tuple[bool, bool], tuple[bool, bool]]
    """For front and back face: whether the transmitted, and the internally reflected, lobe is taken as specular."""


def resolution(surfaces: tuple[Microsurface | None, Microsurface | None], index: float) -> Resolution:
    """Node counts from the widths of the lobes.

    A facet of slope s turns transmitted light by (n − 1) s outside and internally reflected light by 2 s. The polynomial through values
    at Gauss nodes, π/2 · π/2N apart, follows a Gaussian lobe to a percent if their distance is its standard deviation; two rough faces
    widen the lobe. The Fourier modes of a lobe fall to 1e-3 at 8 over its 1/e width.
    """
    slopes = [None if surface is None else _width(surface) for surface in surfaces]
    rough = [b for b in slopes if b is not None]
    sharp = [
        (True, True) if b is None else ((index - 1) * b < NARROWEST_THROUGH, b < NARROWEST_WITHIN or index == 1)
        for b in slopes
    ]
    through = [(index - 1) * b for b, (t, _) in zip(slopes, sharp, strict=True) if b is not None and not t]
    within = [b for b, (_, r) in zip(slopes, sharp, strict=True) if b is not None and not r]
    # A facet turns internally reflected light by 2 n s cos θ outside, across the plane of incidence.
    lobes = [*through, *(2 * b * np.sqrt(index**2 - 1) for b in within if index > 1)]
    scale = min(lobes, default=1.0)
    passed_both = [3.7 / np.hypot.reduce(through)] if through else []
    outside = max([40.0, *passed_both, *(2.0 / width for width in through), *(1.4 / (index * b) for b in within)])
    trapped = np.pi / 2 - np.arcsin(1 / index)
    beyond = max([28.0, *(2.2 * trapped / (2 * b) for b in within), *(1.4 * trapped * index / w for w in through)])
    return Resolution(
        min(int(np.ceil(outside)), MOST_NODES) if rough else 64,
        min(int(np.ceil(beyond)), MOST_BEYOND) if rough else 1,
        int(np.clip(np.ceil(8 / scale), 24, MOST_MODES)) if lobes else 1,
        float(np.clip(scale, 8 / MOST_MODES, 1.0)),
        (sharp[0], sharp[1]),
    )


def _width(surface: Microsurface) -> float:
    """1/e half width of a Gaussian density; for other densities the geometric mean over core and median."""
    assert isinstance(surface.density, RadialDensity)
    slope, density = surface.density.slope, surface.density.density
    half = np.append(slope[density < density[0] / 2], slope[-1])[0]
    return float(np.sqrt(half * surface.typical_slope / np.log(2)))


def sheet(
    surfaces: tuple[Microsurface | None, Microsurface | None], masking: str, index: float, resolved: Resolution
) -> Sheet:
    """The operators of the two faces of a body of one index."""
    nodes = Nodes.of(index, resolved.outside, resolved.beyond)
    azimuths = Azimuths.of(resolved.scale / 3, 48)
    faces: list[face.Face] = []
    for surface, (through, within) in zip(surfaces, resolved.sharp, strict=True):
        if faces and surface is surfaces[0]:
            faces.append(faces[0])
        elif surface is None:
            faces.append(face.smooth(index, nodes))
        else:
            faces.append(face.rough(surface, masking, index, nodes, azimuths, (through, within)))
    return Sheet(faces[0], faces[1], nodes, azimuths)


def tabulate(
    sheets: list[Sheet], smooth: tuple[bool, bool], transmittances: Array, count: int, grid: LobeGrid
) -> tuple[Array, float]:
    """Logarithm of the BSDF of light that has been inside, by ``count`` Fourier modes, and the error of its interpolation.

    Parameters
    ----------
    sheets : one for each index
    smooth : whether the front and the back face are smooth
    transmittances : (K,) internal transmittances at normal incidence

    Returns
    -------
    table : (4, X, T, V, sheets · K), for the paths of ``PATH_ENDS``, divided by the ``grazing_factor``
    error : mean absolute error between the nodes over the mean, both weighted by flux, at the worst incidence; relative to a hundredth
        of the incident light if less than that is scattered [1]
    """
    outside = sheets[0].nodes.outside
    span, turn = np.linspace(0, 1, grid.spans), np.linspace(0, 1, grid.turns)
    on_grid = _PairSums.of(grid, grid.low, span, turn, outside)
    between = [(nodes[1:] + nodes[:-1]) / 2 for nodes in (grid.low, span, turn)]
    checked = _PairSums.of(grid, between[0][::_CHECKED], between[1], between[2], outside)
    # Of equal faces the light from either side is the same, and what passes is symmetric.
    paths = [0, 2] if all(pair.front is pair.back for pair in sheets) else [0, 1, 2, 3]
    factor = np.stack([grazing_factor(smooth, np.array(path), outside[:, None], outside) for path in paths])[:, None]
    straights = [[adding_doubling.straight(pair, float(tau)) for tau in transmittances] for pair in sheets]
    values, exact = np.zeros(()), np.zeros(())
    for start in range(0, count, _MODES_AT_ONCE):
        modes = np.arange(start, min(start + _MODES_AT_ONCE, count), dtype=float)
        components = 4 if start < _STOKES_MODES else 2
        kernels = np.stack(
            [
                _densities(part, delta, pair.nodes.outer_weight)[paths] / factor
                for pair, deltas in zip(sheets, straights, strict=True)
                for part, delta in zip(
                    adding_doubling.scattered(pair, modes, transmittances, components), deltas, strict=True
                )
            ]
        )
        # The last modes fade out: a sharp cut would ring.
        kernels *= ((2 - (modes == 0)) / (2 * np.pi) * np.exp(-36 * (modes / max(count, 2)) ** 12))[:, None, None]
        values, exact = values + on_grid.sums(kernels, modes), exact + checked.sums(kernels, modes)
    if len(paths) < len(PATH_ENDS):
        values, exact = np.repeat(values, 2, axis=0), np.repeat(exact, 2, axis=0)
    least = np.maximum(values.max(axis=(1, 2, 3), keepdims=True) * _FLOOR, 1e-300)
    table = np.log(np.maximum(values, least)).astype(np.float32)
    return table, checked.error(grid, smooth, table, exact)


def _densities(part: adding_doubling.InnerLight, delta: adding_doubling.InnerLight, weight: Array) -> Array:
    """BSDF of each mode between the nodes, (paths, modes, N, N), the smaller angle's node first."""
    roots = np.sqrt(np.multiply.outer(weight, weight))
    front, back, through = ((matrix - np.diag(straight)) / roots for matrix, straight in zip(part, delta, strict=True))
    front, back = ((matrix + np.swapaxes(matrix, -1, -2)) / 2 for matrix in (front, back))
    return np.stack([front, back, through, np.swapaxes(through, -1, -2)])


def _splines(nodes: Array, x: Array) -> Array:
    """Matrix (…, nodes) of quintic splines through the nodes.

    A polynomial through all nodes would ring beside a lobe, which spoils the tail; a spline does not beyond a few nodes.
    """
    return np.asarray(make_interp_spline(nodes, np.eye(nodes.size), k=5)(x))


class _PairSums(NamedTuple):
    """Pairs of directions at which the Fourier modes of a BSDF, given between nodes, are summed."""

    low: Array
    high: Array
    azimuth: Array
    rows: Array
    columns: Array

    @classmethod
    def of(cls, grid: LobeGrid, low: Array, span: Array, turn: Array, nodes: Array) -> _PairSums:
        high, azimuth = grid.directions(low, span, turn)
        return cls(low, high, azimuth, _splines(nodes, low), _splines(nodes, high))

    def sums(self, kernels: Array, modes: Array) -> Array:
        """Σ_m cos mφ F_m, (paths, X, T, V, K), of kernels (K, paths, modes, N, N)."""
        count, paths = kernels.shape[:2]
        half = np.einsum("xn,kpmno->xopkm", self.rows, kernels, optimize=True)
        pairs = self.columns @ half.reshape(*half.shape[:2], -1)
        pairs = pairs.reshape(*pairs.shape[:2], paths * count, modes.size)
        summed = pairs @ self._cosines(modes)
        return np.moveaxis(summed.reshape(*summed.shape[:2], paths, count, -1), (2, 3), (0, 4))

    def _cosines(self, modes: Array) -> Array:
        """cos mφ of consecutive modes, (X, T, modes, V), by cos (m + 1)φ = 2 cos φ cos mφ − cos (m − 1)φ."""
        angle = np.radians(180 - self.azimuth)
        result = np.empty((*angle.shape[:2], modes.size, angle.shape[2]))
        twice = 2 * np.cos(angle)
        for row, mode in enumerate(modes):
            result[:, :, row] = (
                np.cos(mode * angle) if row < 2 else twice * result[:, :, row - 1] - result[:, :, row - 2]
            )
        return result

    def error(self, grid: LobeGrid, smooth: tuple[bool, bool], table: Array, exact: Array) -> float:
        """Largest Σ |interpolated − exact| over Σ exact of all incidences and paths, weighted by flux, over half the azimuths."""
        low, high = (np.broadcast_to(angle[..., None], self.azimuth.shape) for angle in (self.low[:, None], self.high))
        projected = np.radians(np.gradient(self.high, axis=1)) * np.sin(2 * np.radians(self.high)) / 2
        weight = projected[..., None] * np.radians(np.abs(np.gradient(self.azimuth, axis=2)))
        worst = 0.0
        for path in range(table.shape[0]):
            paths = np.full(low.size, path)
            logarithm = grid.interpolate(table, paths, low.ravel(), high.ravel(), self.azimuth.ravel())
            difference = np.abs(np.exp(logarithm).reshape(exact.shape[1:]) - exact[path])
            flux = (weight * grazing_factor(smooth, np.array(path), low, high))[..., None]
            error = (flux * difference).sum(axis=(1, 2))
            total = (flux * np.abs(exact[path])).sum(axis=(1, 2))
            worst = max(worst, float(np.max(error / np.maximum(total, _LEAST_SHARE / 2))))
        return worst
