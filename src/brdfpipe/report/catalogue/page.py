"""The page of the catalogue."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Container, Mapping, Sequence
from typing import Any
from urllib.parse import quote

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.appearance.quantities import AppearanceQuantity
from brdfpipe.appearance.verdicts import VERDICTS
from brdfpipe.report import rendering, structured_data
from brdfpipe.report.catalogue import cuts
from brdfpipe.report.catalogue.rows import listed_quantities, texts
from brdfpipe.report.formatting import MISSING, colour, value_with_u
from brdfpipe.report.plots.bsdf_sections import REFERENCE_WAVELENGTH
from brdfpipe.report.rendering import as_json, render

_UNITS = {"um": "µm", "cd m-2": "cd/m²"}
"""Units in headings."""

_LONGEST_DESCRIPTION = 90
"""Characters of a description in the table."""

_LONGEST_REASON = 240
"""Characters of the reason of a verdict in its tooltip. The CSV and the page of the material contain all of it."""


def catalogue_page(
    catalogue: xr.Dataset,
    failures: Mapping[str, Mapping[str, str]],
    *,
    pages: Container[str] | None = None,
    scene: Mapping[str, str] | None = None,
    others: Sequence[tuple[str, str]] = (),
    changes: str = "",
) -> str:
    """The page of the catalogue: a table that is readable without scripts, and sorts and filters with its own script.

    Parameters
    ----------
    catalogue : kind ``catalogue``
    failures : material → ``stage`` and ``message``; shown first
    pages : materials that have a page; by default all
    scene : ``name`` and ``purpose`` of the scene; None for the default one
    others : names of the other scenes whose catalogues are in the same results, and the links to their pages
    changes : link to the page of what changed since an earlier build; empty without one

    Returns
    -------
    HTML in one file; its policy allows the inline script by its hash, and no request to elsewhere
    """
    vocabulary.validate(catalogue, "catalogue")
    listed = listed_quantities(catalogue.variables)
    shown = [
        quantity
        for quantity in listed
        if quantity.listed and np.isfinite(catalogue[quantity.name].values.astype(float)).any()
    ]
    order = _order(catalogue)
    script, script_hash = rendering.script("uPlot.js", "catalogue.js")
    named = scene or {"name": "", "purpose": ""}
    return render(
        "catalogue.html.j2",
        linked_data=structured_data.of_catalogue(named["name"], named["purpose"]),
        script=script,
        script_hash=script_hash,
        data=as_json(_data(catalogue, [quantity.name for quantity in shown], order)),
        offsets=cuts.OFFSETS.size,
        wavelength_words=f"at the wavelength of each material nearest to {REFERENCE_WAVELENGTH:g} nm",
        headings=[
            f"{quantity.label}, {_UNITS[quantity.unit]}" if quantity.unit in _UNITS else quantity.label
            for quantity in shown
        ],
        scopes=[
            f"{quantity.label} applies to {quantity.applicability.words}."
            for quantity in shown
            if quantity.applicability and quantity.applicability.blank
        ],
        pictured=any(texts(catalogue, "thumbnail")),
        rows=_page_rows(catalogue.isel(material=order), shown, pages),
        failures=[(name, str(e.get("stage", "")), str(e.get("message", ""))) for name, e in sorted(failures.items())],
        counts=Counter(texts(catalogue, "verdict")),
        scene=scene,
        others=others,
        changes=changes,
    )


def _page_rows(
    catalogue: xr.Dataset, shown: Sequence[AppearanceQuantity], pages: Container[str] | None
) -> list[dict[str, Any]]:
    """What the table shows, row by row."""
    columns = [_cells(catalogue, quantity) for quantity in shown]
    names, descriptions, bases = (texts(catalogue, name) for name in ("material", "description", "basis"))
    rows = {
        "name": names,
        "link": [f"{quote(name, safe='')}/report.html" if pages is None or name in pages else "" for name in names],
        "words": [_subtitle(*pair) for pair in zip(descriptions, bases, strict=True)],
        "picture": texts(catalogue, "thumbnail"),
        "colour": [colour(srgb) for srgb in catalogue["srgb"].values],
        "cells": list(zip(*columns, strict=True)) or [()] * len(names),
        "verdict": texts(catalogue, "verdict"),
        "checks": texts(catalogue, "verdict_checks"),
        "reason": [_shortened(reason, _LONGEST_REASON) for reason in texts(catalogue, "verdict_text")],
        "warnings": catalogue["warning_count"].values.tolist(),
    }
    return [dict(zip(rows, values, strict=True)) for values in zip(*rows.values(), strict=True)]


def _order(catalogue: xr.Dataset) -> list[int]:
    """The rows in the order of the page: worst verdict first, then by name."""
    rank = {verdict: k for k, verdict in enumerate(VERDICTS)}
    names, verdicts = texts(catalogue, "material"), texts(catalogue, "verdict")
    return sorted(range(len(names)), key=lambda k: (rank.get(verdicts[k], len(rank)), _natural_key(names[k])))


def _data(catalogue: xr.Dataset, shown: Sequence[str], order: Sequence[int]) -> dict[str, Any]:
    """What the script needs beside the table, in the order of its rows: colours, routes and cuts of the BRDFs."""
    rows = catalogue.isel(material=order)
    lab = np.stack([rows[name].values.astype(float) for name in "Lab"], axis=-1).round(2)
    route = texts(rows, "route")
    routes = sorted(set(route))
    return {
        "quantities": list(shown),
        "lab": [None if np.isnan(one).any() else one.tolist() for one in lab],
        "routes": routes,
        "route": [routes.index(one) for one in route],
        "scale": cuts.scale(),
        "cuts": cuts.packed(rows["brdf_cut"].values),
    }


def _cells(catalogue: xr.Dataset, quantity: AppearanceQuantity) -> list[tuple[str, str, str]]:
    """Value, standard uncertainty and tooltip of each cell of a column; the tooltip is the reason of a missing value."""
    values = catalogue[quantity.name].values.astype(float).tolist()
    uncertainties = catalogue[quantity.u_name].values.astype(float).tolist() if quantity.u else [math.nan] * len(values)
    applicability = quantity.applicability
    if applicability is None:
        reasons, missing = [""] * len(values), MISSING
    else:
        reasons = [reason.replace("`", "") for reason in texts(catalogue, f"no_{applicability.name}")]
        missing = "" if applicability.blank else MISSING
    cells = []
    for value, u, reason in zip(values, uncertainties, reasons, strict=True):
        shown, _, shown_u = value_with_u(value, u, quantity.decimals).partition(" ± ")
        cells.append((missing, "", reason) if math.isnan(value) else (shown, shown_u, ""))
    return cells


def _subtitle(description: str, basis: str) -> str:
    # A measured surface is the usual basis; any other one is stated.
    parts = (_shortened(description, _LONGEST_DESCRIPTION), "" if basis.startswith("surface") else basis)
    return " · ".join(part for part in parts if part)


def _natural_key(name: str) -> list[Any]:
    """Sorts pp-2 before pp-10, as the script of the page does."""
    return [int(part) if k % 2 else part.casefold() for k, part in enumerate(re.split(r"(\d+)", name))]


def _shortened(text: str, longest: int) -> str:
    return text if len(text) <= longest else text[: longest - 1].rstrip() + "…"
