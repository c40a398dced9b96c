"""Which geometries of instruments are in the domain of a scene."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from brdfpipe.flakes.geometries import Directions, geometry_name, named_directions
from brdfpipe.geometry import Array
from brdfpipe.scenes.domain import Domain

_AZIMUTHS = np.arange(360.0)


def gloss_angles(domain: Domain, angles: Iterable[float]) -> list[float]:
    """The angles of incidence [degree] whose mirror direction is in the domain."""
    return [angle for angle in angles if _contains(domain, _mirrored(angle))]


def haze_windows(domain: Domain, windows: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The windows of a haze meter whose mirror direction is in the domain."""
    return [dict(window) for window in windows if _contains(domain, _mirrored(window["angle"]))]


def colour_geometries(domain: Domain, names: Sequence[str]) -> list[str]:
    """The single geometries of the domain, each once: those of ``names`` (geometries, or sets of an instrument) in it, and the pairs of
    directions that it lists.

    A listed pair has the name of the same pair in ``names`` or in a known set, or a name of its own. Views of transmitted light are left out.
    """
    named = {one: pair for name in names for one, pair in named_directions(name).items()}
    candidates = {name: pair for name, pair in named.items() if _contains(domain, pair)}
    for listed in (Directions(*pair) for pair in domain.geometries):
        if listed.theta_o < 90:
            candidates.setdefault(geometry_name(listed), listed)
    found: dict[str, Directions] = {}
    for name, pair in candidates.items():
        if not any(_same(pair, other) for other in found.values()):
            found[name] = pair
    return list(found)


def _mirrored(angle: float) -> Directions:
    return Directions(angle, 0.0, angle, 180.0)


def _same(one: Directions, other: Directions) -> bool:
    return bool(np.any(Domain({"geometries": [one._asdict()]}).contains(*_turned(other, np.array([one.phi_i])))))


def _contains(domain: Domain, pair: Directions) -> bool:
    """Whether a domain contains a pair of directions at any azimuth of incidence."""
    starts = [pair[1] for pair in domain.geometries] + [limit for part in domain.parts for limit in part.phi_i]
    return bool(np.any(domain.contains(*_turned(pair, np.concatenate([starts, _AZIMUTHS])))))


def _turned(pair: Directions, azimuths: Array) -> tuple[Any, Any, Any, Any]:
    """A pair of directions turned about the normal to azimuths of incidence [degree]."""
    return pair.theta_i, azimuths, pair.theta_o, pair.phi_o - pair.phi_i + azimuths
