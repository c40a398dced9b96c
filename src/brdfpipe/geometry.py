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

_COMPARED_AT_ONCE = 2**15
"""Angles whose range is checked together."""


class HalfVector(NamedTuple):
    """Facet that mirrors one direction into another, and cosines and sines of both directions."""

    slope_squared: Array
    """tan²α of the facet's normal [1]."""
    cos_zeta: Array
    """Cosine of the local angle of incidence ζ on the facet [1]."""
    cos_i: Array
    sin_i: Array
    cos_o: Array
    sin_o: Array

    @property
    def cos_alpha(self) -> Array:
        """Cosine of the tilt of the facet's normal."""
        return np.asarray(1 / np.sqrt(1 + self.slope_squared))


def as_numbers(
    theta_i: ArrayLike, phi_i: ArrayLike, theta_o: ArrayLike, phi_o: ArrayLike
) -> tuple[Array, Array, Array, Array] | None:
    """The angles of one pair of directions as numbers, on which operations take a fraction of the time of arrays; None for several pairs."""
    if np.ndim(theta_i) or np.ndim(phi_i) or np.ndim(theta_o) or np.ndim(phi_o):
        return None
    one, two, three, four = (np.asarray(angle, dtype=float)[()] for angle in (theta_i, phi_i, theta_o, phi_o))
    return one, two, three, four


def half_vector(theta_i: ArrayLike, phi_i: ArrayLike, theta_o: ArrayLike, phi_o: ArrayLike) -> HalfVector:
    """Slope and local incidence of the facet that mirrors ``i`` into ``o``.

    Parameters
    ----------
    theta_i, phi_i, theta_o, phi_o : degree, broadcastable; both directions on the same side, 0 <= θ <= 90. Numbers give numbers, which
        take a fraction of the time of arrays

    Notes
    -----
    tan²α = |w_i + w_o|²_xy / |w_i + w_o|²_z and cos ζ = |w_i + w_o| / 2 (CRF, steps c and d). The tangential part is written
    as (sin θ_i − sin θ_o)² + 4 sin θ_i sin θ_o cos²(Δφ/2): near the mirror direction the textbook form
    s_i² + s_o² + 2 s_i s_o cos Δφ cancels and cannot resolve slopes below 1e-8. All follows from the tangents of the half
    angles, t = tan(θ/2): sin θ_i − sin θ_o = 2 (t_i − t_o)(1 − t_i t_o) / [(1 + t_i²)(1 + t_o²)].
    """
    t_i, t_o = tan_half(theta_i), tan_half(theta_o)
    over_i, over_o = 2 / (1 + t_i * t_i), 2 / (1 + t_o * t_o)
    sin_i, sin_o, cos_i, cos_o = t_i * over_i, t_o * over_o, over_i - 1, over_o - 1
    t_phi = tan_half(np.asarray(phi_i, dtype=float) - phi_o)
    difference = (t_i - t_o) * (1 - t_i * t_o) * (over_i * over_o / 2)
    tangential = difference * difference + 4 * (sin_i * sin_o) / (1 + t_phi * t_phi)
    normal = cos_i + cos_o
    normal *= normal
    with np.errstate(divide="ignore", invalid="ignore"):
        slope_squared = tangential / normal
    cos_zeta = np.minimum(np.sqrt(tangential + normal) / 2, 1.0)
    return HalfVector(slope_squared, cos_zeta, cos_i, sin_i, cos_o, sin_o)


def slope_towards(half: HalfVector, phi_i: ArrayLike, phi_o: ArrayLike) -> tuple[Array, Array]:
    """Slopes (p, q) along x and y of the facet that mirrors ``i`` into ``o``: −w_xy / w_z of w_i + w_o.

    Along the mean azimuth ψ of the two directions w_xy is (sin θ_i + sin θ_o) cos δ, across it (sin θ_i − sin θ_o) sin δ, δ half the
    difference of the azimuths: exact near the mirror direction, where the plain sum cancels.
    """
    phi_i, phi_o = np.asarray(phi_i, dtype=float), np.asarray(phi_o, dtype=float)
    mean, delta = np.radians(phi_i + phi_o) / 2, np.radians(phi_i - phi_o) / 2
    scale = -1 / (half.cos_i + half.cos_o)
    along = scale * (half.sin_i + half.sin_o) * np.cos(delta)
    across = scale * (half.sin_i - half.sin_o) * np.sin(delta)
    return along * np.cos(mean) - across * np.sin(mean), along * np.sin(mean) + across * np.cos(mean)


def tan_half(angle: ArrayLike) -> Array:
    """Tangent of half an angle in degree."""
    return np.tan(np.asarray(angle, dtype=float) * (np.pi / 360))


def check_angles(name: str, angles: ArrayLike, low: float, high: float) -> Array:
    """Check angles and return them as floats.

    Raises VocabularyError: an angle outside ``[low, high]`` degree, not finite, or with units other than degree.
    """
    if isinstance(angles, float | int) and low <= angles <= high:
        return np.array(angles, dtype=float)
    units = getattr(angles, "attrs", {}).get("units", "degree")
    if units not in ("degree", "degrees", "deg", "°"):
        raise VocabularyError(f"{name} is in {units!r}; accepted: degree")
    values = np.asarray(angles, dtype=float)
    if not _are_within(values, low, high):
        if not np.isfinite(values).all():
            raise VocabularyError(f"{name} is not finite; accepted: {low:g} to {high:g} degree")
        raise VocabularyError(
            f"{name} spans {values.min():g} to {values.max():g}; accepted: {low:g} to {high:g} degree"
        )
    return values


