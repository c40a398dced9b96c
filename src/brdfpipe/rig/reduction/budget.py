"""The uncertainty budget of a measured BRDF: each term is declared here once, and computed here where it follows from the BRDF itself.

Source: JCGM 100:2008 (Guide to the expression of uncertainty in measurement, GUM), §4 and annex H.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import xarray as xr

from brdfpipe import specular_directions, vocabulary
from brdfpipe.geometry import Array, unit_vector
from brdfpipe.optics.fresnel_equations import fresnel

INDEX = 1.5
"""Refractive index of the surface reflection whose polarisation counts, where that of the material is not known; a face of a higher index polarises
less."""

_NEIGHBOURS = 10  # cells from which the slope of the BRDF about a fibre follows
_LEAST_DISTANCE = 0.5  # at which the weights of these cells stop growing [degree]


@dataclass(frozen=True)
class Term:
    """One term of the budget."""

    name: str
    """Of the component ``brdf_u_<name>`` of kind ``primary``."""
    meaning: str
    correlation: str
    """``independent`` from cell to cell, or ``common`` to the cells of an incidence and wavelength."""
    evaluation: str
    """``A`` from repeated observations, ``B`` otherwise."""
    distribution: str
    freedom: float
    """Degrees of freedom; infinite where the size counts as known."""
    sensitivity: str
    """Relative change of the BRDF by a unit of the input."""
    origin: str


_KNOWN = float("inf")

TERMS = (
    Term("noise", "photons and read noise", "independent", "A", "normal", _KNOWN, "1", "gain and read noise of rig.yaml"),
    Term("repeat", "light over its reference", "common", "A", "normal", 10, "1", "lamp monitor readings of the run"),
    Term("reference", "light of the reference spot", "common", "A", "normal", _KNOWN, "1", "its photons and read noise"),
    Term("calibration", "noise of the etalon", "independent", "A", "normal", _KNOWN, "1", "frames of the etalon"),
    Term("certificate", "level of the etalon", "common", "B", "normal", _KNOWN, "1", "its certificate"),
    Term("etalon", "angular shape, flatness and seat of the etalon", "common", "B", "normal", _KNOWN, "tangent of the angle from its normal", "`angles` and `tilt_u` of its certificate"),
    Term("nd", "transmittances of the filters", "common", "B", "normal", _KNOWN, "1 a frame", "rig.yaml and overlapping frames"),
    Term("glare", "veiling glare of the camera", "common", "B", "normal", _KNOWN, "glare over light", "fit between the spots"),
    Term("stray", "light of walls and mirrors", "common", "A", "normal", _KNOWN, "1/BRDF", "cells below the horizon"),
    Term("geometry", "position of the picture, curvature over a cell", "independent", "B", "normal", _KNOWN, "slope of the picture", "registration"),
    Term("directions", "directions of the fibres", "independent", "B", "normal", _KNOWN, "slope of BRDF and cosines over direction", "`u` of fibres.csv"),
    Term("wavelength", "error of the monochromator", "common", "B", "rectangular", _KNOWN, "slope of BRDF over wavelength", "`monochromator.wavelength_u`, or the offset of lines"),
    Term("band", "width of the band, not corrected", "common", "B", "rectangular", _KNOWN, "change of the slope of BRDF over wavelength", "`slit`"),
    Term("polarisation", "polarisation of the beam", "common", "B", "rectangular", _KNOWN, "M01/M00 of the surface reflection", "`monochromator.polarisation`"),
    Term("linearity", "linearity of the camera", "common", "B", "rectangular", _KNOWN, "1", "`camera.linearity_u`"),
    Term("path", "light of the entrance", "common", "A", "normal", _KNOWN, "1", "etalon through each entrance"),
)  # fmt: skip
"""Every term of kind ``primary``."""

BY_NAME = {term.name: term for term in TERMS}


class Dominant(NamedTuple):
    """The largest term of an incidence."""

    incidence: float  # degree
    name: str
    share: float
    """Of the variance, median over the values"""
    u: float
    """Relative combined standard uncertainty, median over the values"""


def terms_of_brdf(
    reduced: xr.Dataset, brdf: Array, entrances: Array, index: xr.Dataset | None = None
) -> dict[str, Array]:
    """The terms that follow from the BRDF itself [1/sr], (incidence, wavelength, cell); missing where it is.

    Parameters
    ----------
    reduced : kind ``reduced``, with the sizes of the inputs as attributes, and the coordinate ``direction_u``; what is not there counts as exact
    brdf : (incidence, wavelength, cell) in sr⁻¹; missing where there is no value
    entrances : through which the etalon was measured [degree]
    index : kind ``index``, of the material; without it :data:`INDEX`
    """
    attrs, wavelength = reduced.attrs, reduced["wavelength"].values
    slope = np.zeros(brdf.shape)
    if wavelength.size > 1:
        slope = np.abs(np.gradient(brdf, wavelength, axis=1))
    terms = {
        "directions": np.nan_to_num(np.abs(brdf) * _direction_error(reduced, brdf, entrances)),
        "wavelength": np.nan_to_num(slope) * float(attrs.get("wavelength_u", 0.0)),
        "band": np.nan_to_num(_band_error(brdf, wavelength, float(attrs.get("slit", 0.0)))),
        "polarisation": float(attrs.get("polarisation", 0.0)) * _polarised(reduced, brdf, index),
        "linearity": np.nan_to_num(np.abs(brdf)) * float(attrs.get("linearity_u", 0.0)),
    }
    return {name: np.where(np.isfinite(brdf), term, np.nan) for name, term in terms.items()}


def _band_error(brdf: Array, wavelength: Array, slit: float) -> Array:
    """Error (incidence, wavelength, cell) by the width of the band, a triangle of full width s at half maximum.

    Known is the change D of the slope between the middles of the two intervals beside a wavelength, h apart; not where it changes. Evenly along h, it is a
    curvature D/h: an error of s²/12 D/h. At one place, a distance d from the wavelength, the error is s/6 (1 − |d|/s)³ D, and 0 from d = s on. The root
    mean square over all places within h is the larger one from h ≈ s on: an edge between distant wavelengths may lie within the band of one. The larger one counts.
    """
    if wavelength.size < 3 or slit == 0:
        return np.zeros(brdf.shape)
    change = np.abs(np.diff(np.diff(brdf, axis=1) / np.diff(wavelength)[:, None], axis=1))
    apart = (wavelength[2:] - wavelength[:-2]) / 2
    within = np.minimum(apart / (2 * slit), 1.0)
    somewhere = slit / 6 * np.sqrt(2 * slit / (7 * apart) * (1 - (1 - within) ** 7))
    error = change * np.maximum(slit**2 / (12 * apart), somewhere)[:, None]
    return np.concatenate([error[:, :1], error, error[:, -1:]], axis=1)  # at the ends as next to them


def _direction_error(reduced: xr.Dataset, brdf: Array, entrances: Array) -> Array:
    """Relative error (incidence, wavelength, cell) of cells that see another direction than described.

    Their light is that of the true direction, of sample and etalon; it is divided by the cosines of the described one.
    """
    error = np.zeros(brdf.shape)
    if "direction_u" not in reduced.coords:
        return error
    direction_u = np.radians(reduced["direction_u"].values)
    moved = np.flatnonzero(direction_u > 0)
    theta, phi = reduced["theta_s"].values, reduced["phi_s"].values
    direction = unit_vector(theta, phi)
    axes = np.stack([unit_vector(theta + 90, phi), unit_vector(np.full_like(phi, 90.0), phi + 90)], axis=1)
    etalon = np.mean([_cosine_slope(2 * entrance, direction, axes) for entrance in entrances], axis=0)
    for at, incidence in enumerate(reduced["incidence"].values):
        known = np.flatnonzero((brdf[at] > 0).all(axis=0))
        if known.size <= 3:
            continue
        logarithm = np.log(brdf[at][:, known])
        cosines = _cosine_slope(float(incidence), direction, axes) - etalon
        for cell in np.intersect1d(moved, known):
            slope = _slope(direction[known], logarithm, direction[cell], axes[cell]) + cosines[cell]
            # The direction is off by u in any azimuth: along the slope by u/√2, root mean square.
            error[at, :, cell] = np.hypot(*slope.T) * direction_u[cell] / np.sqrt(2)
    return error


def _cosine_slope(tilt: float, direction: Array, axes: Array) -> Array:
    """Slope (cell, axis) of the logarithm of the cosine from a normal ``tilt`` degree from the mirror direction; 0 where it is hardly seen."""
    normal = unit_vector(np.array([tilt]), np.zeros(1))[0]
    cosine = direction @ normal
    return np.where((cosine > 0.05)[:, None], (axes @ normal) / np.maximum(cosine, 0.05)[:, None], 0.0)


def _slope(direction: Array, logarithm: Array, at: Array, axes: Array) -> Array:
    """Slope (wavelength, axis) of logarithms (wavelength, cell) of the cells nearest to a direction."""
    distance = np.linalg.norm(direction - at, axis=1)
    near = np.argsort(distance)[:_NEIGHBOURS]
    weight = 1 / np.hypot(distance[near], np.radians(_LEAST_DISTANCE))
    design = np.column_stack([np.ones(near.size), direction[near] @ axes.T]) * weight[:, None]
    return np.asarray(np.linalg.lstsq(design, (logarithm[:, near] * weight).T)[0][1:].T)


def _polarised(reduced: xr.Dataset, brdf: Array, index: xr.Dataset | None) -> Array:
    """Part of the BRDF that changes with the polarisation of the beam [1/sr]: M01/M00 of a face, times what is above the darkest cell."""
    incidence = reduced["incidence"].values[:, None]
    towards = specular_directions.cos_view_etalon(incidence, reduced["theta_s"].values, reduced["phi_s"].values)
    cosine = np.sqrt(
        (1 + np.clip(towards, -1, 1)) / 2
    )  # of the angle of incidence on a facet that reflects into the cell
    n, k = np.full(brdf.shape[1], INDEX), np.zeros(brdf.shape[1])
    if index is not None:
        n, k = (
            np.interp(reduced["wavelength"].values, index["wavelength"].values, index[name].values) for name in "nk"
        )
    face = fresnel(cosine[:, None], n[:, None], k[:, None])
    lowest = np.nanmin(np.where(brdf > 0, brdf, np.inf), axis=2, keepdims=True)
    return np.nan_to_num(np.maximum(brdf - lowest, 0.0)) * np.abs(face.s - face.p) / np.maximum(face.s + face.p, 1e-12)


def dominant(primary: xr.Dataset) -> list[Dominant]:
    """The largest term of each incidence, by its median share of the variance over valid values."""
    names = [name for name in BY_NAME if f"brdf_u_{name}" in primary]
    value, total = primary["brdf"].values, primary["brdf_u"].values
    valid = np.isfinite(value) & (value > 0) & (total > 0)
    if "brdf_quality" in primary:
        valid &= primary["brdf_quality"].values == vocabulary.quality("measured")
    listed = []
    for at, incidence in enumerate(primary["incidence"].values):
        own = valid[at]
        if not own.any():
            continue
        variance = total[at][own] ** 2
        shares = [float(np.median(primary[f"brdf_u_{name}"].values[at][own] ** 2 / variance)) for name in names]
        largest = int(np.argmax(shares))
        u = float(np.median(total[at][own] / value[at][own]))
        listed.append(Dominant(float(incidence), names[largest], shares[largest], u))
    return listed
