"""Tables: exact on their nodes, with a stated error between them."""

from __future__ import annotations

import numpy as np
import pytest
import rig_primary
import samples

from brdfpipe import facets, optics, vocabulary
from brdfpipe.bsdf import kirchhoff, lambert_gauss, microfacet, tabulation, traced
from brdfpipe.bsdf.input_uncertainty import uncertainty
from brdfpipe.bsdf.measured import completion, smoothing
from brdfpipe.bsdf.registry import REPRESENTATIONS, representation
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


def test_a_table_has_the_uncertainty_of_each_of_its_values():
    bsdf = samples.beckmann_bsdf(0.25)
    changes = uncertainty(bsdf, index=optics.refractive_index(1.5, uncertainty=0.01), spectrum=samples.spectrum(0.3))
    model = (
        bsdf.merge(changes, combine_attrs="override").assign_attrs(uncertainty_not_stated="facets").bsdf.nonspectral()
    )
    assert "brdf_u" not in bsdf.bsdf.nonspectral().bsdf.tabulate(GRID)
    table = model.bsdf.tabulate(GRID)
    assert table.attrs["uncertainty_not_stated"] == "facets"
    u = table["brdf_u"].sel(theta_i=30, phi_o=180, method="nearest")
    wanted = model.bsdf.uncertainty(float(u["theta_i"]), 0, u["theta_o"].values, float(u["phi_o"])).values
    np.testing.assert_allclose(u, wanted, rtol=1e-3)


def _traced():
    return traced.build(samples.gaussian_surface(64), index=1.5, spectrum=_coloured(), rays=640)


def _kirchhoff():
    return kirchhoff.build(samples.gaussian_surface(64, sigma=0.02), index=1.5, spectrum=_coloured())


def _measured():
    truth = rig_primary.of_model(samples.beckmann_bsdf(0.1, n=1.5).bsdf.nonspectral())
    return completion.complete(smoothing.smooth(rig_primary.measured(truth, (10.0, 30.0), (500.0, 600.0), noise=0.01)))


def _coloured():
    return samples.spectrum(np.linspace(0.1, 0.5, samples.WAVELENGTH.size))


UNCERTAIN = {"kirchhoff": _kirchhoff, "rig": _measured, "traced": _traced}


def test_every_representation_that_states_an_uncertainty_is_tabulated_here():
    assert set(UNCERTAIN) == {name for name, one in REPRESENTATIONS.items() if one.states_uncertainty}


@pytest.mark.parametrize("name", UNCERTAIN)
def test_a_spectral_table_has_the_uncertainty_of_each_of_its_values(name):
    # The index is that of all wavelengths, so the uncertainty of traced light does not depend on wavelength, and the diffuse part does.
    bsdf = UNCERTAIN[name]()
    table = bsdf.bsdf.tabulate({"theta_i": [0, 20], "theta_o": np.arange(0, 86, 17.0), "phi_o": [0, 120, 240, 360]})
    assert table.sizes["wavelength"] == bsdf.sizes["wavelength"] > 1
    assert table["brdf_u"].dims == table["brdf"].dims
    for phi_o in (
        120.0,
        240.0,
    ):  # on both sides of the plane of incidence, of which a table of symmetric ones evaluates one
        at = table.sel(theta_i=20, phi_o=phi_o)
        wanted = bsdf.bsdf.uncertainty(20, 0, at["theta_o"].values, phi_o).values
        assert (wanted > 0).any()
        np.testing.assert_allclose(at["brdf_u"], wanted, rtol=1e-3)
        np.testing.assert_allclose(at["brdf"], bsdf.bsdf.evaluate(20, 0, at["theta_o"].values, phi_o), rtol=1e-9)


def test_a_table_depends_on_the_difference_of_azimuths_alone(table):
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
    # At the incidences of the grid the refined table has the reflectance; between them the lobe is at another place, which the verdict says.
    assert float(tabulation.relative_loss(refined).max()) < tabulation.WARN_LIMIT
    assert float(refined["interpolation_rms"]) > tabulation.WARN_LIMIT
    assert tabulation.verdict_of(refined) != "pass"
    # The peak itself is on the grid.
    peak = float(narrow.bsdf.evaluate(30, 0, 30, 180))
    assert float(refined.bsdf.evaluate(30, 0, 30, 180)) == pytest.approx(peak, rel=1e-9)


