"""Colours of a material under a light: the total reflectance, and single geometries."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.bsdf import representations
from brdfpipe.flakes.geometries import SETS, Directions, named
from brdfpipe.spectra import colorimetry

TOTAL = "8:total"
"""Name of the sphere geometry: 8° incidence, all reflected light, specular included."""

GEOMETRIES = ("45:0", *SETS["E2194"])
"""Single geometries that every material is appraised at: 45:0, and the three of ASTM E2194."""

_ALL_ROUND = np.arange(0.0, 360.0, 1.0)

_ROUNDING = 1e-9
"""Differences of lightness that a perfect diffuser shows by rounding."""


def colour(
    bsdf: xr.Dataset,
    geometries: Sequence[str] | Mapping[str, tuple[float, float, float]] = GEOMETRIES,
    illuminant: str = "D65",
    observer: int = 10,
    *,
    azimuth: float | None = None,
) -> xr.DataArray:
    """CIE L*a*b* of the total reflectance at 8° and of single geometries.

    A single geometry away from the mirror direction does not see what a polished surface mirrors; the total reflectance does.

    Parameters
    ----------
    bsdf : kind ``bsdf``; one that does not depend on wavelength is neutral
    geometries : names of geometries (``45as15``), of standards and of instruments (:data:`brdfpipe.flakes.SETS`), each geometry
        once; or name → (theta_i, theta_o, phi_o) [degree]. The reflectance factor is π·BRDF
    illuminant, observer : CIE illuminant name; 2 or 10 [degree]
    azimuth : of the plane of incidence of the single geometries [degree]; by default the colour of the mean over all azimuths,
        which matters to a surface with a lay. The total reflectance is always such a mean

    Returns
    -------
    DataArray ``lab(geometry, component)`` [1]; L* exceeds 100 where a geometry sees a highlight

    Raises
    ------
    BrdfpipeError : an unknown name.

    References
    ----------
    CIE 015; ASTM E308, E2194, E2539; DIN 6175-2:2001 (since 2019 part of DIN 6175). Public sources confirm three angles for E2194,
    several angles of illumination and of view for E2539, and the sign of the aspecular angle, positive towards the normal; that
    the three are 15, 45 and 110° is the trade's use.
    """
    vocabulary.validate(bsdf, "bsdf")
    wavelength, total = representations.total_reflectance(bsdf)
    turns = _ALL_ROUND if azimuth is None and not representations.isotropic(bsdf) else np.array([azimuth or 0.0])
    places = _places(geometries)
    at = np.array([list(place) for place in places.values()], dtype=float).reshape(-1, 4).T[:, :, None]
    module = representations.representation(bsdf)
    theta_i, phi_i, theta_o, phi_o = np.broadcast_arrays(at[0], at[1] + turns, at[2], at[3] + turns)
    brdf = module.evaluate(bsdf, theta_i, phi_i, theta_o, phi_o, None).mean(axis=1)
    factors = np.concatenate([total[None], np.broadcast_to(np.pi * brdf, (brdf.shape[0], wavelength.size))])
    white = colorimetry.weights(illuminant, observer).white
    xyz = colorimetry.reflectance_to_xyz(wavelength, factors, illuminant, observer)
    quantity = vocabulary.QUANTITIES["lab"]
    return xr.DataArray(
        colorimetry.xyz_to_lab(xyz, white),
        dims=("geometry", "component"),
        coords={"geometry": [TOTAL, *places], "component": ["L*", "a*", "b*"]},
        name="lab",
        attrs={"units": quantity.units, "long_name": quantity.long_name},
    )


def _places(geometries: Sequence[str] | Mapping[str, tuple[float, float, float]]) -> dict[str, Directions]:
    if isinstance(geometries, Mapping):
        return {name: Directions(theta_i, 0.0, theta_o, phi) for name, (theta_i, theta_o, phi) in geometries.items()}
    return {name: place for each in geometries for name, place in named(each).items()}


def flop_index(lab15: float, lab45: float, lab110: float) -> float:
    """Flop index 2.69 (L15 − L110)^1.11 / L45^0.86 of the lightness at 15, 45 and 110° aspecular; NaN where it is not defined.

    References
    ----------
    Alman 1987 (DuPont); ASTM E2194 geometries. Public sources confirm the scale, 0 of a solid colour and 15 to 17 of the strongest
    metallic, but not the constants.
    """
    fall = lab15 - lab110
    if not fall >= -_ROUNDING or not lab45 > 0:
        return float("nan")
    return float(2.69 * max(fall, 0.0) ** 1.11 / lab45**0.86)
