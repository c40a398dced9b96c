"""The scene of a preview through Mitsuba 3, a renderer written apart from this package.

Mitsuba draws light at random: 32² pixels of 256 samples have a noise of some hundredths, which the means over a picture do not.
Each pixel is compared with the mean of 4 × 4 of the preview's.
"""

from __future__ import annotations

import numpy as np
import pytest
import samples
import xarray as xr

from brdfpipe import facets, vocabulary
from brdfpipe.appearance import preview_geometry as shots
from brdfpipe.appearance.lights import lights
from brdfpipe.appearance.preview import channels_of, radiance
from brdfpipe.appearance.transport import Table
from brdfpipe.bsdf import lambert_gauss, microfacet

mitsuba = pytest.importorskip("mitsuba", reason="Mitsuba is not there: make peers")

SIDE, FINER = 32, 4
STUDIO = lights("studio")
METAL, GLASS = (1.2, 7.0), (1.5, 0.0)


@pytest.fixture(scope="module", autouse=True)
def _colours():
    """Mitsuba's variant is global: the one found is put back."""
    before = mitsuba.variant()
    mitsuba.set_variant("scalar_rgb")
    yield
    if before is not None:
        mitsuba.set_variant(before)


def grey(value):
    return {"type": "rgb", "value": value}


def renderers_lights():
    """The studio as a map of the sphere: rows from pole to pole, columns from 0 to 360 degree, ends included as Mitsuba takes them."""
    rows = 1024
    polar, azimuth = np.meshgrid(np.linspace(0, np.pi, rows), np.arange(2 * rows) / rows * np.pi, indexing="ij")
    # Its own axis is y; turned by a quarter about x it is our z.
    x, y, z = np.sin(azimuth) * np.sin(polar), np.cos(polar), -np.cos(azimuth) * np.sin(polar)
    light = STUDIO.radiance(np.stack([x, -z, y], axis=-1))
    bitmap = mitsuba.Bitmap(np.repeat(light[..., None], 3, axis=-1).astype(np.float32))
    return {"type": "envmap", "bitmap": bitmap, "to_world": mitsuba.ScalarTransform4f().rotate([1, 0, 0], 90)}


def renderers_picture(subject, material, spp):
    transform = mitsuba.ScalarTransform4f()
    film = {"type": "hdrfilm", "width": SIDE, "height": SIDE, "pixel_format": "rgb", "rfilter": {"type": "box"}}
    place = transform.look_at([0, -shots.PANEL_DISTANCE, 0], [0, 0, 0], [0, 0, 1])
    if subject == "sphere":
        half = 0.5 / shots.SPHERE_RADIUS
        camera = {"type": "orthographic", "to_world": place @ transform.scale([half, half, 1])}
        shape = {"type": "sphere"}
    else:
        normal = (np.array(shots.PANEL_NORMAL) / np.linalg.norm(shots.PANEL_NORMAL)).tolist()
        field = float(2 * np.degrees(np.arctan(shots.PANEL_FIELD)))
        camera = {"type": "perspective", "fov": field, "fov_axis": "x", "to_world": place}
        shape = {"type": "rectangle", "to_world": transform.look_at([0, 0, 0], normal, [0, 0, 1])}
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 2, "hide_emitters": True},
        "shape": shape | {"bsdf": material},
        "lights": renderers_lights(),
        "camera": camera | {"film": film},
    }
    return np.array(mitsuba.render(mitsuba.load_dict(scene), spp=spp), dtype=float)[..., 1] * STUDIO.exposure


def own_picture(subject, bsdf):
    """The same, and which pixels the subject covers whole."""
    shot = {"sphere": shots.sphere, "panel": shots.panel}[subject](SIDE * FINER)
    fine = np.zeros(shot.coverage.shape)
    fine[shot.coverage > 0] = radiance(Table.of(bsdf, *channels_of(bsdf)), shot, STUDIO)[:, 1]
    blocks = (SIDE, FINER, SIDE, FINER)
    return fine.reshape(blocks).mean(axis=(1, 3)), (shot.coverage == 1).reshape(blocks).all(axis=(1, 3))


def own_material(distribution, index):
    n, k = index
    refractive = xr.Dataset(
        {"n": ("wavelength", [n, n]), "k": ("wavelength", [k, k])},
        coords={"wavelength": [360.0, 780.0]},
        attrs={"source": "a number", "dispersion": "constant"},
    )
    return microfacet.build(
        distribution, index=vocabulary.label(refractive, "index"), diffuse="none", multiple_scattering="none"
    )


def rough_metal(**widths):
    return {"type": "roughconductor", "distribution": "beckmann", "eta": grey(METAL[0]), "k": grey(METAL[1]), **widths}


@pytest.mark.parametrize("subject", ["sphere", "panel"])
@pytest.mark.parametrize(
    ("theirs", "ours"),
    [
        ({"type": "diffuse", "reflectance": grey(0.8)}, lambda: lambert_gauss.lambertian(samples.spectrum(0.8))),
        (rough_metal(alpha=0.2), lambda: own_material(facets.analytic("beckmann", 0.2), METAL)),
        (
            rough_metal(alpha_u=0.05, alpha_v=0.3),
            lambda: own_material(facets.analytic("beckmann", a_x=0.05, a_y=0.3), METAL),
        ),
        ({"type": "conductor", "eta": grey(METAL[0]), "k": grey(METAL[1])}, lambda: own_material(facets.flat(), METAL)),
    ],
    ids=["matt", "rough metal", "brushed metal", "mirror"],
)
def test_the_preview_shows_what_mitsuba_renders(subject, theirs, ours):
    expected = renderers_picture(subject, theirs, 256)
    picture, whole = own_picture(subject, ours())
    difference = (picture - expected)[whole]
    # Mitsuba's masking is a rational fit of Smith's, off by up to 3e-3.
    assert difference.mean() == pytest.approx(0, abs=0.008 * expected[whole].mean())
    assert np.sqrt(np.mean(difference**2)) < 0.05


def test_gloss_over_glass_is_what_mitsuba_renders():
    # Of the sphere alone: what enters it meets the light no more within one reflection.
    glass = {"type": "roughdielectric", "distribution": "beckmann", "alpha": 0.2, "int_ior": GLASS[0], "ext_ior": 1.0}
    expected = renderers_picture("sphere", glass, 512)
    picture, whole = own_picture("sphere", own_material(facets.analytic("beckmann", 0.2), GLASS))
    difference = (picture - expected)[whole]
    assert difference.mean() == pytest.approx(0, abs=0.02 * expected[whole].mean())
    assert np.sqrt(np.mean(difference**2)) < 0.1 * expected[whole].max()
