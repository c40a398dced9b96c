"""Fresnel's equations: power reflectance of a smooth interface."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from brdfpipe.errors import BrdfpipeError
from brdfpipe.geometry import Array
from brdfpipe.hemisphere import panel_rule

_CLOSEST_TO_METAL = 1e70
_ROUNDING = 1e-9


class Fresnel(NamedTuple):
    """Power reflectances of a smooth interface [1]."""

    s: Array
    p: Array
    mean: Array
    """For unpolarised light, the mean of s and p."""


def fresnel(cos_zeta: ArrayLike, n: ArrayLike, k: ArrayLike = 0.0) -> Fresnel:
    """Fresnel reflectance of a smooth interface, for light polarised s, p and not at all.

    Parameters
    ----------
    cos_zeta : cosine of the angle of incidence, in [0, 1]
    n : index of the far medium relative to the near one; n > 0, infinity for a perfect mirror
    k : extinction coefficient relative to the near medium, k >= 0; N = n + ik

    Returns
    -------
    F_s, F_p, F : arrays of the broadcast shape, in [0, 1]

    Raises
    ------
    BrdfpipeError : a cosine beyond rounding outside [0, 1], n <= 0, k < 0 or infinite, or NaN anywhere.

    Notes
    -----
    With q = √(N² − sin²ζ) the amplitudes (cos ζ − q)/(cos ζ + q) and (N² cos ζ − q)/(N² cos ζ + q) are written as
    −(N² − 1)/(cos ζ + q)² and (N² − 1)[(N² + 1) cos²ζ − 1]/(N² cos ζ + q)²: the textbook form cancels as N → 1.
    Total internal reflection (n < 1 and sin ζ >= n, k = 0) gives 1, n = 1 gives 0, grazing incidence on n ≠ 1 gives 1.

    References
    ----------
    Born & Wolf, Principles of Optics, 7th ed., §1.5.2 and §14.2.
    """
    c, n, k = _checked_cosine(cos_zeta), _checked_index(n), _checked_extinction(k)
    if n.size and n.min() > 1 and n.max() <= _CLOSEST_TO_METAL and not k.any():
        f_s, f_p = _transparent(c, n, (n - 1) * (n + 1))
        return Fresnel(f_s, f_p, (f_s + f_p) / 2)
    mirror, c_zero = n > _CLOSEST_TO_METAL, c == 0
    n = np.where(mirror, 2.0, n)
    absent = (n == 1) & (k == 0)
    contrast = (n - 1) * (n + 1)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        if k.any():
            f_s, f_p = _absorbing(c, n, k)
            total = (k == 0) & (contrast + c * c <= 0)
        else:
            f_s, f_p = _transparent(c, n, contrast)
            total = contrast + c * c <= 0
    one = (mirror | total | c_zero) & ~absent
    f_s, f_p = (np.where(one, 1.0, np.where(absent, 0.0, np.minimum(f, 1.0))) for f in (f_s, f_p))
    return Fresnel(f_s, f_p, (f_s + f_p) / 2)


class Plate(NamedTuple):
    """Reflectances and transmittances of a plate [1]."""

    reflectance_s: Array
    reflectance_p: Array
    transmittance_s: Array
    transmittance_p: Array


def plate(cos_theta: ArrayLike, n: ArrayLike, transmittance: ArrayLike) -> tuple[Array, Array]:
    """Reflectance and transmittance of a plane-parallel plate with two smooth faces, for unpolarised light.

    Parameters and sources as for :func:`polarised_plate`, of whose values these are the means.
    """
    values = polarised_plate(cos_theta, n, transmittance)
    reflectance, transmittance = (
        values.reflectance_s + values.reflectance_p,
        values.transmittance_s + values.transmittance_p,
    )
    return np.asarray(reflectance / 2), np.asarray(transmittance / 2)


def polarised_plate(cos_theta: ArrayLike, n: ArrayLike, transmittance: ArrayLike) -> Plate:
    """Reflectances and transmittances of a plane-parallel plate with two smooth faces, for light polarised s and p.

    Parameters
    ----------
    cos_theta : cosine of the angle of incidence, in (0, 1]
    n : index of the plate relative to its surroundings; n >= 1
    transmittance : internal transmittance at normal incidence, in [0, 1]

    Notes
    -----
    With τ' = τ^(1/cos θ') R = F + (1 − F)² τ'² F / (1 − F² τ'²) and T = (1 − F)² τ' / (1 − F² τ'²) for s and for p, since each stays
    what it is between the faces. Reflections are added without interference.

    References
    ----------
    Stokes 1862 (Proc. R. Soc. 11, 545), on a pile of plates.
    """
    cos_theta, n = np.asarray(cos_theta, dtype=float), np.asarray(n, dtype=float)
    inner = np.sqrt(np.maximum((n - 1) * (n + 1) + cos_theta**2, 1e-300)) / n
    passage = np.asarray(transmittance, dtype=float) ** (1 / inner)
    values = fresnel(cos_theta, n)
    reflected, transmitted = [], []
    for f in (values.s, values.p):
        series = (1 - f) ** 2 * passage / ((1 - f * passage) * (1 + f * passage))
        reflected.append(f + series * passage * f)
        transmitted.append(series)
    return Plate(*reflected, *transmitted)


def internal_of_plate(transmittance: float, n: float) -> float:
    """Internal transmittance [1] of a plate from its transmittance at normal incidence, reflections included; above 1 if none has it.

    The root of F² T τ² + (1 − F)² τ − T = 0, which :func:`polarised_plate` gives at normal incidence.
    """
    f = float(fresnel(1.0, n).mean)
    through = (1 - f) ** 2
    return 2 * transmittance / (through + math.sqrt(through**2 + (2 * f * transmittance) ** 2))


def reflectance_of(n: Array, k: Array) -> Callable[[Array], Array]:
    """:func:`fresnel` of unpolarised light as a function of cosines in [0, 1], which are not checked; n and k are checked once."""
    n, k = _checked_index(n), _checked_extinction(k)
    if not n.size or n.min() <= 1 or n.max() > _CLOSEST_TO_METAL or k.any():
        return lambda c: fresnel(c, n, k).mean
    contrast = (n - 1) * (n + 1)

    def mean(c: Array) -> Array:
        f_s, f_p = _transparent(c, n, contrast)
        return np.asarray((f_s + f_p) / 2)

    return mean


def mean_fresnel(n: Array, k: Array) -> Array:
    """Reflectance 2 ∫ F μ dμ of a smooth interface under light from everywhere, (wavelength,), of (wavelength,) n and k."""
    theta, weight = panel_rule(np.linspace(0, np.pi / 2, 17), 8)
    return np.asarray((weight * np.sin(2 * theta)) @ fresnel(np.cos(theta)[:, None], n, k).mean)


def _transparent(c: Array, n: Array, contrast: Array) -> tuple[Array, Array]:
    q = np.sqrt(np.maximum(contrast + c * c, 0.0))
    into_s, into_p = c + q, n * n * c + q
    r_s = contrast / (into_s * into_s)
    r_p = (contrast / into_p) * (((n * n + 1) * (c * c) - 1) / into_p)
    return np.minimum(r_s * r_s, 1.0), np.minimum(r_p * r_p, 1.0)


def _absorbing(c: Array, n: Array, k: Array) -> tuple[Array, Array]:
    index = n + 1j * k
    contrast = (index - 1) * (index + 1)
    q = np.sqrt(contrast + c * c)
    r_s = contrast / (c + q) ** 2
    into_p = index * index * c + q
    r_p = (contrast / into_p) * (((index * index + 1) * (c * c) - 1) / into_p)
    f_s: Array = np.abs(r_s) ** 2
    f_p: Array = np.abs(r_p) ** 2
    return f_s, f_p


def _checked_cosine(cos_zeta: ArrayLike) -> Array:
    c = np.asarray(cos_zeta, dtype=float)
    # NaN fails the comparison, and so is refused with the rest.
    low, high = (c.min(), c.max()) if c.size else (0.0, 1.0)
    if not (low >= -_ROUNDING and high <= 1 + _ROUNDING):
        raise BrdfpipeError(f"cos_zeta spans {low:g} to {high:g}; accepted: cosines in [0, 1]")
    return c if low >= 0 and high <= 1 else np.clip(c, 0.0, 1.0)


def _checked_index(n: ArrayLike) -> Array:
    if np.iscomplexobj(n):
        raise BrdfpipeError("n is complex; accepted: the real part as n, the imaginary part as k")
    values = np.asarray(n, dtype=float)
    if values.size and not values.min() > 0:
        raise BrdfpipeError(f"refractive index n is {values.min():g} somewhere; accepted: n > 0")
    return values


def _checked_extinction(k: ArrayLike) -> Array:
    values = np.asarray(k, dtype=float)
    if values.size and not (values.min() >= 0 and values.max() < _CLOSEST_TO_METAL):
        raise BrdfpipeError(
            f"extinction coefficient k spans {values.min():g} to {values.max():g}; accepted: finite k >= 0"
        )
    return values
