"""The small picture beside a material's name."""

from __future__ import annotations

import base64
from io import BytesIO

import numpy as np
import pytest
import samples
import xarray as xr
from PIL import Image

from brdfpipe import facets, flakes
from brdfpipe.appearance.preview import preview
from brdfpipe.bsdf import flake, lambert_gauss, microfacet
from brdfpipe.report.catalogue.rows import THUMBNAIL_SIDE, thumbnail


def metallic(**options) -> xr.Dataset:
    """The patent's metallic blue."""
    colours = {"45:-30": [33.90, -7.58, -36.61], "45:0": [12.29, 1.19, -25.77], "45:65": [3.07, 2.09, -13.24]}
    listed = [{"geometry": name, "lab": lab} for name, lab in colours.items()]
    return flake.build(flakes.ingest({"colours": listed, "illuminant": "D65", "observer": 10}), **options)


MATERIALS = {
    "matt": lambda: lambert_gauss.lambertian(samples.spectrum(0.3)),
    "satin": lambda: samples.beckmann_bsdf(0.2),
    "glossy": lambda: microfacet.build(facets.flat(), index=1.5, spectrum=samples.spectrum(0.3)),
    "flakes": metallic,
    "flakes below a coat": lambda: metallic(model="flake-physical"),
}


@pytest.fixture(scope="module")
def pictures() -> dict[str, xr.Dataset]:
    return {name: preview(make()) for name, make in MATERIALS.items()}


def decoded(uri: str) -> np.ndarray:
    """(THUMBNAIL_SIDE, THUMBNAIL_SIDE, 3)"""
    head, data = uri.split(",")
    assert head == "data:image/webp;base64"
    with Image.open(BytesIO(base64.b64decode(data))) as image:
        return np.asarray(image.convert("RGB")).astype(float)


def test_the_thumbnail_is_the_sphere_of_the_picture(pictures: dict[str, xr.Dataset]) -> None:
    for picture in pictures.values():
        sphere = picture["picture"].values[:, :256]
        exact = np.asarray(
            Image.fromarray(sphere).resize((THUMBNAIL_SIDE, THUMBNAIL_SIDE), Image.Resampling.BOX)
        ).astype(float)
        # What the compression may cost, of 255.
        assert np.abs(decoded(thumbnail(picture)) - exact).mean() < 2.0
        assert len(thumbnail(picture)) < 1500


def _lightness(picture: xr.Dataset) -> np.ndarray:
    """Of the sphere, its rim left out."""
    place = (np.arange(THUMBNAIL_SIDE) + 0.5) / THUMBNAIL_SIDE - 0.5
    inside = np.hypot(place[:, None], place) < 0.38
    return np.where(inside, decoded(thumbnail(picture)).mean(axis=2), np.nan)


def _sharpest(picture: xr.Dataset) -> float:
    shown = _lightness(picture)
    return float(np.nanmax(np.abs(np.diff(shown, axis=0))))


def test_gloss_shows_as_sharp_highlights(pictures: dict[str, xr.Dataset]) -> None:
    matt, satin, glossy = (_sharpest(pictures[name]) for name in ("matt", "satin", "glossy"))
    assert max(matt, satin) < glossy / 3
    assert _sharpest(pictures["flakes"]) < _sharpest(pictures["flakes below a coat"]) / 3


def test_flop_shows_as_a_fall_from_the_highlight(pictures: dict[str, xr.Dataset]) -> None:
    falls = {}
    for name in ("matt", "flakes"):
        shown = _lightness(pictures[name])
        falls[name] = float(np.nanpercentile(shown, 98) / np.nanmedian(shown))
    assert falls["flakes"] > 1.5 * falls["matt"]


def test_the_same_picture_gives_the_same_bytes(pictures: dict[str, xr.Dataset]) -> None:
    picture = pictures["flakes"]
    assert thumbnail(picture) == thumbnail(picture.copy(deep=True))


def test_a_picture_of_any_size_will_do() -> None:
    assert decoded(thumbnail(preview(lambert_gauss.lambertian(samples.spectrum(0.3)), side=32))).shape == (
        THUMBNAIL_SIDE,
        THUMBNAIL_SIDE,
        3,
    )
