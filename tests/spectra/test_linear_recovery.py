"""Spectra that depend linearly on colours: exact colours, constant greys, slopes no larger than those of other spectra of the colour."""

from __future__ import annotations

import numpy as np
import pytest

from brdfpipe.spectra.colorimetry import GRID, delta_e_00, reflectance_to_xyz, weights, xyz_to_lab
from brdfpipe.spectra.linear_recovery import spectra_of_tristimulus

VIEWINGS = [("D65", 2), ("D65", 10), ("A", 2)]


@pytest.mark.parametrize(("illuminant", "observer"), VIEWINGS)
def test_the_spectrum_has_its_colour(illuminant: str, observer: int) -> None:
    xyz = np.array([[0.2, 0.3, 0.1], [0.5, 0.4, 0.6]])
    spectra = xyz @ spectra_of_tristimulus(illuminant, observer).T
    assert reflectance_to_xyz(GRID, spectra, illuminant, observer) / 100 == pytest.approx(xyz, rel=1e-9)


@pytest.mark.parametrize(("illuminant", "observer"), VIEWINGS)
def test_a_grey_is_constant(illuminant: str, observer: int) -> None:
    white = weights(illuminant, observer).white / 100
    assert spectra_of_tristimulus(illuminant, observer) @ (0.4 * white) == pytest.approx(np.full(GRID.size, 0.4))


def test_no_other_spectrum_of_the_colour_is_smoother() -> None:
    spectra = spectra_of_tristimulus()
    found = spectra @ [0.3, 0.25, 0.1]
    generator = np.random.default_rng(1)
    metameric_black = generator.normal(size=(20, GRID.size)) * 0.01
    metameric_black -= metameric_black @ weights("D65", 2).weights / 100 @ spectra.T
    slopes = np.square(np.diff(found + metameric_black, axis=-1)).sum(axis=-1)
    assert (slopes >= np.square(np.diff(found)).sum()).all()


def test_colours_under_the_other_observer_are_those_of_a_natural_spectrum() -> None:
    """A smooth spectrum is recovered well enough that its colour for the other observer is within one unit of ΔE00."""
    natural = 0.1 + 0.6 / (1 + np.exp(-(GRID - 580) / 30))
    xyz = reflectance_to_xyz(GRID, natural, "D65", 2) / 100
    labs = [
        xyz_to_lab(reflectance_to_xyz(GRID, one, "D65", 10), weights("D65", 10).white)
        for one in (natural, spectra_of_tristimulus() @ xyz)
    ]
    assert float(delta_e_00(*labs)) < 1.0
