"""The page of one material."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import xarray as xr
from markupsafe import Markup

from brdfpipe import vocabulary
from brdfpipe.bsdf import representations
from brdfpipe.errors import BrdfpipeError
from brdfpipe.report import comparison, dispersion, figures, finish, lobes, reflection, rig, scattering
from brdfpipe.report import flake_angle_plot as effect
from brdfpipe.report import measurement_coverage as reach
from brdfpipe.report.cards import Table
from brdfpipe.report.pages import MISSING, colour, fixed, grouped, number, render
from brdfpipe.report.svg import Figure, png, sentence

OTHER_CHAPTERS = frozenset({"reduced", "primary", "smoothed", "calibration", "comparison"})
"""Kinds of dataset that the chapters of the rig and of the comparison show."""

_UNITS = {"degree": "°", "sr-1": "sr⁻¹", "1": "", "nm": "nm"}

_FACETS = {
    "slope_rms": "rms slope",
    "anisotropy": "Anisotropy, larger over smaller principal rms slope",
    "lay": "Lay, azimuth of the smaller principal rms slope",
    "facet_count": "Facets",
    "effective_count": "Independent facets",
    "correlation_length": "Correlation length of the heights (1/e)",
    "noise_ratio": "rms slope over 1 pixel / over 2 pixels",
}

_CHECKS = (
    "reciprocity_residual",
    "energy_excess",
    "negative_fraction",
    "integral_residual",
    "closure_residual",
    "grazing_growth",
    "floor",
)
_COUNTS = ("facet_count", "effective_count")

_OF_PREDICTION = (
    "surface",
    "facets",
    "back_surface",
    "back_facets",
    "masking",
    "spectrum",
    "index",
    "interior",
    "multiangle",
    "flake",
)
"""Stages that a BRDF which was measured does not rest on: they tell what it is compared with."""

HIGH_GLOSS = 70.0
"""Gloss units at 60° above which haze means something: ASTM D4039 is for high-gloss nonmetallic surfaces."""

_DERIVED = ("preview", "table", "lambert_gauss")
"""Stages whose warnings tell what is missing in a by-product, and cast no doubt on the BRDF."""

RESIDUAL_LIMIT = 0.2
"""Misfit above which a Gaussian does not describe the lobe."""

MASKING_LIMIT = 0.03
"""Difference of G1 between rays and Smith above which the page explains it."""

_METALLIC = 0.1
"""Extinction coefficient above which no light returns from within a body: that of a metal."""

LOSS_LIMIT = 0.01
"""Share of the light lost to multiple scattering above which the page says what to do."""

_NO_LOSS = 1e-4
_ENERGY_EXACT = ("height-correlated", "separable")

_NANOMETRES_BELOW = 0.1
"""Lengths below this [µm] are written in nm."""


@dataclass(frozen=True)
class Fact:
    """A key number."""

    name: str
    value: str
    unit: str = ""
    hint: str = ""


@dataclass(frozen=True)
class Verdict:
    """The outcome of a check."""

    name: str
    verdict: str
    text: str


@dataclass
class Section:
    """A chapter of the page: figures, then verdicts, then tables."""

    title: str
    figures: list[Figure] = field(default_factory=list)
    tables: list[Table] = field(default_factory=list)
    verdicts: list[Verdict] = field(default_factory=list)

    def __bool__(self) -> bool:
        return bool(self.figures or self.tables or self.verdicts)


def material_page(datasets: Mapping[str, xr.Dataset], *, description: str = "") -> str:
    """The report of one material, one self-contained HTML file.

    Parameters
    ----------
    datasets : stage → its dataset, in the order of the page; any may be absent
    description : the material's own words; untrusted, shown as text

    Returns
    -------
    HTML without any request to elsewhere, without scripts, the same bytes for the same datasets
    """
    known = own_stages(datasets)
    numbers = _surface_parameters(known.get("surface"))
    inputs = [_effect(known), _relief(known, numbers), _finish(known)]
    prediction = [_spectral(known), *inputs] if _is_measured(known) else []
    own = [] if _is_measured(known) else inputs
    sections = [_appearance(known), _colour(known), *own, _fit(known), _quality(known)]
    found = verdicts(known)
    return render(
        "material.html.j2",
        name=material_name(known),
        description=description,
        route=_route_words(known),
        patch=preview(known.get("appearance")),
        viewing=_viewing(known.get("appearance")),
        look=_look(known.get("preview")),
        verdicts=found,
        facts=list(_facts(known, numbers)),
        limits=list(_limits(known)),
        warnings=[(_stage_words(known, stage), text) for stage, text in stage_warnings(known)],
        sections=[section for section in sections if section],
        prediction=[section for section in prediction if section],
        rig=rig.chapter(datasets),
        comparison=comparison.chapter(datasets.get("comparison")),
        provenance=[_provenance(_stage_words(known, stage), dataset) for stage, dataset in known.items()],
    )


def own_stages(datasets: Mapping[str, xr.Dataset]) -> dict[str, xr.Dataset]:
    """The datasets of a material but for the steps from the rig's frames to its measured BSDF, and for the comparison."""
    return {stage: dataset for stage, dataset in datasets.items() if dataset.attrs.get("kind") not in OTHER_CHAPTERS}


