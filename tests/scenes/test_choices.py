"""What the choices cost: the measurements on small cases, the truths that they are judged by, and the tables."""

from __future__ import annotations

import json
from dataclasses import replace

import choices
import colour_choices
import masking_choices
import numpy as np
import pytest
import relief_maps
import resolution_choices
import rig_choices
import surface_choices
from choice_table import Choice, Metric, Option, summary_of_sources, table
from click.testing import CliRunner

from brdfpipe.bsdf.representations.flake import ClearCoat
from brdfpipe.flakes.geometries import directions


def grids(seconds: float = 2.0, error: float = 0.0123) -> Choice:
    options = [
        Option("coarse", "the lobe", {"rms": error, "gloss": 3.0}, {"build": seconds}, 2000),
        Option("fine", "", {"rms": 0.0, "gloss": 1e-5}, {"build": 4.0}, 8000),
    ]
    return Choice("Grid", "A table.", {"rms": Metric("%", 1e-4), "gloss": Metric("GU")}, "fine", options)


def test_rows_state_errors_and_the_time_over_that_of_the_reference():
    coarse, fine = grids().as_json()["rows"]
    assert coarse["relative_time"] == {"build": 0.5}
    assert coarse["errors"]["rms"] == {"value": 0.0123, "unit": "%", "negligible": 1e-4}
    assert fine["relative_time"] == {"build": 1.0}


def test_the_table_marks_the_reference_and_states_relative_errors_in_percent():
    lines = table(grids().as_json())
    assert lines[0] == "### Grid"
    assert lines[4:] == [
        "| Option | leaves out | rms, % | gloss, GU | build, ms (ratio) | kB |",
        "|---|---|---|---|---|---|",
        "| coarse | the lobe | 1.23 | 3 | 2000 (0.5) | 2 |",
        "| **fine** | – | 0 | 1.0e-05 | 4000 (1) | 8 |",
    ]


def test_the_choice_of_a_source_stands_beside_what_takes_its_place():
    choice = replace(grids(), sources=["coarse"], judged_by="rms").as_json()
    assert summary_of_sources([choice])[2:] == ["| Grid | coarse | fine | rms, % | 1.23 | 0 | build 0.5 |"]
    assert len(summary_of_sources([grids().as_json()])) == 2


def test_the_tables_of_the_page_are_those_of_the_record():
    record, page = json.loads(choices.RECORD.read_text(encoding="utf-8")), choices.PAGE.read_text(encoding="utf-8")
    assert choices.with_tables(page, record) == page
    assert choices.with_tables(page, {**record, "machine": "another"}) != page


def test_a_run_keeps_what_it_does_not_measure_and_names_what_became_worse(tmp_path, monkeypatch):
    record, page = tmp_path / "choices.json", tmp_path / "page.md"
    page.write_text("# Above\n\n<!-- choices -->\n<!-- end -->\n\nBelow\n", encoding="utf-8")

    def run(*only: str) -> str:
        arguments = [part for name in only for part in ("--only", name)]
        result = CliRunner().invoke(choices.main, [*arguments, "--record", str(record), "--page", str(page)])
        assert result.exit_code == 0, result.output
        return page.read_text(encoding="utf-8")

    monkeypatch.setattr(choices, "CHOICES", {"table": grids, "scan": grids})
    assert "There is no measurement before." in run("table", "scan")
    assert "No option became slower" in run("table")
    assert list(json.loads(record.read_text(encoding="utf-8"))["choices"]) == ["table", "scan"]
    monkeypatch.setattr(choices, "CHOICES", {"table": lambda: grids(3.1, 0.02), "scan": grids})
    text = run("table", "scan")
    assert "- Grid, coarse: build takes 0.775 times its reference, before 0.5 times" in text
    assert "- Grid, coarse: rms is 0.02, before 0.0123" in text
    assert text.startswith("# Above\n")
    assert text.endswith("\n\nBelow\n")


