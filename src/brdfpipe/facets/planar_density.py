"""The slope density P22 of a surface with a lay, as a function, and its masking in every azimuth.

Slopes are given along the lay, where they are small, and across it. Divided by the two widths (:class:`Ellipse`), a density of
any anisotropy is nearly round; all computations use these scaled slopes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from brdfpipe.errors import VocabularyError
from brdfpipe.geometry import Array
from brdfpipe.hemisphere import panel_rule

_MASKING_TURNS = np.arange(0.0, 360.0, 5.0)
_MARGINAL_NODES = 513
_MASKING_STEP = 0.05
_SIDEWAYS_PANELS = 24


@dataclass(frozen=True)
class SlopeAxis:
    """Slopes from −reach to reach, uniform in asinh(slope/scale): dense about zero, sparse in the tails."""

    scale: float
    reach: float
    size: int

    @cached_property
    def end(self) -> float:
        """asinh(reach/scale)."""
        return float(np.arcsinh(self.reach / self.scale))

    @cached_property
    def nodes(self) -> Array:
        half = (self.size - 1) / 2
        nodes: Array = self.scale * np.sinh(np.arange(-half, half + 1) * (self.end / half))
        return nodes

    @property
    def borders(self) -> Array:
        """(size − 1,) slopes amid the nodes, in the uniform parameter."""
        half = (self.size - 1) / 2
        return np.asarray(self.scale * np.sinh(np.arange(0.5 - half, half) * (self.end / half)))

    def position(self, slope: ArrayLike) -> Array:
        """Fractional index of slopes on the nodes."""
        return np.asarray((np.arcsinh(np.asarray(slope) / self.scale) / self.end + 1) * (self.size - 1) / 2)

    @classmethod
    def of(cls, coordinate: xr.DataArray) -> SlopeAxis:
        """The axis of a dataset's coordinate, whose attribute ``scale`` it needs."""
        return cls(float(coordinate.attrs["scale"]), float(coordinate.values[-1]), coordinate.size)

    def rule(self, panels: int, order: int) -> tuple[Array, Array]:
        """Quadrature over the axis: slopes and weights."""
        t, weight = panel_rule(np.linspace(-self.end, self.end, panels + 1), order)
        return self.scale * np.sinh(t), self.scale * np.cosh(t) * weight


@dataclass(frozen=True)
class Ellipse:
    """Widths of the slopes along a lay and across it.

    Parameters
    ----------
    along, across : widths [1]; slopes over them, (x, y), are about round
    lay : azimuth of the first [degree]
    """

    along: float
    across: float
    lay: float

    @classmethod
    def of(cls, dataset: xr.Dataset) -> Ellipse:
        """The ellipse of a dataset with the coordinates ``slope_along`` and ``slope_across``, and the scalar ``lay``.

        Raises VocabularyError: the azimuth of the lay is missing.
        """
        if "lay" not in dataset or not np.isfinite(dataset["lay"]):
            raise VocabularyError(
                "a slope density with a lay needs the variable 'lay', its azimuth in degree; found none"
            )
        along, across = (float(dataset[name].attrs["scale"]) for name in ("slope_along", "slope_across"))
        return cls(along, across, float(dataset["lay"]))

    def towards(self, azimuth: ArrayLike) -> tuple[Array, Array]:
        """The slope towards an azimuth [degree] is w (x cos ω + y sin ω): width w, and turn ω [degree] in [0, 360)."""
        angle = np.radians(np.asarray(azimuth, dtype=float) - self.lay)
        x, y = self.along * np.cos(angle), self.across * np.sin(angle)
        return np.hypot(x, y), np.degrees(np.arctan2(y, x)) % 360

    def azimuths(self, turn: ArrayLike) -> Array:
        """Sorted azimuths in [0, 360) of turns ω."""
        turn = np.radians(np.asarray(turn, dtype=float))
        angle = np.degrees(np.arctan2(self.along * np.sin(turn), self.across * np.cos(turn)))
        # Rounded, so that 360 − 1e-14 is not listed beside 0.
        return np.sort(np.round(self.lay + angle, 9) % 360)


