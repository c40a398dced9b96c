"""Pictures of fields in false colour: the colours, the colour bar, and a raster image in its axes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from brdfpipe.report.plots.svg import Array, frame, image, linear_ticks, png, text

_MISSING_COLOUR = (240, 90, 120)
_LEVELS = 160

DISC_CENTRE = (212.0, 186.0)
"""Of a picture of the hemisphere, figure units"""
DISC_RADIUS = 158.0

Ticks = Sequence[tuple[float, str]]
"""(fraction of the bar from its lower end, label)"""


def false_colour(
    values: Array, low: float, high: float, levels: int = _LEVELS
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Palette indices, top row first, and the palette; the last index is the missing one.

    Parameters
    ----------
    values : (rows, columns), rows upwards; NaN where missing
    low, high : values of the first and the last colour
    levels : number of colours; few of them look like contours
    """
    level = np.clip((values[::-1] - low) / (high - low), 0, 1) * levels
    missing = np.isnan(level)
    indices = np.where(missing, levels, np.minimum(np.where(missing, 0, level), levels - 1)).astype(np.uint8)
    return indices, np.vstack([viridis(np.linspace(0, 1, levels)), [_MISSING_COLOUR]]).astype(np.uint8)


def framed(
    description: str,
    uri: str,
    x: tuple[str, float, float],
    y: tuple[str, float, float],
    unit: str,
    bar: Ticks,
    *,
    levels: int = 64,
) -> tuple[Markup, bool]:
    """An image in its axes with a colour bar, x and y to one scale unless that would leave a mere line.

    Parameters
    ----------
    description : what a person who cannot see it should know
    uri : data URI of the image
    x, y : label, low and high of each axis
    unit : what the colours mean
    bar : ticks of the colour bar
    levels : number of colours of the bar

    Returns
    -------
    The figure, and whether x and y are to one scale
    """
    extent_x, extent_y = x[2] - x[1], y[2] - y[1]
    top, room_x, room_y = 28.0, 370.0, 400.0
    scale = min(room_x / extent_x, room_y / extent_y)
    wide, tall = max(extent_x * scale, 120.0), max(extent_y * scale, 120.0)
    left = 54 + (room_x - wide) / 2
    height = top + tall + 46
    parts = [image(uri, left, top, wide, tall), f'<path class="a" d="M{left:g} {top:g}v{tall:.1f}h{wide:.1f}"/>']
    for position, name in linear_ticks(x[1], x[2], count=max(2, round(5 * wide / room_x))):
        at = left + wide * (position - x[1]) / extent_x
        parts.append(f'<path class="a" d="M{at:.1f} {top + tall:.1f}v4"/>')
        parts.append(text(at, top + tall + 17, name, "middle"))
    for position, name in linear_ticks(y[1], y[2], count=5 if tall > 200 else 4):
        at = top + tall * (y[2] - position) / extent_y
        parts.append(f'<path class="a" d="M{left:g} {at:.1f}h-4"/>')
        parts.append(text(left - 7, at + 4, name, "end"))
    parts.append(text(left + wide / 2, height - 8, x[0], "middle", "t"))
    parts.append(text(left - 50, 15, y[0], "start", "t"))
    parts += _colour_bar(left + wide + 18, top, tall, unit, bar, levels)
    return frame(description, height, parts), bool(np.isclose(wide / extent_x, tall / extent_y, rtol=1e-6))


def disc(
    description: str, uri: str, margin: float, unit: str, bar: Ticks, signs: Sequence[str], *, levels: int = 64
) -> Markup:
    """A picture of the hemisphere of directions, seen along the normal, with a colour bar.

    Parameters
    ----------
    description : what a person who cannot see it should know
    uri : data URI of the image
    margin : direction cosine at its edges, a little above 1
    unit : what the colours mean
    bar : ticks of the colour bar
    signs : marks on the disc, in figure units (:func:`on_disc`)
    levels : number of colours of the bar
    """
    side = 2 * DISC_RADIUS * margin
    left, top = DISC_CENTRE[0] - side / 2, DISC_CENTRE[1] - side / 2
    parts = [image(uri, left, top, side, side, smooth=True)]
    for angle in (30, 60, 90):
        r = DISC_RADIUS * np.sin(np.radians(angle))
        style = "a" if angle == 90 else "v"
        parts.append(f'<circle class="{style}" cx="{DISC_CENTRE[0]:g}" cy="{DISC_CENTRE[1]:g}" r="{r:.1f}"/>')
        parts.append(
            text(
                DISC_CENTRE[0],
                DISC_CENTRE[1] - r + (14 if angle < 90 else -6),
                f"{angle}°",
                "middle",
                "w" if angle < 90 else "",
            )
        )
    parts += signs
    parts += _colour_bar(410, DISC_CENTRE[1] - DISC_RADIUS, 2 * DISC_RADIUS, unit, bar, levels)
    return frame(description, DISC_CENTRE[1] + DISC_RADIUS + 14, parts)


def on_disc(theta: float, azimuth: float) -> tuple[float, float]:
    """Where a direction stands on a disc, in figure units; azimuth 0 to the right, counter-clockwise [degree]."""
    r = DISC_RADIUS * np.sin(np.radians(theta))
    return DISC_CENTRE[0] + r * np.cos(np.radians(azimuth)), DISC_CENTRE[1] - r * np.sin(np.radians(azimuth))


def _colour_bar(x: float, top: float, tall: float, unit: str, ticks: Ticks, levels: int) -> list[str]:
    ramp = viridis(np.linspace(1, 0, levels))[:, None, :]
    # A long unit ends at the picture's edge instead of starting at the bar.
    parts = [image(png(ramp), x, top, 12, tall), text(x + 12, 15, unit, "end", "t")]
    for fraction, name in ticks:
        at = top + tall * (1 - fraction)
        parts.append(f'<path class="a" d="M{x + 12:.1f} {at:.1f}h4"/>')
        parts.append(text(x + 19, at + 4, name))
    return parts


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
