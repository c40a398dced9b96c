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
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.geometry import Array, HalfVector
from brdfpipe.masking.smith import Smith, cotangent
from brdfpipe.masking.visibility import VISIBILITY
from brdfpipe.references.height_mesh import HeightMesh

_GRAZING = np.linspace(0.0, 0.96, 17)
_ASYMMETRY = np.linspace(0.0, 1.0, 6)
_SLOPE_STEP = 0.2  # between nodes of asinh(slope/width)
_STEEPEST = 1e-3  # share of the facets that are steeper than the last node
_NEAREST_HORIZON = 0.98  # largest asymmetry of the cosines that is traced
_BLOCKS = 8  # of the map along each axis, whose scatter is the uncertainty
_VIRTUAL_FACETS = 1.0  # counted as visible after Smith: the ratio is 1 where nothing else was counted
_LEAST_COUNT = 10.0  # visible facets after Smith below which a ratio is flagged


class VisibilityError(BrdfpipeError):
    """The visibility of facets cannot be tabulated for a surface."""


def tabulate(surface: xr.Dataset, facets: xr.Dataset, *, samples: int = 2**14, seed: int = 0) -> xr.Dataset:
    """Visibility of the facets of a map from pairs of directions, over Smith's.

    Parameters
    ----------
    surface : kind ``surface``, a levelled map
    facets : kind ``facets``, isotropic, estimated from that surface
    samples : facets that are traced for every incidence and asymmetry
    seed : of the positions of the facets

    Returns
    -------
    Dataset of kind ``visibility``: ``visibility_ratio`` = G2 / G2 of Smith, with ``visibility_ratio_u`` and
    ``visibility_ratio_quality``, over the coordinates of :class:`brdfpipe.masking.visibility.VisibilityRatio`. Where
    few facets were counted the ratio approaches 1, and is flagged as extrapolated.

    Raises
    ------
    VisibilityError : a surface with a lay.
    HeightMapError : as :meth:`brdfpipe.references.height_mesh.HeightMesh.of`; so for a line profile.

    Notes
    -----
    G2 of facets of slope s at the angle ζ from both directions is E[visible from both | s, ζ, δ]. Each facet's share of
    the mean plane counts. Beyond its edges the map goes on in its mirror image.

    References
    ----------
    Ribardière et al. 2019 (visibility of measured maps); Smith 1967; Heitz 2014 (JCGT 3(2)), eq. 99.
    """
    vocabulary.validate(facets, "facets")
    if facets["slope_density"].ndim != 1:
        raise VisibilityError(
            "masking 'measured' is for isotropic surfaces, and this one has a lay; set `surface.isotropic: true` or another `model.masking`"
        )
    mesh = HeightMesh.of(surface)
    smith, width = Smith.of(facets), RadialDensity.of(facets).median_slope
    steepest = float(np.quantile(np.hypot(*mesh.slopes()), 1 - _STEEPEST))
    steepness = _SLOPE_STEP * np.arange(max(4, int(np.ceil(np.arcsinh(steepest / width) / _SLOPE_STEP)) + 1))
    blocks = np.arange(samples) * _BLOCKS**2 // samples
    visible, expected = np.zeros((2, _GRAZING.size, steepness.size, _ASYMMETRY.size, _BLOCKS**2))
    for row, grazing in enumerate(_GRAZING):
        for column, asymmetry in enumerate(_ASYMMETRY):
            position = _positions(mesh, blocks, seed + row * _ASYMMETRY.size + column)
            counted, slope, pair, seen = _seen(mesh, position, grazing, asymmetry, width)
            at = np.minimum(np.arcsinh(slope / width) / _SLOPE_STEP, steepness.size - 1)
            for sums, values in ((visible, seen.astype(float)), (expected, _smith_g2(pair, smith))):
                sums[row, :, column] = _shared_sums(at, blocks[counted], values, steepness.size)
    # In these limits the asymmetry has no meaning.
    for sums in (visible, expected):
        sums[0] = sums[0].mean(axis=1, keepdims=True)
        sums[:, 0] = sums[:, 0].mean(axis=1, keepdims=True)
    ratio, relative_u = _ratio(visible, expected)
    extrapolated = expected.sum(axis=-1) < _LEAST_COUNT
    dims = ("grazing", "steepness", "asymmetry")
    quality = np.where(extrapolated, vocabulary.quality("extrapolated"), vocabulary.quality("measured"))
    result = xr.Dataset(
        {
            "visibility_ratio": (dims, ratio),
            "visibility_ratio_u": (dims, ratio * relative_u),
            "visibility_ratio_quality": (dims, quality.astype(np.int8)),
        },
        coords={"grazing": _GRAZING, "steepness": steepness, "asymmetry": _ASYMMETRY},
        attrs={"method": f"{samples} facets of the map for each incidence and asymmetry"},
    )
    return vocabulary.label(result, "visibility")


