"""Parameters of closed formulas, each with its error or a refusal."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import samples
from damaged_files import check_garbled_models

from brdfpipe import facets, optics
from brdfpipe.bsdf import microfacet
from brdfpipe.bsdf.table_error import errors_at, fresh_pairs
from brdfpipe.errors import InputError
from brdfpipe.exchange.fits import gauss
from brdfpipe.exchange.fits.scatter import FORMULAS, at_incidence
from brdfpipe.exchange.read_table import ReadTable, as_bsdf
from brdfpipe.exchange.reading import read
from brdfpipe.exchange.records import errors_in_brief
from brdfpipe.exchange.registry import FORMATS, ExchangeError, write


def test_every_formula_is_listed_with_its_error(tmp_path: Path) -> None:
    write(samples.beckmann_bsdf(0.2), tmp_path / "x.parameters.json")
    document = json.loads((tmp_path / "x.parameters.json").read_text())
    fits = {one["formula"]: one for one in document["fits"]}
    assert list(fits) == ["abg", "harvey", "k_correlation", "lambert_gauss", "ggx", "beckmann"]
    assert fits["beckmann"]["parameters"]["alpha"] == pytest.approx(0.2 * np.sqrt(2), rel=0.02)
    assert fits["beckmann"]["error"]["median"] < fits["ggx"]["error"]["median"]
    for one in fits.values():
        assert one["error"]["directions"] > 1000
        assert ("refused" in one) != bool({"parameters", "incidences"} & set(one))
        assert 0 < one["error"]["delta_e_00"] < 30
    # At 45:0 the Beckmann lobe of the same slopes is the BSDF, but for light that is reflected more than once.
    assert fits["beckmann"]["error"]["delta_e_00"] < 1
    assert fits["beckmann"]["error"]["delta_e_00"] < fits["ggx"]["error"]["delta_e_00"]
    assert "spectrum" in document["left_out"]


def test_a_cell_of_the_page_names_the_median_of_each_fit_and_those_beyond_a_limit(tmp_path: Path) -> None:
    record = FORMATS["parameters"].write(samples.beckmann_bsdf(0.2), tmp_path / "x", largest_error=0.06)[
        "x.parameters.json"
    ]
    text = errors_in_brief(record)
    fits = {one["formula"]: one for one in record["fits"]}
    for name in ("beckmann", "lambert_gauss"):
        assert f"{name} {fits[name]['error']['median']:.1%}" in text
    # Of both ways the one with the smaller error.
    assert f"abg by incidence {fits['abg']['by_incidence']['error']['median']:.1%}" in text
    assert text.index("beckmann") < text.index("abg by incidence") < text.index("beyond a limit: ggx")
    assert len(text) < 200


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


def test_lambert_and_gaussian_is_listed_by_incidence_or_refused(tmp_path: Path) -> None:
    bsdf = samples.beckmann_bsdf(0.2)
    write(bsdf, tmp_path / "x.parameters.json")
    (one,) = (
        fit for fit in json.loads((tmp_path / "x.parameters.json").read_text())["fits"] if "gauss" in fit["formula"]
    )
    assert [row["theta_i"] for row in one["incidences"]] == [0, 15, 30, 45, 60, 75, 85]
    # The stated error is that of the rows as they are written.
    rows = {row["theta_i"]: row["parameters"] for row in one["incidences"]}
    grey = bsdf.bsdf.nonspectral()
    pairs = fresh_pairs(grey, 3)
    again = errors_at(grey, gauss.evaluation(rows), pairs)
    assert np.median(again) == pytest.approx(one["error"]["median"], rel=0.2)
    assert one["error"]["delta_e_00"] > 3
    write(bsdf, tmp_path / "x.parameters.json", largest_delta_e=3.0)
    (one,) = (
        fit for fit in json.loads((tmp_path / "x.parameters.json").read_text())["fits"] if "gauss" in fit["formula"]
    )
    assert one["refused"] == "the colour difference is above the limit of 3"
    assert "incidences" not in one


def test_a_material_without_any_formula_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ExchangeError, match=r"no formula describes this material: the nearest, lambert_gauss"):
        write(samples.beckmann_bsdf(0.2), tmp_path / "x.parameters.json", largest_error=1e-4)
    for option in ("largest_error", "largest_delta_e"):
        with pytest.raises(ExchangeError, match=f"{option} is 0"):
            write(samples.beckmann_bsdf(0.2), tmp_path / "x.parameters.json", **{option: 0})
    assert not list(tmp_path.iterdir())


HARVEY = {"b0": 0.8, "l": 0.1, "s": 2.0, "L": 0.2}
GAUSS = {"G0": 0.8, "s_par": 8.0, "s_perp": 6.0, "L": 0.2}
HARVEY_AT_60 = {"b0": 2.0, "l": 0.08, "s": 2.5, "L": 0.15}


def _document() -> dict:
    rows = [
        {"theta_i": 0, "parameters": HARVEY},
        {"theta_i": 30, "refused": "off"},
        {"theta_i": 60, "parameters": HARVEY_AT_60},
    ]
    listed = {"error": {"percentile_95": 0.1}, "incidences": rows}
    harvey = {"formula": "harvey", "parameters": HARVEY, "error": {"percentile_95": 0.5}, "by_incidence": listed}
    abg = {"formula": "abg", "refused": "the median error is above the limit", "error": {"percentile_95": 2.0}}
    ggx = {"formula": "ggx", "parameters": {"alpha": 0.3, "n": 1.5, "L": 0.2}, "error": {"percentile_95": 0.3}}
    gaussians = {
        "formula": "lambert_gauss",
        "error": {"percentile_95": 0.6},
        "incidences": [{"theta_i": 0, "parameters": GAUSS}],
    }
    return {"fits": [abg, harvey, gaussians, ggx]}


def _written(folder: Path, document: object) -> Path:
    path = folder / "x.parameters.json"
    path.write_text(json.dumps(document))
    return path


def test_the_formula_with_the_least_error_is_evaluated(tmp_path: Path) -> None:
    found = read(_written(tmp_path, _document()))
    at = np.array([[0.0, 0, 8, 170], [60, 0, 58, 181], [45, 0, 0, 0], [30, 0, 50, 120]]).T
    expected = at_incidence(FORMULAS["harvey"], {0.0: HARVEY, 60.0: HARVEY_AT_60})(*at, None)[:, 0]
    assert np.ravel(found.bsdf.evaluate(*at)) == pytest.approx(expected, rel=0.02)
    assert "harvey by incidence (2)" in found.attrs["history"]
    assert "not evaluated: harvey" in found.attrs["history"]


def test_lambert_and_gaussian_is_evaluated(tmp_path: Path) -> None:
    rows = [{"theta_i": 0, "parameters": {**GAUSS, "s_perp": 8.0}}, {"theta_i": 60, "parameters": GAUSS}]
    fits = [{"formula": "lambert_gauss", "error": {"percentile_95": 0.1}, "incidences": rows}]
    found = read(_written(tmp_path, {"fits": fits}))
    assert "lambert_gauss by incidence (2)" in found.attrs["history"]
    assert float(found.bsdf.evaluate(60, 0, 60, 180).item()) == pytest.approx(0.8 + 0.2 / np.pi, rel=0.02)
    assert float(found.bsdf.evaluate(0, 0, 8, 0).item()) == pytest.approx(0.8 * np.exp(-0.5) + 0.2 / np.pi, rel=0.02)
    rows[1]["parameters"] = {**GAUSS, "s_par": 0}
    with pytest.raises(InputError, match="lambert_gauss has no width"):
        read(_written(tmp_path, {"fits": fits}), "parameters")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda fits: fits.clear(), "no formula has parameters"),
        (lambda fits: fits[1].update(parameters={**HARVEY, "l": 0}), "l of harvey is out of range"),
        (lambda fits: fits[1].update(parameters={"b0": 1}), "l of harvey is not a number.*None"),
        (lambda fits: fits[3].update(parameters={"alpha": 0.3, "n": 0.5, "L": 0.2}), "ggx out of range"),
        (lambda fits: fits[1]["by_incidence"]["incidences"].reverse(), "do not increase"),
        (lambda fits: fits[1].update(parameters=7), "parameters is not an object"),
    ],
)
def test_parameters_that_contradict_themselves_are_refused(tmp_path: Path, change: Callable, message: str) -> None:
    document = _document()
    change(document["fits"])
    with pytest.raises(InputError, match=message):
        read(_written(tmp_path, document), "parameters")


@pytest.mark.parametrize("count", [40, pytest.param(300, marks=pytest.mark.slow)])
def test_garbled_files_are_read_or_refused_and_never_crash(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, count: int
) -> None:
    check_garbled_models(
        monkeypatch, json.dumps(_document(), indent=1).encode(), tmp_path / "x.parameters.json", "parameters", count
    )
