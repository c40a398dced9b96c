"""Numbers of rays, facets and nodes of a planned model."""

import pytest

from brdfpipe.scenes.numerics import FEWER_LAY_NODES, FINE, MOST_OF_TOLERANCE, NUMERICS, QUICK, USES, numerics_for
from brdfpipe.scenes.scene_keys import METRIC_UNITS

LAYS = {"lay": True, "no lay": False}
USED = [(lay, metric) for lay, uses in USES.items() for metric in uses]


@pytest.mark.parametrize(("lay", "metric"), USED)
def test_a_scene_has_fewer_numbers_only_where_their_error_is_a_small_part_of_its_tolerance(lay, metric):
    use = USES[lay][metric]
    least = use.error / MOST_OF_TOLERANCE
    assert numerics_for(metric, least, LAYS[lay]) == use
    assert numerics_for(metric, 0.99 * least, LAYS[lay]) == (FINE, 0.0)


@pytest.mark.parametrize(
    ("lay", "metric"), [(lay, metric) for lay in LAYS for metric in METRIC_UNITS if (lay, metric) not in USED]
)
def test_metrics_whose_numerical_error_was_not_measured_or_is_large_have_fine_numerics(lay, metric):
    assert numerics_for(metric, 1e9, LAYS[lay]) == (FINE, 0.0)


def test_quick_numerics_take_less_of_everything_that_a_surface_without_a_lay_has():
    quick, fine = NUMERICS[QUICK], NUMERICS[FINE]
    assert quick.rays < fine.rays
    assert all(few < many for few, many in zip(quick.reflection_nodes, fine.reflection_nodes, strict=True))
    assert quick.phase_step > fine.phase_step


def test_fewer_nodes_of_a_lay_are_all_that_differs():
    fewer, fine = NUMERICS[FEWER_LAY_NODES], NUMERICS[FINE]
    assert all(few <= many for few, many in zip(fewer.lay_energy_nodes, fine.lay_energy_nodes, strict=True))
    assert fewer.lay_energy_nodes != fine.lay_energy_nodes
    assert fewer.rays == fine.rays
