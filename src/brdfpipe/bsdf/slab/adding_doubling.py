"""Adding–doubling: all reflections between two faces, summed by solving one linear system for each Fourier mode.

Downward light just below the front face obeys d = t_F + ρ_F τ ρ_B τ d; t_B τ d leaves through the back and t_F τ ρ_B τ d through the
front. Light is a Stokes vector here, of as many components as asked for. Each face is described as seen from its own outside, so the
back is turned over, which changes the sign of U and V.

References
----------
van de Hulst 1980, Multiple Light Scattering, §4; Grant & Hunt 1969 (Proc. R. Soc. A 313) for its conservation of energy.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from brdfpipe.bsdf.slab.face import REVERSED, Azimuths, Face, Nodes
from brdfpipe.geometry import Array

_ISOLATED = 1e-12
_TURNED_OVER = np.array([1.0, 1.0, -1.0, -1.0])


class Sheet(NamedTuple):
    """The two faces of a slab of one index, on common nodes."""

    front: Face
    back: Face
    nodes: Nodes
    azimuths: Azimuths

    def passage(self, transmittance: float) -> Array:
        """τ^(1/cos θ) of the nodes inside, (J,)."""
        return np.asarray(transmittance ** (1 / np.cos(np.radians(self.nodes.inside))))


class InnerLight(NamedTuple):
    """Light that has been inside, reflected at the front, reflected at the back, and transmitted from the front to the back.

    Operators (modes, N, N), or shares (N,) of the light that was reflected and refracted specularly alone.
    """

    front: Array
    back: Array
    through: Array


def straight(sheet: Sheet, transmittance: float) -> InnerLight:
    """Shares of specular reflections and refractions alone: R = F + (1 − F)² τ² F / (1 − F² τ²), without its first term.

    Summed for s and p apart; the mean of both is returned.
    """
    front, back = sheet.front, sheet.back
    count = front.lost_outside.size
    passage = sheet.passage(transmittance)[:count]
    polarisations = np.array([[1.0, 1.0], [1.0, -1.0]])
    t_front, t_back = polarisations @ front.straight, polarisations @ back.straight
    r_front, r_back = polarisations @ front.mirrored[:2, :count], polarisations @ back.mirrored[:2, :count]
    series = passage / (1 - r_front * r_back * passage**2)
    return InnerLight(
        (t_front**2 * r_back * passage * series).mean(axis=0),
        (t_back**2 * r_front * passage * series).mean(axis=0),
        (t_front * t_back * series).mean(axis=0),
    )


def scattered(sheet: Sheet, modes: Array, transmittances: Array, components: int, first: int = 0) -> list[InnerLight]:
    """Operators of Fourier modes, for each internal transmittance at normal incidence, with ``components`` of I, Q, U and V inside.

    They are those between the nodes from the ``first`` on; the light of the others has to be negligible in these modes.
    """
    t_front, r_front = _flat(*sheet.front.operators(sheet.azimuths, modes, components, first))
    size = sheet.nodes.inside.size - first
    reversed_, turned = (np.repeat(signs[:components], size) for signs in (REVERSED, _TURNED_OVER))
    equal = sheet.front is sheet.back
    if not equal:
        t_back, r_back = _flat(*sheet.back.operators(sheet.azimuths, modes, components, first))
        t_back, r_back = t_back * turned[:, None], r_back * (turned[:, None] * turned)
    result = []
    for transmittance in transmittances:
        passage = np.tile(sheet.passage(float(transmittance))[first:], components)
        if equal:
            # The two faces differ by a turn-over, so each crossing is the same factor of the series.
            crossing = r_front * (turned * passage)
            odd, even = (solved(sign * crossing, t_front) for sign in (1.0, -1.0))
            down, up = (odd + even) / 2, (odd - even) / 2 * turned[:, None]
            leaves = np.swapaxes(t_front, -1, -2) * (reversed_ * passage)
            to_front = leaves @ up
            result.append(InnerLight(to_front, to_front, np.swapaxes((leaves * turned) @ down, -1, -2)))
            continue
        below, above = r_back * passage, r_front * passage
        leaves_front, leaves_back = (np.swapaxes(t, -1, -2) * (reversed_ * passage) for t in (t_front, t_back))
        straight = sheet.front.is_smooth, sheet.back.is_smooth
        returned, entering = (_product(above, part, size, *straight) for part in (below, t_back))
        both = solved(returned, np.concatenate([t_front, entering], axis=-1))
        down, down_of_back = np.split(both, [t_front.shape[-1]], axis=-1)
        up = _product(below, down, size, straight[1], False)
        to_front = _product(leaves_front, up, size, straight[0], False)
        to_back, through = (_product(leaves_back, light, size, straight[1], False) for light in (down_of_back, down))
        result.append(InnerLight(to_front, to_back, np.swapaxes(through, -1, -2)))
    return result


def _product(left: Array, right: Array, size: int, straight_left: bool, straight_right: bool) -> Array:
    """Product of operators over components and ``size`` nodes; a straight one, of a smooth face, does not change the node.

    Of a straight operator, outside or inside, the elements between different nodes are 0, and the same for all modes.
    """
    if not (straight_left or straight_right):
        return np.asarray(left @ right)
    modes, rows, columns = left.shape[0], left.shape[1], right.shape[2]
    if straight_right:
        elements, count = _between_components(right[0], size)
        parts = left.reshape(modes, rows, -1, size)[..., :count]
        return np.einsum("mrak,abk->mrbk", parts, elements).reshape(modes, rows, columns)
    elements, count = _between_components(left[0], size)
    parts = right.reshape(modes, -1, size, columns)[:, :, :count]
    return np.einsum("abk,mbkn->makn", elements, parts).reshape(modes, rows, columns)


def _between_components(operator: Array, size: int) -> tuple[Array, int]:
    """Elements (components, components, nodes) of a straight operator, and the number of nodes, fewer outside than inside."""
    rows, columns = (extent if extent < size else size for extent in operator.shape)
    count = min(rows, columns)
    parts = operator.reshape(operator.shape[0] // rows, rows, operator.shape[1] // columns, columns)
    return np.einsum("akbk->abk", parts[:, :count, :, :count]), count


def _flat(through: Array, within: Array) -> tuple[Array, Array]:
    """Components and nodes as one axis."""
    modes, components, inside, outside = through.shape
    size = components * inside
    return through.reshape(modes, size, outside), within.reshape(modes, size, size)


def balances(sheet: Sheet, transmittances: Array) -> Array:
    """Reflectance, transmittance and absorptance, (transmittances, 2, 3, N), for light from the front and from the back.

    Each is computed independently; the absorptance is (1 − τ) of the light that leaves either face inwards. The zeroth mode holds
    them, and in it I and Q do not mix with U and V.
    """
    inside, components = sheet.nodes.inside.size, 2
    front, back = (
        _flat(*face.operators(sheet.azimuths, np.zeros(1), components)) for face in (sheet.front, sheet.back)
    )

    def balance(face: Face, near: tuple[Array, Array], far: tuple[Array, Array], passage: Array) -> Array:
        root, outer_root = face.root, face.outer_root
        (t_near,), (r_near,), (t_far,), (r_far,) = *near, *far
        inward = solved((r_near * passage) @ (r_far * passage), t_near)
        outward = (r_far * passage) @ inward
        reflected = outer_root @ (t_near.T * passage) @ outward / outer_root
        transmitted = outer_root @ (t_far.T * passage) @ inward / outer_root
        absorbed = (root * (1 - passage[:inside])) @ (inward + outward)[:inside] / outer_root
        return np.stack([face.outer_albedo + reflected, transmitted, absorbed])

    passages = [np.tile(sheet.passage(float(transmittance)), components) for transmittance in transmittances]
    return np.array(
        [[balance(sheet.front, front, back, each), balance(sheet.back, back, front, each)] for each in passages]
    )


def solved(returned: Array, entering: Array) -> Array:
    """(1 − A)⁻¹ t, of one mode or several."""
    matrix = -returned
    diagonal = np.einsum("...ii->...i", matrix)
    diagonal += 1
    isolated = diagonal < _ISOLATED
    if isolated.any():
        # Modes trapped between smooth faces are singular, and carry no light: any solution will do.
        diagonal += isolated & (np.abs(returned).sum(axis=-1) <= 1 + _ISOLATED)
    return np.asarray(np.linalg.solve(matrix, entering))
