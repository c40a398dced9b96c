"""Errors that were measured on other materials."""

import numpy as np
import pytest
from tried_models import FACETS, SLOPES, known

from brdfpipe.errors import BrdfpipeError
from brdfpipe.scenes import experience
from brdfpipe.scenes.error_regression import LEAST
from brdfpipe.scenes.experience import Experience
from brdfpipe.scenes.features import FEATURES
from brdfpipe.scenes.ladders import FULLEST, Candidate


def test_a_candidate_that_was_tried_on_few_materials_has_no_regression():
    assert known(*SLOPES).error(Candidate(optics="wave")) is None
    assert known(*SLOPES[: LEAST - 1]).error(FACETS) is None
    assert known(*SLOPES[:LEAST]).error(FACETS) is not None


def test_errors_below_what_counts_are_equal():
    of_fullest = Experience("gloss", "digest", known(*SLOPES).materials, least_error=0.01).error(FULLEST)
    assert of_fullest is not None
    assert np.exp(of_fullest.logarithms) == pytest.approx(0.01)


def test_a_file_gives_back_what_was_written(tmp_path):
    path, written = tmp_path / "gloss.json", known(*SLOPES)
    written.write(path)
    found = experience.read(path)
    assert found.parameters == written.parameters
    assert [one.name for one in found.materials] == [one.name for one in written.materials]
    before, after = (one.error(FACETS).at([0.1] * len(FEATURES)) for one in (written, found))
    assert after == pytest.approx(before, abs=5e-3)  # numbers have three digits


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "{}",
        '{"metric": "gloss", "scene": "", "least_error": 1, "deviations": 2, "parameters": {}, "materials": '
        '[{"name": "a", "features": {}, "trials": {"x": [1, 2]}}]}',
    ],
)
def test_another_file_is_refused(tmp_path, text):
    path = tmp_path / "gloss.json"
    path.write_text(text)
    with pytest.raises(BrdfpipeError, match="make tradeoff"):
        experience.read(path)
