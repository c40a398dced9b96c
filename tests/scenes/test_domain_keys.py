"""What the keys of a domain accept, and what they refuse."""

from __future__ import annotations

from pathlib import Path

import pytest

from brdfpipe.descriptions import reading
from brdfpipe.errors import InputError
from brdfpipe.scenes.domain_keys import DomainKeys


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "domain.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_every_form_of_a_domain_is_read_with_its_defaults(tmp_path):
    text = """
geometries: [{theta_i: 45, theta_o: 0, phi_o: 180}]
cones:
  - {theta_i: [0, 80], half_angle: 5}
  - {theta_i: 30, phi_i: 0, about: {theta_o: 120, phi_o: 180}, half_angle: 2.5}
ranges: [{theta_i: [20, 70], theta_o: [0, 60], phi_o: [90, 270]}]
hemisphere: {}
side: Both
"""
    assert reading.read(written(tmp_path, text), DomainKeys) == {
        "geometries": [{"theta_i": 45, "phi_i": 0, "theta_o": 0, "phi_o": 180}],
        "cones": [
            {"theta_i": [0, 80], "phi_i": [0, 360], "about": "mirror", "half_angle": 5},
            {"theta_i": 30, "phi_i": 0, "about": {"theta_o": 120, "phi_o": 180}, "half_angle": 2.5},
        ],
        "ranges": [{"theta_i": [20, 70], "phi_i": 0, "theta_o": [0, 60], "phi_o": [90, 270]}],
        "hemisphere": {"theta_i": [0, 85], "phi_i": [0, 360]},
        "side": "both",
    }


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("side: both", "the domain is empty: no direction is named; accepted: at least one of `geometries`, `cones`, "),
        ("geometries: []", "line 1, geometries: not an accepted value; found []"),
        ("hemisphere: {theta_i: [60, 30]}", "hemisphere.theta_i: the values do not increase; found [60"),
        ("hemisphere: {theta_i: 90}", "hemisphere.theta_i: not an accepted value; found 90"),
        ("cones: [{theta_i: 10, half_angle: 0}]", "cones.0.half_angle: not an accepted value; found 0"),
        ("cones: [{theta_i: 10, half_angle: 5, about: normal}]", "cones.0.about: not an accepted value"),
        ("ranges: [{theta_i: 10, theta_o: 5, phi_o: [0, 400]}]", "ranges.0.phi_o: more than one turn; found [0"),
        ("hemisphere: {phi_i: [-360, 30]}", "hemisphere.phi_i: more than one turn; found [-360"),
        (
            "geometries: [{theta_i: 10, theta_o: 120, phi_o: 0}]",
            "geometries.0.theta_o: a view on another side of the surface; found 120; accepted: 0 to 90 with `side: reflection`",
        ),
        (
            "side: transmission\ncones: [{theta_i: 10, half_angle: 5, about: {theta_o: 30, phi_o: 0}}]",
            "cones.0.about.theta_o: a view on another side of the surface; found 30; accepted: 90 to 180",
        ),
        ("ranges: [{theta_i: 10, theta_o: [60, 100], phi_o: 0}]", "ranges.0.theta_o: a view on another side"),
    ],
)
def test_a_domain_that_cannot_be_used_is_refused_with_the_key(tmp_path, text, message):
    with pytest.raises(InputError) as refusal:
        reading.read(written(tmp_path, text), DomainKeys)
    assert message in str(refusal.value)
