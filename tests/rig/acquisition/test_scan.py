"""The scan: frames on disk, their labels, and resuming after every kind of interruption."""

from __future__ import annotations

import io
import math
import os
import shutil
import sys
import time
from contextlib import suppress
from dataclasses import replace

import filelock
import numpy as np
import pytest
import small_rig
from astropy.io import fits

from brdfpipe import vocabulary
from brdfpipe.errors import InputError
from brdfpipe.rig.acquisition import journal
from brdfpipe.rig.acquisition.devices.connection import connect
from brdfpipe.rig.acquisition.devices.errors import DeviceError, DeviceLost, WrongDevice
from brdfpipe.rig.acquisition.scan import ScanStopped, last_finished, scan
from brdfpipe.rig.emulator.emulated_scan import automatic_operator
from brdfpipe.rig.frame_file import frame_size, read_frame
from brdfpipe.rig.frames import read_run
from brdfpipe.rig.plan import Plan
from brdfpipe.rig.raw_frame import RawFrame


@pytest.fixture(autouse=True)
def quick_disk(monkeypatch):
    """No test here is about power failures."""
    monkeypatch.setattr(os, "fsync", lambda file: None)


@pytest.fixture
def plan(tmp_path):
    return Plan.load(small_rig.write(tmp_path / "bench"))


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "run"


def on_disk(folder):
    return sorted(path.name for path in (folder / "frames").glob("*"))


def events(folder, kind=None):
    return [event for event in journal.read(folder / "journal.jsonl") if kind in (None, event["event"])]


def stopped_at(plan, folder, number, error=None, **options):
    """A scan that stops because the camera fails at an exposure."""
    camera = small_rig.FakeCamera(before=small_rig.failing({number}, error or DeviceLost("camera", "gone")))
    with pytest.raises(ScanStopped) as stop:
        small_rig.take(plan, small_rig.fake_bench(camera=camera), folder, **options)
    return stop.value


# --- an undisturbed scan


def test_each_frame_is_on_the_disk_before_the_next_exposure(plan, folder):
    states = []
    camera = small_rig.FakeCamera(before=lambda number: states.append((on_disk(folder), len(events(folder, "frame")))))
    small_rig.take(plan, small_rig.fake_bench(camera=camera), folder)
    names = [shot.name for shot in plan.shots]
    assert states == [(names[:done], done) for done in range(len(names))]
    assert on_disk(folder) == names


def test_the_camera_exposes_as_planned(plan, folder):
    camera = small_rig.FakeCamera()
    small_rig.take(plan, small_rig.fake_bench(camera=camera), folder)
    assert camera.exposures == [(shot.exposure, not shot.dark) for shot in plan.shots]


def test_devices_move_only_where_the_plan_requires_it(plan, folder):
    bench = small_rig.fake_bench()
    small_rig.take(plan, bench, folder)
    wavelengths, positions = ([getattr(shot, key) for shot in plan.shots] for key in ("wavelength", "position"))
    for moves, wanted in ((bench.monochromator.moves, wavelengths), (bench.wheel.moves, positions)):
        assert moves == [after for before, after in zip([None, *wanted], wanted, strict=False) if before != after]


def test_the_folder_has_the_descriptions_of_the_frames(plan, folder):
    done = small_rig.take(plan, small_rig.fake_bench(), folder)
    for name in ("plan.yaml", "rig.yaml", "fibres.csv"):
        assert (folder / name).read_bytes() == (plan.path.parent / name).read_bytes()
    assert done.frames == done.taken == len(plan.shots)
    assert done.text == f"{len(plan.shots)} frames in {folder}, {len(plan.shots)} of them taken now"
    assert not list(folder.glob("**/.*.tmp"))


