"""Vignetting and gradients of the illumination of a picture, found and removed."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from brdfpipe.geometry import Array

DEGREE = 2
"""Of the polynomial in both positions."""
_BLOCKS = 16
"""Blocks along a side, to whose medians the polynomial is fitted."""


def without_gradient(values: Array) -> tuple[Array, float]:
    """A picture of unit mean without the slow change of its illumination.

    Parameters
    ----------
    values : (rows, columns) light in any unit

    Returns
    -------
    The picture over the fitted illumination, of mean 1; and the largest fitted illumination over the least, less 1

    Notes
    -----
    The illumination is a polynomial of degree 2 in x and y, fitted to the medians of 16 x 16 blocks. It has no structure finer than half of the picture.
    """
    rows, columns = ((np.arange(n) + 0.5) / n * 2 - 1 for n in values.shape)
    edges = [np.linspace(0, n, _BLOCKS + 1).astype(int) for n in values.shape]
    # Medians: those of few sparkles do not differ from block to block as means do.
    medians = np.array(
        [
            [np.median(values[top:end, left:right]) for left, right in pairwise(edges[1])]
            for top, end in pairwise(edges[0])
        ]
    )
    middles = [(edge[:-1] + edge[1:]) / values.shape[k] - 1 for k, edge in enumerate(edges)]
    powers = [(i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)]
    basis = np.stack([np.outer(middles[0] ** i, middles[1] ** j).ravel() for i, j in powers], axis=1)
    factors = np.linalg.lstsq(basis, medians.ravel(), rcond=None)[0]
    fitted = sum(factor * np.outer(rows**i, columns**j) for factor, (i, j) in zip(factors, powers, strict=True))
    # Where light is almost absent the polynomial may cross zero.
    fitted = np.maximum(fitted, 0.05 * medians.mean())
    flat = values / fitted
    return flat / flat.mean(), float(fitted.max() / fitted.min() - 1)
