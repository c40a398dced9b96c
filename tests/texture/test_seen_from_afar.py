"""A map and the BRDF of what its pixels do not resolve, against the BRDF of all facets."""

from __future__ import annotations

import numpy as np
import pytest
import relief_maps
import samples

from brdfpipe import facets
from brdfpipe.bsdf import microfacet
from brdfpipe.bsdf.registry import representation
from brdfpipe.errors import BrdfpipeError
from brdfpipe.texture.height_pixels import central_slopes, pixel_heights
from brdfpipe.texture.seen_from_afar import seen_from_afar
from brdfpipe.texture.slope_split import SlopeSplit, split


def gaussian(size):
    return relief_maps.gaussian(0.1, size, 1, 8.0)


def cells(size):
    """Cells under fine roughness, as etched moulds have it."""
    return 0.15 * relief_maps.cells(size, 1) + relief_maps.gaussian(0.1, size, 1, 4.0)


def ridges(size):
    return relief_maps.ridges(size, 1, 0.12) + relief_maps.gaussian(0.08, size, 1, 4.0)


def parts(height, pixel) -> tuple[np.ndarray, SlopeSplit, np.ndarray]:
    """All facets, the split, and the slopes of the map."""
    surface = samples.surface(height)
    every = facets.estimate(surface)
    slopes = central_slopes(pixel_heights(surface, pixel)[0], pixel)
    return every, split(every, *slopes), slopes


def bsdf_of(one):
    return microfacet.build(one, index=1.5, multiple_scattering="none")


LIGHT = np.array([(0.0, 0.0), *((r, a) for r in (2.0, 4.0) for a in range(0, 360, 60))])
"""Directions of a round light of 5 degree about its middle [degree]."""


def of_light(values):
    return values.reshape(-1, len(LIGHT)).mean(axis=1)


def directions(slope_rms):
    """Incidences, and lights about outgoing directions from the mirror direction to two rms slopes beside it."""
    tilt = np.degrees(np.arctan(slope_rms))
    middles = [(theta, theta + step * tilt) for theta in (0.0, 25.0, 45.0) for step in (-1.5, -0.7, 0, 0.7, 1.5)]
    theta_i, middle = np.repeat(np.array(middles), len(LIGHT), axis=0).T
    radius, turn = np.tile(LIGHT, (len(middles), 1)).T
    along = middle + radius * np.cos(np.radians(turn))
    x = np.sin(np.radians(along))
    y = np.sin(np.radians(radius)) * np.sin(np.radians(turn))
    theta_o = np.degrees(np.arcsin(np.minimum(np.hypot(x, y), 1)))
    return theta_i, np.full_like(theta_i, 20.0), theta_o, np.degrees(np.arctan2(-y, -x)) + 20.0


@pytest.mark.parametrize(("make", "pixel"), [(gaussian, 4), (cells, 4), (ridges, 4)])
def test_the_mean_over_the_map_is_the_brdf_of_all_facets_and_the_double_count_is_not(make, pixel):
    every, found, _ = parts(make(1024), pixel)
    assert 0.2 < found.unresolved < 0.9
    pairs = directions(float(every["slope_rms"]))
    full = bsdf_of(every)
    wanted = of_light(representation(full).evaluate(*pairs, None)[:, 0])
    together = of_light(seen_from_afar(bsdf_of(found.facets), found.map_slopes, *pairs)[:, 0])
    twice = of_light(seen_from_afar(full, found.map_slopes, *pairs)[:, 0])
    # Half of it are the counts of so small a map, which a density without their scatter cannot follow at the peak.
    assert np.sqrt(np.mean((together / wanted - 1) ** 2)) < 0.02
    assert np.abs(together / wanted - 1).max() < 0.05
    assert np.abs(twice / wanted - 1).max() > 0.1


def test_the_mean_over_the_map_is_reciprocal():
    _, found, _ = parts(gaussian(512), 4)
    pairs = np.array([10.0, 30.0]), np.zeros(2), np.array([25.0, 40.0]), np.array([150.0, 190.0])
    rest = bsdf_of(found.facets)
    there = seen_from_afar(rest, found.map_slopes, *pairs)
    assert seen_from_afar(rest, found.map_slopes, *pairs[2:], *pairs[:2]) == pytest.approx(there, rel=1e-6)


