"""Frames of a small plan on an emulated rig of full size, made once for all tests of a process."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import rig_accuracy as accuracy
import xarray as xr

from brdfpipe.rig.emulator.effects import Effects
from brdfpipe.rig.plan import Plan

WAVELENGTHS, INCIDENCES, FIBRES = (470.0, 550.0), (10.0, 30.0), 60


@cache
def plan() -> Plan:
    """Target, etalon and sample through two entrances, at two wavelengths, with 60 fibres."""
    return accuracy.plan_of(WAVELENGTHS, INCIDENCES, FIBRES)


@cache
def frames(
    truth: str = "plastic, 10 sr⁻¹, 3°",
    seed: int = 1,
    session: int = 0,
    effects: Effects | None = None,
    of: str = "sample",
) -> xr.Dataset:
    """Frames of a truth; ``of`` is the ``nd_location`` of the filters."""
    rig = replace(plan().rig, nd_location=of)
    return accuracy.frames_of(
        replace(plan(), rig=rig), accuracy.TRUTHS[truth](), seed=seed, session=session, effects=effects
    )


@cache
def reduced(load: str = "sample", truth: str = "plastic, 10 sr⁻¹, 3°", seed: int = 1) -> xr.Dataset:
    """All arrangements of a load."""
    return accuracy.reduced(plan(), frames(truth, seed), load)


def without(frames: xr.Dataset, **conditions: object) -> xr.Dataset:
    """Frames without those whose coordinates all have these values."""
    lost = np.ones(frames.sizes["frame"], dtype=bool)
    for name, value in conditions.items():
        lost &= frames[name].values == value
    return frames.isel(frame=~lost)
