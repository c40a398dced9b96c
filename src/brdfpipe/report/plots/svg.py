"""Charts as inline SVG, from numpy arrays.

Class names refer to the style sheet of the page, so that figures follow it into dark mode and onto paper. No element has an ``id``:
figures on one page cannot clash, and equal data gives equal bytes.
"""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass, field
from io import BytesIO
from typing import Any, ClassVar, Literal

import numpy as np
from markupsafe import Markup, escape
from numpy.typing import ArrayLike, NDArray

from brdfpipe.report.plots.figure_data import metadata, of_charts

Array = NDArray[np.float64]

Pattern = Literal["line", "dash", "dots"]

WIDTH = 520
"""Width of every figure in figure units; type is 12 units high."""

_PATTERN_CLASS = {"line": "", "dash": " d", "dots": " o"}
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True)
class Axis:
    """Axis of a chart."""

    label: str
    low: float
    high: float
    log: bool = False
    step: float | None = None
    """Distance between ticks; by default a round number."""
    tick_values: tuple[float, ...] = ()
    """Positions of the ticks; by default round numbers."""

    def fraction(self, values: ArrayLike) -> Array:
        """Positions of values, 0 to 1 along the axis; values that a log axis cannot show are far below it."""
        values = np.asarray(values, dtype=float)
        if not self.log:
            return np.asarray((values - self.low) / (self.high - self.low))
        low, high = np.log10([self.low, self.high])
        logs = np.where(np.isnan(values), np.nan, np.log10(np.maximum(values, self.low * 1e-3)))
        return np.asarray((logs - low) / (high - low))

    def ticks(self) -> list[tuple[float, str]]:
        """Positions and labels of the ticks."""
        if self.tick_values:
            return [(value, f"{value:g}") for value in self.tick_values]
        return _log_ticks(self.low, self.high) if self.log else linear_ticks(self.low, self.high, self.step)

    def minor_ticks(self) -> list[float]:
        """Positions of unlabelled ticks: 2 to 9 of each decade, where there is room for them."""
        if not self.log or self.tick_values or np.log10(self.high / self.low) > 4.5:
            return []
        decades = np.arange(np.floor(np.log10(self.low)), np.ceil(np.log10(self.high)))
        values = (10.0 ** decades[:, None] * np.arange(2, 10)).ravel()
        return [float(value) for value in values if self.low <= value <= self.high]


@dataclass(frozen=True)
class Line:
    """A curve; NaN breaks it."""

    columns: ClassVar[tuple[str, ...]] = ("x", "y")
    """Fields that are its data, see :mod:`brdfpipe.report.plots.figure_data`"""

    x: ArrayLike
    y: ArrayLike
    style: str = "c0"
    label: str = ""
    pattern: Pattern = "line"


@dataclass(frozen=True)
class Points:
    """Points, with error bars where ``error`` is given and not NaN; points of NaN are not drawn."""

    columns: ClassVar[tuple[str, ...]] = ("x", "y", "error")

    x: ArrayLike
    y: ArrayLike
    error: ArrayLike = np.nan
    style: str = "c0"
    label: str = ""


@dataclass(frozen=True)
class Band:
    """The area between two curves over the same x."""

    columns: ClassVar[tuple[str, ...]] = ("x", "low", "high")

    x: ArrayLike
    low: ArrayLike
    high: ArrayLike
    style: str = "c0"
    label: str = ""


Mark = Line | Points | Band

_LABEL_WIDTH = 44
"""Width of the longest power of ten, on a narrow page, in figure units."""


@dataclass(frozen=True)
class Figure:
    """A picture with its caption, ready for the template; without a picture, its note stands alone."""

    title: str
    svg: Markup = field(default_factory=Markup)
    legend: tuple[tuple[str, str, str], ...] = ()
    """(shape, style, label), shape one of ``line``, ``dash``, ``dots``, ``points``, ``area``, ``missing``."""
    note: str = ""
    full: bool = False
    """Whether its card is as wide as the page."""


def legend(marks: Sequence[Mark]) -> tuple[tuple[str, str, str], ...]:
    """The legend of the labelled marks of a chart; empty for a single one, which the caption names."""
    shapes = {Band: "area", Points: "points"}
    entries = tuple(
        (mark.pattern if isinstance(mark, Line) else shapes[type(mark)], mark.style, mark.label)
        for mark in marks
        if mark.label
    )
    return entries if len(entries) > 1 else ()


