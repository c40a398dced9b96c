"""From a measured surface to its facet distribution.

On a constant-pitch grid every facet has the same projected area, so facets are counted in slope space: the count is the
slope density P22, and D(m) = P22 / cos⁴α.

References
----------
Patent US 9,395,299 (CRF), steps a3 and b; Heitz 2014 (JCGT 3(2)); Ribardière 2019.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.errors import plain
from brdfpipe.facets.height_maps import estimate_from_maps
from brdfpipe.facets.line_profiles import METHODS, check_directions, estimate_from_lines
from brdfpipe.facets.slope_histogram import FacetError
from brdfpipe.psd.scans import WELL_SAMPLED, SortedScans, commonly_filtered, sort_scans

_TOLERANCE = 1.01
_RESOLVING = 0.275
"""Half a wavelength of light [um]: facets are structures that light resolves."""


def estimate(
    surface: xr.Dataset | Sequence[xr.Dataset],
    *,
    method: str = "mixture",
    isotropic: bool | None = None,
    noise: float | None = None,
    noise_uncertainty: float | None = None,
) -> xr.Dataset:
    """Facet distribution of a levelled surface, with counts and uncertainty.

    Parameters
    ----------
    surface : kind ``surface``, levelled; an areal map or a line profile; or several scans of one surface, all maps or all
        lines. Those of a pitch that differs by a factor of 1.5 or more from the first are not counted. Those whose attribute
        ``repeat`` is true show the noise of the first. A line's azimuth [degree] is its attribute ``azimuth``, 0 by default
    method : how a line profile is turned into a two-dimensional density: ``mixture`` (a scale mixture of Gaussians, whose
        inversion is exact; where it does not fit, rings), ``abel`` (rings) or ``crf`` (the patent's histogram). For a
        map, the last two have no effect but a warning
    isotropic : whether the surface is isotropic. A single line must be declared isotropic. A map that is
        not declared either way has a lay if its principal slopes differ by more than a factor of 1.2
    noise : rms of white height noise [um], 0 for none; None: from the plateau of the spectrum of each scan, where it has one
    noise_uncertainty : standard uncertainty of a given noise [um]

    Returns
    -------
    Dataset of kind ``facets``: radial for an isotropic surface, on a grid of slopes for one with a lay; slopes are about each
    scan's mean. ``effective_count`` is the number of independent facets.
    Quantised heights of a map are dithered, which the history states. Noise is subtracted; ``noise_sigma`` [um] is its rms

    Raises
    ------
    FacetError : no scan; an unknown method; a single line that is not declared isotropic; scans that are not all maps or all lines,
        of different bandwidth, or given twice; too few independent facets; an impossible slope rms.
    PsdError : repeats do not fit the first scan; the noise is negative, not below the rms of the heights, or given for heights smoothed with λs.
    VocabularyError : a dataset is not of kind ``surface``.
    """
    scans = [surface] if isinstance(surface, xr.Dataset) else list(surface)
    scans, extending, known_noise = _sorted_scans(scans, method, noise, noise_uncertainty)
    if scans[0]["height"].ndim == 1:
        return _with_others_stated(estimate_from_lines(scans, method, isotropic, known_noise), scans[0], extending)
    facets = _with_others_stated(estimate_from_maps(scans, isotropic, known_noise), scans[0], extending)
    if method == METHODS[0]:
        return facets
    return vocabulary.add_warning(
        facets,
        f"surface.method {method} is for line profiles and was ignored: an areal map gives slopes in all directions; "
        "remove `surface.method`",
    )


def check_scans(
    scans: Sequence[xr.Dataset],
    *,
    method: str = "mixture",
    isotropic: bool | None = None,
    noise: float | None = None,
    noise_uncertainty: float | None = None,
) -> None:
    """Refuse scans that :func:`estimate` would refuse before it counts a facet: of unlike kind, bandwidth or direction."""
    counted, _, _ = _sorted_scans(scans, method, noise, noise_uncertainty)
    if counted[0]["height"].ndim == 1:
        check_directions(counted, method, isotropic)


def _sorted_scans(
    scans: Sequence[xr.Dataset], method: str, noise: float | None, noise_uncertainty: float | None
) -> SortedScans:
    """The scans of a surface by what they are for, those to count of one kind and bandwidth."""
    if not scans:
        raise FacetError("no scan of a surface given; accepted: one scan, or several of one surface")
    if method not in METHODS:
        raise FacetError(f"unknown method {method!r}; accepted: {', '.join(METHODS)}")
    for scan in scans:
        vocabulary.validate(scan, "surface")
    sorted_scans = sort_scans(scans, noise, noise_uncertainty)
    counted = sorted_scans[0]
    dimensions = {scan["height"].ndim for scan in counted}
    if len(dimensions) != 1:
        raise FacetError(
            f"scans of one surface must be all maps or all lines; found {len(counted)} scans of {sorted(dimensions)} dimensions"
        )
    _check_consistent(counted)
    return sorted_scans


def _with_others_stated(facets: xr.Dataset, first: xr.Dataset, extending: Sequence[xr.Dataset]) -> xr.Dataset:
    """State that scans of other magnification were not counted, and warn if one of them resolves light better than the first."""
    if not extending:
        return facets
    pitch, others = float(first.attrs["pitch_x"]), [float(scan.attrs["pitch_x"]) for scan in extending]
    stated = ", ".join(plain(other) for other in others)
    facets = vocabulary.add_history(
        facets,
        f"The facets are those of the scans of the first pitch, {plain(pitch)} um; scans of the pitches {stated} um extend the roughness spectrum alone.",
    )
    nearest = min([pitch, *others], key=lambda value: abs(np.log(value / _RESOLVING)))
    if nearest == pitch:
        return facets
    return vocabulary.add_warning(
        facets,
        f"slopes depend on the pitch: the facets are those of the first scan, of {plain(pitch)} um, but the one of {plain(nearest)} um is nearer to half a "
        "wavelength of light; list it first in `surface`",
    )


def _check_consistent(scans: Sequence[xr.Dataset]) -> None:
    """Refuse scans of different bandwidth (pitch, filters), whose slopes are not comparable.

    A common λs of at least 8 pitches makes up for different pitches.
    """
    first = scans[0].attrs
    pitches = [name for name in ("pitch_x", "pitch_y") if name in first]
    for number, scan in enumerate(scans[1:], start=2):
        pair = first, scan.attrs
        required = WELL_SAMPLED * max(float(attrs[name]) for attrs in pair for name in pitches)
        for name in ("lambda_s", "lambda_c", *([] if commonly_filtered(scans[0], scan) else pitches)):
            values = [float(attrs.get(name, 0.0)) for attrs in pair]
            if max(values) > _TOLERANCE * min(values):
                raise FacetError(
                    f"scans 1 and {number} of the surface have different bandwidths: {name} is "
                    + " and ".join(f"{plain(value, 4)} um" if value else "not set" for value in values)
                    + "; accepted: cutoffs and pitches equal within 1 %; measure at one pitch and set one `surface.lambda_s` and "
                    f"`surface.lambda_c` (with λs of at least {plain(required, 4)} um, pitches may differ)"
                )
    for (one, a), (two, b) in combinations(enumerate(scans, start=1), 2):
        if _identical(a, b):
            raise FacetError(
                f"scans {one} and {two} of the surface have identical heights; accepted: "
                "each scan once; remove one of them from `surface.scans`"
            )


def _identical(a: xr.Dataset, b: xr.Dataset) -> bool:
    first, second = (np.atleast_2d(scan["height"].values) for scan in (a, b))
    # One line may be given for two directions. Compared row by row: two maps mostly differ in the first.
    return (
        first.shape == second.shape
        and a.attrs.get("azimuth", 0.0) == b.attrs.get("azimuth", 0.0)
        and all(np.array_equal(*rows, equal_nan=True) for rows in zip(first, second, strict=True))
    )
