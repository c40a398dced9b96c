from __future__ import annotations

import re

import numpy as np
import xarray as xr
from samples import beckmann_bsdf, spectrum

from brdfpipe import optics, vocabulary
from brdfpipe.bsdf import microfacet
from brdfpipe.bsdf.lambert_gauss import lambertian
from brdfpipe.facets import analytic, flat
from brdfpipe.report.plots import directional_maps


def _direction(theta: float | np.ndarray, phi: float | np.ndarray) -> np.ndarray:
    theta, phi = np.radians(theta), np.radians(phi)
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)


def test_bare_facets_polarise_by_fresnel() -> None:
    bsdf = beckmann_bsdf(0.1, n=1.5, reflectance=None)
    figure = directional_maps.polarisation(bsdf)
    assert figure is not None
    fresnel = optics.fresnel(0.5, 1.5)
    expected = 100 * float((fresnel.s - fresnel.p) / (fresnel.s + fresnel.p))
    assert f"{expected:.0f}\u202f% of the light in the mirror direction" in figure.note


def test_at_brewsters_angle_all_of_the_mirrored_light_is_polarised() -> None:
    bsdf = beckmann_bsdf(0.1, n=float(np.sqrt(3)), reflectance=None)  # tan 60°
    figure = directional_maps.polarisation(bsdf)
    assert figure is not None
    assert "100\u202f% of the light in the mirror direction" in figure.note


def test_a_base_dilutes_the_polarisation() -> None:
    wide = directional_maps.polarisation(beckmann_bsdf(0.3, reflectance=0.9))
    assert wide is not None
    stated = re.search(r"([\d.]+)\u202f% of the light", wide.note)
    assert stated is not None
    assert 0 < float(stated[1]) < 60


def test_the_degree_of_polarisation_is_the_same_from_both_formulas() -> None:
    bsdf = beckmann_bsdf(0.1, n=1.5, reflectance=None)
    theta, turn = np.array([20.0, 60.0, 80.0]), np.array([150.0, 0.0, 40.0])
    degree = directional_maps._facet_polarisation(bsdf, theta, turn)
    w_i, w_o = (_direction(t, p) for t, p in ((60.0, 180.0), (theta, turn)))
    cos_zeta = np.sqrt((1 + np.sum(w_i * w_o, axis=-1)) / 2)
    facet = optics.fresnel(cos_zeta, 1.5)
    np.testing.assert_allclose(degree, np.abs(facet.s - facet.p) / (facet.s + facet.p), rtol=1e-9)


def test_a_metal_has_a_scale_of_its_own() -> None:
    index = xr.Dataset(
        {"n": ("wavelength", [1.0, 1.0]), "k": ("wavelength", [7.0, 7.0])}, {"wavelength": [400.0, 700.0]}
    )
    metal = microfacet.build(analytic("ggx", 0.2), index=vocabulary.label(index.assign_attrs(source="test"), "index"))
    figure = directional_maps.polarisation(metal)
    assert figure is not None
    assert ">100\u202f%<" not in figure.svg
    assert ">20\u202f%<" in figure.svg


def test_the_mirrored_ray_of_a_smooth_surface_is_a_sentence() -> None:
    figure = directional_maps.polarisation(microfacet.build(flat(), index=float(np.sqrt(3)), spectrum=spectrum(0.3)))
    assert figure is not None
    assert not figure.svg
    assert "100\u202f% of the mirrored ray is polarised" in figure.note


def test_a_bsdf_without_index_or_facets_has_no_map_of_polarisation() -> None:
    assert directional_maps.polarisation(lambertian(spectrum(0.3))) is None
    grid = {"theta_i": [0.0, 80.0], "theta_o": [0.0, 80.0], "phi_o": [0.0, 180.0]}
    assert directional_maps.polarisation(beckmann_bsdf().bsdf.tabulate(grid)) is None
