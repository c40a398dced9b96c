"""Refractive index: n and k against wavelength, their range of validity, and the mean index of colour-neutral models."""

from __future__ import annotations

import math
import re
from typing import NamedTuple

import numpy as np
import xarray as xr

from brdfpipe.bsdf.nonspectral import normalised_response
from brdfpipe.bsdf.registry import representation
from brdfpipe.optics.dispersion import STORED_SPAN
from brdfpipe.report.formatting import number
from brdfpipe.report.plots.spectrum import visible_strip
from brdfpipe.report.plots.svg import Array, Axis, Figure, Line, Mark, Points, chart, legend, nice_range, power_of_ten

_LOG_RATIO = 30.0
"""Largest over smallest k above which its axis is logarithmic."""

_SMALL = 1e-3
"""Largest value below which the unit of an axis is a power of ten."""

_FITTED_FROM = re.compile(r"fitted from ([0-9.]+) nm, was extrapolated to")
"""The extrapolated part in the history of an index (:func:`brdfpipe.optics.dispersion.sampled`)."""


class _MeanIndex(NamedTuple):
    """The index of colour-neutral models."""

    n: float
    k: float
    wavelength: float
    """Mean wavelength of the weight [nm]."""


def dispersive(index: xr.Dataset) -> bool:
    """Whether an index depends on wavelength."""
    return any(np.ptp(index[name].values) > 0 for name in ("n", "k"))


def dispersion(index: xr.Dataset, bsdf: xr.Dataset | None = None) -> list[Figure]:
    """n(λ), and k(λ) of an absorbing body; a note alone where neither depends on wavelength.

    ``bsdf`` is the BSDF built with the index; from it follows the index of colour-neutral models.
    """
    source = str(index.attrs.get("source", "")).strip()
    source_words = f" Source: {source}" if source else ""
    if not dispersive(index):
        n, k = (float(index[name].values.flat[0]) for name in ("n", "k"))
        return [Figure("Refractive index", note=f"n = {n:.6g} and k = {k:.6g} at all wavelengths.{source_words}")]
    mean, absorbs = _mean_index(bsdf), bool(index["k"].values.any())
    mean_words = "" if mean is None else f" {_mean_index_words(mean)}"
    note = f"{_range_words(index)}{'' if absorbs else ' k = 0 throughout.'}{mean_words}{source_words}"
    figures = [_figure(index, "n", "Refractive index n(λ)", mean, note)]
    return [*figures, _figure(index, "k", "Extinction coefficient k(λ)", mean, "")] if absorbs else figures


def _figure(index: xr.Dataset, name: str, title: str, mean: _MeanIndex | None, note: str) -> Figure:
    valid_from, valid_to = _validity(index)
    wavelength, curve = _visible_part(index, name, (valid_from, valid_to))
    mean_value = 0.0 if mean is None else float(getattr(mean, name))
    axis, unit = _axis(name, np.append(curve, mean_value) if mean_value > 0 else curve)
    values = curve / unit
    ends = [end for end in (valid_from, valid_to) if STORED_SPAN[0] < end < STORED_SPAN[1]]
    marks: list[Mark] = [
        Line([end, end], [axis.low, axis.high], "ref", "" if k else "end of validity", "dots")
        for k, end in enumerate(ends)
    ]
    valid, extrapolated = wavelength >= valid_from, wavelength <= valid_from
    marks.append(Line(wavelength[valid], values[valid], "c0", name))
    if not valid.all():
        marks.append(Line(wavelength[extrapolated], values[extrapolated], "c3", "extrapolated", "dash"))
    if mean is not None and mean_value > 0:
        crossing = _crossing(wavelength, curve, mean_value, mean.wavelength)
        marks.append(Points([crossing], [mean_value / unit], style="c2", label=f"{name} of colour-neutral models"))
    svg = chart(
        f"{title} against wavelength, from {number(curve.min(), 5)} to {number(curve.max(), 5)}",
        Axis("wavelength, nm", *STORED_SPAN, step=50),
        axis,
        marks,
        height=270,
        strip=visible_strip(*STORED_SPAN),
    )
    return Figure(title, svg, legend(marks), note)


def _visible_part(index: xr.Dataset, name: str, validity: tuple[float, float]) -> tuple[Array, Array]:
    """Wavelengths and values within the range of the models, with nodes at both ends of the validity."""
    wavelength, values = index["wavelength"].values.astype(float), index[name].values.astype(float)
    low, high = max(STORED_SPAN[0], wavelength[0]), min(STORED_SPAN[1], wavelength[-1])
    nodes = np.union1d(wavelength, [low, high, *validity])
    nodes = nodes[(nodes >= low) & (nodes <= high)]
    return nodes, np.interp(nodes, wavelength, values)


def _axis(name: str, values: Array) -> tuple[Axis, float]:
    """An axis, and its unit."""
    low, high = float(values.min()), float(values.max())
    if name == "k" and low > 0 and high > _LOG_RATIO * low:
        ends = 10.0 ** math.floor(math.log10(low)), 10.0 ** math.ceil(math.log10(high))
        return Axis("k (log)", *ends, log=True), 1.0
    exponent = math.floor(math.log10(high)) if high < _SMALL else 0
    unit = 10.0**exponent
    low, high = nice_range(low / unit, high / unit, margin=0.08)
    return Axis(f"{name}, {power_of_ten(exponent)}" if exponent else name, max(low, 0.0), high), unit


def _validity(index: xr.Dataset) -> tuple[float, float]:
    """Wavelengths between which the index is known [nm]; below, it is extrapolated."""
    first, last = (float(end) for end in index["wavelength"].values[[0, -1]])
    fitted = _FITTED_FROM.search(str(index.attrs.get("history", "")))
    return max(float(fitted[1]), first) if fitted else first, last


def _range_words(index: xr.Dataset) -> str:
    (low, high), first = _validity(index), float(index["wavelength"].values[0])
    if first < low:
        return f"A Sellmeier formula fitted from {low:g} nm and extrapolated to {first:g} nm (dashed)."
    formula = index.attrs.get("dispersion") == "formula"
    kind = "A formula" if formula else f"A table of {index.sizes['wavelength']} wavelengths"
    return f"{kind}, taken from {low:g} to {high:g} nm."


# --- the index of colour-neutral models


def _mean_index(bsdf: xr.Dataset | None) -> _MeanIndex | None:
    """The index averaged with V(λ) and D65; None where a BSDF has no index over wavelength."""
    if bsdf is None or not representation(bsdf).uses_index or (weight := normalised_response(bsdf)) is None:
        return None
    index = representation(bsdf).mean_index(weight)
    return None if index is None else _MeanIndex(*index, float(weight @ bsdf["wavelength"].values))


def _mean_index_words(mean: _MeanIndex) -> str:
    absorbs = f" and k = {number(mean.k, 4)}" if mean.k > 0 else ""
    return (
        f"Colour-neutral models (gloss, haze, the Lambert + Gauss fit, tables without colour) use n = {mean.n:.4f}{absorbs}, the mean "
        "weighted with V(λ) and D65."
    )


def _crossing(wavelength: Array, curve: Array, value: float, about: float) -> float:
    """The wavelength nearest to ``about`` at which a curve has a value; where it is nearest to the value if it never has it."""
    above = curve >= value
    before = np.flatnonzero(above[1:] != above[:-1])
    if before.size == 0:
        return float(wavelength[int(np.abs(curve - value).argmin())])
    share = (value - curve[before]) / (curve[before + 1] - curve[before])
    crossings = wavelength[before] + share * np.diff(wavelength)[before]
    return float(crossings[int(np.abs(crossings - about).argmin())])
