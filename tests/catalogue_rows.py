"""Rows and tables of a catalogue, for the tests of its page and of its table."""

from __future__ import annotations

import csv
import io

import xarray as xr

from brdfpipe.report import summarise

Datasets = dict[str, xr.Dataset]

FAILURES = {"broken": {"stage": "surface", "message": "grain.txt: no unit; set `surface: unit` in material.yaml"}}


def renamed(datasets: Datasets, name: str) -> Datasets:
    """The datasets of a material under another name."""
    return {stage: dataset.assign_attrs(material=name) for stage, dataset in datasets.items()}


def row(datasets: Datasets, name: str, description: str = "") -> xr.Dataset:
    """The row of a material under another name."""
    return summarise(renamed(datasets, name), description=description)


def table(text: str) -> list[dict[str, str]]:
    """The lines of ``catalogue.csv`` by column."""
    return list(csv.DictReader(io.StringIO(text)))
