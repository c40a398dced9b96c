"""A small chart kit: numpy arrays in, inline SVG out.

Colours and type come from the page's style sheet through class names, so that a figure follows the page into dark mode and
onto paper. Nothing here needs an ``id``: two figures on one page cannot clash, and equal data gives equal bytes.
"""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from typing import Literal

import numpy as np
from markupsafe import Markup, escape
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

WIDTH = 520
"""Width of every figure, in its own units; type is 12 units high."""

_PATTERN = {"line": "", "dash": " d", "dots": " o"}
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True)
class Axis:
    """One axis of a chart: what it shows, from where to where."""

    label: str
    low: float
    high: float
    log: bool = False
    step: float | None = None
    """Distance between ticks; chosen where None."""
    at: tuple[float, ...] = ()
    """Positions of the ticks; chosen where empty."""

    def place(self, values: ArrayLike) -> Array:
        """Fraction of the axis, 0 to 1, at which values stand; values that a log axis cannot show stand far below it."""
        values = np.asarray(values, dtype=float)
        if not self.log:
            return np.asarray((values - self.low) / (self.high - self.low))
        low, high = np.log10([self.low, self.high])
        logs = np.where(np.isnan(values), np.nan, np.log10(np.maximum(values, self.low * 1e-3)))
        return np.asarray((logs - low) / (high - low))

    def ticks(self) -> list[tuple[float, str]]:
        """Positions and labels of the ticks."""
        if self.at:
            return [(value, f"{value:g}") for value in self.at]
        if self.log:
            return _log_ticks(self.low, self.high)
        return linear_ticks(self.low, self.high, self.step)

    def minor(self) -> list[float]:
        """Positions of unlabelled ticks: 2 to 9 of each decade, where there is room for them."""
        if not self.log or self.at or np.log10(self.high / self.low) > 4.5:
            return []
        decades = np.arange(np.floor(np.log10(self.low)), np.ceil(np.log10(self.high)))
        values = (10.0 ** decades[:, None] * np.arange(2, 10)).ravel()
        return [float(value) for value in values if self.low <= value <= self.high]


@dataclass(frozen=True)
class Line:
    """A curve; NaN breaks it."""

    x: ArrayLike
    y: ArrayLike
    style: str = "c0"
    label: str = ""
    pattern: Literal["line", "dash", "dots"] = "line"


@dataclass(frozen=True)
class Points:
    """Points with error bars; a bar of NaN is not drawn, a point of NaN neither."""

    x: ArrayLike
    y: ArrayLike
    error: ArrayLike
    style: str = "c0"
    label: str = ""


@dataclass(frozen=True)
class Band:
    """The area between two curves over the same x."""

    x: ArrayLike
    low: ArrayLike
    high: ArrayLike
    style: str = "c0"
    label: str = ""


Mark = Line | Points | Band


@dataclass(frozen=True)
class Figure:
    """A picture with its caption, ready for the template."""

    title: str
    svg: Markup
    legend: tuple[tuple[str, str, str], ...] = ()
    """(shape, style, label), shape one of ``line``, ``dash``, ``dots``, ``points``, ``area``."""
    note: str = ""


def sentence(title: str, words: str) -> Figure:
    """What is said where a picture would be empty."""
    return Figure(title, Markup(""), note=words)


def legend(marks: Sequence[Mark]) -> tuple[tuple[str, str, str], ...]:
    """The legend of a chart's labelled marks; a single mark needs none beside the caption."""
    entries = tuple((_shape(mark), mark.style, mark.label) for mark in marks if mark.label)
    return entries if len(entries) > 1 else ()


def _shape(mark: Mark) -> str:
    if isinstance(mark, Band):
        return "area"
    return "points" if isinstance(mark, Points) else mark.pattern


