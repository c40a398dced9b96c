"""Penalised least squares of many problems with one basis and one penalty: minimise ‖W (B c − z)‖² + ε ‖D c‖².

In standard form the penalty is a sum of squares. One QR decomposition of (W B | W z), and one singular value decomposition of its triangle,
give a problem's solution at every ε. BᵀW²B is never formed: with weights of a narrow lobe its condition exceeds double precision.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from brdfpipe.geometry import Array

_NEGLIGIBLE = 1e-10
"""Share of the largest singular value below which others count as zero: functions that are redundant, or without penalty."""
_FEWEST_LEFT = 0.05  # smallest share of the values left as degrees of freedom for which cross-validation counts


@dataclass(frozen=True)
class StandardForm:
    """A basis whose penalty is the sum of squares of all but its first coefficients (Eldén 1977; Hansen 1998, ch. 2)."""

    rows: Array  # (values, coefficients)
    free: int  # number of coefficients without penalty, the first ones
    to_basis: Array  # (terms, coefficients) matrix to the coefficients of the original basis

    @classmethod
    def of(cls, rows: Array, roughness: Array) -> StandardForm:
        """From B and D, without functions that are redundant in both."""
        d, b = (np.asarray(np.linalg.qr(matrix, mode="r")) for matrix in (roughness, rows))
        stacked = np.concatenate([b / max(np.linalg.norm(b), 1e-300), d / max(np.linalg.norm(d), 1e-300)])
        _, size, right = np.linalg.svd(stacked, full_matrices=False)
        distinct = size > _NEGLIGIBLE * size[0]
        basis = right[distinct].T / size[distinct]
        _, penalty, right = np.linalg.svd(d @ basis)
        penalty = np.concatenate([penalty, np.zeros(basis.shape[1] - penalty.size)])
        free = penalty <= _NEGLIGIBLE * max(penalty[0], 1e-300)
        order = np.argsort(~free, kind="stable")
        to_basis = (basis @ right.T / np.where(free, 1.0, penalty))[:, order]
        return cls(rows @ to_basis, int(free.sum()), to_basis)


@dataclass(frozen=True)
class Decomposition:
    """Decomposed weighted problems that share a basis; the first axis counts problems, ``free`` and ``rest`` coefficients."""

    form: StandardForm
    counts: Array  # (problems,) values of weight above 0
    triangle: Array  # (problems, free, free)
    mixed: Array  # (problems, free, rest)
    free_values: Array  # (problems, free)
    singular: Array  # (problems, rest)
    right: Array  # (problems, rest, rest) right singular vectors, as rows
    values: Array  # (problems, rest) along the left singular vectors
    unexplained: Array  # (problems,) squares that no coefficients explain

    @classmethod
    def of(cls, form: StandardForm, weight: Array, values: Array) -> Decomposition:
        """From weights W and values z, both (problems, values); values of weight 0 may be any finite number."""
        terms, free = form.rows.shape[1], form.free
        system = np.zeros((weight.shape[0], max(weight.shape[1], terms + 1), terms + 1))
        np.multiply(weight[..., None], form.rows, out=system[:, : weight.shape[1], :-1])
        system[:, : weight.shape[1], -1] = weight * values
        triangle = np.asarray(np.linalg.qr(system, mode="r"))
        left, singular, right = np.linalg.svd(triangle[:, free:terms, free:terms])
        return cls(
            form,
            (weight > 0).sum(axis=1).astype(float),
            triangle[:, :free, :free],
            triangle[:, :free, free:terms],
            triangle[:, :free, -1],
            singular,
            right,
            np.einsum("pij,pi->pj", left, triangle[:, free:terms, -1]),
            triangle[:, terms, -1] ** 2,
        )

    def effective_parameters(self, strengths: Array) -> Array:
        """Trace of the smoother (problems, strengths)."""
        return self.form.free + self._filter_factors(strengths).sum(axis=-1)

    def chi_squared(self, strengths: Array) -> Array:
        """‖W (B c − z)‖² (problems, strengths)."""
        lost = (1 - self._filter_factors(strengths)) * self.values[:, None, :]
        return self.unexplained[:, None] + (lost**2).sum(axis=-1)

    def roughness(self, strengths: Array) -> Array:
        """‖D c‖² (problems, strengths)."""
        squared = self.singular[:, None, :] ** 2
        return ((self.singular * self.values)[:, None, :] ** 2 / (squared + strengths[:, None]) ** 2).sum(axis=-1)

    def cross_validation(self, strengths: Array) -> Array:
        """n χ²/(n − trace)² (problems, strengths), infinite with too few degrees of freedom (Golub, Heath & Wahba 1979)."""
        count = self.counts[:, None]
        left = count - self.effective_parameters(strengths)
        enough = left > _FEWEST_LEFT * count
        score = count * self.chi_squared(strengths) / np.where(enough, left, 1.0) ** 2
        return np.where(enough, score, np.inf)

    def solution(self, strength: float) -> Array:
        """Coefficients in standard form (problems, coefficients); ``@ form.to_basis.T`` gives those of the basis."""
        damped = self.singular * self.values / (self.singular**2 + strength)
        rest = np.einsum("pij,pi->pj", self.right, damped)
        left = self.free_values - np.einsum("pij,pj->pi", self.mixed, rest)
        return np.concatenate([np.einsum("pij,pj->pi", self._inverse_triangle, left), rest], axis=-1)

    def covariance_factor(self, strength: float) -> Array:
        """S (problems, coefficients, coefficients) with S Sᵀ = (BᵀW²B + ε DᵀD)⁻¹ in standard form: the covariance if W is 1/u.

        The penalty counts as prior knowledge: so the covariance includes the error of smoothing, on average over directions, besides
        that of the noise (Wahba 1983; Marra & Wood 2012).
        """
        free = self.form.free
        damped = np.swapaxes(self.right, 1, 2) / np.sqrt(self.singular**2 + strength)[:, None, :]
        inverse = self._inverse_triangle
        factor = np.zeros((damped.shape[0], free + damped.shape[1], free + damped.shape[1]))
        factor[:, :free, :free] = inverse
        factor[:, :free, free:] = -inverse @ (self.mixed @ damped)
        factor[:, free:, free:] = damped
        return factor

    def replaced(self, at: NDArray[np.int64], other: Decomposition) -> Decomposition:
        """These problems with those at some indices replaced by others."""
        merged = {name: values.copy() for name, values in vars(self).items() if name != "form"}
        for name, values in merged.items():
            values[at] = getattr(other, name)
        return replace(self, **merged)

    @property
    def _inverse_triangle(self) -> Array:
        """Pseudo-inverse: coefficients that too few values leave undetermined are 0."""
        return np.asarray(np.linalg.pinv(self.triangle))

    def _filter_factors(self, strengths: Array) -> Array:
        squared = self.singular[:, None, :] ** 2
        return squared / (squared + strengths[:, None])