def material_name(datasets: Mapping[str, xr.Dataset]) -> str:
    """The name that the datasets carry."""
    return next(
        (str(dataset.attrs["material"]) for dataset in datasets.values() if "material" in dataset.attrs), "unnamed"
    )


def stage_warnings(datasets: Mapping[str, xr.Dataset]) -> list[tuple[str, str]]:
    """(stage, warning) of all stages, each warning once: a stage that passes one on does not repeat it."""
    seen: dict[str, str] = {}
    for stage, dataset in datasets.items():
        for text in vocabulary.warnings(dataset):
            seen.setdefault(text, stage)
    return [(stage, text) for text, stage in seen.items()]


def verdicts(datasets: Mapping[str, xr.Dataset]) -> list[Verdict]:
    """The verdicts of the checks and of the table, then ``warn`` for every stage that warned of what the BRDF rests on.

    The checks look at the BRDF alone: of a scan that hardly shows its facets they find a perfectly sound one.
    """
    return [*_checked(datasets), *_doubts(datasets)]


def _doubts(datasets: Mapping[str, xr.Dataset]) -> list[Verdict]:
    told: dict[str, list[str]] = {}
    for stage, text in stage_warnings({stage: each for stage, each in datasets.items() if stage not in _DERIVED}):
        told.setdefault(stage, []).append(text.strip().removesuffix("."))
    return [Verdict(_stage_words(datasets, stage), "warn", "; ".join(texts)) for stage, texts in told.items()]


def _stage_words(datasets: Mapping[str, xr.Dataset], stage: str) -> str:
    """A stage in words, which tell where it is but what a measurement is compared with."""
    inputs = _is_measured(datasets) and stage in _OF_PREDICTION
    return f"{_words(stage)} (of the prediction)" if inputs else _words(stage)


def _checked(datasets: Mapping[str, xr.Dataset]) -> list[Verdict]:
    found: dict[str, Verdict] = {}
    for stage in ("checks", "table"):
        for name, entry in _mapping(datasets[stage].attrs.get("verdicts") if stage in datasets else None).items():
            told = entry if isinstance(entry, dict) else {"verdict": entry}
            found[name] = Verdict(_words(name), str(told.get("verdict", "")), str(told.get("text", "")))
    return list(found.values())


def preview(appearance: xr.Dataset | None) -> str | None:
    """``#rrggbb`` of the material."""
    return colour(appearance["srgb"].values) if appearance is not None and "srgb" in appearance else None


def primary_lab(appearance: xr.Dataset | None) -> tuple[str, tuple[float, float, float]] | None:
    """The geometry people quote (the first that the appearance lists) and its L*a*b*."""
    if appearance is None or "lab" not in appearance or appearance["lab"].size == 0:
        return None
    lightness, a, b = appearance["lab"].values[0].tolist()
    return _labels(appearance["lab"], "geometry")[0], (lightness, a, b)


def no_gloss(datasets: Mapping[str, xr.Dataset]) -> str:
    """Why gloss would say nothing of the material, and what to do; empty where it does."""
    if not _finish_known(datasets):
        return (
            "No surface finish was measured or assumed: the gloss of the ideally matt BRDF would say nothing of the material. Give "
            "`surface` in material.yaml to model it."
        )
    # Of a paint whose clear coat is not modelled, the stage itself knows.
    why = str(datasets["appearance"].attrs.get("no_gloss", "")) if "appearance" in datasets else ""
    return f"{why[:1].upper()}{why[1:]}." if why else ""


_HAZE_ANGLES = (20.0, 60.0)
"""Gloss geometries of D4039."""


def no_haze(datasets: Mapping[str, xr.Dataset]) -> str:
    """Why D4039 does not apply, or what it would need is missing; empty where it does."""
    gloss = dict(_gloss(datasets.get("appearance")))
    if (why := no_gloss(datasets)) or not set(_HAZE_ANGLES) <= set(gloss):
        return why or "D4039 takes the gloss at 20° and at 60°, which were not both computed."
    if _metallic(datasets.get("bsdf")):
        return "D4039 is for nonmetallic surfaces, and this one is a metal."
    if not gloss[60.0] > HIGH_GLOSS:
        return f"D4039 is for more than {HIGH_GLOSS:g} gloss units at 60°, and this one has {fixed(gloss[60.0], 1)}."
    return ""


def haze(datasets: Mapping[str, xr.Dataset]) -> float:
    """Haze as of D4039, gloss at 60° less gloss at 20°; NaN outside of the standard's scope."""
    appearance = datasets.get("appearance")
    if appearance is None or "haze" not in appearance or no_haze(datasets):
        return math.nan
    return float(appearance["haze"])


def _finish_known(datasets: Mapping[str, xr.Dataset]) -> bool:
    """Whether a finish is known: a BRDF predicted without facets is matt by assumption."""
    return "facets" in datasets or route(datasets) != "predicted"


