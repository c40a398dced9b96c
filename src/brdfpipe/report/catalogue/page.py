"""The page of the catalogue."""

from __future__ import annotations

import math
import re
from base64 import b64encode
from collections import Counter
from collections.abc import Container, Mapping, Sequence
from hashlib import sha256
from typing import Any
from urllib.parse import quote

import numpy as np
import xarray as xr
from markupsafe import Markup

from brdfpipe import vocabulary
from brdfpipe.appearance.quantities import AppearanceQuantity
from brdfpipe.appearance.verdicts import VERDICTS
from brdfpipe.report import structured_data
from brdfpipe.report.catalogue.rows import listed_quantities, texts
from brdfpipe.report.formatting import MISSING, colour, value_with_u
from brdfpipe.report.rendering import TEMPLATES, render

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
) -> str:
    """The page of the catalogue: a table that is readable without scripts, and sorts and filters with its own script.

    Parameters
    ----------
    catalogue : kind ``catalogue``
    failures : material → ``stage`` and ``message``; shown first
    pages : materials that have a page; by default all
    scene : ``name`` and ``purpose`` of the scene; None for the default one
    others : names of the other scenes whose catalogues are in the same results, and the links to their pages

    Returns
    -------
    HTML in one file; its policy allows the inline script by its hash, and no request to elsewhere
    """
    script = (TEMPLATES / "catalogue.js").read_text("utf-8")
    vocabulary.validate(catalogue, "catalogue")
    listed = listed_quantities(catalogue.variables)
    shown = [
        quantity
        for quantity in listed
        if quantity.listed and np.isfinite(catalogue[quantity.name].values.astype(float)).any()
    ]
    named = scene or {"name": "", "purpose": ""}
    return render(
        "catalogue.html.j2",
        linked_data=structured_data.of_catalogue(named["name"], named["purpose"]),
        script=Markup(script),
        script_hash=b64encode(sha256(script.encode()).digest()).decode(),
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
        rows=_page_rows(catalogue, shown, pages),
        failures=[(name, str(e.get("stage", "")), str(e.get("message", ""))) for name, e in sorted(failures.items())],
        counts=Counter(texts(catalogue, "verdict")),
        scene=scene,
        others=others,
    )


def _page_rows(
    catalogue: xr.Dataset, shown: Sequence[AppearanceQuantity], pages: Container[str] | None
) -> list[dict[str, Any]]:
    """The rows in the order of the page: worst verdict first, then by name."""
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
    rank = {verdict: k for k, verdict in enumerate(VERDICTS)}
    records = [dict(zip(rows, values, strict=True)) for values in zip(*rows.values(), strict=True)]
    return sorted(records, key=lambda row: (rank.get(row["verdict"], len(rank)), _natural_key(row["name"])))


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
