"""The pairs of directions that a scene needs, as a set to sample and to ask.

Incidences are spread evenly over their range of angles. For each incidence, views are spread evenly in projected solid angle
|cos θ_o| dω_o, the measure in which a BRDF sums to reflectance. A domain of several parts counts every part alike; its single
geometries are together one part.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from brdfpipe.errors import BrdfpipeError
from brdfpipe.geometry import Array, unit_vector
from brdfpipe.scenes.domain_keys import MIRROR
from brdfpipe.scenes.projected_cone import within_cone

TOLERANCE = 1e-6
"""Angle by which a direction may miss a part of a domain and still count as inside [degree]."""

_DIMENSIONS = 4

Limits = tuple[float, float]


class DirectionPairs(NamedTuple):
    """Pairs of directions with their weights, (n,) each; angles in degree."""

    theta_i: Array
    phi_i: Array
    theta_o: Array
    phi_o: Array
    weight: Array
    """Share of the domain that a pair stands for; the sum is 1"""

    @property
    def angles(self) -> tuple[Array, Array, Array, Array]:
        return self[:4]


class Part(ABC):
    """A part of a domain that is sampled."""

    theta_i: Limits
    phi_i: Limits

    def sample(self, points: Array) -> tuple[Array, Array, Array, Array]:
        """θ_i, φ_i, θ_o, φ_o [degree] of points of the unit hypercube (n, 4)."""
        theta_i, phi_i = _between(self.theta_i, points[:, 0]), _between(self.phi_i, points[:, 1])
        theta_o, phi_o = self.views(theta_i, phi_i, points[:, 2], points[:, 3])
        return theta_i, phi_i, theta_o, phi_o % 360

    def contains(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> NDArray[np.bool_]:
        """Whether pairs of directions belong to the part."""
        incident = _in_angles(self.theta_i, theta_i) & (_in_azimuths(self.phi_i, phi_i) | (theta_i <= TOLERANCE))
        return np.asarray(incident & self.sees(theta_i, phi_i, theta_o, phi_o))

    @property
    @abstractmethod
    def transmits(self) -> bool:
        """Whether views are on the transmission side."""

    @property
    def incidence_words(self) -> str:
        return f"incidence {_words(self.theta_i)}, {_azimuth_words(self.phi_i)}"

    @abstractmethod
    def views(self, theta_i: Array, phi_i: Array, u: Array, v: Array) -> tuple[Array, Array]:
        """θ_o and φ_o of points of the unit square, for incidences of the same shape."""

    @abstractmethod
    def sees(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> NDArray[np.bool_]:
        """Whether views belong to the part, for incidences that do."""

    @abstractmethod
    def description(self) -> str:
        """The part in words."""


@dataclass(frozen=True)
class ConePart(Part):
    """Views within a cone, on one side."""

    theta_i: Limits
    phi_i: Limits
    axis: tuple[float, float] | None
    """θ and φ; None follows the incidence"""
    half_angle: float
    below: bool
    """Whether the views are on the transmission side"""

    @property
    def transmits(self) -> bool:
        return self.below

    def views(self, theta_i: Array, phi_i: Array, u: Array, v: Array) -> tuple[Array, Array]:
        theta, phi = self._axis(theta_i, phi_i)
        rise, turn = within_cone(180 - theta if self.below else theta, self.half_angle, u, v)
        return 180 - rise if self.below else rise, phi + turn

    def sees(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> NDArray[np.bool_]:
        return _on_side(theta_o, self.below) & (
            _between_directions(*self._axis(theta_i, phi_i), theta_o, phi_o) <= self.half_angle + TOLERANCE
        )

    def _axis(self, theta_i: Array, phi_i: Array) -> tuple[Array, Array]:
        if self.axis is not None:
            return np.full_like(theta_i, self.axis[0]), np.full_like(theta_i, self.axis[1])
        return 180 - theta_i if self.below else theta_i, phi_i + 180

    def description(self) -> str:
        followed = "straight" if self.below else "mirror"
        axis = f"the {followed} direction" if self.axis is None else f"({self.axis[0]:g}°, {self.axis[1]:g}°)"
        return f"{self.incidence_words}: views within {self.half_angle:g}° of {axis}"


@dataclass(frozen=True)
class RangePart(Part):
    """Views of a range of polar angles and azimuths."""

    theta_i: Limits
    phi_i: Limits
    theta_o: Limits
    phi_o: Limits

    @property
    def transmits(self) -> bool:
        return self.theta_o[1] > 90

    def views(self, theta_i: Array, phi_i: Array, u: Array, v: Array) -> tuple[Array, Array]:
        first, last = (_projected_share(limit) for limit in self.theta_o)
        share = first + (last - first) * u
        rise = np.degrees(np.arcsin(np.sqrt(np.clip(np.minimum(share, 2 - share), 0.0, 1.0))))
        theta_o = np.clip(np.where(share <= 1, rise, 180 - rise), *self.theta_o)
        return theta_o, _between(self.phi_o, v)

    def sees(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> NDArray[np.bool_]:
        pole = np.minimum(theta_o, 180 - theta_o) <= TOLERANCE
        return np.asarray(_in_angles(self.theta_o, theta_o) & (_in_azimuths(self.phi_o, phi_o) | pole))

    def description(self) -> str:
        return f"{self.incidence_words}: views {_words(self.theta_o)}, {_azimuth_words(self.phi_o)}"


@dataclass(frozen=True)
class HemispherePart(Part):
    """All views on one side."""

    theta_i: Limits
    phi_i: Limits
    below: bool

    @property
    def transmits(self) -> bool:
        return self.below

    def views(self, theta_i: Array, phi_i: Array, u: Array, v: Array) -> tuple[Array, Array]:
        rise = np.degrees(np.arcsin(np.sqrt(u)))
        return 180 - rise if self.below else rise, 360 * v

    def sees(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> NDArray[np.bool_]:
        return _on_side(theta_o, self.below)

    def description(self) -> str:
        return f"{self.incidence_words}: all views {'in transmission' if self.below else 'in reflection'}"


class Domain:
    """The pairs of directions that a scene needs.

    Parameters
    ----------
    content : what :class:`.domain_keys.DomainKeys` declares, with defaults, as :func:`brdfpipe.descriptions.reading.read` returns it

    Raises
    ------
    BrdfpipeError : an empty domain.
    """

    def __init__(self, content: Mapping[str, Any]) -> None:
        below = {"reflection": (False,), "transmission": (True,), "both": (False, True)}[
            content.get("side", "reflection")
        ]
        names = ("theta_i", "phi_i", "theta_o", "phi_o")
        self.geometries = tuple(tuple(float(pair[name]) for name in names) for pair in content.get("geometries", ()))
        self.parts: tuple[Part, ...] = (
            *(part for cone in content.get("cones", ()) for part in _cones(cone, below)),
            *(RangePart(*(_limits(views[name]) for name in names)) for views in content.get("ranges", ())),
            *(
                HemispherePart(_limits(views["theta_i"]), _limits(views["phi_i"]), side)
                for views in ([content["hemisphere"]] if "hemisphere" in content else [])
                for side in below
            ),
        )
        if not (self.geometries or self.parts):
            raise BrdfpipeError("the domain is empty; accepted: geometries, cones, ranges or the hemisphere")

    @property
    def incidences(self) -> list[list[float]]:
        """Ranges of the angle of incidence [low, high] of its parts [degree], increasing, each once."""
        ranges = {(pair[0], pair[0]) for pair in self.geometries} | {part.theta_i for part in self.parts}
        return [[float(low), float(high)] for low, high in sorted(ranges)]

    @property
    def transmits(self) -> bool:
        """Whether a view is on the transmission side."""
        return any(pair[2] > 90 for pair in self.geometries) or any(part.transmits for part in self.parts)

    def directions(self, n: int, seed: int) -> DirectionPairs:
        """Pairs of directions: the single geometries as they are, then ``n`` sampled ones.

        Parameters
        ----------
        n : number of sampled pairs, at least one for each part; 0 is accepted, and any other number ignored, where there are only single
            geometries
        seed : of the scrambling. The first n of 2n pairs are those of n

        Notes
        -----
        A Sobol' sequence for each part, scrambled after Owen (scipy.stats.qmc); the parts take turns. Different seeds give independent
        scrambles, whose scatter is the sampling error of a mean.
        """
        if isinstance(n, bool) or not isinstance(n, int | np.integer) or n < len(self.parts):
            raise BrdfpipeError(f"number of directions is {n!r}; accepted: an integer >= {len(self.parts)}")
        fixed, count = len(self.geometries), int(n) if self.parts else 0
        parts = len(self.parts) + (fixed > 0)
        angles, weight = np.empty((fixed + count, 4)), np.empty(fixed + count)
        if fixed:
            angles[:fixed], weight[:fixed] = np.array(self.geometries), 1 / (parts * fixed)
        for number, part in enumerate(self.parts):
            turns = np.arange(fixed + number, fixed + count, len(self.parts))
            points = _sobol(turns.size, np.random.default_rng([seed, number]))
            angles[turns], weight[turns] = np.stack(part.sample(points), axis=-1), 1 / (parts * turns.size)
        theta_i, phi_i, theta_o, phi_o = angles.T
        return DirectionPairs(theta_i, phi_i, theta_o, phi_o, weight)

    def contains(self, theta_i: ArrayLike, phi_i: ArrayLike, theta_o: ArrayLike, phi_o: ArrayLike) -> NDArray[np.bool_]:
        """Whether pairs of directions [degree, broadcastable] belong to the domain, within :data:`TOLERANCE`."""
        angles = np.broadcast_arrays(*(np.asarray(angle, dtype=float) for angle in (theta_i, phi_i, theta_o, phi_o)))
        inside = np.zeros(angles[0].shape, dtype=bool)
        for pair in self.geometries:
            near = _between_directions(*angles[:2], *pair[:2]) <= TOLERANCE
            inside |= near & (_between_directions(*angles[2:], *pair[2:]) <= TOLERANCE)
        for part in self.parts:
            inside |= part.contains(*angles)
        return inside

    def description(self) -> str:
        """The domain in words, its parts separated by semicolons."""
        words = [part.description() for part in self.parts]
        if self.geometries:
            listed = [f"{a:g}°, {b:g}° → {c:g}°, {d:g}°" for a, b, c, d in self.geometries[:3]]
            more = len(self.geometries) - len(listed)
            words.insert(0, "geometries " + " and ".join([*listed, *([f"{more} more"] if more else [])]))
        return "; ".join(words)


def _cones(cone: Mapping[str, Any], below: Sequence[bool]) -> list[ConePart]:
    incident = _limits(cone["theta_i"]), _limits(cone["phi_i"])
    if cone["about"] == MIRROR:
        return [ConePart(*incident, None, float(cone["half_angle"]), side) for side in below]
    axis = float(cone["about"]["theta_o"]), float(cone["about"]["phi_o"])
    return [ConePart(*incident, axis, float(cone["half_angle"]), axis[0] > 90)]


def _sobol(n: int, generator: np.random.Generator) -> Array:
    from scipy.stats import qmc

    # A whole power of two, of which the first n are taken: scipy warns of other numbers, which are balanced a little less.
    points = qmc.Sobol(_DIMENSIONS, scramble=True, rng=generator).random_base2(max(n - 1, 0).bit_length())
    return np.asarray(points[:n])


def _limits(angle: float | Sequence[float]) -> Limits:
    first, last = angle if isinstance(angle, Sequence) else (angle, angle)
    return float(first), float(last)


def _between(limits: Limits, share: Array) -> Array:
    return limits[0] + (limits[1] - limits[0]) * share


def _projected_share(theta: float) -> float:
    """∫ |cos θ| 2 sin θ dθ from 0 to θ: 1 at the horizon, 2 straight down."""
    square = float(np.sin(np.radians(theta)) ** 2)
    return square if theta <= 90 else 2 - square


def _on_side(theta: Array, below: bool) -> NDArray[np.bool_]:
    return np.asarray(theta >= 90 - TOLERANCE if below else theta <= 90 + TOLERANCE)


def _in_angles(limits: Limits, angle: Array) -> NDArray[np.bool_]:
    return np.asarray((angle >= limits[0] - TOLERANCE) & (angle <= limits[1] + TOLERANCE))


def _in_azimuths(limits: Limits, azimuth: Array) -> NDArray[np.bool_]:
    beyond = (azimuth - limits[0] + TOLERANCE) % 360
    return np.asarray(beyond <= limits[1] - limits[0] + 2 * TOLERANCE)


def _between_directions(theta_1: ArrayLike, phi_1: ArrayLike, theta_2: ArrayLike, phi_2: ArrayLike) -> Array:
    """Angle between directions [degree], accurate for small ones."""
    chord = np.linalg.norm(unit_vector(theta_1, phi_1) - unit_vector(theta_2, phi_2), axis=-1)
    return np.degrees(2 * np.arcsin(np.minimum(chord / 2, 1.0)))


def _words(limits: Limits) -> str:
    return f"{limits[0]:g}°" if limits[0] == limits[1] else f"{limits[0]:g}° to {limits[1]:g}°"


def _azimuth_words(limits: Limits) -> str:
    return "all azimuths" if limits[1] - limits[0] >= 360 else f"azimuth {_words(limits)}"
