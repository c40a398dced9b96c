"""A clear coat on an opaque body: lacquer over a coloured base, or a film on a plastic or metal.

The outer face of the coat reflects by its facets directly. Light that has been inside is summed over all reflections between that face
and the face of the base (:mod:`brdfpipe.bsdf.slab.adding_doubling`), apart for light that has been in the body below, of which one number
at each wavelength follows from the total reflectance (:mod:`brdfpipe.bsdf.slab.base`). Energy is conserved and the BRDF is reciprocal.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from brdfpipe import hemisphere, vocabulary
from brdfpipe.bsdf.base import UNRESOLVED_SLOPE
from brdfpipe.bsdf.microfacet.builder import doubted_geometry, index_on, wavelengths_of
from brdfpipe.bsdf.microfacet.gloss_trap import trap_of
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
THINNEST = 0.01
"""Thickness [mm] below which the light of both faces may interfere: the coherence length λ²/2nΔλ of bands of 10 nm at 550 nm."""


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
    spectrum : kind ``spectrum``, the total reflectance of the coated body. The light scattered in the body follows from it; with the
        specular excluded (``sce``), what the trap of the instrument takes away is added. Without a spectrum, and of a metal, there is none
    internal_transmittance, absorption, thickness : of the coat, as of :func:`brdfpipe.bsdf.slab.build`; the thickness [mm] may stand beside
        the internal transmittance too, for a warning about interference
    masking : one of :data:`brdfpipe.masking.modes.SMITH_MASKINGS`
    wavelength : [nm], increasing, where neither spectrum, index nor transmittance sets them

    Returns
    -------
    Dataset of kind ``bsdf``, representation ``coated``

    Raises
    ------
    ModelError : an unknown masking, an absorbing coat, a metal with a spectrum, or a transmittance, absorption or thickness out of range.
    VocabularyError : a dataset of the wrong kind.

    Notes
    -----
    Facets of the base lose light to one another; what a metal reflects of it is returned diffusely. Where the total reflectance is below
    that of the faces, the light of the body is set to 0, flagged, and a warning names the wavelengths; above that of a body that absorbs
    nothing likewise.
    """
    given = CoatedBody.of(
        coat,
        surface,
        coat_index=coat_index,
        index=index,
        spectrum=spectrum,
        inside=internal_transmittance_of(internal_transmittance, absorption, None if absorption is None else thickness),
        masking=masking,
        wavelength=wavelength,
    )
    resolved = given.resolution()
    grid = LobeGrid.of(float(np.degrees(resolved.scale)))
    bsdf = given.dataset(given.solved(given.wavelength_nodes(), depth_nodes(given.inside), resolved, grid))
    warnings = list(given.warnings)
    for one, own in zip(given.faces, (coat, surface), strict=True):
        if one is not None and one is not own:
            warnings += [text for text in vocabulary.warnings(one) if text not in warnings]
    if thickness is not None and thickness < THINNEST:
        warnings.append(
            f"the coat is {1e3 * thickness:.3g} µm thick: below {1e3 * THINNEST:g} µm the light of both faces interferes, which is not "
            "modelled; where both are smooth, the spectrum has fringes that a prediction has not"
        )
    if (error := float(bsdf["interpolation_error"])) > ERROR_LIMIT:
        warnings.append(
            f"light that has been inside the coat is interpolated with an error of {error:.1%} of the flux at the worst incidence; "
            "integrate with `albedo`, which does not interpolate"
        )
    return vocabulary.label(vocabulary.add_warning(bsdf, *warnings), "bsdf")


class Solution(NamedTuple):
    """The light between the faces of a coated body, whatever its total reflectance is."""

    wavelength: Array
    """Nodes of the wavelength [nm]"""
    depth: Array
    """Nodes of √(−ln τ)"""
    resolved: Resolution
    grid: LobeGrid
    found: tuple[_Node, ...]
    """At each node of the wavelength"""


