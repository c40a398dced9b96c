"""Measurement coverage: which parts of a curve rest on measured directions, and the uncertainty of the others.

A BSDF from a model has no quality flags, and no coverage.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from brdfpipe import vocabulary
from brdfpipe.bsdf.registry import representation
from brdfpipe.hemisphere import around_mirror
from brdfpipe.report.formatting import number
from brdfpipe.report.plots import bsdf_sections
from brdfpipe.report.plots.bsdf_sections import Plane
from brdfpipe.report.plots.svg import Array, Line

KNOWN = ("measured", "interpolated")
"""Quality flags of directions that were measured, or that are between measured ones."""

_SOUGHT = np.arange(0.0, 90.0)
"""Incidences at which it is asked how far a measurement reaches [degree]."""

_SLOPE = 0.1
"""Of the facets of a lobe of which a representation tells none."""


def quality(
    bsdf: xr.Dataset, plane: Plane, incidence: ArrayLike, theta_o: ArrayLike, turn: ArrayLike
) -> NDArray[np.int8] | None:
    """Where values come from, of ``QUALITY_FLAGS``; arguments as of :func:`.scattering.value`. None of a BSDF that rests on a model."""
    evaluator = representation(bsdf)
    if not evaluator.states_quality:
        return None
    return np.asarray(evaluator.quality(*bsdf_sections.directions(plane, incidence, theta_o, turn)), dtype=np.int8)


def at_mirror(
    bsdf: xr.Dataset, plane: Plane, incidence: ArrayLike, *, through: bool = False
) -> NDArray[np.int8] | None:
    """The same in the mirror direction, or straight on through the sample."""
    theta_o = np.asarray(incidence, dtype=float)
    return quality(bsdf, plane, incidence, 180 - theta_o if through else theta_o, 0.0)


def known(flags: ArrayLike) -> NDArray[np.bool_]:
    """Whether flags are among :data:`KNOWN`."""
    return np.isin(flags, [vocabulary.quality(name) for name in KNOWN])


def split(line: Line, measured: NDArray[np.bool_]) -> tuple[Line, Line]:
    """A curve where it is known, and the rest of it dashed; the two meet."""
    rest = ~measured
    rest[1:] |= ~measured[:-1]
    rest[:-1] |= ~measured[1:]
    value = np.asarray(line.y, dtype=float)
    solid, dashed = (np.where(part, value, np.nan) for part in (measured, rest))
    return replace(line, y=solid), replace(line, y=dashed, pattern="dash")


# --- in words


def words(bsdf: xr.Dataset, plane: Plane, shown: Sequence[float], *, through: bool = False) -> str:
    """Beyond which incidences nothing was measured in the mirror direction, or straight on, and how sure the BSDF is there.

    Parameters
    ----------
    shown : incidences of which the uncertainty is told [degree]

    Returns
    -------
    A sentence; empty of a BSDF that rests on a model or was measured at any incidence
    """
    theta = np.asarray(shown, dtype=float)
    where = "straight on through the sample" if through else "in the mirror direction"

    def relative(unknown: Array) -> Array:
        at = unknown, 180 - unknown if through else unknown
        u, value = _uncertainty(bsdf, plane, *at, 0.0), bsdf_sections.value(bsdf, plane, *at, 0.0)
        return np.divide(u, value, out=np.full_like(u, np.nan), where=value > 0)

    unknown = _unknown(bsdf, plane, theta, through)
    uncertainty = (
        _listed(unknown, relative(unknown)) if unknown.size and representation(bsdf).states_uncertainty else ""
    )
    return _sentence(
        bsdf, plane, where, through, f" (standard uncertainty there: {uncertainty})" if uncertainty else ""
    )


def reflectance_words(bsdf: xr.Dataset, plane: Plane, shown: Sequence[float]) -> str:
    """The same of the directional reflectance: its uncertainty is as if all directions were off together, which is the most it can be."""
    unknown = _unknown(bsdf, plane, np.asarray(shown, dtype=float), False)
    uncertainty = ""
    if unknown.size and representation(bsdf).states_uncertainty:
        most = [_reflectance_uncertainty(bsdf, plane, angle) for angle in unknown.tolist()]
        uncertainty = f" (standard uncertainty of the reflectance there: at most {_listed(unknown, np.array(most))})"
    return _sentence(bsdf, plane, "in the mirror direction", False, uncertainty)


def _unknown(bsdf: xr.Dataset, plane: Plane, theta: Array, through: bool) -> Array:
    flags = at_mirror(bsdf, plane, theta, through=through)
    return theta[:0] if flags is None else theta[~known(flags)]


def _sentence(bsdf: xr.Dataset, plane: Plane, where: str, through: bool, sure: str) -> str:
    flags = at_mirror(bsdf, plane, _SOUGHT, through=through)
    if flags is None or known(flags).all():
        return ""
    measured = _SOUGHT[known(flags)]
    if not measured.size:
        return f" Nothing was measured {where} at any incidence{sure}."
    ends = [f"below {measured[0]:g}°"] if measured[0] > _SOUGHT[0] else []
    ends += [f"beyond {measured[-1]:g}°"] if measured[-1] < _SOUGHT[-1] else []
    return f" Nothing was measured {where} {' and '.join(ends) or 'at some incidences'}{' of incidence' if ends else ''}{sure}."


def _listed(theta: Array, share: Array) -> str:
    return ", ".join(f"{_percent(u)} at {angle:g}°" for angle, u in zip(theta, share, strict=True))


def _percent(share: float) -> str:
    return "over 100\u202f%" if share > 1 else f"{number(100 * share, 2)}\u202f%"


def _uncertainty(bsdf: xr.Dataset, plane: Plane, incidence: ArrayLike, theta_o: ArrayLike, turn: ArrayLike) -> Array:
    angles = bsdf_sections.directions(plane, incidence, theta_o, turn)
    return representation(bsdf).uncertainty(*angles, bsdf_sections.reference(bsdf))[..., 0]


def _reflectance_uncertainty(bsdf: xr.Dataset, plane: Plane, incidence: float) -> float:
    """Relative, as if all directions were off together."""
    to = around_mirror(incidence, representation(bsdf).lobe_slope or _SLOPE, order=3, turns=8)
    # The rule's azimuths are those of light that comes from 0; both halves are asked, as the BSDF need not be even.
    either = np.concatenate([to.phi - 180, 180 - to.phi]), np.tile(to.theta, 2)
    u, value = (
        np.tile(to.weight, 2) @ function(bsdf, plane, incidence, either[1], either[0])
        for function in (_uncertainty, bsdf_sections.value)
    )
    return float(u / value) if value > 0 else float("nan")
