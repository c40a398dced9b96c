"""Parameters of closed formulas (``.parameters.json``): ABg, Harvey, K-correlation, and the widths of GGX and Beckmann, each with its error.

For optical design programs that take parameters instead of tables. A formula that is too far from the BSDF is listed with its error and without parameters.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import xarray as xr

from brdfpipe import store
from brdfpipe.appearance.origin import METAL_EXTINCTION
from brdfpipe.exchange import records
from brdfpipe.exchange.fits.fitting import Fit, Form, fit, index_of
from brdfpipe.exchange.fits.forms import by_albedo, dielectric
from brdfpipe.exchange.fits.scatter import FORMULAS, ScatterFit, fit_formula
from brdfpipe.exchange.registry import ExchangeError, Format

FORMAT = Format(
    description="parameters of ABg, Harvey, K-correlation, GGX and Beckmann, fitted, for optical design programs",
    files={"reflection": {"write": (".parameters.json",)}},
    options={"largest_error": 0.25},
)


def write(bsdf: xr.Dataset, path: Path, *, largest_error: float) -> records.Record:
    """Write the parameters of the reflecting side, weighted with V(λ) and D65.

    Parameters
    ----------
    bsdf : kind ``bsdf``, without a lay
    path : the file; it appears whole or not at all
    largest_error : above which a formula is refused: of the median error, relative to BRDF·cos θ_o, and of the largest error of
        the directional reflectance, relative to it [1]

    Raises
    ------
    ExchangeError : every formula is refused, the surface has a lay, or no light is scattered back.
    """
    if not largest_error > 0:
        raise ExchangeError(f"largest_error is {largest_error!r}; accepted: above 0")
    fits = [_of_formula(bsdf, name) for name in FORMULAS]
    n, k = index_of(bsdf)
    if k < METAL_EXTINCTION:
        fits += [_of_facets(bsdf, distribution, n) for distribution in ("ggx", "beckmann")]
    for one in fits:
        named = {"median error": one["error"]["median"], "error of the reflectance": one["error"]["albedo"]}
        if beyond := [words for words, error in named.items() if not error <= largest_error]:
            del one["parameters"]
            one["refused"] = f"the {beyond[0]} is above the limit of {largest_error:g}"
    if all("refused" in one for one in fits):
        least = min(fits, key=lambda one: max(float(one["error"]["median"]), float(one["error"]["albedo"])))
        raise ExchangeError(
            f"no formula describes this material: the nearest, {least['formula']}, is off by {least['error']['median']:.0%} of BRDF cos theta_o "
            f"(median) and {least['error']['albedo']:.0%} of the reflectance, above the limit of {largest_error:g}; use the format of a table, or raise the option `largest_error`"
        )
    document = {
        **records.identity(bsdf),
        "values": "BRDF in sr-1, not multiplied by the cosine, weighted with V(lambda) and D65",
        "x": "distance of the direction cosines from those of the mirror direction, |beta - beta0|",
        "error": "relative: median and 95th percentile of BRDF cos theta_o, and albedo, the largest of the directional reflectance to 75 degree",
        "fits": fits,
        "left_out": records.left_out(bsdf, FORMAT, channels=1),
    }
    store.write_text(path, json.dumps(document, indent=1, ensure_ascii=False) + "\n")
    return document


def _of_formula(bsdf: xr.Dataset, name: str) -> dict[str, Any]:
    found = fit_formula(bsdf, name)
    parameters = {key: _digits(value) for key, value in found.parameters.items()}
    return _entry(name, FORMULAS[name].words, parameters, found)


def _of_facets(bsdf: xr.Dataset, distribution: str, index: float | None) -> dict[str, Any]:
    found = fit(bsdf, Form(distribution, dielectric, by_albedo, index))
    words = (
        "D F G / (4 cos theta_i cos theta_o) with height-correlated masking and Fresnel's equations of n, and L / pi times 1 - the lobe's "
        "reflectance from the direction of view"
    )
    luminous = {"alpha": found.material.lobe.alpha, "n": found.index, "L": found.luminous_base}
    parameters = {key: _digits(value) for key, value in luminous.items()}
    return _entry(distribution, words, parameters, found)


def _entry(formula: str, words: str, parameters: dict[str, float], found: ScatterFit | Fit) -> dict[str, Any]:
    error = {
        "median": _digits(found.median),
        "percentile_95": _digits(found.percentile_95),
        "albedo": _digits(found.albedo),
        "directions": found.directions,
    }
    return {"formula": formula, "brdf": words, "parameters": parameters, "error": error}


def _digits(value: float) -> float:
    return float(f"{value:.4g}")
