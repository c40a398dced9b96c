"""A scene: what the BRDF of a material is for. A build computes only what the scene asks for."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

from brdfpipe import documents, installation
from brdfpipe.descriptions import reading
from brdfpipe.descriptions.keys import NAME, NAME_WORDS
from brdfpipe.errors import BrdfpipeError, shortened
from brdfpipe.scenes.domain import Domain
from brdfpipe.scenes.results import PARTS
from brdfpipe.scenes.scene_keys import AS_MATERIAL, CHEAPEST, METRIC_UNITS, METRICS_OF_DOMAINS, SceneKeys
from brdfpipe.store import canonical_json

DEFAULT = "catalogue"
"""The scene without a folder of its own in the results."""

FOLDER = "scenes"
"""Folder of the other scenes in the results."""


class SceneError(BrdfpipeError):
    """No such scene."""


@dataclass(frozen=True)
class Scene:
    """A scene with the defaults of its keys."""

    name: str
    """The name of its file."""
    content: Mapping[str, Any]

    @property
    def digest(self) -> str:
        """Of the content: two scenes with the same one compute the same."""
        return hashlib.sha256(canonical_json(dict(self.content)).encode()).hexdigest()

    @property
    def folder(self) -> str:
        """Folder of its results in the folder of results, with a slash at its end; empty for the default scene."""
        return "" if self.name == DEFAULT else f"{FOLDER}/{self.name}/"

    def asks(self, *results: str) -> bool:
        """Whether the scene asks for one of these results."""
        return bool(set(results) & set(self.content["results"]))

    @cached_property
    def domain(self) -> Domain:
        """The pairs of directions that it needs."""
        return Domain(self.content["domain"])

    @property
    def parts(self) -> tuple[str, ...]:
        """The parts of the appearance that it asks for."""
        return tuple(part for part in PARTS if self.asks(part))

    @property
    def accepts_cheapest(self) -> bool:
        """Whether the scene takes the cheapest model once errors are measured for it; uncertainties and model errors are those of the fullest one."""
        return self.content["model"] == CHEAPEST and not self.asks("uncertainty", "model_error", "comparison")

    @property
    def plans(self) -> bool:
        """Whether the cheapest model is taken: the scene accepts it, and errors were measured for the scene."""
        return self.accepts_cheapest and self.experience_file is not None

    @property
    def experience_file(self) -> Path | None:
        """The file of the errors that were measured for this scene, or for one with the same :attr:`errors_of`; None without one."""
        own = measured_errors_file(self.name)
        files = [own, *sorted(set(own.parent.glob("*.json")) - {own})]
        measured = (file for file in files if file.is_file())
        return next((file for file in measured if _measured_for(file, file.stat().st_mtime_ns) == self.errors_of), None)

    @property
    def accepted_error(self) -> dict[str, Any]:
        """Metric, unit, tolerance and the digest of what of the scene decides how large an error is."""
        metric = self.content["metric"]
        given = {
            "scene": self.name,
            "metric": metric,
            "unit": METRIC_UNITS[metric],
            "tolerance": self.content["tolerance"],
        }
        return given | {"errors_of": self.errors_of}

    @property
    def errors_of(self) -> str:
        """Digest of what of the scene decides how large the error of a model is; the domain is part of it where the metric depends on it."""
        metric, domain = self.content["metric"], self.content["domain"]
        decisive = {name: self.content[name] for name in ("metric", "bands", "polarisation")}
        if metric in METRICS_OF_DOMAINS:
            decisive["domain"] = {
                name: sorted(part, key=canonical_json) if isinstance(part, list) else part
                for name, part in domain.items()
            }
        return hashlib.sha256(canonical_json(decisive).encode()).hexdigest()[:16]

    def exports(self, of_material: Sequence[str]) -> tuple[str, ...]:
        """Formats of the files for other programs; ``of_material``: those that the material names."""
        formats = self.content["exports"]
        return tuple(of_material if formats == AS_MATERIAL else formats)


def measured_errors_file(name: str) -> Path:
    """The file to which the errors that are measured for a shipped scene are written; it may not exist."""
    return installation.project_folder() / "config" / "scenes" / "experience" / f"{name}.json"


@lru_cache(maxsize=64)
def _measured_for(path: Path, time: int) -> str | None:
    """The digest of the scenes for which errors were measured, from the first line of their file; None of another file."""
    try:
        with path.open(encoding="utf-8") as file:
            return str(json.loads(file.readline() + "}}")["scene"])
    except (ValueError, KeyError, TypeError):
        return None


def shipped_scenes() -> dict[str, Path]:
    """The scenes of the project, the default first: name → file."""
    files = {path.stem: path for path in (installation.project_folder() / "config" / "scenes").glob("*.yaml")}
    return {name: files[name] for name in sorted(files, key=lambda name: (name != DEFAULT, name))}


def is_file(value: str) -> bool:
    """Whether a scene is given by its file, and not by the name of a shipped one."""
    return "/" in value or "\\" in value or Path(value).suffix in (".yaml", ".yml")


def parts_within_scene(place: Path) -> tuple[str, ...]:
    """The parts of a path in the results after the folder of its scene; all of them for the default scene."""
    return place.parts[2:] if place.parts[0] == FOLDER else place.parts


def load_scene(value: str | Path, folder: Path | None = None) -> Scene:
    """A scene by the name of a shipped one, or by its file.

    Parameters
    ----------
    value : a name, or a path that ends in ``.yaml``
    folder : of a relative path; by default the current one

    Raises
    ------
    SceneError : no scene of that name, no such file, or a name that is not accepted.
    InputError : a mistake in the file, with its line and its key.
    """
    shipped = shipped_scenes()
    if not is_file(str(value)):
        if str(value) not in shipped:
            accepted = f"{', '.join(shipped)}; or the path of a file, as scenes/mine.yaml"
            raise SceneError(
                f"no scene {shortened(str(value), 64)!r}{documents.nearest(str(value), shipped)}; accepted: {accepted}"
            )
        return read_scene(shipped[str(value)])
    path = (folder or Path()) / value
    if not path.is_file():
        raise SceneError(
            f"scene {shortened(str(value), 200)!r}: no such file; accepted: {', '.join(shipped)}; or a file"
        )
    scene = read_scene(path)
    if (namesake := _shipped_namesake(scene)) is not None and scene.digest != read_scene(shipped[namesake]).digest:
        raise SceneError(
            f"scene {path.name}: {namesake} is the name of a shipped scene, which has another content and the same folder of results; "
            "accepted: any other name of the file"
        )
    return scene


def _shipped_namesake(scene: Scene) -> str | None:
    """The shipped scene of the same name, None without one; some file systems ignore letter case."""
    return next((name for name in shipped_scenes() if name.casefold() == scene.name.casefold()), None)


def read_scene(path: Path) -> Scene:
    """Read and validate the file of a scene.

    Raises
    ------
    SceneError : the name of the file is not accepted. InputError : a mistake in the file.
    """
    if not re.fullmatch(NAME, path.stem):
        raise SceneError(f"scene {path.name}: not an accepted name; accepted: {NAME_WORDS}")
    return _read_once(path, path.stat().st_mtime_ns)


@lru_cache(maxsize=64)
def _read_once(path: Path, time: int) -> Scene:
    """All materials of a catalogue may have the same scene."""
    return Scene(path.stem, reading.read(path, SceneKeys))


def different(scenes: Mapping[str, Scene], first: Scene) -> list[str]:
    """Keys of the scenes that have the name of an earlier one, or of ``first``, and another content: their results have the same folder."""
    digests = {first.name: first.digest}
    return [key for key, scene in scenes.items() if digests.setdefault(scene.name, scene.digest) != scene.digest]
