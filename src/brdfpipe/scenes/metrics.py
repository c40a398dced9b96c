"""The error of a BRDF by purpose: what one scene needs exactly, another does not notice.

No single number serves. The mean square of logarithms, on which fits usually rest, follows the quality that people perceive badly,
although it is a good loss to fit with, and the difference of pictures in ICtCp follows it best (Kavoosighafi et al. 2025). Of the
errors of the family of the root mean square, that of cube roots agrees best with observers (Fores et al. 2012). A fit that minimises
such an error can still look wrong: Lavoué et al. 2021 show fits of one measured paint of which Beckmann's lobe was rated worst. And
none of them says whether a ray tracer finds the right glare, or a gloss meter the right value.

References
----------
Kavoosighafi, Mantiuk, Hajisharif, Miandji, Unger 2025, Perceived quality of BRDF models (Comput. Graph. Forum, doi 10.1111/cgf.70162).
Fores, Ferwerda, Gu 2012, Toward a perceptually based metric for BRDF modeling (IS&T Color and Imaging Conf. 20, 142).
Lavoué, Bonneel, Farrugia, Soler 2021, Perceptual quality of BRDF approximations (Comput. Graph. Forum 40(2), 327).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe.appearance.colours import xyz_of
from brdfpipe.appearance.gloss_meter import gloss
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.registry import representation
from brdfpipe.errors import BrdfpipeError
from brdfpipe.geometry import Array
from brdfpipe.scenes.domain import DirectionPairs, Domain
from brdfpipe.scenes.picture_difference import picture_differences
from brdfpipe.spectra import colorimetry

DIRECTIONS = 4096
"""Pairs of directions at which BRDFs are compared, unless a number is given."""

GLARE_FLOOR = 1e-3
"""BRDF·cos θ_o below which a direction carries no glare [sr-1]; a white diffuser has 0.32 at the normal."""

_SCRAMBLES = 8
_INCIDENCES = 8


class Figure(NamedTuple):
    """One number of a comparison."""

    name: str
    value: float
    u: float
    """Standard uncertainty from the choice of directions or pixels; 0 where all that count are compared"""
    unit: str


Compute = Callable[..., tuple[Figure, ...]]


@dataclass(frozen=True)
class Metric:
    """The error of a BRDF for a purpose."""

    name: str
    unit: str
    words: str
    """What its first figure is, for pages."""
    figures: Compute
    """From candidate, reference and domain, and keywords of the metric's own; the first figure is the error"""

    def error(self, candidate: xr.Dataset, reference: xr.Dataset, domain: Domain, **options: object) -> Figure:
        """The error of the candidate [:attr:`unit`], with its sampling uncertainty.

        Parameters
        ----------
        candidate, reference : kind ``bsdf``
        domain : the pairs of directions that count
        options : those of the function of the metric

        Raises
        ------
        BrdfpipeError : nothing to compare in the domain.
        """
        return self.figures(candidate, reference, domain, **options)[0]


def glare(
    candidate: xr.Dataset,
    reference: xr.Dataset,
    domain: Domain,
    *,
    n: int = DIRECTIONS,
    seed: int = 0,
    floor: float = GLARE_FLOOR,
) -> tuple[Figure, ...]:
    """Error of the light that a ray tracer finds, weighted with V(λ)·D65.

    Parameters
    ----------
    candidate, reference, domain : as for :meth:`Metric.error`
    n, seed : of the sampled directions, in eight scrambles
    floor : of BRDF·|cos θ_o| [sr-1], > 0

    Returns
    -------
    - ``glare``: rms over the domain of (c − r) / max(r, floor), c and r the BRDF·|cos θ_o| of candidate and reference, where one of
      them is above the floor [1]
    - ``glare_95``: 95th percentile of its absolute value [1]
    - ``albedo``: rms of the relative error of the directional reflectance (and transmittance, with views on that side) at incidences
      of the domain, light that a smooth surface mirrors included [1]

    Raises
    ------
    BrdfpipeError : no direction above the floor, or a floor that is not above 0.
    """
    if not floor > 0:
        raise BrdfpipeError(f"the floor is {floor!r}; accepted: above 0 [sr-1]")
    batches = _batches(domain, n, seed)
    c, r = (_projected(nonspectral(bsdf), batches) for bsdf in (candidate, reference))
    weight = np.stack([batch.weight for batch in batches]) * (np.maximum(c, r) > floor)
    if not weight.any():
        raise BrdfpipeError(f"no direction of the domain has BRDF·cos θ_o above {floor:g} sr-1; lower the floor")
    error = np.abs(c - r) / np.maximum(r, floor)
    highest = np.array([_quantile(*row, 0.95) for row in zip(error, weight, strict=True) if row[1].any()])
    at_95 = _quantile(error.ravel(), weight.ravel(), 0.95)
    return (
        _rms("glare", error, weight, "1"),
        Figure("glare_95", at_95, _standard_error(highest), "1"),
        _albedo_error(candidate, reference, batches[0], floor),
    )


