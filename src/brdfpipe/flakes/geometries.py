"""Names of measuring geometries, as standards and portable instruments write them.

- ``45:-30``: incidence and view; the view counts positive on the illuminator's side of the normal.
- ``45as15``: incidence and aspecular angle, from the mirror direction towards the illuminator; ``45as-15`` is beyond the mirror.
- ``45as25az90``: out of the plane of incidence, turned about the mirror direction; azimuth 0 leads away from the normal.
- ``as15`` or ``as-15``: the effect-paint trade's short name of ``45as15``; its hyphen is not a sign. Names
  with and without a hyphen are refused together, because there it may be one.

References
----------
ASTM E2194, E2539; DIN 6175-2:2001 (since 2019 part of DIN 6175); patent US 7,991,596 (DuPont), whose signs these are. Instruments'
sets are as their makers publish them; those of E2539, DIN 6175-2, MA68, MA-T6 and the CM series could not be checked against a
public text.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from brdfpipe.errors import BrdfpipeError
from brdfpipe.geometry import Array, angles_of, unit_vector

_NUMBER = r"\d{1,3}(?:\.\d{1,6})?"
_VIEW = re.compile(rf"({_NUMBER})\s*[:/]\s*([+-]?{_NUMBER})")
_ASPECULAR = re.compile(rf"r?({_NUMBER})\s*as\s*([+-]?{_NUMBER})(?:\s*az\s*([+-]?{_NUMBER}))?", re.IGNORECASE)
_SHORT = re.compile(rf"as\s*-?\s*({_NUMBER})", re.IGNORECASE)

ACCEPTED = "45:-30, 45as15, 45as25az90, as-15, or theta_i, phi_i, theta_o and phi_o"

_SIX = ("45as-15", "45as15", "45as25", "45as45", "45as75", "45as110")

SETS: Mapping[str, tuple[str, ...]] = {
    "E2194": ("45as15", "45as45", "45as110"),
    "DIN 6175-2": ("45as25", "45as45", "45as75"),
    "E2539": (*_SIX, "15as-15", "15as15"),
    "BYK-mac": _SIX,
    "MA68": _SIX[1:],
    "MA-T6": _SIX,
    "MA-T12": (*_SIX, "15as-45", "15as-30", "15as-15", "15as15", "15as45", "15as80"),
    "CM-M6": _SIX,
    "CM-512m3": ("25:0", "45:0", "75:0"),
}
"""Geometries that a standard requires or an instrument measures, by its name."""


class Directions(NamedTuple):
    """A pair of directions [degree]; light comes from azimuth 0 unless the angles were given one by one."""

    theta_i: float
    phi_i: float
    theta_o: float
    phi_o: float


def directions(name: str) -> Directions:
    """Directions of a geometry, by its name.

    Parameters
    ----------
    name : see the module; a Unicode minus is a sign

    Raises
    ------
    BrdfpipeError : unknown name, or directions below the surface.
    """
    text = str(name).strip().replace("\N{MINUS SIGN}", "-")
    if short := _SHORT.fullmatch(text):
        if "\N{MINUS SIGN}" in str(name):
            raise _refusal(name, "a minus sign where the short name has a hyphen; write 45as15 or 45as-15")
        pair = _aspecular(45.0, float(short[1]), None)
    elif view := _VIEW.fullmatch(text):
        pair = _in_plane(float(view[1]), float(view[2]))
    elif aspecular := _ASPECULAR.fullmatch(text):
        turn = None if aspecular[3] is None else float(aspecular[3])
        pair = _aspecular(float(aspecular[1]), float(aspecular[2]), turn)
    else:
        raise _refusal(name, "unknown geometry")
    if not (0 <= pair.theta_i < 90 and 0 <= pair.theta_o < 90):
        raise _refusal(
            name, f"direction not above the surface (θ_i = {pair.theta_i:g}, θ_o = {pair.theta_o:.4g} degree)"
        )
    return pair


def named_directions(names: str | Sequence[str]) -> dict[str, Directions]:
    """Directions by name, of geometries or of the set of a standard or an instrument (:data:`SETS`)."""
    if isinstance(names, str):
        known = {title.casefold(): title for title in SETS}
        if names.casefold() in known:
            return named_directions(SETS[known[names.casefold()]])
        near = difflib.get_close_matches(names, SETS, n=1)
        if near:
            raise _refusal(names, f"unknown set of geometries (nearest is {near[0]})")
        names = [names]
    refuse_mixed_signs(names)
    return {name: directions(name) for name in names}


def refuse_mixed_signs(names: Iterable[object]) -> None:
    """Refuse short names with and without a hyphen together: the hyphen may be a sign.

    Raises BrdfpipeError: with both names, and what to write instead.
    """
    short = [str(name).strip() for name in names if _SHORT.fullmatch(str(name).strip())]
    hyphen = next((name for name in short if "-" in name), None)
    plain = next((name for name in short if "-" not in name), None)
    if hyphen is None or plain is None:
        return
    angle = hyphen.partition("-")[2].strip()
    raise BrdfpipeError(
        f"geometries {hyphen[:40]!r} and {plain[:40]!r} are ambiguous together: the hyphen may be a sign; write "
        f"45as-{angle} for {angle} degree beyond the mirror direction, 45as{angle} for {angle} degree towards the illuminator, and "
        "likewise for the other names"
    )


def geometry_name(pair: Directions) -> str:
    """A name of a pair of directions above the surface, that of a known set where one has it: the inverse of :func:`directions`."""
    turn = (pair.phi_o - pair.phi_i) % 360
    plain = Directions(pair.theta_i, 0.0, pair.theta_o, turn)
    for name in dict.fromkeys(name for names in SETS.values() for name in names):
        if np.allclose(_unit(directions(name)), _unit(plain), atol=1e-9):
            return name
    incidence, view = _written(pair.theta_i), _written(pair.theta_o)
    if min(turn, 360 - turn) < 1e-6 or pair.theta_o == 0:
        return f"{incidence}:{view}"
    if abs(turn - 180) < 1e-6:
        return f"{incidence}:-{view}"
    theta = np.radians(pair.theta_i)
    # Light falls from azimuth 0 here and from 180 in `_aspecular`, whose axes these are, turned about the normal.
    mirror = np.array([-np.sin(theta), 0.0, np.cos(theta)])
    away = np.array([-np.cos(theta), 0.0, -np.sin(theta)])
    towards = _unit(plain)[1]
    angle = np.degrees(np.arccos(np.clip(towards @ mirror, -1, 1)))
    azimuth = np.degrees(np.arctan2(-towards[1], towards @ away))
    return f"{incidence}as{_written(angle)}az{_written(azimuth)}"


def _written(angle: float) -> str:
    """An angle [degree] with the decimals that names may have."""
    return f"{angle:.6f}".rstrip("0").rstrip(".")


def _unit(pair: Directions) -> Array:
    """Unit vectors of light and view, (2, 3)."""
    return np.stack([unit_vector(pair.theta_i, pair.phi_i), unit_vector(pair.theta_o, pair.phi_o)])


def _in_plane(incidence: float, view: float) -> Directions:
    return Directions(incidence, 0.0, abs(view), 0.0 if view >= 0 else 180.0)


def _aspecular(incidence: float, aspecular: float, turn: float | None) -> Directions:
    if turn is None:
        return _in_plane(incidence, round(aspecular - incidence, 9))
    theta, angle, azimuth = np.radians([incidence, aspecular, turn])
    mirror = np.array([np.sin(theta), 0.0, np.cos(theta)])
    away = np.array([np.cos(theta), 0.0, -np.sin(theta)])
    across = np.array([0.0, 1.0, 0.0])
    view = np.cos(angle) * mirror + np.sin(angle) * (np.cos(azimuth) * away + np.sin(azimuth) * across)
    polar, phi = (float(value) for value in angles_of(view))
    # The mirror direction is at azimuth 180 here.
    return Directions(incidence, 0.0, round(polar, 9), round((phi + 180) % 360, 9))


def _refusal(name: str, problem: str) -> BrdfpipeError:
    return BrdfpipeError(f"geometry {str(name)[:40]!r}: {problem}; accepted: {ACCEPTED}")
