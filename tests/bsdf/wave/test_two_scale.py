"""Facets with finer roughness, and the passage from waves to facets."""

from __future__ import annotations

import itertools
import json
from collections.abc import Sequence
from functools import cache

import numpy as np
import pytest
import relief_maps
import samples
import xarray as xr
from mirror_halo import halo_of_mirrors
from scipy.integrate import quad
from scipy.special import ive

from brdfpipe import appearance, hemisphere, psd, vocabulary
from brdfpipe.bsdf import kirchhoff, microfacet, wave
from brdfpipe.bsdf.microfacet.microsurface import ModelError
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.wave import two_scale
from brdfpipe.bsdf.wave.two_scale import RoughSurface, characteristic_function, facet_share, passage_phase
from brdfpipe.comparison.model_error import model_error
from brdfpipe.facets import analytic, estimate, flat
from brdfpipe.facets.radial_density import RadialDensity


@cache
def rough(sigma: float, length: float = 5.0, optics: str = "auto", **options) -> xr.Dataset:
    """A Gaussian surface of index 1.5 at 550 nm."""
    return wave.build(
        psd.analytic("gaussian", sigma=sigma, length=length),
        facets=analytic("beckmann", a=2 * sigma / length),
        index=1.5,
        wavelength=550.0,
        optics=optics,
        **options,
    )


def composite() -> xr.Dataset:
    """Roughness of which the longer part is facets, and the shorter one waves upon them."""
    return rough(0.4, 10.0, "composite")


def facets_alone(sigma: float, length: float = 5.0) -> xr.Dataset:
    return microfacet.build(analytic("beckmann", a=2 * sigma / length), index=1.5)


def gloss(bsdf: xr.Dataset) -> np.ndarray:
    return np.asarray(appearance.gloss(bsdf, [20, 60]).values)


def mirror_share(bsdf: xr.Dataset, theta: Sequence[float]) -> np.ndarray:
    """Coherent light over what a smooth surface reflects."""
    smooth = microfacet.build(flat(), index=1.5)
    return np.array([float(bsdf.bsdf.specular(t)[0].squeeze() / smooth.bsdf.specular(t)[0].squeeze()) for t in theta])


def unscattered_share(sigma: float, length: float, theta: float) -> float:
    """Light that the first order of a perfect mirror leaves: e^(−g₁), g₁ = ∫ (16π²/λ⁴) cos θ_i cos²θ_o S dω over what propagates.

    S is the Gaussian spectrum; its integral over azimuth is a Bessel function.
    """
    sine, cosine, width = np.sin(np.radians(theta)), np.cos(np.radians(theta)), (np.pi * length / 0.55) ** 2

    def of_ring(u: float) -> float:
        return 2 * np.pi * u * np.sqrt(1 - u**2) * np.exp(-width * (u - sine) ** 2) * ive(0, 2 * width * u * sine)

    # The lobe beyond 8 widths holds 1e-28 of the light.
    low, high = max(0.0, sine - 8 / np.sqrt(width)), min(1.0, sine + 8 / np.sqrt(width))
    integral = quad(of_ring, low, high, points=[sine], limit=200, epsrel=1e-8)[0]
    return float(np.exp(-16 * np.pi**2 / 0.55**4 * cosine * np.pi * (length * sigma) ** 2 * integral))


def test_the_characteristic_function_of_gaussian_slopes_is_a_gaussian():
    t = np.geomspace(1e-3, 200, 60)
    found = characteristic_function(RadialDensity.of(analytic("beckmann", a=0.1)))(t)
    # The table of the density ends at a few rms slopes.
    assert found == pytest.approx(np.exp(-((0.1 * t) ** 2) / 4), abs=5e-6)


