"""Penalised least squares, many at a time: one basis, one penalty, and weights and values of each problem's own.

Minimise ‖W (B c − z)‖² + ε ‖D c‖². Once for all, coefficients are changed so that the penalty is a plain sum of squares; then each problem is
one QR decomposition of (W B | W z) and one singular value decomposition of its triangle, and these give the solution, its covariance, its
effective parameters and its residual at every ε. BᵀW²B is never formed: the condition of W B reaches 1e10 with weights of a narrow lobe,
and its square is beyond double precision.

References
----------
Eldén 1977 (standard form); Golub, Heath & Wahba 1979 (generalised cross-validation); Hansen 1998, ch. 2 (GSVD).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from brdfpipe.geometry import Array

_NEGLIGIBLE = 1e-10
"""Singular values below this share of the largest count as zero: of functions that the others express, or that cost nothing."""

_FEWEST_LEFT = 0.05
"""Cross-validation counts where so large a share of the measured values is left over."""


@dataclass(frozen=True)
class StandardForm:
    """A basis whose penalty is the sum of squares of all but its first coefficients."""

    rows: Array
    """(values, coefficients)"""
    free: int
    """How many of the first coefficients cost nothing."""
    back: Array
    """(terms, coefficients) that leads to coefficients in the basis as given."""

    @classmethod
    def of(cls, rows: Array, roughness: Array) -> StandardForm:
        """Of rows B and D. Functions that neither tells from the others are left out."""
        d, b = (np.asarray(np.linalg.qr(each, mode="r")) for each in (roughness, rows))
        stacked = np.concatenate([b / max(np.linalg.norm(b), 1e-300), d / max(np.linalg.norm(d), 1e-300)])
        _, size, turned = np.linalg.svd(stacked, full_matrices=False)
        told = size > _NEGLIGIBLE * size[0]
        basis = turned[told].T / size[told]
        _, cost, turned = np.linalg.svd(d @ basis)
        cost = np.concatenate([cost, np.zeros(basis.shape[1] - cost.size)])
        nothing = cost <= _NEGLIGIBLE * max(cost[0], 1e-300)
        order = np.argsort(~nothing, kind="stable")
        back = (basis @ turned.T / np.where(nothing, 1.0, cost))[:, order]
        return cls(rows @ back, int(nothing.sum()), back)


@dataclass(frozen=True)
class Decomposed:
    """Weighted problems that share a basis, taken apart; the first axis counts problems."""

    form: StandardForm
    counts: Array
    """(problems,) values of weight above 0."""
    first: Array
    """(problems, free, free) triangle of the coefficients that cost nothing."""
    mixed: Array
    """(problems, free, rest)"""
    first_values: Array
    """(problems, free)"""
    singular: Array
    """(problems, rest)"""
    turned: Array
    """(problems, rest, rest) right singular vectors, as rows."""
    values: Array
    """(problems, rest) along the left singular vectors."""
    unreachable: Array
    """(problems,) squares that no coefficients explain."""

    @classmethod
    def of(cls, form: StandardForm, weight: Array, values: Array) -> Decomposed:
        """Of weights W and values z, both (problems, values); values of weight 0 may be anything finite."""
        terms, free = form.rows.shape[1], form.free
        system = np.zeros((weight.shape[0], max(weight.shape[1], terms + 1), terms + 1))
        np.multiply(weight[..., None], form.rows, out=system[:, : weight.shape[1], :-1])
        system[:, : weight.shape[1], -1] = weight * values
        triangle = np.asarray(np.linalg.qr(system, mode="r"))
        left, singular, turned = np.linalg.svd(triangle[:, free:terms, free:terms])
        return cls(
            form,
            (weight > 0).sum(axis=1).astype(float),
            triangle[:, :free, :free],
            triangle[:, :free, free:terms],
            triangle[:, :free, -1],
            singular,
            turned,
            np.einsum("pij,pi->pj", left, triangle[:, free:terms, -1]),
            triangle[:, terms, -1] ** 2,
        )

    def effective(self, strengths: Array) -> Array:
        """Trace of the smoother (problems, strengths)."""
        return self.form.free + self._kept(strengths).sum(axis=-1)

    def chi_squared(self, strengths: Array) -> Array:
        """‖W (B c − z)‖² (problems, strengths)."""
        lost = (1 - self._kept(strengths)) * self.values[:, None, :]
        return self.unreachable[:, None] + (lost**2).sum(axis=-1)

    def roughness(self, strengths: Array) -> Array:
        """‖D c‖² (problems, strengths)."""
        squared = self.singular[:, None, :] ** 2
        return ((self.singular * self.values)[:, None, :] ** 2 / (squared + strengths[:, None]) ** 2).sum(axis=-1)

    def cross_validation(self, strengths: Array) -> Array:
        """n χ²/(n − trace)² (problems, strengths); infinite where next to no values are left over."""
        count = self.counts[:, None]
        left = count - self.effective(strengths)
        enough = left > _FEWEST_LEFT * count
        score = count * self.chi_squared(strengths) / np.where(enough, left, 1.0) ** 2
        return np.where(enough, score, np.inf)

    def solution(self, strength: float) -> Array:
        """Coefficients in the standard form (problems, free); ``@ form.back.T`` leads to those of the basis as given."""
        damped = self.singular * self.values / (self.singular**2 + strength)
        rest = np.einsum("pij,pi->pj", self.turned, damped)
        left = self.first_values - np.einsum("pij,pj->pi", self.mixed, rest)
        return np.concatenate([np.einsum("pij,pj->pi", self._inverse, left), rest], axis=-1)

    def spread(self, strength: float) -> Array:
        """S (problems, free, free) with S Sᵀ = (BᵀW²B + ε DᵀD)⁻¹ in the standard form: the covariance where W is 1/u.

        The penalty counts as what is known of the function beforehand; so the covariance holds the error that smoothing
        makes, on average over directions, besides that of the noise (Wahba 1983; Marra & Wood 2012).
        """
        free = self.form.free
        damped = np.swapaxes(self.turned, 1, 2) / np.sqrt(self.singular**2 + strength)[:, None, :]
        inverse = self._inverse
        whole = np.zeros((damped.shape[0], free + damped.shape[1], free + damped.shape[1]))
        whole[:, :free, :free] = inverse
        whole[:, :free, free:] = -inverse @ (self.mixed @ damped)
        whole[:, free:, free:] = damped
        return whole

    def updated(self, at: NDArray[np.int64], other: Decomposed) -> Decomposed:
        """These problems with those at some places taken anew."""
        merged = {}
        for name in ("counts", "first", "mixed", "first_values", "singular", "turned", "values", "unreachable"):
            merged[name] = getattr(self, name).copy()
            merged[name][at] = getattr(other, name)
        return replace(self, **merged)

    @property
    def _inverse(self) -> Array:
        """Of the first triangle; what fewer values than coefficients leave open is taken as 0."""
        return np.asarray(np.linalg.pinv(self.first))

    def _kept(self, strengths: Array) -> Array:
        squared = self.singular[:, None, :] ** 2
        return squared / (squared + strengths[:, None])
