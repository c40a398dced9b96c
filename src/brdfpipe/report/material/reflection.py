"""Sections on the BRDF: reflection and transmission with gloss and the model, and the Lambert + Gauss fit."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import xarray as xr

from brdfpipe.appearance.applicability import HAZE_ANGLES, gloss_exclusion, gloss_units
from brdfpipe.appearance.gloss_basis import gloss_flags, worst_flag
from brdfpipe.appearance.multiple_scattering import MultipleScattering, multiple_scattering
from brdfpipe.appearance.quantities import quantity
from brdfpipe.bsdf.change_variables import NOT_STATED
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.representations.wave import Wave
from brdfpipe.errors import BrdfpipeError
from brdfpipe.masking.modes import MULTIPLE_SCATTERING_ADVISED, PHYSICAL_MASKINGS
from brdfpipe.report.cards import Section, Table
from brdfpipe.report.formatting import (
    basis_legend,
    decimals_with_u,
    fixed,
    labels,
    number,
    percent,
    plus_minus_u,
    uncertainty_value,
)
from brdfpipe.report.plots import bsdf_cuts, bsdf_sections, directional_maps, reflectance
from brdfpipe.report.plots.svg import Figure

LOSS_LIMIT = 0.01
"""Share of the light lost to multiple scattering above which the page advises to add it."""

_NEGLIGIBLE_LOSS = 1e-4
_MODEL_CHOICES = {
    "recipe": "Recipe",
    "optics": "Optics",
    "form": "Theory of the halo",
    "masking": "Masking",
    "diffuse_mode": "Diffuse part",
    "multiple_scattering": "Multiple scattering",
    "transmission": "Transmission",
}

_REGIME_INCIDENCES = (0.0, 20.0, 45.0, 60.0, 75.0, 85.0)
_REGIME_WAVELENGTHS = (450.0, 550.0, 650.0)

RESIDUAL_LIMIT = 0.2
"""Residual above which a Gaussian does not describe the lobe."""

_FIT_COLUMNS = (
    ("lambert", "Lambertian ρ", 1.0),
    ("gauss_peak", "Peak G₀, sr⁻¹", 1.0),
    ("gauss_fwhm_parallel", "FWHM ∥, °", 1.0),
    ("gauss_fwhm_perpendicular", "FWHM ⊥, °", 1.0),
    ("gauss_reflectance", "Gaussian ρ", 1.0),
    ("fit_residual", "Residual, %", 100.0),
)

_STYLE_NOTE = "D523-style: computed from the BRDF with the apertures of the standard. Conformance is not claimed."


def reflection_section(datasets: Mapping[str, xr.Dataset]) -> Section:
    """Curves, maps and parts of the BRDF and BTDF, gloss, and the model."""
    bsdf = datasets.get("bsdf")
    transmits = bsdf is not None and representation(bsdf).transmits
    section = Section("Reflection and transmission" if transmits else "Reflection")
    if bsdf is not None:
        try:
            section.figures += [*bsdf_cuts.cuts(bsdf), *directional_maps.directional_maps(bsdf)]
        except BrdfpipeError as error:  # a measured table may not cover the directions shown
            section.figures.append(Figure("BRDF in the plane of incidence", note=f"Not shown: {error}"))
    section.figures += reflectance.shares(datasets.get("checks"), bsdf)
    section.figures += filter(None, [None if bsdf is None else directional_maps.polarisation(bsdf)])
    section.tables += filter(None, [gloss_table(datasets), source_table(datasets)])
    if bsdf is not None and ("masking" in bsdf.attrs or "optics" in bsdf.attrs):
        section.tables += filter(None, [regime_table(bsdf), model_table(bsdf)])
    return section


# --- gloss


def gloss_table(datasets: Mapping[str, xr.Dataset]) -> Table | None:
    """Gloss at each geometry, haze after D4039, haze after ISO 13803; None where no gloss was computed."""
    appearance = datasets.get("appearance")
    gloss = gloss_units(appearance)
    if appearance is None or not gloss:
        return None
    header: tuple[str, ...] = ("Quantity", quantity("haze").unit)
    if reason := gloss_exclusion(datasets):
        geometries = ", ".join(quantity(f"gloss_{angle:g}").label for angle in gloss)
        return Table("Gloss", header, [(geometries, "not modelled")], reason)
    flags, rows = gloss_flags(appearance), list(_gloss_rows(datasets, appearance))
    columns, note = [0, 1], _STYLE_NOTE + _clear_coat_note(datasets.get("bsdf"))
    if "gloss_u" in appearance and np.isfinite(appearance["gloss_u"]).any():
        title, sentence = _uncertainty_words(appearance)
        columns, header, note = [*columns, 2], (*header, title), note + sentence
    if flags:
        columns, header, note = [*columns, 3], (*header, "Basis"), f"{note} {basis_legend(flags.values())}"
    return Table("Gloss", header, [[row[column] for column in columns] for row in rows], note)


def _gloss_rows(datasets: Mapping[str, xr.Dataset], appearance: xr.Dataset) -> Iterator[tuple[str, str, str, str]]:
    """Label, value, uncertainty and basis of gloss, of G60 − G20, called haze only where D4039 applies, and of ISO 13803 windows."""
    flags, haze, window_haze = gloss_flags(appearance), quantity("haze"), quantity("reflectance_haze")
    for angle, (value, u) in zip(appearance["gloss_angle"].values.tolist(), _values(appearance, "gloss"), strict=True):
        if math.isfinite(value):
            gloss = quantity(f"gloss_{angle:g}")
            yield gloss.label, *_with_u(value, u, gloss.decimals), flags.get(angle, "")
    for value, u in _values(appearance, "haze"):
        if math.isfinite(value):
            label = haze.symbol if haze.exclusion(datasets) else haze.label
            yield label, *_with_u(value, u, haze.decimals), worst_flag(appearance, *HAZE_ANGLES)
    if "reflectance_haze" in appearance:
        windows = labels(appearance["reflectance_haze"], "haze_window")
        for window, (value, u) in zip(windows, _values(appearance, "reflectance_haze"), strict=True):
            yield f"{window_haze.label}, {window}", *_with_u(value, u, window_haze.decimals), ""


def _with_u(value: float, u: float, decimals: int) -> tuple[str, str]:
    """A value with the digits that its uncertainty leaves, and ``± u``, which is empty where it is not known."""
    return fixed(value, decimals_with_u(u, decimals)), plus_minus_u(u)


def _values(appearance: xr.Dataset, name: str) -> list[tuple[float, float]]:
    """Values of a variable and their standard uncertainties, NaN where these are not known."""
    if name not in appearance:
        return []
    uncertainty = appearance.get(f"{name}_u", xr.full_like(appearance[name], np.nan))
    return list(zip(appearance[name].values.ravel().tolist(), uncertainty.values.ravel().tolist(), strict=True))


def _uncertainty_words(appearance: xr.Dataset) -> tuple[str, str]:
    """Title of the column, and a sentence on what the uncertainty includes."""
    source = "standard uncertainty from the tolerances of apertures and axes"
    if "gloss_u_source" in appearance:
        return "Uncertainty, k = 1", " Uncertainty: standard uncertainty from all known sources."
    if "BSDF" in str(appearance["gloss_u"].attrs.get("long_name", "")):
        included = "that of gloss includes the uncertainty of the BRDF, that of haze does not"
        return "Uncertainty, k = 1", f" Uncertainty: {source}; {included}."
    return "Tolerances, k = 1", f" Tolerances: {source}. The uncertainty of the BRDF is not included."


_SOURCE_TITLES = {
    "facets": "Facets counted",
    "noise": "Noise of the heights",
    "psd": "Roughness spectrum",
    "index": "Refractive index",
    "spectrum": "Reflectance spectrum",
    "colours": "Measured colours",
    "clear_coat": "Slope of the clear coat",
    "transmittance": "Internal transmittance",
    "model": "Model",
    "instrument": "Instrument",
}


def source_table(datasets: Mapping[str, xr.Dataset]) -> Table | None:
    """Standard uncertainty of gloss, haze and colour from each source; None where that of the inputs is not known."""
    appearance, bsdf = datasets.get("appearance"), datasets.get("bsdf", xr.Dataset())
    if appearance is None or "gloss_u_source" not in appearance:
        return None
    columns: dict[str, tuple[str, dict[str, Any]]] = {}
    if not gloss_exclusion(datasets):
        columns |= {
            quantity(f"gloss_{angle:g}").label: ("gloss", {"gloss_angle": angle}) for angle in gloss_units(appearance)
        }
        columns |= {name: (name, {}) for name in ("haze",) if f"{name}_u_source" in appearance}
    columns["L* 45:0"] = ("lab", {"geometry": "45:0", "component": "L*"})
    columns["L* 45as15"] = ("lab", {"geometry": "45as15", "component": "L*"})
    by_source = [appearance[f"{name}_u_source"].sel(at).values for name, at in columns.values()]
    total = [float(appearance[f"{name}_u"].sel(at)) for name, at in columns.values()]
    sources = map(str, appearance["source"].values)
    rows = [
        (_SOURCE_TITLES.get(source, source), *map(uncertainty_value, values))
        for source, *values in zip(sources, *by_source, strict=True)
    ]
    note = "Standard uncertainties. Each source changes all directions and wavelengths together."
    if missing := [name for name in str(bsdf.attrs.get(NOT_STATED, "")).split(", ") if name]:
        listed = ", ".join(_SOURCE_TITLES.get(name, name).lower() for name in missing)
        note += f" Not known, and none assumed: {listed}."
    header = ("Source", *(title if title != "haze" else quantity("haze").symbol for title in columns))
    return Table(
        "Uncertainty by source, k = 1", header, [*rows, ("All together", *map(uncertainty_value, total))], note
    )


def _clear_coat_note(bsdf: xr.Dataset | None) -> str:
    """The assumption on the clear coat of a paint; empty for other materials."""
    if bsdf is None or (coat := bsdf.attrs.get("clear_coat", "none")) == "none":
        return ""
    if coat == "rough":
        slope = float(bsdf["clear_coat_slope"])
        return f" The slope of the clear coat is given ({slope:g}), not measured; gloss and haze follow from it."
    return " The clear coat is assumed smooth, not measured; gloss and haze follow from it."


# --- model


def regime_table(bsdf: xr.Dataset) -> Table | None:
    """Shares of the surface's reflection that are coherent, and as of facets, by incidence and wavelength; None for facets alone."""
    evaluator = representation(bsdf)
    if not isinstance(evaluator, Wave):
        return None
    wavelength = bsdf["wavelength"].values
    nearest = np.unique([wavelength[np.abs(wavelength - nm).argmin()] for nm in _REGIME_WAVELENGTHS])
    coherent, facets = (100 * share for share in evaluator.regime(np.array(_REGIME_INCIDENCES), nearest))
    shares = np.stack([coherent, np.maximum(100 - coherent - facets, 0.0), facets], axis=-1)
    note = (
        "Of the light that the surface reflects towards the mirror direction: the share that is reflected coherently, as by a smooth "
        "surface; the share that is scattered as waves are; and the share that is reflected as by facets."
    )
    if "cut_error" in bsdf:
        note += (
            f" Roughness of {1e3 * float(bsdf['fine_sigma']):.3g} nm rms is too fine to be facets, and dims and spreads their reflection. If the "
            f"frequency that parts both moves by a factor of 1.5, the lobe changes by up to {percent(float(bsdf['cut_error']))}."
        )
    if (missed := float(bsdf["energy_residual"])) > _NEGLIGIBLE_LOSS:
        note += f" Waves miss up to {percent(missed)} of the incident light; it enters the base."
    rows = [
        (f"{angle:g}°", *(f"{share:.0f}\u202f%" for share in row.ravel()))
        for angle, row in zip(_REGIME_INCIDENCES, shares, strict=True)
    ]
    header = ["Incidence", *(f"{nm:g} nm, {name}" for nm in nearest for name in ("coherent", "waves", "facets"))]
    return Table("Coherent light, waves and facets", header, rows, note)


