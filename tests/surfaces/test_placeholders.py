"""Marks of missing heights that no format declares: named, never measured, and missing once declared."""

from __future__ import annotations

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
        InputError, match=r"found -25400 in 41\.0% of them; accepted: `missing: -25400`.*surface\.missing"
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
    with pytest.raises(InputError, match=r"found -32768 in 14\.3% of them"):
        read_surface(tmp_path / "line.npy", unit="nm", pitch=1000)
    surface = read_surface(tmp_path / "line.npy", unit="nm", pitch=1000, missing=-32768)
    np.testing.assert_array_equal(np.isnan(surface.height), np.arange(2000) % 7 == 0)


def test_a_declared_value_that_no_height_has_is_noted_since_further_scans_share_the_key(tmp_path: Path) -> None:
    np.save(tmp_path / "line.npy", rough())
    surface = read_surface(tmp_path / "line.npy", unit="um", pitch=1, missing=-9999)
    assert "No heights of -9999 taken as missing" in surface.attrs["history"]
    assert not np.isnan(surface.height).any()


def test_heights_that_a_real_surface_may_have_are_no_placeholder() -> None:
    height = rough()
    assert find(height) is None
    assert find(np.maximum(height, np.median(height))) is None  # a worn plateau, or a saturated sensor
    spike = height.copy()
    spike[7] = 1000.0
    assert find(spike) is None  # a single spike is warned of instead
    assert find(np.where(height > np.median(height), height, height.min() - 1.0)) is None  # a step
    assert find(np.full(10, np.nan)) is None
