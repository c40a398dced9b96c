"""Gloss, against the reference values and independent integrals."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import samples

from brdfpipe import facets, flakes, optics
from brdfpipe.appearance import apertures
from brdfpipe.appearance import gloss as gloss_units
from brdfpipe.appearance.apertures import directions
from brdfpipe.appearance.gloss_meter import (
    RECEPTOR,
    RECEPTOR_TOLERANCE,
    SOURCE_TOLERANCE,
    GlossError,
    beam_of,
    gloss_and_haze,
    gloss_with_uncertainty,
)
from brdfpipe.bsdf import flake, lambert_gauss, microfacet
from brdfpipe.bsdf.nonspectral import nonspectral


def rough(a, n=1.5):
    return samples.glossy_bsdf(a, n)


@pytest.mark.parametrize(("a", "printed"), [(0.05, (5.1526, 36.5641, 37.1876)), (0.20, (0.3416, 5.1028, 6.0225))])
def test_gloss_of_a_rough_dielectric_is_the_printed_one(a, printed):
    assert gloss_units(rough(a)).values == pytest.approx(printed, abs=5.1e-5)


def test_gloss_of_a_white_lambertian_is_the_printed_one():
    white = lambert_gauss.lambertian(samples.spectrum(1.0))
    assert gloss_units(white).values == pytest.approx((1.2025, 2.4841, 0.03273), rel=2e-4)


@pytest.mark.parametrize("angle", [20.0, 60.0, 85.0])
def test_gloss_of_black_glass_is_100_at_every_angle(angle):
    # The smoother, the nearer to polished; 1e-4 is smooth to the receptor at every geometry.
    assert float(gloss_units(rough(1e-4, n=1.567), [angle])[0]) == pytest.approx(100, abs=1e-3)


@pytest.mark.parametrize("angle", [20.0, 85.0])
def test_points_on_both_sides_of_the_plane_of_incidence_receive_the_same_light(angle):
    sample = apertures.sample_of(rough(0.05), None)
    beam = beam_of(angle, apertures.QUICK)
    # Not exactly symmetric: every point of the source is evaluated.
    window = beam.window._replace(low_v=np.nextafter(beam.window.low_v, 0.0))
    one_side, both_sides = (
        apertures.received(sample, [beam._replace(window=either)], np.zeros(1))[0] for either in (beam.window, window)
    )
    assert one_side == pytest.approx(both_sides, rel=1e-9)
    nodes = [
        apertures.Receptors.of(sample, [beam._replace(window=either)]).nodes[0] for either in (beam.window, window)
    ]
    assert nodes[0].weight.size < 0.6 * nodes[1].weight.size


def test_gloss_of_a_polished_dielectric_is_its_reflectance_over_the_source():
    angles = (20.0, 60.0, 85.0)
    on_axis = [82.0452, 89.1368, 98.9746]
    exact = []
    for angle in angles:
        light = apertures.source(angle, apertures.FINE)
        cos = np.cos(np.radians(light.theta))
        reflected = [np.sum(light.weight * optics.fresnel(cos, n)[2]) for n in (1.5, 1.567)]
        exact.append(100 * reflected[0] / reflected[1])
    gloss = gloss_units(rough(1e-4), angles).values
    assert gloss == pytest.approx(exact, rel=1e-6)
    # The printed values are the ratio on the axis; the aperture adds 2e-5.
    assert gloss == pytest.approx(on_axis, rel=3e-5)


def sides(angle):
    """Half widths of source and receptor in the tangent plane, in the plane of incidence and across it."""
    receptor = {20.0: (1.8, 3.6), 60.0: (4.4, 11.7), 85.0: (4.0, 6.0)}[angle]
    return [np.tan(np.radians(full) / 2) for full in (0.75, 2.5, *receptor)]


def aperture_flux(bsdf, angle, azimuth, u, v, up, vp):
    """What goes from points of the source to points of the receptor, and what black glass would mirror of it."""
    theta_i, phi_i = directions(u, v, angle)
    theta_o, phi_o = directions(up, vp, angle)
    f = bsdf.bsdf.evaluate(theta_i, phi_i + azimuth, theta_o, phi_o + azimuth + 180).values
    sent = np.cos(np.radians(theta_i)) * (1 + u**2 + v**2) ** -1.5
    flux = f * sent * np.cos(np.radians(theta_o)) * (1 + up**2 + vp**2) ** -1.5
    return flux, sent * optics.fresnel(np.cos(np.radians(theta_i)), 1.567)[2]


def brute_force(bsdf, angle, points=(8, 10, 60, 200), azimuth=0.0):
    """Gauss and Legendre's rule over both rectangles, one panel each: 200 points across, for a lobe 40 times narrower at 85°."""
    nodes, weights = zip(*(np.polynomial.legendre.leggauss(n) for n in points), strict=True)
    at = np.meshgrid(*(half * node for half, node in zip(sides(angle), nodes, strict=True)), indexing="ij")
    flux, glass = aperture_flux(bsdf, angle, azimuth, *(angles.ravel() for angles in at))
    over_receptor = np.einsum("abcd,a,b,c,d", flux.reshape(points), *weights, optimize=True)
    over_source = np.einsum("ab,a,b", glass.reshape(points)[:, :, 0, 0], *weights[:2])
    half_u, half_v = sides(angle)[2:]
    return 100 * over_receptor * half_u * half_v / over_source


