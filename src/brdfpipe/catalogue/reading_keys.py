"""The key ``measured`` of ``material.yaml``: readings of a laboratory's own instruments, which are compared with what the BRDF predicts.

The default uncertainties are those of :mod:`brdfpipe.comparison.reading_defaults`.
"""

from __future__ import annotations

from datetime import date
from typing import Annotated

from pydantic import BeforeValidator, Field, Strict

from brdfpipe.comparison.reading_defaults import LAB_U, REFLECTANCE_HAZE_U, TRANSMITTANCE_U
from brdfpipe.descriptions.keys import Keys, OneOf, key

Gloss = Annotated[float, Field(ge=0, le=2000)]
Lab = Annotated[
    tuple[
        Annotated[float, Field(ge=0, le=400, description="L*")],
        Annotated[float, Field(ge=-400, le=400, description="a*")],
        Annotated[float, Field(ge=-400, le=400, description="b*")],
    ],
    Strict(False),
]
Uncertainty = Annotated[float, Field(gt=0, le=100)]


class GlossReadings(Keys):
    """Gloss units by geometry."""

    at_least_one = ("20", "60", "85")
    none_given = "no gloss reading"

    at_20: Gloss = key("gloss units at 20 degree", alias="20", example=3.1)
    at_60: Gloss = key("gloss units at 60 degree", alias="60", example=22.4)
    at_85: Gloss = key("gloss units at 85 degree", alias="85", example=48)


class ColourReading(Keys):
    """A colour at one geometry."""

    geometry: str = key(
        'the geometry by name: "8:total" (a sphere, specular included), "8:sce" (excluded, by a gloss trap), "45:0", "45as15" and others of `appearance.geometries`',
        required=True,
        min_length=3,
        max_length=32,
        example="45:0",
    )
    lab: Lab = key("the three numbers L*, a*, b*", required=True, example=[50, 0, 0])
    illuminant: str = key("illuminant of the colour, D65, D50, A or another CIE illuminant", default="D65")
    observer: Annotated[int, OneOf((10, 2))] = key("observer of the colour, 10 or 2 degree", default=10)


class ReadingUncertainty(Keys):
    """Standard uncertainties of the readings."""

    gloss: Uncertainty = key("of each gloss reading, gloss units", default_words="1, and 1 % of a reading above 100")
    haze: Uncertainty = key(
        "of `haze`, gloss units", default_words="√2 of that of gloss, as a difference of two readings"
    )
    reflectance_haze: Uncertainty = key("of `reflectance_haze`, gloss units", default=REFLECTANCE_HAZE_U)
    lab: Uncertainty = key("of each of L*, a* and b*", default=LAB_U)
    transmittance: Annotated[float, Field(gt=0, le=1)] = key(
        "of `transmittance`, a share of 1", default=TRANSMITTANCE_U
    )


class MeasuredReadings(Keys):
    """Readings of instruments, beside which the prediction is put."""

    at_least_one = ("gloss", "haze", "reflectance_haze", "lab", "transmittance")
    none_given = "no reading"

    gloss: GlossReadings = key("gloss units by geometry {20, 60, 85}, D523 or ISO 2813")
    haze: Gloss = key("haze after ASTM D4039: gloss at 60 degree minus gloss at 20 degree")
    reflectance_haze: Gloss = key("haze after ISO 13803, without the logarithmic scale of instruments")
    lab: list[ColourReading] = key("colours, each {geometry, lab, illuminant, observer}", min_length=1, max_length=100)
    transmittance: Annotated[float, Field(ge=0, le=1)] = key(
        "total luminous transmittance of a clear body at normal incidence, a share of 1"
    )
    uncertainty: ReadingUncertainty = key(
        "standard uncertainties of the readings (k = 1) {gloss, haze, reflectance_haze, lab, transmittance}",
        default=ReadingUncertainty.model_construct(),
    )
    instrument: str = key(
        "the instrument, one line for the page", max_length=200, example="hand-held gloss meter, 20°, 60°, 85°"
    )
    date: Annotated[str, BeforeValidator(lambda day: day.isoformat() if isinstance(day, date) else day)] = key(
        "day of the readings, as 2026-01-31", pattern=r"^\d{4}-\d{2}-\d{2}$", example="2026-01-31"
    )
