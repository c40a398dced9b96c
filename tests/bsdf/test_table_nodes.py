"""Tables whose nodes follow the lobe: the stated error is that of a program that interpolates them linearly."""

from __future__ import annotations

import numpy as np
import pytest
import samples

from brdfpipe import facets
from brdfpipe.bsdf import microfacet, table_nodes
from brdfpipe.bsdf.grids import GRIDS
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.table_error import error_of, errors_at, fresh_pairs


@pytest.fixture(scope="module")
def glossy():
    return samples.beckmann_bsdf(0.1).bsdf.nonspectral()


@pytest.mark.parametrize("layout", ["uniform", "specular"])
def test_the_stated_error_is_found_at_other_directions(glossy, layout):
    choice = table_nodes.choose_nodes(glossy, layout, tolerance=0.02, albedo_tolerance=0.004)
    assert choice.within_tolerance
    assert choice.error.percentile_95 <= 0.02
    assert choice.error.albedo <= 0.004
    read = table_nodes.interpolation(choice.axes, choice.values)
    again = error_of(glossy, read, fresh_pairs(glossy, 77, incidences=24))
    # 95th percentiles of 3000 and 6000 directions of 12 and 24 incidences.
    assert again.percentile_95 <= 1.4 * choice.error.percentile_95


def test_a_smaller_tolerance_needs_more_nodes(glossy):
    coarse, fine = (table_nodes.choose_nodes(glossy, "specular", tolerance=limit) for limit in (0.1, 0.02))
    assert fine.values.size > coarse.values.size
    assert fine.error.percentile_95 < coarse.error.percentile_95


def test_nodes_gather_where_the_lobe_is(glossy):
    axis = table_nodes.choose_nodes(glossy, "specular", tolerance=0.05).axes["theta_s"]
    step = np.diff(axis)
    # The lobe of slope 0.1 has left the mirror direction by 45°.
    assert np.median(step[axis[1:] < 20]) < 0.3 * np.median(step[axis[1:] > 45])


def test_too_few_values_are_said_to_be_too_few(glossy):
    choice = table_nodes.choose_nodes(glossy, "uniform", tolerance=1e-3, largest=500)
    assert choice.values.size <= 500
    assert not choice.within_tolerance
    assert choice.error.percentile_95 > 1e-3


def test_a_perfect_diffuser_needs_three_nodes_of_each_axis():
    white = samples.beckmann_bsdf(0.3, n=1.0000001, reflectance=0.5).bsdf.nonspectral()
    choice = table_nodes.choose_nodes(white, "uniform", tolerance=0.01)
    assert choice.values.size < 200
    assert choice.error.percentile_95 < 0.01


def test_a_surface_that_mirrors_all_its_light_has_the_smallest_table():
    polished = microfacet.build(facets.flat(), index=1.5)
    chosen = table_nodes.choose_nodes(polished)
    assert chosen.within_tolerance
    assert chosen.values.size == table_nodes.smallest_table(polished, "uniform")


def test_a_surface_with_a_lay_has_azimuths_of_incidence():
    brushed = samples.brushed_bsdf(0.3, 0.15).bsdf.nonspectral()
    choice = table_nodes.choose_nodes(brushed, "specular", tolerance=0.1, albedo_tolerance=0.05, largest=400_000)
    assert list(choice.axes) == ["phi_i", "theta_i", "theta_s", "phi_s"]
    read = table_nodes.interpolation(choice.axes, choice.values)
    errors = errors_at(brushed, read, fresh_pairs(brushed, 5))
    assert np.quantile(errors, 0.95) <= 1.4 * choice.error.percentile_95


def test_the_scale_keeps_the_reflectance_and_hides_no_coarse_grid(glossy):
    axes = {"theta_i": np.array([0.0, 40.0, 80.0]), "theta_s": np.linspace(0, 180, 7), "phi_s": np.linspace(0, 180, 7)}
    values = table_nodes.values_on_nodes(representation(glossy).evaluate, GRIDS["specular"], axes, False, True)
    factor = table_nodes.albedo_factor(glossy, values, axes, 0.05)
    assert np.abs(factor - 1).max() == pytest.approx(0.05)


def test_half_of_the_directions_are_where_the_light_goes(glossy):
    pairs = fresh_pairs(glossy, 3)
    away = np.hypot(
        *(
            np.sin(np.radians(pairs.theta_o)) * f(np.radians(pairs.phi_o))
            + np.sin(np.radians(pairs.theta_i)) * f(np.radians(pairs.phi_i))
            for f in (np.cos, np.sin)
        )
    )
    # A lobe of slope 0.1 reaches 0.4 in direction cosines; it holds an eighth of an even spread at most.
    assert (away < 0.4).mean() > 0.2
    assert (away > 0.8).mean() > 0.2


def test_fewer_values_than_a_table_of_a_lay_has_are_refused():
    brushed = samples.brushed_bsdf(0.3, 0.15).bsdf.nonspectral()
    assert table_nodes.smallest_table(brushed, "specular") == 81
    with pytest.raises(ValueError, match="at least 81 values; found 80"):
        table_nodes.choose_nodes(brushed, "specular", largest=80)
    assert table_nodes.choose_nodes(brushed, "specular", largest=81).values.size == 81


def test_the_last_attempt_gives_a_table_whatever_its_error(glossy, monkeypatch):
    monkeypatch.setattr(table_nodes, "_ATTEMPTS", 1)
    choice = table_nodes.choose_nodes(glossy, "specular", tolerance=0.01, largest=10_000_000)
    assert choice.error.percentile_95 > 0
    assert choice.within_tolerance == (choice.error.percentile_95 <= 0.01 and choice.error.albedo <= 0.001)
