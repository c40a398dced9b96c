"""Reflection and transmission operators of one face of a slab, between nodes of polar angles outside and inside.

Radiance inside is L/n², and directions are weighted by their étendue, cos θ sin θ dθ outside and n² cos θ sin θ dθ inside: then
reciprocity makes every operator symmetric, and the rows of a lossless face sum to 1. The angles inside are the refracted angles
outside, and angles beyond the critical angle, so that the operator of a smooth face is diagonal.

Light inside is a Stokes vector (I, Q, U, V), in the frames of :mod:`brdfpipe.bsdf.microfacet.polarised`. Light outside is unpolarised
where it enters, and only its I is needed where it leaves. About the plane of incidence I and Q are even, U and V odd in azimuth: of
each Fourier mode the first two have the cosine, the others the sine.

References
----------
van de Hulst 1980, Multiple Light Scattering, §4 (adding–doubling and its Fourier modes); Hovenier, van der Mee & Domke 2004,
Transfer of Polarized Light in Planetary Atmospheres (symmetries and Fourier modes of Stokes vectors); Stam 2001 and
Jakob et al. 2014 (SIGGRAPH, layered materials) for rough interfaces; Kulla & Conty 2017 (SIGGRAPH course) for the light the facets lose.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from brdfpipe.bsdf.microfacet import energy, transmission
from brdfpipe.bsdf.microfacet.microsurface import Microsurface
from brdfpipe.bsdf.microfacet.polarised import phased_product
from brdfpipe.bsdf.slab.lobe_table import barycentric
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.geometry import Array, HalfVector, frame_rotation, half_vector
from brdfpipe.hemisphere import panel_rule
from brdfpipe.optics.fresnel_equations import fresnel as fresnel_reflectance

LEAST_LOSS = 1e-8
"""Share of the light that every face loses, so that no rounding makes a loss negative [1]."""

_TINY = 1e-300
_BALANCING_STEPS = 60
_NEGLIGIBLE = 1e-14
_BLOCK = 2**16
PANELS = 48
"""Panels of slopes over which the shares of facets are integrated."""


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
        inner, inner_width = np.zeros((2, 0))
        if index > 1:
            inner, inner_width = panel_rule(np.array([np.arcsin(1 / index), np.pi / 2]), beyond)
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
    odd_spline: CubicSpline
    """The same, odd about both ends"""

    @classmethod
    def of(cls, scale: float, count: int) -> Azimuths:
        """Nodes that resolve lobes of at least the width ``scale`` [radian]."""
        phi = scale * np.sinh(np.linspace(0, np.arcsinh(np.pi / scale), count))
        phi[-1] = np.pi
        splines = (CubicSpline(phi, np.eye(count), bc_type=ends) for ends in ("clamped", "natural"))
        return cls(phi, *splines)

    def integrals(self, modes: Array) -> Array:
        """∫ g(φ) cos mφ dφ over the circle of the spline g through unit values, (P, modes).

        Exact: after four integrations by parts only the third derivative remains, which is constant between nodes.
        """
        third = 6 * self.spline.c[0]
        cosine = np.cos(self.phi[:, None] * modes)
        with np.errstate(divide="ignore", invalid="ignore"):
            result = 2 * third.T @ (cosine[:-1] - cosine[1:]) / modes**4
        return np.where(modes == 0, 2 * np.asarray(self.spline.integrate(0, np.pi))[:, None], result)

    def odd_integrals(self, modes: Array) -> Array:
        """∫ g(φ) sin mφ dφ over the circle of the odd spline g, which is 0 at both ends, (P, modes)."""
        third = 6 * self.odd_spline.c[0]
        sine = np.sin(self.phi[:, None] * modes)
        with np.errstate(divide="ignore", invalid="ignore"):
            result = 2 * third.T @ (sine[:-1] - sine[1:]) / modes**4
        return np.where(modes == 0, 0.0, result)


ELEMENTS = ("II", "QI", "QQ", "UI", "UQ", "UU", "VQ", "VU", "VV")
"""Elements of an internal reflection's Mueller matrix, light that leaves first; reciprocity gives the others."""

_PLACES = tuple(("IQUV".index(element[0]), "IQUV".index(element[1])) for element in ELEMENTS)
_ODD = tuple((out > 1) != (into > 1) for out, into in _PLACES)
_THROUGH_ODD = (False, False, True)
REVERSED = np.array([1.0, 1.0, -1.0, 1.0])
"""Signs of I, Q, U and V of light that runs back: the p axis stays, the s axis turns round."""


