"""A plane-parallel sheet in air: two rough or smooth faces, and an internal transmittance between them.

Adding–doubling: each face is an operator between polar angles, in Fourier modes of the azimuth, and all reflections to and fro are
summed by solving a linear system. What a face reflects at once is evaluated by its facets themselves, so that gloss is as sharp
as it is; only what has been inside is tabulated.

References
----------
Patent US 9,395,299 (CRF), "combination of the BTDF of the two surfaces"; van de Hulst 1980, Multiple Light Scattering, §4;
Walter 2007 (EGSR) for the faces; Kulla & Conty 2017 (SIGGRAPH course) for the light their facets lose.
"""

from __future__ import annotations

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.bsdf.microfacet.microsurface import Microsurface, ModelError
from brdfpipe.bsdf.representations.slab import Slab
from brdfpipe.bsdf.slab import adding_doubling
from brdfpipe.bsdf.slab.body import Body, Spectral, lagrange
from brdfpipe.bsdf.slab.lobe_table import LobeGrid
from brdfpipe.bsdf.slab.model import SIDES
from brdfpipe.bsdf.slab.tabulation import Resolution, resolution, sheet, tabulate
from brdfpipe.facets.facet_dataset import azimuthal_average
from brdfpipe.geometry import Array

MASKING = ("height-correlated", "separable")
"""Masking modes that keep energy and reciprocity through an interface."""

ERROR_LIMIT = 0.02
"""Error of the interpolation above which a slab warns [1]."""

