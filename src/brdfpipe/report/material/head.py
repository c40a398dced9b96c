"""Head of the page: key numbers, one tile for each appearance quantity, and the rendered picture."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import groupby

import xarray as xr
from markupsafe import Markup

from brdfpipe.appearance.quantities import AppearanceQuantity, quantities, quantities_on_request
from brdfpipe.report.formatting import length, number, value_with_u
from brdfpipe.report.plots.svg import Figure, png

_LIGHTS = {
    "studio": "three soft boxes and a dim sky",
    "sun": "a small sun and a clear sky",
    "overcast": "an overcast sky",
}


@dataclass(frozen=True)
class KeyNumber:
    """A tile."""

    name: str
    value: str
    unit: str = ""
    hint: str = ""


def key_numbers(datasets: Mapping[str, xr.Dataset]) -> Iterator[KeyNumber]:
    """Tiles of the quantities that are known and apply to the material."""
    every = [quantity for quantity in (*quantities(), *quantities_on_request()) if quantity.listed]
    for title, group in groupby(every, key=lambda quantity: quantity.tile or quantity.label):
        values = {quantity: quantity.value(datasets) for quantity in group}
        if any(math.isfinite(value) for value in values.values()):
            texts, units = zip(
                *(_value_and_unit(one, value, one.uncertainty(datasets)) for one, value in values.items()), strict=True
            )
            hint = next(iter(values)).hint
            yield KeyNumber(title, "  ".join(texts), units[0], hint if isinstance(hint, str) else hint(datasets))


def _value_and_unit(quantity: AppearanceQuantity, value: float, u: float) -> tuple[str, str]:
    """A value with its uncertainty, where that is known, and its unit."""
    if quantity.unit == "um":
        return length(value)
    if quantity.percent:
        return value_with_u(100 * value, 100 * u, max(quantity.decimals - 2, 0)), "%"
    text = number(value, quantity.significant) if quantity.significant else value_with_u(value, u, quantity.decimals)
    return text, {"1": "", "cd m-2": "cd/m²"}.get(quantity.unit, quantity.unit)


def picture(preview: xr.Dataset | None) -> Figure | None:
    """The preview as a figure; None without one."""
    if preview is None:
        return None
    pixels = preview["picture"].values
    subject = f"Sphere and flat panel under {_LIGHTS.get(str(preview.attrs['light']), 'lights')}"
    markup = Markup('<img class="look" src="{}" width="{}" height="{}" alt="{}">')
    note = (
        f"{subject}, spectrum of {preview.attrs['illuminant']}. Rendered from the BRDF. The exposure is the same for every material: "
        f"a perfect white diffuser reaches {100 * float(preview.attrs['white_level']):.0f} % of the screen's white. Brighter light is "
        "compressed."
    )
    return Figure("Preview", markup.format(png(pixels), pixels.shape[1], pixels.shape[0], subject), note=note)
