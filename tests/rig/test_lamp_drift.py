"""Lamp drift from the reference spot."""

from __future__ import annotations

import numpy as np
import pytest
import small_rig

from brdfpipe.rig.lamp_drift import LampReading, drift_warnings, reference_signal
from brdfpipe.rig.plan import Plan
from brdfpipe.rig.screen import spot_masks

DARK = 100


@pytest.fixture
def plan(tmp_path):
    return Plan.load(small_rig.write(tmp_path))


def test_the_reference_signal_is_its_electrons(plan):
    reference, _ = spot_masks(plan.rig)
    counts = (DARK + 7 * reference).astype(np.uint16)
    dark = np.full(counts.shape, float(DARK))
    assert reference_signal(counts, dark, plan.rig) == pytest.approx(7 * 3 * reference.sum())


def test_a_reference_beyond_the_linear_range_has_no_signal(plan):
    reference, _ = spot_masks(plan.rig)
    counts = np.where(reference, 60_000, DARK).astype(np.uint16)
    assert np.isnan(reference_signal(counts, np.zeros(counts.shape), plan.rig))


def lamp_readings(*signals):
    return [LampReading(10 * number, 600.0 * number, signal) for number, signal in enumerate(signals)]


def test_a_steady_lamp_gives_no_warning():
    assert drift_warnings(lamp_readings(100, 101, 99, 101.9, 98.1), 550, 0.02) == []


def test_a_lamp_that_warms_up_is_warned_of_once_with_advice():
    (warning,) = drift_warnings(lamp_readings(95, 99, 100, 100), 550, 0.02)
    assert "+4.2% in the 10 min before frame 10" in warning
    assert "550 nm" in warning
    assert "warm up" in warning


def test_a_lamp_that_fades_is_warned_of_at_every_further_step():
    first, second = drift_warnings(lamp_readings(100, 97, 96, 94), 550, 0.02)
    assert "-3.0%" in first
    assert "-3.1%" in second
    assert "20 min before frame 30" in second
    assert "its age" in first


def test_unusable_readings_are_warned_of():
    (warning,) = drift_warnings(lamp_readings(float("nan"), 100, 0, 100), 550, 0.02)
    assert "frame 0, 20" in warning
    assert "`drift.step`" in warning


def test_no_reading_gives_no_warning():
    assert drift_warnings([], 550, 0.02) == []
