"""A BSDF in a few lines, for people: what it is, of what it was made, and how much light it reflects."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr
from markupsafe import escape

from brdfpipe import vocabulary
from brdfpipe.bsdf.registry import representation
from brdfpipe.errors import printable, shortened
from brdfpipe.geometry import Array

INCIDENCES = (8.0, 45.0, 75.0)
"""Angles of incidence of the stated reflectances [degree]; the first is that of spectrophotometers with a sphere."""

_WAVELENGTHS = (450.0, 550.0, 650.0)
"""Wavelengths of the stated reflectances [nm], where the data cover them."""

_MOST = 200
"""Characters of a warning."""


def properties(bsdf: xr.Dataset) -> dict[str, str]:
    """What a BSDF is, by name, in words."""
    evaluator, attrs = representation(bsdf), bsdf.attrs
    sides = "reflection and transmission" if evaluator.transmits else "reflection"
    lay = "no lay"
    if "light_azimuth" in attrs:
        lay = f"that of the source is left out: for light from azimuth {float(attrs['light_azimuth']):g}° alone"
    elif not evaluator.isotropic:
        lay = "depends on the azimuth" if evaluator.lay is None else f"{round(evaluator.lay, 1):g}°"
    if bsdf.sizes.get("wavelength") and bsdf["wavelength"].ndim == 1:
        nm = bsdf["wavelength"].values
        spectral = f"{nm[0]:g} to {nm[-1]:g} nm, {nm.size} values"
    else:
        spectral = "all alike"
    words = {
        "material": str(attrs.get("material", "")),
        "route": str(attrs.get("route", "")),
        "representation": evaluator.name,
        "sides": sides,
        "wavelengths": spectral,
        "lay": lay,
        "uncertainty": _uncertainty(bsdf),
    }
    return {name: printable(text) for name, text in words.items() if text}


def reflectances(bsdf: xr.Dataset) -> tuple[Array, list[str], Array]:
    """The directional reflectance at a few incidences and wavelengths.

    Returns
    -------
    Incidences [degree], names of the wavelengths, and the reflectance [1], mirror reflection included: (incidence, wavelength)
    """
    incidences = np.array(INCIDENCES)
    wavelengths: Array | None = None
    names = ["all wavelengths"]
    if bsdf.sizes.get("wavelength") and bsdf["wavelength"].ndim == 1:
        own = bsdf["wavelength"].values.astype(float)
        inside = [nm for nm in _WAVELENGTHS if own[0] <= nm <= own[-1]]
        wavelengths = np.array(inside or own[[own.size // 2]])
        names = [f"{nm:g} nm" for nm in wavelengths]
    values = representation(bsdf).albedo(incidences, np.zeros_like(incidences), wavelengths)
    return incidences, names, np.broadcast_to(values, (incidences.size, len(names)))


def warnings_of(bsdf: xr.Dataset) -> list[str]:
    """What the stages warned of."""
    return [printable(str(one)) for one in vocabulary.warnings(bsdf)]


def text(bsdf: xr.Dataset) -> str:
    """The summary as lines of text."""
    known = properties(bsdf)
    width = max(map(len, known)) + 2
    lines = [
        f"<BSDF: {known.pop('material', 'no name')}>",
        *(f"  {name:<{width}}{words}" for name, words in known.items()),
    ]
    incidences, names, values = reflectances(bsdf)
    lines.append(f"  {'reflectance':<{width}}" + "  ".join(f"{name:>8}" for name in names))
    for incidence, row in zip(incidences, values, strict=True):
        lines.append(f"  {f'  at {incidence:g}°':<{width}}" + "  ".join(f"{value:8.4f}" for value in row))
    lines += [f"  warning: {shortened(one, _MOST)}" for one in warnings_of(bsdf)]
    return "\n".join(lines)


def html(bsdf: xr.Dataset) -> str:
    """The summary as a fragment of HTML for notebooks; texts of the dataset are escaped."""
    known = properties(bsdf)
    title = escape(known.pop("material", "no name"))
    incidences, names, values = reflectances(bsdf)
    head = "".join(f"<th>{escape(name)}</th>" for name in names)
    rows = "".join(
        f"<tr><th>{incidence:g}°</th>{''.join(f'<td>{value:.4f}</td>' for value in row)}</tr>"
        for incidence, row in zip(incidences, values, strict=True)
    )
    notes = "".join(f"<li>{escape(one)}</li>" for one in warnings_of(bsdf))
    return (
        f"<div><strong>BSDF: {title}</strong>{_rows(known)}"
        f"<table><tr><th>reflectance at</th>{head}</tr>{rows}</table>"
        f"{f'<details><summary>Warnings</summary><ul>{notes}</ul></details>' if notes else ''}</div>"
    )


def _rows(known: Mapping[str, str]) -> str:
    cells = (
        f"<tr><th style='text-align:left'>{escape(name)}</th><td>{escape(words)}</td></tr>"
        for name, words in known.items()
    )
    return f"<table>{''.join(cells)}</table>"


def _uncertainty(bsdf: xr.Dataset) -> str:
    """The sources of the uncertainty that is stated, and what is not."""
    missing = str(bsdf.attrs.get("uncertainty_not_stated", ""))
    without = f"; not stated: {missing}" if missing else ""
    if "uncertainty_source" in bsdf.coords:
        sources = dict.fromkeys(map(str, np.atleast_1d(bsdf["uncertainty_source"].values)))
        return f"from {', '.join(sources)}{without}"
    return "stated by the measurement" if representation(bsdf).states_uncertainty else "not stated"
