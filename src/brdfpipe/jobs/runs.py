"""Runs of camera rigs that materials and calibrations depend on, as their plans describe them; frames are not read."""

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
    """What the plan of a run states."""

    arrangements: tuple[Arrangement, ...]
    sources: list[str]
    """Files of the plan, the rig and its fibres."""


def results_folder(owner: Material | Calibration) -> str:
    """Folder of the results of a material or a calibration."""
    return f"{CALIBRATIONS}/{owner.name}" if isinstance(owner, Calibration) else owner.name


def planned_runs(catalogue: Catalogue) -> tuple[dict[str, Run], dict[str, str]]:
    """Runs by folder of results; and by material, why a run that it needs cannot be used."""
    measured = [material for material in catalogue.materials if material.has("rig")]
    owners: list[Material | Calibration] = [*catalogue.calibrations.values(), *measured]
    runs: dict[str, Run] = {}
    problems: dict[str, str] = {}
    for owner in owners:
        try:
            runs[results_folder(owner)] = _planned_run(owner)
        except BrdfpipeError as error:
            problems[results_folder(owner)] = str(error)
    failures = {}
    for material in measured:
        folders = [material.name, *(f"{CALIBRATIONS}/{name}" for name in catalogue.calibrations_of(material))]
        if refused := [problems[folder] for folder in folders if folder in problems]:
            failures[material.name] = refused[0]
    return runs, failures


def _planned_run(owner: Material | Calibration) -> Run:
    from brdfpipe.rig.plan import PLAN, Plan, sources

    file = owner.files["rig"]  # the plan, or the journal beside it
    path = file if file.suffix == ".yaml" else file.parent / PLAN
    plan = Plan.load(path)
    load = "etalon" if isinstance(owner, Calibration) else "sample"
    if all(arrangement.load != load for arrangement in plan.arrangements):
        raise InputError(path, f"the {load} is not measured", where="runs", accepted=f"a list with {load} in it")
    return Run(plan.arrangements, [str(source) for source in sources(path).values()])
