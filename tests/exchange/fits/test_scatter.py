"""Formulas of scattered light: their own parameters are found in tables of them."""

from __future__ import annotations

from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest
import samples

from brdfpipe.bsdf.table_error import Pairs
from brdfpipe.exchange.fits.light import ReflectedLight
from brdfpipe.exchange.fits.scatter import (
    FORMULAS,
    LISTED_INCIDENCES,
    distance,
    error_by_incidence,
    fit_formula,
    reflectance_of,
)
from brdfpipe.exchange.read_table import ReadTable, as_bsdf
from brdfpipe.exchange.registry import ExchangeError

LOBES = {"abg": (0.05, 0.02, 2.5), "harvey": (3.0, 0.15, 2.2), "k_correlation": (3.0, 0.2, 2.5)}
BASE = 0.1


def table_of(name: str):
    """A fine table about the mirror direction of a formula over a Lambertian part."""
    theta_i, theta_s, phi_s = (
        np.linspace(0, 88, 23),
        np.concatenate([np.linspace(0, 20, 41), np.linspace(21, 170, 90)]),
        np.linspace(0, 180, 37),
    )
    from brdfpipe.bsdf.grids import GRIDS

    nodes = dict(zip(("theta_i", "theta_s", "phi_s"), np.meshgrid(theta_i, theta_s, phi_s, indexing="ij"), strict=True))
    pairs = Pairs(*(np.asarray(angle) for angle in GRIDS["specular"].directions(nodes)))
    cosines = (np.cos(np.radians(np.minimum(angle, 89.9))) for angle in (pairs.theta_i, pairs.theta_o))
    values = FORMULAS[name].lobe(distance(pairs), *cosines, LOBES[name]) + BASE / np.pi
    axes = {"theta_i": theta_i, "theta_s": theta_s, "phi_s": phi_s}
    return as_bsdf(ReadTable("specular", axes, values[..., None]), Path("x"))


def test_the_distance_is_zero_in_the_mirror_direction() -> None:
    at = Pairs(*(np.array(angles) for angles in ([30.0, 30.0], [10.0, 10.0], [30.0, 50.0], [190.0, 190.0])))
    assert distance(at) == pytest.approx([0.0, np.sin(np.radians(50)) - 0.5], abs=1e-12)


@pytest.mark.parametrize("name", FORMULAS)
def test_its_own_parameters_are_found(name: str) -> None:
    found = fit_formula(ReflectedLight(table_of(name)), name)
    *lobe, base = found.parameters.values()
    assert base == pytest.approx(BASE, rel=0.05)
    assert lobe[2] == pytest.approx(LOBES[name][2], rel=0.05)
    # Peak and width of a lobe are correlated; the peak of ABg is A/B.
    peak = lobe[0] / lobe[1] if name == "abg" else lobe[0]
    expected = LOBES[name][0] / LOBES[name][1] if name == "abg" else LOBES[name][0]
    assert peak == pytest.approx(expected, rel=0.1)
    assert found.error.median < 0.02
    assert found.error.albedo < 0.05
    assert found.error.peak < 0.1


@pytest.mark.parametrize("name", FORMULAS)
def test_one_incidence_has_its_own_parameters(name: str) -> None:
    found = fit_formula(ReflectedLight(table_of(name)), name, 40.0)
    assert found.error.median < 0.02
    # Peak and width are correlated, and the table is interpolated about its peak.
    assert found.error.peak < 0.1
    peak = FORMULAS[name].lobe(np.zeros(1), np.cos(np.radians(40)), np.cos(np.radians(40)), LOBES[name])
    fitted = FORMULAS[name].lobe(
        np.zeros(1), np.cos(np.radians(40)), np.cos(np.radians(40)), tuple(found.parameters.values())[:3]
    )
    assert fitted == pytest.approx(peak, rel=0.1)


def test_a_lobe_whose_width_follows_the_incidence_needs_parameters_by_incidence() -> None:
    """Facets of slope 0.2: one width in direction cosines misses the peak at normal incidence many times over."""
    light = ReflectedLight(samples.beckmann_bsdf(0.2))
    of_all = fit_formula(light, "abg")
    listed = {float(at): fit_formula(light, "abg", float(at)).parameters for at in LISTED_INCIDENCES}
    between = error_by_incidence(light, "abg", listed)
    assert of_all.error.peak > 3
    assert between.peak < 0.5
    assert between.albedo < 0.25 * of_all.error.albedo
    assert between.directions == of_all.error.directions


def test_incidences_beyond_the_list_have_the_parameters_of_its_ends() -> None:
    light, parameters = (
        ReflectedLight(table_of("harvey")),
        dict(zip(("b0", "l", "s", "L"), (*LOBES["harvey"], BASE), strict=True)),
    )
    one, three = (
        error_by_incidence(light, "harvey", dict.fromkeys(at, parameters)) for at in ((30.0,), (10.0, 30.0, 50.0))
    )
    assert astuple(one) == pytest.approx(astuple(three))
    assert one.median < 0.02


def test_the_reflectance_of_a_lobe_is_its_integral() -> None:
    # Harvey at normal incidence in closed form: the rings about the normal end at the horizon, x = 1.
    for width, slope in ((0.02, 3.0), (0.1, 2.5), (0.5, 1.5)):
        expected = 2 * np.pi * width**2 / (slope - 2) * (1 - (1 + width**-2) ** (1 - slope / 2))
        found = reflectance_of(FORMULAS["harvey"], (1.0, width, slope), np.zeros(1))
        assert found == pytest.approx([expected], rel=0.01)
    # The K-correlation of a lobe without width or slope is b0 cos θ_i cos θ_o, whose integral is 2π/3 b0 cos θ_i.
    incidences = np.array([0.0, 40.0, 75.0])
    found = reflectance_of(FORMULAS["k_correlation"], (1.0, 1e6, 1.0), incidences)
    assert found == pytest.approx(2 * np.pi / 3 * np.cos(np.radians(incidences)), rel=0.01)


def test_the_wrong_formula_has_a_larger_error() -> None:
    light = ReflectedLight(table_of("k_correlation"))
    assert fit_formula(light, "abg").error.median > 3 * fit_formula(light, "k_correlation").error.median


def test_a_lay_is_refused() -> None:
    with pytest.raises(ExchangeError, match="lay"):
        ReflectedLight(samples.brushed_bsdf(0.3, 0.1))