def model_table(bsdf: xr.Dataset) -> Table:
    """Choices of the model, with a note on multiple scattering."""
    rows = [(title, str(bsdf.attrs[name])) for name, title in _MODEL_CHOICES.items() if name in bsdf.attrs]
    if (
        "optics" not in bsdf.attrs
        and bsdf.attrs["representation"] == "microfacet"
        and not representation(bsdf).transmits
    ):
        masking = str(bsdf.attrs["masking"])
        cause = "" if masking in PHYSICAL_MASKINGS else f", as masking `{masking}` is of facets alone"
        rows.insert(0, ("Optics", f"facets{cause}"))
    # The balance of the light shows the losses of a body that transmits.
    several = None if representation(bsdf).transmits else multiple_scattering(bsdf, bsdf_sections.REFERENCE_WAVELENGTH)
    texts: tuple[str, ...] = ()
    if several is not None and (masking := str(bsdf.attrs["masking"])) not in PHYSICAL_MASKINGS:
        note = (
            f"Masking `{masking}` follows its source and need not conserve energy. Facets that are perfect mirrors would reflect "
            f"{percent(1 - several.mirrors)} of the light, mean over the hemisphere. `model.masking: height-correlated` never reflects "
            "more than arrives. The checks state where this model does."
        )
        texts = (note,)
    elif several is not None:
        state = "lost" if several.mode == "none" else several.mode
        rows.append((f"Light reflected more than once, {state}", percent(several.share)))
        texts = _scattering_note_and_remark(several, bsdf.attrs)
    return Table("Model", ("Choice", "Value"), rows, *texts)


