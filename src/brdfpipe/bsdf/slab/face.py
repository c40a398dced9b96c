"""Reflection and transmission operators of one face of a slab, between nodes of polar angles outside and inside.

Radiance inside is L/n², and directions are weighted by their étendue, cos θ sin θ dθ outside and n² cos θ sin θ dθ inside: then
every operator is symmetric (reciprocity), and the rows of a lossless face sum to 1. The angles inside are the refracted angles
outside, and angles beyond the critical angle, so that the operator of a smooth face is diagonal.

References
----------
van de Hulst 1980, Multiple Light Scattering, §4 (adding–doubling and its Fourier modes); Stam 2001 and Jakob et al. 2014
(SIGGRAPH, layered materials) for rough interfaces; Kulla & Conty 2017 (SIGGRAPH course) for the light the facets lose.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from brdfpipe.bsdf.microfacet import energy, transmission
from brdfpipe.bsdf.microfacet.microsurface import Microsurface
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.geometry import Array, half_vector
from brdfpipe.hemisphere import panel_rule
from brdfpipe.optics.fresnel_equations import fresnel as fresnel_reflectance

_LEAST_LOSS = 1e-8
_BALANCING_STEPS = 60
_NEGLIGIBLE = 1e-14
_BLOCK = 2**16


@dataclass(frozen=True)
class Nodes:
    """Polar angles outside and inside a body, and their étendues."""

    outside: Array
    """(N,) degree"""
    inside: Array
    """(J,) degree; the first N are those outside, refracted"""
    weight: Array
    """(J,) étendue over 2π; the first N hold outside as well"""

    @classmethod
    def of(cls, index: float, outside: int, beyond: int) -> Nodes:
        """Gauss–Legendre nodes in θ, outside and beyond the critical angle."""
        theta, width = panel_rule(np.array([0.0, np.pi / 2]), outside)
        critical = np.arcsin(1 / index)
        inner, inner_width = panel_rule(np.array([critical, np.pi / 2]), beyond)
        if index == 1:
            inner, inner_width = np.zeros((2, 0))
        weight = [width * np.sin(theta) * np.cos(theta), index**2 * inner_width * np.sin(inner) * np.cos(inner)]
        inside = np.degrees(np.concatenate([np.arcsin(np.sin(theta) / index), inner]))
        return cls(np.degrees(theta), inside, np.concatenate(weight))

    @property
    def outer_weight(self) -> Array:
        """(N,) étendue over 2π of the nodes outside."""
        return self.weight[: self.outside.size]


@dataclass(frozen=True)
class Azimuths:
    """Azimuths from the plane of incidence at which a lobe is sampled, dense at its peak, and its Fourier integrals."""

    phi: Array
    """(P,) radian, from 0 to π"""
    spline: CubicSpline
    """Through unit values at each azimuth, even about both ends"""

    @classmethod
    def of(cls, scale: float, count: int) -> Azimuths:
        """Nodes that resolve lobes of at least the width ``scale`` [radian]."""
        phi = scale * np.sinh(np.linspace(0, np.arcsinh(np.pi / scale), count))
        phi[-1] = np.pi
        return cls(phi, CubicSpline(phi, np.eye(count), bc_type="clamped"))

    def integrals(self, modes: Array) -> Array:
        """∫ g(φ) cos mφ dφ over the circle of the spline g through unit values, (P, modes).

        Exact: after four integrations by parts only the third derivative remains, which is constant between nodes.
        """
        third = 6 * self.spline.c[0]
        cosine = np.cos(self.phi[:, None] * modes)
        with np.errstate(divide="ignore", invalid="ignore"):
            result = 2 * third.T @ (cosine[:-1] - cosine[1:]) / modes**4
        return np.where(modes == 0, 2 * np.asarray(self.spline.integrate(0, np.pi))[:, None], result)


@dataclass(frozen=True)
class Face:
    """The operators of one face, symmetrised by the roots of the étendues."""

    reflected: Array
    """(N,) share of the light from outside that the facets reflect outside [1]"""
    straight: Array
    """(N,) share that is transmitted into the refracted direction [1]"""
    mirrored: Array
    """(J,) share of the light inside that is reflected into the mirror direction [1]"""
    through: Array | None
    """(N, J, P) transmission into other directions, at the azimuths; None for none"""
    within: Array | None
    """(J, J, P) internal reflection into other directions; None for none"""
    lost_outside: Array
    """(N,) loss of the facets after one interaction, which is returned diffusely [1]"""
    lost_inside: Array
    """(J,) the same for light from inside [1]"""
    root: Array
    """(J,) root of the étendues"""
    correction: float
    """Largest difference, in shares of the light, between sums over the nodes and integrals over the facets, before scaling"""

    @property
    def total_loss(self) -> float:
        """∫ of the loss over the étendue of both sides."""
        outer = self.root[: self.straight.size] ** 2
        return float(outer @ self.lost_outside + self.root**2 @ self.lost_inside)

    def operators(self, azimuths: Azimuths, modes: Array) -> tuple[Array, Array]:
        """Transmission (modes, N, J) and internal reflection (modes, J, J) of Fourier modes."""
        outside, inside = self.straight.size, self.mirrored.size
        integrals = azimuths.integrals(modes)
        through = _modes(self.through, integrals, (modes.size, outside, inside))
        within = _modes(self.within, integrals, (modes.size, inside, inside))
        through[:, np.arange(outside), np.arange(outside)] += self.straight
        within[:, np.arange(inside), np.arange(inside)] += self.mirrored
        if self.total_loss > 0:
            # Light that the facets lose is diffuse: it has the zeroth mode alone.
            into, out = self.root * self.lost_inside, self.root[:outside] * self.lost_outside
            through[modes == 0] += np.outer(out, into) / self.total_loss
            within[modes == 0] += np.outer(into, into) / self.total_loss
        return through, within

    @property
    def diffuse(self) -> Array:
        """Factors g(θ), (N,), of the diffuse reflection outside, g(θ_i) g(θ_o) [sr-1/2]."""
        return self.lost_outside / np.sqrt(2 * np.pi * self.total_loss) if self.total_loss > 0 else self.lost_outside

    @property
    def outer_albedo(self) -> Array:
        """(N,) share of the light from outside that is reflected without entering."""
        if self.total_loss == 0:
            return self.reflected
        outer = self.root[: self.straight.size] ** 2
        return np.asarray(self.reflected + self.lost_outside * (outer @ self.lost_outside) / self.total_loss)


def _modes(kernel: Array | None, integrals: Array, shape: tuple[int, ...]) -> Array:
    if kernel is None:
        return np.zeros(shape)
    return np.ascontiguousarray(np.moveaxis(kernel @ integrals, -1, 0))


def smooth(index: float, nodes: Nodes) -> Face:
    """A perfectly smooth face: Fresnel's reflectance on the diagonals, and 1 beyond the critical angle."""
    reflected = fresnel_reflectance(np.cos(np.radians(nodes.outside)), index).mean
    mirrored = np.concatenate([reflected, np.ones(nodes.inside.size - reflected.size)])
    no_loss = np.zeros(reflected.size), np.zeros(mirrored.size)
    return Face(reflected, 1 - reflected, mirrored, None, None, *no_loss, np.sqrt(nodes.weight), 0.0)


