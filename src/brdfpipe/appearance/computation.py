"""How a material appears to people and instruments: gloss, haze, colour, and further quantities of the table."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.appearance import quantities
from brdfpipe.appearance.cabin import Cabin
from brdfpipe.appearance.colours import (
    ANGLE_TOLERANCE,
    FLOP_GEOMETRIES,
    GEOMETRIES,
    TOTAL,
    colour,
    colour_quality,
    colour_uncertainty,
    colour_without_specular,
    flop_index,
)
from brdfpipe.appearance.gloss_basis import MEASURED_FLAGS, gloss_quality, gloss_uncertainty_from_bsdf
from brdfpipe.appearance.gloss_meter import gloss, gloss_and_haze
from brdfpipe.appearance.haze import WINDOWS, HazeWindow, checked_window, reflectance_haze_with_uncertainty
from brdfpipe.appearance.input_uncertainty import with_input_uncertainty, with_transmission_uncertainty
from brdfpipe.appearance.veiling_glare import veiling_luminance
from brdfpipe.bsdf.registry import representation
from brdfpipe.errors import BrdfpipeError
from brdfpipe.spectra import colorimetry

PARTS = ("gloss", "haze", "colour", "transmission")
"""What may be computed; ``gloss`` with the haze of D4039, ``haze`` is that beside the mirror direction."""


def compute_appearance(
    bsdf: xr.Dataset,
    *,
    illuminant: str = "D65",
    observer: int = 10,
    gloss_angles: Sequence[float] = (20, 60, 85),
    geometries: Sequence[str] = (),
    haze: Sequence[HazeWindow | Mapping[str, Any]] = WINDOWS,
    parts: Sequence[str] = PARTS,
    standard_geometries: bool = True,
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
    parts : what is computed, of :data:`PARTS`
    standard_geometries : whether :data:`.colours.GEOMETRIES` are computed too
    cabin : of a dashboard of this material; adds the veiling luminance (:func:`.veiling_glare.veiling_luminance`)

    Returns
    -------
    Dataset of kind ``appearance``, of these the asked parts:

    - ``gloss``; ``haze`` (G60 − G20, NaN without both); ``reflectance_haze`` by window; ``lab`` of the total reflectance and of single
      geometries; ``flop_index``. ``<name>_u``: standard uncertainty from the tolerances of instruments.
    - ``lab_sce`` of the reflectance at 8° without what a gloss trap takes; ``luminous_reflectance``; ``srgb`` of the total reflectance (2° observer, D65); the computed quantities of
      :mod:`brdfpipe.appearance.quantities`.
    - BSDF that rests on measured angles: ``lab_quality`` and ``gloss_quality``, and ``gloss_u`` contains the uncertainty of the BSDF.
    - Surface with a lay: the values are means over the azimuth of the plane of incidence. ``gloss_along``, ``gloss_across``,
      ``lab_along`` and ``lab_across`` are for planes along the azimuth ``lay`` and across it.
    - Paint without a modelled clear coat: gloss and haze are those of the flakes alone. The attribute ``no_gloss``, a warning, and a
      ``comment`` on each number state this.

    Raises
    ------
    BrdfpipeError : an unknown part or geometry, or an impossible window.
    """
    if unknown := sorted(set(parts) - set(PARTS)):
        raise BrdfpipeError(f"no part {unknown[0]!r} of the appearance; accepted: {', '.join(PARTS)}")
    all_geometries = [*(GEOMETRIES if standard_geometries else ()), *geometries]
    windows = [checked_window(window) for window in haze] if "haze" in parts else []
    appearance = xr.Dataset()
    if "gloss" in parts:
        appearance = appearance.assign(gloss_and_haze(bsdf, gloss_angles).data_vars)
    if "colour" in parts:
        appearance = _with_colours(appearance, bsdf, all_geometries, illuminant, observer)
    if "gloss" in parts:
        appearance = _add_gloss_basis(appearance, bsdf)
    if windows:
        appearance["reflectance_haze"], appearance["reflectance_haze_u"] = reflectance_haze_with_uncertainty(
            bsdf, windows
        )
    appearance = with_input_uncertainty(appearance, bsdf, geometries=all_geometries, windows=windows)
    if not representation(bsdf).isotropic:
        appearance = appearance.assign(
            _along_and_across(bsdf, parts, illuminant, observer, gloss_angles, all_geometries)
        )
    if "transmission" in parts:
        appearance = with_transmission_uncertainty(appearance.assign(quantities.computed(bsdf)), bsdf)
    if cabin is not None:
        appearance = appearance.assign(veiling_luminance(bsdf, cabin).data_vars)
    if ("gloss" in parts or windows) and (reason := representation(bsdf).gloss_caveat):
        appearance = vocabulary.add_warning(_mark_flakes_alone(appearance, reason), reason)
    return vocabulary.label(_with_flop_warning(appearance), "appearance")


