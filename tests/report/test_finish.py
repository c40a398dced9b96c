from __future__ import annotations

import io
import re
from base64 import b64decode

import numpy as np
import pytest
import xarray as xr
from PIL import Image

from brdfpipe import vocabulary
from brdfpipe.facets import analytic
from brdfpipe.report import finish
from brdfpipe.report.svg import Figure

Datasets = dict[str, xr.Dataset]


def _labels(figure: Figure) -> list[str]:
    return [label for *_, label in figure.legend]


def _masking(smith: np.ndarray | None = None) -> xr.Dataset:
    theta = np.array([0.0, 30.0, 60.0, 80.0])
    g1 = finish._beckmann_g1(np.maximum(theta, 1e-3), 0.2) if smith is None else smith
    curves = {"g1_raycast": g1 - 0.01, "g1_raycast_u": np.array([0.0, 0.002, 0.003, np.nan]), "g1_smith": g1}
    result = xr.Dataset(
        {name: ("theta", values) for name, values in curves.items()}, coords={"theta": theta}, attrs={"method": "rays"}
    )
    return vocabulary.label(result, "masking")


@pytest.fixture(scope="module")
def brushed() -> xr.Dataset:
    """A Beckmann finish with a lay at 30 degree."""
    return analytic("beckmann", a_x=0.2, a_y=0.5, azimuth=30.0)


# --- isotropic


def test_the_beckmann_overlay_of_masking_is_the_closed_form() -> None:
    # PHYSICS: G1 of Beckmann a = 0.3 at 60, 75, 85 degree
    g1 = finish._beckmann_g1(np.array([60.0, 75.0, 85.0]), 0.3)
    np.testing.assert_allclose(g1, [0.99963733, 0.96249761, 0.64581632], atol=1e-8)


def test_the_overlays_of_a_named_density_are_that_density() -> None:
    slope = np.linspace(0, 0.4, 50)
    for name, which in (("beckmann", 0), ("ggx", 1)):
        facets = analytic(name, 0.1)
        model = finish._radial_models(facets)[which][0]
        own = np.interp(slope, facets["slope"].values, facets["slope_density"].values)
        # Linear interpolation between 512 nodes, and of the median slope between quadrature nodes: 1 % at the peak.
        np.testing.assert_allclose(model(slope), own, rtol=0.02, atol=0.01 * own.max())


def test_the_masking_overlay_of_ggx_is_the_masking_of_ggx() -> None:
    facets = analytic("ggx", 0.2)
    theta = np.array([45.0, 70.0, 85.0])
    own = 1 / (1 + np.interp(theta, facets["theta"].values, facets["lambda_smith"].values))
    np.testing.assert_allclose(finish._ggx_g1(theta, 0.2), own, atol=2e-3)


def test_beckmann_has_the_rms_slope_where_it_is_finite_and_else_the_median() -> None:
    assert "Beckmann of the same rms slope, 0.1" in _labels(finish.slope_density(analytic("beckmann", 0.1)))
    assert any("Beckmann of the same median slope" in label for label in _labels(finish.masking(analytic("ggx", 0.1))))


def test_the_slope_against_scale_leaves_out_what_is_missing(full: Datasets) -> None:
    figure = finish.slope_by_scale(full["facets"])
    assert figure is not None
    assert figure.svg.count("h0") == 3  # one point each; the fourth scale is missing


def test_a_single_scale_makes_no_figure(full: Datasets) -> None:
    assert finish.slope_by_scale(full["facets"].isel(scale=[0])) is None
    assert finish.slope_by_scale(full["facets"].isel(scale=[0, 3])) is None
    assert finish.slope_by_scale(analytic("beckmann", 0.1)) is None


def test_isotropic_facets_need_only_their_density(full: Datasets) -> None:
    bare = full["facets"][["slope_density"]]
    titles = [figure.title for figure in finish.facet_figures(bare)]
    assert titles == ["Slope density of the facets", "Facet distribution D(α)"]
    assert finish.facet_figures(full["facets"][["slope_rms"]]) == []


# --- with a lay


def test_facets_with_a_lay_have_a_rose_a_map_two_sections_and_masking(brushed: xr.Dataset) -> None:
    assert [figure.title for figure in finish.facet_figures(brushed)] == [
        "Lay",
        "Slope density, all azimuths",
        "Slope density along the lay",
        "Slope density across the lay",
        "Masking G₁(θ)",
    ]


def test_the_rose_of_a_beckmann_finish_is_its_width_over_root_two(brushed: xr.Dataset) -> None:
    density = finish._planar(brushed)
    towards = finish._rms_towards(density, np.array([30.0, 120.0]))
    # The density is a spline between nodes: its moments hold to 1e-4.
    np.testing.assert_allclose(towards, np.array([0.2, 0.5]) / np.sqrt(2), rtol=1e-3)
    mean = finish._mean_towards(density, np.array([30.0, 120.0]))
    np.testing.assert_allclose(mean, np.array([0.2, 0.5]) / np.sqrt(np.pi), rtol=1e-3)