def monte_carlo(bsdf, angle, n, seed, azimuth=0.0):
    rng = np.random.default_rng(seed)
    half = sides(angle)
    flux, glass = aperture_flux(bsdf, angle, azimuth, *(rng.uniform(-h, h, n) for h in half))
    scale = 100 * 4 * half[2] * half[3] / glass.mean()
    return scale * flux.mean(), scale * flux.std() / np.sqrt(n)


def counted(bsdf, angle, n, seed, azimuth=0.0):
    """Light that the sampler of the BSDF sends to where the receptor is, found by the two angles from its axis."""
    (nodes_u, weights_u), (nodes_v, weights_v) = (np.polynomial.legendre.leggauss(points) for points in (3, 4))
    # Of a source this small, angles serve as well as points of its tangent plane.
    source = [
        (angle + 0.375 * u, 1.25 * v / np.sin(np.radians(angle)), wu * wv)
        for u, wu in zip(nodes_u, weights_u, strict=True)
        for v, wv in zip(nodes_v, weights_v, strict=True)
    ]
    full_u, full_v = {20.0: (1.8, 3.6), 60.0: (4.4, 11.7), 85.0: (4.0, 6.0)}[angle]
    mirror, along = np.radians(angle), np.radians(azimuth + 180)
    total = variance = glass = 0.0
    for k, (theta, phi, weight) in enumerate(source):
        drawn = bsdf.bsdf.sample(n, seed + k, theta, phi + azimuth)
        polar, turn = np.radians(drawn["theta_o"].values), np.radians(drawn["phi_o"].values) - along
        x, y, z = np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)
        forward = x * np.sin(mirror) + z * np.cos(mirror)
        beyond = np.degrees(np.arctan2(x * np.cos(mirror) - z * np.sin(mirror), forward))
        aside = np.degrees(np.arctan2(y, forward))
        seen = (np.abs(beyond) <= full_u / 2) & (np.abs(aside) <= full_v / 2)
        light = drawn["weight"].values.reshape(-1) * seen
        sent = weight * np.cos(np.radians(theta)) * np.sin(np.radians(theta))
        total, variance = total + sent * light.mean(), variance + sent**2 * light.var() / n
        glass += sent * float(optics.fresnel(np.cos(np.radians(theta)), 1.567)[2])
    return 100 * total / glass, 100 * np.sqrt(variance) / glass


ANGLES = [20.0, 60.0, 85.0]


@pytest.mark.cases(2)
@pytest.mark.parametrize(("a", "angle"), [(0.01, 20.0), (0.01, 85.0), (0.05, 60.0), (0.5, 60.0)])
def test_gloss_agrees_with_one_panel_of_many_points(a, angle):
    assert float(gloss_units(rough(a), [angle])[0]) == pytest.approx(brute_force(rough(a), angle), rel=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("a", [0.01, 0.015, 0.02, 0.03, 0.05, 0.1, 0.2, 0.35, 0.5])
@pytest.mark.parametrize("angle", ANGLES)
def test_gloss_agrees_with_one_panel_of_many_points_at_any_roughness(a, angle):
    # The rules of both are far finer than what is asked for: 1e-4.
    assert float(gloss_units(rough(a), [angle])[0]) == pytest.approx(brute_force(rough(a), angle), rel=1e-5)


@pytest.mark.cases(1)
@pytest.mark.parametrize("a", [0.01, 0.1, 0.5])
def test_gloss_agrees_with_a_monte_carlo_of_the_apertures(a):
    mean, sigma = monte_carlo(rough(a), 60.0, 400_000, seed=11)
    assert abs(float(gloss_units(rough(a), [60.0])[0]) - mean) < 3 * sigma


ROUGHNESSES = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5]