def _are_within(values: Array, low: float, high: float) -> bool:
    """Whether all values are; NaN is not. Many are compared in parts that stay in the processor's cache between the two comparisons."""
    flat = values.reshape(-1) if values.flags.contiguous else values[None]
    parts = (flat[start : start + _COMPARED_AT_ONCE] for start in range(0, len(flat), _COMPARED_AT_ONCE))
    return all(bool(part.min() >= low and part.max() <= high) for part in parts if part.size)


def unit_vector(theta: ArrayLike, phi: ArrayLike) -> Array:
    """Unit vectors (…, 3) of directions in degree."""
    theta, phi = np.radians(theta), np.radians(phi)
    return np.stack(
        np.broadcast_arrays(np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)), axis=-1
    )


def frame_rotation(theta_i: ArrayLike, phi_i: ArrayLike, theta_o: ArrayLike, phi_o: ArrayLike) -> tuple[Array, Array]:
    """Angles ψ_i, ψ_o [radian], in [−π, π], from the frames of both directions to the frame of the facet, from s towards p.

    Parameters
    ----------
    theta_i, phi_i, theta_o, phi_o : (…) degree, broadcastable; 0 <= θ <= 90

    Notes
    -----
    The facet's s axis is w_o × w_i / |w_o × w_i| for both directions. With Δ = φ_o − φ_i,
    ψ_i = atan2(sin θ_o sin Δ, sin(θ_i − θ_o) + 2 sin θ_o cos θ_i sin²(Δ/2)); ψ_o is the same with i and o exchanged except in Δ.
    Towards retro-reflection both diverge, but 2(ψ_i + ψ_o), on which the light depends there, has a limit; the form with
    sin(θ_i − θ_o) avoids cancellation. If the cross product is zero, ψ_i = 0 and ψ_o = π − Δ are the limits.
    """
    theta_i, theta_o = np.radians(theta_i), np.radians(theta_o)
    delta = np.radians(np.asarray(phi_o, dtype=float) - phi_i)
    sin_i, cos_i, sin_o, cos_o = np.sin(theta_i), np.cos(theta_i), np.sin(theta_o), np.cos(theta_o)
    ahead = 2 * np.sin(delta / 2) ** 2
    difference = np.sin(theta_i - theta_o)
    across_i, along_i = sin_o * np.sin(delta), difference + sin_o * cos_i * ahead
    across_o, along_o = sin_i * np.sin(delta), -difference + sin_i * cos_o * ahead
    undefined = (across_i == 0) & (along_i == 0) & (across_o == 0) & (along_o == 0)
    straight = np.arctan2(np.sin(delta), -np.cos(delta))
    psi_i = np.where(undefined, 0.0, np.arctan2(across_i, along_i))
    return psi_i, np.where(undefined, straight, np.arctan2(across_o, along_o))


def angles_of(vector: ArrayLike) -> tuple[Array, Array]:
    """Polar angle and azimuth, in degree, of vectors (…, 3) that need not be normalised."""
    v = np.asarray(vector, dtype=float)
    theta = np.degrees(np.arctan2(np.hypot(v[..., 0], v[..., 1]), v[..., 2]))
    return theta, np.degrees(np.arctan2(v[..., 1], v[..., 0]))


def checked_angles(name: str, angle: ArrayLike, low: float, high: float) -> xr.DataArray | Array:
    """Checked angles; a DataArray stays a DataArray."""
    values = check_angles(name, angle, low, high)
    return angle.copy(data=values) if isinstance(angle, xr.DataArray) else values


def broadcast(**angles: xr.DataArray | Array) -> tuple[xr.DataArray, ...]:
    """Directions that broadcast together: DataArrays by dimension name, plain arrays as in numpy into ``direction``.

    Raises VocabularyError: plain angles of different lengths; labelled angles with different coordinates or sizes along a common
    dimension; or a dimension ``wavelength``.
    """
    plain = {name: angle for name, angle in angles.items() if not isinstance(angle, xr.DataArray)}
    try:
        shape = np.broadcast_shapes(*(angle.shape for angle in plain.values()))
    except ValueError as error:
        shapes = ", ".join(f"{name} {angle.shape}" for name, angle in plain.items() if angle.shape)
        raise VocabularyError(
            f"angles of different shapes: {shapes}; give equal lengths, or DataArrays of different dimensions for all combinations"
        ) from error
    dims = ("direction",) if len(shape) == 1 else tuple(f"direction_{axis}" for axis in range(len(shape)))
    labelled = {
        name: angle if isinstance(angle, xr.DataArray) else xr.DataArray(np.broadcast_to(angle, shape), dims=dims)
        for name, angle in angles.items()
    }
    if len(plain) == len(angles):
        return tuple(labelled.values())
    if any("wavelength" in angle.dims for angle in labelled.values()):
        raise VocabularyError(
            "the angles have the dimension 'wavelength'; give the wavelengths as the argument `wavelength`"
        )
    try:
        aligned = xr.align(*labelled.values(), join="exact")
    except ValueError as error:
        raise VocabularyError(
            f"the angles {', '.join(labelled)} differ in coordinates or size along a common dimension; give equal coordinates"
        ) from error
    return xr.broadcast(*aligned)
