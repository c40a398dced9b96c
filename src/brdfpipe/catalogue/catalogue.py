"""The catalogue: one folder a material, each with a ``material.yaml``, validated before anything is computed.

One bad material never stops the others: it becomes a line in :attr:`Catalogue.failures`.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

from brdfpipe import documents, installation
from brdfpipe.errors import BrdfpipeError, InputError, printable

DESCRIPTION = "material.yaml"

NAME = r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}"
"""What a material may be called: it becomes a folder of the results."""

RESERVED = frozenset(
    {"logs", "failures", "exports", "calibrations", "catalogue", "index", "index.html"}
    | {"catalogue.nc", "catalogue.csv", "catalogue.lock.json"}
)
"""Names that mean something else in the results folder."""

SURFACE_STAGE_KEYS = (
    *("file", "format", "layout", "unit", "lateral_unit", "pitch", "channel"),
    *("form", "lambda_s", "lambda_c", "azimuth"),
)
"""Keys of ``surface`` that say how a scan is read and levelled; the rest says what is made of it."""

FILE_PARTS = ("surface", "index", "spectrum", "multiangle")

MULTIANGLE_STAGE_KEYS = ("file", "colours", "wavelength", "illuminant", "observer", "scale")
"""Keys of ``multiangle`` that say what was measured; the rest says what is made of it."""

ROUTES = (("rig", "measured"), ("multiangle", "flake"))
"""Parts of a description that make a BSDF of their own, the one to be preferred first; else it is predicted."""

MODEL_DEFAULTS = {"masking": "height-correlated", "diffuse": "coupled", "multiple_scattering": "none"}
"""What holds where ``model`` does not say otherwise, by a recipe or one by one."""

RECIPE_MASKING = {"crf": "crf"}
"""What a recipe of ``model`` means for its masking."""

CALIBRATIONS, CALIBRATION = "calibrations", "calibration.yaml"
"""Where a catalogue describes the calibrations of its rigs: one folder each, with this description."""

RIG_STAGE_KEYS = {
    "rig_run": ("emulate",),
    "reduced": ("override",),
    "primary": ("override", "lamp_hours"),
    "smoothed": ("smoothing",),
    "calibration": ("valid_days", "valid_hours", "lamp_hours", "override"),
}
"""Keys of ``rig``, and of a calibration, that a stage depends on."""

INTERIOR = ("internal_transmittance", "absorption")
"""Keys of ``slab`` of which one says what passes the body."""

TRANSMITTING_MASKING = ("height-correlated", "separable")
"""Modes of ``model.masking`` that keep energy where light passes a surface."""

RESULT_MARKS = (".build.lock", ".snakemake", "catalogue.nc")
"""What tells a folder of results."""


class CatalogueError(BrdfpipeError):
    """The catalogue or the configuration as a whole cannot be used."""


@dataclass(frozen=True)
class Material:
    """One material: its validated description, with defaults, and its raw files."""

    name: str
    folder: Path
    content: Mapping[str, Any]
    files: Mapping[str, Path]
    """Part of the description (surface, index, spectrum, back_surface, interior; surface-2 … for further scans; rig) → raw file."""

    def has(self, part: str) -> bool:
        """Whether the description has this part: surface, index, spectrum, multiangle, slab, back (a face of its own), or what a prediction needs."""
        if part == "predicted":
            # Where the BSDF comes from elsewhere, nothing is to be said of a spectrum as a perfect diffuser.
            alone = not any(self.has(other) for other, _ in ROUTES)
            return "surface" in self.content or ("spectrum" in self.content and alone)
        if part == "back":
            return isinstance(self.content.get("slab", {}).get("back"), Mapping)
        return part in self.content

    @property
    def exports(self) -> tuple[str, ...]:
        return tuple(self.content["exports"])

    @property
    def scans(self) -> list[int]:
        """Numbers of the further scans of the surface, from 2."""
        return [number for number, _ in enumerate(self.content.get("surface", {}).get("scans", []), start=2)]

    def scan_spec(self, number: int) -> dict[str, Any]:
        """How a further scan is read: like the first, but for its own file and azimuth."""
        surface = self.content["surface"]
        shared = {key: surface[key] for key in SURFACE_STAGE_KEYS if key in surface and key != "azimuth"}
        return shared | dict(surface["scans"][number - 2])

    def spec(self, stage: str, config: Mapping[str, Any]) -> dict[str, Any]:
        """The part of the description and the configuration that a stage depends on, and nothing else."""
        if stage in ("surface", "back_surface", "facets", "back_facets"):
            surface = self.content["slab"]["back"] if stage.startswith("back") else self.content.get("surface", {})
            kept = SURFACE_STAGE_KEYS if stage.endswith("surface") else set(surface) - {*SURFACE_STAGE_KEYS, "scans"}
            return {key: value for key, value in surface.items() if key in kept}
        if stage == "interior":
            clear = {} if "absorption" in self.content["slab"] else {"internal_transmittance": 1}
            return clear | {key: value for key, value in self.content["slab"].items() if key != "back"}
        if stage == "index":
            return {"index": self.content["index"]}
        if stage == "spectrum":
            return dict(self.content["spectrum"])
        if stage in ("multiangle", "flake"):
            given = self.content["multiangle"]
            return {key: given[key] for key in given if (key in MULTIANGLE_STAGE_KEYS) == (stage == "multiangle")}
        if stage in RIG_STAGE_KEYS:
            return {key: self.content["rig"][key] for key in RIG_STAGE_KEYS[stage] if key in self.content["rig"]}
        if stage == "predicted":
            # Written out, so that saying the default changes nothing.
            choices = ["masking"] if self.has("slab") else list(MODEL_DEFAULTS)
            default = {} if "recipe" in self.content["model"] else {key: MODEL_DEFAULTS[key] for key in choices}
            return default | dict(self.content["model"])
        if stage == "bsdf":
            return {"route": next((route for part, route in ROUTES if self.has(part)), "predicted")}
        if stage == "appearance":
            return {key: config[key] for key in ("illuminant", "observer", "gloss_angles")} | dict(config["appearance"])
        if stage == "preview":
            return {"illuminant": config["illuminant"], "light": config["preview_light"]}
        if stage in ("table", "lambert_gauss", "comparison"):
            return dict(config[stage])
        if stage == "report":
            return {"description": self.content.get("description", ""), "exports": sorted(self.exports)}
        return {}


@dataclass(frozen=True)
class Calibration:
    """A run of the etalon on a rig, and the certificate it goes by."""

    name: str
    folder: Path
    content: Mapping[str, Any]
    files: Mapping[str, Path]
    """``rig``: the plan, or the journal of the finished run; ``certificate``."""

    @property
    def previous(self) -> str:
        """The calibration of the same rig before this one; empty if none is told of."""
        return str(self.content.get("previous", ""))

    def spec(self, stage: str) -> dict[str, Any]:
        """The part of the description that a stage depends on."""
        return {key: self.content[key] for key in RIG_STAGE_KEYS.get(stage, ()) if key in self.content}


@dataclass(frozen=True)
class Catalogue:
    """The materials that can be built, the reasons why others cannot, and the configuration."""

    folder: Path
    materials: tuple[Material, ...]
    failures: Mapping[str, str]
    """Name of a material (or its folder) → what is wrong with it, in one line."""
    config: Mapping[str, Any] = field(repr=False)
    calibrations: Mapping[str, Calibration] = field(default_factory=dict)

    @cached_property
    def by_name(self) -> Mapping[str, Material]:
        return {material.name: material for material in self.materials}

    def __getitem__(self, name: str) -> Material:
        try:
            return self.by_name[name]
        except KeyError:
            raise CatalogueError(
                f"{self.folder.name}: no material {name!r}{documents.nearest(name, self.by_name)}"
            ) from None

    def spec(self, name: str, stage: str) -> dict[str, Any]:
        """See :meth:`Material.spec`."""
        return self[name].spec(stage, self.config)

    def calibrations_of(self, material: Material) -> list[str]:
        """The calibration of a rig's material, and all before it that its chart goes back to."""
        names = [material.content["rig"]["calibration"]]
        while previous := self.calibrations[names[-1]].previous:
            names.append(previous)
        return names


