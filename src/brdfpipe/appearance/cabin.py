"""A dashboard below a windscreen, the light outside, and where the driver looks.

Car axes: x forwards, y to the left, z up. The windscreen is a plane rectangle whose foot lies across the car at the height of the
dashboard, which is horizontal.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from brdfpipe.appearance.skies import SKIES
from brdfpipe.errors import BrdfpipeError
from brdfpipe.geometry import Array
from brdfpipe.optics.fresnel_equations import Plate, internal_of_plate, polarised_plate


@dataclass(frozen=True)
class Windscreen:
    """A plane pane of one glass."""

    rake: float = 30.0
    """Angle between the pane and the horizontal [degree]"""
    length: float = 0.9
    """From its foot to its top, along the pane [m]"""
    width: float = 1.4
    """[m]"""
    transmittance: float = 0.75
    """Luminous transmittance at normal incidence, reflections included [1]"""
    index: float = 1.52
    """Refractive index of the glass"""

    def plate(self, cosine: Array) -> Plate:
        """Reflectances and transmittances of the pane at cosines of the angle of incidence."""
        return polarised_plate(
            np.clip(cosine, 1e-9, 1.0), self.index, internal_of_plate(self.transmittance, self.index)
        )


@dataclass(frozen=True)
class Sun:
    """The disc of the sun."""

    elevation: float = 45.0
    """[degree]"""
    azimuth: float = 0.0
    """From the direction of driving, to the left [degree]"""
    illuminance: float = 100_000.0
    """On a plane perpendicular to its light, outside the car [lx]"""


@dataclass(frozen=True)
class Sky:
    """The sky without the sun."""

    kind: str = "clear"
    illuminance: float = 15_000.0
    """Of the whole sky on the horizontal plane, outside the car [lx]"""


@dataclass(frozen=True)
class Cabin:
    """A dashboard below a windscreen, the light outside, and where the driver looks."""

    windscreen: Windscreen = field(default_factory=Windscreen)
    sun: Sun = field(default_factory=Sun)
    sky: Sky = field(default_factory=Sky)
    line_of_sight: float = 5.0
    """Angle by which the driver looks down, straight ahead [degree]"""
    distance: float = 0.4
    """From the foot of the windscreen back to the point of the dashboard that the driver sees mirrored [m]"""
    material_azimuth: float = 0.0
    """Azimuth of the direction of driving in the frame of the material [degree]"""

    def __post_init__(self) -> None:
        if self.sky.kind not in SKIES:
            raise BrdfpipeError(f"unknown sky {self.sky.kind!r}; accepted: {', '.join(SKIES)}")
        if not internal_of_plate(self.windscreen.transmittance, self.windscreen.index) <= 1:
            most = polarised_plate(1.0, self.windscreen.index, 1.0).transmittance_s
            problem = f"glass of index {self.windscreen.index:g} cannot transmit {self.windscreen.transmittance:g}"
            raise BrdfpipeError(f"{problem}: its faces reflect the rest; accepted: at most {most:.4f}")
        if not self.windscreen.rake > self.line_of_sight:
            problem = f"the driver looks down by {self.line_of_sight:g} degree along a windscreen of rake {self.windscreen.rake:g}"
            raise BrdfpipeError(f"{problem}; accepted: a line of sight below the rake")
        if not self.view[2] > 0:
            raise BrdfpipeError(
                f"a windscreen of rake {self.windscreen.rake:g} degree does not mirror the dashboard to the driver, but what is behind; "
                f"accepted: a rake below {(180 + self.line_of_sight) / 2:g}"
            )
        if not self.through_the_windscreen(self.view):
            raise BrdfpipeError(
                f"the driver does not see the dashboard {self.distance:g} m behind the windscreen's foot mirrored: the place on the glass is "
                f"above its top; accepted: a smaller distance, or a longer windscreen than {self.windscreen.length:g} m"
            )

    @cached_property
    def glass_normal(self) -> Array:
        """Normal of the windscreen's inner face, into the cabin."""
        rake = np.radians(self.windscreen.rake)
        return np.array([-np.sin(rake), 0.0, -np.cos(rake)])

    @cached_property
    def view(self) -> Array:
        """From the dashboard to the place on the glass where the driver sees it."""
        turned = np.radians(2 * self.windscreen.rake - self.line_of_sight)
        return np.array([-np.cos(turned), 0.0, np.sin(turned)])

    @property
    def height(self) -> float:
        """Distance of the dashboard's point from the plane of the glass [m]."""
        return float(self.distance * np.sin(np.radians(self.windscreen.rake)))

    def directions_to(self, slant: Array, across: Array) -> Array:
        """Vectors from the dashboard's point to points of the glass: along the pane from its foot, and to the left [m]."""
        rake = np.radians(self.windscreen.rake)
        return np.stack([self.distance - slant * np.cos(rake), across, slant * np.sin(rake)], axis=-1)

    def point_on_glass(self, direction: Array) -> tuple[float, float] | None:
        """Where a ray from the dashboard's point meets the plane of the glass; None where it does not."""
        towards = -float(direction @ self.glass_normal)
        if towards <= 0:
            return None
        rake = np.radians(self.windscreen.rake)
        x, y, z = direction * self.height / towards - [self.distance, 0.0, 0.0]
        return float(z * np.sin(rake) - x * np.cos(rake)), float(y)

    def through_the_windscreen(self, direction: Array) -> bool:
        """Whether a ray from the dashboard's point passes the rectangle of the glass."""
        at = self.point_on_glass(direction)
        return at is not None and 0 <= at[0] <= self.windscreen.length and abs(at[1]) <= self.windscreen.width / 2


def cabin_of(content: Mapping[str, Any]) -> Cabin:
    """The cabin that the keys of a scene describe; absent ones have their defaults. Raises BrdfpipeError: an impossible geometry or glass."""
    kinds = {"windscreen": Windscreen, "sun": Sun, "sky": Sky}
    return Cabin(**{name: kinds[name](**value) if name in kinds else value for name, value in content.items()})
