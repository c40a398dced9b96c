"""The way of the light to the holder: lamp, slit, splitter, neutral filters, mirrors."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from brdfpipe.geometry import Array
from brdfpipe.rig.description import Rig
from brdfpipe.rig.emulator.effects import Effects, stream

SPLIT = 0.08
"""Share of the light that the splitter sends to the reference fibre, at :data:`MIDDLE`."""

MIDDLE = 560.0
"""Wavelength at which the lamp is 1 and slopes are 0 [nm]."""

_HALF_BAND = 170.0
"""From the middle to the ends of what the rig is built for, 390 to 730 nm."""

_WARM_UP = 600.0
"""Time constant of the lamp [s]."""

_PERIODS = np.array([2800.0, 5000.0, 7900.0])
"""Of the lamp's wandering [s]: minutes to hours, no multiples of each other."""

_LINES = np.array(
    [
        *((450.1, 0.06), (462.4, 0.15), (467.1, 0.28), (473.4, 0.12), (480.7, 0.10), (484.3, 0.08), (492.0, 0.10)),
        *((823.2, 2.6), (828.0, 1.4), (834.7, 0.6), (840.9, 0.6), (881.9, 2.8), (895.2, 1.2), (904.5, 1.4)),
        *((916.3, 1.8), (979.9, 1.2), (992.3, 1.2)),
    ]
)
"""Wavelengths of xenon [nm] (NIST Atomic Spectra Database), and heights above the continuum that give the look of an arc's spectrum."""

_LINE_WIDTH = 3.0
"""Standard deviation of a line in an arc under pressure [nm]."""

_TRIANGLE = np.sqrt(0.4) * np.array([-1.0, 0.0, 1.0]), np.array([5, 14, 5]) / 24
"""Gauss's rule of three points for a triangular band of unit full width at half maximum: exact for polynomials of degree 5."""


class Source:
    """What reaches the splitter, the reference and the holder, of a lamp whose middle is 1 at :data:`MIDDLE`.

    Parameters
    ----------
    rig : filters, slit
    effects, seed, session : see :mod:`brdfpipe.rig.emulator.effects`
    """

    def __init__(self, rig: Rig, effects: Effects, seed: int, session: int) -> None:
        self._rig, self._effects, self._seed = rig, effects, seed
        self._phases = stream(seed, "lamp", session).uniform(0, 2 * np.pi, _PERIODS.size)

    def lamp(self, time: ArrayLike) -> Array:
        """Light of the lamp over that of a warm and steady one, at a time since it was lit [s].

        Times count in whole milliseconds: one that has been through a file gives the same light.
        """
        time = np.round(np.asarray(time, dtype=float), 3)[..., None]
        waves = np.sin(2 * np.pi * time / _PERIODS + self._phases).sum(axis=-1) * np.sqrt(2 / _PERIODS.size)
        warm = 1 - self._effects.warm_up * np.exp(-time[..., 0] / _WARM_UP)
        return np.asarray(warm * np.maximum(0.0, 1 + self._effects.drift * waves))

    def band(self, wavelength: ArrayLike) -> tuple[Array, Array]:
        """Wavelengths [nm] that stand for the band the slit lets pass, (…, nodes), and the lamp's light in each."""
        wavelength = np.asarray(wavelength, dtype=float)[..., None]
        if not self._effects.slit:
            return wavelength, self._spectrum(wavelength)
        offsets, weights = _TRIANGLE
        nodes = wavelength + self._rig.slit * offsets
        return nodes, weights * self._spectrum(nodes)

    def split(self, wavelength: ArrayLike) -> Array:
        """Share that goes to the reference; the rest goes on to the holder."""
        return SPLIT * (1 + self._effects.splitter_slope * (np.asarray(wavelength, dtype=float) - MIDDLE) / 100)

    def filter(self, position: int, wavelength: float) -> float:
        """True transmittance of what stands at a position of the wheel; nothing stands where the description has no filter."""
        for each in self._rig.filters:
            if each.position == position:
                constant, tilt = stream(self._seed, "filter", position).uniform(-1, 1, 2)
                # At most u in all: the tilt takes 3/10 of it at the ends of the band.
                error = 0.7 * constant + 0.3 * tilt * np.clip((wavelength - MIDDLE) / _HALF_BAND, -1, 1)
                true = each.transmittance * (1 + self._effects.filters * each.u * float(error))
                return min(max(true, 0.0), 1.0)
        return 1.0

    def path(self, entrance: float, wavelength: ArrayLike) -> Array:
        """Share of the holder's light that the mirrors of an entrance bring there, about 1."""
        which = round(1000 * entrance)
        level = 1 + self._effects.paths * stream(self._seed, "path", which).standard_normal()
        slope = self._effects.path_slope * stream(self._seed, "path slope", which).standard_normal()
        return np.maximum(0.0, level * (1 + slope * (np.asarray(wavelength, dtype=float) - MIDDLE) / 100))

    def _spectrum(self, wavelength: Array) -> Array:
        return _xenon(wavelength) / _xenon(np.array(MIDDLE)) if self._effects.xenon else np.ones_like(wavelength)


def _xenon(wavelength: Array) -> Array:
    """A xenon arc as the camera sees it through the grating: weak in the violet, where both grow blind, lines on a flat continuum."""
    lines = _LINES[:, 1] * np.exp(-(((wavelength[..., None] - _LINES[:, 0]) / _LINE_WIDTH) ** 2) / 2)
    seen = 1 / (1 + np.exp((405 - wavelength) / 18)) / (1 + np.exp((wavelength - 780) / 60))
    return np.asarray((1 + lines.sum(axis=-1)) * seen)
