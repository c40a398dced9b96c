"""A run taken by the emulated rig, with the same scan over the same serial protocols as in a laboratory."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

from brdfpipe.errors import InputError
from brdfpipe.rig.acquisition import journal as journals
from brdfpipe.rig.acquisition.devices.connection import connect
from brdfpipe.rig.acquisition.scan import Summary, last_finished, scan
from brdfpipe.rig.emulator.emulated_rig import READOUT, EmulatedRig
from brdfpipe.rig.emulator.sample_holder import Truth
from brdfpipe.rig.plan import JOURNAL, Arrangement, Plan


def make_run(plan_file: Path, folder: Path, truth: Truth | None, *, seed: int = 0, session: int = 0) -> Summary:
    """Scan a plan with an emulated rig; the folder of the run appears complete or not at all, and replaces an existing one.

    Parameters
    ----------
    truth : the sample, :func:`brdfpipe.bsdf.registry.representation` of a ``bsdf`` dataset; None for a plan that measures no sample
    seed, session : of the random properties of the rig, and of the day

    Raises
    ------
    InputError : the plan measures a sample, but there is no truth.
    ScanStopped, StoreError : the disk is full.
    """
    plan = Plan.load(plan_file)
    if truth is None and any(arrangement.load == "sample" for arrangement in plan.arrangements):
        problem = "the plan measures a sample, but no truth is given"
        raise InputError(plan_file, problem, where="runs", accepted="[target, etalon]")
    temporary = folder.with_name(f".{folder.name}.tmp")
    shutil.rmtree(temporary, ignore_errors=True)
    try:
        summary = scan_emulated(plan, temporary, truth, seed=seed, session=session)
        shutil.rmtree(folder, ignore_errors=True)
        temporary.rename(folder)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return summary


def scan_emulated(
    plan: Plan,
    folder: Path,
    truth: Truth | None,
    *,
    seed: int = 0,
    session: int = 0,
    resume: bool = False,
    progress: bool = False,
    on_warning: Callable[[str], None] = lambda line: None,
) -> Summary:
    """Scan a plan with an emulated rig, frame by frame as in a laboratory; parameters and errors as of :func:`make_run` and :func:`scan`."""
    with (
        EmulatedRig(plan.rig, truth, seed=seed, session=session) as emulated,
        connect(emulated.rig, camera=emulated.camera) as devices,
    ):
        operator = f"emulator, seed {seed}, session {session}"
        if resume:
            _check_same_rig(folder, operator)
            restore_state(emulated, plan, folder)
        clock, confirm = emulated.clock.now, automatic_operator(emulated)
        return scan(
            plan,
            devices,
            folder,
            clock=clock,
            confirm=confirm,
            operator=operator,
            progress=progress,
            resume=resume,
            on_warning=on_warning,
        )


def _check_same_rig(folder: Path, operator: str) -> None:
    """Refuse to continue a run of another emulated rig, or of a real one."""
    operators = {event.get("operator") for event in journals.read(folder / JOURNAL) if event["event"] == "begun"}
    if others := operators - {operator}:
        found, accepted = ", ".join(map(str, others)), f"{operator}, or another --out"
        raise InputError(folder, "holds a run of another rig", found=found, accepted=accepted)


def restore_state(emulated: EmulatedRig, plan: Plan, folder: Path) -> None:
    """Restore the state of an emulated rig after the last finished frame of a run."""
    if (last := last_finished(plan, folder)) is not None:
        shot, frame = last
        end = frame.started + shot.exposure + READOUT
        emulated.restore(end, frame.state.wavelength, frame.state.position, shot.ordinal)


def automatic_operator(emulated: EmulatedRig) -> Callable[[Arrangement, str], bool]:
    """An operator who makes every arrangement of an emulated rig."""

    def confirm(arrangement: Arrangement, instruction: str) -> bool:
        emulated.set_entrance(arrangement.incidence, load=arrangement.load, side=arrangement.side, aim=arrangement.aim)
        return True

    return confirm
