"""Figures of a refractive index: n and k against wavelength, their range of validity, and the mean index of colour-neutral models."""

from __future__ import annotations

import math
import re
from typing import NamedTuple

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.bsdf.microfacet.builder import build as build_microfacet
from brdfpipe.bsdf.nonspectral import nonspectral, normalised_response
from brdfpipe.bsdf.registry import representation
from brdfpipe.facets.analytic_distributions import flat
from brdfpipe.optics.dispersion import STORED_SPAN
from brdfpipe.report.formatting import number
from brdfpipe.report.plots.spectrum import visible_strip
from brdfpipe.report.plots.svg import (
    Array,
    Axis,
    Figure,
    Line,
    Mark,
    Points,
    chart,
    legend,
    nice_range,
    power_of_ten,
    sentence,
)

_DECIMALS = 4
_MOST_RATIO = 30.0
"""Largest over smallest k from where on its axis is logarithmic."""

_SMALL = 1e-3
"""Largest value below which an axis counts in powers of ten."""

_FITTED_FROM = re.compile(r"fitted from ([0-9.]+) nm, was extrapolated to")
"""How the history of an index tells of its extrapolated part (:func:`brdfpipe.optics.dispersion.sampled`)."""


class _Neutral(NamedTuple):
    """The one index that stands for all wavelengths."""

    n: float
    k: float
    about: float
    """Mean wavelength of the light it is weighted with [nm]"""


class _Known(NamedTuple):
    """Where an index is known [nm]."""

    low: float
    """Of the validity; what lies below is extrapolated"""
    high: float


def dispersive(index: xr.Dataset) -> bool:
    """Whether an index depends on wavelength."""
    return any(np.ptp(index[name].values) > 0 for name in ("n", "k"))


def dispersion(index: xr.Dataset, bsdf: xr.Dataset | None = None) -> list[Figure]:
    """n(λ), and k(λ) of what absorbs; a sentence where neither depends on wavelength.

    Parameters
    ----------
    index : kind ``index``
    bsdf : kind ``bsdf``, built with it; tells the index of the models that know no wavelengths
    """
    source = str(index.attrs.get("source", "")).strip()
    source_words = f" Source: {source}" if source else ""
    if not dispersive(index):
        n, k = (float(index[name].values.flat[0]) for name in ("n", "k"))
        return [sentence("Refractive index", f"n = {n:.6g} and k = {k:.6g} at all wavelengths.{source_words}")]
    neutral, absorbs = _neutral(bsdf), bool(index["k"].values.any())
    stands = "" if neutral is None else f" {_neutral_words(neutral)}"
    clear = "" if absorbs else " k = 0 throughout."
    figures = [
        _figure(index, "n", "Refractive index n(λ)", neutral, f"{_range_words(index)}{clear}{stands}{source_words}")
    ]
    if absorbs:
        figures.append(_figure(index, "k", "Extinction coefficient k(λ)", neutral, ""))
    return figures


def _figure(index: xr.Dataset, name: str, title: str, neutral: _Neutral | None, note: str) -> Figure:
    known = _known(index)
    wavelength, curve = _shown(index, name, known)
    mean = 0.0 if neutral is None else float(getattr(neutral, name))
    axis, unit = _axis(name, np.append(curve, mean) if mean > 0 else curve)
    values = curve / unit
    marks: list[Mark] = [
        Line([end, end], [axis.low, axis.high], "ref", "" if place else "end of validity", "dots")
        for place, end in enumerate(end for end in known if STORED_SPAN[0] < end < STORED_SPAN[1])
    ]
    valid, beyond = wavelength >= known.low, wavelength <= known.low
    marks.append(Line(wavelength[valid], values[valid], "c0", name))
    if not valid.all():
        marks.append(Line(wavelength[beyond], values[beyond], "c3", "extrapolated", "dash"))
    if neutral is not None and mean > 0:
        crossing = _crossing(wavelength, curve, mean, neutral.about)
        marks.append(Points([crossing], [mean / unit], [np.nan], "c2", f"{name} of colour-neutral models"))
    svg = chart(
        f"{title} against wavelength, from {number(curve.min(), 5)} to {number(curve.max(), 5)}",
        Axis("wavelength, nm", *STORED_SPAN, step=50),
        axis,
        marks,
        height=270,
        strip=visible_strip(*STORED_SPAN),
    )
    return Figure(title, svg, legend(marks), note)


