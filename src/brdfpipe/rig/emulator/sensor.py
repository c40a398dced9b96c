"""From electrons to counts: what a sensor adds, and what it cannot hold."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from brdfpipe.geometry import Array
from brdfpipe.rig.description import CameraSettings
from brdfpipe.rig.emulator.effects import Effects, stream

ROOM = 20.0
"""Temperature of the sensor when it is switched on [°C]."""

_DOUBLING = 7.0
"""Rise of temperature that doubles the dark current [°C]."""

_WARMING = 3000.0
"""Time constant of the sensor's warming [s]."""

_HOT = 100.0
"""Dark current of the coolest hot pixel over the others'; the rest is distributed exponentially above it, with twice this mean."""


class Sensor:
    """The sensor of a camera.

    Parameters
    ----------
    camera : size, gain, linear range, bits
    effects, seed : see :mod:`brdfpipe.rig.emulator.effects`; hot pixels and response are the same in all sessions
    """

    def __init__(self, camera: CameraSettings, effects: Effects, seed: int) -> None:
        shape = camera.height, camera.width
        self._camera, self._effects = camera, effects
        deviates = stream(seed, "response").standard_normal(shape)
        self._response = np.maximum(0.0, 1 + effects.response * deviates)
        self._dark = effects.dark * hot_pixels(shape, effects, seed)

    def temperature(self, time: float) -> float:
        """Of the sensor [°C], at a time since it was switched on [s]."""
        return ROOM + self._effects.warming * (1 - float(np.exp(-time / _WARMING)))

    def expected(self, light: Array, seconds: float, temperature: float) -> Array:
        """Mean electrons on each pixel, of light [e⁻] that a uniform sensor would take."""
        warm = 2.0 ** ((temperature - ROOM) / _DOUBLING)
        return np.asarray(self._response * light + self._dark * (seconds * warm))

    def read(self, expected: Array, noise: np.random.Generator) -> NDArray[np.uint16]:
        """Counts of a frame, its noise drawn from ``noise``."""
        camera, effects = self._camera, self._effects
        electrons = noise.poisson(expected).astype(float) if effects.photon_noise else expected
        charge = compressed(electrons, camera.linear_to, effects.compression)
        if effects.read_noise:
            charge = charge + effects.read_noise * noise.standard_normal(charge.shape)
        counts = np.rint(charge / camera.gain + effects.bias)
        return np.clip(counts, 0, camera.full).astype(np.uint16)


def hot_pixels(shape: tuple[int, int], effects: Effects, seed: int) -> Array:
    """Dark current of each pixel over that of most."""
    noise = stream(seed, "hot pixels")
    size = shape[0] * shape[1]
    relative = np.ones(size)
    hot = noise.permutation(size)[: round(effects.hot_pixels * size)]
    relative[hot] = _HOT * (1 + noise.exponential(2.0, hot.size))
    return relative.reshape(shape)


def compressed(electrons: Array, linear_to: float, scale: float) -> Array:
    """Charge that is read of electrons: l + c ln(1 + (e − l)/c) above l, which rises for ever; ``scale`` c = 0 is linear throughout."""
    if not scale or electrons.max(initial=0.0) <= linear_to:
        return electrons
    beyond = np.maximum(electrons - linear_to, 0.0)
    return np.asarray(np.minimum(electrons, linear_to) + scale * np.log1p(beyond / scale))
