"""Scans of several magnifications give one spectrum."""

from __future__ import annotations

import numpy as np
import pytest
import samples
from random_surfaces import heights

from brdfpipe import vocabulary
from brdfpipe.psd import PsdError, analytic, estimate, estimate_joined, join
from brdfpipe.psd.k_correlation import KCorrelation
from brdfpipe.psd.noise_floor import NoiseFloor

MODEL = KCorrelation(0.1, 5.0, 3.0)


def scan(size: int, pitch: float, seed: int, factor: float = 1.0):
    height = factor * heights(MODEL.areal, (size, size), (pitch, pitch), seed)
    return estimate(samples.surface(height, (pitch, pitch)))


@pytest.fixture(scope="module")
def microscope_and_interferometer():
    return scan(256, 2.0, 1), scan(256, 0.2, 2)


def test_the_joined_spectrum_covers_both_bands(microscope_and_interferometer) -> None:
    coarse, fine = microscope_and_interferometer
    joined = vocabulary.validate(join(coarse, fine), "psd")
    # The ends are those of rings of 1/20 decade here, and of wider ones there.
    assert float(joined["band_low"]) == pytest.approx(float(coarse["band_low"]), rel=0.4)
    assert float(joined["band_high"]) == pytest.approx(float(fine["band_high"]), rel=0.1)
    z = (joined["psd"].values / MODEL.areal(joined["frequency"].values) - 1) / (
        joined["psd_uncertainty"] / joined["psd"]
    ).values
    # Neighbouring values are interpolated between the same rings.
    assert 0.3 < np.sqrt(np.mean(z**2)) < 1.5
    assert not vocabulary.warnings(joined)
    for name, true in MODEL._asdict().items():
        assert abs(float((joined[f"fit_{name}"] - true) / joined[f"fit_{name}_u"])) < 3


def test_two_scans_alike_halve_the_variance() -> None:
    first, second = scan(256, 1.0, 1), scan(256, 1.0, 2)
    joined = join(first, second)
    relative = (joined["psd_uncertainty"] / joined["psd"]).values
    single = (first["psd_uncertainty"] / first["psd"]).interp(frequency=joined["frequency"]).values
    assert np.nanmedian(relative / single) == pytest.approx(np.sqrt(0.5), rel=0.25)


def test_noise_changes_scans_of_one_instrument_together_and_others_on_their_own() -> None:
    surfaces = [samples.surface(heights(MODEL.areal, (128, 128), (0.5, 0.5), seed), (0.5, 0.5)) for seed in (1, 2)]
    noise, u = 0.004, 0.0008
    # S falls by 2 σ u ΔA at all frequencies.
    expected = -2 * noise * u * 0.25
    one = estimate_joined(surfaces, noise=noise, noise_uncertainty=u)["psd_noise_change"]
    assert one.sizes["uncertain_noise"] == 1
    assert float(one.median()) == pytest.approx(expected, rel=0.1)
    floor = NoiseFloor(noise, u, "given")
    two = join(*(estimate(surface, noise=floor) for surface in surfaces))["psd_noise_change"]
    assert two.sizes["uncertain_noise"] == 2
    assert float(np.sqrt((two**2).sum("uncertain_noise")).median()) == pytest.approx(-expected / np.sqrt(2), rel=0.1)


def test_noise_changes_a_joined_spectrum_where_its_scan_measures() -> None:
    coarse, fine = (
        estimate(
            samples.surface(heights(MODEL.areal, (128, 128), (pitch, pitch), seed), (pitch, pitch)),
            noise=NoiseFloor(noise, noise / 5, "given"),
        )
        for seed, pitch, noise in ((1, 1.0, 0.004), (2, 0.2, 0.001))
    )
    joined = join(coarse, fine)
    of_coarse, of_fine = joined["psd_noise_change"].values
    low = joined["frequency"].values < float(fine["band_low"])
    high = joined["frequency"].values > float(coarse["band_high"]) * 1.2
    # Interpolation between the rings changes it by some per cent.
    np.testing.assert_allclose(of_coarse[low], -2 * 0.004**2 / 5 * 1.0, rtol=0.2)
    np.testing.assert_allclose(of_fine[high], -2 * 0.001**2 / 5 * 0.04, rtol=0.2)
    assert not of_coarse[high].any()
    assert not of_fine[low].any()


def test_scans_that_disagree_are_reported(microscope_and_interferometer) -> None:
    coarse, _ = microscope_and_interferometer
    (warning,) = vocabulary.warnings(join(coarse, scan(256, 0.2, 2, factor=2.0)))
    assert "scans 1 and 2 differ by a factor of" in warning
    # Heights twice as large: four times the spectrum.
    assert float(warning.split("factor of ")[1].split()[0]) == pytest.approx(4, rel=0.15)
    assert "scan 2 being the rougher" in warning


def test_a_gap_between_bands_is_reported() -> None:
    joined = join(scan(128, 8.0, 1), scan(128, 0.05, 2))
    assert any("leave a gap" in text for text in vocabulary.warnings(joined))
    inside = (joined["frequency"] > 0.07) & (joined["frequency"] < 0.3)
    assert not inside.any()


def test_one_spectrum_alone_is_unchanged(microscope_and_interferometer) -> None:
    assert join(microscope_and_interferometer[0]) is microscope_and_interferometer[0]


def test_an_assumed_spectrum_cannot_be_joined(microscope_and_interferometer) -> None:
    with pytest.raises(PsdError, match="must be measured"):
        join(microscope_and_interferometer[0], analytic("gaussian", sigma=0.1, length=5.0))
    with pytest.raises(PsdError, match="at least one"):
        join()