def chart(description: str, x: Axis, y: Axis, marks: Sequence[Mark], *, height: int = 300, strip: str = "") -> Markup:
    """A Cartesian chart.

    Parameters
    ----------
    description : what a person who cannot see it should know
    marks : drawn in order, clipped to the axes
    height : figure units
    strip : data URI of an image laid along the x axis
    """
    left, right, top, bottom = 54, 16, 28, 46 + (10 if strip else 0)
    width, tall = WIDTH - left - right, height - top - bottom
    parts = [*_grid(x, y, left, top, width, tall)]
    if strip:
        parts.append(image(strip, left, top + tall + 3, width, 9))
    # A nested svg clips to its own box without a clipPath, which would need an id.
    parts.append(f'<svg x="{left}" y="{top}" width="{width}" height="{tall}">')
    parts += [_mark(mark, x, y, width, tall) for mark in marks]
    parts.append("</svg>")
    drop = 27 if strip else 17
    parts += [
        text(left + width * float(x.place(value)), top + tall + drop, name, "middle") for value, name in x.ticks()
    ]
    parts.append(text(left + width / 2, height - 8, x.label, "middle", "t"))
    parts.append(text(4, 15, y.label, "start", "t"))
    return frame(description, height, parts)


def polar(
    description: str,
    decades: tuple[int, int],
    marks: Sequence[Line],
    sources: Sequence[tuple[float, str]],
    below: Sequence[Line] = (),
    quantity: str = "BRDF",
) -> Markup:
    """A goniometric half disc, or a full one: angle from the normal, radius logarithmic.

    Parameters
    ----------
    description : what a person who cannot see it should know
    decades : exponents of ten at the centre and at the rim
    marks : x in degree from the normal (negative on the side of the source), y the value
    sources : where sources stand [degree], and the style of each
    below : the same from the lower normal, of the light that passes; without it the disc is a half one
    quantity : what the radius is
    """
    radius = 190.0 if below else 218.0
    centre_x, centre_y, height = WIDTH / 2, radius + 32, 2 * radius + 72 if below else 300
    low, high = decades
    axis = Axis("", 10.0**low, 10.0**high, log=True)
    parts: list[str] = []
    for exponent in range(low + 1, high + 1):
        r = radius * (exponent - low) / (high - low)
        half = f"a{r:.1f} {r:.1f} 0 0 1 "
        rest = f"{half}{-2 * r:.1f} 0" if below else ""
        parts.append(f'<path class="g" d="M{centre_x - r:.1f} {centre_y:g}{half}{2 * r:.1f} 0{rest}"/>')
    for angle in range(-165, 181, 15) if below else range(-90, 91, 15):
        sine, cosine = np.sin(np.radians(angle)), np.cos(np.radians(angle))
        end_x, end_y = centre_x + radius * sine, centre_y - radius * cosine
        parts.append(f'<path class="g" d="M{centre_x:g} {centre_y:g}L{end_x:.1f} {end_y:.1f}"/>')
        if angle % 30 == 0:
            anchor = "middle" if angle % 180 == 0 else "start" if angle > 0 else "end"
            drop = 4 - 4 * cosine if below else 0.0
            at_y = centre_y - (radius + 8) * cosine + drop
            parts.append(text(centre_x + (radius + 8) * sine, at_y, f"{abs(angle)}°", anchor))
    parts += [_ray(mark, axis, centre_x, centre_y, radius, 1) for mark in marks]
    parts += [_source(centre_x, centre_y, radius, *source) for source in sources]
    parts += [_ray(mark, axis, centre_x, centre_y, radius, -1) for mark in below]
    parts.append(f'<path class="a" d="M{centre_x - radius:g} {centre_y:g}h{2 * radius:g}"/>')
    skip = max(1, round((high - low) / 4))
    halo = "h" if below else ""
    for exponent in range(high - skip if below else high, low, -skip):
        r = radius * (exponent - low) / (high - low)
        parts.append(text(centre_x + r, centre_y + 16, power_of_ten(exponent), "middle", halo))
    parts.append(text(centre_x, centre_y + 16, power_of_ten(low), "middle", halo))
    if below:
        parts.append(text(4, 15, "side of the source", "start", "t"))
        parts.append(
            text(centre_x + radius, height - 4, f"{quantity}, sr⁻¹ (log); rim {power_of_ten(high)}", "end", "t")
        )
    else:
        parts.append(text(centre_x - radius, centre_y + 16, "side of the source", "start", "t"))
        parts.append(text(centre_x + radius, height - 8, f"{quantity}, sr⁻¹ (log)", "end", "t"))
    return frame(description, height, parts)


