"""The page of the catalogue."""

from __future__ import annotations

import math
import re
from base64 import b64encode
from collections import Counter
from collections.abc import Mapping, Sequence
from hashlib import sha256
from typing import Any
from urllib.parse import quote

import numpy as np
import xarray as xr
from markupsafe import Markup

from brdfpipe import vocabulary
from brdfpipe.appearance.quantities import AppearanceQuantity, quantities
from brdfpipe.appearance.verdicts import VERDICTS
from brdfpipe.report.catalogue.rows import texts
from brdfpipe.report.formatting import colour, fixed
from brdfpipe.report.pages import TEMPLATES, render

_LONGEST_DESCRIPTION = 90
"""Characters of a description in the table."""

_LONGEST_REASON = 240
"""Characters of the reason of a verdict in its tooltip. The CSV and the page of the material contain all of it."""


def catalogue_page(catalogue: xr.Dataset, failures: Mapping[str, Mapping[str, str]]) -> str:
    """The page of the catalogue: a table that is readable without scripts, and sorts and filters with its own script.

    Parameters
    ----------
    catalogue : kind ``catalogue``
    failures : material → ``stage`` and ``message``; shown first

    Returns
    -------
    HTML in one file; its policy allows the inline script by its hash, and no request to elsewhere
    """
    script = (TEMPLATES / "catalogue.js").read_text("utf-8")
    vocabulary.validate(catalogue, "catalogue")
    shown = [
        quantity
        for quantity in quantities()
        if quantity.in_catalogue and np.isfinite(catalogue[quantity.name].values.astype(float)).any()
    ]
    return render(
        "catalogue.html.j2",
        script=Markup(script),
        script_hash=b64encode(sha256(script.encode()).digest()).decode(),
        headings=[_heading(quantity) for quantity in shown],
        scopes=_scopes(shown),
        pictured=any(texts(catalogue, "thumbnail")),
        rows=_page_rows(catalogue, shown),
        failures=[(name, str(e.get("stage", "")), str(e.get("message", ""))) for name, e in sorted(failures.items())],
        counts=Counter(texts(catalogue, "verdict")),
    )


def _heading(quantity: AppearanceQuantity) -> str:
    return f"{quantity.label}, µm" if quantity.unit == "um" else quantity.label


def _scopes(shown: Sequence[AppearanceQuantity]) -> list[str]:
    """To which materials a quantity applies, where its cells may be blank."""
    return [
        f"{quantity.label} applies to {quantity.applicability.words}."
        for quantity in shown
        if quantity.applicability and quantity.applicability.blank
    ]


def _page_rows(catalogue: xr.Dataset, shown: Sequence[AppearanceQuantity]) -> list[dict[str, Any]]:
    """The rows in the order of the page: worst verdict first, then by name."""
    columns = [_cells(catalogue, quantity) for quantity in shown]
    cells = list(zip(*columns, strict=True)) or [()] * catalogue.sizes["material"]
    pictures = texts(catalogue, "thumbnail")
    names, verdicts = texts(catalogue, "material"), texts(catalogue, "verdict")
    descriptions, bases = texts(catalogue, "description"), texts(catalogue, "basis")
    checks, reasons = texts(catalogue, "verdict_checks"), texts(catalogue, "verdict_text")
    warnings, srgb = catalogue["warning_count"].values.tolist(), catalogue["srgb"].values
    rank = {verdict: k for k, verdict in enumerate(VERDICTS)}
    order = sorted(range(len(names)), key=lambda k: (rank.get(verdicts[k], len(rank)), _natural_key(names[k])))
    return [
        {
            "name": names[k],
            "link": f"{quote(names[k], safe='')}/report.html",
            "words": _subtitle(descriptions[k], bases[k]),
            "picture": pictures[k],
            "colour": colour(srgb[k]),
            "cells": cells[k],
            "verdict": verdicts[k],
            "checks": checks[k],
            "reason": _shortened(reasons[k], _LONGEST_REASON),
            "warnings": int(warnings[k]),
        }
        for k in order
    ]


def _cells(catalogue: xr.Dataset, quantity: AppearanceQuantity) -> list[tuple[str, str]]:
    """Text and tooltip of each cell of a column."""
    values = catalogue[quantity.name].values.astype(float).tolist()
    applicability = quantity.applicability
    if applicability is None:
        return [(fixed(value, quantity.decimals), "") for value in values]
    reasons = texts(catalogue, f"no_{applicability.name}")
    return [
        ("", reason.replace("`", ""))
        if math.isnan(value) and applicability.blank
        else (fixed(value, quantity.decimals), reason.replace("`", "") if math.isnan(value) else "")
        for value, reason in zip(values, reasons, strict=True)
    ]


def _subtitle(description: str, basis: str) -> str:
    # A measured surface is the rule; any other basis is stated.
    parts = (_shortened(description, _LONGEST_DESCRIPTION), "" if basis.startswith("surface") else basis)
    return " · ".join(part for part in parts if part)


def _natural_key(name: str) -> list[Any]:
    """Sorts pp-2 before pp-10, as the script of the page does."""
    return [int(part) if k % 2 else part.casefold() for k, part in enumerate(re.split(r"(\d+)", name))]


def _shortened(text: str, longest: int) -> str:
    return text if len(text) <= longest else text[: longest - 1].rstrip() + "…"
