"""The catalogue: one row for each material, as a dataset, as comma-separated values, and as digests."""

from __future__ import annotations

import csv
import json
import math
from collections import Counter
from collections.abc import Container, Mapping, Sequence
from io import StringIO
from typing import Any

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.appearance.origin import basis, route, uncertainty_not_stated
from brdfpipe.appearance.quantities import AppearanceQuantity, applicabilities, quantities, quantities_on_request
from brdfpipe.appearance.verdicts import Acceptances, overall, reason_to_accept, refused_exports, stage_warnings
from brdfpipe.errors import VocabularyError
from brdfpipe.report.catalogue.cuts import INCIDENCES, OFFSETS, lobe_cut
from brdfpipe.report.formatting import colour
from brdfpipe.report.plots.svg import data_uri
from brdfpipe.report.rendering import material_name, own_stages

_ROUNDING_ERROR = 1e-9
"""Largest magnitude that is written as 0: the rounding error of sums."""

THUMBNAIL_SIDE = 96
"""Pixels along the side; shown at about half as many, for screens of high resolution."""

_THUMBNAIL_QUALITY = 85


def text_columns() -> dict[str, str]:
    """Text variables of a row: name → long name."""
    reasons = {f"no_{a.name}": f"why {a.name} does not apply; empty where it applies" for a in applicabilities()}
    return {
        "route": "how the BRDF was obtained",
        "basis": "inputs of the BRDF",
        "verdict": "worst verdict of the checks; warn at best where a stage has a warning, or a condition of the model; empty where nothing was checked",
        "verdict_checks": "checks, conditions of the model and stages with that verdict, unless it is pass",
        "verdict_text": "what those checks found, or the warnings of those stages",
        **reasons,
        "uncertainty_not_stated": "inputs that the uncertainties leave out, because theirs is not known; empty where there are none",
        "refused_exports": "why formats of other programs were not written; empty where all were",
        "thumbnail": "small picture, a data URI; empty without a preview",
        "digests": "JSON: stage to digest of its dataset",
        "description": "description of the material by its user",
    }


def summarise(datasets: Mapping[str, xr.Dataset], *, description: str = "", accepted: Acceptances = ()) -> xr.Dataset:
    """The row of one material.

    Parameters
    ----------
    datasets : stage → its dataset, as for :func:`brdfpipe.report.material_page`
    description : of the material, by its user
    accepted : warnings that the description accepts; they are not counted

    Returns
    -------
    Dataset of kind ``catalogue``, dimension ``material`` of length 1: the quantities of :mod:`brdfpipe.appearance.quantities`, NaN
    where not known or not applicable, and of those on request the ones that were computed; :func:`text_columns`; ``warning_count``; ``srgb`` (material, channel), NaN where not
    known; ``brdf_cut`` (material, cut_incidence, cut_offset), of :func:`.cuts.lobe_cut`
    """
    known = own_stages(datasets)
    digests = {stage: str(dataset.attrs["digest"]) for stage, dataset in known.items() if "digest" in dataset.attrs}
    appearance = known.get("appearance", xr.Dataset())
    requested = [quantity for quantity in quantities_on_request() if quantity.name in appearance]
    row = {
        "material": material_name(known),
        **{quantity.name: quantity.value(known) for quantity in (*quantities(), *requested)},
        **{quantity.u_name: quantity.uncertainty(known) for quantity in quantities() if quantity.u},
        "route": route(known),
        "basis": basis(known),
        **_verdict_texts(known, accepted),
        **{f"no_{applicability.name}": applicability.exclusion(known) for applicability in applicabilities()},
        "uncertainty_not_stated": uncertainty_not_stated(known),
        "refused_exports": "; ".join(refused_exports(known, accepted)),
        "thumbnail": thumbnail(known["preview"]) if "preview" in known else "",
        "digests": json.dumps(digests, sort_keys=True),
        "description": description,
        "warning_count": sum(reason_to_accept(text, accepted) is None for _, text in stage_warnings(known)),
        "srgb": appearance["srgb"].values if "srgb" in appearance else np.full(3, np.nan),
        "brdf_cut": lobe_cut(known.get("bsdf")),
    }
    return _dataset([row])


