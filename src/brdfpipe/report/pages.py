"""What both kinds of page share: the templates, and how a number is written."""

from __future__ import annotations

import math
import re
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup, escape
from numpy.typing import ArrayLike

from brdfpipe.report.svg import minus

if TYPE_CHECKING:
    from jinja2 import Environment

TEMPLATES = Path(__file__).parent / "templates"

MISSING = "–"
"""How a number that is not known is written."""

VERDICTS = ("fail", "warn", "pass")
"""Worst first."""

_MARKS = {"pass": "✓", "warn": "!", "fail": "✕"}
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def render(template: str, **context: Any) -> str:
    """A page from its template; every value that is not :class:`Markup` is escaped."""
    return _environment().get_template(template).render(**context)


def number(value: float, digits: int = 3) -> str:
    """A number to some significant digits, with a true minus sign; ``–`` where it is not known."""
    value = float(value)
    if not math.isfinite(value):
        return MISSING
    if value == 0:
        return "0"
    exponent = math.floor(math.log10(abs(value)))
    if not -4 <= exponent < 6:
        mantissa = f"{value / 10.0**exponent:.{digits - 1}f}"
        return minus(mantissa) + "×10" + str(exponent).translate(_SUPERSCRIPT)
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


def colour(srgb: ArrayLike) -> str | None:
    """``#rrggbb`` of an sRGB colour (3,) in [0, 1]; None where it is not known."""
    channels = np.asarray(srgb, dtype=float)
    if channels.shape != (3,) or not np.isfinite(channels).all():
        return None
    red, green, blue = (np.clip(channels, 0, 1) * 255).round().astype(int).tolist()
    return f"#{red:02x}{green:02x}{blue:02x}"


def with_code(text: object) -> Markup:
    """Text with its ``backticked`` parts set as code; all of it escaped."""
    return Markup(re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(text))))


def worst(verdicts: list[str]) -> str:
    """The worst of some verdicts; empty where there is none."""
    return next((verdict for verdict in VERDICTS if verdict in verdicts), "")


@cache
def _environment() -> Environment:
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["code"] = with_code
    environment.globals["mark"] = _MARKS
    environment.globals["style"] = Markup((TEMPLATES / "style.css").read_text("utf-8"))
    return environment