def test_the_operator_is_asked_before_each_arrangement_and_only_then(plan, folder):
    asked = []

    def confirm(arrangement, words):
        asked.append((arrangement, words, len(on_disk(folder))))
        return True

    small_rig.take(plan, small_rig.fake_bench(), folder, confirm=confirm, operator="ada")
    assert [arrangement for arrangement, _, _ in asked] == list(plan.arrangements)
    assert "arrangement 1 of 2 (frame 1): etalon in the holder, turned to the 10 degree entrance" in asked[0][1]
    assert "tile in the holder, at 20 degree, for reflection" in asked[1][1]
    first = next(shot for shot in plan.shots if shot.arrangement == plan.arrangements[1])
    assert asked[1][2] == first.ordinal - 1
    confirmed = events(folder, "confirmed")
    assert [(event["incidence"], event["holder"], event["by"]) for event in confirmed] == [
        (10, "etalon", "ada"),
        (20, "tile", "ada"),
    ]


def test_line_lamp_and_mirror_are_scanned_with_their_instructions_and_read_back(tmp_path, folder):
    text = (
        small_rig.PLAN
        + "runs: [line-lamp, mirror]\nline_lamp: {lines: [546.074]}\nmirror: {step: 45, to: 45}\nbad_frames: accept\n"
    )
    plan = Plan.load(small_rig.write(tmp_path / "turned", text))
    asked = []

    def confirm(arrangement, words):
        asked.append(words)
        return True

    small_rig.take(plan, small_rig.fake_bench(), folder, confirm=confirm)
    assert asked[0].endswith("line lamp in place of the lamp")
    assert "its normal at theta_s = 10.00 and phi_s = 0.00 degree, so that it sends the light to (0, 0)" in asked[1]
    frames = read_run(folder)
    mirror = frames.isel(frame=frames["purpose"].values == "mirror")
    assert np.unique(mirror["aim_theta"].values).tolist() == [0.0, 45.0]
    assert np.isnan(frames["aim_theta"].values[frames["purpose"].values == "line-lamp"]).all()
    assert frames.attrs["lines"] == [546.074]
    # The frames of a sample do not need those of the mirror.
    assert "mirror" not in read_run(folder, 10.0)["purpose"].values


def test_a_slit_that_changed_before_a_resumed_scan_is_warned_of(plan, folder):
    def warnings(slit, **options):
        camera = small_rig.FakeCamera(before=small_rig.failing({9}, DeviceLost("camera", "gone")))
        monochromator = small_rig.FakeMonochromator(settings={"grating": "1", "side exit slit": slit})
        heard = []
        with suppress(ScanStopped):
            bench = small_rig.fake_bench(monochromator=monochromator, camera=camera)
            small_rig.take(plan, bench, folder, on_warning=heard.append, **options)
        return [warning for warning in heard if "the devices are set" in warning]

    assert warnings("480 um") == []
    assert events(folder, "begun")[0]["settings"] == {"grating": "1", "side exit slit": "480 um"}
    assert warnings("480 um", resume=True) == []
    (warning,) = warnings("1000 um", resume=True)
    assert "set otherwise than at the start of the run (side exit slit 1000 um, was 480 um)" in warning


def test_an_operator_who_refuses_stops_the_scan(plan, folder):
    answers = iter([True, False])
    with pytest.raises(ScanStopped, match="not confirmed: arrangement 2 of 2"):
        small_rig.take(plan, small_rig.fake_bench(), folder, confirm=lambda arrangement, words: next(answers))
    assert 0 < len(on_disk(folder)) < len(plan.shots)
    small_rig.take(plan, small_rig.fake_bench(), folder, resume=True)
    assert len(on_disk(folder)) == len(plan.shots)


def test_the_journal_has_every_state_of_the_devices(plan, folder):
    ticks = iter(range(10_000))
    small_rig.take(plan, small_rig.fake_bench(), folder, clock=lambda: float(next(ticks)), operator="ada")
    records = events(folder)
    assert [event["clock"] for event in records] == sorted(event["clock"] for event in records)
    begun, *_, finished = records
    assert (begun["monochromator"], begun["wheel"], begun["camera"]) == (
        "fake monochromator",
        "fake wheel",
        "fake camera",
    )
    assert (begun["rig_digest"], begun["sample"], begun["left"]) == (plan.rig.digest, "tile", len(plan.shots))
    assert finished["event"] == "finished"
    for event, shot in zip(events(folder, "frame"), plan.shots, strict=True):
        assert (event["shot"], event["file"]) == (shot.ordinal, shot.name)
        assert (event["wavelength"], event["position"], event["incidence"]) == (
            shot.wavelength,
            shot.position,
            shot.arrangement.incidence,
        )
        assert event["temperature"] is None


