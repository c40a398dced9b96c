"""Veiling glare against closed forms, and against plain sums over directions with fields instead of Mueller matrices."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import samples

from brdfpipe import facets, optics, psd
from brdfpipe.appearance.cabin import Cabin, Sky, Sun, Windscreen
from brdfpipe.appearance.skies import sky_luminance
from brdfpipe.appearance.veiling_glare import SUN_RADIUS, veiling_luminance
from brdfpipe.bsdf import microfacet, wave
from brdfpipe.bsdf.lambert_gauss import lambertian
from brdfpipe.errors import BrdfpipeError
from brdfpipe.geometry import angles_of, unit_vector
from brdfpipe.optics.fresnel_equations import internal_of_plate

UP = np.array([0.0, 0.0, 1.0])
RAKE, DOWN = 30.0, 5.0
TO_EYE = unit_vector(90 - (2 * RAKE - DOWN), 180)
MIRROR_ELEVATION = 2 * RAKE - DOWN


def pane(cosine, side):
    """Amplitudes of what a pane of transmittance 0.75 and index 1.52 reflects and transmits of s (0) or p (1): roots of sums of powers."""
    sine_inside = np.sqrt(1 - np.asarray(cosine) ** 2) / 1.52
    f = optics.fresnel(cosine, 1.52)[side]
    f0 = ((1.52 - 1) / (1.52 + 1)) ** 2
    tau = max(t for t in np.roots([f0**2 * 0.75, (1 - f0) ** 2, -0.75]) if t > 0) ** (1 / np.sqrt(1 - sine_inside**2))
    bounces = np.arange(60)[:, None]
    inside = (np.atleast_1d(f) * tau) ** bounces
    transmitted = (1 - f) ** 2 * tau * (inside**2).sum(axis=0)
    reflected = f + (1 - f) ** 2 * tau**2 * f * (inside**2).sum(axis=0)
    return np.sqrt(reflected), np.sqrt(transmitted)


def split(field, travel, normal, amplitudes, outgoing=None):
    """A field (n, 3) after an element that changes its s and p parts about a normal; ``outgoing``: the new direction of travel."""
    s = np.cross(travel, normal)
    s /= np.linalg.norm(s, axis=1, keepdims=True)
    p_in, p_out = np.cross(travel, s), np.cross(travel if outgoing is None else outgoing, s)
    along_s, along_p = (field * s).sum(axis=1), (field * p_in).sum(axis=1)
    return amplitudes[0][:, None] * along_s[:, None] * s + amplitudes[1][:, None] * along_p[:, None] * p_out


def to_the_driver(bsdf, directions, index):
    """BRDF·cos θ_i of the dashboard with what both passages of the glass do to the light (n,), by fields of two polarisations."""
    glass = np.array([-np.sin(np.radians(RAKE)), 0, -np.cos(np.radians(RAKE))])
    theta_i, phi_i = angles_of(directions)
    theta_o, phi_o = angles_of(TO_EYE)
    whole = bsdf.bsdf.nonspectral().bsdf.evaluate(theta_i, phi_i, theta_o, phi_o).values
    facet_alone = microfacet_part(bsdf)
    lobe = whole if facet_alone is None else facet_alone.bsdf.evaluate(theta_i, phi_i, theta_o, phi_o).values
    if index is None:
        lobe = np.zeros_like(whole)
    travel, view = -directions, np.broadcast_to(TO_EYE, directions.shape)
    half = directions + TO_EYE
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    cos_h, cos_in = (directions * half).sum(axis=1), np.abs(directions @ glass)
    entering = [pane(cos_in, side)[1] for side in (0, 1)]
    leaving = [np.full(len(directions), pane(np.abs(TO_EYE @ glass), side)[0][0]) for side in (0, 1)]
    total = np.zeros(len(directions))
    if index is not None:
        q = np.sqrt(index**2 - 1 + cos_h**2)
        r = [(cos_h - q) / (cos_h + q), (index**2 * cos_h - q) / (index**2 * cos_h + q)]
        first = np.cross(travel, [0.0, 1.0, 0.3])
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        for field in (first, np.cross(travel, first)):  # any two perpendicular fields of half the power each
            field = split(field, travel, glass, entering)
            field = split(field, travel, half, r, view)
            field = split(field, view, glass, leaving)
            total += (field**2).sum(axis=1) / 2
        total *= lobe / ((r[0] ** 2 + r[1] ** 2) / 2)
    passed = (entering[0] ** 2 + entering[1] ** 2) / 2 * (leaving[0] ** 2 + leaving[1] ** 2) / 2
    return (total + (whole - lobe) * passed) * directions[:, 2]


def microfacet_part(bsdf):
    from brdfpipe.bsdf.registry import representation

    return (
        None
        if bsdf.attrs["representation"] == "lambert_gauss"
        else representation(bsdf.bsdf.nonspectral()).without_diffuse()
    )


def seen_through_the_glass(directions, cabin):
    """Whether rays from the dashboard pass the rectangle: x / z of its points from corner to corner, in the frame of the pane."""
    rake = np.radians(RAKE)
    x, y, z = directions.T
    # The point −distance + t (x, z) is on the line from the foot upwards and back: z t / (distance − x t) = tan(rake).
    with np.errstate(divide="ignore", invalid="ignore"):
        t = cabin.distance * np.tan(rake) / (z + x * np.tan(rake))
        slant = z * t / np.sin(rake)
        return (t > 0) & (slant <= cabin.windscreen.length) & (np.abs(y * t) <= cabin.windscreen.width / 2)


def sky_by_brute_force(bsdf, cabin, index, steps=(300, 600)):
    """A sum over directions of equal projected solid angle of the whole hemisphere."""
    u, v = ((np.arange(n) + 0.5) / n for n in steps)
    theta, phi = (a.ravel() for a in np.meshgrid(np.degrees(np.arcsin(np.sqrt(u))), 360 * v, indexing="ij"))
    directions = unit_vector(theta, phi)
    directions = directions[seen_through_the_glass(directions, cabin)]
    luminance = sky_luminance(
        cabin.sky.kind, cabin.sky.illuminance, (cabin.sun.elevation, cabin.sun.azimuth), directions
    )
    share = np.pi / (steps[0] * steps[1])
    return (to_the_driver(bsdf, directions, index) / directions[:, 2] * luminance).sum() * share


def black(slope: float):
    """Facets of index 1.5 over a body that reflects nothing."""
    return samples.beckmann_bsdf(slope, n=1.5, reflectance=None)


@pytest.mark.parametrize("kind", ["uniform", "clear", "overcast"])
def test_the_sky_on_a_beige_dashboard_is_the_sum_over_all_directions(kind):
    cabin = Cabin(sky=Sky(kind), sun=Sun(elevation=50, azimuth=20))
    beige = samples.beckmann_bsdf(0.3, n=1.5, reflectance=0.45)
    found = float(veiling_luminance(beige, cabin)["veiling_luminance_sky"])
    assert found == pytest.approx(sky_by_brute_force(beige, cabin, 1.5), rel=2e-3)
    matt = lambertian(samples.spectrum(0.45))
    found = float(veiling_luminance(matt, cabin)["veiling_luminance_sky"])
    assert found == pytest.approx(sky_by_brute_force(matt, cabin, None), rel=2e-3)


@pytest.mark.parametrize("slope", [0.2, 0.03])
def test_the_sky_on_a_black_dashboard_is_the_sum_over_all_directions(slope):
    """The step of the sum is 0.2° to 0.4°, a tenth of the narrower lobe."""
    cabin = Cabin(sun=Sun(elevation=60, azimuth=-15))
    found = float(veiling_luminance(black(slope), cabin)["veiling_luminance_sky"])
    assert found == pytest.approx(sky_by_brute_force(black(slope), cabin, 1.5, (500, 1000)), rel=5e-3)


def test_the_sky_in_a_polished_black_dashboard_is_three_reflections_and_a_passage():
    """In the plane of symmetry s and p stay what they are."""
    cabin = Cabin(sky=Sky("clear"), sun=Sun(elevation=20, azimuth=40))
    polished = microfacet.build(facets.flat(), index=1.5)
    glass = np.array([-np.sin(np.radians(RAKE)), 0, -np.cos(np.radians(RAKE))])
    mirror = TO_EYE * [-1, -1, 1]
    power = 0.0
    for side in (0, 1):
        entered = pane(abs(mirror @ glass), side)[1][0] ** 2
        leaving = pane(abs(TO_EYE @ glass), side)[0][0] ** 2
        power += entered * optics.fresnel(TO_EYE[2], 1.5)[side] * leaving / 2
    expected = power * sky_luminance("clear", 15_000.0, (20, 40), mirror)
    found = float(veiling_luminance(polished, cabin)["veiling_luminance_sky"])
    assert found == pytest.approx(float(expected), rel=1e-6)
    # A lobe much narrower than what the sky changes over tends to it.
    narrow = float(veiling_luminance(black(1e-3), cabin)["veiling_luminance_sky"])
    assert narrow == pytest.approx(found, rel=2e-3)


def test_the_sun_on_a_matt_dashboard_is_its_closed_form():
    sun = Sun(elevation=40, azimuth=10)
    towards = unit_vector(50, 10)
    glass = np.array([-np.sin(np.radians(RAKE)), 0, -np.cos(np.radians(RAKE))])
    passed, mirrored = (
        np.mean([pane(abs(at @ glass), side)[k] ** 2 for side in (0, 1)]) for at, k in ((towards, 1), (TO_EYE, 0))
    )
    expected = sun.illuminance * np.cos(np.radians(50)) * passed * 0.4 / np.pi * mirrored
    found = float(veiling_luminance(lambertian(samples.spectrum(0.4)), Cabin(sun=sun))["veiling_luminance_sun"])
    assert found == pytest.approx(expected, rel=1e-4)  # the disc has a little curvature: 1e-5


@pytest.mark.parametrize(("slope", "off"), [(0.002, 0.2), (0.002, 0.6), (0.05, 4.0)])
def test_the_sun_in_a_glossy_dashboard_is_the_mean_over_its_disc(slope, off):
    sun = Sun(elevation=MIRROR_ELEVATION + off, azimuth=0.05)
    towards = unit_vector(90 - sun.elevation, sun.azimuth)
    right = np.cross(towards, UP) / np.linalg.norm(np.cross(towards, UP))
    # Points of equal solid angle on a spiral.
    count = 20_000
    radius = np.radians(SUN_RADIUS) * np.sqrt((np.arange(count) + 0.5) / count)[:, None]
    turn = (np.arange(count) * np.pi * (3 - np.sqrt(5)))[:, None]
    disc = np.cos(radius) * towards + np.sin(radius) * (np.cos(turn) * right + np.sin(turn) * np.cross(right, towards))
    expected = sun.illuminance * to_the_driver(black(slope), disc, 1.5).mean()
    found = float(veiling_luminance(black(slope), Cabin(sun=sun))["veiling_luminance_sun"])
    assert found == pytest.approx(expected, rel=5e-3)


def test_a_polished_dashboard_mirrors_the_sun_only_from_one_place():
    polished = microfacet.build(facets.flat(), index=1.5)
    there, beside = (Cabin(sun=Sun(elevation=MIRROR_ELEVATION + off)) for off in (0.2, 0.3))
    luminance = float(veiling_luminance(polished, there)["veiling_luminance_sun"])
    assert 1e6 < luminance < 100_000 / (np.pi * np.sin(np.radians(SUN_RADIUS)) ** 2)
    assert float(veiling_luminance(polished, beside)["veiling_luminance_sun"]) == 0


def test_the_sun_behind_the_car_or_the_roof_lights_nothing():
    matt = lambertian(samples.spectrum(0.4))
    for sun in (Sun(azimuth=180), Sun(elevation=20, azimuth=80), Sun(elevation=89, azimuth=180)):
        found = veiling_luminance(matt, Cabin(sun=sun))
        visible = seen_through_the_glass(unit_vector(90 - sun.elevation, sun.azimuth)[None], Cabin())[0]
        assert (float(found["veiling_luminance_sun"]) > 0) == visible
        assert float(found["veiling_luminance"]) == float(
            found["veiling_luminance_sun"] + found["veiling_luminance_sky"]
        )
    assert float(veiling_luminance(matt, Cabin(sun=Sun(azimuth=180)))["veiling_luminance_sun"]) == 0


def test_a_larger_windscreen_shows_more_sky_up_to_that_of_a_half_space():
    matt = lambertian(samples.spectrum(1.0))
    cabin = Cabin(sky=Sky("uniform"), windscreen=Windscreen(transmittance=0.9))
    small, large, huge = (
        float(
            veiling_luminance(matt, replace(cabin, windscreen=replace(cabin.windscreen, length=size, width=2 * size)))[
                "veiling_luminance_sky"
            ]
        )
        for size in (0.9, 4.0, 40.0)
    )
    assert small < large < huge
    # Without losses in the glass a half space up to the rake gives (1 + cos 30°) / 2 of the sky.
    mirrored = np.mean([pane_of(0.9, side) for side in (0, 1)])
    assert huge < 15_000 / np.pi * (1 + np.cos(np.radians(30))) / 2 * mirrored


def pane_of(transmittance, side):
    """Reflectance for s or p of a windscreen towards the driver."""
    cosine = np.sin(np.radians(RAKE - DOWN))
    return float(Windscreen(transmittance=transmittance).plate(np.array(cosine))[side])


def test_the_frame_of_a_surface_with_a_lay_turns_with_the_car():
    brushed = samples.brushed_bsdf(0.3, 0.1)
    along, across, turned = (
        float(
            veiling_luminance(samples.brushed_bsdf(0.3, 0.1, lay) if lay else brushed, Cabin(material_azimuth=azimuth))[
                "veiling_luminance"
            ]
        )
        for lay, azimuth in ((0, 0), (0, 90), (90, 90))
    )
    assert abs(along / across - 1) > 0.05
    assert turned == pytest.approx(along, rel=1e-3)


def test_the_glass_has_the_transmittance_that_is_asked_for():
    normal = Windscreen(transmittance=0.7, index=1.6).plate(np.array(1.0))
    assert (normal.transmittance_s + normal.transmittance_p) / 2 == pytest.approx(0.7, rel=1e-12)
    assert internal_of_plate(0.0, 1.5) == 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"sky": Sky("foggy")}, "unknown sky 'foggy'; accepted: uniform, clear, overcast"),
        ({"windscreen": Windscreen(transmittance=0.95)}, "cannot transmit 0.95.*at most 0.91"),
        ({"line_of_sight": 31.0}, "accepted: a line of sight below the rake"),
        ({"windscreen": Windscreen(rake=93.0), "line_of_sight": 2.0}, "accepted: a rake below 91"),
        ({"distance": 0.6}, "accepted: a smaller distance"),
    ],
)
def test_a_cabin_that_cannot_be_is_refused(options, message):
    with pytest.raises(BrdfpipeError, match=message):
        Cabin(**options)


def test_waves_on_a_hardly_rough_dashboard_lead_to_the_polished_one():
    """With 1 nm of height g is 5e-4, and so is the share of the light that is scattered."""
    waves = wave.build(psd.analytic("gaussian", sigma=1e-3, length=5.0), index=1.5, wavelength=[450.0, 550.0, 650.0])
    found, polished = (
        float(veiling_luminance(bsdf)["veiling_luminance_sky"])
        for bsdf in (waves, microfacet.build(facets.flat(), index=1.5))
    )
    assert found == pytest.approx(polished, rel=1e-3)
