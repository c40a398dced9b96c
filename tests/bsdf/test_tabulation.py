"""Tables: exact on their nodes, honest about what lies between."""

from __future__ import annotations

import numpy as np
import pytest
import samples

from brdfpipe import vocabulary
from brdfpipe.bsdf import lambert_gauss, tabulation
from brdfpipe.errors import VocabularyError

GRID = {"theta_i": np.arange(0, 81, 10.0), "theta_o": np.arange(0, 86, 5.0), "phi_o": np.arange(0, 361, 10.0)}


@pytest.fixture(scope="module")
def bsdf():
    return samples.beckmann_bsdf(0.25)


@pytest.fixture(scope="module")
def table(bsdf):
    return bsdf.bsdf.nonspectral().bsdf.tabulate(GRID)


def test_a_table_is_the_model_on_its_nodes(bsdf, table):
    model = bsdf.bsdf.nonspectral()
    for direction in ((30, 0, 30, 180), (0, 0, 85, 350), (80, 0, 0, 0)):
        assert float(table.bsdf.evaluate(*direction)) == pytest.approx(
            float(model.bsdf.evaluate(*direction)), rel=1e-12
        )


def test_a_table_only_knows_the_azimuth_between_its_directions(table):
    assert float(table.bsdf.evaluate(30, 40, 30, 220)) == pytest.approx(
        float(table.bsdf.evaluate(30, 0, 30, 180)), rel=1e-12
    )
    assert float(table.bsdf.evaluate(30, 0, 30, -170)) == pytest.approx(
        float(table.bsdf.evaluate(30, 0, 30, 190)), rel=1e-12
    )


def test_half_a_circle_is_mirrored(bsdf):
    half = bsdf.bsdf.nonspectral().bsdf.tabulate({**GRID, "phi_o": np.arange(0, 181, 10.0)})
    assert float(half.bsdf.evaluate(30, 0, 30, 190)) == pytest.approx(
        float(half.bsdf.evaluate(30, 0, 30, 170)), rel=1e-12
    )


def test_a_spectral_bsdf_makes_a_spectral_table(bsdf):
    spectral = bsdf.bsdf.tabulate(GRID)
    assert spectral["brdf"].dims == ("theta_i", "theta_o", "phi_o", "wavelength")
    mean = spectral.bsdf.nonspectral(np.ones(85))
    assert float(mean.bsdf.evaluate(20, 0, 20, 180)) == pytest.approx(
        float(bsdf.bsdf.evaluate(20, 0, 20, 180).mean()), rel=1e-9
    )
    assert spectral.bsdf.evaluate(20, 0, 20, 180, wavelength=552).shape == (1,)


def test_too_coarse_a_grid_is_warned_about_with_its_error():
    narrow = samples.beckmann_bsdf(0.02).bsdf.nonspectral()
    coarse = narrow.bsdf.tabulate(GRID)
    assert "too coarse for the lobe" in vocabulary.warnings(coarse)[0]
    assert abs(coarse["grid_albedo"] / coarse["model_albedo"] - 1).max() > 0.05


@pytest.mark.parametrize("sigma", [0.001, 0.02])
def test_a_refined_grid_holds_a_lobe_that_the_grid_misses(sigma):
    narrow = samples.beckmann_bsdf(sigma, reflectance=0.06).bsdf.nonspectral()
    assert tabulation.verdict_of(narrow.bsdf.tabulate(GRID)) != "pass"
    refined = tabulation.faithful_table(narrow, GRID)
    assert tabulation.verdict_of(refined) == "pass"
    assert vocabulary.warnings(refined) == []
    # The peak itself is on the grid.
    peak = float(narrow.bsdf.evaluate(30, 0, 30, 180))
    assert float(refined.bsdf.evaluate(30, 0, 30, 180)) == pytest.approx(peak, rel=1e-9)


def test_a_grid_that_holds_the_lobe_stays_as_it_is():
    wide = samples.beckmann_bsdf(0.4, reflectance=0.3).bsdf.nonspectral()
    grid = GRID | {"theta_i": np.arange(0, 61, 10.0)}
    assert tabulation.faithful_table(wide, grid).sizes["theta_o"] == GRID["theta_o"].size


def test_a_refined_grid_still_covers_the_full_circle_once():
    narrow = samples.beckmann_bsdf(0.02).bsdf.nonspectral()
    axes = tabulation.refined(narrow, GRID)
    assert (axes["phi_o"][0], axes["phi_o"][-1]) == (0, 360)
    for axis in axes.values():
        assert (np.diff(axis) > 0).all()


def test_a_bsdf_whose_lobe_is_unknown_keeps_the_grid():
    matt = lambert_gauss.lambertian(samples.spectrum(0.5)).bsdf.nonspectral()
    assert tabulation.refined(matt, GRID)["theta_o"].tolist() == GRID["theta_o"].tolist()


def test_black_loses_nothing():
    black = lambert_gauss.lambertian(samples.spectrum(0.0)).bsdf.nonspectral().bsdf.tabulate(GRID)
    assert tabulation.verdict_of(black) == "pass"
    assert vocabulary.warnings(black) == []


def test_a_table_that_makes_light_fails():
    table = samples.beckmann_bsdf(0.001, reflectance=0.06).bsdf.nonspectral().bsdf.tabulate(GRID)
    assert tabulation.verdict_of(table) == "fail"


def test_the_grid_integral_of_a_wide_lobe_is_that_of_the_model(table):
    # Trapezoids of 5° by 10° on a lobe of 30°: 1 % below 60°.
    near = table.sel(theta_i=slice(0, 50))
    assert near["grid_albedo"].values == pytest.approx(near["model_albedo"].values, rel=0.01)


@pytest.mark.parametrize(
    ("axis", "values"), [("theta_i", [0, 95]), ("theta_o", [10, 5]), ("phi_o", [0]), ("phi_o", [[0, 360]])]
)
def test_unusable_axes_are_refused(bsdf, axis, values):
    with pytest.raises(VocabularyError, match=axis):
        bsdf.bsdf.tabulate({**GRID, axis: values})


def test_half_a_circle_of_azimuths_makes_a_full_one():
    assert tabulation.full_circle([0, 90, 170, 180]).tolist() == [0, 90, 170, 180, 190, 270, 360]


@pytest.mark.parametrize("half", [[0, 90], [10, 180], [0, 90, 90, 180], [0], [0, 200]])
def test_azimuths_that_are_no_half_circle_are_refused(half):
    with pytest.raises(VocabularyError, match="phi_o"):
        tabulation.full_circle(half)


def test_a_missing_axis_is_named(bsdf):
    with pytest.raises(VocabularyError, match="the grid needs 'phi_o'"):
        bsdf.bsdf.tabulate({"theta_i": [0, 10], "theta_o": [0, 10]})
