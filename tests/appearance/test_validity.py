"""Conditions under which a prediction can be trusted, and their share in the verdict of a material."""

from __future__ import annotations

import numpy as np
import pytest
import samples
import xarray as xr

from brdfpipe import facets, flakes, psd, vocabulary
from brdfpipe.appearance.origin import Datasets
from brdfpipe.appearance.validity import Judgement, validity
from brdfpipe.appearance.verdicts import overall, verdicts, worst
from brdfpipe.bsdf import flake, slab

ROUGHNESS = "Roughness against wavelength (550 nm)"
PITCH = "Structure finer than the scan"
ERROR = "Error of the predicted light"


def datasets(**further: xr.Dataset) -> dict[str, xr.Dataset]:
    known = {"surface": samples.gaussian_surface(32), "facets": facets.analytic("beckmann", 0.1)}
    bsdf = samples.beckmann_bsdf(0.07)
    return {**known, "predicted": bsdf, "bsdf": bsdf, **further}


def judged(known: Datasets) -> dict[str, Judgement]:
    return {judgement.condition: judgement for judgement in validity(known)}


def model_error(light_error: float, uncertainty: float, valid: bool = True, gloss_error: float = 0.0) -> xr.Dataset:
    shape = ("reference", "plane", "theta_i", "region")
    return xr.Dataset(
        {
            "light_error": (shape, np.full((1, 1, 2, 1), light_error)),
            "light_error_u": (shape, np.full((1, 1, 2, 1), uncertainty)),
            "valid": (("reference", "theta_i"), np.full((1, 2), int(valid))),
            "gloss_error": ((*shape[:2], "gloss_angle"), np.full((1, 1, 1), gloss_error)),
            "gloss_error_u": ((*shape[:2], "gloss_angle"), np.full((1, 1, 1), 0.25)),
            "gloss_valid": (("reference", "gloss_angle"), np.full((1, 1), int(valid))),
        },
        {
            "reference": ["traced"],
            "plane": ["mean over azimuth"],
            "theta_i": [0.0, 60.0],
            "region": ["peak"],
            "gloss_angle": [60.0],
        },
        {"advice": "set `model.truth: use`"},
    )


@pytest.mark.parametrize(
    ("sigma", "verdict"), [(0.013, "fail"), (0.03, "fail"), (0.05, "warn"), (0.2, "warn"), (5.0, "pass")]
)
def test_facets_of_smooth_surfaces_are_not_trusted(sigma, verdict):
    known = datasets(psd=psd.analytic("gaussian", sigma=sigma, length=5.0))
    assert judged(known)[ROUGHNESS].verdict == verdict
    assert ("`model.optics: auto`" in judged(known)[ROUGHNESS].advice) == (verdict != "pass")
    for other in ({"optics": "auto"}, {"representation": "kirchhoff"}):
        assert judged(known | {"bsdf": known["bsdf"].assign_attrs(other)})[ROUGHNESS].verdict == "pass"


@pytest.mark.parametrize(("sigma", "verdict"), [(0.013, "fail"), (0.12, "fail"), (0.5, "warn"), (5.0, "pass")])
def test_each_face_of_a_sheet_is_judged_by_the_light_that_passes(sigma, verdict):
    sheet = slab.build(facets.flat(), facets.flat(), index=1.5)
    spectrum = psd.analytic("gaussian", sigma=sigma, length=5.0)
    own_back = {"back_facets": facets.analytic("beckmann", 0.1), "back_psd": spectrum}
    known: dict[str, xr.Dataset] = {"facets": facets.flat(), "bsdf": sheet, **own_back}
    front, back = (f"{ROUGHNESS}, {side} face" for side in ("front", "back"))
    assert judged(known)[back].verdict == verdict
    assert front not in judged(known)
    assert judged(known | {"bsdf": sheet.assign(back_wave_sigma=sigma)})[back].verdict == "pass"
    both = {"facets": own_back["back_facets"], "psd": spectrum, "bsdf": sheet}
    assert judged(both)[front].verdict == judged(both)[back].verdict == verdict


@pytest.mark.parametrize(
    ("band", "longer", "verdict"),
    [
        (1.0, 0.0, "pass"),
        (0.6, 0.8, "pass"),
        (0.75, 0.0, "warn"),
        (1.25, 0.0, "warn"),
        (0.4, 0.2, "fail"),
        (2.1, 0.0, "fail"),
    ],
)
def test_the_rms_heights_of_the_spectrum_and_of_the_heights_must_agree(band, longer, verdict):
    spectrum = psd.analytic("gaussian", sigma=1.0, length=5.0).assign_attrs(form="measured")
    known = datasets(psd=spectrum.assign(sigma=band, long_sigma=longer, sigma_heights=1.0))
    judgement = judged(known)["Rms height"]
    assert judgement.verdict == verdict
    assert (
        judgement.finding == f"{1e3 * np.hypot(band, longer):.0f} nm in the roughness spectrum, 1000 nm of the heights"
    )