def test_the_share_of_facets_rises_from_none_to_all_with_phase_and_slope():
    phase = np.geomspace(1e-3, 1e4, 200)
    shares = [facet_share(phase, slope) for slope in (0.0, 0.1, 0.25, 0.3, 0.5)]
    assert shares[0][0] == 0
    assert shares[0][-1] == 1
    assert (np.diff(shares[0]) >= 0).all()
    for less, more in itertools.pairwise(shares):
        assert (more >= less).all()
    # Steep surfaces reflect as waves too where phases are small.
    assert (shares[-1][phase > 10] == 1).all()
    assert (shares[-1][phase < 1] == 0).all()


def test_a_surface_whose_slopes_are_not_normal_is_one_of_facets_earlier():
    phases = [passage_phase(normality) for normality in (1.0, 1.02, 0.9, 1.3, 3.0)]
    assert phases == pytest.approx([600**0.5, 600**0.5, 10.0, 4.0, 4.0])
    assert facet_share(np.array([10.0]), 0.1, 4.0)[0] == 1
    assert facet_share(np.array([10.0]), 0.1)[0] == 0


@pytest.mark.parametrize("sigma", [0.002, 0.02, 0.12, 0.2])
def test_auto_is_waves_on_a_smooth_surface(sigma):
    # Its coherent light loses what the halo of first order scatters, 1 % less than g at 60 degree.
    assert gloss(rough(sigma)) == pytest.approx(gloss(rough(sigma, optics="wave")), abs=0.32)


@pytest.mark.parametrize("optics", ["auto", "composite"])
def test_a_rough_surface_of_low_slopes_reflects_as_its_facets(optics):
    bsdf, expected = rough(1.0, 20.0, optics), facets_alone(1.0, 20.0)
    # Phase variances of 130 at 60 and 460 at 20 degree: the next order of geometrical optics is 1/g.
    assert gloss(bsdf) == pytest.approx(gloss(expected), rel=0.01)
    assert representation(bsdf).specular(np.array([20.0]), np.zeros(1), None)[0][0, 0] < 1e-12
    theta = np.array([0.0, 30.0, 60.0])
    assert bsdf.bsdf.albedo(theta).values[:, 0] == pytest.approx(expected.bsdf.albedo(theta).values, rel=0.01)


@pytest.mark.parametrize(
    ("sigma", "length", "error"),
    [
        (1.0, 20.0, 0.002),
        pytest.param(0.12, 5.0, 1e-4, marks=pytest.mark.slow),
        pytest.param(0.3, 3.0, 0.0005, marks=pytest.mark.slow),
        pytest.param(3.0, 60.0, 0.004, marks=pytest.mark.slow),
    ],
)
def test_the_albedo_is_the_integral_of_the_brdf_up_to_grazing(sigma, length, error):
    model, nm = representation(rough(sigma, length)), np.array([550.0])
    for theta in (60.0, 80.0, 83.5, 85.7, 87.0, 88.2, 89.0, 89.3, 89.7, 89.86, 89.97):
        at = np.array([theta]), np.zeros(1), nm
        rule = hemisphere.around_mirror(theta, model.lobe_slope, order=16, turns=48)
        angles = np.full_like(rule.theta, theta), np.zeros_like(rule.theta), rule.theta, rule.phi
        returned = rule.weight @ model.evaluate(*angles, nm) + model.specular(*at)[0]
        # What docs/limits.md states.
        assert model.albedo(*at) == pytest.approx(returned, abs=error if theta < 89.9 else 3 * error)


@pytest.mark.parametrize(
    ("sigma", "length"),
    [(0.12, 5.0), *(pytest.param(*each, marks=pytest.mark.slow) for each in ((0.01, 0.2), (0.1, 2.0)))],
)
def test_the_coherent_light_of_auto_is_what_the_first_order_leaves(sigma, length):
    theta = (20.0, 60.0, 85.0, 88.0)
    expected = [unscattered_share(sigma, length, t) for t in theta]
    assert mirror_share(rough(sigma, length), theta) == pytest.approx(expected, abs=1e-3)


