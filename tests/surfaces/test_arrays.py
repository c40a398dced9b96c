"""NumPy files: rows are y, the unit is stated, and nothing but numbers is ever loaded."""

from __future__ import annotations

import io
import pickle
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from brdfpipe.errors import InputError
from brdfpipe.surfaces import read_surface

STATED: dict[str, Any] = {"unit": "um", "pitch": [0.5, 0.7]}


def saved(folder: Path, array: Any, name: str = "map.npy") -> Path:
    np.save(folder / name, array)
    return folder / name


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("dtype", ["<f8", ">f8", "<f4", ">f4"])
def test_a_map_keeps_its_orientation_whatever_its_layout(
    tmp_path: Path, asymmetric: xr.Dataset, dtype: str, order: Any
) -> None:
    array = np.asarray(asymmetric.height.values, dtype=dtype, order=order)
    surface = read_surface(saved(tmp_path, array), **STATED)
    np.testing.assert_array_equal(surface.height, array)
    assert surface.height.dtype == array.dtype.newbyteorder("=")
    assert (surface.attrs["pitch_x"], surface.attrs["pitch_y"]) == (0.5, 0.7)


@pytest.mark.parametrize("shape", [(-1,), (1, -1), (-1, 1)])
def test_one_row_or_column_is_a_line(tmp_path: Path, line: xr.Dataset, shape: tuple[int, ...]) -> None:
    surface = read_surface(saved(tmp_path, line.height.values.reshape(shape)), unit="um", pitch=0.25)
    assert surface.height.dims == ("x",)
    np.testing.assert_array_equal(surface.height, line.height)


def test_units_scale_heights_and_pitch(tmp_path: Path, asymmetric: xr.Dataset) -> None:
    path = saved(tmp_path, asymmetric.height.values * 1e3)
    surface = read_surface(path, unit="nm", lateral_unit="mm", pitch=[5e-4, 7e-4])
    np.testing.assert_allclose(surface.height, asymmetric.height, rtol=1e-15)
    assert (surface.attrs["pitch_x"], surface.attrs["pitch_y"]) == pytest.approx((0.5, 0.7))


def test_integers_are_read_as_numbers(tmp_path: Path, asymmetric: xr.Dataset) -> None:
    counts = np.round(np.nan_to_num(asymmetric.height.values) * 1e3).astype(np.int16)
    np.testing.assert_allclose(read_surface(saved(tmp_path, counts), unit="nm", pitch=500).height, counts * 1e-3)


