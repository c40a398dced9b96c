"""Marks of missing heights that no format declares: named, never measured, and missing once declared."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from brdfpipe.errors import InputError
from brdfpipe.surfaces import read_surface
from brdfpipe.surfaces.placeholders import find


def rough(count: int = 2000) -> np.ndarray:
    return np.cumsum(np.random.default_rng(3).normal(scale=0.05, size=count))


def test_a_value_far_from_all_others_is_named_with_the_key_that_declares_it(tmp_path: Path) -> None:
    height = rough()
    height[500:1320] = -25400
    np.savetxt(tmp_path / "line.txt", height, fmt="%.4f")
    with pytest.raises(
        InputError, match=r"found -25400 in 820 of 2000 heights; accepted: `missing: -25400`.*surface\.missing"
    ):
        read_surface(tmp_path / "line.txt", unit="um", pitch=1)
    surface = read_surface(tmp_path / "line.txt", unit="um", pitch=1, missing=-25400)
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(surface.height)), np.arange(500, 1320))
    assert "820 heights of -25400 taken as missing" in surface.attrs["history"]


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.int16])
def test_the_declared_value_is_in_the_unit_of_the_file(tmp_path: Path, dtype: type) -> None:
    height = (rough() * 1000).astype(dtype)
    height[::7] = -32768
    np.save(tmp_path / "line.npy", height)
    with pytest.raises(InputError, match=r"found -32768 in 286 of 2000 heights"):
        read_surface(tmp_path / "line.npy", unit="nm", pitch=1000)
    surface = read_surface(tmp_path / "line.npy", unit="nm", pitch=1000, missing=-32768)
    np.testing.assert_array_equal(np.isnan(surface.height), np.arange(2000) % 7 == 0)


def test_a_declared_value_that_no_height_has_is_noted_since_further_scans_share_the_key(tmp_path: Path) -> None:
    np.save(tmp_path / "line.npy", rough())
    surface = read_surface(tmp_path / "line.npy", unit="um", pitch=1, missing=-9999)
    assert "No heights of -9999 taken as missing" in surface.attrs["history"]
    assert not np.isnan(surface.height).any()


@pytest.mark.parametrize(("count", "size"), [(2, 2880), (3, 2880), (3, 300_000)])
@pytest.mark.parametrize("value", [-25400.0, 1e10])
def test_few_heights_of_a_placeholder_are_named_too(tmp_path: Path, value: float, count: int, size: int) -> None:
    height = rough(size)
    height[np.linspace(7, size - 9, count).astype(int)] = value
    np.save(tmp_path / "line.npy", height)
    with pytest.raises(InputError, match=rf"found {re.escape(f'{value:.7g}')} in {count} of {size} heights"):
        read_surface(tmp_path / "line.npy", unit="um", pitch=1)
    surface = read_surface(tmp_path / "line.npy", unit="um", pitch=1, missing=value)
    assert int(np.isnan(surface.height).sum()) == count


@pytest.mark.parametrize("marks", [(-25400.0, -1e10), (-32768.0, 32767.0), (-1e10, -9e9), (-1e10, -25400.0, 1e10)])
def test_several_placeholders_are_named_together_and_declared_as_a_list(
    tmp_path: Path, marks: tuple[float, ...]
) -> None:
    height = rough()
    for place, mark in enumerate(marks):
        height[100 * place + 5 : 100 * place + 9] = mark
    np.save(tmp_path / "line.npy", height)
    options = {"unit": "um", "pitch": 1}
    with pytest.raises(InputError, match=f"{len(marks)} values lie far from all other heights") as refusal:
        read_surface(tmp_path / "line.npy", **options)
    listed = ", ".join(f"{mark:.7g}" for mark in sorted(marks))
    assert f"accepted: `missing: [{listed}]` if they do" in str(refusal.value)
    surface = read_surface(tmp_path / "line.npy", missing=marks, **options)
    assert int(np.isnan(surface.height).sum()) == 4 * len(marks)
    assert surface.attrs["history"].count("4 heights of") == len(marks)
    with pytest.raises(InputError, match=re.escape(f"`missing: [{marks[0]:.7g}, ")):
        read_surface(tmp_path / "line.npy", missing=marks[0], **options)


def test_heights_that_a_real_surface_may_have_are_no_placeholder() -> None:
    height = rough()
    assert find(height) == ()
    assert find(np.maximum(height, np.median(height))) == ()  # a worn plateau, or a saturated sensor
    spike = height.copy()
    spike[7] = 1000.0
    assert find(spike) == ()  # a single spike is warned of instead
    assert find(np.where(height > np.median(height), height, height.min() - 1.0)) == ()  # a step
    assert find(np.full(10, np.nan)) == ()
    two = height.copy()
    two[[7, 900]] = 1000.0, 1000.5
    assert find(two) == ()  # spikes of different heights
    dust = height.copy()
    dust[300:340] = np.minimum(5 * np.r_[np.arange(20), np.arange(20)[::-1]], 60.0)
    assert find(dust) == ()  # a particle whose top is clipped, with its flanks
    pit = np.round(height, 2)
    pit[[300, 301, 302, 303]] = -2.0, -9.0, -9.0, -2.5
    assert find(pit) == ()  # a pit of few levels
    levels = np.resize([0.0, 10.0, 11.0, 25.0], 2000)
    assert find(levels) == ()  # few levels have wide gaps
