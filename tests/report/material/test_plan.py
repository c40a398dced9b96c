"""The section of a page on the model that a scene needs."""

from tried_models import FACETS, ORIGIN, SLOPES, known

from brdfpipe.report.material.plan import choice_words, plan_section
from brdfpipe.scenes.ladders import FULLEST, Candidate
from brdfpipe.scenes.planning import chosen, judge, plan_dataset


def test_a_page_lists_the_candidates_by_cost_and_names_the_chosen_one():
    judged = judge((Candidate(optics="wave"), FULLEST, FACETS), ORIGIN, known(*SLOPES))
    scene = {"scene": "gloss-sheet", "metric": "gloss", "unit": "GU", "tolerance": 1.0}
    (table,) = plan_section({"plan": plan_dataset(judged, chosen(judged, 1.0), ORIGIN, **scene)}).tables
    assert [row[0] for row in table.rows] == ["optics facets", "fullest", "optics wave"]
    assert [row[-1] for row in table.rows] == ["chosen", "", ""]
    assert table.rows[0][1] == "0.3"
    assert float(table.rows[0][2]) >= 0.3
    assert table.rows[1][1:3] == ("0", "0")
    assert table.rows[2][1:4] == ("–", "–", "–")


def test_a_page_without_a_plan_says_nothing_of_it():
    assert plan_section({}).tables == []
    assert choice_words({}) == ""


def test_the_head_of_a_page_says_in_words_what_the_chosen_model_leaves_out():
    judged = judge((FULLEST, FACETS), ORIGIN, known(*SLOPES))
    scene = {"scene": "gloss-sheet", "metric": "gloss", "unit": "GU"}
    cheaper, fullest = (
        choice_words({"plan": plan_dataset(judged, chosen(judged, tolerance), ORIGIN, **scene, tolerance=tolerance)})
        for tolerance in (1.0, 0.01)
    )
    assert "the model leaves out: diffraction, and the coherent light of smooth surfaces" in cheaper
    assert "expected to be 0.3 GU" in cheaper
    assert cheaper.endswith("the scene accepts 1 GU")
    assert fullest == ""