@pytest.mark.parametrize(("missed", "verdict"), [(1e-5, "pass"), (0.009, "pass"), (0.02, "warn"), (0.06, "fail")])
def test_light_that_waves_miss_is_judged_whatever_the_optics(missed, verdict):
    for optics, advice in (("wave", "Set `model.optics: auto`"), ("auto", "Measure a larger area")):
        known = datasets()
        known["bsdf"] = known["bsdf"].assign(energy_residual=missed).assign_attrs(optics=optics)
        judgement = judged(known)["Light that waves miss"]
        assert judgement.verdict == verdict
        assert judgement.advice.startswith(advice) == (verdict != "pass")


@pytest.mark.parametrize("optics", ["facets", "wave"])
def test_a_simpler_model_whose_error_the_scene_accepts_lowers_no_verdict(optics):
    known = datasets(psd=psd.analytic("gaussian", sigma=0.03, length=5.0))
    known["bsdf"] = known["bsdf"].assign(energy_residual=0.02).assign_attrs(optics=optics)
    plan = xr.Dataset(attrs={"scene": "gloss-sheet", "choice": f"optics {optics}"})
    alone, planned = judged(known), judged(known | {"plan": plan})
    assert planned[ROUGHNESS].verdict == "pass"
    assert (alone[ROUGHNESS].verdict == "fail") == (optics == "facets")
    assert "the scene gloss-sheet accepts the error" in planned[ROUGHNESS].finding
    assert planned["Light that waves miss"].verdict == ("pass" if optics == "wave" else "warn")
    for condition in alone.keys() - {ROUGHNESS, "Light that waves miss"}:
        assert planned[condition] == alone[condition]
    assert judged(known | {"plan": plan.assign_attrs(choice="fullest")}) == alone


def test_the_phase_variance_is_that_of_long_waves_too():
    short = psd.analytic("gaussian", sigma=0.03, length=5.0)
    both = [judged(datasets(psd=one))[ROUGHNESS] for one in (short, short.assign(long_sigma=5.0))]
    assert [judgement.verdict for judgement in both] == ["fail", "pass"]


def test_a_condition_that_fails_makes_the_verdict_of_the_material_fail():
    rough, smooth = (datasets(psd=psd.analytic("gaussian", sigma=sigma, length=5.0)) for sigma in (5.0, 0.013))
    assert worst(verdicts(rough)) != "fail"
    assert worst(verdicts(smooth)) == "fail"
    (failed,) = [entry for entry in verdicts(smooth) if entry.verdict == "fail"]
    assert "coherent" in failed.text


def test_a_condition_that_warns_counts_in_the_verdict():
    table = facets.analytic("beckmann", 0.1).assign(tail_share=0.2)
    known = datasets(psd=psd.analytic("gaussian", sigma=5.0, length=5.0), facets=table)
    verdict, (reason,) = overall(known)
    assert (verdict, reason.name) == ("warn", "extrapolated slopes")


def test_masking_is_judged_by_what_the_heights_advise():
    def judgement(used, choice):
        known = datasets(visibility=choice)
        known["predicted"] = known["bsdf"].assign_attrs(masking=used)
        return judged(known)["Masking of facets by their neighbours"]

    advised = samples.masking_choice()
    assert judgement("measured", advised).verdict == "pass"
    assert judgement("measured", advised).finding.startswith("traced on the heights; Smith's masking would give ")
    ignored = judgement("height-correlated", advised)
    assert ignored.verdict == "warn"
    assert "`model.masking: auto`" in ignored.advice
    assert judgement("height-correlated", samples.masking_choice("height-correlated", 0.01)).verdict == "pass"
    untraced = advised[[]].assign_attrs(masking="height-correlated", reason="no visibility was traced: a lay")
    assert judgement("height-correlated", untraced).verdict == ""


