"""The tail of a radial slope density: the facets that are steeper than those counted in bins.

They are too few for bins of their own. Their share and their mean slope are known, which decide the masking at grazing. The tail
carries both on from the density where the bins end, without a step or a kink: ln P falls as steeply as there at first, and along a
straight line in the end.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from brdfpipe.geometry import Array
from brdfpipe.hemisphere import panel_rule

_LENGTHS = 40
"""Length of a tail, over the distance in which it falls by a factor of e in the end."""

_NODES = 24
_BENDS = np.geomspace(0.1, 4.0, 13)
"""Lengths of the bend between both decays that are tried, over the decay length where the bins end."""
_SOLVED = 1e-8
_LOG_DECAY_RANGE = 20.0
"""Logarithm of the largest factor between the decay of a tail and its first guess."""
_FITTED_BINS = 4


class Junction(NamedTuple):
    """The density where the bins end."""

    slope: float
    density: float
    decay: float
    """−d ln P/ds"""

    @classmethod
    def of(cls, edges: Array, log_density: Array) -> Junction:
        """From the line of ln P against s² through the last bins, of given mean densities (bins,)."""
        middle = (edges[1:] ** 2 + edges[:-1] ** 2)[-_FITTED_BINS:] / 2
        line = np.polynomial.Polynomial.fit(middle, log_density[-_FITTED_BINS:], 1)
        end = float(edges[-1])
        return cls(end, float(np.exp(line(end**2))), float(-2 * end * line.deriv()(end**2)))


def tail(junction: Junction, share: float, excess: float) -> tuple[Array, Array]:
    """Slopes and densities of the tail, from the junction on, that hold a ``share`` of the facets and their mean ``excess`` slope.

    ln P(s) = ln P₀ − c x − D [1 − (1 + y) e⁻ʸ] − (b − c) x e⁻ʸ with x = s − s₀ and y = x/λ: the density P₀ and its decay b are those
    of the junction. c and D follow from 2π ∫ P s ds, the share, and E[x], and λ makes the decay vary the least. Where P decreases
    for no λ, the bins end too low for their tail: then it is a plain exponential, P₁ e^(−x/L) with 2πP₁ (s₀ L + L²) the share and
    E[x] = L (s₀ + 2L)/(s₀ + L). Without facets beyond the junction the density ends there.
    """
    start = junction.slope
    if share == 0:
        return np.array([start]), np.zeros(1)
    length = (excess - start + np.sqrt((start - excess) ** 2 + 8 * start * excess)) / 4
    plain = share / (2 * np.pi * length * (start + length))
    if junction.decay > 0:
        content = share / (2 * np.pi * junction.density)
        guess = 1 / length, float(np.log(junction.density / plain))
        best, least = None, np.inf
        # The variation falls with the length of the bend and then rises; each solution is a guess of the next.
        for bent in (_Bent(start, junction.decay, bend / junction.decay) for bend in _BENDS):
            solution = bent.solved(content, excess, *guess)
            if solution is None:
                continue
            if bent.variation(*solution) >= least:
                break
            best, least, guess = (bent, *solution), bent.variation(*solution), solution
        if best:
            bent, decay, drop = best
            x = bent.nodes(decay)
            return start + x, junction.density * np.exp(-bent.fall(x, decay, drop))
    step = np.concatenate([[0.0], np.geomspace(0.05, _LENGTHS, _NODES)])
    return start + length * step, plain * np.exp(-step)


class _Bent(NamedTuple):
    """A logarithm of the density that bends from one decay to another."""

    start: float
    decay: float
    """b, at the junction"""
    bend: float
    """λ"""

    def fall(self, x: Array, last_decay: float, drop: float) -> Array:
        """ln P₀ − ln P at a distance from the junction."""
        y = x / self.bend
        faded = np.exp(-y)
        return np.asarray(last_decay * x + drop * (1 - (1 + y) * faded) + (self.decay - last_decay) * x * faded)

    def nodes(self, last_decay: float) -> Array:
        """Distances from the junction that resolve the bend and the line beyond it."""
        first, last = 0.05 * min(self.bend, 1 / last_decay), _LENGTHS / last_decay
        span = float(np.log(last / first))
        count = int(np.ceil(_NODES * span / np.log(_LENGTHS / 0.05)))
        return np.concatenate([[0.0], first * np.exp(np.linspace(0.0, span, count + 1))])

    def solved(self, content: float, excess: float, last_decay: float, drop: float) -> tuple[float, float] | None:
        """The decay c and the drop D that give ∫ P/P₀ s ds and E[x], from a first guess; None if P rises somewhere or there are none."""
        from scipy.optimize import root

        def miss(unknown: Array) -> tuple[Array, Array]:
            """Logarithms of both over what is wanted, and their derivatives."""
            if not np.abs(unknown[0] - np.log(last_decay)) < _LOG_DECAY_RANGE:
                return np.full(2, np.inf), np.eye(2)  # ends a search that diverges
            decay, drop = float(np.exp(unknown[0])), float(unknown[1])
            x, weight = panel_rule(self.nodes(decay), 4)
            faded = np.exp(-x / self.bend)
            share = weight * np.exp(-self.fall(x, decay, drop)) * (self.start + x)
            moments = np.stack([np.ones_like(x), x]) * share
            rates = np.stack([-decay * x * (1 - faded), (1 + x / self.bend) * faded - 1])
            total, slopes = moments.sum(axis=1), moments @ rates.T
            first = slopes[0] / total[0]
            return (
                np.log([total[0] / content, total[1] / total[0] / excess]),
                np.stack([first, slopes[1] / total[1] - first]),
            )

        with np.errstate(all="ignore"):
            solution = root(miss, np.array([np.log(last_decay), drop]), jac=True)
        if not (np.isfinite(solution.fun).all() and np.abs(solution.fun).max() < _SOLVED):
            return None
        decay, drop = float(np.exp(solution.x[0])), float(solution.x[1])
        falls = np.diff(self._falls(decay, drop)) >= 0
        return (decay, drop) if falls.all() else None

    def variation(self, last_decay: float, drop: float) -> float:
        """Total variation of the decay."""
        return float(np.abs(np.diff(self._falls(last_decay, drop), 2)).sum() / self.bend)

    def _falls(self, last_decay: float, drop: float) -> Array:
        return self.fall(np.linspace(0.0, 12 * self.bend, 400), last_decay, drop)
