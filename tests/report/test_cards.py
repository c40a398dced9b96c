"""A table takes the width that its columns need."""

from __future__ import annotations

import pytest

from brdfpipe.report.cards import Table


@pytest.mark.parametrize(
    ("header", "row", "broad"),
    [
        (("Quantity", "Value"), ("Gloss 60°", "100.2"), False),
        (("Parameter", "Value", "Definition"), ("Sq", "0.943 µm", 80 * "x"), False),
        (
            ("Incidence", "g", "Reference", "Peak", "Shoulder", "Rest"),
            ("75°", "30", "Traced rays", *["−10.0 % ± 1.0 %"] * 3),
            True,
        ),
        (("Incidence", *"abcdefghi"), ("0°", *["100 %"] * 9), True),
        (("Files", "Error"), ("grain.parameters.json", 900 * "x"), False),
    ],
)
def test_a_table_of_many_or_long_columns_is_as_wide_as_the_page(
    header: tuple[str, ...], row: tuple[str, ...], broad: bool
) -> None:
    assert Table("", header, [row]).broad is broad


def test_a_table_without_rows_or_columns_is_narrow() -> None:
    assert not Table("", (), []).broad
