"""CIE colorimetry on a 5-nm grid: tristimulus values, L*a*b*, preview colours and luminous weights.

Tristimulus values are on the CIE scale for reflecting objects: Y = 100 for the perfect diffuser.
"""

from __future__ import annotations

import difflib
import io
from functools import cache
from importlib import resources
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from brdfpipe.errors import BrdfpipeError

Array = NDArray[np.float64]

OBSERVERS = (2, 10)
"""Standard observers: CIE 1931 (2 degree) and CIE 1964 (10 degree)."""

# CIE 1976 L*a*b* (CIE 15:2018) with the junction in exact fractions.
_EPSILON = 216 / 24389
_KAPPA = 24389 / 27

# IEC 61966-2-1: chromaticities of the sRGB primaries.
_SRGB_PRIMARIES = np.array([[0.64, 0.33], [0.30, 0.60], [0.15, 0.06]])

_BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])


class Weights(NamedTuple):
    """What turns a reflectance into tristimulus values: XYZ = R @ weights."""

    wavelength: Array
    """(n,) nm: 360 to 780 by 5."""
    weights: Array
    """(n, 3): illuminant times colour-matching functions, scaled to Y = 100 for R = 1."""
    white: Array
    """(3,): XYZ of the perfect diffuser."""


def cmf(observer: int = 10) -> tuple[Array, Array]:
    """Colour-matching functions of a standard observer.

    Parameters
    ----------
    observer : 2 or 10 degree

    Returns
    -------
    wavelength : (n,) nm, 360 to 780 by 5
    xyz : (n, 3), the functions x̄, ȳ, z̄

    References
    ----------
    CIE 15:2018, tables of the CIE 1931 and CIE 1964 standard colorimetric observers.
    """
    wavelength, table = _table("cmf.csv")
    return wavelength, np.stack([table[f"{axis}{_observer(observer)}"] for axis in "xyz"], axis=1)


def illuminant(name: str = "D65") -> tuple[Array, Array]:
    """Relative spectral power of an illuminant.

    Parameters
    ----------
    name : D65, A, D50, C, E, FL2 or LED-B3, in any case

    Returns
    -------
    wavelength : (n,) nm, 360 to 780 by 5
    power : (n,) in the units of its CIE table; 0 where CIE gives no value (FL2 and LED-B3 below 380 nm)

    References
    ----------
    CIE 15:2018, tables of illuminants.
    """
    wavelength, table = _table("illuminants.csv")
    return wavelength, table[illuminant_name(name)]


def illuminant_name(name: str) -> str:
    """CIE's spelling of an illuminant's name, given in any case; :class:`BrdfpipeError` with those known if there is none."""
    known = {title.casefold(): title for title in _table("illuminants.csv")[1]}
    wanted = str(name).casefold()
    if wanted not in known:
        nearest = difflib.get_close_matches(wanted, known, n=1, cutoff=0.5)
        hint = f" (nearest is {known[nearest[0]]})" if nearest else ""
        raise BrdfpipeError(f"unknown illuminant {str(name)[:40]!r}{hint}; known: {', '.join(known.values())}")
    return known[wanted]


def weights(illuminant: str = "D65", observer: int = 10) -> Weights:
    """Tristimulus weights of an illuminant and an observer, and the white they give (Y = 100).

    Raises
    ------
    BrdfpipeError : unknown illuminant or observer, with those known.
    """
    return _weights(illuminant_name(illuminant), _observer(observer))


def basis() -> tuple[Array, Array]:
    """Four basis reflectances: red, green, blue and cyan, each with peak 1.

    Returns
    -------
    wavelength : (n,) nm, 360 to 780 by 5
    reflectance : (4, n)

    References
    ----------
    Smits, "An RGB-to-spectrum conversion for reflectances", J. Graphics Tools 4 (1999) 11–22. The patent US 9,395,299 names
    the four colours without their spectra.
    """
    wavelength, table = _table("basis.csv")
    return wavelength, np.stack([table[name] for name in ("red", "green", "blue", "cyan")])


