"""Surfaces with waves longer than the band of their spectrum: two scales, a lens, a curved part, a hole in the scan.

The reference is Kirchhoff's integral on the whole map, |FFT exp(iqh)|² without windows or patches, in the apertures of the gloss meter.
"""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
import random_surfaces
import relief_maps
import samples
import xarray as xr

from brdfpipe import appearance, facets, psd
from brdfpipe.appearance import apertures
from brdfpipe.appearance.gloss_meter import gloss_at
from brdfpipe.bsdf import kirchhoff, microfacet, wave
from brdfpipe.bsdf.slab.wave_face import WaveSurface
from brdfpipe.bsdf.wave import builder, height_transform
from brdfpipe.geometry import Array
from brdfpipe.optics.fresnel_equations import fresnel
from brdfpipe.optics.index import refractive_index
from brdfpipe.surfaces.levelling import level

POLISHED = {20.0: 82.05, 60.0: 89.14, 85.0: 98.97}
"""Gloss of a smooth surface of index 1.5."""
RECEPTOR = {20.0: (1.8, 3.6), 60.0: (4.4, 11.7), 85.0: (4.0, 6.0)}
SOURCE = (0.75, 2.5)
ANGLES = list(POLISHED)
LIGHT = np.arange(400.0, 701.0, 50.0)


def waviness(sigma: float, length: float, fine: float, fine_length: float, seed: int) -> xr.Dataset:
    coarse, rough = (
        random_surfaces.heights(random_surfaces.gaussian(*one), (256, 256), (0.5, 0.5), number)
        for one, number in (((sigma, length), seed), ((fine, fine_length), seed + 100))
    )
    return samples.surface(coarse + rough, (0.5, 0.5))


def lens() -> xr.Dataset:
    x = np.arange(128) * 2.0
    rough = random_surfaces.heights(random_surfaces.gaussian(0.002, 8.0), (128, 128), (2.0, 2.0), 1)
    return level(samples.surface(0.1 * np.cos(x / 40)[:, None] * np.cos(x / 37) + rough, (2.0, 2.0)))


def curved_part() -> xr.Dataset:
    x = (np.arange(128) - 63.5) * 2.0
    rough = random_surfaces.heights(random_surfaces.gaussian(0.02, 8.0), (128, 128), (2.0, 2.0), 1)
    return level(samples.surface((x[:, None] ** 2 + x**2) / 2 / 5000.0 + rough, (2.0, 2.0)))


def kirchhoff_gloss(surface: xr.Dataset) -> Array:
    """Gloss at 550 nm; the map is continued by its mirror image, which has no steps at its edges, and seen along both axes."""
    height, pitch = surface["height"].values.astype(float), float(surface.attrs["pitch_x"])
    height = np.block([[height, height[:, ::-1]], [height[::-1], height[::-1, ::-1]]])
    frequency = np.fft.fftfreq(height.shape[0], pitch)
    result = []
    for angle, polished in POLISHED.items():
        phase = 4 * np.pi * np.cos(np.radians(angle)) / 0.55
        light = np.abs(np.fft.fft2(np.exp(1j * phase * height))) ** 2 / height.size**2
        sine = np.sin(np.radians(angle)) + 0.55 * frequency
        along = np.degrees(np.arcsin(np.clip(sine, -1, 1))) - angle
        seen = [
            np.where(np.abs(sine) < 1, overlap(along, RECEPTOR[angle][0], SOURCE[0]), 0.0),
            overlap(np.degrees(0.55 * frequency), RECEPTOR[angle][1], SOURCE[1]),
        ]
        result.append(polished * (seen[0] @ light @ seen[1] + seen[1] @ light @ seen[0]) / 2)
    return np.array(result)


def overlap(offset: Array, receptor: float, source: float) -> Array:
    """Share of a source image that a receptor sees, displaced by an offset; full widths [degree]."""
    low, high = np.maximum(offset - source / 2, -receptor / 2), np.minimum(offset + source / 2, receptor / 2)
    return np.clip(high - low, 0.0, source) / source


def predicted(surface: xr.Dataset, optics: str = "auto") -> xr.Dataset:
    return wave.build(
        psd.estimate(surface), index=1.5, wavelength=550.0, facets=facets.estimate([surface]), optics=optics
    )


@pytest.mark.parametrize(
    ("make", "optics", "tolerance"),
    [
        (lens, "auto", 0.01),
        (lens, "wave", 0.01),
        pytest.param(lens, "composite", 0.01, marks=pytest.mark.slow),
        (curved_part, "auto", 0.1),
        # The map has six waves along a side.
        (partial(waviness, 0.1, 20.0, 0.02, 1.0, 1), "auto", 0.05),
    ],
    ids=["lens", "lens, wave", "lens, composite", "curved part", "two scales"],
)
def test_gloss_is_that_of_diffraction_on_the_whole_map(make, optics, tolerance):
    surface = make()
    bsdf = predicted(surface, optics)
    assert float(bsdf["energy_residual"]) < 1e-3
    assert appearance.gloss(bsdf, ANGLES).values == pytest.approx(kirchhoff_gloss(surface), rel=tolerance)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 3])