def _ray(mark: Line, axis: Axis, centre_x: float, centre_y: float, radius: float, up: int) -> str:
    """A curve of a goniometric plot, on the upper (1) or lower (-1) half."""
    reach = radius * np.clip(axis.place(mark.y), 0, 1)
    angles = np.radians(np.asarray(mark.x, dtype=float))
    return path(
        centre_x + reach * np.sin(angles),
        centre_y - up * reach * np.cos(angles),
        f"l {mark.style}{_PATTERN[mark.pattern]}",
    )


def rose(description: str, unit: str, azimuth: ArrayLike, value: ArrayLike, axis: float) -> Markup:
    """A full disc: a positive quantity against azimuth, counter-clockwise from x, with one direction marked across it.

    Parameters
    ----------
    description : what a person who cannot see it should know
    unit : what the radius is
    azimuth : degree, all around
    value : > 0
    axis : degree; the direction that is marked, both ways
    """
    radius, centre_x, centre_y, height = 138.0, WIDTH / 2, 184.0, 368
    rings = linear_ticks(0, float(np.max(value)), count=4)[1:]
    scale = radius / max(rings[-1][0], 1.04 * float(np.max(value)))

    def place(degrees: ArrayLike, reach: ArrayLike) -> tuple[Array, Array]:
        turn = np.radians(np.asarray(degrees, dtype=float))
        return centre_x + reach * np.cos(turn), centre_y - reach * np.sin(turn)

    parts = [f'<circle class="g" cx="{centre_x:g}" cy="{centre_y:g}" r="{scale * ring:.1f}"/>' for ring, _ in rings]
    for angle in range(0, 360, 30):
        (end_x, end_y), (at_x, at_y) = place(angle, radius), place(angle, radius + 11)
        parts.append(f'<path class="g" d="M{centre_x:g} {centre_y:g}L{end_x:.1f} {end_y:.1f}"/>')
        anchor = "middle" if angle % 180 == 90 else "start" if end_x > centre_x else "end"
        name = {0: "0°, x", 90: "90°, y"}.get(angle, f"{angle}°")
        parts.append(text(float(at_x), float(at_y) + 4, name, anchor))
    ends_x, ends_y = place([axis, axis + 180], radius)
    parts.append(path(ends_x, ends_y, "l c3 d"))
    parts.append(path(*place(azimuth, scale * np.asarray(value, dtype=float)), "l c0", closed=True))
    # The ring labels stand beside the marked direction, where the curve is narrowest.
    for ring, name in rings:
        at_x, at_y = place(axis + 15, scale * ring)
        parts.append(text(float(at_x), float(at_y) + 4, name, "middle", "h"))
    parts.append(text(4, 15, unit, "start", "t"))
    return frame(description, height, parts)


def frame(description: str, height: float, parts: Sequence[str]) -> Markup:
    """The outer element: scales to its column, names itself to a screen reader."""
    return Markup(
        f'<svg class="fig" viewBox="0 0 {WIDTH} {height:g}" role="img" aria-label="{escape(description)}" '
        f'xmlns="http://www.w3.org/2000/svg">{"".join(parts)}</svg>'
    )


def text(x: float, y: float, content: str, anchor: str = "start", style: str = "") -> str:
    """A line of text; the content is escaped."""
    attribute = f' class="{style}"' if style else ""
    place = "" if anchor == "start" else f' text-anchor="{anchor}"'
    return f'<text x="{x:.1f}" y="{y:.1f}"{place}{attribute}>{escape(content)}</text>'


def image(uri: str, x: float, y: float, width: float, height: float, *, smooth: bool = False) -> str:
    """A raster image stretched over a box, pixels kept sharp unless ``smooth``."""
    sharp = "" if smooth else ' class="px"'
    return (
        f'<image x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" preserveAspectRatio="none"{sharp} '
        f'href="{uri}"/>'
    )


