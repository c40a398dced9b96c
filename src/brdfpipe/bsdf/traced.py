"""The BSDF of a measured height map by tracing rays over it: a reference solution for models of the surface.

References
----------
Heitz, Hanika, d'Eon & Dachsbacher 2016 (ACM Trans. Graph. 35(4), 58) for the account of light by order of reflection; Torrance & Sparrow
1967 for the density of facets in the slope of the half vector.
"""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from brdfpipe import vocabulary
from brdfpipe.bsdf.microfacet.builder import index_on
from brdfpipe.bsdf.microfacet.model import mean_index
from brdfpipe.bsdf.representations.traced import Traced, TracedTable, masking_over_cosines
from brdfpipe.bsdf.spectrum_closure import around_mirror_direction, with_base
from brdfpipe.facets.height_quantisation import height_step
from brdfpipe.geometry import Array, HalfVector
from brdfpipe.optics.fresnel_equations import fresnel, mean_fresnel
from brdfpipe.optics.index import refractive_index
from brdfpipe.references.height_mesh import HeightMapError, HeightMesh
from brdfpipe.references.tracer import SlopeBins, TracedLight, trace

INCIDENCES = np.array([0, 10, 20, 30, 40, 50, 60, 65, 70, 75, 80, 84, 88.0])
"""Angles of incidence that are traced [degree]."""
LAY_LIMIT = 1.2
"""Ratio of the principal slopes above which the mean over azimuth is reported as such."""
STEP_LIMIT = 0.1
"""Slope of one step of quantised heights, over the typical slope, above which the result warns."""
LOST_LIMIT = 0.01
"""Lost light, over reflected and lost light, above which the result warns."""

_POINTS = 5  # along each axis of a bin, over which its factors are averaged
_LEAST_SHARE = 0.4  # of a bin above the horizon, for its light to give a density
_CORRECTIONS = 2  # of the densities, so that their interpolation returns the light of every bin


def build(
    surface: xr.Dataset,
    *,
    index: xr.Dataset | float | str,
    spectrum: xr.Dataset | None = None,
    rays: int = 10**6,
    seed: int = 0,
    edges: str = "mirrored",
    threads: int = 1,
) -> xr.Dataset:
    """BSDF of a height map, by tracing rays over it with every bounce.

    Parameters
    ----------
    surface : kind ``surface``, a levelled map
    index, spectrum : as for :func:`brdfpipe.bsdf.microfacet.build`
    rays : number of rays of each of the 13 incidences
    seed : of the positions of the rays
    edges : one of :data:`brdfpipe.references.height_mesh.EDGES`
    threads : does not change the result

    Returns
    -------
    Dataset of kind ``bsdf``, representation ``traced``, with its statistical uncertainty; reciprocal, and the mean over the azimuth of
    incidence. ``reflected(order, traced_incidence)``, ``refracted`` and ``lost`` account for the light

    Raises
    ------
    HeightMapError : a line profile, or a map, index or number of rays that cannot be used.
    VocabularyError : a dataset of the wrong kind.

    Notes
    -----
    Geometric optics on the triangles of the map: no diffraction, no light that returns from the body to another facet. The index of the
    tracing is the mean over wavelength; at each wavelength a single reflection has its own Fresnel reflectance, and light reflected more
    than once is in addition scaled with the mean reflectance of a facet.
    """
    mesh = HeightMesh.of(surface, edges)
    slope = mesh.typical_slope
    if not slope > 0:
        raise HeightMapError("the surface is perfectly flat; use `brdfpipe.facets.flat` and the facet model")
    index = vocabulary.validate(index, "index") if isinstance(index, xr.Dataset) else refractive_index(index)
    if spectrum is not None:
        vocabulary.validate(spectrum, "spectrum")
    n, k, wavelength, warnings = index_on(index, None if spectrum is None else spectrum["wavelength"].values)
    spectral = () if n.ndim == 0 else ("wavelength",)
    bsdf = xr.Dataset(
        {"n": (spectral, n), "k": (spectral, k)}, {} if wavelength is None else {"wavelength": wavelength}
    )
    weight = np.full(n.size, 1 / n.size)
    traced_n, traced_k = mean_index(bsdf, weight) if spectral else (float(n), float(k))
    bins = SlopeBins.of(slope)
    light = [
        trace(mesh, theta, index=complex(traced_n, traced_k), bins=bins, rays=rays, seed=seed, threads=threads)
        for theta in INCIDENCES
    ]
    bsdf = bsdf.assign(_densities(light, bins, slope, traced_n, traced_k)).assign(_account(light))
    bsdf = bsdf.assign(
        smith_slope=slope,
        slope_scale=bins.width,
        traced_reflectance=float(mean_fresnel(np.array([traced_n]), np.array([traced_k]))[0]),
    )
    bsdf = bsdf.assign_coords(
        traced_incidence=INCIDENCES, half_slope_across=bins.centres[bins.half :], half_slope_along=bins.centres
    )
    bsdf.attrs = {
        "representation": Traced.name,
        "rays": rays,
        "seed": seed,
        "edges": edges,
        "band": surface.attrs["band"],
    }
    table = TracedTable.of(bsdf)
    colour = table.colour(np.atleast_1d(n), np.atleast_1d(k))

    def reflectance(theta_i: float, half_angle: float = 180.0) -> Array:
        at = min(theta_i, 89.99)
        return around_mirror_direction(
            lambda i, azimuth_i, o, azimuth_o: table.brdf(i, azimuth_i, o, azimuth_o, colour), at, slope, half_angle
        )

    bsdf = with_base(
        bsdf, lambda theta: np.stack([reflectance(float(angle)) for angle in theta]), spectrum, reflectance
    )
    return vocabulary.label(vocabulary.add_warning(bsdf, *warnings, *_warnings(bsdf, mesh)), "bsdf")


