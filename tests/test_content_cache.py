"""A cache of what is computed from arrays: the same content is computed once, any other again."""

from __future__ import annotations

import numpy as np
import pytest

from brdfpipe.content_cache import cached_by_content


@pytest.fixture
def counted():
    """A cached sum of two arrays for two results, and the arguments for which it was computed."""
    computed = []

    @cached_by_content(2)
    def total(one, other):
        """A sum."""
        computed.append((one, other))
        return one.sum() + other.sum()

    return total, computed


def test_the_same_content_is_computed_once(counted) -> None:
    total, computed = counted
    given = np.arange(6.0).reshape(2, 3)
    assert total(given, given[:, ::-1]) == total(given.copy(), given[:, ::-1].copy()) == 30
    assert len(computed) == 1


@pytest.mark.parametrize(
    "other",
    [np.arange(6.0).reshape(3, 2), np.arange(6).reshape(2, 3), np.arange(1.0, 7.0).reshape(2, 3)],
    ids=["shape", "type", "values"],
)
def test_another_shape_type_or_value_is_computed_again(counted, other) -> None:
    total, computed = counted
    given = np.arange(6.0).reshape(2, 3)
    total(given, given)
    assert total(other, given) == other.sum() + given.sum()
    assert len(computed) == 2


def test_arrays_that_were_changed_in_place_are_computed_again(counted) -> None:
    total, _ = counted
    given = np.zeros(3)
    assert total(given, given) == 0
    given[0] = 1
    assert total(given, given) == 2


def test_the_result_that_was_not_used_for_longest_is_forgotten(counted) -> None:
    total, computed = counted
    one, two, three = np.eye(3)
    for first in (one, two, one, three, one, two):
        total(first, one)
    assert [int(first.argmax()) for first, _ in computed] == [0, 1, 2, 1]


def test_the_function_keeps_its_documentation(counted) -> None:
    assert counted[0].__doc__ == "A sum."