def heights(steps: int, slope: float | None) -> list[tuple[float, float]]:
    """Rms heights from 1 nm to 2 um, and correlation lengths: of 5 um, or of a fixed slope [um]."""
    return [(s, 5.0 if slope is None else 2 * s / slope) for s in np.geomspace(0.001, 2.0, steps).tolist()]


@pytest.mark.parametrize(
    ("slope", "steps"),
    [(None, 4), *(pytest.param(slope, 61, marks=pytest.mark.slow) for slope in (None, 0.1))],
)
def test_gloss_has_no_jump_from_1_nm_to_2_um(slope, steps):
    surfaces = heights(steps, slope)
    waves, auto = (np.array([gloss(rough(*each, optics)) for each in surfaces]) for optics in ("wave", "auto"))
    facets = np.array([gloss(facets_alone(*each)) for each in surfaces])
    # Roughness finer than the wavelength scatters no light, which the coherent light of `wave`, e^(−g), misses all the same.
    smooth, of_first_order = gloss(microfacet.build(flat(), index=1.5)), []
    for each, of_waves in zip(surfaces, waves, strict=True):
        share = np.array([unscattered_share(*each, theta) for theta in (20.0, 60.0)])
        of_first_order.append(of_waves + (share - mirror_share(rough(*each, "wave"), (20.0, 60.0))) * smooth)
    # Between both models wherever they differ, and therefore as smooth as they are.
    assert (auto > 0.93 * np.minimum(waves, facets)).all()
    assert (auto < 1.02 * np.maximum(of_first_order, facets)).all()
    assert (np.diff(auto, axis=0) < 0.01).all()


@pytest.mark.slow
@pytest.mark.parametrize("slope", [None, 0.1])
def test_gloss_and_peak_are_smooth_functions_of_the_height(slope):
    surfaces, found = heights(61, slope), []
    step = np.log(surfaces[1][0] / surfaces[0][0])
    for each in surfaces:
        bsdf = rough(*each)
        peak = float(bsdf.bsdf.evaluate(60.0, 0.0, 60.0, 180.0).squeeze())
        found.append([*appearance.gloss(bsdf, [20, 60, 85]).values, 10 * np.log10(peak)])
    # A second difference of 300 h² is a curvature; a jump would not fall with the step.
    assert np.abs(np.diff(found, 2, axis=0)).max() < 300 * step**2


@pytest.mark.slow
def test_two_scales_agree_with_diffraction_on_their_maps():
    # 1 um over 20 um and 30 nm over 1 um: facets of all slopes give 13.1 units at 60 degree, diffraction 15.4.
    ratios = []
    for seed in (3, 5, 7, 9):
        coarse, fine = _gaussian_map(1.0, 20.0, 0.25, 1024, seed), _gaussian_map(0.03, 1.0, 0.25, 1024, seed + 1)
        surface = vocabulary.label(coarse.assign(height=coarse["height"] + fine["height"]), "surface")
        bsdf = wave.build(psd.estimate(surface), facets=estimate(surface), index=1.5, wavelength=550.0, optics="auto")
        assert "log_fine_halo" in bsdf
        ratios.append(gloss(bsdf) / gloss(kirchhoff.build(surface, index=1.5, wavelength=550.0)))
    # Few modes of a map of 13 coarse correlation lengths reach the receptor: they scatter by 10 and 4 %.
    noise = np.std(ratios, axis=0, ddof=1) / np.sqrt(len(ratios))
    assert (np.abs(np.mean(ratios, axis=0) - 1) < 0.03 + 2 * noise).all()
    assert (noise < [0.08, 0.03]).all()


def test_the_surface_alone_is_enough_for_the_facets():
    surface = {"facets": analytic("beckmann", a=0.1), "index": 1.5, "spectrum": samples.spectrum(0.4)}
    complete, alone = microfacet.build(**surface), microfacet.build(**surface, surface_alone=True)
    assert "directional_albedo" not in alone
    representations = []
    for sigma, length in ((0.2, 5.0), (0.5, 4.0), (30.0, 600.0)):
        spectrum = psd.analytic("gaussian", sigma=sigma, length=length)
        built = [wave.build(spectrum, **surface, predicted=one, optics="auto") for one in (complete, alone)]
        xr.testing.assert_identical(*built)
        representations.append(built[0].attrs["representation"])
    assert representations == ["wave", "wave", "microfacet"]


