"""Resolution of the lobes of a slab, and the table of the light that has been inside it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.interpolate import make_interp_spline

from brdfpipe.bsdf.microfacet.microsurface import Microsurface
from brdfpipe.bsdf.slab import adding_doubling, face, wave_face
from brdfpipe.bsdf.slab.adding_doubling import Sheet
from brdfpipe.bsdf.slab.face import Azimuths, Nodes
from brdfpipe.bsdf.slab.lobe_table import PATH_ENDS, LobeGrid, grazing_factor
from brdfpipe.bsdf.slab.wave_face import WaveSurface
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.geometry import Array

Surface = Microsurface | WaveSurface | None
"""A face: of facets alone, of waves and facets, or smooth"""

MOST_NODES, MOST_BEYOND, MOST_MODES = 160, 96, 400
NARROWEST_THROUGH, NARROWEST_WITHIN = 0.018, 0.02
"""Half width of a transmitted lobe outside, and slope of a face seen from inside, below which a lobe is taken as specular [1]."""

_MODES_AT_ONCE = 8
_STOKES_MODES, _NARROW_STOKES_MODES, _NARROW = 32, 8, 0.045
"""Fourier modes with all of I, Q, U and V, of lobes wider and narrower than the last [radian]; multiples of those at once. Higher ones
have I and Q alone, because light of narrow lobes hardly turns its plane of polarisation. Measured on faces of a = 0.05 to 1 and n = 1.5 and
2.4, this changes at most 2.2e-4 of the scattered light of an incidence."""
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


def resolution(surfaces: tuple[Surface, Surface], index: float, wavelengths: Array) -> Resolution:
    """Node counts from the widths of the lobes; ``wavelengths`` are those of faces with waves [nm].

    A facet of slope s turns transmitted light by (n − 1) s outside and internally reflected light by 2 s. The polynomial through values
    at Gauss nodes, π/2 · π/2N apart, follows a Gaussian lobe to a percent if their distance is its standard deviation; two rough faces
    widen the lobe. The Fourier modes of a lobe fall to 1e-3 at 8 over its 1/e width. A halo counts as facets whose lobe is as wide.
    """
    widths = [_widths(surface, index, wavelengths) for surface in surfaces]
    sharp = [_sharp(surface, index) for surface in surfaces]
    through, within = [], []
    for surface, width, (sharp_through, sharp_within) in zip(surfaces, widths, sharp, strict=True):
        if width is not None and (isinstance(surface, WaveSurface) or not sharp_through):
            through.append(width[0])
        if width is not None and (isinstance(surface, WaveSurface) or not sharp_within):
            within.append(width[1])
    # A facet turns internally reflected light by 2 n s cos θ outside, across the plane of incidence.
    lobes = [*through, *(2 * b * np.sqrt(index**2 - 1) for b in within if index > 1)]
    scale = min(lobes, default=1.0)
    passed_both = [3.7 / np.hypot.reduce(through)] if through else []
    outside = max([40.0, *passed_both, *(2.0 / width for width in through), *(1.4 / (index * b) for b in within)])
    trapped = np.pi / 2 - np.arcsin(1 / index)
    beyond = max([28.0, *(2.2 * trapped / (2 * b) for b in within), *(1.4 * trapped * index / w for w in through)])
    rough = any(width is not None for width in widths)
    return Resolution(
        min(int(np.ceil(outside)), MOST_NODES) if rough else 64,
        min(int(np.ceil(beyond)), MOST_BEYOND) if rough else 1,
        int(np.clip(np.ceil(8 / scale), 24, MOST_MODES)) if lobes else 1,
        float(np.clip(scale, 8 / MOST_MODES, 1.0)),
        (sharp[0], sharp[1]),
    )


def _widths(surface: Surface, index: float, wavelengths: Array) -> tuple[float, float] | None:
    """Half width of the narrowest transmitted lobe outside, and slope of the facets of the internally reflected one."""
    if surface is None:
        return None
    if isinstance(surface, WaveSurface):
        halos = np.array([wave_face.lobe_widths(surface, index, float(nm)) for nm in wavelengths]).min(axis=0)
        return float(halos[0]), float(halos[1]) / (2 * index)
    return (index - 1) * _width(surface), _width(surface)


def _sharp(surface: Surface, index: float) -> tuple[bool, bool]:
    """Whether the lobes of the facets of a face are too narrow for nodes: the transmitted, and the internally reflected one."""
    if surface is None:
        return True, True
    width = _width(surface.facets if isinstance(surface, WaveSurface) else surface)
    return (index - 1) * width < NARROWEST_THROUGH, width < NARROWEST_WITHIN or index == 1


def _width(surface: Microsurface) -> float:
    """1/e half width of a Gaussian density; for other densities the geometric mean over core and median."""
    assert isinstance(surface.density, RadialDensity)
    slope, density = surface.density.slope, surface.density.density
    half = np.append(slope[density < density[0] / 2], slope[-1])[0]
    return float(np.sqrt(half * surface.typical_slope / np.log(2)))


def sheet(
    surfaces: tuple[Surface, Surface], masking: str, index: float, resolved: Resolution, wavelength: float = np.nan
) -> Sheet:
    """The operators of the two faces of a body of one index, at one wavelength [nm] for faces with waves."""
    nodes = Nodes.of(index, resolved.outside, resolved.beyond)
    azimuths = Azimuths.of(resolved.scale / 3, 48)
    faces: list[face.Face] = []
    for surface, sharp in zip(surfaces, resolved.sharp, strict=True):
        if faces and surface is surfaces[0]:
            faces.append(faces[0])
        elif surface is None or (index == 1 and isinstance(surface, WaveSurface)):
            faces.append(face.smooth(index, nodes))
        elif isinstance(surface, WaveSurface):
            faces.append(wave_face.rough(surface, masking, index, wavelength, nodes, azimuths, sharp))
        else:
            faces.append(face.rough(surface, masking, index, nodes, azimuths, sharp))
    return Sheet(faces[0], faces[1], nodes, azimuths)


def tabulate(
    pair: Sheet, smooth: tuple[bool, bool], transmittances: Array, count: int, grid: LobeGrid
) -> tuple[Array, float]:
    """Logarithm of the BSDF of light that has been inside, by ``count`` Fourier modes, and the error of its interpolation.

    Parameters
    ----------
    pair : the operators of the two faces
    smooth : whether the front and the back face are smooth
    transmittances : (K,) internal transmittances at normal incidence

    Returns
    -------
    table : (4, X, T, V, K), for the paths of ``PATH_ENDS``, divided by the ``grazing_factor``
    error : mean absolute error between the nodes over the mean, both weighted by flux, at the worst incidence; relative to a hundredth
        of the incident light if less than that is scattered [1]
    """
    outside = pair.nodes.outside
    span, turn = np.linspace(0, 1, grid.spans), np.linspace(0, 1, grid.turns)
    on_grid = _PairSums.of(grid, grid.low, span, turn, outside)
    between = [(nodes[1:] + nodes[:-1]) / 2 for nodes in (grid.low, span, turn)]
    checked = _PairSums.of(grid, between[0][::_CHECKED], between[1], between[2], outside)
    # Of equal faces the light from either side is the same, and what passes is symmetric.
    paths = [0, 2] if pair.front is pair.back else [0, 1, 2, 3]
    factor = np.stack([grazing_factor(smooth, np.array(path), outside[:, None], outside) for path in paths])[:, None]
    straight = [adding_doubling.straight(pair, float(tau)) for tau in transmittances]
    values, exact = np.zeros(()), np.zeros(())
    stokes_modes = _STOKES_MODES if np.radians(grid.scale) > _NARROW else _NARROW_STOKES_MODES
    for start in range(0, count, _MODES_AT_ONCE):
        modes = np.arange(start, min(start + _MODES_AT_ONCE, count), dtype=float)
        components = 4 if start < stokes_modes else 2
        scattered = adding_doubling.scattered(pair, modes, transmittances, components)
        kernels = np.stack(
            [
                _densities(part, delta, pair.nodes.outer_weight)[paths] / factor
                for part, delta in zip(scattered, straight, strict=True)
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
