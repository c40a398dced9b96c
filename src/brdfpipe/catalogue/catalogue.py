"""Read a catalogue: a folder for each material with a ``material.yaml``, validated before anything is computed.

A material that cannot be built does not stop the others: :attr:`Catalogue.failures` says why.
"""

from __future__ import annotations

import fnmatch
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from brdfpipe import documents
from brdfpipe.catalogue.calibration import Calibration, load_calibrations
from brdfpipe.catalogue.configuration import load_config
from brdfpipe.catalogue.defaults import Defaults, load_defaults
from brdfpipe.catalogue.material import Material, load_material
from brdfpipe.catalogue.names import (
    CALIBRATION,
    CALIBRATIONS,
    DEFAULTS,
    DESCRIPTION,
    RESERVED,
    RESULT_MARKS,
    CatalogueError,
)
from brdfpipe.descriptions.keys import NAME
from brdfpipe.errors import BrdfpipeError, InputError, printable
from brdfpipe.scenes.geometries import gloss_angles
from brdfpipe.scenes.scene import Scene, SceneError, different, load_scene
from brdfpipe.stages import STAGES, Subject


@dataclass(frozen=True)
class Catalogue:
    """The materials that can be built, the reasons why others cannot, and the configuration."""

    folder: Path
    materials: tuple[Material, ...]
    failures: Mapping[str, str]
    """Name of a material (or its folder) → what is wrong with it, in one line."""
    config: Mapping[str, Any] = field(repr=False)
    scene: Scene
    """Of the materials that name none."""
    calibrations: Mapping[str, Calibration] = field(default_factory=dict)
    further_problems: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Name of a material that cannot be built → what is wrong with its description beside the first problem, a line each."""
    defaults: Defaults = field(default_factory=lambda: Defaults(Path(DEFAULTS)))
    """What its materials inherit."""

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

    @property
    def unused_defaults(self) -> list[str]:
        """Keys of ``catalogue.yaml`` that no material inherits."""
        # Of both halves of a pair of spectra a key stands in `spectrum` once.
        used = {re.sub(r"^spectrum\.sc[ie]\.", "spectrum.", key) for item in self.materials for key in item.inherited}
        used |= {"scene"} if any("scene" not in item.content for item in self.materials) else set()
        return [key for key in self.defaults.keys if not any(key == one or key.startswith(f"{one}.") for one in used)]

    @cached_property
    def scenes(self) -> tuple[Scene, ...]:
        """The scenes of the catalogue and of its materials, each once."""
        scenes = [self.scene, *(material.scene for material in self.materials)]
        return tuple({scene.name: scene for scene in scenes}.values())

    def scene_of(self, name: str) -> Scene:
        """The scene of a material; of one whose description cannot be used, that of the catalogue."""
        return self.by_name[name].scene if name in self.by_name else self.scene

    def selected(self, patterns: Sequence[str]) -> frozenset[str]:
        """Names that match any of some patterns with ``*`` and ``?``, of materials that cannot be built too; all without patterns.

        Raises CatalogueError: nothing matches a pattern.
        """
        known = [*self.by_name, *self.failures]
        matching = {pattern: fnmatch.filter(known, pattern) for pattern in patterns}
        for pattern, names in matching.items():
            if not names:
                hint = documents.nearest(pattern, known)
                raise CatalogueError(f"{self.folder.name}: no material {pattern!r}{hint}")
        return frozenset(name for names in matching.values() for name in names) if patterns else frozenset(known)

    def spec(self, name: str, stage: str) -> dict[str, Any]:
        """The part of a material's description and of the configuration that a stage depends on."""
        return STAGES[stage].parameters(Subject(self[name], self.config))

    def calibrations_of(self, material: Material) -> list[str]:
        """The calibration of a rig's material, and the previous ones that its chart shows."""
        names = [material.content["rig"]["calibration"]]
        while previous := self.calibrations[names[-1]].previous:
            names.append(previous)
        return names


