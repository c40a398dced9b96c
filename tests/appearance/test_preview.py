"""The picture of a material."""

from __future__ import annotations

from io import BytesIO

import numpy as np
import pytest
import samples
from PIL import Image

from brdfpipe import facets, optics, vocabulary
from brdfpipe.appearance import preview_geometry as shots
from brdfpipe.appearance.lights import WHITE_LEVEL, LightError
from brdfpipe.appearance.preview import OTHER_LIGHTS, channels_of, png, preview, tone
from brdfpipe.bsdf import lambert_gauss, microfacet, slab
from brdfpipe.spectra import colorimetry
from brdfpipe.spectra.recovery import recover


def black(a):
    return samples.glossy_bsdf(a, 1.55)


def sphere(picture):
    """The left half, (side, side, channel), as numbers."""
    pixels = picture["picture"].values.astype(float)
    return pixels[:, : len(pixels)]


def test_a_perfect_white_reaches_the_white_level_and_no_more():
    picture = preview(lambert_gauss.lambertian(samples.spectrum(1.0)), side=96)
    white = 255 * float(colorimetry.encoded_srgb(WHITE_LEVEL))
    # The brightest of 400 normals sets the exposure.
    assert sphere(picture).max() == pytest.approx(white, abs=1.0)


@pytest.mark.parametrize("lab", [(38, 22, 15), (45, 60, 40), (50, 70, 50), (30, 30, -60), (80, 5, 85)])
def test_a_saturated_colour_is_that_of_steps_of_5_nm(lab):
    """Wavelengths 20 nm apart. The sum over 5 nm is tested against colour-science."""
    spectrum = recover(lab, illuminant="D65", observer=10)
    wavelength, channels = channels_of(lambert_gauss.lambertian(spectrum))
    found = spectrum["total_reflectance"].interp(wavelength=wavelength).values @ channels
    whole = spectrum["wavelength"].values, spectrum["total_reflectance"].values
    xyz = colorimetry.reflectance_to_xyz(*whole, "D65", 2)
    wanted = colorimetry.srgb_from_xyz(colorimetry.weights("D65", 2).white) @ xyz
    # A hundredth of the weakest channel, which is outside sRGB of one.
    assert wavelength.size == 16
    assert found == pytest.approx(wanted, rel=0.01)


@pytest.mark.parametrize("illuminant", ["D65", "A", "FL2"])
def test_a_neutral_material_is_neutral_under_every_illuminant(illuminant):
    pixels = sphere(preview(lambert_gauss.lambertian(samples.spectrum(0.5)), illuminant=illuminant, side=48))
    assert np.ptp(pixels, axis=2).max() == 0


def test_the_colour_of_a_matt_material_is_that_of_its_spectrum():
    red = 0.05 + 0.4 / (1 + np.exp(-(samples.WAVELENGTH - 600) / 14))
    pixels = sphere(preview(lambert_gauss.lambertian(samples.spectrum(red)), side=96))[shots.sphere(96).coverage == 1]
    brightest = pixels[pixels.sum(axis=1).argmax()]
    expected = colorimetry.reflectance_to_xyz(samples.WAVELENGTH, red, "D65", 2) * WHITE_LEVEL
    to_screen = colorimetry.srgb_from_xyz(colorimetry.weights("D65", 2).white)
    # Wavelengths 20 nm apart stand for those 5 nm apart.
    assert brightest == pytest.approx(255 * colorimetry.encoded_srgb(to_screen @ expected), abs=2.0)


def test_the_same_material_gives_the_same_bytes():
    bsdf = samples.beckmann_bsdf(0.05)
    assert png(preview(bsdf, side=64)) == png(preview(bsdf, side=64))


def test_the_file_is_a_small_png_of_the_picture():
    picture = preview(samples.beckmann_bsdf(0.02))
    content = png(picture)
    assert len(content) < 80_000
    with Image.open(BytesIO(content)) as stored:
        assert (np.asarray(stored) == picture["picture"].values).all()