def reflectance_to_xyz(
    wavelength: ArrayLike, reflectance: ArrayLike, illuminant: str = "D65", observer: int = 10
) -> Array:
    """Tristimulus values of reflectances.

    Parameters
    ----------
    wavelength : (n,) nm, increasing
    reflectance : (..., n) [1]
    illuminant, observer : see :func:`weights`

    Returns
    -------
    XYZ : (..., 3), Y = 100 for R = 1

    Raises
    ------
    BrdfpipeError : wavelengths that do not increase, shapes that differ, undefined values.

    Notes
    -----
    The 5-nm grid is filled by monotone cubic (PCHIP) interpolation: it keeps the data, takes irregular grids, never leaves the
    range of its neighbours, and on 10- and 20-nm data comes nearer to the 5-nm result than straight lines, which cut every
    peak. Beyond the ends the reflectance is held constant (CIE 15:2018, extrapolation).
    """
    known = np.asarray(wavelength, dtype=float)
    values = np.asarray(reflectance, dtype=float)
    if known.ndim != 1 or values.ndim == 0 or values.shape[-1] != known.size or known.size == 0:
        raise BrdfpipeError(
            f"reflectance has shape {values.shape}, wavelength {known.shape}; accepted: (..., n) on increasing (n,) nm"
        )
    if not (np.isfinite(known).all() and np.isfinite(values).all() and (np.diff(known) > 0).all()):
        raise BrdfpipeError("wavelength must increase strictly, and reflectance be finite, to have a colour")
    table = weights(illuminant, observer)
    xyz: Array = _on_grid(known, values, table.wavelength) @ table.weights
    return xyz


def xyz_to_lab(xyz: ArrayLike, white: ArrayLike) -> Array:
    """CIE 1976 L*a*b*.

    Parameters
    ----------
    xyz : (..., 3)
    white : (3,) XYZ of the white, on the same scale; see :func:`weights`

    Returns
    -------
    lab : (..., 3)

    References
    ----------
    CIE 15:2018, CIE 1976 L*a*b*, with ε = 216/24389 and κ = 24389/27 exact (the junction is continuous).
    """
    t = np.asarray(xyz, dtype=float) / np.asarray(white, dtype=float)
    f = np.where(t > _EPSILON, np.cbrt(t), (_KAPPA * t + 16) / 116)
    return np.stack([116 * f[..., 1] - 16, 500 * (f[..., 0] - f[..., 1]), 200 * (f[..., 1] - f[..., 2])], axis=-1)


def lab_to_xyz(lab: ArrayLike, white: ArrayLike) -> Array:
    """Inverse of :func:`xyz_to_lab`: XYZ (..., 3) on the scale of ``white``."""
    values = np.asarray(lab, dtype=float)
    f_y = (values[..., 0] + 16) / 116
    f = np.stack([f_y + values[..., 1] / 500, f_y, f_y - values[..., 2] / 200], axis=-1)
    t = np.where(f**3 > _EPSILON, f**3, (116 * f - 16) / _KAPPA)
    xyz: Array = t * np.asarray(white, dtype=float)
    return xyz


def delta_e_ab(lab_1: ArrayLike, lab_2: ArrayLike) -> Array:
    """Colour difference ΔE*ab between L*a*b* (..., 3): Euclidean distance (CIE 15:2018)."""
    distance: Array = np.linalg.norm(np.asarray(lab_1, dtype=float) - np.asarray(lab_2, dtype=float), axis=-1)
    return distance


