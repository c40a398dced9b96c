"""Files that follow from declarations: templates and editor schemas of descriptions, tables of keys and of appearance quantities.

``make keys`` (``python -m brdfpipe.catalogue.generated_files``) writes them into a checkout after a declaration was changed.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from brdfpipe import installation
from brdfpipe.appearance.quantities import docs_table
from brdfpipe.catalogue import calibration_keys, material_keys
from brdfpipe.catalogue.config_keys import Config
from brdfpipe.catalogue.default_keys import CatalogueDefaults
from brdfpipe.catalogue.reading_keys import MeasuredReadings
from brdfpipe.descriptions import rendering
from brdfpipe.file_formats import FileFormat
from brdfpipe.masking.modes import MODEL_DEFAULTS, OPTICS, TRUTHS
from brdfpipe.rig.plan_keys import PlanKeys
from brdfpipe.rig.reduction.certificate_keys import CertificateKeys
from brdfpipe.rig.rig_keys import RigKeys
from brdfpipe.scenes.glare_keys import GlareKeys
from brdfpipe.scenes.ladders import LADDERS
from brdfpipe.scenes.results import RESULTS
from brdfpipe.scenes.scene import load_scene, shipped_scenes
from brdfpipe.scenes.scene_keys import AS_MATERIAL, SceneKeys
from brdfpipe.spectra.formats.registry import FORMATS as SPECTRUM_FORMATS
from brdfpipe.surfaces.reading import FORMATS as SURFACE_FORMATS

DESCRIPTIONS: Mapping[str, Any] = {
    "material": material_keys.Material,
    "catalogue": CatalogueDefaults,
    "config": Config,
    "calibration": calibration_keys.Calibration,
    "certificate": CertificateKeys,
    "rig": RigKeys,
    "plan": PlanKeys,
    "scene": SceneKeys,
}
"""Description → its keys."""

RIG_TEMPLATE = """\
One camera rig. The values are those of a bench like the one of the Keldysh preprint; replace them by your own.
docs/rig.md explains every key; `brdfpipe rig doctor rig.yaml` tries the devices.
Without an angular target remove `target` here, and `target` from the `runs` of plan.yaml."""

PLAN_TEMPLATE = """\
One measurement of one sample. docs/rig.md explains every key.
`brdfpipe rig scan plan.yaml --dry-run` estimates frames, bytes and hours."""

MATERIAL_TEMPLATE = """\
One material: remove the # in front of what it has and enter your own values; lines that start with # do not count.
docs/materials.md explains every key; `brdfpipe check` says what is wrong or missing."""


MATERIAL_BLOCKS = f"""\
description: one line for the reader of the report

# The colour: a measured spectrum, a file in this folder …
spectrum: {{file: reflectance.txt, geometry: sci, incidence: 8, scale: percent, reflectance_uncertainty: 0.003}}

# … or L*, a*, b* of a colorimeter.
spectrum: {{lab: [50, 0, 0], illuminant: D65, observer: 10, geometry: sci, reflectance_uncertainty: 0.003}}

# The surface: a scan, a file in this folder (X3P, an instrument's own format, NumPy or text) …
surface: {{file: surface.x3p, form: plane}}

# … with the noise of its heights, and further scans of the same finish …
surface: {{file: surface.x3p, noise: 0.002, noise_uncertainty: 0.0005, scans: [{{file: surface-2.x3p}}]}}

# … or a line profile …
surface: {{file: profile.txt, layout: line, unit: um, pitch: 0.5, isotropic: true}}

# … or an assumed finish …
surface: {{distribution: beckmann, slope_rms: 0.15}}

# … with its correlation length, from which waves follow …
surface: {{distribution: beckmann, slope_rms: 0.05, length: 5}}

# … or one whose gloss was read (`measured.gloss` below) …
surface: {{distribution: measured-gloss}}

# … or a polished one.
surface: {{distribution: flat}}

# The refractive index, needed with a surface: a plastic (ABS, PC/ABS, PP, PMMA, PC, PS, SAN), a number, n and k of a metal,
# or a table of wavelength, n and, where it absorbs, k.
index: ABS

index: 1.52

index: {{n: 1.2, k: 7.0}}

index: {{file: index.txt}}

# How well the index is known; the uncertainties of gloss and colours include what is stated here and as `…_uncertainty` elsewhere.
index_uncertainty: 0.005

# A paint with effect pigments: its colours at three geometries or more, from a multi-angle instrument; it needs nothing else.
multiangle: {{file: colours.csv, illuminant: D65, observer: 10, index: 1.5, model: flake-physical}}

# A table of the BSDF from another program or instrument; it needs nothing else.
table: {{file: vinyl.bsdf, format: zemax}}

# A clear body: light passes it, `surface` is its front, and there is no `spectrum`.
slab: {{thickness: 2, internal_transmittance: 0.95, transmittance_uncertainty: 0.005, back: same}}

# … or with an absorption coefficient.
slab: {{thickness: 2, absorption: {{file: absorption.txt, unit: 1/mm}}}}

# A clear coat or a film on an opaque body: `surface` and `index` are those of the coat, `spectrum` is that of the coated body.
coat: {{thickness: 0.04, base: {{index: 1.59, surface: flat}}}}

# … on a metal with a surface of its own, without `spectrum`.
coat: {{thickness: 0.04, absorption: 2, base: {{index: {{n: 1.2, k: 7.0}}, surface: {{distribution: beckmann, slope_rms: 0.1}}}}}}

# Readings of the laboratory's own instruments, beside which the prediction is put.
measured: {{gloss: {{20: 3.1, 60: 22.4, 85: 48}}, instrument: hand-held gloss meter, date: 2026-01-31}}