def test_time_left_is_shown_on_a_terminal(plan, folder, monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    camera = small_rig.FakeCamera(before=lambda number: time.sleep(0.15 * (number == 9)))  # long enough to be shown
    small_rig.take(plan, small_rig.fake_bench(camera=camera), folder, progress=True)
    text = terminal.getvalue()
    assert f"of {len(plan.shots)} (" in text
    assert " left" in text


# --- labels


def test_a_frame_is_labelled_with_the_state_read_back(plan, folder):
    bench = small_rig.fake_bench(monochromator=small_rig.FakeMonochromator(report=lambda state: state + 0.03))
    small_rig.take(plan, bench, folder)
    for shot in plan.shots:
        assert fits.getheader(folder / "frames" / shot.name)["WAVELEN"] == shot.wavelength + 0.03
    frames = read_run(folder)
    assert (frames["wavelength_read"] - frames["wavelength"]).values == pytest.approx(0.03)


@pytest.mark.parametrize("bench", [
    {"monochromator": small_rig.FakeMonochromator(report=lambda state: state + 0.6)},
    {"monochromator": small_rig.FakeMonochromator(report=lambda state: math.nan)},
    {"wheel": small_rig.FakeWheel(report=lambda state: 3)},
])  # fmt: skip
def test_no_frame_is_exposed_while_a_device_reports_another_state(plan, folder, bench):
    camera = small_rig.FakeCamera()
    with pytest.raises(ScanStopped, match=r"stopped before frame 1 of .*requested .*, devices report"):
        small_rig.take(plan, small_rig.fake_bench(camera=camera, **bench), folder)
    assert camera.exposures == []
    assert on_disk(folder) == []


class Restless:
    """A device that moves during some exposures."""

    def __init__(self, numbers, device, change):
        self.numbers, self.device, self.change = numbers, device, change

    def __call__(self, number):
        if number in self.numbers:
            self.device.state += self.change


@pytest.mark.parametrize(("device", "change"), [("monochromator", 0.2), ("monochromator", -40.0), ("wheel", 1)])
def test_a_frame_during_which_a_device_moved_is_taken_again(plan, folder, device, change):
    bench = small_rig.fake_bench(camera=small_rig.FakeCamera())
    bench.camera.before = Restless({4, 7}, getattr(bench, device), change)
    done = small_rig.take(plan, bench, folder)
    assert done.retries == 2
    assert "2 exposures repeated" in done.text
    retries = events(folder, "retry")
    assert [event["shot"] for event in retries] == [4, 6]
    assert "a device moved during the exposure" in retries[0]["problem"]
    # Every pixel holds the number of the exposure: the fourth and the seventh are missing.
    numbers = [int(fits.getdata(folder / "frames" / shot.name)[0, 0]) for shot in plan.shots]
    assert numbers == [number for number in range(1, len(plan.shots) + 3) if number not in (4, 7)]
    assert (read_run(folder)["wavelength_read"] == read_run(folder)["wavelength"]).all()


def test_a_device_that_keeps_moving_stops_the_scan(plan, folder):
    bench = small_rig.fake_bench(camera=small_rig.FakeCamera())
    bench.camera.before = Restless(range(5, 100), bench.wheel, 1)
    with pytest.raises(ScanStopped, match=r"stopped before frame 5 .*a device moved during the exposure"):
        small_rig.take(plan, bench, folder)
    assert len(on_disk(folder)) == 4
    assert len(bench.camera.exposures) == 4 + 3
    small_rig.take(plan, small_rig.fake_bench(), folder, resume=True)
    assert len(on_disk(folder)) == len(plan.shots)


# --- devices that fail


def test_an_exposure_is_repeated_after_a_failure_of_the_camera(plan, folder):
    camera = small_rig.FakeCamera(before=small_rig.failing({2, 5, 6}, small_rig.camera_error()))
    done = small_rig.take(plan, small_rig.fake_bench(camera=camera), folder)
    assert done.retries == 3
    assert len(on_disk(folder)) == len(plan.shots)
    assert [event["attempt"] for event in events(folder, "retry")] == [1, 1, 2]


def test_a_camera_that_fails_three_times_stops_the_scan(plan, folder):
    camera = small_rig.FakeCamera(before=small_rig.failing({4, 5, 6}, small_rig.camera_error("no frame in 61 s")))
    with pytest.raises(ScanStopped) as stop:
        small_rig.take(plan, small_rig.fake_bench(camera=camera), folder)
    message = str(stop.value)
    for words in (
        f"before frame 4 of {len(plan.shots)}",
        "no frame in 61 s",
        "3 frames are safe",
        "repeat the command with --resume",
    ):
        assert words in message
    assert events(folder)[-1]["event"] == "stopped"
    assert len(on_disk(folder)) == 3


@pytest.mark.parametrize("kind", [DeviceLost, WrongDevice])
def test_no_exposure_is_repeated_after_a_device_is_lost_or_exchanged(plan, folder, kind):
    stop = stopped_at(plan, folder, 4, kind("monochromator", "gone"))
    assert "monochromator: gone" in str(stop)
    assert len(on_disk(folder)) == 3


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda picture: replace(picture, counts=picture.counts[:, :-1]), "image of 95 × 72"),
        (lambda picture: replace(picture, counts=picture.counts.astype(np.int32)), "int32"),
        (lambda picture: replace(picture, seconds=2.0), "exposure time 2 s, 1 s requested"),
        (lambda picture: replace(picture, seconds=math.nan), "exposure time nan s"),
        (lambda picture: replace(picture, started=math.nan), "invalid start of the exposure: nan"),
        (lambda picture: replace(picture, started=-1.0), "invalid start of the exposure: -1.0"),
        (lambda picture: replace(picture, started=1e11), "invalid start of the exposure: 1000"),
    ],
)
def test_an_image_other_than_requested_is_refused(plan, folder, spoil, words):
    class Spoilt(small_rig.FakeCamera):
        def expose(self, seconds, *, shutter=True) -> RawFrame:
            return spoil(super().expose(seconds, shutter=shutter))

    with pytest.raises(ScanStopped) as stop:
        small_rig.take(plan, small_rig.fake_bench(camera=Spoilt()), folder)
    assert words in str(stop.value)
    assert on_disk(folder) == []