def png(pixels: NDArray[np.uint8], palette: NDArray[np.uint8] | None = None, *, clear: int | None = None) -> str:
    """Data URI of an image.

    Parameters
    ----------
    pixels : (rows, columns) palette indices, or (rows, columns, 3) sRGB
    palette : (≤256, 3) sRGB
    clear : the palette index that is transparent
    """
    from PIL import Image

    picture = Image.fromarray(np.ascontiguousarray(pixels))
    if palette is not None:
        picture.putpalette(palette.astype(np.uint8).tobytes())
    stream = BytesIO()
    options = {} if clear is None else {"transparency": clear}
    picture.save(stream, "PNG", optimize=False, compress_level=9, **options)
    return "data:image/png;base64," + b64encode(stream.getvalue()).decode("ascii")


def path(x: ArrayLike, y: ArrayLike, style: str, *, closed: bool = False) -> str:
    """A path through points in figure units; NaN breaks it, points that no eye can tell from a straight line are dropped."""
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    present = np.isfinite(x) & np.isfinite(y)
    breaks = np.flatnonzero(np.diff(present.astype(np.int8))) + 1
    pieces = [piece for piece in np.split(np.arange(x.size), breaks) if piece.size > 1 and present[piece[0]]]
    data = "".join(_piece(*_thin(x[piece], y[piece])) for piece in pieces)
    return f'<path class="{style}" d="{data}{"Z" if closed else ""}"/>' if data else ""


def linear_ticks(low: float, high: float, step: float | None = None, count: int = 6) -> list[tuple[float, str]]:
    """Ticks at round numbers, about ``count`` of them."""
    if step is None:
        raw = (high - low) / count
        power = 10.0 ** np.floor(np.log10(raw))
        step = float(power * next(nice for nice in (1, 2, 2.5, 5, 10) if nice * power >= raw * 0.999))
    first, last = np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9)
    values = np.arange(first, last + 1) * step
    decimals = _decimals(step)
    return [(float(value), minus(f"{value + 0.0:.{decimals}f}")) for value in values]


def nice_range(low: float, high: float, *, margin: float = 0.04) -> tuple[float, float]:
    """A range a little wider than the data, never empty."""
    if not np.isfinite([low, high]).all():
        return 0.0, 1.0
    span = high - low
    if span <= 0:
        span = abs(high) or 1.0
        return low - span / 2, high + span / 2
    return low - margin * span, high + margin * span


def power_of_ten(exponent: int) -> str:
    """A decade, written out where that is shorter: 0.01, 1, 100, 10⁻⁴."""
    if -2 <= exponent <= 3:
        return f"{10.0**exponent:g}"
    return "10" + str(exponent).translate(_SUPERSCRIPT)


def minus(number: str) -> str:
    """A number with a true minus sign."""
    return number.replace("-", "−")


def _decimals(step: float) -> int:
    for decimals in range(9):
        if abs(round(step, decimals) - step) < 1e-9 * step:
            return decimals
    return 9


def _log_ticks(low: float, high: float) -> list[tuple[float, str]]:
    first, last = int(np.ceil(np.log10(low) - 1e-9)), int(np.floor(np.log10(high) + 1e-9))
    if last - first < 2:
        values = [m * 10.0**e for e in range(first - 1, last + 1) for m in (1, 2, 5)]
        return [(value, f"{value:g}") for value in values if low * 0.999 <= value <= high * 1.001]
    skip = max(1, int(np.ceil((last - first) / 7)))
    return [(10.0**exponent, power_of_ten(exponent)) for exponent in range(last, first - 1, -skip)]


