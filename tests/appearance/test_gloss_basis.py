"""What a gloss rests on, of a BSDF that was measured."""

from __future__ import annotations

import numpy as np
import pytest
import rig_primary
import samples

from brdfpipe import appearance, vocabulary
from brdfpipe.bsdf.measured import completion, smoothing

WAVELENGTHS = (400.0, 500.0, 600.0, 700.0)


@pytest.fixture(scope="module")
def paint():
    return samples.beckmann_bsdf(0.085, n=1.52)


@pytest.fixture(scope="module")
def seen(paint):
    truth = rig_primary.of_model(paint.bsdf.nonspectral())
    primary = rig_primary.measured(truth, (10.0, 20.0, 30.0, 45.0, 60.0), WAVELENGTHS, noise=0.01)
    return appearance.compute_appearance(completion.complete(smoothing.smooth(primary)))


def test_the_quality_of_gloss_is_that_of_its_mirror_direction(seen):
    flags = [vocabulary.QUALITY_FLAGS[flag] for flag in seen["gloss_quality"].values]
    assert flags[:2] == ["measured", "measured"]
    assert flags[2] not in ("measured", "interpolated")
    (warning,) = (text for text in vocabulary.warnings(seen) if "not measured" in text)
    assert "Gloss at 85° rests on" in warning


def test_its_uncertainty_covers_the_truth_where_it_was_measured_and_where_not(seen, paint):
    truth = appearance.gloss(paint)
    assert (np.abs(seen["gloss"] - truth) < 2 * seen["gloss_u"]).all()
    assert seen["gloss"].values[:2] == pytest.approx(truth.values[:2], rel=0.02)
    assert float(seen["gloss_u"][2]) > 0.5 * float(seen["gloss"][2])


def test_the_uncertainty_of_the_bsdf_is_in_that_of_the_gloss(seen, paint):
    tolerances = appearance.gloss_with_uncertainty(paint)[1]
    assert (seen["gloss_u"][:2] > 0.98 * tolerances[:2]).all()
    assert "BSDF" in seen["gloss_u"].attrs["long_name"]


def test_a_gloss_that_rests_on_a_model_has_no_such_flags(paint):
    computed = appearance.compute_appearance(paint)
    assert "gloss_quality" not in computed
    assert "BSDF" not in computed["gloss_u"].attrs["long_name"]