@dataclass(frozen=True)
class Face:
    """The operators of one face, symmetrised by the roots of the étendues."""

    reflected: Array
    """(N,) share of the light from outside that is reflected outside, without what the facets lose [1]"""
    straight: Array
    """(2, N) I and Q of the light that is transmitted into the refracted direction, of unit light [1]"""
    mirrored: Array
    """(elements, J) Mueller matrix of the reflection inside into the mirror direction [1]"""
    through: Array | None
    """(3, N, J, P) I, Q and U of the light transmitted into other directions, at the azimuths; None for none"""
    within: Array | None
    """(elements, J, J, P) internal reflection into other directions, light that leaves first; None for none"""
    lost_outside: Array
    """(N,) loss of the facets after one interaction, which is returned diffusely [1]"""
    lost_inside: Array
    """(2, J) the same for I and Q of light from inside [1]"""
    root: Array
    """(J,) root of the étendues"""
    correction: float
    """Largest difference, in shares of the light, between sums over the nodes and integrals over the facets, before scaling"""
    mirrored_outside: Array
    """(N,) share of the light from outside that is reflected outside into the mirror direction [1]"""

    @property
    def is_smooth(self) -> bool:
        """Whether light leaves the face into the mirrored and the refracted direction alone."""
        return self.through is None and self.within is None and self.total_loss == 0

    @property
    def total_loss(self) -> float:
        """∫ of the loss over the étendue of both sides."""
        return float(self.outer_root**2 @ self.lost_outside + self.root**2 @ self.lost_inside[0])

    @property
    def outer_root(self) -> Array:
        """(N,) root of the étendues of the nodes outside."""
        return self.root[: self.lost_outside.size]

    def operators(self, azimuths: Azimuths, modes: Array, components: int, first: int = 0) -> tuple[Array, Array]:
        """Transmission from outside and internal reflection of Fourier modes, for the first ``components`` of I, Q, U and V.

        Returns (modes, components, J, N) and (modes, components, J, components, J), for the nodes from the ``first`` on.
        """
        outside, inside = self.lost_outside.size - first, self.root.size - first
        even, odd = azimuths.integrals(modes), azimuths.odd_integrals(modes)
        through = np.zeros((modes.size, components, inside, outside))
        within = np.zeros((modes.size, components, inside, components, inside))
        at, at_outside = np.arange(inside), np.arange(outside)
        for component in range(min(components, 2)):
            through[:, component, at_outside, at_outside] = self.straight[component, first:]
        if self.through is not None:
            for component, kernel in enumerate(self.through[:components, first:, first:]):
                through[:, component] += _modes(kernel, odd if _THROUGH_ODD[component] else even).swapaxes(1, 2)
        for element, (outgoing, into) in enumerate(_PLACES):
            if outgoing >= components:
                break
            part = np.zeros((modes.size, inside, inside))
            part[:, at, at] = self.mirrored[element, first:]
            if self.within is not None:
                part += _modes(self.within[element, first:, first:], odd if _ODD[element] else even)
            within[:, outgoing, :, into] = part
            if outgoing != into:
                within[:, into, :, outgoing] = part.swapaxes(1, 2) * (REVERSED[outgoing] * REVERSED[into])
        if self.total_loss > 0 and modes[0] == 0:
            # Light that the facets lose is diffuse: it has the zeroth mode alone, without U and V.
            into_i_q, out = (
                (self.root * self.lost_inside[:components])[:, first:],
                (self.outer_root * self.lost_outside)[first:],
            )
            through[0, :2] += np.multiply.outer(into_i_q, out) / self.total_loss
            within[0, :2, :, :2] += np.multiply.outer(into_i_q, into_i_q) / self.total_loss
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
        return np.asarray(
            self.reflected + self.lost_outside * (self.outer_root**2 @ self.lost_outside) / self.total_loss
        )


def _modes(kernel: Array, integrals: Array) -> Array:
    return np.moveaxis(kernel @ integrals, -1, 0)


def smooth(index: float, nodes: Nodes) -> Face:
    """A perfectly smooth face: Fresnel's reflectance on the diagonals, and 1 beyond the critical angle."""
    outside = fresnel_reflectance(np.cos(np.radians(nodes.outside)), index)
    mirrored = mirror_elements(np.cos(np.radians(nodes.inside)), 1 / index)
    # The light that passes is the same from either side.
    mirrored[:3, : outside.mean.size] = outside.mean, (outside.s - outside.p) / 2, outside.mean
    straight = np.stack([1 - outside.mean, -(outside.s - outside.p) / 2])
    no_loss = np.zeros(outside.mean.size), np.zeros((2, nodes.inside.size))
    return Face(outside.mean, straight, mirrored, None, None, *no_loss, np.sqrt(nodes.weight), 0.0, outside.mean)


