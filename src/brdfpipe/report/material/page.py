"""The page of one material."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from urllib.parse import quote

import numpy as np
import xarray as xr

from brdfpipe.appearance.applicability import limits
from brdfpipe.appearance.origin import basis, gloss_readings, is_measured, route, solution_words
from brdfpipe.appearance.quantities import values, viewing_conditions
from brdfpipe.appearance.validity import validity
from brdfpipe.appearance.verdicts import (
    Acceptances,
    decisive,
    reason_to_accept,
    stage_title,
    stage_warnings,
    verdicts,
)
from brdfpipe.report import comparison, rendering, structured_data
from brdfpipe.report.cards import Section, Table
from brdfpipe.report.formatting import colour
from brdfpipe.report.material.checks import checks_section, exported_files, exports_table, provenance
from brdfpipe.report.material.colour import colour_section
from brdfpipe.report.material.head import key_numbers, looks
from brdfpipe.report.material.inputs import (
    coat_section,
    effect_pigment_section,
    facet_section,
    spectrum_section,
    surface_section,
)
from brdfpipe.report.material.model_error import model_error_section
from brdfpipe.report.material.plan import choice_words, plan_section
from brdfpipe.report.material.readings import readings_section
from brdfpipe.report.material.reflection import lambert_gauss_section, reflection_section
from brdfpipe.report.material.roughness import roughness_section
from brdfpipe.report.material.texture import texture_section
from brdfpipe.report.rendering import as_json, material_name, own_stages, render
from brdfpipe.report.rig import section as rig_section
from brdfpipe.report.viewer import viewer_data


def material_page(
    datasets: Mapping[str, xr.Dataset],
    *,
    description: str = "",
    accepted: Acceptances = (),
    unused: Mapping[str, str] = MappingProxyType({}),
    origins: Sequence[Sequence[str]] = (),
    files: Mapping[str, str] = MappingProxyType({}),
) -> str:
    """The report of one material, one self-contained HTML file.

    Parameters
    ----------
    datasets : stage → its dataset, in the order of the page; any may be absent
    description : of the material, by its user; untrusted, shown as text
    accepted : warnings that the description accepts
    unused : keys of the description that nothing uses, and why
    origins : key, value and origin of all that the description says, inherits or leaves to defaults
    files : stage → its file in relation to the page, for links

    Returns
    -------
    HTML that requests nothing from elsewhere, the same bytes for the same datasets; with the data set as JSON-LD. Its only script is that of
    the directional viewer and of the data of figures, allowed by its hash; without it the page has all figures.
    """
    known = own_stages(datasets)
    appearance = known.get("appearance")
    measured = is_measured(known)
    of_material = values(known)
    facts = list(key_numbers(known, of_material))
    conditions = [] if measured else validity(known)
    outcomes = verdicts(known, accepted, conditions)
    verdict, reasons = decisive(outcomes)
    exported = exports_table(known, material_name(known))
    inputs = [
        effect_pigment_section(known),
        surface_section(known),
        roughness_section(known),
        facet_section(known),
        coat_section(known),
        model_error_section(known),
        plan_section(known),
    ]
    sections = [
        readings_section(known),
        reflection_section(known),
        colour_section(known),
        texture_section(known),
        *([] if measured else inputs),
        lambert_gauss_section(known),
        checks_section(known),
        Section("Files", tables=[exported] if exported else []),
        _description_section(origins, known.get("spectrum")),
    ]
    prediction = [spectrum_section(known), *inputs] if measured else []
    name = material_name(known)
    technique = f"{route(known).capitalize()} from {basis(known) or 'no data'}"
    exported_paths = exported_files(known, name)
    directional = viewer_data(known)
    shown = [section for section in sections if section]
    scripts = [*(["figures.js"] if shown else []), *(["uPlot.js", "viewer.js"] if directional else [])]
    script, script_hash = rendering.script(*scripts) if scripts else ("", "")
    return render(
        "material.html.j2",
        viewer=as_json(directional) if directional else "",
        script=script,
        script_hash=script_hash,
        name=name,
        linked_data=structured_data.of_material(known, of_material, name, description, technique, exported_paths),
        description=description,
        route=": ".join(filter(None, (technique, solution_words(known)))),
        choice=choice_words(known),
        patch=colour(appearance["srgb"].values) if appearance is not None and "srgb" in appearance else None,
        viewing=viewing_conditions(appearance),
        looks=looks(known.get("preview")),
        verdict=verdict,
        reasons=reasons,
        verdicts=outcomes,
        facts=facts,
        plus_minus=any("±" in fact.value for fact in facts),
        validity=conditions,
        validity_note=_validity_note(known) if conditions else _no_conditions(known),
        limits=[*limits(known), *(f"`{key}` of material.yaml is not used: {why}." for key, why in unused.items())],
        warnings=[
            (stage_title(known, stage), text, reason_to_accept(text, accepted)) for stage, text in stage_warnings(known)
        ],
        sections=shown,
        prediction=[section for section in prediction if section],
        rig=rig_section.chapter(datasets),
        comparison=comparison.chapter(datasets.get("comparison")),
        downloads=[
            (title, [(quote(file), file.rpartition("/")[2]) for file in listed])
            for title, listed in _downloads(_datasets(files, known), exported_paths)
        ],
        provenance=[provenance(stage_title(known, stage), dataset) for stage, dataset in known.items()],
    )


def _datasets(files: Mapping[str, str], known: Mapping[str, xr.Dataset]) -> dict[str, str]:
    """The files without the records of exported ones, which have links of their own."""
    return {
        stage: file for stage, file in files.items() if stage not in known or known[stage].attrs["kind"] != "export"
    }


def _downloads(datasets: Mapping[str, str], exported: Sequence[str]) -> list[tuple[str, Sequence[str]]]:
    """Titles and files of the links, the BSDF itself first."""
    ordered = sorted(datasets.values(), key=lambda file: not file.endswith("bsdf.nc"))
    groups = [
        ("Datasets (netCDF), from which every figure is drawn", ordered),
        ("Exported for other programs", exported),
    ]
    return [(title, files) for title, files in groups if files]


def _description_section(origins: Sequence[Sequence[str]], spectrum: xr.Dataset | None) -> Section:
    """What the description says, and where each value came from; a value that the file of the spectrum overruled is that of the file."""
    section = Section("Description")
    stated = {} if spectrum is None else _stated_by_file(spectrum)
    rows = [
        (key, stated[key], f"the file, not {origin} ({value})")
        if key in stated and not _agrees(value, stated[key])
        else (key, value, origin)
        for key, value, origin in origins
    ]
    if rows:
        section.tables.append(Table("Keys of the material", ("Key", "Setting", "From"), rows))
    return section


def _validity_note(datasets: Mapping[str, xr.Dataset]) -> str:
    """Explains the symbols of the first table."""
    notes = []
    if "psd" in datasets:
        notes.append(
            "g: variance of the phase that the heights give to reflected light. Facets need 20; below 0.01 a surface mirrors."
        )
    if "model_error" in datasets:
        notes.append("±: one standard uncertainty (k = 1).")
    return " ".join(notes)


def _no_conditions(datasets: Mapping[str, xr.Dataset]) -> str:
    """Why there is no statement on trust; empty for a measured BRDF, whose uncertainty is its own."""
    if is_measured(datasets) or "bsdf" not in datasets:
        return ""
    if route(datasets) == "imported":
        return (
            "The BRDF is the table of a file, interpolated between its nodes. The file does not say how well it was measured or computed; "
            "the checks and warnings say where it contradicts itself or physics."
        )
    if "surface" in datasets:
        return "No condition of the model was judged: the surface is perfectly flat, or no facets were counted."
    if gloss_readings(datasets):
        return (
            "The surface is known by its gloss alone. No condition of the model can be judged without a scan: whether one density of slopes, without a lay "
            "and by geometrical optics, describes it. The uncertainties cover the slopes that have this gloss."
        )
    return (
        "Nothing of the surface was measured: there is no statement on how far gloss, haze and the angular figures can be trusted. They are "
        "those of the assumed finish. Set `surface: file` in material.yaml to use a measurement."
    )


def _stated_by_file(spectrum: xr.Dataset) -> dict[str, str]:
    """Keys that the file of a spectrum may overrule where they are inherited, with the values that the spectrum has."""
    incidence = f"{spectrum.attrs['theta_i']:g}"
    stated = {"spectrum.incidence": incidence, "spectrum.sci.incidence": incidence}
    if "specular_excluded_reflectance" not in spectrum:
        stated["spectrum.geometry"] = str(spectrum.attrs["geometry"])
        if stated["spectrum.geometry"] != "sce":
            stated["spectrum.specular_trap"] = "none: the specular component is included"
    u = spectrum["total_reflectance_u"].values if "total_reflectance_u" in spectrum else np.zeros(1)
    if u.min() != u.max():
        stated["spectrum.reflectance_uncertainty"] = f"{u.min():.2g} to {u.max():.2g}"
    return stated


def _agrees(value: str, stated: str) -> bool:
    try:
        return float(value) == float(stated)
    except ValueError:
        return value == stated
