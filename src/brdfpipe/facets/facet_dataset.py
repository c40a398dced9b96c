"""Datasets of kind ``facets`` from slope densities, with the warnings that all estimates share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import vocabulary
from brdfpipe.facets import planar_density as planar
from brdfpipe.facets.planar_density import Ellipse, PlanarDensity, SlopeAxis
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.geometry import Array
from brdfpipe.masking.smith import smith_lambda

_ALPHA_NODES = 121


def radial_dataset(density: RadialDensity, slope_rms: float) -> xr.Dataset:
    """Density, D and Λ of an isotropic surface."""
    alpha = np.degrees(np.arctan(density.slope))
    return xr.Dataset(
        {
            "slope_density": ("slope", density.density),
            "D": ("alpha", density.density * (1 + density.slope**2) ** 2),
            "lambda_smith": smith_lambda(density),
            "slope_rms": slope_rms,
        },
        coords={"slope": density.slope, "alpha": alpha},
    )


def planar_dataset(density: PlanarDensity, slope_rms: float) -> xr.Dataset:
    """Density, D, Λ and lay of an anisotropic surface."""
    ellipse, nodes = density.ellipse, 2 * _ALPHA_NODES - 1
    scale = float(np.sqrt(ellipse.along * ellipse.across))
    steepest = float(np.hypot(density.along.reach, density.across.reach))
    slope = SlopeAxis(scale, steepest, nodes).nodes[_ALPHA_NODES - 1 :]
    lambda_smith = planar.smith_lambda(density)
    # Masking varies fast about the lay, D about the perpendicular, where a narrow ellipse is long.
    azimuth = np.sort((lambda_smith["phi"].values + 90) % 360)
    beta = np.radians(azimuth)
    # The facet normal leans away from the slope: β = atan2(−q, −p).
    polar = density(-slope[:, None] * np.cos(beta), -slope[:, None] * np.sin(beta))
    return xr.Dataset(
        {
            "slope_density": (("slope_across", "slope_along"), density.density),
            "D": (("alpha", "beta"), polar * (1 + slope[:, None] ** 2) ** 2),
            "lambda_smith": lambda_smith,
            "slope_rms": slope_rms,
            "anisotropy": ellipse.across / ellipse.along,
            "lay": density.azimuth,
        },
        coords={
            "slope_along": ("slope_along", density.along.nodes, {"scale": density.along.scale}),
            "slope_across": ("slope_across", density.across.nodes, {"scale": density.across.scale}),
            "alpha": np.degrees(np.arctan(slope)),
            "beta": azimuth,
        },
    )


def principal_ellipse(first: float, second: float, azimuth: float) -> Ellipse:
    """The ellipse of two widths, towards an azimuth [degree] and across it: its lay runs along the smaller, in [0, 180)."""
    turned = 90 if first > second else 0
    # Rounded, so that 29.8 is not written as 29.80000000000001.
    return Ellipse(min(first, second), max(first, second), round((azimuth + turned) % 180, 9) % 180)


NOISE_ADVICE = (
    "state it (`surface.noise`), smooth the heights (`surface.lambda_s`), or average scans of the same place: a finer pitch makes the slopes of white "
    "noise larger"
)


def noise_warning(facets: xr.Dataset) -> list[str]:
    """A warning if the slope rms over one pixel is much larger than over two."""
    ratio = float(facets["noise_ratio"])
    if not ratio > 1.2:
        return []
    return [
        f"the slope rms over one pixel is {ratio:.2f} times that over two: the scan is limited by noise or by its pitch. "
        f"If it is noise, {NOISE_ADVICE}; if it is finer roughness, measure with a finer pitch"
    ]


def quality_flags(measured: NDArray[np.bool_]) -> NDArray[np.int8]:
    """Quality flag of each density value: ``measured`` or ``extrapolated``."""
    return np.where(measured, vocabulary.quality("measured"), vocabulary.quality("extrapolated")).astype(np.int8)


def azimuthal_average(facets: xr.Dataset) -> xr.Dataset:
    """Average a facet distribution with a lay over azimuth.

    Parameters
    ----------
    facets : kind ``facets``; an isotropic one is returned unchanged

    Returns
    -------
    Dataset of kind ``facets``, with a warning that says what was averaged
    """
    vocabulary.validate(facets, "facets")
    if "slope" in facets.dims:
        return facets
    planar = PlanarDensity.of(facets)
    density = radial_average(planar)
    radial = radial_dataset(density, float(facets["slope_rms"]))
    if "slope_density_change" in facets:
        changed = (replace(planar, density=planar.density + one) for one in facets["slope_density_change"].values)
        on_nodes = (radial_average(one)(density.slope**2) for one in changed)
        changes = ("uncertain_change", "slope"), np.array([one - density.density for one in on_nodes])
        radial = radial.assign(slope_density_change=changes).assign_coords(
            uncertainty_source=("uncertain_change", facets["uncertainty_source"].values)
        )
    radial.attrs = {name: facets.attrs[name] for name in ("method", "band")}
    radial = vocabulary.add_warning(
        radial,
        f"the surface has a lay (anisotropy {float(facets['anisotropy']):.2f}, along {float(facets['lay']) % 180:.0f}°) and the "
        "reflection model is isotropic: its density was averaged over azimuth; set `surface.isotropic: true` to confirm",
    )
    return vocabulary.label(radial, "facets")


def radial_average(planar: PlanarDensity) -> RadialDensity:
    """The density averaged over azimuth."""
    steepest = float(np.hypot(planar.along.reach, planar.across.reach))
    slope = SlopeAxis(planar.along.scale / 2, steepest, 1023).nodes[511:]
    average = _ring_means(planar, slope)
    return RadialDensity(slope[average > 0], average[average > 0]).normalised()


def _ring_means(planar: PlanarDensity, slope: Array) -> Array:
    """Mean of the density around rings of given slopes."""
    # Small slopes vary along the lay, large ones across it: points are denser across, half as much as on the ellipse.
    turn = np.linspace(0, 2 * np.pi, 1440, endpoint=False)
    x, y = np.sqrt(planar.along.scale) * np.cos(turn), np.sqrt(planar.across.scale) * np.sin(turn)
    square = x**2 + y**2
    weight = 1 / square / np.sum(1 / square)
    radius = slope[:, None] / np.sqrt(square)
    return np.asarray(planar.principal(radius * x, radius * y) @ weight)