# --- resume


@pytest.mark.parametrize("number", [1, 2, 7, 12])
def test_a_resumed_scan_takes_only_missing_frames(plan, folder, number):
    stopped_at(plan, folder, number)
    before = small_rig.contents(folder)
    assert len(before) == number - 1
    camera = small_rig.FakeCamera()
    done = small_rig.take(plan, small_rig.fake_bench(camera=camera), folder, resume=True)
    assert len(camera.exposures) == done.taken == len(plan.shots) - number + 1
    after = small_rig.contents(folder)
    assert list(after) == [shot.name for shot in plan.shots]
    assert {name: after[name] for name in before} == before
    assert [event["shot"] for event in events(folder, "frame")] == [shot.ordinal for shot in plan.shots]


def test_elapsed_time_includes_a_pause(plan, folder):
    stopped_at(plan, folder, 5)
    camera = small_rig.FakeCamera(started=lambda number: 1.7e9 + 10 + 3600 + 10.0 * number)
    small_rig.take(plan, small_rig.fake_bench(camera=camera), folder, resume=True)
    elapsed = read_run(folder)["elapsed"].values
    assert list(elapsed[:4]) == [0, 10, 20, 30]
    assert list(elapsed[4:6]) == [3610, 3620]


def test_a_resumed_scan_asks_again_for_the_current_arrangement(plan, folder):
    stopped_at(plan, folder, 10)
    asked = []
    small_rig.take(
        plan,
        small_rig.fake_bench(),
        folder,
        resume=True,
        confirm=lambda arrangement, words: not asked.append((arrangement, words)),
    )
    assert asked[0][0] == plan.shots[9].arrangement
    assert "(frame 10)" in asked[0][1]