def chart(description: str, x: Axis, y: Axis, marks: Sequence[Mark], *, height: int = 300, strip: str = "") -> Markup:
    """A Cartesian chart: marks drawn in order and clipped to the axes, with an image (data URI) along the x axis if there is one."""
    left, right, top, bottom = 54, 16, 28, 46 + (10 if strip else 0)
    width, tall = WIDTH - left - right, height - top - bottom
    x_ticks = [(left + width * float(x.fraction(value)), name) for value, name in x.ticks()]
    y_ticks = [(top + tall * (1 - float(y.fraction(value))), name) for value, name in y.ticks()]
    minor = [top + tall * (1 - float(y.fraction(value))) for value in y.minor_ticks()]
    grid = "".join(f"M{column:.1f} {top}v{tall}" for column, _ in x_ticks)
    grid += "".join(f"M{left} {row:.1f}h{width}" for row, _ in y_ticks)
    axes = f"M{left} {top}v{tall}h{width}" + "".join(f"M{left - 3} {row:.1f}h3" for row in minor)
    parts = [f'<path class="g" d="{grid}"/>', f'<path class="a" d="{axes}"/>']
    parts += [text(left - 6, row + 4, name, "end") for row, name in y_ticks]
    if strip:
        parts.append(image(strip, left, top + tall + 3, width, 9))
    # A nested svg clips to its own box without a clipPath, which would need an id.
    parts.append(f'<svg x="{left}" y="{top}" width="{width}" height="{tall}">')
    parts += [_mark(mark, x, y, width, tall) for mark in marks]
    parts.append("</svg>")
    parts += [text(column, top + tall + (27 if strip else 17), name, "middle") for column, name in x_ticks]
    parts.append(text(left + width / 2, height - 8, x.label, "middle", "t"))
    parts.append(text(4, 15, y.label, "start", "t"))
    return frame(description, height, [*parts, metadata(x.label, y.label, marks)])


def _mark(mark: Mark, x: Axis, y: Axis, width: float, tall: float) -> str:
    across = width * x.fraction(mark.x)
    if isinstance(mark, Line):
        return path(across, tall * (1 - y.fraction(mark.y)), f"l {mark.style}{_PATTERN_CLASS[mark.pattern]}")
    if isinstance(mark, Points):
        return _points(mark, across, y, tall)
    low, high = tall * (1 - y.fraction(mark.low)), tall * (1 - y.fraction(mark.high))
    present = np.isfinite(low) & np.isfinite(high)
    limit = 4 * tall  # a lower edge far below the axis stays a short number
    across, low, high = across[present], np.clip(low[present], -limit, limit), np.clip(high[present], -limit, limit)
    return path(np.r_[across, across[::-1]], np.r_[high, low[::-1]], f"b {mark.style}", closed=True)


def _points(mark: Points, across: Array, y: Axis, tall: float) -> str:
    value = np.asarray(mark.y, dtype=float)
    error = np.broadcast_to(np.asarray(mark.error, dtype=float), value.shape)
    at, low, high = (tall * (1 - y.fraction(v)) for v in (value, value - error, value + error))
    dots = "".join(f"M{a:.1f} {b:.1f}h0" for a, b in zip(across, at, strict=True) if np.isfinite([a, b]).all())
    bars = "".join(
        f"M{a:.1f} {b:.1f}V{c:.1f}m-4 0h8M{a - 4:.1f} {b:.1f}h8"
        for a, b, c in zip(across, low, high, strict=True)
        if np.isfinite([a, b, c]).all()
    )
    return f'<path class="e {mark.style}" d="{bars}"/><path class="p {mark.style}" d="{dots}"/>'


