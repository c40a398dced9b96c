"""Gloss of the finishes between Beckmann's and GGX, and those that agree with gloss readings.

A density of the family (:mod:`brdfpipe.facets.student_slopes`) has a width and a tail. Assumed before the readings: all widths from 0.001 to 1 are equally
likely on a logarithmic scale, and so are Beckmann's tail, that of GGX, and one between.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy.interpolate import CubicSpline, PchipInterpolator

from brdfpipe import vocabulary
from brdfpipe.appearance import apertures, gloss_meter
from brdfpipe.bsdf.microfacet.builder import build
from brdfpipe.bsdf.microfacet.microsurface import Microsurface
from brdfpipe.bsdf.microfacet.model import Model
from brdfpipe.facets import student_slopes
from brdfpipe.facets.analytic_distributions import flat
from brdfpipe.facets.facet_dataset import radial_dataset
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.geometry import Array
from brdfpipe.masking.smith import Smith, smith_lambda
from brdfpipe.optics.fresnel_equations import fresnel
from brdfpipe.optics.index import refractive_index

ANGLES = (20.0, 60.0, 85.0)
"""Geometries of gloss meters [degree]."""

WIDTHS = (1e-3, 1.0)
"""Range of the widths a. Narrower slopes mirror as a polished surface does; wider ones are steeper than 45° at half of the facets."""

TAILS: Mapping[str, Mapping[float, float]] = {
    "any": {0.0: 1 / 3, 0.25: 1 / 9, 0.5: 1 / 9, 0.75: 1 / 9, 1.0: 1 / 3},
    "beckmann": {0.0: 1.0},
    "ggx": {1.0: 1.0},
}
"""Accepted words → probability of each tail before the readings: either named density, or one between them."""

MULTIPLE_SCATTERING = "directional"
"""Light that facets reflect more than once, where the default leaves it to its share: gloss is a continuous function of the width."""

_NODES, _FINE = 29, 561
"""Widths at which gloss is computed, and between them, on a logarithmic scale."""

_FURTHER_WIDTHS = np.geomspace(0.02, 1.0, 12)
"""Widths at which the light that facets reflect more than once is computed; below the first there is none."""

_RULE = apertures.Rule((2, 3), 3)
"""Accurate to 0.1 gloss units."""

_NEAR = 20.0
"""Logarithm of the largest likelihood over one that is still near."""

_WAVELENGTH, _LEAST_INDEX, _INDEX_STEPS = 550.0, 1.001, 41
"""At which the index is read [nm], its smallest value, and number of indices within three standard uncertainties."""

_UNLIKELY = 1e-5
"""Share of the most likely density below which one is left out."""


class Finishes(NamedTuple):
    """The densities that agree with readings."""

    tail: Array
    log_width: Array
    weight: Array
    """Probability of each, (densities,); of one width and tail each."""
    gloss: Array
    """Of each at 20, 60 and 85°, (densities, 3)."""
    chi_squared: float
    """Of the one that agrees best."""
    at_edges: tuple[float, float]
    """Likelihood at the smallest and the largest width over the largest likelihood."""

    @property
    def log_median(self) -> Array:
        """Logarithm of the median slope of each."""
        ratio = {tail: np.log(student_slopes.median_over_width(tail)) for tail in np.unique(self.tail).tolist()}
        return self.log_width + np.array([ratio[tail] for tail in self.tail.tolist()])

    def mean(self, values: Array) -> Array:
        """Mean of values (densities, …)."""
        return np.asarray(np.tensordot(self.weight, values, 1))

    def deviation(self, values: Array) -> Array:
        """Standard deviation of values (densities, …)."""
        return np.asarray(np.sqrt(np.maximum(self.mean(np.square(values - self.mean(values))), 0.0)))


@dataclass(frozen=True)
class GlossOfFinishes:
    """Gloss of the finishes of the family, with one index and one spectrum.

    Parameters
    ----------
    index : kind ``index``, a number or a plastic's name
    spectrum : kind ``spectrum``; None for a body without diffuse light
    slopes : a word of :data:`TAILS`
    """

    index: xr.Dataset | float | str
    spectrum: xr.Dataset | None = None
    slopes: str = "any"
    _known: dict[str, Array] = field(default_factory=dict, init=False, repr=False, compare=False)

    @property
    def tails(self) -> tuple[float, ...]:
        return tuple(TAILS[self.slopes])

    def finishes(self, gloss: Mapping[float, float], u: Mapping[float, float]) -> Finishes:
        """The densities that agree with readings, by geometry [degree], and their standard uncertainties [gloss units]."""
        at = [ANGLES.index(angle) for angle in gloss]
        read, read_u = np.array(list(gloss.values())), np.array([u[angle] for angle in gloss])
        log_width = _log_widths(_FINE)
        single = CubicSpline(_log_widths(_NODES), self._single, axis=1)(log_width)
        # The light that is reflected more than once is computed only near the widths that agree.
        first = self._log_likelihood(single, at, read, read_u)
        near = log_width[(first > first.max() - _NEAR).any(axis=0)]
        factor = self._several(log_width, float(near[0]), float(near[-1]))
        values = factor * (single + self._base)
        log_likelihood = self._log_likelihood(factor * single + (factor - 1) * self._base, at, read, read_u)
        log_likelihood = log_likelihood + np.log(list(TAILS[self.slopes].values()))[:, None]
        likelihood = np.exp(log_likelihood - log_likelihood.max())
        kept = likelihood > _UNLIKELY
        tail, width = np.meshgrid(self.tails, log_width, indexing="ij")
        best = values[np.unravel_index(likelihood.argmax(), likelihood.shape)][at]
        misfit = float(np.sum(((read - best) / read_u) ** 2))
        weight = likelihood[kept] / likelihood[kept].sum()
        ends = float(likelihood[:, 0].max()), float(likelihood[:, -1].max())
        return Finishes(tail[kept], width[kept], weight, values[kept], misfit, ends)

    def _log_likelihood(self, of_surface: Array, at: list[int], read: Array, u: Array) -> Array:
        """Of readings, from the gloss of the surface alone (…, 3); the index is uncertain as stated, and common to all angles."""
        by_index = [
            np.log(share) - 0.5 * np.square((read - (of_surface * factor + self._base)[..., at]) / u).sum(axis=-1)
            for share, factor in self._index_factors
        ]
        return np.asarray(np.logaddexp.reduce(by_index))

    @property
    def _index_factors(self) -> list[tuple[float, Array]]:
        """Probability, and Fresnel's reflectance at the angles over that of the given index, of indices within its uncertainty."""
        index = self.index if isinstance(self.index, xr.Dataset) else refractive_index(self.index)
        at = index.sel(wavelength=_WAVELENGTH, method="nearest")
        n, k, n_u = float(at["n"]), float(at["k"]), float(at.get("n_u", 0.0))
        if not n_u:
            return [(1.0, np.ones(len(ANGLES)))]
        cosine = np.cos(np.radians(ANGLES))
        nominal = fresnel(cosine, n, k).mean
        # Close enough that gloss changes by less than its uncertainty from one to the next.
        steps = np.linspace(-3, 3, _INDEX_STEPS)
        share = np.exp(-(steps**2) / 2)
        return [
            (float(one), fresnel(cosine, max(n + step * n_u, _LEAST_INDEX), k).mean / nominal)
            for one, step in zip(share / share.sum(), steps.tolist(), strict=True)
        ]

    @property
    def _flat(self) -> tuple[apertures.Sample, Model]:
        sample = apertures.sample_of(build(flat(), index=self.index, spectrum=self.spectrum), None)
        return sample, Model.of(sample.bsdf, None)

    @property
    def _base(self) -> Array:
        """Gloss of the diffuse light below a polished surface, (3,)."""
        if "base" not in self._known:
            sample, model = self._flat
            self._known["base"] = _gloss(sample, model, sample.lobe)
        return self._known["base"]

    @property
    def _single(self) -> Array:
        """Gloss of light that facets mirror once, (tails, widths, 3)."""
        if "single" not in self._known:
            sample, model = self._flat
            bare = replace(model, diffuse=np.zeros(1))
            widths = np.exp(_log_widths(_NODES))
            self._known["single"] = np.array([list(_of_widths(sample, bare, tail, widths)) for tail in self.tails])
        return self._known["single"]

    def _several(self, log_width: Array, low: float, high: float) -> Array:
        """Factor of gloss by light that facets reflect more than once, (tails, widths, 3), right between two widths; linear in the tail."""
        nodes = np.log(_FURTHER_WIDTHS)
        first = max(int(np.searchsorted(nodes, low, side="right")) - 1, 0)
        last = min(int(np.searchsorted(nodes, high)), nodes.size - 1)
        if high < nodes[0]:
            return np.ones((len(self.tails), log_width.size, 3))
        used = nodes[first : last + 1]
        ends = sorted({self.tails[0], self.tails[-1]})
        factors = np.array([[self._factor(tail, float(np.exp(one))) for one in used] for tail in ends])
        if first == 0:
            # No light is reflected twice where slopes are half as wide.
            used = np.concatenate([[nodes[0] - np.log(2)], used])
            factors = np.concatenate([np.ones_like(factors[:, :1]), factors], axis=1)
        at = np.clip(log_width, used[0], used[-1])
        by_end = PchipInterpolator(used, factors, axis=1)(at) if used.size > 1 else factors.repeat(at.size, axis=1)
        return np.array([by_end[0] + tail * (by_end[-1] - by_end[0]) for tail in self.tails])

    def _factor(self, tail: float, width: float) -> Array:
        """Gloss of the whole model over that of the single reflection and a base that the facets do not change."""
        name = f"{tail} {width}"
        if name not in self._known:
            whole = build(
                _facets_of(tail, width),
                index=self.index,
                spectrum=self.spectrum,
                multiple_scattering=MULTIPLE_SCATTERING,
            )
            once = CubicSpline(_log_widths(_NODES), self._single[self.tails.index(tail)], axis=0)
            quick = once(np.log(width)) + self._base
            self._known[name] = gloss_meter.gloss(whole, ANGLES).values / quick
        return self._known[name]


