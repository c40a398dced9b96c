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
    model, total = representation(bsdf), None
    wavelengths = None if wavelength is None else np.atleast_1d(np.asarray(wavelength, dtype=float))
    for (x, y), share in zip(slopes.slopes.T, slopes.share, strict=True):
        frame = local_frame(float(x), float(y))
        i, o = incident @ frame.T, outgoing @ frame.T
        lit = (i[:, 2] > _GRAZING) & (o[:, 2] > _GRAZING)
        weight = share * i[:, 2] / incident[:, 2]
        if areas == "relief":
            weight = weight * o[:, 2] / (outgoing[:, 2] * frame[2, 2])
        values = model.evaluate(*_angles(i[lit]), *_angles(o[lit]), wavelengths)
        if total is None:
            total = np.zeros((len(incident), values.shape[-1]))
        total[lit] += weight[lit, None] * values
    assert total is not None
    return total


_GRAZING = 1e-3


def local_frame(slope_x: float, slope_y: float) -> Array:
    """(3, 3) axes of a point of a normal map, in rows: x in the plane of its normal, y, and the normal."""
    normal = np.array([-slope_x, -slope_y, 1.0]) / np.sqrt(1 + slope_x**2 + slope_y**2)
    first = np.array([1.0, 0.0, 0.0]) - normal * normal[0]
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(normal, first), normal])


def _angles(vectors: Array) -> tuple[Array, Array]:
    """Polar angle and azimuth [degree] of unit vectors (n, 3)."""
    x, y, z = vectors.T
    return np.degrees(np.arctan2(np.hypot(x, y), z)), np.degrees(np.arctan2(y, x))
