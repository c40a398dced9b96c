"""What every way to a facet distribution ends with: the dataset, and its warnings."""

from __future__ import annotations

import numpy as np
import xarray as xr

from brdfpipe import masking, planar, vocabulary
from brdfpipe.density import RadialDensity
from brdfpipe.geometry import Array
from brdfpipe.planar import PlanarDensity, SlopeAxis

_ALPHA_NODES = 121
_PLANAR_NODES = 129


def radial_dataset(density: RadialDensity, slope_rms: float) -> xr.Dataset:
    """Density, D and Λ of an isotropic surface."""
    alpha = np.degrees(np.arctan(density.slope))
    return xr.Dataset(
        {
            "slope_density": ("slope", density.density),
            "D": ("alpha", density.density * (1 + density.slope**2) ** 2),
            "lambda_smith": masking.smith_lambda(density),
            "slope_rms": slope_rms,
        },
        coords={"slope": density.slope, "alpha": alpha},
    )


def planar_dataset(density: PlanarDensity, slope_rms: float) -> xr.Dataset:
    """Density, D and Λ of a surface with a lay."""
    reach = float(np.hypot(density.x.reach, density.y.reach))
    scale = float(np.sqrt(density.x.scale * density.y.scale))
    slope = SlopeAxis(scale, reach, 2 * _ALPHA_NODES - 1).nodes[_ALPHA_NODES - 1 :]
    # The facet normal leans away from the slope: β = atan2(−q, −p).
    beta = np.radians(planar.AZIMUTHS)
    polar = density(-slope[:, None] * np.cos(beta), -slope[:, None] * np.sin(beta))
    dataset = xr.Dataset(
        {
            "slope_density": (("slope_y", "slope_x"), density.density),
            "D": (("alpha", "beta"), polar * (1 + slope[:, None] ** 2) ** 2),
            "lambda_smith": planar.smith_lambda(density),
            "slope_rms": slope_rms,
        },
        coords={
            "slope_x": ("slope_x", density.x.nodes, {"scale": density.x.scale}),
            "slope_y": ("slope_y", density.y.nodes, {"scale": density.y.scale}),
            "alpha": np.degrees(np.arctan(slope)),
            "beta": planar.AZIMUTHS,
        },
    )
    return dataset


def planar_axes(scale_x: float, scale_y: float, reach: float, size: int = _PLANAR_NODES) -> tuple[SlopeAxis, SlopeAxis]:
    """Axes that reach ``reach`` scales along x and y."""
    return SlopeAxis(scale_x, scale_x * reach, size), SlopeAxis(scale_y, scale_y * reach, size)


def with_noise_warning(facets: xr.Dataset) -> xr.Dataset:
    """Warn where slopes over one pixel are much larger than over two."""
    ratio = float(facets["noise_ratio"])
    if ratio > 1.2:
        facets = vocabulary.add_warning(
            facets,
            f"the slope rms over one pixel is {ratio:.2f} times that over two: the scan is limited by noise or by its pitch; "
            "measure with more averaging, or at a finer pitch",
        )
    return facets


def positive(values: Array, floor: float = 1e-290) -> Array:
    """A density as a logarithm can take it: never zero, but at ``floor`` of its peak or less."""
    return np.maximum(values, floor * values.max())
