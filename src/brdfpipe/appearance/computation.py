"""How a material appears to people and instruments: gloss, haze, colour, and further quantities of the table."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.appearance import quantities
from brdfpipe.appearance.colours import (
    ANGLE_TOLERANCE,
    GEOMETRIES,
    TOTAL,
    colour,
    colour_quality,
    colour_uncertainty,
    flop_index,
)
from brdfpipe.appearance.gloss_basis import MEASURED_FLAGS, gloss_quality, gloss_uncertainty_from_bsdf
from brdfpipe.appearance.gloss_meter import gloss, gloss_and_haze
from brdfpipe.appearance.haze import WINDOWS, HazeWindow, checked_window, reflectance_haze_with_uncertainty
from brdfpipe.appearance.input_uncertainty import with_input_uncertainty, with_transmission_uncertainty
from brdfpipe.appearance.veiling_glare import Cabin, veiling_luminance
from brdfpipe.bsdf.registry import representation
from brdfpipe.spectra import colorimetry


def compute_appearance(
    bsdf: xr.Dataset,
    *,
    illuminant: str = "D65",
    observer: int = 10,
    gloss_angles: Sequence[float] = (20, 60, 85),
    geometries: Sequence[str] = (),
    haze: Sequence[HazeWindow | Mapping[str, Any]] = WINDOWS,
    cabin: Cabin | None = None,
) -> xr.Dataset:
    """The appearance quantities of a material.

    Parameters
    ----------
    bsdf : kind ``bsdf``
    illuminant, observer : of L*a*b*
    gloss_angles : degree, among 20, 60 and 85
    geometries : of L*a*b*, in addition to :data:`.colours.GEOMETRIES`: names, or sets such as E2539 and MA-T6
        (:data:`brdfpipe.flakes.SETS`)
    haze : windows of the reflectance haze; see :func:`.haze.reflectance_haze`
    cabin : of a dashboard of this material; adds the veiling luminance (:func:`.veiling_glare.veiling_luminance`)

    Returns
    -------
    Dataset of kind ``appearance``:

    - ``gloss``; ``haze`` (G60 − G20, NaN without both); ``reflectance_haze`` by window; ``lab`` of the total reflectance and of single
      geometries; ``flop_index``. ``<name>_u``: standard uncertainty from the tolerances of instruments.
    - ``luminous_reflectance``; ``srgb`` of the total reflectance (2° observer, D65); the computed quantities of
      :mod:`brdfpipe.appearance.quantities`.
    - BSDF that rests on measured angles: ``lab_quality`` and ``gloss_quality``, and ``gloss_u`` contains the uncertainty of the BSDF.
    - Surface with a lay: the values are means over the azimuth of the plane of incidence. ``gloss_along``, ``gloss_across``,
      ``lab_along`` and ``lab_across`` are for planes along the azimuth ``lay`` and across it.
    - Paint without a modelled clear coat: gloss and haze are those of the flakes alone. The attribute ``no_gloss``, a warning, and a
      ``comment`` on each number state this.
    """
    all_geometries = [*GEOMETRIES, *geometries]
    lab = colour(bsdf, all_geometries, illuminant, observer)
    wavelength, total = representation(bsdf).total_reflectance()
    lightness = [float(lab.sel(geometry=f"45as{angle}", component="L*")) for angle in (15, 45, 110)]
    flop = flop_index(*lightness)
    weight = colorimetry.luminous_weight(wavelength)
    appearance = xr.Dataset(
        {
            **gloss_and_haze(bsdf, gloss_angles).data_vars,
            "lab": lab,
            **colour_uncertainty(bsdf, all_geometries, illuminant, observer).data_vars,
            "flop_index": flop,
            "luminous_reflectance": float(weight @ total / weight.sum()),
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
    if (flags := colour_quality(bsdf, all_geometries)) is not None:
        appearance["lab_quality"] = flags
    appearance = _add_gloss_basis(appearance, bsdf)
    if haze:
        appearance["reflectance_haze"], appearance["reflectance_haze_u"] = reflectance_haze_with_uncertainty(bsdf, haze)
    windows = [checked_window(window) for window in haze]
    appearance = with_input_uncertainty(appearance, bsdf, geometries=all_geometries, windows=windows)
    if not representation(bsdf).isotropic:
        appearance = appearance.assign(_along_and_across(bsdf, illuminant, observer, gloss_angles, all_geometries))
    appearance = with_transmission_uncertainty(appearance.assign(quantities.computed(bsdf)), bsdf)
    if cabin is not None:
        appearance = appearance.assign(veiling_luminance(bsdf, cabin).data_vars)
    if reason := representation(bsdf).gloss_caveat:
        appearance = vocabulary.add_warning(_mark_flakes_alone(appearance, reason), reason)
    if math.isnan(flop) and lightness[2] > lightness[0]:
        appearance = vocabulary.add_warning(
            appearance,
            f"No flop index: L* rises from {lightness[0]:.1f} at 15° from the mirror direction to {lightness[2]:.1f} at 110°. The flop "
            "index is for paints that darken away from the mirror direction. Check that the colours belong to their geometries.",
        )
    return vocabulary.label(appearance, "appearance")


def _add_gloss_basis(appearance: xr.Dataset, bsdf: xr.Dataset) -> xr.Dataset:
    """Add the uncertainty of the BSDF to that of gloss, and the quality flags of gloss."""
    if (u := gloss_uncertainty_from_bsdf(bsdf, appearance["gloss"])) is not None:
        appearance["gloss_u"] = appearance["gloss_u"].copy(data=np.hypot(appearance["gloss_u"], u))
        appearance["gloss_u"].attrs["long_name"] += " and the BSDF"
    if (flags := gloss_quality(bsdf, appearance["gloss_angle"])) is None:
        return appearance
    appearance["gloss_quality"] = flags
    if u is None:  # the gloss of a paint is that of its clear coat
        return appearance
    measured = np.isin(flags.values, [vocabulary.quality(name) for name in MEASURED_FLAGS])
    unmeasured = [f"{angle:g}°" for angle in flags["gloss_angle"].values[~measured]]
    if not unmeasured:
        return appearance
    return vocabulary.add_warning(
        appearance,
        f"Gloss at {' and '.join(unmeasured)} rests on directions that were not measured. It may be far off; see its uncertainty. "
        "Measure at a larger incidence, or use a gloss meter.",
    )


def _mark_flakes_alone(appearance: xr.Dataset, reason: str) -> xr.Dataset:
    marked = {
        name: appearance[name].assign_attrs(comment="of the flakes alone: no clear coat is modelled")
        for name in ("gloss", "gloss_u", "haze", "haze_u", "reflectance_haze", "reflectance_haze_u")
        if name in appearance
    }
    return appearance.assign(marked).assign_attrs(no_gloss=reason)


def _along_and_across(
    bsdf: xr.Dataset, illuminant: str, observer: int, gloss_angles: Sequence[float], geometries: Sequence[str]
) -> dict[str, xr.DataArray | float]:
    """Gloss and colour in the planes along and across the lay; at azimuths 0 and 90° where the lay is not known."""
    lay = representation(bsdf).lay or 0.0
    values: dict[str, xr.DataArray | float] = {"lay": lay}
    for plane, azimuth in (("along", lay), ("across", lay + 90)):
        # Without units and long names, as the vocabulary has others for these names.
        values[f"gloss_{plane}"] = gloss(bsdf, gloss_angles, azimuth=azimuth).drop_attrs()
        values[f"lab_{plane}"] = colour(bsdf, geometries, illuminant, observer, azimuth=azimuth).drop_attrs()
    return values
