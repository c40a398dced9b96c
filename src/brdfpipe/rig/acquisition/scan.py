"""The scan: every exposure of a plan, each on disk before the next begins, and each labelled with what the devices report.

A frame is accepted only if both devices report the requested state before and after its exposure. The frames in the folder of the run alone decide
what is finished. After any interruption (Ctrl-C, kill, a disconnected device, a full disk, a power failure) the same command with ``--resume``
takes the missing frames and no others. Each frame is judged (:mod:`brdfpipe.rig.checks`) before it is stored; the plan's ``bad_frames`` says
what happens to a bad one.
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from importlib.metadata import version
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from brdfpipe import store
from brdfpipe.errors import BrdfpipeError, InputError
from brdfpipe.geometry import Array
from brdfpipe.rig.acquisition import journal as journals
from brdfpipe.rig.acquisition import run_folder
from brdfpipe.rig.acquisition.devices.connection import RigDevices
from brdfpipe.rig.acquisition.devices.errors import DeviceError, DeviceLost, WrongDevice
from brdfpipe.rig.acquisition.estimate import durations
from brdfpipe.rig.acquisition.frame_choice import FrameChoice
from brdfpipe.rig.acquisition.instructions import instruction
from brdfpipe.rig.checks.frame_judge import Finding, FrameJudge
from brdfpipe.rig.filter_location import check_overlaps
from brdfpipe.rig.frame_file import WAVELENGTH_TOLERANCE, DeviceState, Frame, FrameError, frame_size, write_frame
from brdfpipe.rig.frames import frames_dataset, read_shots
from brdfpipe.rig.lamp_drift import LampReading, drift_warnings, reference_signal
from brdfpipe.rig.plan import FRAMES, JOURNAL, Arrangement, Plan, Shot
from brdfpipe.rig.raw_frame import RawFrame, expected_format, exposure_tolerance, has_expected_format, image_format

ATTEMPTS = 3
"""An exposure and two repetitions."""

STILL = 0.05
"""Largest difference [nm] of two readings of a monochromator at rest."""

LATEST_START = 9.9e9
"""Seconds of Unix time, in the year 2283: a header has no room for microseconds of a later start."""

_BRACKET = attrgetter("purpose", "arrangement", "wavelength")

Confirm = Callable[[Arrangement, str], bool]
"""Asks the operator to arrange mirrors and sample, also described in words; returns whether it is done."""


class BadFrame(DeviceError):
    """A frame that its checks find bad; it may be better when it is taken again."""


class BadArrangement(BrdfpipeError):
    """Frames show that mirrors or holder are not arranged as confirmed."""


class ScanStopped(BrdfpipeError):
    """The scan cannot continue; finished frames are safe, and the scan can be resumed."""


@dataclass(frozen=True)
class Summary:
    """Result of a scan."""

    folder: Path
    frames: int
    """Frames in the folder: all of the plan but those left out."""
    taken: int
    """Frames taken by this scan."""
    left_out: int
    """Frames of the plan that were not needed."""
    retries: int
    """Exposures that were discarded and repeated."""
    warnings: tuple[str, ...]

    @property
    def text(self) -> str:
        repeated = f", {self.retries} exposure{'s' * (self.retries > 1)} repeated" if self.retries else ""
        spared = f", {self.left_out} of the plan not needed" if self.left_out else ""
        return f"{self.frames} frames in {self.folder}, {self.taken} of them taken now{repeated}{spared}"


def scan(
    plan: Plan,
    devices: RigDevices,
    folder: Path,
    *,
    clock: Callable[[], float],
    confirm: Confirm,
    operator: str = "",
    progress: bool = False,
    resume: bool = False,
    on_warning: Callable[[str], None] = lambda line: None,
) -> Summary:
    """Take every frame of a plan that is missing in the folder.

    Parameters
    ----------
    plan : exposures and rig
    devices : of the rig
    folder : of the run; created if it does not exist
    clock : seconds, for the journal
    confirm : called before the first frame and whenever mirrors or sample must be moved; the scan stops if it returns False
    operator : name of the person who confirms, for the journal
    progress : show frames and time left on a terminal
    resume : continue an existing run; otherwise a run that has been started is refused
    on_warning : called with each warning

    Raises
    ------
    InputError : the folder holds other files, or a run of another plan or rig.
    ScanStopped : a device failed permanently, the operator refused, or the disk is full.
    """
    with run_folder.locked(folder):
        run_folder.prepare(plan, folder, resume)
        with journals.Journal(folder / JOURNAL, clock) as journal:
            return _Scan(plan, devices, folder, journal, confirm, operator, on_warning).run(progress)


def last_finished(plan: Plan, folder: Path) -> tuple[Shot, Frame] | None:
    """Last complete frame of a run, None if there is none."""
    results = read_shots(folder, plan, reversed(plan.shots))
    return next(((shot, result) for shot, result in results if isinstance(result, Frame)), None)


@dataclass
class _Scan:
    """A scan in progress."""

    plan: Plan
    devices: RigDevices
    folder: Path
    journal: journals.Journal
    confirm: Confirm
    operator: str
    on_warning: Callable[[str], None]
    _camera: str = ""
    _arrangement: Arrangement | None = None
    """Arrangement that the operator confirmed last."""
    _requested: DeviceState | None = None
    """State last requested and reached; None if the devices must be moved again to be sure."""
    _run_start: float | None = None
    _finished: set[Shot] = field(default_factory=set)
    _lamp_readings: list[LampReading] = field(default_factory=list)
    _first_settings: Any = None
    """Settings of the devices at the start of the run, as its journal has them."""
    _filters_checked: bool = False
    """Whether a bracket with overlapping frames has been checked for the location of the filters."""
    _mean_darks: dict[float, Array] = field(default_factory=dict)
    _warnings: list[str] = field(default_factory=list)
    _retries: int = 0
    _judge: FrameJudge | None = None
    """None where frames are accepted unchecked."""
    _choice: FrameChoice | None = None
    """None where all frames of a bracket are taken."""
    _left_out: set[Shot] = field(default_factory=set)
    _digests: dict[Shot, str] = field(default_factory=dict)
    _warned: set[tuple[str, Arrangement]] = field(default_factory=set)

    def __post_init__(self) -> None:
        if self.plan.bad_frames != "accept":
            self._judge = FrameJudge(self.plan.rig)
        if self.plan.exposures == "needed":
            self._choice = FrameChoice(self.plan)

    def run(self, progress: bool) -> Summary:
        """Take the missing frames."""
        self._find_finished()
        before = len(self._finished)
        missing = [shot for shot in self.plan.shots if shot not in self._finished and shot not in self._left_out]
        self._check_disk(len(missing))
        if missing:
            self._record_start(len(missing))
            self._take_all(missing, progress)
            self.journal.append("finished", frames=len(self._finished))
        count = len(self._finished)
        return Summary(self.folder, count, count - before, len(self._left_out), self._retries, tuple(self._warnings))

    # --- existing frames

    def _find_finished(self) -> None:
        """Accept frames that are complete and, if the journal lists them, have the listed digest."""
        events = journals.read(self.folder / JOURNAL)
        digests, rejected = journals.recorded_digests(events), journals.rejected_digests(events)
        self._filters_checked = any(event["event"] == "overlap" for event in events)
        self._first_settings = next((event.get("settings") for event in events if event["event"] == "begun"), None)
        taken_again = rejected if self.plan.bad_frames in ("retake", "stop") else set()
        for shot, result in read_shots(self.folder, self.plan, self.plan.shots):
            if isinstance(result, Frame) and result.digest in taken_again:
                self._warn(f"{shot.name}: its arrangement was rejected; the frame is taken again")
            elif isinstance(result, Frame) and digests.get(shot.ordinal, result.digest) == result.digest:
                if shot.ordinal not in digests:
                    self.journal.append("adopted", **self._frame_record(shot, result))
                self._add_finished(shot, result)
            else:
                problem = str(result) if isinstance(result, FrameError) else f"{shot.name}: changed since it was taken"
                self.journal.append("damaged", shot=shot.ordinal, problem=problem)
                self._warn(f"{problem}; the frame is taken again")
        if self._choice is not None:
            ordinals = journals.left_out(events)
            self._left_out = {
                shot for shot in self.plan.shots if shot.ordinal in ordinals and shot not in self._finished
            }
        accepted = [shot for shot, digest in self._digests.items() if digest in rejected]
        if accepted:
            # Readers of the run use them from now on.
            shots, sha256 = [shot.ordinal for shot in accepted], [self._digests[shot] for shot in accepted]
            self.journal.append("accepted", shots=shots, sha256=sha256, bad_frames=self.plan.bad_frames)
        self._check_lamp(new=False)

    def _check_disk(self, count: int) -> None:
        required, free = count * frame_size(self.plan), shutil.disk_usage(self.folder).free
        if required > free:
            problem, found = "not enough disk space for the missing frames", f"{free >> 20} MiB free"
            accepted = f"{(required >> 20) + 1} MiB; free disk space, or choose another --out"
            raise InputError(self.folder, problem, found=found, accepted=accepted)

    def _record_start(self, missing: int) -> None:
        plan, devices = self.plan, self.devices
        self._camera = devices.camera.identify()
        names = {"monochromator": devices.monochromator.identify(), "wheel": devices.wheel.identify()}
        settings = {**devices.monochromator.describe(), **devices.wheel.describe()}
        self.journal.append(
            "begun",
            frames=len(plan.shots),
            left=missing,
            sample=plan.sample,
            rig=plan.rig.name,
            rig_digest=plan.rig.digest,
            operator=self.operator,
            software=version("brdfpipe"),
            camera=self._camera,
            settings=settings,
            **names,
        )
        if isinstance(self._first_settings, dict):
            self._compare_settings(self._first_settings, settings)

    def _compare_settings(self, before: dict[str, Any], now: dict[str, str]) -> None:
        """Warn of settings of the devices that differ from those at the start of the run."""
        changed = [name for name in sorted({*before, *now}) if before.get(name) != now.get(name)]
        if changed:
            text = ", ".join(
                f"{name} {now.get(name, 'unknown')}, was {before.get(name, 'unknown')}" for name in changed
            )
            advice = "slits and mirrors decide which light passes: set them back, or begin a new run"
            self._warn(f"the devices are set otherwise than at the start of the run ({text}); {advice}")

    # --- exposures

    def _take_all(self, missing: list[Shot], progress: bool) -> None:
        with _progress_bar(self.plan, missing, progress) as advance:
            choice, leave_out = self._choice, partial(self._leave_out, advance=advance)
            for shot in missing if choice is None else choice.order(missing, leave_out):
                try:
                    self._arrange(shot, advance)
                    self._take(shot)
                except KeyboardInterrupt:
                    self._record_end("interrupted", shot, "Ctrl-C")
                    raise
                except BrdfpipeError as error:
                    self._record_end("stopped", shot, str(error))
                    stop = f"scan stopped before frame {shot.ordinal} of {len(self.plan.shots)}: {error}"
                    safe = f"{len(self._finished)} frames are safe in {self.folder}"
                    advice = "Correct the problem and repeat the command with --resume"
                    raise ScanStopped(f"{stop}; {safe}. {advice}") from error
                advance(shot)

    def _leave_out(self, shots: list[Shot], advance: Callable[[Shot | None], None]) -> None:
        """Record frames that are not needed."""
        self._left_out |= {*shots}
        self.journal.append("left out", shots=[shot.ordinal for shot in shots])
        for shot in shots:
            advance(shot)

    def _arrange(self, shot: Shot, advance: Callable[[Shot | None], None]) -> None:
        if shot.arrangement == self._arrangement:
            return
        text = self._instruction(shot)
        if not self.confirm(shot.arrangement, text):
            raise BrdfpipeError(f"not confirmed: {text}")
        self._arrangement = shot.arrangement
        self.journal.append("confirmed", **_arrangement_record(shot, self.plan), by=self.operator)
        advance(None)

    def _instruction(self, shot: Shot) -> str:
        arrangement, arrangements = shot.arrangement, self.plan.arrangements
        number = f"arrangement {arrangements.index(arrangement) + 1} of {len(arrangements)} (frame {shot.ordinal})"
        return f"{number}: {instruction(arrangement, self.plan.sample_id(arrangement))}"

    def _take(self, shot: Shot) -> None:
        raw, state = self._expose(shot)
        path = self.folder / FRAMES / shot.name
        frame = write_frame(path, raw, shot, self.plan, state=state, run_start=self._run_start, camera=self._camera)
        self.journal.append("frame", **self._frame_record(shot, frame))
        self._add_finished(shot, frame)
        if shot.purpose == "drift":
            self._check_lamp(new=True)
        elif shot.step and not self._filters_checked:
            self._check_filters(shot)

    def _expose(self, shot: Shot) -> tuple[RawFrame, DeviceState]:
        """One exposure during which no device moved, and the state the devices reported."""
        attempt = 0
        while True:
            attempt += 1
            try:
                before = self._move_devices(shot)
                raw = self._read_camera(shot)
                after = self._device_state()
                if before.position != after.position or abs(before.wavelength - after.wavelength) > STILL:
                    raise DeviceError("rig", f"a device moved during the exposure: {before} before, {after} after")
                self._check_frame(shot, raw, before)
                return raw, before
            except (DeviceLost, WrongDevice):
                raise
            except DeviceError as error:
                self._requested = None
                self.journal.append("retry", shot=shot.ordinal, attempt=attempt, problem=str(error))
                if attempt == ATTEMPTS or (isinstance(error, BadFrame) and self.plan.bad_frames == "stop"):
                    raise
                self._retries += 1

    def _move_devices(self, shot: Shot) -> DeviceState:
        """State the devices report after they have moved to that of the shot."""
        target = DeviceState(shot.wavelength, shot.position)
        # Cleared until the devices have arrived: a repetition then moves both.
        before, self._requested = self._requested, None
        if before is None or before.wavelength != target.wavelength:
            self.devices.monochromator.goto(target.wavelength)
        if before is None or before.position != target.position:
            self.devices.wheel.goto(target.position)
        state = self._device_state()
        if state.position != target.position or not abs(state.wavelength - target.wavelength) <= WAVELENGTH_TOLERANCE:
            raise DeviceError("rig", f"requested {target}, devices report {state}")
        self._requested = target
        return state

    def _device_state(self) -> DeviceState:
        return DeviceState(self.devices.monochromator.wavelength(), self.devices.wheel.position())

    def _read_camera(self, shot: Shot) -> RawFrame:
        raw = self.devices.camera.expose(shot.exposure, shutter=not shot.dark)
        camera = self.plan.rig.camera
        if not has_expected_format(raw.counts, camera):
            raise DeviceError("camera", f"image of {image_format(raw.counts)}, expected {expected_format(camera)}")
        if not abs(raw.seconds - shot.exposure) <= exposure_tolerance(shot.exposure):
            raise DeviceError("camera", f"exposure time {raw.seconds:g} s, {shot.exposure:g} s requested")
        if not (math.isfinite(raw.started) and 0 <= raw.started < LATEST_START):
            raise DeviceError("camera", f"invalid start of the exposure: {raw.started}")
        return raw

    def _check_frame(self, shot: Shot, raw: RawFrame, state: DeviceState) -> None:
        """Judge a frame before it is stored. Raises BadFrame or BadArrangement, as the plan's ``bad_frames`` asks."""
        if self._judge is None:
            return
        last_step = len(self.plan.bracket) if self._choice is None else self._choice.last_step(shot)
        last = bool(shot.step) and shot.step == last_step
        for finding in self._judge.judge(shot, raw.counts, wavelength_read=state.wavelength, last_of_bracket=last):
            if finding.severity == "warning" or self.plan.bad_frames == "warn":
                self._note(shot, finding)
            elif finding.arrangement:
                self._reject_arrangement(shot, finding)
                raise BadArrangement(finding.text)
            else:
                raise BadFrame("frame", f"{finding.name}: {finding.text}")

    def _note(self, shot: Shot, finding: Finding) -> None:
        """Record a finding, and warn of it once in an arrangement."""
        self.journal.append("noticed", shot=shot.ordinal, check=finding.name, problem=finding.text)
        if (key := (finding.name, shot.arrangement)) not in self._warned:
            self._warned.add(key)
            self._warn(f"frame {shot.ordinal}: {finding.text}")

    def _reject_arrangement(self, shot: Shot, finding: Finding) -> None:
        """Record that the finished frames of the shot's arrangement must be taken again."""
        shots = [other for other in self._finished if other.arrangement == shot.arrangement and not other.dark]
        shots.sort(key=attrgetter("ordinal"))
        self.journal.append(
            "rejected",
            shots=[other.ordinal for other in shots],
            sha256=[self._digests[other] for other in shots],
            check=finding.name,
            problem=finding.text,
        )

    def _add_finished(self, shot: Shot, frame: Frame) -> None:
        self._digests[shot] = frame.digest
        if self._judge is not None:
            self._judge.learn(shot, frame.counts)
        if self._choice is not None and shot.step:
            self._choice.learn(shot, frame.counts, self._mean_dark(shot.exposure))
        if self._run_start is None:
            self._run_start = frame.run_start
        self._finished.add(shot)
        if shot.purpose == "drift":
            dark = self._mean_dark(shot.exposure)
            signal = math.nan if dark is None else reference_signal(frame.counts, dark, self.plan.rig)
            self._lamp_readings.append(LampReading(shot.ordinal, frame.elapsed, signal))

    # --- checks of the rig by its frames

    def _check_lamp(self, *, new: bool) -> None:
        drift = self.plan.drift
        for warning in drift_warnings(self._lamp_readings, drift.wavelength, drift.tolerance):
            if warning not in self._warnings:
                if new:
                    self.journal.append("drift", warning=warning)
                self._warn(warning)

    def _check_filters(self, shot: Shot) -> None:
        """Check the location of the filters once a bracket is complete."""
        bracket = [other for other in self.plan.shots if _BRACKET(other) == _BRACKET(shot)]
        if not self._finished.issuperset(bracket):
            return
        darks = [other for other in self.plan.shots if other.dark and other in self._finished]
        results = read_shots(self.folder, self.plan, [*darks, *bracket])
        frames = {shot: result for shot, result in results if isinstance(result, Frame)}
        check = check_overlaps(frames_dataset(frames, self.plan), self.plan.rig)
        if check.overlaps:
            self._filters_checked = True
            pairs, location = len(check.overlaps), check.nd_location
            self.journal.append("overlap", pairs=pairs, nd_location=location, warnings=check.warnings)
            for warning in check.warnings:
                self._warn(warning)

    def _mean_dark(self, exposure: float) -> Array | None:
        """Mean of the finished dark frames of an exposure time [counts]; None if there are none."""
        if exposure not in self._mean_darks:
            shots = [shot for shot in self._finished if shot.dark and shot.exposure == exposure]
            results = read_shots(self.folder, self.plan, shots)
            if counts := [result.counts for _, result in results if isinstance(result, Frame)]:
                self._mean_darks[exposure] = np.mean(counts, axis=0)
        return self._mean_darks.get(exposure)

    # --- journal and messages

    def _warn(self, warning: str) -> None:
        self._warnings.append(warning)
        self.on_warning(f"warning: {warning}")

    def _frame_record(self, shot: Shot, frame: Frame) -> dict[str, Any]:
        return {
            **_arrangement_record(shot, self.plan),
            "purpose": shot.purpose,
            "file": shot.name,
            "sha256": frame.digest,
            "wavelength": frame.state.wavelength,
            "position": frame.state.position,
            "exposure": shot.exposure,
            "started": frame.started,
            "temperature": frame.temperature if math.isfinite(frame.temperature) else None,
        }

    def _record_end(self, event: str, shot: Shot, reason: str) -> None:
        with suppress(store.StoreError):  # a full disk has no room for it
            self.journal.append(event, shot=shot.ordinal, reason=reason)


