"""The coherent light of a rough perfect conductor near grazing, against exact solutions of Maxwell's equations for surfaces of one dimension.

Periodic surfaces of a Gaussian spectrum are solved by the method of moments with outgoing plane waves as basis, matched to the boundary
condition by least squares at all points of the surface. These waves are complete on it (Millar 1973, Radio Sci. 8, 785), so that the error is what
is left of the boundary condition. The mean field over many surfaces is the coherent light, as in Thorsos 1988 (J. Acoust. Soc. Am. 83, 78).
"""

from __future__ import annotations

import numpy as np
import pytest

WAVELENGTH, PERIOD, LENGTH, THETA, SURFACES = 0.55, 100.0, 5.0, 85.0, 20
WAVE_NUMBER, SINE, COSINE = 2 * np.pi / WAVELENGTH, np.sin(np.radians(THETA)), np.cos(np.radians(THETA))
POINTS = int(5 * PERIOD / WAVELENGTH)

Array = np.ndarray


def line_spectrum(sigma: float) -> Array:
    """Mean square height of each line of frequency m/PERIOD, m = 1, 2 …, half of it at −m [um2]."""
    frequency = np.arange(1, POINTS // 2 + 1) / PERIOD
    return 2 * np.sqrt(np.pi) * LENGTH * sigma**2 * np.exp(-((np.pi * LENGTH * frequency) ** 2)) / PERIOD


def relief(sigma: float, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Heights [um] and slopes at all points, and the mean square height of each line of this surface."""
    lines = np.sqrt(line_spectrum(sigma) / 4) * (rng.standard_normal((2, POINTS // 2)) * [[1], [1j]]).sum(axis=0)
    amplitudes = POINTS * np.concatenate([[0.0], lines])
    frequency = np.arange(amplitudes.size) / PERIOD
    height, slope = (np.fft.irfft(amplitudes * factor, POINTS) for factor in (1.0, 2j * np.pi * frequency))
    return height, slope, 2 * np.abs(lines) ** 2


def mirror_amplitude(height: Array, slope: Array, tm: bool) -> complex:
    """Amplitude of the mirror direction over that of a flat surface, with the error of boundary and energy proven small."""
    reach = 1.3  # Evanescent waves up to 1.3 times the wave number of the light.
    order = np.arange(np.ceil((-reach - SINE) * PERIOD / WAVELENGTH), (reach - SINE) * PERIOD / WAVELENGTH)
    sine = SINE + order * WAVELENGTH / PERIOD
    cosine = np.sqrt(1 - sine**2 + 0j)
    x = np.arange(POINTS) / POINTS
    waves = np.exp(1j * (2 * np.pi * np.outer(x, order) + WAVE_NUMBER * np.outer(height, cosine)))
    incident = np.exp(-1j * WAVE_NUMBER * COSINE * height)
    if tm:  # The normal derivative vanishes, for TE the field.
        waves *= cosine - slope[:, None] * sine
        incident *= -COSINE - slope * SINE
    scale = np.abs(waves).max(axis=0)
    amplitude = np.linalg.lstsq(waves / scale, -incident, rcond=1e-12)[0] / scale
    assert np.linalg.norm(waves @ amplitude + incident) < 3e-3 * np.linalg.norm(incident)
    assert np.sum(np.abs(amplitude) ** 2 * cosine.real) / COSINE == pytest.approx(1, abs=1e-4)
    return complex(amplitude[order == 0][0]) * (1 if tm else -1)


def amplitude_of_first_order(lines: Array, tm: bool) -> complex:
    """e^(−Σ 2k² w h²): loss to the orders that propagate, and change of phase by those that do not; w = cos θ_i cos θ for TE."""
    exponent = 0j
    for side in (1, -1):
        sine = SINE + side * np.arange(1, lines.size + 1) * WAVELENGTH / PERIOD
        cosine = np.sqrt(1 - sine**2 + 0j)
        weight = (1 - sine * SINE) ** 2 / (COSINE * cosine) if tm else COSINE * cosine
        exponent += WAVE_NUMBER**2 * np.sum(weight * lines)
    return complex(np.exp(-exponent))


@pytest.mark.slow
@pytest.mark.parametrize("sigma", [0.05, 0.12])
@pytest.mark.parametrize("tm", [False, True])
def test_coherent_light_near_grazing_is_what_the_first_order_leaves(sigma, tm):
    rng, found = np.random.default_rng(0), []
    for _ in range(SURFACES):
        height, slope, lines = relief(sigma, rng)
        found.append([mirror_amplitude(height, slope, tm), amplitude_of_first_order(lines, tm)])
    # The theory for each surface's own lines varies as its solution does: what differs has little noise.
    solved, theory = np.array(found).T
    coherent = abs(solved.mean())
    difference = 2 * coherent * (solved - theory).real.mean()
    noise = 2 * coherent * (solved - theory).real.std(ddof=1) / np.sqrt(SURFACES)
    share = abs(amplitude_of_first_order(line_spectrum(sigma), tm)) ** 2
    # Light of second order is about half the square of that of first order.
    second_order = (1 - share) ** 2 / 2
    assert abs(difference) < second_order + 3 * noise
    # The share e^(−g) is excluded, for TE as for TM: near grazing more light is scattered.
    of_phase = np.exp(-((2 * WAVE_NUMBER * sigma * COSINE) ** 2))
    assert of_phase - (share + difference) > 3 * (second_order + noise)
