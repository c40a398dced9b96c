"""The wavelength of the monochromator, checked by lines."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import rig_accuracy as accuracy
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st

from brdfpipe import vocabulary
from brdfpipe.rig.emulator.effects import Effects
from brdfpipe.rig.plan import LineCheck, Plan
from brdfpipe.rig.reduction.line_lamp import LineReading, fit_line, line_warnings, read_lines, wavelength_u
from brdfpipe.rig.reduction.relative_light import reduce

LINES = (435.833, 546.074)
SLIT = 10.0
PLACES = 0.9 * SLIT * np.arange(-4, 5) / 4


def plan(*runs: str) -> Plan:
    small = accuracy.plan_of((550.0,), (10.0,), 30)
    return replace(small, runs=runs, lines=LineCheck(LINES, 3, 0.3))


def frames(offset: float, *runs: str) -> xr.Dataset:
    return accuracy.frames_of(plan("line-lamp", *runs), None, seed=1, effects=Effects(wavelength_offset=offset))


@given(st.floats(-4, 4), st.floats(0.75, 1.25), st.floats(1e3, 1e6), st.integers(0, 1000))
def test_the_middle_of_a_line_is_found_within_its_uncertainty(offset, width, height, seed):
    light = height * np.maximum(1 - np.abs(PLACES - offset) / (width * SLIT), 0)
    noise = np.sqrt(light + 400)
    noisy = light + noise * np.random.default_rng(seed).standard_normal(light.size)
    middle, u = fit_line(PLACES, noisy, noise, SLIT)
    assert abs(middle - offset) < 6 * u + 0.02
    assert u < 1.0


@pytest.mark.parametrize("offset", [-2.0, 0.0, 0.7])
def test_the_middle_does_not_depend_on_the_shape_of_the_slit(offset):
    round_ = 1e5 * np.exp(-4 * np.log(2) * ((PLACES - offset) / SLIT) ** 2)
    middle, u = fit_line(PLACES, round_, np.sqrt(round_ + 400), SLIT)
    assert abs(middle - offset) < 3 * u
    assert u < 0.5


def test_without_a_line_there_is_no_offset():
    assert np.isnan(fit_line(PLACES, np.full(9, 3.0), np.full(9, 20.0), SLIT)).all()


@pytest.mark.parametrize("offset", [0.0, 0.4, -1.2])
def test_the_offset_of_an_emulated_monochromator_is_recovered(offset):
    readings = read_lines(frames(offset), plan("line-lamp").rig)
    assert [reading.line for reading in readings] == list(LINES)
    for reading in readings:
        assert reading.offset == pytest.approx(-offset, abs=0.05)
        assert reading.u < 0.05
    assert wavelength_u(readings, 0.1) == pytest.approx(max(abs(offset), 0.1), abs=0.03)
    assert len(line_warnings(readings, 0.3)) == (abs(offset) > 0.3)


def test_an_offset_beyond_the_tolerance_is_named_and_counts_as_uncertainty():
    run = frames(0.8, "etalon")
    reduced = reduce(
        run.assign_attrs(line_tolerance=0.3, lines=list(LINES)), plan("etalon").rig, load="etalon", incidence=10.0
    )
    assert reduced.attrs["wavelength_u"] == pytest.approx(0.8, abs=0.05)
    (named,) = [text for text in vocabulary.warnings(reduced) if "lines" in text]
    assert "-0.8" in named
    assert "at 546.074 nm" in named


def test_a_line_out_of_reach_is_named():
    readings = read_lines(frames(9.0), plan("line-lamp").rig)
    (named,) = line_warnings(readings, 0.3)
    assert named.startswith("No clear line at 435.833, 546.074 nm")
    assert wavelength_u(readings, 0.1) == 0.1
    assert wavelength_u([LineReading(500.0, 0.05, 0.01)], 0.1) == 0.1
