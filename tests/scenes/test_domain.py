"""Directions of a domain: all inside, of the right density, repeatable and extensible."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from brdfpipe.descriptions import reading
from brdfpipe.errors import BrdfpipeError
from brdfpipe.geometry import unit_vector
from brdfpipe.scenes.domain import Domain
from brdfpipe.scenes.domain_keys import DomainKeys
from brdfpipe.scenes.projected_cone import within_cone

ALL_AROUND = [0, 360]
EVERY_PART = {
    "geometries": [
        {"theta_i": 45, "phi_i": 0, "theta_o": 0, "phi_o": 180},
        {"theta_i": 15, "phi_i": 9, "theta_o": 3, "phi_o": 4},
    ],
    "cones": [
        {"theta_i": [0, 88], "phi_i": ALL_AROUND, "about": "mirror", "half_angle": 5},
        {"theta_i": 30, "phi_i": [-20, 20], "about": {"theta_o": 85, "phi_o": 180}, "half_angle": 20},
        {"theta_i": 30, "phi_i": 0, "about": {"theta_o": 95, "phi_o": 180}, "half_angle": 20},
    ],
    "ranges": [{"theta_i": [20, 70], "phi_i": 0, "theta_o": [60, 130], "phi_o": [300, 400]}],
    "hemisphere": {"theta_i": [0, 85], "phi_i": ALL_AROUND},
    "side": "both",
}


def cone_at(theta_o: float, half_angle: float) -> Domain:
    """Views about a fixed direction."""
    axis = {"theta_o": theta_o, "phi_o": 40}
    return Domain({"cones": [{"theta_i": 10, "phi_i": 0, "about": axis, "half_angle": half_angle}], "side": "both"})


def cone_moments(theta: float, half_angle: float) -> tuple[float, float]:
    """∫ cos θ dω and ∫ cos² θ dω over a cone above the horizon, along its rings: an integral in one variable each.

    On a ring of radius r the cosine is p + q cos t, with p = cos r cos θ and q = sin r sin θ; it is positive up to t = arccos(−p / q).
    """
    theta, half = np.radians([theta, half_angle])

    def ring(r: float, power: int) -> float:
        p, q = np.cos(r) * np.cos(theta), np.sin(r) * np.sin(theta)
        t = np.pi if p >= q else np.arccos(np.clip(-p / q, -1, 1))
        if power == 1:
            return np.sin(r) * 2 * (p * t + q * np.sin(t))
        return np.sin(r) * 2 * (p * p * t + 2 * p * q * np.sin(t) + q * q * (t / 2 + np.sin(2 * t) / 4))

    edge = [np.pi / 2 - theta] if half > np.pi / 2 - theta > 0 else None
    first, second = (quad(ring, 0, half, args=(power,), points=edge, epsabs=0, epsrel=1e-10)[0] for power in (1, 2))
    return first, second


@pytest.mark.parametrize("seed", [0, 1])
def test_every_direction_of_every_part_is_inside(seed):
    domain = Domain(EVERY_PART)
    pairs = domain.directions(4096, seed)
    assert domain.contains(*pairs.angles).all()
    assert pairs.theta_i.max() < 90
    assert pairs.theta_o.max() <= 180
    assert pairs.weight.sum() == pytest.approx(1, abs=1e-12)
    for part in domain.parts:  # each has its turn
        assert part.contains(*pairs.angles).sum() >= 4096 // len(domain.parts)


@given(
    theta=st.floats(0, 90),
    half=st.floats(-5, np.log10(90)).map(lambda exponent: min(10**exponent, 90.0)),
    u=st.floats(0, 1),
    v=st.floats(0, 1),
)
def test_directions_are_within_the_cone_and_above_the_horizon(theta, half, u, v):
    polar, azimuth = within_cone(theta, half, u, v)
    assert 0 <= polar <= 90
    chord = np.linalg.norm(unit_vector(polar, azimuth) - unit_vector(theta, 0))
    # Degrees near 90 and the sines of both directions are rounded to about 1e-15 and 1e-14 degree.
    assert np.degrees(2 * np.arcsin(min(chord / 2, 1))) <= half + 1e-12


@pytest.mark.parametrize(
    ("theta", "half_angle"),
    [
        (0, 1),
        (0, 90),
        (30, 10),
        (60, 30),
        (80, 10),
        (80, 10.001),
        (85, 20),
        (70, 60),
        (90, 30),
        (89.99, 0.05),
        (45, 90),
        (90, 90),
        (20, 70),
    ],
)
def test_moments_of_the_cosine_in_a_cone_are_those_of_projected_solid_angle(theta, half_angle):
    first, second = cone_moments(theta, half_angle)
    pairs = cone_at(theta, half_angle).directions(2**14, seed=3)
    # 2^14 Sobol' points integrate a smooth function of two variables to about 1e-6 and better.
    assert np.cos(np.radians(pairs.theta_o)).mean() == pytest.approx(second / first, rel=1e-4)
    if theta + half_angle <= 90:  # not cut: the centre of the ellipse
        mean = (np.sin(np.radians(pairs.theta_o)) * np.cos(np.radians(pairs.phi_o - 40))).mean()
        assert mean == pytest.approx(np.sin(np.radians(theta)) * np.cos(np.radians(half_angle)), abs=1e-5)


def test_closed_forms_of_the_mean_cosine():
    domain = Domain({"hemisphere": {"theta_i": 10, "phi_i": 0}})
    assert np.cos(np.radians(domain.directions(2**13, 1).theta_o)).mean() == pytest.approx(2 / 3, rel=1e-4)
    half = np.radians(12)
    about_the_normal = np.cos(np.radians(cone_at(0, 12).directions(2**13, 1).theta_o)).mean()
    assert about_the_normal == pytest.approx(
        2 * (1 - np.cos(half) ** 3) / (3 * np.sin(half) ** 2), abs=1e-5
    )  # spread: 0.02
    # Half a cone about the horizon: ∫cos²θ dω = π (2 − 3 cos h + cos³ h) / 6, and ∫cosθ dω = h − sin h cos h.
    at_the_horizon = np.cos(np.radians(cone_at(90, 12).directions(2**13, 1).theta_o)).mean()
    square = np.pi * (2 - 3 * np.cos(half) + np.cos(half) ** 3) / 6
    assert at_the_horizon == pytest.approx(square / (half - np.sin(half) * np.cos(half)), rel=1e-4)


def test_cones_on_the_transmission_side_mirror_those_above():
    above, below = cone_at(75, 30).directions(512, 5), cone_at(105, 30).directions(512, 5)
    np.testing.assert_allclose(below.theta_o, 180 - above.theta_o, atol=1e-10)
    np.testing.assert_array_equal(below.phi_o, above.phi_o)
    straight = Domain(
        {"cones": [{"theta_i": 40, "phi_i": 0, "about": "mirror", "half_angle": 1}], "side": "transmission"}
    )
    assert straight.contains(40, 0, 140, 180)
    assert not straight.contains(40, 0, 40, 180)


def test_ranges_are_even_in_incidence_and_in_the_projected_solid_angle_of_views():
    limits = {"theta_i": [20, 70], "phi_i": [0, 90], "theta_o": [30, 120], "phi_o": [350, 370]}
    pairs = Domain({"ranges": [limits], "side": "both"}).directions(2**13, seed=2)
    assert pairs.theta_i.mean() == pytest.approx(45, abs=0.01)
    assert pairs.theta_i.std() == pytest.approx(50 / np.sqrt(12), rel=1e-3)
    assert pairs.phi_i.mean() == pytest.approx(45, abs=0.01)
    # ∫|cos θ| sin θ dθ is 3/8 from 30° to 90°, and 1/8 from 90° to 120°; the mean of cos² θ above is 3/8.
    assert (pairs.theta_o > 90).mean() == pytest.approx(1 / 4, abs=1e-3)
    above = pairs.theta_o[pairs.theta_o < 90]
    assert (np.cos(np.radians(above)) ** 2).mean() == pytest.approx(3 / 8, rel=1e-3)
    assert ((pairs.phi_o >= 350) | (pairs.phi_o <= 10)).all()


def test_the_same_seed_gives_the_same_directions_and_more_extend_fewer():
    domain = Domain(EVERY_PART)
    fewer, more, again = domain.directions(100, 4), domain.directions(200, 4), domain.directions(100, 4)
    np.testing.assert_array_equal(fewer, again)
    np.testing.assert_array_equal(np.stack(fewer.angles), np.stack(more.angles)[:, : fewer.weight.size])
    assert not np.array_equal(fewer.angles[2], domain.directions(100, 5).angles[2])


def test_single_geometries_are_as_they_are():
    domain = Domain({"geometries": EVERY_PART["geometries"]})
    pairs = domain.directions(1000, 1)
    np.testing.assert_array_equal(np.stack(pairs.angles), [[45, 15], [0, 9], [0, 3], [180, 4]])
    np.testing.assert_array_equal(pairs.weight, 0.5)
    assert domain.contains(45, 360, 0, 12)  # at the normal every azimuth is the same direction
    assert not domain.contains(45, 1, 0, 0)


def test_directions_outside_are_recognised():
    cone = Domain({"cones": [{"theta_i": [10, 20], "phi_i": [350, 370], "about": "mirror", "half_angle": 5}]})
    assert cone.contains(15, 5, 15, 185)
    assert cone.contains([15, 15], -5, [19.9, 20.1], 175).tolist() == [True, False]
    assert not cone.contains(25, 0, 25, 180)
    assert not cone.contains(15, 20, 15, 200)
    grazing = Domain({"cones": [{"theta_i": 88, "phi_i": 0, "about": "mirror", "half_angle": 5}]})
    assert grazing.contains(88, 0, [89, 91], 180).tolist() == [True, False]


def test_a_domain_says_what_it_is(tmp_path: Path):
    path = tmp_path / "domain.yaml"
    path.write_text(
        "geometries: [{theta_i: 45, theta_o: 0, phi_o: 0}]\ncones: [{theta_i: [0, 80], half_angle: 5}]\nhemisphere: {phi_i: 0}"
    )
    assert Domain(reading.read(path, DomainKeys)).description() == (
        "geometries 45°, 0° → 0°, 0°; incidence 0° to 80°, all azimuths: views within 5° of the mirror direction; "
        "incidence 0° to 85°, azimuth 0°: all views in reflection"
    )
    assert "views 60° to 130°, azimuth 300° to 400°" in Domain(EVERY_PART).description()


@pytest.mark.parametrize(
    ("content", "message"), [({}, "the domain is empty"), ({"geometries": []}, "the domain is empty")]
)
def test_an_empty_domain_is_refused(content, message):
    with pytest.raises(BrdfpipeError, match=message):
        Domain(content)


@pytest.mark.parametrize("n", [0, 1.5, True, -3])
def test_too_few_directions_are_refused(n):
    with pytest.raises(BrdfpipeError, match="number of directions is"):
        Domain({"hemisphere": {"theta_i": 10, "phi_i": 0}}).directions(n, 0)


@pytest.mark.parametrize(
    ("content", "incidences", "transmits"),
    [
        ({"geometries": [{"theta_i": 45, "phi_i": 0, "theta_o": 0, "phi_o": 0}] * 2}, [[45, 45]], False),
        ({"geometries": [{"theta_i": 8, "phi_i": 0, "theta_o": 172, "phi_o": 0}]}, [[8, 8]], True),
        ({"hemisphere": {"theta_i": [0, 85], "phi_i": [0, 360]}, "side": "both"}, [[0, 85]], True),
        ({"ranges": [{"theta_i": 20, "phi_i": 0, "theta_o": [60, 120], "phi_o": 180}]}, [[20, 20]], True),
    ],
)
def test_a_domain_knows_its_incidences_and_whether_it_transmits(content, incidences, transmits):
    domain = Domain(content)
    assert (domain.incidences, domain.transmits) == (incidences, transmits)
