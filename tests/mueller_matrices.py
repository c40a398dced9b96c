"""Properties that every physical Mueller matrix has."""

from __future__ import annotations

import numpy as np

RECIPROCAL = np.diag([1.0, 1.0, -1.0, 1.0])
"""Q of the reciprocity M(o → i) = Q M(i → o)ᵀ Q (Sekera 1966, J. Opt. Soc. Am. 56, 1732): reversed light has its 45° axes mirrored."""

_PAULI = np.array([[[1, 0], [0, 1]], [[1, 0], [0, -1]], [[0, 1], [1, 0]], [[0, -1j], [1j, 0]]])


def physical(mueller, tolerance: float = 1e-12) -> np.ndarray:
    """Whether Mueller matrices (…, 4, 4) are sums of Jones matrices: no eigenvalue of the coherency matrix is below −tolerance · M[0, 0].

    The Hermitian coherency matrix ¼ Σ M_ab σ_a ⊗ σ_b* has the trace M[0, 0] (Cloude 1986, Optik 75, 26).
    """
    m = np.asarray(mueller, dtype=float)
    coherency = np.einsum("...ab,aij,bkl->...ikjl", m, _PAULI, _PAULI.conj()).reshape(*m.shape[:-2], 4, 4) / 4
    smallest = np.linalg.eigvalsh(coherency)[..., 0]
    return np.asarray((m[..., 0, 0] >= 0) & (smallest >= -tolerance * m[..., 0, 0]))