_BALANCE = ("reflectance", "transmittance", "absorptance", "specular_reflectance", "specular_transmittance")


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
    front, back : kind ``facets``, each seen from the air before it; perfectly smooth faces are :func:`brdfpipe.facets.flat`.
        A lay is averaged over azimuth, with a warning
    index : kind ``index``, a number or a plastic's name
    internal_transmittance : share of the light that crosses the sheet at normal incidence from face to face, 0 to 1 [1]; a
        number, or a DataArray over ``wavelength``. 1 by default
    absorption, thickness : instead of it, the (napierian) absorption coefficient [mm-1], a number or a DataArray over
        ``wavelength``, and the thickness [mm]
    masking : one of :data:`MASKING`

    Returns
    -------
    Dataset of kind ``bsdf``, representation ``slab``. Light comes from the front for θ_i < 90 degree and from the back for
    θ_i > 90, and leaves likewise. Perfectly specular parts are shares of the light, ``specular_reflectance(theta_i)`` and
    ``specular_transmittance(theta_i)``; ``reflectance``, ``transmittance`` and ``absorptance`` hold all of it and sum to 1

    Raises
    ------
    ModelError : an unknown masking, an absorbing index, or a transmittance, absorption or thickness out of range.
    VocabularyError : a dataset of the wrong kind.

    Notes
    -----
    What the facets' model loses of the light it gives back diffusely on both sides (:func:`brdfpipe.bsdf.slab.face.rough`): energy closes
    to rounding. Lobes narrower than :data:`brdfpipe.bsdf.slab.tabulation.NARROWEST_THROUGH` are carried as specular inside and behind the
    sheet, with a warning; how much light they hold stays exact. ``interpolation_error`` states the error between the nodes,
    ``quadrature_error`` by how much the operators of the faces were scaled to keep energy.
    """
    if masking not in MASKING:
        raise ModelError(f"masking {masking!r} does not keep energy through a slab; accepted: {', '.join(MASKING)}")
    faces = [azimuthal_average(vocabulary.validate(each, "facets")) for each in (front, back)]
    surfaces = _surfaces(front, back, faces)
    body = Body.of(index, internal_transmittance, absorption, thickness)
    resolved = resolution(surfaces, float(body.n.min()))
    index_node, depth_node = body.index_nodes(), body.depth_nodes()
    sheets = [sheet(surfaces, masking, float(each), resolved) for each in index_node]
    grid = LobeGrid.of(float(np.degrees(resolved.scale)))
    table, error = tabulate(
        sheets, (surfaces[0] is None, surfaces[1] is None), np.exp(-(depth_node**2)), resolved.modes, grid
    )
    bsdf = xr.Dataset(
        {
            "n": (("wavelength",) * body.n.ndim, body.n),
            "internal_transmittance": (("wavelength",) * body.transmittance.ndim, body.transmittance),
            "log_scattered": (("path", "theta_low", "span", "turn", "node"), table),
            "lobe_scale": grid.scale,
            "interpolation_error": error,
            "quadrature_error": max(each.correction for pair in sheets for each in (pair.front, pair.back)),
        },
        coords={"theta_low": grid.low, "index_node": index_node, "depth_node": depth_node},
        attrs={"representation": Slab.name, "masking": masking, "transmission": "slab"},
    )
    if body.wavelength is not None:
        bsdf = bsdf.assign_coords(wavelength=body.wavelength)
    bsdf = _with_balance(bsdf, sheets)
    for name, each, surface in zip(SIDES, faces, surfaces, strict=True):
        bsdf.attrs[f"{name}_band"] = each.attrs["band"]
        bsdf = bsdf if surface is None else _with_face(bsdf, name, each)
    averaged = [each for each, given in zip(faces, (front, back), strict=True) if each is not given]
    inherited = dict.fromkeys(text for each in averaged for text in vocabulary.warnings(each))
    texts = [*body.held, *inherited, *_warnings(surfaces, float(body.n.mean()), resolved, error)]
    return vocabulary.label(vocabulary.add_warning(bsdf, *texts), "bsdf")


# --- what was given


def _surfaces(
    front: xr.Dataset, back: xr.Dataset, faces: list[xr.Dataset]
) -> tuple[Microsurface | None, Microsurface | None]:
    surfaces = [Microsurface.of(each) if each["slope_density"].size else None for each in faces]
    # One finish on both faces is worked out once.
    alike = front is back or front.drop_attrs().identical(back.drop_attrs())
    return surfaces[0], surfaces[0] if alike else surfaces[1]


# --- what is kept


def _with_face(bsdf: xr.Dataset, name: str, facets: xr.Dataset) -> xr.Dataset:
    slope, theta = f"{name}_slope", f"{name}_theta"
    return bsdf.assign_coords({slope: facets["slope"].values, theta: facets["theta"].values}).assign(
        {
            f"{name}_slope_density": (slope, facets["slope_density"].values),
            f"{name}_lambda_smith": (theta, facets["lambda_smith"].values),
        }
    )


def _with_balance(bsdf: xr.Dataset, sheets: list[adding_doubling.Sheet]) -> xr.Dataset:
    """Add where the light goes, its specular parts, and what the faces return diffusely, at the nodes of the quadrature."""
    n, inside = (np.atleast_1d(bsdf[name].values) for name in ("n", "internal_transmittance"))
    by_index = lagrange(bsdf["index_node"].values, n)
    distinct, where = np.unique(inside, return_inverse=True)
    by_node = np.array([[_shares(each, float(t)) for t in distinct] for each in sheets])[:, where]
    # Either, or both, of index and transmittance may depend on wavelength.
    shares = np.moveaxis((by_index.T[:, :, None, None] * by_node).sum(axis=0), 0, -1)
    diffuse = np.stack([[each.front.diffuse, each.back.diffuse] for each in sheets], axis=-1) @ by_index.T
    outside = sheets[0].nodes.outside
    fields = {name: _field("theta_i", values) for name, values in zip(_BALANCE, shares, strict=True)}
    fields |= {f"{name}_diffuse": _field("theta", values) for name, values in zip(SIDES, diffuse, strict=True)}
    return bsdf.assign_coords(theta=outside, theta_i=np.concatenate([outside, 180 - outside[::-1]])).assign(fields)


def _field(angle: str, values: Array) -> tuple[tuple[str, ...], Array]:
    """Values, (angles, wavelength or 1), as a variable."""
    return ((angle,), values[:, 0]) if values.shape[1] == 1 else ((angle, "wavelength"), values)


def _shares(each: adding_doubling.Sheet, transmittance: float) -> Array:
    """Reflected, transmitted, absorbed, mirrored and straight shares, (5, 2N) from the front and then the back."""
    sharp = adding_doubling.straight(each, transmittance)
    sides = []
    for balance, lit, rough, inner in zip(
        adding_doubling.balances(each, transmittance),
        (each.front, each.back),
        (each.front.total_loss > 0, each.back.total_loss > 0),
        (sharp.front, sharp.back),
        strict=True,
    ):
        mirrored = inner + (0.0 if rough else lit.reflected)
        sides.append(np.stack([*balance, mirrored, sharp.through]))
    return np.concatenate([sides[0], sides[1][:, ::-1]], axis=1)


def _warnings(
    surfaces: tuple[Microsurface | None, Microsurface | None], index: float, resolved: Resolution, error: float
) -> list[str]:
    texts = []
    for name, surface, (through, within) in zip(SIDES, surfaces, resolved.sharp, strict=True):
        if surface is None or not (through or within):
            continue
        width = np.degrees((index - 1) * surface.median_slope)
        texts.append(
            f"the lobe that the {name} face transmits is some {width:.2g}° wide, less than a slab resolves, and is carried as specular "
            "inside and behind the sheet: reflectance and transmittance hold, angles near the straight direction do not; take the "
            "face for smooth (facets.flat) or evaluate it alone as a transparent interface"
        )
    if error > ERROR_LIMIT:
        texts.append(
            f"what has been inside the slab is interpolated with an error of {error:.1%} of the flux in the worst incidence; "
            "integrate with `albedo` and `transmittance`, which do not interpolate, where that matters"
        )
    return texts