def test_a_table_that_was_refined_in_vain_does_not_advise_to_refine():
    ridges = samples.brushed_bsdf(0.005, 0.3)
    grid = GRID | {"phi_i": [0.0, 180.0]}
    assert "or `table.refine: true`" in vocabulary.warnings(tabulation.tabulate(ridges, grid))[0]
    warned = vocabulary.warnings(tabulation.faithful_table(ridges, grid))[0]
    assert "too coarse for the lobe" in warned
    assert warned.endswith("use finer steps in the configuration's `table`; `table.refine: true` was not enough")


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


def test_a_table_passes_only_if_it_interpolates_within_its_limit():
    wide = samples.beckmann_bsdf(0.4, reflectance=0.3).bsdf.nonspectral()
    fine = {"theta_i": np.arange(0, 61, 3.0), "theta_o": np.arange(0, 90, 3.0), "phi_o": np.arange(0, 361, 6.0)}
    assert tabulation.verdict_of(wide.bsdf.tabulate(fine)) == "pass"
    few = wide.bsdf.tabulate(fine | {"theta_i": [0.0, 60.0]})
    assert tabulation.verdict_of(few) != "pass"
    assert "interpolation between incidences" in vocabulary.warnings(few)[0]


def test_a_black_table_passes():
    black = lambert_gauss.lambertian(samples.spectrum(0.0)).bsdf.nonspectral().bsdf.tabulate(GRID)
    assert tabulation.verdict_of(black) == "pass"
    assert vocabulary.warnings(black) == []


def test_a_table_that_reflects_too_much_fails():
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
    with pytest.raises(VocabularyError, match="the grid has no axis 'phi_o'"):
        bsdf.bsdf.tabulate({"theta_i": [0, 10], "theta_o": [0, 10]})


SPECULAR = {
    "theta_i": np.arange(0, 81, 5.0),
    "theta_s": np.concatenate([np.arange(0, 60, 2.0), np.arange(60, 181, 6.0)]),
    "phi_s": np.arange(0, 181, 10.0),
}
HALF = {
    "theta_h": np.concatenate([np.arange(0, 45, 1.5), np.arange(45, 91, 5.0)]),
    "theta_d": np.concatenate([np.arange(0, 70, 5.0), np.arange(70, 91, 1.0)]),
    "phi_d": np.arange(0, 181, 15.0),
}


@pytest.mark.parametrize(("grid", "rms"), [(SPECULAR, 0.18), (HALF, 0.06)], ids=["specular", "half"])
def test_other_layouts_hold_the_model_within_the_error_they_state(grid, rms):
    bsdf = samples.beckmann_bsdf(0.15, reflectance=None)
    table = bsdf.bsdf.tabulate(grid)
    vocabulary.validate(table, "bsdf")
    assert float(tabulation.relative_loss(table).max()) < tabulation.WARN_LIMIT
    assert float(table["interpolation_rms"]) < rms
    rng = np.random.default_rng(3)
    theta_i, theta_o = rng.uniform(0, 60, (2, 300))
    phi_o = rng.uniform(0, 360, 300)
    model, tabulated = (dataset.bsdf.evaluate(theta_i, 20.0, theta_o, phi_o + 20).values for dataset in (bsdf, table))
    share = np.abs(tabulated - model) / np.maximum(model, float(bsdf.bsdf.albedo(0.0)) / np.pi)
    assert share.max() <= float(table["interpolation_max"])
    assert np.median(share) < 0.05


@pytest.mark.parametrize("grid", [SPECULAR, HALF], ids=["specular", "half"])
def test_other_layouts_are_exact_on_their_nodes(grid):
    bsdf = samples.beckmann_bsdf(0.15, reflectance=None)
    table = bsdf.bsdf.tabulate(grid)
    layout = tabulation.GRIDS["specular" if "theta_s" in grid else "half"]
    nodes = [axis[[1, 4, 5]] for axis in grid.values()]
    at = dict(zip(grid, np.meshgrid(*nodes, indexing="ij"), strict=True))
    theta_i, phi_i, theta_o, phi_o = (angle.ravel() for angle in layout.directions(at))
    above = (theta_i < 89) & (theta_o < 89)
    directions = theta_i[above], phi_i[above], theta_o[above], phi_o[above]
    assert above.sum() > 20
    assert table.bsdf.evaluate(*directions).values == pytest.approx(bsdf.bsdf.evaluate(*directions).values, rel=1e-6)