def _with_colours(
    appearance: xr.Dataset, bsdf: xr.Dataset, geometries: Sequence[str], illuminant: str, observer: int
) -> xr.Dataset:
    """Add colours, the flop index and the total reflectance; no flop index without the three geometries of E2194."""
    lab = colour(bsdf, geometries, illuminant, observer)
    tolerances = colour_uncertainty(bsdf, geometries, illuminant, observer)
    wavelength, total = representation(bsdf).total_reflectance()
    weight = colorimetry.luminous_weight(wavelength)
    without = colour_without_specular(bsdf, illuminant, observer)
    added = {"lab": lab, "lab_sce": without, **tolerances.data_vars}
    if set(FLOP_GEOMETRIES) <= set(lab["geometry"].values):
        flop = flop_index(*lab.sel(geometry=list(FLOP_GEOMETRIES), component="L*").values.tolist())
        if math.isnan(flop):
            added["flop_index_u"] = added["flop_index_u"].copy(data=float("nan"))
        added["flop_index"] = xr.DataArray(flop)
    else:
        del added["flop_index_u"]
    added["luminous_reflectance"] = xr.DataArray(float(weight @ total / weight.sum()))
    added["srgb"] = xr.DataArray(
        colorimetry.reflectance_to_srgb(wavelength, total), {"channel": ["R", "G", "B"]}, ("channel",)
    )
    if (flags := colour_quality(bsdf, geometries)) is not None:
        added["lab_quality"] = flags
    seen_under = {"illuminant": illuminant, "observer": observer}
    return appearance.assign(added).assign_attrs(seen_under, total_geometry=TOTAL, angle_tolerance=ANGLE_TOLERANCE)


def _with_flop_warning(appearance: xr.Dataset) -> xr.Dataset:
    """Warn of colours that have no flop index because they brighten away from the mirror direction."""
    if not math.isnan(float(appearance.get("flop_index", 0.0))):
        return appearance
    near, far = (float(appearance["lab"].sel(geometry=name, component="L*")) for name in FLOP_GEOMETRIES[::2])
    if far <= near:
        return appearance
    return vocabulary.add_warning(
        appearance,
        f"No flop index: L* rises from {near:.1f} at 15° from the mirror direction to {far:.1f} at 110°. The flop "
        "index is for paints that darken away from the mirror direction. Check that the colours belong to their geometries.",
    )


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
    bsdf: xr.Dataset,
    parts: Sequence[str],
    illuminant: str,
    observer: int,
    gloss_angles: Sequence[float],
    geometries: Sequence[str],
) -> dict[str, xr.DataArray | float]:
    """Gloss and colour in the planes along and across the lay; at azimuths 0 and 90° where the lay is not known."""
    lay = representation(bsdf).lay or 0.0
    values: dict[str, xr.DataArray | float] = {"lay": lay}
    for plane, azimuth in (("along", lay), ("across", lay + 90)):
        # Without units and long names, as the vocabulary has others for these names.
        if "gloss" in parts:
            values[f"gloss_{plane}"] = gloss(bsdf, gloss_angles, azimuth=azimuth).drop_attrs()
        if "colour" in parts:
            values[f"lab_{plane}"] = colour(bsdf, geometries, illuminant, observer, azimuth=azimuth).drop_attrs()
    return values
