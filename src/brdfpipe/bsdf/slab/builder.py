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

from brdfpipe import vocabulary
from brdfpipe.bsdf.microfacet.builder import index_on
from brdfpipe.bsdf.microfacet.microsurface import Microsurface, ModelError
from brdfpipe.bsdf.representations.slab import BALANCE, SIDES, TABLE_DIMS, Slab, lagrange, root_depth
from brdfpipe.bsdf.slab import adding_doubling
from brdfpipe.bsdf.slab.lobe_table import LobeGrid
from brdfpipe.bsdf.slab.tabulation import Resolution, resolution, sheet, tabulate
from brdfpipe.facets.facet_dataset import azimuthal_average
from brdfpipe.geometry import Array
from brdfpipe.masking.modes import SMITH_MASKINGS
from brdfpipe.optics.index import refractive_index

Spectral: TypeAlias = float | xr.DataArray
"""A number, or values over ``wavelength`` [nm]."""

ERROR_LIMIT = 0.02
"""Interpolation error above which a slab has a warning [1]."""

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
    masking : one of :data:`brdfpipe.masking.modes.SMITH_MASKINGS`

    Returns
    -------
    Dataset of kind ``bsdf``, representation ``slab``. The front side is θ < 90 degree, the back side θ > 90, for both directions.
    Perfectly specular parts are ``specular_reflectance(theta_i)`` and ``specular_transmittance(theta_i)``; they are included in
    ``reflectance``, ``transmittance`` and ``absorptance``, which sum to 1

    Raises
    ------
    ModelError : an unknown masking, an absorbing index, or a transmittance, absorption or thickness out of range.
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
    faces = [azimuthal_average(vocabulary.validate(facets, "facets")) for facets in (front, back)]
    surfaces = _surfaces(front, back, faces)
    body = _body(index, internal_transmittance, absorption, thickness)
    resolved = resolution(surfaces, float(body.n.min()))
    low, high = float(body.n.min()), float(body.n.max())
    index_node = np.array([low]) if low == high else np.linspace(low, high, 3)
    depth_node = _depth_nodes(body.transmittance)
    sheets = [sheet(surfaces, masking, float(n), resolved) for n in index_node]
    grid = LobeGrid.of(float(np.degrees(resolved.scale)))
    smooth = (surfaces[0] is None, surfaces[1] is None)
    table, error = tabulate(sheets, smooth, np.exp(-(depth_node**2)), resolved.modes, grid)
    bsdf = xr.Dataset(
        {
            "n": (("wavelength",) * body.n.ndim, body.n),
            "internal_transmittance": (("wavelength",) * body.transmittance.ndim, body.transmittance),
            "log_scattered": (TABLE_DIMS, table),
            "lobe_scale": grid.scale,
            "interpolation_error": error,
            "quadrature_error": max(face.correction for pair in sheets for face in (pair.front, pair.back)),
        },
        coords={"theta_low": grid.low, "index_node": index_node, "depth_node": depth_node},
        attrs={"representation": Slab.name, "masking": masking, "transmission": "slab"},
    )
    if body.wavelength is not None:
        bsdf = bsdf.assign_coords(wavelength=body.wavelength)
    bsdf = _with_balance(bsdf, sheets)
    warnings = list(body.warnings)
    for side, facets, surface, given in zip(SIDES, faces, surfaces, (front, back), strict=True):
        bsdf.attrs[f"{side}_band"] = facets.attrs["band"]
        if facets is not given:
            warnings += [text for text in vocabulary.warnings(facets) if text not in warnings]
        if surface is not None:
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


def _body(
    index: xr.Dataset | float | str,
    internal_transmittance: Spectral | None,
    absorption: Spectral | None,
    thickness: float | None,
) -> _Body:
    known = vocabulary.validate(index, "index") if isinstance(index, xr.Dataset) else refractive_index(index)
    if np.any(known["k"].values > 0):
        raise ModelError(
            f"the index of the slab absorbs (k up to {float(known['k'].max()):g}); give a real index, and the absorption apart"
        )
    inside, wavelength = _transmittance(internal_transmittance, absorption, thickness)
    n, _, wavelength, warnings = index_on(known, wavelength)
    return _Body(np.asarray(n), inside, wavelength, warnings)


def _transmittance(
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


def _depth_nodes(transmittance: Array) -> Array:
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


def _with_balance(bsdf: xr.Dataset, sheets: list[adding_doubling.Sheet]) -> xr.Dataset:
    """Add reflectance, transmittance, absorptance, their specular parts, and the factors of the outer diffuse reflection."""
    n, inside = (np.atleast_1d(bsdf[name].values) for name in ("n", "internal_transmittance"))
    by_index = lagrange(bsdf["index_node"].values, n)
    distinct, where = np.unique(inside, return_inverse=True)
    by_node = np.array([[_fluxes(pair, float(tau)) for tau in distinct] for pair in sheets])[:, where]
    # Index, transmittance, or both may depend on wavelength.
    fluxes = np.moveaxis((by_index.T[:, :, None, None] * by_node).sum(axis=0), 0, -1)
    diffuse = np.stack([[pair.front.diffuse, pair.back.diffuse] for pair in sheets], axis=-1) @ by_index.T
    outside = sheets[0].nodes.outside
    fields = {name: _variable("theta_i", values) for name, values in zip(BALANCE, fluxes, strict=True)}
    fields |= {f"{side}_diffuse": _variable("theta", values) for side, values in zip(SIDES, diffuse, strict=True)}
    return bsdf.assign_coords(theta=outside, theta_i=np.concatenate([outside, 180 - outside[::-1]])).assign(fields)


def _variable(angle: str, values: Array) -> tuple[tuple[str, ...], Array]:
    """Values, (angles, wavelength or 1), as a variable."""
    return ((angle,), values[:, 0]) if values.shape[1] == 1 else ((angle, "wavelength"), values)


def _fluxes(pair: adding_doubling.Sheet, transmittance: float) -> Array:
    """The fluxes of ``BALANCE``, (5, 2N), from the front and then the back."""
    straight = adding_doubling.straight(pair, transmittance)
    front, back = (
        np.stack([*balance, inner + (0.0 if face.total_loss > 0 else face.reflected), straight.through])
        for balance, face, inner in zip(
            adding_doubling.balances(pair, transmittance),
            (pair.front, pair.back),
            (straight.front, straight.back),
            strict=True,
        )
    )
    return np.concatenate([front, back[:, ::-1]], axis=1)


def _warnings(
    surfaces: tuple[Microsurface | None, Microsurface | None], index: float, resolved: Resolution, error: float
) -> list[str]:
    texts = []
    for side, surface, (through, within) in zip(SIDES, surfaces, resolved.sharp, strict=True):
        if surface is None or not (through or within):
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
