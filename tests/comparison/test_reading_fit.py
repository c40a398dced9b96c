"""The doubtful inputs with which a prediction would agree with readings."""

from __future__ import annotations

import json
from functools import cache
from typing import Any

import numpy as np
import pytest
import samples
import xarray as xr

from brdfpipe import optics, psd, vocabulary
from brdfpipe.appearance import gloss
from brdfpipe.appearance.colours import colour
from brdfpipe.bsdf import microfacet, wave
from brdfpipe.comparison.reading_fit import with_fit
from brdfpipe.comparison.readings import compare_readings
from brdfpipe.facets import analytic
from brdfpipe.report.material.readings import readings_section

WIDTH, INDEX, REFLECTANCE = 0.06, 1.5, 0.2


@cache
def inputs(width: float = WIDTH, index: float = INDEX, reflectance: float = REFLECTANCE) -> dict[str, xr.Dataset]:
    given = {"facets": analytic("beckmann", width), "index": optics.refractive_index(index)}
    # Few wavelengths: the fit builds a BSDF for each derivative.
    spectrum = samples.spectrum(reflectance).isel(wavelength=slice(None, None, 12))
    return given | {"spectrum": vocabulary.label(spectrum, "spectrum")}


def built(**changed: float) -> xr.Dataset:
    return microfacet.build(**inputs(**changed)).assign_attrs(route="predicted")


def read_of(bsdf: xr.Dataset) -> dict[str, Any]:
    """What a good instrument reads of a BSDF."""
    values = dict(zip(("20", "60", "85"), gloss(bsdf, (20, 60, 85)).values.tolist(), strict=True))
    lab = colour(bsdf, ["45:0"]).sel(geometry="45:0").values.tolist()
    return {"gloss": values, "lab": [{"geometry": "45:0", "lab": lab}], "uncertainty": {"gloss": 0.3, "lab": 0.2}}


def fitted(measured: dict[str, Any], bsdf: xr.Dataset | None = None, **options: Any) -> xr.Dataset:
    given = built() if bsdf is None else bsdf
    return with_fit(compare_readings(given, measured), measured, given, predicted=built(), **inputs(), **options)


def sentences(readings: xr.Dataset) -> str:
    return "; ".join(json.loads(readings.attrs["findings"]))


def test_readings_that_agree_ask_for_nothing() -> None:
    result = fitted(read_of(built()))
    assert "posterior" not in result
    assert "no change" in sentences(result)


def test_readings_of_steeper_slopes_ask_for_them() -> None:
    result = fitted(read_of(built(width=1.2 * WIDTH)))
    slope = result.sel(input="slope")
    # The prior of 0.1 pulls by a part of the posterior's own uncertainty.
    assert abs(float(slope["posterior"]) - 1.2) < 2 * float(slope["posterior_u"])
    # Determined, though a higher index and finer roughness do in part what steeper slopes do: better than half of what was assumed.
    assert float(slope["posterior_u"]) < 0.5 * float(slope["prior_u"])
    assert np.abs(result["z_adjusted"]).max() < 1
    assert np.abs(result["z"]).max() > 3
    assert "rougher than its facets say" in sentences(result)
    vocabulary.validate(result, "readings")
    _, table = readings_section({"readings": result}).tables
    assert "not applied" in table.title
    assert [row[0] for row in table.rows] == [
        "Refractive index",
        "Slope scale",
        "Diffuse scale",
        "Roughness finer than the scan",
    ]


@pytest.mark.slow
@pytest.mark.parametrize("sigma", [0.05, 0.25])
def test_readings_of_higher_waves_ask_for_larger_heights(sigma: float) -> None:
    """A smooth surface, of which waves reflect all the light, and one of which facets reflect a part."""
    index, spectrum, length = inputs()["index"], inputs()["spectrum"], 8.0

    def of(factor: float) -> tuple[dict[str, xr.Dataset], xr.Dataset]:
        found = {"facets": analytic("beckmann", 2 * sigma * factor / length), "index": index, "spectrum": spectrum}
        heights = psd.analytic("gaussian", sigma=sigma * factor, length=length)
        predicted = microfacet.build(**found)
        bsdf = wave.build(heights, **found, predicted=predicted, optics="auto").assign_attrs(route="predicted")
        return found | {"predicted": predicted, "psd": heights}, bsdf

    given, bsdf = of(1.0)
    assert bsdf.attrs["representation"] == "wave"
    measured = read_of(of(1.15)[1])
    result = with_fit(compare_readings(bsdf, measured), measured, bsdf, **given)
    slope = result.sel(input="slope")
    assert abs(float(slope["posterior"]) - 1.15) < 2 * float(slope["posterior_u"])
    assert np.abs(result["z_adjusted"]).max() < 1 < 3 < np.abs(result["z"]).max()
    without = with_fit(compare_readings(bsdf, measured), measured, bsdf, **{**given, "psd": None})
    assert "no roughness spectrum" in sentences(without)


def test_readings_of_a_film_ask_for_finer_roughness() -> None:
    read = read_of(built())
    g = (4 * np.pi * 0.04 * np.cos(np.radians([20, 60, 85])) / 0.55) ** 2
    read["gloss"] = dict(zip(read["gloss"], (np.array([*read["gloss"].values()]) * np.exp(-g)).tolist(), strict=True))
    result = fitted(read, slope_u=0.01, index_u=0.001)
    finer = result.sel(input="finer")
    # 40 nm rms; the base's own light of a few tenths of a gloss unit is not lost.
    assert float(finer["posterior"]) == pytest.approx(0.04**2, abs=2 * float(finer["posterior_u"]))
    assert "does not resolve" in sentences(result)


def test_what_the_readings_do_not_constrain_is_said() -> None:
    read = read_of(built(width=1.2 * WIDTH))
    del read["lab"]
    result = fitted(read)
    diffuse = result.sel(input="diffuse")
    assert float(diffuse["posterior_u"]) > 0.8 * float(diffuse["prior_u"])
    (sentence,) = [text for text in json.loads(result.attrs["findings"]) if text.startswith("diffuse scale")]
    assert "does not constrain it" in sentence


def test_readings_that_nothing_explains_are_named() -> None:
    read = read_of(built())
    read["gloss"] = {"60": read["gloss"]["60"], "85": 4 * read["gloss"]["85"]}
    assert "do not explain the readings" in sentences(fitted(read))


def test_an_input_that_would_change_by_many_of_its_uncertainties_is_doubted() -> None:
    found = sentences(fitted({"gloss": {"60": 300}}))
    assert "index were higher than given, 10 times its assumed uncertainty from what was given" in found


def test_a_prediction_that_cannot_be_changed_says_why() -> None:
    measured = {"gloss": {"60": 90.0}}
    file = built().assign_attrs(route="imported")
    readings = with_fit(compare_readings(file, measured), measured, file)
    assert "for opaque bodies with facets alone" in sentences(readings)
    of_gloss = with_fit(
        compare_readings(built(), measured, ["gloss 60°"]), measured, built(), predicted=built(), **inputs()
    )
    assert "already those that have this gloss" in sentences(of_gloss)
