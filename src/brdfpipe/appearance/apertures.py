"""Apertures of gloss meters: light from the source image into rectangular windows about its mirror image, integrated on the model.

Windows are rectangles in the tangent plane of an axis, u in the plane of incidence (increasing with θ), v across it. A full angle a
has the half width tan(a/2), and dω = du dv / (1 + u² + v²)^(3/2).

References
----------
ASTM D523, ISO 2813 and JIS Z 8741; :mod:`brdfpipe.appearance.gloss_meter` states what public sources confirm of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import vocabulary
from brdfpipe.bsdf.base import Representation
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.source_changes import Reflector, SourceChanges
from brdfpipe.geometry import Array, angles_of
from brdfpipe.hemisphere import graded_edges, panel_rule
from brdfpipe.optics.fresnel_equations import fresnel

REFERENCE_INDEX = 1.567
"""Index of polished black glass, which has 100 units at every geometry (ASTM D523, ISO 2813, JIS Z 8741)."""

SOURCE = (0.75, 2.5)
"""Full angles of the source image, in the plane of incidence and across it [degree] (ASTM D523; not confirmed)."""

_NARROWEST_SLOPE, _NARROW_SLOPE, _MODERATE_SLOPE = 1e-6, 1e-4, 0.02
_DARKEST_LOBE = 1e-12
_MOST_EVALUATIONS = 2**19
_FIRST_AZIMUTHS, _MOST_AZIMUTHS, _CONVERGED = 16, 512, 3e-4


class Rule(NamedTuple):
    """Numbers of quadrature points."""

    source: tuple[int, int]
    """In the plane of incidence, and across it."""
    window: int
    """In each panel of the window, along each side."""


FINE = Rule((4, 6), 5)
"""Accurate to 2e-5 of the gloss of facets, and to 1e-3 of it of a halo that is narrow beside its facets, or empty about the mirror direction."""

QUICK, _QUICKEST = Rule((3, 4), 4), Rule((3, 4), 3)
"""Accurate to 3e-4 of the gloss of the narrowest lobes, 2e-5 of moderate ones; and to 5e-5 of a mean over azimuths of wide lobes."""

UNCERTAINTY_ORDER = 3
"""Points in each panel of a window, for an uncertainty."""


@dataclass(frozen=True, eq=False)
class Source:
    """Points of the source image, in its tangent plane and as directions [degree]."""

    u: Array
    v: Array
    weight: Array
    """Projected solid angle of each point [sr]."""
    glass: Array
    """Reflectance of black glass at each point."""
    theta: Array
    phi: Array

    @classmethod
    def joined(cls, sources: Sequence[Source]) -> Source:
        """The points of several sources, one after the other."""
        return cls(*(np.concatenate([getattr(one, part.name) for one in sources]) for part in fields(cls)))

    @cached_property
    def on_one_side(self) -> tuple[Source, NDArray[np.intp]]:
        """The source without the mirror images of its points in the plane of incidence, and the number of the point left for each."""
        place = np.round(np.stack([self.u, np.abs(self.v)]), 12)
        _, kept, number = np.unique(place, axis=1, return_index=True, return_inverse=True)
        return Source(*(getattr(self, part.name)[kept] for part in fields(self))), number.reshape(-1)


class Window(NamedTuple):
    """A rectangle in the tangent plane of an axis."""

    low_u: float
    high_u: float
    low_v: float
    high_v: float


class Beam(NamedTuple):
    """Light from a source into a window about its mirror image."""

    angle: float
    """Incidence [degree]."""
    light: Source
    window: Window
    order: int
    """Points in each panel of the window."""


class Sample(NamedTuple):
    """What a gloss meter measures."""

    bsdf: xr.Dataset
    """Without wavelength."""
    azimuth: float | None
    """Azimuth of the plane of incidence [degree]; None for the mean over all of them."""
    lobe: float
    """Typical slope of the lobe [rad]."""

    def lobe_at(self, angle: float) -> float:
        """That of the narrowest part of the lobe at an incidence [degree]."""
        narrowest = representation(self.bsdf).lobe_slope_at(angle)
        return self.lobe if narrowest is None else min(self.lobe, max(narrowest, _NARROWEST_SLOPE))


def sample_of(bsdf: xr.Dataset, azimuth: float | None) -> Sample:
    """The sample of a BSDF, averaged with V(λ)·D65; of an isotropic one, a single azimuth stands for all."""
    vocabulary.validate(bsdf, "bsdf")
    reduced = nonspectral(bsdf)
    if azimuth is None and representation(reduced).isotropic:
        azimuth = 0.0
    return Sample(reduced, azimuth, lobe_scale(reduced))


def half_width(full_angle: float) -> float:
    """Half width of an aperture in the tangent plane of its axis; ``full_angle`` in degree."""
    return float(np.tan(np.radians(full_angle) / 2))


def centred(full_u: float, full_v: float) -> Window:
    """A window centred on its axis, from its full angles [degree]."""
    half_u, half_v = half_width(full_u), half_width(full_v)
    return Window(-half_u, half_u, -half_v, half_v)


def directions(u: Array, v: Array, angle: float) -> tuple[Array, Array]:
    """θ and φ [degree] of points of the tangent plane of the axis (``angle``, 0)."""
    sin, cos = np.sin(np.radians(angle)), np.cos(np.radians(angle))
    return angles_of(np.stack([sin + u * cos, v, cos - u * sin], axis=-1))


@lru_cache(maxsize=256)
def source(angle: float, rule: Rule, window: Window | None = None) -> Source:
    """The source image about the incidence ``angle`` [degree], or another window there; the same object each time, as it is the same of all materials."""
    low_u, high_u, low_v, high_v = window or centred(*SOURCE)
    u, weight_u = panel_rule([low_u, high_u], rule.source[0])
    v, weight_v = panel_rule([low_v, high_v], rule.source[1])
    u, v = (grid.ravel() for grid in np.meshgrid(u, v, indexing="ij"))
    theta, phi = directions(u, v, angle)
    cos = np.cos(np.radians(theta))
    weight = np.outer(weight_u, weight_v).ravel() / (1 + u**2 + v**2) ** 1.5 * cos
    return Source(u, v, weight, fresnel(cos, REFERENCE_INDEX)[2], theta, phi)


def gloss_units_of(light: Source, reflected: Array) -> Array:
    """Gloss units of the share of light reflected from each point of a source, (azimuths, points) → (azimuths,)."""
    return np.asarray(100 * (reflected @ light.weight) / (light.weight @ light.glass))


def over_azimuths(sample: Sample, measure: Callable[[Array, Rule], Array], rule: Rule) -> tuple[Array, Array]:
    """Azimuths of the plane of incidence [degree], and the values of a measure (azimuths, rule) → values at each.

    One azimuth with ``rule``; or as many as give the mean to 1e-4, the first and the second half of them evenly spaced. They start
    from the lay: at 85° a fine lay shows only within a few degrees of it, and the mean must not settle before this peak is resolved.
    """
    if sample.azimuth is not None:
        azimuths = np.array([sample.azimuth])
        return azimuths, measure(azimuths, rule)
    quick = _QUICKEST if sample.lobe > _MODERATE_SLOPE else QUICK
    azimuths = (representation(sample.bsdf).lay or 0.0) + np.arange(0.0, 360.0, 360 / _FIRST_AZIMUTHS)
    values = measure(azimuths, quick)
    while True:
        between = azimuths + 180 / azimuths.size
        values_between = measure(between, quick)
        change = abs(values_between.mean() - values.mean()) / 2
        azimuths, values = np.concatenate([azimuths, between]), np.concatenate([values, values_between])
        # Periodic and smooth: each doubling roughly squares the error, and the change is that of the coarser mean.
        if change <= _CONVERGED * abs(values.mean()) or azimuths.size >= _MOST_AZIMUTHS:
            return azimuths, values


def first_half(azimuths: Array) -> slice:
    """The evenly spaced first half of azimuths of :func:`over_azimuths`, which is enough for an uncertainty."""
    return slice(-(-azimuths.size // 2))


def received(sample: Sample, beams: Sequence[Beam], azimuths: Array, reflector: Reflector | None = None) -> list[Array]:
    """∫window f cos θ_r dω_r of each beam at azimuths of the plane of incidence [degree], (azimuths, points of its source).

    ``reflector`` is evaluated instead of the BSDF of the sample, which gives the nodes of the quadrature.
    """
    return Receptors.of(sample, beams).received(azimuths, reflector)


class Receptors(NamedTuple):
    """The quadrature of the light that a sample sends into windows; the same for all its BSDFs that are compared."""

    given: Representation
    """The BSDF of the sample"""
    nodes: list[WindowNodes]
    """Of each beam, for the points of its source that are evaluated"""
    number: list[NDArray[np.intp]]
    """Of the point that is evaluated for each point of the source"""

    @classmethod
    def of(cls, sample: Sample, beams: Sequence[Beam]) -> Receptors:
        given = representation(sample.bsdf)
        reduced = [_on_one_side(beam, given.mirror_symmetric) for beam in beams]
        return cls(
            given,
            [window_nodes(beam, sample.lobe_at(beam.angle)) for beam, _ in reduced],
            [number for _, number in reduced],
        )

    def received(self, azimuths: Array, reflector: Reflector | None = None) -> list[Array]:
        """As :func:`received`."""
        evaluate = (self.given if reflector is None else reflector).evaluate
        return self._received(azimuths, lambda *at: [evaluate(*at)])[0]

    def received_each(self, azimuths: Array, changes: SourceChanges) -> list[list[Array]]:
        """The same of a BSDF, and of the same after each change of its inputs."""
        return self._received(azimuths, changes.evaluate_each)

    def _received(
        self, azimuths: Array, evaluate: Callable[[Array, Array, Array, Array, Array | None], list[Array]]
    ) -> list[list[Array]]:
        """Of several BSDFs that are evaluated together."""
        angles = zip(*(node.directions for node in self.nodes), strict=True)
        theta_i, phi_i, theta_o, phi_o = map(np.concatenate, angles)
        flux: list[list[list[Array]]] = []
        # One evaluation for many azimuths: a representation may work hard before it evaluates its first direction.
        blocks = min(azimuths.size, -(-azimuths.size * theta_i.size // _MOST_EVALUATIONS))
        for turn in np.array_split(azimuths, max(blocks, 1)):
            turned = np.broadcast_arrays(theta_i, phi_i + turn[:, None], theta_o, phi_o + 180 + turn[:, None])
            values = evaluate(turned[0], turned[1], turned[2], turned[3], None)
            flux.append([self._by_point(brdf[..., 0]) for brdf in values])
        # From block, BSDF, beam to BSDF, beam.
        return [[np.concatenate(sums) for sums in zip(*of_one, strict=True)] for of_one in zip(*flux, strict=True)]

    def _by_point(self, brdf: Array) -> list[Array]:
        """Sums over the windows of the beams, (azimuths, points of the source) each, of a BRDF (azimuths, nodes)."""
        parts = np.split(brdf, np.cumsum([node.weight.size for node in self.nodes])[:-1], axis=1)
        return [
            _sums_by_point(node.weight * part, node.source_point, int(number.max()) + 1)[:, number]
            for node, part, number in zip(self.nodes, parts, self.number, strict=True)
        ]


def _on_one_side(beam: Beam, symmetric: bool) -> tuple[Beam, NDArray[np.intp]]:
    """A beam without the points of its source that receive as much as another, and the number of the point left for each.

    Those are mirror images in the plane of incidence, if BSDF and window are symmetric about it.
    """
    light, window = beam.light, beam.window
    if not symmetric or window.low_v != -window.high_v:
        return beam, np.arange(light.u.size)
    kept, number = light.on_one_side
    return beam._replace(light=kept), number


def _sums_by_point(values: Array, point: NDArray[np.intp], points: int) -> Array:
    """Sums of each row over the values of each source point, (rows, points)."""
    rows = values.shape[0]
    bins = np.arange(rows)[:, None] * points + point
    return np.bincount(bins.ravel(), values.ravel(), minlength=rows * points).reshape(rows, points).astype(float)


class WindowNodes(NamedTuple):
    directions: tuple[Array, Array, Array, Array]
    """θ_i, φ_i, θ_o, and φ_o from the mirror direction [degree]."""
    weight: Array
    source_point: NDArray[np.intp]


def window_nodes(beam: Beam, lobe: float) -> WindowNodes:
    """Quadrature points of a window for every point of its source.

    The axis of the window is the mirror image of that of the source. The mirror direction of source point (u, v) is therefore
    (u, v) of the window, and panels are graded towards it on the scale of the lobe.
    """
    light, window = beam.light, beam.window
    lobe_across = max(lobe * np.cos(np.radians(beam.angle)), 1e-9)
    u, weight_u = _panels(light.u, lobe, window.low_u, window.high_u, beam.order)
    v, weight_v = _panels(light.v, lobe_across, window.low_v, window.high_v, beam.order)
    # Most panels are clipped to the window, and have no width.
    point, column, row = np.nonzero((weight_u > 0)[:, :, None] & (weight_v > 0)[:, None, :])
    u, v, weight = u[point, column], v[point, row], weight_u[point, column] * weight_v[point, row]
    squared = 1 + u**2 + v**2
    theta_o, phi_o = directions(u, v, beam.angle)
    weight *= np.cos(np.radians(theta_o)) / (squared * np.sqrt(squared))
    return WindowNodes((light.theta[point], light.phi[point], theta_o, phi_o), weight, point)


def _panels(centre: Array, scale: float, low: float, high: float, order: int) -> tuple[Array, Array]:
    """Panels that double in width from half the scale until they cover the whole window, for narrow lobes too."""
    doublings = int(np.clip(np.ceil(np.log2(4 * max(abs(low), abs(high)) / scale)), 4, 40))
    return panel_rule(graded_edges(centre, scale, low, high, doublings), order)


def lobe_scale(bsdf: xr.Dataset) -> float:
    """A quarter of the full width of the specular lobe [rad], a typical slope. Without a lobe, or if its width is unknown: a moderate slope."""
    slope = representation(bsdf).lobe_slope
    if slope is None or (slope < _NARROW_SLOPE and not _has_lobe(bsdf)):
        return _MODERATE_SLOPE
    return float(np.clip(slope, _NARROWEST_SLOPE, 0.2))


def _has_lobe(bsdf: xr.Dataset) -> bool:
    """Whether the BSDF is larger in the mirror direction than a degree beside it; a polished surface has no such lobe."""
    theta, zero = np.full(2, 45.0), np.zeros(2)
    at, beside = representation(bsdf).evaluate(theta, zero, np.array([45.0, 44.0]), zero + 180, None)[:, 0]
    return bool(at > 2 * beside and at > _DARKEST_LOBE)
