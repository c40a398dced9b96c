"""Geometries of instruments that are in the domain of a scene."""

from __future__ import annotations

from typing import Any

import pytest

from brdfpipe.scenes.domain import Domain
from brdfpipe.scenes.geometries import colour_geometries, gloss_angles, haze_windows

ALL_AROUND = [0, 360]
STANDARD = ["45as15", "45as45", "45as110", "45:0"]


def cone(theta_i: Any, half_angle: float = 3, about: Any = "mirror") -> dict[str, Any]:
    return {"theta_i": theta_i, "phi_i": ALL_AROUND, "about": about, "half_angle": half_angle}


@pytest.mark.parametrize(
    ("content", "angles"),
    [
        ({"hemisphere": {"theta_i": [0, 85], "phi_i": ALL_AROUND}}, [20, 60, 85]),
        ({"hemisphere": {"theta_i": [0, 70], "phi_i": ALL_AROUND}}, [20, 60]),
        ({"cones": [cone(60)]}, [60]),
        ({"cones": [cone([10, 65])]}, [20, 60]),
        ({"cones": [cone(60)], "side": "transmission"}, []),
        ({"cones": [cone([0, 80], 5, {"theta_o": 22, "phi_o": 180})]}, [20]),
        ({"geometries": [{"theta_i": 20, "phi_i": 30, "theta_o": 20, "phi_o": 210}]}, [20]),
        ({"geometries": [{"theta_i": 20, "phi_i": 30, "theta_o": 20, "phi_o": 30}]}, []),
        ({"ranges": [{"theta_i": [50, 70], "phi_i": 90, "theta_o": [0, 80], "phi_o": [260, 280]}]}, [60]),
        ({"ranges": [{"theta_i": [50, 70], "phi_i": 90, "theta_o": [0, 80], "phi_o": [0, 180]}]}, []),
    ],
)
def test_a_gloss_angle_counts_where_its_mirror_direction_is_in_the_domain(
    content: dict[str, Any], angles: list[int]
) -> None:
    assert gloss_angles(Domain(content), [20, 60, 85]) == angles
    windows = [{"angle": 20, "offset": 1.9, "aperture": [1.8, 3.6]}]
    assert haze_windows(Domain(content), windows) == (windows if 20 in angles else [])


def test_colours_are_at_the_listed_pairs_and_the_standard_ones_in_the_domain() -> None:
    listed = [
        {"theta_i": 45, "phi_i": 0, "theta_o": 20, "phi_o": 180},
        {"theta_i": 45, "phi_i": 10, "theta_o": 0, "phi_o": 77},  # along the normal, at any azimuth
        {"theta_i": 30, "phi_i": 0, "theta_o": 10, "phi_o": 0},
        {"theta_i": 30, "phi_i": 0, "theta_o": 150, "phi_o": 180},
    ]
    domain = Domain({"geometries": listed, "side": "both"})
    assert colour_geometries(domain, STANDARD) == ["45as45", "45as25", "30:10"]
    everywhere = Domain({"hemisphere": {"theta_i": [0, 85], "phi_i": ALL_AROUND}})
    assert colour_geometries(everywhere, STANDARD) == ["45as15", "45as45", "45as110"]
    assert colour_geometries(everywhere, [*STANDARD, "MA-T6"])[3:] == ["45as-15", "45as25", "45as75"]
    assert colour_geometries(Domain({"cones": [cone(20)]}), STANDARD) == []