def test_a_finished_run_is_not_changed(plan, folder):
    small_rig.take(plan, small_rig.fake_bench(), folder)
    before = small_rig.contents(folder)
    bench = small_rig.fake_bench()
    done = small_rig.take(plan, bench, folder, resume=True, confirm=lambda arrangement, words: 1 / 0)
    assert done.taken == 0
    assert bench.monochromator.moves == bench.wheel.moves == bench.camera.exposures == []
    assert small_rig.contents(folder) == before


def test_resume_starts_a_run_in_a_new_folder(plan, folder):
    assert small_rig.take(plan, small_rig.fake_bench(), folder, resume=True).taken == len(plan.shots)


def test_a_frame_missing_in_the_journal_is_adopted(plan, folder):
    stopped_at(plan, folder, 6)
    lines = (folder / "journal.jsonl").read_bytes().splitlines(keepends=True)
    other_lines = [line for line in lines if b'"shot":5' not in line and b"stopped" not in line]
    (folder / "journal.jsonl").write_bytes(b"".join(other_lines) + b'{"clock":3,"event":"fra')
    camera = small_rig.FakeCamera()
    done = small_rig.take(plan, small_rig.fake_bench(camera=camera), folder, resume=True)
    assert done.taken == len(camera.exposures) == len(plan.shots) - 5
    assert [event["shot"] for event in events(folder, "adopted")] == [5]
    assert [event["event"] for event in events(folder)].count("repaired") == 1
    recorded = sorted(event["shot"] for event in events(folder) if event["event"] in ("frame", "adopted"))
    assert recorded == [shot.ordinal for shot in plan.shots]


def test_without_a_journal_the_frames_still_count(plan, folder):
    stopped_at(plan, folder, 6)
    (folder / "journal.jsonl").unlink()
    assert small_rig.take(plan, small_rig.fake_bench(), folder, resume=True).taken == len(plan.shots) - 5


def spoilt(path):
    content = bytearray(path.read_bytes())
    content[9000] ^= 1
    path.write_bytes(content)


def cut(path):
    path.write_bytes(path.read_bytes()[:5000])


def removed(path):
    path.unlink()


def replaced(path):
    """A complete frame with the right labels and other counts."""
    with fits.open(path) as images:
        images[0].data[:] = 7
        images[0].add_checksum()
        content = io.BytesIO()
        images[0].writeto(content)
    path.write_bytes(content.getvalue())


def test_an_adopted_frame_is_recorded_with_its_digest(plan, folder):
    stopped_at(plan, folder, 6)
    lines = (folder / "journal.jsonl").read_bytes().splitlines(keepends=True)
    (folder / "journal.jsonl").write_bytes(b"".join(line for line in lines if b'"shot":5' not in line))
    stopped_at(plan, folder, 2, resume=True)
    replaced(folder / "frames" / plan.shots[4].name)
    small_rig.take(plan, small_rig.fake_bench(), folder, resume=True)
    assert [event["shot"] for event in events(folder, "adopted")] == [5]
    assert [event["shot"] for event in events(folder, "damaged")] == [5]


@pytest.mark.cases(3)
@pytest.mark.parametrize("damage", [spoilt, cut, removed, replaced])
@pytest.mark.parametrize("number", [1, 4])
def test_a_damaged_frame_is_taken_again(plan, folder, damage, number):
    small_rig.take(plan, small_rig.fake_bench(), folder)
    whole = small_rig.contents(folder)
    damage(folder / "frames" / plan.shots[number - 1].name)
    messages = []
    camera = small_rig.FakeCamera(started=lambda count: 1.7e9 + 5000.0)
    done = small_rig.take(plan, small_rig.fake_bench(camera=camera), folder, resume=True, on_warning=messages.append)
    assert done.taken == len(camera.exposures) == 1
    repeated = [line for line in messages if "taken again" in line]
    assert len(repeated) == (damage is not removed)
    frames = read_run(folder)
    assert frames["elapsed"].values[number - 1] == 4990
    for name, content in whole.items():
        assert ((folder / "frames" / name).read_bytes() == content) == (name != plan.shots[number - 1].name)


