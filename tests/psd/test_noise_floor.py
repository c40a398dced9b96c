from __future__ import annotations

import numpy as np
import pytest
import samples
from random_surfaces import gaussian, gaussian_line, heights

from brdfpipe.psd import PsdError
from brdfpipe.psd.k_correlation import KCorrelation
from brdfpipe.psd.noise_floor import UNKNOWN, from_repeats, given, noise_besides_rounding, noise_floor, plateau
from brdfpipe.psd.periodograms import Scan


def white(shape, scale, seed=11):
    return np.random.default_rng(seed).normal(scale=scale, size=shape)


@pytest.mark.parametrize("share", [0.01, 0.065, 0.2])
def test_the_plateau_above_a_gaussian_surface_is_its_noise(share: float) -> None:
    clean = heights(gaussian(0.1, 12.0), (256, 256), (1.0, 1.0), 1)
    floor = plateau(Scan(clean + white(clean.shape, share * 0.1), (1.0, 1.0)))
    # Of 64 patches the plateau scatters by less than 1 %; the stated 1.5 % are the whiteness of a real instrument.
    assert floor.sigma == pytest.approx(share * 0.1, rel=0.02)
    assert floor.uncertainty == pytest.approx(0.016 * floor.sigma, rel=0.2)


@pytest.mark.parametrize("slope", [2.2, 3.0, 4.0])
def test_a_surface_that_still_falls_at_the_highest_frequencies_has_no_plateau(slope: float) -> None:
    model = KCorrelation(0.1, 12.0, slope)
    assert plateau(Scan(heights(model.areal, (300, 300), (1.0, 1.0), 1), (1.0, 1.0))) is UNKNOWN
    # Sampled at points, waves beyond the Nyquist frequency are folded back and flatten the end of the spectrum.
    folded = heights(KCorrelation(0.1, 48.0, slope).areal, (900, 900), (1.0, 1.0), 1)[::3, ::3]
    assert plateau(Scan(folded, (3.0, 3.0))) is UNKNOWN


def test_a_plateau_that_holds_all_heights_may_be_the_surface() -> None:
    assert plateau(Scan(white((256, 256), 0.05), (1.0, 1.0))) is UNKNOWN


@pytest.mark.parametrize("share", [0.01, 0.1])
@pytest.mark.parametrize("points", [2000, 4000, 30_000])
def test_noise_of_a_line_is_found(points: int, share: float) -> None:
    z = []
    for seed in range(6):
        line = heights(gaussian_line(0.1, 15.0), (points,), (1.0,), seed)
        floor = plateau(Scan(line + white(line.shape, share * 0.1, seed + 50), (1.0,)))
        # The last octave of 2000 heights has 500 modes, which give the level to 4.5 %, and its whiteness is 3 %: half of both of σ. A power in the
        # octaves below may take some of the level.
        assert floor.uncertainty < 0.05 * share * 0.1
        z.append((floor.sigma - share * 0.1) / floor.uncertainty)
    assert float(np.sqrt(np.mean(np.square(z)))) < 1.5


@pytest.mark.parametrize("slope", [2.2, 2.6, 3.0, 4.0])
@pytest.mark.parametrize("points", [400, 1000, 4000])
def test_a_line_across_a_surface_that_still_falls_has_no_plateau(points: int, slope: float) -> None:
    # Few modes and waves that are folded back make an end that looks flat.
    for seed in range(8):
        folded = heights(KCorrelation(0.1, 36.0, slope).line, (3 * points,), (1.0,), seed)[::3]
        assert plateau(Scan(folded, (3.0,))) is UNKNOWN


def test_spikes_of_a_line_are_not_white_noise() -> None:
    line = heights(gaussian_line(0.1, 15.0), (4000,), (1.0,), 1)
    line[[700, 2900]] += 1.0
    assert plateau(Scan(line, (1.0,))) is UNKNOWN


