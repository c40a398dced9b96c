"""Choice of the light that is reflected more than once: traced on the height map, where there is enough of it."""

from __future__ import annotations

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.bsdf.microfacet.builder import index_on, smith_choice
from brdfpipe.bsdf.microfacet.energy import directional_albedo, mirror_albedo
from brdfpipe.bsdf.microfacet.microsurface import Microsurface
from brdfpipe.bsdf.microfacet.model import without_lay
from brdfpipe.bsdf.microfacet.second_reflection import JUDGED, LEAST_SHARE, NODES, largest_share, with_second_reflection
from brdfpipe.bsdf.microfacet.traced_reflections import RAYS, count_light, trace_reflections
from brdfpipe.geometry import Array
from brdfpipe.optics.index import refractive_index
from brdfpipe.references.height_mesh import NOISE_LIMIT, HeightMapError, HeightMesh

TRIAL_RAYS = 2**13
"""Rays of each incidence that decides whether the light is traced."""
LEAST_MISSING = 0.002
"""Light that the single reflection of Smith's mirrors lacks at 75°, below which no ray is traced: the share of a map may be five times it."""


def choose(
    surface: xr.Dataset,
    facets: xr.Dataset,
    *,
    index: xr.Dataset | float | str,
    spectrum: xr.Dataset | None = None,
    multiple_scattering: str = "auto",
    rays: int = RAYS,
    seed: int = 0,
    nodes: tuple[int, int] = NODES,
) -> xr.Dataset:
    """Light that a height map reflects more than once, where it is more than 1 % of the reflected light.

    Parameters
    ----------
    surface : kind ``surface``, a levelled map or line
    facets : kind ``facets``, estimated from that surface
    index, spectrum : as for :func:`brdfpipe.bsdf.microfacet.build`
    multiple_scattering : ``auto``, or ``measured`` to trace the light in any case
    rays : of each of the 12 incidences
    seed : of the positions of the rays
    nodes : of the table of an isotropic surface (:func:`brdfpipe.bsdf.microfacet.traced_reflections.trace_reflections`)

    Returns
    -------
    Dataset of kind ``interreflection``. The attribute ``multiple_scattering`` is ``measured``, ``directional`` or ``none``, and ``reason``
    says why. With ``measured``: the table ``second_reflection`` of the light (docs/model.md), its relative uncertainty
    ``second_reflection_u``, and ``second_share(theta_i)``, the light over the incident light, mean over wavelength, with ``_u``: both are
    the scatter between 64 blocks of the map

    Raises
    ------
    HeightMapError : ``measured`` on a line, on too few heights, or on heights whose slopes are noise to more than 5 %.
    VocabularyError : a dataset of the wrong kind.

    Notes
    -----
    Judged at 60 and 75° and at the wavelength with the largest share. Of a line, or a map whose slopes are noise, Smith's surface decides.
    """
    vocabulary.validate(surface, "surface")
    vocabulary.validate(facets, "facets")
    index = vocabulary.validate(index, "index") if isinstance(index, xr.Dataset) else refractive_index(index)
    n, k, wavelength, _ = index_on(index, None if spectrum is None else spectrum["wavelength"].values)
    if facets["slope_density"].size == 0:
        return _labelled("none", "the surface is flat")
    lay, pairs = facets["slope_density"].ndim == 2, (np.atleast_1d(n), np.atleast_1d(k))
    smith = without_lay(Microsurface.of(facets))
    always = multiple_scattering == "measured"
    missing = 1 - mirror_albedo(smith, "height-correlated", JUDGED[-1:])[0]
    if missing < LEAST_MISSING and not always:
        return _labelled(
            "none",
            f"after Smith, perfect mirrors would reflect {missing:.2%} of the light more than once at {JUDGED[-1]:g}°",
        )
    try:
        mesh = _mesh(surface, facets)
    except HeightMapError as error:
        if always:
            raise
        mode, reason = smith_choice(smith, *pairs)
        return _labelled(mode, f"{reason}; no light was traced: {error}")
    share, theta = _share(mesh, smith, *pairs, seed)
    reason = f"the map reflects {share:.1%} of the light more than once at {theta:g}°"
    if share < LEAST_SHARE and not always:
        return _labelled("none", reason)
    traced = trace_reflections(mesh, smith, *pairs, lay=lay, rays=rays, seed=seed, nodes=nodes)
    spectral = () if n.ndim == 0 else ("wavelength",)
    result = xr.Dataset(
        {"n": (spectral, n), "k": (spectral, k)}, {} if wavelength is None else {"wavelength": wavelength}
    )
    if not spectral:
        result = result.drop_vars("wavelength", errors="ignore")
    result = with_second_reflection(result, traced.table)
    result = result.assign_coords(theta_i=traced.theta).assign(
        second_reflection_u=(("second_theta_i", "second_theta_o", "second_azimuth"), traced.relative_u),
        second_share=("theta_i", traced.share),
        second_share_u=("theta_i", traced.share_u),
    )
    result.attrs = {"rays": rays, "seed": seed}
    return _labelled("measured", reason, result)


def _labelled(mode: str, reason: str, result: xr.Dataset | None = None) -> xr.Dataset:
    result = xr.Dataset() if result is None else result
    return vocabulary.label(result.assign_attrs(multiple_scattering=mode, reason=reason), "interreflection")


def _mesh(surface: xr.Dataset, facets: xr.Dataset) -> HeightMesh:
    mesh = HeightMesh.of(surface)
    noise_share = mesh.noise_share(float(facets.get("noise_sigma", 0.0)))
    if noise_share > NOISE_LIMIT:
        raise HeightMapError(
            f"{noise_share:.0%} of the mean square slope is noise, which rays would meet; average scans of the same place, smooth the heights "
            "(`surface.lambda_s`), or set `model.multiple_scattering: directional`"
        )
    return mesh


def _share(mesh: HeightMesh, smith: Microsurface, n: Array, k: Array, seed: int) -> tuple[float, float]:
    """Largest share of the reflected light that a map reflects more than once, and its incidence."""
    pairs, where = np.unique(np.stack(np.broadcast_arrays(n, k)), axis=1, return_inverse=True)
    light = count_light(mesh, JUDGED, smith.typical_slope, pairs, TRIAL_RAYS, seed).by_direction.sum(axis=(1, 2))
    single = directional_albedo(smith, "height-correlated", n, k, JUDGED)
    return largest_share(light[:, 1:][:, where.ravel()], single)
