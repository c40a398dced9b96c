"""Tensor files of the RGL laboratory: named arrays in one binary file, little endian.

The file begins with ``tensor_file`` and a null, the version 1.0 and the number of fields. Each field states its name, number of dimensions, type, offset and
shape; the arrays follow.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from brdfpipe import store
from brdfpipe.errors import InputError

BEGINNING = b"tensor_file\0"
_VERSION = b"\1\0"
_TYPES = {1: "u1", 2: "i1", 3: "<u2", 4: "<i2", 5: "<u4", 6: "<i4", 7: "<u8", 8: "<i8", 9: "<f2", 10: "<f4", 11: "<f8"}
_NUMBERS = {np.dtype(name): number for number, name in _TYPES.items()}
_MOST_FIELDS, _MOST_DIMENSIONS, _LARGEST = 64, 8, 2**30


def write(path: Path, fields: Mapping[str, NDArray[Any]]) -> None:
    """Write arrays of numbers; the file appears whole or not at all."""
    arrays = {
        name: np.ascontiguousarray(values).astype(values.dtype.newbyteorder("<")) for name, values in fields.items()
    }
    head = len(BEGINNING) + 6 + sum(2 + len(name.encode()) + 11 + 8 * array.ndim for name, array in arrays.items())
    content, at, bodies = [BEGINNING, _VERSION, struct.pack("<I", len(arrays))], head, []
    for name, array in arrays.items():
        encoded = name.encode()
        at += -at % array.itemsize
        content += [struct.pack("<H", len(encoded)), encoded]
        content.append(struct.pack(f"<HBQ{array.ndim}Q", array.ndim, _NUMBERS[array.dtype], at, *array.shape))
        bodies.append((at, array))
        at += array.nbytes
    with store.atomic_path(path, size_hint=at) as temporary, temporary.open("wb") as file:
        file.writelines(content)
        for offset, array in bodies:
            file.write(b"\0" * (offset - file.tell()))
            array.tofile(file)


def read(path: Path) -> dict[str, NDArray[Any]]:
    """The arrays of a file by name.

    Raises InputError: the file is of another kind, contradicts itself, or is larger than 1 GiB.
    """
    if path.stat().st_size > _LARGEST:
        raise InputError(
            path, "the file is too large", found=f"{path.stat().st_size >> 20} MiB", accepted="at most 1024 MiB"
        )
    content = path.read_bytes()
    if not content.startswith(BEGINNING + _VERSION):
        raise InputError(path, "not a tensor file of version 1.0", found=repr(content[:14])[:40])
    at = len(BEGINNING) + 2

    def take(form: str) -> tuple[Any, ...]:
        nonlocal at
        size = struct.calcsize(form)
        if at + size > len(content):
            raise InputError(path, "the file ends within its list of fields", found=f"{len(content)} bytes")
        at += size
        return struct.unpack_from(form, content, at - size)

    (count,) = take("<I")
    if count > _MOST_FIELDS:
        raise InputError(path, "too many fields", found=count, accepted=f"at most {_MOST_FIELDS}")
    fields: dict[str, NDArray[Any]] = {}
    for _ in range(count):
        (length,) = take("<H")
        (encoded,) = take(f"<{length}s")
        name = encoded.decode("utf-8", "replace")
        dimensions, number, offset = take("<HBQ")
        if dimensions > _MOST_DIMENSIONS or number not in _TYPES:
            raise InputError(
                path, f"the field {name[:40]!r} has an unknown type", found=f"{dimensions} dimensions, type {number}"
            )
        shape = take(f"<{dimensions}Q")
        size = math.prod(shape)
        if offset + size * np.dtype(_TYPES[number]).itemsize > len(content):
            raise InputError(path, f"the field {name[:40]!r} is longer than the file", found=f"shape {shape}")
        fields[name] = np.frombuffer(content, dtype=_TYPES[number], count=size, offset=offset).reshape(shape)
    return fields
