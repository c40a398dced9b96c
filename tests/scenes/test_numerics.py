"""Numbers of rays, facets and nodes of a planned model."""

import pytest

from brdfpipe.scenes.numerics import FINE, MOST_OF_TOLERANCE, NUMERICAL_ERROR, NUMERICS, QUICK, numerics_for
from brdfpipe.scenes.scene_keys import METRIC_UNITS


def test_a_scene_has_quick_numerics_only_where_their_error_is_a_small_part_of_its_tolerance():
    least = NUMERICAL_ERROR["gloss"] / MOST_OF_TOLERANCE
    assert numerics_for("gloss", least, lay=False) == (QUICK, NUMERICAL_ERROR["gloss"])
    assert numerics_for("gloss", 0.99 * least, lay=False) == (FINE, 0.0)


def test_surfaces_with_a_lay_have_fine_numerics():
    assert numerics_for("gloss", 1e9, lay=True) == (FINE, 0.0)


@pytest.mark.parametrize("metric", sorted(set(METRIC_UNITS) - set(NUMERICAL_ERROR)))
def test_metrics_whose_numerical_error_was_not_measured_have_fine_numerics(metric):
    assert numerics_for(metric, 1e9, lay=False) == (FINE, 0.0)


def test_quick_numerics_take_less_of_everything():
    quick, fine = NUMERICS[QUICK], NUMERICS[FINE]
    assert quick.rays < fine.rays
    assert all(few < many for few, many in zip(quick.reflection_nodes, fine.reflection_nodes, strict=True))
    assert quick.phase_step > fine.phase_step