def test_many_values_are_those_of_few(monkeypatch):
    bsdf = composite()
    angles = np.array([20.0, 60.0, 85.0]), np.zeros(3), np.array([20.5, 95.0, 80.0]), np.array([180.0, 180.0, 175.0])
    few = representation(bsdf).evaluate(*angles, None)
    monkeypatch.setattr(two_scale, "MANY_HALO_VALUES", 1)
    np.testing.assert_allclose(representation(bsdf).evaluate(*angles, None), few, rtol=1e-10)


def test_the_stated_error_of_the_cut_covers_what_a_moved_cut_changes():
    bsdf = composite()
    theta, view = np.full(21, 45.0), np.linspace(38.0, 52.0, 21)
    at = 1 / (np.pi * 10.0) * np.sqrt(-2 * np.log(float(bsdf["fine_sigma"]) / 0.4))
    values = [
        rough(0.4, 10.0, "composite", cut=cut).bsdf.evaluate(theta, 0.0, view, 180.0).values.squeeze()
        for cut in (at, 1.5 * at)
    ]
    assert 0 < float(bsdf["cut_error"]) < 0.05
    assert np.abs(values[1] / values[0] - 1).max() < 1.5 * float(bsdf["cut_error"])


def test_a_bsdf_without_the_error_of_its_cut_is_otherwise_the_same():
    stated, bare = (rough(0.4, 10.0, "composite", states_cut_error=states) for states in (True, False))
    xr.testing.assert_identical(stated.drop_vars("cut_error"), bare)


def test_the_lobe_of_two_scales_does_not_depend_on_the_cut():
    # 0.4 um over 20 um carries 20 nm over 1 um: as two Gaussian surfaces, between whose frequencies any cut parts the same.
    theta = np.full(40, 30.0)
    view = np.linspace(10.0, 50.0, 40)
    values = [
        rough(0.4, 10.0, "composite", cut=cut).bsdf.evaluate(theta, 0.0, view, 180.0).values.squeeze()
        for cut in (0.08, 0.12, 0.2)
    ]
    lobe = values[-1] > 0.3 * values[-1].max()
    for other in values[:-1]:
        # The coarse part has a phase variance of 50: its next order is 1/g.
        assert other[lobe] == pytest.approx(values[-1][lobe], rel=0.03)


def test_fine_roughness_dims_the_lobe_and_spreads_its_light():
    coarse, fine = rough(1.0, 20.0, "composite"), 0.03
    together = _of_two_gaussians(1.0, 20.0, fine, 0.2)
    peaks = [float(bsdf.bsdf.evaluate(20.0, 0.0, 20.0, 180.0).squeeze()) for bsdf in (coarse, together)]
    phase = (4 * np.pi * fine * np.cos(np.radians(20)) / 0.55) ** 2
    # The wide halo of the fine roughness adds 2 % at the peak.
    assert peaks[1] / peaks[0] == pytest.approx(np.exp(-phase), rel=0.04)
    beside = [float(bsdf.bsdf.evaluate(20.0, 0.0, 65.0, 180.0).squeeze()) for bsdf in (coarse, together)]
    assert beside[1] > 100 * beside[0]


