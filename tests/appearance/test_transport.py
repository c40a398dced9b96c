"""Light transport of a preview, against closed forms and against sampling."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import samples

from brdfpipe import facets, optics
from brdfpipe.appearance import preview
from brdfpipe.appearance import preview_geometry as shots
from brdfpipe.appearance.lights import Lights, lights
from brdfpipe.appearance.preview import channels_of, radiance
from brdfpipe.appearance.transport import Table, _lobe_widths
from brdfpipe.bsdf import lambert_gauss, microfacet
from brdfpipe.geometry import unit_vector

EVEN = Lights((), 1.0, 1.0)
ONE = (None, np.ones((1, 1)))


@cache
def gloss_alone(*, index=1.5, **width):
    with samples.coarse_albedo_tables():
        return microfacet.build(
            facets.analytic("beckmann", **width), index=optics.refractive_index(index), multiple_scattering="none"
        )


def some(points, count, seed=2):
    chosen = np.random.default_rng(seed).choice(len(points.normal), count, replace=False)
    return points.at(chosen)


def views(points, table):
    _, theta, phi = table._local_views(points)
    return theta, phi


@pytest.mark.cases(2)
@pytest.mark.parametrize("a", [0.002, 0.02, 0.1, 0.3])
def test_in_an_even_light_a_surface_shows_its_albedo(a):
    bsdf = gloss_alone(a=a)
    table = Table.of(bsdf, *ONE)
    points = some(shots.sphere(64).pixels, 200)
    theta, _ = views(points, table)
    points, theta = points.at(theta < 80), theta[theta < 80]
    seen = table.near_light(points, EVEN) + table.far_light(points, EVEN)
    assert seen[:, 0] == pytest.approx(bsdf.bsdf.albedo(theta).values, rel=0.01)


def test_in_an_even_light_a_surface_with_a_lay_shows_its_albedo():
    bsdf = gloss_alone(a_x=0.05, a_y=0.3)
    table = Table.of(bsdf, *ONE)
    points = some(shots.panel(64).pixels, 50)
    seen = table.near_light(points, EVEN) + table.far_light(points, EVEN)
    assert seen[:, 0] == pytest.approx(bsdf.bsdf.albedo(*views(points, table)).values, rel=0.015)


def test_in_an_even_light_a_white_lambertian_is_white():
    table = Table.of(lambert_gauss.lambertian(samples.spectrum(1.0)), np.array([550.0]), np.ones((1, 1)))
    shot = shots.sphere(48)
    assert shot.upsampled(table.far_light(shot.coarse, EVEN)) == pytest.approx(
        np.ones((len(shot.grid_position[0]), 1)), rel=2e-3
    )


def test_a_polished_surface_mirrors_the_lights_by_its_reflectance():
    table = Table.of(microfacet.build(facets.flat(), index=1.5), *ONE)
    points = some(shots.panel(64).pixels, 40)
    cosine = (points.normal * points.view).sum(axis=1)
    mirrored = 2 * cosine[:, None] * points.normal - points.view
    light = lights("studio").radiance(mirrored, float(points.spread[0]))
    expected = light * optics.fresnel(cosine, 1.5).mean
    # The reflectance is linear between polar angles of view 2 degree apart.
    assert table.mirrored_light(points, lights("studio"))[:, 0] == pytest.approx(expected, rel=5e-3)


@pytest.mark.cases(3)
@pytest.mark.parametrize(
    ("build", "name"),
    [
        (lambda: gloss_alone(a=0.02), "studio"),
        (lambda: gloss_alone(a=0.3), "sun"),
        (lambda: samples.beckmann_bsdf(0.07, reflectance=0.4), "studio"),
        pytest.param(lambda: gloss_alone(a_x=0.05, a_y=0.3), "studio", marks=pytest.mark.slow),
    ],
    ids=["glossy", "rough in the sun", "coloured", "with a lay"],
)
@pytest.mark.parametrize("shot", [shots.sphere(64), shots.panel(64)], ids=["sphere", "panel"])
def test_pixels_are_those_of_many_samples(build, name, shot):
    bsdf, environment = build(), lights(name)
    wavelength = np.array([550.0]) if "wavelength" in bsdf.coords else None
    table = Table.of(bsdf, wavelength, np.ones((1, 1)))
    pixels = radiance(table, shot, environment)[:, 0]
    inner = np.flatnonzero((shot.pixels.normal * shot.pixels.view).sum(axis=1) > 0.3)
    chosen = np.random.default_rng(4).choice(inner, 15, replace=False)
    points = shot.pixels.at(chosen)
    frame, theta, phi = table._local_views(points)
    for k, pixel in enumerate(chosen):
        drawn = bsdf.bsdf.sample(20_000, 9, float(theta[k]), float(phi[k]), wavelength)
        directions = unit_vector(drawn["theta_o"].values, drawn["phi_o"].values) @ frame[k]
        light = environment.radiance(directions, float(points.spread[k]))
        sampled = light * drawn["weight"].values.reshape(20_000) * environment.exposure
        noise = sampled.std() / np.sqrt(sampled.size)
        # A pixel of 64 is wider than the edges of the boxes, and the nodes blur the lobe by 2 % more.
        assert abs(pixels[pixel] - sampled.mean()) < 4 * noise + 0.05 * sampled.mean()


def test_lobes_are_found_through_evaluation_alone():
    # Half height of exp(−s²/a²) lies at s = a √ln 2; the search steps by 12 %.
    along, across = _lobe_widths(gloss_alone(a_x=0.02, a_y=0.1), 0.0, None)
    assert along == pytest.approx(0.02 * np.sqrt(np.log(2)), rel=0.15)
    assert across == pytest.approx(0.1 * np.sqrt(np.log(2)), rel=0.15)


def test_a_lambertian_has_no_lobe():
    table = Table.of(lambert_gauss.lambertian(samples.spectrum(0.5)), np.array([550.0]), np.ones((1, 1)))
    assert table.near.shape[2] == 0


def test_a_table_looks_like_the_model_it_was_made_from():
    bsdf = gloss_alone(a=0.2)
    stored = bsdf.bsdf.tabulate(
        {
            "theta_i": np.arange(0.0, 90.0, 2.5),
            "theta_o": np.arange(0.0, 90.0, 2.5),
            "phi_o": np.concatenate([np.arange(0, 140, 10.0), np.arange(140, 181, 2.5)]),
        }
    )
    shot, environment = shots.sphere(48), lights("studio")
    modelled, tabulated = (radiance(Table.of(dataset, *ONE), shot, environment) for dataset in (bsdf, stored))
    inner = (shot.pixels.normal * shot.pixels.view).sum(axis=1) > 0.4
    # Linear interpolation cuts the peak of the lobe.
    assert tabulated[inner] == pytest.approx(modelled[inner], rel=0.06, abs=0.003)


def test_light_of_wavelengths_adds_up_to_white():
    for illuminant in ("D65", "A", "FL2"):
        wavelength, channels = channels_of(samples.beckmann_bsdf(), illuminant)
        assert channels.shape == (wavelength.size, 3)
        assert channels.sum(axis=0) == pytest.approx(np.ones(3), abs=1e-12)


@pytest.mark.parametrize("a", [0.02, 0.2])
def test_several_lights_are_those_that_each_gives_alone(a):
    bsdf, names = gloss_alone(a=a), ("studio", "spot", "tubes")
    tables = Table.of(bsdf, None, np.array([[1.0, 0.5, 0.25]])), Table.of(bsdf, *ONE)
    together = radiance(tables[0], shots.sphere(48), *map(lights, names))
    for k, (name, weight) in enumerate(zip(names, (1.0, 0.5, 0.25), strict=True)):
        alone = radiance(tables[1], shots.sphere(48), lights(name))[:, 0]
        assert together[:, k] / weight == pytest.approx(alone, rel=2e-5, abs=1e-6)


@pytest.mark.parametrize("shot", [shots.sphere(128), shots.panel(128)], ids=["sphere", "panel"])
@pytest.mark.parametrize("a", [0.05, 0.12])
def test_a_broad_lobe_seen_at_fewer_points_looks_as_at_every_pixel(shot, a, monkeypatch):
    table = Table.of(gloss_alone(a=a), *ONE)
    seen = []
    for share in (1.0, 0.0):
        monkeypatch.setattr(preview, "_FEWER", share)
        seen.append(preview.tone(radiance(table, shot, lights("studio")))[:, 0])
    # A step of the screen is 1/255, and less where it is dark.
    assert np.abs(seen[0] - seen[1]).max() < 0.5 / 255
