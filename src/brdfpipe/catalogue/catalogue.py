"""The catalogue: one folder per material, each with a ``material.yaml``, validated before anything is computed.

One bad material never stops the others: it becomes a line in :attr:`Catalogue.failures`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from brdfpipe import documents
from brdfpipe.catalogue.calibration import Calibration, load_calibrations
from brdfpipe.catalogue.configuration import load_config
from brdfpipe.catalogue.ignored_folders import ignored
from brdfpipe.catalogue.material import Material, load_material
from brdfpipe.catalogue.names import CALIBRATION, CALIBRATIONS, DESCRIPTION, CatalogueError
from brdfpipe.errors import BrdfpipeError, InputError, printable
from brdfpipe.stages import STAGES, Subject


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
        """The part of a material's description and of the configuration that a stage depends on."""
        return STAGES[stage].parameters(Subject(self[name], self.config))

    def calibrations_of(self, material: Material) -> list[str]:
        """The calibration of a rig's material, and the previous ones that its chart shows."""
        names = [material.content["rig"]["calibration"]]
        while previous := self.calibrations[names[-1]].previous:
            names.append(previous)
        return names


def load(folder: Path, config: Mapping[str, Any] | None = None) -> Catalogue:
    """Read and validate every material of a catalogue; compute nothing.

    Parameters
    ----------
    folder : its sub-folders with a ``material.yaml`` are the materials
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
        raise CatalogueError(f"{folder}: is one material; give the folder above it")
    folders = sorted(path.parent for path in folder.glob(f"*/{DESCRIPTION}") if not path.parent.name.startswith("."))
    if not folders:
        near = "".join(f"; {name}: {why}" for name, why in [*ignored(folder).items()][:3])
        raise CatalogueError(f"{folder}: holds no material; `brdfpipe new NAME --folder {folder}` starts one{near}")
    loaded = {printable(path.name): _load_or_refusal(path, config) for path in folders}
    duplicates = _duplicate_names(loaded)
    failures = {name: item for name, item in loaded.items() if isinstance(item, str)} | duplicates
    materials = {
        item.name: item for name, item in loaded.items() if isinstance(item, Material) and name not in failures
    }
    calibrations = load_calibrations(folder)
    for name, refusal in _rig_refusals(materials, calibrations).items():
        failures[name] = refusal
        del materials[name]
    usable = {name: item for name, item in calibrations.items() if isinstance(item, Calibration)}
    return Catalogue(folder, tuple(materials[name] for name in sorted(materials)), failures, config, usable)


def _load_or_refusal(folder: Path, config: Mapping[str, Any]) -> Material | str:
    try:
        return load_material(folder, config)
    except BrdfpipeError as error:
        return str(error)


def _duplicate_names(loaded: Mapping[str, Material | str]) -> dict[str, str]:
    """Refusals of folders with the name of another one; letter case does not distinguish folders everywhere."""
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


def _rig_refusals(materials: Mapping[str, Material], calibrations: Mapping[str, Calibration | str]) -> dict[str, str]:
    """Refusals of materials whose calibration or emulated truth does not exist."""
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