def _account(light: list[TracedLight]) -> dict[str, tuple[tuple[str, ...], Array]]:
    by_order = ("order", "traced_incidence")
    return {
        "reflected": (by_order, np.stack([part.reflected.mean(axis=-1) for part in light], axis=-1)),
        "reflected_u": (by_order, np.stack([part.reflected_u for part in light], axis=-1)),
        "refracted": (by_order, np.stack([part.refracted.mean(axis=-1) for part in light], axis=-1)),
        "lost": (by_order[1:], np.array([part.lost.mean() for part in light])),
    }


def _densities(
    light: list[TracedLight], bins: SlopeBins, slope: float, n: float, k: float
) -> dict[str, tuple[tuple[str, ...], Array]]:
    """Densities T of light reflected once and more often, and their uncertainties, at the centres of the bins."""
    fields: dict[str, list[Array]] = {}
    for theta, part in zip(INCIDENCES, light, strict=True):
        factors = _factors(theta, bins, slope, n, k)
        by_bin = factors.sum(axis=(1, 3))
        known = np.mean(factors > 0, axis=(1, 3)) >= _LEAST_SHARE
        unpolarised = part.power.mean(axis=1)[:, bins.half :]
        for row, (name, power) in enumerate(
            (("single_density", unpolarised[0]), ("multiple_density", unpolarised[1:].sum(axis=0)))
        ):
            fields.setdefault(name, []).append(_interpolable(power, factors, known))
            relative = np.where(known, part.uncertainty[row, bins.half :] / np.where(known, by_bin, 1.0), 0.0)
            fields.setdefault(f"{name}_u", []).append(_extended(relative, known))
    dims = ("traced_incidence", "half_slope_across", "half_slope_along")
    return {name: (dims, np.stack(values)) for name, values in fields.items()}


