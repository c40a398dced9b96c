"""Numbers of tables as text, against Python's own conversion."""

from __future__ import annotations

import numpy as np
import pytest

from brdfpipe.errors import BrdfpipeError
from brdfpipe.exchange import number_text


def test_text_agrees_with_python_to_half_a_unit_of_the_last_digit():
    generator = np.random.default_rng(0)
    values = np.concatenate(
        [10 ** generator.uniform(-98, 98, 20_000), 10.0 ** np.arange(-98, 98), [9.99994999, 9.999951, 9.9999999e-5]]
    )
    words = number_text.rows(values[:, None]).decode().split("\n")[:-1]
    read = np.array([float(word) for word in words])
    assert np.abs(read / values - 1).max() <= 5.001e-5
    written = np.array([float(f"{value:.4e}") for value in values])
    ties = np.abs(read / written - 1) > 1e-12
    assert ties.mean() < 1e-3


@pytest.mark.parametrize("digits", [2, 4, 6, 9, 12])
def test_any_number_of_digits_is_that_of_python(digits):
    values = 10 ** np.random.default_rng(1).uniform(-99, 98.9, 3000)
    found = number_text.rows(values[:, None], digits=digits).decode().split("\n")[:-1]
    wanted = [f"{value:.{digits - 1}e}" for value in values]
    # Ties, and the rounding of a power of ten in the last of twelve digits.
    assert np.mean([one != other for one, other in zip(found, wanted, strict=True)]) < 2e-3
    assert np.array(found, dtype=float) == pytest.approx(np.array(wanted, dtype=float), rel=2 * 10.0 ** (1 - digits))


def test_tables_of_several_batches_are_whole():
    values = np.random.default_rng(2).uniform(0, 1, (300, 500))
    assert np.array(number_text.rows(values).split(), dtype=float) == pytest.approx(values.ravel(), rel=5.001e-5)


def test_zero_and_what_is_too_small_for_two_digits_of_exponent_become_zero():
    assert number_text.rows(np.array([[0.0, 1e-300]])) == b"0.0000e+00\t0.0000e+00\n"


@pytest.mark.parametrize("value", [-1e-9, np.nan, np.inf, 1e99])
def test_values_that_are_no_bsdf_are_refused(value):
    with pytest.raises(BrdfpipeError, match="from 0 to 1e99"):
        number_text.rows(np.array([[1.0, value]]))


def test_columns_become_lines_of_one_width():
    columns = [number_text.texts(["0", "90"]), number_text.scientific(np.array([0.25, 3.0]), 3)]
    assert number_text.lines(columns) == b" 0,2.50e-01\n90,3.00e+00\n"


def test_an_empty_table_is_empty_text():
    assert number_text.rows(np.empty((0, 3))) == b""
