"""Scans of the emulated rig over serial lines with faults: recovered, or stopped and resumable, and never a wrong label."""

from __future__ import annotations

import os
from dataclasses import replace

import pytest
import serial
import small_rig
from astropy.io import fits

from brdfpipe import vocabulary
from brdfpipe.rig.acquisition import journal
from brdfpipe.rig.acquisition.devices import acton, serial_line, thorlabs
from brdfpipe.rig.acquisition.devices.connection import open_monochromator, open_wheel
from brdfpipe.rig.acquisition.devices.errors import DeviceError, DeviceLost
from brdfpipe.rig.acquisition.scan import ScanStopped
from brdfpipe.rig.description import Rig
from brdfpipe.rig.emulator.effects import Effects
from brdfpipe.rig.emulator.faults import KINDS, Faults
from brdfpipe.rig.frames import read_run
from brdfpipe.rig.plan import Arrangement, Plan

TEXT = small_rig.PLAN.replace("drift: {every: 4}", "drift: {every: 100}")

# One arrangement; the monochromator moves twice, and so does the wheel.
SHORT = TEXT.replace("[500, 550]", "[500]").replace("drift: {", "runs: [sample]\ndrift: {wavelength: 550, ")

FATAL = ("unplug", "wrong-device")
"""Faults that no program can recover from: someone must connect the right device."""

TIMEOUT = 0.4
"""Seconds to wait for a reply. A fault costs as much; a device that takes longer three times running stops the scan."""

WHEELS = ("thorlabs", "acton-wheel")


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """A pseudo-terminal holds no bytes back, and no test here is about power failures."""
    monkeypatch.setattr(serial_line, "QUIET", 0.02)
    monkeypatch.setattr(serial_line, "POLL", 0.01)
    monkeypatch.setattr(os, "fsync", lambda file: None)


@pytest.fixture(scope="module")
def plans(tmp_path_factory):
    return {
        wheel: Plan.load(small_rig.write(tmp_path_factory.mktemp("bench"), SHORT, wheel=wheel, timeout=TIMEOUT))
        for wheel in WHEELS
    }


@pytest.fixture(scope="module")
def undisturbed(plans, tmp_path_factory):
    """By dialect of the wheel: the number of commands of a scan, its frames, and the numbers of the commands that move a device."""
    scans = {}
    for wheel, plan in plans.items():
        folder, faults, moves = tmp_path_factory.mktemp("undisturbed"), Faults.at({}), []
        with pytest.MonkeyPatch.context() as patch, small_rig.emulated(plan, faults=faults) as (rig, camera):
            for driver in (acton.Monochromator, acton.FilterWheel, thorlabs.FilterWheel):
                patch.setattr(driver, "goto", recording(driver.goto, moves, faults))
            small_rig.take_emulated(plan, folder / "run", rig, camera)
        check_labels(plan, folder / "run", camera)
        scans[wheel] = faults.commands, small_rig.contents(folder / "run"), moves
    return scans


def recording(goto, moves, faults):
    def recorded(self, target):
        moves.append(faults.commands + 1)
        return goto(self, target)

    return recorded


def check_labels(plan, folder, *cameras):
    """Every frame on disk has the true state of the devices during its exposure, and no device moved."""
    for shot in plan.shots:
        path = folder / "frames" / shot.name
        if not path.exists():
            continue
        header = fits.getheader(path)
        assert header["SHOT"] == shot.ordinal
        load = {"tile": "sample"}.get(header["SAMPLEID"], header["SAMPLEID"])
        label = (pytest.approx(header["WAVELEN"], abs=6e-4), header["NDPOS"])
        label += (Arrangement(load, header["SIDE"], header["INCANG"]),)
        # A resumed scan repeats times of the scan before it.
        started = header["STARTED"]
        assert any(camera.states.get(started) == label and started not in camera.moved for camera in cameras), path.name


def disturbed(plan, folder, faults):
    """A scan under faults, resumed without faults if it stops; why it stopped, or empty."""
    stopped = ""
    with small_rig.emulated(plan, faults=faults) as (rig, first):
        try:
            small_rig.take_emulated(plan, folder, rig, first)
        except (ScanStopped, DeviceError) as stop:
            stopped = str(stop)
    if folder.exists():
        check_labels(plan, folder, first)
    if stopped:
        with small_rig.emulated(plan, folder=folder) as (rig, second):
            small_rig.take_emulated(plan, folder, rig, second, resume=True)
        check_labels(plan, folder, first, second)
    assert [path.name for path in sorted((folder / "frames").iterdir())] == [shot.name for shot in plan.shots]
    frames = read_run(folder)
    # No frame is missing; the only warning is that the frames come from the emulator.
    assert [text for text in vocabulary.warnings(frames) if "come from the rig emulator" not in text] == []
    assert (frames["wavelength_read"] == frames["wavelength"]).all()
    return stopped