def _log_widths(count: int) -> Array:
    return np.linspace(np.log(WIDTHS[0]), np.log(WIDTHS[1]), count)


def _gloss(sample: apertures.Sample, model: Model, lobe: float) -> Array:
    """Gloss units at :data:`ANGLES` of a model that mirrors nothing into one single direction."""
    reflector = _Scattering(model)
    beams = [gloss_meter.beam_of(angle, _RULE) for angle in ANGLES]
    received = apertures.received(sample._replace(lobe=lobe), beams, np.zeros(1), reflector)
    return np.array(
        [
            gloss_meter.gloss_of(sample, beam, light, np.zeros(1), reflector)[0]
            for beam, light in zip(beams, received, strict=True)
        ]
    )


def _of_widths(sample: apertures.Sample, bare: Model, tail: float, widths: Array) -> Iterator[Array]:
    """Gloss of the light that facets of one tail mirror once, at each width: slopes and masking scale with it."""
    density = _unit_density(tail)
    table = smith_lambda(density)
    cotangent = 1 / np.tan(np.radians(table["theta"].values))
    for width in widths.tolist():
        wide = RadialDensity(density.slope * width, density.density / width**2)
        theta = ("theta", np.degrees(np.arctan2(1.0, width * cotangent)))
        smith = Smith.of(xr.Dataset({"lambda_smith": ("theta", table.values)}, coords={"theta": theta}))
        yield _gloss(sample, replace(bare, surface=Microsurface(wide, smith)), float(np.clip(width, 1e-6, 0.2)))