def load(folder: Path, config: Mapping[str, Any] | None = None) -> Catalogue:
    """Read and validate every material of a catalogue; compute nothing.

    Parameters
    ----------
    folder : its sub-folders that hold a ``material.yaml`` are the materials
    config : see :func:`load_config`; default the project's own

    Raises
    ------
    CatalogueError : the folder is missing or holds no material.
    """
    config = load_config() if config is None else config
    folder = Path(folder).resolve()
    if not folder.is_dir():
        raise CatalogueError(f"{folder}: no such folder")
    if (folder / DESCRIPTION).is_file():
        raise CatalogueError(f"{folder}: is one material; give the folder it stands in")
    folders = sorted(path.parent for path in folder.glob(f"*/{DESCRIPTION}") if not path.parent.name.startswith("."))
    if not folders:
        near = "".join(f"; {name}: {why}" for name, why in [*ignored(folder).items()][:3])
        raise CatalogueError(f"{folder}: holds no material; `brdfpipe new NAME --folder {folder}` starts one{near}")
    loaded = {printable(path.name): _attempt(path, config) for path in folders}
    clashes = _clashes(loaded)
    failures = {name: found for name, found in loaded.items() if isinstance(found, str)} | clashes
    materials = {
        found.name: found for name, found in loaded.items() if isinstance(found, Material) and name not in failures
    }
    calibrations = load_calibrations(folder)
    for name, why in _without_rig(materials, calibrations).items():
        failures[name] = why
        del materials[name]
    usable = {name: found for name, found in calibrations.items() if isinstance(found, Calibration)}
    return Catalogue(folder, tuple(materials[name] for name in sorted(materials)), failures, config, usable)


