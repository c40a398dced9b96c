"""The uncertainty of the gloss of diffraction on a map, against the scatter between maps of one surface."""

from __future__ import annotations

import numpy as np
import pytest
import random_surfaces
import samples
import xarray as xr

from brdfpipe.bsdf import kirchhoff
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.reference_solution import WAVELENGTH
from brdfpipe.comparison.diffracted_gloss import diffracted_gloss, gloss_scatter
from brdfpipe.optics.fresnel_equations import fresnel


def diffraction(parts: list[tuple[float, float]], seed: int, size: int = 256, pitch: float = 0.5) -> xr.Dataset:
    """Diffraction on a map of Gaussian heights, the sum of parts of an rms height and a correlation length [um]."""

    def spectrum(frequency: np.ndarray) -> np.ndarray:
        return sum(random_surfaces.gaussian(*part)(frequency) for part in parts)

    height = random_surfaces.heights(spectrum, (size, size), (pitch, pitch), seed)
    surface = samples.surface(height, (pitch, pitch))
    return nonspectral(kirchhoff.build(surface, index=1.5, wavelength=[WAVELENGTH]))


def test_light_that_smooth_maps_scatter_past_the_receptor_scatters_as_their_mean_square_height():
    # All that is scattered misses the receptor: G is 100 F (1 − q² σ²), and the mean square height of a map of side L has
    # the standard deviation σ² √π ℓ/L.
    sigma, length, side = 0.003, 1.0, 64.0
    reference = diffraction([(sigma, length)], 1, 256, side / 256)
    for angle in (20.0, 60.0):
        cosine = np.cos(np.radians(angle))
        phase = 4e3 * np.pi * cosine / WAVELENGTH * sigma
        mirror = 100 * fresnel(cosine, 1.5).mean / fresnel(cosine, 1.567).mean
        # The receptor at 60 degree sees a tenth of the light that is scattered.
        expected = mirror * phase**2 * np.sqrt(np.pi) * length / side
        assert gloss_scatter(reference, side**2, angle) == pytest.approx(expected, rel=0.15)
        value, u = diffracted_gloss(reference, side**2, angle)
        assert value == pytest.approx(mirror * (1 - phase**2), rel=1e-3)
        # The rings hold the scattered light alone.
        assert u < 2 * expected


@pytest.mark.slow
@pytest.mark.parametrize(
    "parts",
    [[(0.1, 20.0), (0.02, 1.0)], [(0.05, 5.0)], [(0.013, 5.0)]],
    ids=["waves with fine roughness", "50 nm", "13 nm"],
)
def test_maps_scatter_in_gloss_as_each_states(parts):
    references = [diffraction(parts, seed) for seed in range(300, 324)]
    found = np.array([[diffracted_gloss(one, 128.0**2, angle) for angle in (20.0, 60.0, 85.0)] for one in references])
    ratio = np.sqrt(np.mean(found[..., 1] ** 2, axis=0)) / found[..., 0].std(axis=0, ddof=1)
    # That is, z is 0.5 to 1.5. The scatter of 24 maps is known to 1/√46.
    sampling = 1 / np.sqrt(46)
    assert (ratio > (1 - sampling) / 1.5).all()
    assert (ratio < (1 + sampling) / 0.5).all()