@pytest.mark.parametrize(
    ("stated", "message"),
    [
        ({"pitch": 1}, r"the unit of the heights is missing.*`surface\.unit`"),
        ({"unit": "um"}, r"the pitch is missing.*`surface\.pitch`"),
        ({"unit": "inch", "pitch": 1}, "unknown unit"),
        ({"unit": "um", "pitch": -1}, "invalid pitch"),
        ({"unit": "um", "pitch": [1, 2, 3]}, "invalid pitch"),
        ({"unit": "um", "pitch": 1, "layout": "grid"}, "does not apply to the format"),
    ],
)
def test_what_is_not_known_is_asked_for(
    tmp_path: Path, asymmetric: xr.Dataset, stated: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        read_surface(saved(tmp_path, asymmetric.height.values), **stated)


@pytest.mark.parametrize(
    "array",
    [
        np.zeros((3, 40, 40)),
        np.float64(1),
        np.zeros((40, 40), dtype=complex),
        np.zeros((40, 40), dtype=bool),
        np.full((40, 40), "high"),
        np.zeros((40, 40), dtype=[("z", "f8")]),
    ],
)
def test_other_arrays_are_refused(tmp_path: Path, array: Any) -> None:
    with pytest.raises(InputError, match="not an array of heights"):
        read_surface(saved(tmp_path, array), **STATED)


class _Trap:
    sprung = False

    def __reduce__(self) -> Any:
        return (setattr, (_Trap, "sprung", True))


def test_pickled_objects_are_never_loaded(tmp_path: Path) -> None:
    trap = np.empty(1, dtype=object)
    trap[0] = _Trap()
    np.save(tmp_path / "map.npy", trap, allow_pickle=True)
    np.savez(tmp_path / "map.npz", height=trap)
    (tmp_path / "bare.npy").write_bytes(pickle.dumps(_Trap()))
    for name, message in (("map.npy", "objects"), ("map.npz", "objects"), ("bare.npy", "not a NumPy array")):
        with pytest.raises(InputError, match=message):
            read_surface(tmp_path / name, **STATED)
    assert not _Trap.sprung


@pytest.mark.parametrize(
    ("shape", "message"), [((10**6, 10**6), "too many points"), ((10**4, 10**4), "size of the data does not match")]
)
def test_a_header_that_promises_more_than_there_is_costs_no_memory(
    tmp_path: Path, shape: tuple[int, int], message: str
) -> None:
    with (tmp_path / "map.npy").open("wb") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": shape})
        file.write(bytes(80_000))
    with pytest.raises(InputError, match=message):
        read_surface(tmp_path / "map.npy", **STATED)


def test_a_file_with_something_behind_the_array_is_refused(tmp_path: Path, asymmetric: xr.Dataset) -> None:
    path = saved(tmp_path, asymmetric.height.values)
    path.write_bytes(path.read_bytes() + b"more")
    with pytest.raises(InputError, match="size of the data does not match the header"):
        read_surface(path, **STATED)


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
@pytest.mark.parametrize("name", ["height", "z"])
def test_an_archive_brings_its_unit_and_pitch(tmp_path: Path, asymmetric: xr.Dataset, save: Any, name: str) -> None:
    heights = {name: asymmetric.height.values * 1e3}
    save(tmp_path / "map.npz", unit="nm", lateral_unit="um", pitch_x=0.5, pitch_y=0.7, **heights)
    surface = read_surface(tmp_path / "map.npz")
    np.testing.assert_allclose(surface.height, asymmetric.height, rtol=1e-15)
    assert (surface.attrs["pitch_x"], surface.attrs["pitch_y"]) == (0.5, 0.7)
    assert read_surface(tmp_path / "map.npz", pitch=2, lateral_unit="um").attrs["pitch_y"] == 2


@pytest.mark.parametrize(("pitch", "expected"), [(0.5, (0.5, 0.5)), ([0.5, 0.7], (0.5, 0.7)), (2, (2, 2))])
def test_an_archive_may_hold_one_pitch_or_two(
    tmp_path: Path, asymmetric: xr.Dataset, pitch: Any, expected: tuple[float, float]
) -> None:
    np.savez(tmp_path / "map.npz", height=asymmetric.height.values, unit="um", pitch=pitch)
    surface = read_surface(tmp_path / "map.npz")
    assert (surface.attrs["pitch_x"], surface.attrs["pitch_y"]) == expected


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({}, "no array of heights"),
        ({"unit": "um"}, "no array of heights"),
        ({"a": np.zeros((40, 40)), "b": np.zeros((40, 40))}, "several arrays, none named `height`; found 'a, b'"),
        ({"height": np.zeros((40, 40)), "unit": 3.0}, "unit: not a text"),
        ({"height": np.zeros((40, 40)), "unit": "um", "pitch": "wide"}, "pitch: not a length"),
        ({"height": np.zeros((40, 40)), "unit": "um", "pitch": [1.0, 1.0, 1.0]}, "not a length"),
        ({"height": np.zeros((40, 40)), "unit": "parsec", "pitch": 1.0}, "unknown unit; found 'parsec'"),
    ],
)
def test_other_archives_are_refused_in_words(tmp_path: Path, arrays: dict[str, Any], message: str) -> None:
    np.savez(tmp_path / "map.npz", **arrays)
    with pytest.raises(InputError, match=message):
        read_surface(tmp_path / "map.npz")


def test_a_zip_bomb_is_refused_before_it_is_inflated(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "map.npz", height=np.zeros((2000, 2000)), unit="um", pitch=1.0)
    assert (tmp_path / "map.npz").stat().st_size < 100_000
    with pytest.raises(InputError, match="suspiciously large"):
        read_surface(tmp_path / "map.npz")


def test_an_archive_of_other_things_is_refused(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "map.npz", "w") as archive:
        archive.writestr("height.npy", "no array")
    with pytest.raises(InputError, match=r"height\.npy: not a NumPy array"):
        read_surface(tmp_path / "map.npz", **STATED)


def test_an_entry_shorter_than_its_header_says_is_refused(tmp_path: Path) -> None:
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (100, 100)})
    with zipfile.ZipFile(tmp_path / "map.npz", "w") as archive:
        archive.writestr("height.npy", header.getvalue() + bytes(100))
    with pytest.raises(InputError, match=r"height\.npy: the size of the data does not match the header"):
        read_surface(tmp_path / "map.npz", **STATED)


@pytest.mark.parametrize("name", ["absent.npy", "absent.npz"])
def test_an_absent_file_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=f"^{name}: cannot be read"):
        read_surface(tmp_path / name, **STATED)
