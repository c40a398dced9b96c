"""The checks detect violated laws, and pass sound BSDFs."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
import samples
import synthetic

from brdfpipe import facets
from brdfpipe.bsdf import lambert_gauss, microfacet
from brdfpipe.bsdf.base import QUADRATURE_ACCURACY, Representation
from brdfpipe.bsdf.microfacet.microsurface import NOT_PHYSICAL
from brdfpipe.bsdf.representations.microfacet import Microfacet
from brdfpipe.masking.modes import MODES


def verdicts(bsdf):
    return {name: entry["verdict"] for name, entry in json.loads(bsdf.bsdf.check().attrs["verdicts"]).items()}


def test_a_sound_model_passes_everything():
    assert set(verdicts(samples.beckmann_bsdf(0.2)).values()) == {"pass"}


def test_a_neutral_model_is_checked_too():
    assert verdicts(samples.beckmann_bsdf(0.2, reflectance=None)) == {
        "reciprocity": "pass",
        "energy": "pass",
        "positivity": "pass",
        "grazing": "pass",
        "integral": "pass",
    }


def test_a_brdf_that_does_not_integrate_to_its_albedo_fails(monkeypatch):
    right = Microfacet.evaluate
    monkeypatch.setattr(Microfacet, "evaluate", lambda *arguments: 3 * right(*arguments))
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
    assert re.search(r"differ by at most \d{2}% of their mean, between", texts(table)["reciprocity"])
    dark = table.copy(deep=True)
    dark["brdf"][4:] = 0.0
    assert "differ by at most 200% of their mean (one is without light), between" in texts(dark)["reciprocity"]


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


def test_a_clamped_diffuse_part_warns_about_closure():
    bsdf = samples.beckmann_bsdf(0.2, reflectance=0.01)
    assert verdicts(bsdf)["closure"] == "warn"
    assert float(bsdf.bsdf.check()["closure_residual"]) == pytest.approx(0.037, abs=0.005)


@pytest.mark.parametrize(("miss", "verdict"), [(5e-6, "pass"), (5e-4, "warn"), (1.5e-2, "fail")])
def test_closure_is_judged_by_the_light_that_is_missed(miss, verdict):
    bsdf = samples.beckmann_bsdf(0.2)
    bsdf["total_reflectance"] = bsdf["total_reflectance"] + miss
    assert verdicts(bsdf)["closure"] == verdict


def texts(bsdf):
    return {name: entry["text"] for name, entry in json.loads(bsdf.bsdf.check().attrs["verdicts"]).items()}


@pytest.mark.parametrize("options", [{"masking": "none"}, {"masking": "crf"}, {"recipe": "crf"}])
def test_a_violation_by_an_unphysical_mode_is_a_warning_with_its_angle(options):
    bsdf = microfacet.build(facets.analytic("beckmann", 0.3), index=1.55, spectrum=samples.spectrum(0.3), **options)
    by_check = verdicts(bsdf)
    assert "fail" not in by_check.values()
    assert by_check["energy"] == by_check["grazing"] == "warn"
    name, value = next(iter(options.items()))
    assert f"maximum at θ_i = 89.99°; a known property of {name} {value}" in texts(bsdf)["energy"]
    assert "= 90°" in texts(bsdf)["grazing"]


def test_the_masking_of_the_patent_is_not_reciprocal_and_says_where():
    bsdf = microfacet.build(facets.analytic("beckmann", 0.3), index=1.55, masking="crf")
    assert verdicts(bsdf)["reciprocity"] == "warn"
    assert "between θ = " in texts(bsdf)["reciprocity"]


def test_the_same_excess_without_such_a_mode_fails(monkeypatch):
    bsdf = synthetic.register(monkeypatch, lambda _i, o: 1 / (np.pi * np.abs(o[..., 2])))
    # ∫ dω / π = 2 over the hemisphere.
    assert verdicts(bsdf)["energy"] == "fail"
    assert verdicts(bsdf)["grazing"] == "warn"
    assert float(bsdf.bsdf.check()["albedo"][3]) == pytest.approx(2.0, rel=1e-6)


def test_undefined_values_at_grazing_fail(monkeypatch):
    def brdf(_w_i, w_o):
        return np.where(w_o[..., 2] < 1e-3, np.nan, 0.1)

    bsdf = synthetic.register(monkeypatch, brdf)
    assert verdicts(bsdf)["grazing"] == "fail"


def test_light_through_an_interface_is_reciprocal_over_the_square_of_the_index(monkeypatch):
    bsdf = microfacet.build(facets.analytic("beckmann", 0.05), index=1.5, transparent=True)
    checked = bsdf.bsdf.check()
    assert json.loads(checked.attrs["verdicts"])["reciprocity"]["verdict"] == "pass"
    assert float((checked["albedo"] + checked["transmittance"]).max()) <= 1 + 1e-6
    # Without the square of the index the two ways differ by n² = 2.25: 2 · 1.25 / 3.25 of their mean.
    monkeypatch.setattr(Representation, "index_below", lambda *_: 1.0)
    assert float(bsdf.bsdf.check()["reciprocity_residual"]) == pytest.approx(2 * 1.25 / 3.25, rel=1e-3)


def test_a_lay_is_checked_at_several_azimuths():
    surface = facets.analytic("beckmann", a_x=0.1, a_y=0.3)
    with samples.coarse_albedo_tables():
        bsdf = microfacet.build(surface, index=1.5, spectrum=samples.spectrum(0.3), multiple_scattering="none")
    assert set(verdicts(bsdf).values()) == {"pass"}
    # Too bright at one azimuth: only a check at several azimuths detects it.
    bright = bsdf.copy()
    bright["diffuse"] = bright["diffuse"] * 0 + 1.2
    bright["diffuse"].attrs = bsdf["diffuse"].attrs
    assert "φ_i = " in texts(bright)["energy"]


def test_a_smooth_surface_is_sound():
    assert set(verdicts(microfacet.build(facets.flat(), index=1.5, spectrum=samples.spectrum(0.3))).values()) == {
        "pass"
    }


COARSE = {"theta_i": [0.0, 40.0, 86.0], "theta_o": [0.0, 40.0, 86.0], "phi_o": [0.0, 90.0, 180.0]}


@pytest.fixture
def spectral_table():
    """A white Lambertian at half, as a table: sound in every respect."""
    return lambert_gauss.lambertian(samples.spectrum(0.5)).bsdf.tabulate(COARSE)


def test_a_sound_table_passes_everything(spectral_table):
    assert set(verdicts(spectral_table).values()) == {"pass"}


@pytest.mark.parametrize("at", [0, 17, 84])
def test_a_negative_value_at_one_wavelength_fails(spectral_table, at):
    spectral_table["brdf"][..., at] = -0.01
    by_check = verdicts(spectral_table)
    assert by_check["positivity"] == "fail"
    # Its albedo is -0.01 π.
    assert by_check["energy"] == "fail"
    assert "negative reflectance or transmittance, -0.031 at" in texts(spectral_table)["energy"]


def test_a_single_negative_node_at_one_wavelength_fails(spectral_table):
    # Between a positive neighbour of 0.5 / π and -1e-6 no direction but the node itself is negative.
    spectral_table["brdf"][1, 1, 1, 30] = -1e-6
    check = spectral_table.bsdf.check()
    assert float(check["floor"]) == pytest.approx(-1e-6)
    assert verdicts(spectral_table)["positivity"] == "fail"


@pytest.mark.parametrize("at", [0, 84])
def test_a_pair_that_differs_at_an_outer_wavelength_is_not_reciprocal(spectral_table, at):
    spectral_table["brdf"][1, :, :, at] *= 0.5
    assert verdicts(spectral_table)["reciprocity"] == "warn"


def test_growth_towards_grazing_at_an_outer_wavelength_is_detected(monkeypatch):
    bsdf = samples.beckmann_bsdf(0.2)
    right, last = Microfacet.evaluate, float(bsdf["wavelength"][-1])

    def wrong(self, theta_i, phi_i, theta_o, phi_o, wavelength):
        own = bsdf["wavelength"].values if wavelength is None else wavelength
        growth = np.where(own == last, 1 / np.cos(np.radians(np.asarray(theta_o)))[..., None], 1.0)
        return right(self, theta_i, phi_i, theta_o, phi_o, wavelength) * growth

    monkeypatch.setattr(Microfacet, "evaluate", wrong)
    by_check = verdicts(bsdf)
    assert by_check["grazing"] == "warn"
    assert by_check["integral"] == "fail"


def constant(value):
    return lambda w_i, w_o: np.full(np.broadcast_shapes(w_i.shape, w_o.shape)[:-1], value)


def polar(direction):
    return np.degrees(np.arccos(np.clip(direction[..., 2], -1, 1)))


def test_a_small_negative_cap_about_the_normal_fails(monkeypatch):
    bsdf = synthetic.register(monkeypatch, lambda _i, o: np.where(polar(o) < 1, -1.0, 0.2))
    assert verdicts(bsdf)["positivity"] == "fail"


def test_a_gain_between_the_fixed_incidences_fails(monkeypatch):
    bsdf = synthetic.register(
        monkeypatch, lambda i, o: np.where(np.abs(polar(i) - 86.5) < 0.8, 2.0, 0.2) * constant(1 / np.pi)(i, o)
    )
    assert verdicts(bsdf)["energy"] == "fail"
    assert "maximum at θ_i = 86." in texts(bsdf)["energy"]


def test_a_table_is_checked_at_its_own_incidences(spectral_table):
    # Largest on the node at 40, which no fixed incidence is: 0.5 · 2.002 there, and below 1 two degrees away and more.
    spectral_table["brdf"][1] *= 2.002
    assert "maximum at θ_i = 40°" in texts(spectral_table)["energy"]


def test_an_albedo_without_quadrature_may_exceed_one_by_less(monkeypatch):
    def with_excess(excess):
        def albedo(_bsdf, theta_i, _phi_i, _wavelength):
            return np.full((*np.shape(theta_i), 1), 1 + excess)

        return synthetic.register(monkeypatch, constant(1 / np.pi), albedo=albedo, albedo_needs_quadrature=False)

    assert verdicts(with_excess(0.5e-8))["energy"] == "pass"
    assert verdicts(with_excess(QUADRATURE_ACCURACY / 2))["energy"] == "fail"


def test_a_gain_of_a_lay_off_its_axes_fails(monkeypatch):
    def albedo(_bsdf, theta_i, phi_i, _wavelength):
        bright = (np.abs(theta_i - 85) < 4) & (np.abs(phi_i % 360 - 200) < 15)
        return np.where(bright, 1.01, 0.5)[..., None]

    bsdf = synthetic.register(
        monkeypatch, constant(0.5 / np.pi), albedo=albedo, albedo_needs_quadrature=False, isotropic=False
    )
    assert verdicts(bsdf)["energy"] == "fail"


def test_a_negative_albedo_fails(monkeypatch):
    bsdf = synthetic.register(
        monkeypatch,
        constant(0.0),
        albedo=lambda _self, theta_i, _phi_i, _wavelength: np.where(np.asarray(theta_i) > 80, -1e-3, 0.0)[..., None],
        albedo_needs_quadrature=False,
    )
    assert verdicts(bsdf)["energy"] == "fail"


def test_every_unphysical_masking_is_a_known_masking():
    assert set(NOT_PHYSICAL) < set(MODES["masking"])
