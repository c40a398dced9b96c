"""A scan of the emulated rig over its ports, whatever the lines do: recovered, or stopped and resumable, and never a wrong label."""

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
"""Faults that no program can recover from: someone must plug the right device in."""


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """A pseudo-terminal holds no bytes back, and nothing here is about power cuts."""
    monkeypatch.setattr(serial_line, "QUIET", 0.02)
    monkeypatch.setattr(serial_line, "POLL", 0.01)
    monkeypatch.setattr(os, "fsync", lambda file: None)


@pytest.fixture(scope="module")
def plans(tmp_path_factory):
    return {
        wheel: Plan.load(small_rig.write(tmp_path_factory.mktemp("bench"), SHORT, wheel=wheel))
        for wheel in ("thorlabs", "acton-wheel")
    }


@pytest.fixture(scope="module")
def undisturbed(plans, tmp_path_factory):
    """By dialect of the wheel: the number of commands of a scan, its frames, and which commands are moves."""
    found = {}
    for wheel, plan in plans.items():
        folder, faults, moves = tmp_path_factory.mktemp("whole"), Faults.at({}), []
        with pytest.MonkeyPatch.context() as patch, small_rig.emulated(plan, faults=faults) as (stand, witness):
            for driver in (acton.Monochromator, acton.FilterWheel, thorlabs.FilterWheel):
                patch.setattr(driver, "goto", noting(driver.goto, moves, faults))
            small_rig.take_emulated(plan, folder / "run", stand, witness)
        agree(plan, folder / "run", witness)
        found[wheel] = faults.commands, small_rig.contents(folder / "run"), moves
    return found


def noting(goto, moves, faults):
    def noted(self, place):
        moves.append(faults.commands + 1)
        return goto(self, place)

    return noted


def agree(plan, folder, *witnesses):
    """Every frame on the disk says where the devices truly were, by the emulator's own log, and none of them moved."""
    for shot in plan.shots:
        path = folder / "frames" / shot.name
        if not path.exists():
            continue
        header = fits.getheader(path)
        assert header["SHOT"] == shot.ordinal
        load = {"tile": "sample"}.get(header["SAMPLEID"], header["SAMPLEID"])
        label = (pytest.approx(header["WAVELEN"], abs=6e-4), header["NDPOS"])
        label += (Arrangement(load, header["SIDE"], header["INCANG"]),)
        # A scan that was resumed repeats times that the one before it has lived through.
        seen = [witness for witness in witnesses if header["STARTED"] in witness.seen]
        assert any(
            witness.seen[header["STARTED"]] == label and header["STARTED"] not in witness.moved for witness in seen
        ), path.name


def disturbed(plan, folder, faults):
    """A scan under faults, and if it stops another one without: whether it stopped, and why."""
    stopped = ""
    with small_rig.emulated(plan, faults=faults) as (stand, first):
        try:
            small_rig.take_emulated(plan, folder, stand, first)
        except (ScanStopped, DeviceError) as stop:
            stopped = str(stop)
    if folder.exists():
        agree(plan, folder, first)
    if stopped:
        with small_rig.emulated(plan, folder=folder) as (stand, second):
            small_rig.take_emulated(plan, folder, stand, second, resume=True)
        agree(plan, folder, first, second)
    assert [path.name for path in sorted((folder / "frames").iterdir())] == [shot.name for shot in plan.shots]
    found = read_run(folder)
    # Nothing is missing; all that is said is that no laboratory took the frames.
    assert [text for text in vocabulary.warnings(found) if "come from the rig emulator" not in text] == []
    assert (found["wavelength_read"] == found["wavelength"]).all()
    return stopped