def luminous_reflectance(datasets: Mapping[str, xr.Dataset]) -> float:
    """Total reflectance weighted with V(λ) and D65; NaN where it is not known."""
    if "appearance" in datasets and "luminous_reflectance" in datasets["appearance"]:
        return float(datasets["appearance"]["luminous_reflectance"])
    # The BSDF's first: a spectrum measured with the specular excluded is not the total.
    stages = ("bsdf",) if _is_measured(datasets) else ("bsdf", "spectrum")
    holder = next((datasets[s] for s in stages if s in datasets and "total_reflectance" in datasets[s]), None)
    if holder is None or holder.attrs.get("geometry") == "sce":
        return math.nan
    reflectance = holder["total_reflectance"]
    if "wavelength" not in reflectance.dims:
        return float(reflectance)
    from brdfpipe.spectra.colorimetry import reflectance_to_xyz

    # V(λ) is the y-function of the 2-degree observer, whichever observer the colours are for.
    xyz = reflectance_to_xyz(reflectance["wavelength"].values, reflectance.values, "D65", 2)
    return float(xyz[1]) / 100


# --- the head of the page


_LIGHT = {
    "studio": "three soft boxes and a dim sky",
    "sun": "a small sun and a clear sky",
    "overcast": "an overcast sky",
}


def _look(picture: xr.Dataset | None) -> Figure | None:
    """The picture of the material."""
    if picture is None:
        return None
    pixels = picture["picture"].values
    uri = Markup('<img class="look" src="{}" width="{}" height="{}" alt="{}">')
    light = _LIGHT.get(str(picture.attrs["light"]), "lights")
    words = f"Sphere and flat panel under {light}"
    return Figure(
        "How it would look",
        uri.format(png(pixels), pixels.shape[1], pixels.shape[0], words),
        note=f"{words} of {picture.attrs['illuminant']}, computed from the BRDF. The exposure is the same for every material: "
        f"a perfect white diffuser reaches {100 * float(picture.attrs['white_level']):.0f} % of the screen's white, brighter light "
        "is compressed.",
    )


def _facts(datasets: Mapping[str, xr.Dataset], numbers: Mapping[str, xr.DataArray]) -> Iterator[Fact]:
    appearance = datasets.get("appearance")
    if not no_gloss(datasets):
        flags = _gloss_basis(appearance)
        yield from (
            Fact(f"Gloss {angle:g}°", fixed(value, 1), "GU", f"D523-style{_unmeasured(flags, angle)}")
            for angle, value in _gloss(appearance)
        )
        if math.isfinite(haze(datasets)):
            yield Fact("Haze", fixed(haze(datasets), 1), "GU", f"D4039-style{_unmeasured(flags, *_HAZE_ANGLES)}")
    lab = primary_lab(appearance)
    if lab is not None:
        geometry, values = lab
        yield Fact(
            "L* a* b*", "  ".join(fixed(value, 1) for value in values), "", f"{geometry}, {_viewing(appearance)}"
        )
    luminous = luminous_reflectance(datasets)
    if math.isfinite(luminous):
        yield Fact("Total reflectance", fixed(100 * luminous, 1), "%", "V(λ), D65")
    yield from _transmittance_fact(datasets.get("bsdf"))
    yield from _roughness_facts(datasets, numbers)


def _transmittance_fact(bsdf: xr.Dataset | None) -> Iterator[Fact]:
    if bsdf is not None and representations.transmits(bsdf):
        passed = scattering.transmittance(bsdf, scattering.planes(bsdf)[0], np.zeros(1))
        yield Fact(
            "Transmittance", fixed(100 * float(passed[0]), 1), "%", f"at 0°, {scattering.wavelength_words(bsdf)}"
        )


def _roughness_facts(datasets: Mapping[str, xr.Dataset], numbers: Mapping[str, xr.DataArray]) -> Iterator[Fact]:
    whose = "of the prediction, " if _is_measured(datasets) else ""
    for height in ("Sq", "Rq"):
        if height in numbers:
            yield Fact(height, *_length(float(numbers[height])), f"{whose}rms height")
    facets = datasets.get("facets", datasets.get("bsdf"))
    if facets is not None and "slope_rms" in facets and math.isfinite(float(facets["slope_rms"])):
        hint = f"{whose}all azimuths, {number(math.degrees(math.atan(float(facets['slope_rms']))), 2)}°"
        yield Fact("rms slope", number(float(facets["slope_rms"])), "", hint)
    if facets is not None and "slope_along" in facets.dims and "anisotropy" in facets:
        hint = (
            f"{whose}lay {finish.axis_degrees(float(facets['lay']))}" if "lay" in facets else whose.removesuffix(", ")
        )
        yield Fact("Anisotropy", number(float(facets["anisotropy"])), "", hint)


