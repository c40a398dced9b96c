"""Directions and frames.

Directions are polar angle θ from the surface normal and azimuth φ counter-clockwise seen from above, in degrees, and point
away from the surface. The mirror direction of (θ, φ) is (θ, φ + 180). θ_o > 90 is transmission.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from brdfpipe.errors import VocabularyError

Array = NDArray[np.float64]


class HalfVector(NamedTuple):
    """The facet that mirrors one direction into another."""

    slope_squared: Array
    """tan²α of the facet's normal [1]."""
    cos_zeta: Array
    """Cosine of the local angle of incidence ζ on the facet [1]."""


def half_vector(theta_i: ArrayLike, phi_i: ArrayLike, theta_o: ArrayLike, phi_o: ArrayLike) -> HalfVector:
    """Slope and local incidence of the facet that mirrors ``i`` into ``o``.

    Parameters
    ----------
    theta_i, phi_i, theta_o, phi_o : degree, broadcastable; both directions on the same side, 0 <= θ <= 90

    Notes
    -----
    tan²α = |w_i + w_o|²_xy / |w_i + w_o|²_z and cos ζ = |w_i + w_o| / 2 (CRF, steps c and d). The tangential part is written
    as (sin θ_i − sin θ_o)² + 4 sin θ_i sin θ_o cos²(Δφ/2): near the mirror direction the textbook form
    s_i² + s_o² + 2 s_i s_o cos Δφ cancels and cannot resolve slopes below 1e-8.
    """
    theta_i, theta_o = np.radians(theta_i), np.radians(theta_o)
    half_difference = np.radians(np.asarray(phi_i, dtype=float) - phi_o) / 2
    sin_i, sin_o = np.sin(theta_i), np.sin(theta_o)
    sin_difference = 2 * np.cos((theta_i + theta_o) / 2) * np.sin((theta_i - theta_o) / 2)
    tangential = sin_difference**2 + 4 * sin_i * sin_o * np.cos(half_difference) ** 2
    normal = (np.cos(theta_i) + np.cos(theta_o)) ** 2
    with np.errstate(divide="ignore", invalid="ignore"):
        slope_squared = np.where(normal > 0, tangential / normal, np.inf)
    return HalfVector(slope_squared, np.minimum(np.sqrt(tangential + normal) / 2, 1.0))


def check_angles(name: str, angles: ArrayLike, low: float, high: float) -> Array:
    """Angles as floats, refused outside ``[low, high]`` degree, where undefined, or where labelled as radians.

    Raises
    ------
    VocabularyError : naming the angle and what is accepted.
    """
    units = getattr(angles, "attrs", {}).get("units", "degree")
    if units not in ("degree", "degrees", "deg", "°"):
        raise VocabularyError(f"{name} is in {units!r}; angles are in degree")
    values = np.asarray(angles, dtype=float)
    if values.size and not np.isfinite(values).all():
        raise VocabularyError(f"{name} has undefined values; angles must be finite")
    if values.size and (values.min() < low or values.max() > high):
        raise VocabularyError(
            f"{name} spans {values.min():g} to {values.max():g}; accepted are {low:g} to {high:g} degree"
        )
    return values


def unit_vector(theta: ArrayLike, phi: ArrayLike) -> Array:
    """Unit vectors (…, 3) of directions in degree."""
    theta, phi = np.radians(theta), np.radians(phi)
    return np.stack(
        np.broadcast_arrays(np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)), axis=-1
    )


def angles_of(vector: ArrayLike) -> tuple[Array, Array]:
    """Polar angle and azimuth, in degree, of vectors (…, 3) that need not be normalised."""
    v = np.asarray(vector, dtype=float)
    theta = np.degrees(np.arctan2(np.hypot(v[..., 0], v[..., 1]), v[..., 2]))
    return theta, np.degrees(np.arctan2(v[..., 1], v[..., 0]))


def checked_angles(name: str, angle: ArrayLike, low: float, high: float) -> xr.DataArray | Array:
    """Checked angles that stay a DataArray where they came as one."""
    values = check_angles(name, angle, low, high)
    return angle.copy(data=values) if isinstance(angle, xr.DataArray) else values


def broadcast(**angles: xr.DataArray | Array) -> tuple[xr.DataArray, ...]:
    """Directions that broadcast together: DataArrays by dimension name, plain arrays as in numpy into ``direction``."""
    plain = {name: angle for name, angle in angles.items() if not isinstance(angle, xr.DataArray)}
    shape = np.broadcast_shapes(*(angle.shape for angle in plain.values()))
    dims = ("direction",) if len(shape) == 1 else tuple(f"direction_{axis}" for axis in range(len(shape)))
    labelled = {
        name: angle if isinstance(angle, xr.DataArray) else xr.DataArray(np.broadcast_to(angle, shape), dims=dims)
        for name, angle in angles.items()
    }
    return xr.broadcast(*labelled.values())
