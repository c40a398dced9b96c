"""Illumination path: lamp, slit, splitter, neutral filters, mirrors."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from brdfpipe.geometry import Array
from brdfpipe.rig.description import Rig
from brdfpipe.rig.emulator.effects import Effects, random_stream

SPLIT = 0.08
"""Share of the light that the splitter sends to the reference fibre, at :data:`MIDDLE_WAVELENGTH`."""

MIDDLE_WAVELENGTH = 560.0
"""Wavelength [nm] at which the spectrum of the lamp is 1, and about which slopes are linear."""

_HALF_RANGE = 170.0
"""From the middle to the ends of the rig's range, 390 to 730 nm."""

_WARM_UP_TIME = 600.0
"""Time constant of the warm-up of the lamp [s]."""

_DRIFT_PERIODS = np.array([2800.0, 5000.0, 7900.0])
"""Periods of the drift of the lamp [s]: minutes to hours, not multiples of each other."""

_LINES = np.array(
    [
        *((450.1, 0.06), (462.4, 0.15), (467.1, 0.28), (473.4, 0.12), (480.7, 0.10), (484.3, 0.08), (492.0, 0.10)),
        *((823.2, 2.6), (828.0, 1.4), (834.7, 0.6), (840.9, 0.6), (881.9, 2.8), (895.2, 1.2), (904.5, 1.4)),
        *((916.3, 1.8), (979.9, 1.2), (992.3, 1.2)),
    ]
)
"""Wavelengths of xenon lines [nm] (NIST Atomic Spectra Database), and heights above the continuum typical of an arc."""

MERCURY = np.array([(404.656, 0.3), (435.833, 0.8), (546.074, 1.0), (576.960, 0.2), (579.066, 0.2)])
"""Wavelengths of lines of mercury in air [nm] (NIST Atomic Spectra Database), and typical relative heights."""

_LINE_WIDTH = 3.0
"""Standard deviation of a pressure-broadened line [nm]."""

_SLIT_QUADRATURE = np.sqrt(0.4) * np.array([-1.0, 0.0, 1.0]), np.array([5, 14, 5]) / 24
"""Offsets and weights of the three-point Gauss rule for a triangular band of unit full width at half maximum: exact to degree 5."""


class Illumination:
    """Light that reaches the splitter, the reference and the sample; the spectrum of the lamp is 1 at :data:`MIDDLE_WAVELENGTH`."""

    def __init__(self, rig: Rig, effects: Effects, seed: int, session: int) -> None:
        self._rig, self._effects, self._seed = rig, effects, seed
        self._phases = random_stream(seed, "lamp", session).uniform(0, 2 * np.pi, _DRIFT_PERIODS.size)

    def lamp(self, time: ArrayLike) -> Array:
        """Light of the lamp relative to a warm and stable lamp, at a time since it was switched on [s].

        Times are rounded to milliseconds, so that a time read from a file gives the same light.
        """
        time = np.round(np.asarray(time, dtype=float), 3)[..., None]
        drift = np.sin(2 * np.pi * time / _DRIFT_PERIODS + self._phases).sum(axis=-1) * np.sqrt(2 / _DRIFT_PERIODS.size)
        warm_up = 1 - self._effects.warm_up * np.exp(-time[..., 0] / _WARM_UP_TIME)
        return np.asarray(warm_up * np.maximum(0.0, 1 + self._effects.drift * drift))

    def band(self, wavelength: ArrayLike) -> tuple[Array, Array]:
        """Quadrature nodes [nm] of the band that the slit transmits, (…, nodes), and the weighted light of the lamp at each."""
        wavelength = np.asarray(wavelength, dtype=float)[..., None] + self._effects.wavelength_offset
        if not self._effects.slit:
            return wavelength, self._spectrum(wavelength)
        offsets, weights = _SLIT_QUADRATURE
        nodes = wavelength + self._rig.slit * offsets
        return nodes, weights * self._spectrum(nodes)

    def line_lamp(self, wavelength: float) -> float:
        """Light of a mercury lamp that the slit transmits at a wavelength of the monochromator [nm]: a triangle about each line."""
        distance = np.abs(wavelength + self._effects.wavelength_offset - MERCURY[:, 0]) / self._rig.slit
        return float((MERCURY[:, 1] * np.maximum(1 - distance, 0.0)).sum())

    def split_ratio(self, wavelength: ArrayLike) -> Array:
        """Share of the light for the reference; the rest reaches the sample."""
        distance = np.asarray(wavelength, dtype=float) - MIDDLE_WAVELENGTH
        return SPLIT * (1 + self._effects.splitter_slope * distance / 100)

    def filter_transmittance(self, position: int, wavelength: float) -> float:
        """True transmittance at a position of the wheel; 1 where the description has no filter."""
        for filter_ in self._rig.filters:
            if filter_.position == position:
                constant, tilt = random_stream(self._seed, "filter", position).uniform(-1, 1, 2)
                # At most u in total, of which the tilt is 3/10 at the ends of the range.
                error = 0.7 * constant + 0.3 * tilt * np.clip((wavelength - MIDDLE_WAVELENGTH) / _HALF_RANGE, -1, 1)
                transmittance = filter_.transmittance * (1 + self._effects.filters * filter_.u * float(error))
                return min(max(transmittance, 0.0), 1.0)
        return 1.0

    def path_factor(self, entrance: float, wavelength: ArrayLike) -> Array:
        """Relative light that the mirrors of an entrance send to the sample, about 1."""
        key = round(1000 * entrance)
        level = 1 + self._effects.paths * random_stream(self._seed, "path", key).standard_normal()
        slope = self._effects.path_slope * random_stream(self._seed, "path slope", key).standard_normal()
        return np.maximum(0.0, level * (1 + slope * (np.asarray(wavelength, dtype=float) - MIDDLE_WAVELENGTH) / 100))

    def _spectrum(self, wavelength: Array) -> Array:
        if not self._effects.xenon:
            return np.ones_like(wavelength)
        return _xenon(wavelength) / _xenon(np.array(MIDDLE_WAVELENGTH))


def _xenon(wavelength: Array) -> Array:
    """Relative signal of a xenon arc: lines on a flat continuum, times the response of grating and camera, which falls in the violet."""
    lines = _LINES[:, 1] * np.exp(-(((wavelength[..., None] - _LINES[:, 0]) / _LINE_WIDTH) ** 2) / 2)
    response = 1 / (1 + np.exp((405 - wavelength) / 18)) / (1 + np.exp((wavelength - 780) / 60))
    return np.asarray((1 + lines.sum(axis=-1)) * response)
