"""Origin of the BRDF of a material: a prediction, measured colours, or a camera rig."""

from __future__ import annotations

from collections.abc import Mapping

import xarray as xr

from brdfpipe.bsdf.change_variables import NOT_STATED
from brdfpipe.bsdf.registry import representation

Datasets = Mapping[str, xr.Dataset]
"""Stage → its dataset, of one material; any stage may be absent."""

PREDICTION_INPUTS = (
    "surface",
    "facets",
    "back_surface",
    "back_facets",
    "base_surface",
    "base_facets",
    "spectrum",
    "index",
    "base_index",
    "interior",
    "model_error",
    "uncertainty",
    "multiangle",
    "flake",
    "flake_uncertainty",
)
"""Stages on which only a prediction is based, and not a measured BRDF."""

_SOLUTIONS = {"kirchhoff": "diffraction on the map, after Kirchhoff", "traced": "rays traced over the map"}
"""Representation of a reference solution → how it was computed."""

METAL_EXTINCTION = 0.1
"""Extinction coefficient above which no light returns from below the surface."""


def route(datasets: Datasets) -> str:
    """``predicted``, ``flake``, ``measured`` or ``imported``."""
    return str(datasets["bsdf"].attrs.get("route", "predicted")) if "bsdf" in datasets else "predicted"


def is_measured(datasets: Datasets) -> bool:
    """Whether the BRDF was measured, so that inputs of a prediction only serve the comparison."""
    return route(datasets) == "measured"


def basis(datasets: Datasets) -> str:
    """The inputs in words: ``surface + spectrum``, ``assumed finish``, ``a camera rig``; empty where there are none."""
    if is_measured(datasets):
        return "a camera rig"
    if route(datasets) == "imported":
        return f"a table ({datasets['bsdf'].attrs['file_format']})"
    if route(datasets) == "flake" and "multiangle" in datasets:
        return f"colours at {datasets['multiangle'].sizes['geometry']} geometries"
    assumed = "gloss readings" if gloss_readings(datasets) else "assumed finish"
    finish = "surface" if "surface" in datasets else assumed if "facets" in datasets else ""
    return " + ".join(part for part in (finish, "spectrum" if "spectrum" in datasets else "") if part)


def gloss_readings(datasets: Datasets) -> str:
    """The readings that the slopes of the finish were found from, ``60° 22.4, 85° 48``; empty for other finishes."""
    return str(datasets["facets"].attrs.get("gloss_readings", "")) if "facets" in datasets else ""


def uncertainty_not_stated(datasets: Datasets) -> str:
    """What the uncertainties of a material leave out, because it is not known; empty where they leave out nothing."""
    if "bsdf" not in datasets:
        return ""
    if representation(datasets["bsdf"]).states_uncertainty:
        return "BRDF (in haze, colours and reflectance)"
    return str(datasets["bsdf"].attrs.get(NOT_STATED, "all inputs"))


def solution_words(datasets: Datasets) -> str:
    """How a reference solution was computed, ``rays traced over the map``; empty for other BRDFs."""
    return _SOLUTIONS.get(str(datasets["bsdf"].attrs.get("representation")), "") if "bsdf" in datasets else ""


def has_finish(datasets: Datasets) -> bool:
    """Whether a surface finish was measured or assumed. A prediction without facets is perfectly diffuse."""
    return "facets" in datasets or route(datasets) != "predicted"


def is_metal(bsdf: xr.Dataset | None) -> bool:
    """Whether a BSDF states the extinction coefficient of a metal."""
    return bsdf is not None and "k" in bsdf and float(bsdf["k"].min()) > METAL_EXTINCTION


def has_no_diffuse_base(bsdf: xr.Dataset | None) -> bool:
    """Whether no spectrum is needed: a metal, also below a coat, or a body that transmits, reflects no light diffusely from below its surface."""
    return bsdf is not None and (representation(bsdf).transmits or is_metal(bsdf) or bsdf.attrs.get("base") == "metal")