@dataclass(frozen=True)
class PlanarDensity:
    """Slope density on a grid of slopes along the lay and across it, evaluated between its nodes.

    Parameters
    ----------
    along, across : axes of the slope along the lay and across it, 90 degree counter-clockwise from there
    density : (across, along) positive [1]; zero beyond the grid
    azimuth : of the lay [degree]

    Notes
    -----
    log P22 is a tensor-product cubic spline in asinh(slope/scale).
    """

    along: SlopeAxis
    across: SlopeAxis
    density: Array
    azimuth: float

    @classmethod
    def of(cls, dataset: xr.Dataset) -> PlanarDensity:
        """The density of a dataset with a lay. Raises VocabularyError: the dataset has no ``lay``."""
        along, across = (SlopeAxis.of(dataset[name]) for name in ("slope_along", "slope_across"))
        density = dataset["slope_density"].transpose("slope_across", "slope_along").values
        return cls(along, across, density.astype(float), Ellipse.of(dataset).lay)

    @classmethod
    def elliptic(
        cls, radial: Callable[[Array], Array], ellipse: Ellipse, reach: float, size: int = 129
    ) -> PlanarDensity:
        """The density f(x² + y²) / (a b) of slopes x = p/a along the lay and y = q/b across it.

        Parameters
        ----------
        radial : f of a squared slope, of unit mass over the plane
        ellipse : a, b and the lay
        reach : of the grid, in widths
        size : nodes of each axis, odd
        """
        x = SlopeAxis(1.0, reach, size).nodes
        density = radial(x**2 + x[:, None] ** 2) / (ellipse.along * ellipse.across)
        along, across = (SlopeAxis(width, width * reach, size) for width in (ellipse.along, ellipse.across))
        return cls(along, across, density, ellipse.lay)

    def __call__(self, slope_x: ArrayLike, slope_y: ArrayLike) -> Array:
        """P22 at slopes (p, q) along x and y, broadcast."""
        cos, sin = np.cos(np.radians(self.azimuth)), np.sin(np.radians(self.azimuth))
        p, q = np.asarray(slope_x, dtype=float), np.asarray(slope_y, dtype=float)
        return self.principal(p * cos + q * sin, q * cos - p * sin)

    def principal(self, along: ArrayLike, across: ArrayLike) -> Array:
        """P22 at slopes along the lay and across it, broadcast."""
        from scipy.ndimage import map_coordinates

        position = np.array(np.broadcast_arrays(self.across.position(across), self.along.position(along)))
        flat = position.reshape(2, -1)
        values = map_coordinates(self.log_coefficients, flat, order=3, prefilter=False, cval=-np.inf)
        return np.asarray(np.exp(values).reshape(position.shape[1:]))

    @cached_property
    def log_coefficients(self) -> Array:
        from scipy.ndimage import spline_filter

        return np.asarray(spline_filter(np.log(self.density), order=3, mode="mirror"))

    @property
    def ellipse(self) -> Ellipse:
        """Widths of the two axes, and the lay."""
        return Ellipse(self.along.scale, self.across.scale, self.azimuth)

    def rule(self, panels: int = 48, order: int = 4) -> tuple[Array, Array, Array]:
        """Quadrature over the slope plane: p, q along x and y, and probability weights, Σ w h(p, q) = E[h]."""
        a, b, weight = self.principal_rule(panels, order)
        cos, sin = np.cos(np.radians(self.azimuth)), np.sin(np.radians(self.azimuth))
        return a * cos - b * sin, a * sin + b * cos, weight

    def principal_rule(self, panels: int = 48, order: int = 4) -> tuple[Array, Array, Array]:
        """The same quadrature, with slopes along the lay (n,) and across it (n, 1), and weights (n, n)."""
        (a, weight_a), (b, weight_b) = self.along.rule(panels, order), self.across.rule(panels, order)
        return a, b[:, None], self.principal(a, b[:, None]) * weight_b[:, None] * weight_a

    @cached_property
    def moments(self) -> tuple[float, Array, Array]:
        """Mass, mean (2,) and covariance (2, 2) of the slopes along x and y."""
        p, q, weight = self.rule()
        mass = float(weight.sum())
        slopes = np.stack([p.ravel(), q.ravel()])
        mean = slopes @ weight.ravel() / mass
        centred = slopes - mean[:, None]
        return mass, mean, (centred * weight.ravel()) @ centred.T / mass

    @property
    def reach(self) -> float:
        """Distance of the corners of the grid from its centre, in widths."""
        return float(np.hypot(self.along.reach / self.along.scale, self.across.reach / self.across.scale))

    def marginal(self, azimuth: float) -> tuple[Array, Array]:
        """Density P1 of the slope towards an azimuth [degree]: slopes (n,) and values (n,), integrated across."""
        width, turn = self.ellipse.towards(azimuth)
        slope = SlopeAxis(1.0, self.reach, _MARGINAL_NODES).nodes
        return width * slope, self._marginal_density(slope, turn) / width

    def rms_slope(self, azimuth: ArrayLike) -> Array:
        """Root mean square slope about zero towards azimuths (n,) [degree]."""
        _, mean, covariance = self.moments
        towards = np.stack([np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth))])
        second = covariance + np.outer(mean, mean)
        return np.asarray(np.sqrt(np.einsum("ik,ij,jk->k", towards, second, towards)))

    def mean_slope(self, azimuth: Array) -> Array:
        """Mean |slope| towards azimuths (n,) [degree]; finite for some densities whose rms slope is not."""
        p, q, weight = self.rule()
        means = [np.sum(weight * np.abs(p * np.cos(angle) + q * np.sin(angle))) for angle in np.radians(azimuth)]
        return np.array(means) / weight.sum()

    def median_slope(self, azimuth: float) -> float:
        """Median |slope| towards an azimuth [degree]."""
        slope, values = self.marginal(azimuth)
        below = np.r_[0.0, np.cumsum(np.diff(slope) * (values[1:] + values[:-1]) / 2)]
        positive = slope[slope > 0]
        within = np.interp(positive, slope, below) - np.interp(-positive, slope, below)
        return float(np.interp(0.5 * below[-1], within, positive))

    def _marginal_density(self, slope: Array, turn: Array) -> Array:
        """Density of x cos ω + y sin ω at ``slope``, where x and y are slopes over their widths, integrated across."""
        cos, sin = np.cos(np.radians(turn)), np.sin(np.radians(turn))
        sideways, weight = SlopeAxis(1.0, self.reach, 3).rule(_SIDEWAYS_PANELS, 4)
        x, y = slope[:, None] * cos - sideways * sin, slope[:, None] * sin + sideways * cos
        values = self.principal(self.along.scale * x, self.across.scale * y)
        return np.asarray(values @ weight * (self.along.scale * self.across.scale))