def _of_two_gaussians(sigma: float, length: float, fine_sigma: float, fine_length: float) -> xr.Dataset:
    """The composite of two independent Gaussian roughnesses, from the sum of their spectra."""
    spectrum = psd.analytic("gaussian", sigma=sigma, length=length)
    frequency = np.geomspace(1e-4, 4.0, 1200)
    total = sum(
        np.pi * (s * ell) ** 2 * np.exp(-((np.pi * ell * frequency) ** 2))
        for s, ell in ((sigma, length), (fine_sigma, fine_length))
    )
    measured = spectrum.drop_dims("frequency").assign_coords(frequency=frequency).assign(psd=("frequency", total))
    measured = measured.assign(
        psd_uncertainty=("frequency", 0 * total), band_low=1e-4, band_high=4.0, fit_length=fine_length
    )
    measured.attrs = spectrum.attrs | {"form": "measured"}
    for name, unit in (
        ("frequency", "um-1"),
        ("psd", "um4"),
        ("psd_uncertainty", "um4"),
        ("band_low", "um-1"),
        ("band_high", "um-1"),
    ):
        measured[name].attrs["units"] = unit
    measured["fit_length"].attrs["units"] = "um"
    slopes = analytic("beckmann", a=float(np.hypot(2 * sigma / length, 2 * fine_sigma / fine_length)))
    return wave.build(measured, facets=slopes, index=1.5, wavelength=550.0, optics="composite", cut=0.25)


@pytest.mark.parametrize("sigma", [0.05, 0.3])
def test_every_check_of_an_auto_bsdf_passes(sigma):
    checked = rough(sigma).bsdf.check()
    assert {verdict["verdict"] for verdict in json.loads(checked.attrs["verdicts"]).values()} == {"pass"}


def test_the_mueller_matrix_has_the_scalar_brdf():
    bsdf = rough(0.25)
    angles = np.array([20.0, 60.0]), np.zeros(2), np.array([25.0, 50.0]), np.array([170.0, 185.0])
    model = representation(bsdf)
    assert model.mueller(*angles, None)[..., 0, 0] == pytest.approx(model.evaluate(*angles, None), rel=1e-12)


def test_a_composite_of_smooth_relief_warns():
    assert any("facets need 20" in text for text in vocabulary.warnings(rough(0.05, optics="composite")))
    assert vocabulary.warnings(rough(1.0, 20.0, "composite")) == []


@pytest.mark.parametrize("facets", [None, flat()])
def test_facets_are_needed_where_the_surface_may_be_one_of_facets(facets):
    with pytest.raises(ModelError, match="facets of a rough surface"):
        wave.build(psd.analytic("gaussian", sigma=0.1, length=5.0), facets=facets, index=1.5, optics="auto")


@pytest.mark.slow
@pytest.mark.parametrize("sigma", [0.013, 0.05, 0.12, 0.4])
def test_waves_agree_with_diffraction_on_maps(sigma):
    # Kirchhoff's integral on three periodic Gaussian maps of 512 um, which know no roughness spectrum.
    maps = [_gaussian_map(sigma, 5.0, 0.5, 1024, seed) for seed in range(3)]
    on_maps = [kirchhoff.build(heights, index=1.5, wavelength=550.0) for heights in maps]
    bsdf = rough(sigma, optics="wave")
    # The mirror direction itself is within the first ring of frequencies of a finite map.
    view = np.array([12.0, 16.0, 18.0, 19.0, 21.0, 22.0, 24.0, 28.0, 35.0])
    expected = np.mean([each.bsdf.evaluate(20.0, 0.0, view, 180.0).values.squeeze() for each in on_maps], axis=0)
    assert bsdf.bsdf.evaluate(20.0, 0.0, view, 180.0).values.squeeze() == pytest.approx(expected, rel=0.09)
    glosses = np.array([gloss(each) for each in on_maps])
    # Three maps scatter; their mean is known to their spread over the root of three.
    spread = glosses.std(axis=0, ddof=1) / np.sqrt(3)
    assert (np.abs(gloss(bsdf) - glosses.mean(axis=0)) < 4 * spread + 0.1).all()


