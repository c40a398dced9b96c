"""Named slope densities: facet distributions of given widths, and the named densities with the slopes of a facet distribution."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.facets.facet_dataset import planar_dataset, principal_ellipse, radial_dataset
from brdfpipe.facets.planar_density import PlanarDensity
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.facets.slope_histogram import FacetError
from brdfpipe.geometry import Array

_DENSITY: Mapping[str, Callable[[Array], Array]] = {
    "beckmann": lambda u: np.exp(-np.minimum(u, 690.0)) / np.pi,
    "ggx": lambda u: 1 / (np.pi * (1 + u) ** 2),
}
"""P22 of width 1 at a squared slope; above 1e-301, so that its logarithm is finite."""

DISTRIBUTIONS = tuple(_DENSITY)

_MEDIAN = {"beckmann": 0.6744897501960817 / math.sqrt(2), "ggx": 1 / math.sqrt(3)}
"""Median of |slope| towards one azimuth, of width 1; that of a Beckmann is a Gaussian of σ = 1/√2."""

_PLANAR_NODES = 257


def analytic(
    distribution: str,
    a: float | None = None,
    *,
    a_x: float | None = None,
    a_y: float | None = None,
    azimuth: float = 0.0,
) -> xr.Dataset:
    """Facet distribution of a named density.

    Parameters
    ----------
    distribution : ``beckmann``: P22 = exp(−s²/a²)/(πa²), whose slope rms is a/√2 per axis and a in all;
        ``ggx``: P22 = a²/[π(a² + s²)²], which has no finite slope rms
    a : width, 1e-6 to 10 [1]; or, for a surface with a lay, both
    a_x, a_y : widths along the azimuth and across it, 1e-6 to 10 [1], at most a factor of 100 apart
    azimuth : of the axis of ``a_x`` [degree]

    Raises
    ------
    FacetError : the distribution is unknown, a width is out of range, or both kinds of width are given.

    References
    ----------
    Beckmann & Spizzichino 1963; Walter 2007 (EGSR); Heitz 2014 for the anisotropic forms.
    """
    if distribution not in DISTRIBUTIONS:
        raise FacetError(f"unknown facet distribution {distribution!r}; accepted: {', '.join(DISTRIBUTIONS)}")
    widths = {name: width for name, width in (("a", a), ("a_x", a_x), ("a_y", a_y)) if width is not None}
    if set(widths) not in ({"a"}, {"a_x", "a_y"}):
        raise FacetError(f"{distribution} takes either a, or a_x and a_y")
    if not np.isfinite(azimuth):
        raise FacetError(f"the azimuth is {azimuth}; accepted: a finite angle in degree")
    for name, width in widths.items():
        if not 1e-6 <= width <= 10:
            raise FacetError(f"the width {name} of {distribution} is {width:g}; accepted: 1e-6 to 10")
    if "a" in widths:
        return _isotropic(distribution, **widths)
    return _anisotropic(distribution, **widths, azimuth=azimuth)


class EquivalentDensity(NamedTuple):
    """A named density that has a slope in common with a facet distribution."""

    distribution: str
    """One of :data:`DISTRIBUTIONS`."""
    matched: str
    """The slope in common: ``rms`` or ``median``."""
    widths: tuple[float, float]
    """Along the lay and across it; equal for an isotropic surface."""

    def section(self, slope: Array, axis: int = 0) -> Array:
        """P22 at slopes along the lay (axis 0) or across it (1), through zero slope."""
        return _DENSITY[self.distribution]((slope / self.widths[axis]) ** 2) / math.prod(self.widths)


def equivalent_densities(facets: xr.Dataset) -> tuple[EquivalentDensity, EquivalentDensity]:
    """The Beckmann of the same rms slope, or of the same median slope if no rms slope is known, and the GGX of the same median slope.

    ``facets`` is of kind ``facets``, isotropic or with a lay, and not flat.
    """
    slope_rms = float(facets.get("slope_rms", math.nan))
    matched = "rms" if math.isfinite(slope_rms) and slope_rms > 0 else "median"
    if facets["slope_density"].dims == ("slope",):
        median = RadialDensity.of(facets).median_slope
        a = slope_rms if matched == "rms" else median / math.sqrt(math.log(2))
        return EquivalentDensity("beckmann", matched, (a, a)), EquivalentDensity("ggx", "median", (median, median))
    density = PlanarDensity.of(facets)
    azimuths = (density.azimuth, density.azimuth + 90)
    medians = np.array([density.median_slope(azimuth) for azimuth in azimuths])
    widths = density.rms_slope(azimuths) * math.sqrt(2) if matched == "rms" else medians / _MEDIAN["beckmann"]
    beckmann, ggx = ((float(along), float(across)) for along, across in (widths, medians / _MEDIAN["ggx"]))
    return EquivalentDensity("beckmann", matched, beckmann), EquivalentDensity("ggx", "median", ggx)


def flat() -> xr.Dataset:
    """Facet distribution of a perfectly flat surface: all facets are level, which no density can describe.

    Returns
    -------
    Dataset of kind ``facets`` with ``slope_rms`` 0, and a density without nodes
    """
    empty = np.zeros(0)
    facets = xr.Dataset(
        {
            "slope_density": ("slope", empty),
            "D": ("alpha", empty),
            "lambda_smith": ("theta", empty),
            "slope_rms": 0.0,
        },
        coords={"slope": empty, "alpha": empty, "theta": empty},
    )
    return _labelled(facets, "perfectly flat")


def _labelled(facets: xr.Dataset, method: str) -> xr.Dataset:
    facets.attrs |= {"method": method, "band": "none: not measured"}
    return vocabulary.label(facets, "facets")


def _isotropic(distribution: str, a: float) -> xr.Dataset:
    if distribution == "beckmann":
        # Beyond 8.3 a the density is 1e-30 of its peak: less than rounding in every integral.
        slope = a * np.sinh(np.linspace(0, np.arcsinh(8.3), 512))
        density, slope_rms = np.exp(-((slope / a) ** 2)) / (np.pi * a**2), a
    else:
        # The tail decides the masking at grazing: 1e7 a leaves out 2e-7 of the mean slope.
        slope = a * np.sinh(np.linspace(0, np.arcsinh(1e7), 1024))
        density, slope_rms = 1 / (np.pi * a**2 * (1 + (slope / a) ** 2) ** 2), np.nan
    return _labelled(radial_dataset(RadialDensity(slope, density), slope_rms), f"analytic {distribution}, a = {a:g}")


def _anisotropic(distribution: str, a_x: float, a_y: float, azimuth: float) -> xr.Dataset:
    if not 0.01 <= a_x / a_y <= 100:
        raise FacetError(f"a_x / a_y is {a_x / a_y:g}; accepted: 0.01 to 100")
    ellipse = principal_ellipse(a_x, a_y, azimuth)
    if distribution == "beckmann":
        planar = PlanarDensity.elliptic(_DENSITY[distribution], ellipse, 8.3, _PLANAR_NODES)
        slope_rms = float(np.hypot(a_x, a_y) / np.sqrt(2))
    else:
        # As for the isotropic one: a grid that ends at 1e6 a leaves out 1e-6 of the mean slope.
        planar = PlanarDensity.elliptic(_DENSITY[distribution], ellipse, 1e6, _PLANAR_NODES)
        slope_rms = np.nan
    method = f"analytic {distribution}, a_x = {a_x:g}, a_y = {a_y:g}, azimuth {azimuth:g}°"
    return _labelled(planar_dataset(planar, slope_rms), method)
