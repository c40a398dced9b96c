"""The BRDF that a normal map and the BRDF of what it does not resolve have together, seen from afar."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from brdfpipe.bsdf.registry import representation
from brdfpipe.errors import BrdfpipeError
from brdfpipe.geometry import Array, unit_vector
from brdfpipe.texture.slope_split import MapSlopes

AREAS = ("relief", "flat")
"""What the points of a map are weighted by."""


def seen_from_afar(
    bsdf: xr.Dataset,
    slopes: MapSlopes,
    theta_i: ArrayLike,
    phi_i: ArrayLike,
    theta_o: ArrayLike,
    phi_o: ArrayLike,
    *,
    areas: str = AREAS[0],
    wavelength: ArrayLike | None = None,
) -> Array:
    """The mean BRDF of the points of a normal map.

    Parameters
    ----------
    bsdf : kind ``bsdf``, of what the map does not resolve
    slopes : of the map (:func:`brdfpipe.texture.slope_split.binned_slopes`)
    theta_i, phi_i, theta_o, phi_o : (n,) directions of reflection [degree], below 90 degree from the normal of the mean plane
    areas : ``relief``: each point has the area that both directions see of it, so that the result is reciprocal, and for microfacets
        exact but for masking. ``flat``: each has the area of its pixel on a flat polygon, as a renderer without displacement has it; at
        normal observation both agree
    wavelength : (m,) [nm]; None for a BSDF without wavelengths

    Returns
    -------
    (n, m) BRDF [sr-1]

    Raises
    ------
    BrdfpipeError : ``areas`` is unknown.

    Notes
    -----
    With normals n of the share w of the mean plane, f = Σ w f_n (i·n)(o·n) / ((n·z)(i·z)(o·z)); of a flat polygon
    f = Σ w f_n (i·n) / (i·z). Points do not hide one another: their masking is that of their own facets.
    """
    if areas not in AREAS:
        raise BrdfpipeError(f"unknown areas {areas!r}; accepted: {' or '.join(AREAS)}")
    incident, outgoing = (np.atleast_2d(unit_vector(theta, phi)) for theta, phi in ((theta_i, phi_i), (theta_o, phi_o)))
    wavelengths = None if wavelength is None else np.atleast_1d(np.asarray(wavelength, dtype=float))
    frames = local_frames(*slopes.slopes)
    step = max(1, _MOST_PAIRS // len(frames))
    parts = []
    for start in range(0, len(incident), step):
        part = slice(start, start + step)
        values = in_frames(bsdf, frames[None], incident[part, None], outgoing[part, None], areas, wavelengths)
        parts.append(np.einsum("b,nbm->nm", slopes.share, values))
    return np.concatenate(parts)


_MOST_PAIRS = 200_000
"""Pairs of a direction and a bin that are evaluated at once."""
_GRAZING = 1e-3


def in_frames(
    bsdf: xr.Dataset, frames: Array, incident: Array, outgoing: Array, areas: str, wavelength: Array | None
) -> Array:
    """The BRDF of the mean plane that points of a normal map have.

    Parameters
    ----------
    bsdf : kind ``bsdf``, of what the map does not resolve
    frames : (…, 3, 3) of the points (:func:`local_frames`)
    incident, outgoing : (…, 3) unit vectors, broadcast with the frames
    areas : one of :data:`AREAS`
    wavelength : (m,) [nm], or None

    Returns
    -------
    (…, m) [sr-1]; 0 at points that one of the directions does not see
    """
    i, o = np.broadcast_arrays(*(np.einsum("...ij,...j->...i", frames, one) for one in (incident, outgoing)))
    weight = i[..., 2] / incident[..., 2]
    if areas == AREAS[0]:
        weight = weight * o[..., 2] / (outgoing[..., 2] * frames[..., 2, 2])
    lit = (i[..., 2] > _GRAZING) & (o[..., 2] > _GRAZING)
    values = representation(bsdf).evaluate(*_angles(i[lit]), *_angles(o[lit]), wavelength)
    result = np.zeros((*lit.shape, values.shape[-1]))
    result[lit] = weight[lit][:, None] * values
    return result


def local_frames(slope_x: Array, slope_y: Array) -> Array:
    """(…, 3, 3) axes of points of a normal map, in rows: x in the plane of the normal, y, and the normal."""
    normal = np.stack([-slope_x, -slope_y, np.ones_like(slope_x)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    first = np.array([1.0, 0.0, 0.0]) - normal * normal[..., :1]
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    return np.stack([first, np.cross(normal, first), normal], axis=-2)


def _angles(vectors: Array) -> tuple[Array, Array]:
    """Polar angle and azimuth [degree] of unit vectors (n, 3)."""
    x, y, z = vectors.T
    return np.degrees(np.arctan2(np.hypot(x, y), z)), np.degrees(np.arctan2(y, x))