def rough(
    surface: Microsurface, masking: str, index: float, nodes: Nodes, azimuths: Azimuths, sharp: tuple[bool, bool]
) -> Face:
    """A rough, isotropic face, with ``index`` that of the body and the facets seen from outside.

    ``sharp`` takes the transmitted, or the internally reflected, lobe as a single direction, because the nodes do not resolve it.

    The kernels are sampled at the nodes, then scaled, d_i K_ij d_j, until their sums over the nodes equal the integrals over the
    facets. The rest to 1 is e(θ), light that met more than one facet; it is returned as e(θ_i) e(θ_o) / ∫ e over both sides, in L/n²:
    this is reciprocal, and energy is conserved to rounding.
    """
    n, k = np.array([index]), np.zeros(1)
    reflected = energy.directional_albedo(surface, masking, n, k, nodes.outside)[:, 0]
    mirrored = energy.directional_albedo(surface, masking, 1 / n, k, nodes.inside)[:, 0]
    inward = transmission.directional_transmittance(surface, masking, n, nodes.outside)[:, 0]
    outward = transmission.directional_transmittance(surface, masking, n, 180 - nodes.inside)[:, 0]
    inward = np.clip(inward, 0.0, 1 - reflected - _LEAST_LOSS)
    outward = np.clip(outward, 0.0, 1 - mirrored - _LEAST_LOSS)
    mirrored = np.clip(mirrored, 0.0, 1 - _LEAST_LOSS)
    root, outside = np.sqrt(nodes.weight), nodes.outside.size
    zeroth = azimuths.integrals(np.zeros(1))[:, 0]
    straight, delta, corrections = np.zeros(outside), np.zeros(nodes.inside.size), [0.0]
    through, within = None, None
    t, r = np.zeros((outside, nodes.inside.size)), np.zeros((nodes.inside.size,) * 2)
    if sharp[0]:
        straight = np.minimum(inward, outward[:outside])
    else:
        through = _through(surface, masking, index, nodes, azimuths)
        through = through * np.multiply.outer(root[:outside], root)[..., None]
        through, correction = _balanced(through, azimuths, root[:outside], root, inward, outward)
        corrections.append(correction)
        t = through @ zeroth
    if sharp[1]:
        delta = mirrored
    else:
        within = _within(surface, masking, index, nodes, azimuths) * np.multiply.outer(root, root)[..., None]
        within, correction = _balanced(within, azimuths, root, root, mirrored, mirrored)
        corrections.append(correction)
        r = within @ zeroth
    leaves = (root[:outside] @ t) / root
    leaves[:outside] += straight
    lost_outside = 1 - reflected - straight - (t @ root) / root[:outside]
    lost_inside = 1 - delta - leaves - (r @ root) / root
    return Face(reflected, straight, delta, through, within, lost_outside, lost_inside, root, max(corrections))


