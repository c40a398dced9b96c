"""Files hold what xarray writes, and what is remembered of a dataset is what reading its file gives."""

from __future__ import annotations

import netCDF4
import numpy as np
import pytest
import samples
import xarray as xr

from brdfpipe import netcdf_files

FILTERS = {"zlib": True, "complevel": 1, "shuffle": True, "fletcher32": True}


def mixed() -> xr.Dataset:
    """Values and attributes of every form that datasets have, not in the order and the types of a file."""
    grid = np.arange(12.0).reshape(3, 4)
    return xr.Dataset(
        {
            "turned": (("y", "x"), np.asfortranarray(grid), {"units": "1", "count": 3}),
            "repeated": (("y", "x"), np.broadcast_to(np.float32(2.5), (3, 4)), {"one": [1.5], "several": [1, 2]}),
            "swapped": (("x",), np.arange(4, dtype=">i4"), {"real": 0.1}),
            "words": (("x",), np.array(["a", "bcd", "", "ef"], dtype="<U9")),
            "objects": (("y",), np.array(["über", "b", "c"], dtype=object)),
            "is_true": (("y",), np.array([True, False, True])),
            "number": ((), 4.0, {"units": "1"}),
            "word": ((), "single"),
            "none": (("empty",), np.zeros(0)),
        },
        coords={"x": np.arange(4.0), "along": ("x", np.arange(4)), "scalar": 2.0, "label": "one"},
        attrs={"kind": "mixed", "names": ["a", "b"], "limits": np.array([0.0, 1.0]), "level": 2},
    )


DATASETS = {
    "mixed": mixed,
    "spectrum": samples.spectrum,
    "surface": lambda: samples.gaussian_surface(32),
    "bsdf": samples.beckmann_bsdf,
}


@pytest.mark.parametrize("name", DATASETS)
def test_a_file_holds_what_xarray_writes(tmp_path, name):
    dataset = DATASETS[name]()
    netcdf_files.write(dataset, tmp_path / "a.nc")
    encoding = {
        key: ({"_FillValue": None} if variable.dtype.kind == "f" else {})
        | (FILTERS if variable.dtype.kind in "fiu" and variable.ndim and variable.size else {})
        for key, variable in dataset.variables.items()
    }
    dataset.to_netcdf(tmp_path / "b.nc", engine="netcdf4", format="NETCDF4", encoding=encoding)
    with netCDF4.Dataset(tmp_path / "a.nc") as one, netCDF4.Dataset(tmp_path / "b.nc") as other:
        check_attributes(one.__dict__, other.__dict__)
        assert {key: dimension.size for key, dimension in one.dimensions.items()} == {
            key: dimension.size for key, dimension in other.dimensions.items()
        }
        assert list(one.variables) == list(other.variables)
        for key, variable in one.variables.items():
            like = other.variables[key]
            assert (variable.dtype, variable.dimensions) == (like.dtype, like.dimensions)
            assert (variable.filters(), variable.chunking()) == (like.filters(), like.chunking())
            np.testing.assert_array_equal(variable[...], like[...])
            check_attributes(variable.__dict__, like.__dict__)


def test_a_dataset_always_gives_the_same_bytes(tmp_path):
    for name in "ab":
        netcdf_files.write(mixed(), tmp_path / name)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


@pytest.mark.parametrize("name", DATASETS)
def test_what_is_remembered_is_what_a_file_gives(tmp_path, name):
    dataset = DATASETS[name]()
    dataset.attrs.pop("names", None)  # not remembered, see below
    netcdf_files.write(dataset, tmp_path / "a.nc")
    read, remembered = netcdf_files.read(tmp_path / "a.nc"), netcdf_files.as_read(dataset)
    assert remembered is not None
    assert list(read.variables) == list(remembered.variables)
    assert list(read.coords) == list(remembered.coords)
    for key, variable in read.variables.items():
        other = remembered.variables[key]
        assert (variable.dims, variable.dtype.str, variable.encoding) == (other.dims, other.dtype.str, other.encoding)
        assert variable.values.flags.c_contiguous == other.values.flags.c_contiguous
        np.testing.assert_array_equal(variable.values, other.values)
        check_attributes(variable.attrs, other.attrs)
    check_attributes(read.attrs, remembered.attrs)


def check_attributes(read, remembered):
    assert list(read) == list(remembered)
    for key, value in read.items():
        assert type(value) is type(remembered[key])
        np.testing.assert_array_equal(value, remembered[key])
        assert np.asarray(value).dtype == np.asarray(remembered[key]).dtype


def test_a_dataset_whose_attributes_a_file_may_change_is_not_remembered():
    assert netcdf_files.as_read(mixed()) is None
