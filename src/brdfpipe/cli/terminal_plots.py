"""Small plots of text: curves of braille dots, and height maps of shaded blocks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from brdfpipe.geometry import Array

_WIDTH, _HEIGHT = 60, 10
"""Characters; each has 2 × 4 dots."""

_DOTS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])
"""Bits of a braille character by row and column of its dots (Unicode block U+2800)."""

_SHADES = " ░▒▓█"


def curves(x: Array, several: Sequence[Array], x_label: str, y_label: str, *, log: bool = False) -> list[str]:
    """Curves over a common axis, as lines of text.

    Parameters
    ----------
    x : (points,) in any order; points without a finite x are left out
    several : values of each curve (points,); what is not finite, or not positive on a logarithmic axis, is left out
    x_label, y_label : names of the axes with their units
    log : whether the vertical axis is logarithmic; it then shows at most six decades
    """
    order = np.argsort(x)
    order = order[np.isfinite(x[order])]
    x, several = x[order], [y[order] for y in several]
    heights = [np.where(np.isfinite(y) & ((y > 0) | (not log)), y, np.nan).astype(float) for y in several]
    if log:
        heights = [np.log10(y) for y in heights]
    shown = np.concatenate(heights)
    shown = shown[np.isfinite(shown)]
    if not shown.size:
        return [f"{y_label}: no value to show"]
    high = float(shown.max())
    low = max(float(shown.min()), high - 6) if log else float(shown.min())
    span = high - low if high > low else 1.0
    dots = np.zeros((4 * _HEIGHT, 2 * _WIDTH), dtype=bool)
    for y in heights:
        lowest, highest = _extremes_by_column(x, y)
        tops, bottoms = (np.round((4 * _HEIGHT - 1) * (1 - (end - low) / span)) for end in (highest, lowest))
        for column in range(2 * _WIDTH):
            # From column to column a curve has no gap.
            before = max(column - 1, 0)
            top, bottom = np.fmin(tops[column], bottoms[before]), np.fmax(bottoms[column], tops[before])
            if tops[column] < 4 * _HEIGHT:
                first, last = (int(np.clip(end, 0, 4 * _HEIGHT - 1)) for end in (top, bottom))
                dots[first : last + 1, column] = True
    cells = dots.reshape(_HEIGHT, 4, _WIDTH, 2).transpose(0, 2, 1, 3)
    codes = 0x2800 + (cells * _DOTS).sum(axis=(2, 3))
    marks = ["" for _ in range(_HEIGHT)]
    top, bottom = (10.0**end if log else end for end in (high, low))
    marks[0], marks[-1] = f"{top:.3g}", f"{bottom:.3g}"
    lines = [y_label + (" (logarithmic)" if log else "")]
    lines += [f"{mark:>9} ┤{''.join(map(chr, row))}" for mark, row in zip(marks, codes.tolist(), strict=True)]
    ends = f"{x[0]:g}", f"{x[-1]:g}"
    lines.append(f"{'':>9} └{'─' * _WIDTH}")
    lines.append(f"{'':>11}{ends[0]}{x_label:^{_WIDTH - len(ends[0]) - len(ends[1])}}{ends[1]}")
    return lines


def _extremes_by_column(x: Array, y: Array) -> tuple[Array, Array]:
    """The smallest and the largest value of a curve in each column of dots: a peak between two columns must not be lost.

    They are those of the points that fall into the column, and of the interpolation at its middle; NaN where there is none.
    """
    columns = 2 * _WIDTH
    lowest = np.interp(np.linspace(x[0], x[-1], columns), x, y)
    highest = lowest.copy()
    width = x[-1] - x[0]
    column = np.round((x - x[0]) / (width if width > 0 else 1) * (columns - 1)).astype(int)
    np.fmin.at(lowest, column, y)
    np.fmax.at(highest, column, y)
    return lowest, highest


def relief(heights: Array) -> list[str]:
    """A height map (rows, columns) in shades, the highest places full; a missing height is a question mark."""
    if not np.isfinite(heights).any():
        return ["no height to show"]
    rows, columns = heights.shape
    down = min(_HEIGHT * 2, rows)
    across = min(_WIDTH, columns)
    means = np.array(
        [
            [_mean(block) for block in np.array_split(strip, across, axis=1)]
            for strip in np.array_split(heights, down, axis=0)
        ]
    )
    low, high = np.nanmin(means), np.nanmax(means)
    levels = np.nan_to_num((means - low) / (high - low if high > low else 1), nan=-1.0)
    return [
        "".join("?" if level < 0 else _SHADES[min(int(level * len(_SHADES)), len(_SHADES) - 1)] for level in row)
        for row in levels[::-1]
    ]


def _mean(block: Array) -> float:
    known = block[np.isfinite(block)]
    return float(known.mean()) if known.size else float("nan")
