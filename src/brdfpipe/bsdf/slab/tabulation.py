"""Resolution of the lobes of a slab, and the table of the light that has been inside it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.interpolate import make_interp_spline

from brdfpipe.bsdf.microfacet.microsurface import Microsurface
from brdfpipe.bsdf.slab import adding_doubling, face, wave_face
from brdfpipe.bsdf.slab.adding_doubling import Sheet
from brdfpipe.bsdf.slab.face import Azimuths, Nodes
from brdfpipe.bsdf.slab.lobe_table import LobeGrid, grazing_factor
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
_NEGLIGIBLE_MODE = 1e-5
"""Share of the light from an incidence, of that in its zeroth mode, below which all higher modes are left out"""
_FLOOR = 1e-9
_LEAST_SHARE = 0.01
_CHECKED = 3
_SPLINE_REACH = 3
_FEWER = 0.7


class Resolution(NamedTuple):
    """Numbers of nodes for a slab, and the lobes that are too narrow for them."""

    outside: int
    beyond: int
    modes: int
    scale: float
    """Half width of the narrowest lobe of the light that has been inside [radian]."""
    narrowest: float
    """The same of the narrowest resolved lobe of a face [radian]."""
    sharp: tuple[tuple[bool, bool], tuple[bool, bool]]
    """For front and back face: whether the transmitted, and the internally reflected, lobe is taken as specular."""
    panels: int = face.PANELS
    """Panels of the slopes of a face."""

    def coarser(self) -> Resolution:
        """Fewer nodes, for changes of a sheet of rough faces."""
        outside, beyond = (max(int(_FEWER * count), 16) for count in (self.outside, self.beyond))
        return self._replace(outside=outside, beyond=beyond, panels=self.panels // 2)


def resolution(surfaces: tuple[Surface, Surface], index: float, wavelengths: Array) -> Resolution:
    """Node counts from the widths of the lobes; ``wavelengths`` are those of faces with waves [nm].

    A facet of slope s turns transmitted light by (n − 1) s outside and internally reflected light by 2 s. The polynomial through values
    at Gauss nodes, π/2 · π/2N apart, follows a Gaussian lobe to a percent if their distance is its standard deviation; two rough faces
    widen the lobe. The Fourier modes of a lobe fall to 1e-3 at 8 over its 1/e width. A halo counts as facets whose lobe is as wide.
    Light that has been inside has met several faces, whose widths add in quadrature, unless they have coherent light too.
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
    narrowest = min(lobes, default=1.0)
    scale = narrowest
    if not any(isinstance(surface, WaveSurface) for surface in surfaces):
        scale = min((width for width in _of_inner_light(widths, sharp, index) if width), default=narrowest)
    passed_both = [3.7 / np.hypot.reduce(through)] if through else []
    outside = max([40.0, *passed_both, *(2.0 / width for width in through), *(1.4 / (index * b) for b in within)])
    trapped = np.pi / 2 - np.arcsin(1 / index)
    beyond = max([28.0, *(2.2 * trapped / (2 * b) for b in within), *(1.2 * trapped * index / w for w in through)])
    rough = any(width is not None for width in widths)
    return Resolution(
        min(int(np.ceil(outside)), MOST_NODES) if rough else 64,
        min(int(np.ceil(beyond)), MOST_BEYOND) if rough else 1,
        int(np.clip(np.ceil(8 / scale), 24, MOST_MODES)) if lobes else 1,
        float(np.clip(scale, 8 / MOST_MODES, 1.0)),
        float(np.clip(narrowest, 8 / MOST_MODES, 1.0)),
        (sharp[0], sharp[1]),
    )


