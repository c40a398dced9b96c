"""The checks find what is wrong, and only that."""

from __future__ import annotations

import json

import numpy as np
import pytest
import samples

from brdfpipe.bsdf import lambert_gauss, microfacet


def verdicts(bsdf):
    return {name: entry["verdict"] for name, entry in json.loads(bsdf.bsdf.check().attrs["verdicts"]).items()}


def test_a_sound_model_passes_everything():
    assert set(verdicts(samples.beckmann_bsdf(0.2)).values()) == {"pass"}


def test_a_neutral_model_is_checked_too():
    assert verdicts(samples.beckmann_bsdf(0.2, reflectance=None)) == {
        "reciprocity": "pass",
        "energy": "pass",
        "positivity": "pass",
        "integral": "pass",
    }


def test_a_brdf_that_does_not_integrate_to_its_albedo_fails(monkeypatch):
    right = microfacet.evaluate
    monkeypatch.setattr(microfacet, "evaluate", lambda *arguments: 3 * right(*arguments))
    assert verdicts(samples.beckmann_bsdf(0.2))["integral"] == "fail"


def test_energy_above_one_fails():
    assert verdicts(lambert_gauss.lambertian(samples.spectrum(1.05)))["energy"] == "fail"


def test_a_one_sided_lobe_is_not_reciprocal():
    bsdf = samples.beckmann_bsdf(0.2).bsdf.nonspectral()
    table = bsdf.bsdf.tabulate(
        {"theta_i": np.arange(0, 90, 10.0), "theta_o": np.arange(0, 90, 5.0), "phi_o": np.arange(0, 361, 20.0)}
    )
    table["brdf"] = table["brdf"] * (1 + table["theta_i"] / 90)
    table["brdf"].attrs = {"units": "sr-1"}
    assert verdicts(table)["reciprocity"] == "warn"


def test_a_negative_value_fails():
    table = (
        samples.beckmann_bsdf(0.2)
        .bsdf.nonspectral()
        .bsdf.tabulate({"theta_i": [0.0, 80.0], "theta_o": [0.0, 40.0, 85.0], "phi_o": [0.0, 360.0]})
    )
    table["brdf"][0, 1, :] = -1.0
    check = table.bsdf.check()
    assert verdicts(table)["positivity"] == "fail"
    assert float(check["negative_fraction"]) > 0
    assert float(check["floor"]) < 0


def test_a_clamped_diffuse_part_shows_as_a_reflectance_that_does_not_close():
    bsdf = samples.beckmann_bsdf(0.2, reflectance=0.01)
    assert verdicts(bsdf)["closure"] == "warn"
    assert float(bsdf.bsdf.check()["closure_residual"]) == pytest.approx(0.037, abs=0.005)
