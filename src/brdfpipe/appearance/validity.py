"""How far a predicted BSDF can be trusted: what its model assumes, beside what the scan gives.

The checks judge whether a BSDF obeys the laws of optics. A BSDF that does may still be wrong for its surface: too smooth for facets, sampled
too coarsely, noisy, or of a shape that slopes alone do not describe.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import xarray as xr

from brdfpipe.appearance.origin import Datasets
from brdfpipe.bsdf.microfacet.phase_variance import (
    LIMITS,
    known_rms_height,
    phase_variances,
    unresolved_rms_height,
)
from brdfpipe.bsdf.wave import missed_light
from brdfpipe.errors import plain
from brdfpipe.facets.facet_dataset import NOISE_ADVICE
from brdfpipe.flakes.refraction import largest_flake_angle
from brdfpipe.geometry import Array
from brdfpipe.masking.modes import LARGEST_COMPARED

COHERENT_LIMIT = float(np.log(2))
"""Phase variance below which more than half of the mirror reflection is coherent light, which facets leave out."""
NOISE_LIMIT = 0.2
"""Height noise over rms height above which its subtraction is uncertain; docs/model.md has the accuracy."""
TAIL_LIMIT = 0.1
"""Share of facets beyond the counted slopes, above which the wings of the lobe are extrapolated."""
TAIL_CONTRIBUTION_LIMIT = 0.5
"""Share of the mean square slope that these facets have, above which few steep places, or errors of the scan, make most of it."""
ERROR_LIMITS = 0.1, 0.5
"""Errors of the predicted light in the peak from which the verdict is warn, and fail."""
GLOSS_LIMITS = 1.0, 5.0
"""The same of the predicted gloss [gloss units]: one is what gloss meters agree within, and fail is as many times warn as of light."""
SIGNIFICANT = 2.0
"""Standard uncertainties by which an error must exceed its limit."""
HEIGHT_LIMITS = 1.2, 2.0
"""Factors by which the rms heights of the roughness spectrum and of the heights may differ, before the verdict is warn, and fail."""
SLOPE_OF_FINITE_VARIANCE = 4.0
"""Exponent of the roughness spectrum above which the variance of the slope does not depend on the pitch."""

COARSE_PITCH = 10.0
"""Pitch in wavelengths above which roughness finer than it counts as not measured, and a plateau that may be finer roughness is a failure."""
ALIASED = 1.7
"""Slope over one pixel over that over two above which heights are hardly related: of white ones it is 2, of a spectrum that falls as f^−2.5 1.68."""

LARGEST_JUDGED = 75.0
"""Angle of incidence up to which the error of the predicted light is judged [degree]; few maps are large enough beyond."""
OF_COAT = "The face of a coat has facets alone: `surface: {distribution: flat}` describes a smooth one; compare with a measurement of gloss (`measured`)"
"""What to do where waves are needed at the face of a coat."""

REFERENCES = ("traced", "kirchhoff")
"""Representations that are reference solutions themselves."""

POOR_COLOUR = 3.0
"""CIEDE2000 of a fit to the colours of a paint from which it is poor."""

_WAVELENGTH = 0.55


class Judgement(NamedTuple):
    """One condition of the model."""

    condition: str
    finding: str
    verdict: str
    """pass, warn or fail; empty where nothing was judged"""
    advice: str = ""
    """What to do; keys of descriptions in backticks"""


def validity(datasets: Datasets) -> list[Judgement]:
    """Conditions of a BSDF that was predicted from a surface, or fitted to colours; empty for other materials.

    Parameters
    ----------
    datasets : stage → its dataset; ``psd``, ``facets``, ``surface``, ``visibility``, ``bsdf``, ``back_surface``, ``back_psd``,
        ``back_facets`` and ``model_error`` are used where they exist
    """
    if "bsdf" in datasets and datasets["bsdf"].attrs["representation"] == "flake":
        return _of_flakes(datasets["bsdf"])
    if "facets" not in datasets or "bsdf" not in datasets:
        return []
    is_sheet = datasets["bsdf"].attrs["representation"] == "slab"
    if not is_sheet and datasets["facets"]["slope_density"].size == 0:
        return []
    regimes = [_regime_of_face(datasets, side) for side in ("front", "back")] if is_sheet else [_regime(datasets)]
    judgements = (
        *regimes,
        _pitch(datasets),
        _band(datasets),
        _heights(datasets),
        _energy(datasets),
        _noise(datasets),
        _tail(datasets),
        _masking(datasets),
    )
    return [judgement for judgement in (*judgements, _model_error(datasets)) if judgement is not None]


def _of_flakes(bsdf: xr.Dataset) -> list[Judgement]:
    """What the geometries of a paint can tell of its reflection, and what is assumed."""
    measured = bsdf["theta_f_measured"].values
    parameters = 2 * bsdf.sizes["term"] + 1
    form = Judgement(
        "Form of the decrease along the flake angle",
        f"{measured.size} geometries and {parameters} parameters: the fit cannot miss the colours, so that its error is not known, above all "
        "at other incidences",
        "",
        "Measure at more geometries",
    )
    if measured.size > parameters:
        missed, left_out = (float(np.nanmax(bsdf[name])) for name in ("delta_e_00", "leave_one_out"))
        finding = f"ΔE00 up to {missed:.1f} from the {measured.size} measured colours; up to {left_out:.1f} at one that is left out of the fit"
        form = Judgement(form.condition, finding, "pass" if missed <= POOR_COLOUR else "warn")
    low, high = measured.min(), measured.max()
    reached = largest_flake_angle(float(bsdf["clear_coat_index"]))
    angles = Judgement(
        "Flake angles measured",
        f"{low:.3g} to {high:.3g}°; light reaches 0 to {reached:.3g}°, and the rest is extrapolated",
        "",
    )
    if bsdf.attrs["clear_coat"] == "none":
        return [form, angles]
    coat = "assumed smooth" if "clear_coat_slope" not in bsdf else f"slope {float(bsdf['clear_coat_slope']):.2g}, given"
    return [form, angles, Judgement("Clear coat", f"{coat}, not measured; gloss and haze follow from it", "")]


def _rounded(phase: float) -> str:
    """A phase variance to three digits, without an exponent where it is large."""
    return f"{phase:.0f}" if phase >= 100 else f"{phase:.3g}"


def _regime(datasets: Datasets) -> Judgement | None:
    if "psd" not in datasets:
        return None
    phase = phase_variances(known_rms_height(datasets["psd"]))
    finding = "g = " + ", ".join(f"{_rounded(g)} at {angle}°" for angle, g in phase.items())
    condition = "Roughness against wavelength (550 nm)"
    if accepted := _accepted_by_scene(datasets):
        return Judgement(condition, f"{finding}; {accepted}", "pass")
    if _by_waves(datasets):
        return Judgement(condition, f"{finding}; waves and facets", "pass")
    if datasets["bsdf"].attrs["representation"] in REFERENCES:
        return Judgement(condition, f"{finding}; a reference solution on the map", "pass")
    advice = OF_COAT if _is_coated(datasets) else "Set `model.optics: auto`"
    if phase[20] < COHERENT_LIMIT:
        missing = f"{np.exp(-phase[20]):.0%} of the mirror reflection at 20° is coherent light, which facets leave out"
        return Judgement(condition, f"{finding}; {missing}", "fail", advice)
    if any(LIMITS[0] < g < LIMITS[1] for g in phase.values()):
        return Judgement(condition, f"{finding}; facets need {LIMITS[1]:g} or more", "warn", advice)
    return Judgement(condition, f"{finding}; facets", "pass")


def _regime_of_face(datasets: Datasets, side: str) -> Judgement | None:
    """Of a sheet: light that a face transmits has a smaller phase variance than what it reflects."""
    own_back = side == "back" and "back_facets" in datasets
    psd = datasets.get("back_psd" if own_back else "psd")
    if psd is None or datasets["back_facets" if own_back else "facets"]["slope_density"].size == 0:
        return None
    sigma, index = known_rms_height(psd), float(datasets["bsdf"]["n"].mean())
    through = (2 * np.pi * sigma * (index - 1) / _WAVELENGTH) ** 2
    reflected = phase_variances(sigma)[20]
    condition = f"Roughness against wavelength (550 nm), {side} face"
    finding = (
        f"g = {_rounded(through)} of light that passes along the normal, {_rounded(reflected)} of reflection at 20°"
    )
    if f"{side}_wave_sigma" in datasets["bsdf"]:
        return Judgement(condition, f"{finding}; waves", "pass")
    advice = "Set `model.optics: auto`"
    if through < COHERENT_LIMIT:
        missing = f"{np.exp(-through):.0%} of the light passes straight on, which facets leave out"
        return Judgement(condition, f"{finding}; {missing}", "fail", advice)
    if through < LIMITS[1]:
        return Judgement(condition, f"{finding}; facets need {LIMITS[1]:g} or more", "warn", advice)
    return Judgement(condition, f"{finding}; facets", "pass")


def _is_coated(datasets: Datasets) -> bool:
    return str(datasets["bsdf"].attrs["representation"]) == "coated"


def _by_waves(datasets: Datasets) -> bool:
    """Whether the BSDF was predicted from the roughness spectrum, of waves or of facets where these hold."""
    return str(datasets["bsdf"].attrs.get("optics", "facets")) != "facets"


def _accepted_by_scene(datasets: Datasets) -> str:
    """In words, that the scene accepts the error of a simpler model; empty where no plan chose one. The fullest model is judged by itself."""
    plan = datasets.get("plan")
    if plan is None or plan.attrs["choice"] == "fullest":
        return ""
    return f"of what the model leaves out, the scene {plan.attrs['scene']} accepts the error"


def _pitch(datasets: Datasets) -> Judgement | None:
    if "surface" not in datasets:
        return None
    surface, psd = datasets["surface"], datasets.get("psd")
    # Of a sheet, the face whose plateau is higher decides.
    if (
        psd is not None
        and {"back_surface", "back_psd"} <= set(datasets)
        and unresolved_rms_height(datasets["back_psd"]) > unresolved_rms_height(psd)
    ):
        surface, psd = datasets["back_surface"], datasets["back_psd"]
    pitch = float(surface.attrs["pitch_x"])
    finding = f"pitch {pitch:.3g} µm, {pitch / _WAVELENGTH:.2g} wavelengths"
    condition = "Structure finer than the scan"
    if (ratio := float(datasets["facets"].get("noise_ratio", 0.0))) > ALIASED:
        finding += f"; slopes over one pixel are {ratio:.2f} times those over two, as of noise or of finer roughness"
        return Judgement(
            condition, finding, "fail", f"If it is noise, {NOISE_ADVICE}; if finer roughness, scan with a finer pitch"
        )
    if psd is None:
        return Judgement(condition, finding, "")
    unresolved = unresolved_rms_height(psd)
    phase = phase_variances(unresolved)[20]
    if phase > LIMITS[0]:
        finding += f"; a plateau of {_nanometres(unresolved)}, g = {phase:.2g} at 20°, is noise or roughness finer than the pitch"
        coarse = pitch > COARSE_PITCH * _WAVELENGTH
        advice = "Scan the same place twice (`repeat: true`) to tell noise from roughness, or with a pitch near the wavelength"
        return Judgement(condition, finding, "fail" if coarse else "warn", advice)
    if pitch > COARSE_PITCH * _WAVELENGTH:
        advice = "Scan a part of the surface with a pitch near the wavelength too, and name it in `surface.scans`"
        return Judgement(condition, f"{finding}; roughness finer than the pitch was not measured", "warn", advice)
    if np.isnan(psd["fit_slope"]):
        return Judgement(condition, finding, "pass")
    exponent, uncertainty = float(psd["fit_slope"]), float(psd["fit_slope_u"])
    with_waves = (
        _by_waves(datasets)
        or bool(_accepted_by_scene(datasets))
        or datasets["bsdf"].attrs["representation"] == "kirchhoff"
        or "front_wave_sigma" in datasets["bsdf"]
    )
    if not with_waves and exponent + SIGNIFICANT * np.nan_to_num(uncertainty) < SLOPE_OF_FINITE_VARIANCE:
        finding += f"; the roughness spectrum falls as f^−{exponent:.2g}, so that slopes grow with every finer pitch"
        advice = "Scan with a pitch near the wavelength"
        if not _is_coated(datasets):
            advice = "Set `model.optics: auto`, or scan with a pitch near the wavelength"
        return Judgement(condition, finding, "warn", advice)
    return Judgement(condition, finding, "pass")


def _band(datasets: Datasets) -> Judgement | None:
    if "psd" not in datasets or datasets["psd"].attrs["form"] != "measured":
        return None
    low, high = (float(datasets["psd"][name]) for name in ("band_low", "band_high"))
    finding = f"{plain(1 / high)} to {plain(1 / low)} µm"
    if (longer := float(datasets["psd"].get("long_sigma", 0.0))) > 0:
        finding += f"; longer waves have an rms height of {_nanometres(longer)}"
    return Judgement("Measured wavelengths of the relief", finding, "pass")


def _heights(datasets: Datasets) -> Judgement | None:
    """The light that is not mirrored is that of the heights; the halo has the light of the spectrum. Joined spectra have no common heights."""
    psd = datasets.get("psd")
    if psd is None or psd.attrs["form"] != "measured" or "scan" in psd.dims or not float(psd["sigma_heights"]) > 0:
        return None
    heights, spectrum = float(psd["sigma_heights"]), known_rms_height(psd)
    finding = f"{_nanometres(spectrum)} in the roughness spectrum, {_nanometres(heights)} of the heights"
    verdict = _verdict_by_limits(max(spectrum / heights, heights / max(spectrum, 1e-300)), HEIGHT_LIMITS)
    advice = "" if verdict == "pass" else "Measure a larger area, or one with fewer missing heights"
    return Judgement("Rms height", finding, verdict, advice)


def _energy(datasets: Datasets) -> Judgement | None:
    bsdf = datasets["bsdf"]
    if "energy_residual" not in bsdf:
        return None
    missed = float(bsdf["energy_residual"])
    # The fullest model is not of waves alone.
    accepted = _accepted_by_scene(datasets) if bsdf.attrs.get("optics") == "wave" else ""
    verdict = "pass" if accepted else _verdict_by_limits(missed, missed_light.LIMITS)
    finding = f"up to {missed:.2%} of the incident light" if missed >= 5e-5 else "less than 0.01% of the incident light"
    finding = "; ".join(filter(None, (finding, accepted)))
    return Judgement("Light that waves miss", finding, verdict, "" if verdict == "pass" else missed_light.advice(bsdf))


def _nanometres(micrometres: float) -> str:
    """A height to three significant digits, without an exponent."""
    return f"{np.format_float_positional(1e3 * micrometres, precision=3, fractional=False, trim='-')} nm"


def _verdict_by_limits(value: float, limits: tuple[float, float]) -> str:
    """Verdict on a value that has limits for warn and fail."""
    return "fail" if value > limits[1] else "warn" if value > limits[0] else "pass"


def _noise(datasets: Datasets) -> Judgement | None:
    if "psd" not in datasets or datasets["psd"].attrs["form"] != "measured":
        return None
    noise, heights = float(datasets["psd"]["noise_sigma"]), float(datasets["psd"]["sigma_heights"])
    if not noise > 0:
        return Judgement("Height noise", "none found: the roughness spectrum has no plateau", "pass")
    finding = f"{_nanometres(noise)}, {noise / heights:.1%} of the rms height; subtracted"
    if noise <= NOISE_LIMIT * heights:
        return Judgement("Height noise", finding, "pass")
    return Judgement(
        "Height noise", finding, "warn", "Average scans of the same place, or smooth the heights (`surface.lambda_s`)"
    )


def _tail(datasets: Datasets) -> Judgement | None:
    facets = datasets["facets"]
    if "tail_share" not in facets:
        return None
    share = float(facets["tail_share"])
    finding = f"{share:.2%} of the facets"
    if "tail_slope" in facets:
        finding += f", from a slope of {float(facets['tail_slope']):.2g}"
    contribution = float(facets.get("tail_contribution", 0.0))
    if "tail_contribution" in facets:
        finding += f", with {contribution:.0%} of the mean square slope"
    if share > TAIL_LIMIT:
        return Judgement("Extrapolated slopes", finding, "warn", "Measure a larger area, or a longer line")
    if contribution > TAIL_CONTRIBUTION_LIMIT:
        advice = "Look for spikes and scratches in the scan; measure a larger area, or a longer line"
        return Judgement("Extrapolated slopes", finding, "warn", advice)
    return Judgement("Extrapolated slopes", finding, "pass")


def _masking(datasets: Datasets) -> Judgement | None:
    """Smith's masking, or that of the heights; the masking of the prediction may differ from what the heights advise."""
    if "visibility" not in datasets or "predicted" not in datasets:
        return None
    advised, reason = (str(datasets["visibility"].attrs[name]) for name in ("masking", "reason"))
    used = str(datasets["predicted"].attrs.get("masking", ""))
    condition = "Masking of facets by their neighbours"
    if used == "measured":
        return Judgement(condition, f"traced on the heights; {reason}", "pass")
    if advised == "measured":
        advice = "Set `model.masking: auto`"
        return Judgement(condition, f"{used}; {reason}", "warn", advice)
    if "smith_error" not in datasets["visibility"]:
        return Judgement(condition, f"{used}; {reason}", "")
    if missed := _grazing_gloss_missed(datasets):
        return Judgement(condition, f"{used}; {reason}; {missed}", "warn", "Set `model.masking: measured`")
    return Judgement(condition, f"{used}; {reason}", "pass")


