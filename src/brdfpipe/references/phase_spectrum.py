"""Spectrum of the phase that a height map gives to light: Kirchhoff's diffraction integral on the map itself.

For the change q of the wave vector along z, e = exp(i q h) is the reflected field above the map. Its mean is the coherent amplitude; the
spectrum of the rest, U(q, f) = |FFT e|² Δx Δy / (points), is the light that is diffracted to the spatial frequency f.

References
----------
Beckmann & Spizzichino 1963, ch. 3 (Kirchhoff's approximation); Welch 1967, IEEE Trans. AU-15, 70 (windowed patches that overlap by half).
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

_PATCHES = (
    2,
    4,
    8,
    16,
)  # along the shorter side, without overlap: the largest without gaps, as smaller ones blur the spectrum
_BLOCKS = 8  # along the shorter side, whose scatter is the chance part of the coherent light
_LEAST_PATCH = 32
_RING_STEP = 0.05  # between the rings in asinh(f/f0), with f0 so that the finest rings are one bin wide
_PHASE_STEP = 0.2  # of ln q
_LEAST_PHASE = 0.1  # q times the rms height of the first node: below it U grows as q²
_FEWEST_PHASES = 5  # of a smooth surface, so that cubic splines interpolate between them
_SIGNIFICANT = 3.0  # times its bias, which coherent light must exceed


class PhaseSpectrum(NamedTuple):
    """U(q, f), its uncertainty, and the coherent share, of one map."""

    phase: Array
    """(q,) change of the wave vector along z [rad/um], evenly spaced in ln q"""
    frequency: Array
    """(f,) [um-1], evenly spaced in asinh(f / frequency_scale)"""
    frequency_scale: float
    spectrum: Array
    """(q, f) mean over azimuth [um2]"""
    relative_u: Array
    """(q, f) relative standard uncertainty, from the scatter between the patches"""
    coherent: Array
    """(q,) share of the light in the mirror direction"""
    coarse: float
    """Share of steps between neighbouring heights whose phase exceeds π at the largest q"""


def phase_spectrum(surface: xr.Dataset, largest_phase: float) -> PhaseSpectrum:
    """Spectrum of the reflected field of a map.

    Parameters
    ----------
    surface : kind ``surface``, a levelled map; patches with missing heights are not used
    largest_phase : largest q [rad/um], 4π/λ at normal incidence

    Raises
    ------
    HeightMapError : a line profile, a map that is too small, without complete patches or perfectly flat; or heights that differ by more
        than π in phase between neighbours on more than 2 % of the map.
    """
    mesh = HeightMesh.of(surface)
    for count in _PATCHES:
        side = max(_LEAST_PATCH, 2 * (min(mesh.height.shape) // (2 * count)))
        patches = _complete_patches(mesh, side, 2)
        if len(patches) > 1:
            break
    block = min(mesh.height.shape) // _BLOCKS
    blocks = _complete_patches(mesh, block, 1)
    if len(patches) < 2:
        raise HeightMapError(
            f"the map has {len(patches)} patches of {side} × {side} heights without gaps, and two are needed; measure a larger area, or one "
            "with fewer missing heights"
        )
    sigma = float(np.std(mesh.height))
    steps = np.concatenate([np.abs(np.diff(mesh.height, axis=axis)).ravel() for axis in (0, 1)])
    if sigma == 0:
        raise HeightMapError("the surface is perfectly flat; use `brdfpipe.facets.flat` and the facet model")
    coarse = float(np.mean(steps * largest_phase > LARGEST_PHASE_STEP))
    if coarse > COARSE_LIMIT:
        raise HeightMapError(
            f"the phase of reflected light changes by more than π between {coarse:.1%} of neighbouring heights: the map is too coarse or too "
            "steep for Kirchhoff's integral; measure with a finer pitch, or trace rays (`brdfpipe.bsdf.traced.build`)"
        )
    first = min(_LEAST_PHASE / sigma, largest_phase / np.exp((_FEWEST_PHASES - 1) * _PHASE_STEP))
    count = int(np.ceil(np.log(largest_phase / first) / _PHASE_STEP)) + 1
    phase = np.geomspace(first, largest_phase, count)
    rings = _Rings.of(side, mesh.pitch)
    window = np.hanning(side + 1)[:-1]
    window = (window[:, None] * window).astype(np.float32)
    scale = float(np.prod(mesh.pitch)) / float(np.sum(window**2, dtype=float))
    spectrum, uncertainty = np.empty((2, count, rings.frequency.size))
    coherent = np.empty(count)
    heights = mesh.height.astype(np.float32)
    for row, q in enumerate(phase):
        # Single precision: its rounding is 1e-7 of the phase.
        fields = np.exp(np.complex64(1j * q) * heights)
        coherent[row], amplitude = _coherent(fields, blocks, block)
        total = square = np.zeros(rings.frequency.size)
        for y, x in patches:
            transform = fft.fft2((fields[y : y + side, x : x + side] - amplitude) * window)
            mean = rings.mean(transform.real**2 + transform.imag**2) * scale
            total, square = total + mean, square + mean**2
        mean = total / len(patches)
        spread = np.maximum(square / len(patches) - mean**2, 0.0) / (len(patches) - 1)
        spectrum[row], uncertainty[row] = mean, np.sqrt(spread)
    smallest = 1e-12 * spectrum.max(axis=1, keepdims=True)
    spectrum = np.maximum(spectrum, smallest)
    return PhaseSpectrum(phase, rings.frequency, rings.scale, spectrum, uncertainty / spectrum, coherent, coarse)


def _complete_patches(mesh: HeightMesh, side: int, overlap: int) -> list[tuple[int, int]]:
    """First row and column of the patches without missing heights; ``overlap`` of them along each axis share a height."""
    rows, columns = mesh.height.shape
    starts = [
        np.unique(np.linspace(0, size - side, max(1, overlap * size // side - overlap + 1)).astype(int))
        for size in (rows, columns)
    ]
    return [
        (int(y), int(x)) for y in starts[0] for x in starts[1] if mesh.present[y : y + side - 1, x : x + side - 1].all()
    ]


def _coherent(fields: NDArray[np.complex64], blocks: list[tuple[int, int]], side: int) -> tuple[float, np.complex64]:
    """Coherent share without the light that a finite area scatters into it by chance, and the mean amplitude."""
    means = np.array([fields[y : y + side, x : x + side].mean(dtype=complex) for y, x in blocks])
    amplitude = means.mean()
    bias = float(np.mean(np.abs(means - amplitude) ** 2)) / (means.size - 1)
    share = float(np.abs(amplitude) ** 2)
    return (min(max(share - bias, 0.0), 1.0) if share > _SIGNIFICANT * bias else 0.0), np.complex64(amplitude)


class _Rings(NamedTuple):
    """Rings about frequency 0 of a patch, up to the highest frequency that is sampled in all directions."""

    frequency: Array
    scale: float
    ring: NDArray[np.intp]
    """Ring of every bin of the transform; the last one holds the corners, which are not used"""
    bins: NDArray[np.intp]
    """Number of bins of every ring"""

    @classmethod
    def of(cls, side: int, pitch: Array) -> _Rings:
        along, across = (fft.fftfreq(side, step) for step in pitch)
        frequency = np.hypot(along, across[:, None]).ravel()
        finest, nyquist = 1 / (side * float(pitch.min())), 0.5 / float(pitch.max())
        scale = finest / _RING_STEP
        rings = int(np.arcsinh(nyquist / scale) / _RING_STEP)
        ring = np.minimum(np.rint(np.arcsinh(frequency / scale) / _RING_STEP), rings + 1).astype(np.intp)
        number = np.bincount(ring, minlength=rings + 2)[:-1]
        return cls(scale * np.sinh(_RING_STEP * np.arange(rings + 1)), scale, ring, number)

    def mean(self, power: Array) -> Array:
        """Mean over every ring."""
        return np.bincount(self.ring, power.ravel(), minlength=self.bins.size + 1)[:-1] / np.maximum(self.bins, 1)