def _scattering_note_and_remark(several: MultipleScattering, modes: Mapping[str, Any]) -> tuple[str, str]:
    """A note, and a remark where the loss is large and a key adds the light."""
    mean = f"mean over the hemisphere; for facets that are perfect mirrors {percent(max(several.mirrors, 0.0))}"
    if several.mode in ("directional", "measured"):
        light = f"Light that leaves after two or more reflections, {percent(several.share)} ({mean})"
        source = "as traced on the map" if several.mode == "measured" else "that the facets give it"
        return f"{light}, leaves in the directions {source}.", ""
    if several.mode == "compensated":
        light = f"Light that leaves after two or more reflections, {percent(several.share)} ({mean})"
        return f"{light}, is compensated by a diffuse part.", ""
    loss = f"The model loses {percent(several.share)} of the light to multiple scattering ({mean})"
    if several.share < _NEGLIGIBLE_LOSS:
        return f"{loss}: negligible.", ""
    if MULTIPLE_SCATTERING_ADVISED in modes:
        return (
            f"{loss} after Smith. The default does not add it; the history of the BSDF says why.",
            "",
        )
    if modes["masking"] == "separable":
        key = "`model.masking: height-correlated`"
    elif modes["diffuse_mode"] == "crf":
        key = "`model.diffuse: coupled`"
    else:
        key = "`model.multiple_scattering: auto`"
    advice = f"{loss}. Set {key} to add it."
    return ("", advice) if several.share >= LOSS_LIMIT else (advice, "")


