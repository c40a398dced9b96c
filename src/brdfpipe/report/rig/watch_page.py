"""What the page of a run shows while it is measured: progress, warnings, and the last frame with its cells."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import numpy as np

from brdfpipe.report.plots.svg import png
from brdfpipe.rig.acquisition.run_state import WatchedRun
from brdfpipe.rig.plan import Shot
from brdfpipe.rig.reduction import thumbnails


class RunPage:
    """The content of the page of a run. Raises InputError: the folder holds no run."""

    def __init__(self, folder: Path) -> None:
        self._run = WatchedRun(folder)
        self._lock = threading.Lock()
        self._picture: tuple[Shot | None, dict[str, Any]] = (None, {})

    def state(self) -> dict[str, Any]:
        """What the page shows, as JSON has it: progress, warnings, and the last frame with its cells."""
        with self._lock:
            state, plan = self._run.state(), self._run.plan
            if state.last is not None and self._picture[0] != state.last:
                self._picture = state.last, self._drawn(state.last)
            return {
                "sample": plan.sample,
                "rig": plan.rig.name,
                "status": state.status,
                "finished": state.finished,
                "frames": state.frames,
                "seconds_left": state.seconds_left,
                "last": None if state.last is None else _described(state.last),
                "warnings": state.warnings,
                **self._picture[1],
            }

    def _drawn(self, shot: Shot) -> dict[str, Any]:
        """The picture of a frame with its cells; empty if the frame cannot be read."""
        shown = self._run.light(shot)
        if shown is None:
            return {}
        light, cells = shown
        plan, described = self._run.plan, self._run.cells
        drawing = thumbnails.drawing(light, plan.rig, plan.rig.screen, self._run.weights)
        names = ("column", "row", "aperture")
        columns = [drawing[name].values for name in names]
        values = (*columns, cells.snr, cells.saturated, described.theta_s, described.phi_s)
        return {
            "size": [plan.rig.camera.width, plan.rig.camera.height],
            "picture": png(drawing["picture"].values),
            "cells": [
                {
                    "name": name,
                    "column": _number(column),
                    "row": _number(row),
                    "radius": _number(radius),
                    "snr": _number(snr),
                    "saturated": bool(saturated),
                    "theta": _number(theta),
                    "phi": _number(phi),
                }
                for name, column, row, radius, snr, saturated, theta, phi in zip(described.names, *values, strict=True)
            ],
        }


def _described(shot: Shot) -> str:
    at = "" if shot.dark else f" at {shot.arrangement.incidence:g}°, {shot.wavelength:g} nm, filter {shot.position}"
    return f"frame {shot.ordinal}: {shot.purpose}{at}, {shot.exposure:g} s"


def _number(value: float) -> float | None:
    return round(float(value), 2) if np.isfinite(value) else None
