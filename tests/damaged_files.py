"""Files of other programs that were cut, changed or garbled."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from brdfpipe.errors import InputError
from brdfpipe.exchange.fits import evaluated
from brdfpipe.exchange.reading import read


def garbled(content: bytes, count: int, seed: int = 2) -> Iterator[bytes]:
    """Copies of a text file that end early, or hold a wrong character, lack a part, or hold other characters in their first 3000."""
    generator = np.random.default_rng(seed)
    for number in range(count):
        damaged = bytearray(content)
        match number % 4:
            case 0:
                damaged = damaged[: generator.integers(1, len(damaged))]
            case 1:
                damaged[generator.integers(0, min(2000, len(damaged)))] = generator.integers(0, 256)
            case 2:
                start = generator.integers(0, len(damaged) - 300)
                del damaged[start : start + generator.integers(1, 300)]
            case _:
                start = generator.integers(0, min(3000, len(damaged) - 8))
                damaged[start : start + 8] = generator.integers(32, 127, 8).astype(np.uint8).tobytes()
        yield bytes(damaged)


def check_garbled_files(content: bytes, path: Path, format: str, count: int) -> None:
    """Every garbled copy is read as finite values, or refused with an :class:`InputError`; most are refused."""
    refused = 0
    for damaged in garbled(content, count):
        path.write_bytes(damaged)
        try:
            found = read(path, format)
        except InputError:
            refused += 1
            continue
        assert np.isfinite(found["brdf"].values).all()
    # Those that end early, and most of those that lack a part.
    assert refused >= count / 4


def check_garbled_models(monkeypatch: pytest.MonkeyPatch, content: bytes, path: Path, format: str, count: int) -> None:
    """:func:`check_garbled_files` of a format whose models are evaluated when it is read, here in few directions."""
    monkeypatch.setattr(evaluated, "_STEPS_OF_LOBE", 4)
    monkeypatch.setattr(evaluated, "_THETA_D", np.array([0.0, 45, 89]))
    check_garbled_files(content, path, format, count)