def polar(
    description: str,
    decades: tuple[int, int],
    marks: Sequence[Line],
    sources: Sequence[tuple[float, str]],
    below: Sequence[Line] = (),
    quantity: str = "BRDF",
    data_of: Sequence[str] = (),
) -> Markup:
    """A goniometric half disc, or full disc with transmitted light ``below``: angle from the normal, logarithmic radius.

    x of the marks is in degree from the (lower) normal, negative on the side of the source. ``decades`` are the exponents of ten at
    the centre and at the rim, ``sources`` the angles [degree] and styles of the sources, ``data_of`` the titles of the charts that have
    the same curves, for their data.
    """
    radius = 190.0 if below else 218.0
    centre_x, centre_y, height = WIDTH / 2, radius + 32, 2 * radius + 72 if below else 300
    low, high = decades
    axis = Axis("", 10.0**low, 10.0**high, log=True)
    rings = {exponent: radius * (exponent - low) / (high - low) for exponent in range(low, high + 1)}
    parts: list[str] = []
    for r in list(rings.values())[1:]:
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
            label_y = centre_y - (radius + 8) * cosine + drop
            parts.append(text(centre_x + (radius + 8) * sine, label_y, f"{abs(angle)}°", anchor))

    def curve(mark: Line, up: int) -> str:
        reach, angles = radius * np.clip(axis.fraction(mark.y), 0, 1), np.radians(np.asarray(mark.x, dtype=float))
        style = f"l {mark.style}{_PATTERN_CLASS[mark.pattern]}"
        return path(centre_x + reach * np.sin(angles), centre_y - up * reach * np.cos(angles), style)

    parts += [curve(mark, 1) for mark in marks]
    for incidence, style in sources:  # a small triangle on the rim that points to the centre
        x, y = centre_x - radius * np.sin(np.radians(incidence)), centre_y - radius * np.cos(np.radians(incidence))
        place = f"translate({x:.1f} {y:.1f})rotate({-incidence:g})"
        parts.append(f'<path class="s {style}" transform="{place}" d="M0 14l-4-14h8z"/>')
    parts += [curve(mark, -1) for mark in below]
    parts.append(f'<path class="a" d="M{centre_x - radius:g} {centre_y:g}h{2 * radius:g}"/>')
    skip = max(1, round((high - low) / 4))
    labelled = [e for e in range(high - skip if below else high, low, -skip) if rings[e] > _LABEL_WIDTH]
    for exponent in [*labelled, low]:
        label_style = "h" if below else ""
        parts.append(text(centre_x + rings[exponent], centre_y + 16, power_of_ten(exponent), "middle", label_style))
    if below:
        parts.append(text(4, 15, "side of the source", "start", "t"))
        words = f"{quantity}, sr⁻¹ (log); rim {power_of_ten(high)}"
        parts.append(text(centre_x + radius, height - 4, words, "end", "t"))
    else:
        parts.append(text(centre_x - radius, centre_y + 16, "side of the source", "start", "t"))
        parts.append(text(centre_x + radius, height - 8, f"{quantity}, sr⁻¹ (log)", "end", "t"))
    return frame(description, height, [*parts, of_charts(data_of)] if data_of else parts)


def rose(description: str, label: str, azimuth: ArrayLike, value: ArrayLike, axis: float) -> Markup:
    """A full disc: a positive quantity against azimuth [degree], counter-clockwise from x, with the line of azimuth ``axis`` dashed."""
    radius, centre_x, centre_y, height = 138.0, WIDTH / 2, 184.0, 368
    rings = linear_ticks(0, float(np.max(value)), count=4)[1:]
    scale = radius / max(rings[-1][0], 1.04 * float(np.max(value)))

    def place(degrees: ArrayLike, reach: ArrayLike) -> tuple[Array, Array]:
        turn = np.radians(np.asarray(degrees, dtype=float))
        return centre_x + reach * np.cos(turn), centre_y - reach * np.sin(turn)

    parts = [f'<circle class="g" cx="{centre_x:g}" cy="{centre_y:g}" r="{scale * ring:.1f}"/>' for ring, _ in rings]
    for angle in range(0, 360, 30):
        (end_x, end_y), (label_x, label_y) = place(angle, radius), place(angle, radius + 11)
        parts.append(f'<path class="g" d="M{centre_x:g} {centre_y:g}L{end_x:.1f} {end_y:.1f}"/>')
        anchor = "middle" if angle % 180 == 90 else "start" if end_x > centre_x else "end"
        name = {0: "0°, x", 90: "90°, y"}.get(angle, f"{angle}°")
        parts.append(text(float(label_x), float(label_y) + 4, name, anchor))
    parts.append(path(*place([axis, axis + 180], radius), "l c3 d"))
    parts.append(path(*place(azimuth, scale * np.asarray(value, dtype=float)), "l c0", closed=True))
    # The ring labels are beside the dashed line, where the curve is narrowest.
    for ring, name in rings:
        label_x, label_y = place(axis + 15, scale * ring)
        parts.append(text(float(label_x), float(label_y) + 4, name, "middle", "h"))
    parts.append(text(4, 15, label, "start", "t"))
    return frame(description, height, [*parts, metadata("azimuth, degree", label, [Line(azimuth, value)])])


def frame(description: str, height: float, parts: Sequence[str]) -> Markup:
    """The outer element: as wide as its column, with a description for screen readers."""
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
    """A raster image stretched over a box, with sharp pixels unless ``smooth``."""
    sharp = "" if smooth else ' class="px"'
    return (
        f'<image x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" preserveAspectRatio="none"{sharp} '
        f'href="{uri}"/>'
    )


