"""The state of a run, from its folder alone: progress, time left, warnings, the last picture and how well each cell shows in it.

Nothing is written or locked: a scan may be running in the folder.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from brdfpipe.geometry import Array
from brdfpipe.rig.acquisition import journal as journals
from brdfpipe.rig.acquisition.estimate import ARRANGEMENT_TIME, durations
from brdfpipe.rig.frame_file import Frame, FrameError, read_frame
from brdfpipe.rig.plan import FRAMES, JOURNAL, PLAN, Arrangement, Plan, Shot
from brdfpipe.rig.reduction import cells as rig_cells

_ENDS = ("stopped", "interrupted", "finished")
_DARKS = 5  # dark frames of an exposure time that are read for their mean
_MOST_WARNINGS = 200


class CellLight(NamedTuple):
    """Light of the cells in one frame."""

    signal: Array
    """(cell,) electrons, above the mean dark frame."""
    snr: Array
    """(cell,) ratio of signal to noise."""
    saturated: Array
    """(cell,) whether a pixel is out of the linear range."""


@dataclass(frozen=True)
class RunState:
    """What a scan has done so far."""

    status: str
    """``not started``, ``running``, ``stopped``, ``interrupted`` or ``finished``: by the last event of the journal."""
    finished: int
    """Frames of the plan that are in the folder."""
    frames: int
    """Frames of the plan, without those that the scan found not to be needed."""
    seconds_left: float
    """Of the missing frames, and of the arrangements that are still to be made."""
    last: Shot | None
    """The last frame that was taken; None before the first."""
    warnings: tuple[str, ...]
    """What the journal notes, the latest last."""


class WatchedRun:
    """The folder of a run that is watched. Raises InputError: it holds no run."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.plan = Plan.load(folder / PLAN)
        self._seconds = durations(self.plan)
        self._means: dict[float, Array] = {}

    @cached_property
    def cells(self) -> rig_cells.Cells:
        """The cells of the rig."""
        return rig_cells.cells_of(self.plan.rig)

    @cached_property
    def weights(self) -> Any:
        """Share of each pixel in each cell, at the described position of the screen."""
        return rig_cells.weights(self.plan.rig, self.plan.rig.screen)

    def state(self) -> RunState:
        """The present state."""
        events = journals.read(self.folder / JOURNAL)
        present = {path.name for path in (self.folder / FRAMES).glob("*.fits")}
        not_needed = journals.left_out(events)
        wanted = [shot for shot in self.plan.shots if shot.name in present or shot.ordinal not in not_needed]
        missing = [shot for shot in wanted if shot.name not in present]
        arrangements = {shot.arrangement for shot in missing} - _confirmed(events, self.plan)
        names = {shot.name: shot for shot in self.plan.shots}
        taken = [names[file] for event in events if (file := _file(event)) in names and file in present]
        last_event = str(events[-1]["event"]) if events else ""
        return RunState(
            status=last_event if last_event in _ENDS else "running" if events else "not started",
            finished=len(wanted) - len(missing),
            frames=len(wanted),
            seconds_left=sum(self._seconds[shot] for shot in missing) + ARRANGEMENT_TIME * len(arrangements),
            last=taken[-1] if taken else None,
            warnings=tuple(_warnings(events))[-_MOST_WARNINGS:],
        )

    def light(self, shot: Shot) -> tuple[Array, CellLight] | None:
        """Electrons of light (y, x) of a frame, and of its cells; None if the frame cannot be read."""
        frame = self._frame(shot)
        if frame is None:
            return None
        camera = self.plan.rig.camera
        dark = self._mean_dark(shot.exposure)
        level = np.median(frame.counts) if dark is None else dark
        light: Array = np.asarray(camera.gain * (frame.counts - level), dtype=float)
        beyond = (light > camera.linear_to) | (frame.counts >= camera.full)
        variance = np.maximum(light, 0.0) + camera.read_noise**2
        sums = rig_cells.cell_sums(self.weights, np.stack([light, beyond.astype(float)]))
        noise = np.sqrt(rig_cells.cell_sums(self.weights.power(2), variance[None])[0])
        inside = noise > 0
        snr = np.where(inside, sums[0] / np.where(inside, noise, 1.0), np.nan)
        return light, CellLight(sums[0], snr, sums[1] > 0)

    def _frame(self, shot: Shot) -> Frame | None:
        try:
            return read_frame(self.folder / FRAMES / shot.name, shot, self.plan)
        except FrameError:
            return None

    def _mean_dark(self, exposure: float) -> Array | None:
        if exposure not in self._means:
            shots = [shot for shot in self.plan.shots if shot.dark and shot.exposure == exposure][:_DARKS]
            counts = [frame.counts for shot in shots if (frame := self._frame(shot)) is not None]
            if not counts:
                return None
            self._means[exposure] = np.mean(counts, axis=0)
        return self._means[exposure]


def _file(event: Mapping[str, Any]) -> str:
    return str(event.get("file", "")) if event["event"] in ("frame", "adopted") else ""


def _confirmed(events: list[dict[str, Any]], plan: Plan) -> set[Arrangement]:
    """Arrangements that an operator confirmed, by the first frame that the event names."""
    shots = {shot.ordinal: shot for shot in plan.shots}
    numbers = (event.get("shot") for event in events if event["event"] == "confirmed")
    return {shots[number].arrangement for number in numbers if isinstance(number, int) and number in shots}


def _warnings(events: list[dict[str, Any]]) -> Iterator[str]:
    """Texts of the events that warn, in order; equal ones once."""
    seen = set()
    for event in events:
        texts = [event.get(name) for name in ("problem", "warning", "reason")]
        listed = event.get("warnings")
        texts += listed if isinstance(listed, list) else []
        for text in texts:
            if isinstance(text, str) and text not in seen:
                seen.add(text)
                where = f"frame {event['shot']}, " if isinstance(event.get("shot"), int) else ""
                yield f"{where}{event['event']}: {text}"
