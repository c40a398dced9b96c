"""What the materials of a catalogue inherit from its ``catalogue.yaml``, and which of their values came from where."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Set
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from brdfpipe import documents
from brdfpipe.catalogue.configuration import check_illuminant
from brdfpipe.catalogue.default_keys import CatalogueDefaults, accepted_by_spectrum
from brdfpipe.catalogue.names import DEFAULTS
from brdfpipe.descriptions import reading
from brdfpipe.descriptions.reading import Inherited, KeyPath
from brdfpipe.errors import BrdfpipeError, InputError, shortened
from brdfpipe.scenes.scene import is_file, load_scene

_MOST_LETTERS = 80
_NOT_WITH = {"noise": ("lambda_s",), "uncertainty": ("reflectance_uncertainty",)}
"""Key of a material → defaults that it excludes."""


@dataclass(frozen=True)
class Defaults:
    """The defaults of a catalogue; of one without ``catalogue.yaml`` there are none."""

    path: Path
    content: Mapping[str, Any] = field(default_factory=dict)
    lines: documents.Lines = field(default_factory=dict)

    def inherited_by(self, written: Mapping[str, Any]) -> Inherited:
        """What a description inherits that does not say it itself, without the scene: key → value, with the file and the line of each."""
        values = dict(self._inherited(written))
        return Inherited(self.path, values, {key: self._line(key) for key in values})

    def _inherited(self, written: Mapping[str, Any]) -> Iterator[tuple[KeyPath, Any]]:
        if "surface" in written and "index" not in written:
            yield from (
                ((name,), self.content[name])
                for name in ("index", "index_uncertainty")
                if name in self.content and name not in written
            )
        if "exports" in self.content and "exports" not in written:
            yield ("exports",), self.content["exports"]
        surface, spectrum = written.get("surface"), written.get("spectrum")
        if isinstance(surface, Mapping) and "file" in surface:
            yield from self._of_block(("surface",), surface, self.content.get("surface", {}))
        if not isinstance(spectrum, Mapping):
            return
        given = self.content.get("spectrum", {})
        if "sci" in spectrum or "sce" in spectrum:
            halves = {name: spectrum[name] for name in ("sci", "sce") if isinstance(spectrum.get(name), Mapping)}
            of_both = {
                key: value for key, value in given.items() if key in ("specular_trap", "reflectance_uncertainty")
            }
            if any("uncertainty" in half for half in halves.values()):
                of_both.pop("reflectance_uncertainty", None)
            yield from self._of_block(("spectrum",), spectrum, of_both)
            of_each = {key: value for key, value in given.items() if key in ("scale", "incidence")}
            for name, half in halves.items():
                yield from self._of_block(("spectrum", name), half, of_each)
            return
        accepted = accepted_by_spectrum("lab" if "lab" in spectrum else "file")
        if spectrum.get("geometry", given.get("geometry")) != "sce":
            accepted -= {"specular_trap"}
        yield from self._of_block(("spectrum",), spectrum, {key: given[key] for key in given if key in accepted})

    @staticmethod
    def _of_block(
        place: KeyPath, written: Mapping[str, Any], given: Mapping[str, Any]
    ) -> Iterator[tuple[KeyPath, Any]]:
        excluded = {other for key in written for other in _NOT_WITH.get(key, ())}
        if "scale" in given and _states_scale(written):
            excluded.add("scale")
        yield from (
            ((*place, key), value) for key, value in given.items() if key not in written and key not in excluded
        )

    def _line(self, key: KeyPath) -> int:
        """Line of a default; that of one half of a pair of spectra stands in ``spectrum`` itself."""
        own = tuple(step for step in key if step not in ("sci", "sce"))
        return self.lines.get(own, 0)

    @property
    def keys(self) -> list[str]:
        """The keys that are given, ``spectrum.scale``."""
        return [key for key, _ in flattened(self.content)]


def _states_scale(spectrum: Mapping[str, Any]) -> bool:
    """Whether the format of the file of a spectrum has a scale of its own, which a default must not overrule."""
    from brdfpipe.file_formats import extensions
    from brdfpipe.spectra.formats.registry import FORMATS

    plain = {name: FORMATS[name] for name in ("text", "excel")}
    if isinstance(known := spectrum.get("format"), str):
        return known.lower() not in plain
    return Path(str(spectrum.get("file", ""))).suffix.lower() not in extensions(plain)


def load_defaults(folder: Path) -> Defaults:
    """The defaults of a catalogue.

    Parameters
    ----------
    folder : of the catalogue

    Raises
    ------
    InputError : naming the file, the line, the key, what was found and what is accepted.
    """
    path = folder / DEFAULTS
    if not path.exists() and not path.is_symlink():
        return Defaults(path)
    documents.refuse_link_outside(path, "the catalogue's folder")
    found = reading.read_with_lines(path, CatalogueDefaults)
    if "illuminant" in found.content.get("spectrum", {}):
        check_illuminant(path, found.content["spectrum"]["illuminant"], "spectrum.illuminant")
    index = found.content.get("index")
    if isinstance(index, Mapping | str):
        from brdfpipe.optics.index import refractive_index

        try:
            refractive_index(index)
        except InputError as refusal:
            raise found.refusal("index", refusal.problem, refusal.found, refusal.accepted) from None
    scene = found.content.get("scene")
    if scene is not None:
        try:
            refuse_scene_outside(path, scene, folder)
        except InputError as refusal:
            raise found.refusal("scene", refusal.problem, refusal.found, refusal.accepted) from None
        try:
            load_scene(scene, folder)
        except BrdfpipeError as error:
            raise found.refusal("scene", str(error)) from None
        if is_file(scene):
            found.content["scene"] = str((folder / scene).resolve())
    return Defaults(path, found.content, found.lines)


def refuse_scene_outside(path: Path, scene: str, catalogue: Path) -> None:
    """Refuse a file of a scene that is not in the folder of the catalogue.

    Parameters
    ----------
    path : of the description that names the scene, by a path from its own folder
    scene : a file, or the name of a shipped scene
    catalogue : folder of the catalogue

    Raises
    ------
    InputError : naming the description, the file and what is accepted.
    """
    if not is_file(scene):
        return
    target = documents.resolved(path.parent / scene)
    if target is None or not target.is_relative_to(catalogue.resolve()):
        found, accepted = repr(scene), "a file in the catalogue, or the name of a shipped scene"
        raise InputError(path, "leads outside the catalogue", where="scene", found=found, accepted=accepted)


def origins(content: Mapping[str, Any], written: Mapping[str, Any], inherited: Set[str]) -> list[list[str]]:
    """Key, value and origin of everything that a description says or leaves to others, in the order of the keys.

    Parameters
    ----------
    content : validated, with defaults
    written : as in its file
    inherited : keys that the catalogue gives
    """
    own = {key for key, _ in flattened(written)}
    rows = []
    for key, value in flattened(content):
        parents = {key} | {key[:end] for end, letter in enumerate(key) if letter == "."}
        if parents & inherited:
            origin = DEFAULTS
        elif parents & own:
            origin = "material.yaml"
        else:
            origin = "the configuration" if key == "exports" else "the default"
        rows.append([key, shortened(_shown(value), _MOST_LETTERS), origin])
    return rows


def flattened(content: Any, place: str = "") -> Iterator[tuple[str, Any]]:
    """Keys with dots, and their values; lists are values."""
    for key, value in content.items():
        name = f"{place}.{key}" if place else str(key)
        if isinstance(value, Mapping):
            yield from flattened(value, name)
        else:
            yield name, value


def _shown(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False, default=str)