def _limits(datasets: Mapping[str, xr.Dataset]) -> Iterator[str]:
    """What the report cannot say, and why."""
    facets = datasets.get("facets")
    warned = any(vocabulary.warnings(datasets[stage]) for stage in ("predicted", "bsdf") if stage in datasets)
    if not _finish_known(datasets) and not warned:  # the stage that takes a material as matt says so itself
        yield (
            "Gloss and haze are not modelled. No surface finish was measured or assumed, so the BRDF is that of an ideally "
            "matt sample; give `surface` in material.yaml to model them."
        )
    elif facets is not None and "surface" not in datasets and route(datasets) == "predicted":
        method = str(facets.attrs.get("method", "")).strip()
        yield (
            f"The surface finish is assumed{f' ({method})' if method else ''}, not measured. Gloss, haze and the angular "
            "figures follow from the assumption; give `surface: file` in material.yaml to use a measurement."
        )
    modelled = route(datasets) != "measured" and not _without_base(datasets.get("bsdf"))
    if modelled and not {"spectrum", "multiangle"} & set(datasets):
        yield (
            "Colour and diffuse reflection are not modelled. No spectrum is known, so the BRDF holds the light mirrored by the "
            "facets alone; give `spectrum` in material.yaml to model the rest."
        )
    if "bsdf" not in datasets:
        yield "No BRDF was built."
    elif "checks" not in datasets:
        yield "The BRDF was not checked for reciprocity and energy."
    if "appearance" not in datasets:
        yield "Gloss, haze and colour were not computed."


def _without_base(bsdf: xr.Dataset | None) -> bool:
    """Whether no light comes from below the surface by its nature: a metal, or a body that light passes."""
    if bsdf is None:
        return False
    return representations.transmits(bsdf) or _metallic(bsdf)


def _metallic(bsdf: xr.Dataset | None) -> bool:
    return bsdf is not None and "k" in bsdf and float(bsdf["k"].min()) > _METALLIC


def _route_words(datasets: Mapping[str, xr.Dataset]) -> str:
    return f"{route(datasets).capitalize()} from {basis(datasets) or 'no data'}"


def route(datasets: Mapping[str, xr.Dataset]) -> str:
    """How the BRDF came about."""
    return str(datasets["bsdf"].attrs.get("route", "predicted")) if "bsdf" in datasets else "predicted"


def _is_measured(datasets: Mapping[str, xr.Dataset]) -> bool:
    """Whether stages of a prediction, if there are any, tell what a measurement is compared with, and not what the page is of."""
    return route(datasets) == "measured"


def basis(datasets: Mapping[str, xr.Dataset]) -> str:
    """What it rests on: ``surface + spectrum``, ``assumed finish``, …"""
    finish = "surface" if "surface" in datasets else "assumed finish" if "facets" in datasets else ""
    if route(datasets) == "measured":
        return "a camera rig"
    if route(datasets) == "flake" and "multiangle" in datasets:
        return f"colours at {datasets['multiangle'].sizes['geometry']} geometries"
    return " + ".join(part for part in (finish, "spectrum" if "spectrum" in datasets else "") if part)


def _viewing(appearance: xr.Dataset | None) -> str:
    if appearance is None:
        return ""
    return f"{appearance.attrs.get('illuminant', '')}/{appearance.attrs.get('observer', '')}°"


# --- chapters


def _appearance(datasets: Mapping[str, xr.Dataset]) -> Section:
    bsdf, checks = datasets.get("bsdf"), datasets.get("checks")
    passes = bsdf is not None and representations.transmits(bsdf)
    section = Section("Reflection and transmission" if passes else "Reflection")
    if bsdf is not None:
        try:
            section.figures += [*reflection.cuts(bsdf), *lobes.directional_maps(bsdf)]
        except BrdfpipeError as error:  # a measured table may not reach the directions shown
            section.figures.append(sentence("BRDF in the plane of incidence", f"Not shown: {error}"))
    section.figures += reflection.shares(checks, bsdf)
    polarised = lobes.polarisation(bsdf) if bsdf is not None else None
    section.figures += [polarised] if polarised else []
    table = _gloss_table(datasets)
    section.tables += [table] if table else []
    section.tables += [_model_table(bsdf)] if bsdf is not None and "masking" in bsdf.attrs else []
    return section


_MODEL = {
    "recipe": "Recipe",
    "masking": "Masking",
    "diffuse_mode": "Diffuse part",
    "multiple_scattering": "Multiple scattering",
    "transmission": "Transmission",
}


def _model_table(bsdf: xr.Dataset) -> Table:
    rows = [(title, str(bsdf.attrs[name])) for name, title in _MODEL.items() if name in bsdf.attrs]
    several = None if representations.transmits(bsdf) else reflection.multiple_scattering(bsdf)
    if several is None:  # of what transmits, the balance tells
        return Table("Model", ("Choice", "Value"), rows)
    masking = str(bsdf.attrs["masking"])
    if masking not in _ENERGY_EXACT:
        return Table("Model", ("Choice", "Value"), rows, _inexact_words(several, masking))
    title = "Light reflected more than once" + (", given back" if several.compensated else ", left out")
    rows.append((title, _percent(several.share)))
    return Table("Model", ("Choice", "Value"), rows, *_multiple_words(several))


def _inexact_words(several: reflection.MultipleScattering, masking: str) -> str:
    return (
        f"Masking `{masking}` is its source's own choice and need not keep energy: facets that were perfect mirrors would give out "
        f"{_percent(1 - several.mirrors)} of the light, mean over the hemisphere. `model.masking: height-correlated` never gives out more "
        "than arrives at any incidence; the checks say where this one does."
    )


