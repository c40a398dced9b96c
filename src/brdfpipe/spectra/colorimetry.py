"""CIE colorimetry with colour-science, and what it lacks: integration of many spectra at once on one 5-nm grid.

Tristimulus values are on the CIE scale for reflecting objects: Y = 100 for the perfect diffuser. Observers, illuminants, L*a*b*, colour
differences, chromatic adaptation and sRGB are those of colour-science.
"""

from __future__ import annotations

import difflib
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from brdfpipe.errors import BrdfpipeError, abbreviated
from brdfpipe.geometry import Array

OBSERVERS = {2: "CIE 1931 2 Degree Standard Observer", 10: "CIE 1964 10 Degree Standard Observer"}
"""Standard observers: field of view in degrees → colour-science's name."""

GRID = np.arange(360.0, 781.0, 5.0)
"""Wavelengths of the integration, nm."""

SHORTEST, LONGEST = 100.0, 100_000.0
"""Wavelengths that are taken for nanometres."""

_USUAL_ILLUMINANTS = ("D65", "A", "D50", "C", "E", "FL2", "FL11", "LED-B3")
"""Recognised without colour-science, which takes seconds to load."""


def _colour() -> Any:
    """colour-science, imported on first use."""
    from brdfpipe.spectra.colour_science import colour

    return colour


class Weights(NamedTuple):
    """Weights of an illuminant and an observer that turn a reflectance into tristimulus values: XYZ = R @ weights."""

    illuminant: str
    observer: int
    wavelength: Array
    """(n,) nm: :data:`GRID`."""
    weights: Array
    """(n, 3): illuminant times colour-matching functions, scaled to Y = 100 for R = 1."""
    white: Array
    """(3,): XYZ of the perfect diffuser."""


def illuminants() -> tuple[str, ...]:
    """Names of the illuminants colour-science has a spectrum of."""
    return tuple(_colour().SDS_ILLUMINANTS)


def illuminant_name(name: str) -> str:
    """colour-science's spelling of an illuminant's name, given in any case.

    Raises BrdfpipeError: unknown name, with the nearest known one.
    """
    wanted = str(name).casefold()
    usual = {spelling.casefold(): spelling for spelling in _USUAL_ILLUMINANTS}
    if wanted in usual:
        return usual[wanted]
    known = {spelling.casefold(): spelling for spelling in illuminants()}
    if wanted in known:
        return known[wanted]
    nearest = [match for names in (usual, known) for match in difflib.get_close_matches(wanted, names, n=1, cutoff=0.5)]
    hint = f" (nearest is {known[nearest[0]]})" if nearest else ""
    listed = abbreviated([*_USUAL_ILLUMINANTS, *known.values()], len(_USUAL_ILLUMINANTS))
    raise BrdfpipeError(
        f"unknown illuminant {str(name)[:40]!r}{hint}; accepted: {listed} (docs/materials.md lists all)"
    )


def weights(illuminant: str = "D65", observer: int = 10) -> Weights:
    """Tristimulus weights of an illuminant and an observer, and the white they give (Y = 100).

    Parameters
    ----------
    illuminant : name, see :func:`illuminants`; its power is 0 where CIE gives no value (FL2 below 380 nm)
    observer : 2 or 10 degree

    Raises
    ------
    BrdfpipeError : unknown illuminant or observer.

    References
    ----------
    CIE 15:2018, tables of the illuminants and of the CIE 1931 and CIE 1964 standard observers.
    """
    check_observer(observer)
    return _weights(illuminant_name(illuminant), observer)


