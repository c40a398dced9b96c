"""What was never measured does not look like data."""

from __future__ import annotations

import re

import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st
from samples import beckmann_bsdf

from brdfpipe import flakes
from brdfpipe.bsdf import flake
from brdfpipe.geometry import Array
from brdfpipe.report.plots import bsdf_cuts, bsdf_sections, directional_maps, measurement_coverage, reflectance
from brdfpipe.report.plots.bsdf_sections import Plane
from brdfpipe.report.plots.svg import Line

_NORMAL = Plane(0.0, "")


def _dashed(svg: str) -> int:
    return len(re.findall(r'<path class="l c\d d"', svg))


@given(st.lists(st.booleans(), min_size=2, max_size=30))
def test_the_parts_of_a_split_curve_meet_and_only_the_known_one_is_solid(known_points: list[bool]) -> None:
    value = np.arange(1.0, len(known_points) + 1)
    solid, dashed = measurement_coverage.split(Line(value, value, "c0"), np.array(known_points))
    known, rest = (np.isfinite(np.asarray(line.y)) for line in (solid, dashed))
    assert known.tolist() == known_points
    # Every stretch between neighbours belongs to one of them.
    assert ((known[1:] & known[:-1]) | (rest[1:] & rest[:-1])).all()
    assert (solid.pattern, dashed.pattern) == ("line", "dash")


def test_incidences_that_were_not_measured_are_dashed_and_named(on_rig: xr.Dataset) -> None:
    goniometric, cartesian, *_ = bsdf_cuts.cuts(on_rig)
    for figure in (goniometric, cartesian):
        assert [(shape, label) for shape, _, label in figure.legend] == [
            ("dash", "incidence 0° (completed)"),
            ("line", "30°"),
            ("line", "45° (interpolated)"),
            ("line", "60°"),
            ("dash", "75° (completed)"),
        ]
        assert "in the mirror direction below 10° and beyond 60° of incidence" in figure.note
        assert _dashed(figure.svg) >= 2
    assert goniometric.svg.count('class="s ') == 5


def test_the_uncertainty_in_the_note_is_that_of_the_bsdf(on_rig: xr.Dataset) -> None:
    asked = (75.0, 0.0, 75.0, 180.0, 550.0)
    value, u = (float(method(*asked).values.item()) for method in (on_rig.bsdf.evaluate, on_rig.bsdf.uncertainty))
    stated = re.search(r"([\d.]+)\u202f% at 75°", measurement_coverage.words(on_rig, _NORMAL, (30.0, 75.0)))
    assert stated is not None
    assert float(stated[1]) == (100.0 if u > value else pytest.approx(100 * u / value, rel=0.05))
    assert "at 30°" not in stated.string


def test_a_model_has_neither_dashes_nor_words() -> None:
    bsdf = beckmann_bsdf()
    assert measurement_coverage.words(bsdf, _NORMAL, (75.0,)) == ""
    for figure in [*bsdf_cuts.cuts(bsdf), *directional_maps.directional_maps(bsdf)]:
        assert "measured" not in figure.note
        assert {shape for shape, *_ in figure.legend} <= {"line"}
    assert "measured" not in reflectance.shares(None, bsdf)[0].note


def test_the_reflectance_is_dashed_beyond_the_incidences_that_were_measured(on_rig: xr.Dataset) -> None:
    (figure,) = reflectance.shares(None, on_rig)
    assert [(shape, label) for shape, _, label in figure.legend] == [("line", "total"), ("dash", "total (completed)")]
    (solid,) = re.findall(r'<path class="l c0" d="([^"]*)"', figure.svg)
    across = np.array([float(x) for x in re.findall(r"[ML]([-\d.]+) ", solid)]) * 90 / 450
    assert across.min() == pytest.approx(10, abs=1)
    assert across.max() == pytest.approx(60, abs=1)
    assert "standard uncertainty of the reflectance there: at most" in figure.note


def test_the_bound_of_the_reflectance_is_the_uncertainty_of_all_directions_together(on_rig: xr.Dataset) -> None:
    sine, turn = np.meshgrid(np.sqrt((np.arange(60) + 0.5) / 60), 3.0 + 6 * np.arange(60))
    theta = np.degrees(np.arcsin(sine))

    def mean(function: object) -> float:
        values: Array = on_rig.bsdf.__getattribute__(str(function))(45.0, 0.0, theta, turn, 550.0).values
        return float(values.mean())

    bound = measurement_coverage._reflectance_uncertainty(on_rig, _NORMAL, 45.0)
    assert bound == pytest.approx(mean("uncertainty") / mean("evaluate"), rel=0.05)


def test_directions_that_were_not_measured_are_counted_on_a_map(on_rig: xr.Dataset) -> None:
    (figure,) = directional_maps.directional_maps(on_rig)
    share = re.search(r"([\d.]+)\u202f% of the disc is outside the measured directions", figure.note)
    assert share is not None
    sine, turn = np.meshgrid(np.sqrt((np.arange(80) + 0.5) / 80), 1.5 + 3 * np.arange(120))
    flags = measurement_coverage.quality(on_rig, _NORMAL, 45.0, np.degrees(np.arcsin(sine)), turn)
    assert float(share[1]) == pytest.approx(100 * (1 - measurement_coverage.known(flags).mean()), abs=1.5)


def test_flakes_without_a_measured_gloss_have_the_same_note() -> None:
    listed = [{"geometry": name, "lab": [30.0, -5.0, -20.0]} for name in ("45as15", "45as45", "45as110")]
    measured = flakes.ingest({"colours": listed, "illuminant": "D65", "observer": 10})
    bsdf = flake.build(measured)
    words = measurement_coverage.words(bsdf, bsdf_sections.planes(bsdf)[0], (45.0,))
    assert words == " Nothing was measured in the mirror direction at any incidence."
