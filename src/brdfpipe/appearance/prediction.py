"""Colours at any geometries, measured or not, and how two materials differ there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.appearance.colours import quality
from brdfpipe.bsdf.registry import representation
from brdfpipe.flakes.geometries import Directions, named_directions
from brdfpipe.geometry import Array
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
    Dataset of kind ``colours``: ``lab(geometry, component)`` and the directions; where it rests
    on measured angles (an effect paint, a measured BRDF) with ``lab_quality(geometry)`` as well, which flags what lies outside of
    them as extrapolated

    Notes
    -----
    An effect paint that was given as colours is exact under the illuminant and the observer of these, through X, Y and Z alone;
    under others the spectra recovered from them are a guess.
    """
    vocabulary.validate(bsdf, "bsdf")
    places = _places(geometries)
    at = np.array([list(place) for place in places.values()], dtype=float).reshape(-1, 4).T
    table = colorimetry.weights(illuminant, observer)
    result = xr.Dataset(
        {"lab": (("geometry", "component"), colorimetry.xyz_to_lab(_xyz(bsdf, at, illuminant, observer), table.white))},
        coords={"geometry": list(places), "component": ["L*", "a*", "b*"]},
        attrs={"illuminant": colorimetry.illuminant_name(illuminant), "observer": observer},
    )
    for name, angle in zip(("theta_i", "phi_i", "theta_o", "phi_o"), at, strict=True):
        result[name] = ("geometry", angle)
    if (flags := quality(bsdf, places)) is not None:
        result["lab_quality"] = ("geometry", flags)
    return vocabulary.label(result, "colours")


def colour_difference(
    first: xr.Dataset, second: xr.Dataset, geometries: Geometries, illuminant: str = "D65", observer: int = 10
) -> xr.DataArray:
    """CIEDE2000 between two materials at any geometries; arguments as for :func:`predicted_colours`.

    Returns
    -------
    DataArray ``delta_e_00(geometry)`` [1]; with the coordinate ``lab_quality(geometry)`` where either material has one, the worse of
    both: of a difference flagged as extrapolated nothing was measured that would bear it out
    """
    colours = [predicted_colours(bsdf, geometries, illuminant, observer) for bsdf in (first, second)]
    difference = colorimetry.delta_e_00(colours[0]["lab"].values, colours[1]["lab"].values)
    attrs = {"units": "1", "long_name": "CIEDE2000 colour difference"}
    coords: dict[str, object] = {"geometry": colours[0]["geometry"].values}
    flags = [colour["lab_quality"] for colour in colours if "lab_quality" in colour]
    if flags:
        coords["lab_quality"] = ("geometry", np.max([flag.values for flag in flags], axis=0), flags[0].attrs)
    return xr.DataArray(difference, coords, ("geometry",), "delta_e_00", attrs)


def _places(geometries: Geometries) -> dict[str, Directions]:
    if isinstance(geometries, Mapping):
        return {name: Directions(*map(float, angles)) for name, angles in geometries.items()}
    return named_directions(geometries)


def _xyz(bsdf: xr.Dataset, at: Array, illuminant: str, observer: int) -> Array:
    evaluator = representation(bsdf)
    own = evaluator.tristimulus(at[0], at[1], at[2], at[3], colorimetry.illuminant_name(illuminant), observer)
    if own is not None:
        return own
    brdf = evaluator.evaluate(at[0], at[1], at[2], at[3], None)
    wavelength = bsdf["wavelength"].values if "wavelength" in bsdf.coords else np.array([360.0, 780.0])
    factor = np.broadcast_to(np.pi * brdf, (*brdf.shape[:-1], wavelength.size))
    return colorimetry.reflectance_to_xyz(wavelength, factor, illuminant, observer)