def test_incomplete_files_of_an_earlier_scan_are_removed(plan, folder):
    stopped_at(plan, folder, 4)
    (folder / "frames" / f".{plan.shots[3].name}.123.tmp").write_bytes(b"half")
    (folder / ".plan.yaml.99.tmp").write_bytes(b"half")
    small_rig.take(plan, small_rig.fake_bench(), folder, resume=True)
    assert not list(folder.glob("**/.*.tmp"))


def test_the_last_finished_frame_is_found(plan, folder):
    assert last_finished(plan, folder) is None
    stopped_at(plan, folder, 6)
    shot, frame = last_finished(plan, folder)
    assert shot == plan.shots[4]
    assert frame.state.wavelength == shot.wavelength
    cut(folder / "frames" / shot.name)
    assert last_finished(plan, folder)[0] == plan.shots[3]


# --- folders of other runs


def test_a_started_run_needs_resume(plan, folder):
    stopped_at(plan, folder, 4)
    camera = small_rig.FakeCamera()
    with pytest.raises(
        InputError, match=f"holds a run of this plan already; found 3 of {len(plan.shots)} frames; .*--resume"
    ):
        small_rig.take(plan, small_rig.fake_bench(camera=camera), folder)
    assert camera.exposures == []


@pytest.mark.parametrize(
    ("file", "old", "new", "words"),
    [
        ("plan.yaml", "[500, 550]", "[500, 560]", ["wavelengths: 500.0, 560.0 and 500.0, 550.0"]),
        ("plan.yaml", "sample: tile", "sample: other", ["sample: other and tile"]),
        ("plan.yaml", "position: 2}", "position: 4}", ["bracket"]),
        ("rig.yaml", "nd_location: sample", "nd_location: reference", ["rig nd_location: reference and sample"]),
        ("fibres.csv", "A,15", "A,16", ["rig fibres"]),
    ],
)
def test_a_run_of_another_plan_or_rig_is_refused_with_the_difference(plan, folder, file, old, new, words):
    stopped_at(plan, folder, 4)
    path = plan.path.with_name(file)
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(InputError) as refusal:
        small_rig.take(Plan.load(plan.path), small_rig.fake_bench(), folder, resume=True)
    for word in ["holds a run of another plan or rig", *words]:
        assert word in str(refusal.value)
    assert len(on_disk(folder)) == 3


def test_other_ports_do_not_make_another_rig(plan, folder):
    stopped_at(plan, folder, 4)
    rig = plan.path.with_name("rig.yaml")
    rig.write_text(rig.read_text().replace("/dev/ttyUSB1", "/dev/ttyUSB7"))
    small_rig.take(Plan.load(plan.path), small_rig.fake_bench(), folder, resume=True)
    assert len(on_disk(folder)) == len(plan.shots)


def test_a_folder_with_other_files_is_refused(plan, folder):
    folder.mkdir()
    (folder / "thesis.tex").write_text("")
    with pytest.raises(InputError, match=r"holds other files; found thesis\.tex"):
        small_rig.take(plan, small_rig.fake_bench(), folder)


def test_a_run_killed_before_its_plan_was_copied_starts_again(plan, folder):
    small_rig.take(plan, small_rig.fake_bench(), folder)
    (folder / "plan.yaml").unlink()
    shutil.rmtree(folder / "frames")
    (folder / "journal.jsonl").unlink()
    assert small_rig.take(plan, small_rig.fake_bench(), folder).taken == len(plan.shots)


def test_a_second_scan_of_the_same_folder_is_refused(plan, folder):
    folder.mkdir()
    with (
        filelock.FileLock(folder / ".scan.lock"),
        pytest.raises(InputError, match="another scan is running in this folder"),
    ):
        small_rig.take(plan, small_rig.fake_bench(), folder)
    small_rig.take(plan, small_rig.fake_bench(), folder)


# --- interrupts and full disks


@pytest.mark.parametrize("number", [1, 6])
def test_ctrl_c_during_an_exposure_leaves_only_complete_frames(plan, folder, number):
    camera = small_rig.FakeCamera(before=small_rig.failing({number}, KeyboardInterrupt()))
    with pytest.raises(KeyboardInterrupt):
        small_rig.take(plan, small_rig.fake_bench(camera=camera), folder)
    assert on_disk(folder) == [shot.name for shot in plan.shots[: number - 1]]
    assert events(folder)[-1]["event"] == "interrupted"
    small_rig.take(plan, small_rig.fake_bench(), folder, resume=True)
    assert read_run(folder).sizes["frame"] == len(plan.shots)


