from __future__ import annotations

import numpy as np
import pytest
import samples
from samples import beckmann_bsdf, spectrum

from brdfpipe.bsdf import microfacet
from brdfpipe.bsdf.lambert_gauss import lambertian
from brdfpipe.bsdf.registry import representation
from brdfpipe.facets import analytic, flat
from brdfpipe.report.plots import bsdf_sections


def test_an_isotropic_surface_has_one_plane_and_one_with_a_lay_two() -> None:
    assert [plane.words for plane in bsdf_sections.planes(beckmann_bsdf())] == [""]
    brushed = samples.brushed_bsdf(0.1, 0.4, 30.0)
    azimuths = bsdf_sections.planes(brushed)
    assert [plane.words for plane in azimuths] == ["along the lay", "across the lay"]
    # The lay is the azimuth of the smaller slope, which is that of a_x.
    assert [plane.azimuth for plane in azimuths] == pytest.approx([30.0, 120.0], abs=0.1)


def test_light_comes_from_the_side_opposite_to_the_positive_angles() -> None:
    theta, value = bsdf_sections.cut(beckmann_bsdf(0.05), bsdf_sections.Plane(70.0, ""), 45.0)
    # At a slope of 0.05 the shift of the peak from the mirror direction is below a degree.
    assert theta[np.argmax(value)] == pytest.approx(45.0, abs=1.0)


def test_a_cut_of_a_narrow_lobe_contains_its_peak() -> None:
    bsdf = beckmann_bsdf(1e-4, reflectance=None)
    theta, value = bsdf_sections.cut(bsdf, bsdf_sections.planes(bsdf)[0], 30.0)
    exact = float(bsdf.bsdf.evaluate(30.0, 0.0, 30.0, 180.0))
    assert value.max() == pytest.approx(exact, rel=1e-9)
    half = theta[value > exact / 2]
    assert half.size > 4  # and its width: several samples between its half maxima


def test_transmitted_light_peaks_at_the_refracted_direction() -> None:
    glass = microfacet.build(analytic("beckmann", 0.05), index=1.5, transparent=True)
    theta, value = bsdf_sections.cut(glass, bsdf_sections.planes(glass)[0], 45.0, through=True)
    inner = np.degrees(np.arcsin(np.sin(np.radians(45.0)) / 1.5))
    assert theta[np.argmax(value)] == pytest.approx(inner, abs=0.5)


def test_without_its_base_a_bsdf_reflects_less_and_not_nothing() -> None:
    bsdf = beckmann_bsdf()
    facets = representation(bsdf).without_diffuse()
    assert facets is not None
    plane, theta = bsdf_sections.planes(bsdf)[0], np.array([8.0])
    # Fresnel's reflectance of n = 1.55 near the normal, less a little masking.
    assert bsdf_sections.reflectance(facets, plane, theta)[0] == pytest.approx((0.55 / 2.55) ** 2, rel=0.02)
    assert bsdf_sections.reflectance(bsdf, plane, theta)[0] == pytest.approx(0.3, abs=1e-6)


def test_a_table_does_not_distinguish_its_parts() -> None:
    table = beckmann_bsdf().bsdf.tabulate({"theta_i": [0.0, 80.0], "theta_o": [0.0, 80.0], "phi_o": [0.0, 180.0]})
    assert representation(table).without_diffuse() is None


def test_only_a_compensated_bsdf_has_a_part_that_was_reflected_once() -> None:
    rough = analytic("ggx", 0.6)
    assert representation(microfacet.build(rough, index=1.5, multiple_scattering="none")).single_reflection() is None
    given_back = microfacet.build(rough, index=1.5, multiple_scattering="compensated")
    once = representation(given_back).single_reflection()
    plain = microfacet.build(rough, index=1.5, multiple_scattering="none")
    assert once is not None
    plane, theta = bsdf_sections.Plane(0.0, ""), np.array([0.0, 60.0])
    np.testing.assert_allclose(
        bsdf_sections.reflectance(once, plane, theta), bsdf_sections.reflectance(plain, plane, theta), rtol=1e-9
    )


def test_a_flat_surface_reflects_into_one_direction() -> None:
    mirrored, refracted = bsdf_sections.specular(microfacet.build(flat(), index=1.5, transparent=True), np.array([0.0]))
    assert mirrored == pytest.approx([0.04], rel=1e-12)  # (n − 1)² / (n + 1)²
    assert refracted == pytest.approx([0.96], rel=1e-12)


def test_the_wavelength_shown_is_the_nearest_of_its_own() -> None:
    assert bsdf_sections.wavelength_words(lambertian(spectrum(0.3))) == "at 550 nm"
    assert bsdf_sections.wavelength_words(beckmann_bsdf(reflectance=None)) == "all wavelengths alike"


def test_rounding_errors_are_no_light() -> None:
    nearly_black = lambertian(spectrum(1e-15))
    assert not bsdf_sections.value(nearly_black, bsdf_sections.Plane(0.0, ""), 45.0, np.array([0.0, 60.0]), 0.0).any()
