"""Veiling glare: light that lens and window spread over the whole picture, estimated where nothing is lit, and subtracted.

A picture P is the lit scene S plus its halo K ∗ S, which in the Fourier domain is K/(1 + K) P. The kernel K is a sum of Gaussians of rising
widths, as any halo that falls with distance. The loss at the source is the same for etalon and sample and cancels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft, optimize, sparse

from brdfpipe.geometry import Array

WIDTHS = 4 * 1.5 ** np.arange(11)
"""Standard deviations of the Gaussians [pixel], 4 to 231. With a ratio of 2.25 a power law would ripple by several percent."""

BIN = 2
"""Side of the squares of pixels that are averaged: the halo has no finer detail."""

_CURVATURE = 0.15  # prior standard deviation of second differences of amplitudes over their sum; 0.05 for a power law
_MODEL_U = 0.005  # relative standard uncertainty of perfectly fitted glare: the error of the sum of Gaussians
_ROUNDS = 3
_FEWEST_PIXELS = 200
_BLOCK = 8  # side of the blocks of binned pixels over which a misfit would show above the noise


@dataclass(frozen=True)
class Glare:
    """The halo of a camera, and how well it is known."""

    amplitudes: Array  # share of the light in each Gaussian of :data:`WIDTHS`
    level: float  # even light over the whole picture, in the picture's unit
    covariance: Array  # of the amplitudes and the level
    misfit: float
    """χ² over the degrees of freedom of means over blocks; 1 if only noise is left; NaN if the glare is unknown."""

    @property
    def share(self) -> float:
        """Share of the light in the halo."""
        return float(self.amplitudes.sum())


UNKNOWN = Glare(np.zeros(WIDTHS.size), 0.0, np.zeros((WIDTHS.size + 1,) * 2), np.nan)


def estimate(picture: Array, variance: Array, background: NDArray[np.bool_]) -> Glare:
    """The halo from the pixels that hold only glare; :data:`UNKNOWN` if they are too few.

    Amplitudes are not negative and change slowly from width to width. Their covariance covers what the pixels do not determine, such as the
    halo's brightness at its own source. Picture and variance (y, x) are finite; a mean over wavelengths has the least noise.
    """
    dark = _binned(background.astype(float)) == 1.0
    if dark.sum() < _FEWEST_PIXELS:
        return UNKNOWN
    values, weight = _binned(picture)[dark], BIN / np.sqrt(_binned(variance)[dark])
    scene = lit = _binned(np.where(background, 0.0, picture))
    lit_share = _binned((~background).astype(float))
    for _ in range(_ROUNDS):
        halos = _halos(scene)
        design = np.column_stack([halos[:, dark].T, np.ones(values.size)])
        solution, covariance = _solve(design * weight[:, None], values * weight)
        # The scene is the lit pixels without their glare.
        scene = lit - (np.tensordot(solution[:-1], halos, 1) + solution[-1]) * lit_share
    misfit = _misfit((values - design @ solution) * weight, dark)
    return Glare(solution[:-1], float(solution[-1]), covariance * max(misfit, 1.0), misfit)


def subtract(pictures: Array, glare: Glare) -> Array:
    """Finite pictures (…, y, x) without the halo of their scene; an even level is left.

    In double precision: rounding of a transform is a share of the brightest pixel, and must not reach the darkest.
    """
    if not glare.share:
        return pictures
    binned = _binned(pictures)
    padded, squared = _frequencies(binned.shape)
    kernel = np.tensordot(glare.amplitudes, _gaussians(squared), 1)
    spectrum = fft.rfft2(binned, padded) * (kernel / (1 + kernel))
    halo = fft.irfft2(spectrum, padded)[..., : binned.shape[-2], : binned.shape[-1]]
    return pictures - _unbinned(halo, pictures.shape[-2:])


def uncertainty(picture: Array, glare: Glare, weights: sparse.csr_array) -> Array:
    """Standard uncertainty of the glare (cell,) in sums over a finite picture (y, x) without its glare, with weights (cell, pixel)."""
    if not np.isfinite(glare.misfit):
        return np.zeros(weights.shape[0])
    halos = _unbinned(_halos(_binned(picture)), picture.shape).reshape(WIDTHS.size, -1)
    sums = np.column_stack([weights @ halos.T, weights.sum(axis=1)])
    variance = np.einsum("ci,ij,cj->c", sums, glare.covariance, sums)
    return np.sqrt(np.maximum(variance, 0.0) + (_MODEL_U * (sums[:, :-1] @ glare.amplitudes)) ** 2)


def _solve(design: Array, values: Array) -> tuple[Array, Array]:
    """Amplitudes and level that are not negative, and their covariance; design and values are in standard deviations."""
    count = WIDTHS.size
    # The total, with equal amplitudes, is the unit of the amplitudes' prior.
    total, level = _nonnegative(np.column_stack([design[:, :-1].mean(axis=1), design[:, -1]]), values)
    # The level in units of a pixel's noise, if it is less.
    unit = np.append(np.full(count, max(float(total), 1e-6)), max(float(level), 1 / float(design[:, -1].mean())))
    second_differences = np.diff(np.eye(count), 2, axis=0) / _CURVATURE
    prior = np.pad(np.concatenate([second_differences, np.eye(count)]), ((0, 0), (0, 1)))
    stacked = np.concatenate([design * unit, prior])
    solution = _nonnegative(stacked, np.append(values, np.zeros(len(prior))))
    return solution * unit, np.asarray(np.linalg.inv(stacked.T @ stacked)) * np.outer(unit, unit)


def _nonnegative(design: Array, values: Array) -> Array:
    """Least squares without negative unknowns.

    By the normal equations, which a prior keeps well conditioned: a search with as many rows as pixels takes a hundred times as long.
    """
    normal = design.T @ design
    # An unknown without data stays 0.
    normal[np.diag_indices_from(normal)] += 1e-12 * normal.diagonal() + 1e-300
    triangle = np.linalg.cholesky(normal)
    return np.asarray(optimize.nnls(triangle.T, np.linalg.solve(triangle, design.T @ values))[0])


def _misfit(residual: Array, dark: NDArray[np.bool_]) -> float:
    """χ² over the degrees of freedom of the sums over blocks of a residual in standard deviations."""
    picture: Array = np.zeros(dark.shape)
    picture[dark] = residual
    total, count = (_blocks(field, _BLOCK).sum(axis=(-3, -1)) for field in (picture, dark.astype(float)))
    full = count >= _BLOCK**2 / 4
    return float((total[full] ** 2 / count[full]).mean()) if full.any() else 1.0


def _blocks(pictures: Array, side: int) -> Array:
    """Pictures (…, y, x) as (…, row of blocks, y, column of blocks, x), without incomplete blocks."""
    rows, columns = (size // side for size in pictures.shape[-2:])
    whole = pictures[..., : rows * side, : columns * side]
    return whole.reshape(*pictures.shape[:-2], rows, side, columns, side)


def _binned(pictures: Array) -> Array:
    return np.asarray(_blocks(pictures, BIN).mean(axis=(-3, -1), dtype=float))


def _unbinned(binned: Array, shape: tuple[int, ...]) -> Array:
    """Binned pictures on every pixel again, linear between the bins' centres."""
    for axis, (size, count) in enumerate(zip(shape, binned.shape[-2:], strict=True), start=-2):
        index = np.clip((np.arange(size) + 0.5) / BIN - 0.5, 0, count - 1)
        low = np.minimum(index.astype(int), count - 2)
        fraction = np.expand_dims((index - low).astype(binned.dtype), tuple(range(axis + 1, 0)))
        binned = np.take(binned, low, axis) * (1 - fraction) + np.take(binned, low + 1, axis) * fraction
    return binned


def _halos(binned: Array) -> Array:
    """A binned picture convolved with each Gaussian, (width, y, x)."""
    padded, squared = _frequencies(binned.shape)
    spectrum = fft.rfft2(binned, padded) * _gaussians(squared)
    return np.asarray(fft.irfft2(spectrum, padded)[:, : binned.shape[0], : binned.shape[1]])


def _frequencies(shape: tuple[int, ...]) -> tuple[tuple[int, int], Array]:
    """Size of binned pictures padded with darkness, and the squared frequencies of their transforms [1/pixel²]."""
    rows, columns = (fft.next_fast_len(2 * size, real=True) for size in shape[-2:])
    return (rows, columns), fft.fftfreq(rows, BIN)[:, None] ** 2 + fft.rfftfreq(columns, BIN) ** 2


def _gaussians(squared: Array) -> Array:
    """Transforms of the Gaussians, (width, …)."""
    return np.exp(-2 * (np.pi * WIDTHS[:, None, None]) ** 2 * squared)
