"""The slope density of a finish that is known by gloss readings alone.

Gloss at two or three angles bounds the width of the slopes, and less well their tail: more gloss at 20° than at 85° says that the slopes of a finish are
narrow with a long tail. Both are unknown at once (:mod:`brdfpipe.appearance.gloss_of_finishes`). The result is the mean density over all that agree with
the readings, with its principal changes as uncertainty, so that what follows from it has the mean and the variance that the readings leave.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.appearance.gloss_of_finishes import ANGLES, TAILS, WIDTHS, Finishes, GlossOfFinishes
from brdfpipe.comparison import reading_defaults
from brdfpipe.errors import BrdfpipeError
from brdfpipe.facets import student_slopes
from brdfpipe.facets.density_changes import with_changes
from brdfpipe.facets.facet_dataset import radial_dataset
from brdfpipe.facets.radial_density import RadialDensity, masses
from brdfpipe.geometry import Array

_MISFIT = 9.0
"""χ² of the best density, over its degrees of freedom, above which no density of the family explains the readings."""

_AT_EDGE = 0.1
"""Likelihood at the end of the range of widths, over the largest, above which the readings do not bound the width there."""

_NOT_DETERMINED = 0.8
"""Standard deviation of the tail, over that before the readings, above which they do not determine it."""

_TAIL_U = float(np.sqrt(sum(share * (tail - 0.5) ** 2 for tail, share in TAILS["any"].items())))

_STEEPEST = 11.0
"""Slope (85°) up to which the uncertainty of a density is represented."""

_MOST_CHANGES, _KEPT = 8, 0.99
"""Changes of the density, and share of its variance that is enough."""

_DEEPEST = 0.9
"""Largest share of a density that a change takes away: it stays positive."""

_REACH, _SLOPES = 1e6, 1024
"""Steepest slope over the largest width, and number of slopes."""


class GlossFinishError(BrdfpipeError):
    """Gloss readings from which no finish follows."""


def finish_from_gloss(
    gloss: Mapping[float, float],
    *,
    index: xr.Dataset | float | str,
    spectrum: xr.Dataset | None = None,
    gloss_u: float | None = None,
    slopes: str = "any",
) -> xr.Dataset:
    """The slope density of a finish from its gloss.

    Parameters
    ----------
    gloss : geometry (20, 60 or 85 degree) → reading [gloss units], of two or three
    index : kind ``index``, a number or a plastic's name; its ``n_u`` is taken into account
    spectrum : kind ``spectrum``; its diffuse light is part of the gloss
    gloss_u : standard uncertainty of each reading [gloss units]; by default that of :func:`brdfpipe.comparison.reading_defaults.gloss_u`
    slopes : ``any`` from Beckmann's to GGX, or one of them: a word of :data:`TAILS`

    Returns
    -------
    Dataset of kind ``facets``: the mean of the densities that agree with the readings, and its principal changes (source ``facets``). ``median_slope``,
    with the standard uncertainty of its logarithm ``median_slope_log_u``; ``tail`` (0 Beckmann, 1 GGX) and ``tail_u``; ``gloss_chi_squared`` of the density
    that agrees best. Warnings say what the readings do not determine

    Raises
    ------
    GlossFinishError : fewer than two readings, an unknown geometry or word, or an uncertainty that is not above 0.

    Notes
    -----
    The light of facets beyond one reflection is part of it (``multiple_scattering: directional``). If no density explains the readings, their uncertainties are
    enlarged until the best one does (Birge 1932).
    """
    if len(gloss) < 2 or set(gloss) - set(ANGLES):
        given = ", ".join(f"{angle:g}°" for angle in gloss) or "none"
        raise GlossFinishError(
            f"gloss readings at {given}; accepted: two or three of 20°, 60° and 85°; set `measured.gloss`"
        )
    if slopes not in TAILS:
        raise GlossFinishError(f"unknown slopes {slopes!r}; accepted: {', '.join(TAILS)}; set `surface.slopes`")
    if gloss_u is not None and not gloss_u > 0:
        raise GlossFinishError(
            f"the uncertainty of gloss is {gloss_u:g}; accepted: above 0; set `measured.uncertainty.gloss`"
        )
    u = {angle: reading_defaults.gloss_u(value, gloss_u) for angle, value in gloss.items()}
    known = GlossOfFinishes(index, spectrum, slopes)
    found = known.finishes(gloss, u)
    freedom = max(len(gloss) - (2 if slopes == "any" else 1), 1)
    chi_squared, enlarged = found.chi_squared, 1.0
    if chi_squared > _MISFIT * freedom:
        enlarged = float(np.sqrt(chi_squared / freedom))
        found = known.finishes(gloss, {angle: one * enlarged for angle, one in u.items()})
    return facets_of_finishes(found, gloss, chi_squared, enlarged)


def facets_of_finishes(
    found: Finishes, gloss: Mapping[float, float], chi_squared: float, enlarged: float = 1.0
) -> xr.Dataset:
    """The facets of all densities that agree with readings; see :func:`finish_from_gloss`."""
    slope, each = _densities(found)
    mean = found.mean(each)
    density = RadialDensity(slope, mean / float(masses(slope, mean[None])[0]))
    log_median = found.log_median
    values = {
        "median_slope": float(np.exp(found.mean(log_median))),
        "median_slope_log_u": float(found.deviation(log_median)),
        "tail": float(found.mean(found.tail)),
        "tail_u": float(found.deviation(found.tail)),
        "gloss_chi_squared": chi_squared,
    }
    facets = radial_dataset(density, np.nan).assign(values)
    readings = ", ".join(f"{angle:g}° {value:g}" for angle, value in gloss.items())
    facets.attrs = {"method": f"from gloss {readings}", "band": "none: not measured", "gloss_readings": readings}
    facets = with_changes(facets, {"facets": _principal(found, each, density)})
    facets = vocabulary.add_history(facets, _statement(values))
    return vocabulary.label(vocabulary.add_warning(facets, *_not_determined(found, enlarged)), "facets")


def _densities(found: Finishes) -> tuple[Array, Array]:
    """Slopes that resolve all densities, and each density there, (densities, slopes)."""
    width = np.exp(found.log_width)
    reach = width.max() * (8.3 if not found.tail.any() else _REACH)
    slope = width.min() / 2 * np.sinh(np.linspace(0, np.arcsinh(2 * reach / width.min()), _SLOPES))
    pairs = zip(width.tolist(), found.tail.tolist(), strict=True)
    return slope, np.array([student_slopes.density(slope, *pair) for pair in pairs])


def _principal(found: Finishes, each: Array, density: RadialDensity) -> Array:
    """A few changes of the mean density (changes, slopes) with its variance at each slope, and between slopes."""
    by_density = (np.sqrt(found.weight)[:, None] * (each - found.mean(each))).T
    deviation = np.sqrt(np.square(by_density).sum(axis=1))
    seen = (density.slope < _STEEPEST) & (deviation > 1e-9 * density.density)
    if not seen.any():
        return np.empty((0, density.slope.size))
    # Of the relative changes at each slope: a decade of slopes in the tail counts as one about the mirror direction.
    _, sizes, rows = np.linalg.svd(by_density[seen] / deviation[seen, None], full_matrices=False)
    share = np.cumsum(sizes**2) / np.sum(sizes**2)
    changes = by_density @ rows[: min(int(np.searchsorted(share, _KEPT)) + 1, _MOST_CHANGES)].T
    relative = changes / density.density[:, None]
    # The sign is arbitrary: a density grows without limit, and stays positive.
    changes = changes * np.where(-relative.min(axis=0) > relative.max(axis=0), -1.0, 1.0)
    after = np.maximum(density.density[:, None] + changes, (1 - _DEEPEST) * density.density[:, None]).T
    return np.asarray(after / masses(density.slope, after)[:, None] - density.density)


def _statement(values: Mapping[str, float]) -> str:
    tail = (
        "not determined"
        if values["tail_u"] > _NOT_DETERMINED * _TAIL_U
        else f"{values['tail']:.2f} ± {values['tail_u']:.2f}"
    )
    return (
        f"gloss gives a median slope of {values['median_slope']:.3g} ± {100 * values['median_slope_log_u']:.2g} % and a tail {tail} "
        "(0: Beckmann, 1: GGX)"
    )


def _not_determined(found: Finishes, enlarged: float) -> Iterator[str]:
    """What the readings do not determine."""
    order = np.argsort(found.log_median)
    low, high = np.interp([0.05, 0.95], np.cumsum(found.weight[order]), np.exp(found.log_median[order]))
    if enlarged > 1:
        yield (
            "no slopes from Beckmann's to GGX have this gloss: check readings and index; the uncertainty of the readings was enlarged "
            f"{enlarged:.2g} times until the best ones do"
        )
    if found.at_edges[0] > _AT_EDGE:
        yield (
            f"gloss does not tell how smooth the finish is, only that its median slope is below {high:.2g} (95 %): narrower slopes mirror all light into the "
            f"receptors. Down to {WIDTHS[0]:g} all widths count as equally likely"
        )
    if found.at_edges[1] > _AT_EDGE:
        yield (
            f"gloss does not tell how rough the finish is, only that its median slope is above {low:.2g} (95 %): rougher ones have less gloss than the "
            f"uncertainty of the readings. Up to {WIDTHS[1]:g} all widths count as equally likely"
        )
