"""Basis of gloss values: whether their directions were measured, and the uncertainty of the BSDF there."""

from __future__ import annotations

import numpy as np
import xarray as xr

from brdfpipe.appearance.colours import quality
from brdfpipe.appearance.diffracted_gloss import diffracted_gloss_u
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.representations.kirchhoff import Kirchhoff
from brdfpipe.flakes.geometries import Directions
from brdfpipe.vocabulary import QUALITY_FLAGS

MEASURED_FLAGS = ("measured", "interpolated")
"""Quality flags of directions that were measured, or that are between measured ones."""


def gloss_quality(bsdf: xr.Dataset, angles: xr.DataArray) -> xr.DataArray | None:
    """``gloss_quality(gloss_angle)``: quality flag of the mirror direction at each geometry; None for a BSDF from a model."""
    flags = quality(bsdf, {f"{angle:g}": Directions(angle, 0.0, angle, 180.0) for angle in angles.values.tolist()})
    return None if flags is None else angles.copy(data=flags).rename("gloss_quality")


def gloss_uncertainty_from_bsdf(bsdf: xr.Dataset, gloss: xr.DataArray) -> xr.DataArray | None:
    """Standard uncertainty of gloss [gloss units] from that of the BSDF; None where the BSDF has none.

    Of diffraction on a map it is that of the light in the receptor (:func:`.diffracted_gloss.diffracted_gloss_u`). Otherwise the relative uncertainty
    in the mirror direction is applied to the whole receptor: errors of neighbouring directions are correlated.
    """
    if not representation(bsdf).states_uncertainty:
        return None
    reduced, theta = nonspectral(bsdf), gloss["gloss_angle"].values
    if isinstance(representation(reduced), Kirchhoff):
        pairs = zip(theta, gloss.values, strict=True)
        return gloss.copy(data=[diffracted_gloss_u(reduced, float(angle), float(value)) for angle, value in pairs])
    mirror = (theta, np.zeros_like(theta), theta, np.full_like(theta, 180.0), None)
    value = representation(reduced).evaluate(*mirror)[..., 0]
    u = representation(reduced).uncertainty(*mirror)[..., 0]
    return gloss * np.divide(u, value, out=np.zeros_like(u), where=value > 0)


def gloss_flags(appearance: xr.Dataset | None) -> dict[float, str]:
    """Quality flag of gloss by geometry [degree]; empty for a BSDF from a model."""
    if appearance is None or "gloss_quality" not in appearance:
        return {}
    flags = [QUALITY_FLAGS[flag] for flag in appearance["gloss_quality"].values]
    return dict(zip(appearance["gloss_angle"].values.tolist(), flags, strict=True))


def worst_flag(appearance: xr.Dataset | None, *angles: float) -> str:
    """The worst quality flag of gloss at some geometries; empty where none has a flag."""
    flags = gloss_flags(appearance)
    return max((flags[angle] for angle in angles if angle in flags), key=QUALITY_FLAGS.index, default="")


def basis_note(appearance: xr.Dataset | None, *angles: float) -> str:
    """`` (extrapolated)`` and the like where gloss rests on directions that were not measured; else empty."""
    flag = worst_flag(appearance, *angles)
    return f" ({flag})" if flag and flag not in MEASURED_FLAGS else ""
