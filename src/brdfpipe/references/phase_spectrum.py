"""Spectrum of the phase that a height map gives to light: Kirchhoff's diffraction integral on the map itself.

For the change q of the wave vector along z, e = exp(i q h) is the reflected field above the map. Its mean is the coherent amplitude; the
spectrum of the rest, U(q, f) = |FFT e|² Δx Δy / (points), is the light that is diffracted to the spatial frequency f.

Its field is continued by its mirror image. Beyond 98 % of the diffracted light and some ten waves along the map it fades out towards the edges;
between both the spectrum passes over smoothly.

References
----------
Beckmann & Spizzichino 1963, ch. 3 (Kirchhoff's approximation).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe.geometry import Array
from brdfpipe.references.finite_field import FadedField, MirroredField, mirrored_power, remove_doubling
from brdfpipe.references.frequency_rings import SLOWEST, FrequencyRings
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
_MOST_CHANGES = 9  # groups of blocks
_LEAST_CHANGE = -0.99  # of light, relative
_JOIN = 8.0, 24.0  # waves along the shorter side, from the mirrored field to the one that fades out
_OUTSIDE = 0.02, 0.005  # share of the light further from the mirror direction, likewise
_COHERENT_BLOCKS = 8  # along the shorter side, whose scatter is the chance part of the coherent light
_FEWEST_PARTS = 4  # of these, for that scatter
_FLAT_PHASE = 1e-5  # rms [rad] below which a map is flat: levelling a plane leaves rounding
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
    changes: Array
    """(block, q, f) independent relative changes of the spectrum by one standard uncertainty, from the scatter between blocks of the map"""
    coherent: Array
    """(q,) share of the light in the mirror direction"""
    coherent_changes: Array
    """(block, q) what goes with each change of the spectrum, so that all light remains"""
    scaling: Array
    """(q,) factor of the diffracted light that makes it, with the coherent light, all that the measured heights reflect"""
    coarse: float
    """Share of steps between neighbouring heights whose phase exceeds π at the largest q"""

    @property
    def relative_u(self) -> Array:
        """(q, f) relative standard uncertainty of the spectrum"""
        return np.asarray(np.sqrt(np.square(self.changes).sum(axis=0)))


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
    if sigma * largest_phase < _FLAT_PHASE:
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
    rings = FrequencyRings.of(mesh.height, mesh.pitch)
    block_rings = rings.with_modes((side, side), 0.5 / (side * mesh.pitch))
    heights, measured = mesh.height.astype(np.float32), _measured(mesh)
    parts = _Parts.of(heights.shape, measured)
    waves = rings.frequency * float((np.array(heights.shape[::-1]) * mesh.pitch).min())
    far = _passed(waves, *_JOIN)
    mirrored = MirroredField.of(heights.shape, mesh.pitch, rings, 1 - far)
    faded = FadedField.of(heights.shape, mesh.pitch, rings, measured)
    groups = np.array_split(np.arange(len(blocks)), min(len(blocks), _MOST_CHANGES))
    spectrum, changes = np.empty((count, rings.frequency.size)), np.empty((len(groups), count, rings.frequency.size))
    coherent, scaling, coherent_changes = np.empty(count), np.empty(count), np.empty((len(groups), count))
    number = heights.size if measured is None else float(measured.sum(dtype=float))
    for row, q in enumerate(phase):
        # Single precision: its rounding is 1e-7 of the phase.
        field = np.exp(np.complex64(1j * q) * heights)
        if measured is not None:
            field *= measured
        amplitude = parts.coherent_amplitude(field)
        field -= amplitude if measured is None else amplitude * measured
        # What is not coherent is what remains: at small phases the cosine is 1 in single precision.
        remaining = sum(np.square(part).sum(dtype=float) for part in (field.real, field.imag)) / number
        coherent[row] = max(1 - remaining, 0.0) if amplitude else 0.0
        light = mirrored.light(field) / number
        outside = 1 - np.cumsum(light) / light.sum()
        light[:-1] += far * _passed(outside[:-1], *_OUTSIDE) * (faded.light(field) - light)[:-1]
        scaling[row] = (1 - coherent[row]) / light.sum()
        light *= scaling[row]
        by_block = np.array([_block_light(field[y : y + side, x : x + side], block_rings) for y, x in blocks])
        by_block = np.array([by_block[group].mean(axis=0) for group in groups])
        spectrum[row] = np.maximum(light[:-1], 1e-12 * light.max()) / rings.area
        core = int(np.searchsorted(np.cumsum(light[:-1]), SLOWEST * light[:-1].sum()))
        if core > 1:
            # Rings within which the lobe hardly changes are one.
            spectrum[row, :core] = light[:core].sum() / rings.area[:core].sum()
            by_block[:, :core] = by_block[:, :core].sum(axis=1, keepdims=True)
        changes[:, row], coherent_changes[:, row] = _changes(by_block, light[:-1])
    return PhaseSpectrum(
        phase, rings.frequency, rings.scale, spectrum, changes, coherent, coherent_changes, scaling, coarse
    )


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

    def coherent_amplitude(self, field: NDArray[np.complex64]) -> np.complex64:
        """Part of the mean field that is coherent: without it, the light by chance remains. The field is 0 where heights are missing."""
        sums = np.array([field[y : y + self.side, x : x + self.side].sum(dtype=complex) for y, x in self.first])
        amplitude = sums.sum() / self.measured.sum()
        deviation = np.abs(sums / self.measured - amplitude)
        bias = float(np.average(deviation**2, weights=self.measured)) / (self.independent - 1)
        share = float(np.abs(amplitude) ** 2)
        if share <= _SIGNIFICANT * bias:
            return np.complex64(0)
        return np.complex64(amplitude * (1 - np.sqrt(bias / share)))


def _passed(value: Array, start: float, end: float) -> Array:
    """0 up to the start, 1 from the end, smooth in the logarithm between."""
    place = np.log(np.maximum(value, 1e-12) / start) / np.log(end / start)
    place = np.clip(place, 0, 1)
    return np.asarray(place**2 * (3 - 2 * place))


def _block_light(field: NDArray[np.complex64], rings: FrequencyRings) -> Array:
    """Light of every ring of a block, and last, what is not coherent of all its light."""
    power = mirrored_power(field)
    total = power.sum(dtype=float)
    remove_doubling(power)
    return np.append(rings.light(power)[:-1], total) / power.size


def _changes(by_block: Array, light: Array) -> tuple[Array, Array]:
    """Relative changes (block, ring) of the light of the map by ring, and changes of its coherent share (block,), from the light of the blocks.

    The mean over blocks has the changes (value of the block − mean)/√(n (n − 1)), whose squares add to its variance. They are relative to the mean
    size of the light: in rings of few modes what the mirror image doubles may take more than there is, and the mean be next to 0. Rings in which no
    block has light change as the next.
    """
    deviation = (by_block - by_block.mean(axis=0)) / np.sqrt(len(by_block) * (len(by_block) - 1))
    coherent, size = -deviation[:, -1], np.abs(by_block[:, :-1]).mean(axis=0)
    known = size > 0
    relative = deviation[:, :-1] / np.where(known, size, 1.0)
    place = np.arange(size.size)
    relative = np.array([np.interp(place, place[known], one[known]) for one in relative])
    # All light remains.
    relative -= ((relative @ light + coherent) / light.sum())[:, None]
    return np.maximum(relative, _LEAST_CHANGE), coherent
