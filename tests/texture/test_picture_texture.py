"""The texture of an effect paint from pictures, and the BRDF with it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from flake_pictures import flakes
from PIL import Image

from brdfpipe import flakes as effect_pigments
from brdfpipe import vocabulary
from brdfpipe.bsdf import flake
from brdfpipe.bsdf.registry import representation
from brdfpipe.errors import BrdfpipeError
from brdfpipe.texture.picture_reading import read_picture
from brdfpipe.texture.picture_texture import nearest_geometry, of_files, of_pictures
from brdfpipe.texture.textured import Textured

ANGLES = {"45as15": 4.3, "45as45": 14.1}


@pytest.fixture(scope="module")
def pictures():
    return {name: flakes(256, density=0.01, at=at / 2, seed=3) for name, at in ANGLES.items()} | {
        "diffuse": flakes(256, lobe=20.0)
    }


@pytest.fixture(scope="module", params=["structure", "spectrum"])
def texture(request, pictures):
    return of_pictures(pictures, pixel=20.0, size=192, method=request.param, seed=2)


def test_each_geometry_has_a_texture_of_unit_mean_with_the_spectrum_of_its_picture(texture):
    assert vocabulary.validate(texture, "texture") is texture
    assert texture["relative_light"].shape == (3, 192, 192)
    assert texture["relative_light"].mean(("x", "y")).values == pytest.approx(np.ones(3), abs=1e-6)
    assert float(texture["relative_light"].min()) >= 0
    assert (texture["spectrum_difference"].values < 0.05).all()
    assert texture["theta_f"].values[:2] == pytest.approx(list(ANGLES.values()), abs=0.1)
    assert np.isnan(texture["theta_f"].values[2])
    assert texture["tile_graininess"].values == pytest.approx(texture["graininess"].values, rel=0.15)


def test_pieces_keep_sparkles_that_random_phases_break_into_many(pictures):
    found = {
        method: of_pictures(pictures, pixel=20.0, size=192, method=method)["tile_sparkle_density"].values[0]
        for method in ("structure", "spectrum")
    }
    wanted = of_pictures(pictures, pixel=20.0, size=192)["sparkle_density"].values[0]
    assert abs(found["structure"] / wanted - 1) < 0.4
    assert found["spectrum"] > 2 * wanted


def test_pieces_of_few_sparkles_on_a_noisy_background_do_not_blend_each_into_two():
    """The picture of the example: blended over a wide overlap it has 1.5 to 2.3 times as many sparkles."""
    file = Path(__file__).parents[2] / "examples" / "sparkling-texture" / "45as45.png"
    values = read_picture(file, "linear").values
    made = [of_pictures({"45as45": values}, pixel=20.0, size=256, seed=seed) for seed in range(3)]
    ratios = [float(one["tile_sparkle_density"][0] / one["sparkle_density"][0]) for one in made]
    # What is left is the noise of the gain that gives each ring of frequencies its power.
    assert 1 < np.mean(ratios) < 1.4


def test_borders_of_tiles_are_as_any_other_place(texture):
    light = texture["relative_light"].values[0]
    for axis in (0, 1):
        correlation = [np.corrcoef(light.take(k, axis), light.take((k + 1) % 192, axis))[0, 1] for k in range(192)]
        assert min(correlation[:-1]) <= correlation[-1] <= 1


def test_the_mean_over_a_tile_is_the_brdf_and_the_nearest_flake_angle_gives_the_picture(texture):
    labs = {"45as15": [33.9, -7.6, -36.6], "45as45": [12.3, 1.2, -25.8], "45as110": [3.1, 2.1, -13.2]}
    listed = [{"geometry": name, "lab": lab} for name, lab in labs.items()]
    paint = flake.build(effect_pigments.ingest({"colours": listed, "illuminant": "D65", "observer": 10}))
    textured = Textured(paint, texture)
    at = (np.arange(192) + 0.5) * 20.0
    x, y = (one.ravel() for one in np.meshgrid(at, at))
    for geometry, view in (("45as15", 30.0), ("45as45", 0.0)):
        directions = 45.0, 0.0, view, 180.0
        values = textured.evaluate(*directions, x, y, [550.0]).values[:, 0]
        whole = representation(paint).evaluate(*(np.array([one]) for one in directions), np.array([550.0]))[0, 0]
        assert values.mean() == pytest.approx(whole, rel=1e-3)
        light = texture["relative_light"].sel(geometry=geometry).values
        assert values.reshape(192, 192) == pytest.approx(whole * light, rel=1e-5, abs=1e-9)
    assert nearest_geometry(texture, np.array([0.0, 9.0, 40.0])).tolist() == [0, 0, 1]


def test_pictures_are_read_from_files_with_their_warnings(tmp_path):
    values = flakes(128)
    Image.fromarray((values / values.max() * 255).astype(np.uint8)).save(tmp_path / "a.png")
    texture = of_files([tmp_path / "a.png"], geometries=["45as15"], pixel=20.0, size=64)
    assert any("sRGB" in text for text in vocabulary.warnings(texture))
    x = np.linspace(-1, 1, 128)
    uneven = of_pictures({"45as15": values * (1.5 + x)}, pixel=20.0, size=64)
    assert any("light it more evenly" in text for text in vocabulary.warnings(uneven))
    with pytest.raises(BrdfpipeError, match="is unknown"):
        of_pictures({"sideways": values}, pixel=20.0, size=64)


@pytest.mark.parametrize("side", [64, 80])
def test_pictures_of_different_sizes_have_their_spectra_at_the_same_frequencies(side):
    light = np.random.default_rng(1).random((128, 128))
    small = of_pictures({"45as15": light[:side, :side]}, pixel=20.0, size=96)
    both = of_pictures({"45as15": light[:side, :side], "diffuse": light}, pixel=20.0, size=96)
    assert both["texture_frequency"].values == pytest.approx(small["texture_frequency"].values)
    # Of white noise in every ring the density is the variance times the area of a pixel.
    flat = both["sample_contrast_psd"].sel(geometry="diffuse") / (light.var() / light.mean() ** 2 * 20.0**2)
    assert float(flat.mean()) == pytest.approx(1.0, abs=0.1)