def check(plan, folder, kind, ordinals, undisturbed_frames):
    """Faults of one kind at some commands of a scan."""
    faults = Faults.at(dict.fromkeys(ordinals, kind), seed=ordinals[0])
    stopped = disturbed(plan, folder, faults)
    if not faults.injected:
        assert kind == "clamp"  # at a command that does not move
        assert small_rig.contents(folder) == undisturbed_frames
        return
    assert len(faults.injected) == (1 if kind in FATAL else len(ordinals))
    assert bool(stopped) == (kind in FATAL), stopped
    if stopped:
        assert stopped.split(":")[0].startswith(("monochromator", "filter wheel", "scan stopped before frame"))
        assert "monochromator" in stopped or "filter wheel" in stopped
        # The fault took no virtual time, so the frames equal those without faults, byte for byte.
        assert small_rig.contents(folder) == undisturbed_frames


@pytest.mark.cases(6)
@pytest.mark.parametrize("wheel", WHEELS)
@pytest.mark.parametrize("kind", KINDS)
def test_a_fault_is_recovered_or_stops_the_scan_resumably(plans, undisturbed, tmp_path, kind, wheel):
    """At a few commands: while the devices are opened, at a move, near the end. The slow test takes every command."""
    count, undisturbed_frames, moves = undisturbed[wheel]
    number = KINDS.index(kind)
    ordinals = moves if kind == "clamp" else (3, moves[number % len(moves)], count - number)
    # A fatal fault ends its scan. After a clamp the numbers of later moves change. Other faults come in one scan.
    groups = [[ordinal] for ordinal in ordinals] if kind in (*FATAL, "clamp") else [ordinals]
    for group in groups:
        check(plans[wheel], tmp_path / f"{group[0]}", kind, group, undisturbed_frames)


@pytest.mark.slow
@pytest.mark.parametrize("wheel", WHEELS)
@pytest.mark.parametrize("kind", KINDS)
def test_a_fault_at_any_command_is_recovered_or_stops_the_scan_resumably(plans, undisturbed, tmp_path, kind, wheel):
    count, undisturbed_frames, moves = undisturbed[wheel]
    assert len(moves) == 6
    assert count > 70
    for ordinal in range(1, count + 1):
        check(plans[wheel], tmp_path / f"{ordinal}", kind, [ordinal], undisturbed_frames)


@pytest.mark.cases(1)
@pytest.mark.parametrize("seed", range(3))
def test_many_faults_at_once_never_make_a_wrong_label(plans, tmp_path, seed):
    kinds = [kind for kind in KINDS if kind not in FATAL]
    disturbed(plans["thorlabs"], tmp_path / "run", Faults.seeded(seed, 0.1, kinds))


@pytest.mark.slow
@pytest.mark.parametrize("wheel", WHEELS)
@pytest.mark.parametrize("seed", range(10, 40))
def test_many_faults_of_all_kinds_at_once_never_make_a_wrong_label(plans, tmp_path, wheel, seed):
    disturbed(plans[wheel], tmp_path / "run", Faults.seeded(seed, 0.05))


@pytest.mark.parametrize("device", ["monochromator", "wheel"])
def test_a_port_used_by_another_program_is_refused_and_the_run_can_start_later(plans, tmp_path, device):
    plan = plans["thorlabs"]
    with small_rig.emulated(plan) as (rig, camera):
        with serial.Serial(getattr(rig.rig, device).port, exclusive=True), pytest.raises(DeviceLost) as refusal:
            small_rig.take_emulated(plan, tmp_path / "run", rig, camera)
        assert "the port is in use by another program" in str(refusal.value)
        assert not (tmp_path / "run").exists()
        small_rig.take_emulated(plan, tmp_path / "run", rig, camera)
    check_labels(plan, tmp_path / "run", camera)


