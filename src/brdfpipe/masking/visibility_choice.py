"""Choice between Smith's masking and masking traced on the heights of a surface, by the light that its facets reflect once.

Smith's masking follows from slopes alone. Where the facets of the heights themselves are seen more, or less, than that, their traced
visibility replaces it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.geometry import Array, HalfVector
from brdfpipe.masking.facet_sample import BLOCKS, FacetSample, direction
from brdfpipe.masking.line_visibility import tabulate_line
from brdfpipe.masking.modes import LARGEST_COMPARED
from brdfpipe.masking.smith import cotangent
from brdfpipe.masking.traced_visibility import SAMPLES, VisibilityError, ratio_of_sums, tabulate
from brdfpipe.masking.visibility import VISIBILITY
from brdfpipe.optics.fresnel_equations import fresnel
from brdfpipe.references.height_mesh import HeightMapError, HeightMesh

THETA = np.array([15.0, 30.0, 45.0, 60.0, 70.0, 75.0, 80.0, 85.0])
"""Angles of incidence at which both maskings are compared [degree]."""
THRESHOLD = 0.03
"""Relative difference of the light that must be exceeded,"""
SIGNIFICANT = 3.0
"""by more than so many standard uncertainties."""
REGIONS = {"peak": 0.3, "all": 0.0}
"""Light by the smallest share of the peak of the BRDF."""
COMPARED_FACETS = 2**16
"""Facets that are compared at incidences of 60 to 75 degree, and four times fewer at others."""
FIRST_COMPARED = 2**12
"""Facets that are compared first where these may be enough."""

_INDEX = 1.5  # of a plastic: weighs the light
_CLOSELY = 60.0  # smallest angle of incidence at which all facets are compared [degree]
_FEWER = 4  # times fewer facets at other angles
_HORIZON = 1e-6  # cosine of the lowest direction that counts
_FIELDS = ("visible_share", "visible_share_u", "smith_visible_share", "smith_error", "smith_error_u")


_SMALLEST_SHOWN = 5e-4
"""A smaller share of the light is 0.0 %."""


def choose(
    surface: xr.Dataset,
    facets: xr.Dataset,
    *,
    masking: str = "auto",
    samples: int = SAMPLES,
    seed: int = 0,
    quick: bool = False,
) -> xr.Dataset:
    """Masking that describes the heights of a surface, and the visibility of its facets where Smith's does not.

    Parameters
    ----------
    surface : kind ``surface``, a levelled map or line
    facets : kind ``facets``, estimated from that surface
    masking : ``auto``, or ``measured`` to trace the visibility in any case
    samples : facets that are traced for every node of the table
    seed : of the positions of the facets
    quick : compare few facets first, at incidences up to 75 degree alone, and more only while the choice is not clear

    Returns
    -------
    Dataset of kind ``visibility``: ``visible_share`` and ``smith_visible_share`` over (theta_i, region), shares of the light that facets
    reflect and that no other facet intercepts, with the relative difference ``smith_error`` = Smith's over traced light less 1, and its
    ``_u``. The attribute ``masking`` is ``measured`` or ``height-correlated``, and ``reason`` says why. With ``measured``, the tables of
    :func:`brdfpipe.masking.traced_visibility.tabulate`.

    Raises
    ------
    VisibilityError, HeightMapError : ``measured`` on a surface with a lay, on too few heights, or on heights without slopes.
    VocabularyError : a dataset of the wrong kind.

    Notes
    -----
    Smith's masking is replaced where, at an incidence up to 75 degree, in the peak or in all, the light of a body of index 1.5 differs by
    more than 3 % plus three standard uncertainties. On a map both lights are of the same facets, and the uncertainty is that of their ratio on
    this map: chance among the traced facets alone. Of a line it is the scatter between 64 blocks of it.
    """
    vocabulary.validate(surface, "surface")
    vocabulary.validate(facets, "facets")
    try:
        result = _compared_and_traced(surface, facets, masking, samples, seed, quick)
    except (HeightMapError, VisibilityError) as error:
        if masking == "measured":
            raise
        result = xr.Dataset(attrs={"masking": "height-correlated", "reason": f"no visibility was traced: {error}"})
    return vocabulary.label(result, "visibility")


def smith_errors(surface: xr.Dataset, facets: xr.Dataset, theta: float, samples: int) -> dict[str, float]:
    """Light of the facets after Smith over that which is traced on the heights less 1, by region; 0 where none is traced.

    Parameters
    ----------
    surface, facets : as for :func:`choose`
    theta : angle of incidence [degree], below 90
    samples : facets that are traced
    """
    try:
        mesh = _mesh(surface, facets)
    except (HeightMapError, VisibilityError):
        return dict.fromkeys(REGIONS, 0.0)
    sample = FacetSample.of(mesh, samples, 0)
    by_region = _at_incidence(sample, RadialDensity.of(facets), sample.smith_excess(), float(np.radians(theta)))
    return {
        region: float(shares[_FIELDS.index("smith_error")]) for region, shares in zip(REGIONS, by_region, strict=True)
    }


def _compared_and_traced(
    surface: xr.Dataset,
    facets: xr.Dataset,
    masking: str,
    samples: int,
    seed: int,
    quick: bool,
) -> xr.Dataset:
    mesh, line = _mesh(surface, facets, masking), surface["height"].ndim == 1
    density = RadialDensity.of(facets)
    result = (_compared_until_clear if quick else _compared)(mesh, density, seed)
    chosen, reason = _choice(result)
    if masking == "measured":
        chosen, reason = masking, f"`model.masking: measured`; {reason}"
    if chosen == "measured":
        table = (
            tabulate_line(mesh, density.median_slope, samples=samples, seed=seed)
            if line
            else tabulate(mesh, samples=samples, seed=seed)
        )
        result = result.merge(table)
    result.attrs |= {
        "masking": chosen,
        "reason": reason,
        "method": "traced on the line" if line else "traced on the map",
    }
    return result


def _mesh(surface: xr.Dataset, facets: xr.Dataset, masking: str = "auto") -> HeightMesh:
    """The heights, of facets whose masking can be traced."""
    if facets["slope_density"].size == 0:
        raise VisibilityError("the surface is flat, and masks nothing")
    if facets["slope_density"].ndim != 1:
        text = "the surface has a lay; masking is traced for surfaces without one"
        if masking == "measured":
            raise VisibilityError(f"masking 'measured' is not possible: {text}. Set `model.masking: auto`")
        raise VisibilityError(f"{text}, and with a lay is Smith's")
    return HeightMesh.of_line(surface) if surface["height"].ndim == 1 else HeightMesh.of(surface)


def _choice(comparison: xr.Dataset) -> tuple[str, str]:
    judged = comparison.sel(theta_i=slice(None, LARGEST_COMPARED))
    error, u = judged["smith_error"].values, judged["smith_error_u"].values
    over_limit = np.abs(error) / (THRESHOLD + SIGNIFICANT * u)
    row, column = np.unravel_index(int(over_limit.argmax()), error.shape)
    place = f"at {judged['theta_i'].values[row]:g}° in {'the peak' if list(REGIONS)[column] == 'peak' else 'all'}"
    size = f"{error[row, column]:+.1%} ± {u[row, column]:.1%}".replace("-", "−")
    if max(abs(error[row, column]), u[row, column]) < _SMALLEST_SHOWN:
        size = f"less than {2 * _SMALLEST_SHOWN:.1%}"
    found = f"{size} of the light {place}"
    if over_limit.max() > 1:
        return "measured", f"Smith's masking would give {found}"
    return (
        "height-correlated",
        f"Smith's masking is kept: the largest difference from the heights is {found}, less than 3 % plus 3 u",
    )


def _compared_until_clear(mesh: HeightMesh, density: RadialDensity, seed: int) -> xr.Dataset:
    """As :func:`_compared`, up to 75 degree, of as many facets as make the choice clear: that of all facets would be another by chance only
    at three standard uncertainties."""
    theta, count = THETA[THETA <= LARGEST_COMPARED], FIRST_COMPARED
    while count < COMPARED_FACETS:
        result = _compared(mesh, density, seed, count, theta)
        error, u = np.abs(result["smith_error"].values), result["smith_error_u"].values
        u_of_all = u * np.sqrt(count / COMPARED_FACETS)
        limit = THRESHOLD + SIGNIFICANT * u_of_all
        if np.any(error - SIGNIFICANT * u > limit) or np.all(error + SIGNIFICANT * u < limit):
            return result
        count *= _FEWER
    return _compared(mesh, density, seed, theta=theta)


def _compared(
    mesh: HeightMesh, density: RadialDensity, seed: int, count: int = COMPARED_FACETS, theta: Array = THETA
) -> xr.Dataset:
    """Light that facets reflect once, seen by tracing and after Smith, at angles of incidence ``theta`` [degree]."""
    facets = FacetSample.of(mesh, count, seed)
    smith = facets.smith_excess()
    fewer = facets.take(np.arange(0, facets.block.size, _FEWER))
    by_incidence = [
        _at_incidence(
            facets if _CLOSELY <= angle <= LARGEST_COMPARED else fewer, density, smith, float(np.radians(angle))
        )
        for angle in theta
    ]
    dims, coords = ("theta_i", "region"), {"theta_i": theta, "region": list(REGIONS)}
    fields = np.moveaxis(np.array(by_incidence), -1, 0)
    return xr.Dataset({name: (dims, values) for name, values in zip(_FIELDS, fields, strict=True)}, coords)


def _at_incidence(
    facets: FacetSample, density: RadialDensity, smith: Callable[[Array], Array], theta: float
) -> list[Array]:
    """Values of :data:`_FIELDS` of every region at an incidence [rad]; ``smith`` is the mean excess slope by cotangent."""
    p, q = facets.slopes
    squared = p**2 + q**2
    normal = np.stack([-p, -q, np.ones_like(p)], axis=-1) / np.sqrt(1 + squared)[:, None]
    towards = direction(np.full(p.size, theta), facets.azimuth)
    cos_zeta = np.clip(np.einsum("nk,nk->n", towards, normal), 0.0, 1.0)
    outgoing = 2 * cos_zeta[:, None] * normal - towards
    lit = (cos_zeta > 0) & (outgoing[:, 2] > _HORIZON)
    cos_o = np.where(lit, outgoing[:, 2], 1.0)
    cosines = np.full_like(cos_o, np.cos(theta)), cos_o
    (cos_i, sin_i), (cos_o, sin_o) = ((cos, np.sqrt((1 - cos) * (1 + cos))) for cos in cosines)
    pair = HalfVector(squared, cos_zeta, cos_i, sin_i, cos_o, sin_o)
    over_cosines = VISIBILITY["height-correlated"](pair, smith(cotangent(cos_i, sin_i)), smith(cotangent(cos_o, sin_o)))
    reflectance = np.where(lit, fresnel(cos_zeta, _INDEX).mean, 0.0)
    brdf = reflectance * density(squared) * (1 + squared) ** 2 * over_cosines
    light = reflectance * cos_zeta * np.sqrt(1 + squared)
    visible, expected = light * facets.visible(towards, outgoing, among=lit), light * over_cosines * cos_i * cos_o
    regions = [brdf >= least * brdf.max() for least in REGIONS.values()]
    return [_shares(facets, *(inside * part for part in (visible, expected, light))) for inside in regions]


def _shares(facets: FacetSample, visible: Array, expected: Array, light: Array) -> Array:
    """Values of :data:`_FIELDS` from the light of every facet, (n,): visible, visible after Smith, and all."""
    total = float(light.sum())
    seen, after_smith = visible.sum() / total, expected.sum() / total
    if facets.mesh.is_line:
        # A line stands for places beside it, so that the scatter between its places counts.
        visible, expected = (
            np.bincount(facets.block, part, minlength=BLOCKS**2).astype(float) for part in (visible, expected)
        )
    # One facet of the mean weight counts as visible after Smith, where others may all be hidden.
    ratio, relative_u = ratio_of_sums(visible, expected, total / light.size)
    return np.array([seen, seen * relative_u, after_smith, 1 / ratio - 1, relative_u / ratio])
