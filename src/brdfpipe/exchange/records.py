"""What is said in and beside an exported table: its error, and what the format leaves out of the BSDF."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Literal, Protocol

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.bsdf.base import Representation
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.table_error import Limits, TableError
from brdfpipe.exchange.registry import FORMATS, Format
from brdfpipe.exchange.stated_uncertainty import known_uncertainty, uncertainty_in_words

Content = Literal["luminous", "xyz", "rgb", "spectrum"]
"""What the values are: weighted with V(λ) and D65; X, Y and Z, or linear sRGB, under D65; or by wavelength."""

Record = dict[str, Any]
"""Plain values for JSON."""

NEGLIGIBLE_SHARE = 1e-5
"""Of light in a single direction: a four-thousandth of what the face of a plastic reflects at normal incidence; below it is the rounding of models of rough faces."""
FINEST_WITH_LAY = "rgl"
"""Of the formats with a lay that with the smallest error at equal size, because its nodes follow the lobe."""
_STATED_AT = np.array([0.0, 20.0, 45.0, 60.0, 75.0])
"""Incidences at which the share of light in a single direction is stated [degree]."""


class Exported(Protocol):
    """A table of a BSDF."""

    @property
    def bsdf(self) -> xr.Dataset: ...
    @property
    def error(self) -> TableError: ...
    @property
    def reading(self) -> str:
        """What the program does that reads the table, ``interpolated linearly``"""

    @property
    def limits(self) -> Limits | None:
        """Of the error that was asked for; None where a format leaves nothing to choose."""

    @property
    def size(self) -> int: ...
    @property
    def content(self) -> Content: ...


def record(table: Exported, format: Format, whole: xr.Dataset | None = None) -> Record:
    """Material, digest, measurement, uncertainty, error and losses of a table; ``whole`` is the BSDF of which the table holds one side."""
    bsdf, error = table.bsdf if whole is None else whole, table.error
    uncertainty = uncertainty_in_words(bsdf, table.bsdf.attrs.get("one_side", "reflection"))
    return {
        **identity(bsdf),
        **({"uncertainty": uncertainty} if uncertainty else {}),
        "values": table.size,
        "error": {
            "percentile_95": three_digits(error.percentile_95),
            "rms": three_digits(error.rms),
            "albedo": three_digits(error.albedo),
            "directions": error.directions,
            "reading": table.reading,
            **_kept(error, table.limits, format, representation(bsdf)),
        },
        "left_out": left_out(bsdf, format, table.content),
    }


def _kept(error: TableError, limits: Limits | None, format: Format, model: Representation) -> Record:
    """Whether an error keeps its limits; those that it exceeds, option → limit, and of a lay the format with the smallest error."""
    if limits is None:
        return {}
    exceeded = limits.exceeded(error)
    found: Record = {"within_tolerance": not exceeded}
    if exceeded:
        found["exceeded"] = exceeded
    # A module's own declaration has no name yet.
    if exceeded and not model.isotropic and replace(format, name=FINEST_WITH_LAY) != FORMATS[FINEST_WITH_LAY]:
        found["finer_format"] = FINEST_WITH_LAY
    return found


def identity(bsdf: xr.Dataset) -> Record:
    """Material and digest; of a measured BSDF also its measurement, see :data:`brdfpipe.vocabulary.MEASUREMENT`."""
    measurement = {name: str(bsdf.attrs[name]) for name in vocabulary.MEASUREMENT if name in bsdf.attrs}
    return {
        "material": str(bsdf.attrs.get("material", "unnamed")),
        "digest": str(bsdf.attrs.get("digest", "unknown")),
        **({"measurement": measurement} if measurement else {}),
    }


def comment(bsdf: xr.Dataset) -> str:
    """Material, digest and measurement in one line."""
    return "; ".join(heading(identity(bsdf)))


def heading(record: Mapping[str, Any]) -> list[str]:
    """What a record says of the BSDF itself, the first sentences of a file."""
    named = f"brdfpipe: {record['material']}, digest of the BSDF {record['digest']}"
    measurement = record.get("measurement", {})
    if not measurement:
        return [named]
    words = {
        "day": "on",
        "rig": "by the rig",
        "calibrated": "calibrated on",
        "certificate": "by an etalon with the certificate",
    }
    parts = [f"{words[name]} {measurement[name]}" for name in vocabulary.MEASUREMENT if name in measurement]
    return [named, f"measured {', '.join(parts)}"]


def day_of(record: Mapping[str, Any], unknown: str) -> str:
    """The day of the measurement, of a sheet that of reflection, ISO 8601; ``unknown`` of a BSDF that was not measured."""
    return str(record.get("measurement", {}).get("day", unknown)).partition(",")[0]


_CONTENTS: Mapping[Content, str] = {
    "luminous": "weighted with V(lambda) and D65",
    "xyz": "X, Y and Z under D65",
    "rgb": "linear sRGB (IEC 61966-2-1) under D65",
}

VALUES = {
    "reflection": "BRDF in sr-1, not multiplied by the cosine",
    "transmission": "BTDF in sr-1, not multiplied by the cosine; the reflectance below is the transmittance, and light that goes straight on has the place of mirrored light",
}
"""What the numbers of a table of one side are."""


def sentences(record: Record, values: str = VALUES["reflection"]) -> list[str]:
    """The record in words, for comments of a file; ``values`` says what its numbers are."""
    error = record["error"]
    stated = (
        f"error of this table, {error['reading']} at {error['directions']} directions off its nodes: {error['percentile_95']:.2%} of "
        f"BRDF cos theta_o at the 95th percentile, {error['albedo']:.2%} of the directional reflectance"
    )
    return [
        *heading(record),
        values,
        f"{stated}; that is {more}" if (more := _more_than(error)) else stated,
        *record.get("uncertainty", ()),
        *(f"NOT in this file: {text}" for text in record["left_out"].values()),
    ]


def statements(record: Mapping[str, Any]) -> list[str]:
    """The record in words, for a terminal."""
    return [*errors_in_words(record), *(f"left out: {text}" for text in record.get("left_out", {}).values())]


def errors_in_words(record: Mapping[str, Any]) -> list[str]:
    """The errors that a record states."""
    errors = [(f"{name}: ", error, refused) for name, error, refused in _fits(record)]
    named = {"": "error", "light that passes: ": "error_of_transmission"}
    errors += [(start, record[key], "") for start, key in named.items() if isinstance(record.get(key), Mapping)]
    # Where the program averages both orders of the directions, more values do not help.
    finer = "reciprocity" not in record.get("left_out", {})
    return [start + _stated(error, refused, finer) for start, error, refused in errors]


def errors_in_brief(record: Mapping[str, Any]) -> str:
    """The errors in one sentence, for a cell of a table; of fits the least median of each formula."""
    fits = _fits(record)
    if not fits:
        return "; ".join(errors_in_words(record))
    formulas = dict.fromkeys(name.split()[0] for name, _, _ in fits)
    best = dict[str, tuple[float, str]]()
    for name, error, refused in fits:
        formula = name.split()[0]
        if not refused and error["median"] < best.get(formula, (np.inf,))[0]:
            best[formula] = error["median"], name
    medians = ", ".join(f"{name} {median:.1%}" for median, name in sorted(best.values()))
    beyond = ", ".join(one for one in formulas if one not in best)
    return f"error of BRDF·cos θ_o in the median: {medians}" + (f"; beyond a limit: {beyond}" if beyond else "")


def _fits(record: Mapping[str, Any]) -> list[tuple[str, Mapping[str, Any], str]]:
    """Name, error and refusal of each fit."""
    return [
        (name, fit["error"], str(fit.get("refused", "")))
        for one in record.get("fits", [])
        for name, fit in ((one["formula"], one), (f"{one['formula']} by incidence", one.get("by_incidence", {})))
        if "error" in fit
    ]


def _stated(error: Mapping[str, Any], refused: str, finer: bool) -> str:
    """Error of a table or of a fit in words; ``finer``: whether more values make it smaller."""
    median = f"{error['median']:.2%} in the median and " if "median" in error else ""
    parts = [
        f"{median}{error['percentile_95']:.2%} at the 95th percentile, of BRDF·cos θ_o",
        f"{error['albedo']:.2%} of the directional reflectance",
    ]
    if "peak" in error:
        parts.append(f"{error['peak']:.2%} of the BRDF in the mirror direction")
    if "delta_e_00" in error:
        parts.append(f"a colour difference of {error['delta_e_00']:.1f} (ΔE00) off the lobe")
    more = _more_than(error)
    ways = ["`brdfpipe convert --largest` allows more values"] if finer else []
    if "finer_format" in error:
        ways.append(f"`{error['finer_format']}`, whose nodes follow the lobe, errs less with a lay in most cases")
    advice = f": {', '.join(ways)}" if ways else ""
    end = f"; {more}{advice}" if more else ""
    return f"error {', '.join(parts)}{end}" + (f"; not written: {refused}" if refused else "")


def _more_than(error: Mapping[str, Any]) -> str:
    """The limits that an error exceeds, in words; empty if it keeps them or has none."""
    exceeded = [f"the {name} of {limit:.3g}" for name, limit in error.get("exceeded", {}).items()]
    return f"MORE than {' and '.join(exceeded)}" if exceeded else ""


def left_out(bsdf: xr.Dataset, format: Format, content: Content) -> dict[str, str]:
    """What the BSDF has and a file of the format does not hold: property → sentence."""
    model, lost = representation(bsdf), dict[str, str]()
    if model.transmits and not model.is_slab:
        lost["transmission"] = "the light that passes into the body"
    elif model.transmits and "transmission" not in format.carries:
        lost["transmission"] = "the light that passes to the other side"
    if not model.isotropic and "lay" not in format.carries:
        lost["lay"] = "the dependence on the azimuth of incidence: the values are the mean over it"
    if "wavelength" in bsdf.coords and content != "spectrum":
        lost["spectrum"] = f"the spectrum: the values are {_CONTENTS[content]}"
    if "specular" not in format.carries and (text := specular_shares(model)):
        lost["specular"] = text
    if known_uncertainty(bsdf) and "uncertainty" not in format.carries:
        lost["uncertainty"] = "the standard uncertainty of each value"
    if model.uses_index and "polarisation" not in format.carries:
        lost["polarisation"] = "polarisation: the values are of unpolarised light"
    return lost


def specular_shares(model: Representation) -> str:
    """The share of light in single directions, which no density holds, in words; empty where there is none."""
    shares = [part.mean(axis=-1) for part in model.specular(_STATED_AT, np.zeros_like(_STATED_AT), None)]
    texts = []
    for share, words in zip(shares, ("mirrored", "transmitted undeviated"), strict=True):
        if share.max() > NEGLIGIBLE_SHARE:
            listed = " ".join(f"{angle:g}:{value:.6f}" for angle, value in zip(_STATED_AT, share, strict=True))
            texts.append(f"the share {words} into a single direction, by theta_i in degree: {listed}")
    return "; ".join(texts)


def three_digits(value: float) -> float:
    """Three significant digits: the error depends on the choice of directions beyond them."""
    return float(f"{value:.3g}")