def mirror_elements(cosine: Array, n: float, k: float = 0.0) -> Array:
    """Mueller matrix (elements, …) of the reflection inside by a facet, in its own frame; n and k of what lies behind it, relative to the body."""
    fresnel, phased = fresnel_reflectance(cosine, n, k), phased_product(cosine, n, k)
    none, difference = np.zeros_like(fresnel.mean), (fresnel.s - fresnel.p) / 2
    return np.stack([fresnel.mean, difference, fresnel.mean, none, none, phased.real, none, phased.imag, phased.real])


def rough(
    surface: Microsurface,
    masking: str,
    index: float,
    nodes: Nodes,
    azimuths: Azimuths,
    sharp: tuple[bool, bool],
    panels: int = PANELS,
) -> Face:
    """A rough, isotropic face, with ``index`` that of the body and the facets seen from outside.

    ``sharp`` takes the transmitted, or the internally reflected, lobe as a single direction, because the nodes do not resolve it.

    The kernels are sampled at the nodes, then scaled, d_i K_ij d_j, until the sums of their I over the nodes equal the integrals over
    the facets. The rest to 1 is e(θ), light that met more than one facet; it is returned as e(θ_i) e(θ_o) / ∫ e over both sides, in
    L/n²: this is reciprocal, and energy is conserved to rounding. Of light from inside, e has a part for I and one for Q, |e_Q| <= e_I.
    """
    shares = FacetShares(surface, masking, index, nodes, panels)
    reflected, mirrored, inward, outward = shares.reflected, shares.mirrored, shares.inward, shares.outward
    inward = np.clip(inward, 0.0, 1 - reflected - LEAST_LOSS)
    outward = np.clip(outward, 0.0, 1 - mirrored - LEAST_LOSS)
    mirrored = np.clip(mirrored, 0.0, 1 - LEAST_LOSS)
    root, outside = np.sqrt(nodes.weight), nodes.outside.size
    outer_root = root[:outside]
    straight, delta, corrections = np.zeros((2, outside)), np.zeros((len(ELEMENTS), root.size)), [0.0]
    through, within = None, None
    alike = smooth(index, nodes)
    if sharp[0]:
        straight = np.minimum(inward, outward[:outside]) * alike.straight / np.maximum(alike.straight[0], _TINY)
    else:
        through = transmitted_by_facets(surface, masking, index, nodes, azimuths)
        scale, correction = balance(through[0], azimuths, outer_root, root, inward, outward)
        through *= scale[..., None]
        corrections.append(correction)
    if sharp[1]:
        delta = mirrored * alike.mirrored / np.maximum(alike.mirrored[0], _TINY)
    else:
        within = mirrored_by_facets(surface, masking, index, nodes, azimuths)
        scale, correction = balance(within[0], azimuths, root, root, mirrored, mirrored)
        within *= scale[..., None]
        corrections.append(correction)
    none = np.zeros(outside)
    face = Face(
        reflected, straight, delta, through, within, none, np.zeros((2, root.size)), root, max(corrections), none
    )
    return with_losses(face, azimuths)