@pytest.mark.slow
@pytest.mark.parametrize("a", ROUGHNESSES)
@pytest.mark.parametrize("angle", ANGLES)
def test_gloss_agrees_with_a_monte_carlo_of_the_apertures_at_every_angle(a, angle):
    mean, sigma = monte_carlo(rough(a), angle, 2_000_000, seed=5)
    assert sigma < 5e-3 * mean
    assert abs(float(gloss_units(rough(a), [angle])[0]) - mean) < 3 * sigma


@pytest.mark.cases(1)
@pytest.mark.parametrize(("a", "angle"), [(0.02, 20.0), (0.05, 85.0), (0.1, 60.0)])
def test_gloss_is_the_light_that_is_sampled_into_the_receptor(a, angle):
    mean, sigma = counted(rough(a), angle, 20_000, seed=17)
    assert sigma < 0.02 * mean
    assert abs(float(gloss_units(rough(a), [angle])[0]) - mean) < 3 * sigma


@pytest.mark.slow
@pytest.mark.parametrize("a", ROUGHNESSES)
@pytest.mark.parametrize("angle", ANGLES)
def test_gloss_is_the_light_that_is_sampled_into_the_receptor_at_every_angle(a, angle):
    mean, sigma = counted(rough(a), angle, 100_000, seed=23)
    # A matt surface sends one ray in a thousand into the receptor at 20°.
    assert sigma < 0.05 * mean
    assert abs(float(gloss_units(rough(a), [angle])[0]) - mean) < 3 * sigma


@cache
def lay(azimuth, a_x=0.02, a_y=0.2):
    return samples.brushed_bsdf(a_x, a_y, azimuth)


@cache
def paint(**options):
    """The metallic blue of the patent; neutral, as a gloss meter sees it."""
    labs = {"45:-30": (33.90, -7.58, -36.61), "45:0": (12.29, 1.19, -25.77), "45:65": (3.07, 2.09, -13.24)}
    listed = [{"geometry": name, "lab": list(lab)} for name, lab in labs.items()]
    given = flakes.ingest({"colours": listed, "illuminant": "D65", "observer": 10})
    return nonspectral(flake.build(given, index=1.524, **options))


OTHERS = {
    "flakes": lambda: paint(),
    "flakes under a rough coat": lambda: paint(model="flake-physical", clear_coat=0.02),
    "a lay": lambda: lay(30, 0.05, 0.3),
    "a fine lay": lambda: lay(30),
}
QUICK_OTHERS = [("flakes", 60.0), ("flakes under a rough coat", 20.0), ("a lay", 85.0)]