@pytest.mark.parametrize(
    ("error", "uncertainty", "gloss", "verdict"),
    [(0.43, 0.03, 16.5, "warn"), (0.43, 0.3, 16.5, "pass"), (0.14, 0.01, 1.1, "pass"), (-0.3, 0.01, 16.5, "warn")],
)
def test_smiths_masking_at_grazing_incidence_is_judged_by_the_gloss_that_it_adds(error, uncertainty, gloss, verdict):
    heights = samples.masking_choice("height-correlated", 0.01)
    at = {"theta_i": [85.0], "region": ["peak"]}
    shape = ("theta_i", "region")
    grazing = xr.Dataset({"smith_error": (shape, [[error]]), "smith_error_u": (shape, [[uncertainty]])}, at)
    visibility = grazing.assign_attrs(heights.attrs)
    compared = model_error(0.02, 0.01).assign_coords(gloss_angle=[85.0])
    compared["gloss_valid"] = xr.zeros_like(compared["gloss_valid"])
    appearance = xr.Dataset({"gloss": ("gloss_angle", [gloss])}, {"gloss_angle": [85.0]})
    known = datasets(visibility=visibility, model_error=compared, appearance=appearance)
    known["predicted"] = known["bsdf"].assign_attrs(masking="height-correlated")
    found = judged(known)
    assert found["Masking of facets by their neighbours"].verdict == verdict
    assert "gloss at 85° is not judged: no reference solution holds there" in found[ERROR].finding
    compared["gloss_valid"] += 1
    assert judged(known)["Masking of facets by their neighbours"].verdict == "pass"


def test_slopes_of_a_fractal_surface_depend_on_the_pitch():
    spectra = [psd.analytic("k-correlation", sigma=5.0, length=5.0, slope=slope) for slope in (3.0, 4.5)]
    assert [judged(datasets(psd=spectrum))[PITCH].verdict for spectrum in spectra] == ["warn", "pass"]


@pytest.mark.parametrize(
    ("pitch", "unresolved", "verdict"),
    [(20.0, 0.05, "fail"), (2.0, 0.05, "warn"), (20.0, 0.001, "warn"), (20.0, 0.0, "warn"), (2.0, 0.0, "pass")],
)
@pytest.mark.parametrize("optics", ["facets", "auto"])
def test_a_plateau_that_may_be_roughness_is_judged_with_waves_too(pitch, unresolved, verdict, optics):
    spectrum = psd.analytic("gaussian", sigma=5.0, length=500.0).assign(unresolved_sigma=unresolved)
    known = datasets(psd=spectrum, surface=samples.surface(np.zeros((32, 32)), (pitch, pitch)))
    found = judged(known | {"bsdf": known["bsdf"].assign_attrs(optics=optics)})[PITCH]
    assert found.verdict == verdict
    # g = (4π · 50 nm · cos 20°/550 nm)²
    assert ("a plateau of 50 nm, g = 1.2 at 20°" in found.finding) == (unresolved == 0.05)
    assert ("roughness finer than the pitch was not measured" in found.finding) == (pitch == 20 and unresolved < 0.05)


def test_a_plateau_of_either_face_of_a_sheet_is_judged():
    clean, plateau = (
        psd.analytic("gaussian", sigma=5.0, length=500.0).assign(unresolved_sigma=unresolved)
        for unresolved in (0.0, 0.05)
    )
    sheet = slab.build(facets.flat(), facets.flat(), index=1.5)
    scans = [samples.surface(np.zeros((32, 32)), (pitch, pitch)) for pitch in (2.0, 20.0)]
    known = {"surface": scans[0], "back_surface": scans[1], "bsdf": sheet}
    for front, back, verdict in ((clean, clean, "pass"), (plateau, clean, "warn"), (clean, plateau, "fail")):
        faces = {"psd": front, "back_psd": back, "back_facets": facets.flat()}
        assert judged(datasets(**known, **faces))[PITCH].verdict == verdict


def test_slopes_of_hardly_related_heights_fail():
    for ratio, verdict in ((1.86, "fail"), (1.41, "pass")):
        table = facets.analytic("beckmann", 0.1).assign(noise_ratio=ratio)
        known = datasets(facets=table, psd=psd.analytic("gaussian", sigma=5.0, length=5.0))
        judgement = judged(known | {"bsdf": known["bsdf"].assign_attrs(optics="auto")})[PITCH]
        assert judgement.verdict == verdict
        assert ("`surface.noise`" in judgement.advice) == (verdict == "fail")


@pytest.mark.parametrize(
    ("error", "uncertainty", "verdict"),
    [(0.05, 0.01, "pass"), (-0.2, 0.02, "warn"), (0.8, 0.05, "fail"), (-0.6, 0.08, "warn")],
)
def test_the_error_of_the_model_counts_beyond_its_uncertainty(error, uncertainty, verdict):
    judgement = judged(datasets(model_error=model_error(error, uncertainty)))[ERROR]
    assert judgement.verdict == verdict
    assert judgement.advice == ("" if verdict == "pass" else "Set `model.truth: use`")


