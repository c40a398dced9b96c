"""Formulas of scattered light by the distance from the mirror direction, as optical design programs evaluate them, over a Lambertian part.

The distance is that of the direction cosines, x = |β − β₀| with β = (sin θ_o cos φ_o, sin θ_o sin φ_o) and β₀ that of the mirror direction.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from brdfpipe.bsdf.table_error import Evaluate, Pairs
from brdfpipe.exchange.fits.light import INCIDENCES, LEAST_REFLECTANCE, ReflectedLight, Sampled, delta_e_of_greys
from brdfpipe.geometry import Array

_STARTING_WIDTHS = (0.01, 0.03, 0.1, 0.3)


Parameters = tuple[float, float, float] | tuple[Array, Array, Array]
"""Of a lobe, for all directions or for each."""


@dataclass(frozen=True)
class Formula:
    """A formula with three parameters of its lobe."""

    words: str
    names: tuple[str, str, str]
    """Peak or scale [sr-1], width [1], and exponent"""
    lobe: Callable[[Array, Array, Array, Parameters], Array]
    """(x, cos θ_i, cos θ_o, parameters) → BRDF [sr-1]"""
    from_peak: Callable[[float, float, float], tuple[float, float, float]]
    """Peak [sr-1], half width [1], exponent → parameters, for a start"""
    exponents: tuple[float, float] = (0.5, 8.0)


def _abg(x: Array, _i: Array, _o: Array, parameters: Parameters) -> Array:
    a, b, g = parameters
    return np.asarray(a / (b + x**g))


def _harvey(x: Array, _i: Array, _o: Array, parameters: Parameters) -> Array:
    peak, width, slope = parameters
    return np.asarray(peak * (1 + (x / width) ** 2) ** (-slope / 2))


def _k_correlation(x: Array, cos_i: Array, cos_o: Array, parameters: Parameters) -> Array:
    return np.asarray(cos_i * cos_o * _harvey(x, cos_i, cos_o, parameters))


FORMULAS: Mapping[str, Formula] = {
    "abg": Formula(
        "A / (B + x^g) + L / pi", ("A", "B", "g"), _abg, lambda peak, width, g: (peak * width**g, width**g, g)
    ),
    "harvey": Formula(
        "b0 (1 + (x / l)^2)^(-s / 2) + L / pi", ("b0", "l", "s"), _harvey, lambda peak, width, s: (peak, width, s)
    ),
    "k_correlation": Formula(
        "b0 cos theta_i cos theta_o (1 + (x / l)^2)^(-s / 2) + L / pi",
        ("b0", "l", "s"),
        _k_correlation,
        lambda peak, width, s: (peak, width, s),
    ),
}
"""ABg (Pfisterer), Harvey and Shack with a shoulder, and the K-correlation (ABC) model of a smooth surface's spectrum; L is a reflectance."""


LISTED_INCIDENCES = np.array([0.0, 15.0, 30.0, 45.0, 60.0, 75.0, 85.0])
"""Of parameters by incidence [degree]."""


@dataclass(frozen=True)
class ScatterError:
    """How far a formula is from the BSDF [1]."""

    median: float
    """See :class:`brdfpipe.exchange.fits.fitting.Fit`"""
    percentile_95: float
    albedo: float
    """Largest error of the directional reflectance at the incidences, relative to it"""
    peak: float
    """Largest error of the BRDF in the mirror direction of the incidences, relative to it"""
    delta_e: float | None
    """See :func:`brdfpipe.exchange.fits.light.delta_e_of_greys`; None of a single incidence"""
    directions: int


@dataclass(frozen=True)
class ScatterFit:
    """Parameters of a formula, and its error."""

    parameters: dict[str, float]
    """Those of the lobe, and L, the reflectance of the base"""
    error: ScatterError


def distance(pairs: Pairs) -> Array:
    """x of each pair [1]."""
    sines = np.sin(np.radians(pairs.theta_i)), np.sin(np.radians(pairs.theta_o))
    turn = np.radians(pairs.phi_o - pairs.phi_i)
    # The mirror direction is opposite to the incidence.
    return np.asarray(np.hypot(sines[1] * np.cos(turn) + sines[0], sines[1] * np.sin(turn)))


def fit_formula(light: ReflectedLight, name: str, theta_i: float | None = None) -> ScatterFit:
    """Fit a formula of :data:`FORMULAS` to the reflected light, weighted with V(λ) and D65.

    Parameters
    ----------
    light : of a BSDF
    theta_i : the incidence of the fit and of its error [degree]; by default all, and reflectance and peak at
        :data:`brdfpipe.exchange.fits.light.INCIDENCES`

    Raises
    ------
    ExchangeError : no light is scattered back.

    Notes
    -----
    Least squares of the cube roots of BRDF·cos θ_o, as :func:`brdfpipe.exchange.fits.fitting.fit`; from several starting widths.
    """
    formula = FORMULAS[name]
    *lobe, base = _least_squares(formula, light.fitted(theta_i))
    parameters = dict(zip((*formula.names, "L"), (*lobe, base), strict=True))
    return ScatterFit(parameters, error_by_incidence(light, name, {theta_i or 0.0: parameters}, theta_i))


