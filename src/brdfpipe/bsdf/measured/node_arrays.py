"""The nodes of a side of a measured BSDF, and their uncertainties, as arrays for :mod:`brdfpipe.bsdf.measured.node_kernel`."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdfpipe.bsdf.measured.basis import GRAZING, GRAZING_WIDTH, PSpline, has_all_knots
from brdfpipe.geometry import Array

if TYPE_CHECKING:
    from brdfpipe.bsdf.measured.node_interpolation import Side


class Nodes(NamedTuple):
    """The nodes of a side as arrays; angles in radians."""

    about_half: bool
    """Whether ϑ and φ are about the half vector, not about the mirror direction"""
    cosine: Array
    """(node,) of the incidence"""
    sine: Array
    """(node,)"""
    horizon: Array
    """(node,) cosine of the largest polar angle of a cell"""
    abscissa: Array
    """(node,) −ln cos of the incidence"""
    coefficient: Array
    """(node, place, wavelength): of the splines of each harmonic, also of those that it leaves out, which are 0; then of the scales in cos θ_o,
    for each of their harmonics"""
    grazing_first: int
    """First place of these scales"""
    grazing_order: NDArray[np.int64]
    """(grazing harmonic,) k of cos kφ, then of sin kφ"""
    grazing_wave: NDArray[np.int64]
    """(grazing harmonic,) the same harmonic among all"""
    grazing_width: float
    """ϑ beyond which these harmonics have their full size"""
    limits: Array
    """(node, wavelength, 2) least and largest logarithm"""
    scale: float
    """Scale [degree] of t = asinh(ϑ/scale)"""
    knots: Array
    """Of the harmonics with all knots"""
    coarse_knots: Array
    """Of the harmonics with every second knot"""
    order: NDArray[np.int64]
    """(harmonic,) k of cos kφ, then of sin kφ"""
    sines: int
    """First harmonic that is a sine"""
    fine: NDArray[np.int64]
    """(harmonic,) 1 with all knots, 0 with every second"""
    first: NDArray[np.int64]
    """(harmonic,) its first spline among the coefficients"""
    grazing_scale: Array
    """(scale,) in cos θ_o"""
    error_theta: Array
    """Incidences of the next; empty where the two directions of light are not averaged"""
    error_t: Array
    """asinh(ϑ/scale) of the next"""
    error_cosine: Array
    """cos φ of the next"""
    error: Array
    """Uncertainty of the logarithm of the BSDF in one direction of light (incidence, ϑ, φ)"""

    @classmethod
    def of(cls, side: Side, basis: PSpline, margin: float) -> Nodes:
        """Of a side with logarithms in P-splines; they exceed the values at cells by ``margin`` at most."""
        sizes = np.array([len(part) for part in basis.of_all_splines(np.zeros((basis.harmonic.size, 0)))])
        cosine = np.cos(np.radians(side.incidence))
        error = side.path_error or (np.zeros(0), np.zeros(0), np.zeros(0), np.zeros((0, 0, 0)))
        return cls(
            side.about == "half",
            cosine,
            np.sin(np.radians(side.incidence)),
            np.cos(np.radians(side.horizon)),
            np.ascontiguousarray(side.abscissa),
            np.ascontiguousarray(np.swapaxes(_by_place(basis, side.coefficient), 1, 2)),
            int(sizes.sum()),
            basis.grazing_orders,
            np.where(
                np.arange(basis.grazing_orders.size) <= basis.grazing_harmonics,
                basis.grazing_orders,
                basis.harmonics + basis.grazing_orders,
            ),
            math.radians(GRAZING_WIDTH),
            np.stack([side.lowest - margin, side.highest + margin], axis=-1),
            basis.scale,
            basis.knots(True),
            basis.knots(False),
            basis.orders,
            basis.harmonics + 1,
            np.array([has_all_knots(k) for k in basis.orders.tolist()], dtype=np.int64),
            np.cumsum(sizes) - sizes,
            np.array(GRAZING),
            *error,
        )


class Covariances(NamedTuple):
    """The uncertainties of the coefficients of :class:`Nodes`."""

    covariance: Array
    """(node, wavelength, place, place) of independent errors"""
    common: Array
    """(node, wavelength, component, place) change by one standard uncertainty of a common error"""
    measured: NDArray[np.int64]
    """(measured node,) which nodes were measured"""
    odd: NDArray[np.bool_]
    """(function,) whether a function that is not 0 at a direction is odd in σ, in the order of the harmonics"""

    @classmethod
    def of(cls, side: Side, basis: PSpline) -> Covariances | None:
        """Of a side; None where incidences were measured at some wavelengths alone."""
        measured = side.measured.any(axis=1)
        if not (measured == side.measured.all(axis=1)).all() or not measured.any():
            return None
        factor = _by_place(basis, np.swapaxes(side.factor, 2, 3).astype(float))
        orders = np.concatenate([basis.orders.repeat(_SPLINES), basis.grazing_orders.repeat(len(GRAZING))])
        return cls(
            np.swapaxes(factor, 2, 3) @ factor,
            np.ascontiguousarray(np.moveaxis(_by_place(basis, side.common), 0, 2)),
            np.flatnonzero(measured),
            orders % 2 == 1,
        )


class ErrorLimits(NamedTuple):
    """Numbers of the error of interpolation and completion, see :mod:`brdfpipe.bsdf.measured.node_errors`."""

    largest: float
    """Upper limit of the error of a logarithm, which has no exponential beyond"""
    horizon_error: float
    """Largest error of the logarithm beyond the last cell, of a change with cos θ_o as below a dielectric face"""
    horizon_rise: float
    """Added to cos θ_o, so that this error rises evenly from the last cell on"""
    error_range: float
    """Distance from a single incidence at which the logarithm is uncertain by 1 [degree]"""


_SPLINES = 4  # cubic splines that are not 0 at a direction


def _by_place(basis: PSpline, coefficient: Array) -> Array:
    """Coefficients (…, term) as (…, place), see :class:`Nodes`."""
    grazing = len(GRAZING) * basis.grazing_orders.size
    splines = np.concatenate(basis.of_all_splines(np.moveaxis(coefficient, -1, 0)))
    return np.concatenate([np.moveaxis(splines, 0, -1), coefficient[..., coefficient.shape[-1] - grazing :]], axis=-1)