def test_half_the_step_has_a_quarter_of_the_error():
    bsdf = samples.beckmann_bsdf(0.15, reflectance=None)
    coarse = bsdf.bsdf.tabulate(HALF)
    fine = bsdf.bsdf.tabulate(
        {name: np.unique(np.append(axis, (axis[1:] + axis[:-1]) / 2)) for name, axis in HALF.items()}
    )
    # Linear interpolation: half the step, a quarter of the error.
    assert float(coarse["interpolation_rms"] / fine["interpolation_rms"]) == pytest.approx(4, rel=0.3)


def test_the_reflectance_of_a_uniform_table_is_exactly_that_of_its_interpolation(table):
    # Against a quadrature whose cells end at the nodes.
    theta = np.array([0.0, 33.0, 71.0])
    own = representation(table).albedo(theta, np.zeros(3), None)
    integral = representation(table).integrate(theta, np.zeros(3), None, relative=1e-8)
    assert own == pytest.approx(integral.value, rel=1e-8)


def test_a_table_may_hold_both_sides_of_an_interface():
    bsdf = microfacet.build(facets.analytic("beckmann", 0.3), index=1.5, transparent=True)
    grid = {
        "theta_i": [0.0, 30.0, 60.0, 120.0, 150.0, 180.0],
        "theta_o": np.concatenate([np.arange(0, 89, 3.0), np.arange(92, 181, 3.0)]),
        "phi_o": np.arange(0, 361, 6.0),
    }
    table = bsdf.bsdf.tabulate(grid)
    for direction in ((30, 0, 60, 180), (30, 0, 161, 180), (150, 0, 60, 180), (150, 0, 161, 180)):
        assert float(table.bsdf.evaluate(*direction)) == pytest.approx(float(bsdf.bsdf.evaluate(*direction)), rel=1e-9)
    # Between 87 and 92° the sides are not mixed: reflection is constant beyond the last node above.
    assert float(table.bsdf.evaluate(30, 0, 89.5, 180)) == float(table.bsdf.evaluate(30, 0, 87, 180))
    # Steps of 3° on a lobe of 6°.
    model = bsdf.bsdf.transmittance([0.0, 150.0]).values
    assert table.bsdf.transmittance([0.0, 150.0]).values == pytest.approx(model, rel=0.05)
    # Three incidences a side are too few for the lobes between them, and nothing else is wrong.
    (warning,) = vocabulary.warnings(table)
    assert "interpolation between incidences" in warning
    above = bsdf.bsdf.tabulate({**grid, "theta_o": np.arange(0, 89, 3.0), "theta_i": [0.0, 30.0, 60.0]})
    assert "the table holds reflection alone" in vocabulary.warnings(above)[-1]


@pytest.fixture(scope="module")
def lay():
    return samples.brushed_bsdf(0.2, 0.4, 25.0)


LAY = {"theta_i": np.arange(0, 61, 20.0), "theta_o": np.arange(0, 90, 4.0), "phi_o": np.arange(0, 361, 10.0)}


def test_a_table_of_a_lay_carries_the_azimuth_of_incidence(lay):
    table = lay.bsdf.tabulate({**LAY, "phi_i": np.arange(0, 361, 30.0)})
    assert table["brdf"].dims == ("phi_i", "theta_i", "theta_o", "phi_o")
    for phi_i in (0.0, 60.0, -90.0, 390.0):
        direction = (40, phi_i, 36, phi_i + 170)
        assert float(table.bsdf.evaluate(*direction)) == pytest.approx(float(lay.bsdf.evaluate(*direction)), rel=1e-9)
    assert not representation(table).isotropic


def test_a_table_of_a_lay_without_that_azimuth_holds_the_mean_with_a_warning(lay):
    table = lay.bsdf.tabulate(LAY)
    turns = np.arange(0, 360, 30.0)
    mean = lay.bsdf.evaluate(40, turns, 36, turns + 170).mean()
    assert float(table.bsdf.evaluate(40, 0, 36, 170)) == pytest.approx(float(mean), rel=1e-9)
    assert "add `phi_i` to the grid" in vocabulary.warnings(table)[-1]


def test_half_a_circle_is_refused_for_a_lay(lay):
    with pytest.raises(VocabularyError, match="full turn of 360, because the surface has a lay"):
        lay.bsdf.tabulate({**LAY, "phi_o": np.arange(0, 181, 10.0), "phi_i": [0.0, 360.0]})