def colour(
    candidate: xr.Dataset,
    reference: xr.Dataset,
    domain: Domain,
    *,
    n: int = DIRECTIONS,
    seed: int = 0,
    illuminant: str = "D65",
    observer: int = 10,
) -> tuple[Figure, ...]:
    """Colour difference CIEDE2000 of the reflectance factors π·BRDF at the geometries of the domain.

    Returns
    -------
    ``colour``: mean of ΔE00, and ``colour_95``: its 95th percentile [1]. At highlights L* exceeds 100, where ΔE00 was not tested:
    colour geometries avoid the mirror direction
    """
    batches = _batches(domain, n, seed)
    white = colorimetry.weights(illuminant, observer).white
    labs = [
        colorimetry.xyz_to_lab(xyz_of(bsdf, np.maximum(_values(bsdf, batches), 0.0), illuminant, observer), white)
        for bsdf in (candidate, reference)
    ]
    difference, weight = colorimetry.delta_e_00(*labs), np.stack([batch.weight for batch in batches])
    means = (difference * weight).sum(axis=1)
    highest = np.array([_quantile(*row, 0.95) for row in zip(difference, weight, strict=True)])
    at_95 = _quantile(difference.ravel(), weight.ravel(), 0.95)
    return (
        Figure("colour", float(means.mean()), _standard_error(means), "1"),
        Figure("colour_95", at_95, _standard_error(highest), "1"),
    )


def gloss_difference(
    candidate: xr.Dataset, reference: xr.Dataset, domain: Domain, *, angles: tuple[float, ...] = (20, 60, 85)
) -> tuple[Figure, ...]:
    """Difference of the gloss units of ISO 2813 and ASTM D523. The standard fixes the directions, whatever the domain.

    Returns
    -------
    ``gloss``: largest absolute difference, and ``gloss_20``, …: candidate minus reference [GU]
    """
    differences = (gloss(candidate, angles) - gloss(reference, angles)).values
    return (
        Figure("gloss", float(np.abs(differences).max()), 0.0, "GU"),
        *(Figure(f"gloss_{angle:g}", float(d), 0.0, "GU") for angle, d in zip(angles, differences, strict=True)),
    )


def rendering(
    candidate: xr.Dataset, reference: xr.Dataset, domain: Domain, *, n: int = DIRECTIONS, seed: int = 0, side: int = 64
) -> tuple[Figure, ...]:
    """Difference of pictures: ΔE_ITP of the sphere and the panel of the preview under two lights, and the error of logarithms.

    Parameters
    ----------
    n, seed : of the directions of the error of logarithms
    side : pixels along each side of a picture

    Returns
    -------
    - ``rendering``: mean of ΔE_ITP over the pixels of both subjects and both lights; 1 is just noticeable under the best conditions
    - ``rendering_studio``, ``rendering_sun``: of one light each
    - ``log``: rms of ln[(c + floor) / (r + floor)] over the domain, as :func:`log_error` [1]

    References
    ----------
    ITU-R BT.2124 (ΔE_ITP); Kavoosighafi et al. 2025, who found it the closest to what observers say.
    """
    by_light = picture_differences(candidate, reference, side)
    mean, u = (float(np.mean([pair[k] for pair in by_light.values()])) for k in (0, 1))
    return (
        Figure("rendering", mean, u, "1"),
        *(Figure(f"rendering_{light}", *pair, "1") for light, pair in by_light.items()),
        log_error(candidate, reference, domain, n=n, seed=seed),
    )


def log_error(
    candidate: xr.Dataset,
    reference: xr.Dataset,
    domain: Domain,
    *,
    n: int = DIRECTIONS,
    seed: int = 0,
    floor: float = GLARE_FLOOR,
) -> Figure:
    """Rms over the domain of ln[(c + floor) / (r + floor)], c and r the BRDF·|cos θ_o| weighted with V(λ)·D65 [1].

    It is cheap, and the best of the losses in the space of BRDFs (Kavoosighafi et al. 2025): it chooses which candidates are rendered.
    """
    batches = _batches(domain, n, seed)
    c, r = (_projected(nonspectral(bsdf), batches) for bsdf in (candidate, reference))
    error = np.log((np.maximum(c, 0.0) + floor) / (np.maximum(r, 0.0) + floor))
    return _rms("log", error, np.stack([batch.weight for batch in batches]), "1")


