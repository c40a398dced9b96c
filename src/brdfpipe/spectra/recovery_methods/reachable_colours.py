"""Colours that a reflectance can have: the largest chroma at a hue and lightness, and the colour nearest to an impossible one."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from brdfpipe.geometry import Array
from brdfpipe.spectra import colorimetry
from brdfpipe.spectra.colorimetry import Weights
from brdfpipe.spectra.recovery_methods.lhtss import lhtss


def largest_chroma(lab: ArrayLike, table: Weights, specular: ArrayLike = 0.0) -> float:
    """Largest C*ab that a reflectance reaches at the L* and hue of a colour, from below, to 0.1 % of its own C*.

    Parameters
    ----------
    lab : (3,), 0 < L* < 100
    table : of :func:`brdfpipe.spectra.colorimetry.weights`
    specular : reflectance every wavelength has at least [1]
    """
    colour = np.asarray(lab, dtype=float)
    low, high, pieces = 0.0, 1.0, 32
    for _ in range(2):
        scale = np.linspace(low, high, pieces + 1)
        xyz = colorimetry.lab_to_xyz(colour * np.stack([np.ones_like(scale), scale, scale], axis=1), table.white)
        reached = lhtss(xyz, table, specular).reached
        last = int(np.argmin(reached)) - 1 if not reached.all() else pieces
        if last < 0:
            return 0.0
        low, high = scale[last], scale[min(last + 1, pieces)]
    return float(low * np.hypot(*colour[1:]))


def nearest_colour(lab: ArrayLike, table: Weights, specular: ArrayLike = 0.0) -> Array:
    """Colour that a reflectance reaches, about nearest to one out of reach by ΔE*ab.

    Parameters
    ----------
    lab : (3,) CIE 1976 L*, a*, b*, of two decimals
    table : of :func:`brdfpipe.spectra.colorimetry.weights`
    specular : reflectance every wavelength has at least [1]

    Returns
    -------
    lab : (3,) rounded to two decimals; :func:`lhtss` reaches it

    Notes
    -----
    Minimises ΔE*ab² over the reflectance at every wavelength within its bounds. The minimum is on the boundary of the solid
    of object colours, where reflectances are at their bounds; a small step towards grey is within reach.
    """
    from scipy.optimize import minimize

    wanted = np.asarray(lab, dtype=float)

    def square(r: Array) -> tuple[float, Array]:
        xyz = r @ table.weights
        off = colorimetry.xyz_to_lab(xyz, table.white) - wanted
        return float(off @ off), 2 * table.weights @ (_lab_slopes(xyz, table.white).T @ off)

    floor = np.broadcast_to(np.asarray(specular, dtype=float), table.wavelength.size)
    start = np.clip(colorimetry.lab_to_xyz(wanted, table.white)[1] / 100, floor + 1e-3, 1 - 1e-3)
    # Far out ΔE² is large and falls slowly: a looser bound on its relative fall ends the descent a few ΔE short.
    options: Any = {"maxiter": 5000, "maxfun": 50_000, "ftol": 1e-14, "gtol": 1e-9}
    bounds = [(float(lowest), 1.0) for lowest in floor]
    best = minimize(square, start, jac=True, bounds=bounds, method="L-BFGS-B", options=options).x
    grey = np.clip(best @ table.weights[:, 1] / 100, floor + 1e-3, 1 - 1e-3)
    share = np.append(0.0, np.geomspace(1e-6, 1, 64))[:, None]
    xyz = ((1 - share) * best + share * grey) @ table.weights
    near = np.round(colorimetry.xyz_to_lab(xyz, table.white), 2) + 0.0
    within = lhtss(colorimetry.lab_to_xyz(near, table.white), table, floor)
    return np.asarray(near[np.argmax(within.reached)])


def _lab_slopes(xyz: Array, white: Array) -> Array:
    """∂(L*, a*, b*)/∂(X, Y, Z), (3, 3)."""
    t = xyz / white
    slope = np.where(t > 216 / 24389, np.cbrt(np.maximum(t, 1e-6)) ** -2 / 3, 24389 / 27 / 116) / white
    mixed = np.array([[0, 116, 0], [500, -500, 0], [0, 200, -200]], dtype=float)
    return np.asarray(mixed * slope)
