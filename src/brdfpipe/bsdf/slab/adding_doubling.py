"""Two faces and what lies between them: all reflections to and fro, summed by solving one linear system a Fourier mode.

Going down just below the front face, light obeys d = t_F + ρ_F τ ρ_B τ d; it leaves through the back as t_B τ d and through the
front as t_F τ ρ_B τ d.

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


class Scattered(NamedTuple):
    """What has been inside, as (modes, N, N) operators: back to the front, back to the back, and from the front to the back."""

    front: Array
    back: Array
    through: Array


class Straight(NamedTuple):
    """The part of it that left every face in its one mirrored or refracted direction, (N,) each."""

    front: Array
    back: Array
    through: Array


class Balance(NamedTuple):
    """Where the light from one side goes, (N,) each [1]."""

    reflected: Array
    transmitted: Array
    absorbed: Array


def straight(sheet: Sheet, transmittance: float) -> Straight:
    """Shares of the light that sharp reflections and refractions alone let through: R = F + (1 − F)² τ² F / (1 − F² τ²) less its F."""
    front, back = sheet.front, sheet.back
    count = front.straight.size
    passage = sheet.passage(transmittance)[:count]
    r_front, r_back = front.mirrored[:count], back.mirrored[:count]
    series = passage / (1 - r_front * r_back * passage**2)
    return Straight(
        front.straight**2 * r_back * passage * series,
        back.straight**2 * r_front * passage * series,
        front.straight * back.straight * series,
    )


def scattered(sheet: Sheet, modes: Array, transmittances: Array) -> list[Scattered]:
    """The scattered light of Fourier modes, for each of several internal transmittances at normal incidence."""
    t_front, r_front = sheet.front.operators(sheet.azimuths, modes)
    t_back, r_back = (t_front, r_front) if sheet.front is sheet.back else sheet.back.operators(sheet.azimuths, modes)
    result = []
    for transmittance in transmittances:
        passage = sheet.passage(float(transmittance))
        below, above = r_back * passage, r_front * passage
        down = _solved(above @ below, t_front)
        leaving = t_back * passage
        to_front = t_front * passage @ (below @ down)
        alike = sheet.front is sheet.back
        to_back = to_front if alike else leaving @ (above @ _solved(below @ above, t_back))
        result.append(Scattered(to_front, to_back, np.swapaxes(leaving @ down, -1, -2)))
    return result


def balances(sheet: Sheet, transmittance: float) -> tuple[Balance, Balance]:
    """Reflectance, transmittance and absorptance, for light from the front and from the back.

    Notes
    -----
    Each of the three is a sum of its own: what is absorbed is (1 − τ) of what sets out from either face.
    """
    modes = np.zeros(1)
    t_front, r_front = (each[0] for each in sheet.front.operators(sheet.azimuths, modes))
    t_back, r_back = (each[0] for each in sheet.back.operators(sheet.azimuths, modes))
    passage = sheet.passage(transmittance)
    return (
        _balance(sheet.front, (t_front, r_front), (t_back, r_back), passage),
        _balance(sheet.back, (t_back, r_back), (t_front, r_front), passage),
    )


def _balance(lit: Face, near: tuple[Array, Array], far: tuple[Array, Array], passage: Array) -> Balance:
    root, count = lit.root, lit.straight.size
    (t_near, r_near), (t_far, r_far) = near, far
    inward = _solved((r_near * passage) @ (r_far * passage), t_near)
    outward = (r_far * passage) @ inward
    shares = [root[:count] @ (t_near * passage) @ outward, root[:count] @ (t_far * passage) @ inward]
    shares.append((root * (1 - passage)) @ (inward + outward))
    back, through, absorbed = (share / root[:count] for share in shares)
    return Balance(lit.outer_albedo + back, through, absorbed)


def _solved(returned: Array, entering: Array) -> Array:
    """(1 − A)⁻¹ tᵀ, of one mode or of many."""
    size = returned.shape[-1]
    diagonal = np.arange(size)
    matrix = np.eye(size) - returned
    # Light trapped between smooth faces neither comes in nor goes out: any answer will do, as none enters.
    trapped = (matrix[..., diagonal, diagonal] < _ISOLATED) & (np.abs(returned).sum(axis=-1) <= 1 + _ISOLATED)
    matrix[..., diagonal, diagonal] += trapped
    return np.asarray(np.linalg.solve(matrix, np.swapaxes(entering, -1, -2)))