def _multiple_words(several: reflection.MultipleScattering) -> tuple[str, str]:
    """What is to be known of light that the facets reflect more than once, and what must not be missed."""
    bound = f"mean over the hemisphere; of facets that were perfect mirrors, {_percent(max(several.mirrors, 0.0))}"
    if several.compensated:
        given = f"The light that leaves after a second reflection or more, {_percent(several.share)} ({bound}), is given back, diffuse."
        return given, ""
    lost = f"The plain model loses {_percent(several.share)} of the light to multiple scattering ({bound})"
    if several.share < _NO_LOSS:
        return f"{lost}: nothing worth giving back.", ""
    advice = f"{lost}; set `model.multiple_scattering: compensated` to give it back."
    return ("", advice) if several.share >= LOSS_LIMIT else (advice, "")


def _gloss_table(datasets: Mapping[str, xr.Dataset]) -> Table | None:
    appearance = datasets.get("appearance")
    gloss = _gloss(appearance)
    if not gloss:
        return None
    header: tuple[str, ...] = ("Geometry", "Gloss units")
    if why := no_gloss(datasets):
        angles = ", ".join(f"{angle:g}°" for angle, _ in gloss)
        return Table("Gloss", header, [(angles, "not modelled")], why)
    spread, flags = _spread(appearance), _gloss_basis(appearance)
    rows = [(f"{angle:g}°", fixed(value, 2), spread.get(angle, ""), flags.get(angle, "")) for angle, value in gloss]
    if appearance is not None and "haze" in appearance and np.isfinite(appearance["haze"]):
        title = "60° − 20°" if no_haze(datasets) else "Haze (D4039-style), 60° − 20°"
        u = _with_sign(appearance.get("haze_u"))
        rows.append((title, fixed(float(appearance["haze"]), 2), u, _worst(flags, *_HAZE_ANGLES)))
    if appearance is not None and "reflectance_haze" in appearance:
        beside = appearance["reflectance_haze"]
        doubts = appearance.get("reflectance_haze_u", xr.full_like(beside, np.nan))
        found = zip(_labels(beside, "haze_window"), beside.values.tolist(), doubts, strict=True)
        rows += [
            (f"Haze (ISO 13803-style), {window}", fixed(value, 2), _with_sign(u), "") for window, value, u in found
        ]
    note = "D523-style: computed from the BRDF with the standard's apertures; conformance is not claimed."
    note += _coat_words(datasets.get("bsdf"))
    title, words = _spread_words(appearance)
    columns = [0, 1]
    if spread:
        columns, header, note = [*columns, 2], (*header, title), note + words
    if flags:
        columns, header, note = [*columns, 3], (*header, "Basis"), f"{note} {_basis_note(flags.values())}"
    return Table("Gloss", header, [[row[column] for column in columns] for row in rows], note)


def _spread_words(appearance: xr.Dataset | None) -> tuple[str, str]:
    """What the uncertainty of gloss is of: a title, and a sentence."""
    own = appearance is not None and "BSDF" in str(appearance.get("gloss_u", xr.DataArray()).attrs.get("long_name", ""))
    tolerances = "standard uncertainty that the tolerances of apertures and axes leave"
    if own:
        return (
            "Uncertainty",
            f" Uncertainty: {tolerances}, of gloss together with the BRDF's own, which comes on top of that of haze.",
        )
    return "Tolerances", f" Tolerances: {tolerances}; the BRDF's own comes on top."


def _gloss_basis(appearance: xr.Dataset | None) -> dict[float, str]:
    """What gloss rests on by geometry, of ``QUALITY_FLAGS``; empty of a BSDF that rests on a model."""
    if appearance is None or "gloss_quality" not in appearance:
        return {}
    flags = [vocabulary.QUALITY_FLAGS[flag] for flag in appearance["gloss_quality"].values]
    return dict(zip(appearance["gloss_angle"].values.tolist(), flags, strict=True))


def _worst(flags: Mapping[float, str], *angles: float) -> str:
    """The flag of what rests on several geometries; empty where none has one."""
    found = [flags[angle] for angle in angles if angle in flags]
    return max(found, key=vocabulary.QUALITY_FLAGS.index, default="")


def _unmeasured(flags: Mapping[float, str], *angles: float) -> str:
    """What follows a hint: that some geometry was not measured, and what it is instead."""
    flag = _worst(flags, *angles)
    return f" ({flag})" if flag and flag not in reach.KNOWN else ""


def _coat_words(bsdf: xr.Dataset | None) -> str:
    """That the gloss of a paint follows from what was assumed of its clear coat; empty of other materials."""
    coat = "none" if bsdf is None else bsdf.attrs.get("clear_coat", "none")
    if bsdf is None or coat == "none":
        return ""
    if coat == "rough":
        return f" Gloss and haze are with the clear coat's slope as given ({float(bsdf['clear_coat_slope']):g}), not measured."
    return " Gloss and haze are with the clear coat taken as smooth, not measured."


def _with_sign(u: xr.DataArray | None) -> str:
    return "" if u is None else _sign(float(u))