def delta_e_00(lab_1: ArrayLike, lab_2: ArrayLike) -> Array:
    """Colour difference CIEDE2000 between L*a*b* (..., 3), with k_L = k_C = k_H = 1.

    References
    ----------
    ISO/CIE 11664-6:2014; Sharma, Wu & Dalal 2005, Color Res. Appl. 30, 21.
    """
    (l_1, a_1, b_1), (l_2, a_2, b_2) = (np.moveaxis(np.asarray(lab, dtype=float), -1, 0) for lab in (lab_1, lab_2))
    seventh = ((np.hypot(a_1, b_1) + np.hypot(a_2, b_2)) / 2) ** 7
    stretch = 1.5 - 0.5 * np.sqrt(seventh / (seventh + 25.0**7))
    a_1, a_2 = a_1 * stretch, a_2 * stretch
    c_1, c_2 = np.hypot(a_1, b_1), np.hypot(a_2, b_2)
    h_1, h_2 = (np.degrees(np.arctan2(b, a)) % 360 for b, a in ((b_1, a_1), (b_2, a_2)))
    grey = c_1 * c_2 == 0
    turn = np.where(grey, 0.0, (h_2 - h_1 + 180) % 360 - 180)
    # Opposite hues differ by ±180; the formula takes +180 where h₂ − h₁ is 180.
    turn = np.where(~grey & (h_2 - h_1 == 180), 180.0, turn)
    apart = np.abs(h_1 - h_2) > 180
    h = np.where(grey, h_1 + h_2, ((h_1 + h_2) / 2 + np.where(apart, 180, 0)) % 360)
    light, chroma = (l_1 + l_2) / 2, (c_1 + c_2) / 2
    d_l, d_c, d_h = l_2 - l_1, c_2 - c_1, 2 * np.sqrt(c_1 * c_2) * np.sin(np.radians(turn / 2))
    t = (
        1
        - 0.17 * np.cos(np.radians(h - 30))
        + 0.24 * np.cos(np.radians(2 * h))
        + 0.32 * np.cos(np.radians(3 * h + 6))
        - 0.20 * np.cos(np.radians(4 * h - 63))
    )
    s_l = 1 + 0.015 * (light - 50) ** 2 / np.sqrt(20 + (light - 50) ** 2)
    s_c, s_h = 1 + 0.045 * chroma, 1 + 0.015 * chroma * t
    swing = 30 * np.exp(-(((h - 275) / 25) ** 2))
    rotation = -2 * np.sqrt(chroma**7 / (chroma**7 + 25.0**7)) * np.sin(np.radians(2 * swing))
    l_part, c_part, h_part = d_l / s_l, d_c / s_c, d_h / s_h
    square = l_part**2 + c_part**2 + h_part**2 + rotation * c_part * h_part
    distance: Array = np.sqrt(np.maximum(square, 0.0))
    return distance


def xyz_to_srgb(xyz: ArrayLike) -> Array:
    """sRGB for a screen, from tristimulus values under D65 for the 2-degree observer.

    Parameters
    ----------
    xyz : (..., 3), Y = 100 for white; no other illuminant or observer, sRGB being defined for this one

    Returns
    -------
    srgb : (..., 3) in [0, 1], non-linear; colours outside the sRGB gamut are clipped

    Notes
    -----
    The matrix comes from the primaries and the D65 white of :func:`weights`, so that the perfect diffuser is (1, 1, 1).

    References
    ----------
    IEC 61966-2-1.
    """
    return encoded_srgb(np.asarray(xyz, dtype=float) @ _srgb_matrix().T)


def encoded_srgb(linear: ArrayLike) -> Array:
    """Non-linear sRGB (..., 3) of linear one, clipped to [0, 1] (IEC 61966-2-1)."""
    clipped = np.clip(np.asarray(linear, dtype=float), 0.0, 1.0)
    # 1.055 v − 0.055, written so that 1 stays 1.
    curved = 1 - 1.055 * (1 - clipped ** (1 / 2.4))
    return np.where(clipped <= 0.0031308, 12.92 * clipped, curved)


def srgb_from_xyz(white: ArrayLike) -> Array:
    """Matrix (3, 3) from tristimulus values of the 2-degree observer to linear sRGB, for an eye used to ``white``.

    Parameters
    ----------
    white : (3,) XYZ that becomes (1, 1, 1), Y = 100

    References
    ----------
    Lam 1985 (Bradford), as in ICC.1:2022, annex E, to the D65 of IEC 61966-2-1.
    """
    screen, own = weights("D65", 2).white, np.asarray(white, dtype=float)
    gain = (_BRADFORD @ screen) / (_BRADFORD @ own)
    adapted: Array = _srgb_matrix() @ np.linalg.inv(_BRADFORD) @ (gain[:, None] * _BRADFORD)
    return adapted


