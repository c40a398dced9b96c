"""Parameters of closed formulas, each with its error or a refusal."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import samples

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
    assert "spectrum" in document["left_out"]


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


def test_a_material_without_any_formula_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ExchangeError, match=r"no formula describes this material: the nearest, beckmann"):
        write(samples.beckmann_bsdf(0.2), tmp_path / "x.parameters.json", largest_error=1e-4)
    with pytest.raises(ExchangeError, match="largest_error is 0"):
        write(samples.beckmann_bsdf(0.2), tmp_path / "x.parameters.json", largest_error=0)
    assert not list(tmp_path.iterdir())
