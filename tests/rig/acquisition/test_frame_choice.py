"""Frames of a bracket that are not needed: chosen by the last frames of the same cells, without loss of accuracy."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import rig_accuracy as accuracy
import small_rig
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.rig.acquisition import journal
from brdfpipe.rig.acquisition.devices.errors import DeviceLost
from brdfpipe.rig.acquisition.frame_choice import FrameChoice
from brdfpipe.rig.acquisition.run_state import WatchedRun
from brdfpipe.rig.acquisition.scan import ScanStopped
from brdfpipe.rig.frames import read_run
from brdfpipe.rig.plan import Plan, Shot
from brdfpipe.rig.reduction.calibration import calibrate
from brdfpipe.rig.reduction.primary import apply_profile

PLASTIC, NARROW = "plastic, 10 sr⁻¹, 3°", "narrow, 300 sr⁻¹, 1.5°, on metallic 14°"


def left_out(plan: Plan, frames: xr.Dataset) -> list[Shot]:
    """Frames of a whole run that a scan would not have taken."""
    choice, spared = FrameChoice(plan), []
    counts, purpose, exposure = (frames[name].values for name in ("counts", "purpose", "exposure"))
    darks = {at: counts[(purpose == "dark") & (exposure == at)].mean(axis=0) for at in np.unique(exposure)}
    brackets = defaultdict(list)
    for shot, picture in zip(plan.shots, counts, strict=True):
        if shot.step:
            brackets[shot.arrangement, shot.wavelength].append((shot, picture))
    for (arrangement, wavelength), bracket in brackets.items():
        first, taken = choice.before(arrangement, wavelength), set()
        for after in (False, True):
            chosen = choice.after(arrangement, wavelength) - first if after else first
            for shot, picture in bracket:
                if shot.step in chosen:
                    choice.learn(shot, picture, darks[shot.exposure])
                    taken.add(shot.step)
        spared += [shot for shot, _ in bracket if shot.step not in taken]
    return spared


@cache
def plan() -> Plan:
    return accuracy.plan_of((530.0, 540.0, 550.0, 560.0), (10.0, 45.0), 60)


@cache
def frames(truth: str) -> xr.Dataset:
    return accuracy.frames_of(plan(), accuracy.TRUTHS[truth](), seed=3)


def measured(run: xr.Dataset, truth: str) -> accuracy.Measured:
    profile = calibrate(accuracy.reduced(plan(), run, "etalon"), accuracy.certificate())
    primary = apply_profile(accuracy.reduced(plan(), run, "sample"), profile)
    return accuracy.compared(primary, accuracy.TRUTHS[truth]())


def test_the_first_bracket_of_an_arrangement_is_whole_and_the_later_ones_are_not():
    spared = left_out(plan(), frames(PLASTIC))
    first = plan().wavelengths[0]
    assert all(shot.wavelength > first for shot in spared)
    assert {shot.purpose for shot in spared} == {"etalon", "sample"}
    # Two of five frames, at three of four wavelengths.
    brackets = len(plan().wavelengths) * 4
    assert len(spared) >= 0.25 * len(plan().bracket) * brackets


def test_the_frame_that_monitor_readings_repeat_is_kept():
    step, wavelength = plan().drift.step, plan().drift.wavelength
    assert all((shot.step, shot.wavelength) != (step, wavelength) for shot in left_out(plan(), frames(PLASTIC)))


def test_kept_frames_overlap():
    narrow = replace(plan(), bracket=(plan().bracket[0], plan().bracket[-1]))
    assert not FrameChoice(narrow)._overlap(narrow.bracket)
    assert FrameChoice(plan())._overlap(plan().bracket)


def test_a_lobe_that_brightens_is_measured_by_the_frames_that_were_left_out():
    """The prediction is that of a white etalon; the frames themselves then show what is out of range."""
    choice, run = FrameChoice(plan()), dict(zip(plan().shots, frames(NARROW)["counts"].values, strict=True))
    darks = {
        at: np.mean([run[shot] for shot in run if shot.dark and shot.exposure == at], axis=0)
        for at in {shot.exposure for shot in run}
    }
    etalon, sample = (
        [shot for shot in run if shot.purpose == load and shot.arrangement.incidence == 45.0 and shot.wavelength == nm]
        for load, nm in (("etalon", 540.0), ("sample", 550.0))
    )
    arrangement = sample[0].arrangement
    for shot in etalon:
        choice.learn(replace(shot, arrangement=arrangement), run[shot], darks[shot.exposure])
    first = choice.before(arrangement, 550.0)
    in_range = {shot.step: run[shot].max() < plan().rig.camera.linear_to / plan().rig.camera.gain for shot in sample}
    assert not any(in_range[step] for step in first), "the prediction was right"
    for shot in sample:
        if shot.step in first:
            choice.learn(shot, run[shot], darks[shot.exposure])
    assert any(in_range[step] for step in choice.after(arrangement, 550.0))


@pytest.mark.slow
@pytest.mark.parametrize("truth", accuracy.TRUTHS)
def test_fewer_frames_give_the_same_accuracy(truth):
    whole = frames(truth)
    spared = [shot.ordinal for shot in left_out(plan(), whole)]
    part = whole.isel(frame=~np.isin(whole["shot"].values, spared))
    full, fewer = measured(whole, truth), measured(part, truth)
    lights = sum(bool(shot.step) and shot.purpose != "target" for shot in plan().shots)
    print(
        f"{truth}: {len(spared)} of {lights} frames spared, median error {np.median(np.abs(full.error)):.2%} → {np.median(np.abs(fewer.error)):.2%}"
    )
    for share in (50, 95):
        assert np.percentile(np.abs(fewer.error), share) < 1.05 * np.percentile(np.abs(full.error), share) + 5e-4
    assert fewer.error.size > 0.995 * full.error.size
    assert np.sqrt(np.mean(fewer.z**2)) < 1.3


# --- the scan


SMALL = small_rig.PLAN.replace("[500, 550]", "[500, 550, 600]") + "exposures: needed\n"


@pytest.fixture(scope="module")
def taken(tmp_path_factory):
    """A scan of a small rig that leaves frames out, its plan and its folder."""
    folder = tmp_path_factory.mktemp("choice")
    plan = Plan.load(small_rig.write(folder / "bench", SMALL))
    with small_rig.emulated(plan) as (rig, camera):
        done = small_rig.take_emulated(plan, folder / "run", rig, camera)
    return plan, folder / "run", done


def test_a_scan_leaves_frames_out_and_says_so(taken):
    plan, folder, done = taken
    spared = journal.left_out(journal.read(folder / "journal.jsonl"))
    assert spared
    assert done.left_out == len(spared)
    assert done.frames == done.taken == len(plan.shots) - len(spared)
    assert f"{len(spared)} of the plan not needed" in done.text
    present = {path.name for path in (folder / "frames").iterdir()}
    assert present == {shot.name for shot in plan.shots if shot.ordinal not in spared}


def test_frames_that_were_not_needed_are_not_missing(taken):
    _, folder, done = taken
    run = read_run(folder)
    assert run.sizes["frame"] == done.frames
    assert not any("missing" in text for text in vocabulary.warnings(run))
    state = WatchedRun(folder).state()
    assert (state.finished, state.frames, state.seconds_left) == (done.frames, done.frames, 0)


def test_a_resumed_scan_takes_no_frame_that_was_not_needed(taken):
    plan, folder, _ = taken
    with small_rig.emulated(plan, folder=folder) as (rig, camera):
        again = small_rig.take_emulated(plan, folder, rig, camera, resume=True)
    assert again.taken == 0
    assert again.left_out > 0


def test_an_interrupted_scan_is_resumed_with_the_same_choice(taken, tmp_path):
    plan, _, done = taken

    class Lost:
        def __init__(self, camera):
            self.camera, self.left = camera, 17

        def identify(self):
            return self.camera.identify()

        def expose(self, seconds, *, shutter=True):
            self.left -= 1
            if self.left < 0:
                raise DeviceLost("camera", "gone")
            return self.camera.expose(seconds, shutter=shutter)

    with small_rig.emulated(plan) as (rig, camera), pytest.raises(ScanStopped):
        small_rig.take_emulated(plan, tmp_path / "run", rig, Lost(camera))
    with small_rig.emulated(plan, folder=tmp_path / "run") as (rig, camera):
        resumed = small_rig.take_emulated(plan, tmp_path / "run", rig, camera, resume=True)
    assert resumed.frames + resumed.left_out == len(plan.shots)
    assert abs(resumed.frames - done.frames) <= 2


def test_all_frames_are_taken_once_the_plan_asks_for_all(taken, tmp_path):
    import shutil

    plan, folder, done = taken
    shutil.copytree(folder, tmp_path / "run")
    everything = replace(plan, exposures="all")
    with small_rig.emulated(plan, folder=folder) as (rig, camera):
        again = small_rig.take_emulated(everything, tmp_path / "run", rig, camera, resume=True)
    assert again.frames == len(plan.shots)
    assert again.taken == done.left_out