# Visible structure beside the BRDF, of a scan, for scenes that ask for it: docs/texture.md.
texture: {{pixel: 10, size: 512, method: spectrum}}

# … or of an effect paint, from pictures.
texture: {{pictures: [{{file: 45as15.tif, geometry: 45as15}}], pixel: 20, curve: linear}}

# How the reflection is modelled, where the defaults do not fit; docs/model.md says what each choice breaks.
model: {rendering.flow({"optics": OPTICS[0], **MODEL_DEFAULTS, "truth": TRUTHS[0]})}

model: {{recipe: crf}}

# Files for other programs; by default those of config.yaml.
exports: [astm]"""
"""The alternatives that the template of a material shows."""


def templates() -> dict[str, str]:
    """The templates of descriptions, by path in the project."""
    return {
        "config/material.template.yaml": rendering.alternatives(
            material_keys.Material, MATERIAL_TEMPLATE, MATERIAL_BLOCKS
        ),
        "config/rig.template.yaml": rendering.template(RigKeys, RIG_TEMPLATE, included=("target",)),
        "config/plan.template.yaml": rendering.template(PlanKeys, PLAN_TEMPLATE),
    }


def editor_schemas() -> dict[str, str]:
    """The JSON schemas of descriptions, by path in the project."""
    return {f"config/schemas/{name}.schema.json": rendering.editor_schema(keys) for name, keys in DESCRIPTIONS.items()}


def key_tables() -> dict[str, dict[str, str]]:
    """The key tables of the documentation: page → name of the table → rows."""
    keys = material_keys
    return {
        "docs/materials.md": {
            "material": rendering.table(keys.Material, nested=False),
            "surface": rendering.table(keys.Surface, "surface."),
            "spectrum": rendering.table(keys.Spectrum, "spectrum."),
            "slab": rendering.table(keys.Slab, "slab.", nested=False),
            "coat": rendering.table(keys.Coat, "coat.", nested=False),
            "coat.base": rendering.table(keys.CoatedBody, "coat.base.", nested=False),
            "multiangle": rendering.table(keys.Multiangle, "multiangle."),
            "measured": rendering.table(MeasuredReadings, "measured."),
            "table": rendering.table(keys.TableFile, "table."),
            "model": rendering.table(keys.Model, "model."),
            "catalogue": rendering.table(CatalogueDefaults),
            "config": rendering.table(Config),
            "formats of surfaces": _surface_format_table(),
            "formats of spectra": _spectrum_format_table(),
        },
        "docs/rig.md": {
            "rig": rendering.table(RigKeys),
            "plan": rendering.table(PlanKeys),
            "material.rig": rendering.table(keys.RigRoute, "rig.", "Key in material.yaml"),
            "calibration": rendering.table(calibration_keys.Calibration),
            "certificate": rendering.table(CertificateKeys),
        },
        "docs/texture.md": {"texture": rendering.table(keys.Texture, "texture.")},
        "docs/veiling-glare.md": {"glare": rendering.table(GlareKeys, "glare.")},
        "docs/scenes.md": {
            "scenes": _scene_table(),
            "results": _result_table(),
            "ladders": _ladder_table(),
            "scene": rendering.table(SceneKeys),
        },
    }


def _scene_table() -> str:
    rows = ["| Scene | Purpose | Results | Error that is accepted |", "|---|---|---|---|"]
    for name in shipped_scenes():
        content = load_scene(name).content
        exports = content["exports"]
        formats = "exports as the material asks" if exports == AS_MATERIAL else ", ".join(exports)
        listed = ", ".join(filter(None, (*(f"`{result}`" for result in content["results"]), formats)))
        rows.append(f"| `{name}` | {content['purpose']} | {listed} | {content['metric']} {content['tolerance']:g} |")
    return "\n".join(rows)


def _result_table() -> str:
    rows = [f"| `{result.name}` | {result.words} |" for result in RESULTS.values()]
    return "\n".join(["| In `results` | is |", "|---|---|", *rows])


def _ladder_table() -> str:
    rows = ["| Ladder | Rung | Leaves out |", "|---|---|---|"]
    for name, ladder in LADDERS.items():
        words = name.replace("_", " ")
        rows += [f"| {words} | `{rung.name}` | {rung.leaves_out or 'nothing'} |" for rung in ladder]
    return "\n".join(rows)


def _spectrum_format_table() -> str:
    rows = ["| Format | Extensions | Holds | Read by | Tried on |", "|---|---|---|---|---|"]
    rows += [
        f"| `{name}` | {_extensions(known)} | {known.description} | {known.read_by} | {known.tried or 'files that the tests write'} |"
        for name, known in SPECTRUM_FORMATS.items()
    ]
    return "\n".join(rows)


def _surface_format_table() -> str:
    rows = ["| Format | Extensions | Needs | Read by | Tried on | Rows |", "|---|---|---|---|---|---|"]
    rows += [
        f"| `{name}` | {_extensions(known)} | {known.description} | {known.read_by} | {known.tried or 'no real file'} | {known.orientation} |"
        for name, known in SURFACE_FORMATS.items()
    ]
    return "\n".join(rows)


def _extensions(known: FileFormat) -> str:
    return " ".join(f"`{extension}`" for extension in known.extensions) or "none: name the format"


def files(project: Path) -> dict[str, str]:
    """Every file that follows from declarations, by path in the project; pages with their tables renewed."""
    pages = {
        page: rendering.with_tables((project / page).read_text("utf-8"), tables)
        for page, tables in key_tables().items()
    }
    return templates() | editor_schemas() | pages | {"docs/quantities.md": docs_table()}


if __name__ == "__main__":
    folder = installation.project_folder()
    for path, text in files(folder).items():
        (folder / path).parent.mkdir(exist_ok=True)
        (folder / path).write_text(text, encoding="utf-8")
