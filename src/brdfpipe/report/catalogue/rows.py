"""The catalogue as a dataset: one row for each material."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import vocabulary
from brdfpipe.appearance.origin import basis, route
from brdfpipe.appearance.quantities import applicabilities, quantities, stored_unit
from brdfpipe.appearance.verdicts import stage_warnings, verdicts, worst
from brdfpipe.errors import VocabularyError
from brdfpipe.report.plots.thumbnail import thumbnail
from brdfpipe.report.shown_stages import material_name, own_stages


def text_columns() -> dict[str, str]:
    """Text variables of a row: name → long name."""
    return {
        "route": "how the BRDF was obtained",
        "basis": "inputs of the BRDF",
        "verdict": "worst verdict of the checks; warn at best where a stage has a warning; empty where nothing was checked",
        "verdict_checks": "checks and stages with that verdict, unless it is pass",
        "verdict_text": "what those checks found, or the warnings of those stages",
        **{f"no_{each.name}": f"why {each.name} does not apply; empty where it applies" for each in applicabilities()},
        "thumbnail": "small picture, a data URI; empty without a preview",
        "digests": "JSON: stage to digest of its dataset",
        "description": "description of the material by its user",
    }


def summarise(datasets: Mapping[str, xr.Dataset], *, description: str = "") -> xr.Dataset:
    """The row of one material.

    Parameters
    ----------
    datasets : stage → its dataset, as for :func:`brdfpipe.report.material_page`
    description : of the material, by its user

    Returns
    -------
    Dataset of kind ``catalogue``, dimension ``material`` of length 1: the quantities of :mod:`brdfpipe.appearance.quantities`, NaN
    where not known or not applicable; :func:`text_columns`; ``warning_count``; ``srgb`` (material, channel), NaN where not known
    """
    known = own_stages(datasets)
    digests = {stage: str(dataset.attrs["digest"]) for stage, dataset in known.items() if "digest" in dataset.attrs}
    texts = {
        "route": route(known),
        "basis": basis(known),
        **_verdict_texts(known),
        **{f"no_{each.name}": each.exclusion(known) for each in applicabilities()},
        "thumbnail": thumbnail(known["preview"]) if "preview" in known else "",
        "digests": json.dumps(digests, sort_keys=True),
        "description": description,
    }
    appearance = known.get("appearance")
    srgb = np.full(3, np.nan) if appearance is None or "srgb" not in appearance else appearance["srgb"].values
    return _dataset(
        [material_name(known)],
        {quantity.name: np.array([quantity.value(known)]) for quantity in quantities()},
        {name: [text] for name, text in texts.items()},
        np.array([len(stage_warnings(known))], dtype=np.int64),
        np.asarray(srgb, dtype=float)[None],
    )


def combine(rows: Sequence[xr.Dataset]) -> xr.Dataset:
    """One catalogue from the rows of its materials, sorted by name.

    Parameters
    ----------
    rows : kind ``catalogue``, of any number of materials each; none gives an empty catalogue

    Raises
    ------
    VocabularyError : a row is of another kind or lacks a variable, or two rows have the same name.
    """
    for row in rows:
        _check_row(row)
    # Plain arrays: xarray.concat aligns and compares every variable of every row, which takes minutes for a thousand.
    names = [str(name) for row in rows for name in row.variables["material"].values]
    repeated = [name for name, count in Counter(names).items() if count > 1]
    if repeated:
        raise VocabularyError(
            f"two materials of the catalogue are named {repeated[0]!r}; change `name` in material.yaml"
        )
    order = sorted(range(len(names)), key=names.__getitem__)

    def sorted_values(name: str) -> list[Any]:
        values = [value for row in rows for value in row.variables[name].values]
        return [values[k] for k in order]

    return _dataset(
        [names[k] for k in order],
        {quantity.name: np.array(sorted_values(quantity.name), dtype=float) for quantity in quantities()},
        {name: [str(value) for value in sorted_values(name)] for name in text_columns()},
        np.array(sorted_values("warning_count"), dtype=np.int64),
        np.array(sorted_values("srgb"), dtype=float).reshape(len(names), 3),
    )


def texts(catalogue: xr.Dataset, name: str) -> list[str]:
    """A text variable of all materials."""
    return [str(value) for value in catalogue[name].values]


def _verdict_texts(datasets: Mapping[str, xr.Dataset]) -> dict[str, str]:
    outcomes = verdicts(datasets)
    verdict = worst(outcomes)
    reasons = [] if verdict in ("", "pass") else [entry for entry in outcomes if entry.verdict == verdict]
    return {
        "verdict": verdict,
        "verdict_checks": ", ".join(entry.name for entry in reasons),
        "verdict_text": "; ".join(f"{entry.name}: {entry.text}" if entry.text else entry.name for entry in reasons),
    }


def _dataset(
    names: list[str],
    values: Mapping[str, NDArray[np.float64]],
    text_values: Mapping[str, list[str]],
    warning_count: NDArray[np.int64],
    srgb: NDArray[np.float64],
) -> xr.Dataset:
    variables: dict[str, Any] = {
        quantity.name: (
            "material",
            values[quantity.name],
            {"units": stored_unit(quantity), "long_name": quantity.definition},
        )
        for quantity in quantities()
    }
    variables |= {
        name: ("material", np.array(text_values[name], dtype=str), {"long_name": long_name})
        for name, long_name in text_columns().items()
    }
    variables["warning_count"] = ("material", warning_count, {"units": "1", "long_name": "number of warnings"})
    # Not the vocabulary's ``srgb``: a material without a colour is NaN here.
    variables["srgb"] = (("material", "channel"), srgb)
    coordinates = {
        "material": ("material", np.array(names, dtype=str), {"long_name": "name of the material"}),
        "channel": list("RGB"),
    }
    return vocabulary.label(xr.Dataset(variables, coords=coordinates), "catalogue")


def _check_row(row: xr.Dataset) -> None:
    if row.attrs.get("kind") != "catalogue":
        raise VocabularyError(f"expected a dataset of kind 'catalogue', found kind {row.attrs.get('kind')!r}")
    needed = (*(quantity.name for quantity in quantities()), *text_columns(), "material", "warning_count", "srgb")
    absent = [name for name in needed if name not in row.variables]
    if absent:
        raise VocabularyError(
            f"a row of the catalogue lacks {absent[0]!r}; found {', '.join(map(str, row.variables))}; build the material again"
        )
