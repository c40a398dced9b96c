"""Names of measuring geometries."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from brdfpipe.errors import BrdfpipeError
from brdfpipe.flakes.geometries import SETS, directions, geometry_name, named_directions


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("45:-30", (45, 0, 30, 180)),
        ("45:0", (45, 0, 0, 0)),
        ("45:65", (45, 0, 65, 0)),
        ("45/20", (45, 0, 20, 0)),
        ("45:\N{MINUS SIGN}30", (45, 0, 30, 180)),
        ("45as15", (45, 0, 30, 180)),
        ("45AS-15", (45, 0, 60, 180)),
        ("r45as110", (45, 0, 65, 0)),
        ("as15", (45, 0, 30, 180)),
        ("as-15", (45, 0, 30, 180)),
        ("15as-15", (15, 0, 30, 180)),
        ("12.5:-12.5", (12.5, 0, 12.5, 180)),
    ],
)
def test_a_name_in_the_plane_of_incidence(name, expected):
    assert directions(name) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("name", "theta_o", "from_mirror"),
    # Both incidences of a portable instrument share its two detectors out of plane: at 50.14 and at 45 degree.
    [
        ("45as25az90", 50.144, 33.403),
        ("45as25az-90", 50.144, -33.403),
        ("15as38.3az43", 50.144, 33.403),
        ("45as60az125.3", 45.0, 90.0),
        ("15as46.9az104.5", 45.0, 90.0),
    ],
)
def test_a_name_out_of_the_plane_turns_about_the_mirror_direction(name, theta_o, from_mirror):
    angles = directions(name)
    # The names round their angles to 0.1 degree.
    assert angles.theta_o == pytest.approx(theta_o, abs=0.1)
    assert (angles.phi_o - 180 + 180) % 360 - 180 == pytest.approx(from_mirror, abs=0.15)


@given(st.floats(0, 80), st.floats(-80, 80))
def test_an_aspecular_name_and_a_view_name_mean_the_same(incidence, view):
    incidence, view = round(incidence, 2), round(view, 2)
    aspecular = incidence + view
    first, second = directions(f"{incidence:.2f}:{view:.2f}"), directions(f"{incidence:.2f}as{aspecular:.2f}")
    assert first == pytest.approx(second) or view == 0


@pytest.mark.parametrize(
    "name", ["45", "", "45:90", "45as200", "95:0", "45;0", "45:1e1", "as\N{MINUS SIGN}15", "x" * 500]
)
def test_an_unknown_geometry_is_refused_with_the_accepted_forms(name):
    with pytest.raises(BrdfpipeError, match="accepted: 45:-30, 45as15"):
        directions(name)


def test_every_set_has_valid_geometries():
    for name in SETS:
        assert len(named_directions(name.lower())) == len(SETS[name])


def test_a_misspelt_set_is_refused_with_the_nearest_name():
    with pytest.raises(BrdfpipeError, match="nearest is MA-T12"):
        named_directions("MAT12")


def test_short_names_with_and_without_a_hyphen_are_refused_together():
    with pytest.raises(
        BrdfpipeError, match=r"'as-15' and 'as15' are ambiguous together.*write 45as-15 for .* 45as15 for"
    ):
        named_directions(["as-15", "as15", "as25"])
    assert len(named_directions(["as-15", "as-45"])) == len(named_directions(["45as-15", "45as15"])) == 2


@pytest.mark.parametrize("name", ["45as-15", "15as80", "45:20", "30:-70.5", "0:45", "45as25az90", "12.5as33az-120.25"])
def test_a_pair_of_directions_has_a_name_that_means_it(name: str) -> None:
    pair = directions(name)
    # Six decimals of an angle.
    assert np.allclose(directions(geometry_name(pair)), pair, atol=5e-6)
    assert geometry_name(pair._replace(phi_i=25.0, phi_o=pair.phi_o + 25)) == geometry_name(pair)


def test_the_name_of_a_pair_is_that_of_a_known_set_where_it_has_one() -> None:
    assert geometry_name(directions("45:-30")) == "45as15"
    assert {geometry_name(directions(name)) for name in SETS["MA-T12"]} == set(SETS["MA-T12"])