def load_calibrations(folder: Path) -> dict[str, Calibration | str]:
    """The calibrations a catalogue describes, or what is wrong with them."""
    found: dict[str, Calibration | str] = {}
    for path in sorted(folder.glob(f"{CALIBRATIONS}/*/{CALIBRATION}")):
        try:
            found[path.parent.name] = _load_calibration(path)
        except BrdfpipeError as error:
            found[path.parent.name] = str(error)
    return {name: _without_previous(name, found) or each for name, each in found.items()}


def _without_previous(name: str, calibrations: Mapping[str, Calibration | str]) -> str:
    """What is wrong with the calibration before one, or with any before that; empty if nothing is."""
    own = calibrations[name]
    if not (isinstance(own, Calibration) and own.previous):
        return ""
    found, names = calibrations.get(own.previous), _backwards(name, calibrations)
    if found is None:
        others = [other for other in calibrations if other != name]
        problem = f"no such calibration{documents.nearest(own.previous, others)}"
        accepted = ", ".join(others) or "nothing; there is no other"
    elif names[-1] in names[:-1]:
        problem, accepted = f"calibrations before one another: {' → '.join(names)}", "one that was made before"
    elif accepted := found if isinstance(found, str) else _without_previous(own.previous, calibrations):
        problem = "the calibration cannot be used"
    else:
        return ""
    path = own.folder / CALIBRATION
    return str(InputError(path, problem, where="previous", found=repr(own.previous), accepted=accepted))


def _backwards(name: str, calibrations: Mapping[str, Calibration | str]) -> list[str]:
    """A calibration and those before it, to the first, or to where it comes round."""
    names = [name]
    while isinstance(each := calibrations.get(names[-1]), Calibration) and each.previous:
        names.append(each.previous)
        if each.previous in names[:-1]:
            break
    return names


