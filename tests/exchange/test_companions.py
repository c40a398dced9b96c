"""The small tables beside a BRDF file."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import samples

from brdfpipe import exchange
from brdfpipe.bsdf import fitting


def test_the_total_reflectance_is_the_one_the_material_was_given(tmp_path):
    reflectance = np.linspace(0.1, 0.7, samples.WAVELENGTH.size)
    bsdf = samples.beckmann_bsdf(0.2, reflectance=reflectance).assign_attrs(material="grey", digest="abc")
    exchange.write_total_reflectance(bsdf, tmp_path / "r.csv")
    read = pd.read_csv(tmp_path / "r.csv", comment="#")
    assert read["wavelength_nm"].values.tolist() == samples.WAVELENGTH.tolist()
    assert read["total_reflectance"].values == pytest.approx(reflectance, abs=1e-8)
    assert "digest of the source abc" in (tmp_path / "r.csv").read_text()


def test_the_fit_is_a_row_an_incidence(tmp_path):
    fit = fitting.fit_lambert_gauss(samples.beckmann_bsdf(0.1), [0.0, 30.0])
    exchange.write_lambert_gauss(fit, tmp_path / "f.csv")
    read = pd.read_csv(tmp_path / "f.csv", comment="#")
    assert read["theta_i_deg"].tolist() == [0, 30]
    assert read["gauss_peak_per_sr"].values == pytest.approx(fit["gauss_peak"].values, rel=1e-8)
    assert (read["relative_residual"] > 0).all()
