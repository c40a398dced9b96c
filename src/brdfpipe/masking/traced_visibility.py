"""Visibility of facets traced on a height map, as a ratio to Smith's height-correlated masking.

A facet of the map is seen from pairs of directions that it mirrors into each other, so the share that is visible from both is G2 of
facets of just that slope: what the BRDF needs. Counted over facets of like slope all over the map, and over all azimuths, it is divided
by Smith's G2 of the same facets.
"""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import vocabulary
from brdfpipe.errors import BrdfpipeError
from brdfpipe.geometry import Array, HalfVector
from brdfpipe.masking.facet_sample import BLOCKS, FacetSample, direction
from brdfpipe.masking.smith import cotangent
from brdfpipe.masking.visibility import VISIBILITY
from brdfpipe.references.height_mesh import HeightMesh

GRAZING: Array = np.linspace(0.0, 0.96, 17)
"""Nodes of 1/(1 + cot ζ / w), ζ the angle of directions from a facet's normal, and w the median slope."""
ASYMMETRY: Array = np.linspace(0.0, 1.0, 6)
SAMPLES = 2**12
"""Facets that are traced for every node of grazing and asymmetry."""
STEEPNESS_STEP = 0.2
"""Between nodes of asinh(slope/w)"""
VIRTUAL_FACETS = 1.0
"""Counted as visible after Smith: the ratio is 1 where nothing else was counted."""

_STEEPEST = 1e-3  # share of the facets that are steeper than the last node
_NEAREST_HORIZON = 0.98  # largest asymmetry of the cosines that is traced
_LEAST_COUNT = 10.0  # visible facets after Smith below which a ratio is flagged
_SEEN_WHOLE = (
    0.35  # grazing below which hardly a facet is masked, so that a quarter of the facets gives the same uncertainty
)


class VisibilityError(BrdfpipeError):
    """The visibility of facets cannot be tabulated for a surface."""


def tabulate(mesh: HeightMesh, *, samples: int = SAMPLES, seed: int = 0) -> xr.Dataset:
    """Visibility of the facets of an isotropic map from one direction and from pairs of directions, over Smith's.

    Parameters
    ----------
    mesh : of a map
    samples : facets that are traced for every incidence and asymmetry
    seed : of the positions of the facets

    Returns
    -------
    Variables of a dataset of kind ``visibility``, each with ``_u`` and ``_quality``:
    ``visibility_ratio`` = G2 / G2 of Smith over the coordinates of :class:`brdfpipe.masking.visibility.VisibilityRatio`;
    ``single_ratio`` = G1 / G1 of Smith over the grazing of one direction, and asinh(t/w) of the facet's slope t towards it.
    Where few facets were counted a ratio approaches 1, and is flagged as extrapolated.

    Raises
    ------
    VisibilityError : a map without slopes.

    Notes
    -----
    G2 of facets of slope s at the angle ζ from both directions is E[visible from both | s, ζ, δ]. Each facet's share of
    the mean plane counts. Beyond its edges the map goes on in its mirror image. Smith's G2 is that of the slopes of the mesh itself, so
    that noise of the heights changes both.

    References
    ----------
    Ribardière et al. 2019 (visibility of measured maps); Smith 1967; Heitz 2014 (JCGT 3(2)), eqs. 72 and 99.
    """
    facets = FacetSample.of(mesh, 4 * samples, seed)
    width, nodes = width_and_nodes(np.hypot(*facets.slopes))
    return single_ratio(facets, width, nodes).merge(_pair_ratio(facets, width, nodes, samples, seed))


def width_and_nodes(slopes: Array) -> tuple[float, int]:
    """Median of the slopes, and number of nodes of the steepness, whose last node hardly a slope exceeds."""
    median, steepest = np.quantile(slopes, [0.5, 1 - _STEEPEST])
    if not median > 0:
        raise VisibilityError(
            "more than half of the slopes are 0, so that they have no typical size; measure where the finish is"
        )
    return float(median), max(4, int(np.ceil(np.arcsinh(steepest / median) / STEEPNESS_STEP)) + 1)


def single_ratio(facets: FacetSample, width: float, nodes: int) -> xr.Dataset:
    """Facets visible from one direction over Smith's G1, by the grazing of the direction and the slope towards it."""
    smith = facets.smith_excess()
    azimuth = facets.azimuth
    towards = facets.slope_towards(azimuth)
    at = np.clip(np.arcsinh(towards / width) / STEEPNESS_STEP + nodes - 1, 0, 2 * nodes - 2)
    sums = np.zeros((2, GRAZING.size, 2 * nodes - 1, BLOCKS**2))
    for row, grazing in enumerate(GRAZING):
        theta = angle_of(grazing, width)
        facing = np.cos(theta) + towards * np.sin(theta) > 0
        visible = facets.visible(direction(np.full(towards.size, theta), azimuth))
        cot = 1 / np.tan(theta) if grazing > 0 else np.inf
        g1 = 1 / (1 + smith(np.array([cot]))[0] / cot)
        for part, values in zip(sums, (visible.astype(float), g1 * facing), strict=True):
            part[row] = shared_sums(at, facets.block, values, 2 * nodes - 1)
    steepness: Array = STEEPNESS_STEP * np.arange(1.0 - nodes, nodes)
    return ratios("single_ratio", sums, {"grazing": GRAZING, "steepness_towards": steepness})


