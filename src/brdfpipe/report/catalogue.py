"""The catalogue: one row a material, as a dataset, as a table for a spreadsheet, and as a page to search."""

from __future__ import annotations

import json
import math
import re
from base64 import b64encode
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from typing import Any
from urllib.parse import quote

import numpy as np
import xarray as xr
from markupsafe import Markup

from brdfpipe import vocabulary
from brdfpipe.errors import VocabularyError
from brdfpipe.report.material import page
from brdfpipe.report.pages import TEMPLATES, VERDICTS, colour, fixed, render, worst
from brdfpipe.report.thumbnail import thumbnail


@dataclass(frozen=True)
class Number:
    """A numeric column: what it means, and how it is headed and written on the page."""

    long_name: str
    heading: str = ""
    """Empty: not shown on the page."""
    decimals: int = 1


NUMBERS: Mapping[str, Number] = {
    "gloss_20": Number("gloss units at 20 degree, D523-style", "Gloss 20°"),
    "gloss_60": Number("gloss units at 60 degree, D523-style", "Gloss 60°"),
    "gloss_85": Number("gloss units at 85 degree, D523-style", "Gloss 85°"),
    "haze": Number(
        "gloss at 60 degree minus gloss at 20 degree, D4039-style; empty outside of its scope, nonmetallic surfaces of more than 70 gloss "
        "units at 60 degree",
        "Haze D4039",
    ),
    "L": Number("CIE 1976 lightness L* at the first geometry of the appearance", "L*"),
    "a": Number("CIE 1976 a* at the first geometry of the appearance", "a*"),
    "b": Number("CIE 1976 b* at the first geometry of the appearance", "b*"),
    "luminous_reflectance": Number("total reflectance at 8 degree, weighted with V(λ) and D65", "Reflectance", 3),
    "luminous_transmittance": Number(
        "total transmittance at normal incidence, weighted with V(λ) and D65; empty where nothing passes",
        "Transmittance",
        3,
    ),
    "transmission_haze": Number(
        "share of the transmitted light scattered by more than 2.5 degree, D1003-style", "Haze D1003", 3
    ),
    "slope_rms": Number("root mean square slope of the facets", "rms slope", 3),
    "anisotropy": Number("larger over smaller principal slope rms", "Anisotropy", 2),
}

WORDS: Mapping[str, str] = {
    "route": "how the BRDF came about",
    "basis": "what it rests on",
    "verdict": "worst verdict of the checks, warn at best where a stage warned; empty where nothing was checked",
    "verdict_checks": "checks and stages with that verdict, unless it is pass",
    "verdict_text": "what those checks found, or the stages warned of",
    "no_gloss": "why no gloss is given; empty where it is",
    "no_haze": "why no haze is given; empty where it is",
    "thumbnail": "small picture, a data URI; empty without a preview",
    "digests": "JSON: stage to digest of its dataset",
}
"""Text of a row beside its name and description."""

GLOSS_ANGLES = (20, 60, 85)

_ROUNDING = 1e-9
"""What a sum leaves of zero."""

_MOST_WORDS = 240
"""Characters of what a verdict says when pointed at; all of it is in the table and on the material's page."""


def summarise(datasets: Mapping[str, xr.Dataset], *, description: str = "") -> xr.Dataset:
    """The row of one material.

    Parameters
    ----------
    datasets : stage → its dataset, as for :func:`brdfpipe.report.material_page`
    description : the material's own words

    Returns
    -------
    Dataset of kind ``catalogue``, dimension ``material`` of length 1: :data:`NUMBERS` [1], NaN where not known (also the
    gloss of a finish that was neither measured nor assumed, or of flakes without their clear coat); :data:`WORDS`,
    ``description``; ``warning_count``; ``srgb`` (material, channel), NaN where not known
    """
    known = page.own_stages(datasets)
    numbers = {**dict.fromkeys(NUMBERS, math.nan), **_numbers(known)}
    words = {
        "route": page.route(known),
        "basis": page.basis(known),
        "digests": json.dumps(
            {s: str(d.attrs["digest"]) for s, d in known.items() if "digest" in d.attrs}, sort_keys=True
        ),
        "description": description,
        "no_gloss": page.no_gloss(known),
        "no_haze": page.no_haze(known),
        "thumbnail": thumbnail(known["preview"]) if "preview" in known else "",
    }
    words |= _verdict_words(known)
    appearance = known.get("appearance")
    srgb = np.full(3, np.nan) if appearance is None or "srgb" not in appearance else appearance["srgb"].values
    return _dataset(
        [page.material_name(known)],
        {name: np.array([value]) for name, value in numbers.items()},
        {name: [value] for name, value in words.items()},
        np.array([len(page.stage_warnings(known))], dtype=np.int64),
        np.asarray(srgb, dtype=float)[None],
    )


