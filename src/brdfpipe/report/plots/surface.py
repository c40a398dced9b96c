"""Figures of a levelled surface: height map, or line profile."""

from __future__ import annotations

import math

import numpy as np
import xarray as xr

from brdfpipe.errors import plain
from brdfpipe.report.plots.raster import false_colour, framed
from brdfpipe.report.plots.svg import Array, Axis, Figure, Line, chart, linear_ticks, nice_range, png

_MAP_PIXELS = 300


def height_map(surface: xr.Dataset) -> Figure:
    """The levelled height map, in false colour."""
    height = surface["height"]
    extent_x, extent_y = (_extent(height[axis].values.astype(float)) for axis in ("x", "y"))
    values = height.values
    missing = float(np.mean(np.isnan(values)))
    reduced = _reduced(values)
    low, high = _robust_range(reduced)
    svg, to_scale = framed(
        f"Height map, {plain(extent_x, 4)} by {plain(extent_y, 4)} micrometres, heights from {plain(low)} to {plain(high)} micrometres",
        png(*false_colour(reduced, low, high)),
        ("x, µm", 0.0, extent_x),
        ("y, µm", 0.0, extent_y),
        "µm",
        [((value - low) / (high - low), name) for value, name in linear_ticks(low, high, count=5)],
    )
    key = (("missing", "", f"missing heights ({100 * missing:.2g} %)"),) if missing else ()
    note = f"{values.shape[1]} × {values.shape[0]} heights; the colours span the central 99 %. Form, dust and scratches here are in the prediction, too."
    return Figure("Height, levelled", svg, key, note if to_scale else f"{note} x and y are not to the same scale.")


def height_profile(surface: xr.Dataset) -> Figure:
    """The levelled line profile."""
    x = surface["height"]["x"].values.astype(float)
    height = surface["height"].values.astype(float)
    low, high = nice_range(float(np.nanmin(height)), float(np.nanmax(height)), margin=0.06)
    axis_x = Axis("x, µm", 0.0, float(x[-1] - x[0]))
    axis_y = Axis("height, µm", low, high)
    line = Line(*_envelope(x - x[0], height))
    svg = chart("Levelled line profile, height against position", axis_x, axis_y, [line], height=240)
    missing = float(np.mean(np.isnan(height)))
    note = f"{height.size} heights" + (f", {100 * missing:.2g} % missing." if missing else ".")
    note += " Form, dust and scratches here are in the prediction, too."
    return Figure("Height, levelled", svg, note=note)


def _reduced(height: Array) -> Array:
    """At most ``_MAP_PIXELS`` along the longer side: means of blocks, missing where half of the block is missing."""
    step = math.ceil(max(height.shape) / _MAP_PIXELS)
    # A mean over four samples of each block, not over all: a map of 4096² heights must not delay the page.
    stride = max(1, step // 2)
    sampled = height[::stride, ::stride]
    block = math.ceil(step / stride)
    rows, columns = sampled.shape[0] // block, sampled.shape[1] // block
    blocks = sampled[: rows * block, : columns * block].astype(float).reshape(rows, block, columns, block)
    present = np.isfinite(blocks)
    count = present.sum(axis=(1, 3))
    total = np.where(present, blocks, 0.0).sum(axis=(1, 3))
    return np.where(2 * count > block**2, total / np.maximum(count, 1), np.nan)


def _extent(positions: Array) -> float:
    pitch = (positions[-1] - positions[0]) / max(positions.size - 1, 1)
    return float(positions[-1] - positions[0] + pitch)


def _robust_range(values: Array) -> tuple[float, float]:
    present = values[np.isfinite(values)]
    low, high = np.percentile(present, [0.5, 99.5]).tolist() if present.size else (0.0, 1.0)
    return (low, high) if high > low else nice_range(low, high)


def _envelope(x: Array, height: Array, columns: int = 440) -> tuple[Array, Array]:
    """A long profile as the lowest and highest height of each column, so that no peak is lost."""
    if x.size <= 2 * columns:
        return x, height
    block = math.ceil(x.size / columns)
    rows = x.size // block
    blocks = height[: rows * block].reshape(rows, block)
    # fmin and fmax, other than nanmin, do not warn of a column without any height.
    extremes = np.stack([np.fmin.reduce(blocks, axis=1), np.fmax.reduce(blocks, axis=1)], axis=1)
    return np.repeat(x[: rows * block].reshape(rows, block).mean(axis=1), 2), extremes.ravel()
