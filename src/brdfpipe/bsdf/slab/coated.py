"""A clear coat on an opaque body: lacquer over a coloured base, or a film on a plastic or metal.

The outer face of the coat reflects by its facets directly. Light that has been inside is summed over all reflections between that face
and the face of the base (:mod:`brdfpipe.bsdf.slab.adding_doubling`), apart for light that has been in the body below, of which one number
at each wavelength follows from the total reflectance (:mod:`brdfpipe.bsdf.slab.base`). Energy is conserved and the BRDF is reciprocal.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from brdfpipe import vocabulary
from brdfpipe.bsdf.microfacet.builder import index_on, wavelengths_of
from brdfpipe.bsdf.microfacet.microsurface import Microsurface, ModelError
from brdfpipe.bsdf.representations.coated import Coated
from brdfpipe.bsdf.representations.slab import TABLE_DIMS, depth_weights, lagrange
from brdfpipe.bsdf.slab import adding_doubling, base, face
from brdfpipe.bsdf.slab.adding_doubling import Sheet
from brdfpipe.bsdf.slab.builder import depth_nodes, internal_transmittance_of
from brdfpipe.bsdf.slab.face import Azimuths, Nodes
from brdfpipe.bsdf.slab.lobe_table import LobeGrid, barycentric
from brdfpipe.bsdf.slab.tabulation import Resolution, resolution, tabulate
from brdfpipe.facets.facet_dataset import azimuthal_average
from brdfpipe.geometry import Array
from brdfpipe.masking.modes import SMITH_MASKINGS
from brdfpipe.optics.index import refractive_index

_WAVELENGTH_NODES, _METAL_NODES = 5, 9
_ROUNDING = 1e-9
"""Share of the light below which there is none."""
ERROR_LIMIT = 0.02
"""Interpolation error above which a coated body has a warning [1]."""


class _Node(NamedTuple):
    """A coated body at one wavelength, by internal transmittance."""

    table: Array
    """(1, X, T, V, K)"""
    error: float
    reflected: Array
    """(T, N) share of the light that the faces reflect, the body apart, by internal transmittance"""
    specular: Array
    """(T, N) the specular part of it"""
    entering: Array
    """(T, N)"""
    returned: Array
    """(T,)"""
    strongest: Array
    """(T,)"""
    diffuse: Array
    """(N,) factor of the outer diffuse reflection"""
    correction: float


def build(
    coat: xr.Dataset,
    surface: xr.Dataset | None = None,
    *,
    coat_index: xr.Dataset | float | str,
    index: xr.Dataset | float | str,
    spectrum: xr.Dataset | None = None,
    internal_transmittance: float | xr.DataArray | None = None,
    absorption: float | xr.DataArray | None = None,
    thickness: float | None = None,
    masking: str = "height-correlated",
    wavelength: ArrayLike | None = None,
) -> xr.Dataset:
    """BSDF of an opaque body with a clear coat.

    Parameters
    ----------
    coat : kind ``facets``, the outer face of the coat; a perfectly smooth one is :func:`brdfpipe.facets.flat`. A lay is averaged over
        azimuth, with a warning
    surface : kind ``facets``, the face of the body below; smooth by default. Its shape is independent of that of the coat
    coat_index : kind ``index``, a number or a plastic's name; real
    index : the same of the body; a metal has k > 0
    spectrum : kind ``spectrum``, the total reflectance of the coated body, specular included (``sci``). The light scattered in the body
        follows from it. Without a spectrum, and of a metal, there is none
    internal_transmittance, absorption, thickness : of the coat, as of :func:`brdfpipe.bsdf.slab.build`
    masking : one of :data:`brdfpipe.masking.modes.SMITH_MASKINGS`
    wavelength : [nm], increasing, where neither spectrum, index nor transmittance sets them

    Returns
    -------
    Dataset of kind ``bsdf``, representation ``coated``

    Raises
    ------
    ModelError : an unknown masking, an absorbing coat, a metal with a spectrum, a spectrum without the specular part, or a transmittance,
        absorption or thickness out of range.
    VocabularyError : a dataset of the wrong kind.

    Notes
    -----
    Facets of the base lose light to one another; what a metal reflects of it is returned diffusely. Where the total reflectance is below
    that of the faces, the light of the body is set to 0, flagged, and a warning names the wavelengths; above that of a body that absorbs
    nothing likewise.
    """
    if masking not in SMITH_MASKINGS:
        raise ModelError(
            f"a coat needs one of Smith's maskings; found {masking!r}; accepted: {', '.join(SMITH_MASKINGS)}"
        )
    faces = [None if one is None else azimuthal_average(vocabulary.validate(one, "facets")) for one in (coat, surface)]
    surfaces = tuple(Microsurface.of(one) if one is not None and one["slope_density"].size else None for one in faces)
    known = [
        vocabulary.validate(one, "index") if isinstance(one, xr.Dataset) else refractive_index(one)
        for one in (coat_index, index)
    ]
    if np.any(known[0]["k"].values > 0):
        raise ModelError("the index of the coat absorbs; give a real index, and its absorption apart")
    metal = bool(np.any(known[1]["k"].values > 0))
    if spectrum is not None:
        vocabulary.validate(spectrum, "spectrum")
        if metal:
            raise ModelError("light does not come back from below the face of a metal; leave out the spectrum")
        if spectrum.attrs["geometry"] != "sci":
            raise ModelError(f"the spectrum of a coated body is {spectrum.attrs['geometry']!r}; accepted: sci")
    inside, of_transmittance = internal_transmittance_of(internal_transmittance, absorption, thickness)
    at = _wavelengths(spectrum, known, of_transmittance, wavelength)
    (n, _, _, warnings), (n_base, k_base, _, more) = (index_on(one, at) for one in known)
    warnings = [f"coat: {text}" for text in warnings] + [f"base: {text}" for text in more]
    inside = inside if of_transmittance is None else np.interp(at, of_transmittance, inside)
    n, n_base, k_base, inside = (
        np.broadcast_to(np.asarray(part, dtype=float), at.shape) for part in (n, n_base, k_base, inside)
    )
    constant = all(np.ptp(part) == 0 for part in (n, n_base, k_base))
    nodes = _nodes(at, 1 if constant else _METAL_NODES if metal else _WAVELENGTH_NODES)
    depth, transmittances = depth_nodes(inside), np.unique(inside)
    resolved = resolution((surfaces[0], surfaces[1]), float(n.min()), np.full(1, np.nan))
    grid = LobeGrid.of(float(np.degrees(resolved.scale)))
    found = []
    for nm in nodes:
        n_at, n_base_at, k_base_at = (float(np.interp(nm, at, part)) for part in (n, n_base, k_base))
        found.append(_at_node(surfaces, masking, n_at, n_base_at, k_base_at, depth, transmittances, resolved, grid))
    weights = _weights(nodes, at, depth, inside)
    outside = Nodes.of(float(n.min()), resolved.outside, resolved.beyond).outside
    error = max(one.error for one in found)
    bsdf = xr.Dataset(
        {
            "n": ("wavelength", n),
            "log_scattered": (TABLE_DIMS, np.concatenate([one.table for one in found], axis=-1)),
            "node_weight": (("wavelength", "node"), weights),
            "lobe_scale": grid.scale,
            "interpolation_error": error,
            "quadrature_error": max(one.correction for one in found),
        },
        coords={"theta_low": grid.low, "wavelength": at, "theta": outside},
        attrs={"representation": Coated.name, "masking": masking, "transmission": "none"},
    )
    bsdf = _with_fluxes(bsdf, found, np.searchsorted(transmittances, inside), nodes, spectrum)
    if faces[0] is not None and surfaces[0] is not None:
        bsdf = bsdf.assign_coords(front_slope=faces[0]["slope"].values, front_theta=faces[0]["theta"].values)
        bsdf["front_slope_density"] = ("front_slope", faces[0]["slope_density"].values)
        bsdf["front_lambda_smith"] = ("front_theta", faces[0]["lambda_smith"].values)
    for one, given in zip(faces, (coat, surface), strict=True):
        if one is not None and one is not given:
            warnings += [text for text in vocabulary.warnings(one) if text not in warnings]
    if error > ERROR_LIMIT:
        warnings.append(
            f"light that has been inside the coat is interpolated with an error of {error:.1%} of the flux at the worst incidence; "
            "integrate with `albedo`, which does not interpolate"
        )
    return vocabulary.label(vocabulary.add_warning(bsdf, *warnings), "bsdf")


def _wavelengths(
    spectrum: xr.Dataset | None, known: list[xr.Dataset], of_transmittance: Array | None, wavelength: ArrayLike | None
) -> Array:
    """Those of the spectrum, of the transmittance, given, or of an index that depends on them."""
    if spectrum is None and of_transmittance is not None and wavelength is None:
        return of_transmittance
    spectral = [one for one in known if np.ptp(one["n"].values) or np.ptp(one["k"].values)]
    return wavelengths_of(spectrum, (spectral or known)[0], wavelength, ModelError)


def _nodes(wavelength: Array, count: int) -> Array:
    """Chebyshev nodes of the inverse square of the wavelength [nm]."""
    if count == 1 or wavelength.size == 1:
        return wavelength[:1]
    ends = wavelength[[0, -1]] ** -2.0
    inverse = ends.mean() + np.ptp(ends) / 2 * np.cos(np.pi * np.arange(count) / (count - 1))
    return np.asarray(np.clip(inverse**-0.5, wavelength[0], wavelength[-1]))


def _weights(nodes: Array, wavelength: Array, depth: Array, inside: Array) -> Array:
    """Weights (wavelength, nodes of wavelength × nodes of depth) of polynomials between them."""
    by_wavelength = lagrange(nodes**-2.0, wavelength**-2.0)
    return (by_wavelength[:, :, None] * depth_weights(depth, inside)[:, None, :]).reshape(wavelength.size, -1)


def _at_node(
    surfaces: tuple[Microsurface | None, ...],
    masking: str,
    n: float,
    n_base: float,
    k_base: float,
    depth: Array,
    transmittances: Array,
    resolved: Resolution,
    grid: LobeGrid,
) -> _Node:
    """The coated body at one wavelength: its table at all nodes of the depth, and its fluxes for all internal transmittances."""
    nodes = Nodes.of(n, resolved.outside, resolved.beyond)
    azimuths = Azimuths.of(resolved.narrowest / 3, 48)
    front = (
        face.smooth(n, nodes)
        if surfaces[0] is None
        else face.rough(surfaces[0], masking, n, nodes, azimuths, resolved.sharp[0], resolved.panels)
    )
    relative = n_base / n, k_base / n
    below = base.of_base(surfaces[1], masking, n, relative, nodes, azimuths, resolved.sharp[1][1])
    pair = Sheet(front, below, nodes, azimuths)
    smooth = surfaces[0] is None, True
    table, error = tabulate(pair, smooth, np.exp(-(depth**2)), resolved.modes, grid, reflected_alone=True)
    body = [base.body_light(pair, float(tau)) for tau in transmittances]
    straight = [adding_doubling.straight(pair, float(tau)).front + front.mirrored_outside for tau in transmittances]
    return _Node(
        table,
        error,
        adding_doubling.balances(pair, transmittances)[:, 0, 0],
        np.array(straight),
        np.array([one.entering for one in body]),
        np.array([one.returned for one in body]),
        np.array([one.strongest for one in body]),
        front.diffuse,
        max(front.correction, below.correction),
    )


def _with_fluxes(
    bsdf: xr.Dataset, found: list[_Node], at: NDArray[np.intp], nodes: Array, spectrum: xr.Dataset | None
) -> xr.Dataset:
    """Add the reflectance of the faces, the light of the body and the strength of the body that gives the total reflectance.

    ``at`` is the place of the internal transmittance of each wavelength.
    """
    by_node = lagrange(nodes**-2.0, bsdf["wavelength"].values ** -2.0)

    def between(name: str) -> Array:
        values = np.array([getattr(one, name)[at] for one in found])
        return np.asarray(np.einsum("wk,kw...->...w", by_node, values))

    diffuse = np.maximum((by_node @ np.array([one.diffuse for one in found])).T, 0.0)
    over = ("theta", "wavelength")
    bsdf = bsdf.assign(
        faces_reflectance=(over, between("reflected")),
        faces_specular=(over, between("specular")),
        body_share=(over, between("entering")),
        front_diffuse=(over, diffuse),
    )
    if spectrum is None:
        return bsdf.assign(body_weight=("wavelength", np.zeros(bsdf.sizes["wavelength"])))
    theta_m = float(spectrum.attrs["theta_i"])
    total = spectrum["total_reflectance"].values.astype(float)
    alone = Coated(vocabulary.label(bsdf.assign(body_weight=("wavelength", np.ones(total.size))), "bsdf"))
    at_theta = barycentric(bsdf["theta"].values, np.array([theta_m]))
    faces = (at_theta @ bsdf["faces_reflectance"].values)[0]
    unit = (at_theta @ bsdf["body_share"].values)[0] * alone._model(None).reflected_by_body
    strongest, returned = between("strongest"), between("returned")
    most = strongest / (1 - strongest * returned)
    # Through a coat that absorbs all light the body cannot be seen.
    wanted = np.divide(total - faces, unit, out=np.zeros_like(total), where=unit * most > _ROUNDING)
    weight = np.clip(wanted, 0.0, most)
    clamped = np.abs(faces + unit * weight - total) > _ROUNDING
    quality = np.where(clamped, vocabulary.quality("clamped"), vocabulary.quality("measured")).astype(np.int8)
    bsdf = bsdf.assign(
        body_weight=("wavelength", weight),
        theta_m=theta_m,
        total_reflectance=("wavelength", total),
        diffuse_quality=("wavelength", quality),
    )
    if not clamped.any():
        return bsdf
    where = bsdf["wavelength"].values[clamped]
    return vocabulary.add_warning(
        bsdf,
        f"the total reflectance is out of the range of a body below this coat at {where.size} wavelengths ({where.min():g} to "
        f"{where.max():g} nm), between {float(faces.min()):.4f} of the faces alone and {float((faces + unit * most).max()):.4f} of a body "
        "that absorbs nothing; it is the nearest of these there. Check whether the specular was excluded, the indices and the transmittance",
    )
