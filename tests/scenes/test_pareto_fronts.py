"""Fronts of error against time, and the pages that they are written into."""

from __future__ import annotations

import json

import pytest
from pareto_fronts import PAGE, RECORD, example_inputs, front, record, with_tables
from tradeoff import planned_scenes

from brdfpipe.descriptions.rendering import with_section
from brdfpipe.scenes import experience
from brdfpipe.scenes.features import features
from brdfpipe.scenes.ladders import FULLEST, Candidate
from brdfpipe.scenes.planning import chosen, judge
from brdfpipe.scenes.scene import load_scene


def test_no_model_of_a_front_is_beaten_in_both_error_and_time():
    points = {
        "a": (9.0, 0.1),
        "worse and dearer": (9.5, 0.2),
        "b": (3.0, 0.5),
        "as good, dearer": (3.0, 0.6),
        "c": (0.0, 2.0),
    }
    assert front(points) == ["a", "b", "c"]


def test_a_dearer_model_without_a_smaller_error_is_not_on_a_front():
    assert front({"fullest": (0.0, 1.0), "the same, dearer": (0.0, 1.5)}) == ["fullest"]
    assert front({}) == []


def test_the_record_has_relative_times_and_what_is_on_the_front():
    cheap = Candidate(optics="facets")
    rows = {
        candidate.key: {"cost": cost, "relative_time": cost / 2, "bytes": 10, "errors": {"gloss-sheet": error}}
        for candidate, cost, error in ((cheap, 1.0, 0.5), (FULLEST, 2.0, 0.0))
    }
    found = record({"plate": rows}, [load_scene("gloss-sheet")])
    assert [row["choice"] for row in found] == ["gloss-sheet, plate"] * 2
    assert [row["relative_time"]["build"] for row in found] == [0.5, 1.0]
    assert [row["on_front"] for row in found] == [True, True]
    assert found[0]["errors"]["gloss"] == {"value": 0.5, "negligible": pytest.approx(0.01)}


def test_the_tables_of_the_page_are_those_of_the_record():
    rows = json.loads(RECORD.read_text())
    page = PAGE.read_text()
    assert with_tables(page, rows) == page
    assert with_tables(page, [{**row, "seconds": 2 * row["seconds"]} for row in rows]) != page


def test_only_the_named_section_of_a_page_is_replaced():
    page = "a\n<!-- one -->\nold\n<!-- end -->\nb\n<!-- two -->\nkept\n<!-- end -->\n"
    assert with_section(page, "one", "new \\1") == page.replace("old", "new \\1")
    with pytest.raises(ValueError, match="three"):
        with_section(page, "three", "")


BEYOND_ITS_MARGIN = ("luminaire-raytrace", "pp-moulding")
"""A known miss: facets alone err by 0.091 where the margin is 0.063, and lines like it by 0.03 to 0.05; docs/tradeoff.md says so."""


@pytest.mark.slow  # tests/scenes/test_features.py has a cheap one: the light that set the error of an example apart
def test_the_choices_for_the_examples_hold_and_err_by_less_than_their_margins_but_for_one(tmp_path):
    errors = {
        (row["choice"], row["option"]): next(iter(row["errors"].values()))["value"]
        for row in json.loads(RECORD.read_text())
    }
    over, missed, cheaper = [], [], 0
    for name, inputs in example_inputs(tmp_path / "results"):
        found = features(inputs)
        for scene in planned_scenes():
            known = experience.read(scene.experience_file)
            choice = chosen(judge(inputs.structures, found, known), scene.content["tolerance"])
            error = errors[f"{scene.name}, {name}", str(choice.candidate)]
            cheaper += choice.candidate != FULLEST
            if error > scene.content["tolerance"]:
                missed.append((scene.name, name, str(choice.candidate), error))
            if error > max(choice.bound, known.least_error) and choice.candidate != FULLEST:
                over.append((scene.name, name))
    assert missed == []
    assert over == [BEYOND_ITS_MARGIN]
    assert cheaper > 10