def _grazing_gloss_missed(datasets: Datasets) -> str:
    """What Smith's masking adds to the gloss at an angle that no reference solution judges, by the light of the facets of the heights; empty
    below the limit of gloss."""
    result, appearance, visibility = (datasets.get(name) for name in ("model_error", "appearance", "visibility"))
    if result is None or appearance is None or visibility is None or "gloss" not in appearance:
        return ""
    peak = visibility[["smith_error", "smith_error_u"]].sel(region="peak")
    for angle in _unjudged_gloss(result):
        if angle <= LARGEST_COMPARED or not {angle} <= set(peak["theta_i"].values) & set(
            appearance["gloss_angle"].values
        ):
            continue
        at, gloss = peak.sel(theta_i=angle), float(appearance["gloss"].sel(gloss_angle=angle))
        excess = gloss * (1 - 1 / (1 + float(at["smith_error"])))
        if float(certain_error(at["smith_error"], at["smith_error_u"])) > 0 and abs(excess) > GLOSS_LIMITS[0]:
            words = f"{float(at['smith_error']):+.0%} of the light in the peak at {angle:g}°, about {excess:+.1f} of {gloss:.1f} gloss units"
            return f"it gives {words}".replace("-", "−")
    return ""


def _model_error(datasets: Datasets) -> Judgement | None:
    condition = "Error of the predicted light"
    if (result := datasets.get("model_error")) is None:
        if "surface" not in datasets or datasets["bsdf"].attrs["representation"] in REFERENCES:
            return None
        two_faces = datasets["bsdf"].attrs.get("transmission") == "slab" or _is_coated(datasets)
        advice = "Compare with a measurement" if two_faces else "Set `model.truth: check`"
        return Judgement(condition, "not computed", "", advice)
    judged = result[["light_error", "light_error_u", "valid"]]
    peak = judged.sel(region="peak", theta_i=result["theta_i"].values[result["theta_i"].values <= LARGEST_JUDGED])
    light = peak["light_error"].where(peak["valid"] > 0)
    error = light.transpose("reference", "plane", "theta_i").values
    if np.isnan(error).all():
        if datasets.get("surface", result).get("height", result["theta_i"]).ndim == 1:
            finding = "not known for a line profile; masking along it is compared with Smith's below"
            return Judgement(condition, finding, "", "Measure an areal map")
        return Judgement(condition, "no reference solution holds", "warn", "Compare with a measurement")
    known = peak["theta_i"].values[~np.isnan(error).all(axis=(0, 1))]
    excess, of_light = _largest_error(light, peak["light_error_u"], ERROR_LIMITS)
    finding = f"in the peak {of_light('.1%')}, judged from {known.min():g} to {known.max():g}°"
    units = result["gloss_error"].where(result["gloss_valid"] > 0)
    if units.notnull().any():
        of_gloss, words = _largest_error(units, result["gloss_error_u"], GLOSS_LIMITS)
        finding, excess = f"{finding}; gloss {words('.1f')}", np.maximum(excess, of_gloss)
    if unjudged := _unjudged_gloss(result):
        finding += f"; gloss at {' and '.join(f'{angle:g}°' for angle in unjudged)} is not judged: no reference solution holds there"
    verdict = "fail" if excess[1] > 0 else "warn" if excess[0] > 0 else "pass"
    if verdict == "pass" and (open_question := _not_shown_within_limits(peak, result)):
        # An error that may be beyond the limit is not shown to be within it.
        return Judgement(condition, f"{finding}; {open_question}", "warn", "Measure a larger area")
    advice = str(result.attrs.get("advice", ""))
    return Judgement(condition, finding, verdict, "" if verdict == "pass" else advice[:1].upper() + advice[1:])