def smith_lambda(density: PlanarDensity, turns: Array | None = None) -> xr.DataArray:
    """Λ(θ, φ) of a planar density: the mean excess slope of every azimuth's marginal, over cot θ; ``turns`` are other turns ω [degree].

    Azimuths are evenly spaced in the turn ω of the scaled slopes, which resolves the narrow sector along the lay.
    """
    ellipse = density.ellipse
    phi = ellipse.azimuths(_MASKING_TURNS if turns is None else turns)
    steepest = max(ellipse.along, ellipse.across) * density.reach
    scale = min(ellipse.along, ellipse.across)
    end = float(np.arcsinh(steepest / scale))
    # Not closer to grazing: there a polar angle in degree does not resolve cot θ.
    edges = scale * np.sinh(np.linspace(0, end, int(np.ceil(end / _MASKING_STEP)) + 1))[1:]
    table = np.stack([_excess_slope(density, edges, azimuth) for azimuth in phi], axis=1) / edges[:-1, None]
    theta = np.degrees(np.arctan2(1.0, edges[:-1]))
    return xr.DataArray(table[::-1], dims=("theta", "phi"), coords={"theta": theta[::-1], "phi": phi})


def _excess_slope(density: PlanarDensity, edges: Array, azimuth: float) -> Array:
    """g(μ) = E[(p̃ − μ)⁺] of the slope p̃ towards an azimuth, at every edge but the last, beyond which there is none."""
    width, turn = density.ellipse.towards(azimuth)
    edges = edges / width
    slope, weight = panel_rule(edges, 2)
    share = (density._marginal_density(slope, turn) * weight).reshape(-1, 2)
    above = share.sum(axis=1)
    within = (share * (slope.reshape(-1, 2) - edges[:-1, None])).sum(axis=1)
    # Summed from the tail inwards all terms are positive: g is monotonic, without cancellation.
    steeper = np.cumsum(above[::-1])[::-1] - above
    rest = steeper * np.diff(edges)
    return np.asarray(width * np.cumsum((within + rest)[::-1])[::-1])
