"""Faces of a sheet with waves: phase screens, Fresnel's equations, facets as the limit of great roughness, and energy."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import xarray as xr

from brdfpipe import appearance, facets, optics, psd, vocabulary
from brdfpipe.bsdf import microfacet, slab
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.slab import face, wave_face
from brdfpipe.bsdf.slab.builder import ERROR_LIMIT
from brdfpipe.optics.index import refractive_index

WAVELENGTH, INDEX = 550.0, 1.5
CONE = 2.5
"""Half angle of the cone of light that counts as not scattered [degree]"""


def finish(sigma: float, length: float) -> tuple[xr.Dataset, xr.Dataset]:
    """Facets and roughness spectrum of Gaussian heights; lengths in um."""
    return facets.analytic("beckmann", 2 * sigma / length), psd.analytic("gaussian", sigma=sigma, length=length)


@cache
def film(sigma: float, length: float, inside: float, optics: str = "auto") -> xr.Dataset:
    """A sheet with a rough front and a smooth back, at one wavelength."""
    relief, spectrum = finish(sigma, length)
    return slab.build(
        relief,
        facets.flat(),
        index=INDEX,
        internal_transmittance=inside,
        front_psd=spectrum,
        optics=optics,
        wavelength=[WAVELENGTH],
    )


def direct_share_and_haze(bsdf: xr.Dataset) -> tuple[float, float]:
    at = np.zeros(1), np.zeros(1), None
    total = representation(bsdf).transmittance(*at)[0, 0]
    return representation(bsdf).specular(*at)[1][0, 0] / total, appearance.transmission_haze(bsdf)


# --- diffraction on maps


def phase_screen(sigma: float, length: float, maps: int = 4, size: int = 1024) -> tuple[float, float]:
    """Direct share and haze of light behind a surface that shifts its phase by 2π (n − 1) h/λ, by Fourier transforms of periodic maps."""
    frequency = np.fft.fftfreq(size, length / 10)
    squared = frequency[:, None] ** 2 + frequency**2
    filter_ = np.exp(-((np.pi * length) ** 2) * squared / 2)
    sine = WAVELENGTH * 1e-3 * np.sqrt(squared)
    shares = []
    for seed in range(maps):
        noise = np.random.default_rng(seed).standard_normal((size, size))
        height = np.fft.ifft2(np.fft.fft2(noise) * filter_).real
        height *= sigma / height.std()
        field = np.exp(2j * np.pi * (INDEX - 1) / (WAVELENGTH * 1e-3) * height)
        power = np.abs(np.fft.fft2(field) / size**2) ** 2
        shares.append(
            (power[0, 0], power[(sine > np.sin(np.radians(CONE))) & (sine < 1)].sum() / power[sine < 1].sum())
        )
    direct, haze = np.mean(shares, axis=0)
    return float(direct), float(haze)


@pytest.mark.parametrize(
    ("sigma", "length"),
    [
        (0.05, 2.0),
        *(pytest.param(*case, marks=pytest.mark.slow) for case in ((0.013, 2.0), (0.12, 2.0), (0.3, 3.0), (0.3, 8.0))),
    ],
)
def test_direct_light_and_haze_are_those_of_a_phase_screen(sigma, length):
    # Light that has been reflected inside is 1e-6 of the transmitted light of this sheet.
    direct, haze = direct_share_and_haze(film(sigma, length, 0.03))
    expected, expected_haze = phase_screen(sigma, length)
    # The maps scatter by up to 2 % of the direct light and 1 % of the haze.
    assert direct == pytest.approx(expected, rel=0.03)
    assert haze == pytest.approx(expected_haze, rel=0.03)


@pytest.mark.slow
def test_of_a_narrow_halo_the_core_is_direct_light_and_the_haze_is_right():
    direct, haze = direct_share_and_haze(film(0.12, 8.0, 0.03))
    expected, expected_haze = phase_screen(0.12, 8.0)
    assert direct > 1.2 * expected
    assert haze == pytest.approx(expected_haze, rel=0.05)


@pytest.mark.slow
def test_facets_alone_would_make_a_polished_film_hazy():
    direct, haze = direct_share_and_haze(film(0.013, 1.0, 0.03))
    assert direct == pytest.approx(np.exp(-((2 * np.pi * 0.013 * 0.5 / 0.55) ** 2)), rel=1e-3)
    assert haze < 0.006
    by_facets = slab.build(finish(0.013, 0.2)[0], facets.flat(), index=INDEX, internal_transmittance=0.03)
    direct, haze = direct_share_and_haze(by_facets)
    assert direct == 0
    assert haze > 0.5


# --- limits


def test_towards_mirrored_and_refracted_directions_halos_have_fresnels_polarisation():
    along = np.sin(np.radians([0.0, 20.0, 60.0, 85.0]))
    air, body = np.sqrt(1 - along**2), np.sqrt(INDEX**2 - along**2)
    outside, inside = wave_face.Fields.from_outside(along, INDEX), wave_face.Fields.from_inside(along, INDEX)
    fresnel = optics.fresnel(air, INDEX)
    contrast = INDEX**2 - 1
    s, p = (inside.s * outside.s, inside.p * outside.p + inside.normal * outside.normal / INDEX**2)
    np.testing.assert_allclose(np.abs(contrast * s) ** 2, (1 - fresnel.s) * (body - air) ** 2, rtol=1e-12)
    np.testing.assert_allclose(np.abs(contrast * p) ** 2, (1 - fresnel.p) * (body - air) ** 2, rtol=1e-12)
    s, p = inside.s**2, inside.normal**2 / INDEX**2 - inside.p**2
    np.testing.assert_allclose(np.abs(contrast * s) ** 2, fresnel.s * (2 * body) ** 2, rtol=1e-12)
    np.testing.assert_allclose(np.abs(contrast * p) ** 2, fresnel.p * (2 * body) ** 2, rtol=1e-11, atol=1e-15)


def test_beyond_the_critical_angle_all_light_is_reflected_inside():
    along = INDEX * np.sin(np.radians([45.0, 70.0]))
    body = np.sqrt(INDEX**2 - along**2)
    inside = wave_face.Fields.from_inside(along, INDEX)
    for amplitude in (inside.s**2, inside.normal**2 / INDEX**2 - inside.p**2):
        np.testing.assert_allclose(np.abs((INDEX**2 - 1) * amplitude), 2 * body, rtol=1e-12)


def test_the_halos_of_great_roughness_are_the_lobes_of_facets():
    # σ = 1.2 µm and slopes of 0.07: phase variances of 47 and 1700, and hardly any masking.
    relief, spectrum = finish(1.2, 34.0)
    surface = wave_face.WaveSurface.of(relief, spectrum, refractive_index(INDEX), np.array([WAVELENGTH]), "wave")
    nodes, azimuths = face.Nodes.of(INDEX, 40, 20), face.Azimuths.of(0.02, 48)
    arguments = INDEX, nodes, azimuths
    by_facets = face.transmitted_by_facets(surface.facets, "height-correlated", *arguments)
    halo = wave_face.transmitted_halo(surface, INDEX, WAVELENGTH, nodes, azimuths)
    inside_by_facets = face.mirrored_by_facets(surface.facets, "height-correlated", *arguments)
    inside_halo = wave_face.mirrored_halo(surface, INDEX, WAVELENGTH, nodes, azimuths)
    # Inside at 8° and 63°, far from where the reflectance bends.
    pairs = [(by_facets[:, row], halo[:, row]) for row in (5, 20)]
    pairs += [(inside_by_facets[:, :, row], inside_halo[:, :, row]) for row in (5, 49)]
    for wanted, found in pairs:
        lobe = wanted[0] > 0.3 * wanted[0].max()
        assert lobe.any()
        # Fresnel's amplitudes of the mean plane instead of those of the facet.
        np.testing.assert_allclose(found[0][lobe], wanted[0][lobe], rtol=0.12)
        for element in range(1, wanted.shape[0]):
            assert np.abs(found[element] - wanted[element])[lobe].max() < 0.12 * wanted[0].max()


def test_a_face_of_great_roughness_is_one_of_facets():
    relief, spectrum = finish(2.0, 13.0)
    surface = wave_face.WaveSurface.of(relief, spectrum, refractive_index(INDEX), np.array([780.0]), "auto")
    # Phase variances of 65, and of 39 where the index is closer to that of air.
    assert surface.is_of_facets(INDEX, 780.0)
    assert not surface.is_of_facets(1.39, 780.0)


@pytest.mark.slow
def test_a_sheet_of_great_roughness_is_that_of_facets():
    relief, spectrum = finish(2.0, 13.0)
    given = {"index": INDEX, "internal_transmittance": 0.8}
    with_spectrum = slab.build(relief, facets.flat(), front_psd=spectrum, **given)
    xr.testing.assert_identical(with_spectrum, slab.build(relief, facets.flat(), **given))


# --- the sheet


def test_energy_is_balanced_and_the_film_is_reciprocal():
    bsdf = vocabulary.validate(film(0.05, 2.0, 0.8), "bsdf")
    total = bsdf["reflectance"] + bsdf["transmittance"] + bsdf["absorptance"]
    assert total.values == pytest.approx(1.0, abs=1e-12)
    assert (bsdf["specular_reflectance"] <= bsdf["reflectance"]).all()
    theta_o, phi = np.meshgrid([0.0, 20.0, 70.0, 100.0, 160.0], [0.0, 100.0, 180.0])
    forward = representation(bsdf).evaluate(30.0, 0.0, theta_o, phi, None)
    assert (forward >= 0).all()
    assert (forward == representation(bsdf).evaluate(theta_o, phi, 30.0, 0.0, None)).all()
    assert float(bsdf["interpolation_error"]) < ERROR_LIMIT


def test_a_film_reflects_as_much_as_a_plate():
    bsdf, angles = film(0.05, 2.0, 0.8), np.array([8.0, 60.0, 172.0])
    plate = slab.build(facets.flat(), facets.flat(), index=INDEX, internal_transmittance=0.8)
    zero = np.zeros(angles.size)
    found, wanted = (representation(each).albedo(angles, zero, None)[:, 0] for each in (bsdf, plate))
    # Light that the halo turns beyond the critical angle stays inside.
    assert found == pytest.approx(wanted, abs=0.006)


def test_a_film_has_the_gloss_of_its_coherent_light():
    at = np.array([20.0]), np.zeros(1), None
    bsdf = film(0.05, 2.0, 0.03)
    # The light of first order that a perfect mirror scatters, over sines of the exit: 16π²/λ⁴ γ_i γ_o S.
    x, y = np.meshgrid(*(np.linspace(-1, 1, 1201),) * 2)
    cosine = np.sqrt(np.maximum(1 - x**2 - y**2, 0.0))
    spectrum = (
        np.pi * (2.0 * 0.05) ** 2 * np.exp(-((2 * np.pi / 0.55) ** 2) * ((x - np.sin(np.radians(20))) ** 2 + y**2))
    )
    g = float((16 * np.pi**2 / 0.55**4 * np.cos(np.radians(20)) * cosine * spectrum).sum()) * (2 / 1200) ** 2
    expected = float(optics.fresnel(np.cos(np.radians(20)), INDEX).mean) * np.exp(-g)
    assert representation(bsdf).specular(*at)[0][0, 0] == pytest.approx(expected, rel=2e-3)
    regime = representation(bsdf).regime("front", np.array([20.0]), np.array([WAVELENGTH]))
    assert regime[0][0, 0] == pytest.approx(np.exp(-g), rel=2e-3)
    assert representation(bsdf).regime("back", np.array([20.0]), np.array([WAVELENGTH])) is None


@pytest.mark.slow
def test_the_film_of_each_wavelength_is_interpolated():
    relief, spectrum = finish(0.12, 2.0)
    given = {"index": INDEX, "internal_transmittance": 0.8, "front_psd": spectrum}
    bsdf = slab.build(relief, facets.flat(), wavelength=np.arange(400.0, 701.0, 20.0), **given)
    theta_o, phi = np.meshgrid([5.0, 25.0, 60.0, 120.0, 150.0, 175.0], np.linspace(0, 180, 13))
    zero = np.zeros_like(phi)
    for nm in (420.0, 580.0):
        alone = slab.build(relief, facets.flat(), wavelength=[nm], **given)
        found, wanted = (
            representation(each).evaluate(30 + zero, zero, theta_o, phi, at)[..., 0]
            for each, at in ((bsdf, np.array([nm])), (alone, None))
        )
        # A polynomial through five wavelengths, and other nodes of the polar angle.
        assert np.abs(found - wanted).sum() < 0.015 * wanted.sum()
        at = np.array([30.0]), np.zeros(1)
        for share in ("albedo", "transmittance"):
            found, wanted = (
                getattr(representation(each), share)(*at, nm_)[0, 0]
                for each, nm_ in ((bsdf, np.array([nm])), (alone, None))
            )
            assert found == pytest.approx(wanted, abs=1e-3)
    mean = appearance.transmission_haze(bsdf)
    single = [
        appearance.transmission_haze(slab.build(relief, facets.flat(), wavelength=[nm], **given)) for nm in (500, 620)
    ]
    assert min(single) < mean < max(single)


def test_a_face_may_reflect_as_its_facets_do_outside_and_have_waves_inside():
    # The phase variance of what passes is 16 times smaller than that of what is reflected outside.
    relief, spectrum = finish(1.5, 8.0)
    given = {"index": INDEX, "internal_transmittance": 0.8}
    bsdf = slab.build(relief, facets.flat(), front_psd=spectrum, wavelength=[650.0], **given)
    # Outside, the front is the interface of its facets; the light from inside is the same but for the share of waves.
    by_facets = representation(slab.build(relief, facets.flat(), **given))
    found = representation(vocabulary.validate(bsdf, "bsdf")).evaluate(
        30.0, 0.0, np.array([20.0, 30.0, 150.0]), 180.0, None
    )
    wanted = by_facets.evaluate(30.0, 0.0, np.array([20.0, 30.0, 150.0]), 180.0, None)
    np.testing.assert_allclose(found, wanted, rtol=0.03)


def test_waves_with_other_masking_or_optics_are_refused():
    relief, spectrum = finish(0.05, 2.0)
    with pytest.raises(microfacet.ModelError, match="waves are masked by"):
        slab.build(relief, facets.flat(), index=INDEX, front_psd=spectrum, masking="separable")
    with pytest.raises(microfacet.ModelError, match="accepted: facets, wave, auto"):
        slab.build(relief, facets.flat(), index=INDEX, front_psd=spectrum, optics="composite")
