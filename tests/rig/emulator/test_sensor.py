"""The sensor of the emulated rig: each effect against its size, over the pixels of a frame."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from brdfpipe.rig.description import CameraSettings
from brdfpipe.rig.emulator.effects import Effects, random_stream
from brdfpipe.rig.emulator.sensor import ROOM_TEMPERATURE, Sensor, compressed, hot_pixels

IDEAL = Effects.none()
CAMERA = CameraSettings("emulated")
SHAPE = (CAMERA.height, CAMERA.width)


def frame(electrons, effects=IDEAL, *, seconds=0.0, temperature=ROOM_TEMPERATURE, seed=0, number=0, camera=CAMERA):
    sensor = Sensor(camera, effects, seed)
    light = np.broadcast_to(np.asarray(electrons, dtype=float), SHAPE)
    return sensor.read(sensor.expected(light, seconds, temperature), random_stream(seed, "frame", number))


def test_an_ideal_sensor_counts_a_third_of_the_electrons():
    light = np.linspace(0, 196_000, CAMERA.height * CAMERA.width).reshape(SHAPE)
    assert np.array_equal(frame(light), np.rint(light / 3).astype(np.uint16))


def test_photons_come_by_chance():
    # Standard error of a variance of 76 800 numbers: 0.5 %. Rounding adds 9/12 electrons².
    light = 3.0 * frame(5000.0, dataclasses.replace(IDEAL, photon_noise=True))
    assert light.mean() == pytest.approx(5000, rel=2e-4)
    assert light.var() == pytest.approx(5000 + 0.75, rel=0.025)


def test_reading_adds_twenty_electrons_about_the_bias():
    counts = frame(0.0, dataclasses.replace(IDEAL, read_noise=20, bias=100))
    assert counts.mean() == pytest.approx(100, abs=0.15)
    assert (3.0 * counts).std() == pytest.approx(np.hypot(20, np.sqrt(0.75)), rel=0.013)


def test_the_response_of_pixels_varies_by_one_percent_and_is_reproducible():
    effects = dataclasses.replace(IDEAL, response=0.01)
    first, later = frame(20_000.0, effects) / 1.0, frame(20_000.0, effects, number=7) / 1.0
    assert first.std() / first.mean() == pytest.approx(0.01, rel=0.013)
    assert np.array_equal(first, later)
    assert not np.array_equal(first, frame(20_000.0, effects, seed=1))


def test_three_pixels_in_a_thousand_are_hot_and_stay():
    relative = hot_pixels(SHAPE, Effects(), 3)
    assert (relative > 1).sum() == round(0.003 * relative.size)
    assert relative[relative > 1].min() >= 100
    assert np.array_equal(relative, hot_pixels(SHAPE, Effects(), 3))
    assert not np.array_equal(relative, hot_pixels(SHAPE, Effects(), 4))


def test_the_dark_current_doubles_every_seven_degrees_and_grows_with_time():
    effects = dataclasses.replace(IDEAL, dark=30.0)
    assert (frame(0.0, effects, seconds=10) == 100).all()
    assert (frame(0.0, effects, seconds=20) == 200).all()
    assert (frame(0.0, effects, seconds=10, temperature=ROOM_TEMPERATURE + 7) == 200).all()


def test_the_sensor_warms_by_its_figure():
    sensor = Sensor(CAMERA, dataclasses.replace(IDEAL, warming=2.0), 0)
    assert sensor.temperature(0) == ROOM_TEMPERATURE
    assert ROOM_TEMPERATURE + 1.2 < sensor.temperature(3000) < ROOM_TEMPERATURE + 1.3
    assert sensor.temperature(1e6) == ROOM_TEMPERATURE + 2


@given(st.floats(0, 1e6), st.floats(1, 1e5))
def test_compression_begins_beyond_the_linear_range_and_never_turns(electrons, step):
    low, high = compressed(np.array([electrons, electrons + step]), 25_000, 75e3)
    assert low < high <= electrons + step
    if electrons <= 25_000:
        assert low == electrons


def test_compression_begins_gently():
    # Second order in what is beyond: 1 % of 1500 electrons beyond the linear range, at c = 75 000.
    beyond = compressed(np.array([26_500.0]), 25_000, 75e3)[0] - 25_000
    assert beyond == pytest.approx(1500 * (1 - 1500 / 150e3), rel=2e-4)
    assert compressed(np.array([1e5]), 25_000, 75e3)[0] == pytest.approx(25e3 + 75e3 * np.log(2))


def test_counts_end_at_the_largest():
    assert (frame(1e9) == 65_535).all()
    assert (frame(1e9, camera=dataclasses.replace(CAMERA, bits=12)) == 4095).all()
    assert (frame(0.0, dataclasses.replace(IDEAL, read_noise=20)) == 0).any()


def test_one_frame_holds_fifty_to_one_at_a_signal_to_noise_ratio_of_fifty():
    # Nine pixels of 500 electrons, 1/50 of the linear range, with 20 electrons of read noise: 4500 / √(4500 + 9 · 20²) = 50.
    cells = 3.0 * frame(500.0, dataclasses.replace(IDEAL, photon_noise=True, read_noise=20, bias=100)) - 300
    sums = cells[:, :318].reshape(80, 3, 106, 3).sum(axis=(1, 3))
    assert sums.mean() / sums.std() == pytest.approx(50, rel=0.04)
    assert CAMERA.linear_to / 500 == 50


def test_a_frame_depends_on_its_seed_and_number_alone():
    first = frame(800.0, Effects(), seconds=2, number=4)
    assert first.dtype == np.uint16
    assert first.tobytes() == frame(800.0, Effects(), seconds=2, number=4).tobytes()
    assert first.tobytes() != frame(800.0, Effects(), seconds=2, number=5).tobytes()
    assert first.tobytes() != frame(800.0, Effects(), seconds=2, number=4, seed=1).tobytes()