def load(folder: Path, config: Mapping[str, Any] | None = None, scene: str | None = None) -> Catalogue:
    """Read and validate every material of a catalogue; compute nothing.

    Parameters
    ----------
    folder : its sub-folders with a ``material.yaml`` are the materials
    config : see :func:`load_config`; default the project's own
    scene : of all materials, a name or a path, instead of those that the configuration and the materials name

    Raises
    ------
    CatalogueError : the folder is missing or holds no material.
    SceneError, InputError : the scene of the catalogue, or its ``catalogue.yaml``, cannot be used.
    """
    config = load_config() if config is None else config
    folder = documents.resolved(Path(folder)) or Path(folder)
    if not folder.is_dir():
        raise CatalogueError(f"{printable(str(folder))}: no such folder")
    if problem := documents.problem_in_workflow(folder):
        raise CatalogueError(f"{printable(str(folder))}: {problem}; rename or move the catalogue")
    if (folder / DESCRIPTION).is_file():
        raise CatalogueError(f"{folder}: is a material, not a catalogue; give the folder above it")
    defaults = load_defaults(folder)
    of_catalogue = load_scene(scene or defaults.content.get("scene", config["scene"]))
    if problem := _without_gloss_angle(of_catalogue, config):
        raise SceneError(problem)
    folders, unreadable = _folders_of_materials(folder)
    if not folders and not unreadable:
        hints = "".join(f"; {name}: {reason}" for name, reason in [*ignored(folder).items()][:3])
        raise CatalogueError(f"{folder}: holds no material; `brdfpipe new NAME --folder {folder}` starts one{hints}")
    given = of_catalogue if scene else None
    outcomes = {printable(path.name): _load_or_refusal(path, config, given, defaults) for path in folders}
    loaded = {name: item if isinstance(item, Material) else str(item) for name, item in outcomes.items()} | unreadable
    further = {name: item.others for name, item in outcomes.items() if isinstance(item, InputError) and item.others}
    duplicates = _duplicate_names(loaded)
    failures = {name: item for name, item in loaded.items() if isinstance(item, str)} | duplicates
    materials = {item.name: item for key, item in loaded.items() if isinstance(item, Material) and key not in failures}
    calibrations = load_calibrations(folder)
    refusals = _rig_refusals(materials, calibrations) | _scene_refusals(materials, of_catalogue, config)
    for name, refusal in refusals.items():
        failures[name] = refusal
        del materials[name]
    usable = {name: item for name, item in calibrations.items() if isinstance(item, Calibration)}
    in_order = tuple(materials[name] for name in sorted(materials))
    return Catalogue(folder, in_order, failures, config, of_catalogue, usable, further, defaults)


def _folders_of_materials(folder: Path) -> tuple[list[Path], dict[str, str]]:
    """Folders with a description, and those that may be materials but cannot be read: name → refusal."""
    found, unreadable = [], {}
    for item in sorted(folder.iterdir()):
        if item.name.startswith("."):
            continue
        try:
            if (item / DESCRIPTION).is_file():
                found.append(item)
        except OSError as error:
            if re.fullmatch(NAME, item.name) and item.name not in RESERVED:
                unreadable[item.name] = f"{DESCRIPTION}: its folder cannot be read ({error.strerror}); allow reading it"
    return found, unreadable


def _load_or_refusal(
    folder: Path, config: Mapping[str, Any], scene: Scene | None, defaults: Defaults
) -> Material | BrdfpipeError:
    try:
        return load_material(folder, config, scene, defaults)
    except BrdfpipeError as error:
        return error
    except OSError as error:
        return InputError(error.filename or folder / DESCRIPTION, f"cannot be read ({error.strerror})")


def _duplicate_names(loaded: Mapping[str, Material | str]) -> dict[str, str]:
    """Refusals of materials with the name of another one; some file systems ignore letter case."""
    names = {folder: item.name if isinstance(item, Material) else folder for folder, item in loaded.items()}
    counts = Counter(name.casefold() for name in names.values())
    return {
        folder: str(
            InputError(
                DESCRIPTION,
                f"the name {name!r} is used by more than one material",
                where="name",
                found=", ".join(sorted(other for other in names if names[other].casefold() == name.casefold())),
                accepted="a different name for each",
            )
        )
        for folder, name in names.items()
        if counts[name.casefold()] > 1 and isinstance(loaded[folder], Material)
    }


def _without_gloss_angle(scene: Scene, config: Mapping[str, Any]) -> str:
    """Why a scene cannot have the gloss that it asks for; empty if it can."""
    angles = config["gloss_angles"]
    if not scene.asks("gloss") or not angles or gloss_angles(scene.domain, angles):
        return ""
    accepted = " or ".join(f"{angle:g}°" for angle in angles)
    return (
        f"scene {scene.name}: asks for `gloss`, but its domain contains the mirror direction of no gloss angle; accepted: a cone about the mirror "
        f"direction of {accepted} (`gloss_angles` of the configuration); add one to `domain`, or leave `gloss` out of `results`"
    )


