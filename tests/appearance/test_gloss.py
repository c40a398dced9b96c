"""Gloss, against the reference values and independent integrals."""

from __future__ import annotations

import numpy as np
import pytest
import samples

from brdfpipe import facets, optics
from brdfpipe.appearance import gloss as of
from brdfpipe.appearance.gloss import GlossError, _directions, _rectangle
from brdfpipe.bsdf import lambert_gauss, microfacet


def rough(a, n=1.5):
    return microfacet.build(facets.analytic("beckmann", a), index=optics.refractive_index(n))


@pytest.mark.parametrize(("a", "printed"), [(0.05, (5.1526, 36.5641, 37.1876)), (0.20, (0.3416, 5.1028, 6.0225))])
def test_gloss_of_a_rough_dielectric_is_the_printed_one(a, printed):
    assert of(rough(a)).values == pytest.approx(printed, abs=5.1e-5)


def test_gloss_of_a_white_lambertian_is_the_printed_one():
    white = lambert_gauss.lambertian(samples.spectrum(1.0))
    assert of(white).values == pytest.approx((1.2025, 2.4841, 0.03273), rel=2e-4)


@pytest.mark.parametrize("angle", [20.0, 60.0, 85.0])
def test_gloss_of_black_glass_is_100_at_every_angle(angle):
    # The smoother, the nearer to polished; 1e-4 is smooth to the receptor at every geometry.
    assert float(of(rough(1e-4, n=1.567), [angle])[0]) == pytest.approx(100, abs=1e-3)


def test_gloss_of_a_polished_dielectric_is_its_reflectance_over_the_source():
    angles = (20.0, 60.0, 85.0)
    on_axis = [82.0452, 89.1368, 98.9746]
    exact = []
    for angle in angles:
        u, v, weight = _rectangle()
        cos = np.cos(np.radians(_directions(u, v, angle)[0]))
        reflected = [np.sum(weight * cos * optics.fresnel(cos, n)[2]) for n in (1.5, 1.567)]
        exact.append(100 * reflected[0] / reflected[1])
    found = of(rough(1e-4), angles).values
    assert found == pytest.approx(exact, rel=1e-6)
    # The printed values are the ratio on the axis; the aperture adds 2e-5.
    assert found == pytest.approx(on_axis, rel=3e-5)


@pytest.mark.parametrize("a", [0.01, 0.1, 0.5])
def test_gloss_agrees_with_a_monte_carlo_of_the_apertures(a):
    rng = np.random.default_rng(11)
    bsdf, angle, n = rough(a), 60.0, 400_000
    half = [np.tan(np.radians(full) / 2) for full in (0.75, 2.5, 4.4, 11.7)]
    u, v, up, vp = (rng.uniform(-h, h, n) for h in half)
    theta_i, phi_i = _directions(u, v, angle)
    theta_o, phi_o = _directions(up, vp, angle)
    f = bsdf.bsdf.evaluate(theta_i, phi_i, theta_o, phi_o + 180).values
    flux = f * np.cos(np.radians(theta_i)) * np.cos(np.radians(theta_o))
    flux *= ((1 + u**2 + v**2) * (1 + up**2 + vp**2)) ** -1.5 * 4 * half[2] * half[3]
    cos = np.cos(np.radians(theta_i))
    glass = np.mean(optics.fresnel(cos, 1.567)[2] * cos * (1 + u**2 + v**2) ** -1.5)
    mean, sigma = 100 * flux.mean() / glass, 100 * flux.std() / np.sqrt(n) / glass
    assert abs(float(of(bsdf, [angle])[0]) - mean) < 3.5 * sigma


def test_gloss_falls_with_roughness():
    values = np.array([of(rough(a)).values for a in (0.01, 0.02, 0.05, 0.1, 0.2, 0.4)])
    assert (np.diff(values, axis=0) < 0).all()


@pytest.mark.parametrize("a", [1e-5, 1e-4, 1e-3])
def test_gloss_of_a_narrow_lobe_with_a_long_tail_counts_all_of_it(a):
    # Nearly polished: what GGX's tail carries beyond the receptor is of order (a / half aperture)².
    bsdf = microfacet.build(facets.analytic("ggx", a), index=optics.refractive_index(1.567))
    assert float(of(bsdf, [60.0])[0]) == pytest.approx(100, abs=100 * (4 * a / 0.02) ** 2 + 0.01)


def test_gloss_of_a_polished_surface_is_the_limit_of_smooth_ones():
    polished = microfacet.build(facets.flat(), index=1.5)
    assert of(polished).values == pytest.approx((82.0454, 89.1385, 98.9730), abs=5e-5)
    assert of(polished).values == pytest.approx(of(rough(1e-4)).values, rel=1e-6)
    assert of(microfacet.build(facets.flat(), index=1.567)).values == pytest.approx(100, abs=1e-9)


def test_a_base_below_a_polished_surface_adds_to_its_gloss():
    base = of(microfacet.build(facets.flat(), index=1.5, spectrum=samples.spectrum(0.5))).values
    smooth, limit = (
        of(microfacet.build(facets.flat(), index=1.5)).values,
        of(samples.beckmann_bsdf(1e-4 / np.sqrt(2), n=1.5, reflectance=0.5)).values,
    )
    assert (base > smooth).all()
    assert base == pytest.approx(limit, rel=1e-5)


def lay(azimuth, a_x=0.02, a_y=0.2):
    return microfacet.build(facets.analytic("beckmann", a_x=a_x, a_y=a_y, azimuth=azimuth), index=1.5)


def test_gloss_turns_with_the_lay():
    along, turned = of(lay(0), [60.0], azimuth=0), of(lay(30), [60.0], azimuth=30)
    assert float(turned[0]) == pytest.approx(float(along[0]), rel=1e-5)
    assert float(along[0]) > 3 * float(of(lay(0), [60.0], azimuth=90)[0])


def test_gloss_of_a_surface_with_a_lay_is_the_mean_over_the_azimuth():
    angle, brushed = 85.0, lay(30)
    around = [float(of(brushed, [angle], azimuth=azimuth)[0]) for azimuth in np.arange(0.0, 180.0, 3.75)]
    # Half a turn leaves this surface as it was; the peak along the lay is 15° wide.
    assert float(of(brushed, [angle])[0]) == pytest.approx(np.mean(around), rel=1e-3)


def test_gloss_with_a_lay_that_is_hardly_one_is_that_without():
    almost = lay(0, 0.1, 0.1001)
    assert of(almost, [60.0]).values == pytest.approx(of(rough(0.10005), [60.0]).values, rel=1e-4)


def test_an_unknown_geometry_is_refused():
    with pytest.raises(GlossError, match="no gloss geometry 45°; accepted: 20, 60, 85"):
        of(rough(0.1), [45])


def test_the_plane_of_the_receptor_touches_its_axis():
    theta, phi = _directions(np.array([0.0, 0.01]), np.array([0.0, 0.0]), 60.0)
    assert theta == pytest.approx([60.0, 60.0 + np.degrees(np.arctan(0.01))])
    assert phi == pytest.approx([0.0, 0.0])
