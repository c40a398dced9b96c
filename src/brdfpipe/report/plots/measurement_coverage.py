"""Measurement coverage: which parts of a curve rest on measured directions, and the uncertainty of the others.

A BSDF from a model has no quality flags.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from brdfpipe import vocabulary
from brdfpipe.appearance.gloss_basis import MEASURED_FLAGS
from brdfpipe.bsdf.registry import representation
from brdfpipe.hemisphere import around_mirror
from brdfpipe.report.formatting import percent
from brdfpipe.report.plots import bsdf_sections
from brdfpipe.report.plots.bsdf_sections import Plane
from brdfpipe.report.plots.svg import Array, Line, with_neighbours

_TESTED_INCIDENCES = np.arange(0.0, 90.0)
"""Incidences at which the range of a measurement is determined [degree]."""

_DEFAULT_SLOPE = 0.1
"""Typical slope for representations that state none."""


def quality(
    bsdf: xr.Dataset, plane: Plane, incidence: ArrayLike, theta_o: ArrayLike, turn: ArrayLike
) -> NDArray[np.int8] | None:
    """Quality flags; arguments as for :func:`.bsdf_sections.value`. None for a BSDF from a model."""
    evaluator = representation(bsdf)
    if not evaluator.states_quality:
        return None
    return np.asarray(evaluator.quality(*bsdf_sections.directions(plane, incidence, theta_o, turn)), dtype=np.int8)


def at_mirror(
    bsdf: xr.Dataset, plane: Plane, incidence: ArrayLike, *, through: bool = False
) -> NDArray[np.int8] | None:
    """Quality flags in the mirror direction, or straight through the sample; None for a BSDF from a model."""
    theta_o = np.asarray(incidence, dtype=float)
    return quality(bsdf, plane, incidence, 180 - theta_o if through else theta_o, 0.0)


def known(flags: ArrayLike) -> NDArray[np.bool_]:
    """Whether flags are those of directions that were measured, or that are between measured ones."""
    return np.isin(flags, [vocabulary.quality(name) for name in MEASURED_FLAGS])


def split(line: Line, measured: NDArray[np.bool_]) -> tuple[Line, Line]:
    """A curve where it is known, and the rest of it dashed; the two parts meet."""
    value = np.asarray(line.y, dtype=float)
    solid, dashed = (np.where(part, value, np.nan) for part in (measured, with_neighbours(~measured)))
    return replace(line, y=solid), replace(line, y=dashed, pattern="dash")


# --- in words


def words(bsdf: xr.Dataset, plane: Plane, shown: Sequence[float], *, through: bool = False) -> str:
    """The incidences beyond which nothing was measured in the mirror direction, or straight on, and the uncertainty there."""
    unknown = _unknown(bsdf, plane, shown, through)
    uncertainty = ""
    if unknown.size and representation(bsdf).states_uncertainty:
        at = unknown, 180 - unknown if through else unknown
        u, value = _uncertainty(bsdf, plane, *at, 0.0), bsdf_sections.value(bsdf, plane, *at, 0.0)
        relative = np.divide(u, value, out=np.full_like(u, np.nan), where=value > 0)
        uncertainty = f" (standard uncertainty there: {_listed(unknown, relative)})"
    where = "straight on through the sample" if through else "in the mirror direction"
    return _sentence(bsdf, plane, where, through, uncertainty)


def reflectance_words(bsdf: xr.Dataset, plane: Plane, shown: Sequence[float]) -> str:
    """The same for the directional reflectance: the largest uncertainty, as if the errors of all directions were equal."""
    unknown = _unknown(bsdf, plane, shown, False)
    uncertainty = ""
    if unknown.size and representation(bsdf).states_uncertainty:
        largest = [_reflectance_uncertainty(bsdf, plane, angle) for angle in unknown.tolist()]
        uncertainty = f" (standard uncertainty of the reflectance there: at most {_listed(unknown, largest)})"
    return _sentence(bsdf, plane, "in the mirror direction", False, uncertainty)


def _unknown(bsdf: xr.Dataset, plane: Plane, shown: Sequence[float], through: bool) -> Array:
    theta = np.asarray(shown, dtype=float)
    flags = at_mirror(bsdf, plane, theta, through=through)
    return theta[:0] if flags is None else theta[~known(flags)]


def _sentence(bsdf: xr.Dataset, plane: Plane, where: str, through: bool, uncertainty: str) -> str:
    flags = at_mirror(bsdf, plane, _TESTED_INCIDENCES, through=through)
    if flags is None or known(flags).all():
        return ""
    measured = _TESTED_INCIDENCES[known(flags)]
    if not measured.size:
        return f" Nothing was measured {where} at any incidence{uncertainty}."
    ends = [f"below {measured[0]:g}°"] if measured[0] > _TESTED_INCIDENCES[0] else []
    ends += [f"beyond {measured[-1]:g}°"] if measured[-1] < _TESTED_INCIDENCES[-1] else []
    return f" Nothing was measured {where} {' and '.join(ends) or 'at some incidences'}{' of incidence' if ends else ''}{uncertainty}."


def _listed(theta: Array, relative: ArrayLike) -> str:
    percentages = ("over 100\u202f%" if u > 1 else percent(u) for u in np.asarray(relative).tolist())
    return ", ".join(f"{text} at {angle:g}°" for angle, text in zip(theta, percentages, strict=True))


def _uncertainty(bsdf: xr.Dataset, plane: Plane, incidence: ArrayLike, theta_o: ArrayLike, turn: ArrayLike) -> Array:
    angles = bsdf_sections.directions(plane, incidence, theta_o, turn)
    return representation(bsdf).uncertainty(*angles, bsdf_sections.reference(bsdf))[..., 0]


def _reflectance_uncertainty(bsdf: xr.Dataset, plane: Plane, incidence: float) -> float:
    """Relative, as if the errors of all directions were equal."""
    to = around_mirror(incidence, representation(bsdf).lobe_slope or _DEFAULT_SLOPE, order=3, turns=8)
    # The rule's azimuths are those of light from azimuth 0, in one half; both halves are needed, as the BSDF need not be even.
    turn, theta_o = np.concatenate([to.phi - 180, 180 - to.phi]), np.tile(to.theta, 2)
    u, value = (
        np.tile(to.weight, 2) @ function(bsdf, plane, incidence, theta_o, turn)
        for function in (_uncertainty, bsdf_sections.value)
    )
    return float(u / value) if value > 0 else float("nan")
