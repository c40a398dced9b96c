from __future__ import annotations

import io
import re
from base64 import b64decode

import numpy as np
import pytest
import xarray as xr
from PIL import Image
from samples import spectrum

from brdfpipe import vocabulary
from brdfpipe.bsdf import microfacet
from brdfpipe.bsdf.lambert_gauss import lambertian
from brdfpipe.facets import analytic
from brdfpipe.report import figures
from brdfpipe.report.raster import viridis

Datasets = dict[str, xr.Dataset]


def _map(height: np.ndarray) -> xr.Dataset:
    rows, columns = height.shape
    coords = {"x": np.arange(columns) * 1.0, "y": np.arange(rows) * 1.0}
    return vocabulary.label(xr.Dataset({"height": (("y", "x"), height)}, coords=coords), "surface")


def _picture(svg: str) -> np.ndarray:
    data = re.search(r"data:image/png;base64,([^\"]+)", svg)
    assert data is not None
    return np.asarray(Image.open(io.BytesIO(b64decode(data[1]))).convert("RGB"))


def test_the_map_has_y_upwards() -> None:
    height = np.zeros((64, 64))
    height[:32] = 1.0  # high at small y
    picture = _picture(figures.height_map(_map(height)).svg).astype(int)
    yellow, violet = viridis(np.array([1.0, 0.0])).astype(int)
    assert np.abs(picture[-1, 0] - yellow).max() <= 2
    assert np.abs(picture[0, 0] - violet).max() <= 2


def test_missing_heights_have_a_colour_of_their_own() -> None:
    height = np.random.default_rng(0).normal(size=(64, 64))
    height[-8:, :8] = np.nan
    picture = _picture(figures.height_map(_map(height)).svg)
    assert (picture[0, 0] == [240, 90, 120]).all()
    assert not (picture[-1, -1] == [240, 90, 120]).all()


def test_a_large_map_is_reduced() -> None:
    picture = _picture(figures.height_map(_map(np.random.default_rng(0).normal(size=(1000, 1500)))).svg)
    assert max(picture.shape[:2]) <= 300
    assert picture.shape[0] / picture.shape[1] == pytest.approx(1000 / 1500, rel=0.02)


def test_a_single_spike_does_not_flatten_the_colours_of_the_rest() -> None:
    height = np.tile(np.linspace(0, 1, 100), (100, 1))
    height[50, 50] = 1e4
    picture = _picture(figures.height_map(_map(height)).svg)
    assert len(np.unique(picture[0], axis=0)) > 50


def test_a_long_narrow_map_says_that_it_is_not_to_scale() -> None:
    assert "not to the same scale" in figures.height_map(_map(np.random.default_rng(0).normal(size=(32, 1000)))).note


@pytest.mark.parametrize("height", [np.zeros((40, 40)), np.full((40, 40), 5.0)])
def test_a_flat_map_is_still_a_picture(height: np.ndarray) -> None:
    assert _picture(figures.height_map(_map(height)).svg).shape == (40, 40, 3)


def test_a_long_profile_keeps_its_peak() -> None:
    height = np.zeros(20_000)
    height[12_345] = 7.0
    _, shown = figures._envelope(np.arange(20_000.0), height)
    assert shown.size < 1000
    assert shown.max() == 7.0


def test_a_spectrum_with_the_specular_included_is_the_total(full: Datasets) -> None:
    shown = figures.spectrum(full["spectrum"], full["bsdf"])
    assert [label for *_, label in shown.legend] == [
        "± 2 standard uncertainties",
        "total reflectance",
        "mirrored by the facets",
    ]


def test_a_spectrum_with_the_specular_excluded_stands_below_the_total(full: Datasets) -> None:
    excluded = full["spectrum"].assign_attrs(geometry="sce")
    bsdf = microfacet.build(full["facets"], index=full["index"], spectrum=excluded)
    shown = figures.spectrum(excluded, bsdf)
    assert [label for *_, label in shown.legend][1:3] == ["total reflectance", "measured, specular excluded"]
    assert "The total reflectance adds the mirrored light that the measurement excluded." in shown.note
    total = figures._total(excluded, bsdf)
    assert total is not None
    assert (total[1] > excluded["total_reflectance"].values).all()


def test_without_a_bsdf_a_spectrum_with_the_specular_excluded_is_still_not_called_total(full: Datasets) -> None:
    shown = figures.spectrum(full["spectrum"].assign_attrs(geometry="sce"))
    assert [label for *_, label in shown.legend] == ["± 2 standard uncertainties", "measured, specular excluded"]


def test_viridis_runs_from_violet_to_yellow_and_gets_lighter_all_the_way() -> None:
    colours = viridis(np.linspace(0, 1, 64)).astype(float)
    assert (np.diff(colours @ [0.2126, 0.7152, 0.0722]) > 0).all()


def test_the_spectral_strip_is_blue_green_red() -> None:
    strip = _picture(f'"{figures.visible_strip(400.0, 700.0)}"')[0].astype(int)
    at = {wavelength: strip[round((wavelength - 400) / 300 * 139)] for wavelength in (450, 530, 640)}
    assert [int(np.argmax(at[wavelength])) for wavelength in (450, 530, 640)] == [2, 1, 0]


def test_the_part_of_the_facets_in_the_spectrum_is_that_of_all_azimuths() -> None:
    brushed = microfacet.build(analytic("beckmann", a_x=0.1, a_y=0.6), index=1.5, spectrum=spectrum(0.3))
    shown = figures._specular_part(brushed, brushed["wavelength"].values)
    assert shown is not None
    facets = brushed.assign(diffuse=xr.zeros_like(brushed["diffuse"]))
    # Eight azimuths integrate what varies as cos 2φ and cos 4φ exactly; more of it is below the fourth digit.
    around = facets.bsdf.albedo(8.0, np.arange(0.0, 360.0, 15.0)).mean("direction")
    np.testing.assert_allclose(shown, around.values, rtol=1e-4)


def test_a_perfectly_diffuse_material_has_no_part_of_the_facets() -> None:
    matt = lambertian(spectrum(0.3))
    assert figures._specular_part(matt, matt["wavelength"].values) is None
