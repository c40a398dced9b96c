"""How a material looks to people and instruments: gloss, haze, colour, and a preview."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.appearance.colours import (
    ANGLE_TOLERANCE,
    GEOMETRIES,
    TOTAL,
    colour,
    colour_quality,
    colour_uncertainty,
    flop_index,
)
from brdfpipe.appearance.gloss_basis import gloss_quality, of_bsdf
from brdfpipe.appearance.gloss_meter import gloss, gloss_and_haze, gloss_with_uncertainty
from brdfpipe.appearance.haze import WINDOWS, HazeWindow, reflectance_haze, reflectance_haze_with_uncertainty
from brdfpipe.appearance.prediction import colour_difference, predicted_colours
from brdfpipe.appearance.transmission import luminous_transmittance, transmission_haze
from brdfpipe.bsdf import representations

__all__ = [
    "appraise",
    "colour",
    "colour_difference",
    "colour_uncertainty",
    "flop_index",
    "gloss",
    "gloss_and_haze",
    "gloss_with_uncertainty",
    "luminous_transmittance",
    "predicted_colours",
    "reflectance_haze",
    "reflectance_haze_with_uncertainty",
    "transmission_haze",
]


def appraise(
    bsdf: xr.Dataset,
    *,
    illuminant: str = "D65",
    observer: int = 10,
    gloss_angles: Sequence[float] = (20, 60, 85),
    geometries: Sequence[str] = (),
    haze: Sequence[HazeWindow | Mapping[str, Any]] = WINDOWS,
) -> xr.Dataset:
    """The appearance numbers of a material.

    Parameters
    ----------
    bsdf : kind ``bsdf``
    illuminant, observer : for L*a*b*
    gloss_angles : degree, among 20, 60 and 85
    geometries : further ones for L*a*b*: names, or sets such as E2539 and MA-T6 (:data:`brdfpipe.flakes.SETS`)
    haze : windows of the reflectance haze; see :func:`reflectance_haze`

    Returns
    -------
    Dataset of kind ``appearance``: gloss, haze (G60 − G20, NaN without both), reflectance haze by window, L*a*b* of the total
        reflectance and of single geometries, flop index, each with ``<name>_u``, what the tolerances of instruments leave; where the
        BSDF rests on measured angles ``lab_quality`` and ``gloss_quality``, which tell what is extrapolated, and ``gloss_u`` contains
        what the BSDF's own uncertainty leaves; luminous reflectance, and the sRGB colour of the total reflectance (2° observer, D65).
        Of a surface with a lay these are means over the azimuth of the plane of incidence, and ``gloss_along``, ``gloss_across``,
        ``lab_along``, ``lab_across`` tell of planes along the azimuth ``lay`` and across it. Of a material that transmits,
        ``luminous_transmittance`` and ``transmission_haze`` (D1003-style) at normal incidence. Of a paint whose clear coat is not
        modelled, gloss and haze are those of the flakes alone: the attribute ``no_gloss`` and a warning say so, and name the
        model that has the coat; a ``comment`` stands at each of the numbers
    """
    from brdfpipe.spectra import colorimetry

    seen_at = [*GEOMETRIES, *geometries]
    lab = colour(bsdf, seen_at, illuminant, observer)
    wavelength, total = representations.total_reflectance(bsdf)
    lightness = [float(lab.sel(geometry=f"45as{angle}", component="L*")) for angle in (15, 45, 110)]
    flop = flop_index(*lightness)
    seen = colorimetry.luminous_weight(wavelength)
    appearance = xr.Dataset(
        {
            **gloss_and_haze(bsdf, gloss_angles).data_vars,
            "lab": lab,
            **colour_uncertainty(bsdf, seen_at, illuminant, observer).data_vars,
            "flop_index": flop,
            "luminous_reflectance": float(seen @ total / seen.sum()),
            "srgb": ("channel", colorimetry.reflectance_to_srgb(wavelength, total)),
        },
        coords={"channel": ["R", "G", "B"]},
        attrs={
            "illuminant": illuminant,
            "observer": observer,
            "total_geometry": TOTAL,
            "angle_tolerance": ANGLE_TOLERANCE,
        },
    )
    if math.isnan(flop):
        appearance["flop_index_u"] = appearance["flop_index_u"].copy(data=float("nan"))
    if (flags := colour_quality(bsdf, seen_at)) is not None:
        appearance["lab_quality"] = flags
    appearance = _with_basis(appearance, bsdf)
    if haze:
        appearance["reflectance_haze"], appearance["reflectance_haze_u"] = reflectance_haze_with_uncertainty(bsdf, haze)
    if not representations.isotropic(bsdf):
        appearance = appearance.assign(_along_and_across(bsdf, illuminant, observer, gloss_angles, geometries))
    if representations.transmits(bsdf):
        appearance = appearance.assign(
            luminous_transmittance=luminous_transmittance(bsdf), transmission_haze=transmission_haze(bsdf)
        )
    if why := _without_coat(bsdf):
        appearance = vocabulary.add_warning(_commented(appearance, why), why)
    if math.isnan(flop) and lightness[2] > lightness[0]:
        appearance = vocabulary.add_warning(appearance, _rising(lightness[0], lightness[2]))
    return vocabulary.label(appearance, "appearance")


def _with_basis(appearance: xr.Dataset, bsdf: xr.Dataset) -> xr.Dataset:
    """Gloss with what its BSDF leaves uncertain of it, and whether it was measured at all."""
    if (own := of_bsdf(bsdf, appearance["gloss"])) is not None:
        appearance["gloss_u"] = appearance["gloss_u"].copy(data=np.hypot(appearance["gloss_u"], own))
        appearance["gloss_u"].attrs["long_name"] += " and the BSDF"
    if (flags := gloss_quality(bsdf, appearance["gloss_angle"])) is None:
        return appearance
    appearance["gloss_quality"] = flags
    if own is None:  # the gloss of a paint is that of its clear coat
        return appearance
    told = {vocabulary.quality(name) for name in ("measured", "interpolated")}
    unseen = [
        f"{angle:g}°" for angle, flag in zip(flags["gloss_angle"].values, flags.values, strict=True) if flag not in told
    ]
    if not unseen:
        return appearance
    return vocabulary.add_warning(
        appearance,
        f"gloss at {' and '.join(unseen)} rests on directions that were not measured, and may be far off (see its uncertainty): measure at "
        "an incidence as large, or take it from a gloss meter",
    )


def _without_coat(bsdf: xr.Dataset) -> str:
    """Why the gloss is not that of the material; empty where it is, or where nothing better is known."""
    if bsdf.attrs["representation"] != "flake" or bsdf.attrs["clear_coat"] != "none":
        return ""
    coat = "model: flake-physical" if bsdf.attrs["model"] == "flake" else "clear_coat: smooth"
    return (
        "gloss and haze are those of the flakes alone, which no gloss meter sees: the clear coat mirrors far more, and the model "
        f"`{bsdf.attrs['model']}` without it has no gloss lobe; set `multiangle.{coat}` to have it"
    )


def _commented(appearance: xr.Dataset, why: str) -> xr.Dataset:
    noted = {
        name: appearance[name].assign_attrs(comment="of the flakes alone: no clear coat is modelled")
        for name in ("gloss", "gloss_u", "haze", "haze_u", "reflectance_haze", "reflectance_haze_u")
        if name in appearance
    }
    return appearance.assign(noted).assign_attrs(no_gloss=why)


def _rising(near: float, far: float) -> str:
    return (
        f"No flop index: L* is {far:.1f} at 110° from the mirror direction and {near:.1f} at 15°, and the index is for paints that "
        "darken away from it. Check that the colours belong to their geometries."
    )


def _along_and_across(
    bsdf: xr.Dataset, illuminant: str, observer: int, gloss_angles: Sequence[float], geometries: Sequence[str]
) -> dict[str, xr.DataArray | float]:
    """Gloss and colour in the two principal planes; of a surface whose lay is not known, along azimuth 0 and 90."""
    lay = representations.lay(bsdf) or 0.0
    found: dict[str, xr.DataArray | float] = {"lay": lay}
    for plane, azimuth in (("along", lay), ("across", lay + 90)):
        # Units and long names are those of the names here.
        found[f"gloss_{plane}"] = gloss(bsdf, gloss_angles, azimuth=azimuth).drop_attrs()
        found[f"lab_{plane}"] = colour(
            bsdf, [*GEOMETRIES, *geometries], illuminant, observer, azimuth=azimuth
        ).drop_attrs()
    return found
