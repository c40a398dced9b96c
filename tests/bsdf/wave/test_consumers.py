"""What takes a BSDF takes one with a coherent part of any size."""

from __future__ import annotations

import json

import numpy as np
import pytest
import xarray as xr

from brdfpipe import exchange, psd, vocabulary
from brdfpipe.appearance.computation import compute_appearance
from brdfpipe.appearance.preview import preview
from brdfpipe.bsdf import tabulation, wave
from brdfpipe.bsdf.lambert_gauss_fit import fit_lambert_gauss
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.catalogue.configuration import load_config
from brdfpipe.facets import analytic

SURFACES = {"polished white": (0.005, 0.9), "satin black": (0.05, 0.05), "rough white": (0.2, 0.9)}
"""Rms height [um] and total reflectance; the correlation length is 5 um."""


@pytest.fixture(scope="module", params=SURFACES)
def bsdf(request) -> xr.Dataset:
    sigma, reflectance = SURFACES[request.param]
    spectrum = xr.Dataset(
        {"total_reflectance": ("wavelength", np.full(3, reflectance))},
        coords={"wavelength": [400.0, 550.0, 700.0]},
        attrs={"geometry": "sci", "theta_i": 8.0, "method": "a test"},
    )
    return wave.build(
        psd.analytic("gaussian", sigma=sigma, length=5.0),
        facets=analytic("beckmann", a=2 * sigma / 5),
        index=1.5,
        spectrum=vocabulary.label(spectrum, "spectrum"),
        optics="auto",
    )


def coherent(bsdf: xr.Dataset, theta: float = 20.0) -> float:
    return float(bsdf.bsdf.specular(theta)[0].mean())


def test_every_check_passes(bsdf):
    verdicts = json.loads(bsdf.bsdf.check().attrs["verdicts"])
    assert {name: one["verdict"] for name, one in verdicts.items() if one["verdict"] != "pass"} == {}


def test_gloss_haze_and_colours_are_finite_and_count_the_coherent_part(bsdf):
    config = load_config()
    settings = {name: config[name] for name in ("illuminant", "observer", "gloss_angles")}
    result = compute_appearance(bsdf, **settings, **config["appearance"])
    gloss = result["gloss"].values
    assert np.isfinite(gloss).all()
    assert np.isfinite(result["lab"].values).all()
    # Black glass of 100 units reflects 0.0491 at 20 degree, and the receptor sees at least the coherent light.
    assert gloss[0] > 0.98 * 100 * coherent(bsdf) / 0.0491


def test_the_table_and_the_fit_say_that_they_leave_the_coherent_part_out(bsdf):
    config = load_config()
    table = tabulation.faithful_table(nonspectral(bsdf), tabulation.grid_for(bsdf, config["table"]))
    fit = fit_lambert_gauss(bsdf, config["lambert_gauss"]["theta_i"])
    for result in (table, fit):
        said = any("specular part" in text for text in vocabulary.warnings(result))
        # Of the rough surface at the longest wavelength, at 45 degree, 1e-4 of the light.
        assert said == (float(bsdf.bsdf.specular(45.0)[0].max()) > 1e-5)


def test_it_is_exported(bsdf, tmp_path):
    exchange.write(bsdf, tmp_path / "a.astm", tolerance=0.1, albedo_tolerance=0.05, largest=5000)
    assert (tmp_path / "a.astm").stat().st_size > 1000


def test_the_picture_has_the_coherent_reflection(bsdf):
    if coherent(bsdf) > 0.03 or coherent(bsdf) < 1e-3:
        pytest.skip("one picture of a surface that reflects half coherently is enough")
    picture = preview(bsdf, side=48)
    assert np.isfinite(next(iter(picture.data_vars.values())).values.astype(float)).all()


def test_samples_have_the_reflectance_as_their_mean(bsdf):
    samples = bsdf.bsdf.sample(n=4000, seed=1, theta_i=45)
    expected = float(bsdf.bsdf.albedo(45.0).mean())
    scatter = float(samples["weight"].mean("wavelength").std()) / np.sqrt(4000)
    assert float(samples["weight"].mean()) == pytest.approx(expected, abs=max(5 * scatter, 0.01 * expected))