def combine(rows: Sequence[xr.Dataset]) -> xr.Dataset:
    """One catalogue from the rows of its materials, sorted by name.

    Parameters
    ----------
    rows : kind ``catalogue``, of any number of materials each; none gives an empty catalogue

    Raises
    ------
    VocabularyError : a row is of another kind or lacks a variable, or two rows have the same name.
    """
    requested = [one.name for one in quantities_on_request() if any(one.name in row.variables for row in rows)]
    columns = ("material", *_number_columns(), *text_columns(), "warning_count", "srgb", "brdf_cut")
    for row in rows:
        if row.attrs.get("kind") != "catalogue":
            raise VocabularyError(f"expected a dataset of kind 'catalogue', found kind {row.attrs.get('kind')!r}")
        if absent := [name for name in columns if name not in row.variables]:
            found = ", ".join(map(str, row.variables))
            raise VocabularyError(f"a catalogue row lacks {absent[0]!r}; found {found}; build the material again")
    # Plain values: xarray.concat aligns and compares every variable of every row, which takes minutes for a thousand.
    values = {name: [value for row in rows for value in row.variables[name].values] for name in columns}
    for name in requested:
        by_row = [row[name].values if name in row else np.full(row.sizes["material"], np.nan) for row in rows]
        values[name] = list(np.concatenate(by_row))
    names = [str(name) for name in values["material"]]
    if repeated := [name for name, count in Counter(names).items() if count > 1]:
        raise VocabularyError(f"two materials are named {repeated[0]!r}; change `name` in material.yaml")
    order = sorted(range(len(names)), key=names.__getitem__)
    return _dataset([{name: values[name][k] for name in (*columns, *requested)} for k in order])


def texts(catalogue: xr.Dataset, name: str) -> list[str]:
    """A text variable of all materials."""
    return [str(value) for value in catalogue[name].values]


def thumbnail(preview: xr.Dataset) -> str:
    """Data URI of the sphere of a ``preview``, small.

    WebP takes 0.5 to 0.9 kB, a third of a PNG of 64 colours: a page with a thousand of them is small and needs no other file.
    """
    from PIL import Image

    sphere = np.ascontiguousarray(preview["picture"].values[:, : preview.sizes["row"]], dtype=np.uint8)
    # Means over areas: other filters put a dark rim around highlights.
    small = Image.fromarray(sphere).resize((THUMBNAIL_SIDE, THUMBNAIL_SIDE), Image.Resampling.BOX)
    return data_uri(small, "webp", quality=_THUMBNAIL_QUALITY, method=6)


def listed_quantities(names: Container[Any]) -> tuple[AppearanceQuantity, ...]:
    """The quantities of every material, and those on request that are among the names of a catalogue's variables."""
    return (*quantities(), *(quantity for quantity in quantities_on_request() if quantity.name in names))


def _number_columns(names: Container[Any] = ()) -> dict[str, tuple[str, str]]:
    """Unit and definition of the quantities, each followed by its uncertainty; of those on request the ones among the names."""
    columns = {}
    for quantity in listed_quantities(names):
        columns[quantity.name] = quantity.stored_unit, quantity.definition
        if quantity.u:
            columns[quantity.u_name] = quantity.stored_unit, quantity.u_definition
    return columns


def _verdict_texts(datasets: Mapping[str, xr.Dataset], accepted: Acceptances) -> dict[str, str]:
    verdict, reasons = overall(datasets, accepted)
    return {
        "verdict": verdict,
        "verdict_checks": ", ".join(entry.name for entry in reasons),
        "verdict_text": "; ".join(f"{entry.name}: {entry.text}" if entry.text else entry.name for entry in reasons),
    }


