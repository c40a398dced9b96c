"""Figures of a BSDF show its values, and their files are the same each time."""

from __future__ import annotations

import numpy as np
import pytest
import samples

from brdfpipe.bsdf import lambert_gauss
from brdfpipe.errors import BrdfpipeError, InputError, VocabularyError
from brdfpipe.figures import bsdf_plots
from brdfpipe.figures.bsdf_plots import KINDS, BSDFPlots

pytest.importorskip("matplotlib")


def plots(**options) -> BSDFPlots:
    return samples.beckmann_bsdf(0.1, **options).bsdf.plot


def test_a_cut_has_the_values_of_the_bsdf():
    bsdf = samples.beckmann_bsdf(0.1)
    (ax,) = bsdf.bsdf.plot.cartesian([0, 45], wavelength=None).axes
    assert ax.get_ylabel() == "BRDF [sr⁻¹]"
    line = ax.lines[1]
    assert line.get_label() == "45°"
    theta, values = line.get_xdata(), line.get_ydata()
    expected = bsdf.bsdf.evaluate(45, 180, np.abs(theta), np.where(theta >= 0, 0, 180))
    expected = expected.isel(wavelength=0) if "wavelength" in expected.dims else expected
    np.testing.assert_allclose(values, expected, rtol=1e-9)
    assert abs(theta[np.nanargmax(values)] - 45) < 5


def test_a_goniometric_figure_has_the_logarithm_as_radius():
    (ax,) = plots().polar([30]).axes
    (line,) = ax.lines
    angle, radius = np.degrees(line.get_xdata()), line.get_ydata()
    at = np.argmin(np.abs(angle - 30))
    value = samples.beckmann_bsdf(0.1).bsdf.evaluate(30, 180, 30, 0)
    assert radius[at] == pytest.approx(np.log10(float(np.ravel(value)[0])), abs=1e-6)


def test_a_map_is_brightest_at_the_lobe_and_a_narrow_one_is_not_missed():
    figure = samples.beckmann_bsdf(0.003).bsdf.plot.map(45)
    values = figure.axes[0].collections[0].get_array()
    assert float(np.nanmax(values)) > 0.99 * float(
        np.ravel(samples.beckmann_bsdf(0.003).bsdf.evaluate(45, 180, 45, 0))[0]
    )
    zoomed = samples.beckmann_bsdf(0.003).bsdf.plot.map(45, about_mirror=1.0)
    share = [np.mean(np.asarray(one.axes[0].collections[0].get_array()) > 1.0) for one in (figure, zoomed)]
    assert share[1] > 10 * share[0]


def test_a_lay_is_shown_along_and_across():
    figure = samples.brushed_bsdf(0.05, 0.3).bsdf.plot.cartesian(30)
    assert [ax.get_title() for ax in figure.axes] == [
        "plane of incidence along the lay",
        "plane of incidence across the lay",
    ]


@pytest.mark.parametrize("kind", KINDS)
def test_every_figure_is_shown_and_written(kind, tmp_path):
    figure = BSDFPlots(lambert_gauss.lambertian(samples.spectrum(0.5)))(kind)
    assert figure._repr_png_().startswith(b"\x89PNG")
    figure.save(tmp_path / "one.svg")
    BSDFPlots(lambert_gauss.lambertian(samples.spectrum(0.5)))(kind).save(tmp_path / "two.svg")
    assert (tmp_path / "one.svg").read_bytes() == (tmp_path / "two.svg").read_bytes()


def test_refusals(tmp_path, monkeypatch):
    with pytest.raises(BrdfpipeError, match="from 0 to below 90 degree"):
        plots().polar([90])
    with pytest.raises(BrdfpipeError, match="accepted: polar, cartesian, lobe, map, preview"):
        plots()("pie")
    with pytest.raises(InputError, match=r"accepted: \.svg, \.png, \.pdf"):
        plots().polar().save(tmp_path / "a.bmp")
    with pytest.raises(BrdfpipeError, match="the data cover"):
        BSDFPlots(lambert_gauss.lambertian(samples.spectrum(0.5))).polar(wavelength=5000)
    monkeypatch.setattr(bsdf_plots, "find_spec", lambda name: None)
    with pytest.raises(BrdfpipeError, match=r"pip install 'brdfpipe\[plot\]'"):
        plots()


@pytest.mark.parametrize("kind", ["lobe", "map"])
def test_a_figure_of_one_incidence_refuses_several(kind: str):
    with pytest.raises(VocabularyError, match="lobe and map show one angle of incidence; found 2"):
        plots()(kind, theta_i=[20, 50])