@pytest.mark.cases(4)
@pytest.mark.parametrize("number", range(4, 40, 5))
def test_ctrl_c_during_a_write_leaves_only_complete_files(plan, folder, monkeypatch, number):
    fsync, count = os.fsync, iter(range(10_000))

    def interrupted(file):
        if next(count) == number:
            raise KeyboardInterrupt
        fsync(file)

    monkeypatch.setattr(os, "fsync", interrupted)
    with pytest.raises(KeyboardInterrupt):
        small_rig.take(plan, small_rig.fake_bench(), folder)
    monkeypatch.undo()
    assert not list(folder.glob("**/.*.tmp"))
    for name in on_disk(folder):
        shot = next(shot for shot in plan.shots if shot.name == name)
        read_frame(folder / "frames" / name, shot, plan)
    small_rig.take(plan, small_rig.fake_bench(), folder, resume=True)
    assert on_disk(folder) == [shot.name for shot in plan.shots]


@pytest.fixture
def limited():
    """Files of this process cannot grow beyond a size, as on a full disk."""
    resource = pytest.importorskip("resource")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    yield lambda size: resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_disk_that_is_full_during_a_frame_stops_the_scan_clearly(plan, folder, limited):
    def fill(number):
        if number == 6:
            limited(10_000)  # half a frame

    camera = small_rig.FakeCamera(before=fill)
    with pytest.raises(ScanStopped) as stop:
        small_rig.take(plan, small_rig.fake_bench(camera=camera), folder)
    for words in (f"stopped before frame 6 of {len(plan.shots)}", "is the disk full", "5 frames are safe", "--resume"):
        assert words in str(stop.value)
    limited(-1)
    assert on_disk(folder) == [shot.name for shot in plan.shots[:5]]
    small_rig.take(plan, small_rig.fake_bench(), folder, resume=True)
    assert read_run(folder).sizes["frame"] == len(plan.shots)


def test_a_disk_that_is_full_when_the_journal_is_written_loses_no_frame(plan, folder, limited):
    def fill(number):
        if number == 6:
            (folder / "journal.jsonl").write_bytes((folder / "journal.jsonl").read_bytes() + 80_000 * b" " + b"\n")
            limited(80_000)  # enough for a frame, too little for the journal

    camera = small_rig.FakeCamera(before=fill)
    with pytest.raises(ScanStopped, match=r"journal\.jsonl: could not be written"):
        small_rig.take(plan, small_rig.fake_bench(camera=camera), folder)
    limited(-1)
    assert on_disk(folder) == [shot.name for shot in plan.shots[:6]]
    done = small_rig.take(plan, small_rig.fake_bench(), folder, resume=True)
    assert done.taken == len(plan.shots) - 6
    assert [event["shot"] for event in events(folder, "adopted")] == [6]


def test_a_disk_too_small_for_the_plan_is_refused_before_the_first_frame(plan, folder, monkeypatch):
    usage = shutil.disk_usage(folder.parent)
    monkeypatch.setattr("shutil.disk_usage", lambda path: usage._replace(free=len(plan.shots) * frame_size(plan) - 1))
    monkeypatch.setattr("brdfpipe.store.write_bytes", lambda path, content: path.write_bytes(content))
    camera = small_rig.FakeCamera()
    with pytest.raises(InputError, match="not enough disk space for the missing frames"):
        small_rig.take(plan, small_rig.fake_bench(camera=camera), folder)
    assert camera.exposures == []


def test_a_folder_that_cannot_be_created_is_refused(plan, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"cannot be written \(Not a directory\)"):
        small_rig.take(plan, small_rig.fake_bench(), tmp_path / "file" / "run")


