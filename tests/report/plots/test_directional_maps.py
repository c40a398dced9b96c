from __future__ import annotations

import io
import re
from base64 import b64decode
from xml.etree import ElementTree

import numpy as np
import pytest
import samples
import xarray as xr
from PIL import Image
from samples import beckmann_bsdf, spectrum

from brdfpipe.bsdf import microfacet
from brdfpipe.bsdf.lambert_gauss import lambertian
from brdfpipe.bsdf.registry import representation
from brdfpipe.facets import analytic, flat
from brdfpipe.report.plots import bsdf_sections, directional_maps
from brdfpipe.report.plots.svg import Figure


def _picture(svg: str) -> np.ndarray:
    """RGBA of the disc."""
    data = re.search(r"data:image/png;base64,([^\"]+)", svg)
    assert data is not None
    return np.asarray(Image.open(io.BytesIO(b64decode(data[1]))).convert("RGBA")).astype(int)


def _maps(bsdf: xr.Dataset) -> list[Figure]:
    figures = list(directional_maps.directional_maps(bsdf))
    for figure in figures:
        if figure.svg:
            ElementTree.fromstring(figure.svg)
    return figures


def test_the_map_is_brightest_on_the_side_of_the_mirror_direction() -> None:
    (figure,) = _maps(beckmann_bsdf(0.1))
    picture = _picture(figure.svg)
    lightness = picture[..., :3] @ [0.2126, 0.7152, 0.0722]
    row, column = np.unravel_index(np.argmax(np.where(picture[..., 3] > 0, lightness, 0)), lightness.shape)
    size = lightness.shape[0]
    assert column > 0.75 * size  # sin 45° = 0.71 of the radius, to the right
    assert abs(row - size / 2) < 0.1 * size


def test_nothing_is_painted_outside_the_hemisphere() -> None:
    picture = _picture(_maps(beckmann_bsdf())[0].svg)
    assert not picture[:5, :5, 3].any()
    assert (picture[picture.shape[0] // 2, 5:-5, 3] == 255).all()


def test_a_lobe_narrower_than_a_pixel_keeps_its_peak() -> None:
    bsdf = beckmann_bsdf(1e-4)
    (figure,) = _maps(bsdf)
    exact = float(bsdf.bsdf.evaluate(45.0, 0.0, 45.0, 180.0, wavelength=[550.0]).squeeze())
    match = re.search(r"largest ([\d.×⁰¹²³⁴⁵⁶⁷⁸⁹]+) sr", figure.note)
    assert match is not None
    mantissa, _, power = match[1].partition("×10")
    shown = float(mantissa) * 10 ** int(power.translate(str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹", "0123456789")) or 0)
    assert shown == pytest.approx(exact, rel=5e-3)  # three digits


def test_a_lay_gives_two_maps_and_marks_the_lay() -> None:
    along, across = _maps(samples.brushed_bsdf(0.1, 0.4, 30.0))
    assert along.title.endswith("along the lay")
    assert across.title.endswith("across the lay")
    assert "The dashed line is the lay." in along.note
    # Light along the lay is spread across it: the bright streak stands upright in one picture and lies in the other.
    widths = []
    for figure in (along, across):
        bright = _picture(figure.svg)[..., 1] > 150
        rows, columns = np.nonzero(bright)
        widths.append(np.ptp(rows) / np.ptp(columns))
    assert widths[0] > 2 > 0.5 > widths[1]


def test_transmitted_light_has_its_own_map() -> None:
    reflected, passed = _maps(microfacet.build(analytic("ggx", 0.2), index=1.5, transparent=True))
    assert reflected.title.startswith("BRDF")
    assert passed.title.startswith("BTDF")
    assert "Blank: no light." in passed.note  # beyond the critical angle nothing is refracted towards the source


def test_a_perfect_diffuser_is_a_sentence() -> None:
    (figure,) = _maps(lambertian(spectrum(0.3)))
    assert not figure.svg
    assert "Constant over all directions, 0.0955 sr⁻¹" in figure.note  # 0.3 / π


def test_a_smooth_interface_has_no_map() -> None:
    assert _maps(microfacet.build(flat(), index=1.5, transparent=True)) == []


def test_a_black_material_has_no_map() -> None:
    assert _maps(lambertian(spectrum(0.0))) == []


def test_maps_and_cuts_agree_in_the_plane_of_incidence() -> None:
    bsdf = samples.brushed_bsdf(0.1, 0.4, 30.0)
    plane = bsdf_sections.planes(bsdf)[1]
    theta, cut = bsdf_sections.cut(bsdf, plane, 45.0)
    mapped = bsdf_sections.value(bsdf, plane, 45.0, np.abs(theta), np.where(theta < 0, 180.0, 0.0))
    np.testing.assert_array_equal(cut, mapped)


def test_half_of_a_map_gives_the_values_of_all_its_pixels() -> None:
    bsdf = samples.beckmann_bsdf(0.1, n=1.5)
    assert representation(bsdf).mirror_symmetric
    plane, pixels = bsdf_sections.planes(bsdf)[0], directional_maps._HemispherePixels(45.0)
    all_pixels = bsdf_sections.value(bsdf, plane, 45.0, pixels.theta, pixels.turn)
    np.testing.assert_allclose(pixels.values(bsdf, plane, 45.0), all_pixels, rtol=1e-9)
