"""Spectrum of the phase that a height map gives to light: Kirchhoff's diffraction integral on the map itself.

For the change q of the wave vector along z, e = exp(i q h) is the reflected field above the map. Its mean is the coherent amplitude; the
spectrum of the rest, U(q, f) = |FFT e|² Δx Δy / (points), is the light that is diffracted to the spatial frequency f.

The field of the whole map is continued by its mirror image, so that it has no step at the edges and needs no window, which would blur the
light of waves about as long as the map. Its spectrum is that of a cosine transform. The mirror image of a surface that leans to one side
leans to the other; the mean over azimuth is the same.

References
----------
Beckmann & Spizzichino 1963, ch. 3 (Kirchhoff's approximation); Ahmed, Natarajan & Rao 1974, IEEE Trans. Comput. C-23, 90 (cosine transform).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import fft

from brdfpipe.geometry import Array
from brdfpipe.references.height_mesh import HeightMapError, HeightMesh

LARGEST_PHASE_STEP = np.pi
"""Phase between neighbouring heights [rad] above which the map samples the field too coarsely."""
COARSE_LIMIT = 0.02
"""Share of such steps above which the map is refused."""

_BLOCKS = (
    3,
    6,
    12,
    24,
)  # along the shorter side, whose scatter is the uncertainty: the first of which two have no gaps
_LEAST_BLOCK = 16
_COHERENT_BLOCKS = 8  # along the shorter side, whose scatter is the chance part of the coherent light
_FEWEST_PARTS = 4  # of these, for that scatter
_RING_STEP = 0.05  # between the rings in asinh(f/f0)
_SLOWEST = 0.02  # share of the variance of heights in waves that the first ring need not tell apart
_PHASE_STEP = 0.2  # of ln q
_LEAST_PHASE = 0.1  # q times the rms height of the first node: below it U grows as q²
_FEWEST_PHASES = 5  # of a smooth surface, so that cubics interpolate between them
_SIGNIFICANT = 3.0  # times its bias, which coherent light must exceed


class PhaseSpectrum(NamedTuple):
    """U(q, f), its uncertainty, and the coherent share, of one map."""

    phase: Array
    """(q,) change of the wave vector along z [rad/um], evenly spaced in ln q"""
    frequency: Array
    """(f,) [um-1], evenly spaced in asinh(f / frequency_scale)"""
    frequency_scale: float
    spectrum: Array
    """(q, f) mean over azimuth [um2], linear between frequencies in asinh(f / frequency_scale)"""
    relative_u: Array
    """(q, f) relative standard uncertainty, from the scatter between blocks of the map"""
    coherent: Array
    """(q,) share of the light in the mirror direction"""
    coarse: float
    """Share of steps between neighbouring heights whose phase exceeds π at the largest q"""


def phase_spectrum(surface: xr.Dataset, largest_phase: float) -> PhaseSpectrum:
    """Spectrum of the reflected field of a map.

    Parameters
    ----------
    surface : kind ``surface``, a levelled map; cells with missing heights reflect no light, and what the others reflect is scaled to all of it
    largest_phase : largest q [rad/um], 4π/λ at normal incidence

    Raises
    ------
    HeightMapError : a line profile, a map that is too small, without two complete blocks, measured on a small part of its area alone or
        perfectly flat; or heights that differ by more than π in phase between neighbours on more than 2 % of the map.
    """
    mesh = HeightMesh.of(surface)
    shorter = min(mesh.height.shape)
    for count in _BLOCKS:
        side = max(_LEAST_BLOCK, shorter // count)
        blocks = _complete_blocks(mesh, side)
        if len(blocks) > 1:
            break
    if len(blocks) < 2:
        raise HeightMapError(
            f"the map has {len(blocks)} blocks of {side} × {side} heights without gaps, and two are needed; measure a larger area, or one "
            "with fewer missing heights"
        )
    sigma = float(np.std(mesh.height))
    if sigma == 0:
        raise HeightMapError("the surface is perfectly flat; use `brdfpipe.facets.flat` and the facet model")
    coarse = _coarse_share(mesh.height, largest_phase)
    if coarse > COARSE_LIMIT:
        raise HeightMapError(
            f"the phase of reflected light changes by more than π between {coarse:.1%} of neighbouring heights: the map is too coarse or too "
            "steep for Kirchhoff's integral; measure with a finer pitch, or trace rays (`brdfpipe.bsdf.traced.build`)"
        )
    first = min(_LEAST_PHASE / sigma, largest_phase / np.exp((_FEWEST_PHASES - 1) * _PHASE_STEP))
    count = int(np.ceil(np.log(largest_phase / first) / _PHASE_STEP)) + 1
    phase = np.geomspace(first, largest_phase, count)
    rings = _Rings.of(mesh.height, mesh.pitch)
    block_rings = rings.of_modes((side, side), mesh.pitch)
    heights, measured = mesh.height.astype(np.float32), _measured(mesh)
    parts = _Parts.of(heights.shape, measured)
    spectrum, relative_u = np.empty((2, count, rings.frequency.size))
    coherent = np.empty(count)
    for row, q in enumerate(phase):
        # Single precision: its rounding is 1e-7 of the phase.
        field = np.exp(np.complex64(1j * q) * heights)
        if measured is not None:
            field *= measured
        coherent[row], amplitude = parts.coherent(field)
        field -= amplitude if measured is None else amplitude * measured
        power = _power(field)
        light = np.maximum(rings.light(power), 0.0)
        light *= (1 - coherent[row]) / light.sum()
        spectrum[row] = np.maximum(light[:-1], 1e-12 * light.max()) / rings.area
        by_block = np.array([block_rings.light(_power(field[y : y + side, x : x + side]))[:-1] for y, x in blocks])
        relative_u[row] = _relative_scatter(by_block)
    return PhaseSpectrum(phase, rings.frequency, rings.scale, spectrum, relative_u, coherent, coarse)


def _coarse_share(height: Array, phase: float) -> float:
    """Share of the steps between neighbouring heights that change the phase by more than its largest step."""
    steps = [np.abs(np.diff(height, axis=axis)) * phase > LARGEST_PHASE_STEP for axis in (0, 1)]
    return sum(np.count_nonzero(one) for one in steps) / sum(one.size for one in steps)


def _complete_blocks(mesh: HeightMesh, side: int) -> list[tuple[int, int]]:
    """First row and column of the blocks without missing heights, which do not overlap."""
    return [
        (y, x) for y, x in _blocks(mesh.height.shape, side) if mesh.present[y : y + side - 1, x : x + side - 1].all()
    ]


def _blocks(shape: tuple[int, ...], side: int) -> list[tuple[int, int]]:
    """First row and column of blocks that do not overlap."""
    rows, columns = (np.linspace(0, size - side, max(1, size // side)).astype(int) for size in shape)
    return [(int(y), int(x)) for y in rows for x in columns]


def _measured(mesh: HeightMesh) -> NDArray[np.float32] | None:
    """1 where a height belongs to a complete cell and 0 elsewhere; None if all do."""
    if mesh.present.all():
        return None
    measured = np.zeros(mesh.height.shape, dtype=np.float32)
    for y, x in np.ndindex(2, 2):
        rows, columns = (slice(first, first + size) for first, size in zip((y, x), mesh.present.shape, strict=True))
        measured[rows, columns][mesh.present] = 1
    return measured


class _Parts(NamedTuple):
    """Parts of a map, whose mean fields tell coherent light from what a finite area scatters into its direction by chance."""

    first: list[tuple[int, int]]
    side: int
    measured: Array
    """Number of measured heights in every part, some in each"""

    @classmethod
    def of(cls, shape: tuple[int, ...], measured: NDArray[np.float32] | None) -> _Parts:
        side = min(shape) // _COHERENT_BLOCKS
        first = _blocks(shape, side)
        if measured is None:
            return cls(first, side, np.full(len(first), float(side**2)))
        number = np.array([measured[y : y + side, x : x + side].sum(dtype=float) for y, x in first])
        parts = cls([one for one, some in zip(first, number, strict=True) if some], side, number[number > 0])
        if not parts.measured.size or parts.independent < _FEWEST_PARTS:
            raise HeightMapError(
                f"heights were measured in {parts.measured.size} of {len(first)} parts of the map, of {side} × {side} heights each, and "
                f"{_FEWEST_PARTS} equally full ones are needed to know its coherent light; measure a larger area, or one with fewer missing heights"
            )
        return parts

    @property
    def independent(self) -> float:
        """Number of equal parts whose mean is known as well."""
        return float(self.measured.sum() ** 2 / np.square(self.measured).sum())

    def coherent(self, field: NDArray[np.complex64]) -> tuple[float, np.complex64]:
        """Coherent share without the light by chance, and the amplitude of that share, of a field that is 0 where heights are missing."""
        sums = np.array([field[y : y + self.side, x : x + self.side].sum(dtype=complex) for y, x in self.first])
        amplitude = sums.sum() / self.measured.sum()
        deviation = np.abs(sums / self.measured - amplitude)
        bias = float(np.average(deviation**2, weights=self.measured)) / (self.independent - 1)
        share = float(np.abs(amplitude) ** 2)
        if share <= _SIGNIFICANT * bias:
            return 0.0, np.complex64(0)
        # What remains of the mean amplitude carries the light by chance.
        return min(share - bias, 1.0), np.complex64(amplitude * (1 - np.sqrt(bias / share)))


def _power(field: NDArray[np.complex64]) -> NDArray[np.float32]:
    """Power of the modes of a field that is continued by its mirror image, at the frequencies k/2L along each axis."""
    power = np.square(fft.dctn(field.real, norm="ortho"))
    power += np.square(fft.dctn(field.imag, norm="ortho"))
    # The mirror image doubles what is diffracted by chance straight along an axis, as much again as in the row beside it; light of a grating
    # along the axis has nothing there, and is kept.
    mean = power[0, 0]
    power[0] -= power[1] / 2
    power[:, 0] -= power[:, 1] / 2
    power[0, 0] = max(power[0, 0], mean / 4)
    return np.asarray(power)


def _relative_scatter(light: Array) -> Array:
    """Relative standard uncertainty of the mean over blocks, (blocks, rings); that of the next ring where no block has light."""
    mean = light.mean(axis=0)
    known = mean > 0
    scatter = light.std(axis=0, ddof=1) / np.sqrt(len(light))
    place = np.arange(mean.size)
    return np.asarray(np.interp(place, place[known], (scatter / np.where(known, mean, 1.0))[known]))


class _Rings(NamedTuple):
    """Rings about frequency 0, up to the highest frequency that is sampled in all directions.

    Between two rings the spectrum is linear. The light of a mode is shared by both so that the rings have all of it.
    """

    frequency: Array
    scale: float
    area: Array
    """∫ d²f of the part of the spectrum that a ring of height 1 makes [um-2]"""
    inner: NDArray[np.intp]
    """Last ring within the frequency of every mode; modes beyond the last ring have its number and one more"""
    outer_share: NDArray[np.float32]
    """Share of the light of every mode that the next ring has"""

    @classmethod
    def of(cls, height: Array, pitch: Array) -> _Rings:
        """Rings of the modes of a map: as close as they are, or as the spectrum of its heights needs."""
        frequency = _mode_frequency(height.shape, pitch).ravel()
        mode = 0.5 / float((np.array(height.shape[::-1]) * pitch).min())
        heights = np.square(fft.dctn(height - height.mean())).ravel()
        within = np.cumsum(np.bincount((frequency / mode).astype(np.intp), heights))
        some, quarter = np.searchsorted(within, np.array([_SLOWEST, 0.25]) * within[-1])
        nyquist = 0.5 / float(pitch.max())
        # In powers of 2, so that maps of one surface have the same rings.
        modes = 2.0 ** np.floor(np.log2(max(1.0, min(float(some), float(quarter) / 4))))
        scale = mode * modes / _RING_STEP
        count = int(np.arcsinh(nyquist / scale) / _RING_STEP) + 1
        node = np.arange(count)
        frequency = scale * np.sinh(_RING_STEP * node)
        # ∫ f² over the number of the ring.
        integral = scale**2 / 2 * (np.sinh(2 * _RING_STEP * node) / (2 * _RING_STEP) - node)
        between = np.diff(integral)
        area = np.zeros(count)
        area[1:] += frequency[1:] ** 2 - between
        area[:-1] += between - frequency[:-1] ** 2
        empty = cls(frequency, scale, np.pi * area, np.zeros(0, np.intp), np.zeros(0, np.float32))
        return empty.of_modes(height.shape, pitch)

    def of_modes(self, shape: tuple[int, ...], pitch: Array) -> _Rings:
        """The same rings for the modes of a map of another size."""
        position = np.arcsinh(_mode_frequency(shape, pitch).ravel() / self.scale) / _RING_STEP
        inner = np.minimum(position.astype(np.intp), self.frequency.size)
        share = np.where(inner < self.frequency.size, position - inner, 0.0)
        return self._replace(inner=inner, outer_share=share.astype(np.float32))

    def light(self, power: NDArray[np.float32]) -> Array:
        """Light of every ring, of the power of every mode; last, that beyond the rings."""
        outwards = power.ravel() * self.outer_share
        size = self.frequency.size
        light = np.bincount(self.inner, power.ravel() - outwards, minlength=size + 1)
        light[1:] += np.bincount(self.inner, outwards, minlength=size + 1)[:-1]
        return np.asarray(light)


def _mode_frequency(shape: tuple[int, ...], pitch: Array) -> Array:
    """Frequency of the modes of a map that is continued by its mirror image [um-1]."""
    along, across = (np.arange(n) / (2 * n * step) for n, step in zip(shape[::-1], pitch, strict=True))
    return np.hypot(along, across[:, None])