def _load_calibration(path: Path) -> Calibration:
    _check_name(path.parent.name)
    content = documents.read(path, installation.project_folder() / "config" / "schemas" / "calibration.schema.yaml")
    home = "the calibration's folder"
    files = {"rig": documents.file_beside(path, *_rig_file(content, ""), home)}
    files["certificate"] = documents.file_beside(path, content["certificate"], "certificate", home)
    return Calibration(path.parent.name, path.parent, content, files)


def _rig_file(content: Mapping[str, Any], where: str) -> tuple[str, str]:
    """What tells of the frames: the journal of a finished run, or the plan of one to be emulated; and the key that names it."""
    return (f"{content['run']}/journal.jsonl", f"{where}run") if "run" in content else (content["plan"], f"{where}plan")


def _without_rig(materials: Mapping[str, Material], calibrations: Mapping[str, Calibration | str]) -> dict[str, str]:
    """Materials whose calibration, or whose emulated truth, there is not."""
    failures = {}
    for name, material in materials.items():
        if not material.has("rig"):
            continue
        path, rig = material.folder / DESCRIPTION, material.content["rig"]
        calibration, truth = rig["calibration"], rig.get("emulate", {}).get("truth")
        found = calibrations.get(calibration, "")
        if not isinstance(found, Calibration):
            accepted = found or ", ".join(calibrations) or f"a folder {CALIBRATIONS}/{calibration} with {CALIBRATION}"
            near = documents.nearest(calibration, calibrations)
            problem = "the calibration cannot be used" if found else f"no such calibration{near}"
            failures[name] = str(
                InputError(path, problem, where="rig.calibration", found=repr(calibration), accepted=accepted)
            )
        elif truth is not None and (truth not in materials or "emulate" in materials[truth].content.get("rig", {})):
            measurable = [other for other in materials if "emulate" not in materials[other].content.get("rig", {})]
            problem = f"no material that could be measured{documents.nearest(truth, measurable)}"
            accepted = ", ".join(measurable[:10])
            failures[name] = str(
                InputError(path, problem, where="rig.emulate.truth", found=repr(truth), accepted=accepted)
            )
    return failures


def ignored(folder: Path) -> dict[str, str]:
    """Folders of a catalogue that look like materials and are none: name → what was found and what to do, in one line."""
    found = {}
    for place in sorted(item for item in folder.iterdir() if item.is_dir() and not item.name.startswith((".", "_"))):
        if place.name == CALIBRATIONS:
            continue
        if not (place / DESCRIPTION).is_file() and not any((place / mark).exists() for mark in RESULT_MARKS):
            found[printable(place.name)] = _why_ignored(place)
    return {name: why for name, why in found.items() if why}


def load_config(path: Path | None = None) -> dict[str, Any]:
    """The configuration of a catalogue: the project's own, with what ``path`` says instead.

    Raises
    ------
    InputError : naming the file, the key, what stands there and what could.
    """
    schema = installation.project_folder() / "config" / "schemas" / "config.schema.yaml"
    config = documents.read(installation.project_folder() / "config" / "config.yaml", schema)
    if path is None:
        return config
    own = _over(config, documents.read(path, schema))
    _check_illuminant(path, own["illuminant"], "illuminant")
    _check_angles(path, own)
    _check_haze(path, own["appearance"]["haze"])
    return own


def _over(common: Mapping[str, Any], own: Mapping[str, Any]) -> dict[str, Any]:
    """What one mapping says over another, key by key within mappings too; a list stands for itself."""
    return {
        **common,
        **{key: _over(common[key], own[key]) if isinstance(own[key], Mapping) else own[key] for key in own},
    }