def combine(rows: Sequence[xr.Dataset]) -> xr.Dataset:
    """One catalogue from the rows of its materials, sorted by name.

    Parameters
    ----------
    rows : kind ``catalogue``, of any number of materials each; none gives an empty catalogue

    Raises
    ------
    VocabularyError : a row is of another kind or lacks a variable, or two rows have one name.
    """
    for row in rows:
        _check_row(row)
    # Plain arrays: xarray.concat aligns and compares every variable of every row, which takes minutes for a thousand.
    names = [str(name) for row in rows for name in row.variables["material"].values]
    repeated = [name for name, count in Counter(names).items() if count > 1]
    if repeated:
        raise VocabularyError(f"two materials of the catalogue are named {repeated[0]!r}; set `name` in material.yaml")
    order = sorted(range(len(names)), key=names.__getitem__)

    def gathered(name: str) -> list[Any]:
        values = [value for row in rows for value in row.variables[name].values]
        return [values[k] for k in order]

    return _dataset(
        [names[k] for k in order],
        {name: np.array(gathered(name), dtype=float) for name in NUMBERS},
        {name: [str(value) for value in gathered(name)] for name in (*WORDS, "description")},
        np.array(gathered("warning_count"), dtype=np.int64),
        np.array(gathered("srgb"), dtype=float).reshape(len(names), 3),
    )


def catalogue_csv(catalogue: xr.Dataset, failures: Mapping[str, Mapping[str, str]]) -> str:
    """The catalogue as comma-separated values, one line a material, failed ones included.

    Parameters
    ----------
    catalogue : kind ``catalogue``
    failures : material → ``stage`` and ``message``

    Notes
    -----
    A spreadsheet takes text that starts with ``= + - @`` as a formula: such text, which users and their files wrote, gets an
    apostrophe in front. Control characters and line breaks become spaces.
    """
    import pandas as pd

    built = pd.DataFrame({"material": _text(catalogue, "material")})
    built["status"] = "built"
    for name in ("route", "basis", "verdict", "verdict_checks", "verdict_text"):
        built[name] = _text(catalogue, name)
    built["warnings"] = catalogue["warning_count"].values.astype(int)
    for name in NUMBERS:
        values = catalogue[name].values.astype(float)
        built[name] = np.where(np.abs(values) < _ROUNDING, 0.0, values)
    built["srgb"] = [colour(channels) or "" for channels in catalogue["srgb"].values]
    built["description"] = _text(catalogue, "description")
    failed = pd.DataFrame(
        [(name, "failed", entry.get("stage", ""), entry.get("message", "")) for name, entry in failures.items()],
        columns=["material", "status", "stage", "message"],
    )
    # Rebuilt text by text and not concatenated: pandas would turn the counts into floats.
    table = pd.DataFrame(
        [*built.to_dict("records"), *failed.to_dict("records")], columns=[*built.columns, "stage", "message"]
    )
    table["warnings"] = table["warnings"].astype("Int64")
    table = table.sort_values("material", kind="stable")
    for name in ("material", "route", "basis", "verdict_text", "description", "stage", "message"):
        table[name] = [_harmless(value) if isinstance(value, str) else value for value in table[name]]
    return str(table.to_csv(index=False, float_format="%.6g", lineterminator="\n"))


