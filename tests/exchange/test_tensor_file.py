"""Tensor files: bytes as the specification lays them out, and damaged ones."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from brdfpipe.errors import InputError
from brdfpipe.exchange import tensor_file


@pytest.fixture
def fields():
    return {
        "description": np.frombuffer(b"grey", dtype=np.uint8),
        "theta_i": np.linspace(0, 1.5, 4, dtype=np.float32),
        "values": np.arange(24, dtype=np.float64).reshape(2, 3, 4),
    }


def test_fields_are_read_back(fields, tmp_path):
    tensor_file.write(tmp_path / "x.bsdf", fields)
    back = tensor_file.read(tmp_path / "x.bsdf")
    assert list(back) == list(fields)
    for name, values in fields.items():
        assert back[name].dtype == values.dtype
        assert np.array_equal(back[name], values)


def test_the_head_is_that_of_the_format(fields, tmp_path):
    tensor_file.write(tmp_path / "x.bsdf", {"phi_i": fields["theta_i"]})
    content = (tmp_path / "x.bsdf").read_bytes()
    assert content[:18] == b"tensor_file\0\1\0" + struct.pack("<I", 1)
    length, name, dimensions, kind, offset, size = struct.unpack_from("<H5sHBQQ", content, 18)
    assert (length, name, dimensions, kind, size) == (5, b"phi_i", 1, 10, 4)
    assert np.array_equal(np.frombuffer(content, "<f4", 4, offset), fields["theta_i"])


@pytest.mark.cases(60)
@pytest.mark.parametrize("number", range(60))
def test_damaged_files_are_refused_or_read(fields, tmp_path, number):
    tensor_file.write(tmp_path / "x.bsdf", fields)
    content = bytearray((tmp_path / "x.bsdf").read_bytes())
    generator = np.random.default_rng(number)
    if number % 2:
        content = content[: generator.integers(0, len(content))]
    else:
        content[generator.integers(0, 110)] = generator.integers(0, 256)
    (tmp_path / "y.bsdf").write_bytes(content)
    try:
        back = tensor_file.read(tmp_path / "y.bsdf")
    except InputError:
        return
    assert sum(values.size for values in back.values()) <= len(content)


def test_a_field_that_claims_more_than_the_file_is_refused_before_memory_is_taken(tmp_path):
    head = b"tensor_file\0\1\0" + struct.pack("<IH1sHBQ3Q", 1, 1, b"v", 3, 11, 64, 10**6, 10**6, 10**6)
    (tmp_path / "x.bsdf").write_bytes(head + bytes(64))
    with pytest.raises(InputError, match="longer than the file"):
        tensor_file.read(tmp_path / "x.bsdf")
