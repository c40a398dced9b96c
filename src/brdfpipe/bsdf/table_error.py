"""Error of a table as the program that reads it sees it: at directions between its nodes, by that program's interpolation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.stats import qmc

from brdfpipe.bsdf import approximation_error
from brdfpipe.bsdf.base import Representation
from brdfpipe.bsdf.registry import representation
from brdfpipe.geometry import Array
from brdfpipe.hemisphere import Directions

FLOOR = 1e-3
"""BRDF·|cos θ_o| below which errors are not relative [sr-1]; a white diffuser has 0.32 at the normal."""

LARGEST_INCIDENCE = 85.0
"""Largest angle of incidence, and of view, at which tables are compared [degree]."""

Evaluate = Callable[[Array, Array, Array, Array, Array | None], Array]
"""BSDF of one program: θ_i, φ_i, θ_o, φ_o [degree], wavelength [nm] → (directions, wavelength) [sr-1]."""


class Pairs(NamedTuple):
    """Pairs of directions [degree], (n,) each."""

    theta_i: Array
    phi_i: Array
    theta_o: Array
    phi_o: Array

    def chosen(self, selection: NDArray[np.bool_] | NDArray[np.intp]) -> Pairs:
        """Some of the pairs."""
        return Pairs(*(angles[selection] for angles in self))


class TableError(NamedTuple):
    """Error of a table between its nodes [1]."""

    percentile_95: float
    """95th percentile of |table − model|·|cos θ_o| over the larger of the model's BRDF·|cos θ_o| and :data:`FLOOR`"""
    rms: float
    """Root mean square of the same"""
    albedo: float
    """Largest relative error of the directional reflectance or transmittance, at incidences to 80 degree"""
    directions: int
    """Number of pairs of directions"""


class Limits(NamedTuple):
    """Limits of the error of a table [1]."""

    tolerance: float
    """Of :attr:`TableError.percentile_95`"""
    albedo_tolerance: float
    """Of :attr:`TableError.albedo`"""

    def exceeded(self, error: TableError) -> dict[str, float]:
        """The limits that an error exceeds, by name; empty if it keeps both."""
        reached = error.percentile_95, error.albedo
        return {
            name: limit for name, limit, value in zip(self._fields, self, reached, strict=True) if not value <= limit
        }


def fresh_pairs(bsdf: xr.Dataset, seed: int, incidences: int = 12, views: int = 256) -> Pairs:
    """Pairs of directions for a comparison: incidences spread evenly to :data:`LARGEST_INCIDENCE`, and views of each.

    Half of the views are drawn where the BSDF sends the light, half evenly in projected solid angle, on all sides to which it scatters.
    Every pair stands for the same share.

    Parameters
    ----------
    bsdf : kind ``bsdf``
    seed : of the directions; other seeds than that of the choice of a table test it
    """
    model, generator = representation(bsdf), np.random.default_rng(seed)
    unit = qmc.Sobol(2, rng=generator).random(1 << (incidences - 1).bit_length())[:incidences]
    polar = LARGEST_INCIDENCE * unit[:, 0]
    azimuth = 360 * unit[:, 1] if not model.isotropic else np.zeros(incidences)
    return _pairs_at(model, polar, azimuth, views, generator)


def fresh_pairs_at(bsdf: xr.Dataset, theta_i: Array, seed: int, views: int = 512) -> Pairs:
    """As :func:`fresh_pairs`, at given incidences (n,) in the plane of azimuth 0 [degree]."""
    return _pairs_at(representation(bsdf), theta_i, np.zeros_like(theta_i), views, np.random.default_rng(seed))


def _pairs_at(model: Representation, polar: Array, azimuth: Array, views: int, generator: np.random.Generator) -> Pairs:
    groups = [_views(model, *at, views, generator) for at in zip(polar, azimuth, strict=True)]
    theta_o, phi_o = (np.concatenate(angles) for angles in zip(*groups, strict=True))
    sizes = [theta.size for theta, _ in groups]
    pairs = Pairs(np.repeat(polar, sizes), np.repeat(azimuth, sizes), theta_o, phi_o)
    return pairs.chosen(np.abs(90 - theta_o) >= 90 - LARGEST_INCIDENCE)


