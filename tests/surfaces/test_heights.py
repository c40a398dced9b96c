"""What cannot be a surface is refused, what is doubtful is warned of."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from brdfpipe import vocabulary
from brdfpipe.errors import InputError
from brdfpipe.surfaces.heights import Heights, examine, surface_dataset

FILE = Path("somewhere/map.x3p")


def rough(shape: tuple[int, ...] = (40, 40), slope: float = 0.1, pitch: float = 1.0) -> np.ndarray:
    """White noise: its forward differences have twice its variance, on each axis."""
    noise = np.random.default_rng(5).standard_normal(shape)
    return noise * slope * pitch / np.sqrt(2 * len(shape))


def refuse(heights: Heights, message: str) -> None:
    with pytest.raises(InputError, match=rf"^map\.x3p.*{message}"):
        examine(surface_dataset(heights), FILE)


def test_a_plain_surface_passes_without_a_warning() -> None:
    for heights in (Heights(rough(), 1.0, 1.0), Heights(rough((64,)), 1.0)):
        assert vocabulary.warnings(examine(surface_dataset(heights), FILE)) == []


@pytest.mark.parametrize("pitch", [0.9e-3, 1.1e3, -1.0, 0.0])
def test_a_pitch_outside_one_nanometre_to_one_millimetre_is_refused(pitch: float) -> None:
    refuse(Heights(rough((64,)), pitch), r"implausible pitch along x.*`surface\.lateral_unit`")
    refuse(Heights(rough(), 1.0, pitch), r"implausible pitch along y.*`surface\.lateral_unit`")


def test_an_extent_of_a_metre_is_refused() -> None:
    refuse(Heights(rough((1001,), pitch=1e3), 1e3), "implausible extent along x; found 1.001 m")


@pytest.mark.parametrize("shape", [(63,), (31, 40), (40, 31)])
def test_too_few_points_are_refused(shape: tuple[int, ...]) -> None:
    refuse(Heights(rough(shape), 1.0, None if len(shape) == 1 else 1.0), "too few points")


@pytest.mark.parametrize(("slope", "accepted"), [(0.5e-4, False), (2e-4, True), (2.5, True), (3.5, False)])
def test_slopes_outside_the_range_of_finishes_are_refused(slope: float, accepted: bool) -> None:
    heights = Heights(rough(slope=slope), 1.0, 1.0)
    if accepted:
        examine(surface_dataset(heights), FILE)
    else:
        refuse(heights, r"implausible rms slope of a surface finish.*`surface\.unit`")


def test_a_tilt_does_not_count_as_slope() -> None:
    examine(surface_dataset(Heights(rough() + 5.0 * np.arange(40), 1.0, 1.0)), FILE)
    # Printed heights of a perfect plane differ from it by rounding alone.
    refuse(Heights(np.round(0.2 * np.arange(40) * np.ones((40, 1)), 6), 1.0, 1.0), "rms slope")


def test_heights_of_a_few_levels_are_refused() -> None:
    refuse(Heights(np.round(rough(slope=0.4) * 4) / 4, 1.0, 1.0), "quantised to a few levels")
    refuse(Heights(np.zeros((40, 40)), 1.0, 1.0), "quantised to a few levels; found 1 distinct")


@pytest.mark.parametrize("infinity", [np.inf, -np.inf])
def test_infinite_heights_are_refused(infinity: float) -> None:
    height = rough()
    height[3, 4] = infinity
    refuse(Heights(height, 1.0, 1.0), "infinite heights; found 1")


@pytest.mark.parametrize(
    ("share", "outcome"), [(0.005, "pass"), (0.02, "warn"), (0.45, "warn"), (0.55, "fail"), (1, "fail")]
)
def test_missing_heights_pass_warn_or_fail_by_their_share(share: float, outcome: str) -> None:
    height = rough((100, 100))
    height.ravel()[: int(share * height.size)] = np.nan
    heights = Heights(height, 1.0, 1.0)
    if outcome == "fail":
        refuse(heights, "more than half of the heights are missing")
    else:
        texts = vocabulary.warnings(examine(surface_dataset(heights), FILE))
        assert [f"{share:.1%} of the heights are missing" in text for text in texts] == [True] * (outcome == "warn")


@pytest.mark.parametrize(("pitches", "warned"), [((1.0, 1.9), False), ((1.0, 2.1), True), ((2.1, 1.0), True)])
def test_sections_of_unequal_pitch_are_warned_of(pitches: tuple[float, float], warned: bool) -> None:
    surface = examine(surface_dataset(Heights(rough(), *pitches)), FILE)
    assert any("factor 2.1" in text for text in vocabulary.warnings(surface)) == warned


@pytest.mark.parametrize(("spike", "warned"), [(29.0, False), (31.0, True), (-31.0, True)])
def test_a_spike_is_warned_of(spike: float, warned: bool) -> None:
    height = rough((100, 100), slope=0.01)
    height[50, 50] = spike
    surface = examine(surface_dataset(Heights(height, 1.0, 1.0)), FILE)
    assert any("a spike or a damaged height" in text for text in vocabulary.warnings(surface)) == warned


@pytest.mark.parametrize(("step", "warned"), [(0.1, False), (3.0, True)])
def test_a_few_steps_that_carry_the_slope_are_warned_of(step: float, warned: bool) -> None:
    height = rough((100, 100), slope=0.01)
    # Of a block out of place the edges alone are steep.
    height[30:60, 40:80] += step
    texts = vocabulary.warnings(examine(surface_dataset(Heights(height, 1.0, 1.0)), FILE))
    assert any("A few steps dominate the rms slope" in text for text in texts) == warned


def test_the_heavy_tail_of_ggx_gives_no_warning() -> None:
    u = np.random.default_rng(7).uniform(-1, 1, 200_000)
    # Its slopes along a line, P1 = a² / [2 (a² + p²)^(3/2)], inverted; heights are their sum.
    height = np.cumsum(0.1 * u / np.sqrt(1 - u * u))
    texts = vocabulary.warnings(examine(surface_dataset(Heights(height, 1.0)), FILE))
    assert not any("A few steps" in text for text in texts)


def test_heights_that_overflow_are_refused_in_words() -> None:
    height = rough()
    height[3, 4], height[5, 6] = 1e300, -1e308
    refuse(Heights(height, 1.0, 1.0), "implausible rms slope of a surface finish")


def test_the_dataset_has_the_history_and_warnings_of_the_reader() -> None:
    notes: dict[str, Any] = {"history": ("Reversed.",), "warnings": ("Measure again.",)}
    surface = surface_dataset(Heights(rough((40, 50)), 0.5, 0.7, **notes))
    vocabulary.validate(surface, "surface")
    assert (surface.attrs["history"], vocabulary.warnings(surface)) == ("Reversed.", ["Measure again."])
    assert (float(surface.x[-1]), float(surface.y[-1])) == pytest.approx((24.5, 27.3))
