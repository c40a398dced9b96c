"""The scan: every exposure of a plan, each on the disk before the next is begun, and each labelled by what the devices say.

A frame counts only if both devices said the same before and after its exposure, and said what was asked for. What is finished is
told by the frames in the run's folder alone; whatever ends a scan (Ctrl-C, kill, a pulled plug, a full disk, a power cut), the
same command with ``--resume`` takes what is missing and nothing else.
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from brdfpipe import store
from brdfpipe.errors import BrdfpipeError, InputError
from brdfpipe.geometry import Array
from brdfpipe.rig import frame_checks as checks
from brdfpipe.rig import frames
from brdfpipe.rig.acquisition import journal as journals
from brdfpipe.rig.acquisition.devices.camera import TIMING, Picture
from brdfpipe.rig.acquisition.devices.connection import Bench
from brdfpipe.rig.acquisition.devices.errors import DeviceError, DeviceLost, WrongDevice
from brdfpipe.rig.acquisition.estimate import duration
from brdfpipe.rig.frames import WAVELENGTH_TOLERANCE, Frame, FrameError, State
from brdfpipe.rig.plan import FRAMES, JOURNAL, LOCK, PLAN, Arrangement, Plan, Shot, sources

ATTEMPTS = 3
"""An exposure and two repetitions."""

STILL = 0.05
"""Largest difference [nm] of two readings of a monochromator at rest."""

LATEST = 9.9e9
"""Seconds, in the year 2283: a start beyond is no time, nor has a header room for its microseconds."""

Confirm = Callable[[Arrangement, str], bool]
"""Asks the operator to arrange mirrors and sample, given in words too; whether that is done."""


class ScanStopped(BrdfpipeError):
    """The scan cannot go on; what is finished is safe, and the scan can be resumed."""


@dataclass(frozen=True)
class Summary:
    """What a scan did."""

    folder: Path
    frames: int
    """Of the plan, all in the folder."""
    taken: int
    """By this scan."""
    retries: int
    """Exposures that were discarded and repeated."""
    warnings: tuple[str, ...]

    @property
    def text(self) -> str:
        repeated = f", {self.retries} exposure{'s' if self.retries > 1 else ''} repeated" if self.retries else ""
        return f"{self.frames} frames in {self.folder}, {self.taken} of them taken now{repeated}"


def scan(
    plan: Plan,
    bench: Bench,
    folder: Path,
    *,
    clock: Callable[[], float],
    confirm: Confirm,
    operator: str = "",
    progress: bool = False,
    resume: bool = False,
    say: Callable[[str], None] = lambda line: None,
) -> Summary:
    """Take every frame of a plan that the folder does not hold yet.

    Parameters
    ----------
    plan : what to take, with its rig
    bench : the rig's devices
    folder : of the run; made if it is not there
    clock : seconds, for the journal
    confirm : asked before the first frame, and whenever mirrors or sample must be moved; if it refuses, the scan stops
    operator : who confirms, for the journal
    progress : show frames and time left, on a terminal
    resume : go on with what the folder holds; without it a run that has begun is left alone
    say : told of warnings as they arise

    Raises
    ------
    InputError : the folder holds something else, or a run of another plan or rig.
    ScanStopped : a device failed for good, the operator refused, or the disk is full.
    """
    with _locked(folder):
        _prepare(plan, folder, resume)
        with journals.Journal(folder / JOURNAL, clock) as journal:
            run = _Run(plan, bench, folder, journal, confirm, operator, say)
            return run.complete(progress)


def last_finished(plan: Plan, folder: Path) -> tuple[Shot, Frame] | None:
    """The last frame of the plan that is whole, if there is any."""
    found = frames.read_shots(folder, plan, reversed(plan.shots))
    return next(((shot, frame) for shot, frame in found if isinstance(frame, Frame)), None)


@dataclass
class _Run:
    """A run under way."""

    plan: Plan
    bench: Bench
    folder: Path
    journal: journals.Journal
    confirm: Confirm
    operator: str
    say: Callable[[str], None]
    _camera: str = ""
    _arranged: Arrangement | None = None
    _asked: State | None = None
    """What the devices were last told, if they can be trusted to stand there."""
    _origin: float | None = None
    _finished: set[Shot] = field(default_factory=set)
    _looks: list[checks.Look] = field(default_factory=list)
    _judged: bool = False
    """Whether the overlap of a bracket has told where the filters stand."""
    _darks: dict[float, Array] = field(default_factory=dict)
    _warnings: list[str] = field(default_factory=list)
    _retries: int = 0

    def complete(self, progress: bool) -> Summary:
        """Take what is missing."""
        self._recognise()
        left = [shot for shot in self.plan.shots if shot not in self._finished]
        self._check_disk(len(left))
        if left:
            self._note_begin(len(left))
            self._take_all(left, progress)
            self.journal.append("finished", frames=len(self._finished))
        return Summary(self.folder, len(self.plan.shots), len(left), self._retries, tuple(self._warnings))

    # --- what is there

    def _recognise(self) -> None:
        """Find the frames that are finished: whole, and the ones the journal knows where it knows any."""
        events = journals.read(self.folder / JOURNAL)
        known = {event.get("shot"): event.get("sha256") for event in events if event["event"] in ("frame", "adopted")}
        self._judged = any(event["event"] == "overlap" for event in events)
        for shot, found in frames.read_shots(self.folder, self.plan, self.plan.shots):
            problem = str(found) if isinstance(found, FrameError) else ""
            if isinstance(found, Frame) and known.get(shot.ordinal, found.digest) != found.digest:
                problem = f"{shot.name}: changed since it was taken"
            if problem:
                self.journal.append("damaged", shot=shot.ordinal, problem=problem)
                self._warn(f"{problem}; it is taken again")
                continue
            assert isinstance(found, Frame)
            if shot.ordinal not in known:
                self.journal.append("adopted", **self._facts(shot, found))
            self._finish(shot, found)
        self._judge_lamp(fresh=False)

    def _check_disk(self, count: int) -> None:
        need, free = count * frames.size(self.plan), shutil.disk_usage(self.folder).free
        if need > free:
            raise InputError(
                self.folder,
                "the disk is too small for what is to be taken",
                found=f"{free >> 20} MiB free",
                accepted=f"{(need >> 20) + 1} MiB; free some, or choose another --out",
            )

    def _note_begin(self, left: int) -> None:
        plan, bench = self.plan, self.bench
        self._camera = bench.camera.identify()
        self.journal.append(
            "begun",
            frames=len(plan.shots),
            left=left,
            sample=plan.sample,
            rig=plan.rig.name,
            rig_digest=plan.rig.digest,
            operator=self.operator,
            software=version("brdfpipe"),
            monochromator=bench.monochromator.identify(),
            wheel=bench.wheel.identify(),
            camera=self._camera,
        )

    # --- taking

    def _take_all(self, left: list[Shot], progress: bool) -> None:
        with _bar(self.plan, left, progress) as advance:
            for shot in left:
                try:
                    self._arrange(shot, advance)
                    self._take(shot)
                except KeyboardInterrupt:
                    self._note_end("interrupted", shot, "Ctrl-C")
                    raise
                except BrdfpipeError as error:
                    self._note_end("stopped", shot, str(error))
                    raise ScanStopped(self._stopped(shot, error)) from error
                advance(shot)

    def _arrange(self, shot: Shot, advance: Callable[[Shot | None], None]) -> None:
        if shot.arrangement == self._arranged:
            return
        words = self._words(shot)
        if not self.confirm(shot.arrangement, words):
            raise BrdfpipeError(f"not confirmed: {words}")
        self._arranged = shot.arrangement
        self.journal.append("confirmed", **_arrangement(shot, self.plan), by=self.operator)
        advance(None)

    def _words(self, shot: Shot) -> str:
        arrangement, holder = shot.arrangement, self.plan.sample_id(shot.arrangement)
        number = self.plan.arrangements.index(arrangement) + 1
        lit = {
            "sample": f"at {arrangement.incidence:g} degree, for {arrangement.side}",
            "etalon": f"turned to the {arrangement.incidence:g} degree entrance, and the mirrors to that",
            "target": f"and the mirrors to the {arrangement.incidence:g} degree entrance",
        }[arrangement.load]
        return f"arrangement {number} of {len(self.plan.arrangements)} (frame {shot.ordinal}): {holder} in the holder, {lit}"

    def _take(self, shot: Shot) -> None:
        picture, state = self._exposed(shot)
        path = self.folder / FRAMES / shot.name
        frame = frames.write_frame(
            path, picture, shot, self.plan, state=state, origin=self._origin, camera=self._camera
        )
        self.journal.append("frame", **self._facts(shot, frame))
        self._finish(shot, frame)
        if shot.purpose == "drift":
            self._judge_lamp(fresh=True)
        elif shot.step and not self._judged:
            self._judge_filters(shot)

    def _exposed(self, shot: Shot) -> tuple[Picture, State]:
        """One exposure during which nothing moved, and where the devices said they were."""
        problem: DeviceError | None = None
        for attempt in range(1, ATTEMPTS + 1):
            try:
                before = self._moved(shot)
                picture = self._picture(shot)
                after = self._state()
                if before.position == after.position and abs(before.wavelength - after.wavelength) <= STILL:
                    return picture, before
                raise DeviceError(
                    "rig", f"a device moved during the exposure: {_place(before)} before, {_place(after)} after"
                )
            except (DeviceLost, WrongDevice):
                raise
            except DeviceError as error:
                problem, self._asked = error, None
                self.journal.append("retry", shot=shot.ordinal, attempt=attempt, problem=str(error))
                self._retries += attempt < ATTEMPTS
        assert problem is not None
        raise problem

    def _moved(self, shot: Shot) -> State:
        """Where the devices say they are, which is where the shot wants them."""
        wanted = State(shot.wavelength, shot.position)
        # Until they are known to have arrived, they are told again.
        before, self._asked = self._asked, None
        if before is None or before.wavelength != wanted.wavelength:
            self.bench.monochromator.goto(wanted.wavelength)
        if before is None or before.position != wanted.position:
            self.bench.wheel.goto(wanted.position)
        found = self._state()
        if found.position != wanted.position or not abs(found.wavelength - wanted.wavelength) <= WAVELENGTH_TOLERANCE:
            raise DeviceError("rig", f"asked for {_place(wanted)}, the devices say {_place(found)}")
        self._asked = wanted
        return found

    def _state(self) -> State:
        return State(self.bench.monochromator.wavelength(), self.bench.wheel.position())

    def _picture(self, shot: Shot) -> Picture:
        picture = self.bench.camera.expose(shot.exposure, shutter=not shot.dark)
        counts, shape = picture.counts, (self.plan.rig.camera.height, self.plan.rig.camera.width)
        if counts.shape != shape or counts.dtype != np.uint16:
            found = f"{' × '.join(map(str, reversed(counts.shape)))} of {counts.dtype}"
            raise DeviceError("camera", f"a picture of {found}; the description says {shape[1]} × {shape[0]} of uint16")
        if not abs(picture.seconds - shot.exposure) <= TIMING * shot.exposure + 1e-3:
            raise DeviceError("camera", f"exposed {picture.seconds:g} s, asked for {shot.exposure:g} s")
        if not (math.isfinite(picture.started) and 0 <= picture.started < LATEST):
            raise DeviceError("camera", f"a start of the exposure that is no time: {picture.started}")
        return picture

    def _finish(self, shot: Shot, frame: Frame) -> None:
        if self._origin is None:
            self._origin = frame.origin
        self._finished.add(shot)
        if shot.purpose == "drift":
            dark = self._dark(shot.exposure)
            signal = math.nan if dark is None else checks.reference_signal(frame.counts, dark, self.plan.rig)
            self._looks.append(checks.Look(shot.ordinal, frame.elapsed, signal))

    # --- what the frames tell

    def _judge_lamp(self, *, fresh: bool) -> None:
        drift = self.plan.drift
        for warning in checks.drift_warnings(self._looks, drift.wavelength, drift.tolerance):
            if warning in self._warnings:
                continue
            if fresh:
                self.journal.append("drift", warning=warning)
            self._warn(warning)

    def _judge_filters(self, shot: Shot) -> None:
        """Once a bracket is complete, see whether its overlaps tell where the filters stand."""
        key = (shot.purpose, shot.arrangement, shot.wavelength)
        bracket = [each for each in self.plan.shots if (each.purpose, each.arrangement, each.wavelength) == key]
        if not self._finished.issuperset(bracket):
            return
        darks = [each for each in self.plan.shots if each.dark and each in self._finished]
        read = frames.read_shots(self.folder, self.plan, [*darks, *bracket])
        whole = {each: frame for each, frame in read if isinstance(frame, Frame)}
        found = checks.overlap_check(frames.dataset(whole, self.plan), self.plan.rig)
        if not found.overlaps:
            return
        self._judged = True
        self.journal.append(
            "overlap", pairs=len(found.overlaps), nd_location=found.nd_location, warnings=found.warnings
        )
        for warning in found.warnings:
            self._warn(warning)

    def _dark(self, exposure: float) -> Array | None:
        """Mean of the opening dark frames of an exposure time [counts]."""
        if exposure not in self._darks:
            shots = [shot for shot in self._finished if shot.dark and shot.exposure == exposure]
            read = [frame for _, frame in frames.read_shots(self.folder, self.plan, shots) if isinstance(frame, Frame)]
            if not read:
                return None
            self._darks[exposure] = np.mean([frame.counts for frame in read], axis=0)
        return self._darks[exposure]

    # --- what is told

    def _warn(self, warning: str) -> None:
        self._warnings.append(warning)
        self.say(f"warning: {warning}")

    def _facts(self, shot: Shot, frame: Frame) -> dict[str, Any]:
        return {
            **_arrangement(shot, self.plan),
            "purpose": shot.purpose,
            "file": shot.name,
            "sha256": frame.digest,
            "wavelength": frame.state.wavelength,
            "position": frame.state.position,
            "exposure": shot.exposure,
            "started": frame.started,
            "temperature": frame.temperature if math.isfinite(frame.temperature) else None,
        }

    def _note_end(self, event: str, shot: Shot, reason: str) -> None:
        with suppress(store.StoreError):  # on a full disk there is no room for it
            self.journal.append(event, shot=shot.ordinal, reason=reason)

    def _stopped(self, shot: Shot, error: BrdfpipeError) -> str:
        total, done = len(self.plan.shots), len(self._finished)
        return (
            f"stopped before frame {shot.ordinal} of {total}: {error}; {done} frames are safe in {self.folder}: "
            "mend this, and the same command with --resume goes on"
        )


def _arrangement(shot: Shot, plan: Plan) -> dict[str, Any]:
    arrangement = shot.arrangement
    return {
        "shot": shot.ordinal,
        "incidence": arrangement.incidence,
        "side": arrangement.side,
        "holder": plan.sample_id(arrangement),
    }


def _place(state: State) -> str:
    return f"{state.wavelength:g} nm and filter {state.position}"


# --- the run's folder


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    from filelock import FileLock, Timeout

    lock = FileLock(folder / LOCK, timeout=0)
    with ExitStack() as held:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            held.enter_context(lock)
        except Timeout:
            advice = "wait for it, or choose another --out"
            raise InputError(folder, "another scan is running in this folder", accepted=advice) from None
        except OSError as error:
            raise InputError(folder, f"cannot be written ({error.strerror})", accepted="another --out") from error
        yield


def _prepare(plan: Plan, folder: Path, resume: bool) -> None:
    """Make the folder that of a run of this plan, or refuse."""
    for leftover in [*folder.glob(".*.tmp"), *(folder / FRAMES).glob(".*.tmp")]:
        leftover.unlink(missing_ok=True)
    if not (folder / PLAN).exists():
        _begin(plan, folder)
        return
    if unlike := plan.differences(Plan.load(folder / PLAN)):
        raise InputError(
            folder,
            "holds a run of another plan or rig",
            found="; ".join(unlike) + " (of this plan, and of the run there)",
            accepted="the plan it was begun with, or another --out",
        )
    done = sum(1 for _ in (folder / FRAMES).glob("*.fits"))
    if not resume and (done or (folder / JOURNAL).exists()):
        raise InputError(
            folder,
            "holds a run of this plan already",
            found=f"{done} of {len(plan.shots)} frames",
            accepted="--resume, or another --out",
        )
    (folder / FRAMES).mkdir(exist_ok=True)


def _begin(plan: Plan, folder: Path) -> None:
    files = sources(plan.path)
    expected = {FRAMES, LOCK, *(name.split("/")[0] for name in files)}
    if strangers := sorted({item.name for item in folder.iterdir()} - expected):
        raise InputError(folder, "holds other files", found=strangers[0], accepted="a new or an empty folder")
    (folder / FRAMES).mkdir(exist_ok=True)
    # The plan comes last: a folder that has it has the rest.
    for name in sorted(files, key=PLAN.__eq__):
        store.write_bytes(folder / name, files[name].read_bytes())


@contextmanager
def _bar(plan: Plan, left: list[Shot], progress: bool) -> Iterator[Callable[[Shot | None], None]]:
    """Frames done and time left, by what each is expected to take; told None after a wait for the operator."""
    if not progress:
        yield lambda shot: None
        return
    from tqdm import tqdm

    before = dict(zip(plan.shots, (None, *plan.shots), strict=False))
    seconds = {shot: duration(shot, before[shot], plan.rig) for shot in plan.shots}
    total = sum(seconds.values())
    layout = "{percentage:3.0f}%|{bar}| {desc}, {remaining} left"
    with tqdm(
        total=total,
        initial=total - sum(seconds[shot] for shot in left),
        bar_format=layout,
        disable=None,
        leave=False,
    ) as bar:

        def advance(shot: Shot | None) -> None:
            if shot is None:
                bar.unpause()
                return
            place = f"{shot.purpose} at {shot.arrangement.incidence:g}°, {shot.wavelength:g} nm"
            bar.set_description_str(f"frame {shot.ordinal} of {len(plan.shots)} ({place})", refresh=False)
            bar.update(seconds[shot])

        yield advance