def _views(
    model: Representation, theta_i: float, phi_i: float, count: int, generator: np.random.Generator
) -> tuple[Array, Array]:
    drawn = model.distribution(theta_i, phi_i, None).draw(count // 2, generator)
    scattered = ~drawn.is_specular
    polar, around = generator.random((2, count - count // 2))
    theta = np.degrees(np.arcsin(np.sqrt(polar)))
    if model.transmits:
        theta[::2] = 180 - theta[::2]
    return np.append(drawn.theta[scattered], theta), np.append(drawn.phi[scattered], 360 * around)


def error_of(bsdf: xr.Dataset, evaluate: Evaluate, pairs: Pairs, wavelength: Array | None = None) -> TableError:
    """Compare what a program evaluates with the BSDF.

    Parameters
    ----------
    bsdf : kind ``bsdf``, the model
    evaluate : what the program makes of its file
    pairs : where to compare, see :func:`fresh_pairs`
    wavelength : (n,) nm, default those of the BSDF
    """
    errors = errors_at(bsdf, evaluate, pairs, wavelength)
    theta_i = np.linspace(5.0, 80.0, 6)
    albedo = max(
        _albedo_error(representation(bsdf), evaluate, of_side, theta_i, wavelength)
        for of_side in zip(*(rules(bsdf, float(theta)) for theta in theta_i), strict=True)
    )
    return TableError(float(np.quantile(errors, 0.95)), float(np.sqrt(np.mean(errors**2))), albedo, pairs.theta_i.size)


def errors_at(bsdf: xr.Dataset, evaluate: Evaluate, pairs: Pairs, wavelength: Array | None = None) -> Array:
    """|read − given|·|cos θ_o| over the larger of the given BRDF·|cos θ_o| and :data:`FLOOR`, (n, wavelength) [1]."""
    given = representation(bsdf).evaluate(*pairs, wavelength)
    return relative_errors(evaluate(*pairs, wavelength), given, pairs.theta_o)


def relative_errors(read: Array, given: Array, theta_o: Array) -> Array:
    """As :func:`errors_at`, of values (n, wavelength) [sr-1] at polar angles (n,) of view [degree]."""
    cosine = np.abs(np.cos(np.radians(theta_o)))[:, None]
    return np.asarray(np.abs(read - given) * cosine / np.maximum(given * cosine, FLOOR))


def rules(bsdf: xr.Dataset, theta_i: float, phi_i: float = 0.0) -> list[Directions]:
    """Quadratures of each side to which the BSDF scatters light of one incidence, graded towards its lobe."""
    rules, model = [approximation_error.directions(bsdf, theta_i, phi_i)], representation(bsdf)
    if model.transmits:
        behind = approximation_error.directions(bsdf, 180 - float(model.refracted(np.array(theta_i))), phi_i)
        rules.append(behind._replace(theta=180 - behind.theta))
    return rules


def light_of_incidences(
    evaluate: Evaluate, theta_i: Array, phi_i: float, rules: Sequence[Directions], wavelength: Array | None
) -> list[Array]:
    """Light that a BSDF sends into the directions of a quadrature for each incidence [1], (incidences)(wavelength,)."""
    parts = approximation_error.brdf_of_incidences(evaluate, theta_i, phi_i, rules, wavelength)
    return [np.asarray(rule.weight @ part) for rule, part in zip(rules, parts, strict=True)]


def _albedo_error(
    model: Representation, evaluate: Evaluate, rules: Sequence[Directions], theta_i: Array, wavelength: Array | None
) -> float:
    """Largest relative error of the light of one side, at any incidence."""
    given, read = (
        np.array(light_of_incidences(values, theta_i, 0.0, rules, wavelength)) for values in (model.evaluate, evaluate)
    )
    lit = given > 1e-9
    return float(np.max(np.abs(read[lit] / given[lit] - 1), initial=0.0))
