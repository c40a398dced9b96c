"""Read and write datasets as netCDF files with their provenance.

A file appears whole or not at all: it is written under a temporary name in the same folder, flushed to the disk and renamed.
Its bytes depend on the content and the versions of libraries alone, not on time, host or path.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from contextvars import ContextVar
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from brdfpipe import netcdf_files, vocabulary
from brdfpipe.errors import BrdfpipeError, InputError

SOFTWARE = ("brdfpipe", "netCDF4", "numpy", "scipy", "xarray")
"""Packages whose versions are recorded with every dataset."""

_NOT_IN_DIGEST = ("digest", "software")


_SMALL_FILE = 100_000
"""Bytes up to which it takes less time to read all variables than to open the file for some."""
_MOST_SHARED, _MOST_SHARED_BYTES = 2, 64 * 2**20
"""Number and size of the datasets that :func:`shared_dataset` keeps: a material's BSDF, and another that it is compared with. What is prepared from
a BSDF may be larger than itself: 40 MB for a predicted surface."""

_shared: OrderedDict[tuple[int, ...], xr.Dataset] = OrderedDict()
"""By what identifies the content of a file, the least recently used first."""

_MOST_REMEMBERED_BYTES, _MOST_BYTES_OF_ONE = 32 * 2**20, 8 * 2**20
"""Size of the datasets that :func:`remembering` keeps, and of one that is kept: of those of a material the heights alone may be larger."""

_remembered: OrderedDict[tuple[int, ...], tuple[xr.Dataset, int]] = OrderedDict()
"""By what identifies the content of a file, the least recently used first: the dataset and its bytes."""

_remembers: ContextVar[bool] = ContextVar("remembers", default=False)

_owner: ContextVar[Callable[[Path], str | None]] = ContextVar("owner", default=lambda path: None)
"""See :func:`owners_checked`."""


class StoreError(BrdfpipeError):
    """A stored dataset cannot be read or written."""


def open_dataset(path: str | os.PathLike[str], kind: str | None = None) -> xr.Dataset:
    """Read a stored dataset whole into memory.

    Parameters
    ----------
    path : a netCDF file
    kind : required kind; by default the kind in its attributes

    Raises
    ------
    StoreError : the file is missing, truncated or not a netCDF file; or of another material (:func:`owners_checked`).
    VocabularyError : it is not of that kind.
    """
    path = Path(path)
    try:
        recalled = _recalled(path)
        dataset = netcdf_files.read(path) if recalled is None else recalled
    except FileNotFoundError as error:
        raise StoreError(f"{path}: no such dataset; run `brdfpipe build` to build it") from error
    except Exception as error:  # netCDF4 raises OSError, RuntimeError, ValueError and more on damaged files
        raise StoreError(
            f"{path}: damaged or not a netCDF file ({_cause(error)}); "
            "delete it and run `brdfpipe build` to build it again"
        ) from error
    _check_owner(dataset, path)
    own = dataset.attrs.get("kind")
    kind = kind or own
    if recalled is not None and kind == own:
        return dataset  # was validated before it was remembered
    if kind:
        vocabulary.validate(dataset, kind, str(path))
    if recalled is None and kind == own:
        _remember(path, dataset)
    return dataset


def shared_dataset(path: str | os.PathLike[str], kind: str | None = None) -> xr.Dataset:
    """As :func:`open_dataset`, but the same dataset for all who read the same file, as long as it is not written again.

    Stages of a material that follow each other in a process read its BSDF once, and share what is prepared from it. Nobody may change
    the dataset or its arrays.
    """
    key = _identity(Path(path))
    if key is None:
        return open_dataset(path, kind)
    if key not in _shared:
        _shared[key] = open_dataset(path)
    _shared.move_to_end(key)
    dataset = _shared[key]
    while len(_shared) > _MOST_SHARED or (len(_shared) > 1 and _shared_bytes() > _MOST_SHARED_BYTES):
        _shared.popitem(last=False)
    _check_owner(dataset, Path(path))
    return (
        dataset if kind is None or kind == dataset.attrs.get("kind") else vocabulary.validate(dataset, kind, str(path))
    )


def _shared_bytes() -> int:
    return sum(dataset.nbytes for dataset in _shared.values())


def _identity(path: Path) -> tuple[int, ...] | None:
    """What identifies the content of a file; None if there is no file."""
    try:
        found = path.stat()
    except OSError:
        return None
    # A file that is written anew is another inode, and one that is changed in place has another time of change.
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns


@contextmanager
def remembering() -> Iterator[None]:
    """Inside the block, keep what is read and written in memory, for whoever reads the same file again in such a block.

    The stages of a material that follow each other in a process read what the earlier ones wrote. They get datasets of their own on the same
    arrays: nobody may change these in place.
    """
    before = _remembers.set(True)
    try:
        yield
    finally:
        _remembers.reset(before)


def _remember(path: Path, dataset: xr.Dataset | None) -> None:
    if not _remembers.get() or dataset is None or (size := dataset.nbytes) > _MOST_BYTES_OF_ONE:
        return
    if (key := _identity(path)) is not None:
        _remembered[key] = dataset.copy(), size
    while sum(size for _, size in _remembered.values()) > _MOST_REMEMBERED_BYTES:
        _remembered.popitem(last=False)


def _recalled(path: Path) -> xr.Dataset | None:
    key = _identity(path) if _remembers.get() else None
    if key is None or key not in _remembered:
        return None
    _remembered.move_to_end(key)
    return _remembered[key][0].copy()


@contextmanager
def owners_checked(owner: Callable[[Path], str | None]) -> Iterator[None]:
    """Inside the block, refuse a dataset that is another material's than its place says.

    Parameters
    ----------
    owner : from the path, the required attribute ``material``; None: any
    """
    before = _owner.set(owner)
    try:
        yield
    finally:
        _owner.reset(before)


def _check_owner(dataset: xr.Dataset, path: Path) -> None:
    required, found = _owner.get()(path), dataset.attrs.get("material")
    if required is not None and found is not None and found != required:
        raise StoreError(
            f"{path}: is a dataset of the material {found}, not of {required}; delete it and run `brdfpipe build`"
        )


@contextmanager
def opened(paths: Mapping[str, str | os.PathLike[str]]) -> Iterator[dict[str, xr.Dataset]]:
    """Stored datasets by name, of which a variable is read when it is used, inside the block; small ones at once. Their kinds are not checked.

    A copy of such a dataset reads its variables once more: ``load`` one from which others are made.

    Raises
    ------
    StoreError : a file is missing, truncated or not a netCDF file, or a variable that is used is damaged.
    """
    with ExitStack() as files:
        try:
            datasets = {}
            for name, path in paths.items():
                recalled = _recalled(Path(path))
                if recalled is None and Path(path).stat().st_size < _SMALL_FILE:
                    recalled = netcdf_files.read(Path(path))
                datasets[name] = (
                    files.enter_context(xr.open_dataset(path, engine="netcdf4")) if recalled is None else recalled
                )
            for name, dataset in datasets.items():
                _check_owner(dataset, Path(paths[name]))
            yield datasets
        except (OSError, RuntimeError, ValueError):
            for path in paths.values():
                open_dataset(path)  # says which one is damaged, if any is
            raise


def save_dataset(
    dataset: xr.Dataset,
    path: str | os.PathLike[str],
    *,
    stage: str,
    material: str,
    inputs: Mapping[str, str | os.PathLike[str] | xr.Dataset] | None = None,
    parameters: Mapping[str, Any] | None = None,
) -> xr.Dataset:
    """Write a dataset with its provenance; return it as stored.

    Parameters
    ----------
    dataset : a dataset with the attribute ``kind`` (see :func:`brdfpipe.vocabulary.label`)
    path : the file to write; it appears whole or not at all
    stage, material : the stage that computed it, and the material
    inputs : name → raw file (recorded as sha256 of its bytes), dataset (recorded as its digest), or a digest
    parameters : all other parameters of the stage, as plain JSON values

    Raises
    ------
    VocabularyError : the dataset does not satisfy its kind.
    StoreError : the disk is full or the folder cannot be written.
    """
    path = Path(path)
    dataset = dataset.load()
    if "kind" not in dataset.attrs:
        raise StoreError(f"{path.name}: the dataset has no attribute `kind`; use brdfpipe.vocabulary.label")
    vocabulary.validate(dataset, dataset.attrs["kind"], path.name)
    provenance = {
        "stage": stage,
        "material": material,
        "inputs": canonical_json({name: _input_digest(value) for name, value in (inputs or {}).items()}),
        "parameters": canonical_json(parameters or {}),
        "software": canonical_json(_software()),
    }
    attrs = {**{k: v for k, v in dataset.attrs.items() if k != "digest"}, **provenance}
    dataset = dataset.assign_attrs({})
    dataset.attrs = dict(sorted(attrs.items()))
    for variable in dataset.variables.values():
        variable.attrs = dict(sorted(variable.attrs.items()))
        variable.encoding = {}
    dataset.attrs["digest"] = digest(dataset)
    with atomic_path(path, size_hint=dataset.nbytes) as temporary:
        netcdf_files.write(dataset, temporary)
    _remember(path, netcdf_files.as_read(dataset) if _remembers.get() else None)
    return dataset


@contextmanager
def atomic_path(path: str | os.PathLike[str], size_hint: int = 0) -> Iterator[Path]:
    """A temporary name beside ``path``, renamed to ``path`` if the block succeeds, and removed if it fails."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    free = shutil.disk_usage(path.parent).free
    if free < size_hint + 2**20:
        raise StoreError(f"{path}: not enough disk space to write it ({free >> 20} MiB free); free some disk space")
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        yield temporary
        with temporary.open("rb") as handle:
            os.fsync(handle.fileno())
        temporary.replace(path)
        _sync_folder(path.parent)
    except BrdfpipeError:
        raise
    except (OSError, RuntimeError) as error:  # netCDF4 reports a failed write as RuntimeError("NetCDF: HDF error")
        raise StoreError(
            f"{path}: could not be written ({error}); is the disk full or the folder read-only?"
        ) from error
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write a text file (UTF-8, as given) so that it appears whole or not at all."""
    write_bytes(path, text.encode("utf-8"))


def write_bytes(path: str | os.PathLike[str], content: bytes) -> None:
    """Write a file so that it appears whole or not at all."""
    with atomic_path(path, size_hint=len(content)) as temporary:
        temporary.write_bytes(content)


def digest(dataset: xr.Dataset) -> str:
    """Content digest: sha256 over names, dimensions, types, values and attributes, except the digest and the software."""
    content = hashlib.sha256()
    content.update(_attributes_json({k: v for k, v in dataset.attrs.items() if k not in _NOT_IN_DIGEST}))
    for name in sorted(map(str, dataset.variables)):
        variable = dataset.variables[name]
        values = np.asarray(variable.values)
        header = {"name": name, "dims": list(map(str, variable.dims)), "shape": list(values.shape)}
        if values.dtype.kind in "OUS":
            content.update(canonical_json({**header, "dtype": "string"}).encode())
            content.update(canonical_json([str(item) for item in values.ravel()]).encode())
        else:
            little = values.astype(values.dtype.newbyteorder("<"), copy=False)
            content.update(canonical_json({**header, "dtype": little.dtype.str}).encode())
            content.update(np.ascontiguousarray(little).tobytes())
        content.update(_attributes_json(variable.attrs))
    return content.hexdigest()


def verify_digest(dataset: xr.Dataset, source: str) -> xr.Dataset:
    """Check a dataset against the digest it carries; return it. Raises StoreError: the content does not match the digest."""
    if digest(dataset) != dataset.attrs.get("digest"):
        raise StoreError(f"{source}: the content does not match its digest; delete it and run `brdfpipe build`")
    return dataset


def file_digest(path: str | os.PathLike[str]) -> str:
    """sha256 of a file's bytes."""
    try:
        with Path(path).open("rb") as handle:
            return hashlib.file_digest(handle, "sha256").hexdigest()
    except OSError as error:
        raise InputError(Path(path), f"cannot be read ({error.strerror})") from error


def canonical_json(value: Any) -> str:
    """Unique JSON of a value: sorted keys, no spaces, shortest round-trip floats."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False, default=_json_value)


def _cause(error: Exception) -> str:
    """Cause of a library's error, without absolute paths."""
    return error.strerror if isinstance(error, OSError) and error.strerror else type(error).__name__


def _input_digest(value: str | os.PathLike[str] | xr.Dataset) -> str:
    if isinstance(value, xr.Dataset):
        return str(value.attrs.get("digest") or digest(value))
    if not isinstance(value, str):
        return file_digest(value)
    if not re.fullmatch("[0-9a-f]{64}", value):
        raise ValueError(f"{value!r} is no digest; give the path of a raw file as a pathlib.Path")
    return value


def _json_value(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} cannot be written as JSON; accepted: plain values and arrays")


def _attributes_json(attrs: Mapping[Any, Any]) -> bytes:
    # netCDF returns a one-element list as a scalar: both must have the same digest.
    plain = {str(k): np.asarray(v).ravel().tolist() for k, v in attrs.items()}
    return canonical_json(plain).encode()


@cache
def _software() -> dict[str, str]:
    return {package: version(package) for package in SOFTWARE}


def _sync_folder(folder: Path) -> None:
    if os.name != "posix":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
