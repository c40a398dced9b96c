"""Pictures of a textured surface from a distance."""

from __future__ import annotations

import numpy as np
import pytest
import relief_maps
import samples
from flake_pictures import flakes

from brdfpipe import facets, vocabulary
from brdfpipe.bsdf import lambert_gauss, microfacet
from brdfpipe.errors import BrdfpipeError
from brdfpipe.spectra import colorimetry
from brdfpipe.texture.distant_view import structure_preview, structure_previews
from brdfpipe.texture.picture_texture import of_pictures
from brdfpipe.texture.scan_texture import facets_of, of_scan
from brdfpipe.texture.sparkle import sparkle


@pytest.fixture(scope="module")
def paint():
    """Of a diffuser: the picture shows the texture alone."""
    pictures = {"45as15": flakes(256, seed=3), "diffuse": flakes(256, lobe=20.0, seed=3) + 1.0}
    return lambert_gauss.lambertian(samples.spectrum(0.5)), of_pictures(pictures, pixel=20.0, size=192)


def contrast(picture):
    return float(picture["relative_light"].std())


def test_a_spot_shows_sparkles_and_diffuse_light_less_contrast(paint):
    spot, diffuse = (structure_preview(*paint, light=light, distance=0.2, side=128) for light in ("spot", "diffuse"))
    assert vocabulary.validate(spot, "preview") is spot
    assert spot["picture"].shape == (128, 128, 3)
    found = [sparkle(one["relative_light"].values, 29.0).density for one in (spot, diffuse)]
    assert found[0] > 2 * found[1]
    assert contrast(spot) > 2 * contrast(diffuse) > 0.02


def test_both_lights_are_shown_where_the_texture_has_them(paint):
    bsdf, texture = paint
    shown = vocabulary.validate(structure_previews(bsdf, texture, distance=0.2), "preview")
    spot, diffuse = (structure_preview(bsdf, texture, light=light, distance=0.2) for light in ("spot", "diffuse"))
    assert np.array_equal(shown["picture"], spot["picture"])
    assert np.array_equal(shown["picture_in"][0], diffuse["picture"])
    assert shown["light_of"].values.tolist() == ["diffuse"]
    assert shown.attrs["contrast"] == pytest.approx([contrast(spot), contrast(diffuse)], rel=0.05)
    # 256 pixels of half of what an eye resolves at 0.2 m: a minute of arc.
    assert shown.attrs["picture_width"] == pytest.approx(128 * 200 * np.radians(1 / 60))
    alone = structure_previews(bsdf, texture.isel(geometry=[0]), distance=0.2)
    assert "picture_in" not in alone
    assert len(alone.attrs["contrast"]) == 1


def test_structure_fades_with_the_distance_and_the_mean_stays(paint):
    pictures = [structure_preview(*paint, distance=distance, side=192) for distance in (0.1, 0.5, 2.0, 10.0)]
    contrasts = [contrast(one) for one in pictures]
    assert contrasts == sorted(contrasts, reverse=True)
    assert contrasts[-1] < 0.02 < 0.2 < contrasts[0]
    # From afar it is the even panel of the BRDF: half as bright as the white diffuser.
    grey = pictures[-1]["picture"].values.mean(axis=(0, 1))
    level = 255 * colorimetry.encoded_srgb(0.5 * pictures[-1].attrs["white_level"])
    assert grey == pytest.approx(np.full(3, level), abs=2)


def test_the_grain_of_a_scan_is_shaded_by_a_spot():
    surface = samples.surface(relief_maps.gaussian(0.1, 256, 1, 8.0))
    every = facets.estimate(surface)
    texture = of_scan(surface, every, pixel=4.0, size=48, seed=1)
    full, rest = (microfacet.build(one, index=1.5, multiple_scattering="none") for one in (every, facets_of(texture)))
    spot, diffuse = (
        structure_preview(full, texture, rest, light=light, distance=0.02, side=48) for light in ("spot", "diffuse")
    )
    assert contrast(spot) > 2 * contrast(diffuse)


def test_an_unknown_light_and_no_distance_are_refused(paint):
    with pytest.raises(BrdfpipeError, match="unknown light"):
        structure_preview(*paint, light="candle")
    with pytest.raises(BrdfpipeError, match="diffuse light"):
        structure_preview(paint[0], paint[1].isel(geometry=[0]), light="diffuse")
    with pytest.raises(BrdfpipeError, match="distance"):
        structure_preview(*paint, distance=0.0)
