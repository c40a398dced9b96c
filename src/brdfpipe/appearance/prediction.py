"""Colours at any geometries, measured or not, and how two materials differ there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.appearance.colours import angles, quality, xyz_of
from brdfpipe.bsdf.registry import representation
from brdfpipe.flakes.geometries import Directions, named_directions
from brdfpipe.spectra import colorimetry

Geometries = str | Sequence[str] | Mapping[str, Sequence[float]]
"""A standard's or an instrument's set (:data:`brdfpipe.flakes.SETS`), names of geometries, or name → θ_i, φ_i, θ_o, φ_o [degree]."""


def predicted_colours(
    bsdf: xr.Dataset, geometries: Geometries, illuminant: str = "D65", observer: int = 10
) -> xr.Dataset:
    """CIE L*a*b* of a material at geometries that need not have been measured.

    Parameters
    ----------
    bsdf : kind ``bsdf``
    geometries : see :data:`Geometries`
    illuminant, observer : of the colours; see :func:`brdfpipe.spectra.colorimetry.weights`

    Returns
    -------
    Dataset of kind ``colours``: ``lab(geometry, component)`` and the directions. A BSDF that rests on measured angles (an effect
        paint, a measured BRDF) has ``lab_quality(geometry)`` too, which flags geometries beyond the measured ones as extrapolated

    Notes
    -----
    An effect paint that was given as colours is exact under the illuminant and the observer of these, from X, Y and Z. Under others
    it depends on spectra that were recovered from the colours, and is a guess.
    """
    vocabulary.validate(bsdf, "bsdf")
    if isinstance(geometries, Mapping):
        directions = {name: Directions(*map(float, pair)) for name, pair in geometries.items()}
    else:
        directions = named_directions(geometries)
    at = angles(directions)
    name, white = colorimetry.illuminant_name(illuminant), colorimetry.weights(illuminant, observer).white
    evaluator = representation(bsdf)
    xyz = evaluator.tristimulus(at[0], at[1], at[2], at[3], name, observer)
    if xyz is None:
        xyz = xyz_of(bsdf, evaluator.evaluate(at[0], at[1], at[2], at[3], None), illuminant, observer)
    result = xr.Dataset(
        {"lab": (("geometry", "component"), colorimetry.xyz_to_lab(xyz, white))},
        coords={"geometry": list(directions), "component": ["L*", "a*", "b*"]},
        attrs={"illuminant": name, "observer": observer},
    )
    result = result.assign({angle: ("geometry", values) for angle, values in zip(Directions._fields, at, strict=True)})
    if (flags := quality(bsdf, directions)) is not None:
        result["lab_quality"] = ("geometry", flags)
    return vocabulary.label(result, "colours")


def colour_difference(
    first: xr.Dataset, second: xr.Dataset, geometries: Geometries, illuminant: str = "D65", observer: int = 10
) -> xr.DataArray:
    """CIEDE2000 between two materials at any geometries; arguments as for :func:`predicted_colours`.

    Returns
    -------
    DataArray ``delta_e_00(geometry)`` [1]; with the coordinate ``lab_quality(geometry)`` where either material has one, the worse of
    both: no measurement supports a difference that is flagged as extrapolated
    """
    colours = [predicted_colours(bsdf, geometries, illuminant, observer) for bsdf in (first, second)]
    difference = colorimetry.delta_e_00(colours[0]["lab"].values, colours[1]["lab"].values)
    attrs = {"units": "1", "long_name": "CIEDE2000 colour difference"}
    coords: dict[str, object] = {"geometry": colours[0]["geometry"].values}
    flags = [colour["lab_quality"] for colour in colours if "lab_quality" in colour]
    if flags:
        coords["lab_quality"] = ("geometry", np.max([flag.values for flag in flags], axis=0), flags[0].attrs)
    return xr.DataArray(difference, coords, ("geometry",), "delta_e_00", attrs)
