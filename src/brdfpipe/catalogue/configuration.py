"""The configuration of a catalogue: ``config.yaml``, and a file that states only what differs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from brdfpipe import installation
from brdfpipe.catalogue.config_keys import Config
from brdfpipe.descriptions import reading
from brdfpipe.errors import BrdfpipeError, InputError
from brdfpipe.scenes.scene import is_file, load_scene


def load_config(path: Path | None = None) -> dict[str, Any]:
    """The configuration of a catalogue: the one of the project, overridden by ``path``.

    Raises
    ------
    InputError : naming the file, the line, the key, what was found and what is accepted.
    """
    defaults = reading.read(installation.project_folder() / "config" / "config.yaml", Config)
    if path is None:
        return defaults
    settings = reading.read(path, Config)
    if "illuminant" in settings:
        check_illuminant(path, settings["illuminant"], "illuminant")
    for number, window in enumerate(settings.get("appearance", {}).get("haze", [])):
        _check_haze_window(path, window, f"appearance.haze.{number}")
    if "scene" in settings:
        settings["scene"] = _checked_scene(path, settings["scene"])
    return _overridden(defaults, settings)


def _checked_scene(path: Path, scene: str) -> str:
    """A scene by its name, or its file in relation to that of the configuration. Refused here, not in every material."""
    try:
        load_scene(scene, path.parent)
    except BrdfpipeError as error:
        raise InputError(path, str(error), where="scene") from error
    return str((path.parent / scene).resolve()) if is_file(scene) else scene


def _overridden(defaults: Mapping[str, Any], settings: Mapping[str, Any]) -> dict[str, Any]:
    """Defaults overridden by settings, key by key within mappings too; a list replaces the whole list."""
    return {**defaults} | {
        key: _overridden(defaults[key], value) if isinstance(value, Mapping) else value
        for key, value in settings.items()
    }


def _check_haze_window(path: Path, window: Mapping[str, Any], where: str) -> None:
    """Refuse an impossible window of the haze meter here, not in every material."""
    from brdfpipe.appearance import haze

    try:
        haze.checked_window(window)
    except haze.HazeError as error:
        raise InputError(path, str(error), where=where) from error


def check_illuminant(path: Path, name: str, where: str) -> None:
    """Refuse an unknown illuminant; not with the other keys, because the tables of illuminants are slow to load."""
    from brdfpipe.spectra import colorimetry

    try:
        colorimetry.illuminant_name(name)
    except BrdfpipeError as error:
        raise InputError(path, str(error), where=where) from error
