"""Scans of one surface are sorted by what they are for, and do it."""

from __future__ import annotations

import numpy as np
import pytest
import samples
from random_surfaces import heights

from brdfpipe import facets, vocabulary
from brdfpipe.psd import PsdError, estimate, estimate_joined
from brdfpipe.psd.k_correlation import KCorrelation
from brdfpipe.psd.scans import sort_scans

MODEL, NOISE = KCorrelation(0.1, 5.0, 3.5), 0.002


def scan(pitch: float, seed: int, size: int = 256):
    return samples.surface(heights(MODEL.areal, (size, size), (pitch, pitch), seed), (pitch, pitch))


def measured_again(surface, seed: int, noise: float = NOISE):
    height = surface["height"]
    return surface.assign(
        height=height.copy(data=height + np.random.default_rng(seed).normal(scale=noise, size=height.shape))
    )


def repeat(surface, seed: int):
    return measured_again(surface, seed).assign_attrs(repeat=1)


@pytest.fixture(scope="module")
def magnifications():
    """Interferometer, microscope and AFM."""
    return scan(0.2, 1), scan(2.0, 2), scan(0.01, 3)


def test_scans_of_three_magnifications_make_one_spectrum(magnifications) -> None:
    joined = estimate_joined(magnifications)
    assert float(joined["band_low"]) < 0.02
    assert float(joined["band_high"]) > 40
    assert joined["scan_band_high"].values == pytest.approx([2.5, 0.25, 50], rel=0.1)
    relative = (joined["psd_uncertainty"] / joined["psd"]).values
    z = (joined["psd"].values / MODEL.areal(joined["frequency"].values) - 1) / relative
    assert np.sqrt(np.mean(z**2)) < 2
    assert float(joined["fit_slope"]) == pytest.approx(3.5, abs=4 * float(joined["fit_slope_u"]))


def test_facets_are_those_of_the_first_magnification(magnifications) -> None:
    first, coarse, fine = magnifications
    together, alone = facets.estimate(magnifications), facets.estimate(first)
    assert together["slope_density"].equals(alone["slope_density"])
    assert "scans of the pitches 2, 0.01 um extend the roughness spectrum alone" in together.attrs["history"]
    assert not any("list it first" in text for text in vocabulary.warnings(together))
    # Slopes of this surface grow with every finer pitch, and the microscope does not resolve light.
    assert any("list it first" in text for text in vocabulary.warnings(facets.estimate([coarse, first, fine])))


def test_repeats_give_the_noise_and_are_not_counted() -> None:
    clean = scan(0.2, 1)
    noisy = measured_again(clean, 10)
    scans = [noisy, repeat(clean, 11), repeat(clean, 12)]
    found = facets.estimate(scans)
    assert float(found["noise_sigma"]) == pytest.approx(NOISE, rel=0.03)
    assert float(found["facet_count"]) == float(facets.estimate(noisy)["facet_count"])
    reference = float(facets.estimate(clean, noise=0.0)["slope_rms"])
    # Noise makes a twentieth of the mean square slope, and is known to 3 %.
    assert float(facets.estimate(noisy, noise=0.0)["slope_rms"]) > 1.02 * reference
    assert float(found["slope_rms"]) == pytest.approx(reference, rel=0.003)
    joined = estimate_joined(scans)
    assert float(joined["noise_sigma"]) == float(found["noise_sigma"])
    assert joined["psd"].equals(estimate(noisy, noise=sort_scans(scans).noise)["psd"])
    assert "difference of three scans of one place" in joined.attrs["history"]


def test_the_given_noise_is_that_of_the_first_magnification(magnifications) -> None:
    first, _, fine = magnifications
    given = estimate_joined([measured_again(first, 10), fine], noise=NOISE)
    assert given["scan_band_high"].values[1] == pytest.approx(50, rel=0.1)


def test_scans_of_one_filter_are_of_one_magnification_whatever_their_pitch() -> None:
    surface = scan(1.0, 1).assign_attrs(lambda_s=16.0)
    found = sort_scans([surface, surface.assign_attrs(pitch_x=2.0, pitch_y=2.0)])
    assert len(found.counted) == 2
    assert not found.extending


def test_repeats_that_contradict_the_description_are_refused() -> None:
    clean = scan(0.2, 1, 64)
    with pytest.raises(PsdError, match=r"accepted: one of `surface.noise` and `surface.scans.repeat`"):
        sort_scans([clean, repeat(clean, 1)], noise=0.0)
    with pytest.raises(PsdError, match=r"one of `surface.scans.repeat` and `surface.lambda_s`"):
        sort_scans([clean.assign_attrs(lambda_s=2.0), repeat(clean, 1)])
    with pytest.raises(PsdError, match="the same positions"):
        sort_scans([clean, repeat(scan(0.2, 1, 128), 1)])