@pytest.mark.parametrize("name", ["beckmann", "ggx"])
def test_the_overlays_of_a_named_finish_with_a_lay_are_its_sections(name: str) -> None:
    facets = analytic(name, a_x=0.1, a_y=0.2)
    density = finish._planar(facets)
    sections = finish._planar_models(facets, density)[("beckmann", "ggx").index(name)][0]
    slope = np.linspace(0, 0.3, 20)
    # The widths of the overlay come from moments or medians of the tabulated density.
    np.testing.assert_allclose(sections[0](slope), density(slope, 0 * slope), rtol=0.05, atol=1e-3)
    np.testing.assert_allclose(sections[1](slope), density(0 * slope, slope), rtol=0.05, atol=1e-3)


def test_masking_along_the_lay_is_that_of_the_narrow_width(brushed: xr.Dataset) -> None:
    theta = np.array([70.0, 85.0])
    for turn, width in ((0, 0.2), (90, 0.5)):
        smith = np.interp(theta, brushed["theta"].values, finish._lambda_towards(brushed, 30.0 + turn))
        np.testing.assert_allclose(1 / (1 + smith), finish._beckmann_g1(theta, width), atol=5e-3)


def test_the_map_shows_steps_of_half_a_decade(brushed: xr.Dataset) -> None:
    figure = finish.facet_figures(brushed)[1]
    data = re.search(r"data:image/png;base64,([^\"]+)", figure.svg)
    assert data is not None
    colours = np.unique(np.asarray(Image.open(io.BytesIO(b64decode(data[1]))).convert("RGB")).reshape(-1, 3), axis=0)
    assert 8 <= len(colours) <= 10


def test_an_axis_is_written_as_an_azimuth_below_180() -> None:
    assert [finish.axis_degrees(angle) for angle in (-80.0, 0.0, 87.39, 179.99, np.nan)] == [
        "100°",
        "0°",
        "87.4°",
        "0°",
        "–",
    ]


@pytest.mark.parametrize(
    "absent", ["lambda_smith", "D", "slope_rms", "anisotropy", "count", "slope_density_u", "slope_density"]
)
def test_no_variable_of_a_finish_with_a_lay_is_needed(brushed: xr.Dataset, absent: str) -> None:
    steep = 0 * brushed["slope_across"] + np.abs(brushed["slope_along"]) > 0.3
    flags = np.where(steep, vocabulary.quality("extrapolated"), vocabulary.quality("measured"))
    quality = brushed["slope_density"].copy(data=flags)
    counted = brushed.assign(
        slope_density_u=0.1 * brushed["slope_density"], slope_density_quality=quality, count=brushed["slope_density"]
    )
    figures = finish.facet_figures(counted.drop_vars(absent))
    assert all("nan" not in figure.svg for figure in figures)
    if absent != "slope_density":
        assert {"measured", "extrapolated"} <= {label for figure in figures for label in _labels(figure)}


# --- ray casting


def test_ray_casting_is_drawn_with_error_bars_where_they_are_known() -> None:
    figure = finish.raycast_figure(_masking())
    points, bars = (
        re.search(r'class="p c2" d="([^"]*)"', figure.svg),
        re.search(r'class="e c2" d="([^"]*)"', figure.svg),
    )
    assert points is not None
    assert bars is not None
    assert points[1].count("h0") == 4
    assert bars[1].count("V") == 3
    assert "nan" not in figure.svg


def test_smith_is_drawn_finely_only_where_it_is_the_facets_own() -> None:
    facets = analytic("beckmann", 0.2)
    assert finish._smith_curve(_masking(), facets)[0].size > 100
    assert finish._smith_curve(_masking(np.array([1.0, 0.9, 0.8, 0.7])), facets)[0].size == 4
    assert finish._smith_curve(_masking(), None)[0].size == 4


def test_ray_casting_without_uncertainty_has_no_bars() -> None:
    figure = finish.raycast_figure(_masking().drop_vars("g1_raycast_u"))
    assert 'class="e c2" d=""' in figure.svg


def test_g2_is_drawn_against_both_forms_of_smith_where_it_was_cast() -> None:
    comparison = _masking()
    assert finish.bistatic_figure(comparison) is None
    cast = {
        "g2_raycast": [1.0, 0.9, 0.5, np.nan],
        "g2_raycast_u": [0.0, 0.01, np.nan, np.nan],
        "g2_separable": [1.0, 0.85, 0.4, 0.1],
        "g2_height_correlated": [1.0, 0.9, 0.6, 0.2],
    }
    figure = finish.bistatic_figure(comparison.assign({name: ("theta", values) for name, values in cast.items()}))
    assert figure is not None
    assert _labels(figure)[:2] == ["Smith, height-correlated", "Smith, separable"]
    points = re.search(r'class="p c2" d="([^"]*)"', figure.svg)
    assert points is not None
    assert points[1].count("h0") == 3  # no facet faces both directions at the fourth
    assert "nan" not in figure.svg