@pytest.mark.slow
def test_diffraction_on_a_map_tends_to_its_facets_as_the_wavelength_falls():
    view, ratios = np.linspace(14.0, 26.0, 13), {825.0: [], 412.0: []}
    for seed in range(5):
        surface = _gaussian_map(0.3, 6.0, 0.5, 512, seed)
        expected = (
            microfacet.build(estimate(surface), index=1.5, multiple_scattering="none")
            .bsdf.evaluate(20.0, 0.0, view, 180.0)
            .values.squeeze()
        )
        for wavelength, found in ratios.items():
            diffraction = kirchhoff.build(surface, index=1.5, wavelength=wavelength)
            found.append(np.mean(diffraction.bsdf.evaluate(20.0, 0.0, view, 180.0).values.squeeze() / expected))
    for wavelength, found in ratios.items():
        variance = (4 * np.pi * 0.3 * np.cos(np.radians(20)) / (wavelength * 1e-3)) ** 2
        # The next order of geometrical optics is 1/g, and the windows of diffraction see the middle of each map.
        noise = 2 * np.std(found, ddof=1) / np.sqrt(5) + 0.01
        assert abs(float(np.mean(found)) - 1) < 1 / variance + noise
        assert noise < 0.06


@pytest.mark.slow
@pytest.mark.parametrize("slope", [0.05, 0.1, 0.2])
def test_auto_is_no_further_from_traced_rays_than_facets(slope):
    surface = samples.surface(relief_maps.gaussian(slope, 256, 0))
    facets = estimate(surface)
    predicted = microfacet.build(facets, index=1.5, multiple_scattering="none")
    auto = wave.build(
        psd.estimate(surface), facets=facets, predicted=predicted, index=1.5, wavelength=555.0, optics="auto"
    )
    found, alone = (
        model_error(surface, each, facets, rays=400_000)["light_error"].sel(reference="traced", region="peak").squeeze()
        for each in (auto, predicted)
    )
    held = np.isfinite(alone.values)
    assert held.sum() >= 4
    # 0.5 % of each is noise of the rays; at 75 degree and g = 24 part of the light is of waves.
    assert (np.abs(found) < np.abs(alone) + 0.02).values[held].all()


def _gaussian_map(sigma: float, length: float, pitch: float, size: int, seed: int) -> xr.Dataset:
    """A periodic map of heights of a Gaussian autocovariance."""
    f = np.fft.fftfreq(size, pitch)
    spectrum = np.pi * (length * sigma) ** 2 * np.exp(-((np.pi * length) ** 2) * (f**2 + f[:, None] ** 2))
    return samples.surface(relief_maps.of_spectrum(spectrum, pitch, seed), (pitch, pitch))


@pytest.mark.parametrize(
    ("sigma", "length"),
    [(0.12, 5.0), *(pytest.param(*each, marks=pytest.mark.slow) for each in ((0.013, 5.0), (0.12, 1.0)))],
)
def test_coherent_light_and_halo_of_a_perfect_mirror_are_all_light_up_to_grazing(sigma, length):
    bsdf = rough(sigma, length)
    surface, nm = RoughSurface.of(bsdf), np.array([550.0])
    for theta in (52.0, 70.0, 82.0, 86.0, 88.5, 89.5):
        rule = hemisphere.around_mirror(theta, representation(bsdf).lobe_slope, order=5)
        angles = np.full_like(rule.theta, theta), np.zeros_like(rule.theta), rule.theta, rule.phi
        halo = halo_of_mirrors(surface, angles, nm)[..., :2].sum(axis=-1)
        for direction in (angles[0], angles[2]):
            halo *= surface.closure.of_halo(np.cos(np.radians(direction)), 0 * direction, nm)
        # Of the light that waves reflect; steep roughness reflects 6 % of it as facets at 52 degree.
        waves = 1 - surface.facet_share(2 * np.cos(np.radians([theta])), nm)[0, 0]
        # Between the nodes of the factors.
        assert mirror_share(bsdf, [theta])[0] / waves + float(rule.weight @ halo[:, 0]) == pytest.approx(1, abs=2e-3)
