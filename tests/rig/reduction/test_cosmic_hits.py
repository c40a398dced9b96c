"""Cosmic hits are found and removed; the picture of a lens is left alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import rig_accuracy as accuracy
import rig_emulated

from brdfpipe.rig.emulator.effects import Effects
from brdfpipe.rig.reduction import cosmic_hits
from brdfpipe.rig.reduction.brackets import DarkFrames, read_bracket
from brdfpipe.rig.reduction.calibration import calibrate
from brdfpipe.rig.reduction.primary import apply_profile
from brdfpipe.rig.reduction.relative_light import reduce


def test_a_hit_takes_the_median_of_its_neighbours():
    light = np.full((20, 20), 50.0, dtype=np.float32)
    light[7, 9] = light[0, 0] = 5000
    assert cosmic_hits.replace_peaks(light, 400.0) == 2
    assert (light == 50).all()


def test_a_track_is_removed_from_its_brightest_pixel_on():
    light = np.zeros((20, 20), dtype=np.float32)
    light[7, 9], light[8, 10], light[9, 11] = 5000, 2000, 900
    assert cosmic_hits.replace_peaks(light, 400.0) == 3
    assert (light == 0).all()


def test_a_track_of_even_pixels_is_revealed_by_the_other_frames_of_the_bracket():
    k = np.array([1.0, 10.0, 50.0])
    light = np.broadcast_to(100 * k[:, None, None], (3, 12, 12)).astype(np.float32).copy()
    light[2, 5, 4:7] += 4000
    usable = np.ones(light.shape, dtype=bool)
    hits = cosmic_hits.contradicted(light, usable, k, np.full(3, 400.0))
    assert hits[2, 5, 4:7].all()
    assert hits.sum() == 3


def test_pictures_of_the_rig_have_no_hits():
    frames = rig_emulated.frames()
    lit = frames["counts"].values[(frames["purpose"].values != "dark") & (frames["exposure"].values == 10.0)]
    dark = (
        frames["counts"].values[(frames["purpose"].values == "dark") & (frames["exposure"].values == 10.0)].mean(axis=0)
    )
    hot = dark > np.median(dark) + 20
    for counts in lit:
        assert cosmic_hits.replace_peaks(np.float32(3) * (counts - dark).astype(np.float32), 430.0, hot) == 0


def test_a_hundred_and_fifty_hits_in_each_frame_change_the_reduced_light_by_less_than_two_percent():
    plan = rig_emulated.plan()
    hit = accuracy.frames_of(
        plan, accuracy.TRUTHS["plastic, 10 sr⁻¹, 3°"](), seed=1, effects=replace(Effects(), cosmic=150.0)
    )
    clean, disturbed = (
        reduce(frames, plan.rig, incidence=30.0, override=True) for frames in (rig_emulated.frames(), hit)
    )
    change = (disturbed["signal"] / clean["signal"] - 1).values
    u = (np.hypot(clean["signal_u_noise"], clean["signal_u_repeat"]) / np.abs(clean["signal"])).values
    bright = u < 0.02
    # 4.1 % were the 95th percentile without the removal.
    assert np.percentile(np.abs(change)[bright], 95) < 0.02
    # Hits within the reference spot change all cells alike; beside that, two noises differ by √2 of one.
    own = change - np.median(change, axis=-1, keepdims=True)
    assert np.sqrt(np.mean((own / u)[bright] ** 2)) < 2


def test_spots_as_sharp_as_a_hit_keep_their_light():
    frames, rig = rig_emulated.frames(), rig_emulated.plan().rig
    some = frames.isel(frame=np.flatnonzero(frames["purpose"].values == "sample")[:1]).copy(deep=True)
    some["counts"].values[0, 5, 5] += 2000
    darks = DarkFrames.of(frames, rig)
    small = replace(rig, screen=replace(rig.screen, fibre_radius=1.4 / rig.screen.scale))
    assert read_bracket(some, darks, rig).cosmic_hits == 1
    kept = read_bracket(some, darks, small)
    assert kept.cosmic_hits == 0
    assert kept.light[0, 5, 5] > 1000


@pytest.mark.slow
def test_a_hundred_and_fifty_hits_in_each_frame_hardly_change_the_result():
    plan, truth = rig_emulated.plan(), accuracy.TRUTHS["plastic, 10 sr⁻¹, 3°"]()

    def errors(hits: float) -> np.ndarray:
        frames = accuracy.frames_of(plan, truth, seed=1, effects=replace(Effects(), cosmic=hits))
        profile = calibrate(accuracy.reduced(plan, frames, "etalon"), accuracy.certificate())
        return np.abs(accuracy.compared(apply_profile(accuracy.reduced(plan, frames, "sample"), profile), truth).error)

    without, hit = errors(0.0), errors(150.0)
    assert np.percentile(hit, 95) < 1.25 * np.percentile(without, 95)
    assert np.percentile(hit, 50) < 1.25 * np.percentile(without, 50)
