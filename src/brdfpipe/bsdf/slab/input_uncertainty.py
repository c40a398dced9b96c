"""The changes of a clear sheet that the uncertainties of its inputs make.

Each independent change of an input by one standard uncertainty changes a face, the index or the internal transmittance. The sheet is
computed with and without it by fewer nodes; the differences of its shares, and of the logarithm of the light that has been inside,
change the given one (:mod:`brdfpipe.bsdf.source_changes`). The logarithms are of a coarser grid, because what changes them varies
little within a lobe. Fewer nodes err by up to 2e-5 of the light, which is 4 % of the 2e-4 by which uncertain facets of slope 0.2 on a
smooth back change the albedo. A change of faces is computed at the mean index; one of waves at three of the wavelengths of the table.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.bsdf.change_variables import MODEL, MODEL_INCIDENCES, NOT_STATED, between_incidences, between_phases
from brdfpipe.bsdf.input_uncertainty import (
    MIDDLE_WAVELENGTH,
    Change,
    Fields,
    changes_of_facets,
    changes_of_index,
    changes_of_roughness,
    of_lobes,
    stacked,
)
from brdfpipe.bsdf.microfacet.builder import index_on
from brdfpipe.bsdf.microfacet.microsurface import Microsurface
from brdfpipe.bsdf.microfacet.phase_variance import unresolved_rms_height
from brdfpipe.bsdf.representations.slab import BALANCE, SHIFT_DIMS, SIDES, lagrange, node_weights
from brdfpipe.bsdf.slab.builder import Operators
from brdfpipe.bsdf.slab.lobe_table import LobeGrid, barycentric
from brdfpipe.bsdf.slab.tabulation import Resolution, Surface, resolution, sheet, tabulate
from brdfpipe.bsdf.slab.wave_face import WaveSurface
from brdfpipe.bsdf.wave.halo import Halo
from brdfpipe.facets.density_changes import CHANGES
from brdfpipe.facets.facet_dataset import azimuthal_average
from brdfpipe.geometry import Array
from brdfpipe.optics.fresnel_equations import fresnel

TRANSMITTANCE = "transmittance"
"""Source of the internal transmittance."""

_LEAST_FACET_SHARE = 1e-3
_MOST_WAVELENGTHS = 3
_STEP = 0.01
"""Relative step of the internal transmittance over which shares are differenced"""


class _Inputs(NamedTuple):
    """What is known of one face; a smooth one has no slopes."""

    facets: xr.Dataset
    psd: xr.Dataset | None


def uncertainty(
    bsdf: xr.Dataset,
    *,
    facets: xr.Dataset,
    back_facets: xr.Dataset | None = None,
    psd: xr.Dataset | None = None,
    back_psd: xr.Dataset | None = None,
    index: xr.Dataset,
    interior: xr.Dataset | None = None,
) -> xr.Dataset:
    """Changes of a clear sheet by the uncertainties of its inputs.

    Parameters
    ----------
    bsdf : kind ``bsdf`` of representation ``slab``, built from the inputs
    facets, back_facets : kind ``facets`` of the front and the back face; without the second, the first is that of both, whose errors
        are then the same. ``slope_density_change`` are the changes of sources ``facets`` and ``noise``
    psd, back_psd : kind ``psd``; the uncertainty of the spectrum is that of faces with waves
    index : kind ``index``; ``n_u`` is common to all wavelengths
    interior : kind ``interior``; ``internal_transmittance_u`` is common to all wavelengths

    Returns
    -------
    Dataset of kind ``uncertainty``, as of :func:`brdfpipe.bsdf.input_uncertainty.uncertainty`. The attribute ``uncertainty_not_stated``
    names the inputs whose uncertainty is not known: none is assumed

    Raises
    ------
    VocabularyError : a dataset of the wrong kind.
    """
    vocabulary.validate(bsdf, "bsdf")
    vocabulary.validate(index, "index")
    common = back_facets is None
    given = [_Inputs(azimuthal_average(vocabulary.validate(facets, "facets")), psd)]
    if back_facets is not None:
        given.append(_Inputs(azimuthal_average(vocabulary.validate(back_facets, "facets")), back_psd))
    sides = [_inputs_of_side(bsdf, side, given[0 if common else k], index) for k, side in enumerate(SIDES)]
    surfaces = (sides[0], sides[0]) if common else (sides[0], sides[1])
    changes: list[Change] = []
    if _is_uncertain(given, index, interior):
        changes = list(_changes(bsdf, surfaces, given, index, interior))
    stated = {change.source for change in changes}
    missing = [name for name in _expected(given, surfaces) if name not in stated]
    result = stacked(changes)
    if "log_shift_change" in result:
        grid = _grid_of(bsdf)
        result = result.assign_coords(shift_low=grid.low)
    unresolved = [unresolved_rms_height(one.psd) for one in given]
    if any(unresolved):
        result = result.assign(_of_finer_roughness(bsdf, unresolved[0], unresolved[-1]))
    return vocabulary.label(result.assign_attrs({NOT_STATED: ", ".join(missing)}), "uncertainty")


def _of_finer_roughness(bsdf: xr.Dataset, front: float, back: float) -> Fields:
    """Error of the light in the lobes of both sides, where a plateau of the spectrum of a face may be roughness of an rms height [um], finer than the scan.

    As of an opaque body it takes 1 − e^(−g) of the light at 550 nm, and scatters it so far that the rest is taken as unchanged. Light that passes
    a face has g = (2πσ(n cos θ' − cos θ)/λ)², that reflected outside (4πσ cos θ/λ)², and inside (4πσ n cos θ'/λ)².
    """
    n = float(bsdf["n"].mean())
    cosine = np.cos(np.radians(MODEL_INCIDENCES))
    inside = np.sqrt(n**2 - 1 + cosine**2)
    wave_number = 2 * np.pi / MIDDLE_WAVELENGTH
    of_front, of_back = (np.square(wave_number * sigma * (inside - cosine)) for sigma in (front, back))
    fresnel_share = np.asarray(fresnel(cosine, n, 0.0).mean)
    body = float(bsdf["internal_transmittance"].mean()) ** (n / inside)
    # The light that each face returns as if both were smooth.
    first, second = fresnel_share, (1 - fresnel_share) ** 2 * body**2 * fresnel_share

    def reflected(lit: float, other: float, of_lit: Array) -> Array:
        outer, inner = (wave_number * 2 * lit * cosine) ** 2, 2 * of_lit + (wave_number * 2 * other * inside) ** 2
        return np.asarray((first * -np.expm1(-outer) + second * -np.expm1(-inner)) / (first + second))

    passed = -np.expm1(-(of_front + of_back))
    both_sides = np.append(MODEL_INCIDENCES, 180 - MODEL_INCIDENCES[::-1])
    errors = np.append(reflected(front, back, of_front), reflected(back, front, of_back)[::-1])
    return {
        "relative_error": of_lobes(errors, both_sides),
        "transmitted_loss": of_lobes(np.append(passed, passed[::-1]), both_sides),
    }


def _is_uncertain(given: list[_Inputs], index: xr.Dataset, interior: xr.Dataset | None) -> bool:
    return (
        any(CHANGES in one.facets or one.psd is not None for one in given)
        or "n_u" in index
        or (interior is not None and "internal_transmittance_u" in interior)
    )


def _expected(given: list[_Inputs], surfaces: tuple[Surface, Surface]) -> Iterator[str]:
    """Sources that such a sheet has; no reference solution tells the error of its model."""
    if any(one.facets["slope_density"].size for one in given):
        yield "facets"
    if any(isinstance(surface, WaveSurface) for surface in surfaces):
        yield "psd"
    yield "index"
    yield TRANSMITTANCE
    if any(surface is not None for surface in surfaces):
        yield MODEL


def _inputs_of_side(bsdf: xr.Dataset, side: str, given: _Inputs, index: xr.Dataset) -> Surface:
    """The face that the sheet was built of: facets, waves where the sheet has some, or smooth."""
    if given.facets["slope_density"].size == 0:
        return None
    prefix = f"{side}_wave_"
    if not any(str(name).startswith(prefix) for name in bsdf.variables):
        return Microsurface.of(given.facets)
    assert given.psd is not None
    optics = str(bsdf.attrs.get(f"{prefix}optics", "auto"))
    return WaveSurface.of(given.facets, given.psd, index, bsdf["wavelength"].values, optics)


def _grid_of(bsdf: xr.Dataset) -> LobeGrid:
    full = LobeGrid(bsdf["theta_low"].values, bsdf.sizes["span"], bsdf.sizes["turn"], float(bsdf["lobe_scale"]))
    return full.coarser()


# --- a sheet by fewer nodes


@dataclass(frozen=True)
class _Solution:
    """A sheet at nodes of index or wavelength and of internal transmittance, (nodes, …)."""

    table: Array
    """(4, X, T, V, nodes) logarithm of the light that has been inside"""
    fluxes: Array
    """(nodes, 5, 2N) the fluxes of ``BALANCE``"""
    diffuse: Array
    """(nodes, 2, N) factors of the outer diffuse reflection"""
    outside: Array
    """(N,) polar angles [degree]"""


@dataclass(frozen=True)
class _CoarseSheet:
    """How a sheet and its changes are computed: alike, so that the errors of the nodes cancel."""

    bsdf: xr.Dataset
    masking: str
    resolved: Resolution
    grid: LobeGrid
    index: Array
    """(nodes,) of the index or of the wavelength"""
    wavelength: Array
    """(nodes,) [nm]; NaN without waves"""

    @classmethod
    def of(cls, bsdf: xr.Dataset, surfaces: tuple[Surface, Surface], index: xr.Dataset) -> _CoarseSheet:
        """Of the faces of a sheet."""
        if "wavelength_node" in bsdf.coords:
            nodes = bsdf["wavelength_node"].values
            kept = np.unique(np.linspace(0, nodes.size - 1, min(nodes.size, _MOST_WAVELENGTHS)).round().astype(int))
            wavelength = nodes[kept]
            n = np.broadcast_to(index_on(index, wavelength)[0], wavelength.shape)
        else:
            n, wavelength = np.array([float(bsdf["n"].mean())]), np.full(1, np.nan)
        resolved = resolution(surfaces, float(n.min()), wavelength)
        if surfaces != (None, None):
            resolved = resolved.coarser()
        return cls(bsdf, str(bsdf.attrs["masking"]), resolved, _grid_of(bsdf), n, wavelength)

    def solved(self, surfaces: tuple[Surface, Surface], more_index: float = 0.0, factor: float = 1.0) -> _Solution:
        """The sheet of given faces, with another index, and with the internal transmittances times a factor."""
        inside = np.minimum(np.exp(-(self.bsdf["depth_node"].values ** 2)) * factor, 1.0)
        smooth = (surfaces[0] is None, surfaces[1] is None)
        tables, fluxes, diffuse, outside = [], [], [], np.empty(0)
        for n, nm in zip(self.index + more_index, self.wavelength, strict=True):
            pair = sheet(surfaces, self.masking, float(n), self.resolved, float(nm))
            tables.append(tabulate(pair, smooth, inside, self.resolved.modes, self.grid)[0])
            operators = Operators.of(pair, inside)
            of_faces = operators.fluxes[:, :5].copy()
            of_faces[:, 3] += operators.fluxes[:, 5]
            fluxes.append(of_faces)
            diffuse.append(np.broadcast_to(operators.diffuse.T, (inside.size, *operators.diffuse.T.shape)))
            outside = operators.outside
        return _Solution(np.concatenate(tables, axis=-1), np.concatenate(fluxes), np.concatenate(diffuse), outside)

    @property
    def _to_nodes(self) -> Array:
        """Matrix (nodes of the dataset, nodes here)."""
        depths = self.bsdf.sizes["depth_node"]
        if "wavelength_node" in self.bsdf.coords:
            first = lagrange(self.wavelength**-2.0, self.bsdf["wavelength_node"].values ** -2.0)
        else:
            first = np.ones((self.bsdf.sizes["index_node"], 1))
        return np.asarray(np.kron(first, np.eye(depths)), dtype=float)

    def differences(self, given: _Solution, changed: _Solution, *, with_table: bool = True) -> Fields:
        """Changes of the variables of the sheet."""
        bsdf, to_nodes = self.bsdf, self._to_nodes
        by_wavelength = node_weights(bsdf, None)[1] @ to_nodes
        between = barycentric(given.outside, bsdf["theta"].values)
        fluxes = np.tensordot(by_wavelength, changed.fluxes - given.fluxes, 1)
        front, back = fluxes[..., : given.outside.size], fluxes[..., given.outside.size :][..., ::-1]
        fluxes = np.concatenate([front @ between.T, (back @ between.T)[..., ::-1]], axis=-1)
        diffuse = np.tensordot(by_wavelength, changed.diffuse - given.diffuse, 1) @ between.T
        names = [*BALANCE, *(f"{side}_diffuse" for side in SIDES)]
        values = [*np.moveaxis(fluxes, 1, 0), *np.moveaxis(diffuse, 1, 0)]
        fields = {name: _like(bsdf[name], value) for name, value in zip(names, values, strict=True)}
        if with_table:
            shift = (changed.table - given.table) @ to_nodes.T
            fields["log_shift"] = xr.DataArray(shift.astype(np.float32), dims=SHIFT_DIMS)
        return fields


def _like(given: xr.DataArray, change: Array) -> xr.DataArray:
    """A change (wavelength or 1, angles) with the dimensions of what it changes."""
    if "wavelength" not in given.dims:
        return xr.DataArray(change.mean(axis=0), dims=given.dims)
    return xr.DataArray(np.broadcast_to(change.T, given.shape), dims=given.dims)


# --- changes


def _changes(
    bsdf: xr.Dataset,
    surfaces: tuple[Surface, Surface],
    given: list[_Inputs],
    index: xr.Dataset,
    interior: xr.Dataset | None,
) -> Iterator[Change]:
    coarse = _CoarseSheet.of(bsdf, surfaces, index)
    before = coarse.solved(surfaces)
    for number, inputs in enumerate(given):
        surface = surfaces[number]
        for source, changed, of_face in _of_a_face(surface, inputs, bsdf):
            sides = SIDES if len(given) == 1 else SIDES[number : number + 1]
            both = (changed, changed) if len(given) == 1 else _replaced(surfaces, number, changed)
            fields = coarse.differences(before, coarse.solved(both))
            for side in sides:
                fields |= _of_outer_reflection(bsdf, side, changed, of_face)
            yield Change(source, fields)
    if "n_u" in index:
        u = float(index["n_u"].mean())
        # Where the table has several nodes of the index, its interpolation follows it.
        alone = bsdf.sizes.get("index_node", 1) == 1
        denser = _of_denser_body(surfaces[0], u), _of_denser_body(surfaces[1], u)
        fields = coarse.differences(before, coarse.solved(denser, more_index=u), with_table=alone)
        fields |= {
            name: xr.full_like(bsdf[name], u).drop_vars("wavelength", errors="ignore") for name in _indices(bsdf)
        }
        yield Change("index", fields)
    if interior is not None and "internal_transmittance_u" in interior:
        yield Change(TRANSMITTANCE, _of_transmittance(coarse, before, surfaces, interior))


def _of_denser_body(surface: Surface, more_index: float) -> Surface:
    """A face of a body whose index is larger.

    The outer reflection of waves, or of the facets that take their place, has an index and tables of the light of its own.
    """
    if not isinstance(surface, WaveSurface):
        return surface
    outside = surface.outside
    fields = changes_of_index(outside, xr.full_like(outside["n"], more_index).drop_vars("wavelength", errors="ignore"))
    of_table = fields.pop("directional_albedo")
    change = between_incidences(of_table["change_theta"].values, of_table.values, outside["theta_i"].values)
    fields["directional_albedo"] = xr.DataArray(change, dims=("theta_i", *of_table.dims[1:]))
    return surface._replace(outside=_changed(outside, fields))


def _replaced(surfaces: tuple[Surface, Surface], number: int, changed: Surface) -> tuple[Surface, Surface]:
    return (changed, surfaces[1]) if number == 0 else (surfaces[0], changed)


def _indices(bsdf: xr.Dataset) -> list[str]:
    """Indices of the body and of the outer reflection of faces with waves."""
    return [name for name in ("n", "front_wave_n", "back_wave_n") if name in bsdf]


def _of_transmittance(
    coarse: _CoarseSheet, before: _Solution, surfaces: tuple[Surface, Surface], interior: xr.Dataset
) -> Fields:
    """Less light that crosses the sheet, by the derivative over the logarithm of the internal transmittance."""
    bsdf = coarse.bsdf
    inside = bsdf["internal_transmittance"]
    u = xr.full_like(inside, float(interior["internal_transmittance_u"].mean()))
    by_share = coarse.differences(before, coarse.solved(surfaces, factor=1 - _STEP))
    scale = u / np.maximum(inside, _STEP) / _STEP
    fields = {name: change * _along(scale, change) for name, change in by_share.items() if name in BALANCE}
    shift = by_share["log_shift"] * float(scale.mean())
    if bsdf.sizes["depth_node"] > 1:
        return fields | {"internal_transmittance": xr.DataArray(-u.values, dims=u.dims)}
    return fields | {"log_shift": shift}


def _along(scale: xr.DataArray, change: xr.DataArray) -> Array | float:
    """A factor over wavelength for a change (angles, wavelength), or its mean for one (angles,)."""
    return np.asarray(scale.values) if "wavelength" in change.dims and scale.ndim else float(scale.mean())


def _of_a_face(surface: Surface, inputs: _Inputs, bsdf: xr.Dataset) -> Iterator[tuple[str, Surface, Fields]]:
    """Source, changed face, and change of the variables of a face of facets, for each change of its inputs."""
    facets, psd = inputs
    if surface is None:
        return
    of_facets = list(changes_of_facets(facets, facets)) if CHANGES in facets and _has_facets(surface, bsdf) else []
    if not isinstance(surface, WaveSurface):
        yield from ((source, _with_facets(facets, fields), fields) for source, fields in of_facets)
        return
    inner = list(changes_of_roughness(surface.table, psd)) if psd is not None else []
    # Light that passes knows the spectrum alone: with it, what is reflected coherently changes band by band.
    alone = None if psd is None else psd.drop_vars(["coherent_sigma", "coherent_sigma_u"], errors="ignore")
    outer = list(changes_of_roughness(surface.outside, alone)) if alone is not None else []
    noise = [fields for source, fields in of_facets if source == "noise"]
    for number, (source, of_table) in enumerate(inner):
        table, outside = _changed(surface.table, of_table), surface.outside
        outside = _changed(outside, outer[number][1]) if outer else outside
        changed = surface._replace(table=table, halo=Halo.of(table), outside=outside)
        if source == "noise" and noise:
            # The noise of the heights is one: that of the facets and the first of the spectrum change together.
            of_noise = noise.pop()
            changed = changed._replace(facets=_with_facets(facets, of_noise), outside=_outer_facets(outside, of_noise))
        yield source, changed, {}
    together = any(source == "noise" for source, _ in inner)
    for source, fields in of_facets:
        if source != "noise" or not together:
            outside = _outer_facets(surface.outside, fields)
            yield source, surface._replace(facets=_with_facets(facets, fields), outside=outside), {}


def _with_facets(facets: xr.Dataset, fields: Fields) -> Microsurface:
    return Microsurface.of(_changed(facets, fields))


def _has_facets(surface: Surface, bsdf: xr.Dataset) -> bool:
    """Whether the facets of a face matter: for a face with waves, where its roughness is great."""
    if not isinstance(surface, WaveSurface):
        return True
    shortest = float(bsdf["wavelength"].values[0])
    change = np.array([float(bsdf["n"].max()) - 1, 2 * float(bsdf["n"].max())])
    return bool((surface.facet_share(change, np.ones(2), shortest) > _LEAST_FACET_SHARE).any())


def _changed(dataset: xr.Dataset, fields: Fields) -> xr.Dataset:
    changed = {
        name: dataset[name].copy(data=dataset[name].values + _values(dataset, change))
        for name, change in fields.items()
    }
    return dataset.assign(changed)


def _values(dataset: xr.Dataset, change: xr.DataArray) -> Array:
    """A change of a variable of a dataset; of a halo it is known at some phase variances."""
    if "change_phase" not in change.dims:
        return np.asarray(change.values)
    return between_phases(change["change_phase"].values, change.values, dataset["phase_variance"].values)


def _outer_facets(outside: xr.Dataset, fields: Fields) -> xr.Dataset:
    """The light that a face with waves reflects outside, if it is partly that of its facets."""
    known = {name: change for name, change in fields.items() if name in outside and outside[name].shape == change.shape}
    return _changed(outside, known) if len(known) == len(fields) else outside


def _of_outer_reflection(bsdf: xr.Dataset, side: str, changed: Surface, of_face: Fields) -> Fields:
    """Changes of the variables from which the light is evaluated that a face reflects outside."""
    if not isinstance(changed, WaveSurface):
        return {
            f"{side}_{name}": xr.DataArray(change.values, dims=bsdf[f"{side}_{name}"].dims)
            for name, change in of_face.items()
        }
    fields = {}
    for name in ("sigma", "log_halo", "slope_density", "lambda_smith"):
        own = f"{side}_wave_{name}"
        if own in bsdf and changed.outside[name].shape == bsdf[own].shape:
            change = changed.outside[name].values - bsdf[own].values
            if np.any(change):
                fields[own] = xr.DataArray(change, dims=bsdf[own].dims)
    return fields
