"""Veiling glare of known halos: estimated, subtracted, and its uncertainty."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import fft, ndimage, sparse

from brdfpipe.rig.reduction import glare

SHAPE = (160, 200)
ROWS, COLUMNS = np.mgrid[: SHAPE[0], : SHAPE[1]]
SPOTS = [(x, y) for x in (20, 40, 160, 180) for y in range(14, 150, 16)]
NOISE = 1e-4


def distance(x, y):
    return np.hypot(COLUMNS - x, ROWS - y)


def scene(lobe: float = 5.0, base: float = 0.3):
    """A disc with a lobe and spots beside it, and the pixels without light."""
    disc = distance(100, 80) < 45
    lit = np.where(disc, base + lobe * np.exp(-(distance(100, 80) ** 2) / (2 * 12**2)), 0.0)
    dark = distance(100, 80) > 49
    for x, y in SPOTS:
        lit = lit + base * (distance(x, y) < 3)
        dark &= distance(x, y) > 8
    return ndimage.gaussian_filter(lit, 0.7), dark


def halo_of(picture, kernel):
    """The exact convolution of the picture with a halo of integral 1."""
    size = [2 * side for side in SHAPE]
    row, column = (np.fft.fftfreq(count, 1 / count) for count in size)
    spread = kernel(np.hypot(row[:, None], column))
    halo = fft.irfft2(fft.rfft2(picture, size) * fft.rfft2(spread, size), size)
    return halo[: SHAPE[0], : SHAPE[1]]


def moffat(radius, exponent):
    return lambda r: (exponent - 1) / (np.pi * radius**2) * (1 + (r / radius) ** 2) ** -exponent


def exponential(radius):
    return lambda r: np.exp(-r / radius) / (2 * np.pi * radius**2)


def photographed(shining, kernel, share, seed=0):
    seen = (1 - share) * shining + share * halo_of(shining, kernel)
    variance = NOISE**2 * (1 + 100 * np.maximum(seen, 0))
    return seen + np.sqrt(variance) * np.random.default_rng(seed).standard_normal(SHAPE), variance


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


SPOT_SUMS = sparse.csr_array(np.array([(distance(x, y) < 5).ravel().astype(float) for x, y in SPOTS]))
DISC_SUMS = sparse.csr_array(
    np.array([(distance(x, y) < 4).ravel().astype(float) for x in range(65, 140, 10) for y in range(50, 115, 10)])
)


@settings(max_examples=12, deadline=None)
@given(
    st.floats(0.002, 0.02),
    st.one_of(
        st.tuples(st.floats(15.0, 80.0), st.floats(1.3, 2.0)).map(lambda shape_of: moffat(*shape_of)),
        st.floats(25.0, 60.0).map(exponential),
    ),
    st.floats(0.0, 20.0),
)
def test_a_known_halo_is_subtracted(share, kernel, lobe):
    """At the spots at most a tenth of the glare is left; on the disc, where it is extrapolated, as much as its stated uncertainty."""
    shining, dark = scene(lobe)
    seen, variance = photographed(shining, kernel, share)
    halo = glare.estimate(seen, variance, dark)
    clean = glare.subtract(seen, halo) - halo.level
    error = (clean - (1 - share) * shining).ravel()
    glow = share * halo_of(shining, kernel).ravel()
    noise = np.sqrt(SPOT_SUMS @ variance.ravel())
    assert rms(SPOT_SUMS @ error) < 0.1 * rms(SPOT_SUMS @ glow) + 2 * rms(noise)
    u = np.hypot(glare.uncertainty(clean, halo, DISC_SUMS), np.sqrt(DISC_SUMS @ variance.ravel()))
    assert rms(DISC_SUMS @ error / u) < 3
    assert rms(u) < 1.5 * rms(DISC_SUMS @ glow) + 2 * rms(noise)


@pytest.mark.parametrize(
    "kernel", [moffat(40, 1.5), moffat(15, 1.3), exponential(30)], ids=["wide", "steep", "exponential"]
)
def test_the_remaining_glare_is_as_large_as_its_stated_uncertainty(kernel):
    ratios = []
    for seed in range(8):
        shining, dark = scene(10.0 * (seed + 1))
        seen, variance = photographed(shining, kernel, 0.005, seed)
        halo = glare.estimate(seen, variance, dark)
        clean = glare.subtract(seen, halo) - halo.level
        for sums in (SPOT_SUMS, DISC_SUMS):
            u = glare.uncertainty(clean, halo, sums)
            error = sums @ (clean - 0.995 * shining).ravel()
            noise = sums @ variance.ravel()
            ratios += list(error**2 / (u**2 + noise))
    assert 0.2 < np.sqrt(np.mean(ratios)) < 1.3


def test_without_a_halo_nothing_is_subtracted():
    shining, dark = scene()
    seen, variance = photographed(shining, moffat(40, 1.5), 0.0)
    halo = glare.estimate(seen, variance, dark)
    assert halo.share < 1e-4
    changed = np.abs(SPOT_SUMS @ (glare.subtract(seen, halo) - seen).ravel())
    assert (changed < 2 * np.sqrt(SPOT_SUMS @ variance.ravel())).all()


def test_a_camera_without_noise_or_halo_has_no_glare():
    shining, dark = scene()
    halo = glare.estimate(np.where(dark, 0.0, shining), np.full(SHAPE, 1e-8), dark)
    assert halo.share < 1e-5
    assert np.isfinite(glare.uncertainty(shining, halo, SPOT_SUMS)).all()


def test_an_empty_picture_has_no_glare():
    _, dark = scene()
    variance = np.full(SHAPE, NOISE**2)
    halo = glare.estimate(NOISE * np.random.default_rng(0).standard_normal(SHAPE), variance, dark)
    assert np.isfinite(halo.amplitudes).all()
    picture = np.zeros(SHAPE)
    assert (glare.uncertainty(picture, glare.estimate(picture, variance, dark), SPOT_SUMS) < NOISE).all()


def test_an_even_level_is_distinguished_from_a_halo_and_left():
    shining, dark = scene()
    seen, variance = photographed(shining, moffat(40, 1.5), 0.005)
    plain = glare.estimate(seen, variance, dark)
    lifted = glare.estimate(seen + 0.01, variance, dark)
    # The widest Gaussian and a level are almost the same: together they change by what was added.
    glow, lit = (
        float((seen - glare.subtract(seen, estimated) + estimated.level)[dark].mean()) for estimated in (plain, lifted)
    )
    assert lit - glow == pytest.approx(0.01, rel=0.05)
    assert lifted.level - plain.level == pytest.approx(0.01, rel=0.2)


def test_the_halo_is_that_of_the_scene_and_not_of_the_picture():
    """K/(1 + K) of the picture, not K of it: the halo has a halo already."""
    strong = glare.Glare(np.where(np.arange(glare.WIDTHS.size) == 5, 0.2, 0.0), 0.0, np.zeros((12, 12)), 1.0)
    shining, _ = scene()
    wide = glare.WIDTHS[5]
    seen = shining + 0.2 * halo_of(shining, lambda r: np.exp(-((r / wide) ** 2) / 2) / (2 * np.pi * wide**2))
    # The halo at the edge of the picture ends there, which a transform does not know.
    inner = np.s_[40:-40, 40:-40]
    left = glare.subtract(seen, strong) - shining
    assert np.abs(left[inner]).max() < 0.02 * np.abs(seen - shining)[inner].max()


def test_pictures_are_corrected_one_by_one_as_together():
    shining, dark = scene()
    seen, variance = photographed(shining, moffat(40, 1.5), 0.005)
    halo = glare.estimate(seen, variance, dark)
    both = glare.subtract(np.array([seen, 2 * seen]), halo)
    assert both[0] == pytest.approx(glare.subtract(seen, halo), abs=1e-12)
    assert both[1] == pytest.approx(2 * both[0], abs=1e-12)


def test_the_glare_of_a_picture_without_background_is_unknown():
    halo = glare.estimate(np.ones(SHAPE), np.ones(SHAPE), np.zeros(SHAPE, dtype=bool))
    assert halo is glare.UNKNOWN
    assert (glare.subtract(np.ones(SHAPE), halo) == 1).all()
    assert (glare.uncertainty(np.ones(SHAPE), halo, SPOT_SUMS) == 0).all()


def test_a_halo_that_no_sum_of_gaussians_fits_is_uncertain():
    """A ghost: a displaced image of the disc."""
    shining, dark = scene()
    seen, variance = photographed(shining, moffat(40, 1.5), 0.005)
    ghost = 0.01 * np.roll(shining, (50, 70), (0, 1))
    halo = glare.estimate(seen + ghost, variance, dark)
    assert halo.misfit > 10
    plain = glare.estimate(seen, variance, dark)
    assert glare.uncertainty(shining, halo, DISC_SUMS).mean() > 3 * glare.uncertainty(shining, plain, DISC_SUMS).mean()