def _positions(mesh: HeightMesh, block: NDArray[np.intp], seed: int) -> Array:
    """(n, 2) positions along x and y, in cells, evenly spread over the blocks of the map in their order."""
    number = np.arange(block.size)
    shift = np.random.default_rng(seed).random(2)
    # Roberts' additive recurrence in two dimensions.
    within = (shift + (number[:, None] + 1) * [0.7548776662466927, 0.5698402909980532]) % 1.0
    row, column = np.divmod(block, _BLOCKS)
    rows, columns = mesh.present.shape
    place = np.stack([column, row], axis=1).astype(float) + within
    return np.asarray(place * [columns / _BLOCKS, rows / _BLOCKS], dtype=float)


def _seen(
    mesh: HeightMesh, position: Array, grazing: float, asymmetry: float, width: float
) -> tuple[NDArray[np.bool_], Array, HalfVector, NDArray[np.bool_]]:
    """Positions whose facet was measured, and of these facets: slope, the pair of directions, and whether both see them."""
    from brdfpipe.references import ray_kernel

    counted = mesh.present[position[:, 1].astype(int), position[:, 0].astype(int)]
    position = np.ascontiguousarray(position[counted])
    facet = np.empty((position.shape[0], 4))
    ray_kernel.facets_at(mesh.height, mesh.pitch, position, facet)
    slope = np.hypot(facet[:, 1], facet[:, 2])
    tan_zeta = grazing / ((1 - grazing) * width)
    zeta = float(np.arctan(tan_zeta))
    limit = np.minimum(slope * tan_zeta, 1.0)
    difference = np.minimum(asymmetry * limit, _NEAREST_HORIZON)
    turn = np.arccos(np.clip(difference / np.maximum(slope * tan_zeta, 1e-300), 0.0, 1.0))
    # Both sides of the plane by turns.
    turn[1::2] *= -1
    visible = np.empty(slope.size, dtype=bool)
    low = float(mesh.height.min())
    ray_kernel.visible_pairs(
        mesh.height, mesh.ceiling, mesh.offset, low, mesh.pitch, mesh.edges, position, facet, zeta, turn, visible
    )
    difference = np.where(slope * tan_zeta > 0, difference, 0.0)
    mean = np.cos(zeta) / np.sqrt(1 + slope**2)
    cos_i, cos_o = mean * (1 - difference), mean * (1 + difference)
    sin_i, sin_o = (np.sqrt(np.maximum((1 - cos) * (1 + cos), 0.0)) for cos in (cos_i, cos_o))
    pair = HalfVector(slope**2, np.full_like(slope, np.cos(zeta)), cos_i, sin_i, cos_o, sin_o)
    return counted, slope, pair, visible


def _smith_g2(pair: HalfVector, smith: Smith) -> Array:
    towards = ((pair.cos_i, pair.sin_i), (pair.cos_o, pair.sin_o))
    excess = (smith.excess(cotangent(cos, sin)) for cos, sin in towards)
    return VISIBILITY["height-correlated"](pair, *excess) * pair.cos_i * pair.cos_o


def _shared_sums(at: Array, block: NDArray[np.intp], values: Array, nodes: int) -> Array:
    """(node, block) sums of values, each shared linearly between the two nodes beside its place."""
    node = np.minimum(at.astype(np.intp), nodes - 2)
    share = at - node
    index, size = node * _BLOCKS**2 + block, nodes * _BLOCKS**2
    lower = np.bincount(index, values * (1 - share), minlength=size)
    upper = np.bincount(index + _BLOCKS**2, values * share, minlength=size)
    return np.asarray(lower + upper, dtype=float).reshape(nodes, _BLOCKS**2)


def _ratio(visible: Array, expected: Array) -> tuple[Array, Array]:
    """Visible over expected facets, over the blocks (last axis), and its relative standard uncertainty from their scatter."""
    total = expected.sum(axis=-1) + _VIRTUAL_FACETS
    ratio = (visible.sum(axis=-1) + _VIRTUAL_FACETS) / total
    blocks = visible.shape[-1]
    scatter = np.sum((visible - ratio[..., None] * expected) ** 2, axis=-1) * blocks / (blocks - 1)
    return ratio, np.sqrt(scatter + _VIRTUAL_FACETS**2) / (total * ratio)
