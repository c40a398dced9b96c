"""What a scene may ask for. Which stages compute it follows from the conditions in :mod:`brdfpipe.stages`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Result:
    """A result that a scene may ask for."""

    name: str
    """As ``results`` of a scene names it."""
    words: str
    """For the documentation."""
    of_appearance: bool = False
    """Whether it is a part of the appearance that every material may have."""


_RESULTS = (
    Result("bsdf", "the BRDF itself, a function to evaluate anywhere"),
    Result("gloss", "gloss units, and the haze of D4039", of_appearance=True),
    Result("haze", "haze beside the mirror direction", of_appearance=True),
    Result("colour", "L\\*a\\*b\\*, the flop index and the total reflectance", of_appearance=True),
    Result("transmission", "transmittance and transmission haze of a clear body", of_appearance=True),
    Result("veiling_glare", "luminance of a dashboard's image in the windscreen ([veiling glare](veiling-glare.md))"),
    Result("checks", "reciprocity, energy and closure of the BRDF"),
    Result("model_error", "the prediction beside rays and diffraction on its own scan"),
    Result(
        "uncertainty",
        "standard uncertainties of the BRDF, gloss, haze, colours and transmission from the inputs of the BRDF and its model",
    ),
    Result("comparison", "the measured BRDF of a camera rig, and readings of instruments, beside the predicted ones"),
    Result("table", "the BRDF on a grid of directions"),
    Result("lambert_gauss", "the parameters of a Lambert and Gauss model"),
    Result("preview", "a picture of the material"),
    Result("texture", "visible structure beside the BRDF, of materials with the key `texture` ([texture](texture.md))"),
    Result("page", "the page of the material"),
)

RESULTS: Mapping[str, Result] = {result.name: result for result in _RESULTS}
"""By name."""

PARTS = tuple(result.name for result in _RESULTS if result.of_appearance)
"""Results that are parts of the appearance that every material may have."""