@dataclass(frozen=True)
class FacetShares:
    """Shares of the light that facets reflect or transmit, (N,) from outside and (J,) from inside.

    They are integrated at fewer angles than those of the nodes, and polynomials between these: within 1e-3 but for the last degree
    before grazing and lobes of 0.02, and within 1e-4 of the light from all angles.
    """

    surface: Microsurface
    masking: str
    index: float
    nodes: Nodes
    panels: int = PANELS
    """Panels of slopes; fewer go with fewer angles"""

    @property
    def reflected(self) -> Array:
        """Light from outside that is reflected outside, (N,)."""
        return self._between(lambda theta: self._albedo(self.index, theta), inside=False)

    @property
    def mirrored(self) -> Array:
        """Light from inside that is reflected inside, (J,)."""
        return self._between(lambda theta: self._albedo(1 / self.index, theta), inside=True)

    @property
    def inward(self) -> Array:
        """Light from outside that is transmitted, (N,)."""
        return self._between(self._transmittance, inside=False)

    @property
    def outward(self) -> Array:
        """Light from inside that is transmitted, (J,)."""
        return self._between(lambda theta: self._transmittance(180 - theta), inside=True)

    def _albedo(self, index: float, theta: Array) -> Array:
        given = self.surface, self.masking, np.array([index]), np.zeros(1), theta
        return energy.directional_albedo(*given, panels=self.panels)[:, 0]

    def _transmittance(self, theta: Array) -> Array:
        given = self.surface, self.masking, np.array([self.index]), theta
        return transmission.directional_transmittance(*given, panels=self.panels)[:, 0]

    def _between(self, share: Callable[[Array], Array], *, inside: bool) -> Array:
        """A share at all nodes, from that at fewer angles; of an angle inside as a polynomial in its angle outside, if there is one."""
        nodes, outside = self.nodes, self.nodes.outside.size
        beyond = nodes.inside.size - outside
        least = self.panels // 2, self.panels // 3
        fewer = Nodes.of(self.index, min(outside, max(least[0], outside // 3)), min(beyond, max(least[1], beyond // 3)))
        values = share(fewer.inside if inside else fewer.outside)
        below = barycentric(fewer.outside, nodes.outside) @ values[: fewer.outside.size]
        if not inside or not beyond:
            return np.asarray(below)
        above = barycentric(fewer.inside[fewer.outside.size :], nodes.inside[outside:]) @ values[fewer.outside.size :]
        return np.concatenate([below, above])


def with_losses(face: Face, azimuths: Azimuths) -> Face:
    """The face with its losses, which are what its operators lack of the conservation of energy.

    The loss of Q is at most that of I; the rest of it, an error of the sums over the nodes, is corrected in the operators.
    """
    (t,), (r,) = face.operators(azimuths, np.zeros(1), 2)
    root, outer_root = face.root, face.outer_root
    kept = (t[0].T @ root) / outer_root
    # I of the light that leaves, of unit I or Q from inside.
    leaves = (np.einsum("ajn,n->aj", t, outer_root) + np.einsum("o,oaj->aj", root, r[0])) / root
    lost_i = 1 - leaves[0]
    lost_q = np.clip(-leaves[1], -np.maximum(lost_i, 0.0), np.maximum(lost_i, 0.0))
    factor = -(leaves[1] + lost_q) / np.maximum(leaves[0], _TINY)
    straight, mirrored = face.straight.copy(), face.mirrored.copy()
    straight[1] += factor[: outer_root.size] * straight[0]
    mirrored[1] += factor * mirrored[0]
    if face.through is not None:
        face.through[1] += factor[:, None] * face.through[0]
    if face.within is not None:
        face.within[1] += factor[:, None, None] * face.within[0]
    lost_outside = 1 - face.reflected - kept
    return replace(
        face, straight=straight, mirrored=mirrored, lost_outside=lost_outside, lost_inside=np.stack([lost_i, lost_q])
    )


def transmitted_by_facets(surface: Microsurface, masking: str, index: float, nodes: Nodes, azimuths: Azimuths) -> Array:
    """I, Q and U of f_t/n² from the nodes outside to those inside, (3, N, J, P)."""
    result = np.zeros((3, nodes.outside.size, nodes.inside.size, azimuths.phi.size))
    phi = 180 + np.degrees(azimuths.phi)
    steepest = _steepest(surface)
    rows = max(1, _BLOCK // result[0, 0].size)
    for start in range(0, nodes.outside.size, rows):
        block = slice(start, start + rows)
        theta_i, theta_o, azimuth = np.broadcast_arrays(
            nodes.outside[block, None, None], 180 - nodes.inside[:, None], phi
        )
        cos_i, cos_o = np.cos(np.radians(theta_i)), np.cos(np.radians(theta_o))
        cosine = cos_i * cos_o + np.sin(np.radians(theta_i)) * np.sin(np.radians(theta_o)) * np.cos(np.radians(azimuth))
        # Most pairs of directions would need facets steeper than any in the density; their slope is cheap to test.
        squared_length = 1 + index**2 + 2 * index * cosine
        present = squared_length < (1 + steepest**2) * (cos_i + index * cos_o) ** 2
        angles = theta_i[present], np.zeros(np.count_nonzero(present)), theta_o[present], azimuth[present]
        values = transmission.transmitted(surface, masking, index, *angles) / index**2
        cos_facet = np.abs(1 + index * cosine[present]) / np.sqrt(squared_length[present])
        fresnel = fresnel_reflectance(np.minimum(cos_facet, 1.0), index)
        polarised = values * (fresnel.p - fresnel.s) / np.maximum(2 - 2 * fresnel.mean, _TINY)
        turn = 2 * frame_rotation(*angles)[1]
        for component, part in enumerate((values, polarised * np.cos(turn), polarised * np.sin(turn))):
            result[component, block][present] = part
    return result


def mirrored_by_facets(
    surface: Microsurface,
    masking: str,
    index: float,
    nodes: Nodes,
    azimuths: Azimuths,
    behind: tuple[float, float] | None = None,
) -> Array:
    """Mueller matrix of f_r/n² between the nodes inside, (elements, J, J, P).

    ``behind``: n and k of what lies behind the face, relative to the body; by default air.
    """
    far = (1 / index, 0.0) if behind is None else behind
    count = nodes.inside.size
    first, second = np.triu_indices(count)
    result = np.zeros((len(ELEMENTS), count, count, azimuths.phi.size))
    phi, steepest = 180 + np.degrees(azimuths.phi), _steepest(surface)
    pairs = max(1, _BLOCK // phi.size)
    for start in range(0, first.size, pairs):
        i, o = first[start : start + pairs], second[start : start + pairs]
        pair = half_vector(nodes.inside[i, None], 0.0, nodes.inside[o, None], phi)
        row, turn = np.nonzero(pair.slope_squared < steepest**2)
        into, out, azimuth = i[row], o[row], phi[turn]
        pair = HalfVector(*(np.broadcast_to(part, (i.size, phi.size))[row, turn] for part in pair))
        values = surface.reflected(pair, 0.0, azimuth, masking) / index**2
        elements = mirror_elements(pair.cos_zeta, *far) * values
        psi_i, psi_o = frame_rotation(nodes.inside[into], np.zeros(into.size), nodes.inside[out], azimuth)
        result[:, out, into, turn] = _turned(elements, psi_i, psi_o)
        # Light that goes the other way, with the same sense of the azimuth.
        result[:, into, out, turn] = _turned(elements, psi_o, psi_i)
    return result


def _steepest(surface: Microsurface) -> float:
    """Slope above which there are hardly any facets."""
    assert isinstance(surface.density, RadialDensity)
    slope, density = surface.density.slope, surface.density.density
    return float(slope[density > _NEGLIGIBLE * density.max()][-1])


def _turned(facet: Array, psi_i: Array, psi_o: Array) -> Array:
    """Mueller matrices (elements, …) of facets in the frames of the sheet, R(−ψ_o) M R(ψ_i).

    The frames are those of a normal that points out of the body, from where azimuths run the other way: odd elements change sign.
    """
    mean, difference, phased, retarded = facet[0], facet[1], facet[5], facet[7]
    cos_i, sin_i, cos_o, sin_o = np.cos(2 * psi_i), np.sin(2 * psi_i), np.cos(2 * psi_o), np.sin(2 * psi_o)
    return np.stack(
        [
            mean,
            cos_o * difference,
            cos_o * cos_i * mean + sin_o * sin_i * phased,
            -sin_o * difference,
            cos_o * sin_i * phased - sin_o * cos_i * mean,
            sin_o * sin_i * mean + cos_o * cos_i * phased,
            sin_i * retarded,
            cos_i * retarded,
            phased,
        ]
    )


def balance(
    kernel: Array, azimuths: Azimuths, row_root: Array, column_root: Array, rows: Array, columns: Array
) -> tuple[Array, float]:
    """Factors that symmetrise a kernel and make its rows and columns sum to given shares, never to more; and the largest correction.

    Sinkhorn & Knopp 1967, by roots so that a symmetric kernel stays symmetric. Rows and columns must carry the same total: the larger
    shares are lowered to it. The last steps only shrink, so that no sum exceeds its share.
    """
    carried = float(row_root**2 @ rows), float(column_root**2 @ columns)
    if min(carried) <= _TINY:
        # Faces between equal indices reflect nothing.
        return np.zeros_like(kernel[..., 0]), 0.0
    rows, columns = rows * min(1.0, carried[1] / carried[0]), columns * min(1.0, carried[0] / carried[1])
    roots = np.multiply.outer(row_root, column_root)
    zeroth = kernel @ azimuths.integrals(np.zeros(1))[:, 0] * roots
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
    return np.clip(down, 0.0, 2.0)[:, None] * np.clip(across, 0.0, 2.0) * roots, correction
