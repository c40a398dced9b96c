"""The parameters of a renderer's shading model that come nearest to a BSDF, and how far they are from it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import xarray as xr
from scipy.optimize import minimize

from brdfpipe.appearance import colours
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.table_error import Evaluate, Pairs, errors_at, fresh_pairs, fresh_pairs_at
from brdfpipe.exchange.fits.forms import Lobe, Material, base_share
from brdfpipe.exchange.gridded import linear_rgb
from brdfpipe.exchange.registry import ExchangeError
from brdfpipe.flakes.geometries import Directions, named_directions
from brdfpipe.geometry import Array
from brdfpipe.optics.fresnel_equations import fresnel
from brdfpipe.spectra import colorimetry

COLOUR_GEOMETRIES = ("45:0", "45as75", "45as110")
"""Geometries off the lobe at which the colour of a fit is compared."""
INCIDENCES = np.array([0.0, 20.0, 40.0, 60.0, 75.0])
"""At which the base is fitted to the reflectance [degree]."""
WIDTHS = (1e-3, 1.0)
"""Least and largest width of a lobe [1]."""
INDICES = (1.0, 2.5)
"""Least and largest index where it is fitted."""
LEAST_REFLECTANCE = 1e-3
"""Below which the error of a reflectance is relative to this [1]."""
_STARTING_INDICES = (1.05, 1.3, 1.5, 1.8)
_FITTED, _COMPARED = 5, 7
"""Seeds of the directions of the fit, and of those at which its error is stated."""


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
    """Largest CIEDE2000 at :data:`COLOUR_GEOMETRIES`, D65 and 2 degree"""
    directions: int

    @property
    def luminous_base(self) -> float:
        """Reflectance of the base, weighted with V(λ) and D65."""
        return float(self.material.base @ luminance_of_rgb())


def fit(bsdf: xr.Dataset, form: Form) -> Fit:
    """Fit the width of a lobe and the colour of its base to a BSDF.

    Parameters
    ----------
    bsdf : kind ``bsdf``, without a lay; a smooth face has the least width of :data:`WIDTHS`
    form : the shading model

    Raises
    ------
    ExchangeError : the surface has a lay, or no light is reflected.

    Notes
    -----
    The width minimises the squared difference of the cube roots of BRDF·cos θ_o, V(λ) and D65, at directions of which half are drawn where the
    light goes: of the simple metrics it follows perceived differences best (Fores, Ferwerda & Gu 2012). To its share of the mean square is added that of the
    directional reflectances, without which a free index follows the peak of the lobe and reflects too much. The base follows from the
    directional reflectances at :data:`INCIDENCES`, by relative least squares, within 0 and 1.
    """
    luminous = luminance_of_rgb()
    if is_smooth(bsdf) and representation(bsdf).isotropic:
        return _on_smooth_face(bsdf, form)
    pairs, values = reflected_light(bsdf)
    cosine = np.cos(np.radians(pairs.theta_o))
    wanted = np.cbrt(values * cosine)
    reflectance = _reflectance(bsdf)
    total = np.maximum(reflectance @ luminous, LEAST_REFLECTANCE)

    def material(log_width: float, index: float) -> Material:
        return _with_base(form.lobe(float(np.exp(log_width)), index), form, reflectance)

    def misfit(at: Array) -> float:
        tried = material(*at)
        found = np.cbrt(tried.evaluate(*pairs) @ luminous * cosine)
        reflected = np.cbrt(tried.albedo(INCIDENCES) @ luminous / total)
        return float(np.square(found - wanted).mean() / np.square(wanted).mean() + np.square(reflected - 1).mean())

    # Several starts: a lobe that is much too narrow is seen by no direction.
    logs = np.log(WIDTHS)
    indices = _STARTING_INDICES if form.index is None else (form.index,)
    starts = [np.array([log_width, index]) for log_width in np.linspace(logs[0], logs[1], 13) for index in indices]
    start = min(starts, key=misfit)
    step = (logs[1] - logs[0]) / 12
    bounds = [
        (max(start[0] - step, logs[0]), min(start[0] + step, logs[1])),
        INDICES if form.index is None else (form.index, form.index),
    ]
    simplex = start + np.array(
        [[0.0, 0.0], [step / 4 if start[0] + step / 4 < bounds[0][1] else -step / 4, 0.0], [0.0, 0.05]]
    )
    found = minimize(
        misfit,
        start,
        method="Nelder-Mead",
        bounds=bounds,
        options={"xatol": 1e-3, "fatol": 1e-9, "initial_simplex": simplex},
    )
    return _with_error(bsdf, material(*found.x), float(found.x[1]))


def checked(found: Fit, largest_error: float, largest_delta_e: float, form: str) -> Fit:
    """Refuse a fit that is not the material.

    Raises ExchangeError: the median error, or the colour difference, is above its limit.
    """
    for name, value, limit, words in (
        ("largest_error", found.median, largest_error, f"{found.median:.0%} of BRDF cos theta_o (median)"),
        ("largest_delta_e", found.delta_e, largest_delta_e, f"a CIEDE2000 of {found.delta_e:.1f}"),
    ):
        if not limit > 0:
            raise ExchangeError(f"{name} is {limit!r}; accepted: above 0")
        if not value <= limit:
            raise ExchangeError(
                f"{form} does not describe this material: the best fit is off by {words}, above the limit of {limit:g}; "
                f"use the format of a table, or raise `{name}`"
            )
    return found


def reflected_light(bsdf: xr.Dataset, theta_i: float | None = None) -> tuple[Pairs, Array]:
    """Pairs of directions above the surface for a fit, of one incidence or of all, and the BRDF there, weighted with V(λ) and D65 [sr-1].

    Raises ExchangeError: the surface has a lay, or no direction has light.
    """
    if not representation(bsdf).isotropic:
        raise ExchangeError("a surface with a lay has no such parameters: use the format of a table")
    reduced = nonspectral(bsdf)
    pairs = fresh_pairs(reduced, _FITTED) if theta_i is None else fresh_pairs_at(reduced, np.array([theta_i]), _FITTED)
    pairs = pairs.chosen(pairs.theta_o < 90)
    values = representation(reduced).evaluate(*pairs, None)[:, 0]
    if not values.any():
        raise ExchangeError(
            "the BSDF scatters no light back, so that there is nothing to fit: use the format of a table"
        )
    return pairs, values


def is_smooth(bsdf: xr.Dataset) -> bool:
    """Whether the surface mirrors most of what it reflects without entering the material into a single direction."""
    normal = np.zeros(1)
    mirrored = representation(bsdf).specular(normal, normal, None)[0].mean()
    n, k = index_of(bsdf)
    return bool(n is not None and mirrored > 0.5 * fresnel(1.0, n, k).mean)


def index_of(bsdf: xr.Dataset) -> tuple[float | None, float]:
    """n and k, weighted with V(λ) and D65; None where the BSDF states no index, and 0 where it states no k."""
    named = next((name for name in ("n", "clear_coat_index") if name in bsdf), None)
    return None if named is None else _luminous_mean(bsdf, named), _luminous_mean(bsdf, "k") if "k" in bsdf else 0.0


def _luminous_mean(bsdf: xr.Dataset, name: str) -> float:
    values = bsdf[name]
    if "mixed" in values.dims:
        # A mean over wavelengths has its own weights.
        return float(values @ bsdf["mixture"])
    if "wavelength" not in values.dims:
        return float(values.mean())
    return float(values @ xr.DataArray(colorimetry.luminous_weight(values["wavelength"].values), dims="wavelength"))


def _with_base(lobe: Lobe, form: Form, reflectance: Array) -> Material:
    """The base that has the rest of the reflectance (incidences, 3)."""
    share, rest = base_share(lobe, form.under_lobe, INCIDENCES), reflectance - lobe.albedo(INCIDENCES)
    # Relative to the reflectance: else the base is what a lobe misses at grazing incidence.
    scale = np.maximum(reflectance, LEAST_REFLECTANCE)
    weight = np.square(share / scale).sum(axis=0)
    base = np.divide((share * rest / scale**2).sum(axis=0), weight, out=np.zeros(3), where=weight > 0)
    return Material(lobe, np.clip(base, 0.0, 1.0), form.under_lobe)


def _on_smooth_face(bsdf: xr.Dataset, form: Form) -> Fit:
    """The base below a face that mirrors; no direction off the mirror direction has light of such a lobe."""
    assert form.index is not None
    lobe = form.lobe(WIDTHS[0], form.index)
    return _with_error(bsdf, _with_base(lobe, form, _reflectance(bsdf)), form.index)


def _with_error(bsdf: xr.Dataset, material: Material, index: float) -> Fit:
    reduced, luminous, reflectance = nonspectral(bsdf), luminance_of_rgb(), _reflectance(bsdf)
    pairs = fresh_pairs(reduced, _COMPARED)
    pairs = pairs.chosen(pairs.theta_o < 90)

    def evaluate(theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, _: Array | None) -> Array:
        return np.asarray(material.evaluate(theta_i, phi_i, theta_o, phi_o) @ luminous)[:, None]

    errors = errors_at(reduced, evaluate, pairs)
    off = np.abs((material.albedo(INCIDENCES) - reflectance) @ luminous)
    plane = np.zeros_like(INCIDENCES)
    mirror = Pairs(INCIDENCES, plane, INCIDENCES, plane + 180.0)
    return Fit(
        material,
        index,
        float(np.median(errors)),
        float(np.quantile(errors, 0.95)),
        float((off / np.maximum(reflectance @ luminous, LEAST_REFLECTANCE)).max()),
        float(errors_at(reduced, evaluate, mirror).max()),
        _delta_e(bsdf, material),
        errors.size,
    )


def _reflectance(bsdf: xr.Dataset) -> Array:
    """(incidences, 3) directional reflectance in linear sRGB; without the light mirrored into a single direction, unless the face is smooth."""
    model, azimuth = representation(bsdf), np.zeros_like(INCIDENCES)
    albedo = model.albedo(INCIDENCES, azimuth, None)
    if not is_smooth(bsdf):
        albedo = albedo - model.specular(INCIDENCES, azimuth, None)[0]
    return np.asarray(linear_rgb(bsdf).convert(albedo))


def _delta_e(bsdf: xr.Dataset, material: Material) -> float:
    white, at = colorimetry.weights("D65", 2).white, _colour_directions()
    xyz = colours.xyz_of(bsdf, representation(bsdf).evaluate(*at, None), "D65", 2)
    of_fit = material.evaluate(*at) * np.pi @ np.linalg.inv(colorimetry.srgb_from_xyz(white)).T
    labs = (colorimetry.xyz_to_lab(np.maximum(values, 0.0), white) for values in (xyz, of_fit))
    return float(np.max(colorimetry.delta_e_00(*labs)))


def delta_e_of_greys(reduced: xr.Dataset, evaluate: Evaluate) -> float:
    """Largest CIEDE2000 at :data:`COLOUR_GEOMETRIES` of a fit without colour: greys of both luminances.

    Parameters
    ----------
    reduced : kind ``bsdf``, weighted with V(λ)
    evaluate : the fit
    """
    white, at = colorimetry.weights("D65", 2).white, _colour_directions()
    both = (np.pi * values(*at, None)[:, :1] * white for values in (representation(reduced).evaluate, evaluate))
    labs = (colorimetry.xyz_to_lab(np.maximum(values, 0.0), white) for values in both)
    return float(np.max(colorimetry.delta_e_00(*labs)))


def _colour_directions() -> Pairs:
    named: dict[str, Directions] = {}
    for name in COLOUR_GEOMETRIES:
        named |= named_directions(name)
    return Pairs(*colours.angles(named))


def luminance_of_rgb() -> Array:
    """(3,) luminance of linear red, green and blue; 1 for white."""
    return np.asarray(np.linalg.inv(colorimetry.srgb_from_xyz(colorimetry.weights("D65", 2).white) * 100)[1])
