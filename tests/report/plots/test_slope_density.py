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
from brdfpipe.report.material import inputs
from brdfpipe.report.plots import masking, slope_density
from brdfpipe.report.plots.svg import Figure

Datasets = dict[str, xr.Dataset]


def _labels(figure: Figure) -> list[str]:
    return [label for *_, label in figure.legend]


@pytest.fixture(scope="module")
def brushed() -> xr.Dataset:
    """A Beckmann finish with a lay at 30 degree."""
    return analytic("beckmann", a_x=0.2, a_y=0.5, azimuth=30.0)


# --- isotropic


def test_the_slope_against_scale_omits_missing_values(full: Datasets) -> None:
    figure = slope_density.slope_by_scale(full["facets"])
    assert figure is not None
    assert figure.svg.count("h0") == 3  # one point each; the fourth scale is missing


def test_a_single_scale_makes_no_figure(full: Datasets) -> None:
    assert slope_density.slope_by_scale(full["facets"].isel(scale=[0])) is None
    assert slope_density.slope_by_scale(full["facets"].isel(scale=[0, 3])) is None
    assert slope_density.slope_by_scale(analytic("beckmann", 0.1)) is None


def test_isotropic_facets_need_only_their_density(full: Datasets) -> None:
    bare = full["facets"][["slope_density"]]
    titles = [figure.title for figure in inputs.facet_figures(bare)]
    assert titles == ["Slope density of the facets", "Facet distribution D(α)"]
    assert inputs.facet_figures(full["facets"][["slope_rms"]]) == []


def test_beckmann_has_the_rms_slope_where_it_is_finite_and_else_the_median() -> None:
    assert "Beckmann of the same rms slope, 0.1" in _labels(slope_density.slope_density(analytic("beckmann", 0.1)))
    assert any(
        "Beckmann of the same median slope" in label for label in _labels(masking.smith_masking(analytic("ggx", 0.1)))
    )


# --- with a lay


def test_facets_with_a_lay_have_a_rose_a_map_two_sections_and_masking(brushed: xr.Dataset) -> None:
    assert [figure.title for figure in inputs.facet_figures(brushed)] == [
        "Lay",
        "Slope density, all azimuths",
        "Slope density along the lay",
        "Slope density across the lay",
        "Masking G₁(θ)",
    ]


def test_the_map_shows_steps_of_half_a_decade(brushed: xr.Dataset) -> None:
    figure = inputs.facet_figures(brushed)[1]
    data = re.search(r"data:image/png;base64,([^\"]+)", figure.svg)
    assert data is not None
    colours = np.unique(np.asarray(Image.open(io.BytesIO(b64decode(data[1]))).convert("RGB")).reshape(-1, 3), axis=0)
    assert 8 <= len(colours) <= 10


def test_an_axis_is_written_as_an_azimuth_below_180() -> None:
    assert [slope_density.axis_degrees(angle) for angle in (-80.0, 0.0, 87.39, 179.99, np.nan)] == [
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
    figures = inputs.facet_figures(counted.drop_vars(absent))
    assert all("nan" not in figure.svg for figure in figures)
    if absent != "slope_density":
        assert {"measured", "extrapolated"} <= {label for figure in figures for label in _labels(figure)}


# --- ray casting
