"""A plane-parallel sheet in air: two rough or smooth faces, and an internal transmittance between them.

Adding–doubling: each face is an operator between polar angles, in Fourier modes of the azimuth, and all reflections between the
faces are summed by solving a linear system. Light between the faces keeps its polarisation, as a Stokes vector. The outer reflection
of a face is evaluated by its facets directly, so gloss keeps its sharpness; only the light that has been inside is tabulated.

References
----------
Patent US 9,395,299 (CRF), "combination of the BTDF of the two surfaces"; van de Hulst 1980, Multiple Light Scattering, §4;
Walter 2007 (EGSR) for the faces; Kulla & Conty 2017 (SIGGRAPH course) for the light their facets lose.
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from brdfpipe import vocabulary
from brdfpipe.bsdf.microfacet.builder import index_on, wavelengths_of
from brdfpipe.bsdf.microfacet.microsurface import Microsurface, ModelError
from brdfpipe.bsdf.representations.slab import BALANCE, SIDES, TABLE_DIMS, Slab, first_weights, root_depth, with_waves
from brdfpipe.bsdf.slab import adding_doubling
from brdfpipe.bsdf.slab.lobe_table import LobeGrid
from brdfpipe.bsdf.slab.tabulation import Resolution, Surface, resolution, sheet, tabulate
from brdfpipe.bsdf.slab.wave_face import WaveSurface
from brdfpipe.facets.facet_dataset import azimuthal_average
from brdfpipe.geometry import Array
from brdfpipe.masking.modes import SMITH_MASKINGS
from brdfpipe.optics.index import refractive_index

Spectral: TypeAlias = float | xr.DataArray
"""A number, or values over ``wavelength`` [nm]."""

ERROR_LIMIT = 0.02
"""Interpolation error above which a slab has a warning [1]."""

FACE_OPTICS = ("facets", "wave", "auto")
"""Accepted optics of a face with a roughness spectrum."""

WAVELENGTH_NODES = 5
"""Wavelengths at which a sheet with waves is computed, for all others."""

_NO_LIGHT = 1e-200
_DARKEST_DEPTH = float(np.sqrt(-np.log(1e-4)))


class _Body(NamedTuple):
    """Index and internal transmittance at normal incidence; scalars if they do not depend on wavelength."""

    n: Array
    transmittance: Array
    wavelength: Array | None
    warnings: list[str]


def build(
    front: xr.Dataset,
    back: xr.Dataset,
    *,
    index: xr.Dataset | float | str,
    internal_transmittance: Spectral | None = None,
    absorption: Spectral | None = None,
    thickness: float | None = None,
    masking: str = "height-correlated",
    front_psd: xr.Dataset | None = None,
    back_psd: xr.Dataset | None = None,
    optics: str = "auto",
    wavelength: ArrayLike | None = None,
) -> xr.Dataset:
    """BSDF of a plane-parallel sheet with air on both sides.

    Parameters
    ----------
    front, back : kind ``facets``, each seen from its own air side; a perfectly smooth face is :func:`brdfpipe.facets.flat`.
        A lay is averaged over azimuth, with a warning
    index : kind ``index``, a number or a plastic's name
    internal_transmittance : share of the light that crosses the sheet at normal incidence from face to face, 0 to 1 [1]; a
        number, or a DataArray over ``wavelength``. 1 by default
    absorption, thickness : alternatively, the (napierian) absorption coefficient [mm-1], a number or a DataArray over
        ``wavelength``, and the thickness [mm]
    masking : one of :data:`brdfpipe.masking.modes.SMITH_MASKINGS`; with waves the first of them
    front_psd, back_psd : kind ``psd``, the roughness spectra of the faces; a face without one, and a smooth one, knows facets alone
    optics : of faces with a spectrum, ``facets``, ``wave``, or ``auto``, which passes from waves to facets with the phase variance and
        the slope, of transmitted and of reflected light apart
    wavelength : [nm], increasing, of a sheet with waves whose index and transmittance do not depend on wavelength; by default
        :data:`brdfpipe.bsdf.microfacet.builder.WAVELENGTHS`

    Returns
    -------
    Dataset of kind ``bsdf``, representation ``slab``. The front side is θ < 90 degree, the back side θ > 90, for both directions.
    Perfectly specular parts are ``specular_reflectance(theta_i)`` and ``specular_transmittance(theta_i)``; they are included in
    ``reflectance``, ``transmittance`` and ``absorptance``, which sum to 1

    Raises
    ------
    ModelError : an unknown masking or optics, an absorbing index, or a transmittance, absorption or thickness out of range.
    VocabularyError : a dataset of the wrong kind.

    Notes
    -----
    Light that the model of the facets loses is returned diffusely on both sides (:func:`brdfpipe.bsdf.slab.face.rough`), so energy is
    conserved to rounding. Lobes narrower than :data:`brdfpipe.bsdf.slab.tabulation.NARROWEST_THROUGH` are treated as specular inside
    and behind the sheet, with a warning; their flux is exact. ``interpolation_error`` is the error between the nodes of the table,
    ``quadrature_error`` the correction by which the operators of the faces were scaled to conserve energy.
    """
    if masking not in SMITH_MASKINGS:
        raise ModelError(
            f"a slab needs one of Smith's maskings; found {masking!r}; accepted: {', '.join(SMITH_MASKINGS)}"
        )
    if optics not in FACE_OPTICS:
        raise ModelError(f"unknown optics {optics!r} of a slab; accepted: {', '.join(FACE_OPTICS)}; set `model.optics`")
    faces = [azimuthal_average(vocabulary.validate(facets, "facets")) for facets in (front, back)]
    known = vocabulary.validate(index, "index") if isinstance(index, xr.Dataset) else refractive_index(index)
    body = _body(known, internal_transmittance, absorption, thickness)
    surfaces: tuple[Surface, Surface] = _surfaces(front, back, faces)
    spectra = (None, None) if optics == "facets" else (front_psd, back_psd)
    if any(psd is not None and facets["slope_density"].size for psd, facets in zip(spectra, faces, strict=True)):
        if masking != SMITH_MASKINGS[0]:
            raise ModelError(f"waves are masked by `masking: {SMITH_MASKINGS[0]}`; found {masking!r}")
        body, surfaces = _with_waves(body, surfaces, faces, spectra, known, optics, wavelength)
    with_spectrum = any(isinstance(surface, WaveSurface) for surface in surfaces)
    low, high = float(body.n.min()), float(body.n.max())
    if with_spectrum:
        assert body.wavelength is not None
        wavelength_node = _wavelength_nodes(body.wavelength)
        index_node = np.broadcast_to(index_on(known, wavelength_node)[0], wavelength_node.shape)
        first = {"wavelength_node": wavelength_node}
    else:
        index_node = np.array([low]) if low == high else np.linspace(low, high, 3)
        wavelength_node = np.full(index_node.size, np.nan)
        first = {"index_node": index_node}
    resolved = resolution(surfaces, low, wavelength_node)
    depth_node = depth_nodes(body.transmittance)
    grid = LobeGrid.of(float(np.degrees(resolved.scale)))
    smooth = (surfaces[0] is None, surfaces[1] is None)
    tables, errors, operators = [], [], []
    for n, nm in zip(index_node, wavelength_node, strict=True):
        # One at a time: the kernels of a pair of faces take up to 300 MB.
        pair = sheet(surfaces, masking, float(n), resolved, float(nm))
        table, error = tabulate(pair, smooth, np.exp(-(depth_node**2)), resolved.modes, grid)
        tables.append(table)
        errors.append(error)
        operators.append(Operators.of(pair, np.unique(body.transmittance)))
    error = max(errors)
    bsdf = xr.Dataset(
        {
            "n": (("wavelength",) * body.n.ndim, body.n),
            "internal_transmittance": (("wavelength",) * body.transmittance.ndim, body.transmittance),
            "log_scattered": (TABLE_DIMS, np.concatenate(tables, axis=-1)),
            "lobe_scale": grid.scale,
            "interpolation_error": error,
            "quadrature_error": max(each.correction for each in operators),
        },
        coords={"theta_low": grid.low, **first, "depth_node": depth_node},
        attrs={"representation": Slab.name, "masking": masking, "transmission": "slab"},
    )
    if body.wavelength is not None:
        bsdf = bsdf.assign_coords(wavelength=body.wavelength)
    bsdf = _with_balance(bsdf, operators, surfaces)
    warnings = list(body.warnings)
    for side, facets, surface, given in zip(SIDES, faces, surfaces, (front, back), strict=True):
        bsdf.attrs[f"{side}_band"] = facets.attrs["band"]
        if facets is not given:
            warnings += [text for text in vocabulary.warnings(facets) if text not in warnings]
        if isinstance(surface, WaveSurface):
            bsdf = with_waves(bsdf, side, surface.outside)
            warnings += [f"{side} face: {text}" for text in vocabulary.warnings(surface.outside)]
        elif surface is not None:
            slope, theta = f"{side}_slope", f"{side}_theta"
            bsdf = bsdf.assign_coords({slope: facets["slope"].values, theta: facets["theta"].values})
            bsdf[f"{side}_slope_density"] = (slope, facets["slope_density"].values)
            bsdf[f"{side}_lambda_smith"] = (theta, facets["lambda_smith"].values)
    warnings += _warnings(surfaces, float(body.n.mean()), resolved, error)
    return vocabulary.label(vocabulary.add_warning(bsdf, *warnings), "bsdf")


# --- input


def _surfaces(
    front: xr.Dataset, back: xr.Dataset, faces: list[xr.Dataset]
) -> tuple[Microsurface | None, Microsurface | None]:
    surfaces = [Microsurface.of(facets) if facets["slope_density"].size else None for facets in faces]
    # Two equal faces are computed once.
    equal = front is back or front.drop_attrs().identical(back.drop_attrs())
    return surfaces[0], surfaces[0] if equal else surfaces[1]


def _with_waves(
    body: _Body,
    surfaces: tuple[Surface, Surface],
    faces: list[xr.Dataset],
    spectra: tuple[xr.Dataset | None, xr.Dataset | None],
    index: xr.Dataset,
    optics: str,
    wavelength: ArrayLike | None,
) -> tuple[_Body, tuple[Surface, Surface]]:
    """The body at wavelengths, and its faces with waves where these matter."""
    given = wavelengths_of(None, index, wavelength, ModelError) if body.wavelength is None else body.wavelength
    n = np.broadcast_to(index_on(index, given)[0], given.shape)
    found: list[Surface] = []
    for surface, facets, psd in zip(surfaces, faces, spectra, strict=True):
        if found and surface is not None and surface is surfaces[0] and _equal(spectra):
            found.append(found[0])
        elif surface is None or psd is None:
            found.append(surface)
        else:
            waves = WaveSurface.of(facets, psd, index, given, optics)
            found.append(surface if waves.is_of_facets(float(n.min()), float(given[-1])) else waves)
    if not any(isinstance(surface, WaveSurface) for surface in found):
        return body, surfaces
    return body._replace(n=n, wavelength=given), (found[0], found[1])


def _equal(spectra: tuple[xr.Dataset | None, xr.Dataset | None]) -> bool:
    front, back = spectra
    return front is back or (front is not None and back is not None and front.drop_attrs().identical(back.drop_attrs()))


def _wavelength_nodes(wavelength: Array) -> Array:
    """Chebyshev nodes of the inverse square of the wavelength, between which the logarithm of the scattered light is a polynomial."""
    ends = wavelength[[0, -1]] ** -2.0
    if wavelength.size == 1:
        return wavelength
    inverse = ends.mean() + np.ptp(ends) / 2 * np.cos(np.pi * np.arange(WAVELENGTH_NODES) / (WAVELENGTH_NODES - 1))
    return np.asarray(np.clip(inverse**-0.5, wavelength[0], wavelength[-1]))


def _body(
    index: xr.Dataset,
    internal_transmittance: Spectral | None,
    absorption: Spectral | None,
    thickness: float | None,
) -> _Body:
    if np.any(index["k"].values > 0):
        raise ModelError(
            f"the index of the slab absorbs (k up to {float(index['k'].max()):g}); give a real index, and the absorption apart"
        )
    inside, wavelength = internal_transmittance_of(internal_transmittance, absorption, thickness)
    n, _, wavelength, warnings = index_on(index, wavelength)
    return _Body(np.asarray(n), inside, wavelength, warnings)


def internal_transmittance_of(
    internal_transmittance: Spectral | None, absorption: Spectral | None, thickness: float | None
) -> tuple[Array, Array | None]:
    if absorption is None and thickness is None:
        values, wavelength = _spectrum(1.0 if internal_transmittance is None else internal_transmittance)
        if not (values.min() >= 0 and values.max() <= 1):
            raise ModelError(f"the internal transmittance spans {values.min():g} to {values.max():g}; accepted: 0 to 1")
        return values, wavelength
    if internal_transmittance is not None or absorption is None or thickness is None:
        raise ModelError("give either the internal transmittance, or the absorption and the thickness")
    values, wavelength = _spectrum(absorption)
    if not (values.min() >= 0 and np.isfinite(values).all() and 0 < thickness < np.inf):
        raise ModelError(
            f"the absorption spans {values.min():g} to {values.max():g} mm-1 and the thickness is {thickness:g} mm; accepted: finite, "
            "absorption >= 0 and thickness > 0"
        )
    return np.asarray(np.exp(-values * thickness)), wavelength


def _spectrum(given: Spectral) -> tuple[Array, Array | None]:
    if not isinstance(given, xr.DataArray) or given.ndim == 0:
        return np.asarray(given, dtype=float), None
    if given.dims != ("wavelength",) or given.size == 0 or not (np.diff(given["wavelength"].values) > 0).all():
        raise ModelError(
            f"a spectrum of the slab has dimensions {given.dims}; accepted: a number, or values over increasing `wavelength`"
        )
    values, wavelength = given.values.astype(float), given["wavelength"].values.astype(float)
    return (np.asarray(values[0]), None) if np.ptp(values) == 0 else (values, wavelength)


def depth_nodes(transmittance: Array) -> Array:
    """Chebyshev nodes of √(−ln τ), between which the logarithm of the scattered light is a polynomial.

    Light trapped beyond the critical angle fades with the slightest absorption: near τ = 1 the logarithm bends like a root.
    """
    depth = root_depth(transmittance)
    low, high = min(float(depth.min()), _DARKEST_DEPTH), min(float(depth.max()), _DARKEST_DEPTH)
    if depth.max() > _DARKEST_DEPTH:
        low = min(low, _DARKEST_DEPTH - 0.2)
    if low == high:
        return np.array([low])
    span = high - low
    count = 3 if span < 0.1 else 5 if span < 0.5 else 6 if span < 1.5 else 8
    return np.asarray((low + high) / 2 - (high - low) / 2 * np.cos(np.pi * np.arange(count) / (count - 1)))


# --- output


class Operators(NamedTuple):
    """What remains of the operators of a sheet beside its table."""

    outside: Array
    """(N,) polar angles [degree]"""
    fluxes: Array
    """(transmittances, 6, 2N)"""
    diffuse: Array
    """(N, 2) factors of the outer diffuse reflection of front and back"""
    correction: float

    @classmethod
    def of(cls, pair: adding_doubling.Sheet, transmittances: Array) -> Operators:
        """Of a sheet and several internal transmittances at normal incidence."""
        diffuse = np.stack([pair.front.diffuse, pair.back.diffuse], axis=-1)
        correction = max(pair.front.correction, pair.back.correction)
        return cls(pair.nodes.outside, _fluxes(pair, transmittances), diffuse, correction)


def _with_balance(bsdf: xr.Dataset, operators: list[Operators], surfaces: tuple[Surface, Surface]) -> xr.Dataset:
    """Add reflectance, transmittance, absorptance, their specular parts, and the factors of the outer diffuse reflection."""
    n, inside = (np.atleast_1d(bsdf[name].values) for name in ("n", "internal_transmittance"))
    first = first_weights(bsdf, n, None)
    _, where = np.unique(inside, return_inverse=True)
    by_node = np.array([each.fluxes for each in operators])[:, where]
    outside = operators[0].outside
    with_waves = "wavelength_node" in bsdf.coords
    if with_waves:
        # Coherent light falls exponentially with the inverse square of the wavelength.
        by_node[:, :, 3:] = np.log(np.maximum(by_node[:, :, 3:], _NO_LIGHT))
    # Index, transmittance, or both may depend on wavelength.
    *fluxes, outer = np.moveaxis((first.T[:, :, None, None] * by_node).sum(axis=0), 0, -1)
    if with_waves:
        # The polynomial over wavelength may fall below 0 by its error.
        balance = np.maximum(fluxes[:3], 0.0)
        fluxes[:3] = balance / balance.sum(axis=0)
        fluxes[3:] = [np.minimum(np.exp(inner), total) for inner, total in zip(fluxes[3:], fluxes[:2], strict=True)]
        outer = _outer_specular(np.exp(outer), outside, surfaces)
        fluxes[3] = np.minimum(fluxes[3] + outer, fluxes[0])
    else:
        fluxes[3] = fluxes[3] + outer
    diffuse = np.stack([each.diffuse.T for each in operators], axis=-1) @ first.T
    diffuse = np.maximum(diffuse, 0.0) if with_waves else diffuse
    fields = {name: _variable("theta_i", values) for name, values in zip(BALANCE, fluxes, strict=True)}
    fields |= {f"{side}_diffuse": _variable("theta", values) for side, values in zip(SIDES, diffuse, strict=True)}
    return bsdf.assign_coords(theta=outside, theta_i=np.concatenate([outside, 180 - outside[::-1]])).assign(fields)


def _outer_specular(interpolated: Array, outside: Array, surfaces: tuple[Surface, Surface]) -> Array:
    """Outer mirror reflection (2N, wavelength) from both sides: exact where a face has waves, else as interpolated."""
    result = interpolated.copy()
    for surface, half in zip(surfaces, np.split(result, 2), strict=True):
        if isinstance(surface, WaveSurface):
            half[:] = surface.reflection.specular(outside, np.zeros_like(outside), None)[0]
    result[outside.size :] = result[outside.size :][::-1]
    return result


def _variable(angle: str, values: Array) -> tuple[tuple[str, ...], Array]:
    """Values, (angles, wavelength or 1), as a variable."""
    return ((angle,), values[:, 0]) if values.shape[1] == 1 else ((angle, "wavelength"), values)


def _fluxes(pair: adding_doubling.Sheet, transmittances: Array) -> Array:
    """The fluxes of ``BALANCE`` inside, and the outer mirror reflection, (transmittances, 6, 2N), from the front and then the back."""
    result = []
    for transmittance, balances in zip(transmittances, adding_doubling.balances(pair, transmittances), strict=True):
        straight = adding_doubling.straight(pair, float(transmittance))
        front, back = (
            np.stack([*balance, inner, straight.through, face.mirrored_outside])
            for balance, face, inner in zip(
                balances, (pair.front, pair.back), (straight.front, straight.back), strict=True
            )
        )
        result.append(np.concatenate([front, back[:, ::-1]], axis=1))
    return np.array(result)


def _warnings(surfaces: tuple[Surface, Surface], index: float, resolved: Resolution, error: float) -> list[str]:
    texts = []
    for side, surface, (through, within) in zip(SIDES, surfaces, resolved.sharp, strict=True):
        if not isinstance(surface, Microsurface) or not (through or within):
            continue
        width = np.degrees((index - 1) * surface.typical_slope)
        texts.append(
            f"the lobe transmitted by the {side} face is about {width:.2g}° wide, narrower than a slab resolves, and is treated as "
            "specular inside and behind the sheet: reflectance and transmittance are right, angles near the straight direction are "
            "not; take the face as smooth (facets.flat), or evaluate it alone as a transparent interface"
        )
    if error > ERROR_LIMIT:
        texts.append(
            f"light that has been inside the slab is interpolated with an error of {error:.1%} of the flux at the worst incidence; "
            "integrate with `albedo` and `transmittance`, which do not interpolate"
        )
    return texts