def test_the_page_shows_the_measurement_that_is_kept():
    record = json.loads(choices.RECORD.read_text(encoding="utf-8"))
    page = choices.PAGE.read_text(encoding="utf-8")
    assert list(record["choices"]) == list(choices.CHOICES)
    assert choices.with_tables(page, record) == page, "run `python benchmarks/choices.py`"


# --- truths


def test_the_light_of_a_paint_is_the_same_in_both_directions():
    names = ("45as25", "45as110", "60as35", "45as30az90")
    for name in names:
        theta_i, phi_i, theta_o, phi_o = directions(name)
        there, back = (
            colour_choices._passed(*pair)
            for pair in ((theta_i, phi_i, theta_o, phi_o), (theta_o, phi_o, theta_i, phi_i))
        )
        assert there[:2] == pytest.approx(back[:2], rel=1e-12)


def test_what_a_coat_lets_pass_is_that_of_polarised_light():
    coat = ClearCoat(colour_choices.INDEX, True, None)
    for name in ("45as25", "15as45", "60as35", "45as30az90"):
        at = directions(name)
        mirrored, _, cos_i, cos_o = colour_choices._passed(*at)
        expected = coat.share(*(np.array([angle]) for angle in at))[0] * coat.normal_transmittance**2
        assert mirrored / (cos_i * cos_o) == pytest.approx(expected, rel=1e-9)


def test_slopes_of_a_line_have_the_distribution_that_they_are_compared_with():
    from scipy.stats import norm, t

    width = surface_choices._WIDTH
    # One component of GGX slopes is Student's t of two degrees of freedom; about 10⁴ slopes are independent.
    for kind, expected in (("beckmann", norm(scale=width / np.sqrt(2))), ("ggx", t(2, scale=width / np.sqrt(2)))):
        slopes = np.diff(surface_choices._line(kind))
        for share in (0.6, 0.75, 0.9):
            assert np.quantile(slopes, share) == pytest.approx(expected.ppf(share), rel=0.1)


# --- measurements

CHEAP = {"diffuse", "spectrum", "albedo"}


@pytest.fixture
def small(monkeypatch):
    """Small maps, few rays, colours and wavelengths."""
    for module, name, value in (
        (colour_choices, "COLOURS", 3),
        (colour_choices, "DRAWS", 1),
        (colour_choices, "PAINTS", {"silver": colour_choices.PAINTS["silver"]}),
        (surface_choices, "MAPS", {"slope 0.3": relief_maps.gaussian(0.3, 128, 0, length=5.0)}),
        (surface_choices, "EVALUATED", 1000),
        (surface_choices, "LINE", 2**14),
        (surface_choices, "_LINES", 1),
        (masking_choices, "MAPS", {"slope 0.3": relief_maps.gaussian(0.3, 128, 0, length=5.0)}),
        (masking_choices, "REFERENCE_RAYS", 20_000),
        (masking_choices, "RAYS", 2_000),
        (rig_choices, "WAVELENGTHS", np.array([550.0])),
        (resolution_choices, "_PLACES", 1),
    ):
        monkeypatch.setattr(module, name, value)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name in CHEAP else pytest.mark.slow) for name in choices.CHOICES]
)
@pytest.mark.usefixtures("small")
def test_every_choice_is_measured(name):
    measured = choices.CHOICES[name]()
    names = [option.name for option in measured.options]
    assert {measured.reference, measured.ours or measured.reference, *measured.sources} <= set(names)
    assert not measured.sources or measured.judged_by in measured.metrics
    for option in measured.options:
        assert set(option.errors) == set(measured.metrics)
        assert np.isfinite([*option.errors.values()]).all()
        assert min(option.errors.values()) >= 0
        assert min(option.seconds.values()) > 0
    assert any(option.leaves_out for option in measured.options) or name == "albedo"
    assert table(measured.as_json())