def _check_angles(path: Path, config: Mapping[str, Any]) -> None:
    """Refuse lists of angles that do not increase: every material would fail by them."""
    lists = {("lambert_gauss", "theta_i"), *(("table", key) for key in ("theta_i", "theta_o", "phi_o", "phi_i"))}
    for part, key in sorted(lists):
        angles = list(config.get(part, {}).get(key, []))
        if any(second <= first for first, second in pairwise(angles)):
            raise InputError(
                path, "the angles do not increase", where=f"{part}.{key}", found=angles, accepted="a rising list"
            )
    phi = config.get("table", {}).get("phi_o", [0, 180])
    if (phi[0], phi[-1]) != (0, 180):
        found = f"{phi[0]:g} to {phi[-1]:g}"
        raise InputError(
            path, "the azimuths do not span half a circle", where="table.phi_o", found=found, accepted="0 to 180"
        )


def _check_haze(path: Path, windows: Sequence[Mapping[str, Any]]) -> None:
    """Refuse windows of a haze meter that cannot be: every material would fail by them."""
    from brdfpipe.appearance import haze

    for place, window in enumerate(windows):
        try:
            haze.checked_window(window)
        except haze.HazeError as error:
            raise InputError(path, str(error), where=f"appearance.haze.{place}") from error


def load_material(folder: Path, config: Mapping[str, Any]) -> Material:
    """Read and validate one material.

    Raises
    ------
    InputError : naming the file, the line, the key, what stands there and what could.
    """
    path = folder / DESCRIPTION
    content = documents.read(path, installation.project_folder() / "config" / "schemas" / "material.schema.yaml")
    name = str(content.get("name", folder.name))
    _check_name(name, path)
    content.setdefault("exports", config["exports"])
    _check_together(path, content)
    if content.get("slab", {}).get("back") == "flat":
        content["slab"] = content["slab"] | {"back": {"distribution": "flat"}}
    files = {
        part: documents.file_beside(path, file, f"{where}.file", "the material's folder")
        for part, where, file in _raw_names(content)
    }
    if "rig" in content:
        files["rig"] = documents.file_beside(path, *_rig_file(content["rig"], "rig."), "the material's folder")
    return Material(name, folder, content, files)


def _raw_names(content: Mapping[str, Any]) -> Iterator[tuple[str, str, str]]:
    """Part, key and name of each raw file of a description."""
    slab = content.get("slab", {})
    holders = [(part, part, content.get(part)) for part in FILE_PARTS]
    holders += [("back_surface", "slab.back", slab.get("back"))]
    holders += [("interior", f"slab.{key}", slab.get(key)) for key in INTERIOR]
    for part, where, holder in holders:
        if isinstance(holder, Mapping) and "file" in holder:
            yield part, where, holder["file"]
    for number, scan in enumerate(content.get("surface", {}).get("scans", []), start=2):
        yield f"surface-{number}", "surface.scans", scan["file"]


