"""Compiled loops do what their Python does, also where no machine code can be kept."""

from typing import Any

import numba
import numpy as np
import pytest

from brdfpipe.compilation import compiled


def _sum_of_inverses(values: np.ndarray) -> float:
    total = 0.0
    for value in values:
        total += 1 / value
    return total


def test_a_compiled_loop_has_the_result_of_its_python() -> None:
    values = np.linspace(0.5, 3.0, 101)
    assert compiled(_sum_of_inverses)(values) == _sum_of_inverses(values)


def test_a_division_by_zero_is_an_infinity_as_in_numpy() -> None:
    assert compiled(_sum_of_inverses)(np.zeros(1)) == np.inf


def test_where_no_machine_code_can_be_kept_it_is_compiled_in_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    njit = numba.njit

    def without_a_place(**options: Any) -> Any:
        if options.get("cache"):
            raise RuntimeError("cannot cache function: no locator available")
        return njit(**options)

    monkeypatch.setattr(numba, "njit", without_a_place)
    assert compiled(_sum_of_inverses)(np.array([4.0])) == 0.25
