"""Parameters of closed formulas (``.parameters.json``), each with its error.

They are ABg, Harvey, K-correlation, Lambert + Gaussian, and the widths of GGX and Beckmann. For optical design programs that take parameters instead of tables. A formula that is too far from the BSDF is listed with its error and without parameters.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from brdfpipe import store
from brdfpipe.appearance.origin import METAL_EXTINCTION
from brdfpipe.errors import InputError
from brdfpipe.exchange import records
from brdfpipe.exchange.fits import evaluated, gauss
from brdfpipe.exchange.fits.fitting import Fit, Form, fit
from brdfpipe.exchange.fits.forms import Lobe, Material, by_albedo, dielectric
from brdfpipe.exchange.fits.light import ReflectedLight, delta_e_of_greys, index_of, luminance_of_rgb
from brdfpipe.exchange.fits.scatter import (
    FORMULAS,
    LISTED_INCIDENCES,
    ScatterError,
    at_incidence,
    error_by_incidence,
    fit_formula,
)
from brdfpipe.exchange.listed_points import read_object
from brdfpipe.exchange.read_table import ReadTable
from brdfpipe.exchange.registry import ExchangeError, Format

_LARGEST_PARAMETER = 1e12

FORMAT = Format(
    description="parameters of ABg, Harvey, K-correlation, Lambert + Gaussian, GGX and Beckmann, fitted, for optical design programs",
    files={"reflection": {"write": (".parameters.json",)}},
    refuses=("lay",),
    options={"largest_error": 0.25, "largest_delta_e": 5.0},
    read="read",
    begins=('"fits"', '"formula"'),
)


def write(bsdf: xr.Dataset, path: Path, *, largest_error: float, largest_delta_e: float) -> records.Record:
    """Write the parameters of the reflecting side, weighted with V(λ) and D65.

    Parameters
    ----------
    bsdf : kind ``bsdf``, without a lay
    path : the file; it appears whole or not at all
    largest_error : above which a formula is refused: of the median error, relative to BRDF·cos θ_o, and of the largest error of
        the directional reflectance, relative to it [1]
    largest_delta_e : above which a formula is refused: CIEDE2000 of greys of both luminances off the lobe

    Raises
    ------
    ExchangeError : every formula is refused, the surface has a lay, or no light is scattered back.
    """
    for option, value in (("largest_error", largest_error), ("largest_delta_e", largest_delta_e)):
        if not value > 0:
            raise ExchangeError(f"{option} is {value!r}; accepted: above 0")
    limits, light = _Limits(largest_error, largest_delta_e), ReflectedLight(bsdf)
    fits = [_of_formula(light, name, limits) for name in FORMULAS]
    fits.append(_of_gauss(light, limits))
    n, k = index_of(bsdf)
    if k < METAL_EXTINCTION:
        fits += [_of_facets(light, distribution, n, limits) for distribution in ("ggx", "beckmann")]
    if all("refused" in one and "refused" in one.get("by_incidence", one) for one in fits):
        least = min(fits, key=lambda one: max(float(one["error"]["median"]), float(one["error"]["albedo"])))
        raise ExchangeError(
            f"no formula describes this material: the nearest, {least['formula']}, is off by {least['error']['median']:.0%} of BRDF cos theta_o "
            f"(median), {least['error']['albedo']:.0%} of the reflectance and a CIEDE2000 of {least['error']['delta_e_00']:.1f} off the lobe: {least['refused']}; use the format of a table, "
            "or raise `largest_error` or `largest_delta_e`, an `--option` of `brdfpipe convert`"
        )
    document = {
        **records.identity(bsdf),
        "values": "BRDF in sr-1, not multiplied by the cosine, weighted with V(lambda) and D65",
        "x": "distance of the direction cosines from those of the mirror direction, |beta - beta0|",
        "error": "relative: median and 95th percentile of BRDF cos theta_o, and the largest of the directional reflectance (albedo) and of the BRDF "
        "in the mirror direction (peak) to 75 degree; and the largest CIEDE2000 of greys of both luminances at 45:0, 45as75 and 45as110 (delta_e_00)",
        "by_incidence": "parameters of single incidences, and their error there; the error of the whole list is that of parameters interpolated linearly "
        "in the cosine of the incidence",
        "fits": fits,
        "left_out": records.left_out(bsdf, FORMAT, "luminous"),
    }
    store.write_text(path, json.dumps(document, indent=1, ensure_ascii=False) + "\n")
    return document


class _Limits(NamedTuple):
    error: float
    """Of the median error and of the reflectance [1]"""
    delta_e: float


def _of_formula(light: ReflectedLight, name: str, limit: _Limits) -> dict[str, Any]:
    of_all = fit_formula(light, name)
    found = {float(theta_i): fit_formula(light, name, float(theta_i)) for theta_i in LISTED_INCIDENCES}
    incidences = [
        {"theta_i": theta_i, **_within(limit, one.parameters, _error(one.error))} for theta_i, one in found.items()
    ]
    kept = {theta_i: one.parameters for theta_i, one in found.items() if not _refusal(limit, _error(one.error))}
    listed: dict[str, Any] = {"refused": "every incidence is refused"}
    if kept:
        error = _error(error_by_incidence(light, name, kept))
        refusal = _refusal(limit, error)
        listed = {"error": error, **({"refused": refusal} if refusal else {"incidences": incidences})}
    return {
        "formula": name,
        "brdf": FORMULAS[name].words,
        **_within(limit, of_all.parameters, _error(of_all.error)),
        "by_incidence": listed,
    }


def _of_gauss(light: ReflectedLight, limit: _Limits) -> dict[str, Any]:
    rows, found = gauss.fit_gauss(light)
    error = _error(found)
    refusal = _refusal(limit, error)
    incidences = [
        {"theta_i": theta_i, "parameters": {name: _digits(value) for name, value in row.items()}}
        for theta_i, row in rows.items()
    ]
    written = {"refused": refusal} if refusal else {"incidences": incidences}
    return {"formula": "lambert_gauss", "brdf": gauss.WORDS, **written, "error": error}


def _of_facets(light: ReflectedLight, distribution: str, index: float | None, limit: _Limits) -> dict[str, Any]:
    found = fit(light, Form(distribution, dielectric, by_albedo, index))
    luminance = luminance_of_rgb()
    found = replace(
        found,
        delta_e=delta_e_of_greys(
            light.reduced, lambda *at: np.asarray(found.material.evaluate(*at[:4]) @ luminance)[:, None]
        ),
    )
    words = (
        "D F G / (4 cos theta_i cos theta_o) with height-correlated masking and Fresnel's equations of n, and L / pi times 1 - the lobe's "
        "reflectance from the direction of view"
    )
    luminous = {"alpha": found.material.lobe.alpha, "n": found.index, "L": found.luminous_base}
    return {"formula": distribution, "brdf": words, **_within(limit, luminous, _error(found))}


def _within(limit: _Limits, parameters: dict[str, float], error: dict[str, float]) -> dict[str, Any]:
    """The error, and the parameters unless it is above the limit."""
    refusal = _refusal(limit, error)
    return {
        **({"refused": refusal} if refusal else {"parameters": {key: _digits(one) for key, one in parameters.items()}}),
        "error": error,
    }


def _refusal(limit: _Limits, error: dict[str, float]) -> str:
    """Which error is above the limit; empty if none is."""
    named = {
        "median error": (error["median"], limit.error),
        "error of the reflectance": (error["albedo"], limit.error),
        "colour difference": (error.get("delta_e_00", 0.0), limit.delta_e),
    }
    beyond = [(words, most) for words, (size, most) in named.items() if not size <= most]
    return f"the {beyond[0][0]} is above the limit of {beyond[0][1]:g}" if beyond else ""


def _error(found: ScatterError | Fit) -> dict[str, float]:
    sizes = {name: _digits(getattr(found, name)) for name in ("median", "percentile_95", "albedo", "peak")}
    colour = {} if found.delta_e is None else {"delta_e_00": _digits(found.delta_e)}
    return {**sizes, **colour, "directions": found.directions}


def read(path: Path) -> ReadTable:
    """The formula of the file with the least error at the 95th percentile, evaluated: with one set of parameters, or with those by incidence.

    Raises InputError: the file is damaged, no formula has parameters, or they are no numbers or out of range.
    """
    fits = read_object(path).get("fits")
    if not isinstance(fits, list):
        raise InputError(
            path, "the file has no list `fits`", found=type(fits).__name__, accepted="fits: [{formula, …}]"
        )
    found = [one for fit in fits if isinstance(fit, dict) for one in _stated(path, fit)]
    if not found:
        raise InputError(path, "no formula has parameters", found=f"{len(fits)} fits", accepted="at least one")
    best = min(found, key=lambda one: one.error)
    others = ", ".join(one.words for one in found if one is not best)
    words = f"{best.words}, weighted with V(λ) and D65{f'; not evaluated: {others}' if others else ''}"
    return evaluated.table(best.evaluate, best.width, "photopic", words)


class _Stated(NamedTuple):
    """A formula of a file."""

    words: str
    error: float
    """At the 95th percentile [1]"""
    width: float
    """Of the half vector [1]"""
    evaluate: evaluated.Evaluate


def _stated(path: Path, fit: dict[str, Any]) -> Iterator[_Stated]:
    """The formula with one set of parameters, and with those by incidence, where the file has them."""
    name = str(fit.get("formula"))[:40]
    listed = evaluated.part(path, fit, "by_incidence")
    if "parameters" in fit:
        parameters, error = evaluated.part(path, fit, "parameters"), _percentile(path, fit)
        if name in FORMULAS:
            yield _of_scatter(path, name, {0.0: parameters}, error)
        elif name in ("ggx", "beckmann"):
            yield _of_distribution(path, name, parameters, error)
    if name in FORMULAS and (rows := _by_incidence(path, name, listed)):
        yield _of_scatter(path, name, rows, _percentile(path, listed))
    if name == "lambert_gauss" and (rows := _by_incidence(path, name, fit)):
        yield _of_gaussians(path, rows, _percentile(path, fit))


def _by_incidence(path: Path, name: str, listed: dict[str, Any]) -> dict[float, dict[str, Any]]:
    """Increasing incidence [degree] → parameters; empty where there are none."""
    rows = listed.get("incidences")
    found = {
        evaluated.number(path, row.get("theta_i"), "theta_i"): evaluated.part(path, row, "parameters")
        for row in (rows if isinstance(rows, list) else ())
        if isinstance(row, dict) and "parameters" in row
    }
    theta_i = list(found)
    if not (all(0 <= one <= 90 for one in theta_i) and (np.diff(theta_i) > 0).all()):
        stated = ", ".join(f"{one:g}" for one in theta_i[:8])
        raise InputError(path, f"the incidences of {name} do not increase", found=stated, accepted="0 to 90 degree")
    return found


def _percentile(path: Path, values: dict[str, Any]) -> float:
    """The error of a fit; the largest of a file that states none."""
    return evaluated.number(path, evaluated.part(path, values, "error").get("percentile_95", 1e300), "percentile_95")


def _of_scatter(path: Path, name: str, listed: dict[float, dict[str, Any]], error: float) -> _Stated:
    formula = FORMULAS[name]
    parameters = {
        incidence: {key: _parameter(path, name, values, key) for key in (*formula.names, "L")}
        for incidence, values in listed.items()
    }
    # Of the lobe about the mirror direction; the half vector turns half as far, or less far towards grazing incidence.
    widths = [one[formula.names[1]] ** (1 / one["g"] if name == "abg" else 1) for one in parameters.values()]
    several = f" by incidence ({len(listed)})" if len(listed) > 1 else ""
    at = at_incidence(formula, parameters)
    return _Stated(
        f"{name}{several}, {formula.words}",
        error,
        float(np.clip(min(widths) / 4, 1e-4, 1.0)),
        lambda theta_i, phi_i, theta_o, phi_o: at(theta_i, phi_i, theta_o, phi_o, None),
    )


def _of_gaussians(path: Path, listed: dict[float, dict[str, Any]], error: float) -> _Stated:
    rows = {
        theta_i: {key: _parameter(path, "lambert_gauss", values, key, zero=True) for key in gauss.NAMES}
        for theta_i, values in listed.items()
    }
    widths = [min(row["s_par"], row["s_perp"]) for row in rows.values() if row["G0"] > 0]
    if widths and min(widths) == 0:
        raise InputError(path, "a lobe of lambert_gauss has no width", found="0", accepted="s_par and s_perp above 0")
    at = gauss.evaluation(rows)
    return _Stated(
        f"lambert_gauss by incidence ({len(rows)}), {gauss.WORDS}",
        error,
        float(np.clip(np.radians(min(widths, default=90.0)) / 4, 1e-4, 1.0)),
        lambda theta_i, phi_i, theta_o, phi_o: at(theta_i, phi_i, theta_o, phi_o, None),
    )


def _of_distribution(path: Path, name: str, parameters: dict[str, Any], error: float) -> _Stated:
    alpha, n, base = (_parameter(path, name, parameters, key) for key in ("alpha", "n", "L"))
    if not (1 <= n <= evaluated.LARGEST_INDEX and alpha <= 1):
        found = f"alpha {alpha:g}, n {n:g}"
        raise InputError(path, f"parameters of {name} out of range", found=found, accepted="alpha to 1, n from 1 to 10")
    material = Material(Lobe(name, max(alpha, 1e-3), dielectric(n)), np.full(3, base), by_albedo)
    words = f"{name} facets of width {alpha:g} with index {n:g} over a Lambertian base of {base:g}"
    return _Stated(words, error, max(alpha, 1e-3), lambda *at: material.evaluate(*at)[:, :1])


def _parameter(path: Path, formula: str, parameters: dict[str, Any], key: str, zero: bool = False) -> float:
    """A number from 0; above it unless it is ``L``, or ``zero`` is accepted."""
    value = evaluated.number(path, parameters.get(key), f"{key} of {formula}")
    high = 1.0 if key == "L" else _LARGEST_PARAMETER
    if not 0 <= value <= high or (value == 0 and key != "L" and not zero):
        raise InputError(
            path, f"{key} of {formula} is out of range", found=f"{value:g}", accepted=f"above 0, to {high:g}"
        )
    return value


def _digits(value: float) -> float:
    return float(f"{value:.4g}")