def _check_together(path: Path, content: Mapping[str, Any]) -> None:
    """Refuse what each key allows and physics does not."""
    if isinstance(content.get("index"), Mapping) and set(content["index"]) == {"n"}:
        from brdfpipe.optics.index import without_k

        raise without_k(path, content["index"]["n"])
    model = content["model"]
    masking = model.get("masking", RECIPE_MASKING.get(model.get("recipe"), MODEL_DEFAULTS["masking"]))
    if model.get("multiple_scattering") == "compensated" and masking not in ("height-correlated", "separable"):
        raise InputError(
            path,
            "what this masking loses cannot be compensated, because it does not keep energy",
            where="model.masking",
            found=repr(masking),
            accepted="height-correlated or separable, or `multiple_scattering: none`",
        )
    if "slab" not in content:
        return
    if "spectrum" in content:
        raise InputError(
            path,
            "`slab` and `spectrum` stand together: a clear body has no diffuse base that a reflectance spectrum could tell of, "
            "its colour is what it absorbs on the way through",
            accepted="`slab` with `internal_transmittance` or `absorption`; or `spectrum` without `slab`, for an opaque body",
        )
    if masking not in TRANSMITTING_MASKING:
        raise InputError(
            path,
            "this masking does not keep energy where light passes a surface",
            where="model.masking",
            found=repr(masking),
            accepted=", ".join(TRANSMITTING_MASKING),
        )
    for key, why in (
        ("diffuse", "a clear body has no diffuse base"),
        ("multiple_scattering", "a slab always keeps the light that its facets reflect more than once"),
    ):
        if key in model:
            raise InputError(
                path, why, where=f"model.{key}", found=repr(model[key]), accepted=f"`slab` without `model.{key}`"
            )
    if isinstance(content["index"], Mapping) and content["index"].get("k", 0) > 0:
        raise InputError(
            path,
            "the body of a slab would be opaque: an extinction coefficient takes all light within micrometres",
            where="index.k",
            found=content["index"]["k"],
            accepted="k of 0; what the body absorbs is said by `slab.internal_transmittance` or `slab.absorption`",
        )
    if isinstance(content["slab"]["back"], Mapping) and "scans" in content["slab"]["back"]:
        raise InputError(
            path, "further scans are counted for the front alone", where="slab.back.scans", accepted="one file"
        )


def parts(material: Material) -> list[str]:
    """What a material brings, in words."""
    return [_words(part, material.content[part]) for part in (*FILE_PARTS, "slab", "rig") if material.has(part)]


def check_formats(material: Material) -> None:
    """Check what can be told of the raw files without reading them, and the names of the plastic and the illuminant.

    Raises
    ------
    InputError : an empty file, an extension nobody reads, an unknown plastic or illuminant.
    """
    from brdfpipe.columns import TEXT_SUFFIXES
    from brdfpipe.optics import index
    from brdfpipe.optics.index import refractive_index
    from brdfpipe.spectra import containers
    from brdfpipe.surfaces.reading import FORMATS

    suffixes = {"spectrum": containers.SUFFIXES, "index": index.SUFFIXES}
    known = {suffix: name for name, form in FORMATS.items() for suffix in form.extensions}
    keys = {part: where.removesuffix(".scans") for part, where, _ in _raw_names(material.content)}
    for part, path in material.files.items():
        if part == "rig":
            continue
        scanned = "surface" in part
        accepted = known if scanned else suffixes.get(part, TEXT_SUFFIXES)
        if path.stat().st_size == 0:
            raise InputError(path, "empty", key=f"{keys[part]}.file")
        stated = material.content["slab"]["back"] if part == "back_surface" else material.content.get("surface", {})
        named = "format" in (stated if scanned else material.content["spectrum"] if part == "spectrum" else {})
        if path.suffix.lower() not in accepted and not named:
            key = f"{keys[part]}.format" if scanned else f"{keys[part]}.file"
            raise InputError(
                path,
                "the extension tells no known format",
                found=path.suffix or "none",
                accepted=", ".join(sorted(accepted)),
                key=key,
            )
    if material.has("index") and "index" not in material.files:
        refractive_index(material.content["index"])
    spectrum = material.content.get("spectrum", {})
    if "illuminant" in spectrum:
        _check_illuminant(material.folder / DESCRIPTION, spectrum["illuminant"], "spectrum.illuminant")
    if "colours" in material.content.get("multiangle", {}):
        from brdfpipe.flakes.reading import ingest

        ingest(material.spec("multiangle", {}))


def start_material(folder: Path, name: str) -> Path:
    """Write a commented description to start a material from, beside raw files that are there already; return its path.

    Raises
    ------
    CatalogueError : the name cannot be used, the material exists, or the folder cannot be written.
    """
    _check_name(name)
    path = folder / name / DESCRIPTION
    template = (installation.project_folder() / "config" / "material.template.yaml").read_text(encoding="utf-8")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("x", encoding="utf-8") as file:
            file.write(template)
    except FileExistsError as error:
        raise CatalogueError(f"{error.filename}: exists already; choose another name") from None
    except OSError as error:
        raise CatalogueError(f"{path.parent}: cannot be written ({error.strerror})") from error
    return path


