"""Calibrations of camera rigs, as a catalogue describes them in ``calibrations/``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from brdfpipe import documents
from brdfpipe.catalogue import calibration_keys
from brdfpipe.catalogue.names import CALIBRATION, CALIBRATIONS, check_name
from brdfpipe.descriptions import reading
from brdfpipe.errors import BrdfpipeError, InputError


@dataclass(frozen=True)
class Calibration:
    """A run of the etalon on a rig, and the certificate of the etalon."""

    name: str
    folder: Path
    content: Mapping[str, Any]
    files: Mapping[str, Path]
    """``rig``: the plan, or the journal of the finished run; ``certificate``."""

    @property
    def previous(self) -> str:
        """The calibration of the same rig before this one; empty if none is named."""
        return str(self.content.get("previous", ""))


def load_calibrations(folder: Path) -> dict[str, Calibration | str]:
    """The calibrations of a catalogue by name, or why they cannot be used."""
    calibrations: dict[str, Calibration | str] = {}
    for path in sorted(folder.glob(f"{CALIBRATIONS}/*/{CALIBRATION}")):
        try:
            calibrations[path.parent.name] = _load_calibration(path)
        except BrdfpipeError as error:
            calibrations[path.parent.name] = str(error)
    return {name: _problem_of_previous(name, calibrations) or item for name, item in calibrations.items()}


def _load_calibration(path: Path) -> Calibration:
    check_name(path.parent.name)
    folder = "the calibration's folder"
    documents.refuse_link_outside(path, folder)
    content = reading.read(path, calibration_keys.Calibration)
    files = {"rig": documents.file_beside(path, *run_file(content, ""), folder)}
    files["certificate"] = documents.file_beside(path, content["certificate"], "certificate", folder)
    return Calibration(path.parent.name, path.parent, content, files)


def run_file(rig: Mapping[str, Any], prefix: str) -> tuple[str, str]:
    """The file of a run and its key: the journal of a finished run, or the plan of an emulated one."""
    return (f"{rig['run']}/journal.jsonl", f"{prefix}run") if "run" in rig else (rig["plan"], f"{prefix}plan")


def _problem_of_previous(name: str, calibrations: Mapping[str, Calibration | str]) -> str:
    """Why the previous calibration, or one before it, cannot be used; empty if it can."""
    calibration = calibrations[name]
    if not (isinstance(calibration, Calibration) and calibration.previous):
        return ""
    previous, chain = calibrations.get(calibration.previous), _chain(name, calibrations)
    if previous is None:
        others = [other for other in calibrations if other != name]
        problem = f"no such calibration{documents.nearest(calibration.previous, others)}"
        accepted = ", ".join(others) or "leave it out; there is no other calibration"
    elif chain[-1] in chain[:-1]:
        problem, accepted = f"the previous calibrations form a loop: {' → '.join(chain)}", "an earlier calibration"
    elif (
        accepted := previous if isinstance(previous, str) else _problem_of_previous(calibration.previous, calibrations)
    ):
        problem = "the calibration cannot be used"
    else:
        return ""
    path = calibration.folder / CALIBRATION
    return str(InputError(path, problem, where="previous", found=repr(calibration.previous), accepted=accepted))


def _chain(name: str, calibrations: Mapping[str, Calibration | str]) -> list[str]:
    """Names of a calibration and the previous ones, up to the first or to a repetition."""
    names = [name]
    while isinstance(calibration := calibrations.get(names[-1]), Calibration) and calibration.previous:
        names.append(calibration.previous)
        if calibration.previous in names[:-1]:
            break
    return names
