"""A BRDF with its structure: mean over a tile, and values at places."""

from __future__ import annotations

import numpy as np
import pytest
import relief_maps
import samples

from brdfpipe import facets
from brdfpipe.bsdf import microfacet
from brdfpipe.bsdf.registry import representation
from brdfpipe.errors import BrdfpipeError, VocabularyError
from brdfpipe.texture.scan_texture import facets_of, normals_of, of_scan
from brdfpipe.texture.textured import Textured

DIRECTIONS = [(0.0, 0.0, 0.0, 0.0), (45.0, 20.0, 30.0, 200.0), (60.0, 0.0, 40.0, 180.0)]


def made(height):
    surface = samples.surface(height)
    every = facets.estimate(surface)
    texture = of_scan(surface, every, pixel=4.0, size=48, seed=1)
    full, rest = (microfacet.build(one, index=1.5, multiple_scattering="none") for one in (every, facets_of(texture)))
    return full, texture, rest


@pytest.fixture(scope="module")
def gaussian():
    return made(relief_maps.gaussian(0.1, 256, 1, 8.0))


def places(texture, per_pixel=11):
    """Evenly spread over a tile, none of them one that the slopes of the map are taken at."""
    pixel, count = texture.attrs["pixel"], texture.sizes["x"] * per_pixel
    at = (np.arange(count) + 0.5) * pixel / per_pixel
    return (one.ravel() for one in np.meshgrid(at, at))


@pytest.mark.parametrize(
    "height",
    [
        lambda: relief_maps.gaussian(0.1, 256, 1, 8.0),
        lambda: 0.15 * relief_maps.cells(256, 1) + relief_maps.gaussian(0.1, 256, 1, 4.0),
        lambda: relief_maps.ridges(256, 1, 0.12) + relief_maps.gaussian(0.08, 256, 1, 4.0),
    ],
    ids=["gaussian", "cells", "ridges"],
)
def test_the_mean_over_a_tile_is_the_brdf(height):
    full, texture, rest = made(height())
    textured = Textured(full, texture, rest)
    for directions in DIRECTIONS:
        values = textured.evaluate(*directions, *places(texture))
        wanted = representation(full).evaluate(*(np.array([one]) for one in directions), None)[0, 0]
        assert float(values.mean()) == pytest.approx(wanted, rel=1e-3)
        assert float(values.std()) > 0.1 * wanted


def test_a_place_is_bright_where_its_normal_mirrors_the_light(gaussian):
    full, texture, rest = gaussian
    normals = normals_of(texture)
    row, column = np.unravel_index(np.argmax(normals[..., 2]), normals.shape[:2])
    steep_row, steep_column = np.unravel_index(np.argmin(normals[..., 2]), normals.shape[:2])
    pixel = texture.attrs["pixel"]
    x, y = (np.array([column, steep_column]) + 0.5) * pixel, (np.array([row, steep_row]) + 0.5) * pixel
    level, steep = Textured(full, texture, rest).evaluate(0.0, 0.0, 0.0, 0.0, x, y).values
    assert level > representation(full).evaluate(*np.zeros((4, 1)), None)[0, 0] > steep


def test_the_accessor_of_a_bsdf_evaluates_with_places(gaussian):
    full, texture, rest = gaussian
    at = 45.0, 20.0, 30.0, 200.0, [10.0, 20.0], 5.0
    wanted = Textured(full, texture, rest).evaluate(*at)
    assert full.bsdf.textured(texture, rest).evaluate(*at).equals(wanted)
    assert full.bsdf.evaluate(*at[:4], x=at[4], y=at[5], texture=texture, rest=rest).equals(wanted)
    with pytest.raises(VocabularyError, match="missing: y, texture"):
        full.bsdf.evaluate(*at[:4], x=1.0)


def test_tiles_repeat(gaussian):
    textured = Textured(*gaussian)
    side = gaussian[1].attrs["pixel"] * gaussian[1].sizes["x"]
    here, there = (textured.evaluate(30.0, 0.0, 25.0, 180.0, 11.0 + k * side, 7.0 - k * side) for k in (0, 3))
    assert float(there[0]) == pytest.approx(float(here[0]), rel=1e-9)


def test_wavelengths_are_those_of_the_bsdf(gaussian):
    _, texture, _ = gaussian
    full = samples.beckmann_bsdf(0.1, reflectance=0.3)
    rest = microfacet.build(facets_of(texture), index=1.55, spectrum=samples.spectrum(0.3))
    values = Textured(full, texture, rest).evaluate(20.0, 0.0, 10.0, 180.0, [1.0, 2.0, 3.0], 5.0, [500.0, 600.0])
    assert values.dims == ("place", "wavelength")
    assert values.shape == (3, 2)


def test_what_cannot_be_evaluated_is_refused(gaussian):
    full, texture, rest = gaussian
    with pytest.raises(BrdfpipeError, match="unresolved"):
        Textured(full, texture)
    with pytest.raises(VocabularyError, match="theta_i"):
        Textured(full, texture, rest).evaluate(95.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    with pytest.raises(VocabularyError, match=r"x \(2,\), y \(3,\)"):
        Textured(full, texture, rest).evaluate(45.0, 0.0, 0.0, 0.0, [0.0, 1.0], [0.0, 1.0, 2.0])
    with pytest.raises(VocabularyError, match=r"found str; brdfpipe\.open_dataset"):
        Textured(full, "texture.nc", rest)
