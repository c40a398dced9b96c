"""The small tables beside a BRDF file."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd
import pytest
import samples

from brdfpipe import exchange, facets, optics, vocabulary
from brdfpipe.bsdf import lambert_gauss_fit as fitting
from brdfpipe.bsdf import microfacet, slab
from brdfpipe.bsdf.input_uncertainty import uncertainty


def test_the_total_reflectance_is_the_one_the_material_was_given(tmp_path):
    reflectance = np.linspace(0.1, 0.7, samples.WAVELENGTH.size)
    bsdf = samples.beckmann_bsdf(0.2, reflectance=reflectance).assign_attrs(material="grey", digest="abc")
    exchange.write_total_reflectance(bsdf, tmp_path / "r.csv")
    read = pd.read_csv(tmp_path / "r.csv", comment="#")
    assert read["wavelength_nm"].values.tolist() == samples.WAVELENGTH.tolist()
    assert read["total_reflectance"].values == pytest.approx(reflectance, abs=1e-8)
    assert "digest of the source abc" in (tmp_path / "r.csv").read_text()


@pytest.mark.parametrize("stated", [True, False])
def test_the_total_reflectance_has_an_uncertainty_if_its_spectrum_has(tmp_path, stated):
    spectrum = samples.spectrum(0.3)
    known = spectrum.assign(total_reflectance_u=0 * spectrum["total_reflectance"] + 0.004) if stated else spectrum
    bsdf = samples.beckmann_bsdf(0.2)
    changes = uncertainty(
        bsdf, index=optics.refractive_index(1.5, uncertainty=0.01), spectrum=vocabulary.label(known, "spectrum")
    )
    uncertain = bsdf.merge(changes, combine_attrs="override")
    missing = changes.attrs["uncertainty_not_stated"]
    exchange.write_total_reflectance(uncertain.assign_attrs(uncertainty_not_stated=missing), tmp_path / "r.csv")
    read = pd.read_csv(tmp_path / "r.csv", comment="#")
    assert ("total_reflectance_u" in read) == stated
    if stated:
        # The index moves light between the surface and the base, and leaves their sum.
        assert read["total_reflectance_u"].values == pytest.approx(0.004, rel=1e-3)


def test_the_fit_is_a_row_an_incidence(tmp_path):
    fit = fitting.fit_lambert_gauss(samples.beckmann_bsdf(0.1), [0.0, 30.0])
    exchange.write_lambert_gauss(fit, tmp_path / "f.csv")
    read = pd.read_csv(tmp_path / "f.csv", comment="#")
    assert read["theta_i_deg"].tolist() == [0, 30]
    assert read["gauss_peak_per_sr"].values == pytest.approx(fit["gauss_peak"].values, rel=1e-8)
    assert (read["relative_residual"] > 0).all()


def test_what_a_polished_surface_mirrors_has_a_column_of_its_own(tmp_path):
    polished = microfacet.build(facets.flat(), index=1.5, spectrum=samples.spectrum(0.3))
    exchange.write_total_reflectance(polished, tmp_path / "r.csv")
    read = pd.read_csv(tmp_path / "r.csv", comment="#")
    assert read["total_reflectance"].values == pytest.approx(0.3, abs=1e-9)
    assert read["specular_reflectance"].values == pytest.approx(0.0400063, abs=1e-6)
    fit = fitting.fit_lambert_gauss(polished, [0.0, 60.0])
    exchange.write_lambert_gauss(fit, tmp_path / "f.csv", model=polished)
    # The fit of a polished body is its Lambertian base, and its colour off the lobe.
    assert re.search(r"CIEDE2000 [0-9.]+ of greys of both luminances at 45:0", (tmp_path / "f.csv").read_text())
    read = pd.read_csv(tmp_path / "f.csv", comment="#")
    assert read["specular_reflectance"].values == pytest.approx([0.04, optics.fresnel(0.5, 1.5).mean], abs=1e-9)


def test_fits_of_a_surface_with_a_lay_stand_by_azimuth(tmp_path):
    bsdf = samples.brushed_bsdf(0.05, 0.2, 20.0)
    fits = {azimuth: fitting.fit_lambert_gauss(bsdf, [30.0], azimuth) for azimuth in (20.0, 110.0)}
    exchange.write_lambert_gauss(fits[20.0], tmp_path / "f.csv", model=bsdf, azimuths=fits)
    text, read = (tmp_path / "f.csv").read_text(), pd.read_csv(tmp_path / "f.csv", comment="#")
    assert "NOT isotropic" in text
    assert read["phi_i_deg"].tolist() == [20, 110]
    assert read["fwhm_parallel_deg"][0] < read["fwhm_parallel_deg"][1] / 2


def test_the_total_transmittance_is_that_of_a_clear_plate(tmp_path):
    plate = slab.build(facets.flat(), facets.flat(), index=1.5)
    exchange.write_total_transmittance(plate, tmp_path / "t.csv")
    read = pd.read_csv(tmp_path / "t.csv", comment="#")
    # Without absorption T = (1 − r) / (1 + r), r = 0.04: all of it straight.
    assert read["total_transmittance"].values == pytest.approx(0.96 / 1.04, abs=1e-9)
    assert read["specular_transmittance"].values == pytest.approx(0.96 / 1.04, abs=1e-9)
    assert "D1003-style haze" in (tmp_path / "t.csv").read_text()