def _scene_refusals(
    materials: Mapping[str, Material], of_catalogue: Scene, config: Mapping[str, Any]
) -> dict[str, str]:
    """Refusals of materials with a scene of the name of another one, or one that cannot have the gloss that it asks for."""
    scenes = {name: materials[name].scene for name in sorted(materials)}
    problems = {name: _without_gloss_angle(scene, config) for name, scene in scenes.items()}
    return {name: problem for name, problem in problems.items() if problem} | {
        name: str(
            InputError(
                materials[name].folder / DESCRIPTION,
                "another scene of the same name is used, by the catalogue or by another material",
                where="scene",
                found=repr(materials[name].content.get("scene", scenes[name].name)),
                accepted="a file with a name of its own",
            )
        )
        for name in different(scenes, of_catalogue)
    }


def _rig_refusals(materials: Mapping[str, Material], calibrations: Mapping[str, Calibration | str]) -> dict[str, str]:
    """Refusals of materials whose calibration, or the material to be emulated, does not exist."""
    refusals = {}
    measurable = [name for name, item in materials.items() if "emulate" not in item.content.get("rig", {})]
    for name, material in materials.items():
        if not material.has("rig"):
            continue
        rig = material.content["rig"]
        calibration, truth = rig["calibration"], rig.get("emulate", {}).get("truth")
        loaded = calibrations.get(calibration)
        if not isinstance(loaded, Calibration):
            where, value = "rig.calibration", calibration
            problem = f"no such calibration{documents.nearest(calibration, calibrations)}"
            accepted = ", ".join(calibrations) or f"a folder {CALIBRATIONS}/{calibration} with {CALIBRATION}"
            if loaded is not None:
                problem, accepted = "the calibration cannot be used", loaded
        elif truth is not None and truth not in measurable:
            where, value = "rig.emulate.truth", truth
            problem = f"no such material to emulate a measurement of{documents.nearest(truth, measurable)}"
            accepted = ", ".join(measurable[:10])
        else:
            continue
        path = material.folder / DESCRIPTION
        refusals[name] = str(InputError(path, problem, where=where, found=repr(value), accepted=accepted))
    return refusals


def ignored(folder: Path) -> dict[str, str]:
    """Folders that look like materials, and files like the defaults, that are ignored: name → what was found and what to do, in one line."""
    reasons: dict[str, str] = {}
    items = sorted(folder.iterdir())
    for item in items:
        if re.fullmatch(r"catalog(ue)?\.ya?ml(\.txt)?", item.name, re.IGNORECASE) and item.name != DEFAULTS:
            reasons[printable(item.name)] = f"is not read; rename it to {DEFAULTS}, whose keys all materials inherit"
    for item in (item for item in items if item.is_dir() and not item.name.startswith((".", "_"))):
        if item.name == CALIBRATIONS:
            continue
        try:
            reason = _reason_to_ignore(item)
        except OSError as error:
            reason = f"cannot be read ({error.strerror})"
        if reason:
            reasons[printable(item.name)] = reason
    return reasons


def _reason_to_ignore(folder: Path) -> str | None:
    if (folder / DESCRIPTION).is_file() or any((folder / mark).exists() for mark in RESULT_MARKS):
        return None
    names = sorted(item.name for item in folder.iterdir() if not item.name.startswith("."))
    misnamed = [name for name in names if re.fullmatch(r"material\.ya?ml(\.txt)?", name, re.IGNORECASE)]
    if DESCRIPTION in names:
        return f"{DESCRIPTION} is no file; put the description there"
    if misnamed:
        return f"{misnamed[0]} is not read; rename it to {DESCRIPTION}"
    deeper = [name for name in names if (folder / name / DESCRIPTION).is_file()]
    if deeper:
        return f"{DESCRIPTION} is one folder too deep, in {deeper[0]}; move that folder into the catalogue itself"
    from brdfpipe.columns import TEXT_SUFFIXES
    from brdfpipe.file_formats import extensions
    from brdfpipe.surfaces.reading import FORMATS

    suffixes = {*TEXT_SUFFIXES, *extensions(FORMATS)}
    raw = [name for name in names if Path(name).suffix.lower() in suffixes and (folder / name).is_file()]
    if raw:
        return f"{raw[0]} but no {DESCRIPTION}; `brdfpipe new` with the folder's name writes one beside the raw files"
    return None