def reflectance_to_srgb(wavelength: ArrayLike, reflectance: ArrayLike) -> Array:
    """Preview colour (..., 3) of reflectances (..., n) on wavelengths (n,) nm: always D65 and the 2-degree observer."""
    return xyz_to_srgb(reflectance_to_xyz(wavelength, reflectance, "D65", 2))


def luminous_weight(wavelength: ArrayLike, illuminant: str = "D65") -> Array:
    """Weights that average a spectral quantity as the eye does: V(λ)·S(λ), normalised.

    Parameters
    ----------
    wavelength : (n,) nm, increasing; any grid, a single wavelength included
    illuminant : see :func:`illuminant`

    Returns
    -------
    weight : (n,) >= 0, with sum 1

    Notes
    -----
    ``(R * weight).sum()`` is ∫ R V S dλ / ∫ V S dλ on the 5-nm grid for the R that is linear between ``wavelength`` and
    constant beyond its ends, so that coarse and irregular grids weigh what they stand for. V is the CIE 1931 ȳ.
    """
    nodes = np.asarray(wavelength, dtype=float)
    if nodes.ndim != 1 or nodes.size == 0 or not np.isfinite(nodes).all() or (np.diff(nodes) <= 0).any():
        raise BrdfpipeError("wavelength must be a list of increasing nm")
    grid, share = weights(illuminant, 2).wavelength, weights(illuminant, 2).weights[:, 1]
    position = np.interp(grid, nodes, np.arange(nodes.size, dtype=float))
    left = np.minimum(position.astype(int), max(nodes.size - 2, 0))
    right = np.minimum(left + 1, nodes.size - 1)
    fraction = position - left
    weight = np.bincount(left, share * (1 - fraction), nodes.size) + np.bincount(right, share * fraction, nodes.size)
    normalised: Array = weight / weight.sum()
    return normalised


def _on_grid(known: Array, values: Array, grid: Array) -> Array:
    if known.shape == grid.shape and (known == grid).all():
        return values
    if known.size == 1:
        return np.broadcast_to(values, (*values.shape[:-1], grid.size))
    from scipy.interpolate import PchipInterpolator

    filled: Array = PchipInterpolator(known, values, axis=-1)(np.clip(grid, known[0], known[-1]))
    return filled


@cache
def _weights(name: str, observer: int) -> Weights:
    wavelength, power = illuminant(name)
    product = power[:, None] * cmf(observer)[1]
    product *= 100 / product[:, 1].sum()
    white = product.sum(axis=0)
    for array in (product, white):
        array.setflags(write=False)
    return Weights(wavelength, product, white)


@cache
def _srgb_matrix() -> Array:
    x, y = _SRGB_PRIMARIES.T
    primaries = np.stack([x / y, np.ones(3), (1 - x - y) / y])
    white = weights("D65", 2).white
    matrix: Array = np.linalg.inv(primaries * np.linalg.solve(primaries, white))
    matrix.setflags(write=False)
    return matrix


@cache
def _table(file: str) -> tuple[Array, dict[str, Array]]:
    text = resources.files("brdfpipe.spectra").joinpath("tables", file).read_text("ascii")
    rows = [line for line in text.splitlines() if not line.startswith("#")]
    values = np.loadtxt(io.StringIO("\n".join(rows[1:])), delimiter=",", unpack=True)
    values.setflags(write=False)
    return values[0], dict(zip(rows[0].split(",")[1:], values[1:], strict=True))


def _observer(observer: int) -> int:
    if observer not in OBSERVERS:
        raise BrdfpipeError(f"unknown observer {str(observer)[:40]!r}; known: 2 and 10 (degree)")
    return int(observer)