def test_gloss_of_two_scales_is_that_of_diffraction_on_other_maps(seed):
    surface = waviness(0.1, 20.0, 0.02, 1.0, seed)
    found = appearance.gloss(predicted(surface), ANGLES).values
    assert found == pytest.approx(kirchhoff_gloss(surface), rel=0.05)


def test_the_reference_solution_does_not_blur_waves_as_long_as_the_map():
    surface = lens()
    reference = kirchhoff.build(surface, index=1.5, wavelength=[550.0])
    assert appearance.gloss(reference, ANGLES).values == pytest.approx(kirchhoff_gloss(surface), rel=0.005)
    light = reference["directional_albedo"].sel(theta_i=[0, 60]).values
    assert light == pytest.approx(fresnel(np.cos(np.radians([0, 60])), 1.5).mean, rel=0.01)


@pytest.mark.parametrize("hole", ["block", "steep places"])
def test_missing_heights_take_no_light(hole):
    whole = relief_maps.gaussian(0.2, 128, 5)
    reference = microfacet.build(facets.estimate([samples.surface(whole)]), index=1.5, multiple_scattering="none")
    height = whole.copy()
    slope = np.hypot(*np.gradient(whole))
    height[slope > np.quantile(slope, 0.9)] = np.nan
    if hole == "block":
        height = whole.copy()
        height[50:100, 25:90] = np.nan
    bsdf = predicted(samples.surface(height))
    assert float(bsdf.get("energy_residual", 0.0)) < 1e-3
    # Without its steep places the map itself is smoother.
    expected, tolerance = appearance.gloss(reference, ANGLES).values, 0.3
    assert appearance.gloss(bsdf, ANGLES).values == pytest.approx(expected, rel=tolerance)


def test_a_face_of_a_sheet_scatters_long_waves_near_the_straight_direction():
    surface = lens()
    face = WaveSurface.of(
        facets.estimate([surface]), psd.estimate(surface), refractive_index(1.5), np.array([550.0]), "wave"
    )
    sine = np.geomspace(1e-5, 1.0, 4001)
    halo = face.transform(np.full_like(sine, 2.0), sine, 550.0) * sine**2
    inside = np.trapezoid(np.where(sine < np.sin(np.radians(1.0)), halo, 0.0), np.log(sine))
    # Its slopes of at most 0.0025 deflect light by 0.3 degree.
    assert inside / np.trapezoid(halo, np.log(sine)) > 0.95


def wavy_line() -> xr.Dataset:
    """A profile of an eroded mould: roughness 6 um long upon waves ten times as long, which the band of its spectrum cuts."""
    random, frequency = np.random.default_rng(3), np.fft.rfftfreq(4096, 0.5)
    rough, wavy = (
        np.fft.irfft(np.fft.rfft(random.standard_normal(4096)) * np.exp(-((np.pi * length * frequency) ** 2) / 2))
        for length in (6.0, 60.0)
    )
    return samples.surface(0.33 * rough / rough.std() + 0.6 * wavy / wavy.std(), (0.5, 0.5))


def test_finer_tables_and_quadratures_do_not_change_the_gloss_of_a_line(monkeypatch):
    surface = wavy_line()
    roughness, slopes = psd.estimate(surface), facets.estimate(surface, isotropic=True)
    assert float(roughness["long_sigma"]) > 0.3

    def built() -> xr.Dataset:
        return wave.build(roughness, index=1.5, wavelength=LIGHT, facets=slopes, optics="auto", states_cut_error=False)

    bsdf = built()
    found = appearance.gloss(bsdf, ANGLES).values
    sample = apertures.sample_of(bsdf, None)._replace(lobe=0.005)
    finer = [float(gloss_at(sample, angle, np.zeros(1), apertures.Rule((8, 12), 10))[0]) for angle in ANGLES]
    assert found == pytest.approx(finer, abs=0.01)
    monkeypatch.setattr(height_transform, "FREQUENCY_STEP", height_transform.FREQUENCY_STEP / 4)
    more = builder.ENERGY_NODES._replace(turns=2 * builder.ENERGY_NODES.turns)
    monkeypatch.setattr(builder, "ENERGY_NODES", more)
    assert found == pytest.approx(appearance.gloss(built(), ANGLES).values, abs=0.02)
