"""Readings of instruments beside their predictions."""

from __future__ import annotations

import io
import json
import math

import numpy as np
import pandas as pd
import pytest
import samples
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.appearance import compute_appearance
from brdfpipe.appearance.colours import colour_without_specular
from brdfpipe.bsdf import lambert_gauss, microfacet
from brdfpipe.bsdf.input_uncertainty import uncertainty
from brdfpipe.comparison.readings import compare_readings, predicted_values, readings_of, readings_table
from brdfpipe.errors import BrdfpipeError
from brdfpipe.report.material.readings import readings_section


@pytest.fixture(scope="module")
def bsdf() -> xr.Dataset:
    return samples.beckmann_bsdf(0.08)


@pytest.fixture(scope="module")
def read(bsdf: xr.Dataset) -> dict:
    """What a perfect instrument reads of it."""
    appearance = compute_appearance(bsdf, illuminant="A", observer=2)
    gloss = dict(zip(("20", "60", "85"), appearance["gloss"].values.tolist(), strict=True))
    lab = appearance["lab"].sel(geometry="45:0").values.tolist()
    return {
        "gloss": gloss,
        "haze": gloss["60"] - gloss["20"],
        "reflectance_haze": float(appearance["reflectance_haze"][0]),
        "lab": [{"geometry": "45:0", "lab": lab, "illuminant": "A", "observer": 2}],
    }


def test_a_perfect_reading_is_the_prediction(bsdf: xr.Dataset, read: dict) -> None:
    result = compare_readings(bsdf, read)
    assert list(result["reading"].values) == [
        "gloss 20°", "gloss 60°", "gloss 85°", "haze D4039", "haze ISO 13803",
        "L* 45:0, A/2°", "a* 45:0, A/2°", "b* 45:0, A/2°",
    ]  # fmt: skip
    assert np.abs(result["z"]).max() < 1e-6
    assert json.loads(result.attrs["verdicts"])["readings"]["verdict"] == "pass"


@pytest.mark.parametrize(("off", "verdict"), [(1.9, "pass"), (2.1, "warn"), (-3.1, "fail")])
def test_the_furthest_reading_decides_the_verdict(bsdf: xr.Dataset, read: dict, off: float, verdict: str) -> None:
    clean = compare_readings(bsdf, read).sel(reading="gloss 60°")
    u = math.hypot(0.5, float(clean["predicted_u"]))
    wrong = {"gloss": read["gloss"] | {"60": read["gloss"]["60"] + off * u}, "uncertainty": {"gloss": 0.5}}
    result = compare_readings(bsdf, wrong)
    assert float(result["z"].sel(reading="gloss 60°")) == pytest.approx(off, rel=1e-6)
    found = json.loads(result.attrs["verdicts"])["readings"]
    assert found["verdict"] == verdict
    assert "gloss 60°: read" in found["text"]


def test_a_reading_that_the_bsdf_was_fitted_to_is_judged_by_its_own_uncertainty(bsdf: xr.Dataset, read: dict) -> None:
    off = {"gloss": {"60": read["gloss"]["60"] + 3}}
    free, fitted = (compare_readings(bsdf, off, fitted) for fitted in ((), ("gloss 60°",)))
    assert float(fitted["z"][0]) == pytest.approx(3, rel=1e-6)
    assert float(free["z"][0]) < 3
    assert "was fitted to gloss 60°" in readings_section({"readings": fitted}).tables[0].note


def test_default_uncertainties_are_those_of_the_documentation() -> None:
    measured = {
        "gloss": {"20": 50.0, "60": 150.0},
        "haze": 20.0,
        "reflectance_haze": 3.0,
        "lab": [{"geometry": "45:0", "lab": [50, 0, 0]}],
        "transmittance": 0.9,
    }
    assert [one.u for one in readings_of(measured)] == [1, 1.5, math.sqrt(2), 1, 0.5, 0.5, 0.5, 0.005]


def test_what_a_bsdf_cannot_predict_is_listed_with_the_reason(bsdf: xr.Dataset) -> None:
    opaque = compare_readings(bsdf, {"transmittance": 0.5, "gloss": {"60": 20.0}})
    assert np.isnan(opaque["z"].sel(reading="transmittance"))
    assert "opaque" in json.loads(opaque.attrs["not_predicted"])["transmittance"]
    matt = lambert_gauss.lambertian(samples.spectrum(0.4)).assign_attrs(route="predicted")
    result = compare_readings(matt, {"gloss": {"60": 20.0}})
    assert json.loads(result.attrs["verdicts"])["readings"]["verdict"] == "warn"
    table = readings_section({"readings": result}).tables[0]
    assert table.rows[0][2:] == ("–", "–", "–")
    assert "Set `surface`" in table.note


def test_an_unknown_geometry_is_refused(bsdf: xr.Dataset) -> None:
    with pytest.raises(BrdfpipeError, match="unknown geometry"):
        compare_readings(bsdf, {"lab": [{"geometry": "45az75", "lab": [50, 0, 0]}]})


def test_the_table_holds_the_same_numbers(bsdf: xr.Dataset, read: dict) -> None:
    result = compare_readings(bsdf, read)
    table = pd.read_csv(io.StringIO(readings_table(result)))
    assert list(table["reading"]) == list(result["reading"].values)
    assert list(table["unit"]) == ["GU"] * 5 + ["1"] * 3
    for column, name in (("read", "read_value"), ("predicted", "predicted_value"), ("predicted_u", "predicted_u")):
        np.testing.assert_allclose(table[column], result[name], rtol=1e-5, atol=1e-12)


def test_a_colour_without_the_specular_is_compared_with_its_uncertainty() -> None:
    spectrum = samples.spectrum(0.3)
    stated = vocabulary.label(
        spectrum.assign(total_reflectance_u=xr.full_like(spectrum["total_reflectance"], 0.01).drop_attrs()), "spectrum"
    )
    bsdf, brighter = (
        microfacet.build(samples.beckmann(0.1), index=1.5, spectrum=one, multiple_scattering="none")
        for one in (spectrum, samples.spectrum(0.31))
    )
    changes = uncertainty(bsdf, spectrum=stated)
    uncertain = bsdf.merge(changes, combine_attrs="override")
    uncertain.attrs |= {"uncertainty_not_stated": changes.attrs["uncertainty_not_stated"]}
    read = colour_without_specular(bsdf).values
    measured = {"lab": [{"geometry": "8:sce", "lab": read.tolist()}, {"geometry": "8:total", "lab": [50, 0, 0]}]}
    result = compare_readings(uncertain, measured)
    assert list(result["reading"].values[:3]) == ["L* 8:sce, D65/10°", "a* 8:sce, D65/10°", "b* 8:sce, D65/10°"]
    assert np.abs(result["z"].values[:3]).max() < 1e-6
    of_lightness = float(colour_without_specular(brighter)[0] - read[0])
    assert result["predicted_u"].values[0] == pytest.approx(of_lightness, rel=0.02)
    assert predicted_values(uncertain, readings_of(measured)) == pytest.approx(result["predicted_value"].values)
    # Without an uncertainty of the spectrum that of the colour is not known, as that of the total reflectance.
    assert np.isnan(compare_readings(bsdf, measured)["predicted_u"]).all()