def _grid(x: Axis, y: Axis, left: float, top: float, width: float, tall: float) -> list[str]:
    ticks_x, ticks_y = x.ticks(), y.ticks()
    columns = [left + width * float(x.place(value)) for value, _ in ticks_x]
    rows = [top + tall * (1 - float(y.place(value))) for value, _ in ticks_y]
    minor = [top + tall * (1 - float(y.place(value))) for value in y.minor()]
    lines = "".join(f"M{column:.1f} {top}v{tall}" for column in columns)
    lines += "".join(f"M{left} {row:.1f}h{width}" for row in rows)
    small = "".join(f"M{left - 3} {row:.1f}h3" for row in minor)
    parts = [
        f'<path class="g" d="{lines}"/>',
        f'<path class="a" d="M{left} {top}v{tall}h{width}{small}"/>',
    ]
    parts += [text(left - 6, row + 4, name, "end") for row, (_, name) in zip(rows, ticks_y, strict=True)]
    return parts


def _mark(mark: Mark, x: Axis, y: Axis, width: float, tall: float) -> str:
    across = width * x.place(mark.x)
    if isinstance(mark, Line):
        return path(across, tall * (1 - y.place(mark.y)), f"l {mark.style}{_PATTERN[mark.pattern]}")
    if isinstance(mark, Points):
        return _points(mark, across, y, tall)
    low, high = tall * (1 - y.place(mark.low)), tall * (1 - y.place(mark.high))
    present = np.isfinite(low) & np.isfinite(high)
    across, low, high = across[present], low[present], high[present]
    limit = 4 * tall  # a lower edge far below the axis stays a short number
    low, high = np.clip(low, -limit, limit), np.clip(high, -limit, limit)
    return path(np.r_[across, across[::-1]], np.r_[high, low[::-1]], f"b {mark.style}", closed=True)


def _points(mark: Points, across: Array, y: Axis, tall: float) -> str:
    value, error = np.asarray(mark.y, dtype=float), np.asarray(mark.error, dtype=float)
    at, low, high = (tall * (1 - y.place(v)) for v in (value, value - error, value + error))
    dots = "".join(f"M{a:.1f} {b:.1f}h0" for a, b in zip(across, at, strict=True) if np.isfinite([a, b]).all())
    bars = "".join(
        f"M{a:.1f} {b:.1f}V{c:.1f}m-4 0h8M{a - 4:.1f} {b:.1f}h8"
        for a, b, c in zip(across, low, high, strict=True)
        if np.isfinite([a, b, c]).all()
    )
    return f'<path class="e {mark.style}" d="{bars}"/><path class="p {mark.style}" d="{dots}"/>'


def _source(centre_x: float, centre_y: float, radius: float, incidence: float, style: str) -> str:
    """A small triangle on the rim that points from the source to the centre."""
    degrees = -incidence
    x = centre_x + radius * np.sin(np.radians(degrees))
    y = centre_y - radius * np.cos(np.radians(degrees))
    return f'<path class="s {style}" transform="translate({x:.1f} {y:.1f})rotate({degrees:g})" d="M0 14l-4-14h8z"/>'


def _piece(x: Array, y: Array) -> str:
    points = [f"{a:.1f} {b:.1f}" for a, b in zip(x.tolist(), y.tolist(), strict=True)]
    return "M" + "L".join(points)


def _thin(x: Array, y: Array, tolerance: float = 0.06, passes: int = 5) -> tuple[Array, Array]:
    """Drop every second point that lies within the tolerance of its neighbours' chord, a few times over."""
    for _ in range(passes):
        if x.size < 8:
            break
        ax, ay, bx, by = x[:-2], y[:-2], x[2:], y[2:]
        dx, dy = bx - ax, by - ay
        length = np.hypot(dx, dy)
        away = np.abs(dx * (y[1:-1] - ay) - dy * (x[1:-1] - ax)) / np.where(length > 0, length, 1)
        # On a chord of no length, or past its end (a spike), the perpendicular distance says nothing.
        along = (dx * (x[1:-1] - ax) + dy * (y[1:-1] - ay)) / np.where(length > 0, length**2, 1)
        flat = (away < tolerance) & (length > 0) & (along >= 0) & (along <= 1)
        keep = np.ones(x.size, dtype=bool)
        keep[1:-1] = ~flat | (np.arange(1, x.size - 1) % 2 == 0)
        if keep.all():
            break
        x, y = x[keep], y[keep]
    return x, y