@pytest.mark.cases(1)
@pytest.mark.parametrize(("name", "angle"), QUICK_OTHERS)
def test_gloss_of_other_bsdfs_agrees_with_one_panel_of_many_points(name, angle):
    bsdf = OTHERS[name]()
    gloss = float(gloss_units(bsdf, [angle], azimuth=13.0)[0])
    assert gloss == pytest.approx(brute_force(bsdf, angle, azimuth=13.0), rel=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("name", OTHERS)
@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize("azimuth", [30.0, 52.0])
def test_gloss_of_other_bsdfs_agrees_with_one_panel_of_many_points_at_every_angle(name, angle, azimuth):
    bsdf = OTHERS[name]()
    gloss = float(gloss_units(bsdf, [angle], azimuth=azimuth)[0])
    # The peak of flakes is a cone, which one panel of a rule for smooth functions integrates to about 1e-5.
    assert gloss == pytest.approx(brute_force(bsdf, angle, azimuth=azimuth), rel=5e-5)


@pytest.mark.parametrize(("name", "angle"), QUICK_OTHERS)
def test_gloss_of_other_bsdfs_agrees_with_a_monte_carlo_of_the_apertures(name, angle):
    bsdf = OTHERS[name]()
    mean, sigma = monte_carlo(bsdf, angle, 200_000, seed=3, azimuth=13.0)
    assert sigma < 0.02 * mean
    assert abs(float(gloss_units(bsdf, [angle], azimuth=13.0)[0]) - mean) < 3 * sigma


@pytest.mark.slow
@pytest.mark.parametrize("name", OTHERS)
@pytest.mark.parametrize("angle", ANGLES)
def test_gloss_of_other_bsdfs_agrees_with_a_monte_carlo_of_the_apertures_at_every_angle(name, angle):
    bsdf = OTHERS[name]()
    mean, sigma = monte_carlo(bsdf, angle, 2_000_000, seed=7, azimuth=52.0)
    assert sigma < 0.01 * mean
    assert abs(float(gloss_units(bsdf, [angle], azimuth=52.0)[0]) - mean) < 3 * sigma


def test_gloss_of_a_lay_is_the_light_that_is_sampled_into_the_receptor():
    mean, sigma = counted(lay(30, 0.05, 0.3), 60.0, 20_000, seed=29, azimuth=52.0)
    assert sigma < 0.03 * mean
    assert abs(float(gloss_units(lay(30, 0.05, 0.3), [60.0], azimuth=52.0)[0]) - mean) < 3 * sigma


def perturbed(bsdf, angle, azimuths=(0.0,), *, source=(0.0, 0.0), receptor=(0.0, 0.0), axis=0.0, incidence=0.0):
    """Gloss of an instrument whose apertures and axes [degree] are off by this, set to 100 on black glass; mean over azimuths."""
    whole = [0.75 + source[0], 2.5 + source[1]]
    full = [width + more for width, more in zip(RECEPTOR[angle], receptor, strict=True)]
    light = apertures.source(angle + incidence, apertures.FINE, apertures.centred(*whole))
    window = apertures.centred(*full)
    shift = np.tan(np.radians(axis))
    window = window._replace(low_u=window.low_u + shift, high_u=window.high_u + shift)
    sample = apertures.sample_of(bsdf, 0.0)
    (got,) = apertures.received(sample, [apertures.Beam(angle + incidence, light, window, 5)], np.array(azimuths))
    return 100 * (light.weight @ got.mean(axis=0)) / (light.weight @ light.glass)


def spread_of_instruments(bsdf, angle, azimuths=(0.0,)):
    """Standard uncertainty over instruments at the ends of each tolerance in turn."""
    (wide_u, wide_v), (receptor_u, receptor_v) = SOURCE_TOLERANCE, RECEPTOR_TOLERANCE[angle]
    half = []
    for off in (
        {"source": (wide_u, 0)},
        {"source": (0, wide_v)},
        {"receptor": (receptor_u, 0)},
        {"receptor": (0, receptor_v)},
        {"axis": 0.1},
        {"incidence": 0.1},
    ):
        ends = [
            {
                key: tuple(s * x for x in offset) if isinstance(offset, tuple) else s * offset
                for key, offset in off.items()
            }
            for s in (-1, 1)
        ]
        less, more = (perturbed(bsdf, angle, azimuths, **end) for end in ends)
        half.append((more - less) / 2)
    return np.sqrt(np.sum(np.square(half)) / 3)


@pytest.mark.cases(5)
@pytest.mark.parametrize("a", [0.005, 0.02, 0.1, 0.4])
@pytest.mark.parametrize("angle", ANGLES)
def test_the_uncertainty_is_that_of_instruments_at_the_ends_of_their_tolerances(a, angle):
    bsdf = nonspectral(rough(a))
    units, spread = gloss_with_uncertainty(bsdf, [angle])
    assert float(units[0]) == pytest.approx(perturbed(bsdf, angle), rel=1e-9)
    # Linear in the receptor, two points in the rim of the source, a point source for the incidence: an uncertainty needs no more.
    assert float(spread[0]) == pytest.approx(spread_of_instruments(bsdf, angle), rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("angle", ANGLES)
def test_the_uncertainty_of_a_lay_is_that_of_instruments_all_round_it(angle):
    azimuths = np.arange(1.0, 361.0, 360 / 64)
    units, spread = gloss_with_uncertainty(lay(30), [angle])
    assert float(units[0]) == pytest.approx(perturbed(lay(30), angle, azimuths), rel=1e-4)
    assert float(spread[0]) == pytest.approx(spread_of_instruments(lay(30), angle, azimuths), rel=0.05)


def test_tolerances_leave_black_glass_at_100():
    units, spread = gloss_with_uncertainty(microfacet.build(facets.flat(), index=1.567))
    assert units.values == pytest.approx(100, abs=1e-9)
    assert spread.values == pytest.approx(0, abs=1e-9)


def test_the_uncertainty_of_a_polished_surface_is_that_of_the_angle_of_incidence():
    def ratio(angle):
        reflected = [float(optics.fresnel(np.cos(np.radians(angle)), n)[2]) for n in (1.5, 1.567)]
        return 100 * reflected[0] / reflected[1]

    spread = gloss_with_uncertainty(microfacet.build(facets.flat(), index=1.5))[1].values
    expected = [abs(ratio(angle + 0.1) - ratio(angle - 0.1)) / 2 / np.sqrt(3) for angle in ANGLES]
    # What the source's tolerance adds is of second order, and shows at 20° where the first order is smallest.
    assert spread == pytest.approx(expected, rel=0.05, abs=2e-5)


def test_the_uncertainty_of_a_matt_surface_is_that_of_the_receptor():
    spread = gloss_with_uncertainty(lambert_gauss.lambertian(samples.spectrum(1.0)), [60.0])[1]
    # Light in proportion to the solid angle; black glass changes with the angle of incidence as well.
    by_width = np.hypot(0.1 / 4.4, 0.2 / 11.7)
    glass = [float(optics.fresnel(np.cos(np.radians(angle)), 1.567)[2]) for angle in (59.9, 60.1)]
    cosine = np.cos(np.radians([59.9, 60.1]))
    by_angle = (np.diff(np.log(cosine)) - np.diff(np.log(glass)))[0] / 2
    # Moving the receptor's axis changes the cosine of what it sees.
    by_axis = np.radians(0.1) * np.tan(np.radians(60))
    expected = 2.4841 * np.sqrt((by_width**2 + by_angle**2 + by_axis**2) / 3)
    assert float(spread[0]) == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("a", [0.005, 0.02, 0.1])
def test_the_uncertainty_of_haze_is_that_of_instruments_with_one_source(a):
    bsdf = nonspectral(rough(a))
    half = []
    for key, low, high in (
        ("receptor", *((RECEPTOR_TOLERANCE[angle][0], 0) for angle in (20.0, 60.0))),
        ("receptor", *((0, RECEPTOR_TOLERANCE[angle][1]) for angle in (20.0, 60.0))),
        ("axis", 0.1, 0.1),
        ("incidence", 0.1, 0.1),
        ("source", (SOURCE_TOLERANCE[0], 0), (SOURCE_TOLERANCE[0], 0)),
        ("source", (0, SOURCE_TOLERANCE[1]), (0, SOURCE_TOLERANCE[1])),
    ):
        ranges = []
        for angle, off in ((20.0, low), (60.0, high)):
            ends = [tuple(s * x for x in off) if isinstance(off, tuple) else s * off for s in (-1, 1)]
            less, more = (perturbed(bsdf, angle, **{key: end}) for end in ends)
            ranges.append((more - less) / 2)
        half += [ranges[1] - ranges[0]] if key == "source" else ranges
    readings = gloss_and_haze(bsdf)
    assert float(readings["haze_u"]) == pytest.approx(np.sqrt(np.sum(np.square(half)) / 3), rel=0.05)
    assert float(readings["haze"]) == pytest.approx(perturbed(bsdf, 60.0) - perturbed(bsdf, 20.0), rel=1e-6)


def test_haze_needs_both_angles():
    readings = gloss_and_haze(rough(0.1), [20.0, 85.0])
    assert np.isnan(readings["haze"])
    assert np.isnan(readings["haze_u"])


def test_a_lay_leaves_an_uncertainty_between_those_of_its_planes():
    brushed = lay(30)
    mean = float(gloss_with_uncertainty(brushed, [60.0])[1][0])
    planes = [float(gloss_with_uncertainty(brushed, [60.0], azimuth=azimuth)[1][0]) for azimuth in (30, 120)]
    assert 0 < mean < max(planes)


def test_gloss_falls_with_roughness():
    values = np.array([gloss_units(rough(a)).values for a in (0.01, 0.02, 0.05, 0.1, 0.2, 0.4)])
    assert (np.diff(values, axis=0) < 0).all()


@pytest.mark.parametrize("a", [1e-5, 1e-4, 1e-3])
def test_gloss_of_a_narrow_lobe_with_a_long_tail_counts_all_of_it(a):
    # Nearly polished: what GGX's tail carries beyond the receptor is of order (a / half aperture)².
    bsdf = microfacet.build(facets.analytic("ggx", a), index=optics.refractive_index(1.567), multiple_scattering="none")
    assert float(gloss_units(bsdf, [60.0])[0]) == pytest.approx(100, abs=100 * (4 * a / 0.02) ** 2 + 0.01)


def test_gloss_of_a_polished_surface_is_the_limit_of_smooth_ones():
    polished = microfacet.build(facets.flat(), index=1.5)
    # Not the 82.0452, 89.1368, 98.9746 that are quoted for a polished surface: those are the ratio of the reflectances on the axis,
    # a point source's. The source image is 0.75° × 2.5°, and the reflectance, which is curved most at 85°, is averaged over it.
    assert gloss_units(polished).values == pytest.approx((82.0454, 89.1385, 98.9730), abs=5e-5)
    assert gloss_units(polished).values == pytest.approx(gloss_units(rough(1e-4)).values, rel=1e-6)
    assert gloss_units(microfacet.build(facets.flat(), index=1.567)).values == pytest.approx(100, abs=1e-9)


def test_a_base_below_a_polished_surface_adds_to_its_gloss():
    base = gloss_units(microfacet.build(facets.flat(), index=1.5, spectrum=samples.spectrum(0.5))).values
    smooth, limit = (
        gloss_units(microfacet.build(facets.flat(), index=1.5)).values,
        gloss_units(samples.beckmann_bsdf(1e-4 / np.sqrt(2), n=1.5, reflectance=0.5)).values,
    )
    assert (base > smooth).all()
    assert base == pytest.approx(limit, rel=1e-5)


def test_gloss_turns_with_the_lay():
    along, turned = gloss_units(lay(0), [60.0], azimuth=0), gloss_units(lay(30), [60.0], azimuth=30)
    assert float(turned[0]) == pytest.approx(float(along[0]), rel=1e-5)
    assert float(along[0]) > 3 * float(gloss_units(lay(0), [60.0], azimuth=90)[0])


def test_gloss_of_a_surface_with_a_lay_is_the_mean_over_the_azimuth():
    angle, brushed = 85.0, lay(30)
    around = [float(gloss_units(brushed, [angle], azimuth=azimuth)[0]) for azimuth in np.arange(31.875, 120.0, 3.75)]
    # The lay, at 30°, is an axis of symmetry, and so is what lies across it; the peak along the lay is 15° wide.
    assert float(gloss_units(brushed, [angle])[0]) == pytest.approx(np.mean(around), rel=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(("a_x", "a_y"), [(0.05, 0.3), (0.01, 0.3), (0.05, 0.1)])
@pytest.mark.parametrize("angle", ANGLES)
def test_the_mean_over_the_azimuth_of_any_lay_agrees_with_one_of_many_azimuths(a_x, a_y, angle):
    brushed = lay(30, a_x, a_y)
    assert float(gloss_units(brushed, [angle])[0]) == pytest.approx(
        perturbed(brushed, angle, np.arange(256) * 1.40625), rel=1e-4
    )


def test_a_turned_lay_has_the_same_mean():
    assert gloss_units(lay(30)).values == pytest.approx(gloss_units(lay(0)).values, rel=1e-6)


def test_gloss_with_a_lay_that_is_hardly_one_is_that_without():
    almost = lay(0, 0.1, 0.1001)
    assert gloss_units(almost, [60.0]).values == pytest.approx(gloss_units(rough(0.10005), [60.0]).values, rel=1e-4)


def test_an_unknown_geometry_is_refused():
    with pytest.raises(GlossError, match="no gloss geometry 45°; accepted: 20, 60, 85; set `gloss_angles`"):
        gloss_units(rough(0.1), [45])


def test_one_angle_may_be_a_number():
    assert gloss_units(rough(0.1), 60).equals(gloss_units(rough(0.1), [60.0]))


def test_the_plane_of_the_receptor_touches_its_axis():
    theta, phi = directions(np.array([0.0, 0.01]), np.array([0.0, 0.0]), 60.0)
    assert theta == pytest.approx([60.0, 60.0 + np.degrees(np.arctan(0.01))])
    assert phi == pytest.approx([0.0, 0.0])
