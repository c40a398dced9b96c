"""The parameters of a renderer's shading model that come nearest to a BSDF, and how far they are from it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize, minimize_scalar

from brdfpipe.exchange.fits.forms import Lobe, Material, base_share
from brdfpipe.exchange.fits.light import INCIDENCES, LEAST_REFLECTANCE, ReflectedLight, luminance_of_rgb
from brdfpipe.exchange.registry import ExchangeError
from brdfpipe.geometry import Array

WIDTHS = (1e-3, 1.0)
"""Least and largest width of a lobe [1]."""
INDICES = (1.0, 2.5)
"""Least and largest index where it is fitted."""
_STARTING_INDICES = (1.05, 1.3, 1.5, 1.8)


@dataclass(frozen=True)
class Form:
    """A shading model of which the width of the lobe and the colour of the base are free; the index too, where none is known."""

    distribution: str
    fresnel_of: Callable[[float], Callable[[Array], Array]]
    """Index → see :attr:`brdfpipe.exchange.fits.forms.Lobe.fresnel`"""
    under_lobe: Callable[[Lobe, Array, Array, Array, Array], Array]
    """See :class:`brdfpipe.exchange.fits.forms.Material`"""
    index: float | None
    """None: it is fitted, within :data:`INDICES`"""
    compensated: bool = False
    """See :attr:`brdfpipe.exchange.fits.forms.Lobe.compensated`"""

    def lobe(self, width: float, index: float) -> Lobe:
        return Lobe(self.distribution, width, self.fresnel_of(index), self.compensated)


@dataclass(frozen=True)
class Fit:
    """A material of a renderer, and its error."""

    material: Material
    index: float
    """Of the lobe"""
    median: float
    """Of |fit − BSDF|·cos θ_o over the larger of BSDF·cos θ_o and 0.001 sr⁻¹, at directions that the fit did not use [1]"""
    percentile_95: float
    albedo: float
    """Largest difference of the directional reflectance, relative to it [1]"""
    peak: float
    """Largest error of the BRDF in the mirror direction, relative to it [1]"""
    delta_e: float
    """Largest CIEDE2000 at :data:`brdfpipe.exchange.fits.light.COLOUR_GEOMETRIES`, D65 and 2 degree"""
    directions: int

    @property
    def luminous_base(self) -> float:
        """Reflectance of the base, weighted with V(λ) and D65."""
        return float(self.material.base @ luminance_of_rgb())


def fit(light: ReflectedLight, form: Form) -> Fit:
    """Fit the width of a lobe and the colour of its base to a BSDF.

    Parameters
    ----------
    light : of a BSDF; a smooth face has the least width of :data:`WIDTHS`
    form : the shading model

    Raises
    ------
    ExchangeError : no light is scattered back.

    Notes
    -----
    The width minimises the squared difference of the cube roots of BRDF·cos θ_o, V(λ) and D65, at directions of which half are drawn where the
    light goes: of the simple metrics it follows perceived differences best (Fores, Ferwerda & Gu 2012). To its share of the mean square is added that of the
    directional reflectances, without which a free index follows the peak of the lobe and reflects too much. The base follows from the
    directional reflectances at :data:`INCIDENCES`, by relative least squares, within 0 and 1.
    """
    luminous, reflectance = luminance_of_rgb(), light.colour
    if light.is_smooth:
        # No direction off the mirror direction has light of such a lobe: the base is what is free.
        assert form.index is not None
        return _with_error(light, _with_base(form.lobe(WIDTHS[0], form.index), form, reflectance), form.index)
    pairs, values = light.fitted()
    cosine = np.cos(np.radians(pairs.theta_o))
    wanted = np.cbrt(values * cosine)
    total = np.maximum(reflectance @ luminous, LEAST_REFLECTANCE)

    def material(log_width: float, index: float) -> Material:
        return _with_base(form.lobe(float(np.exp(log_width)), index), form, reflectance)

    def misfit(at: Sequence[float] | Array) -> float:
        tried = material(*at)
        found = np.cbrt(tried.evaluate(*pairs) @ luminous * cosine)
        reflected = np.cbrt(tried.albedo(INCIDENCES) @ luminous / total)
        return float(np.square(found - wanted).mean() / np.square(wanted).mean() + np.square(reflected - 1).mean())

    # Several starts: a lobe that is much too narrow is seen by no direction.
    logs = np.log(WIDTHS)
    step = (logs[1] - logs[0]) / 12
    indices = _STARTING_INDICES if form.index is None else (form.index,)
    starts = [(log_width, index) for log_width in np.linspace(logs[0], logs[1], 13) for index in indices]
    log_width, index = min(starts, key=misfit)
    near = max(log_width - step, logs[0]), min(log_width + step, logs[1])
    if form.index is not None:
        one = minimize_scalar(
            lambda tried: misfit((tried, index)), bounds=near, method="bounded", options={"xatol": 1e-3}
        )
        return _with_error(light, material(float(one.x), index), index)
    inwards = step / 4 if log_width + step / 4 < near[1] else -step / 4
    both = minimize(
        misfit,
        (log_width, index),
        method="Nelder-Mead",
        bounds=(near, INDICES),
        options={
            "xatol": 1e-3,
            "fatol": 1e-9,
            "initial_simplex": np.array([log_width, index]) + np.array([[0.0, 0.0], [inwards, 0.0], [0.0, 0.05]]),
        },
    )
    return _with_error(light, material(*both.x), float(both.x[1]))


def checked(found: Fit, largest_error: float, largest_delta_e: float, form: str) -> Fit:
    """Refuse a fit that is not the material.

    Raises ExchangeError: the median error, or the colour difference, is above its limit.
    """
    for name, value, limit, words in (
        ("largest_error", found.median, largest_error, "{:.0%} of BRDF·cos θ_o (median)"),
        ("largest_delta_e", found.delta_e, largest_delta_e, "a CIEDE2000 of {:.1f}"),
    ):
        if not limit > 0:
            raise ExchangeError(f"{name} is {limit!r}; accepted: above 0")
        if not value <= limit:
            raise ExchangeError(
                f"{form} does not describe this material: the best fit is off by {words.format(value)}, above the limit `{name}: {limit:g}`; "
                "use the format of a table, or raise the limit"
            )
    return found


def _with_base(lobe: Lobe, form: Form, reflectance: Array) -> Material:
    """The base that has the rest of the reflectance (incidences, 3)."""
    share, rest = base_share(lobe, form.under_lobe, INCIDENCES), reflectance - lobe.albedo(INCIDENCES)
    # Relative to the reflectance: else the base is what a lobe misses at grazing incidence.
    scale = np.maximum(reflectance, LEAST_REFLECTANCE)
    weight = np.square(share / scale).sum(axis=0)
    base = np.divide((share * rest / scale**2).sum(axis=0), weight, out=np.zeros(3), where=weight > 0)
    return Material(lobe, np.clip(base, 0.0, 1.0), form.under_lobe)


def _with_error(light: ReflectedLight, material: Material, index: float) -> Fit:
    luminous, compared = luminance_of_rgb(), light.compared()

    def evaluate(theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, _: Array | None) -> Array:
        return np.asarray(material.evaluate(theta_i, phi_i, theta_o, phi_o) @ luminous)[:, None]

    errors = compared.errors(evaluate)
    off = np.abs((material.albedo(INCIDENCES) - light.colour) @ luminous)
    return Fit(
        material,
        index,
        float(np.median(errors)),
        float(np.quantile(errors, 0.95)),
        float((off / np.maximum(light.colour @ luminous, LEAST_REFLECTANCE)).max()),
        float(light.mirrored(INCIDENCES).errors(evaluate).max()),
        light.delta_e(lambda *at: material.evaluate(*at[:4])),
        errors.size,
    )
