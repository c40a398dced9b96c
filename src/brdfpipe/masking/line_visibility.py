"""Visibility of the facets of an isotropic surface, from a line across it.

On a line only directions in its plane can be traced, and only the slope along it is known. Two assumptions lead to other directions:

- A facet is seen from a direction as the line's facets of the same slope towards that direction are: what it is seen like does not depend
  on its slope across. On a Gaussian surface this is exact; on cells, flat tops are counted together with their flanks.
- Of a pair of directions, with λ = 1/G1 − 1 of either, G2 = c^w / (1 + λ_i + λ_o), w = (1 − cos(φ_i − φ_o))/2. The factor c of opposite
  directions is traced; towards one side, where w = 0, it is 1, as in Smith's.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.geometry import Array
from brdfpipe.masking.facet_sample import FacetSample
from brdfpipe.masking.smith import cotangent
from brdfpipe.masking.traced_visibility import (
    ASYMMETRY,
    GRAZING,
    SAMPLES,
    STEEPNESS_STEP,
    angle_of,
    mirrored_pairs,
    ratio_of_sums,
    shared_sums,
    single_ratio,
    width_and_nodes,
)
from brdfpipe.masking.visibility import SingleVisibility
from brdfpipe.references.height_mesh import HeightMesh

_WITHIN_PLANE = (
    0.98  # largest slope over cot ζ of a facet with both directions in the plane of the line and above the horizon
)


def tabulate_line(mesh: HeightMesh, typical_slope: float, *, samples: int = SAMPLES, seed: int = 0) -> xr.Dataset:
    """Visibility of the facets of an isotropic surface from one direction and from pairs of directions, over Smith's.

    Parameters
    ----------
    mesh : of a line
    typical_slope : median slope √(p² + q²) of the surface's facets
    samples : a fourth of the facets that are traced at every node of grazing
    seed : of the positions of the facets

    Returns
    -------
    As :func:`brdfpipe.masking.traced_visibility.tabulate`.

    Raises
    ------
    VisibilityError : a line without slopes.
    """
    facets = FacetSample.of(mesh, 4 * samples, seed)
    _, nodes = width_and_nodes(np.abs(facets.slopes[0]) / typical_slope)
    single = single_ratio(facets, typical_slope, nodes)
    by_one = SingleVisibility.of(single)
    by_one_u = replace(by_one, ratio=single["single_ratio_u"].values)
    traced = _TracedLine(facets, typical_slope, by_one, by_one_u)
    steepness = STEEPNESS_STEP * np.arange(nodes)
    ratio, u = (np.ones((GRAZING.size, nodes, ASYMMETRY.size)) for _ in range(2))
    u *= 0
    for row, grazing in enumerate(GRAZING[1:], start=1):
        zeta = angle_of(grazing, typical_slope)
        factor, factor_u = traced.opposite_factor(zeta, nodes)
        for column, asymmetry in enumerate(ASYMMETRY):
            ratio[row, :, column], u[row, :, column] = traced.pair_ratio(
                typical_slope * np.sinh(steepness), zeta, asymmetry, factor, factor_u
            )
    axes = {"grazing": GRAZING, "steepness": steepness, "asymmetry": ASYMMETRY}
    flag = np.where(u > ratio, vocabulary.quality("extrapolated"), vocabulary.quality("measured"))
    fields = {"visibility_ratio": ratio, "visibility_ratio_u": u, "visibility_ratio_quality": flag.astype(np.int8)}
    return single.merge(xr.Dataset({name: (tuple(axes), values) for name, values in fields.items()}, axes))


class _TracedLine(NamedTuple):
    """Facets of a line, and their visibility from one direction over Smith's, with its standard uncertainty."""

    facets: FacetSample
    typical_slope: float
    ratio: SingleVisibility
    ratio_u: SingleVisibility

    def hidden(self, slope: Array, direction: Array) -> tuple[Array, Array, Array]:
        """1/G1 − 1 of facets that fall by ``slope`` along x, from unit vectors (n, 3): after Smith, as traced, and the latter's uncertainty."""
        cos, sin = direction[:, 2], np.hypot(direction[:, 0], direction[:, 1])
        mu = cotangent(cos, sin)
        smith = self.facets.smith_excess()(mu) / np.maximum(mu, 1e-12)
        towards = np.divide(slope * direction[:, 0], sin, out=np.zeros_like(sin), where=sin > 0)
        ratio, u = (table(mu, towards, self.typical_slope) for table in (self.ratio, self.ratio_u))
        inverse = (1 + smith) / ratio
        return smith, inverse - 1, inverse * u / ratio

    def opposite_factor(self, zeta: float, nodes: int) -> tuple[Array, Array]:
        """Facets seen from both of two opposite directions at ζ over 1/(1 + λ_i + λ_o), by their steepness; and its relative uncertainty."""
        p = self.facets.slopes[0]
        use = np.flatnonzero(np.abs(p) * np.tan(zeta) <= _WITHIN_PLANE)
        facets, fall = self.facets.take(use), -p[use]
        _, towards = mirrored_pairs(-fall, np.zeros_like(fall), zeta, 1.0)
        (_, lambda_i, _), (_, lambda_o, _) = (self.hidden(fall, one) for one in towards)
        at = np.minimum(np.arcsinh(np.abs(fall) / self.typical_slope) / STEEPNESS_STEP, nodes - 1)
        counted = facets.visible(*towards).astype(float), 1 / (1 + lambda_i + lambda_o)
        return ratio_of_sums(*(shared_sums(at, facets.block, values, nodes) for values in counted))

    def pair_ratio(
        self, slope: Array, zeta: float, asymmetry: float, factor: Array, factor_u: Array
    ) -> tuple[Array, Array]:
        """G2 over Smith's of facets of some slopes, and its standard uncertainty."""
        _, (towards_i, towards_o) = mirrored_pairs(-slope, np.zeros_like(slope), zeta, asymmetry)
        (smith_i, lambda_i, u_i), (smith_o, lambda_o, u_o) = (self.hidden(slope, one) for one in (towards_i, towards_o))
        across = np.hypot(*towards_i[:, :2].T) * np.hypot(*towards_o[:, :2].T)
        along = np.sum(towards_i[:, :2] * towards_o[:, :2], axis=1)
        opposite = 0.5 - 0.5 * np.divide(along, across, out=-np.ones_like(along), where=across > 0)
        hidden = 1 + lambda_i + lambda_o
        ratio = factor**opposite * (1 + smith_i + smith_o) / hidden
        return ratio, ratio * np.sqrt((opposite * factor_u) ** 2 + (u_i**2 + u_o**2) / hidden**2)
