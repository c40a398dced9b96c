"""Errors that were measured on other materials."""

import pytest
from tried_models import FACETS, ORIGIN, known

from brdfpipe.errors import BrdfpipeError
from brdfpipe.scenes import experience
from brdfpipe.scenes.experience import Experience, Known
from brdfpipe.scenes.ladders import Candidate


def test_the_nearest_materials_come_first_and_distant_ones_not_at_all():
    near = known(2.0, 0.5, 1.0, 9.0).nearest(ORIGIN, FACETS, 2.5)
    assert [round(away, 9) for away, _ in near] == [0.5, 1.0, 2.0]
    assert [trial.error for _, trial in near] == [0.5, 1.0, 2.0]


def test_a_candidate_that_was_not_tried_has_no_neighbours():
    assert known(0.5).nearest(ORIGIN, Candidate(optics="wave"), 2.5) == []


def test_a_file_gives_back_what_was_written(tmp_path):
    path = tmp_path / "gloss.json"
    known(0.5, 1.0).write(path)
    assert experience.read(path) == Experience(
        "gloss",
        "digest",
        tuple(
            Known(one.name, {k: round(v, 4) for k, v in one.features.items()}, one.trials)
            for one in known(0.5, 1.0).materials
        ),
    )


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "{}",
        '{"metric": "gloss", "scene": "", "materials": [{"name": "a", "features": {}, "trials": {"x": [1, 2]}}]}',
    ],
)
def test_another_file_is_refused(tmp_path, text):
    path = tmp_path / "gloss.json"
    path.write_text(text)
    with pytest.raises(BrdfpipeError, match="make tradeoff"):
        experience.read(path)
