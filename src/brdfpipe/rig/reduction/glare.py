"""Veiling glare: the light that lens and window spread over the whole picture, found where nothing shines and taken away.

The picture is what shines, S, and a halo of it, K ∗ S. The kernel K is taken as a sum of Gaussians on a ladder of widths, whose
amplitudes are not negative and change but slowly from rung to rung: any halo that falls with the distance is such a sum. They follow
from the pixels of the screen beyond disc and fibres, which hold nothing else. What the amplitudes do not tell (how bright the halo
is where its source shines itself) their covariance says.

The halo of the picture P = S + K ∗ S is K/(1 + K) of it in Fourier's terms. The loss of what stays in place is the same for etalon and
sample and cancels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft, optimize, sparse

from brdfpipe.geometry import Array

WIDTHS = 4 * 1.5 ** np.arange(11)
"""Standard deviations of the Gaussians [pixel], 4 to 231. On rungs twice as far apart a power law would ripple by several percent."""

BIN = 2
"""Pixels of a side that are joined: the halo has no finer detail."""

_STIFF = 0.15
"""Standard deviation of the bend of the amplitudes from rung to rung, over their sum. That of a power law of the distance is 0.05."""

_MODEL = 0.005
"""Relative standard uncertainty of glare that fits perfectly: what the ladder itself is off."""

_ROUNDS = 3
_LEAST_PIXELS = 200
_BLOCK = 8
"""Side of the blocks of joined pixels over which a misfit would show above the noise."""


@dataclass(frozen=True)
class Glare:
    """The halo of a camera, and how well it is known."""

    amplitudes: Array
    """Share of the light in each Gaussian of :data:`WIDTHS`."""
    level: float
    """Even light over the whole picture, in its unit."""
    covariance: Array
    """Of the amplitudes and the level."""
    misfit: float
    """χ² over the degrees of freedom of means over blocks; 1 if there is nothing but noise."""

    @property
    def share(self) -> float:
        """Share of the light in the halo."""
        return float(self.amplitudes.sum())


NONE = Glare(np.zeros(WIDTHS.size), 0.0, np.zeros((WIDTHS.size + 1,) * 2), np.nan)
"""Nothing is known of a halo."""


def estimate(picture: Array, variance: Array, background: NDArray[np.bool_]) -> Glare:
    """The halo from the pixels where nothing shines.

    Parameters
    ----------
    picture, variance : (y, x), finite; a mean over wavelengths has the least noise
    background : (y, x), the pixels that hold glare alone
    """
    dark = _joined(background.astype(float)) == 1.0
    if dark.sum() < _LEAST_PIXELS:
        return NONE
    seen, weight = _joined(picture)[dark], BIN / np.sqrt(_joined(variance)[dark])
    shining = _joined(np.where(background, 0.0, picture))
    shares = _joined((~background).astype(float))
    for _ in range(_ROUNDS):
        halos = _halos(shining)
        design = np.column_stack([halos[:, dark].T, np.ones(seen.size)])
        found, factor = _solution(design * weight[:, None], seen * weight)
        # What shines is what is left of the lit pixels without their glare.
        glare = np.tensordot(found[:-1], halos, 1) + found[-1]
        shining = _joined(np.where(background, 0.0, picture)) - glare * shares
    misfit = _misfit((seen - design @ found) * weight, dark)
    return Glare(found[:-1], float(found[-1]), factor * max(misfit, 1.0), misfit)


def removed(pictures: Array, glare: Glare) -> Array:
    """Pictures (…, y, x), finite, without the halo of what shines in them; an even level is left.

    In double precision: rounding of a transform is a share of the brightest pixel, and must not reach the darkest.
    """
    if not glare.share:
        return pictures
    joined = _joined(pictures)
    padded, squared = _frequencies(joined.shape)
    kernel = np.tensordot(glare.amplitudes, _gaussians(squared), 1)
    spectrum = fft.rfft2(joined, padded) * (kernel / (1 + kernel))
    halo = fft.irfft2(spectrum, padded)[..., : joined.shape[-2], : joined.shape[-1]]
    return pictures - _spread(halo, pictures.shape[-2:])


def uncertainty(picture: Array, glare: Glare, weights: sparse.csr_array) -> Array:
    """Standard uncertainty of the glare, (cell,), in sums over pixels with the weights of a cell.

    Parameters
    ----------
    picture : (y, x), finite, without its glare
    weights : (cell, pixel by rows)
    """
    if not np.isfinite(glare.misfit):
        return np.zeros(weights.shape[0])
    halos = _spread(_halos(_joined(picture)), picture.shape).reshape(WIDTHS.size, -1)
    sums = np.column_stack([weights @ halos.T, weights.sum(axis=1)])
    variance = np.einsum("ci,ij,cj->c", sums, glare.covariance, sums)
    return np.sqrt(np.maximum(variance, 0.0) + (_MODEL * (sums[:, :-1] @ glare.amplitudes)) ** 2)


def _solution(design: Array, seen: Array) -> tuple[Array, Array]:
    """Amplitudes and level that are not negative, and their covariance, of a design and pictures in standard deviations."""
    count = WIDTHS.size
    # How much there is altogether, were all widths alike: the measure of what the amplitudes may do.
    together = np.column_stack([design[:, :-1].mean(axis=1), design[:, -1]])
    total, level = _not_negative(together, seen)
    # The level in units of a pixel's noise, if it is less.
    unit = np.append(np.full(count, max(float(total), 1e-6)), max(float(level), 1 / float(design[:, -1].mean())))
    bends = np.diff(np.eye(count), 2, axis=0) / _STIFF
    prior = np.pad(np.concatenate([bends, np.eye(count)]), ((0, 0), (0, 1)))
    stacked = np.concatenate([design * unit, prior])
    found = _not_negative(stacked, np.append(seen, np.zeros(len(prior))))
    return found * unit, np.asarray(np.linalg.inv(stacked.T @ stacked)) * np.outer(unit, unit)


def _not_negative(design: Array, seen: Array) -> Array:
    """Least squares without negative unknowns.

    By the normal equations, which a prior keeps well conditioned: a search with as many rows as pixels takes a hundred times as long.
    """
    normal = design.T @ design
    # An unknown of which nothing is seen stays 0.
    normal[np.diag_indices_from(normal)] += 1e-12 * normal.diagonal() + 1e-300
    triangle = np.linalg.cholesky(normal)
    return np.asarray(optimize.nnls(triangle.T, np.linalg.solve(triangle, design.T @ seen))[0])


def _misfit(residual: Array, dark: NDArray[np.bool_]) -> float:
    """χ² over the degrees of freedom of the sums over blocks of a residual in standard deviations."""
    picture = np.zeros(dark.shape)
    picture[dark] = residual
    rows, columns = (size // _BLOCK * _BLOCK for size in dark.shape)
    shape = (rows // _BLOCK, _BLOCK, columns // _BLOCK, _BLOCK)
    total = picture[:rows, :columns].reshape(shape).sum(axis=(1, 3))
    count = dark[:rows, :columns].reshape(shape).sum(axis=(1, 3))
    full = count >= _BLOCK**2 / 4
    return float((total[full] ** 2 / count[full]).mean()) if full.any() else 1.0


def _joined(pictures: Array) -> Array:
    rows, columns = (size // BIN * BIN for size in pictures.shape[-2:])
    shape = (*pictures.shape[:-2], rows // BIN, BIN, columns // BIN, BIN)
    return np.asarray(pictures[..., :rows, :columns].reshape(shape).mean(axis=(-3, -1), dtype=float))


def _spread(joined: Array, shape: tuple[int, ...]) -> Array:
    """Joined pictures on every pixel again, linearly between the middles of the joined ones."""
    for axis, (size, count) in enumerate(zip(shape, joined.shape[-2:], strict=True), start=-2):
        place = np.clip((np.arange(size) + 0.5) / BIN - 0.5, 0, count - 1)
        low = np.minimum(place.astype(int), count - 2)
        part = np.expand_dims((place - low).astype(joined.dtype), tuple(range(axis + 1, 0)))
        joined = np.take(joined, low, axis) * (1 - part) + np.take(joined, low + 1, axis) * part
    return joined


def _halos(joined: Array) -> Array:
    """A joined picture spread by each Gaussian, (width, y, x)."""
    padded, squared = _frequencies(joined.shape)
    spectrum = fft.rfft2(joined, padded) * _gaussians(squared)
    return np.asarray(fft.irfft2(spectrum, padded)[:, : joined.shape[0], : joined.shape[1]])


def _frequencies(shape: tuple[int, ...]) -> tuple[tuple[int, int], Array]:
    """Size of joined pictures with dark all round, and the squared frequencies of their transforms [1/pixel²]."""
    rows, columns = (fft.next_fast_len(2 * size, real=True) for size in shape[-2:])
    return (rows, columns), fft.fftfreq(rows, BIN)[:, None] ** 2 + fft.rfftfreq(columns, BIN) ** 2


def _gaussians(squared: Array) -> Array:
    """Transforms of the Gaussians, (width, …)."""
    return np.exp(-2 * (np.pi * WIDTHS[:, None, None]) ** 2 * squared)