def _dataset(rows: Sequence[Mapping[str, Any]]) -> xr.Dataset:
    """The dataset of rows: column → value."""

    def column(name: str, dtype: type, **attrs: str) -> tuple[str, Any, dict[str, str]]:
        return "material", np.array([row[name] for row in rows], dtype=dtype), attrs

    variables: dict[str, Any] = {
        name: column(name, float, units=unit, long_name=definition)
        for name, (unit, definition) in _number_columns(rows[0] if rows else ()).items()
    }
    variables |= {name: column(name, str, long_name=long_name) for name, long_name in text_columns().items()}
    variables["warning_count"] = column("warning_count", np.int64, units="1", long_name="number of warnings")
    # Not the vocabulary's ``srgb``: NaN for a material without a colour.
    srgb = np.array([row["srgb"] for row in rows], dtype=float).reshape(len(rows), 3)
    variables["srgb"] = (("material", "channel"), srgb)
    cuts = np.array([row["brdf_cut"] for row in rows], dtype=np.float32).reshape(
        len(rows), INCIDENCES.size, OFFSETS.size
    )
    words = {"units": "sr-1", "long_name": "BRDF in the plane of incidence, for the comparison on the page"}
    variables["brdf_cut"] = (("material", "cut_incidence", "cut_offset"), cuts, words)
    angles = {
        "cut_incidence": ("cut_incidence", INCIDENCES, {"units": "degree", "long_name": "angle of incidence"}),
        "cut_offset": ("cut_offset", OFFSETS, {"units": "degree", "long_name": "angle from the mirror direction"}),
    }
    names = column("material", str, long_name="name of the material")
    coordinates = {"material": names, "channel": list("RGB"), **angles}
    return vocabulary.label(xr.Dataset(variables, coords=coordinates), "catalogue")


# --- files beside the dataset


def catalogue_csv(catalogue: xr.Dataset, failures: Mapping[str, Mapping[str, str]]) -> str:
    """The catalogue as comma-separated values, one line for each material, failed ones included.

    Parameters
    ----------
    catalogue : kind ``catalogue``
    failures : material → ``stage`` and ``message``

    Notes
    -----
    A spreadsheet reads text that starts with ``= + - @`` as a formula. Such text gets an apostrophe in front. Control characters and line breaks become spaces.
    """
    names = ("route", "basis", "verdict", "verdict_checks", "verdict_text")
    columns = {name: texts(catalogue, name) for name in ("material", *names)}
    columns["warnings"] = [str(count) for count in catalogue["warning_count"].values.tolist()]
    numbers = _number_columns(catalogue.variables)
    for name in numbers:
        values = catalogue[name].values.astype(float)
        rounded = np.where(np.abs(values) < _ROUNDING_ERROR, 0.0, values).tolist()
        columns[name] = ["" if math.isnan(value) else f"{value:.6g}" for value in rounded]
    columns["uncertainty_not_stated"] = texts(catalogue, "uncertainty_not_stated")
    columns["srgb"] = [colour(channels) or "" for channels in catalogue["srgb"].values]
    columns["description"] = texts(catalogue, "description")
    columns["refused_exports"] = texts(catalogue, "refused_exports")
    later = {"refused_exports"} | {column for one in quantities() if one.appended for column in (one.name, one.u_name)}
    rows = [{"status": "built", **dict(zip(columns, row, strict=True))} for row in zip(*columns.values(), strict=True)]
    rows += [{"material": name, "status": "failed", **failure} for name, failure in failures.items()]
    header = ["material", "status", *list(columns)[1:], "stage", "message"]
    # Older columns keep their places.
    header.sort(key=lambda name: name in later)
    stream = StringIO()
    writer = csv.DictWriter(stream, header, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    for row in sorted(rows, key=lambda row: row["material"]):
        writer.writerow(
            {name: row.get(name) if name in numbers else _escape_formula(row.get(name, "")) for name in header}
        )
    return stream.getvalue()


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
