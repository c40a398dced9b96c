"""Sensor of the camera: from electrons to counts, with noise, dark current, hot pixels and saturation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from brdfpipe.geometry import Array
from brdfpipe.rig.description import CameraSettings
from brdfpipe.rig.emulator.effects import Effects, random_stream

ROOM_TEMPERATURE = 20.0
"""Temperature of the sensor when it is switched on [°C]."""

_DOUBLING = 7.0
"""Temperature rise that doubles the dark current [°C]."""

_WARMING_TIME = 3000.0
"""Time constant of the warming of the sensor [s]."""

_HOT = 100.0
"""Smallest relative dark current of a hot pixel; the excess is distributed exponentially with twice this mean."""


class Sensor:
    """The sensor of a camera; hot pixels and response are equal in all sessions."""

    def __init__(self, camera: CameraSettings, effects: Effects, seed: int) -> None:
        shape = camera.height, camera.width
        self._camera, self._effects = camera, effects
        deviates = random_stream(seed, "response").standard_normal(shape)
        self._response = np.maximum(0.0, 1 + effects.response * deviates)
        self._dark = effects.dark * hot_pixels(shape, effects, seed)

    def temperature(self, time: float) -> float:
        """Temperature of the sensor [°C] at a time since it was switched on [s]."""
        return ROOM_TEMPERATURE + self._effects.warming * (1 - float(np.exp(-time / _WARMING_TIME)))

    def expected(self, light: Array, seconds: float, temperature: float) -> Array:
        """Expected electrons in each pixel; ``light``: (height, width), electrons in a sensor of uniform response."""
        warming = 2.0 ** ((temperature - ROOM_TEMPERATURE) / _DOUBLING)
        return np.asarray(self._response * light + self._dark * (seconds * warming))

    def read(self, expected: Array, noise: np.random.Generator) -> NDArray[np.uint16]:
        """Counts of a frame, with noise from ``noise``."""
        camera, effects = self._camera, self._effects
        electrons = noise.poisson(expected).astype(float) if effects.photon_noise else expected
        if effects.cosmic:
            electrons = electrons + cosmic_hits(electrons.shape, effects.cosmic, noise)
        charge = compressed(electrons, camera.linear_to, effects.compression)
        if effects.read_noise:
            charge = charge + effects.read_noise * noise.standard_normal(charge.shape)
        counts = np.rint(charge / camera.gain + effects.bias)
        return np.clip(counts, 0, camera.full).astype(np.uint16)


def cosmic_hits(shape: tuple[int, ...], count: float, noise: np.random.Generator) -> Array:
    """Electrons of cosmic hits on a frame (height, width): tracks of one to three pixels with 3000 electrons on average in each."""
    charge = np.zeros(shape)
    hits = noise.poisson(count)
    row, column = (noise.integers(0, size, hits) for size in shape)
    steps = noise.integers(-1, 2, (2, hits))
    for pixel in range(3):
        reached = noise.integers(1, 4, hits) > pixel
        at = [
            np.clip(start + pixel * step, 0, size - 1)
            for start, step, size in zip((row, column), steps, shape, strict=True)
        ]
        np.add.at(charge, (at[0][reached], at[1][reached]), noise.exponential(3000.0, int(reached.sum())))
    return charge


def hot_pixels(shape: tuple[int, int], effects: Effects, seed: int) -> Array:
    """Dark current of each pixel relative to that of a normal pixel."""
    generator, size = random_stream(seed, "hot pixels"), shape[0] * shape[1]
    relative = np.ones(size)
    hot = generator.permutation(size)[: round(effects.hot_pixels * size)]
    relative[hot] = _HOT * (1 + generator.exponential(2.0, hot.size))
    return relative.reshape(shape)


def compressed(electrons: Array, linear_to: float, scale: float) -> Array:
    """Charge read from electrons e: l + c ln(1 + (e − l)/c) above the linear range l; linear throughout for the scale c = 0."""
    if not scale or electrons.max(initial=0.0) <= linear_to:
        return electrons
    excess = np.maximum(electrons - linear_to, 0.0)
    return np.asarray(np.minimum(electrons, linear_to) + scale * np.log1p(excess / scale))