def lock(catalogue: xr.Dataset) -> str:
    """JSON {material: {stage: digest}}: equal for two catalogues exactly when all their datasets are."""
    digests = {
        name: json.loads(text)
        for name, text in zip(_text(catalogue, "material"), _text(catalogue, "digests"), strict=True)
    }
    return json.dumps(digests, indent=1, sort_keys=True, ensure_ascii=False) + "\n"


def catalogue_page(catalogue: xr.Dataset, failures: Mapping[str, Mapping[str, str]]) -> str:
    """The page of the catalogue: a table that reads without scripts, and sorts and filters with its own one.

    Parameters
    ----------
    catalogue : kind ``catalogue``
    failures : material → ``stage`` and ``message``; shown first

    Returns
    -------
    HTML in one file; its policy allows the one inline script by its hash and no request to elsewhere
    """
    script = (TEMPLATES / "catalogue.js").read_text("utf-8")
    vocabulary.validate(catalogue, "catalogue")
    shown = _columns(catalogue)
    return render(
        "catalogue.html.j2",
        script=Markup(script),
        script_hash=b64encode(sha256(script.encode()).digest()).decode(),
        headings=[NUMBERS[name].heading for name in shown],
        haze="haze" in shown,
        pictured=any(_text(catalogue, "thumbnail")),
        rows=_page_rows(catalogue, shown),
        failures=[(name, str(e.get("stage", "")), str(e.get("message", ""))) for name, e in sorted(failures.items())],
        counts=Counter(_text(catalogue, "verdict")),
    )


def _columns(catalogue: xr.Dataset) -> dict[str, np.ndarray[Any, np.dtype[np.float64]]]:
    """The numbers shown, those that some material has."""
    columns = {name: catalogue[name].values.astype(float) for name, number in NUMBERS.items() if number.heading}
    return {name: values for name, values in columns.items() if np.isfinite(values).any()}


def _page_rows(
    catalogue: xr.Dataset, shown: Mapping[str, np.ndarray[Any, np.dtype[np.float64]]]
) -> list[dict[str, Any]]:
    """The rows as shown: worst verdict first, then by name."""
    columns = [
        [_cell(name, value, why) for value, why in zip(values.tolist(), _reasons(catalogue, name), strict=True)]
        for name, values in shown.items()
    ]
    cells = list(zip(*columns, strict=True)) or [()] * catalogue.sizes["material"]
    pictures = _text(catalogue, "thumbnail")
    names, verdicts = _text(catalogue, "material"), _text(catalogue, "verdict")
    descriptions, bases = _text(catalogue, "description"), _text(catalogue, "basis")
    checks, reasons = _text(catalogue, "verdict_checks"), _text(catalogue, "verdict_text")
    warnings, srgb = catalogue["warning_count"].values.tolist(), catalogue["srgb"].values
    rank = {verdict: k for k, verdict in enumerate(VERDICTS)}
    order = sorted(range(len(names)), key=lambda k: (rank.get(verdicts[k], len(rank)), _natural(names[k])))
    return [
        {
            "name": names[k],
            "link": f"{quote(names[k], safe='')}/report.html",
            # What rests on a measured surface is the rule; anything else is worth a word.
            "words": " · ".join(
                text
                for text in (_shortened(descriptions[k]), "" if bases[k].startswith("surface") else bases[k])
                if text
            ),
            "picture": pictures[k],
            "colour": colour(srgb[k]),
            "cells": cells[k],
            "verdict": verdicts[k],
            "checks": checks[k],
            "reason": _shortened(reasons[k], _MOST_WORDS),
            "warnings": int(warnings[k]),
        }
        for k in order
    ]


def _reasons(catalogue: xr.Dataset, name: str) -> list[str]:
    """Why each material lacks a number, as far as a row tells."""
    column = "no_haze" if name == "haze" else "no_gloss" if name.startswith("gloss_") else ""
    return _text(catalogue, column) if column else [""] * catalogue.sizes["material"]


def _cell(name: str, value: float, why: str) -> tuple[str, str]:
    """What a cell shows, and what it says when pointed at."""
    if not math.isnan(value):
        return fixed(value, NUMBERS[name].decimals), ""
    # Haze does not apply to a matt material; that is no missing number.
    return "" if name == "haze" else fixed(value, 0), why.replace("`", "")


