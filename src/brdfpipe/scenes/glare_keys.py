"""The keys of a veiling glare geometry: a dashboard below a windscreen, and the light outside. The defaults are those of the computation."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import model_validator

from brdfpipe.appearance.cabin import Cabin, cabin_of
from brdfpipe.appearance.skies import SKIES
from brdfpipe.descriptions.keys import Keys, OneOf, key
from brdfpipe.errors import BrdfpipeError, InputError

_CABIN = Cabin()


class WindscreenKeys(Keys):
    """A plane pane of one glass."""

    rake: float = key(
        "angle between the windscreen and the horizontal",
        default=_CABIN.windscreen.rake,
        unit="degree",
        ge=5,
        le=85,
        details="Some drawings give the angle from the vertical instead: 90 minus this.",
    )
    length: float = key(
        "from its foot to its top, along the pane", default=_CABIN.windscreen.length, unit="m", gt=0, le=10
    )
    width: float = key("width", default=_CABIN.windscreen.width, unit="m", gt=0, le=10)
    transmittance: float = key(
        "luminous transmittance at normal incidence, reflections included",
        default=_CABIN.windscreen.transmittance,
        gt=0,
        lt=1,
    )
    index: float = key("refractive index of the glass", default=_CABIN.windscreen.index, ge=1.3, le=2.5)


class SunKeys(Keys):
    """The disc of the sun."""

    elevation: float = key("elevation above the horizon", default=_CABIN.sun.elevation, unit="degree", gt=0, le=90)
    azimuth: float = key(
        "azimuth from the direction of driving, to the left", default=_CABIN.sun.azimuth, unit="degree", ge=-360, le=360
    )
    illuminance: float = key(
        "illuminance on a plane perpendicular to its light, outside the car; 0 without sun",
        default=_CABIN.sun.illuminance,
        unit="lx",
        ge=0,
        le=200_000,
    )


class SkyKeys(Keys):
    """The sky without the sun."""

    kind: Annotated[str, OneOf(tuple(SKIES))] = key(
        "uniform, clear or overcast: types 5, 12 and 1 of ISO 15469", default=_CABIN.sky.kind
    )
    illuminance: float = key(
        "illuminance of the whole sky on the horizontal plane, outside the car",
        default=_CABIN.sky.illuminance,
        unit="lx",
        ge=0,
        le=200_000,
    )


class GlareKeys(Keys):
    """The geometry and the light of veiling glare."""

    windscreen: WindscreenKeys = key(
        "the pane {rake, length, width, transmittance, index}", default=WindscreenKeys.model_construct()
    )
    sun: SunKeys = key("the sun {elevation, azimuth, illuminance}", default=SunKeys.model_construct())
    sky: SkyKeys = key("the sky {kind, illuminance}", default=SkyKeys.model_construct())
    line_of_sight: float = key(
        "angle by which the driver looks down, straight ahead; below 0 up",
        default=_CABIN.line_of_sight,
        unit="degree",
        ge=-30,
        le=60,
    )
    distance: float = key(
        "from the foot of the windscreen back to the point of the dashboard that the driver sees mirrored",
        default=_CABIN.distance,
        unit="m",
        gt=0,
        le=5,
    )
    material_azimuth: float = key(
        "azimuth of the direction of driving in the frame of the material; for surfaces with a lay",
        default=_CABIN.material_azimuth,
        unit="degree",
        ge=-360,
        le=360,
    )

    @model_validator(mode="after")
    def _check_geometry(self) -> Self:
        try:
            cabin_of(self.model_dump())
        except BrdfpipeError as error:
            raise InputError("", str(error)) from error
        return self