def test_a_plateau_of_a_coarse_scan_may_be_roughness_finer_than_its_pitch() -> None:
    # The peaks of roughness of ℓ = 2 µm are 10 ℓ apart: white at this pitch.
    waviness, fine = heights(gaussian(1.0, 500.0), (256, 256), (20.0, 20.0), 1), white((256, 256), 0.05)
    scan = Scan(waviness + fine, (20.0, 20.0))
    assert plateau(scan).unresolved(scan) == pytest.approx(0.05, rel=0.03)
    assert plateau(scan).unresolved(scan._replace(pitch=(1.0, 1.0))) == 0
    stated = given(scan, 0.05)
    assert stated.unresolved(scan) == from_repeats(scan, [scan._replace(height=waviness)]).unresolved(scan) == 0


def test_noise_above_all_slopes_is_refused() -> None:
    # Neighbours differ by σ√(2(1 − exp(−1/ℓ²))) = 0.083 σ at ℓ = 12 pixels: noise alone would be 0.083 σ/√2 = 0.059 σ.
    clean = heights(gaussian(0.1, 12.0), (256, 256), (1.0, 1.0), 1)
    scan = Scan(clean, (1.0, 1.0))
    with pytest.raises(PsdError, match="neighbouring heights differ by less"):
        given(scan, 0.3 * float(clean.std()))
    assert given(scan, 0.005).sigma == 0.005
    noisy = Scan(clean + white(clean.shape, 0.03), (1.0, 1.0))
    assert given(noisy, 0.03).sigma == 0.03


def test_spikes_are_not_white_noise() -> None:
    height = heights(gaussian(0.1, 12.0), (256, 256), (1.0, 1.0), 1)
    height[17, 40], height[200, 130] = 3.0, -3.0
    assert plateau(Scan(height, (1.0, 1.0))) is UNKNOWN


def test_the_difference_of_two_scans_of_one_place_is_noise() -> None:
    # A slope of 3 hides the noise from the plateau, not from the difference.
    clean = heights(KCorrelation(0.1, 12.0, 3.0).areal, (256, 256), (1.0, 1.0), 1)
    first, second = (samples.surface(clean + white(clean.shape, 0.005, seed)) for seed in (1, 2))
    assert noise_floor(first) is UNKNOWN
    floor = noise_floor(first, second)
    assert floor.sigma == pytest.approx(0.005, abs=3 * floor.uncertainty)
    assert floor.uncertainty < 3e-4


def test_scans_of_one_place_must_match() -> None:
    height = white((64, 64), 0.1)
    with pytest.raises(PsdError, match="the same positions"):
        noise_floor(samples.surface(height), samples.surface(height[:, :60]))
    with pytest.raises(PsdError, match="a second measurement"):
        noise_floor(samples.surface(height), samples.surface(height))


def test_rounding_is_no_further_noise() -> None:
    clean, step = heights(gaussian(0.1, 12.0), (256, 256), (1.0, 1.0), 1), 0.01
    rounded = np.rint(clean / step) * step
    floor = plateau(Scan(rounded, (1.0, 1.0)))
    assert floor.sigma == pytest.approx(step / np.sqrt(12), rel=0.05)
    assert noise_besides_rounding(floor, step) == 0
    noisy = np.rint((clean + white(clean.shape, 0.01)) / step) * step
    assert noise_besides_rounding(plateau(Scan(noisy, (1.0, 1.0))), step) == pytest.approx(0.01, rel=0.03)


@pytest.mark.parametrize("uncertainty", [0.0, 0.002, 0.01])
def test_a_given_noise_is_noise_however_uncertain(uncertainty: float) -> None:
    floor = given(Scan(white((64, 64), 0.1), (1.0, 1.0)), 0.01, uncertainty=uncertainty)
    assert noise_besides_rounding(floor, 0.0) == 0.01
    assert noise_besides_rounding(floor, 0.01) == pytest.approx(0.01 * (11 / 12) ** 0.5)
