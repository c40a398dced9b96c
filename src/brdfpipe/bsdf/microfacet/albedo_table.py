"""The directional albedo of a surface between the nodes of its table."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline, PPoly, RectBivariateSpline

from brdfpipe.bsdf.microfacet import anisotropic_quadrature as quadrature
from brdfpipe.content_cache import cached_by_content
from brdfpipe.facets.planar_density import Ellipse
from brdfpipe.geometry import Array
from brdfpipe.hemisphere import panel_rule
from brdfpipe.piecewise import PiecewiseCubic

_LAY_FINENESS = 8.0  # smaller rms slope, as an angle, over the angle on which the albedo varies near grazing
_LAY_MOST_GRAZING = 2.0  # upper limit of that angle [degree]


@dataclass(frozen=True)
class AlbedoTable:
    """The directional albedo as a spline in the angle from grazing."""

    theta: Array
    """(θ,) increasing, from 0 to 90 degree"""
    values: Array
    """(θ, wavelength), or (θ, φ, wavelength) of a surface with a lay"""
    phi: Array | None = None
    """(φ,) degree, increasing around the circle; of a surface with a lay"""
    ellipse: Ellipse | None = None
    """Principal slopes of a surface with a lay, which scale both angles so that the albedo is smooth"""
    second: Callable[[], PPoly] | None = None
    """Gives the part of an isotropic albedo that is not smooth in θ, cubics of 90° − θ, (wavelength,); a spline holds the rest"""

    def __call__(self, theta: Array, phi: Array | float = 0.0) -> Array:
        """E, (…, wavelength), in [0, 1]."""
        grazing = 90 - np.asarray(theta, dtype=float)
        if self.phi is None:
            # Faster than np.clip where there are few.
            return np.minimum(np.maximum(self.spline(grazing), 0.0), 1.0)
        assert self.ellipse is not None
        at = np.arcsinh(grazing / lay_scale(self.ellipse)), quadrature.azimuth_to_arc(self.ellipse, phi)
        values = np.stack([spline.ev(*at) for spline in self.surfaces], axis=-1)
        return np.minimum(np.maximum(values, 0.0), 1.0)

    def mean(self) -> Array:
        """2 ∫ E μ dμ, averaged over azimuth, (wavelength,): exact for the spline."""
        theta, weight = panel_rule(np.radians(self.theta), 6)
        weight = weight * np.sin(2 * theta)
        if self.phi is None:
            return np.asarray(weight @ self(np.degrees(theta)))
        assert self.ellipse is not None
        phi = quadrature.arc_to_azimuth(self.ellipse, np.linspace(0.0, 360.0, 4 * self.phi.size, endpoint=False))
        width, _ = self.ellipse.towards(phi)
        mean = np.einsum("tpl,p->tl", self(np.degrees(theta)[:, None], phi), width / width.sum())
        return np.asarray(weight @ mean)

    @cached_property
    def spline(self) -> PiecewiseCubic:
        grazing, values = 90 - self.theta[::-1], self.values[::-1]
        if self.second is None:
            return _even_piecewise(grazing, values)
        second = self.second()
        return PiecewiseCubic.of(_sum(even_spline(grazing, values - second(grazing)), second))

    @cached_property
    def surfaces(self) -> list[RectBivariateSpline]:
        assert self.phi is not None
        assert self.ellipse is not None
        arc = quadrature.azimuth_to_arc(self.ellipse, self.phi)
        order = np.argsort(arc)
        around = np.concatenate([order[-4:], order, order[:4]])
        grazing = np.arcsinh((90 - self.theta[::-1]) / lay_scale(self.ellipse))
        values = np.moveaxis(self.values[::-1][:, around], -1, 0)
        arcs = np.unwrap(arc[around] - 360, period=360)
        return [RectBivariateSpline(grazing, arcs, by_angles) for by_angles in values]


def lay_scale(ellipse: Ellipse) -> float:
    """Angle from grazing [degree] on which the albedo of a surface with a lay varies."""
    return min(float(np.degrees(min(ellipse.along, ellipse.across))) / _LAY_FINENESS, _LAY_MOST_GRAZING)


@cached_by_content(16)
def _even_piecewise(grazing: Array, values: Array) -> PiecewiseCubic:
    return PiecewiseCubic.of(even_spline(grazing, values))


def even_spline(grazing: Array, values: Array) -> CubicSpline:
    """Spline through an isotropic albedo (nodes, wavelength) over 90° − θ [degree]."""
    # E is even in θ: its derivative is 0 at the normal, 90 degree from grazing.
    return CubicSpline(grazing, values, axis=0, bc_type=("not-a-knot", (1, np.zeros(values.shape[1]))))


def _sum(first: PPoly, second: PPoly) -> PPoly:
    """The sum of two piecewise cubics, exact but for rounding, with the nodes of both."""
    nodes = np.union1d(first.x, second.x)
    terms = [(first(nodes[:-1], order) + second(nodes[:-1], order)) / math.factorial(order) for order in (3, 2, 1, 0)]
    return PPoly(np.stack(terms), nodes)