def _spread(appearance: xr.Dataset | None) -> dict[float, str]:
    if appearance is None or "gloss_u" not in appearance:
        return {}
    angles, spread = appearance["gloss_angle"].values.tolist(), appearance["gloss_u"].values.tolist()
    return {angle: f"± {fixed(each, 2)}" for angle, each in zip(angles, spread, strict=True) if math.isfinite(each)}


def _gloss(appearance: xr.Dataset | None) -> list[tuple[float, float]]:
    """Angle and gloss units of every geometry that was computed."""
    if appearance is None or "gloss" not in appearance:
        return []
    angles, values = appearance["gloss_angle"].values.tolist(), appearance["gloss"].values.tolist()
    return [(angle, value) for angle, value in zip(angles, values, strict=True) if math.isfinite(value)]


def _colour(datasets: Mapping[str, xr.Dataset]) -> Section:
    """The colours, and the spectrum and index that they follow from, if they do."""
    inputs = Section("") if _is_measured(datasets) else _spectral(datasets)
    appearance = datasets.get("appearance")
    colours = [_lab_table(appearance)] if appearance is not None and "lab" in appearance else []
    return Section("Colour", inputs.figures, [*inputs.tables, *colours])


def _spectral(datasets: Mapping[str, xr.Dataset]) -> Section:
    section = Section("Spectrum and index")
    modelled = datasets.get("predicted" if _is_measured(datasets) else "bsdf")
    if "spectrum" in datasets:
        section.figures.append(figures.spectrum(datasets["spectrum"], modelled))
        recovered = _recovery_table(datasets["spectrum"])
        section.tables += [recovered] if recovered else []
    if "index" in datasets:
        section.figures += dispersion.dispersion(datasets["index"], modelled)
        section.tables += [_index_table(datasets["index"])] if dispersion.dispersive(datasets["index"]) else []
    return section


def _recovery_table(spectrum: xr.Dataset) -> Table | None:
    """How well a spectrum recovered from a colour has it, and what the choice of the method may cost under other light."""
    residual = float(spectrum.attrs.get("residual_delta_e", math.nan))
    if not math.isfinite(residual):
        return None
    method, against = str(spectrum.attrs["method"]), str(spectrum.attrs.get("metamerism_against", ""))
    rows = [("ΔE*ab to the colour given", fixed(residual, 2))]
    found = [
        (name.removeprefix("metamerism_"), spectrum.attrs[name]) for name in spectrum.attrs if _is_metamerism(name)
    ]
    rows += [(f"ΔE00 to {against} under {light}", fixed(float(apart), 2)) for light, apart in found]
    note = f"Recovered by {method}: many spectra have one colour."
    if found:
        note += f" ΔE00: how far the spectrum that {against} finds for it looks different under another light."
    else:
        note += " How it would look under another light is not known better: no other exact method reaches the colour."
    return Table("Recovery of the spectrum", ("Quantity", "Value"), rows, note)


def _is_metamerism(name: str) -> bool:
    return name.startswith("metamerism_") and name != "metamerism_against"


_BASIS = {
    "measured": "at an angle that was measured",
    "interpolated": "between angles that were measured",
    "extrapolated": "beyond the angles that were measured",
    "completed": "takes in directions that were not measured",
}


def _basis_note(flags: Collection[str]) -> str:
    return "Basis: " + "; ".join(f"{flag}, {_BASIS[flag]}" for flag in _BASIS if flag in flags) + "."


def _lab_table(appearance: xr.Dataset) -> Table:
    names, values = _labels(appearance["lab"], "geometry"), appearance["lab"].values.tolist()
    doubts = appearance.get("lab_u", xr.full_like(appearance["lab"], np.nan)).values.tolist()
    rows = [
        (name, *(f"{fixed(value, 2)} {_sign(u)}".rstrip() for value, u in zip(lab, each, strict=True)))
        for name, lab, each in zip(names, values, doubts, strict=True)
    ]
    header: tuple[str, ...] = ("Geometry", "L*", "a*", "b*")
    flop = float(appearance["flop_index"]) if "flop_index" in appearance else math.nan
    total = str(appearance.attrs.get("total_geometry", ""))
    notes = [f"{total}: all reflected light, as a sphere collects it."] if total in names else []
    if math.isfinite(flop):
        notes.append(f"Flop index {number(flop)} {_with_sign(appearance.get('flop_index_u'))}".rstrip() + ".")
    if "lab_u" in appearance and "angle_tolerance" in appearance.attrs:
        notes.append(
            f"±: standard uncertainty that ± {float(appearance.attrs['angle_tolerance']):g}° of the directions of light and of view "
            "leave, which is assumed of instruments; their apertures are not averaged over, and the BRDF's own comes on top."
        )
    if "lab_quality" in appearance:
        flags = [vocabulary.QUALITY_FLAGS[flag] for flag in appearance["lab_quality"].values]
        header, rows = (*header, "Basis"), [(*row, flag) for row, flag in zip(rows, flags, strict=True)]
        notes.append(_basis_note(flags))
    return Table(f"L*a*b*, {_viewing(appearance)}", header, rows, " ".join(notes))


def _sign(u: float) -> str:
    return f"± {fixed(u, 2)}" if math.isfinite(u) else ""


