"""Key numbers at the head of the page, one tile for each appearance quantity."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import groupby

import xarray as xr

from brdfpipe.appearance.quantities import AppearanceQuantity, quantities
from brdfpipe.report.formatting import fixed, length, number


@dataclass(frozen=True)
class KeyNumber:
    """A tile."""

    name: str
    value: str
    unit: str = ""
    hint: str = ""


def key_numbers(datasets: Mapping[str, xr.Dataset]) -> Iterator[KeyNumber]:
    """Tiles of the quantities that are known and apply."""
    shown = [quantity for quantity in quantities() if quantity.on_page]
    for title, group in groupby(shown, key=lambda quantity: quantity.tile_title):
        values = {quantity: quantity.value(datasets) for quantity in group}
        if any(math.isfinite(value) for value in values.values()):
            texts, units = zip(*(_value_and_unit(*item) for item in values.items()), strict=True)
            yield KeyNumber(title, "  ".join(texts), units[0], next(iter(values)).hint_words(datasets))


def _value_and_unit(quantity: AppearanceQuantity, value: float) -> tuple[str, str]:
    if quantity.unit == "um":
        return length(value)
    if quantity.percent:
        return fixed(100 * value, max(quantity.decimals - 2, 0)), "%"
    text = number(value, quantity.significant) if quantity.significant else fixed(value, quantity.decimals)
    return text, "" if quantity.unit == "1" else quantity.unit
