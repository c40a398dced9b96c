"""The standard uncertainty of a BSDF in words, for files with comments and no place for the uncertainty of each value."""

from __future__ import annotations

from typing import cast

import numpy as np
import xarray as xr

from brdfpipe.bsdf.change_variables import NOT_STATED
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.one_side import Side
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.source_changes import SourceChanges, in_quadrature, uncertain
from brdfpipe.bsdf.table_error import fresh_pairs
from brdfpipe.geometry import Array

_MIRROR_AT = np.array([20.0, 45.0, 60.0])
"""Incidences at which the uncertainty in the mirror direction is stated [degree]."""
_SEED = 11
"""Of the directions over which it is stated; no table is chosen with it."""


def known_uncertainty(bsdf: xr.Dataset) -> bool:
    """Whether a BSDF has a standard uncertainty: of its uncertain inputs, or of its measurement."""
    return uncertain(bsdf) or representation(bsdf).states_uncertainty


def uncertainty_in_words(bsdf: xr.Dataset, side: Side) -> list[str]:
    """Relative standard uncertainty (k = 1) of the luminous BSDF: of reflection in the mirror direction, and over all directions of a side.

    Empty where no uncertainty is known, see :func:`known_uncertainty`. All formats of a BSDF say the same: it is kept with the representation.
    """
    if not known_uncertainty(bsdf):
        return []
    derived, key = representation(bsdf).derived, f"{__name__}, {side}"
    if key not in derived:
        derived[key] = _in_words(bsdf, side)
    return list(cast("list[str]", derived[key]))


def _in_words(bsdf: xr.Dataset, side: Side) -> list[str]:
    luminous = nonspectral(bsdf)
    changes = SourceChanges.of(luminous) if uncertain(luminous) else None
    model = representation(luminous) if changes is None else changes.given
    notes = []
    if side == "reflection":
        mirror = _MIRROR_AT, np.zeros_like(_MIRROR_AT), _MIRROR_AT, np.full_like(_MIRROR_AT, 180.0), None
        # One Jacobian gives all sources, where the variance would take another.
        u = (
            model.uncertainty(*mirror)[:, 0]
            if changes is None
            else in_quadrature(changes.by_source(changes.of_brdf(*mirror)[..., 0]))
        )
        relative = _relative(u, model.evaluate(*mirror)[:, 0])
        listed = " ".join(f"{angle:g}:{value:.4f}" for angle, value in zip(_MIRROR_AT, relative, strict=True))
        notes.append(
            f"relative standard uncertainty in the mirror direction, by theta_i in degree: {listed} ({_origin(luminous, changes)})"
        )
    pairs = fresh_pairs(luminous, _SEED, incidences=6, views=64)
    pairs = pairs.chosen((pairs.theta_o > 90) == (side == "transmission"))
    u = np.sqrt(changes.variance(*pairs, None)) if changes is not None else model.uncertainty(*pairs, None)
    relative = _relative(u[:, 0], model.evaluate(*pairs, None)[:, 0])
    low, middle, high = np.quantile(relative, [0.05, 0.5, 0.95])
    notes.append(
        f"relative standard uncertainty at {relative.size} directions, half of them where the light goes: median {middle:.4f}, nine tenths of them {low:.4f} to "
        f"{high:.4f}; of each direction in the dataset"
    )
    return notes


def _origin(luminous: xr.Dataset, changes: SourceChanges | None) -> str:
    if changes is None:
        return "from the measurement"
    missing = str(luminous.attrs.get(NOT_STATED, ""))
    unknown = f"; not known, and none assumed: {missing}" if missing else ""
    return f"from {' and '.join(dict.fromkeys(changes.sources))}{unknown}"


def _relative(u: Array, value: Array) -> Array:
    return np.divide(u, value, out=np.zeros_like(u), where=value > 0)
