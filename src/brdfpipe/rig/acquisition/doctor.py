"""``brdfpipe rig doctor``: identify, move and time each device of a rig, and state for each failure what to do.

The checks of a device end at its first failure; those of the other devices go on.
"""

from __future__ import annotations

import statistics
import textwrap
import time
import timeit
from collections.abc import Callable, Mapping
from contextlib import closing, suppress
from dataclasses import dataclass, field
from functools import partial
from typing import TypeVar

import click
import numpy as np

from brdfpipe.rig.acquisition.devices.camera import Camera
from brdfpipe.rig.acquisition.devices.connection import open_camera, open_monochromator, open_wheel
from brdfpipe.rig.acquisition.devices.errors import DeviceError, single_line
from brdfpipe.rig.description import Rig
from brdfpipe.rig.raw_frame import expected_format, has_expected_format, image_format

DARK_EXPOSURE = 0.1
"""Exposure time of the dark frame [s]."""

QUERIES = 10
"""Transactions of which the median time is reported."""

WIDTH = 118

HEADING = f"{'device':<15}{'check':<13}{'':<6}{'s':>7}  result"

Result = TypeVar("Result")


@dataclass(frozen=True)
class Row:
    """One line of the doctor's table."""

    device: str
    check: str
    passed: bool
    result: str
    seconds: float
    """Duration of the check."""
    advice: str = ""

    def __str__(self) -> str:
        first = f"{self.device:<15}{self.check:<13}{'pass' if self.passed else 'FAIL':<6}{self.seconds:7.3f}  "
        lines = textwrap.wrap(self.result, WIDTH - len(first)) or [""]
        if self.advice:
            lines += textwrap.wrap(f"→ {self.advice}", WIDTH - len(first))
        return first + f"\n{'':{len(first)}}".join(lines)


def doctor(rig: Rig, camera: Camera | None = None, report: Callable[[str], None] = click.echo) -> list[Row]:
    """Identify, move and time each device of a rig; return the table. The rig is ready if every row passed.

    The devices return to their initial positions; nothing is recorded. ``camera`` replaces the described one, ``report`` is called with
    each line of the table as soon as it is known.
    """
    report(HEADING)
    table = _Table(report)
    for examine in (_examine_monochromator, _examine_wheel, partial(_examine_camera, camera)):
        with suppress(_CheckFailed):
            examine(rig, table)
    failed = sum(not row.passed for row in table.rows)
    report(f"{len(table.rows) - failed} passed, {failed} failed")
    return table.rows


class _CheckFailed(Exception):
    """A check failed; its row is in the table, and the other checks of the device are skipped."""


@dataclass
class _Table:
    report: Callable[[str], None]
    rows: list[Row] = field(default_factory=list)

    def check(
        self, device: str, check: str, action: Callable[[], Result], describe: Callable[[Result], str] = str
    ) -> Result:
        """Carry out a check and add its row; raises _CheckFailed if it fails."""
        start = time.perf_counter()
        try:
            result = action()
            passed, text, advice = True, describe(result), ""
        except DeviceError as error:
            passed, text, advice = False, error.summary, error.advice
        except Exception as error:  # a bug in one driver must not prevent the other checks
            passed, text = False, single_line(f"{type(error).__name__}: {error}")
            advice = "this is a bug in the driver, not a fault of the device"
        row = Row(device, check, passed, text, time.perf_counter() - start, advice)
        self.rows.append(row)
        self.report(str(row))
        if not passed:
            raise _CheckFailed
        return result


def _examine_monochromator(rig: Rig, table: _Table) -> None:
    name, port = "monochromator", rig.monochromator.port
    with closing(table.check(name, "port", lambda: open_monochromator(rig.monochromator), lambda _: port)) as device:
        table.check(name, "identity", device.identify)
        start = table.check(name, "wavelength", device.wavelength, _nanometres)
        table.check(name, "settings", device.describe, _settings)
        table.check(name, "query", lambda: _median_time(device.wavelength))
        for wavelength in (*rig.wavelengths, start):
            table.check(name, f"to {wavelength:g} nm", partial(device.goto, wavelength), _nanometres)


def _examine_wheel(rig: Rig, table: _Table) -> None:
    name, port = "filter wheel", rig.wheel.port
    with closing(table.check(name, "port", lambda: open_wheel(rig.wheel), lambda _: port)) as device:
        table.check(name, "identity", device.identify)
        start = table.check(name, "position", device.position)
        table.check(name, "settings", device.describe, _settings)
        table.check(name, "query", lambda: _median_time(device.position))
        for position in (*range(1, rig.wheel.positions + 1), start):
            table.check(name, f"to {position}", partial(device.goto, position))


def _examine_camera(camera: Camera | None, rig: Rig, table: _Table) -> None:
    name = "camera"
    device = table.check(name, "driver", lambda: camera or open_camera(rig.camera), lambda _: rig.camera.kind)
    table.check(name, "identity", device.identify)
    table.check(name, "dark frame", lambda: _dark_frame(rig, device))


def _median_time(query: Callable[[], float]) -> str:
    milliseconds = 1000 * statistics.median(timeit.repeat(query, number=1, repeat=QUERIES))
    return f"{milliseconds:.2f} ms per transaction, median of {QUERIES}"


def _dark_frame(rig: Rig, camera: Camera) -> str:
    """Expose a short dark frame and describe it."""
    counts = camera.expose(DARK_EXPOSURE, shutter=False).counts
    if not has_expected_format(counts, rig.camera):
        advice = f"expected {expected_format(rig.camera)}: correct `camera.width` and `camera.height`"
        raise DeviceError("camera", f"image of {image_format(counts)}", advice=advice)
    median = float(np.median(counts))
    if median > rig.camera.full / 2:
        advice = "close the shutter, or cover the screen: light reaches the sensor"
        raise DeviceError("camera", f"dark frame with a median of {median:g} counts", advice=advice)
    return f"{rig.camera.width} × {rig.camera.height} pixels, median {median:g} counts, maximum {counts.max()}"


def _settings(settings: Mapping[str, str]) -> str:
    return ", ".join(f"{name} {value}" for name, value in settings.items()) or "none that the device reports"


def _nanometres(wavelength: float) -> str:
    return f"{wavelength:.3f} nm"