def check(plan, folder, kind, ordinal, whole):
    faults = Faults.at({ordinal: kind}, seed=ordinal)
    stopped = disturbed(plan, folder, faults)
    if not faults.injected:
        assert kind == "clamp"  # at a command that moves nothing
        assert small_rig.contents(folder) == whole
        return
    assert bool(stopped) == (kind in FATAL), stopped
    if stopped:
        assert stopped.split(":")[0].startswith(("monochromator", "filter wheel", "scan stopped before frame"))
        assert "monochromator" in stopped or "filter wheel" in stopped
        # What stopped it took no time of the rig's, so the run is that of a rig without faults, to the byte.
        assert small_rig.contents(folder) == whole


@pytest.mark.parametrize("wheel", ["thorlabs", "acton-wheel"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_fault_is_recovered_or_stops_the_scan_resumably(plans, undisturbed, tmp_path, kind, wheel):
    """Here at a few commands: as the devices are opened, at a move, near the end; at every one in the slow proof."""
    count, whole, moves = undisturbed[wheel]
    number = KINDS.index(kind)
    for ordinal in moves if kind == "clamp" else (3, moves[number % len(moves)], count - number):
        check(plans[wheel], tmp_path / f"{ordinal}", kind, ordinal, whole)


@pytest.mark.slow
@pytest.mark.parametrize("wheel", ["thorlabs", "acton-wheel"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_fault_at_any_command_is_recovered_or_stops_the_scan_resumably(plans, undisturbed, tmp_path, kind, wheel):
    count, whole, moves = undisturbed[wheel]
    assert len(moves) == 6
    assert count > 70
    for ordinal in range(1, count + 1):
        check(plans[wheel], tmp_path / f"{ordinal}", kind, ordinal, whole)


@pytest.mark.parametrize("seed", range(3))
def test_many_faults_at_once_never_make_a_wrong_label(plans, tmp_path, seed):
    kinds = [kind for kind in KINDS if kind not in FATAL]
    disturbed(plans["thorlabs"], tmp_path / "run", Faults.seeded(seed, 0.1, kinds))


@pytest.mark.slow
@pytest.mark.parametrize("wheel", ["thorlabs", "acton-wheel"])
@pytest.mark.parametrize("seed", range(10, 40))
def test_many_faults_of_all_kinds_at_once_never_make_a_wrong_label(plans, tmp_path, wheel, seed):
    disturbed(plans[wheel], tmp_path / "run", Faults.seeded(seed, 0.05))


@pytest.mark.parametrize("device", ["monochromator", "wheel"])
def test_a_port_held_by_another_program_is_told_and_the_run_goes_on_later(plans, tmp_path, device):
    plan = plans["thorlabs"]
    with small_rig.emulated(plan) as (stand, witness):
        with serial.Serial(getattr(stand.rig, device).port, exclusive=True), pytest.raises(DeviceLost) as refusal:
            small_rig.take_emulated(plan, tmp_path / "run", stand, witness)
        assert "the port is in use by another program" in str(refusal.value)
        assert not (tmp_path / "run").exists()
        small_rig.take_emulated(plan, tmp_path / "run", stand, witness)
    agree(plan, tmp_path / "run", witness)


@pytest.mark.parametrize("moment", [1, 13])
def test_no_other_program_gets_a_port_during_a_scan(plans, undisturbed, tmp_path, moment):
    plan = plans["thorlabs"]
    refused = []

    class Intruder(small_rig.Witness):
        def expose(self, seconds, *, shutter=True):
            if len(self.seen) + 1 == moment:
                for open_device, settings in (
                    (open_monochromator, stand.rig.monochromator),
                    (open_wheel, stand.rig.wheel),
                ):
                    with pytest.raises(DeviceLost, match="the port is in use by another program"):
                        open_device(settings)
                    refused.append(settings.port)
            return super().expose(seconds, shutter=shutter)

    with small_rig.emulated(plan) as (stand, _):
        small_rig.take_emulated(plan, tmp_path / "run", stand, Intruder(stand))
    assert len(refused) == 2
    assert small_rig.contents(tmp_path / "run") == undisturbed["thorlabs"][1]


def test_a_plug_pulled_during_an_exposure_stops_the_scan_resumably(plans, undisturbed, tmp_path):
    plan = plans["thorlabs"]

    class Clumsy(small_rig.Witness):
        def expose(self, seconds, *, shutter=True):
            picture = super().expose(seconds, shutter=shutter)
            if len(self.seen) == 9:
                stand.ports[1].unplug()
            return picture

    with (
        small_rig.emulated(plan) as (stand, _),
        pytest.raises(ScanStopped, match=r"stopped before frame 9 .*filter wheel"),
    ):
        small_rig.take_emulated(plan, tmp_path / "run", stand, Clumsy(stand))
    assert len(small_rig.contents(tmp_path / "run")) == 8
    with small_rig.emulated(plan, folder=tmp_path / "run") as (stand, witness):
        small_rig.take_emulated(plan, tmp_path / "run", stand, witness, resume=True)
    assert small_rig.contents(tmp_path / "run") == undisturbed["thorlabs"][1]


# --- what the frames tell


def scanned(plan, folder, *, truth=None, **options):
    """A scan of a rig that is not quite as its description says, and what was said during it."""
    said = []
    with small_rig.emulated(replace(plan, rig=truth or plan.rig), **options) as (stand, witness):
        done = small_rig.take_emulated(plan, folder, stand, witness, say=said.append)
    assert said == [f"warning: {warning}" for warning in done.warnings]
    return done.warnings


WIDE = TEXT.replace(
    "[{exposure: 1, position: 2}, {exposure: 1, position: 1}]",
    "[{exposure: 3, position: 2}, {exposure: 3, position: 1}]",
)


@pytest.mark.parametrize(("said", "true"), [("sample", "reference"), ("reference", "sample")])
def test_a_wrong_place_of_the_filters_is_detected_and_named_during_the_scan(tmp_path, said, true):
    path = small_rig.write(tmp_path / "bench", WIDE)
    rig = path.with_name("rig.yaml")
    rig.write_text(rig.read_text().replace("nd_location: sample", f"nd_location: {said}"))
    plan = Plan.load(path)
    (warning,) = scanned(plan, tmp_path / "run", truth=replace(Rig.load(rig), nd_location=true))
    assert f"wrong `nd_location: {said}`" in warning
    assert f"indicate `nd_location: {true}`" in warning
    (event,) = [event for event in journal.read(tmp_path / "run" / "journal.jsonl") if event["event"] == "overlap"]
    assert (event["nd_location"], event["warnings"]) == (true, [warning])
    # Told as soon as a bracket is complete, long before the run is.
    taken = [each["event"] for each in journal.read(tmp_path / "run" / "journal.jsonl")]
    assert taken[: taken.index("overlap")].count("frame") == 5 + 1 + 2


def test_filters_in_the_right_place_are_in_order(tmp_path):
    assert scanned(Plan.load(small_rig.write(tmp_path / "bench", WIDE)), tmp_path / "run") == ()
    (event,) = [event for event in journal.read(tmp_path / "run" / "journal.jsonl") if event["event"] == "overlap"]
    assert event["nd_location"] == "sample"


def test_a_lamp_that_warms_up_is_told_with_what_to_do(tmp_path):
    text = TEXT.replace("drift: {every: 100}", "drift: {every: 2, tolerance: 0.02}")
    plan = Plan.load(small_rig.write(tmp_path / "bench", text))
    warnings = scanned(plan, tmp_path / "run", effects=replace(Effects(), warm_up=0.5, drift=0.0))
    assert warnings
    assert all("let the lamp warm up" in warning for warning in warnings)
    told = [event["warning"] for event in journal.read(tmp_path / "run" / "journal.jsonl") if event["event"] == "drift"]
    assert told == list(warnings)


def test_a_steady_lamp_is_not_warned_of(tmp_path):
    text = TEXT.replace("drift: {every: 100}", "drift: {every: 2}")
    plan = Plan.load(small_rig.write(tmp_path / "bench", text))
    assert scanned(plan, tmp_path / "run", effects=replace(Effects(), warm_up=0.0, drift=0.0)) == ()
