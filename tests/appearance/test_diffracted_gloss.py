"""The uncertainty of the gloss of diffraction on a map, against the scatter between maps of one surface."""

from __future__ import annotations

import numpy as np
import pytest
import random_surfaces
import samples
import xarray as xr

from brdfpipe.appearance import compute_appearance, gloss, gloss_with_uncertainty
from brdfpipe.appearance.apertures import SOURCE
from brdfpipe.appearance.diffracted_gloss import diffracted_gloss_u, gloss_scatter
from brdfpipe.appearance.gloss_basis import gloss_uncertainty_from_bsdf
from brdfpipe.appearance.gloss_meter import RECEPTOR
from brdfpipe.bsdf import kirchhoff
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.reference_solution import WAVELENGTH
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
        assert gloss_scatter(reference, angle) == pytest.approx(expected, rel=0.15)
        value = float(gloss(reference, [angle])[0])
        assert value == pytest.approx(mirror * (1 - phase**2), rel=1e-3)
        # The rings hold the scattered light alone.
        assert diffracted_gloss_u(reference, angle, value) < 2 * expected


def seen(frequency: np.ndarray, angle: float) -> np.ndarray:
    """Share of the source image whose light a receptor sees, of light that a mode diffracts: (2, modes) [um-1] to (modes,)."""
    (window_u, window_v), half = (np.radians(width) / 2 for width in RECEPTOR[angle]), np.radians(SOURCE) / 2
    u, v = ((np.arange(24) + 0.5) / 12 - 1) * half[:, None]
    sin_i, sin_across = (part.ravel() for part in np.meshgrid(np.sin(np.radians(angle) + u), np.sin(v)))
    sin_o, across = (
        at[:, None] + WAVELENGTH * 1e-3 * one for at, one in zip((sin_i, sin_across), frequency, strict=True)
    )
    along = np.arcsin(np.clip(sin_o, -1, 1)) - np.radians(angle)
    return ((np.abs(along) < window_u) & (np.abs(across) < window_v)).mean(axis=0)


@pytest.mark.parametrize("angle", [20.0, 60.0])
def test_gloss_of_maps_whose_modes_the_receptor_sees_in_part_scatters_by_their_speckle(angle):
    # Low heights diffract q² |H(f)|² into each mode: gloss is 100 F (1 − Σ q² |H|² (1 − w)), of each map exactly.
    sigma, length, size, maps = 0.003, 5.0, 64, 300
    part, cosine = random_surfaces.gaussian(sigma, length), np.cos(np.radians(angle))
    frequency = np.fft.fftfreq(size)
    w = seen(np.stack(np.meshgrid(frequency, frequency)).reshape(2, -1), angle)
    missed = (4e3 * np.pi * cosine / WAVELENGTH) ** 2 * (1 - w)
    lost = []
    for seed in range(maps):
        height = random_surfaces.heights(part, (size, size), (1.0, 1.0), seed)
        power = np.abs(np.fft.fft2(height - height.mean()).ravel()) ** 2 / size**4
        lost.append(missed @ power)
    mirror = 100 * fresnel(cosine, 1.5).mean / fresnel(cosine, 1.567).mean
    # A map of four times the area scatters half as much. 300 maps know the scatter to 4 %, and one map its own spectrum to about 5 %; a factor 2 in
    # the variance would be 41 %.
    stated = 2 * gloss_scatter(diffraction([(sigma, length)], 1), angle)
    assert stated == pytest.approx(mirror * np.std(lost, ddof=1), rel=0.15)


def test_maps_scatter_in_gloss_and_beside_the_mirror_direction_as_they_state():
    references = [diffraction([(0.03, 5.0)], seed, 128) for seed in range(24)]
    values = [gloss(one, [60]) for one in references]
    stated = [gloss_uncertainty_from_bsdf(one, value) for one, value in zip(references, values, strict=True)]
    ratio = np.sqrt(np.mean(np.square(stated), axis=0)) / np.std(values, axis=0, ddof=1)
    # Within a factor 2; the scatter of 24 maps is known to 1/√46.
    assert ((ratio > 0.5) & (ratio < 2)).all()
    # In the mirror direction the light is that of one speckle, which scatters by all of its mean.
    at = 30.0, 0.0, np.array([30.0, 30.2, 31.0]), 180.0
    brdf = np.array([one.bsdf.evaluate(*at) for one in references])
    u = [one.bsdf.uncertainty(*at) for one in references]
    ratio = np.sqrt(np.mean(np.square(u), axis=0)) / brdf.std(axis=0, ddof=1)
    assert brdf.std(axis=0)[0] > 0.3 * brdf.mean(axis=0)[0]
    assert ((ratio > 0.5) & (ratio < 2)).all()


def test_the_uncertainty_of_gloss_is_that_of_the_light_in_the_receptor_and_not_of_one_direction():
    # 30 nm: two thirds of the light at 20 degree are coherent, and a speckle in the mirror direction may be twice as bright.
    surface = samples.surface(
        random_surfaces.heights(random_surfaces.gaussian(0.03, 5.0), (128, 128), (0.5, 0.5), 1), (0.5, 0.5)
    )
    appearance = compute_appearance(
        kirchhoff.build(surface, index=1.5, wavelength=[500.0, 550.0, 600.0]), parts=["gloss"], gloss_angles=[20]
    )
    tolerances = gloss_with_uncertainty(one := diffraction([(0.03, 5.0)], 1, 128), [20])[1]
    of_map = diffracted_gloss_u(one, 20.0, float(gloss(one, [20])[0]))
    # The mean over wavelength scatters as one wavelength does.
    assert float(appearance["gloss_u"][0]) == pytest.approx(np.hypot(float(tolerances[0]), of_map), rel=0.25)


@pytest.mark.slow
@pytest.mark.parametrize(
    "parts",
    [[(0.1, 20.0), (0.02, 1.0)], [(0.05, 5.0)], [(0.013, 5.0)]],
    ids=["waves with fine roughness", "50 nm", "13 nm"],
)
def test_maps_scatter_in_gloss_as_each_states(parts):
    references = [diffraction(parts, seed) for seed in range(300, 324)]
    values = [gloss(one, [20, 60, 85]) for one in references]
    stated = [gloss_uncertainty_from_bsdf(one, value) for one, value in zip(references, values, strict=True)]
    ratio = np.sqrt(np.mean(np.square(stated), axis=0)) / np.std(values, axis=0, ddof=1)
    # That is, z is 0.5 to 1.5. The scatter of 24 maps is known to 1/√46.
    sampling = 1 / np.sqrt(46)
    assert (ratio > (1 - sampling) / 1.5).all()
    assert (ratio < (1 + sampling) / 0.5).all()
