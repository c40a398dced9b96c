"""Colours of a material under a light: the total reflectance, and single geometries."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.bsdf import representations
from brdfpipe.spectra import colorimetry

TOTAL = "8:total"
"""Name of the sphere geometry: 8° incidence, all reflected light, specular included."""

GEOMETRIES: Mapping[str, tuple[float, float, float]] = {
    "45:0": (45.0, 0.0, 0.0),
    "45as15": (45.0, 30.0, 180.0),
    "45as45": (45.0, 0.0, 0.0),
    "45as110": (45.0, 65.0, 0.0),
}
"""Single geometries by name: incidence, viewing angle, and azimuth of the view from the incidence [degree] (ASTM E2194)."""


def colour(
    bsdf: xr.Dataset,
    geometries: Mapping[str, tuple[float, float, float]] = GEOMETRIES,
    illuminant: str = "D65",
    observer: int = 10,
) -> xr.DataArray:
    """CIE L*a*b* of the total reflectance at 8° and of single geometries.

    Parameters
    ----------
    bsdf : kind ``bsdf``; one that does not depend on wavelength is neutral
    geometries : name → (theta_i, theta_o, phi_o) [degree]; the reflectance factor is π·BRDF
    illuminant, observer : CIE illuminant name; 2 or 10 [degree]

    Returns
    -------
    DataArray ``lab(geometry, component)`` [1]; L* exceeds 100 where a geometry sees a highlight

    References
    ----------
    CIE 015; ASTM E308, E2194.
    """
    vocabulary.validate(bsdf, "bsdf")
    wavelength, total = representations.total_reflectance(bsdf)
    directions = np.array(list(geometries.values()), dtype=float).reshape(-1, 3).T
    module = representations.representation(bsdf)
    brdf = module.evaluate(bsdf, directions[0], np.zeros_like(directions[0]), directions[1], directions[2], None)
    factors = np.concatenate([total[None], np.broadcast_to(np.pi * brdf, (brdf.shape[0], wavelength.size))])
    white = colorimetry.weights(illuminant, observer).white
    xyz = colorimetry.reflectance_to_xyz(wavelength, factors, illuminant, observer)
    quantity = vocabulary.QUANTITIES["lab"]
    return xr.DataArray(
        colorimetry.xyz_to_lab(xyz, white),
        dims=("geometry", "component"),
        coords={"geometry": [TOTAL, *geometries], "component": ["L*", "a*", "b*"]},
        name="lab",
        attrs={"units": quantity.units, "long_name": quantity.long_name},
    )


def flop_index(lab15: float, lab45: float, lab110: float) -> float:
    """Flop index 2.69 (L15 − L110)^1.11 / L45^0.86 of the lightness at 15, 45 and 110° aspecular; NaN where it is not defined.

    References
    ----------
    Alman 1987; ASTM E2194 geometries.
    """
    if not lab15 >= lab110 or not lab45 > 0:
        return float("nan")
    return float(2.69 * (lab15 - lab110) ** 1.11 / lab45**0.86)
