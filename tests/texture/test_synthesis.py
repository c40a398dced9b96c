"""Maps that look like a sample: spectrum, distribution, structure, borders."""

from __future__ import annotations

import numpy as np
import pytest
import relief_maps
from hypothesis import given
from hypothesis import strategies as st

from brdfpipe.errors import BrdfpipeError
from brdfpipe.texture.synthesis import METHODS, likeness, synthesise


def sample_of(name, size=300):
    """A part of a larger map: it is not periodic."""
    return relief_maps.MAPS[name](512, 1)[:size, :size]


def curvature_skewness(height):
    curvature = (height[2:] + height[:-2])[:, 1:-1] + (height[:, 2:] + height[:, :-2])[1:-1] - 4 * height[1:-1, 1:-1]
    return float(np.mean((curvature - curvature.mean()) ** 3) / curvature.std() ** 3)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", ["slope 0.1", "cells", "ridges"])
@pytest.mark.parametrize("size", [256, 480])
def test_the_power_spectrum_is_that_of_the_sample_up_to_half_the_nyquist_frequency(name, size, method):
    sample = sample_of(name)
    tile = synthesise(sample, size, seed=2, method=method)
    found = likeness(sample, tile)
    assert found.spectrum < 0.05
    assert found.heights < 0.1
    # Another window than that of the synthesis, and rings of another width; its scatter is that of few pieces of a small sample.
    window = np.outer(np.sin(np.linspace(0, np.pi, 300)), np.sin(np.linspace(0, np.pi, 300)))
    frequency = [np.hypot(np.fft.fftfreq(n), np.fft.fftfreq(n)[:, None]) for n in (300, size)]
    power = [
        np.abs(np.fft.fft2((sample - sample.mean()) * window)) ** 2 / np.sum(window**2),
        np.abs(np.fft.fft2(tile)) ** 2 / tile.size,
    ]
    whole = [one[(f > 0.01) & (f < 0.25)].mean() for one, f in zip(power, frequency, strict=True)]
    assert whole[1] == pytest.approx(whole[0], rel=0.3)


@pytest.mark.parametrize("name", ["slope 0.1", "cells"])
def test_the_power_is_on_average_that_of_periodic_samples_without_a_window(name):
    """The periodogram of a periodic map needs no window: no estimate of the module is used."""
    frequency = np.hypot(np.fft.fftfreq(256), np.fft.fftfreq(256)[:, None])
    # The Gaussian falls by orders within the next octave, so that few waves would be compared.
    octaves = [(frequency >= low) & (frequency < 2 * low) for low in (1 / 64, 1 / 32)]
    power = np.zeros((2, len(octaves)))
    for seed in range(16):
        sample = relief_maps.MAPS[name](256, seed)
        for row, one in enumerate((sample, synthesise(sample, 256, seed=seed))):
            of_map = np.abs(np.fft.fft2(one)) ** 2
            power[row] += [of_map[octave].mean() for octave in octaves]
    # A window weights parts of a sample: one sample differs by 10 to 15 %, the mean of 16 by a quarter of that, two standard errors.
    assert power[1] == pytest.approx(power[0], rel=0.08)


def test_pieces_keep_the_cells_that_random_phases_lose():
    sample = sample_of("cells", 400)
    there = curvature_skewness(sample)
    by_method = {method: curvature_skewness(synthesise(sample, 384, method=method, seed=3)) for method in METHODS}
    assert there > 1
    assert abs(by_method["spectrum"]) < 0.3 * there
    assert by_method["structure"] == pytest.approx(there, rel=0.25)


@pytest.mark.parametrize("method", METHODS)
def test_borders_of_tiles_are_as_any_other_place(method):
    """Steps over the border, against the same number of steps at other places."""
    tile = synthesise(sample_of("cells"), 256, method=method, seed=5)
    for axis in (0, 1):
        rms = np.sqrt(np.mean((np.roll(tile, -1, axis) - tile) ** 2, axis=1 - axis))
        others = np.sort(rms[:-1])
        assert others[0] <= rms[-1] <= others[-1]
        correlation = [np.corrcoef(tile.take(k, axis), tile.take((k + 1) % 256, axis))[0, 1] for k in range(256)]
        assert min(correlation[:-1]) <= correlation[-1] <= 1


@given(
    size=st.integers(32, 90),
    seed=st.integers(0, 2**32 - 1),
    scale=st.sampled_from([1e-6, 1.0, 1e6]),
    method=st.sampled_from(METHODS),
)
def test_any_size_and_seed_gives_the_same_finite_map_again(size, seed, scale, method):
    sample = scale * sample_of("slope 0.1", 200)
    tile = synthesise(sample, size, method=method, seed=seed)
    assert tile.shape == (size, size)
    assert np.isfinite(tile).all()
    assert np.array_equal(tile, synthesise(sample, size, method=method, seed=seed))
    assert not np.array_equal(tile, synthesise(sample, size, method=method, seed=seed + 1))
    assert np.abs(tile).max() < 20 * sample.std()


def test_what_cannot_be_synthesised_is_refused():
    sample = sample_of("slope 0.1", 64)
    for sizes, options, words in (
        (16, {}, "out of range"),
        (64, {"method": "other"}, "unknown method"),
    ):
        with pytest.raises(BrdfpipeError, match=words):
            synthesise(sample, sizes, **options)
    with pytest.raises(BrdfpipeError, match="too small"):
        synthesise(sample[:20], 64)
    with pytest.raises(BrdfpipeError, match="flat"):
        synthesise(np.zeros((64, 64)), 64)
