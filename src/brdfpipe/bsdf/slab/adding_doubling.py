"""Adding–doubling: all reflections between two faces, summed by solving one linear system for each Fourier mode.

Downward light just below the front face obeys d = t_F + ρ_F τ ρ_B τ d; t_B τ d leaves through the back and t_F τ ρ_B τ d through the
front.

References
----------
van de Hulst 1980, Multiple Light Scattering, §4; Grant & Hunt 1969 (Proc. R. Soc. A 313) for its conservation of energy.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from brdfpipe.bsdf.slab.face import Azimuths, Face, Nodes
from brdfpipe.geometry import Array

_ISOLATED = 1e-12


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
    """Shares of specular reflections and refractions alone: R = F + (1 − F)² τ² F / (1 − F² τ²), without its first term."""
    front, back = sheet.front, sheet.back
    count = front.straight.size
    passage = sheet.passage(transmittance)[:count]
    r_front, r_back = front.mirrored[:count], back.mirrored[:count]
    series = passage / (1 - r_front * r_back * passage**2)
    return InnerLight(
        front.straight**2 * r_back * passage * series,
        back.straight**2 * r_front * passage * series,
        front.straight * back.straight * series,
    )


def scattered(sheet: Sheet, modes: Array, transmittances: Array) -> list[InnerLight]:
    """Operators of Fourier modes, for each internal transmittance at normal incidence."""
    equal = sheet.front is sheet.back
    t_front, r_front = sheet.front.operators(sheet.azimuths, modes)
    t_back, r_back = (t_front, r_front) if equal else sheet.back.operators(sheet.azimuths, modes)
    result = []
    for transmittance in transmittances:
        passage = sheet.passage(float(transmittance))
        below, above = r_back * passage, r_front * passage
        down = _solved(above @ below, t_front)
        leaving = t_back * passage
        to_front = t_front * passage @ (below @ down)
        to_back = to_front if equal else leaving @ (above @ _solved(below @ above, t_back))
        result.append(InnerLight(to_front, to_back, np.swapaxes(leaving @ down, -1, -2)))
    return result


def balances(sheet: Sheet, transmittance: float) -> tuple[Array, Array]:
    """Reflectance, transmittance and absorptance, (3, N), for light from the front and from the back.

    Each is computed independently; the absorptance is (1 − τ) of the light that leaves either face inwards.
    """
    passage = sheet.passage(transmittance)

    front, back = (face.operators(sheet.azimuths, np.zeros(1)) for face in (sheet.front, sheet.back))

    def balance(face: Face, near: tuple[Array, Array], far: tuple[Array, Array]) -> Array:
        root, count = face.root, face.straight.size
        (t_near,), (r_near,), (t_far,), (r_far,) = *near, *far
        inward = _solved((r_near * passage) @ (r_far * passage), t_near)
        outward = (r_far * passage) @ inward
        reflected = root[:count] @ (t_near * passage) @ outward / root[:count]
        transmitted = root[:count] @ (t_far * passage) @ inward / root[:count]
        absorbed = (root * (1 - passage)) @ (inward + outward) / root[:count]
        return np.stack([face.outer_albedo + reflected, transmitted, absorbed])

    return balance(sheet.front, front, back), balance(sheet.back, back, front)


def _solved(returned: Array, entering: Array) -> Array:
    """(1 − A)⁻¹ tᵀ, of one mode or several."""
    size = returned.shape[-1]
    diagonal = np.arange(size)
    matrix = np.eye(size) - returned
    # Modes trapped between smooth faces are singular, and carry no light: any solution will do.
    trapped = (matrix[..., diagonal, diagonal] < _ISOLATED) & (np.abs(returned).sum(axis=-1) <= 1 + _ISOLATED)
    matrix[..., diagonal, diagonal] += trapped
    return np.asarray(np.linalg.solve(matrix, np.swapaxes(entering, -1, -2)))
