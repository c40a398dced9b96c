"""Method ``basis4``: mixtures of four basis spectra, in closed form.

The mixture is S = Σ wᵢ Sᵢ with w >= 0 and S <= 1, of :func:`basis`. Four weights for three tristimulus values leave one freedom: the
closed form takes the smoothest spectrum.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from brdfpipe.geometry import Array
from brdfpipe.spectra import colorimetry
from brdfpipe.spectra.colorimetry import Weights
from brdfpipe.spectra.recovery_methods.lhtss import Recovered

ROUNDING = 1e-9


@cache
def basis() -> Array:
    """Four basis reflectances (4, n) on :data:`brdfpipe.spectra.colorimetry.GRID`: red, green, blue and cyan, each with peak 1.

    Source: Smits, "An RGB-to-spectrum conversion for reflectances", J. Graphics Tools 4 (1999) 11–22, straight lines between the centres of its
    ten bins. The patent US 9,395,299 names the four colours without their spectra.
    """
    from brdfpipe.spectra.colour_science import colour

    bins = [colour.recovery.SDS_SMITS1999[name] for name in ("red", "green", "blue", "cyan")]
    spectra = np.stack([np.interp(colorimetry.GRID, group.wavelengths, group.values) for group in bins])
    spectra /= spectra.max(axis=1, keepdims=True)
    spectra.setflags(write=False)
    return spectra


def closed_form(xyz: ArrayLike, table: Weights, floor: ArrayLike = 0.0) -> Recovered:
    """Smoothest mixtures that have given colours exactly (method ``basis4``).

    Parameters
    ----------
    xyz : (B, 3) tristimulus values, Y = 100 for the perfect diffuser
    table : of :func:`brdfpipe.spectra.colorimetry.weights`
    floor : () or (n,), what every spectrum has beneath its mixture (specular), 0 <= floor < 1: R = floor + (1 − floor) S

    Notes
    -----
    w = w₀ + t v, v the null vector of the basis' tristimulus values. w >= 0 and S <= 1 leave an interval of t; within it
    Σ (S_{i+1} − S_i)², a parabola in t, is smallest.
    """
    spectra, under = basis(), np.asarray(floor, dtype=float)
    primaries, darkest = _primaries(table, under)
    colours = np.atleast_2d(np.asarray(xyz, dtype=float)) - darkest
    w_0 = colours @ np.linalg.pinv(primaries)
    null = np.linalg.svd(primaries.T)[2][3]
    s_0, along = w_0 @ spectra, null @ spectra
    offset = np.concatenate([w_0, 1 - s_0], axis=1)
    slope = np.concatenate([null, -along])
    # offset + t slope >= 0 for every weight and wavelength.
    with np.errstate(divide="ignore", invalid="ignore"):
        bound = -offset / slope
    lowest = np.where(slope > 0, bound, -np.inf).max(axis=1)
    highest = np.where(slope < 0, bound, np.inf).min(axis=1)
    still = (offset[:, slope == 0] >= 0).all(axis=1)
    smoothest = -(np.diff(s_0, axis=1) @ np.diff(along)) / (np.diff(along) @ np.diff(along))
    reached = still & (lowest <= highest + ROUNDING) & np.isfinite(colours).all(axis=1)
    t = np.where(reached, np.clip(smoothest, lowest, np.maximum(lowest, highest)), np.nan)
    weights = np.where(reached[:, None], np.maximum(w_0 + t[:, None] * null, 0.0), np.nan)
    return Recovered(under + (1 - under) * np.minimum(weights @ spectra, 1.0), np.asarray(reached), weights)


def nearest(lab: ArrayLike, table: Weights, floor: ArrayLike = 0.0) -> Array:
    """Colour (3,) of a mixture nearest to a given one by ΔE*ab."""
    from scipy.optimize import LinearConstraint, minimize

    distance, spectra = distance_to(np.asarray(lab, dtype=float), table, floor, rescale=False), basis()
    optimum = minimize(  # type: ignore[call-overload]
        lambda w: float(distance(w[None])[0] ** 2),
        np.full(4, 0.3),
        bounds=[(0, 1)] * 4,
        constraints=LinearConstraint(spectra.T, -np.inf, 1.0),
        method="SLSQP",
        options={"maxiter": 300, "ftol": 1e-10},
    )
    w = np.clip(optimum.x, 0, 1)
    primaries, darkest = _primaries(table, floor)
    return colorimetry.xyz_to_lab(darkest + w / max(float((w @ spectra).max()), 1.0) @ primaries, table.white)


def distance_to(lab: Array, table: Weights, floor: ArrayLike, rescale: bool = True) -> Callable[[Array], Array]:
    """ΔE*ab to a colour, of weights (B, 4)."""
    primaries, darkest = _primaries(table, floor)

    def distance(w: Array) -> Array:
        xyz = darkest + (rescaled(w) if rescale else w) @ primaries
        return colorimetry.delta_e_ab(colorimetry.xyz_to_lab(xyz, table.white), lab)

    return distance


def _primaries(table: Weights, floor: ArrayLike) -> tuple[Array, Array]:
    """Tristimulus values (4, 3) that each basis spectrum adds above a floor, and (3,) of the floor alone."""
    under = np.broadcast_to(np.asarray(floor, dtype=float), len(table.weights))
    return (basis() * (1 - under)) @ table.weights, under @ table.weights


def rescaled(w: Array) -> Array:
    """Weights (B, 4) divided by the largest reflectance of their mixture where that exceeds 1."""
    return np.asarray(w / np.maximum((w @ peaks()).max(axis=1, keepdims=True), 1.0))


@cache
def peaks() -> Array:
    """The basis at the wavelengths where a mixture can be largest: those not exceeded by another in all four spectra."""
    spectra = basis().T
    unique = np.unique(spectra, axis=0)
    dominated = [(np.delete(unique, i, axis=0) >= row).all(axis=1).any() for i, row in enumerate(unique)]
    maximal: Array = unique[~np.array(dominated)].T
    maximal.setflags(write=False)
    return maximal
