"""Rasters in false colour or in grey: the colour maps, the colour bar, and an image in its axes."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from brdfpipe.report.plots.svg import Array, frame, image, linear_ticks, png, text

_MISSING_COLOUR = (240, 90, 120)

Ticks = Sequence[tuple[float, str]]
"""(fraction of the colour bar from its lower end, label)"""
ColourMap = Callable[[Array], NDArray[np.uint8]]
"""Fractions (…) → (…, 3) sRGB."""


def viridis(fraction: Array) -> NDArray[np.uint8]:
    """The viridis colour map, (…, 3) sRGB, by the sixth-degree polynomial fit of M. Zucker (public domain)."""
    coefficients = np.array(
        [
            [0.2777273272, 0.0054073445, 0.3340998053],
            [0.1050930431, 1.4046135299, 1.3845901626],
            [-0.3308618287, 0.2148475595, 0.0950951630],
            [-4.6342304990, -5.7991009734, -19.3324409563],
            [6.2282699363, 14.1799333668, 56.6905526007],
            [4.7763849977, -13.7451453777, -65.3530326334],
            [-5.4354558559, 4.6458526122, 26.3124352496],
        ]
    )
    powers = np.asarray(fraction, dtype=float)[..., None] ** np.arange(7)
    return np.asarray((np.clip(powers @ coefficients, 0, 1) * 255).round(), dtype=np.uint8)


def light(fraction: Array) -> NDArray[np.uint8]:
    """Greys (…, 3) sRGB whose light is proportional to the fraction."""
    from brdfpipe.spectra.colorimetry import encoded_srgb

    grey = (255 * encoded_srgb(np.asarray(fraction, dtype=float))).round().astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=-1)


def false_colour(
    values: Array, low: float, high: float, levels: int = 160, colours: ColourMap = viridis
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Palette indices, top row first, and the palette, whose last colour is that of missing values.

    ``values`` has rows upwards and NaN where missing; ``low`` and ``high`` are those of the first and the last colour.
    """
    level = np.clip((values[::-1] - low) / (high - low), 0, 1) * levels
    missing = np.isnan(level)
    indices = np.where(missing, levels, np.minimum(np.where(missing, 0, level), levels - 1)).astype(np.uint8)
    return indices, np.vstack([colours(np.linspace(0, 1, levels)), [_MISSING_COLOUR]]).astype(np.uint8)


def framed(
    description: str,
    uri: str,
    x: tuple[str, float, float],
    y: tuple[str, float, float],
    unit: str,
    ticks: Ticks,
    *,
    levels: int = 64,
    colours: ColourMap = viridis,
) -> tuple[Markup, bool]:
    """An image in its axes (label, low, high) with a colour bar, and whether x and y have the same scale.

    They do, unless the image would be narrower than 24 figure units.
    """
    extent_x, extent_y = x[2] - x[1], y[2] - y[1]
    top, room_x, room_y = 28.0, 370.0, 400.0
    scale = min(room_x / extent_x, room_y / extent_y)
    wide, tall = max(extent_x * scale, 24.0), max(extent_y * scale, 24.0)
    left = 54 + (room_x - wide) / 2
    # The colour bar needs room for its labels.
    bar = max(tall, 110.0)
    height = top + max(tall + 46, bar + 8)
    parts = [image(uri, left, top, wide, tall), f'<path class="a" d="M{left:g} {top:g}v{tall:.1f}h{wide:.1f}"/>']
    for position, name in linear_ticks(x[1], x[2], count=max(2, round(5 * wide / room_x))):
        at = left + wide * (position - x[1]) / extent_x
        parts.append(f'<path class="a" d="M{at:.1f} {top + tall:.1f}v4"/>')
        parts.append(text(at, top + tall + 17, name, "middle"))
    for position, name in linear_ticks(y[1], y[2], count=5 if tall > 200 else max(1, round(tall / 30))):
        at = top + tall * (y[2] - position) / extent_y
        parts.append(f'<path class="a" d="M{left:g} {at:.1f}h-4"/>')
        parts.append(text(left - 7, at + 4, name, "end"))
    parts.append(text(left + wide / 2, top + tall + 38, x[0], "middle", "t"))
    parts.append(text(left - 50, 15, y[0], "start", "t"))
    parts += colour_bar(left + wide + 18, top, bar, unit, ticks, levels, colours)
    return frame(description, height, parts), bool(np.isclose(wide / extent_x, tall / extent_y, rtol=1e-6))


def colour_bar(
    x: float, top: float, tall: float, unit: str, ticks: Ticks, levels: int, colours: ColourMap = viridis
) -> list[str]:
    ramp = colours(np.linspace(1, 0, levels))[:, None, :]
    # The unit ends at the edge of the picture, as a long one would not fit to the right of the bar.
    parts = [image(png(ramp), x, top, 12, tall), text(x + 12, 15, unit, "end", "t")]
    if colours is light:  # which is white at one end, as the page may be
        parts.append(f'<path class="a" d="M{x:.1f} {top:.1f}h12v{tall:.1f}h-12z"/>')
    for fraction, name in ticks:
        at = top + tall * (1 - fraction)
        parts.append(f'<path class="a" d="M{x + 12:.1f} {at:.1f}h4"/>')
        parts.append(text(x + 19, at + 4, name))
    return parts
