"""The order of the stages that predict a BSDF."""

from __future__ import annotations

from brdfpipe import prediction
from brdfpipe.bsdf.predictions import PREDICTIONS, best_prediction
from brdfpipe.stages import STAGES


def test_every_stage_that_predicts_a_bsdf_is_in_the_order():
    assert set(PREDICTIONS) == {
        name for name, stage in STAGES.items() if stage.kind == "bsdf" and stage.of_prediction and not stage.stands_for
    }


def test_a_prediction_comes_before_those_that_it_starts_from():
    for place, name in enumerate(PREDICTIONS):
        assert not set(prediction.READS[name]) & set(PREDICTIONS[:place]), name


def test_the_best_prediction_is_the_first_in_the_order():
    assert best_prediction({"predicted": 1, "wave": 2, "facets": 3}) == "wave"
    assert best_prediction({"predicted", "reference"}) == "reference"
    assert best_prediction(["facets"]) is None