def _arrangement_record(shot: Shot, plan: Plan) -> dict[str, Any]:
    incidence, side = shot.arrangement.incidence, shot.arrangement.side
    return {"shot": shot.ordinal, "incidence": incidence, "side": side, "holder": plan.sample_id(shot.arrangement)}


@contextmanager
def _progress_bar(plan: Plan, missing: list[Shot], progress: bool) -> Iterator[Callable[[Shot | None], None]]:
    """Frames done and time left, from the expected duration of each; called with None after waiting for the operator."""
    from tqdm import tqdm

    seconds = durations(plan)
    total, left = sum(seconds.values()), sum(seconds[shot] for shot in missing)
    form = "{percentage:3.0f}%|{bar}| {desc}, {remaining} left"
    shown = None if progress else True  # None: on a terminal
    with tqdm(total=total, initial=total - left, bar_format=form, disable=shown, leave=False) as bar:

        def advance(shot: Shot | None) -> None:
            if shot is None:
                bar.unpause()
            else:
                description = f"{shot.purpose} at {shot.arrangement.incidence:g}°, {shot.wavelength:g} nm"
                bar.set_description_str(f"frame {shot.ordinal} of {len(plan.shots)} ({description})", refresh=False)
                bar.update(seconds[shot])

        yield advance