def png(pixels: NDArray[np.uint8], palette: NDArray[np.uint8] | None = None, *, clear: int | None = None) -> str:
    """Data URI of a PNG of sRGB pixels (rows, columns, 3), or of palette indices (rows, columns), of which ``clear`` is transparent."""
    from PIL import Image

    picture = Image.fromarray(np.ascontiguousarray(pixels))
    if palette is not None:
        picture.putpalette(palette.astype(np.uint8).tobytes())
    transparency = {} if clear is None else {"transparency": clear}
    return data_uri(picture, "png", **transparency)


def data_uri(picture: Any, format: Literal["png", "webp", "jpeg"], **options: Any) -> str:
    """Data URI of a PIL image."""
    stream = BytesIO()
    picture.save(stream, format.upper(), **options)
    return f"data:image/{format};base64," + b64encode(stream.getvalue()).decode("ascii")


def path(x: ArrayLike, y: ArrayLike, style: str, *, closed: bool = False) -> str:
    """A path through points in figure units; NaN breaks it. Points that no eye can tell from a straight line are dropped."""
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    present = np.isfinite(x) & np.isfinite(y)
    breaks = np.flatnonzero(np.diff(present.astype(np.int8))) + 1
    data = ""
    for piece in np.split(np.arange(x.size), breaks):
        if piece.size > 1 and present[piece[0]]:
            thin_x, thin_y = _thinned(x[piece], y[piece])
            data += "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in zip(thin_x.tolist(), thin_y.tolist(), strict=True))
    return f'<path class="{style}" d="{data}{"Z" if closed else ""}"/>' if data else ""


def _thinned(x: Array, y: Array, tolerance: float = 0.06, passes: int = 5) -> tuple[Array, Array]:
    """Drop every second point within the tolerance of the chord of its neighbours, a few times over."""
    for _ in range(passes):
        if x.size < 8:
            break
        ax, ay, bx, by = x[:-2], y[:-2], x[2:], y[2:]
        dx, dy = bx - ax, by - ay
        length = np.hypot(dx, dy)
        distance = np.abs(dx * (y[1:-1] - ay) - dy * (x[1:-1] - ax)) / np.where(length > 0, length, 1)
        # Beyond the ends of the chord (a spike), the perpendicular distance says nothing.
        along = (dx * (x[1:-1] - ax) + dy * (y[1:-1] - ay)) / np.where(length > 0, length**2, 1)
        flat = (distance < tolerance) & (length > 0) & (along >= 0) & (along <= 1)
        keep = np.ones(x.size, dtype=bool)
        keep[1:-1] = ~flat | (np.arange(1, x.size - 1) % 2 == 0)
        if keep.all():
            break
        x, y = x[keep], y[keep]
    return x, y


def _log_ticks(low: float, high: float) -> list[tuple[float, str]]:
    first, last = int(np.ceil(np.log10(low) - 1e-9)), int(np.floor(np.log10(high) + 1e-9))
    if last - first < 2:
        values = [m * 10.0**e for e in range(first - 1, last + 1) for m in (1, 2, 5)]
        return [(value, f"{value:g}") for value in values if low * 0.999 <= value <= high * 1.001]
    skip = max(1, int(np.ceil((last - first) / 7)))
    return [(10.0**exponent, power_of_ten(exponent)) for exponent in range(last, first - 1, -skip)]


def linear_ticks(low: float, high: float, step: float | None = None, count: int = 6) -> list[tuple[float, str]]:
    """Ticks at round numbers, about ``count`` of them."""
    if step is None:
        raw = (high - low) / count
        power = 10.0 ** np.floor(np.log10(raw))
        step = float(power * next(nice for nice in (1, 2, 2.5, 5, 10) if nice * power >= raw * 0.999))
    first, last = np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9)
    decimals = next((d for d in range(9) if abs(round(step, d) - step) < 1e-9 * step), 9)
    return [(float(value), minus(f"{value + 0.0:.{decimals}f}")) for value in np.arange(first, last + 1) * step]


def with_neighbours(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """A mask and its neighbours, so that a part of a curve meets the rest."""
    return np.asarray(mask | np.r_[mask[1:], False] | np.r_[False, mask[:-1]])


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
    return f"{10.0**exponent:g}" if -2 <= exponent <= 3 else "10" + str(exponent).translate(_SUPERSCRIPT)


def minus(number: str) -> str:
    """A number with a true minus sign."""
    return number.replace("-", "−")
