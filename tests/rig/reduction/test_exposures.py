"""Darks, masks, electrons, and the merge of a bracket."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from brdfpipe.rig.description import CameraSettings
from brdfpipe.rig.reduction import exposures

CAMERA = CameraSettings("emulated", width=40, height=30)
SHAPE = (30, 40)


def darks(random, count=5, noise=7.0, shape=SHAPE, hot=()):
    mean = np.full(shape, 100.0)
    for place in hot:
        mean[place] += 300
    frames = np.rint(mean + noise * random.standard_normal((count, *shape)))
    return exposures.mean_dark(frames.astype(np.uint16), CAMERA)


# --- dark frames


def test_the_noise_of_a_dark_frame_is_that_of_its_ordinary_pixels():
    dark = darks(np.random.default_rng(0), count=5, noise=7.0, shape=(200, 200), hot=[(3, 4), (9, 9)])
    assert dark.variance == pytest.approx(7.0**2 + 1 / 12, rel=0.03)
    assert dark.floor == pytest.approx(dark.variance * 1.2)
    assert dark.mean.mean() == pytest.approx(100, abs=0.1)


@settings(max_examples=30, deadline=None)
@given(st.integers(2, 12), st.integers(0, 50))
def test_the_noise_is_unbiased_however_few_the_frames(count, seed):
    dark = darks(np.random.default_rng(seed), count=count, noise=10.0, shape=(120, 120))
    assert dark.variance == pytest.approx(100 + 1 / 12, rel=0.15)


def test_a_single_dark_frame_has_the_read_noise_of_the_description():
    dark = darks(np.random.default_rng(0), count=1)
    assert dark.variance == pytest.approx((CAMERA.read_noise / CAMERA.gain) ** 2 + 1 / 12)
    assert dark.floor == pytest.approx(2 * dark.variance)


def test_a_camera_without_noise_still_rounds():
    assert darks(np.random.default_rng(0), noise=0.0).variance == pytest.approx(1 / 12)


def test_hot_pixels_are_found_and_no_others():
    hot = [(3, 4), (3, 5), (20, 39), (0, 0)]
    dark = darks(np.random.default_rng(1), hot=hot)
    assert sorted(zip(*np.nonzero(dark.hot), strict=True)) == sorted(hot)


# --- electrons and masks


def test_electrons_are_counts_above_the_dark_times_the_gain():
    flat = exposures.MeanDark(np.full(SHAPE, 100, dtype=np.float32), 50.0, np.zeros(SHAPE, dtype=bool), 5)
    light, usable = exposures.subtract_dark(np.full(SHAPE, 350, dtype=np.uint16), flat, CAMERA)
    assert (light == 750).all()
    assert usable.all()


def test_pixels_beyond_the_linear_range_are_left_out_with_their_neighbours():
    flat = exposures.MeanDark(np.full(SHAPE, 100, dtype=np.float32), 50.0, np.zeros(SHAPE, dtype=bool), 5)
    counts = np.full(SHAPE, 200, dtype=np.uint16)
    counts[10, 10] = 100 + round(25000 / 3) + 1
    counts[0, 0] = CAMERA.full
    _, usable = exposures.subtract_dark(counts, flat, CAMERA)
    out = np.zeros(SHAPE, dtype=bool)
    out[9:12, 9:12] = out[:2, :2] = True
    assert (usable == ~out).all()


def test_a_hot_pixel_takes_the_mean_of_its_ordinary_neighbours():
    hot = np.zeros(SHAPE, dtype=bool)
    hot[5, 5] = hot[5, 6] = hot[0, 0] = True
    light = np.arange(1200, dtype=np.float32).reshape(1, *SHAPE).copy()
    light[:, hot] = 1e6
    exposures.HotPixels(hot).interpolate(light)
    near = [(4, 4), (4, 5), (4, 6), (5, 4), (6, 4), (6, 5), (6, 6)]
    assert light[0, 5, 5] == pytest.approx(np.mean([40 * y + x for y, x in near]))
    assert light[0, 0, 0] == pytest.approx((1 + 40 + 41) / 3)


def test_a_hot_pixel_among_hot_ones_becomes_0_and_pictures_without_hot_pixels_stay():
    light = np.ones((2, *SHAPE), dtype=np.float32)
    exposures.HotPixels(np.ones(SHAPE, dtype=bool)).interpolate(light)
    assert (light == 0).all()
    light = np.ones((2, *SHAPE), dtype=np.float32)
    exposures.HotPixels(np.zeros(SHAPE, dtype=bool)).interpolate(light)
    assert (light == 1).all()


# --- the merge


def frames(random, q, k, floor):
    """Electrons of a bracket of a scene q."""
    k = np.asarray(k, dtype=float)
    light = random.poisson(q * k[:, None, None]) + np.sqrt(floor) * random.standard_normal((k.size, *q.shape))
    return light.astype(np.float32), np.ones(light.shape, dtype=bool), k, np.full(k.size, float(floor))


@settings(max_examples=10, deadline=None)
@given(st.floats(0.0, 3.0), st.floats(1.0, 400.0), st.integers(0, 1000))
def test_the_merge_of_faint_light_is_unbiased(electrons, floor, seed):
    """The mean of many pixels of a few electrons in the longest frame is right within its uncertainty."""
    scene = np.full((300, 300), electrons)
    merged = exposures.merge(*frames(np.random.default_rng(seed), scene, [0.01, 0.1, 1.0], floor))
    error = float(merged.light.mean(dtype=float)) - electrons
    assert abs(error) < 4.5 * np.sqrt((electrons + floor) / scene.size)
    assert (merged.light < 0).any() or floor < 2


@settings(max_examples=10, deadline=None)
@given(st.floats(1.0, 1e4), st.integers(0, 1000))
def test_the_stated_noise_is_that_of_the_merge(electrons, seed):
    scene = np.full((200, 200), electrons)
    merged = exposures.merge(*frames(np.random.default_rng(seed), scene, [0.1, 1.0, 3.0], 400.0))
    assert np.var(merged.light.astype(float)) == pytest.approx(merged.variance.mean(dtype=float), rel=0.05)
    # As small as with the weights of the true light.
    best = 1 / sum(k * k / (electrons * k + 400.0) for k in (0.1, 1.0, 3.0))
    assert merged.variance.mean(dtype=float) == pytest.approx(best, rel=0.03)


def test_frames_out_of_range_do_not_count():
    light, usable, k, floor = frames(np.random.default_rng(0), np.full(SHAPE, 1e4), [0.1, 1.0, 5.0], 400.0)
    light[2], usable[2] = 25000.0, False
    merged = exposures.merge(light, usable, k, floor)
    two = exposures.merge(light[:2], usable[:2], k[:2], floor[:2])
    assert merged.light == pytest.approx(two.light)
    assert (merged.shares[2] == 0).all()
    assert merged.shares.sum(axis=0) == pytest.approx(np.ones(SHAPE))
    assert not merged.saturated.any()


def test_a_pixel_out_of_range_in_every_frame_is_missing():
    light, usable, k, floor = frames(np.random.default_rng(0), np.full(SHAPE, 10.0), [1.0, 5.0], 400.0)
    usable[:, 4, 4] = False
    merged = exposures.merge(light, usable, k, floor)
    assert merged.saturated.sum() == 1
    assert merged.saturated[4, 4]
    assert np.isnan(merged.light[4, 4])
    assert np.isnan(merged.variance[4, 4])
    assert np.isfinite(np.delete(merged.light.ravel(), 4 * 40 + 4)).all()
    assert (merged.shares[:, 4, 4] == 0).all()


def test_negative_light_stays_negative():
    light = np.full((2, *SHAPE), -5.0, dtype=np.float32)
    merged = exposures.merge(light, np.ones(light.shape, dtype=bool), np.array([1.0, 2.0]), np.array([400.0, 400.0]))
    assert (merged.light < 0).all()


def test_a_common_factor_of_all_scales_divides_the_result():
    light, usable, k, floor = frames(np.random.default_rng(2), np.full(SHAPE, 100.0), [0.5, 2.0], 400.0)
    one, other = (exposures.merge(light, usable, factor * k, floor) for factor in (1.0, 8.0))
    assert other.light == pytest.approx(one.light / 8, rel=1e-6)
    assert other.variance == pytest.approx(one.variance / 64, rel=1e-6)