def _effect(datasets: Mapping[str, xr.Dataset]) -> Section:
    section = Section("Effect pigments")
    flake, multiangle = datasets.get("flake"), datasets.get("multiangle")
    if flake is None or multiangle is None:
        return section
    section.figures.append(effect.fall(flake, multiangle))
    note = (
        "θf: flake angle. ΔE00: of the fitted colour; left out: of the colour that the fit to the other geometries gives here, which "
        "takes four geometries or more."
    )
    section.tables.append(Table("Measured geometries", *effect.geometry_rows(flake, multiangle), note))
    words = "A and C on the scale of Y = 100." if "channel" in flake.dims else "A and C as fractions."
    section.tables.append(Table("Fit along the flake angle", *effect.parameter_rows(flake), words))
    return section


def _index_table(index: xr.Dataset) -> Table:
    lines = np.array([486.1, 587.6, 656.3])  # at which indices are quoted
    own = np.atleast_1d(index["wavelength"].values) if "wavelength" in index.coords else lines
    n, k = (np.interp(lines, own, np.broadcast_to(index[name].values, own.shape)) for name in ("n", "k"))
    rows = [
        (f"{line:g} nm", fixed(real, 4), number(imaginary)) for line, real, imaginary in zip(lines, n, k, strict=True)
    ]
    return Table("Refractive index at the lines F, d and C", ("Wavelength", "n", "k"), rows)


def _relief(datasets: Mapping[str, xr.Dataset], numbers: Mapping[str, xr.DataArray]) -> Section:
    section = Section("Surface")
    surface = datasets.get("surface")
    if surface is None:
        return section
    section.figures.append(figures.height_map(surface) if surface["height"].ndim == 2 else figures.profile(surface))
    rows = [
        (name.replace("_", " "), _quantity(numbers[name]), str(numbers[name].attrs.get("long_name", "")))
        for name in numbers
    ]
    note = _attributes(surface, ("levelling", "band"))
    if rows:
        section.tables.append(Table("Surface parameters", ("Parameter", "Value", "Definition"), rows, note))
    return section


def _surface_parameters(surface: xr.Dataset | None) -> dict[str, xr.DataArray]:
    if surface is None:
        return {}
    from brdfpipe.surfaces.texture_parameters import parameters

    found = parameters(surface)
    return {str(name): found[name] for name in found.data_vars if found[name].ndim == 0}


def _finish(datasets: Mapping[str, xr.Dataset]) -> Section:
    section = Section("Facets")
    if "facets" in datasets:
        section.figures += finish.facet_figures(datasets["facets"])
        section.tables.append(_facet_table(datasets["facets"]))
    if "masking" in datasets:
        section.figures.append(finish.raycast_figure(datasets["masking"], datasets.get("facets")))
        bistatic = finish.bistatic_figure(datasets["masking"])
        section.figures += [bistatic] if bistatic else []
        section.tables.append(_raycast_table(datasets["masking"]))
    return section


def _facet_table(facets: xr.Dataset) -> Table:
    rows = [(title, _facet_number(name, facets[name])) for name, title in _FACETS.items() if name in facets]
    if "slope_rms_scale" in facets and "scale" in facets.coords:
        rows += [
            (f"rms slope over {scale:g} pixel{'s' if scale != 1 else ''}", number(value))
            for scale, value in zip(facets["scale"].values, facets["slope_rms_scale"].values, strict=True)
        ]
    return Table("Facets in numbers", ("Quantity", "Value"), rows, _attributes(facets, ("method", "band")))


def _facet_number(name: str, scalar: xr.DataArray) -> str:
    if name in _COUNTS:
        return grouped(float(scalar))
    return finish.axis_degrees(float(scalar)) if name == "lay" else _quantity(scalar)


def _raycast_table(comparison: xr.Dataset) -> Table:
    columns = [
        comparison["theta"].values,
        comparison["g1_raycast"].values,
        2 * finish.raycast_uncertainty(comparison),
        comparison["g1_smith"].values,
    ]
    rows = [
        (f"{theta:g}°", fixed(cast, 4), fixed(doubt, 4), fixed(smith, 4), fixed(cast - smith, 4))
        for theta, cast, doubt, smith in np.stack(columns, axis=1).tolist()
    ]
    header = ("θ", "Ray casting", "± 2 u", "Smith", "Difference")
    title, note = "G₁ by ray casting and after Smith", _attributes(comparison, ("method",))
    return Table(title, header, rows, note, _disagreement(comparison))


def _disagreement(comparison: xr.Dataset) -> str:
    """What a difference between rays and Smith means and what to do; empty where it is small or within the uncertainty."""
    difference = np.abs(comparison["g1_raycast"].values - comparison["g1_smith"].values)
    doubt = np.nan_to_num(2 * finish.raycast_uncertainty(comparison))
    largest = int(np.argmax(np.where(difference > doubt, difference, 0.0)))
    if difference[largest] <= max(MASKING_LIMIT, doubt[largest]):
        return ""
    return (
        f"Rays and Smith differ by up to {fixed(difference[largest], 2)}, at {comparison['theta'].values[largest]:g}°. "
        "On the slopes of one line the two agree exactly: the facets counted are not those along the lines cast. Reasons are "
        "slopes that still rise towards one pixel (noise, or too wide a pitch), a lay taken for isotropic, missing heights, or "
        "too few independent facets. Measure more finely, with less noise or over a larger area, or check surface.isotropic; "
        "until then gloss and reflection at grazing angles are no better known than this."
    )


