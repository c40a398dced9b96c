"""Named forms of the reflection along the flake angle: ρ(θf) = Σ A exp[−(θf/B)^p] + C, with A >= 0, B > 0 and C >= 0."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from brdfpipe.errors import InputError
from brdfpipe.geometry import Array

FAINTEST = 1e-3
"""Share of a channel's largest value below which noise is absolute instead of relative."""
ROUNDING = 1e-12
BLACK = 1e-12
"""Smaller values count as 0: their square would underflow."""

_SAME_ANGLE = 1e-3
"""Flake angles closer than this count as equal [degree]."""
_STRAIGHT = 20.0
"""B over the range of flake angles, above which the decay is a straight line."""
_STEEP = 0.02
"""B over the smallest distance of two flake angles, below which B is undetermined."""


class Form(NamedTuple):
    """A form of decay."""

    terms: int
    power: int

    @property
    def parameters(self) -> int:
        return 2 * self.terms + 1

    @property
    def others(self) -> str:
        """Names of the other forms, for advice."""
        return ", ".join(name for name, form in FORMS.items() if form != self)


FORMS: Mapping[str, Form] = {
    "exponential": Form(1, 1),
    "gaussian": Form(1, 2),
    "double-exponential": Form(2, 1),
}


def curve(theta_f: ArrayLike, amplitude: Array, decay: Array, constant: Array, power: int) -> Array:
    """Σ A exp[−(θf/B)^p] + C: (..., channels) of θf (...) and parameters (terms, channels)."""
    theta = np.asarray(theta_f, dtype=float)[..., None]
    total = np.broadcast_to(constant, (*theta.shape[:-1], constant.size))
    for a, b in zip(amplitude, decay, strict=True):
        ratio = theta / b
        total = total + a * np.exp(-(ratio if power == 1 else ratio**power))
    return np.asarray(total)


def distinct(theta_f: Array) -> int:
    """Number of different flake angles."""
    return int(1 + np.count_nonzero(np.diff(np.sort(theta_f)) > _SAME_ANGLE)) if theta_f.size else 0


class ChannelCurve(NamedTuple):
    """Fitted parameters of one channel."""

    amplitude: Array
    decay: Array
    constant: float


class ChannelData(NamedTuple):
    """Values of one channel against the flake angle, and the form to fit to them."""

    name: str
    """For messages"""
    form: Form
    theta: Array
    """(geometries,) degree"""
    rho: Array
    """(geometries,) values"""
    scale: Array
    """Standard uncertainty of each value, or its relative substitute"""
    tolerance: Array
    """Largest tolerated misfit of each value"""
    known: bool
    """Whether the scale is the standard uncertainty"""

    def without(self, geometry: int) -> ChannelData:
        others = np.arange(self.theta.size) != geometry
        names = ("theta", "rho", "scale", "tolerance")
        return self._replace(**{name: getattr(self, name)[others] for name in names})

    @property
    def decay_range(self) -> tuple[float, float]:
        """Range of B in which the geometries may determine it [degree]."""
        gaps = np.diff(np.sort(self.theta))
        return _STEEP * float(gaps[gaps > _SAME_ANGLE].min()), _STRAIGHT * float(np.ptp(self.theta))

    def predicted(self, fitted: ChannelCurve) -> Array:
        """Values of a curve at the geometries."""
        constant = np.array([fitted.constant])
        return curve(self.theta, fitted.amplitude[:, None], fitted.decay[:, None], constant, self.form.power)[:, 0]

    def relative_misfit(self, fitted: ChannelCurve) -> float:
        """Rms of misfit over tolerance."""
        return float(np.sqrt(np.mean(((self.predicted(fitted) - self.rho) / self.tolerance) ** 2)))

    def out_of_range(self, parameter: str, reason: str) -> InputError:
        """The error for a parameter that this form cannot have."""
        return InputError(
            "material.yaml",
            f"{parameter} of the fit is out of range: {reason}",
            where=f"multiangle, channel {self.name}",
            accepted=f"A >= 0, B > 0, C >= 0; another form ({self.form.others}), more geometries, or corrected colours",
            key="multiangle.form",
        )

    def rising(self, near: float, far: float) -> InputError:
        """The error for a colour that is brighter at the flake angle ``far`` than at ``near``."""
        reason = f"the colour is brighter at a flake angle of {far:.4g} than at {near:.4g} degree"
        return self.out_of_range("A", f"{reason}, so that A would be negative")


NOT_CONVEX = "the colour falls linearly or ever faster with the flake angle, so that B would be infinite or negative"
"""Reason for a B out of range."""
