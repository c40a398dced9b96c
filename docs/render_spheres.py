"""Draw docs/programs/mitsuba.png, spheres of the preview above those of Mitsuba: ``python docs/render_spheres.py [FILE]``; needs ``make peers``.

It prints how far the mean of the pixels, and single pixels, of both differ. Mitsuba draws light at random, from a fixed seed.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import mitsuba
import numpy as np
import xarray as xr
from PIL import Image

from brdfpipe import facets, spectra
from brdfpipe.appearance import preview
from brdfpipe.appearance.lights import lights
from brdfpipe.appearance.preview_geometry import SPHERE_RADIUS, sphere
from brdfpipe.appearance.transport import Table
from brdfpipe.bsdf.microfacet.builder import build
from brdfpipe.geometry import Array
from brdfpipe.mitsuba import material
from brdfpipe.optics.index import refractive_index
from brdfpipe.spectra.colorimetry import encoded_srgb

SIDE, SAMPLES = 120, 512
BACKGROUND = 0.8
STUDIO = lights("studio")


def materials() -> dict[str, xr.Dataset]:
    """A satin red, a brushed black and a polished red plastic."""
    index, red = refractive_index(1.5), spectra.recover([38, 22, 15], illuminant="D65", observer=10)
    made = {
        "satin": build(facets.analytic("beckmann", 0.12 * np.sqrt(2)), index=index, spectrum=red),
        "brushed": build(facets.analytic("beckmann", a_x=0.09 * np.sqrt(2), a_y=0.25 * np.sqrt(2)), index=index),
        "polished": build(facets.flat(), index=index, spectrum=red),
    }
    return {name: bsdf.assign_attrs(material=name) for name, bsdf in made.items()}


def own_picture(bsdf: xr.Dataset) -> Array:
    """The sphere of the preview, linear, (SIDE, SIDE, 3)."""
    shot, picture = sphere(SIDE), np.zeros((SIDE, SIDE, 3))
    picture[shot.coverage > 0] = preview.radiance(Table.of(bsdf, *preview.channels_of(bsdf)), shot, STUDIO)
    return picture


def rendered(bsdf: dict[str, object]) -> Array:
    """The same sphere in the same light by Mitsuba."""
    rows = 1024
    polar, azimuth = np.meshgrid(np.linspace(0, np.pi, rows), np.arange(2 * rows) / rows * np.pi, indexing="ij")
    # The axis of Mitsuba's map is y; turned by a quarter about x it is the vertical z of the preview.
    x, y, z = np.sin(azimuth) * np.sin(polar), np.cos(polar), -np.cos(azimuth) * np.sin(polar)
    light = np.repeat(STUDIO.radiance(np.stack([x, -z, y], axis=-1))[..., None], 3, axis=-1)
    half, transform = 0.5 / SPHERE_RADIUS, mitsuba.ScalarTransform4f()
    place = transform.look_at([0, -5, 0], [0, 0, 0], [0, 0, 1]) @ transform.scale([half, half, 1])
    film = {"type": "hdrfilm", "width": SIDE, "height": SIDE, "pixel_format": "rgb", "rfilter": {"type": "box"}}
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 2, "hide_emitters": True},
        "ball": {"type": "sphere", "material": bsdf},
        "around": {
            "type": "envmap",
            "bitmap": mitsuba.Bitmap(light.astype(np.float32)),
            "to_world": transform.rotate([1, 0, 0], 90),
        },
        "camera": {"type": "orthographic", "to_world": place, "film": film},
    }
    return np.array(mitsuba.render(mitsuba.load_dict(scene), spp=SAMPLES, seed=1), dtype=float) * STUDIO.exposure


def main() -> None:
    """Draw the picture and print the differences."""
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent / "programs" / "mitsuba.png"
    mitsuba.set_variant("llvm_ad_rgb")
    coverage, columns = sphere(SIDE).coverage[..., None], []
    with tempfile.TemporaryDirectory() as folder:
        for name, bsdf in materials().items():
            pair = own_picture(bsdf), rendered(material(bsdf, folder))
            inside = coverage[..., 0] == 1
            ours, theirs = (one[inside] for one in pair)
            rms = np.sqrt(np.mean((theirs - ours) ** 2)) / ours.mean()
            print(f"{name}: mean {theirs.mean() / ours.mean() - 1:+.2%}, single pixels {rms:.1%} rms")
            # Mitsuba's pixels at the edge are already weighted with their share of the sphere.
            weighted = pair[0] * coverage, pair[1]
            columns.append(np.concatenate([preview.tone(one) + (1 - coverage) * BACKGROUND for one in weighted]))
    picture = (255 * encoded_srgb(np.concatenate(columns, axis=1))).round().astype(np.uint8)
    Image.fromarray(picture).quantize(128).save(target, optimize=True)


if __name__ == "__main__":
    main()