def _shown(index: xr.Dataset, name: str, known: _Known) -> tuple[Array, Array]:
    """Wavelengths and values where they are of use; neither the ends of that nor those of the validity need be nodes."""
    wavelength, values = index["wavelength"].values.astype(float), index[name].values.astype(float)
    low, high = max(STORED_SPAN[0], wavelength[0]), min(STORED_SPAN[1], wavelength[-1])
    at = np.union1d(wavelength, [low, high, *known])
    at = at[(at >= low) & (at <= high)]
    return at, np.interp(at, wavelength, values)


def _axis(name: str, values: Array) -> tuple[Axis, float]:
    """An axis, and the unit it counts in."""
    low, high = float(values.min()), float(values.max())
    if name == "k" and low > 0 and high > _MOST_RATIO * low:
        ends = 10.0 ** math.floor(math.log10(low)), 10.0 ** math.ceil(math.log10(high))
        return Axis("k (log)", *ends, log=True), 1.0
    exponent = math.floor(math.log10(high)) if high < _SMALL else 0
    unit = 10.0**exponent
    low, high = nice_range(low / unit, high / unit, margin=0.08)
    return Axis(f"{name}, {power_of_ten(exponent)}" if exponent else name, max(low, 0.0), high), unit


def _known(index: xr.Dataset) -> _Known:
    first, last = (float(end) for end in index["wavelength"].values[[0, -1]])
    fitted = _FITTED_FROM.search(str(index.attrs.get("history", "")))
    return _Known(max(float(fitted[1]), first) if fitted else first, last)


def _range_words(index: xr.Dataset) -> str:
    known, first = _known(index), float(index["wavelength"].values[0])
    if first < known.low:
        return f"A Sellmeier formula fitted from {known.low:g} nm and extrapolated to {first:g} nm (dashed)."
    formula = index.attrs.get("dispersion") == "formula"
    kind = "A formula" if formula else f"A table of {index.sizes['wavelength']} wavelengths"
    return f"{kind}, taken from {known.low:g} to {known.high:g} nm."


# --- the index of models that know no wavelengths


def _neutral(bsdf: xr.Dataset | None) -> _Neutral | None:
    """None where a BSDF has no index over wavelength."""
    if bsdf is None or not representation(bsdf).uses_index or bsdf["n"].dims != ("wavelength",):
        return None
    weight = normalised_response(bsdf)
    assert weight is not None
    about = float(weight @ bsdf["wavelength"].values)
    if representation(bsdf).is_slab:
        return _Neutral(float(weight @ bsdf["n"].values), 0.0, about)
    # The same body, polished: its index is averaged alike, in a twelfth of the time.
    own = xr.Dataset(
        {name: ("wavelength", bsdf[name].values) for name in ("n", "k")}, {"wavelength": bsdf["wavelength"]}
    )
    polished = build_microfacet(flat(), index=vocabulary.label(own.assign_attrs(source="own"), "index"))
    reduced = nonspectral(polished, weight)
    return _Neutral(float(reduced["n"]), float(reduced["k"]), about)


def _neutral_words(neutral: _Neutral) -> str:
    absorbs = f" and k = {number(neutral.k, 4)}" if neutral.k > 0 else ""
    return (
        f"Colour-neutral models (gloss, haze, the Lambert + Gauss fit, tables without colour) use n = {neutral.n:.{_DECIMALS}f}{absorbs}, the mean "
        "weighted with V(λ) and D65."
    )


def _crossing(wavelength: Array, curve: Array, value: float, about: float) -> float:
    """The wavelength, nearest to one, at which a curve takes a value; where it comes nearest to it if it never does."""
    above = curve >= value
    before = np.flatnonzero(above[1:] != above[:-1])
    if before.size == 0:
        return float(wavelength[int(np.abs(curve - value).argmin())])
    share = (value - curve[before]) / (curve[before + 1] - curve[before])
    crossings = wavelength[before] + share * np.diff(wavelength)[before]
    return float(crossings[int(np.abs(crossings - about).argmin())])