def _pair_ratio(facets: FacetSample, width: float, nodes: int, samples: int, seed: int) -> xr.Dataset:
    smith = facets.smith_excess()
    sums = np.zeros((2, GRAZING.size, nodes, ASYMMETRY.size, BLOCKS**2))
    for row, grazing in enumerate(GRAZING):
        fewer = samples if grazing > _SEEN_WHOLE else samples // 4
        for column, asymmetry in enumerate(ASYMMETRY if row else ASYMMETRY[:1]):
            some = FacetSample.of(facets.mesh, fewer, seed + 1 + row * ASYMMETRY.size + column)
            pair, towards = mirrored_pairs(*some.slopes, angle_of(grazing, width), asymmetry)
            at = np.minimum(np.arcsinh(np.sqrt(pair.slope_squared) / width) / STEEPNESS_STEP, nodes - 1)
            g2 = VISIBILITY["height-correlated"](
                pair, *(smith(cotangent(*one)) for one in ((pair.cos_i, pair.sin_i), (pair.cos_o, pair.sin_o)))
            )
            seen = some.visible(*towards).astype(float)
            for part, values in zip(sums, (seen, g2 * pair.cos_i * pair.cos_o), strict=True):
                part[row, :, column] = shared_sums(at, some.block, values, nodes)
    # In these limits the asymmetry has no meaning.
    sums[:, 0] = sums[:, 0, :, :1]
    sums[:, :, 0] = sums[:, :, 0].mean(axis=2, keepdims=True)
    axes = {"grazing": GRAZING, "steepness": STEEPNESS_STEP * np.arange(float(nodes)), "asymmetry": ASYMMETRY}
    return ratios("visibility_ratio", sums, axes)


def angle_of(grazing: float, width: float) -> float:
    """Angle [rad] of a node of grazing."""
    return float(np.arctan(grazing / ((1 - grazing) * width)))


def mirrored_pairs(p: Array, q: Array, zeta: float, asymmetry: float) -> tuple[HalfVector, tuple[Array, Array]]:
    """Pairs of directions at ``zeta`` [rad] that facets of slopes ``p`` and ``q``, (n,), mirror into each other, also as vectors, (n, 3)."""
    slope = np.hypot(p, q)
    secant = np.sqrt(1 + slope**2)
    reach = slope * np.tan(zeta)
    difference = np.minimum(asymmetry * np.minimum(reach, 1.0), _NEAREST_HORIZON)
    along = np.clip(difference / np.maximum(reach, 1e-300), 0.0, 1.0)
    # Both sides of the plane by turns.
    across = np.sqrt(1 - along**2) * np.where(np.arange(slope.size) % 2, -1.0, 1.0)
    with np.errstate(invalid="ignore"):
        down_x, down_y = np.where(slope > 0, -p / slope, 1.0), np.where(slope > 0, -q / slope, 0.0)
    normal = np.stack([slope * down_x, slope * down_y, np.ones_like(slope)], axis=-1) / secant[:, None]
    descent = np.stack([down_x, down_y, -slope], axis=-1) / secant[:, None]
    level = np.stack([-down_y, down_x, np.zeros_like(slope)], axis=-1)
    sideways = np.sin(zeta) * (along[:, None] * descent + across[:, None] * level)
    mean = np.cos(zeta) / secant
    difference = np.where(reach > 0, difference, 0.0)
    cos_i, cos_o = mean * (1 - difference), mean * (1 + difference)
    sin_i, sin_o = (np.sqrt(np.maximum((1 - cos) * (1 + cos), 0.0)) for cos in (cos_i, cos_o))
    pair = HalfVector(slope**2, np.full_like(slope, np.cos(zeta)), cos_i, sin_i, cos_o, sin_o)
    central = np.cos(zeta) * normal
    return pair, (central + sideways, central - sideways)


def shared_sums(at: Array, block: NDArray[np.intp], values: Array, nodes: int) -> Array:
    """(node, block) sums of values, each shared linearly between the two nodes beside its place."""
    node = np.minimum(at.astype(np.intp), nodes - 2)
    share = at - node
    index, size = node * BLOCKS**2 + block, nodes * BLOCKS**2
    lower = np.bincount(index, values * (1 - share), minlength=size)
    upper = np.bincount(index + BLOCKS**2, values * share, minlength=size)
    return np.asarray(lower + upper, dtype=float).reshape(nodes, BLOCKS**2)


def ratios(name: str, sums: Array, axes: dict[str, Array]) -> xr.Dataset:
    """Visible over expected facets with uncertainty and quality, from both sums, (2, *axes, block)."""
    visible, expected = sums
    ratio, relative_u = ratio_of_sums(visible, expected)
    extrapolated = expected.sum(axis=-1) < _LEAST_COUNT
    quality = np.where(extrapolated, vocabulary.quality("extrapolated"), vocabulary.quality("measured"))
    fields = {name: ratio, f"{name}_u": ratio * relative_u, f"{name}_quality": quality.astype(np.int8)}
    return xr.Dataset({key: (tuple(axes), values) for key, values in fields.items()}, axes)


def ratio_of_sums(visible: Array, expected: Array, virtual: Array | float = VIRTUAL_FACETS) -> tuple[Array, Array]:
    """Visible over expected facets, over the blocks (last axis), and its relative standard uncertainty from their scatter."""
    total = expected.sum(axis=-1) + virtual
    ratio = (visible.sum(axis=-1) + virtual) / total
    blocks = visible.shape[-1]
    scatter = np.sum((visible - ratio[..., None] * expected) ** 2, axis=-1) * blocks / (blocks - 1)
    return ratio, np.sqrt(scatter + virtual**2) / (total * ratio)
