"""The doctor: each device of a rig is named, moved and timed, and what is wrong is told beside what to do.

A device is left at its first failure; the others are examined all the same.
"""

from __future__ import annotations

import statistics
import textwrap
import time
from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import dataclass, field
from functools import partial
from typing import TypeVar

import click
import numpy as np

from brdfpipe.rig.acquisition.devices.camera import Camera, open_camera
from brdfpipe.rig.acquisition.devices.connection import open_monochromator, open_wheel
from brdfpipe.rig.acquisition.devices.errors import DeviceError, visible
from brdfpipe.rig.description import Rig

DARK = 0.1
"""Exposure of the dark frame [s]."""

QUESTIONS = 10
"""Transactions of which the median time is told."""

WIDTH = 118

HEADING = f"{'device':<15}{'check':<13}{'':<6}{'s':>7}  found"

Found = TypeVar("Found")


@dataclass(frozen=True)
class Row:
    """One line of the doctor's table."""

    device: str
    check: str
    passed: bool
    found: str
    seconds: float
    """How long the check took."""
    advice: str = ""

    def __str__(self) -> str:
        first = f"{self.device:<15}{self.check:<13}{'pass' if self.passed else 'FAIL':<6}{self.seconds:7.3f}  "
        lines = textwrap.wrap(self.found, WIDTH - len(first)) or [""]
        if self.advice:
            lines += textwrap.wrap(f"→ {self.advice}", WIDTH - len(first))
        return first + f"\n{'':{len(first)}}".join(lines)


def doctor(rig: Rig, camera: Camera | None = None, report: Callable[[str], None] = click.echo) -> list[Row]:
    """Identify, move and time each device of a rig; they stand again where they stood, and nothing is recorded.

    Parameters
    ----------
    rig : the description
    camera : instead of the one described, as the emulator's
    report : given each line of the table as soon as it is known

    Returns
    -------
    The table; the rig is in order if every row passed.
    """
    table = _Table(report)
    for examine in (_monochromator, _wheel):
        with suppress(_Failed):
            examine(rig, table)
    with suppress(_Failed):
        _camera(rig, camera, table)
    failed = sum(not row.passed for row in table.rows)
    report(f"{len(table.rows) - failed} passed, {failed} failed")
    return table.rows


class _Failed(Exception):
    """A check failed: it stands in the table, and the device is left."""


@dataclass
class _Table:
    report: Callable[[str], None]
    rows: list[Row] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.report(HEADING)

    def check(self, device: str, check: str, action: Callable[[], Found], told: Callable[[Found], str] = str) -> Found:
        """Carry out a check and note it; raises _Failed, once it is noted, if it fails."""
        begin = time.perf_counter()
        try:
            found = action()
            passed, text, advice = True, told(found), ""
        except DeviceError as error:
            passed, text, advice = False, error.found, error.advice
        except Exception as error:  # a fault of one driver must not hide the others
            passed, text = False, visible(f"{type(error).__name__}: {error}")
            advice = "this is a fault of the driver, not of the device"
        row = Row(device, check, passed, text, time.perf_counter() - begin, advice)
        self.rows.append(row)
        self.report(str(row))
        if not passed:
            raise _Failed
        return found


def _monochromator(rig: Rig, table: _Table) -> None:
    name = "monochromator"
    port = rig.monochromator.port
    with closing(table.check(name, "port", lambda: open_monochromator(rig.monochromator), lambda _: port)) as device:
        table.check(name, "identity", device.identify)
        start = table.check(name, "wavelength", device.wavelength, _nanometres)
        table.check(name, "question", lambda: _typical(device.wavelength), _milliseconds)
        for wavelength in (*rig.wavelengths, start):
            table.check(name, f"to {wavelength:g} nm", partial(device.goto, wavelength), _nanometres)


def _wheel(rig: Rig, table: _Table) -> None:
    name = "filter wheel"
    with closing(table.check(name, "port", lambda: open_wheel(rig.wheel), lambda _: rig.wheel.port)) as device:
        table.check(name, "identity", device.identify)
        start = table.check(name, "position", device.position)
        table.check(name, "question", lambda: _typical(device.position), _milliseconds)
        for position in (*range(1, rig.wheel.positions + 1), start):
            table.check(name, f"to {position}", partial(device.goto, position))


def _camera(rig: Rig, camera: Camera | None, table: _Table) -> None:
    name = "camera"
    device = table.check(name, "driver", lambda: camera or open_camera(rig.camera), lambda _: rig.camera.kind)
    table.check(name, "identity", device.identify)
    table.check(name, "dark frame", lambda: _dark(rig, device))


def _typical(question: Callable[[], float]) -> float:
    """Median time of a transaction [s]."""
    times = []
    for _ in range(QUESTIONS):
        begin = time.perf_counter()
        question()
        times.append(time.perf_counter() - begin)
    return statistics.median(times)


def _dark(rig: Rig, camera: Camera) -> str:
    """Expose a short dark frame and describe it."""
    counts = camera.expose(DARK, shutter=False).counts
    shape = (rig.camera.height, rig.camera.width)
    if counts.shape != shape or counts.dtype != np.uint16:
        problem = f"a frame of {' × '.join(map(str, counts.shape[::-1]))} {counts.dtype.name}"
        raise DeviceError(
            "camera", problem, advice=f"{shape[1]} × {shape[0]} uint16 by `camera.width` and `camera.height`"
        )
    median = float(np.median(counts))
    if median > rig.camera.full / 2:
        advice = "close the shutter, or cover the screen: light reaches the sensor"
        raise DeviceError("camera", f"a dark frame of {median:g} counts", advice=advice)
    return f"{shape[1]} × {shape[0]} pixels, median {median:g} counts, highest {counts.max()}"


def _nanometres(wavelength: float) -> str:
    return f"{wavelength:.3f} nm"


def _milliseconds(seconds: float) -> str:
    return f"{1000 * seconds:.2f} ms a transaction, median of {QUESTIONS}"
