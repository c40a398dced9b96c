"""The apertures of gloss meters: light from a source image into rectangles about its mirror image, integrated on the model.

Rectangles lie in the tangent plane of an axis, u in the plane of incidence (growing with θ) and v across it; a full angle a is a
half width tan(a/2), and dω = du dv / (1 + u² + v²)^(3/2).

References
----------
ASTM D523, ISO 2813 and JIS Z 8741; :mod:`brdfpipe.appearance.gloss` tells what of them is confirmed by public sources.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe.bsdf.registry import representation
from brdfpipe.geometry import Array, angles_of
from brdfpipe.hemisphere import graded_edges, panel_rule
from brdfpipe.optics.fresnel_equations import fresnel

REFERENCE_INDEX = 1.567
"""Of polished black glass, which has 100 units at every geometry (ASTM D523, ISO 2813, JIS Z 8741)."""

SOURCE = (0.75, 2.5)
"""Full angles of the source image, in the plane of incidence and across it [degree] (ASTM D523; not confirmed)."""

_NARROW, _MODERATE = 1e-4, 0.02
_FAINTEST = 1e-12
_BLOCK = 2**19
_FIRST_AZIMUTHS, _MOST_AZIMUTHS = 16, 512
_MEAN_ERROR = 3e-4


class Rule(NamedTuple):
    """Points of the quadrature."""

    source: tuple[int, int]
    """In the plane of incidence and across it."""
    receptor: int
    """In each panel."""


FINE = Rule((4, 6), 5)
"""To 1e-5 of the gloss."""

QUICK = Rule((3, 4), 4)
"""To 3e-4 of the gloss of the narrowest lobes, 2e-5 of moderate ones."""

_QUICKEST = Rule((3, 4), 3)


class Source(NamedTuple):
    """Points of the source image, in its tangent plane and as directions [degree]."""

    u: Array
    v: Array
    weight: Array
    """Projected solid angle of each [sr]."""
    glass: Array
    """Reflectance of black glass, the reference of every instrument."""
    theta: Array
    phi: Array


class Window(NamedTuple):
    """A rectangle in the tangent plane of an axis."""

    low_u: float
    high_u: float
    low_v: float
    high_v: float


def centred(full_u: float, full_v: float) -> Window:
    """The aperture of these full angles [degree]."""
    half_u, half_v = half_width(full_u), half_width(full_v)
    return Window(-half_u, half_u, -half_v, half_v)


def source(angle: float, rule: Rule, window: Window | None = None) -> Source:
    """The source image about the incidence ``angle`` [degree], or another window there."""
    low_u, high_u, low_v, high_v = window or centred(*SOURCE)
    u, weight_u = panel_rule([low_u, high_u], rule.source[0])
    v, weight_v = panel_rule([low_v, high_v], rule.source[1])
    u, v = (grid.ravel() for grid in np.meshgrid(u, v, indexing="ij"))
    theta, phi = directions(u, v, angle)
    cos = np.cos(np.radians(theta))
    weight = np.outer(weight_u, weight_v).ravel() / (1 + u**2 + v**2) ** 1.5 * cos
    return Source(u, v, weight, fresnel(cos, REFERENCE_INDEX)[2], theta, phi)


class Beam(NamedTuple):
    """Light from a source into a window about its mirror image."""

    angle: float
    """Incidence [degree]."""
    light: Source
    window: Window
    order: int
    """Points in each panel of the window."""


def received(bsdf: xr.Dataset, beams: Sequence[Beam], azimuths: Array, scale: float) -> list[Array]:
    """∫window f cos θ_r dω_r of each beam, (azimuths, points of its source).

    Parameters
    ----------
    bsdf : kind ``bsdf`` without wavelength
    beams : all evaluated at once
    azimuths : that the plane of incidence is turned by [degree]; all on the same nodes
    scale : of the lobe, from :func:`lobe_scale`
    """
    nodes = [_nodes(beam, scale) for beam in beams]
    theta_i, phi_i, theta_o, phi_o = (
        np.concatenate(angles) for angles in zip(*(node.at for node in nodes), strict=True)
    )
    evaluate = representation(bsdf).evaluate
    flux: list[list[Array]] = [[] for _ in beams]
    # One evaluation for many azimuths: a representation may work hard before it evaluates its first direction.
    blocks = min(azimuths.size, -(-azimuths.size * theta_i.size // _BLOCK))
    for some in np.array_split(azimuths, max(blocks, 1)):
        turned = (theta_i, phi_i + some[:, None], theta_o, phi_o + 180 + some[:, None])
        brdf = evaluate(*_broadcast(*turned), None)[..., 0]
        parts = np.split(brdf, np.cumsum([node.weight.size for node in nodes])[:-1], axis=1)
        for sums, node, part, beam in zip(flux, nodes, parts, beams, strict=True):
            sums.append(_by_owner(node.weight * part, node.owner, beam.light.u.size))
    return [np.concatenate(sums) for sums in flux]


def _broadcast(theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> tuple[Array, Array, Array, Array]:
    theta_i, phi_i, theta_o, phi_o = np.broadcast_arrays(theta_i, phi_i, theta_o, phi_o)
    return theta_i, phi_i, theta_o, phi_o


def _by_owner(values: Array, owner: NDArray[np.intp], owners: int) -> Array:
    """Sums of each row over the values of each owner, (rows, owners)."""
    rows = values.shape[0]
    into = np.arange(rows)[:, None] * owners + owner
    sums = np.bincount(into.ravel(), values.ravel(), minlength=rows * owners)
    return sums.reshape(rows, owners).astype(float)


def all_round(read: Callable[[Array], Array], bsdf: xr.Dataset) -> tuple[Array, Array]:
    """Azimuths of the plane of incidence [degree] that give the mean of a reading to 1e-4, and the reading there.

    Either half of them is evenly spaced too.

    Notes
    -----
    A fine lay shows within a few degrees of its own azimuth at 85°, so the evenly spaced azimuths start from it: halving their
    step then takes the same peak in at half the weight, and the mean does not settle before the peak is resolved.
    """
    azimuths = (representation(bsdf).lay or 0.0) + np.arange(0.0, 360.0, 360 / _FIRST_AZIMUTHS)
    values = read(azimuths)
    while True:
        between = azimuths + 180 / azimuths.size
        others = read(between)
        change = abs(others.mean() - values.mean()) / 2
        azimuths, values = np.concatenate([azimuths, between]), np.concatenate([values, others])
        # Periodic and smooth: each doubling about squares the error, and the change is that of the coarser mean.
        if change <= _MEAN_ERROR * abs(values.mean()) or azimuths.size >= _MOST_AZIMUTHS:
            return azimuths, values


class _Nodes(NamedTuple):
    at: tuple[Array, Array, Array, Array]
    """θ_i, φ_i, θ_o and φ_o from the mirror direction [degree]"""
    weight: Array
    owner: NDArray[np.intp]
    """Source point of each."""


def _nodes(beam: Beam, scale: float) -> _Nodes:
    """Points of a window for every point of its source.

    The window's axis is the mirror image of the source's, so the mirror direction of source point (u, v) is (u, v) of the
    window; panels are graded towards it, on the scale of the lobe.
    """
    light, window = beam.light, beam.window
    across = max(scale * np.cos(np.radians(beam.angle)), 1e-9)
    u, weight_u = _panels(light.u, scale, window.low_u, window.high_u, beam.order)
    v, weight_v = _panels(light.v, across, window.low_v, window.high_v, beam.order)
    u, v = np.broadcast_arrays(u[:, :, None], v[:, None, :])
    weight = weight_u[:, :, None] * weight_v[:, None, :] / (1 + u**2 + v**2) ** 1.5
    # Panels clipped to the rectangle have no width: most of them, for every single source point.
    used = weight > 0
    theta_o, phi_o = directions(u[used], v[used], beam.angle)
    owner = np.nonzero(used)[0]
    weight = weight[used] * np.cos(np.radians(theta_o))
    return _Nodes((light.theta[owner], light.phi[owner], theta_o, phi_o), weight, owner)


def lobe_scale(bsdf: xr.Dataset) -> float:
    """Half the half width of the specular lobe in radian, a typical slope; a moderate one where the lobe is not known."""
    slope = representation(bsdf).lobe_slope
    if slope is None or (slope < _NARROW and not _peaks(bsdf)):
        return _MODERATE
    return float(np.clip(slope, 1e-6, 0.2))


def mean_rule(scale: float) -> Rule:
    """Points for a mean over many azimuths, to 5e-5 of it: fewer where the lobe is wide."""
    return _QUICKEST if scale > _MODERATE else QUICK


def half_width(full_angle: float) -> float:
    """Half width of an aperture in the tangent plane of its axis."""
    return float(np.tan(np.radians(full_angle) / 2))


def directions(u: Array, v: Array, angle: float) -> tuple[Array, Array]:
    """θ and φ of points of the tangent plane of the axis (angle, 0)."""
    sin, cos = np.sin(np.radians(angle)), np.cos(np.radians(angle))
    return angles_of(np.stack([sin + u * cos, v, cos - u * sin], axis=-1))


def _panels(centre: Array, scale: float, low: float, high: float, order: int) -> tuple[Array, Array]:
    """Panels that double in width from half the scale until they cover the whole window, however narrow the lobe."""
    doublings = int(np.clip(np.ceil(np.log2(4 * max(abs(low), abs(high)) / scale)), 4, 40))
    return panel_rule(graded_edges(centre, scale, low, high, doublings), order)


def _peaks(bsdf: xr.Dataset) -> bool:
    """Whether the BSDF is any larger in the mirror direction than a degree beside it: a polished surface's is not."""
    theta, nowhere = np.full(2, 45.0), np.zeros(2)
    at, beside = representation(bsdf).evaluate(theta, nowhere, np.array([45.0, 44.0]), nowhere + 180, None)[:, 0]
    return bool(at > 2 * beside and at > _FAINTEST)
