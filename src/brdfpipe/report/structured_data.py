"""The pages for machines: data sets of schema.org as JSON-LD, which catalogues of data and search engines read.

References
----------
schema.org, Dataset (https://schema.org/Dataset). Who made the data and under which licence is in the metadata of a release alone
(:mod:`brdfpipe.releases.metadata`): a build does not know it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import xarray as xr
from markupsafe import Markup

from brdfpipe.appearance.quantities import AppearanceQuantity
from brdfpipe.file_formats import media_type
from brdfpipe.report.rendering import as_json

_CONTEXT = "https://schema.org"


def of_material(
    datasets: Mapping[str, xr.Dataset],
    known: Mapping[AppearanceQuantity, float],
    name: str,
    description: str,
    technique: str,
    files: Iterable[str],
) -> Markup:
    """The data set of one material.

    Parameters
    ----------
    datasets : stage → its dataset
    known : :func:`brdfpipe.appearance.quantities.values` of them
    name, description : of the material; untrusted
    technique : how the BRDF was obtained
    files : paths of exported files in relation to the page

    Returns
    -------
    JSON in which no character can end the element of the page that holds it
    """
    measured = [
        {
            "@type": "PropertyValue",
            "name": quantity.name,
            "description": quantity.definition,
            "value": round(value, quantity.decimals),
            **({} if quantity.unit == "1" else {"unitText": quantity.unit}),
        }
        for quantity, value in known.items()
        if not quantity.on_request and not math.isnan(value)
    ]
    digest = str(datasets["bsdf"].attrs.get("digest", "")) if "bsdf" in datasets else ""
    return _markup(
        {
            **_dataset(name, description or f"The BRDF of {name} and what follows from it"),
            "isPartOf": {"@type": "Dataset", "url": "../index.html"},
            "measurementTechnique": technique,
            **({"identifier": digest} if digest else {}),
            "variableMeasured": measured,
            "distribution": [_download(file) for file in files],
        }
    )


def of_catalogue(scene: str, purpose: str) -> Markup:
    """The data set of a catalogue. Its materials say on their pages that they are part of it; a list would make a page of thousands large.

    Parameters
    ----------
    scene, purpose : name and purpose of the scene; empty for the default one

    Returns
    -------
    JSON as of :func:`of_material`
    """
    name = f"BRDF catalogue: {scene}" if scene else "BRDF catalogue"
    return _markup(
        {
            **_dataset(name, purpose or "Colour, gloss and verdict of every material"),
            "distribution": [_download("catalogue.csv"), _download("catalogue.nc")],
        }
    )


def _dataset(name: str, description: str) -> dict[str, Any]:
    return {"@type": "Dataset", "name": name, "description": description}


def _download(path: str) -> dict[str, str]:
    return {"@type": "DataDownload", "contentUrl": path, "encodingFormat": media_type(path)}


def _markup(content: Mapping[str, Any]) -> Markup:
    return as_json({"@context": _CONTEXT, **content})
