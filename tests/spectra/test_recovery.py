"""Spectra recovered from colours: printed values, exactness, limits and refusals."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

from brdfpipe import vocabulary
from brdfpipe.errors import InputError
from brdfpipe.optics import fresnel, interpolate_index, refractive_index
from brdfpipe.spectra import colorimetry, metamerism, recover
from brdfpipe.spectra.colour_science import colour
from brdfpipe.spectra.recovery import METHODS
from brdfpipe.spectra.recovery_methods import random_search
from brdfpipe.spectra.recovery_methods.lhtss import lhtss
from brdfpipe.spectra.recovery_methods.reachable_colours import largest_chroma, nearest_colour
from brdfpipe.store import save_dataset
from brdfpipe.vocabulary import validate

F8 = float(fresnel(np.cos(np.radians(8)), 1.55).mean)


def lab_of(spectrum: xr.Dataset) -> np.ndarray:
    """L*a*b* of a recovered spectrum, by the general route."""
    illuminant, observer = spectrum.attrs["illuminant"], spectrum.attrs["observer"]
    xyz = colorimetry.reflectance_to_xyz(
        spectrum["wavelength"].values, spectrum["total_reflectance"].values, illuminant, observer
    )
    return colorimetry.xyz_to_lab(xyz, colorimetry.weights(illuminant, observer).white)


def test_a_red_has_the_spectrum_of_the_physics_sheet() -> None:
    spectrum = recover([40.74, 50.71, 26.06], illuminant="D65", observer=2)
    r = spectrum["total_reflectance"].sel(wavelength=[400, 500, 600, 700]).values
    # Six printed decimals.
    assert r == pytest.approx([0.054604, 0.031846, 0.245409, 0.583694], abs=5.1e-7)


@pytest.mark.parametrize("observer", [2, 10])
def test_the_24_patches_of_the_colour_checker_are_matched(observer: int) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        checker = colour.CCS_COLOURCHECKERS["ColorChecker24 - After November 2014"]
        xyz = [colour.xyY_to_XYZ(xyy) for xyy in checker.data.values()]
        labs = colour.XYZ_to_Lab(np.array(xyz), checker.illuminant)
    assert len(labs) == 24
    table = colorimetry.weights("D65", observer)
    recovered = lhtss(colorimetry.lab_to_xyz(labs, table.white), table)
    assert recovered.reached.all()
    assert ((recovered.reflectance > 0) & (recovered.reflectance < 1)).all()
    back = colorimetry.xyz_to_lab(
        colorimetry.reflectance_to_xyz(table.wavelength, recovered.reflectance, "D65", observer), table.white
    )
    assert colorimetry.delta_e_ab(back, labs).max() < 1e-5


@settings(deadline=None, max_examples=60)
@given(
    knots=st.lists(st.floats(0.002, 0.998), min_size=6, max_size=6),
    illuminant=st.sampled_from(["D65", "A", "FL2", "LED-B3"]),
    observer=st.sampled_from([2, 10]),
)
def test_every_colour_of_a_reflectance_is_recovered_exactly(knots: list[float], illuminant: str, observer: int) -> None:
    table = colorimetry.weights(illuminant, observer)
    reflectance = np.interp(table.wavelength, np.linspace(360, 780, 6), knots)
    lab = colorimetry.xyz_to_lab(reflectance @ table.weights, table.white)
    spectrum = recover(lab, illuminant=illuminant, observer=observer)
    # Newton stops at 1e-11 of white, 4e-8 in L*a*b*.
    assert colorimetry.delta_e_ab(lab_of(spectrum), lab) < 1e-7
    assert spectrum.attrs["residual_delta_e"] < 1e-7


def test_no_spectrum_of_the_same_colour_is_smoother() -> None:
    table = colorimetry.weights("D65", 10)
    r = recover([60, -30, 40], illuminant="D65", observer=10)["total_reflectance"].values
    z = np.pad(np.arctanh(2 * r - 1), 1, mode="edge")
    roughness_by_z = 2 * (2 * z[1:-1] - z[:-2] - z[2:])
    roughness_by_r = roughness_by_z / (2 * r * (1 - r))
    same_colour = np.linalg.svd(table.weights.T)[2][3:]
    # At the minimum no step that keeps the colour changes the roughness to first order; Newton stops at 1e-8.
    assert np.abs(same_colour @ roughness_by_r).max() < 1e-6


def test_a_grey_is_flat() -> None:
    spectrum = recover([50, 0, 0], illuminant="D65", observer=10)
    # The CIE formula, ((50 + 16)/116)³.
    assert spectrum["total_reflectance"].values == pytest.approx(np.full(85, (66 / 116) ** 3), rel=1e-8)


def test_black_and_white_are_0_and_1_at_every_wavelength() -> None:
    assert (recover([0, 0, 0], illuminant="A", observer=2)["total_reflectance"] == 0).all()
    assert (recover([100, 0, 0], illuminant="A", observer=2)["total_reflectance"] == 1).all()


@pytest.mark.parametrize("lightness", [1e-6, 1e-3, 99.999, 99.9999999])
def test_nearly_black_and_nearly_white_are_recovered(lightness: float) -> None:
    spectrum = recover([lightness, 0, 0], illuminant="D65", observer=10)
    assert spectrum.attrs["residual_delta_e"] < 1e-7


def test_thousands_of_colours_go_in_one_call_and_match_the_single_ones() -> None:
    rng = np.random.default_rng(2)
    table = colorimetry.weights("D65", 10)
    reflectances = np.stack(
        [np.interp(table.wavelength, np.linspace(360, 780, 5), row) for row in rng.uniform(0.01, 0.99, (1000, 5))]
    )
    xyz = reflectances @ table.weights
    many = lhtss(xyz, colorimetry.weights("D65", 10))
    assert many.reached.all()
    assert many.reflectance @ table.weights == pytest.approx(xyz, abs=1e-8)
    assert many.reflectance[777] == pytest.approx(
        lhtss(xyz[777], colorimetry.weights("D65", 10)).reflectance[0], rel=1e-10
    )


def test_colours_out_of_reach_do_not_disturb_the_others() -> None:
    xyz = np.array([[20, 20, 20], [90, 10, 1], [-1, 5, 5], [50, 100, 50], [30, 30, np.nan]], dtype=float)
    recovered = lhtss(xyz, colorimetry.weights("D65", 10))
    assert recovered.reached.tolist() == [True, False, False, False, False]
    assert np.isnan(recovered.reflectance[1:]).all()


def test_no_colours_give_no_spectra() -> None:
    assert lhtss(np.empty((0, 3)), colorimetry.weights("D65", 10)).reflectance.shape == (0, 85)


def test_a_colour_out_of_reach_is_refused_with_the_largest_chroma_of_its_hue() -> None:
    with pytest.raises(
        InputError, match=r"impossible colour: no reflectance has it; found L\*a\*b\* \(50, 200, 0\).*C\* up to 9"
    ) as refusal:
        recover([50, 200, 0], illuminant="D65", observer=10)
    assert refusal.value.key == "spectrum.lab"


def test_the_largest_chroma_is_reachable_and_a_little_more_is_not() -> None:
    lab = np.array([50.0, 120.0, -90.0])
    chroma = largest_chroma(lab, colorimetry.weights("D65", 10))
    hue = lab[1:] / np.hypot(*lab[1:])
    recover([50, *(chroma * hue)], illuminant="D65", observer=10)
    with pytest.raises(InputError):
        recover([50, *((chroma + 0.002 * 150) * hue)], illuminant="D65", observer=10)


@pytest.mark.parametrize("lab", [[0, 1, 0], [100, 0, -2]])
def test_black_and_white_have_no_chroma(lab: list[float]) -> None:
    with pytest.raises(InputError, match=r"accepted: a\* = b\* = 0 at L\* = 0 and L\* = 100"):
        recover(lab, illuminant="D65", observer=10)


def test_with_the_specular_included_the_spectrum_stays_above_fresnel() -> None:
    lab = [26.0, 3.0, -6.0]
    spectrum = recover(lab, illuminant="D65", observer=10, specular_index=1.55)
    assert spectrum["total_reflectance"].min() > F8
    assert colorimetry.delta_e_ab(lab_of(spectrum), lab) < 1e-7
    assert spectrum.attrs["specular_index"] == 1.55


def test_a_colour_of_the_specular_reflection_alone_is_the_limit() -> None:
    lightness = 116 * (F8 + 1e-9) ** (1 / 3) - 16
    spectrum = recover([lightness, 0, 0], illuminant="D65", observer=10, specular_index=1.55)
    assert spectrum["total_reflectance"].values == pytest.approx(np.full(85, F8), abs=2e-9)


@pytest.mark.parametrize("lab", [[10, 0, 0], [0, 0, 0], [25, 40, 30]])
def test_a_colour_darker_than_its_specular_reflection_is_refused_as_specular_excluded(lab: list[float]) -> None:
    with pytest.raises(InputError, match=r"0\.0465, the specular reflectance of index 1\.55.*\(SCE\)") as refusal:
        recover(lab, illuminant="D65", observer=10, specular_index=1.55)
    assert refusal.value.key == "spectrum.geometry"


@pytest.mark.parametrize(
    "lab", [[50, 0], [[50, 0, 0]], [101, 0, 0], [-1, 0, 0], [50, np.nan, 0], "red", None, ["a", 0, 0]]
)
def test_an_invalid_colour_is_refused(lab: object) -> None:
    with pytest.raises(InputError, match=r"invalid colour.*\[L\*, a\*, b\*\] with 0 <= L\* <= 100"):
        recover(lab, illuminant="D65", observer=10)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("options", "key"),
    [
        ({"illuminant": "D56", "observer": 10}, "spectrum.illuminant"),
        ({"illuminant": "D65", "observer": 5}, "spectrum.observer"),
    ],
)
def test_an_unknown_illuminant_or_observer_names_its_key(options: dict, key: str) -> None:
    with pytest.raises(InputError) as refusal:
        recover([50, 0, 0], **options)
    assert refusal.value.key == key


def test_an_unknown_method_is_refused_with_the_known_ones() -> None:
    with pytest.raises(
        InputError, match="unknown method of recovery; found 'magic'; accepted: lhtss, basis4, random4, adaptive4"
    ) as refusal:
        recover([50, 0, 0], illuminant="D65", observer=10, method="magic")
    assert (refusal.value.where, refusal.value.key) == ("spectrum.method", "spectrum.method")


def test_a_recovered_spectrum_is_valid_and_states_its_method(tmp_path: Path) -> None:
    spectrum = validate(recover([50, 10, 0], illuminant="d65", observer=10, geometry="sce", theta=10), "spectrum")
    save_dataset(spectrum, tmp_path / "spectrum.nc", stage="spectrum", material="m")
    expected = {"geometry": "sce", "theta_i": 10.0, "method": "lhtss", "illuminant": "D65", "observer": 10}
    assert {key: spectrum.attrs[key] for key in expected} == expected
    assert spectrum["wavelength"].values.tolist() == list(range(360, 781, 5))


def test_a_thousand_random_colours_of_reflectances_are_matched() -> None:
    rng = np.random.default_rng(11)
    table = colorimetry.weights("D65", 10)
    knots = np.linspace(360, 780, 7)
    reflectances = np.stack(
        [np.interp(table.wavelength, knots, row) for row in rng.beta(0.7, 0.7, (1000, 7)).clip(0.003, 0.997)]
    )
    labs = colorimetry.xyz_to_lab(reflectances @ table.weights, table.white)
    recovered = lhtss(colorimetry.lab_to_xyz(labs, table.white), table)
    assert recovered.reached.all()
    back = colorimetry.xyz_to_lab(recovered.reflectance @ table.weights, table.white)
    assert colorimetry.delta_e_ab(back, labs).max() < 1e-5


@pytest.mark.cases(3)
@pytest.mark.parametrize("lab", [[50, 200, 0], [5, -60, 40], [95, -90, 20], [30, -120, 100], [100, 0, -2], [0, 3, 0]])
def test_the_nearest_colour_is_reachable_and_no_spectrum_of_many_is_nearer(lab: list[float]) -> None:
    with pytest.raises(InputError, match=r"impossible colour.*nearest colour is L\*a\*b\* \("):
        recover(lab, illuminant="D65", observer=10)
    near = nearest_colour(lab, colorimetry.weights("D65", 10))
    apart = colorimetry.delta_e_ab(near, lab)
    recover(near, illuminant="D65", observer=10)
    # Spectra of 0 and 1 with two steps bound all object colours (Schroedinger).
    table = colorimetry.weights("D65", 10)
    first, second = np.meshgrid(table.wavelength, table.wavelength)
    band = (
        ((table.wavelength >= first[..., None]) & (table.wavelength <= second[..., None])).astype(float).reshape(-1, 85)
    )
    limits = colorimetry.xyz_to_lab(np.concatenate([band, 1 - band]) @ table.weights, table.white)
    # Some per mille of grey and two decimals are given away.
    assert apart < colorimetry.delta_e_ab(limits, lab).min() * 1.03 + 0.5


@pytest.mark.parametrize(
    ("lab", "observer", "least"),
    # The least ΔE of a descent that goes on until ΔE² falls by less than 1e-14 of itself.
    [
        ([82.77025938, -53.37459378, 130.05765151], 10, 4.027),
        ([30.319, -122.486, -19.352], 10, 13.359),
        ([30.319, -122.486, -19.352], 2, 12.55),
    ],
)
def test_the_nearest_colour_is_the_nearest(lab: list[float], observer: int, least: float) -> None:
    near = nearest_colour(lab, colorimetry.weights("D65", observer))
    assert least - 0.005 < colorimetry.delta_e_ab(near, lab) < least + 0.02


@pytest.mark.parametrize("method", ["lhtss", "basis4"])
def test_a_dispersive_surface_alone_is_the_limit_at_every_wavelength(method: str) -> None:
    index = refractive_index("PC")
    table = colorimetry.weights("D65", 10)
    n, _ = interpolate_index(index, table.wavelength)
    specular = fresnel(np.cos(np.radians(8)), n).mean
    # A trace of black beneath, or the colour would be on the very limit.
    lab = colorimetry.xyz_to_lab((specular + 1e-6) @ table.weights, table.white)
    spectrum = recover(lab, illuminant="D65", observer=10, method=method, specular_index=index)
    assert spectrum["total_reflectance"].values == pytest.approx(specular, abs=1e-4)
    assert (spectrum["total_reflectance"] >= specular).all()
    assert spectrum.attrs["residual_delta_e"] < 1e-6
    assert spectrum.attrs["specular_index"] == pytest.approx(1.585, abs=0.005)
    with pytest.raises(
        InputError, match=r"0\.04\d\d to 0\.0\d\d\d, the specular reflectance of index 1\.5\d+ to 1\.\d+;"
    ):
        recover([10, 0, 0], illuminant="D65", observer=10, specular_index=index)


def test_colours_near_the_limit_of_all_reflectances_are_recovered() -> None:
    table = colorimetry.weights("D65", 10)
    rng = np.random.default_rng(5)
    first, width = rng.uniform(380, 600, (300, 1)), rng.uniform(30, 150, (300, 1))
    band = ((table.wavelength >= first) & (table.wavelength <= first + width)).astype(float)
    xyz = (0.01 + 0.98 * np.concatenate([band, 1 - band])) @ table.weights
    recovered = lhtss(xyz, colorimetry.weights("D65", 10))
    assert recovered.reached.all()
    assert recovered.reflectance @ table.weights == pytest.approx(xyz, abs=1e-8)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("index", [None, 1.55])
def test_every_method_reaches_the_colour_above_its_floor(method: str, index: float | None) -> None:
    lab = [50.0, 20.0, 10.0]
    spectrum = validate(
        recover(lab, illuminant="D65", observer=10, method=method, threshold=1.5, specular_index=index), "spectrum"
    )
    residual = colorimetry.delta_e_ab(lab_of(spectrum), lab)
    assert residual < (1e-6 if method in ("lhtss", "basis4") else 1.5)
    assert spectrum.attrs["residual_delta_e"] == pytest.approx(residual, abs=1e-9)
    assert spectrum["total_reflectance"].min() >= (F8 if index else 0)
    assert spectrum.attrs["method"] == method


@pytest.mark.parametrize("method", ["basis4", "random4", "adaptive4"])
@pytest.mark.parametrize("lab", [[50, 100, 0], [100, 0, 0], [70, -60, -50]])
def test_a_colour_no_mixture_has_is_refused_with_the_nearest(method: str, lab: list[float]) -> None:
    with pytest.raises(
        InputError, match=r"no mixture of the four.*accepted: lhtss; or .*nearest one, L\*a\*b\* \("
    ) as refusal:
        recover(lab, illuminant="D65", observer=10, method=method)
    assert refusal.value.key == "spectrum.method"


def test_a_search_that_does_not_reach_its_threshold_is_warned_about_and_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    checkpoint = tmp_path / "best.json"
    monkeypatch.setitem(random_search.LIMIT, "random4", 8192)
    options = {"illuminant": "D65", "observer": 10, "method": "random4", "threshold": 1e-6, "checkpoint": checkpoint}
    spectrum = recover([50, 20, 10], **options)
    assert "ended after 8192 mixtures" in vocabulary.warnings(spectrum)[0]
    assert spectrum.attrs["residual_delta_e"] < 20
    assert recover([50, 20, 10], **options).attrs["tried"] == 16384


def test_a_forgotten_request_to_stop_gives_no_black_spectrum(tmp_path: Path) -> None:
    (tmp_path / "best.json.stop").touch()
    spectrum = recover(
        [50, 20, 10], illuminant="D65", observer=10, method="random4", threshold=3.0, checkpoint=tmp_path / "best.json"
    )
    assert vocabulary.warnings(spectrum) == []
    assert spectrum.attrs["residual_delta_e"] < 3


@pytest.mark.parametrize(
    ("options", "key"),
    [
        ({"threshold": 0.0}, "threshold"),
        ({"threshold": np.nan}, "threshold"),
        ({"seed": -1}, "seed"),
        ({"seed": 1.5}, "seed"),
    ],
)
def test_a_threshold_or_seed_out_of_range_names_its_key(options: dict, key: str) -> None:
    with pytest.raises(InputError) as refusal:
        recover([50, 0, 0], illuminant="D65", observer=10, method="random4", **options)
    assert refusal.value.key == f"spectrum.{key}"


def test_metamerism_compares_the_methods_under_other_light() -> None:
    differences = metamerism([40, 20, 10], illuminant="D65", observer=10, methods=("lhtss", "basis4", "adaptive4"))
    assert differences["delta_e00"].dims == ("light", "recovery", "other")
    assert differences["light"].values.tolist() == ["A", "FL2", "LED-B3"]
    pairs = differences["delta_e00"].values
    np.testing.assert_allclose(pairs, np.swapaxes(pairs, 1, 2), atol=1e-9)
    assert np.abs(np.einsum("lmm->lm", pairs)).max() < 1e-9
    table = colorimetry.weights("A", 10)
    labs = colorimetry.xyz_to_lab(differences["total_reflectance"].values @ table.weights, table.white)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        theirs = float(colour.delta_E(labs[0], labs[1], method="CIE 2000"))
    assert float(differences["delta_e00"].sel(light="A", recovery="lhtss", other="basis4")) == pytest.approx(
        theirs, rel=1e-9
    )


def test_a_recovered_spectrum_says_what_the_other_exact_method_would_have_changed() -> None:
    lhtss_attrs = recover([40, 20, 10], illuminant="D65", observer=10).attrs
    pair = metamerism([40, 20, 10], illuminant="D65", observer=10, methods=("lhtss", "basis4"))["delta_e00"]
    for light in ("A", "FL2", "LED-B3"):
        assert lhtss_attrs[f"metamerism_{light}"] == pytest.approx(
            float(pair.sel(light=light, recovery="lhtss", other="basis4"))
        )
    assert lhtss_attrs["metamerism_against"] == "basis4"
    assert "metamerism_A" not in recover([70, -55, -45], illuminant="D65", observer=10).attrs


def test_a_method_that_does_not_reach_a_colour_is_left_out_of_the_comparison_and_named() -> None:
    differences = metamerism([70, -55, -45], illuminant="D65", observer=10, methods=("basis4", "lhtss"))
    assert differences["recovery"].values.tolist() == differences["other"].values.tolist() == ["lhtss"]
    (reason,) = vocabulary.warnings(differences)
    assert reason.startswith("method basis4 was left out: ")
    assert "no mixture of the four basis spectra" in reason
    with pytest.raises(InputError, match="no mixture"):
        metamerism([70, -55, -45], illuminant="D65", observer=10, methods=("basis4",))
    with pytest.raises(InputError, match="unknown method"):
        metamerism([40, 20, 10], illuminant="D65", observer=10, methods=("lhtss", "lhtts"))