def test_a_device_that_fails_before_the_first_frame_stops_the_scan(plan, folder):
    class Absent(small_rig.FakeWheel):
        def identify(self):
            raise DeviceError("filter wheel", "no answer")

    with pytest.raises(DeviceError, match="no answer"):
        small_rig.take(plan, small_rig.fake_bench(wheel=Absent()), folder)
    assert small_rig.take(plan, small_rig.fake_bench(), folder, resume=True).taken == len(plan.shots)


# --- frames that are bad


class Spoiling:
    """The emulated camera, some of whose frames are replaced before the scan sees them."""

    def __init__(self, camera, spoil):
        self.camera, self.spoil, self.number, self.last = camera, spoil, 0, None

    def identify(self):
        return self.camera.identify()

    def expose(self, seconds, *, shutter=True):
        self.number += 1
        raw = self.camera.expose(seconds, shutter=shutter)
        spoilt = replace(raw, counts=self.spoil(self.number, raw.counts, self.last))
        self.last = spoilt.counts
        return spoilt


def stuck(numbers):
    """A camera that repeats its last frame at these exposures."""
    return lambda number, counts, last: last if number in numbers else counts


def spoilt_scan(plan, folder, spoil, **options):
    with small_rig.emulated(plan, folder=folder if folder.exists() else None) as (rig, camera):
        return small_rig.take_emulated(plan, folder, rig, Spoiling(camera, spoil), **options)


def test_a_bad_frame_is_taken_again(plan, folder):
    done = spoilt_scan(plan, folder, stuck({15}))
    assert (done.retries, done.warnings) == (1, ())
    (event,) = events(folder, "retry")
    assert event["shot"] == 15
    assert "identical to frame 14" in event["problem"]


def test_a_camera_that_stays_stuck_stops_the_scan_with_advice(plan, folder):
    with pytest.raises(ScanStopped, match=r"before frame 15 .*identical to frame 14.*restart both"):
        spoilt_scan(plan, folder, lambda number, counts, last: last if number >= 15 else counts)
    assert len(on_disk(folder)) == 14


def test_the_first_bad_frame_stops_a_scan_that_asks_for_it(plan, folder):
    with pytest.raises(ScanStopped, match="identical"):
        spoilt_scan(replace(plan, bad_frames="stop"), folder, stuck({15}))
    assert events(folder, "retry")[-1]["attempt"] == 1


def test_a_bad_frame_may_be_kept_with_a_warning(plan, folder):
    done = spoilt_scan(replace(plan, bad_frames="warn"), folder, stuck({15}))
    assert len(done.warnings) == 1
    assert "frame 15: identical to frame 14" in done.warnings[0]
    assert [event["check"] for event in events(folder, "noticed")] == ["identical"]


def test_an_arrangement_that_was_not_made_is_rejected_and_taken_again(tmp_path, folder):
    text = small_rig.PLAN.replace("incidences: [20]", "incidences: [20, 45]").replace("exposure: 1,", "exposure: 5,")
    plan = Plan.load(small_rig.write(tmp_path / "two", text))
    with small_rig.emulated(plan) as (rig, camera), connect(rig.rig, camera=camera) as devices:

        def confirm(arrangement, words):
            return arrangement.incidence == 45 or automatic_operator(rig)(arrangement, words)

        with pytest.raises(
            ScanStopped, match=r"picture is that of the sample at 20° .*not changed for the sample at 45°"
        ):
            scan(plan, devices, folder, clock=rig.clock.now, confirm=confirm)
    (rejected,) = events(folder, "rejected")
    assert (rejected["check"], rejected["problem"].split()[:2]) == ("alike", ["the", "picture"])
    kept = tmp_path / "kept"
    shutil.copytree(folder, kept)
    done = spoilt_scan(plan, folder, stuck(()), resume=True)
    assert done.frames == len(on_disk(folder)) == len(plan.shots)
    assert sum("its arrangement was rejected" in warning for warning in done.warnings) == len(rejected["shots"])
    # Accepted frames count for the scan, and for whoever reads the run.
    spoilt_scan(replace(plan, bad_frames="accept"), kept, stuck(()), resume=True)
    assert [event["sha256"] for event in events(kept, "accepted")] == [rejected["sha256"]]
    assert not any("rejected" in text for text in vocabulary.warnings(read_run(kept)))
