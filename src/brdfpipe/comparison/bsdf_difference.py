"""How far two BSDFs of any source are apart: by direction, in reflectance, gloss and colour."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
import xarray as xr

from brdfpipe.appearance import colours
from brdfpipe.appearance.gloss_meter import gloss
from brdfpipe.bsdf.grids import specular_angles
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.table_error import FLOOR, Pairs, fresh_pairs
from brdfpipe.geometry import Array
from brdfpipe.spectra import colorimetry

INCIDENCES = (0.0, 20.0, 45.0, 60.0, 75.0)
"""Incidences of reflectances [degree]."""
GLOSS_ANGLES = (20.0, 60.0, 85.0)
INCIDENCE_EDGES = (0.0, 15.0, 30.0, 45.0, 60.0, 75.0, 85.0)
MIRROR_EDGES = (0.0, 2.0, 5.0, 15.0, 40.0, 180.0)
"""Edges of the regions of :attr:`Difference.by_region` [degree]."""


class Difference(NamedTuple):
    """Differences of two BSDFs, the second minus the first, weighted with V(λ) and D65 unless they are colours."""

    median: float
    """Of |second − first|·|cos θ_o| over the larger of their mean·|cos θ_o| and 0.001 sr⁻¹ [1]"""
    percentile_95: float
    by_region: Array
    """(incidence regions, regions about the mirror direction) median of (second − first) over the mean, signed [1]; NaN where no direction is"""
    albedo: Array
    """(2, incidences) directional reflectances of both [1]"""
    gloss: Array
    """(2, gloss angles) of both [GU]"""
    colour: float
    """ΔE00 of the 45:0 colours, D65 and 10 degree; NaN if both do not depend on wavelength"""
    grey: tuple[bool, bool]
    """Whether each does not depend on wavelength, so that its colour is that of a grey"""
    directions: int


def difference(first: xr.Dataset, second: xr.Dataset, seed: int = 1) -> Difference:
    """Compare two BSDFs.

    Parameters
    ----------
    first, second : kind ``bsdf``
    seed : of the pairs of directions, half of which are drawn where either sends its light

    Notes
    -----
    Angles of incidence and view go to 85°. Light that is mirrored into a single direction counts in reflectance and gloss alone.
    """
    reduced = nonspectral(first), nonspectral(second)
    pairs = Pairs(*np.concatenate([fresh_pairs(one, seed) for one in reduced], axis=1))
    values = [representation(one).evaluate(*pairs, None)[:, 0] for one in reduced]
    cosine = np.abs(np.cos(np.radians(pairs.theta_o)))
    signed = (values[1] - values[0]) * cosine / np.maximum((values[0] + values[1]) / 2 * cosine, FLOOR)
    return Difference(
        float(np.median(np.abs(signed))),
        float(np.quantile(np.abs(signed), 0.95)),
        _by_region(pairs, signed),
        np.array([_albedo(one) for one in reduced]),
        np.array([gloss(one, GLOSS_ANGLES).values for one in (first, second)]),
        _colour(first, second),
        ("wavelength" not in first.coords, "wavelength" not in second.coords),
        signed.size,
    )


def _by_region(pairs: Pairs, signed: Array) -> Array:
    away = specular_angles(pairs.theta_i, pairs.phi_i, pairs.theta_o, pairs.phi_o)[0]
    row, column = np.digitize(pairs.theta_i, INCIDENCE_EDGES) - 1, np.digitize(away, MIRROR_EDGES) - 1
    result = np.full((len(INCIDENCE_EDGES) - 1, len(MIRROR_EDGES) - 1), np.nan)
    for index in np.ndindex(result.shape):
        here = (row == index[0]) & (column == index[1]) & (pairs.theta_o < 90)
        if here.any():
            result[index] = np.median(signed[here])
    return result


def _albedo(bsdf: xr.Dataset) -> Array:
    theta_i = np.array(INCIDENCES)
    return np.asarray(representation(bsdf).albedo(theta_i, np.zeros_like(theta_i), None)[:, 0])


def _colour(first: xr.Dataset, second: xr.Dataset) -> float:
    if "wavelength" not in first.coords and "wavelength" not in second.coords:
        return float("nan")
    labs = [colours.colour(one, ["45:0"]).sel(geometry="45:0").values for one in (first, second)]
    return float(colorimetry.delta_e_00(*labs))


def as_text(found: Difference) -> str:
    """The differences as a table for a terminal."""
    lines = [
        f"{found.directions} pairs of directions: median {found.median:.2%}, 95th percentile {found.percentile_95:.2%} of BRDF·cos θ_o (difference over the mean of both; 200% where one has no light)",
        "",
        "difference of the BRDF (median, second minus first) by incidence and angle from the mirror direction",
        "".join(f"{text:>11}" for text in ("", *(f"{a:g}-{b:g}°" for a, b in pairwise(MIRROR_EDGES)))),
    ]
    for (low, high), row in zip(pairwise(INCIDENCE_EDGES), found.by_region, strict=True):
        cells = ("" if np.isnan(value) else f"{value:+.1%}" for value in row)
        lines.append("".join(f"{text:>11}" for text in (f"{low:g}-{high:g}°", *cells)))
    lines += ["", "".join(f"{text:>13}" for text in ("", "first", "second", "difference"))]
    for angle, (one, other) in zip(INCIDENCES, found.albedo.T, strict=True):
        lines.append(
            "".join(
                f"{text:>13}" for text in (f"albedo {angle:g}°", f"{one:.4f}", f"{other:.4f}", f"{other - one:+.4f}")
            )
        )
    for angle, (one, other) in zip(GLOSS_ANGLES, found.gloss.T, strict=True):
        lines.append(
            "".join(
                f"{text:>13}" for text in (f"gloss {angle:g}°", f"{one:.2f}", f"{other:.2f}", f"{other - one:+.2f}")
            )
        )
    if not np.isnan(found.colour):
        text = f"ΔE00 of the colours at 45:0: {found.colour:.2f}"
        for name, grey in zip(("first", "second"), found.grey, strict=True):
            text += f"; the {name} file has no colours and counts as a grey" if grey else ""
        lines += ["", text]
    return "\n".join(lines)