def _factors(theta_i: float, bins: SlopeBins, slope: float, n: float, k: float) -> Array:
    """∫ F G cos ζ / (cos θ_i cos α) dp dq over parts of the bins, (across, parts, along, parts): the light of density 1.

    Both signs of the slope across are in one bin.
    """
    offset = (np.arange(_POINTS) + 0.5) / _POINTS
    along = bins.step * (np.arange(-bins.half, bins.half)[:, None] + offset).ravel()
    p, area = bins.width * np.sinh(along), bins.width * np.cosh(along) * bins.step / _POINTS
    q, height = p[p.size // 2 :, None], 2 * area[p.size // 2 :, None]
    cos_i, sin_i = np.cos(np.radians(theta_i)), np.sin(np.radians(theta_i))
    square = p * p + q * q
    towards = cos_i - p * sin_i
    cos_o = 2 * towards / (1 + square) - cos_i
    above = (towards > 0) & (cos_o > 0)
    cos_o = np.where(above, cos_o, 1.0)
    cos_zeta = np.where(above, np.minimum(towards / np.sqrt(1 + square), 1.0), 1.0)
    pair = HalfVector(
        square, cos_zeta, np.full_like(cos_o, cos_i), np.full_like(cos_o, sin_i), cos_o, np.sqrt(1 - cos_o**2)
    )
    # f cos θ_o dω_o, with dω_o = 4 cos ζ cos³α dp dq.
    light = fresnel(cos_zeta, n, k).mean * masking_over_cosines(pair, slope) * cos_o * 4 * cos_zeta * pair.cos_alpha**3
    return np.where(above, light * area * height, 0.0).reshape(bins.half, _POINTS, 2 * bins.half, _POINTS)


def _interpolable(power: Array, factors: Array, known: NDArray[np.bool_]) -> Array:
    """Density at the centres whose linear interpolation has the given light in every bin."""
    by_bin = np.where(known, factors.sum(axis=(1, 3)), 1.0)
    mean = _extended(np.where(known, power / by_bin, 0.0), known)
    across, along = (_at_points(size) for size in power.shape)
    density = mean
    for _ in range(_CORRECTIONS):
        between = (across @ density @ along.T).reshape(factors.shape)
        found = np.einsum("apbq,apbq->ab", between, factors) / by_bin
        ratio = np.where(known & (found > 0), mean / np.where(found > 0, found, 1.0), 1.0)
        density = _extended(density * np.clip(ratio, 0.5, 2.0), known)
    # Noise of bins with few rays does not average out of the product: the sum of all light is set again.
    total = float(np.sum((across @ density @ along.T).reshape(factors.shape) * factors))
    return density * (float(power.sum()) / total) if total > 0 else density


def _at_points(bins: int) -> Array:
    """(bins · points, bins) matrix of the linear interpolation between the centres of bins, constant beyond the outermost."""
    points = (np.arange(bins)[:, None] + (np.arange(_POINTS) + 0.5) / _POINTS - 0.5).ravel()
    return np.stack([np.interp(points, np.arange(bins), unit) for unit in np.eye(bins)], axis=-1)


def _extended(values: Array, known: NDArray[np.bool_]) -> Array:
    """Values with those beyond the horizon, which no light reaches, taken from the nearest bin."""
    if known.all():
        return values
    nearest = distance_transform_edt(~known, return_distances=False, return_indices=True)
    return np.asarray(values[tuple(nearest)])


def quantisation(mesh: HeightMesh) -> str:
    """Warning of heights that are quantised so coarsely that rays meet the steps; empty where they are not."""
    step = height_step(mesh.height, (float(mesh.pitch[0]), float(mesh.pitch[1]))) / float(mesh.pitch.min())
    if step <= STEP_LIMIT * mesh.typical_slope:
        return ""
    return (
        f"the heights are quantised, and one step between neighbours is a slope of {step:.2g}, {step / mesh.typical_slope:.1g} of the "
        "typical one: the facets that are traced are those of the steps; export the heights with more digits"
    )


def _warnings(bsdf: xr.Dataset, mesh: HeightMesh) -> list[str]:
    warnings = []
    anisotropy = mesh.anisotropy
    if anisotropy > LAY_LIMIT:
        warnings.append(
            f"the principal slopes of the surface differ by a factor {anisotropy:.2f}, and the traced BSDF is the mean over the azimuth of "
            "incidence: it does not show the lay"
        )
    warnings += filter(None, [quantisation(mesh)])
    lost = float((bsdf["lost"] / (bsdf["lost"] + bsdf["reflected"].sum("order"))).max())
    if lost > LOST_LIMIT:
        warnings.append(
            f"{lost:.1%} of the reflected light was lost on missing heights or beyond the map; measure a larger area, or one with fewer "
            "missing heights"
        )
    return warnings
