"""Head of the page: key numbers, one tile for each appearance quantity, and the rendered pictures."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe.appearance.quantities import AppearanceQuantity
from brdfpipe.report.formatting import length, number, rounded_up, value_with_u
from brdfpipe.report.plots.svg import data_uri

_LIGHTS = {
    "studio": ("Soft boxes", "three soft boxes and a dim sky"),
    "sun": ("Sun", "a small sun and a clear sky"),
    "overcast": ("Overcast sky", "an overcast sky"),
    "spot": ("Spot lamp", "one lamp in a dim room"),
    "tubes": ("Rows of tubes", "four rows of tubes"),
}
"""By light of the preview: its name, and what it is."""

_SUBJECTS = ("sphere", "flat panel", "moulded part")


@dataclass(frozen=True)
class KeyNumber:
    """A tile."""

    name: str
    value: str
    unit: str = ""
    hint: str = ""


def key_numbers(datasets: Mapping[str, xr.Dataset], known: Mapping[AppearanceQuantity, float]) -> Iterator[KeyNumber]:
    """Tiles of the quantities that are known and apply to the material; ``known`` are :func:`brdfpipe.appearance.quantities.values` of it."""
    every = [quantity for quantity in known if quantity.listed]
    for title, group in groupby(every, key=lambda quantity: quantity.tile or quantity.label):
        values = {quantity: known[quantity] for quantity in group}
        if any(math.isfinite(value) for value in values.values()):
            texts, units = zip(
                *(_value_and_unit(one, value, one.uncertainty(datasets)) for one, value in values.items()), strict=True
            )
            hint = next(iter(values)).hint
            # A narrow page breaks lines between values only.
            values_alone = (text.replace(" ", "\N{NO-BREAK SPACE}") for text in texts)
            yield KeyNumber(title, "  ".join(values_alone), units[0], hint if isinstance(hint, str) else hint(datasets))


def _value_and_unit(quantity: AppearanceQuantity, value: float, u: float) -> tuple[str, str]:
    """A value with its uncertainty, where that is known, and its unit."""
    if quantity.unit == "um":
        return length(value)
    if quantity.percent:
        return value_with_u(100 * value, 100 * u, max(quantity.decimals - 2, 0)), "%"
    if quantity.significant:
        text = number(value, quantity.significant)
    else:
        # As in the tables of gloss and colours below.
        text = value_with_u(value, rounded_up(u) if quantity.decimals <= 1 else u, quantity.decimals)
    return text, {"1": "", "cd m-2": "cd/m²"}.get(quantity.unit, quantity.unit)


@dataclass(frozen=True)
class Look:
    """The material in one light."""

    name: str
    pictures: tuple[tuple[str, str], ...]
    """What is shown, and its data URI"""


@dataclass(frozen=True)
class Looks:
    """The material in every light of its preview, that of the scene first."""

    lights: tuple[Look, ...]
    side: int
    note: str


def looks(preview: xr.Dataset | None) -> Looks | None:
    """The preview as pictures of its subjects; None without one."""
    if preview is None:
        return None
    shown = [(str(preview.attrs["light"]), str(preview.attrs["illuminant"]), preview["picture"].values)]
    if "picture_in" in preview:
        others = (preview[name].values for name in ("light_of", "illuminant_of", "picture_in"))
        shown += [(str(light), str(illuminant), pixels) for light, illuminant, pixels in zip(*others, strict=True)]
    side = preview.sizes["row"]
    subjects = _SUBJECTS[: preview.sizes["column"] // side]
    return Looks(
        tuple(_look(*light, subjects) for light in shown),
        side,
        f"Rendered from the BRDF, for an eye adapted to the light. The exposure is the same for every material: a perfect white diffuser reaches "
        f"{100 * float(preview.attrs['white_level']):.0f} % of the screen's white, and brighter light is compressed. The part has no shadows of "
        "its own. See where highlights lie on the ribs and how sharp their edges are.",
    )


def _look(light: str, illuminant: str, pixels: NDArray[np.uint8], subjects: Sequence[str]) -> Look:
    name, words = _LIGHTS.get(light, (light, "lights"))
    pictures = np.split(pixels, len(subjects), axis=1)
    described = (f"{subject.capitalize()} in the light of {words}, {illuminant}" for subject in subjects)
    return Look(f"{name}, {illuminant}", tuple(zip(described, map(_jpeg, pictures), strict=True)))


def _jpeg(pixels: NDArray[np.uint8]) -> str:
    """Data URI of a picture (rows, columns, 3): a third of the size of a PNG, with colours at every pixel."""
    from PIL import Image

    return data_uri(Image.fromarray(np.ascontiguousarray(pixels)), "jpeg", quality=90, subsampling=0)
