"""A whole run made by the emulated rig, in place of a laboratory: the same scan, over the same serial lines."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.errors import InputError
from brdfpipe.rig.acquisition import journal as journals
from brdfpipe.rig.acquisition.devices.connection import connect
from brdfpipe.rig.acquisition.scan import Summary, last_finished, scan
from brdfpipe.rig.emulator.bench import READOUT, EmulatedRig
from brdfpipe.rig.plan import JOURNAL, Arrangement, Plan


def measure(plan_file: Path, folder: Path, truth: xr.Dataset | None, *, seed: int = 0, session: int = 0) -> Summary:
    """Scan a plan with an emulated rig; the folder of the run appears whole or not at all, in place of one that is there.

    Parameters
    ----------
    plan_file : ``plan.yaml``
    folder : of the run
    truth : kind ``bsdf``, what lies in the holder as the sample; None for a plan that measures none
    seed, session : of all that is random about the rig, and about the day

    Raises
    ------
    InputError : the plan measures a sample, and there is no truth.
    ScanStopped, StoreError : the disk is full.
    """
    plan = Plan.load(plan_file)
    if truth is None and any(each.load == "sample" for each in plan.arrangements):
        raise InputError(
            plan_file, "a sample is measured, and there is none", where="runs", accepted="[target, etalon]"
        )
    temporary = folder.with_name(f".{folder.name}.tmp")
    shutil.rmtree(temporary, ignore_errors=True)
    try:
        summary = take(plan, temporary, black() if truth is None else truth, seed=seed, session=session)
        shutil.rmtree(folder, ignore_errors=True)
        temporary.rename(folder)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return summary


def take(
    plan: Plan,
    folder: Path,
    truth: xr.Dataset,
    *,
    seed: int = 0,
    session: int = 0,
    resume: bool = False,
    progress: bool = False,
    say: Callable[[str], None] = lambda line: None,
) -> Summary:
    """Scan a plan with an emulated rig, frame by frame into the folder as a laboratory would; arguments as above and of :func:`scan`.

    Raises
    ------
    InputError : the folder holds something else, or a run of another plan or rig.
    ScanStopped, StoreError : the disk is full.
    """
    with (
        EmulatedRig(plan.rig, truth, seed=seed, session=session) as stand,
        connect(stand.rig, camera=stand.camera) as bench,
    ):
        operator = f"emulator, seed {seed}, session {session}"
        if resume:
            _check_same(folder, operator)
            restore(stand, plan, folder)
        return scan(
            plan,
            bench,
            folder,
            clock=stand.clock.now,
            confirm=hands(stand),
            operator=operator,
            progress=progress,
            resume=resume,
            say=say,
        )


def _check_same(folder: Path, operator: str) -> None:
    """Refuse to go on with a run of another rig, or of a real one."""
    begun = {event.get("operator") for event in journals.read(folder / JOURNAL) if event["event"] == "begun"}
    if others := begun - {operator}:
        raise InputError(
            folder,
            "holds a run of another rig",
            found=", ".join(map(str, others)),
            accepted=f"{operator}, or another --out",
        )


def restore(stand: EmulatedRig, plan: Plan, folder: Path) -> None:
    """Put an emulated rig where it stood when the last finished frame of a run had been read out."""
    if (found := last_finished(plan, folder)) is not None:
        shot, frame = found
        stand.restore(
            frame.started + shot.exposure + READOUT, frame.state.wavelength, frame.state.position, shot.ordinal
        )


def hands(stand: EmulatedRig) -> Callable[[Arrangement, str], bool]:
    """An operator of an emulated rig, who does what he is asked."""

    def confirm(arrangement: Arrangement, words: str) -> bool:
        stand.set_entrance(arrangement.incidence, load=arrangement.load, side=arrangement.side)
        return True

    return confirm


def black() -> xr.Dataset:
    """The BSDF of what reflects nothing."""
    nothing = ("theta_i", np.zeros(2))
    variables = dict.fromkeys(("gauss_peak", "gauss_fwhm_parallel", "gauss_fwhm_perpendicular"), nothing)
    bsdf = xr.Dataset({"lambert": 0.0, **variables}, {"theta_i": [0.0, 90.0]}, {"representation": "lambert_gauss"})
    return vocabulary.label(bsdf, "bsdf")
