"""The summary of a BSDF: its properties and reflectances, and harmless HTML."""

from __future__ import annotations

import samples

from brdfpipe.bsdf import lambert_gauss, summary
from brdfpipe.bsdf.lambert_gauss_fit import fit_lambert_gauss


def test_the_summary_states_kind_sides_wavelengths_and_reflectance():
    bsdf = lambert_gauss.lambertian(samples.spectrum(0.3)).assign_attrs(material="panel", route="predicted")
    text = repr(bsdf.bsdf)
    assert text.startswith("<BSDF: panel>")
    for words in ("lambert_gauss", "predicted", "reflection", "nm, ", "no lay", "not stated", "at 45°", "0.3000"):
        assert words in text


def test_a_lay_and_uncertainties_are_named():
    assert "30°" in summary.properties(samples.brushed_bsdf(0.05, 0.3, 30.0))["lay"]


def test_a_fit_of_a_surface_with_a_lay_does_not_say_that_there_is_none():
    fit = fit_lambert_gauss(samples.brushed_bsdf(0.05, 0.3, 30.0), [30.0], azimuth=30.0)
    assert summary.properties(fit)["lay"] == "that of the source is left out: for light from azimuth 30° alone"
    assert summary.properties(fit_lambert_gauss(samples.glossy_bsdf(0.1, 1.5), [30.0]))["lay"] == "no lay"


def test_the_html_holds_no_markup_of_the_dataset():
    hostile = lambert_gauss.lambertian(samples.spectrum(0.3)).assign_attrs(
        material="<script>alert(1)</script>", warnings='["<img src=x onerror=alert(1)>"]'
    )
    html = hostile.bsdf._repr_html_()
    assert "<script" not in html
    assert "<img" not in html
    assert "0.3000" in html