@dataclass(frozen=True)
class CoatedBody:
    """The inputs of a coated body, at its wavelengths."""

    faces: tuple[xr.Dataset | None, xr.Dataset | None]
    """Facets of the coat and of the body below, without a lay; None for a smooth body"""
    masking: str
    wavelength: Array
    """(wavelength,) [nm]"""
    n: Array
    """(wavelength,) of the coat"""
    n_base: Array
    k_base: Array
    inside: Array
    """(wavelength,) internal transmittance"""
    spectrum: xr.Dataset | None
    warnings: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        coat: xr.Dataset,
        surface: xr.Dataset | None,
        *,
        coat_index: xr.Dataset | float | str,
        index: xr.Dataset | float | str,
        spectrum: xr.Dataset | None,
        inside: tuple[Array, Array | None],
        masking: str,
        wavelength: ArrayLike | None,
    ) -> CoatedBody:
        """Checked inputs, as those of :func:`build`; ``inside``: internal transmittance, and its wavelengths if it has some."""
        if masking not in SMITH_MASKINGS:
            raise ModelError(
                f"a coat needs one of Smith's maskings; found {masking!r}; accepted: {', '.join(SMITH_MASKINGS)}"
            )
        faces = [
            None if one is None else azimuthal_average(vocabulary.validate(one, "facets")) for one in (coat, surface)
        ]
        known = [
            vocabulary.validate(one, "index") if isinstance(one, xr.Dataset) else refractive_index(one)
            for one in (coat_index, index)
        ]
        if np.any(known[0]["k"].values > 0):
            raise ModelError("the index of the coat absorbs; give a real index, and its absorption apart")
        if spectrum is not None:
            vocabulary.validate(spectrum, "spectrum")
            if np.any(known[1]["k"].values > 0):
                raise ModelError("light does not come back from below the face of a metal; leave out the spectrum")
        values, of_transmittance = inside
        at = _wavelengths(spectrum, known, of_transmittance, wavelength)
        (n, _, _, of_coat), (n_base, k_base, _, of_base) = (index_on(one, at) for one in known)
        values = values if of_transmittance is None else np.interp(at, of_transmittance, values)
        n, n_base, k_base, values = (
            np.broadcast_to(np.asarray(part, dtype=float), at.shape) for part in (n, n_base, k_base, values)
        )
        warnings = (*(f"coat: {text}" for text in of_coat), *(f"base: {text}" for text in of_base))
        return cls((faces[0], faces[1]), masking, at, n, n_base, k_base, values, spectrum, warnings)

    @property
    def is_metal(self) -> bool:
        """Whether the body is a metal, from below whose face no light comes back."""
        return bool(np.any(self.k_base > 0))

    @cached_property
    def surfaces(self) -> tuple[Microsurface | None, Microsurface | None]:
        """Facets of the coat and of the body; None for a smooth face."""
        first, second = (
            Microsurface.of(one) if one is not None and one["slope_density"].size else None for one in self.faces
        )
        return first, second

    def resolution(self) -> Resolution:
        """Numbers of nodes for the lobes of both faces."""
        return resolution(self.surfaces, float(self.n.min()), np.full(1, np.nan))

    def wavelength_nodes(self) -> Array:
        """Wavelengths at which the faces are computed [nm]."""
        constant = all(np.ptp(part) == 0 for part in (self.n, self.n_base, self.k_base))
        return _nodes(self.wavelength, 1 if constant else _METAL_NODES if self.is_metal else _WAVELENGTH_NODES)

    def solved(self, nodes: Array, depth: Array, resolved: Resolution, grid: LobeGrid) -> Solution:
        """The light between the faces at nodes of wavelength [nm] and of √(−ln τ)."""
        transmittances = np.unique(self.inside)
        found = []
        for nm in nodes:
            n, n_base, k_base = (
                float(np.interp(nm, self.wavelength, part)) for part in (self.n, self.n_base, self.k_base)
            )
            found.append(
                _at_node(self.surfaces, self.masking, n, n_base, k_base, depth, transmittances, resolved, grid)
            )
        return Solution(nodes, depth, resolved, grid, tuple(found))

    def dataset(self, solution: Solution) -> xr.Dataset:
        """Dataset of representation ``coated``, not labelled, with the light of the body that gives the total reflectance."""
        nodes, depth, resolved, grid, found = solution
        outside = Nodes.of(float(self.n.min()), resolved.outside, resolved.beyond).outside
        bsdf = xr.Dataset(
            {
                "n": ("wavelength", self.n),
                "log_scattered": (TABLE_DIMS, np.concatenate([one.table for one in found], axis=-1)),
                "node_weight": (("wavelength", "node"), _weights(nodes, self.wavelength, depth, self.inside)),
                "lobe_scale": grid.scale,
                "interpolation_error": max(one.error for one in found),
                "quadrature_error": max(one.correction for one in found),
            },
            coords={"theta_low": grid.low, "wavelength": self.wavelength, "theta": outside},
            attrs={
                "representation": Coated.name,
                "masking": self.masking,
                "transmission": "none",
                "base": "metal" if self.is_metal else "dielectric",
            },
        )
        coat = self.faces[0]
        if coat is not None and self.surfaces[0] is not None:
            bsdf = bsdf.assign_coords(front_slope=coat["slope"].values, front_theta=coat["theta"].values)
            bsdf["front_slope_density"] = ("front_slope", coat["slope_density"].values)
            bsdf["front_lambda_smith"] = ("front_theta", coat["lambda_smith"].values)
        at = np.searchsorted(np.unique(self.inside), self.inside)
        return _with_fluxes(bsdf, found, at, nodes, self.spectrum, self.surfaces)


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
    bsdf: xr.Dataset,
    found: tuple[_Node, ...],
    at: NDArray[np.intp],
    nodes: Array,
    spectrum: xr.Dataset | None,
    surfaces: tuple[Microsurface | None, ...],
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
    in_trap, body_in_trap = _trapped(bsdf, spectrum, surfaces)
    seen = unit - body_in_trap
    wanted = np.divide(total + in_trap - faces, seen, out=np.zeros_like(total), where=seen * most > _ROUNDING)
    weight = np.clip(wanted, 0.0, most)
    total = total + in_trap + body_in_trap * weight
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
        f"that absorbs nothing; it is the nearest of these there. Check {doubted_geometry(spectrum)}the indices and the transmittance",
    )


def _trapped(bsdf: xr.Dataset, spectrum: xr.Dataset, surfaces: tuple[Microsurface | None, ...]) -> tuple[Array, Array]:
    """Light of the faces, and of a body of unit weight, that goes into a gloss trap, (wavelength,) each; 0 if the specular was included."""
    none = np.zeros(bsdf.sizes["wavelength"])
    if spectrum.attrs["geometry"] != "sce":
        return none, none
    theta_m = float(spectrum.attrs["theta_i"])
    slope = min((one.typical_slope for one in surfaces if one is not None), default=UNRESOLVED_SLOPE)
    theta, phi, weight = hemisphere.around_mirror(theta_m, slope, trap_of(spectrum))
    lit = np.full_like(theta, theta_m), np.zeros_like(phi)
    dark, unit = (
        Coated(vocabulary.label(bsdf.assign(body_weight=("wavelength", none + share)), "bsdf")) for share in (0.0, 1.0)
    )
    of_faces, of_all = (weight @ one.evaluate(*lit, theta, phi, None) for one in (dark, unit))
    mirrored = dark.specular(np.array([theta_m]), np.zeros(1), None)[0][0]
    return np.asarray(mirrored + of_faces), np.asarray(of_all - of_faces)
