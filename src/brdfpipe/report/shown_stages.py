"""The datasets of a material that its page and its row of the catalogue show, and the name of the material."""

from __future__ import annotations

from collections.abc import Mapping

import xarray as xr

OTHER_SECTIONS = frozenset({"reduced", "primary", "smoothed", "calibration", "comparison"})
"""Kinds of dataset that the sections of the rig and of the comparison show."""


def own_stages(datasets: Mapping[str, xr.Dataset]) -> dict[str, xr.Dataset]:
    """The datasets of a material, without those from the frames of a rig to its measured BSDF, and without the comparison."""
    return {stage: dataset for stage, dataset in datasets.items() if dataset.attrs.get("kind") not in OTHER_SECTIONS}


def material_name(datasets: Mapping[str, xr.Dataset]) -> str:
    """The name of the material in the attributes of its datasets."""
    return next(
        (str(dataset.attrs["material"]) for dataset in datasets.values() if "material" in dataset.attrs), "unnamed"
    )
