"""Parameters of closed formulas, each with its error or a refusal."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import samples

from brdfpipe import facets, optics
from brdfpipe.bsdf import microfacet
from brdfpipe.exchange.read_table import ReadTable, as_bsdf
from brdfpipe.exchange.registry import ExchangeError, write


def test_every_formula_is_listed_with_its_error(tmp_path: Path) -> None:
    write(samples.beckmann_bsdf(0.2), tmp_path / "x.parameters.json")
    document = json.loads((tmp_path / "x.parameters.json").read_text())
    fits = {one["formula"]: one for one in document["fits"]}
    assert list(fits) == ["abg", "harvey", "k_correlation", "ggx", "beckmann"]
    assert fits["beckmann"]["parameters"]["alpha"] == pytest.approx(0.2 * np.sqrt(2), rel=0.02)
    assert fits["beckmann"]["error"]["median"] < fits["ggx"]["error"]["median"]
    for one in fits.values():
        assert one["error"]["directions"] > 1000
        assert ("refused" in one) != ("parameters" in one)
        assert 0 < one["error"]["delta_e_00"] < 30
    # At 45:0 the Beckmann lobe of the same slopes is the BSDF, but for light that is reflected more than once.
    assert fits["beckmann"]["error"]["delta_e_00"] < 1
    assert fits["beckmann"]["error"]["delta_e_00"] < fits["ggx"]["error"]["delta_e_00"]
    assert "spectrum" in document["left_out"]


def test_a_formula_of_another_colour_has_no_parameters(tmp_path: Path) -> None:
    write(samples.beckmann_bsdf(0.2), tmp_path / "x.parameters.json", largest_delta_e=0.6)
    fits = {one["formula"]: one for one in json.loads((tmp_path / "x.parameters.json").read_text())["fits"]}
    assert fits["ggx"]["refused"] == "the colour difference is above the limit of 0.6"
    assert "parameters" in fits["beckmann"]


@pytest.mark.parametrize("suffix", [".parameters.json", ".mtlx", ".gltf"])
def test_light_that_only_passes_is_not_fitted_as_a_black_surface(suffix: str, tmp_path: Path) -> None:
    axes = {"theta_i": np.linspace(0, 80, 5), "theta_o": np.linspace(0, 90, 10), "phi_o": np.linspace(0, 180, 7)}
    passing = as_bsdf(ReadTable("uniform", axes, np.full((5, 10, 7, 1), 0.1), side="transmission"), Path("x"))
    with pytest.raises(ExchangeError, match="scatters no light back"):
        write(passing, tmp_path / f"x{suffix}")
    assert not list(tmp_path.iterdir())


def test_a_smooth_metal_has_no_scattered_light_for_a_formula(tmp_path: Path) -> None:
    gold = microfacet.build(
        facets.flat(), index=optics.refractive_index({"n": 0.4, "k": 2.8}), multiple_scattering="none"
    )
    with pytest.raises(ExchangeError, match="scatters no light back"):
        write(gold, tmp_path / "x.parameters.json")


def test_a_formula_beyond_the_limit_has_no_parameters(tmp_path: Path) -> None:
    write(samples.beckmann_bsdf(0.2), tmp_path / "x.parameters.json", largest_error=0.06)
    fits = {one["formula"]: one for one in json.loads((tmp_path / "x.parameters.json").read_text())["fits"]}
    assert "the median error is above the limit of 0.06" in fits["k_correlation"]["refused"]
    assert "parameters" in fits["beckmann"]


def test_a_formula_that_reflects_too_much_has_no_parameters(tmp_path: Path) -> None:
    # The lobe of a grazing incidence outweighs the others: at normal incidence this fit reflects many times the light.
    write(samples.beckmann_bsdf(0.08), tmp_path / "x.parameters.json")
    fits = {one["formula"]: one for one in json.loads((tmp_path / "x.parameters.json").read_text())["fits"]}
    assert fits["k_correlation"]["error"]["median"] < 0.25 < fits["k_correlation"]["error"]["albedo"]
    assert fits["k_correlation"]["refused"] == "the error of the reflectance is above the limit of 0.25"
    assert fits["ggx"]["error"]["albedo"] < 0.25
    assert "parameters" in fits["ggx"]


def test_each_incidence_is_listed_with_its_parameters_or_a_refusal(tmp_path: Path) -> None:
    write(samples.beckmann_bsdf(0.2), tmp_path / "x.parameters.json", largest_error=0.1)
    fits = {one["formula"]: one for one in json.loads((tmp_path / "x.parameters.json").read_text())["fits"]}
    assert fits["abg"]["refused"] == "the error of the reflectance is above the limit of 0.1"
    listed = fits["abg"]["by_incidence"]["incidences"]
    assert [one["theta_i"] for one in listed] == [0, 15, 30, 45, 60, 75, 85]
    for one in listed:
        assert ("parameters" in one) == (max(one["error"]["median"], one["error"]["albedo"]) <= 0.1)
    # At 85 degree the lobe is lopsided, which no function of the distance from the mirror direction is.
    assert "parameters" not in listed[-1]
    assert "by_incidence" not in fits["ggx"]


def test_a_material_without_any_formula_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ExchangeError, match=r"no formula describes this material: the nearest, beckmann"):
        write(samples.beckmann_bsdf(0.2), tmp_path / "x.parameters.json", largest_error=1e-4)
    for option in ("largest_error", "largest_delta_e"):
        with pytest.raises(ExchangeError, match=f"{option} is 0"):
            write(samples.beckmann_bsdf(0.2), tmp_path / "x.parameters.json", **{option: 0})
    assert not list(tmp_path.iterdir())
