"""Spectra that depend linearly on colours: exact colours, constant greys, never negative, about as smooth as can be."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import nnls

from brdfpipe.spectra.colorimetry import GRID, delta_e_00, reflectance_to_xyz, weights, xyz_to_lab
from brdfpipe.spectra.linear_recovery import amounts, spectra_of_primaries

RED, GREEN, BLUE = np.eye(3)


def xyz_of(rgb: np.ndarray) -> np.ndarray:
    """Of the primaries of IEC 61966-2-1, rounded there to four digits."""
    return rgb @ np.array([[0.4124, 0.2126, 0.0193], [0.3576, 0.7152, 0.1192], [0.1805, 0.0722, 0.9505]])


@pytest.mark.parametrize("rgb", [RED, GREEN, BLUE, [0.2, 0.5, 0.9], [0.05, 0.01, 0.0]])
def test_the_spectrum_has_its_colour_under_d65(rgb: np.ndarray) -> None:
    rgb = np.asarray(rgb, dtype=float)
    found = reflectance_to_xyz(GRID, spectra_of_primaries() @ rgb, "D65", 2) / 100
    assert found == pytest.approx(xyz_of(rgb), abs=3e-4)  # the rounding of the standard's matrix
    assert amounts(found) == pytest.approx(rgb, abs=1e-7)


def test_the_spectra_of_every_colour_of_a_screen_are_reflectances_and_a_grey_is_constant() -> None:
    spectra = spectra_of_primaries()
    assert spectra.min() >= 0
    assert spectra.sum(axis=1) == pytest.approx(np.ones(GRID.size), abs=1e-9)
    assert spectra @ amounts(0.4 * weights("D65", 2).white / 100) == pytest.approx(np.full(GRID.size, 0.4), abs=1e-7)


def test_a_colour_outside_srgb_keeps_its_luminance_and_has_no_negative_amount() -> None:
    monochromatic = weights("D65", 2).weights[[20, 30, 40]] / 100
    found = amounts(monochromatic)
    assert found.min() == 0
    spectra = found @ spectra_of_primaries().T
    assert reflectance_to_xyz(GRID, spectra, "D65", 2)[:, 1] / 100 == pytest.approx(monochromatic[:, 1], rel=1e-6)
    assert (amounts(np.array([0.1, 0.0, 0.1])) == 0).all()


def test_no_other_primaries_that_meet_the_conditions_are_smoother() -> None:
    """The problem is convex: nearer to any others that meet the conditions the slopes only grow."""
    spectra, generator = spectra_of_primaries(), np.random.default_rng(1)
    weighting, count = weights("D65", 2).weights / 100, GRID.size
    conditions = 1e4 * np.vstack([np.kron(np.eye(3), weighting.T), np.kron(np.ones((1, 3)), np.eye(count))])
    least = np.square(np.diff(spectra, axis=0)).sum()
    for _ in range(3):
        target = np.clip(spectra + generator.normal(scale=0.2, size=spectra.shape), 0, 1).T.ravel()
        found, _ = nnls(
            np.vstack([np.eye(3 * count), conditions]), np.concatenate([target, conditions @ spectra.T.ravel()])
        )
        other = found.reshape(3, count).T
        assert other.T @ weighting == pytest.approx(spectra.T @ weighting, abs=1e-6)
        for share in (1e-3, 1.0):
            assert np.square(np.diff(spectra + share * (other - spectra), axis=0)).sum() > least


@pytest.mark.parametrize(("place", "width"), [(580, 30), (590, 25), (520, 60)])
def test_colours_under_the_other_observer_are_those_of_a_natural_spectrum(place: float, width: float) -> None:
    """A smooth spectrum is recovered well enough that its colour for the other observer is within 1.5 units of ΔE00."""
    natural = 0.1 + 0.6 / (1 + np.exp(-(GRID - place) / width))
    recovered = spectra_of_primaries() @ amounts(reflectance_to_xyz(GRID, natural, "D65", 2) / 100)
    labs = [
        xyz_to_lab(reflectance_to_xyz(GRID, one, "D65", 10), weights("D65", 10).white) for one in (natural, recovered)
    ]
    assert float(delta_e_00(*labs)) < 1.5