def _fit(datasets: Mapping[str, xr.Dataset]) -> Section:
    section = Section("Lambert + Gauss fit")
    fit = datasets.get("lambert_gauss")
    if fit is None or "theta_i" not in fit.coords:
        return section
    columns = (
        ("lambert", "Lambertian ρ", 1.0),
        ("gauss_peak", "Peak G₀, sr⁻¹", 1.0),
        ("gauss_fwhm_parallel", "FWHM ∥, °", 1.0),
        ("gauss_fwhm_perpendicular", "FWHM ⊥, °", 1.0),
        ("gauss_reflectance", "Gaussian ρ", 1.0),
        ("fit_residual", "Residual, %", 100.0),
    )
    theta_i = np.atleast_1d(fit["theta_i"].values)
    present = [(name, title, factor) for name, title, factor in columns if name in fit]
    values = [
        np.broadcast_to(factor * scattering.at_reference(fit[name]).values, theta_i.shape)
        for name, _, factor in present
    ]
    rows = [(f"{angle:g}°", *(number(value[k]) for value in values)) for k, angle in enumerate(theta_i)]
    note = "The residual is the flux-weighted rms misfit over the flux-weighted rms BRDF."
    if "wavelength" in fit["lambert"].dims:
        note = f"Lambertian ρ {scattering.wavelength_words(fit)}. {note}"
    header = ("Incidence", *(title for _, title, _ in present))
    section.tables.append(Table("Fit for each angle of incidence", header, rows, note, _misfit(fit)))
    return section


def _misfit(fit: xr.Dataset) -> str:
    """What to know of the incidences at which the lobe is no Gaussian; empty where there is none."""
    if "fit_residual" not in fit:
        return ""
    theta_i = np.atleast_1d(fit["theta_i"].values)
    poor = theta_i[np.broadcast_to(fit["fit_residual"].values, theta_i.shape) > RESIDUAL_LIMIT].tolist()
    if not poor:
        return ""
    where = "every incidence" if len(poor) == theta_i.size > 1 else ", ".join(f"{angle:g}°" for angle in poor)
    return (
        f"Residual above {RESIDUAL_LIMIT:.0%} at {where}: the lobe is not a Gaussian there; "
        "use the table or the BSDF itself."
    ).replace("%", "\u202f%")


def _quality(datasets: Mapping[str, xr.Dataset]) -> Section:
    section = Section("Checks", verdicts=_checked(datasets))
    checks = datasets.get("checks")
    if checks is not None:
        rows = [_named(checks[name]) for name in _CHECKS if name in checks]
        section.tables.append(Table("Checks in numbers", ("Quantity", "Value"), rows))
    return section


# --- provenance


def _provenance(stage: str, dataset: xr.Dataset) -> dict[str, Any]:
    attrs = dataset.attrs
    return {
        "stage": stage,
        "digest": str(attrs.get("digest", "")),
        "inputs": [(name, str(value)) for name, value in _mapping(attrs.get("inputs")).items()],
        "parameters": [
            (name, json.dumps(value, ensure_ascii=False)) for name, value in _mapping(attrs.get("parameters")).items()
        ],
        "software": ", ".join(f"{name} {value}" for name, value in _mapping(attrs.get("software")).items()),
        "history": [line for line in str(attrs.get("history", "")).splitlines() if line],
    }


def _mapping(text: object) -> dict[str, Any]:
    found = json.loads(text) if isinstance(text, str) and text else {}
    return found if isinstance(found, dict) else {}


# --- words and numbers


def _percent(share: float) -> str:
    return f"{number(100 * share, 2)}\u202f%"


def _named(scalar: xr.DataArray) -> tuple[str, str]:
    return str(scalar.attrs.get("long_name", scalar.name)), _quantity(scalar)


def _quantity(scalar: xr.DataArray) -> str:
    units = str(scalar.attrs.get("units", ""))
    value, unit = _length(float(scalar)) if units == "um" else (number(float(scalar)), _UNITS.get(units, units))
    return value if value == MISSING or not unit else value + unit if unit == "°" else f"{value} {unit}"


def _length(micrometres: float) -> tuple[str, str]:
    """A length and its unit."""
    if 0 < abs(micrometres) < _NANOMETRES_BELOW:
        return number(1000 * micrometres), "nm"
    return number(micrometres), "µm"


def _attributes(dataset: xr.Dataset, names: Sequence[str]) -> str:
    words = [f"{name.capitalize()}: {dataset.attrs[name]}." for name in names if dataset.attrs.get(name)]
    return re.sub(r"\bum\b", "µm", " ".join(words))


def _labels(values: xr.DataArray, dimension: str) -> list[str]:
    if dimension in values.coords:
        return [str(name) for name in values[dimension].values]
    return [str(k + 1) for k in range(values.sizes[dimension])]


def _words(name: str) -> str:
    return name.replace("_", " ")
