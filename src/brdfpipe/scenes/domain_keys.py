"""The keys of a scene's ``domain``: the pairs of directions that the scene needs.

Directions point away from the surface; light comes from above (θ_i < 90°), and θ_o > 90° is transmission, as in :mod:`brdfpipe.geometry`.
"""

from typing import Annotated, Any, Self

from pydantic import Field, Strict, model_validator

from brdfpipe.descriptions.keys import Choice, Items, Keys, OneOf, key, mapping_or_value
from brdfpipe.errors import InputError

MIRROR = "mirror"
"""The axis of a cone that follows the incidence: (θ_i, φ_i + 180), and (180 − θ_i, φ_i + 180) on the transmission side."""


def _range_or_angle(value: Any) -> int:
    return 0 if isinstance(value, list | tuple) else 1


_Incidence = Annotated[float, Field(ge=0, lt=90, description="an angle of incidence")]
_IncidenceLimit = Annotated[float, Field(ge=0, le=90, description="an angle of incidence")]
_Polar = Annotated[float, Field(ge=0, le=180, description="an angle from the normal")]
_Azimuth = Annotated[float, Field(ge=-360, le=720, description="an azimuth")]

_IncidenceRange = Annotated[tuple[_IncidenceLimit, _IncidenceLimit], Strict(False), Items(rising=True)]
_PolarRange = Annotated[tuple[_Polar, _Polar], Strict(False), Items(rising=True)]
_AzimuthRange = Annotated[tuple[_Azimuth, _Azimuth], Strict(False), Items(rising=True)]

Incidences = Annotated[_IncidenceRange | _Incidence, Choice(_range_or_angle)]
Polars = Annotated[_PolarRange | _Polar, Choice(_range_or_angle)]
Azimuths = Annotated[_AzimuthRange | _Azimuth, Choice(_range_or_angle)]

_ALL_AROUND = (0, 360)


class _Incident(Keys):
    """Incidences of a part of a domain."""

    theta_i: Incidences = key("angle of incidence, or its range [low, high]", required=True, unit="degree", example=45)
    phi_i: Azimuths = key("azimuth of incidence, or its range", default=_ALL_AROUND, unit="degree")

    @model_validator(mode="after")
    def _check_turns(self) -> Self:
        for name in ("phi_i", "phi_o"):
            limits = getattr(self, name, None)
            if isinstance(limits, tuple) and limits[1] - limits[0] > 360:
                found, accepted = list(limits), "a range of at most 360 degree"
                raise InputError("", "more than one turn", where=name, found=found, accepted=accepted)
        return self


class Geometry(Keys):
    """One pair of directions."""

    theta_i: _Incidence = key("angle of incidence", required=True, unit="degree", example=45)
    phi_i: _Azimuth = key("azimuth of incidence", default=0, unit="degree")
    theta_o: _Polar = key("polar angle of view; above 90 in transmission", required=True, unit="degree", example=0)
    phi_o: _Azimuth = key("azimuth of view", required=True, unit="degree", example=180)


class Axis(Keys):
    """A fixed direction of view."""

    theta_o: _Polar = key("polar angle; above 90 in transmission", required=True, unit="degree", example=30)
    phi_o: _Azimuth = key("azimuth", required=True, unit="degree", example=180)


class Cone(_Incident):
    """Views within a cone."""

    about: Annotated[Axis | Annotated[str, OneOf((MIRROR,))], Choice(mapping_or_value)] = key(
        "axis of the cone: mirror (follows the incidence) or a fixed direction {theta_o, phi_o}",
        default=MIRROR,
        details="In transmission, mirror means the direction in which light passes straight through.",
    )
    half_angle: float = key(
        "half the opening of the cone, which ends at the horizon", required=True, unit="degree", gt=0, le=90, example=5
    )


class Range(_Incident):
    """A range of views."""

    phi_i: Azimuths = key("azimuth of incidence, or its range", default=0, unit="degree")
    theta_o: Polars = key(
        "polar angle of view, or its range; above 90 in transmission", required=True, unit="degree", example=[0, 80]
    )
    phi_o: Azimuths = key("azimuth of view, or its range", required=True, unit="degree", example=[0, 360])


class Hemisphere(_Incident):
    """All views."""

    theta_i: Incidences = key(
        "angle of incidence, or its range [low, high]", default=(0, 85), unit="degree", example=45
    )


class DomainKeys(Keys):
    """The pairs of directions that a scene needs: one or several parts."""

    at_least_one = ("geometries", "cones", "ranges", "hemisphere")
    none_given = "the domain is empty: no direction is named"

    geometries: list[Geometry] = key(
        "single pairs of directions, [{theta_i: 45, phi_i: 0, theta_o: 0, phi_o: 0}, …]",
        min_length=1,
        max_length=10_000,
        example=[{"theta_i": 45, "theta_o": 0, "phi_o": 180}],
    )
    cones: list[Cone] = key(
        "cones of views for incidences, [{theta_i: [0, 80], about: mirror, half_angle: 5}, …]",
        min_length=1,
        max_length=100,
    )
    ranges: list[Range] = key(
        "ranges of incidence and view, [{theta_i: [20, 70], theta_o: [0, 60], phi_o: [90, 270]}, …]",
        min_length=1,
        max_length=100,
    )
    hemisphere: Hemisphere = key("every view, for a range of incidences {theta_i, phi_i}; `{}` for its defaults")
    side: Annotated[str, OneOf(("reflection", "transmission", "both"))] = key(
        "side of the views: reflection, transmission or both", default="reflection"
    )

    @model_validator(mode="after")
    def _check_side(self) -> Self:
        """Refuse fixed views on the other side."""
        fixed: list[tuple[str, Any]] = [
            (f"geometries.{k}.theta_o", g.theta_o) for k, g in enumerate(self.geometries or ())
        ]
        fixed += [(f"ranges.{k}.theta_o", r.theta_o) for k, r in enumerate(self.ranges or ())]
        fixed += [
            (f"cones.{k}.about.theta_o", cone.about.theta_o)
            for k, cone in enumerate(self.cones or ())
            if isinstance(cone.about, Axis)
        ]
        low, high = {"reflection": (0, 90), "transmission": (90, 180), "both": (0, 180)}[self.side]
        for where, theta in fixed:
            first, last = theta if isinstance(theta, tuple) else (theta, theta)
            if first < low or last > high:
                found = f"{first:g}" if first == last else f"{first:g} to {last:g}"
                accepted = f"{low} to {high} with `side: {self.side}`; views above 90 are transmission"
                raise InputError(
                    "", "a view on another side of the surface", where=where, found=found, accepted=accepted
                )
        return self