# --- Lambert + Gauss fit


def lambert_gauss_section(datasets: Mapping[str, xr.Dataset]) -> Section:
    """Parameters and residuals of the fit."""
    section = Section("Lambert + Gauss fit")
    fit = datasets.get("lambert_gauss")
    if fit is None or "theta_i" not in fit.coords:
        return section
    theta_i = np.atleast_1d(fit["theta_i"].values)
    present = [column for column in _FIT_COLUMNS if column[0] in fit]
    columns = [
        np.broadcast_to(factor * bsdf_sections.at_reference(fit[name]).values, theta_i.shape)
        for name, _, factor in present
    ]
    rows = [(f"{angle:g}°", *(number(column[k]) for column in columns)) for k, angle in enumerate(theta_i)]
    note = "Residual: flux-weighted rms misfit over the flux-weighted rms BRDF."
    if "wavelength" in fit["lambert"].dims:
        note = f"Lambertian ρ {bsdf_sections.wavelength_words(fit)}. {note}"
    header = ("Incidence", *(title for _, title, _ in present))
    section.tables.append(Table("Fit at each angle of incidence", header, rows, note, _residual_remark(fit)))
    return section


def _residual_remark(fit: xr.Dataset) -> str:
    """Incidences at which the lobe is not a Gaussian; empty where there are none."""
    if "fit_residual" not in fit:
        return ""
    theta_i = np.atleast_1d(fit["theta_i"].values)
    poor = theta_i[np.broadcast_to(fit["fit_residual"].values, theta_i.shape) > RESIDUAL_LIMIT].tolist()
    if not poor:
        return ""
    angles = "every incidence" if len(poor) == theta_i.size > 1 else ", ".join(f"{angle:g}°" for angle in poor)
    return f"Residual above {100 * RESIDUAL_LIMIT:.0f}\u202f% at {angles}: the lobe is not a Gaussian there. Use the table or the BSDF itself."