def screened(
    candidates: Mapping[str, xr.Dataset], reference: xr.Dataset, domain: Domain, keep: int = 3, **options: int
) -> tuple[str, ...]:
    """Names of the ``keep`` candidates of the smallest :func:`log_error`, best first; ``options`` as there."""
    errors = {name: log_error(bsdf, reference, domain, **options).value for name, bsdf in candidates.items()}
    return tuple(sorted(errors, key=errors.__getitem__)[:keep])


METRICS: Mapping[str, Metric] = {
    metric.name: metric
    for metric in (
        Metric("glare", "1", "relative rms error of BRDF·cos θ_o", glare),
        Metric("colour", "1", "mean colour difference ΔE00", colour),
        Metric("gloss", "GU", "largest difference of gloss units", gloss_difference),
        Metric("rendering", "1", "mean difference of pictures ΔE_ITP", rendering),
    )
}
"""By the name that a scene gives."""


# --- samples of a domain


def _batches(domain: Domain, n: int, seed: int) -> list[DirectionPairs]:
    """Independent scrambles of the domain's directions, ``n`` together; single geometries need one batch."""
    if not domain.parts:
        return [domain.directions(0, seed)]
    each = max(n // _SCRAMBLES, len(domain.parts))
    seeds = np.random.default_rng(seed).integers(2**31, size=_SCRAMBLES)
    return [domain.directions(each, int(scramble)) for scramble in seeds]


def _values(bsdf: xr.Dataset, batches: list[DirectionPairs]) -> Array:
    """BRDF [sr-1], (batches, directions, wavelength or 1)."""
    theta_i, phi_i, theta_o, phi_o = (np.concatenate(angle) for angle in zip(*(b.angles for b in batches), strict=True))
    values = representation(bsdf).evaluate(theta_i, phi_i, theta_o, phi_o, None)
    return np.asarray(values.reshape(len(batches), -1, values.shape[-1]))


def _projected(bsdf: xr.Dataset, batches: list[DirectionPairs]) -> Array:
    """BRDF·|cos θ_o| of a BSDF that does not depend on wavelength, (batches, directions) [sr-1]."""
    cosine = np.abs(np.cos(np.radians(np.stack([batch.theta_o for batch in batches]))))
    return np.asarray(_values(bsdf, batches)[..., 0] * cosine)


def _albedo_error(candidate: xr.Dataset, reference: xr.Dataset, pairs: DirectionPairs, floor: float) -> Figure:
    theta_i, first = np.unique(pairs.theta_i, return_index=True)
    chosen = np.sort(first)[:_INCIDENCES] if theta_i.size > _INCIDENCES else first
    incidence = pairs.theta_i[chosen], pairs.phi_i[chosen]
    below: NDArray[np.bool_] = pairs.theta_o > 90
    shares = []
    for bsdf in (candidate, reference):
        evaluator = representation(nonspectral(bsdf))
        reflected = 0.0 if below.all() else evaluator.albedo(*incidence, None)[:, 0]
        shares.append(reflected + (evaluator.transmittance(*incidence, None)[:, 0] if below.any() else 0.0))
    error = (shares[0] - shares[1]) / np.maximum(shares[1], np.pi * floor)
    value = math.sqrt(np.mean(error**2))
    if error.size < 2:
        return Figure("albedo", value, 0.0, "1")
    halves = [math.sqrt(np.mean(error[k::2] ** 2)) for k in (0, 1)]
    return Figure("albedo", value, abs(halves[0] - halves[1]) / 2, "1")


def _rms(name: str, error: Array, weight: Array, unit: str) -> Figure:
    """Weighted rms of (batches, directions), and its standard error from the scatter of the batches."""
    used = weight.any(axis=1)
    squares = (error**2 * weight).sum(axis=1)[used] / weight.sum(axis=1)[used]
    total = math.sqrt((error**2 * weight).sum() / weight.sum())
    return Figure(name, total, _standard_error(squares) / (2 * total) if total > 0 else 0.0, unit)


def _standard_error(batches: Array) -> float:
    return float(batches.std(ddof=1) / math.sqrt(batches.size)) if batches.size > 1 else 0.0


def _quantile(values: Array, weight: Array, share: float) -> float:
    """The smallest value that is not below those of a share of the weight."""
    order = np.argsort(values)
    running = np.cumsum(weight[order])
    return float(values[order][np.searchsorted(running, share * running[-1] * (1 - 1e-12))])
