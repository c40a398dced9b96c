"""One material of a catalogue: its description, its raw files, and a description to start from."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from brdfpipe import documents, installation
from brdfpipe.catalogue import material_keys
from brdfpipe.catalogue.calibration import run_file
from brdfpipe.catalogue.defaults import Defaults, origins, refuse_scene_outside
from brdfpipe.catalogue.names import DEFAULTS, DESCRIPTION, CatalogueError, check_name
from brdfpipe.descriptions import reading
from brdfpipe.errors import BrdfpipeError, InputError
from brdfpipe.scenes.scene import Scene, load_scene

FILE_PARTS = ("surface", "index", "spectrum", "multiangle", "table")
"""Parts of a description that may name a raw file."""

INTERIOR = ("internal_transmittance", "absorption")
"""Keys of ``slab`` and ``coat`` that may name a raw file."""

OTHER_FACES = {"back": "slab.back", "base": "coat.base.surface"}
"""The other face of a body with two: name in files and stages → its key."""

BASE_INDEX = "coat.base.index"

ROUTES = (("rig", "measured"), ("table", "imported"), ("multiangle", "flake"))
"""Parts of a description with a BSDF of their own, the preferred one first; without them the BSDF is predicted."""


@dataclass(frozen=True)
class Material:
    """One material: its validated description, with defaults, and its raw files."""

    name: str
    folder: Path
    content: Mapping[str, Any]
    files: Mapping[str, Path]
    """Part of the description (surface, mask, index, spectrum, spectrum_sce, back_surface, base_surface, base_index, interior; surface-2 … for further scans;
    rig) → raw file."""
    scene: Scene
    """What its results are for."""
    origins: Sequence[Sequence[str]] = ()
    """Key, value and origin of all that the description says, inherits or leaves to defaults."""
    inherited: Mapping[str, str] = field(default_factory=dict)
    """Keys that the catalogue gives → where, as ``catalogue.yaml, line 5``."""

    def has(self, part: str) -> bool:
        """Whether the description has a part: surface, index, spectrum, multiangle, table, slab, coat, back or base (a face of its own), or what a
        prediction needs."""
        if part == "predicted":
            # Beside another route a spectrum alone is no prediction of a perfect diffuser.
            alone = not any(self.has(other) for other, _ in ROUTES)
            return "surface" in self.content or ("spectrum" in self.content and alone)
        if part in OTHER_FACES:
            return isinstance(at_key(self.content, OTHER_FACES[part]), Mapping)
        return part in self.content

    @property
    def exports(self) -> tuple[str, ...]:
        return tuple(self.content["exports"])


def load_material(
    folder: Path, config: Mapping[str, Any], scene: Scene | None = None, defaults: Defaults | None = None
) -> Material:
    """Read and validate one material.

    Parameters
    ----------
    folder : of its description
    config : see :func:`brdfpipe.catalogue.configuration.load_config`
    scene : instead of the one that the description, the catalogue or the configuration names
    defaults : what the catalogue gives to its materials; see :func:`brdfpipe.catalogue.defaults.load_defaults`

    Raises
    ------
    InputError : naming the file, the line, the key, what was found and what is accepted.
    """
    path = folder / DESCRIPTION
    documents.refuse_link_outside(path, "the material's folder")
    defaults = Defaults(path) if defaults is None else defaults
    found = reading.read_with_lines(path, material_keys.Material, defaults.inherited_by)
    name = str(found.content.get("name", folder.name))
    check_name(name, path)
    content = completed(found.content, config)
    files = {
        part: documents.file_beside(path, file, f"{key}.file", "the material's folder")
        for part, key, file in raw_files(content)
    }
    if "rig" in content:
        files["rig"] = documents.file_beside(path, *run_file(content["rig"], "rig."), "the material's folder")
    known_scene = scene or _scene_of(path, content, {**config, **defaults.content})
    lines = {} if found.inherited is None else found.inherited.lines
    inherited = {".".join(map(str, key)): f"{DEFAULTS}, line {line}" for key, line in lines.items()}
    stated = [row for row in origins(content, found.written, inherited.keys()) if row[0] != "scene"]
    stated.append(["scene", known_scene.name, _origin_of_scene(scene, content, defaults)])
    return Material(name, folder, content, files, known_scene, stated, inherited)


def _origin_of_scene(given: Scene | None, content: Mapping[str, Any], defaults: Defaults) -> str:
    if given is not None:
        return "the command line"
    return DESCRIPTION if "scene" in content else DEFAULTS if "scene" in defaults.content else "the configuration"


def completed(content: Mapping[str, Any], config: Mapping[str, Any]) -> dict[str, Any]:
    """A description with the keys that it takes from the configuration, and a flat back as the surface that it is."""
    full = {"exports": config["exports"], **content}
    if full.get("slab", {}).get("back") == "flat":
        full["slab"] = full["slab"] | {"back": {"distribution": "flat"}}
    return full


def _scene_of(path: Path, content: Mapping[str, Any], config: Mapping[str, Any]) -> Scene:
    """The scene that a description names, or that of the catalogue or the configuration."""
    if "scene" not in content:
        return load_scene(config["scene"])
    refuse_scene_outside(path, content["scene"], path.parent.parent)
    try:
        return load_scene(content["scene"], path.parent)
    except BrdfpipeError as error:
        raise InputError(path, str(error), where="scene", others=getattr(error, "others", ())) from None


def at_key(content: Mapping[str, Any], key: str) -> Any:
    """What a description has at a key, as ``slab.back``; None where it has nothing."""
    found: Any = content
    for name in key.split("."):
        found = found.get(name) if isinstance(found, Mapping) else None
    return found


def raw_files(content: Mapping[str, Any]) -> Iterator[tuple[str, str, str]]:
    """Part, key and name of each raw file of a description."""
    holders = [(part, part) for part in FILE_PARTS]
    holders += [(f"{face}_surface", key) for face, key in OTHER_FACES.items()]
    holders += [("base_index", BASE_INDEX), ("spectrum", "spectrum.sci"), ("spectrum_sce", "spectrum.sce")]
    holders += [("mask", "surface.mask")]
    holders += [("interior", f"{body}.{key}") for body in ("slab", "coat") for key in INTERIOR]
    for part, key in holders:
        holder = at_key(content, key)
        if isinstance(holder, Mapping) and "file" in holder:
            yield part, key, holder["file"]
    for number, picture in enumerate(content.get("texture", {}).get("pictures", []), start=1):
        yield f"texture-{number}", "texture.pictures", picture["file"]
    for number, scan in enumerate(content.get("surface", {}).get("scans", []), start=2):
        yield f"surface-{number}", "surface.scans", scan["file"]


def unused_keys(content: Mapping[str, Any]) -> dict[str, str]:
    """Keys of a description that nothing uses → why; those of a prediction beside another route that has none."""
    route = next((part for part, _ in ROUTES if part in content), None)
    # A rig's reflection is compared with the prediction of its surface.
    predicts = route is None or (route == "rig" and "surface" in content)
    unused = {}
    if not predicts:
        why = f"the BRDF is that of `{route}`"
        given = ("surface", "index", "index_uncertainty", "slab", "coat", "spectrum")
        unused = {key: why for key in given if key in content}
        if content.get("model"):
            unused["model"] = why
    elif "surface" not in content and content.get("model"):
        # The index still serves the recovery of a spectrum from a colour.
        unused["model"] = "a body without `surface` is a perfect diffuser"
    if route == "rig" and "multiangle" in content:
        unused["multiangle"] = "the BRDF is that of `rig`"
    return unused


def start_material(folder: Path, name: str) -> Path:
    """Write a commented description of a new material, beside raw files that are already there; return its path.

    Raises
    ------
    CatalogueError : the name is not accepted, the material exists, or the folder cannot be written.
    """
    check_name(name)
    path = folder / name / DESCRIPTION
    template = (installation.project_folder() / "config" / "material.template.yaml").read_text(encoding="utf-8")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("x", encoding="utf-8") as file:
            file.write(template)
    except FileExistsError as error:
        raise CatalogueError(f"{error.filename}: already exists; choose another name") from None
    except OSError as error:
        raise CatalogueError(f"{path.parent}: cannot be written ({error.strerror})") from error
    return path


def summary_words(material: Material) -> list[str]:
    """The parts of a material in words, for ``brdfpipe check``."""
    parts = (*FILE_PARTS, "slab", "coat", "rig")
    return [_part_words(part, material.content[part]) for part in parts if material.has(part)]


def _part_words(part: str, content: Any) -> str:
    if not isinstance(content, Mapping):
        return f"{part} {content}"
    if part in ("slab", "coat"):
        return f"{part} {content['thickness']:g} mm"
    if part == "rig":
        return f"rig run {content['run']}" if "run" in content else f"rig emulated with {content['emulate']['truth']}"
    if "k" in content:
        return f"{part} {content['n']:g} + {content['k']:g}i"
    if "sci" in content:
        return f"{part} {content['sci']['file']} and {content['sce']['file']}"
    if "colours" in content:
        return f"{part} {len(content['colours'])} colours"
    return f"{part} " + ("L*a*b*" if "lab" in content else str(content.get("file") or content.get("distribution")))
