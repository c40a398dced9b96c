from __future__ import annotations

import math

import pytest

from brdfpipe.errors import plain
from brdfpipe.report.formatting import length, plus_minus_u, share_percent, uncertainty_value, value_with_u


@pytest.mark.parametrize(
    ("micrometres", "words"), [(0.943, "0.943 µm"), (0.00135, "1.35 nm"), (12.0, "12.0 µm"), (0.0, "0 µm")]
)
def test_small_heights_are_written_in_nanometres(micrometres: float, words: str) -> None:
    assert " ".join(length(micrometres)) == words


@pytest.mark.parametrize(
    ("value", "digits", "words"),
    [(1470.4, 3, "1470"), (123456.0, 3, "123000"), (2.0, 4, "2"), (0.000123456, 3, "0.000123"), (0.0, 3, "0")],
)
def test_lengths_in_messages_have_no_exponent(value: float, digits: int, words: str) -> None:
    assert plain(value, digits) == words


@pytest.mark.parametrize(
    ("share", "words"),
    [(0.0, "0 %"), (3.8e-16, "less than 0.001 %"), (1e-5, "0.0010 %"), (0.00344, "0.34 %"), (0.123, "12.3 %")],
)
def test_shares_too_small_to_mean_anything_have_no_digits(share: float, words: str) -> None:
    assert share_percent(share).replace("\u202f", " ") == words


@pytest.mark.parametrize(("u", "words"), [(0.0, "0"), (0.004, "< 0.01"), (0.0123, "0.01"), (1.234, "1.23")])
def test_a_known_uncertainty_is_never_written_as_none(u: float, words: str) -> None:
    assert uncertainty_value(u) == words


@pytest.mark.parametrize(("u", "words"), [(0.0, "± 0"), (0.0004, "± 0.01"), (1.234, "± 1.23"), (math.nan, "")])
def test_beside_a_value_a_small_uncertainty_is_rounded_up(u: float, words: str) -> None:
    assert plus_minus_u(u) == words


@pytest.mark.parametrize(
    ("value", "u", "words"),
    [
        (45.24, 1.31, "45.2 ± 1.3"),
        (0.084, 0.004, "0.084 ± 0.004"),
        (75.94, 49.2, "76 ± 49"),
        (75.94, 2e6, "75.9 ± not known"),
        (75.94, math.nan, "75.9"),
    ],
)
def test_a_value_has_the_digits_that_its_uncertainty_leaves(value: float, u: float, words: str) -> None:
    assert value_with_u(value, u, 1) == words