def test_no_other_program_can_open_a_port_during_a_scan(plans, undisturbed, tmp_path):
    plan = plans["thorlabs"]
    refused = []

    class Intruder(small_rig.RecordingCamera):
        def expose(self, seconds, *, shutter=True):
            if len(self.states) + 1 in (1, 13):
                settings = self.rig.rig
                devices = [(open_monochromator, settings.monochromator), (open_wheel, settings.wheel)]
                for open_device, device in devices:
                    with pytest.raises(DeviceLost, match="the port is in use by another program"):
                        open_device(device)
                    refused.append(device.port)
            return super().expose(seconds, shutter=shutter)

    with small_rig.emulated(plan) as (rig, _):
        small_rig.take_emulated(plan, tmp_path / "run", rig, Intruder(rig))
    assert len(refused) == 4
    assert small_rig.contents(tmp_path / "run") == undisturbed["thorlabs"][1]


def test_a_device_disconnected_during_an_exposure_stops_the_scan_resumably(plans, undisturbed, tmp_path):
    plan = plans["thorlabs"]

    class Disconnecting(small_rig.RecordingCamera):
        def expose(self, seconds, *, shutter=True):
            raw = super().expose(seconds, shutter=shutter)
            if len(self.states) == 9:
                self.rig.ports[1].unplug()
            return raw

    with (
        small_rig.emulated(plan) as (rig, _),
        pytest.raises(ScanStopped, match=r"stopped before frame 9 .*filter wheel"),
    ):
        small_rig.take_emulated(plan, tmp_path / "run", rig, Disconnecting(rig))
    assert len(small_rig.contents(tmp_path / "run")) == 8
    with small_rig.emulated(plan, folder=tmp_path / "run") as (rig, camera):
        small_rig.take_emulated(plan, tmp_path / "run", rig, camera, resume=True)
    assert small_rig.contents(tmp_path / "run") == undisturbed["thorlabs"][1]


# --- warnings derived from the frames


def scanned(plan, folder, *, truth=None, **options):
    """Warnings of a scan of a rig that may differ from its description."""
    lines = []
    with small_rig.emulated(replace(plan, rig=truth or plan.rig), **options) as (rig, camera):
        summary = small_rig.take_emulated(plan, folder, rig, camera, on_warning=lines.append)
    assert lines == [f"warning: {warning}" for warning in summary.warnings]
    return summary.warnings


def events(folder):
    return journal.read(folder / "journal.jsonl")


WIDE = TEXT.replace(
    "[{exposure: 1, position: 2}, {exposure: 1, position: 1}]",
    "[{exposure: 3, position: 2}, {exposure: 3, position: 1}]",
)


@pytest.mark.parametrize(("described", "true"), [("sample", "reference"), ("reference", "sample")])
def test_a_wrong_location_of_the_filters_is_detected_during_the_scan(tmp_path, described, true):
    path = small_rig.write(tmp_path / "bench", WIDE)
    rig = path.with_name("rig.yaml")
    rig.write_text(rig.read_text().replace("nd_location: sample", f"nd_location: {described}"))
    plan = Plan.load(path)
    (warning,) = scanned(plan, tmp_path / "run", truth=replace(Rig.load(rig), nd_location=true))
    assert f"wrong `nd_location: {described}`" in warning
    assert f"indicate `nd_location: {true}`" in warning
    (event,) = [event for event in events(tmp_path / "run") if event["event"] == "overlap"]
    assert (event["nd_location"], event["warnings"]) == (true, [warning])
    # As soon as a bracket is complete, long before the run is.
    names = [event["event"] for event in events(tmp_path / "run")]
    assert names[: names.index("overlap")].count("frame") == 5 + 1 + 2


def test_a_right_location_of_the_filters_gives_no_warning(tmp_path):
    assert scanned(Plan.load(small_rig.write(tmp_path / "bench", WIDE)), tmp_path / "run") == ()
    (event,) = [event for event in events(tmp_path / "run") if event["event"] == "overlap"]
    assert event["nd_location"] == "sample"


def test_a_lamp_that_warms_up_gives_a_warning_with_advice(tmp_path):
    text = TEXT.replace("drift: {every: 100}", "drift: {every: 2, tolerance: 0.02}")
    plan = Plan.load(small_rig.write(tmp_path / "bench", text))
    warnings = scanned(plan, tmp_path / "run", effects=replace(Effects(), warm_up=0.5, drift=0.0))
    assert warnings
    assert all("let the lamp warm up" in warning for warning in warnings)
    assert [event["warning"] for event in events(tmp_path / "run") if event["event"] == "drift"] == list(warnings)


def test_a_steady_lamp_gives_no_warning(tmp_path):
    text = TEXT.replace("drift: {every: 100}", "drift: {every: 2}")
    plan = Plan.load(small_rig.write(tmp_path / "bench", text))
    assert scanned(plan, tmp_path / "run", effects=replace(Effects(), warm_up=0.0, drift=0.0)) == ()
