"""The catalogue as comma-separated values, and the digests of all its datasets."""

from __future__ import annotations

import json
from collections.abc import Mapping

import numpy as np
import xarray as xr

from brdfpipe.appearance.quantities import quantities
from brdfpipe.report.catalogue.rows import texts
from brdfpipe.report.formatting import colour

_ROUNDING_ERROR = 1e-9
"""Largest magnitude that is written as 0: the rounding error of sums."""


def catalogue_csv(catalogue: xr.Dataset, failures: Mapping[str, Mapping[str, str]]) -> str:
    """The catalogue as comma-separated values, one line for each material, failed ones included.

    Parameters
    ----------
    catalogue : kind ``catalogue``
    failures : material → ``stage`` and ``message``

    Notes
    -----
    A spreadsheet reads text that starts with ``= + - @`` as a formula. Such text from users and their files gets an apostrophe in
    front. Control characters and line breaks become spaces.
    """
    import pandas as pd

    built = pd.DataFrame({"material": texts(catalogue, "material")})
    built["status"] = "built"
    for name in ("route", "basis", "verdict", "verdict_checks", "verdict_text"):
        built[name] = texts(catalogue, name)
    built["warnings"] = catalogue["warning_count"].values.astype(int)
    for quantity in quantities():
        values = catalogue[quantity.name].values.astype(float)
        built[quantity.name] = np.where(np.abs(values) < _ROUNDING_ERROR, 0.0, values)
    built["srgb"] = [colour(channels) or "" for channels in catalogue["srgb"].values]
    built["description"] = texts(catalogue, "description")
    failed = pd.DataFrame(
        [(name, "failed", entry.get("stage", ""), entry.get("message", "")) for name, entry in failures.items()],
        columns=["material", "status", "stage", "message"],
    )
    # Rebuilt from records and not concatenated: pandas would turn the counts into floats.
    table = pd.DataFrame(
        [*built.to_dict("records"), *failed.to_dict("records")], columns=[*built.columns, "stage", "message"]
    )
    table["warnings"] = table["warnings"].astype("Int64")
    table = table.sort_values("material", kind="stable")
    for name in ("material", "route", "basis", "verdict_text", "description", "stage", "message"):
        table[name] = [_escape_formula(value) if isinstance(value, str) else value for value in table[name]]
    return str(table.to_csv(index=False, float_format="%.6g", lineterminator="\n"))


def lock(catalogue: xr.Dataset) -> str:
    """JSON {material: {stage: digest}}: equal for two catalogues exactly when all their datasets are equal."""
    digests = {
        name: json.loads(text)
        for name, text in zip(texts(catalogue, "material"), texts(catalogue, "digests"), strict=True)
    }
    return json.dumps(digests, indent=1, sort_keys=True, ensure_ascii=False) + "\n"


def _escape_formula(text: str) -> str:
    line = "".join(character if character.isprintable() else " " for character in text).strip()
    return "'" + line if line[:1] in tuple("=+-@") else line
