"""The runs of camera rigs that a catalogue's materials and calibrations rest on, as their plans have them; no frame is read."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from brdfpipe.catalogue.calibration import Calibration
from brdfpipe.catalogue.catalogue import Catalogue
from brdfpipe.catalogue.material import Material
from brdfpipe.catalogue.names import CALIBRATIONS
from brdfpipe.errors import BrdfpipeError, InputError

if TYPE_CHECKING:
    from brdfpipe.rig.plan import Arrangement


class Run(NamedTuple):
    """What is known of a run before it is read."""

    arrangements: tuple[Arrangement, ...]
    sources: list[str]


def place(owner: Material | Calibration) -> str:
    """Folder of the results of a material, or of a calibration."""
    return f"{CALIBRATIONS}/{owner.name}" if isinstance(owner, Calibration) else owner.name


def of(loaded: Catalogue) -> tuple[dict[str, Run], dict[str, str]]:
    """The runs of the rigs' materials and calibrations by their places, and what is wrong with those of some materials."""
    measured = [material for material in loaded.materials if material.has("rig")]
    owners: list[Material | Calibration] = [*loaded.calibrations.values(), *measured]
    runs: dict[str, Run] = {}
    problems: dict[str, str] = {}
    for owner in owners:
        try:
            runs[place(owner)] = _planned(owner)
        except BrdfpipeError as error:
            problems[place(owner)] = str(error)
    needed = {
        material.name: [material.name, *(f"calibrations/{each}" for each in loaded.calibrations_of(material))]
        for material in measured
    }
    failures = {name: [problems[place] for place in places if place in problems] for name, places in needed.items()}
    return runs, {name: found[0] for name, found in failures.items() if found}


def _planned(owner: Material | Calibration) -> Run:
    from brdfpipe.rig.plan import PLAN, Plan, sources

    told = owner.files["rig"]
    path = told if told.suffix == ".yaml" else told.parent / PLAN
    plan = Plan.load(path)
    load = "etalon" if isinstance(owner, Calibration) else "sample"
    if all(each.load != load for each in plan.arrangements):
        raise InputError(path, f"the {load} is not measured", where="runs", accepted=f"a list with {load} in it")
    return Run(plan.arrangements, [str(file) for file in sources(path).values()])
