"""The geometries of standards and instruments: each direction lies where its name says."""

from __future__ import annotations

import re

import numpy as np
import pytest

from brdfpipe.appearance.colours import GEOMETRIES
from brdfpipe.flakes import SETS, directions
from brdfpipe.geometry import Array

NAMES = sorted({name for names in SETS.values() for name in names} | set(GEOMETRIES))
OUT_OF_PLANE = [
    *(f"45as25az{turn}" for turn in (90, -90)),
    *(f"45as60az{turn}" for turn in (125.3, -125.3)),
    *(f"15as38.3az{turn}" for turn in (43, -43)),
    *(f"15as46.9az{turn}" for turn in (104.5, -104.5)),
]
"""Of a portable instrument with 19 geometries."""


def vector(theta, phi) -> Array:
    theta, phi = np.radians([theta, phi])
    return np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])


def vectors(name) -> tuple[Array, Array, Array]:
    """Of the light, of its mirror image and of the view; the normal is the third axis."""
    at = directions(name)
    light = vector(at.theta_i, at.phi_i)
    return light, light * [-1, -1, 1], vector(at.theta_o, at.phi_o)


def degrees_between(one, other) -> float:
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(one, other)), one @ other)))


def numbers(name) -> tuple[float, float, float | None]:
    """Incidence, aspecular angle (positive from the mirror direction towards the normal) and turn that a name states."""
    if aspecular := re.fullmatch(r"([\d.]+)as(-?[\d.]+)(?:az(-?[\d.]+))?", name):
        return float(aspecular[1]), float(aspecular[2]), None if aspecular[3] is None else float(aspecular[3])
    incidence, view = map(float, name.split(":"))
    return incidence, incidence + view, None


@pytest.mark.parametrize("name", [*NAMES, *OUT_OF_PLANE])
def test_the_view_is_as_far_from_the_mirror_direction_as_the_name_says(name):
    light, mirror, view = vectors(name)
    incidence, aspecular, _ = numbers(name)
    assert degrees_between(light, [0, 0, 1]) == pytest.approx(incidence, abs=1e-6)
    assert degrees_between(mirror, view) == pytest.approx(abs(aspecular), abs=1e-6)


@pytest.mark.parametrize("name", NAMES)
def test_a_positive_aspecular_angle_is_towards_the_light(name):
    light, mirror, view = vectors(name)
    assert light[0] > 0
    # From the normal, positive on the light's side.
    mirrored, seen = (float(np.degrees(np.arctan2(direction[0], direction[2]))) for direction in (mirror, view))
    assert seen - mirrored == pytest.approx(numbers(name)[1], abs=1e-6)
    assert view[1] == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("name", OUT_OF_PLANE)
def test_the_turn_about_the_mirror_direction_is_that_of_the_name(name):
    _, mirror, view = vectors(name)
    _, _, turn = numbers(name)
    aside = view - (view @ mirror) * mirror
    # Azimuth 0 leads away from the normal.
    away = mirror * mirror[2] - [0, 0, 1]
    assert degrees_between(aside, away) == pytest.approx(abs(turn), abs=1e-6)
    opposite = name.replace("az-", "az") if "az-" in name else name.replace("az", "az-")
    assert vectors(opposite)[2] == pytest.approx(view * [1, -1, 1], abs=1e-9)


def test_two_lamps_of_one_instrument_share_its_detectors_out_of_the_plane():
    views = {name: vectors(name)[2] for name in OUT_OF_PLANE}
    for one, other in (("45as25az90", "15as38.3az43"), ("45as60az125.3", "15as46.9az104.5")):
        # Names are rounded to 0.1 degree.
        assert degrees_between(views[one], views[other]) < 0.15


@pytest.mark.parametrize("name", SETS)
def test_no_set_contains_a_direction_twice(name):
    pairs = [directions(geometry) for geometry in SETS[name]]
    assert len(set(pairs)) == len(pairs) >= 3
