"""The curvature of the light over a cell of the disc: by how much the mean over the cell differs from the value in its middle."""

from __future__ import annotations

import numpy as np
from scipy import ndimage, sparse

from brdfpipe.geometry import Array
from brdfpipe.rig.description import Rig
from brdfpipe.rig.reduction import pictures
from brdfpipe.rig.reduction.cells import cell_sums
from brdfpipe.rig.reduction.exposures import Mask
from brdfpipe.rig.reduction.registration import Registration

CURVATURE_U = 0.05
"""Relative standard uncertainty of the curvature correction."""

_NEXT_ORDER = 0.15
"""Half of the next term over the square of the correction, as of the exponential flank of a lobe: sinh x / x = 1 + b + 0.3 b² + …, b = x²/6."""
_SMOOTHING = 1.5  # standard deviation of the Gaussian [pixel] that smooths the light before its curvature is taken
_TRUNCATION = 6.0  # in standard deviations; at 4 its second derivative gives even light a curvature of 1e-4
_LARGEST_RATIO = 1.2  # largest ratio of a cell's light to its smoothed light
_RIM_CLEARANCE = 3.5  # distance from the disc's rim, in standard deviations, within which no curvature is taken


def curvature_correction(
    rig: Rig, registration: Registration, weights: sparse.csr_array, clean: Array, area: Array, of_disc: Mask
) -> tuple[Array, sparse.csr_array]:
    """The part of curvature in the sums over disc cells (wavelength, cell), and the weights (cell, pixel) of the light that give it.

    ``weights`` are the shares (cell, pixel) of pixels in cells, ``clean`` the light (wavelength, y, x) without glare, ``area`` in pixels.

    The mean over a cell of second moments M about its middle is f + ½ Σ M_jk ∂_j∂_k f; the core of the point spread adds its own moments.
    Derivatives are those of the smoothed light, divided by that light: smoothing raises both alike on the flank of a lobe. Near the rim they
    follow from the part of a cell farther inside.
    """
    margin = -_RIM_CLEARANCE * _SMOOTHING / registration.screen.scale
    inner = pictures.within_disc(rig, registration.screen, margin)
    within = sparse.csr_array(
        sparse.diags_array(of_disc.astype(float)) @ weights @ sparse.diags_array(inner.ravel() * 1.0)
    )
    within.eliminate_zeros()
    whole = area / np.maximum(within.sum(axis=1), 1.0)
    y, x = np.indices(inner.shape).reshape(2, -1)
    middle = [weights @ axis / np.maximum(area, 1.0) for axis in (y, x)]
    coefficients = {}
    for first, second in ((0, 0), (1, 1), (0, 1)):
        moment = weights @ ((y, x)[first] * (y, x)[second]) / np.maximum(area, 1.0) - middle[first] * middle[second]
        orders = ((first == 0) + (second == 0), (first == 1) + (second == 1))
        # Half of either second derivative, and of the mixed one twice; the moment of a pixel is 1/12.
        coefficients[orders] = whole * ((moment + 1 / 12 + registration.blur**2) / 2 if first == second else moment)
    bends, smooth = _derivative_weights(within, inner.shape, [coefficients, {(0, 0): whole}])
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.nan_to_num(cell_sums(weights, clean) / cell_sums(smooth, clean))
    # Bounded, because noise makes the ratio of faint light arbitrary.
    return cell_sums(bends, clean) * np.clip(ratio, 0.0, _LARGEST_RATIO), bends


def curvature_u(correction: Array, signal: Array) -> Array:
    """Standard uncertainty of the curvature correction."""
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.nan_to_num(np.abs(correction / signal), posinf=1.0)
    return np.abs(correction) * np.minimum(CURVATURE_U + _NEXT_ORDER * share, 1.0)


def _derivative_weights(
    weights: sparse.csr_array, shape: tuple[int, ...], wanted: list[dict[tuple[int, int], Array]]
) -> list[sparse.csr_array]:
    """Weights (cell, pixel) that give sums over cells of derivatives of the smoothed light, each order times a coefficient of the cell.

    The Gaussian and its even derivatives are self-adjoint: instead of the light, each cell's weights are filtered, within a box about it.
    """
    height, width = shape
    filled = np.flatnonzero(np.diff(weights.indptr))
    cell = np.repeat(np.arange(filled.size), np.diff(weights.indptr)[filled])
    row, column = np.divmod(weights.indices, width)
    margin = int(_TRUNCATION * _SMOOTHING + 0.5) + 1
    starts = weights.indptr[filled]
    low = [np.minimum.reduceat(axis, starts) - margin if filled.size else axis for axis in (row, column)]
    box = [int((at - least[cell]).max(initial=0)) + margin + 1 for at, least in zip((row, column), low, strict=True)]
    boxed = np.zeros((filled.size, *box))
    boxed[cell, row - low[0][cell], column - low[1][cell]] = weights.data
    y, x = (least[:, None] + np.arange(size) for least, size in zip(low, box, strict=True))
    within = ((y >= 0) & (y < height))[:, :, None] & ((x >= 0) & (x < width))[:, None, :]
    pixel = (y[:, :, None] * width + x[:, None, :])[within]
    owner = np.broadcast_to(filled[:, None, None], within.shape)[within]
    matrices = []
    for coefficients in wanted:
        filtered = np.zeros(boxed.shape)
        for orders, coefficient in coefficients.items():
            sigma = (0, _SMOOTHING, _SMOOTHING)
            derivative = ndimage.gaussian_filter(boxed, sigma, (0, *orders), mode="constant", truncate=_TRUNCATION)
            filtered += coefficient[filled, None, None] * derivative
        matrices.append(sparse.csr_array((filtered[within], (owner, pixel)), shape=weights.shape))
    return matrices