def check_observer(observer: int) -> None:
    """Refuse an observer other than 2 and 10 degree."""
    if observer not in OBSERVERS:
        raise BrdfpipeError(f"unknown observer {str(observer)[:40]!r}; accepted: 2 or 10 (degree)")


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
    The 5-nm grid is filled by monotone cubic (PCHIP) interpolation: on 10- and 20-nm data it is closer to the 5-nm result than
    straight lines, which cut every peak. Beyond the ends the reflectance is held constant (CIE 15:2018, extrapolation).
    """
    nodes, values = np.asarray(wavelength, dtype=float), np.asarray(reflectance, dtype=float)
    if nodes.ndim != 1 or values.ndim == 0 or values.shape[-1] != nodes.size or nodes.size == 0:
        raise BrdfpipeError(
            f"reflectance has shape {values.shape}, wavelength {nodes.shape}; accepted: (..., n) on increasing (n,) nm"
        )
    if not (np.isfinite(nodes).all() and np.isfinite(values).all() and (np.diff(nodes) > 0).all()):
        raise BrdfpipeError("a colour needs strictly increasing wavelengths and finite reflectances")
    _refuse_other_units(nodes)
    return np.asarray(_on_grid(nodes, values) @ weights(illuminant, observer).weights)


def xyz_to_lab(xyz: ArrayLike, white: ArrayLike) -> Array:
    """CIE 1976 L*a*b* (..., 3) of XYZ (..., 3); ``white`` is the XYZ (3,) of the white, on the same scale (:func:`weights`)."""
    colour, reference = _colour(), np.asarray(white, dtype=float)
    return np.asarray(colour.XYZ_to_Lab(np.asarray(xyz, dtype=float) / reference[1], colour.XYZ_to_xy(reference)))


def lab_to_xyz(lab: ArrayLike, white: ArrayLike) -> Array:
    """Inverse of :func:`xyz_to_lab`: XYZ (..., 3) on the scale of ``white``."""
    colour, reference = _colour(), np.asarray(white, dtype=float)
    return np.asarray(colour.Lab_to_XYZ(np.asarray(lab, dtype=float), colour.XYZ_to_xy(reference)) * reference[1])


def delta_e_ab(lab_1: ArrayLike, lab_2: ArrayLike) -> Array:
    """Colour difference ΔE*ab between L*a*b* (..., 3): Euclidean distance (CIE 15:2018)."""
    return np.asarray(_colour().delta_E(lab_1, lab_2, method="CIE 1976"))


def delta_e_00(lab_1: ArrayLike, lab_2: ArrayLike) -> Array:
    """Colour difference CIEDE2000 between L*a*b* (..., 3), with k_L = k_C = k_H = 1 (ISO/CIE 11664-6)."""
    return np.asarray(_colour().delta_E(lab_1, lab_2, method="CIE 2000"))


def delta_e_itp(xyz_1: ArrayLike, xyz_2: ArrayLike) -> Array:
    """Colour difference ΔE_ITP of lights of a screen (ITU-R BT.2124).

    Parameters
    ----------
    xyz_1, xyz_2 : (..., 3) tristimulus values of the 2-degree observer, Y in cd/m²; the eye is adapted to D65. Each primary of
        BT.2020 is clipped to 0 to 10 000 cd/m², the range of the PQ curve

    Returns
    -------
    (...) : 720 √(ΔI² + ΔT² / 4 + ΔP²) of ICtCp with the PQ curve; 1 is just noticeable under the best conditions
    """
    colour = _colour()
    space = colour.RGB_COLOURSPACES["ITU-R BT.2020"]
    screens = (np.asarray(xyz, dtype=float) @ space.matrix_XYZ_to_RGB.T for xyz in (xyz_1, xyz_2))
    encoded = [colour.RGB_to_ICtCp(np.clip(rgb, 0.0, 1e4), method="ITU-R BT.2100-2 PQ") for rgb in screens]
    return np.asarray(colour.difference.delta_E_ITP(*encoded))


def encoded_srgb(linear: ArrayLike) -> Array:
    """Non-linear sRGB (..., 3) of linear one, clipped to [0, 1] (IEC 61966-2-1)."""
    return np.asarray(_colour().cctf_encoding(np.clip(np.asarray(linear, dtype=float), 0.0, 1.0), function="sRGB"))


def linear_srgb(encoded: ArrayLike) -> Array:
    """Linear sRGB of non-linear values from 0 to 1 (IEC 61966-2-1)."""
    return np.asarray(_colour().cctf_decoding(np.asarray(encoded, dtype=float), function="sRGB"))


def srgb_from_xyz(white: ArrayLike) -> Array:
    """Matrix (3, 3) from tristimulus values of the 2-degree observer to linear sRGB, for an eye adapted to ``white``.

    Parameters
    ----------
    white : (3,) XYZ that becomes (1, 1, 1), Y = 100

    Notes
    -----
    Bradford adaptation to the white of sRGB, then the matrix that follows from the primaries. That of IEC 61966-2-1 is rounded to four
    digits and leaves white off (1, 1, 1) by 2e-4.
    """
    colour = _colour()
    srgb, reference = colour.RGB_COLOURSPACES["sRGB"], np.asarray(white, dtype=float)
    to_rgb = np.linalg.inv(colour.normalised_primary_matrix(srgb.primaries, srgb.whitepoint))
    screen_white = colour.xy_to_XYZ(srgb.whitepoint)
    adaptation = colour.adaptation.matrix_chromatic_adaptation_VonKries(reference / 100, screen_white, "Bradford")
    return np.asarray(to_rgb @ adaptation / 100)


def reflectance_to_srgb(wavelength: ArrayLike, reflectance: ArrayLike) -> Array:
    """Preview colour (..., 3) in [0, 1] of reflectances (..., n) on wavelengths (n,) nm: D65, 2-degree observer, clipped to the gamut."""
    matrix = srgb_from_xyz(weights("D65", 2).white)
    return encoded_srgb(reflectance_to_xyz(wavelength, reflectance, "D65", 2) @ matrix.T)


def luminous_weight(wavelength: ArrayLike, illuminant: str = "D65") -> Array:
    """Weights that average a spectral quantity as the eye does: V(λ)·S(λ), normalised.

    Parameters
    ----------
    wavelength : (n,) nm, increasing; any grid, a single wavelength included
    illuminant : see :func:`weights`

    Returns
    -------
    weight : (n,) >= 0, with sum 1

    Notes
    -----
    ``(R * weight).sum()`` is ∫ R V S dλ / ∫ V S dλ on the 5-nm grid, with R linear between ``wavelength`` and constant beyond its
    ends. V is the CIE 1931 ȳ.
    """
    nodes = np.asarray(wavelength, dtype=float)
    if nodes.ndim != 1 or nodes.size == 0 or not np.isfinite(nodes).all() or (np.diff(nodes) <= 0).any():
        raise BrdfpipeError("wavelength must be a list of increasing nm")
    _refuse_other_units(nodes)
    luminous = weights(illuminant, 2).weights[:, 1]
    position = np.interp(GRID, nodes, np.arange(nodes.size, dtype=float))
    left = np.minimum(position.astype(int), max(nodes.size - 2, 0))
    fraction = position - left
    weight = np.bincount(left, luminous * (1 - fraction), nodes.size)
    weight += np.bincount(np.minimum(left + 1, nodes.size - 1), luminous * fraction, nodes.size)
    return np.asarray(weight / weight.sum())


def _on_grid(nodes: Array, values: Array) -> Array:
    from scipy.interpolate import PchipInterpolator

    if np.array_equal(nodes, GRID):
        return values
    if nodes.size == 1:
        return np.broadcast_to(values, (*values.shape[:-1], GRID.size))
    return np.asarray(PchipInterpolator(nodes, values, axis=-1)(np.clip(GRID, nodes[0], nodes[-1])))


@cache
def _weights(name: str, observer: int) -> Weights:
    colour = _colour()
    shape = colour.SpectralShape(GRID[0], GRID[-1], GRID[1] - GRID[0])
    zero_beyond = {"method": "Constant", "left": 0, "right": 0}
    power = colour.SDS_ILLUMINANTS[name].copy().align(shape, extrapolator_kwargs=zero_beyond).values
    product = power[:, None] * colour.MSDS_CMFS[OBSERVERS[observer]][GRID]
    product *= 100 / product[:, 1].sum()
    white = product.sum(axis=0)
    for array in (product, white):
        array.setflags(write=False)
    return Weights(name, observer, GRID, product, white)


def _refuse_other_units(wavelength: Array) -> None:
    """Refuse wavelengths in m or um: constant beyond their ends, a reflectance over them would still have a colour."""
    if not (wavelength[0] >= SHORTEST and wavelength[-1] <= LONGEST):
        raise BrdfpipeError(
            f"the wavelengths span {wavelength[0]:g} to {wavelength[-1]:g}; accepted: {SHORTEST:g} to {LONGEST:g} nm. Are they in nm?"
        )
