"""Facet distributions of named densities, for tests and for materials known by a roughness figure alone."""

from __future__ import annotations

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.density import RadialDensity
from brdfpipe.facets.assembly import planar_dataset, positive, radial_dataset
from brdfpipe.facets.counting import FacetError
from brdfpipe.planar import PlanarDensity, SlopeAxis

DISTRIBUTIONS = ("beckmann", "ggx")

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
    if (a is None) != (a_x is not None and a_y is not None) or (a is not None and (a_x is not None or a_y is not None)):
        raise FacetError(f"{distribution} takes either a, or a_x and a_y")
    if not np.isfinite(azimuth):
        raise FacetError(f"the azimuth is {azimuth}; accepted: a finite angle in degree")
    for name, width in (("a", a), ("a_x", a_x), ("a_y", a_y)):
        if width is not None and not 1e-6 <= width <= 10:
            raise FacetError(f"the width {name} of {distribution} is {width:g}; accepted: 1e-6 to 10")
    if a is not None:
        return _isotropic(distribution, a)
    assert a_x is not None
    assert a_y is not None
    return _anisotropic(distribution, a_x, a_y, azimuth)


def _isotropic(distribution: str, a: float) -> xr.Dataset:
    if distribution == "beckmann":
        # Beyond 8.3 a the density is 1e-30 of its peak: less than rounding in every integral.
        slope = a * np.sinh(np.linspace(0, np.arcsinh(8.3), 512))
        density, slope_rms = np.exp(-((slope / a) ** 2)) / (np.pi * a**2), a
    else:
        # The tail decides the masking at grazing: 1e7 a leaves out 2e-7 of the mean slope.
        slope = a * np.sinh(np.linspace(0, np.arcsinh(1e7), 1024))
        density, slope_rms = 1 / (np.pi * a**2 * (1 + (slope / a) ** 2) ** 2), np.nan
    facets = radial_dataset(RadialDensity(slope, density), slope_rms)
    facets.attrs |= {"method": f"analytic {distribution}, a = {a:g}", "band": "none: not measured"}
    return vocabulary.label(facets, "facets")


def _anisotropic(distribution: str, a_x: float, a_y: float, azimuth: float) -> xr.Dataset:
    if not 0.01 <= a_x / a_y <= 100:
        raise FacetError(f"a_x / a_y is {a_x / a_y:g}; accepted: 0.01 to 100")
    cos, sin = np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth))
    reach = 8.3 if distribution == "beckmann" else 3e4
    along_x, along_y = np.hypot(a_x * cos, a_y * sin), np.hypot(a_x * sin, a_y * cos)
    # Off the axes an ellipse is narrower than its shadow on them: more nodes keep its ridge.
    skew = along_x * along_y / (a_x * a_y)
    size = 1 + 2 * int(np.ceil((_PLANAR_NODES // 2) * min(skew, 4.0)))
    x, y = SlopeAxis(along_x, along_x * reach, size), SlopeAxis(along_y, along_y * reach, size)
    p, q = np.meshgrid(x.nodes, y.nodes)
    u = ((p * cos + q * sin) / a_x) ** 2 + ((q * cos - p * sin) / a_y) ** 2
    if distribution == "beckmann":
        density, slope_rms = np.exp(-np.minimum(u, 640.0)) / (np.pi * a_x * a_y), np.hypot(a_x, a_y) / np.sqrt(2)
    else:
        density, slope_rms = 1 / (np.pi * a_x * a_y * (1 + u) ** 2), np.nan
    planar = PlanarDensity(x, y, positive(density))
    mass = planar.moments[0]
    if abs(mass - 1) > 1e-5:
        raise FacetError(
            f"an ellipse of a_x / a_y = {a_x / a_y:g} at azimuth {azimuth:g}° is too narrow for a grid along x and y "
            f"(its mass comes out as {mass:.6f}); turn it nearer to an axis, or make it rounder"
        )
    facets = planar_dataset(planar, float(slope_rms))
    rough_along = a_x >= a_y
    facets = facets.assign(anisotropy=max(a_x / a_y, a_y / a_x), lay=(azimuth + 90 * rough_along + 90) % 180 - 90)
    facets.attrs |= {
        "method": f"analytic {distribution}, a_x = {a_x:g}, a_y = {a_y:g}, azimuth {azimuth:g}°",
        "band": "none: not measured",
    }
    return vocabulary.label(facets, "facets")