def _unit_density(tail: float) -> RadialDensity:
    """The density of width 1."""
    reach, nodes = (8.3, 512) if tail == 0 else (1e7, 1024)
    slope = np.sinh(np.linspace(0, np.arcsinh(reach), nodes))
    return RadialDensity(slope, student_slopes.density(slope, 1.0, tail))


def _facets_of(tail: float, width: float) -> xr.Dataset:
    unit = _unit_density(tail)
    facets = radial_dataset(RadialDensity(unit.slope * width, unit.density / width**2), np.nan)
    return vocabulary.label(facets.assign_attrs(method="", band=""), "facets")


class _Scattering:
    """A model whose light is scattered; none is mirrored into one single direction."""

    def __init__(self, model: Model) -> None:
        self._model = model

    def evaluate(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None) -> Array:
        return self._model.evaluate(theta_i, phi_i, theta_o, phi_o)

    def specular(self, theta_i: Array, phi_i: Array, wavelength: Array | None) -> tuple[Array, Array]:
        none = np.zeros((*np.shape(theta_i), 1))
        return none, none

    def albedo(self, theta_i: Array, phi_i: Array, wavelength: Array | None) -> Array:
        return self._model.directional_albedo(theta_i, phi_i)

    def transmittance(self, theta_i: Array, phi_i: Array, wavelength: Array | None) -> Array:
        return self._model.transmittance(theta_i, phi_i)
