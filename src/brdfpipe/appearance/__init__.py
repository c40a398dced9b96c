"""How a material looks to people and instruments: gloss, haze, colour, and a preview."""

from __future__ import annotations

from collections.abc import Sequence

import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.appearance.colour import TOTAL, colour, flop_index
from brdfpipe.appearance.gloss import gloss
from brdfpipe.bsdf import representations

__all__ = ["appraise", "colour", "flop_index", "gloss"]


def appraise(
    bsdf: xr.Dataset,
    *,
    illuminant: str = "D65",
    observer: int = 10,
    gloss_angles: Sequence[float] = (20, 60, 85),
) -> xr.Dataset:
    """The appearance numbers of a material.

    Parameters
    ----------
    bsdf : kind ``bsdf``
    illuminant, observer : for L*a*b*
    gloss_angles : degree, among 20, 60 and 85

    Returns
    -------
    Dataset of kind ``appearance``: gloss, haze (G60 − G20, NaN without both), L*a*b* of the total reflectance and of single
        geometries, flop index, luminous reflectance, and the sRGB colour of the total reflectance (2° observer, D65)
    """
    from brdfpipe.spectra import colorimetry

    units = gloss(bsdf, gloss_angles)
    lab = colour(bsdf, illuminant=illuminant, observer=observer)
    wavelength, total = representations.total_reflectance(bsdf)
    by_angle = dict(zip(units["gloss_angle"].values.tolist(), units.values.tolist(), strict=True))
    lightness = lab.sel(component="L*")
    seen = colorimetry.luminous_weight(wavelength)
    appearance = xr.Dataset(
        {
            "gloss": units,
            "haze": by_angle.get(60.0, float("nan")) - by_angle.get(20.0, float("nan")),
            "lab": lab,
            "flop_index": flop_index(*(float(lightness.sel(geometry=f"45as{angle}")) for angle in (15, 45, 110))),
            "luminous_reflectance": float(seen @ total / seen.sum()),
            "srgb": ("channel", colorimetry.reflectance_to_srgb(wavelength, total)),
        },
        coords={"channel": ["R", "G", "B"]},
        attrs={"illuminant": illuminant, "observer": observer, "total_geometry": TOTAL},
    )
    return vocabulary.label(appearance, "appearance")
