"""Colours at any geometries, and differences between materials."""

from __future__ import annotations

import numpy as np
import pytest
import samples

from brdfpipe import flakes, vocabulary
from brdfpipe.appearance import colour_difference, predicted_colours
from brdfpipe.bsdf import flake, lambert_gauss
from brdfpipe.errors import BrdfpipeError

LAB = {"45as15": (33.90, -7.58, -36.61), "45as45": (12.29, 1.19, -25.77), "45as110": (3.07, 2.09, -13.24)}


def paint(factor=1.0, **options):
    listed = [{"geometry": name, "lab": (factor * np.array(lab)).tolist()} for name, lab in LAB.items()]
    return flake.build(flakes.ingest({"colours": listed, "illuminant": "D65", "observer": 10}), **options)


def test_measured_geometries_have_the_measured_colours_and_others_are_flagged():
    predicted = predicted_colours(paint(), [*LAB, "45as25", "45as5"])
    vocabulary.validate(predicted, "colours")
    assert predicted["lab"].values[:3] == pytest.approx(np.array(list(LAB.values())), abs=1e-9)
    flags = [vocabulary.QUALITY_FLAGS[flag] for flag in predicted["lab_quality"].values]
    assert flags == ["measured"] * 3 + ["interpolated", "extrapolated"]
    assert LAB["45as45"][0] < float(predicted["lab"].sel(geometry="45as25", component="L*")) < LAB["45as15"][0]


def test_colours_under_another_illuminant_follow_from_the_spectra():
    predicted = predicted_colours(paint(), "E2194", illuminant="A", observer=2)
    assert predicted["geometry"].values.tolist() == ["45as15", "45as45", "45as110"]
    # A blue under the reddish illuminant stays blue, and darkens.
    assert (predicted["lab"].sel(component="b*") < 0).all()
    assert float(predicted["lab"][0, 0]) < LAB["45as15"][0]


def test_a_material_does_not_differ_from_itself():
    assert (colour_difference(paint(), paint(), "MA-T12").values == 0).all()


def test_a_paint_differs_from_a_lambertian_by_the_colours_of_both():
    grey = lambert_gauss.lambertian(samples.spectrum(0.2))
    difference = colour_difference(paint(), grey, {"here": (45.0, 0.0, 30.0, 180.0)})
    assert float(difference[0]) > 20
    assert difference["geometry"].values.tolist() == ["here"]


def test_the_two_models_agree_where_measured_and_part_elsewhere():
    plain, physical = paint(index=1.524), paint(index=1.524, model="flake-physical")
    assert colour_difference(plain, physical, list(LAB)).values == pytest.approx(0, abs=1e-6)
    apart = colour_difference(plain, physical, ["45as25", "45as75", "15as15", "75:0"])
    # Within the plane that was measured they are alike; at other incidences transmission and Jacobian tell.
    assert (apart.values[:2] < 2).all()
    assert float(apart[3]) > float(apart[:2].max())


def test_an_unknown_geometry_is_refused():
    with pytest.raises(BrdfpipeError, match="unknown geometry"):
        predicted_colours(paint(), ["46 degrees"])


def test_a_difference_beyond_the_measured_angles_is_flagged():
    grey = lambert_gauss.lambertian(samples.spectrum(0.2))
    wide = flake.build(
        flakes.ingest(
            {
                "colours": [
                    {"geometry": name, "lab": list(lab)} for name, lab in {**LAB, "45as5": (40.0, -8.0, -38.0)}.items()
                ],
                "illuminant": "D65",
                "observer": 10,
            }
        )
    )
    for pair in ((paint(), grey), (grey, paint()), (paint(), wide)):
        difference = colour_difference(*pair, ["45as15", "45as5"])
        flags = [vocabulary.QUALITY_FLAGS[flag] for flag in difference["lab_quality"].values]
        assert flags == ["measured", "extrapolated"]
    assert "lab_quality" not in colour_difference(grey, grey, ["45:0"]).coords
