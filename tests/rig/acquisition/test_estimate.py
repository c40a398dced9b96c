"""The dry run: frames, bytes, hours, and brackets with gaps or too small a range."""

from __future__ import annotations

import math

import pytest
import small_rig

from brdfpipe.rig import templates
from brdfpipe.rig.acquisition.estimate import ARRANGEMENT_TIME, READOUT, SLEW_SPEED, WHEEL_MOVE, estimate, frame_range
from brdfpipe.rig.description import Rig
from brdfpipe.rig.frame_file import frame_size
from brdfpipe.rig.plan import Plan


@pytest.fixture
def plan(tmp_path):
    return Plan.load(small_rig.write(tmp_path))


def bracketed(tmp_path, bracket):
    line = "bracket: [{exposure: 1, position: 2}, {exposure: 1, position: 1}]"
    assert line in small_rig.PLAN
    return Plan.load(small_rig.write(tmp_path, small_rig.PLAN.replace(line, f"bracket: {bracket}")))


def test_frames_are_counted_by_purpose(plan):
    assert estimate(plan).counts == {"dark": 10, "drift": 3, "etalon": 4, "sample": 4}
    assert estimate(plan).frames == len(plan.shots) == 21


def test_bytes_are_those_of_the_frames_that_are_written(plan, tmp_path):
    small_rig.take(plan, small_rig.fake_bench(), tmp_path / "run")
    files = list((tmp_path / "run" / "frames").iterdir())
    assert estimate(plan).size == sum(path.stat().st_size for path in files)
    assert {path.stat().st_size for path in files} == {frame_size(plan)}


def test_hours_include_exposures_moves_readouts_and_manual_work(plan):
    lights = [shot for shot in plan.shots if not shot.dark]
    exposures = len(plan.shots) * (1 + READOUT)
    pairs = list(zip(plan.shots, plan.shots[1:], strict=False))
    moves = sum(abs(after.wavelength - before.wavelength) for before, after in pairs) / SLEW_SPEED
    turns = sum(after.position != before.position for before, after in pairs) * WHEEL_MOVE
    expected = exposures + moves + turns + 2 * ARRANGEMENT_TIME
    assert estimate(plan).hours == pytest.approx(expected / 3600)
    assert len(lights) == 11


def test_a_slow_monochromator_takes_longer(plan, tmp_path):
    rig = tmp_path / "rig.yaml"
    rig.write_text(rig.read_text().replace("dialect: acton,", "dialect: acton, speed: 100,"))
    slow = estimate(Plan.load(tmp_path / "plan.yaml"))
    # 500 to 550 nm and back in each of two arrangements, between lamp readings: 250 nm in total.
    travelled = sum(abs(b.wavelength - a.wavelength) for a, b in zip(plan.shots, plan.shots[1:], strict=False))
    assert 3600 * (slow.hours - estimate(plan).hours) == pytest.approx(travelled * (60 / 100 - 1 / SLEW_SPEED))


def test_the_range_of_a_frame_is_that_of_a_spot_at_a_signal_to_noise_of_50(plan):
    pixels = math.pi * (2 * 0.9) ** 2
    darkest = 25_000 / frame_range(plan.rig)
    assert math.sqrt(pixels) * darkest / math.sqrt(darkest + 20**2) == pytest.approx(50)


def test_nine_pixels_hold_51_to_one(tmp_path):
    """The figure of the design paper, for the spots of a fibre that cover nine pixels."""
    small_rig.write(tmp_path)
    rig = tmp_path / "rig.yaml"
    rig.write_text(rig.read_text().replace("fibre_radius: 2", f"fibre_radius: {3 / math.sqrt(math.pi) / 0.9}"))
    assert frame_range(Rig.load(rig)) == pytest.approx(51, abs=1)


def test_steps_that_do_not_overlap_are_named(tmp_path):
    result = estimate(bracketed(tmp_path, "[{exposure: 10, position: 1}, {exposure: 0.01, position: 1}]"))
    assert "bracket steps 2 and 1 do not overlap: 1e+03 times the light" in result.warnings[0]


def test_a_bracket_that_is_too_short_gives_a_warning(tmp_path):
    (warning,) = estimate(bracketed(tmp_path, "[{exposure: 1, position: 1}]")).warnings
    assert "needs 1 : 2.5e+05" in warning


def test_a_bracket_that_reaches_gives_no_warning(tmp_path):
    steps = ", ".join(
        f"{{exposure: {exposure}, position: {position}}}"
        for exposure, position in [(0.2, 4), (2, 4), (2, 2), (2, 1), (20, 1)]
    )
    assert estimate(bracketed(tmp_path, f"[{steps}]")).warnings == ()


def test_the_bench_to_start_from_takes_hours_and_reaches_everything(tmp_path):
    result = estimate(Plan.load(templates.start(tmp_path / "bench")))
    assert result.warnings == ()
    assert result.counts["sample"] == 875
    assert 1 < result.hours < 4  # the preprint: 3 to 4 hours a sample
    first, *lines = result.text.splitlines()
    assert (
        first == f"sample-1 on bench-1: {result.frames} frames, {result.size / 1e6:.1f} MB, about {result.hours:.1f} h"
    )
    assert [line.split()[0] for line in lines] == ["dark", "drift", "target", "etalon", "sample", "manual"]
    assert "7 arrangements" in lines[-1]
