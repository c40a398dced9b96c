"""The slope density P22(p, q) of a surface with a lay, as a function, and its masking in every azimuth.

The isotropic counterpart is :mod:`brdfpipe.density`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from brdfpipe.geometry import Array
from brdfpipe.hemisphere import panel_rule

AZIMUTHS = np.arange(0.0, 360.0, 5.0)
"""Azimuths at which masking is tabulated [degree]."""

_TOWARDS = 513
_ACROSS_PANELS = 32


@dataclass(frozen=True)
class SlopeAxis:
    """Slopes from −reach to reach, uniform in asinh(slope/scale): dense about zero, sparse in the tails."""

    scale: float
    reach: float
    size: int

    @property
    def end(self) -> float:
        """asinh(reach/scale)."""
        return float(np.arcsinh(self.reach / self.scale))

    @cached_property
    def nodes(self) -> Array:
        half = (self.size - 1) / 2
        nodes: Array = self.scale * np.sinh(np.arange(-half, half + 1) * (self.end / half))
        return nodes

    def position(self, slope: ArrayLike) -> Array:
        """Fractional index of slopes on the nodes."""
        return np.asarray((np.arcsinh(np.asarray(slope) / self.scale) / self.end + 1) * (self.size - 1) / 2)

    @classmethod
    def of(cls, coordinate: xr.DataArray) -> SlopeAxis:
        """The axis that a dataset's coordinate carries, with its ``scale`` as attribute."""
        return cls(float(coordinate.attrs["scale"]), float(coordinate.values[-1]), coordinate.size)


@dataclass(frozen=True)
class PlanarDensity:
    """Slope density on a grid of slopes, evaluated between its nodes.

    Parameters
    ----------
    x, y : axes of the slope towards x and y
    density : (y, x) positive [1]; zero beyond the grid

    Notes
    -----
    log P22 is a tensor-product cubic spline in asinh(slope/scale).
    """

    x: SlopeAxis
    y: SlopeAxis
    density: Array

    @classmethod
    def of(cls, facets: xr.Dataset) -> PlanarDensity:
        """The density that an anisotropic ``facets`` dataset carries."""
        density = facets["slope_density"].transpose("slope_y", "slope_x").values
        return cls(SlopeAxis.of(facets["slope_x"]), SlopeAxis.of(facets["slope_y"]), density)

    def __call__(self, slope_x: ArrayLike, slope_y: ArrayLike) -> Array:
        """P22 at slopes (p, q), broadcast."""
        from scipy.ndimage import map_coordinates

        p, q = np.broadcast_arrays(np.asarray(slope_x, dtype=float), np.asarray(slope_y, dtype=float))
        row, column = self.y.position(q), self.x.position(p)
        inside = (row >= 0) & (row <= self.y.size - 1) & (column >= 0) & (column <= self.x.size - 1)
        places = np.stack([row[inside], column[inside]])
        result = np.zeros(p.shape)
        result[inside] = np.exp(map_coordinates(self._coefficients, places, order=3, prefilter=False, mode="mirror"))
        return result

    @cached_property
    def _coefficients(self) -> Array:
        from scipy.ndimage import spline_filter

        return np.asarray(spline_filter(np.log(self.density), order=3, mode="mirror"))

    def rule(self, panels: int = 48) -> tuple[Array, Array, Array]:
        """Quadrature over the slope plane: p, q and probability weights, Σ w h(p, q) = E[h]."""
        p, weight_p = _axis_rule(self.x, panels)
        q, weight_q = _axis_rule(self.y, panels)
        p, q = np.meshgrid(p, q)
        return p, q, self(p, q) * weight_q[:, None] * weight_p

    @cached_property
    def moments(self) -> tuple[float, Array, Array]:
        """Mass, mean (2,) and covariance (2, 2) of the slopes."""
        p, q, weight = self.rule()
        mass = float(weight.sum())
        slopes = np.stack([p.ravel(), q.ravel()])
        mean = slopes @ weight.ravel() / mass
        centred = slopes - mean[:, None]
        return mass, mean, (centred * weight.ravel()) @ centred.T / mass

    def marginal(self, azimuth: float) -> tuple[Array, Array]:
        """Density P1 of the slope towards an azimuth [degree]: slopes (n,) and values (n,), integrated across."""
        cos, sin = np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth))
        along = float(np.hypot(self.x.scale * cos, self.y.scale * sin))
        towards = SlopeAxis(along, float(np.hypot(self.x.reach * cos, self.y.reach * sin)), _TOWARDS).nodes
        # Given the slope along, the ridge of a tilted ellipse lies off the axis: the rule across is centred on it.
        ridge = (self.y.scale**2 - self.x.scale**2) * sin * cos / along**2
        narrow = self.x.scale * self.y.scale / along
        end = np.arcsinh(2 * float(np.hypot(self.x.reach, self.y.reach)) / narrow)
        t, weight = panel_rule(np.linspace(-end, end, _ACROSS_PANELS + 1), 4)
        sideways = narrow * np.sinh(t) + ridge * towards[:, None]
        values = self(towards[:, None] * cos - sideways * sin, towards[:, None] * sin + sideways * cos)
        return towards, values @ (narrow * np.cosh(t) * weight)


def _axis_rule(axis: SlopeAxis, panels: int) -> tuple[Array, Array]:
    t, weight = panel_rule(np.linspace(-axis.end, axis.end, panels + 1), 4)
    return axis.scale * np.sinh(t), axis.scale * np.cosh(t) * weight


def smith_lambda(density: PlanarDensity) -> xr.DataArray:
    """Λ(θ, φ) of a planar density: the mean excess slope of every azimuth's marginal, over cot θ."""
    from scipy.interpolate import CubicSpline

    half = AZIMUTHS[AZIMUTHS < 180]
    scale, reach = max(density.x.scale, density.y.scale), float(np.hypot(density.x.reach, density.y.reach))
    mu = SlopeAxis(scale, reach, 2 * _TOWARDS - 1).nodes[_TOWARDS:-1][::-1]
    excess = {}
    for azimuth in half:
        towards, values = density.marginal(float(azimuth))
        for sign, slope, marginal in ((0, towards, values), (180, -towards[::-1], values[::-1])):
            first = CubicSpline(slope, marginal).antiderivative()
            moment = CubicSpline(slope, marginal * slope).antiderivative()
            at = np.clip(mu, slope[0], slope[-1])
            beyond = first(slope[-1]) - first(at)
            excess[azimuth + sign] = np.maximum(moment(slope[-1]) - moment(at) - at * beyond, 0.0)
    table = np.stack([excess[azimuth] for azimuth in AZIMUTHS], axis=1) / mu[:, None]
    return xr.DataArray(
        table, dims=("theta", "phi"), coords={"theta": np.degrees(np.arctan2(1.0, mu)), "phi": AZIMUTHS}
    )