def _through(surface: Microsurface, masking: str, index: float, nodes: Nodes, azimuths: Azimuths) -> Array:
    """f_t/n² from the nodes outside to those inside, (N, J, P)."""
    result = np.empty((nodes.outside.size, nodes.inside.size, azimuths.phi.size))
    phi = 180 + np.degrees(azimuths.phi)
    assert isinstance(surface.density, RadialDensity)
    slope, density = surface.density.slope, surface.density.density
    steepest = float(slope[density > _NEGLIGIBLE * density.max()][-1])
    rows = max(1, _BLOCK // result[0].size)
    for start in range(0, nodes.outside.size, rows):
        block = slice(start, start + rows)
        theta_i, theta_o, azimuth = np.broadcast_arrays(
            nodes.outside[block, None, None], 180 - nodes.inside[:, None], phi
        )
        cos_i, cos_o = np.cos(np.radians(theta_i)), np.cos(np.radians(theta_o))
        cosine = cos_i * cos_o + np.sin(np.radians(theta_i)) * np.sin(np.radians(theta_o)) * np.cos(np.radians(azimuth))
        # Most pairs of directions would need facets steeper than any in the density; their slope is cheap to test.
        length = 1 + index**2 + 2 * index * cosine
        present = length < (1 + steepest**2) * (cos_i + index * cos_o) ** 2
        values = np.zeros(theta_i.shape)
        angles = theta_i[present], np.zeros(np.count_nonzero(present)), theta_o[present], azimuth[present]
        values[present] = transmission.transmitted(surface, masking, index, *angles) / index**2
        result[block] = values
    return result


def _within(surface: Microsurface, masking: str, index: float, nodes: Nodes, azimuths: Azimuths) -> Array:
    """f_r/n² between the nodes inside, (J, J, P)."""
    count = nodes.inside.size
    first, second = np.triu_indices(count)
    result = np.empty((count, count, azimuths.phi.size))
    phi = 180 + np.degrees(azimuths.phi)
    pairs = max(1, _BLOCK // phi.size)
    for start in range(0, first.size, pairs):
        i, o = first[start : start + pairs], second[start : start + pairs]
        pair = half_vector(nodes.inside[i, None], 0.0, nodes.inside[o, None], phi)
        fresnel = fresnel_reflectance(pair.cos_zeta, 1 / index).mean
        values = surface.reflected(pair, 0.0, phi, masking) * fresnel / index**2
        result[i, o] = values
        result[o, i] = values
    return result


def _balanced(
    kernel: Array, azimuths: Azimuths, row_root: Array, column_root: Array, rows: Array, columns: Array
) -> tuple[Array, float]:
    """A kernel scaled so that its rows and columns sum to given shares, never to more; and the largest correction.

    Sinkhorn & Knopp 1967, by roots so that a symmetric kernel stays symmetric. Rows and columns must carry the same total: the larger
    shares are lowered to it. The last steps only shrink, so that no sum exceeds its share.
    """
    carried = float(row_root**2 @ rows), float(column_root**2 @ columns)
    rows, columns = rows * min(1.0, carried[1] / carried[0]), columns * min(1.0, carried[0] / carried[1])
    zeroth = kernel @ azimuths.integrals(np.zeros(1))[:, 0]
    matrix = zeroth * column_root / row_root[:, None]
    transposed = zeroth * row_root[:, None] / column_root
    correction = float(row_root**2 @ np.abs(matrix.sum(axis=1) - rows) / carried[0])
    down, across = np.ones(rows.size), np.ones(columns.size)
    for step in range(_BALANCING_STEPS):
        sums = down * (matrix @ across), across * (down @ transposed)
        # Limited, because the ratios of negligible shares are inaccurate.
        high, power = (2.0, 0.5) if step < _BALANCING_STEPS - 8 else (1.0, 1.0)
        down = down * np.clip(rows / np.maximum(sums[0], 1e-30), 0.0, high) ** power
        across = across * np.clip(columns / np.maximum(sums[1], 1e-30), 0.0, high) ** power
    return kernel * (np.clip(down, 0.0, 2.0)[:, None] * np.clip(across, 0.0, 2.0))[..., None], correction
