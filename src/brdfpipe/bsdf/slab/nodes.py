"""Where the faces of a slab are sampled: polar angles outside and inside, and azimuths."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from brdfpipe.geometry import Array
from brdfpipe.hemisphere import panel_rule


@dataclass(frozen=True)
class Nodes:
    """Polar angles outside and inside a body, and their étendues.

    Parameters
    ----------
    outside : (N,) degree
    inside : (J,) degree; the first N are those outside, refracted
    weight : (J,) étendue over 2π; the first N are those outside as well
    """

    outside: Array
    inside: Array
    weight: Array

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
    """Azimuths from the plane of incidence at which a lobe is sampled, dense at its peak, and its Fourier integrals.

    Parameters
    ----------
    phi : (P,) radian, from 0 to π
    spline : the cubic spline through unit values at each of them, even about both ends
    """

    phi: Array
    spline: CubicSpline

    @classmethod
    def of(cls, scale: float, count: int) -> Azimuths:
        """Nodes on which a lobe of width ``scale`` [radian], or any wider one, is a smooth spline."""
        phi = scale * np.sinh(np.linspace(0, np.arcsinh(np.pi / scale), count))
        phi[-1] = np.pi
        return cls(phi, CubicSpline(phi, np.eye(count), bc_type="clamped"))

    def integrals(self, modes: Array) -> Array:
        """∫ g(φ) cos mφ dφ over the circle of the spline g through unit values, (P, modes).

        Exact for the spline: four integrations by parts leave its third derivative, which is constant between nodes.
        """
        third = 6 * self.spline.c[0]
        cosine = np.cos(self.phi[:, None] * modes)
        with np.errstate(divide="ignore", invalid="ignore"):
            result = 2 * third.T @ (cosine[:-1] - cosine[1:]) / modes**4
        return np.where(modes == 0, 2 * np.asarray(self.spline.integrate(0, np.pi))[:, None], result)