def _of_inner_light(
    widths: list[tuple[float, float] | None], sharp: list[tuple[bool, bool]], index: float
) -> tuple[float, float, float]:
    """Half widths of the light that the front and the back return from inside, and of what passes; 0 for a specular one."""
    front, back = (
        (0.0, 0.0)
        if width is None
        else (width[0] * (not specular[0]), 2 * width[1] * np.sqrt(index**2 - 1) * (not specular[1]))
        for width, specular in zip(widths, sharp, strict=True)
    )
    return (
        float(np.sqrt(2 * front[0] ** 2 + back[1] ** 2)),
        float(np.sqrt(2 * back[0] ** 2 + front[1] ** 2)),
        float(np.hypot(front[0], back[0])),
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
    azimuths = Azimuths.of(resolved.narrowest / 3, 48)
    faces: list[face.Face] = []
    for surface, sharp in zip(surfaces, resolved.sharp, strict=True):
        if faces and surface is surfaces[0]:
            faces.append(faces[0])
        elif surface is None or (index == 1 and isinstance(surface, WaveSurface)):
            faces.append(face.smooth(index, nodes))
        elif isinstance(surface, WaveSurface):
            faces.append(wave_face.rough(surface, masking, index, wavelength, nodes, azimuths, sharp, resolved.panels))
        else:
            faces.append(face.rough(surface, masking, index, nodes, azimuths, sharp, resolved.panels))
    return Sheet(faces[0], faces[1], nodes, azimuths)


def tabulate(
    pair: Sheet,
    smooth: tuple[bool, bool],
    transmittances: Array,
    count: int,
    grid: LobeGrid,
    reflected_alone: bool = False,
) -> tuple[Array, float]:
    """Logarithm of the BSDF of light that has been inside, by ``count`` Fourier modes, and the error of its interpolation.

    Parameters
    ----------
    pair : the operators of the two faces
    smooth : whether the front and the back face are smooth
    transmittances : (K,) internal transmittances at normal incidence
    reflected_alone : only light from the front that leaves it again

    Returns
    -------
    table : (4 or 1, X, T, V, K), for the paths of ``PATH_ENDS``, divided by the ``grazing_factor``
    error : mean absolute error between the nodes over the mean, both weighted by flux, at the worst incidence; relative to a hundredth
        of the incident light if less than that is scattered [1]
    """
    outside = pair.nodes.outside
    span, turn = np.linspace(0, 1, grid.spans), np.linspace(0, 1, grid.turns)
    on_grid = _PairSums.of(grid, grid.low, span, turn, outside)
    between = [(nodes[1:] + nodes[:-1]) / 2 for nodes in (grid.low, span, turn)]
    checked = _PairSums.of(grid, between[0][::_CHECKED], between[1], between[2], outside)
    # Of equal faces the light from either side is the same, and what passes is symmetric.
    equal = pair.front is pair.back
    paths = [0] if reflected_alone else [0, 2] if equal else [0, 1, 2, 3]
    factor = np.stack([grazing_factor(smooth, np.array(path), outside[:, None], outside) for path in paths])[:, None]
    straight = [adding_doubling.straight(pair, float(tau)) for tau in transmittances]
    values, exact = (np.zeros(sums.shape(len(paths), transmittances.size)) for sums in (on_grid, checked))
    weight, whole, first = pair.nodes.outer_weight, np.zeros(()), 0
    stokes_modes = _STOKES_MODES if np.radians(grid.scale) > _NARROW else _NARROW_STOKES_MODES
    for start in range(0, count, _MODES_AT_ONCE):
        modes = np.arange(start, min(start + _MODES_AT_ONCE, count), dtype=float)
        components = 4 if start < stokes_modes else 2
        scattered = adding_doubling.scattered(pair, modes, transmittances, components, first)
        kernels = np.stack(
            [
                _densities(part, delta, weight, first)[paths] / factor[..., first:, first:]
                for part, delta in zip(scattered, straight, strict=True)
            ]
        )
        light = np.abs(kernels[:, :, [0, -1]]) @ weight[first:]
        whole = light[:, :, 0] if start == 0 else whole
        # The last modes fade out: a sharp cut would ring.
        kernels *= ((2 - (modes == 0)) / (2 * np.pi) * np.exp(-36 * (modes / max(count, 2)) ** 12))[:, None, None]
        on_grid.add(values, kernels, modes, first)
        checked.add(exact, kernels, modes, first)
        # Near the normal the light of high modes vanishes first.
        present = (light[:, :, 1] > _NEGLIGIBLE_MODE * whole[..., first:]).any(axis=(0, 1))
        if not present.any():
            break
        first += int(present.argmax())
    if equal and not reflected_alone:
        values, exact = np.repeat(values, 2, axis=0), np.repeat(exact, 2, axis=0)
    least = np.maximum(values.max(axis=(1, 2, 3), keepdims=True) * _FLOOR, 1e-300)
    table = np.log(np.maximum(values, least)).astype(np.float32)
    return table, checked.error(grid, smooth, table, exact)


def _densities(part: adding_doubling.InnerLight, delta: adding_doubling.InnerLight, weight: Array, first: int) -> Array:
    """BSDF of each mode between the nodes from the ``first`` on, (paths, modes, N, N), the smaller angle's node first."""
    roots = np.sqrt(np.multiply.outer(weight[first:], weight[first:]))
    front, back, through = (
        (matrix - np.diag(straight[first:])) / roots for matrix, straight in zip(part, delta, strict=True)
    )
    front, back = ((matrix + np.swapaxes(matrix, -1, -2)) / 2 for matrix in (front, back))
    return np.stack([front, back, through, np.swapaxes(through, -1, -2)])


def _splines(nodes: Array, x: Array) -> Array:
    """Matrix (…, nodes) of quintic splines through the nodes.

    A polynomial through all nodes would ring beside a lobe, which spoils the tail; a spline does not beyond a few nodes.
    """
    return np.asarray(make_interp_spline(nodes, np.eye(nodes.size), k=5)(x))


def _cosines(azimuth: Array, modes: Array) -> Array:
    """cos mφ of consecutive modes, (X, T, modes, V), by cos (m + 1)φ = 2 cos φ cos mφ − cos (m − 1)φ."""
    angle = np.radians(180 - azimuth)
    result = np.empty((*angle.shape[:2], modes.size, angle.shape[2]))
    twice = 2 * np.cos(angle)
    for row, mode in enumerate(modes):
        result[:, :, row] = np.cos(mode * angle) if row < 2 else twice * result[:, :, row - 1] - result[:, :, row - 2]
    return result


class _PairSums(NamedTuple):
    """Pairs of directions at which the Fourier modes of a BSDF, given between nodes, are summed."""

    low: Array
    high: Array
    azimuth: Array
    nodes: Array
    rows: Array
    columns: Array

    @classmethod
    def of(cls, grid: LobeGrid, low: Array, span: Array, turn: Array, nodes: Array) -> _PairSums:
        high, azimuth = grid.directions(low, span, turn)
        return cls(low, high, azimuth, nodes, _splines(nodes, low), _splines(nodes, high))

    def shape(self, paths: int, count: int) -> tuple[int, ...]:
        """Shape (paths, X, T, V, K) of sums."""
        return paths, *self.azimuth.shape, count

    def add(self, total: Array, kernels: Array, modes: Array, first: int) -> None:
        """Add Σ_m cos mφ F_m to a total (paths, X, T, V, K), of kernels (K, paths, modes, N, N) between the nodes from the ``first`` on."""
        count, paths = kernels.shape[:2]
        # A spline does not ring further.
        start = int(np.searchsorted(self.low, self.nodes[max(first - _SPLINE_REACH, 0)])) if first else 0
        rows, columns = self.rows[start:, first:], self.columns[start:, :, first:]
        half = np.einsum("xn,kpmno->xopkm", rows, kernels, optimize=True)
        pairs = columns @ half.reshape(*half.shape[:2], -1)
        pairs = pairs.reshape(*pairs.shape[:2], paths * count, modes.size)
        summed = pairs @ _cosines(self.azimuth[start:], modes)
        total[:, start:] += np.moveaxis(summed.reshape(*summed.shape[:2], paths, count, -1), (2, 3), (0, 4))

    def error(self, grid: LobeGrid, smooth: tuple[bool, bool], table: Array, exact: Array) -> float:
        """Largest Σ |interpolated − exact| over Σ exact of all incidences and paths, weighted by flux, over half the azimuths."""
        low, high = (np.broadcast_to(angle[..., None], self.azimuth.shape) for angle in (self.low[:, None], self.high))
        projected = np.radians(np.gradient(self.high, axis=1)) * np.sin(2 * np.radians(self.high)) / 2
        weight = projected[..., None] * np.radians(np.abs(np.gradient(self.azimuth, axis=2)))
        paths, nodes = table.shape[0], table.shape[-1]
        all_paths = np.moveaxis(table, 0, -2).reshape(1, *table.shape[1:4], -1)
        at = low.ravel(), high.ravel(), self.azimuth.ravel()
        logarithm = grid.interpolate(all_paths, np.zeros(low.size, dtype=int), *at).reshape(*low.shape, paths, nodes)
        worst = 0.0
        for path in range(paths):
            difference = np.abs(np.exp(logarithm[..., path, :]) - exact[path])
            flux = (weight * grazing_factor(smooth, np.array(path), low, high))[..., None]
            error = (flux * difference).sum(axis=(1, 2))
            total = (flux * np.abs(exact[path])).sum(axis=(1, 2))
            worst = max(worst, float(np.max(error / np.maximum(total, _LEAST_SHARE / 2))))
        return worst