def _words(part: str, content: Any) -> str:
    if not isinstance(content, Mapping):
        return f"{part} {content}"
    if part == "slab":
        return f"slab {content['thickness']:g} mm"
    if part == "rig":
        return f"rig run {content['run']}" if "run" in content else f"rig emulated with {content['emulate']['truth']}"
    if "k" in content:
        return f"{part} {content['n']:g} + {content['k']:g}i"
    if "colours" in content:
        return f"{part} {len(content['colours'])} colours"
    return f"{part} " + ("L*a*b*" if "lab" in content else str(content.get("file") or content.get("distribution")))


def _attempt(folder: Path, config: Mapping[str, Any]) -> Material | str:
    try:
        return load_material(folder, config)
    except BrdfpipeError as error:
        return str(error)


def _clashes(loaded: Mapping[str, Material | str]) -> dict[str, str]:
    """Folders whose name another one claims as well; letter case is not enough to tell folders apart everywhere."""
    names = {folder: found.name if isinstance(found, Material) else folder for folder, found in loaded.items()}
    claims = Counter(name.casefold() for name in names.values())
    return {
        folder: str(
            InputError(
                DESCRIPTION,
                f"the name {name!r} is used by more than one material",
                where="name",
                found=", ".join(sorted(other for other in names if names[other].casefold() == name.casefold())),
                accepted="a name of its own for each",
            )
        )
        for folder, name in names.items()
        if claims[name.casefold()] > 1 and isinstance(loaded[folder], Material)
    }


def _check_name(name: str, path: Path | None = None) -> None:
    """Refuse a name given on the command line or, with ``path``, in a description."""
    if not re.fullmatch(NAME, name):
        problem, key = "not a usable name", "name"
        accepted = "letters, digits, dots, dashes and underscores, at most 64, starting with a letter or a digit"
    elif name.casefold() in RESERVED:
        problem, key, accepted = "a reserved name", None, "any other name"
    else:
        return
    if path is None:
        raise CatalogueError(f"the name {name!r}: {problem}; accepted: {accepted}")
    raise InputError(path, problem, where="name", found=repr(name), accepted=accepted, key=key)


def _check_illuminant(path: Path, name: str, where: str) -> None:
    from brdfpipe.spectra import colorimetry

    try:
        colorimetry.illuminant_name(name)
    except BrdfpipeError as error:
        raise InputError(path, str(error), where=where) from error


def _why_ignored(folder: Path) -> str | None:
    try:
        items = sorted(item.name for item in folder.iterdir() if not item.name.startswith("."))
    except OSError as error:
        return f"cannot be read ({error.strerror})"
    near = [name for name in items if re.fullmatch(r"material\.ya?ml(\.txt)?", name, re.IGNORECASE)]
    if near:
        return f"{near[0]} is not read; rename it to {DESCRIPTION}"
    deeper = [name for name in items if (folder / name / DESCRIPTION).is_file()]
    if deeper:
        return (
            f"{DESCRIPTION} lies one folder deeper, in {deeper[0]}; a material's folder stands in the catalogue itself"
        )
    from brdfpipe.columns import TEXT_SUFFIXES
    from brdfpipe.surfaces.reading import FORMATS

    known = {*TEXT_SUFFIXES, *(suffix for form in FORMATS.values() for suffix in form.extensions)}
    raw = [name for name in items if Path(name).suffix.lower() in known and (folder / name).is_file()]
    if raw:
        return f"{raw[0]} but no {DESCRIPTION}; `brdfpipe new` with the folder's name writes one beside the raw files"
    return None
