"""From the spectrum of lines across an isotropic surface to that of the plane.

W(f) = 2∫_f^∞ S(r) r dr/√(r² − f²) is an Abel transform, and S(f) = −(1/π) ∫_f^∞ W′(r) dr/√(r² − f²). W is taken as a power between
neighbouring rings and beyond the last one; S is evaluated amid two rings, where their power is the slope of a smooth W to second order.

References
----------
Church, Takacs & Leonard 1989, Proc. SPIE 1165, 136; Bracewell 2000, The Fourier Transform and Its Applications, ch. 13 (Abel).
"""

from __future__ import annotations

import numpy as np

from brdfpipe.geometry import Array
from brdfpipe.psd.periodograms import Rings

_T, _WEIGHT = np.polynomial.legendre.leggauss(12)
_LAST_RINGS = 3
_LEAST_POWER = 1.05
"""Least decay beyond the last ring, so that the integral exists: S of slope 2.05."""
_STEP = 1e-4
_FINER = 8
"""Nodes of an integral for each ring."""
_BEYOND = 3.0
"""Logarithm of the highest frequency over that of the band whose waves count as seen by the line."""
_ADJUSTMENTS = 5
_LARGEST_CHANGE = 1.0
"""Of the logarithm of a ring, at a time."""


def invert(line: Rings) -> Rings:
    """Plane spectrum [um4] from the line spectrum [um3] of at least four rings, with the propagated uncertainty.

    The last ring is left out. A line spectrum that rises with frequency gives a negative plane spectrum there.
    """
    frequency = np.sqrt(line.frequency[1:] * line.frequency[:-1])
    log_density = np.log(line.density)
    density = _inverted(line.frequency, log_density, frequency)
    changes = [_inverted(line.frequency, log_density + _STEP * row, frequency) for row in np.eye(log_density.size)]
    jacobian = (np.array(changes) - density) / _STEP
    relative = line.uncertainty / line.density
    return Rings(frequency, density, np.sqrt(np.square(jacobian * relative[:, None]).sum(axis=0)))


def inverted_change(line: Rings, change: Array) -> Array:
    """Change of the plane spectrum [um4] of :func:`invert` by a small change of the line spectrum [um3], linear in it."""
    frequency = np.sqrt(line.frequency[1:] * line.frequency[:-1])
    log_density, relative = np.log(line.density), change / line.density
    before, after = (_inverted(line.frequency, log_density + step * relative, frequency) for step in (0.0, _STEP))
    return (after - before) / _STEP


def with_variance_of(line: Rings, spectrum: Rings) -> Rings:
    """The plane spectrum, adjusted so that its line spectrum has the variance that the line has within the band of the plane spectrum.

    The waves of a ring r cross the line at f = r cos φ, so that (2/π)(asin(high/r) − asin(low/r)) of them are within the band; the last is
    continued as a power. Rings change in proportion to the square of their relative uncertainty and to what they contribute, which is
    the least change of their logarithms (Lagrange multiplier), and the change of a ring is added to its uncertainty.
    """
    nodes, low, high = np.log(spectrum.frequency), spectrum.frequency[0], spectrum.frequency[-1]
    inside = np.linspace(nodes[0], nodes[-1], _FINER * nodes.size)
    of_line = np.exp(np.interp(inside, np.log(line.frequency), np.log(line.density)) + inside)
    variance = 2 * np.trapezoid(of_line, inside)
    x = np.append(inside, np.linspace(nodes[-1], nodes[-1] + _BEYOND, _FINER * _LAST_RINGS * 10)[1:])
    r = np.exp(x)
    across = 2 / np.pi * (np.arcsin(np.minimum(high / r, 1.0)) - np.arcsin(np.minimum(low / r, 1.0)))
    weight = np.gradient(x) * 2 * np.pi * r**2 * across
    near = np.stack([np.interp(x, nodes, row) for row in np.eye(nodes.size)], axis=1)
    relative = spectrum.uncertainty / spectrum.density
    start = log_density = np.log(spectrum.density)
    for _ in range(_ADJUSTMENTS):
        last = min(_LAST_RINGS, nodes.size - 1)
        power = (log_density[-1 - last] - log_density[-1]) / (nodes[-1] - nodes[-1 - last])
        beyond = max(1 + _LEAST_POWER, power) * np.maximum(x - nodes[-1], 0.0)
        parts = weight * np.exp(np.interp(x, nodes, log_density) - beyond)
        share = parts @ near / parts.sum()
        direction = relative**2 * share
        change = direction * np.log(variance / parts.sum()) / max(float(direction @ share), 1e-300)
        log_density = log_density + np.clip(change, -_LARGEST_CHANGE, _LARGEST_CHANGE)
    density = np.exp(log_density)
    return Rings(spectrum.frequency, density, density * np.hypot(relative, log_density - start))


def _inverted(node: Array, log_density: Array, frequency: Array) -> Array:
    """S at frequencies, from the logarithm of W at nodes."""
    log_node = np.log(node)
    power = -np.diff(log_density) / np.diff(log_node)
    last = min(_LAST_RINGS, power.size)
    power = np.append(power, max(_LEAST_POWER, float(power[-last:].mean())))
    # With r = f cosh t the root cancels: dr/√(r² − f²) = dt.
    start = np.arccosh(np.maximum(node / frequency[:, None], 1.0))
    end = np.concatenate([start[:, 1:], start[:, -1:] + 40 / (power[-1] + 1)], axis=1)
    middle, half = (end + start) / 2, (end - start) / 2
    r = frequency[:, None, None] * np.cosh(middle[..., None] + half[..., None] * _T)
    exponent = log_density[None, :, None] - power[:, None] * (np.log(r) - log_node[:, None])
    panels = (np.exp(exponent) / r * _WEIGHT).sum(axis=-1) * half * power
    return np.asarray(panels.sum(axis=1) / np.pi)