def _unjudged_gloss(result: xr.Dataset) -> list[float]:
    """Angles of gloss at which no reference solution holds."""
    held = (result["gloss_valid"] > 0).any([dim for dim in result["gloss_valid"].dims if dim != "gloss_angle"])
    return [float(angle) for angle in result["gloss_angle"].values[~held.values]]


def _not_shown_within_limits(peak: xr.Dataset, result: xr.Dataset) -> str:
    """What is not shown of the errors, in words; empty where each of them is known to its limit, and within it."""
    light = peak[["light_error", "light_error_u"]].where(peak["valid"] > 0)
    units = result[["gloss_error", "gloss_error_u"]].where(result["gloss_valid"] > 0)
    return " and ".join(
        [
            *_not_shown(light["light_error"], light["light_error_u"], ERROR_LIMITS[0], ".0%", " of the light"),
            *_not_shown(units["gloss_error"], units["gloss_error_u"], GLOSS_LIMITS[0], ".1f", " gloss units"),
        ]
    )


def _not_shown(error: xr.DataArray, u: xr.DataArray, limit: float, form: str, unit: str) -> list[str]:
    if (largest := float(u.max())) > limit:
        return [f"known only to ± {largest:{form}}{unit}"]
    return [f"not shown to be within {limit:{form}}{unit}"] if float(abs(error).max()) > limit else []


def certain_error(error: xr.DataArray, uncertainty: xr.DataArray) -> xr.DataArray:
    """Size of an error without :data:`SIGNIFICANT` standard uncertainties: what must exceed a limit. Negative where the error may be none."""
    return abs(error) - SIGNIFICANT * uncertainty


def _largest_error(
    error: xr.DataArray, u: xr.DataArray, limits: tuple[float, float]
) -> tuple[Array, Callable[[str], str]]:
    """By how much the most significant error exceeds each limit; and the words of the error that decides, value ± u and angle, in a number format."""
    angle = next(str(dim) for dim in error.dims if str(dim) in ("theta_i", "gloss_angle"))
    error, u = xr.broadcast(error, u)
    certain = certain_error(error, u).values
    # Where none certainly exceeds its limit, the largest error.
    at = np.nanargmax(certain if np.nanmax(certain) > limits[0] else abs(error).values)
    value, at_u = float(error.values.flat[at]), float(u.values.flat[at])
    row = np.unravel_index(at, error.shape)[error.dims.index(angle)]

    def words(form: str) -> str:
        return f"{value:+{form}} ± {at_u:{form}} at {float(error[angle][row]):g}°".replace("-", "−")

    return np.nanmax(certain) - np.array(limits), words
