"""Datasets as netCDF files, by netCDF4 itself: the layers of xarray above it take as long as a small file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
import xarray as xr
from numpy.typing import NDArray

_NUMBERS = "fiu"
"""Kinds of types that a file holds as they are."""


def write(dataset: xr.Dataset, path: Path) -> None:
    """Write a dataset: content and filters are those of ``Dataset.to_netcdf``, compressed and with a checksum, without missing values of floats.

    The checksum detects zeroed blocks, as a full disk leaves them. Raises OSError or RuntimeError: it cannot be written.
    """
    variables, attributes = _encoded(dataset)
    with netCDF4.Dataset(path, mode="w", format="NETCDF4") as file:
        for attribute, value in attributes.items():
            strings = np.asarray(value).dtype.kind == "U" and np.size(value) > 1
            (file.setncattr_string if strings else file.setncattr)(attribute, value)
        sizes = {str(name): size for variable in variables.values() for name, size in variable.sizes.items()}
        for dimension, size in sizes.items():
            file.createDimension(dimension, size)
        # All variables are defined before the first value is written: each change from one to the other flushes the file.
        values = {name: _plain(variable) for name, variable in variables.items()}
        for name, variable in variables.items():
            kind = str if values[name].dtype.kind == "O" else values[name].dtype
            written = file.createVariable(
                name, kind, tuple(map(str, variable.dims)), **_filters(dataset.variables[name])
            )
            written.set_auto_maskandscale(False)
            written.setncatts(variable.attrs)
        for name in variables:
            file.variables[name][...] = values[name]


def read(path: Path) -> xr.Dataset:
    """All variables of a netCDF file, in memory."""
    with netCDF4.Dataset(path) as file:
        file.set_auto_maskandscale(False)
        variables = {
            name: xr.Variable(variable.dimensions, _found(variable[...], variable.dtype is str), variable.__dict__)
            for name, variable in file.variables.items()
        }
        return _decoded(variables, file.__dict__)


def as_read(dataset: xr.Dataset) -> xr.Dataset | None:
    """What :func:`read` gives of the file that :func:`write` writes, with the types and the order of everything; no number is copied.

    None if an attribute has a form that a netCDF file does not keep.
    """
    variables, attributes = _encoded(dataset)
    try:
        found = {
            name: xr.Variable(
                variable.dims,
                _found(values := _plain(variable), values.dtype.kind == "O"),
                dict(_kept(variable.attrs)),
            )
            for name, variable in variables.items()
        }
        return _decoded(found, dict(_kept(attributes)))
    except TypeError:
        return None


def _decoded(variables: dict[str, xr.Variable], attributes: dict[str, Any]) -> xr.Dataset:
    """As :func:`xarray.decode_cf`, which would first make a dataset of what is not decoded yet."""
    decoded, others, coordinates = xr.conventions.decode_cf_variables(variables, attributes)
    return xr.Dataset(decoded, attrs=others).set_coords(coordinates & decoded.keys())


def _encoded(dataset: xr.Dataset) -> tuple[dict[str, xr.Variable], Mapping[str, Any]]:
    """Variables and attributes as a file holds them: coordinates are named by attributes; truth values are numbers."""
    variables, attributes = xr.conventions.encode_dataset_coordinates(dataset)
    encoded = {
        str(name): variable
        if variable.dtype.kind in _NUMBERS
        else xr.conventions.encode_cf_variable(variable, name=name)
        for name, variable in variables.items()
    }
    return encoded, attributes


def _filters(variable: xr.Variable) -> dict[str, Any]:
    compressed = variable.dtype.kind in _NUMBERS and variable.ndim > 0 and variable.size > 0
    return {"zlib": True, "complevel": 1, "shuffle": True, "fletcher32": True} if compressed else {}


def _plain(variable: xr.Variable) -> NDArray[Any]:
    """The values in the order and the types of a file: rows one after the other, strings as objects."""
    values = np.asarray(variable.values)
    if values.dtype.kind in "OUS":
        return values.astype(object)
    return np.asarray(values, dtype=values.dtype.newbyteorder("="), order="C")


def _found(values: Any, strings: bool) -> NDArray[Any]:
    return np.asarray(values, dtype=str if strings else None)


def _kept(attributes: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Attributes as a file gives them back. Raises TypeError: not known."""
    for name, value in attributes.items():
        if isinstance(value, str):
            yield name, str(value)
            continue
        array = np.asarray(value)
        if array.dtype.kind not in _NUMBERS or array.ndim > 1 or array.size == 0:
            raise TypeError(name)
        yield name, array.ravel()[0] if array.size == 1 else array
