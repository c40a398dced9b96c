"""What a gloss rests on: whether its directions were measured, and how well the BSDF is known there."""

from __future__ import annotations

import numpy as np
import xarray as xr

from brdfpipe.appearance.colours import quality
from brdfpipe.bsdf import representations
from brdfpipe.flakes.geometries import Directions


def gloss_quality(bsdf: xr.Dataset, angles: xr.DataArray) -> xr.DataArray | None:
    """``gloss_quality(gloss_angle)``: a value of ``QUALITY_FLAGS`` of the mirror direction at each; None of a BSDF that rests on a model."""
    flags = quality(bsdf, {f"{angle:g}": Directions(angle, 0.0, angle, 180.0) for angle in angles.values.tolist()})
    return None if flags is None else angles.copy(data=flags).rename("gloss_quality")


def of_bsdf(bsdf: xr.Dataset, gloss: xr.DataArray) -> xr.DataArray | None:
    """Standard uncertainty of gloss units that the BSDF's own leaves; None where that is not known.

    Its relative uncertainty in the mirror direction is taken for all of the receptor: neighbouring directions are off together.
    """
    if not representations.has_uncertainty(bsdf):
        return None
    reduced, theta = representations.nonspectral(bsdf), gloss["gloss_angle"].values
    along = (theta, np.zeros_like(theta), theta, np.full_like(theta, 180.0), None)
    value, u = (
        each(reduced, *along)[..., 0]
        for each in (representations.representation(reduced).evaluate, representations.uncertainty)
    )
    return gloss * np.divide(u, value, out=np.zeros_like(u), where=value > 0)
