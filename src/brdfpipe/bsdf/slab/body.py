"""The body of a slab over wavelength: its index and internal transmittance, and the few nodes that stand for all of them.

What is scattered inside depends on wavelength through these two numbers alone, and smoothly: it is worked out at a few of each
and interpolated, so that forty wavelengths do not cost forty times as much.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.bsdf.microfacet.microsurface import ModelError
from brdfpipe.bsdf.spectral import at_wavelengths
from brdfpipe.geometry import Array
from brdfpipe.optics.index import interpolate_index, refractive_index

Spectral: TypeAlias = float | xr.DataArray
"""A number, or values over ``wavelength`` [nm]."""

_DARKEST = float(np.sqrt(-np.log(1e-4)))
_BLACK = 1e-300


@dataclass(frozen=True)
class Body:
    """Index and internal transmittance at normal incidence, scalars where they do not depend on wavelength."""

    n: Array
    transmittance: Array
    wavelength: Array | None
    held: tuple[str, ...] = ()
    """What to warn about"""

    @classmethod
    def of(
        cls,
        index: xr.Dataset | float | str,
        internal_transmittance: Spectral | None,
        absorption: Spectral | None,
        thickness: float | None,
    ) -> Body:
        """The body as :func:`brdfpipe.bsdf.slab.build` is given it."""
        known = vocabulary.validate(index, "index") if isinstance(index, xr.Dataset) else refractive_index(index)
        if np.any(known["k"].values > 0):
            raise ModelError(
                f"the index of the slab absorbs (k up to {float(known['k'].max()):g}); give a real index, and the absorption apart"
            )
        inside, wavelength = _transmittance(internal_transmittance, absorption, thickness)
        n, nm = known["n"].values.astype(float), known["wavelength"].values
        if np.ptp(n) == 0:
            return cls(np.asarray(n[0]), inside, wavelength)
        if wavelength is None:
            return cls(n, inside, nm)
        within = np.clip(wavelength, nm[0], nm[-1])
        held = (
            f"the refractive index is known from {nm[0]:g} to {nm[-1]:g} nm and was held constant beyond; give a table that covers "
            f"{wavelength[0]:g} to {wavelength[-1]:g} nm"
        )
        beyond = not np.array_equal(within, wavelength)
        return cls(interpolate_index(known, within)[0], inside, wavelength, (held,) if beyond else ())

    def index_nodes(self) -> Array:
        """Indices between which all that depends on the index is a parabola."""
        low, high = float(self.n.min()), float(self.n.max())
        return np.array([low]) if low == high else np.linspace(low, high, 3)

    def depth_nodes(self) -> Array:
        """Roots of −ln τ between which the logarithm of the scattered light is a polynomial: Chebyshev's.

        Light trapped beyond the critical angle dwindles with the first trace of absorption: near τ = 1 the logarithm bends like
        the root.
        """
        depth = _depth(self.transmittance)
        low, high = min(float(depth.min()), _DARKEST), min(float(depth.max()), _DARKEST)
        if depth.max() > _DARKEST:
            low = min(low, _DARKEST - 0.2)
        if low == high:
            return np.array([low])
        count = 3 if high - low < 0.1 else 5 if high - low < 0.5 else 8
        return np.asarray((low + high) / 2 - (high - low) / 2 * np.cos(np.pi * np.arange(count) / (count - 1)))


@dataclass(frozen=True)
class Mixture:
    """How the nodes of index and transmittance make up each wavelength.

    Parameters
    ----------
    n : (wavelength or 1,) index
    weights : (wavelength or 1, nodes)
    """

    n: Array
    weights: Array

    @classmethod
    def of(cls, bsdf: xr.Dataset, wavelength: Array | None) -> Mixture:
        """That of a ``slab`` at its own or other wavelengths [nm]."""
        n, inside = (np.atleast_1d(at_wavelengths(bsdf[name], wavelength)) for name in ("n", "internal_transmittance"))
        by_index = lagrange(bsdf["index_node"].values, n)
        by_depth = _depth_weights(bsdf["depth_node"].values, inside)
        weights = by_index[:, :, None] * by_depth[:, None, :]
        return cls(n, weights.reshape(weights.shape[0], -1))

    @property
    def size(self) -> int:
        return self.weights.shape[0]


def lagrange(nodes: Array, x: Array) -> Array:
    """Weights, (x, nodes), of the polynomial through values at the nodes."""
    others = ~np.eye(nodes.size, dtype=bool)
    factors = np.where(others, (x[:, None, None] - nodes) / np.where(others, nodes[:, None] - nodes, 1.0), 1.0)
    return np.asarray(factors.prod(axis=-1))


def _depth(transmittance: Array) -> Array:
    """√(−ln τ)."""
    return np.sqrt(-np.log(np.clip(transmittance, _BLACK, 1.0)))


def _depth_weights(nodes: Array, transmittance: Array) -> Array:
    depth = _depth(transmittance)
    if nodes.size == 1:
        return np.ones((depth.size, 1))
    weights = lagrange(nodes, np.minimum(depth, nodes[-1]))
    # Darker than all nodes, the light that crosses the fewest times is what is left: its logarithm is a line over ln τ.
    line = np.zeros_like(weights)
    line[:, -2:] = lagrange(nodes[-2:] ** 2, depth**2)
    return np.where((depth > nodes[-1])[:, None], line, weights)


def _transmittance(
    internal_transmittance: Spectral | None, absorption: Spectral | None, thickness: float | None
) -> tuple[Array, Array | None]:
    if absorption is None and thickness is None:
        values, wavelength = _field(1.0 if internal_transmittance is None else internal_transmittance)
        if not (values.min() >= 0 and values.max() <= 1):
            raise ModelError(f"the internal transmittance spans {values.min():g} to {values.max():g}; accepted: 0 to 1")
        return values, wavelength
    if internal_transmittance is not None or absorption is None or thickness is None:
        raise ModelError("give either the internal transmittance, or the absorption and the thickness")
    values, wavelength = _field(absorption)
    if not (values.min() >= 0 and np.isfinite(values).all() and 0 < thickness < np.inf):
        raise ModelError(
            f"absorption of {values.min():g} to {values.max():g} mm-1 over {thickness:g} mm; accepted: finite, >= 0 and > 0"
        )
    return np.asarray(np.exp(-values * thickness)), wavelength


def _field(given: Spectral) -> tuple[Array, Array | None]:
    if not isinstance(given, xr.DataArray) or given.ndim == 0:
        return np.asarray(given, dtype=float), None
    if given.dims != ("wavelength",) or given.size == 0 or not (np.diff(given["wavelength"].values) > 0).all():
        raise ModelError(
            f"a spectrum of the slab has dimensions {given.dims}; accepted: a number, or values over increasing `wavelength`"
        )
    values, wavelength = given.values.astype(float), given["wavelength"].values.astype(float)
    return (np.asarray(values[0]), None) if np.ptp(values) == 0 else (values, wavelength)
