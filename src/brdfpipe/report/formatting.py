"""How numbers, units and the basis of a value are written on the pages."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Sequence

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from brdfpipe.report.plots.svg import minus, power_of_ten

MISSING = "–"
"""A number that is not known."""

STANDARD = "±: k = 1"
"""In titles of tables: the uncertainties are standard uncertainties."""

EXPANDED_UNCERTAINTY = "± 2 standard uncertainties"

_UNITS = {"degree": "°", "sr-1": "sr⁻¹", "1": "", "nm": "nm"}
_NANOMETRES_BELOW = 0.1
"""Lengths below this are written in nm [µm]."""

SMALLEST_SHARE = 1e-5
"""Smaller shares of the light have no meaning: no model and no measurement is as exact."""
_SMALLEST_UNCERTAINTY = 0.01
"""Smaller uncertainties of gloss units and colours are not written as numbers."""
_LARGEST_UNCERTAINTY = 100.0
"""Nor are larger ones: gloss units of bodies, L* and percentages end there."""
NOT_KNOWN, NOT_DETERMINED = "not known", "not determined"

_BASIS = {
    "measured": "at a measured angle",
    "interpolated": "between measured angles",
    "extrapolated": "beyond the measured angles",
    "completed": "includes directions that were not measured",
}


def number(value: float, digits: int = 3) -> str:
    """A number to some significant digits, with a true minus sign; ``–`` where it is not known."""
    value = float(value)
    if not math.isfinite(value):
        return MISSING
    if value == 0:
        return "0"
    exponent = math.floor(math.log10(abs(value)))
    if not -4 <= exponent < 6:
        return f"{minus(f'{value / 10.0**exponent:.{digits - 1}f}')}×{power_of_ten(exponent)}"
    return fixed(value, max(0, digits - 1 - exponent))


def fixed(value: float, decimals: int) -> str:
    """A number to some decimals, with a true minus sign and never −0; ``–`` where it is not known."""
    value = float(value)
    if not math.isfinite(value):
        return MISSING
    return minus(f"{round(value, decimals) + 0.0:.{decimals}f}")


def grouped(count: float) -> str:
    """A count with thin spaces between its thousands."""
    return f"{count:,.0f}".replace(",", "\u202f") if math.isfinite(count) else MISSING


def percent(share: float, digits: int = 2) -> str:
    """A share [1] in percent, to some significant digits."""
    return f"{number(100 * share, digits)}\u202f%"


def share_percent(share: float) -> str:
    """A share [1] of the light in percent: three significant digits from 1 % on, two below; ``less than 0.001 %`` instead of a smaller one."""
    if 0 < share < SMALLEST_SHARE:
        return f"less than {100 * SMALLEST_SHARE:g}\u202f%"
    return percent(share, 3 if share >= 0.01 else 2)


def plus_minus_u(u: float) -> str:
    """``± u`` to two decimals, one below them rounded up to 0.01; empty where the uncertainty is not known."""
    return f"± {uncertainty_value(rounded_up(u))}" if math.isfinite(u) else ""


def rounded_up(u: float) -> float:
    """An uncertainty of gloss units or colours, one below 0.01 rounded up to it."""
    return max(u, _SMALLEST_UNCERTAINTY) if u > 0 else u


def uncertainty_value(u: float) -> str:
    """An uncertainty to two decimals, ``< 0.01`` below them, ``0`` for none; ``not known`` where it is larger than the scale."""
    if u == 0 or not math.isfinite(u):
        return "0" if u == 0 else MISSING
    if u > _LARGEST_UNCERTAINTY:
        return NOT_KNOWN
    return fixed(u, 2) if u >= _SMALLEST_UNCERTAINTY else f"< {_SMALLEST_UNCERTAINTY:g}"


def value_with_u(value: float, u: float, decimals: int) -> str:
    """``45.2 ± 1.3``; a smaller uncertainty has up to two decimals more, and is left out if these do not show it; a large one has fewer."""
    if not math.isfinite(u):
        return fixed(value, decimals)
    if u > _LARGEST_UNCERTAINTY:
        return f"{fixed(value, decimals)} ± {NOT_KNOWN}"
    shown = decimals_with_u(u, decimals)
    return f"{fixed(value, shown)} ± {fixed(u, shown)}" if round(u, shown) > 0 else fixed(value, shown)


def decimals_with_u(u: float, decimals: int) -> int:
    """Decimals that an uncertainty leaves to a value: up to two more than ``decimals`` for a small one, none for one from 10 on."""
    if not u <= _LARGEST_UNCERTAINTY:
        return decimals
    if u >= 10:
        return 0
    return next((digits for digits in range(decimals, decimals + 3) if round(u, digits) > 0), decimals)


def length(micrometres: float) -> tuple[str, str]:
    """A length and its unit, µm or nm."""
    if 0 < abs(micrometres) < _NANOMETRES_BELOW:
        return number(1000 * micrometres), "nm"
    return number(micrometres), "µm"


def quantity(scalar: xr.DataArray) -> str:
    """A scalar variable with its unit."""
    units = str(scalar.attrs.get("units", ""))
    value, unit = length(float(scalar)) if units == "um" else (number(float(scalar)), _UNITS.get(units, units))
    if value == MISSING or not unit:
        return value
    return value + unit if unit == "°" else f"{value} {unit}"


def colour(srgb: ArrayLike) -> str | None:
    """``#rrggbb`` of an sRGB colour (3,) in [0, 1]; None where it is not known."""
    channels = np.asarray(srgb, dtype=float)
    if channels.shape != (3,) or not np.isfinite(channels).all():
        return None
    red, green, blue = (np.clip(channels, 0, 1) * 255).round().astype(int).tolist()
    return f"#{red:02x}{green:02x}{blue:02x}"


def labels(values: xr.DataArray, dimension: str) -> list[str]:
    """Names along a dimension; numbers from 1 where it has none."""
    if dimension in values.coords:
        return [str(name) for name in values[dimension].values]
    return [str(k + 1) for k in range(values.sizes[dimension])]


def attribute_note(dataset: xr.Dataset, names: Sequence[str]) -> str:
    """Attributes of a dataset as sentences, ``Name: value.``"""
    sentences = [f"{name.capitalize()}: {dataset.attrs[name]}." for name in names if dataset.attrs.get(name)]
    return re.sub(r"\bum\b", "µm", " ".join(sentences))


def basis_legend(flags: Collection[str]) -> str:
    """What the quality flags in a table mean."""
    return "Basis: " + "; ".join(f"{flag}, {_BASIS[flag]}" for flag in _BASIS if flag in flags) + "."