def test_a_flat_polygon_is_as_the_relief_at_normal_observation():
    _, found, _ = parts(gaussian(512), 4)
    rest, pairs = bsdf_of(found.facets), (np.array([0.0, 20.0]), np.zeros(2), np.zeros(2), np.zeros(2))
    relief, flat = (seen_from_afar(rest, found.map_slopes, *pairs, areas=areas) for areas in ("relief", "flat"))
    assert flat == pytest.approx(relief, rel=1e-9)
    with pytest.raises(BrdfpipeError, match="areas"):
        seen_from_afar(rest, found.map_slopes, *pairs, areas="other")


@pytest.mark.slow
@pytest.mark.parametrize(("make", "pixel"), [(gaussian, 4), (cells, 4), (ridges, 4)])
def test_mitsuba_renders_the_map_from_afar_as_the_full_brdf(make, pixel, tmp_path):
    """A polygon with the map of normals and a rough conductor of the residual, in a renderer that knows nothing of this package."""
    mitsuba = pytest.importorskip("mitsuba", reason="Mitsuba is not there: make peers")
    import brdfpipe.mitsuba as ours

    before = mitsuba.variant()
    mitsuba.set_variant("llvm_ad_rgb")
    try:
        every, found, slopes = parts(make(2048 if make is ridges else 1024), pixel)
        upright = 1 / np.sqrt(1 + slopes[0] ** 2 + slopes[1] ** 2)
        normals = np.stack([-slopes[0] * upright, -slopes[1] * upright, upright], axis=-1)
        # The first row of a bitmap is the lower edge of a polygon.
        bitmap = mitsuba.Bitmap(((normals + 1) / 2).astype(np.float32))
        full, rest = (
            ours.material(bsdf_of(one).assign_attrs(material=name), tmp_path, name, two_sided=False)
            for name, one in (("full", every), ("rest", found.facets))
        )
        texture = {"type": "bitmap", "bitmap": bitmap, "raw": True, "filter_type": "bilinear"}

        def mapped(bsdf):
            return {"type": "normalmap", "normalmap": texture, "bsdf": bsdf}

        def luminance(bsdf, theta):
            # A round light of 5 degree: in one direction counted densities scatter by some per cent.
            radius, turn = np.radians(LIGHT.T)
            tilt = np.stack([np.radians(theta) + radius * np.cos(turn), radius * np.sin(turn)])
            steep = np.hypot(*tilt)
            towards = np.stack([*(tilt / steep * np.sin(steep)), np.cos(steep)], axis=1)
            lights = {
                f"light {number}": {
                    "type": "directional",
                    "direction": (-one).tolist(),
                    "irradiance": {"type": "rgb", "value": 1 / len(LIGHT)},
                }
                for number, one in enumerate(towards)
            }
            scene = {
                "type": "scene",
                "integrator": {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0},
                **lights,
                "panel": {"type": "rectangle", "material": bsdf},
                "camera": {
                    "type": "orthographic",
                    "to_world": mitsuba.ScalarTransform4f().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0]),
                    "film": {
                        "type": "hdrfilm",
                        "width": 256,
                        "height": 256,
                        "pixel_format": "rgb",
                        "rfilter": {"type": "box"},
                    },
                },
            }
            return float(np.array(mitsuba.render(mitsuba.load_dict(scene), spp=64)).mean())

        tilt = np.degrees(np.arctan(float(every["slope_rms"])))
        incidences = np.array([0.6, 1.2, 1.8, 2.4]) * tilt
        wanted, together, twice = (
            np.array([luminance(bsdf, theta) for theta in incidences]) for bsdf in (full, mapped(rest), mapped(full))
        )
        assert together == pytest.approx(wanted, rel=0.02)
        assert np.abs(twice / wanted - 1).max() > 0.1
    finally:
        if before is not None:
            mitsuba.set_variant(before)