def test_a_table_of_a_smooth_surface_warns_about_the_specular_part():
    table = microfacet.build(facets.flat(), index=1.5, spectrum=samples.spectrum(0.3)).bsdf.nonspectral()
    assert any("perfectly specular" in text for text in vocabulary.warnings(table.bsdf.tabulate(GRID)))


@pytest.mark.parametrize("phi_o", [(0, 90), (0, 270), (90, 270), (180, 360), (-90, 90), (0, 350)])
def test_part_of_a_circle_that_no_symmetry_completes_is_refused(bsdf, phi_o):
    with pytest.raises(VocabularyError, match=rf"phi_o .* from {phi_o[0]} to {phi_o[1]} .*0 to 180, or a full turn"):
        bsdf.bsdf.tabulate({**GRID, "phi_o": np.arange(phi_o[0], phi_o[1] + 1, 10.0)})


@pytest.mark.parametrize("phi_o", [(0, 180), (0, 360), (-180, 180)])
def test_half_a_circle_and_a_full_turn_from_anywhere_hold_the_mirror_direction(bsdf, phi_o):
    model = bsdf.bsdf.nonspectral()
    tabulated = model.bsdf.tabulate({**GRID, "phi_o": np.arange(phi_o[0], phi_o[1] + 1, 10.0)})
    assert float(tabulated.bsdf.evaluate(30, 0, 30, 180)) == pytest.approx(
        float(model.bsdf.evaluate(30, 0, 30, 180)), rel=1e-12
    )


def test_an_axis_of_no_layout_or_of_another_is_refused(bsdf):
    for extra in ("foo", "phi_h"):
        with pytest.raises(VocabularyError, match=extra):
            bsdf.bsdf.tabulate({**GRID, extra: [0.0, 180.0]})


SPEC = {
    "theta_i": list(range(0, 81, 10)),
    "theta_o": list(range(0, 86, 5)),
    "phi_o": list(range(0, 181, 10)),
    "phi_i": [0, 90, 180],
}
"""As the configuration has it."""


@pytest.mark.parametrize("refine", [False, True])
def test_a_table_at_wavelengths_has_the_values_of_each(bsdf, refine):
    bands = [450.0, 555.0, 640.0]
    table = tabulation.table_for(bsdf, SPEC | {"refine": refine, "wavelength": bands})
    vocabulary.validate(table, "bsdf")
    assert table["wavelength"].values.tolist() == bands
    theta_i, theta_o, phi_o = (float(table[name].values[1]) for name in ("theta_i", "theta_o", "phi_o"))
    expected = bsdf.bsdf.evaluate(theta_i, 0, theta_o, phi_o, wavelength=bands)
    np.testing.assert_allclose(table["brdf"].sel(theta_i=theta_i, theta_o=theta_o, phi_o=phi_o), expected, rtol=1e-9)
    # Between wavelengths of the model its index is linear, and so, nearly, is the reflectance.
    np.testing.assert_allclose(table.bsdf.evaluate(theta_i, 0, theta_o, phi_o).values, expected, rtol=1e-9)
    assert table["grid_albedo"].dims == ("theta_i", "wavelength")


def test_a_table_without_bands_is_the_average_for_the_eye(bsdf):
    table = tabulation.table_for(bsdf, SPEC | {"refine": False})
    assert "wavelength" not in table.coords
    assert table.identical(tabulation.tabulate(bsdf.bsdf.nonspectral(), tabulation.grid_for(bsdf, SPEC)))


def test_a_band_that_the_bsdf_does_not_have_is_refused(bsdf):
    with pytest.raises(VocabularyError, match="not at 200 nm"):
        tabulation.table_for(bsdf, SPEC | {"refine": False, "wavelength": [200.0, 555.0]})


@pytest.mark.parametrize(
    ("needed", "kept"),
    [
        ([[45, 45]], [40, 50]),
        ([[0, 0]], [0, 10]),
        ([[20, 40]], [20, 30, 40]),
        ([[85, 89]], [70, 80]),
        ([[8, 8], [62, 63]], [0, 10, 60, 70]),
    ],
)
def test_a_table_has_the_incidences_about_those_that_are_needed(bsdf, needed, kept):
    assert tabulation.grid_for(bsdf, SPEC | {"incidence": needed})["theta_i"].tolist() == kept
