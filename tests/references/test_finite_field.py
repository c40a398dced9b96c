"""Light of a field on a finite area, in the mean over fields of known autocovariance."""

from __future__ import annotations

import numpy as np
from scipy import fft

from brdfpipe.references.finite_field import FadedField, MirroredField
from brdfpipe.references.frequency_rings import FrequencyRings

SIZE, LENGTH = 64, 6.0
"""Size and correlation length [pixel]"""


def factor_of_covariance():
    """A with A Aᵀ the autocovariance exp(−x²/ℓ²) of one axis."""
    place = np.arange(SIZE)
    covariance = np.exp(-(((place[:, None] - place) / LENGTH) ** 2))
    value, vector = np.linalg.eigh(covariance)
    return vector * np.sqrt(np.maximum(value, 0))


def rings_of(field_size: int) -> FrequencyRings:
    """As close as the modes of a field of one slow wave."""
    wave = np.cos(np.pi * (np.arange(field_size) + 0.5) / field_size)
    return FrequencyRings.of(wave[:, None] + wave, np.ones(2))


def test_the_mean_light_of_a_mirrored_field_is_that_of_an_infinite_one():
    factor, generator, rings = factor_of_covariance(), np.random.default_rng(1), rings_of(SIZE)
    near = MirroredField.of((SIZE, SIZE), np.ones(2), rings, np.ones(rings.frequency.size))
    faded = FadedField.of((SIZE, SIZE), np.ones(2), rings, None)
    light = np.zeros((2, rings.frequency.size))
    for _ in range(400):
        real, imaginary = (factor @ one @ factor.T for one in generator.normal(size=(2, SIZE, SIZE)))
        field = ((real + 1j * imaginary) / np.sqrt(2)).astype(np.complex64)
        light += near.light(field)[:-1] / SIZE**2, faded.light(field)[:-1]
    mirrored, faded_light = light / 400
    expected = np.pi * LENGTH**2 * np.exp(-((np.pi * LENGTH * rings.frequency) ** 2)) * rings.area
    within = [np.cumsum(one)[[3, 6, 10, 15]] for one in (mirrored, expected)]
    np.testing.assert_allclose(*within, rtol=0.03)
    np.testing.assert_allclose(faded_light.sum(), 1, atol=0.02)


def test_the_expected_power_of_mirrored_modes_is_that_of_the_transformed_covariance():
    # Without the formula.
    power = np.square(fft.dct(factor_of_covariance(), norm="ortho", axis=0)).sum(axis=1)
    power[0] -= power[1] / 2
    rings = rings_of(SIZE)
    near = MirroredField.of((SIZE, SIZE), np.ones(2), rings, np.ones(rings.frequency.size))
    number = len(near.expected[0])
    spectrum = np.sqrt(np.pi) * LENGTH * np.exp(-((np.pi * LENGTH * np.arange(number) / (2 * SIZE)) ** 2))
    np.testing.assert_allclose(near.expected[0] @ spectrum, power[:number], atol=0.002 * spectrum[0])
    assert (power[1:6] < 0.93 * spectrum[1:6]).all()
