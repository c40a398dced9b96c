"""All representations of a BSDF, and the representation of a dataset, cached because it may compute tables."""

from __future__ import annotations

import weakref
from collections.abc import Hashable, Mapping
from operator import is_
from typing import NamedTuple

import xarray as xr

from brdfpipe.bsdf.base import Representation
from brdfpipe.bsdf.representations.coated import Coated
from brdfpipe.bsdf.representations.flake import Flake
from brdfpipe.bsdf.representations.kirchhoff import Kirchhoff
from brdfpipe.bsdf.representations.lambert_gauss import LambertGauss
from brdfpipe.bsdf.representations.measured import Measured
from brdfpipe.bsdf.representations.microfacet import Microfacet, Smooth
from brdfpipe.bsdf.representations.slab import Slab
from brdfpipe.bsdf.representations.table import Table
from brdfpipe.bsdf.representations.traced import Traced
from brdfpipe.bsdf.representations.wave import Wave
from brdfpipe.errors import VocabularyError

REPRESENTATIONS: dict[str, type[Representation]] = {
    kind.name: kind
    for kind in (Coated, Flake, Kirchhoff, LambertGauss, Measured, Microfacet, Slab, Smooth, Table, Traced, Wave)
}
"""Class by value of the attribute ``representation``."""


class _CachedRepresentation(NamedTuple):
    dataset: weakref.ref[xr.Dataset]
    variables: Mapping[Hashable, object]
    attributes: Mapping[Hashable, object]
    representation: Representation


_CACHE: dict[int, _CachedRepresentation] = {}
"""By ``id`` of the dataset, which cannot be hashed; an entry is removed together with its dataset."""


def representation(bsdf: xr.Dataset) -> Representation:
    """The representation of a ``bsdf`` dataset, made at the first call and cached.

    Raises
    ------
    VocabularyError : the dataset has no representation, or an unknown one.

    Notes
    -----
    The same dataset object gives the same instance as long as its variables and attributes are the same objects. A copy gets
    a new one. Array elements that are changed in place are not noticed: treat datasets as immutable and use ``assign``.
    """
    key = id(bsdf)
    entry = _CACHE.get(key)
    if (
        entry is not None
        and entry.dataset() is bsdf
        and _same_objects(entry.variables, bsdf.variables.mapping)
        and _same_objects(entry.attributes, bsdf.attrs)
    ):
        return entry.representation
    name = bsdf.attrs.get("representation")
    if name not in REPRESENTATIONS:
        raise VocabularyError(f"unknown representation {name!r} of a BSDF; accepted: {', '.join(REPRESENTATIONS)}")

    def remove(reference: weakref.ref[xr.Dataset]) -> None:
        if key in _CACHE and _CACHE[key].dataset is reference:
            # What was derived from the representation may refer to it, and would keep both until cyclic garbage is collected.
            _CACHE.pop(key).representation.derived.clear()

    # The shallow copy shares the arrays; a reference to the dataset itself would keep it alive.
    made = REPRESENTATIONS[name](bsdf.copy())
    _CACHE[key] = _CachedRepresentation(weakref.ref(bsdf, remove), dict(bsdf.variables), dict(bsdf.attrs), made)
    return made


def _same_objects(one: Mapping[Hashable, object], other: Mapping[Hashable, object]) -> bool:
    return one.keys() == other.keys() and all(map(is_, one.values(), map(other.__getitem__, one)))