def _natural(name: str) -> list[Any]:
    """Sorts pp-2 before pp-10, as the page's script does."""
    return [int(part) if k % 2 else part.casefold() for k, part in enumerate(re.split(r"(\d+)", name))]


def _verdict_words(datasets: Mapping[str, xr.Dataset]) -> dict[str, str]:
    found = page.verdicts(datasets)
    verdict = worst([entry.verdict for entry in found])
    blamed = [] if verdict in ("", "pass") else [entry for entry in found if entry.verdict == verdict]
    return {
        "verdict": verdict,
        "verdict_checks": ", ".join(entry.name for entry in blamed),
        "verdict_text": "; ".join(f"{entry.name}: {entry.text}" if entry.text else entry.name for entry in blamed),
    }


def _numbers(datasets: Mapping[str, xr.Dataset]) -> dict[str, float]:
    numbers = {"luminous_reflectance": page.luminous_reflectance(datasets), "haze": page.haze(datasets)}
    appearance = datasets.get("appearance")
    if appearance is not None and "gloss" in appearance and not page.no_gloss(datasets):
        gloss = dict(zip(appearance["gloss_angle"].values.tolist(), appearance["gloss"].values.tolist(), strict=True))
        numbers |= {f"gloss_{angle}": gloss[angle] for angle in GLOSS_ANGLES if angle in gloss}
    if appearance is not None:
        passed = ("luminous_transmittance", "transmission_haze")
        numbers |= {name: float(appearance[name]) for name in passed if name in appearance}
    lab = page.primary_lab(appearance)
    if lab is not None:
        numbers |= dict(zip("Lab", lab[1], strict=True))
    facets = datasets.get("facets")
    if facets is not None:
        numbers |= {name: float(facets[name]) for name in ("slope_rms", "anisotropy") if name in facets}
    return numbers


def _dataset(
    names: list[str],
    numbers: Mapping[str, np.ndarray[Any, np.dtype[np.float64]]],
    words: Mapping[str, list[str]],
    warning_count: np.ndarray[Any, np.dtype[np.int64]],
    srgb: np.ndarray[Any, np.dtype[np.float64]],
) -> xr.Dataset:
    variables: dict[str, Any] = {
        name: ("material", numbers[name], {"units": "1", "long_name": number.long_name})
        for name, number in NUMBERS.items()
    }
    titles = {**WORDS, "description": "the material's own words"}
    variables |= {name: ("material", _strings(words[name]), {"long_name": titles[name]}) for name in titles}
    variables["warning_count"] = ("material", warning_count, {"units": "1", "long_name": "number of warnings"})
    # Not ``srgb``'s own quantity: a material without a colour is NaN here.
    variables["srgb"] = (("material", "channel"), srgb)
    coordinates = {
        "material": ("material", _strings(names), {"long_name": "name of the material"}),
        "channel": list("RGB"),
    }
    return vocabulary.label(xr.Dataset(variables, coords=coordinates), "catalogue")


def _check_row(row: xr.Dataset) -> None:
    if row.attrs.get("kind") != "catalogue":
        raise VocabularyError(f"expected a dataset of kind 'catalogue', found kind {row.attrs.get('kind')!r}")
    absent = [
        name
        for name in (*NUMBERS, *WORDS, "description", "material", "warning_count", "srgb")
        if name not in row.variables
    ]
    if absent:
        raise VocabularyError(f"a row of the catalogue lacks {absent[0]!r}; found {', '.join(map(str, row.variables))}")


def _strings(values: list[str]) -> np.ndarray[Any, Any]:
    return np.array(values, dtype=str)


def _text(catalogue: xr.Dataset, name: str) -> list[str]:
    return [str(value) for value in catalogue[name].values]


def _shortened(text: str, most: int = 90) -> str:
    return text if len(text) <= most else text[: most - 1].rstrip() + "…"


def _harmless(text: str) -> str:
    line = "".join(character if character.isprintable() else " " for character in text).strip()
    return "'" + line if line[:1] in tuple("=+-@") else line