def error_by_incidence(
    light: ReflectedLight, name: str, parameters: Mapping[float, Mapping[str, float]], theta_i: float | None = None
) -> ScatterError:
    """Error of a formula whose parameters are interpolated linearly in the cosine of the incidence, as OpticStudio does.

    Parameters
    ----------
    light : of a BSDF
    parameters : increasing incidence [degree] → parameters, which hold beyond the outermost
    theta_i : the incidence of the error; see :func:`fit_formula`
    """
    formula = FORMULAS[name]
    evaluate = at_incidence(formula, parameters)
    incidences = INCIDENCES if theta_i is None else np.array([theta_i])
    lobe, base = _interpolated(formula, parameters, incidences)
    return error_of_fit(light, evaluate, reflectance_of(formula, lobe, incidences) + base, theta_i)


def error_of_fit(
    light: ReflectedLight, evaluate: Evaluate, reflectance: Array, theta_i: float | None = None
) -> ScatterError:
    """Error of a fit, and of its reflectance at :data:`brdfpipe.exchange.fits.light.INCIDENCES` or at the one incidence [degree] of the error."""
    incidences = INCIDENCES if theta_i is None else np.array([theta_i])
    errors, scattered = light.compared(theta_i).errors(evaluate), light.reflectance(incidences)
    return ScatterError(
        float(np.median(errors)),
        float(np.quantile(errors, 0.95)),
        float((np.abs(reflectance - scattered) / np.maximum(scattered, LEAST_REFLECTANCE)).max()),
        float(light.mirrored(incidences).errors(evaluate).max()),
        delta_e_of_greys(light.reduced, evaluate) if theta_i is None else None,
        errors.size,
    )


def at_incidence(formula: Formula, parameters: Mapping[float, Mapping[str, float]]) -> Evaluate:
    """The BRDF of a formula with parameters by incidence, see :func:`error_by_incidence`."""

    def evaluate(theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, _: Array | None) -> Array:
        cosines = np.cos(np.radians(theta_i)), np.cos(np.radians(theta_o))
        lobe, base = _interpolated(formula, parameters, theta_i)
        x = distance(Pairs(theta_i, phi_i, theta_o, phi_o))
        return np.asarray(formula.lobe(x, *cosines, lobe) + base / np.pi)[:, None]

    return evaluate


def _interpolated(
    formula: Formula, parameters: Mapping[float, Mapping[str, float]], theta_i: Array
) -> tuple[tuple[Array, Array, Array], Array]:
    """The parameters of the lobe and the reflectance of the base, each in the shape of ``theta_i``."""
    cosine, known = np.cos(np.radians(theta_i)), np.cos(np.radians(list(parameters)))[::-1]
    scale, width, exponent, base = (
        np.interp(cosine, known, [one[key] for one in parameters.values()][::-1]) for key in (*formula.names, "L")
    )
    return (scale, width, exponent), base


def _least_squares(formula: Formula, light: Sampled) -> tuple[float, float, float, float]:
    """The parameters of the lobe, and the reflectance of the base."""
    pairs, values = light
    x, cos_i, cos_o = distance(pairs), np.cos(np.radians(pairs.theta_i)), np.cos(np.radians(pairs.theta_o))
    wanted = np.cbrt(values * cos_o)

    def residual(logs: Array) -> Array:
        *lobe, base = np.exp(logs)
        return np.asarray(np.cbrt((formula.lobe(x, cos_i, cos_o, tuple(lobe)) + base / np.pi) * cos_o) - wanted)

    floor = float(np.clip(np.quantile(values, 0.05) * np.pi, 1e-6, 1.0))
    peak = max(float(np.quantile(values, 0.99)), 1e-6)
    starts = [np.log([*formula.from_peak(peak, width, 2.0), floor]) for width in _STARTING_WIDTHS]
    low = np.log([1e-12, 1e-12, formula.exponents[0], 1e-9])
    high = np.log([1e9, 1e3, formula.exponents[1], 1.0])
    found = min(
        (least_squares(residual, np.clip(start, low + 1e-6, high - 1e-6), bounds=(low, high)) for start in starts),
        key=lambda result: float(result.cost),
    )
    scale, width, exponent, base = (float(value) for value in np.exp(found.x))
    return scale, width, exponent, base


def reflectance_of(formula: Formula, parameters: Parameters, theta_i: Array) -> Array:
    """Directional reflectance of the lobe of a formula at incidences in degree, shape of ``theta_i``; ``parameters`` of all or of each.

    The integral of the BRDF over the projected solid angle, which is the area of direction cosines: rings about the mirror direction, cut at the horizon.
    """
    x = np.geomspace(1e-6, 2.0, 1000)[:, None]
    azimuth = np.radians(np.arange(0.5, 180))
    scale, width, exponent = np.broadcast_arrays(*parameters, theta_i)[:3]
    reflectance = []
    for row, incidence in enumerate(np.radians(theta_i)):
        squared = np.sin(incidence) ** 2 + 2 * x * np.sin(incidence) * np.cos(azimuth) + x**2
        cos_o = np.sqrt(np.maximum(1 - squared, 0.0))
        brdf = formula.lobe(x, np.cos(incidence), cos_o, (scale[row], width[row], exponent[row])) * (squared < 1)
        reflectance.append(np.trapezoid(2 * np.pi * brdf.mean(axis=1) * x[:, 0] ** 2, np.log(x[:, 0])))
    return np.asarray(reflectance)