@pytest.mark.parametrize(("units", "verdict"), [(0.9, "pass"), (-2.0, "warn"), (5.4, "warn"), (-36.0, "fail")])
def test_an_error_of_gloss_counts_where_the_light_in_the_peak_is_right(units, verdict):
    judgement = judged(datasets(model_error=model_error(0.038, 0.01, gloss_error=units)))[ERROR]
    assert judgement.verdict == verdict
    assert f"gloss {units:+.1f} ± 0.2 at 60°".replace("-", "−") in judgement.finding
    assert "in the peak +3.8% ± 1.0%" in judgement.finding


@pytest.mark.parametrize(
    ("error", "uncertainty", "units", "words"),
    [
        (0.02, 0.13, 0.0, "known only to ± 13% of the light"),
        (0.2, 0.06, 0.0, "not shown to be within 10% of the light"),
        (0.02, 0.02, 1.3, "not shown to be within 1.0 gloss units"),
        (0.2, 0.06, 1.3, "not shown to be within 10% of the light and not shown to be within 1.0 gloss units"),
    ],
)
def test_an_error_that_is_not_shown_to_be_within_its_limit_does_not_pass(error, uncertainty, units, words):
    judgement = judged(datasets(model_error=model_error(error, uncertainty, gloss_error=units)))[ERROR]
    assert (judgement.verdict, judgement.advice) == ("warn", "Measure a larger area")
    assert judgement.finding.endswith(f"; {words}")
    assert judged(datasets(model_error=model_error(0.02, 0.09)))[ERROR].verdict == "pass"


def test_an_error_that_was_not_computed_or_has_no_reference_is_stated():
    assert judged(datasets())[ERROR] == Judgement(ERROR, "not computed", "", "Set `model.truth: check`")
    without_reference = datasets(model_error=model_error(0.0, 0.0, valid=False))
    assert judged(without_reference)[ERROR].verdict == "warn"
    line = without_reference | {"surface": samples.surface(np.zeros(32))}
    assert judged(line)[ERROR].finding.startswith("not known for a line profile")
    assert judged(line)[ERROR].verdict == ""


def test_noise_and_tails_are_judged_by_their_share():
    spectrum = psd.analytic("gaussian", sigma=5.0, length=5.0)
    spectrum = spectrum.assign(noise_sigma=1.5).assign_attrs(form="measured")
    table = facets.analytic("beckmann", 0.1).assign(tail_share=0.2, tail_slope=0.4)
    found = judged(datasets(psd=spectrum, facets=table))
    assert found["Height noise"].verdict == "warn"
    assert found["Extrapolated slopes"].verdict == "warn"
    assert "0.4" in found["Extrapolated slopes"].finding
    # A density with a lay has no single slope where its tail begins.
    assert (
        judged(datasets(facets=table.drop_vars("tail_slope")))["Extrapolated slopes"].finding == "20.00% of the facets"
    )
    assert judged(datasets(psd=spectrum.assign(noise_sigma=0.0)))["Height noise"].finding.startswith("none found")


def paint(*names: str) -> xr.Dataset:
    """A paint of colours that an exponential does not fit."""
    values = {"45as15": 20.0, "45as25": 12.0, "45as45": 5.0, "45as75": 2.0}
    colours = [{"geometry": name, "xyz": [values[name]] * 3} for name in names]
    multiangle = flakes.ingest({"colours": colours, "illuminant": "D65", "observer": 10})
    return flake.build(multiangle, model="flake-physical")


def test_the_fit_of_a_paint_is_judged_by_colours_that_it_could_miss():
    form, angles, coat = validity({"bsdf": paint("45as15", "45as45", "45as75")})
    assert form.verdict == ""
    assert "3 geometries and 3 parameters: the fit cannot miss the colours" in form.finding
    assert angles.finding.startswith("4.33 to 23.8°; light reaches 0 to 41.8°")
    assert coat.finding.startswith("assumed smooth, not measured")
    more = validity({"bsdf": paint("45as15", "45as25", "45as45", "45as75")})[0]
    assert more.verdict == "pass"
    assert "from the 4 measured colours" in more.finding


def test_other_materials_have_no_conditions():
    assert validity({"bsdf": vocabulary.label(samples.beckmann_bsdf(0.1), "bsdf")}) == []
    assert validity(datasets() | {"facets": facets.flat()}) == []


@pytest.mark.parametrize(("contribution", "verdict"), [(0.45, "pass"), (0.55, "warn")])
def test_few_facets_that_make_most_of_the_mean_square_slope_are_named(contribution, verdict):
    few = facets.analytic("beckmann", 0.1).assign(tail_share=1e-4, tail_contribution=contribution)
    assert judged(datasets(facets=few))["Extrapolated slopes"].verdict == verdict
