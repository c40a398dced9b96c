"""The changes of a coated body that the uncertainties of its inputs make.

Each independent change of an input by one standard uncertainty changes a face, the index of the coat, its internal transmittance or the
spectrum. The coated body is computed with and without it by fewer nodes and at its mean indices; the differences change the given one
(:mod:`brdfpipe.bsdf.source_changes`). The light of the body is found anew with each change, so that the total reflectance stays that of the spectrum.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.bsdf.change_variables import MODEL, NOT_STATED
from brdfpipe.bsdf.input_uncertainty import Change, Fields, changes_of_facets, stacked
from brdfpipe.bsdf.representations.slab import TABLE_DIMS
from brdfpipe.bsdf.slab.builder import depth_nodes
from brdfpipe.bsdf.slab.coated import CoatedBody, Solution
from brdfpipe.bsdf.slab.input_uncertainty import TRANSMITTANCE
from brdfpipe.bsdf.slab.lobe_table import LobeGrid, barycentric
from brdfpipe.bsdf.slab.tabulation import Resolution
from brdfpipe.facets.density_changes import CHANGES
from brdfpipe.geometry import Array
from brdfpipe.optics.interior import spectral

BASE_FACETS = "base facets"
"""Source of the facets of the body below the coat."""

_OVER_THETA = ("faces_reflectance", "faces_specular", "body_share", "front_diffuse")
_OF_SPECTRUM = ("body_weight", "total_reflectance")
_OF_COAT = ("front_slope_density", "front_lambda_smith")
_LEAST_FACTOR = 1e-3
"""Least share of a transmittance that is left as it is lowered by its uncertainty."""


def uncertainty(
    bsdf: xr.Dataset,
    *,
    facets: xr.Dataset,
    base_facets: xr.Dataset | None = None,
    index: xr.Dataset,
    base_index: xr.Dataset,
    interior: xr.Dataset,
    spectrum: xr.Dataset | None = None,
) -> xr.Dataset:
    """Changes of a coated body by the uncertainties of its inputs.

    Parameters
    ----------
    bsdf : kind ``bsdf`` of representation ``coated``, built from the inputs
    facets, base_facets : kind ``facets`` of the coat and of the body below, smooth without; where both are one, their errors are the same.
        ``slope_density_change`` are the changes of sources ``facets`` and ``noise``
    index : kind ``index`` of the coat; ``n_u`` is common to all wavelengths
    base_index : the same of the body; its uncertainty is not known
    interior : kind ``interior``; ``internal_transmittance_u`` is common to all wavelengths
    spectrum : kind ``spectrum``; ``total_reflectance_u`` is common to all wavelengths

    Returns
    -------
    Dataset of kind ``uncertainty``, as of :func:`brdfpipe.bsdf.input_uncertainty.uncertainty`. The attribute ``uncertainty_not_stated``
    names the inputs whose uncertainty is not known: none is assumed

    Raises
    ------
    VocabularyError : a dataset of the wrong kind.
    """
    vocabulary.validate(bsdf, "bsdf")
    passed = spectral(interior)
    inside = (
        (passed.values, passed["wavelength"].values) if isinstance(passed, xr.DataArray) else (np.asarray(passed), None)
    )
    given = CoatedBody.of(
        facets,
        base_facets,
        coat_index=index,
        index=base_index,
        spectrum=spectrum,
        inside=inside,
        masking=str(bsdf.attrs["masking"]),
        wavelength=None if spectrum is not None else bsdf["wavelength"].values,
    )
    one_relief = facets is base_facets
    changes = list(_changes(_CoarseBody.of(bsdf, given), one_relief, index, interior))
    stated = {change.source for change in changes}
    missing = [name for name in _expected(given, one_relief) if name not in stated]
    return vocabulary.label(stacked(changes).assign_attrs({NOT_STATED: ", ".join(missing)}), "uncertainty")


def _expected(given: CoatedBody, one_relief: bool) -> Iterator[str]:
    """Sources that such a body has; no reference solution states the error of its model."""
    if given.surfaces[0] is not None:
        yield "facets"
    if given.surfaces[1] is not None and not one_relief:
        yield BASE_FACETS
    yield "index"
    yield "base index"
    yield TRANSMITTANCE
    if given.spectrum is not None:
        yield "spectrum"
    if given.surfaces != (None, None):
        yield MODEL


@dataclass(frozen=True)
class _CoarseBody:
    """A coated body by fewer nodes and at its mean indices, and how its changes are those of the given one."""

    bsdf: xr.Dataset
    """The given one"""
    body: CoatedBody
    depth: Array
    """Nodes of √(−ln τ) of its table"""
    resolved: Resolution
    grid: LobeGrid

    @classmethod
    def of(cls, bsdf: xr.Dataset, given: CoatedBody) -> _CoarseBody:
        """Of the inputs of a coated body."""
        n, n_base, k_base = (np.full_like(one, one.mean()) for one in (given.n, given.n_base, given.k_base))
        body = replace(given, n=n, n_base=n_base, k_base=k_base)
        resolved = body.resolution()
        if body.surfaces != (None, None):
            resolved = resolved.coarser()
        grid = LobeGrid(bsdf["theta_low"].values, bsdf.sizes["span"], bsdf.sizes["turn"], float(bsdf["lobe_scale"]))
        return cls(bsdf, body, depth_nodes(given.inside), resolved, grid)

    def solved(self, body: CoatedBody, factor: float = 1.0) -> Solution:
        """The light between the faces of other inputs, in a table at the transmittances of the nodes times a factor."""
        depth = self.depth if factor == 1.0 else np.sqrt(self.depth**2 - np.log(factor))
        return body.solved(body.wavelength[:1], depth, self.resolved, self.grid)

    def differences(self, before: xr.Dataset, after: xr.Dataset) -> Fields:
        """Changes of the variables of the given body."""
        fields: Fields = {}
        between = barycentric(before["theta"].values, self.bsdf["theta"].values)
        for name in _OVER_THETA:
            change = between @ (after[name] - before[name]).transpose("theta", "wavelength").values
            fields[name] = xr.DataArray(change, dims=("theta", "wavelength"))
        for name in (*_OF_SPECTRUM, *_OF_COAT, "n"):
            if name in self.bsdf:
                fields[name] = xr.DataArray(after[name].values - before[name].values, dims=self.bsdf[name].dims)
        table = after["log_scattered"].values - before["log_scattered"].values
        # The nodes of the given table are those of the depth at each of its wavelengths.
        wavelengths = self.bsdf.sizes["node"] // self.depth.size
        fields["log_scattered"] = xr.DataArray(np.tile(table, wavelengths).astype(np.float32), dims=TABLE_DIMS)
        return fields


def _changes(coarse: _CoarseBody, one_relief: bool, index: xr.Dataset, interior: xr.Dataset) -> Iterator[Change]:
    body = coarse.body
    if not (
        any(face is not None and CHANGES in face for face in body.faces)
        or "n_u" in index
        or "internal_transmittance_u" in interior
        or (body.spectrum is not None and "total_reflectance_u" in body.spectrum)
    ):
        return
    light = coarse.solved(body)
    before = body.dataset(light)

    def differences(changed: CoatedBody, factor: float = 1.0) -> Fields:
        return coarse.differences(before, changed.dataset(coarse.solved(changed, factor)))

    for number, name in enumerate(("facets", BASE_FACETS)):
        relief = body.faces[number]
        if relief is None or CHANGES not in relief or (one_relief and number == 1):
            continue
        for source, of_relief in changes_of_facets(relief, relief):
            changed = relief.assign({key: relief[key] + change for key, change in of_relief.items()})
            faces = (changed, changed if one_relief else body.faces[1]) if number == 0 else (body.faces[0], changed)
            yield Change(name if source == "facets" else source, differences(replace(body, faces=faces)))
    if "n_u" in index:
        yield Change("index", differences(replace(body, n=body.n + float(index["n_u"].mean()))))
    if "internal_transmittance_u" in interior:
        u, mean = float(interior["internal_transmittance_u"].mean()), float(body.inside.mean())
        # Less light passes: above 1 there is no transmittance.
        darker = replace(body, inside=np.clip(body.inside - u, 0.0, 1.0))
        factor = max(1 - u / max(mean, u), _LEAST_FACTOR) if u > 0 else 1.0
        yield Change(TRANSMITTANCE, differences(darker, factor))
    spectrum = body.spectrum
    if spectrum is not None and "total_reflectance_u" in spectrum:
        more = spectrum["total_reflectance"] + spectrum["total_reflectance_u"]
        brighter = replace(
            body, spectrum=spectrum.assign(total_reflectance=more.assign_attrs(spectrum["total_reflectance"].attrs))
        )
        yield Change("spectrum", coarse.differences(before, brighter.dataset(light)))