def test_the_picture_is_valid_in_the_vocabulary():
    picture = preview(lambert_gauss.lambertian(samples.spectrum(0.5)), side=32, light="overcast", illuminant="d50")
    vocabulary.validate(picture, "preview")
    assert picture["picture"].shape == (32, 96, 3)
    assert (picture.attrs["illuminant"], picture.attrs["light"]) == ("D50", "overcast")


def test_further_lights_are_what_each_gives_as_the_light_of_the_scene():
    bsdf = samples.beckmann_bsdf(0.1, reflectance=0.3)
    picture = preview(bsdf, side=48)
    assert [*zip(picture["light_of"].values, picture["illuminant_of"].values, strict=True)] == [*OTHER_LIGHTS]
    for k, other in enumerate(OTHER_LIGHTS):
        alone = preview(bsdf, side=48, light=other.light, illuminant=other.illuminant, others=())
        assert "picture_in" not in alone
        difference = picture["picture_in"].values[k].astype(int) - alone["picture"].values
        assert np.abs(difference).max() <= 1


def test_a_further_light_that_is_that_of_the_scene_is_not_repeated():
    picture = preview(black(0.2), side=32, light="spot", illuminant="A")
    assert picture["light_of"].values.tolist() == ["tubes"]


def test_an_unknown_light_is_refused():
    with pytest.raises(LightError, match="candle"):
        preview(black(0.1), light="candle")


def test_the_smoother_the_surface_the_sharper_the_lights_in_it():
    steepest = [
        np.abs(np.diff(sphere(preview(black(a), side=96))[20:76, 20:76], axis=0)).max() for a in (0.02, 0.1, 0.3)
    ]
    assert steepest[0] > 1.5 * steepest[1] > 1.5**2 * steepest[2]


def test_a_glossy_sphere_brightens_at_its_rim():
    pixels = sphere(preview(black(0.02), side=128, light="overcast"))[..., 1]
    centre, rim = pixels[64, 64], pixels[8:12, 64].max()
    assert rim > 2 * centre


def test_streaks_run_across_the_lay():
    surface = facets.analytic("beckmann", a_x=0.03, a_y=0.3)
    with samples.coarse_albedo_tables():
        brushed = microfacet.build(surface, index=optics.refractive_index(1.55), multiple_scattering="none")
    pixels = sphere(preview(brushed, side=96))[24:72, 20:76, 1]
    assert np.abs(np.diff(pixels, axis=1)).mean() > 1.5 * np.abs(np.diff(pixels, axis=0)).mean()


@pytest.mark.slow
def test_a_lay_turned_with_its_own_coordinates_looks_the_same():
    pictures = [
        preview(
            microfacet.build(
                facets.analytic("beckmann", a_x=0.05, a_y=0.3, azimuth=azimuth),
                index=optics.refractive_index(1.55),
                multiple_scattering="none",
            ),
            side=48,
        )["picture"].values.astype(float)
        for azimuth in (0.0, 40.0)
    ]
    assert np.abs(pictures[1] - pictures[0]).max() <= 3


def test_a_polished_surface_is_the_limit_of_smooth_ones():
    polished = preview(microfacet.build(facets.flat(), index=1.55), side=64)["picture"].values.astype(float)
    nearly = preview(black(1e-3), side=64)["picture"].values.astype(float)
    assert np.sqrt(np.mean((polished - nearly) ** 2)) < 1.5


def test_tones_are_linear_up_to_white_and_never_clip():
    linear = np.linspace(0, 3, 3001)
    shown = tone(linear)
    assert shown[linear <= WHITE_LEVEL] == pytest.approx(linear[linear <= WHITE_LEVEL])
    assert (np.diff(shown) > 0).all()
    assert shown.max() < 1
    # No bend where the two parts meet.
    assert np.abs(np.diff(shown, 2)).max() < 1.1e-6 / (1 - WHITE_LEVEL)


def test_a_clear_slab_shows_the_backdrop_through_it():
    clear = slab.build(facets.flat(), facets.flat(), index=1.5)
    picture = preview(clear, side=64, light="overcast")["picture"].values.astype(float)
    backdrop, below = picture[44, 0, 1], picture[44, 32, 1]
    # Both faces of glass take 8 %, and give a little of the ground back.
    assert 0.9 * backdrop < below < 1.1 * backdrop
