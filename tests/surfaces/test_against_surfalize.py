"""Files of instruments beside surfalize, an independent reader; where both differ, bytes of the file say who is right."""

from __future__ import annotations

import struct
import warnings
from pathlib import Path
from typing import Any

import instrument_files
import numpy as np
import pytest
import xarray as xr

from brdfpipe.surfaces import read_surface

surfalize = pytest.importorskip("surfalize", reason="surfalize is not there: make peers")

WRITTEN = ("al3d", "gwy", "plux", "sdf", "sur", "zmg")
"""Extensions of files that the tests write and that surfalize reads: it wants more of the others than heights and pitch."""


def second_opinion(path: Path) -> tuple[np.ndarray, tuple[float, float]]:
    """Heights (y, x) [µm], in the order of the file, and pitches x, y [µm], as surfalize reads them."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of unequal pitches
        surface: Any = surfalize.Surface.load(path)
    return np.asarray(surface.data, dtype=float), (float(surface.step_x), float(surface.step_y))


def about_mean(height: np.ndarray) -> np.ndarray:
    return height - np.nanmean(height)


@pytest.mark.parametrize("suffix", WRITTEN)
def test_both_read_the_same_heights_from_a_small_file(tmp_path: Path, asymmetric: xr.Dataset, suffix: str) -> None:
    path = tmp_path / f"map.{suffix}"
    path.write_bytes(instrument_files.WRITERS[suffix](asymmetric.height.values))
    surface, (height, pitches) = read_surface(path), second_opinion(path)
    # surfalize keeps the order of the file; that of SDF is upwards.
    upwards = height if suffix == "sdf" else height[::-1]
    np.testing.assert_allclose(about_mean(upwards), about_mean(surface.height.values), rtol=0, atol=1e-7)
    assert (surface.attrs["pitch_x"], surface.attrs["pitch_y"]) == pytest.approx(pitches, rel=1e-6)


@pytest.mark.parametrize("name", ["al3d-1.al3d", "nms-2.nms", "sur-2.sur", "x3p-2.x3p"])
def test_both_read_the_same_heights_from_a_real_file(shared_data: Path, name: str) -> None:
    path = shared_data / "surfaces" / name
    surface, (height, pitches) = read_surface(path), second_opinion(path)
    upwards = height if name.endswith(".x3p") else height[::-1]
    np.testing.assert_array_equal(np.isnan(upwards), np.isnan(surface.height))
    spread = float(np.nanstd(surface.height))
    np.testing.assert_allclose(about_mean(upwards), about_mean(surface.height.values), rtol=0, atol=1e-5 * spread)
    assert (surface.attrs["pitch_x"], surface.attrs["pitch_y"]) == pytest.approx(pitches, rel=1e-6)


def test_of_a_plu_file_surfalize_reads_the_two_counts_as_the_first_heights(shared_data: Path) -> None:
    path = shared_data / "surfaces" / "plu-1.plu"
    surface, (height, _) = read_surface(path), second_opinion(path)
    content = path.read_bytes()
    assert struct.unpack_from("<2I", content, 500) == surface.height.shape
    np.testing.assert_array_equal(height.ravel()[:2], np.frombuffer(content, "<f4", 2, 500))
    np.testing.assert_array_equal(height.ravel()[2:], surface.height.values[::-1].ravel()[:-2])


def test_of_a_metropro_file_surfalize_takes_an_eighth_of_the_counts_of_a_fringe(
    tmp_path: Path, asymmetric: xr.Dataset
) -> None:
    """The file's own description has 32 768 counts a fringe at phase resolution 1; surfalize takes 4096."""
    written = np.nan_to_num(asymmetric.height.values)
    path = tmp_path / "map.dat"
    path.write_bytes(instrument_files.metropro(written))
    surface, (height, _) = read_surface(path, format="metropro"), second_opinion(path)
    np.testing.assert_allclose(about_mean(surface.height.values), about_mean(written), atol=1e-5)
    np.testing.assert_allclose(about_mean(height[::-1]), 8 * about_mean(written), atol=1e-4)
    assert surface.attrs["pitch_x"] == pytest.approx(instrument_files.PITCH[0], rel=1e-6)


def test_surfalize_does_not_read_the_real_opd_file(shared_data: Path) -> None:
    path = shared_data / "surfaces" / "opd-1.opd"
    assert read_surface(path).height.size > 0
    with pytest.raises(ValueError, match="not a valid BlockType"):
        second_opinion(path)


def test_of_a_tmd_file_surfalize_takes_the_lengths_for_micrometres(shared_data: Path) -> None:
    path = shared_data / "surfaces" / "tmd-1.tmd"
    surface, (height, pitches) = read_surface(path, unit="um"), second_opinion(path)
    np.testing.assert_allclose(height[::-1], surface.height, rtol=1e-6, atol=1e-9)
    assert (surface.attrs["pitch_x"], surface.attrs["pitch_y"]) == pytest.approx(pitches, rel=1e-6)
