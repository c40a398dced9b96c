"""The error of a BRDF by purpose, against closed forms and independent integrals."""

from __future__ import annotations

import numpy as np
import pytest
import samples
from scipy.integrate import quad

from brdfpipe import facets, optics, vocabulary
from brdfpipe.bsdf import microfacet
from brdfpipe.bsdf.lambert_gauss import lambertian
from brdfpipe.errors import BrdfpipeError
from brdfpipe.scenes import metrics
from brdfpipe.scenes.domain import Domain
from brdfpipe.scenes.metrics import METRICS
from brdfpipe.scenes.scene_keys import METRICS_OF_DOMAINS
from brdfpipe.spectra import colorimetry
from brdfpipe.spectra.colour_science import colour

HEMISPHERE = Domain({"hemisphere": {"theta_i": [0, 80], "phi_i": 0}})
FORTY_FIVE = Domain({"geometries": [{"theta_i": 45, "phi_i": 0, "theta_o": 0, "phi_o": 0}]})


def lambert(reflectance=0.3):
    """A perfectly diffuse BRDF: a number, or values on the 5-nm grid."""
    return lambertian(samples.spectrum(reflectance))


def lambert_and_peak(reflectance: float, peak: float, fwhm: float = 12.0):
    """A perfectly diffuse BRDF with a Gaussian lobe about the mirror direction."""
    width = ("theta_i", np.full(2, fwhm))
    lobe = {
        "gauss_peak": ("theta_i", np.full(2, peak)),
        "gauss_fwhm_parallel": width,
        "gauss_fwhm_perpendicular": width,
    }
    return vocabulary.label(lambert(reflectance).drop_vars("total_reflectance").assign(lobe), "bsdf")


def figures(name: str, candidate, reference, domain=HEMISPHERE, **options) -> dict:
    return {figure.name: figure for figure in METRICS[name].figures(candidate, reference, domain, **options)}


@pytest.mark.parametrize("name", METRICS)
def test_a_brdf_has_no_error_against_itself(name):
    options = {"gloss": {}, "rendering": {"n": 256, "side": 16}}.get(name, {"n": 256})
    for figure in METRICS[name].figures(lambert_and_peak(0.2, 1.0), lambert_and_peak(0.2, 1.0), HEMISPHERE, **options):
        assert (figure.value, figure.u) == (0, 0)
    assert METRICS[name].error(lambert(), lambert(), HEMISPHERE, **options).unit == METRICS[name].unit


@pytest.mark.parametrize("name", METRICS)
def test_the_error_of_a_metric_depends_on_the_domain_if_it_is_listed_so(name):
    options = {"gloss": {}, "rendering": {"n": 256, "side": 16}}.get(name, {"n": 256})
    pair = lambert_and_peak(0.2, 1.0), lambert_and_peak(0.3, 0.5)
    errors = {METRICS[name].error(*pair, domain, **options).value for domain in (HEMISPHERE, FORTY_FIVE)}
    assert len(errors) == (2 if name in METRICS_OF_DOMAINS else 1)


def test_a_brdf_scaled_by_1_05_has_a_glare_error_of_5_percent():
    found = figures("glare", lambert_and_peak(0.21, 1.05), lambert_and_peak(0.2, 1.0), n=512, floor=1e-9)
    assert found["glare"].value == pytest.approx(0.05, abs=1e-12)
    assert found["glare_95"].value == pytest.approx(0.05, abs=1e-12)
    assert found["albedo"].value == pytest.approx(
        0.05, abs=5e-6
    )  # integrals to 1e-6, and the fit of a Gaussian to none
    assert found["glare"].u == pytest.approx(0, abs=1e-12)


def test_the_glare_error_of_a_lobe_that_is_missing_is_its_closed_form():
    """At normal incidence the lobe is exp(−θ²/2σ²) nearly; the Gaussian of longitude and latitude is integrated here as it is."""
    peak, sigma, white = 0.5, 40 / np.sqrt(8 * np.log(2)), 0.4 / np.pi

    def ring(theta):
        phi = np.linspace(0, 2 * np.pi, 721)[:-1]
        x, y, z = np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)
        along, across = np.degrees(np.arctan2(-x, z)), np.degrees(np.arcsin(y))
        lobe = peak * np.exp(-(along**2 + across**2) / (2 * sigma**2))
        return (lobe**2).mean() * 2 * np.sin(theta) * np.cos(theta)

    expected = np.sqrt(quad(ring, 0, np.pi / 2, points=[0.5])[0]) / white
    normal = Domain({"hemisphere": {"theta_i": 0, "phi_i": 0}})
    misses = []
    for seed in range(6):
        found = figures(
            "glare", lambert_and_peak(0.4, peak, 40.0), lambert(0.4), normal, n=4096, seed=seed, floor=1e-9
        )["glare"]
        # 4096 Sobol' points and a lobe of 4 % of them: plain random points would miss by 2 %.
        assert found.value == pytest.approx(expected, rel=0.02)
        misses.append((found.value - expected) / found.u)
    # Six misses over their stated standard uncertainty from eight scrambles: an rms near 1, below 2.2 with more than 99.9 %.
    assert np.sqrt(np.mean(np.square(misses))) < 2.2
    assert np.sqrt(np.mean(np.square(misses))) > 0.2


def test_darkness_below_the_floor_does_not_count():
    dim, dimmer = lambert(2e-3), lambert(1e-3)
    with pytest.raises(BrdfpipeError, match="no direction of the domain has BRDF·cos θ_o above"):
        METRICS["glare"].error(dim, dimmer, HEMISPHERE, n=64)
    with pytest.raises(BrdfpipeError, match="the floor is 0"):
        METRICS["glare"].error(dim, dimmer, HEMISPHERE, floor=0)
    # A light that the reference does not have counts over the floor.
    at_45 = METRICS["glare"].error(lambert(0.1), dimmer, FORTY_FIVE).value
    assert at_45 == pytest.approx((0.099 / np.pi) / 1e-3, rel=1e-9)


def test_the_share_of_transmitted_light_counts_where_a_scene_looks_through():
    through = Domain({"hemisphere": {"theta_i": 0, "phi_i": 0}, "side": "both"})
    assert figures("glare", lambert(0.33), lambert(0.3), through, n=64)["albedo"].value == pytest.approx(0.1, rel=1e-9)


def test_colour_differences_are_ciede2000_of_colour_science():
    wavelength = samples.WAVELENGTH
    red, brown = 0.1 + 0.6 / (1 + np.exp(-(wavelength - 600) / 15)), 0.1 + 0.4 / (1 + np.exp(-(wavelength - 580) / 25))
    found = figures("colour", lambert(red), lambert(brown), FORTY_FIVE, illuminant="A", observer=2)
    white = colorimetry.weights("A", 2).white
    labs = [
        colour.XYZ_to_Lab(colorimetry.reflectance_to_xyz(wavelength, r, "A", 2) / 100, colour.XYZ_to_xy(white))
        for r in (red, brown)
    ]
    assert found["colour"].value == pytest.approx(float(colour.delta_E(*labs, method="CIE 2000")), rel=1e-9)
    assert found["colour"].value == pytest.approx(found["colour_95"].value)
    assert found["colour"].u == 0
    # The same everywhere: scrambles agree.
    everywhere = figures("colour", lambert(red), lambert(brown), HEMISPHERE, n=64, illuminant="A", observer=2)["colour"]
    assert everywhere.value == pytest.approx(found["colour"].value, rel=1e-9)


def test_the_gloss_of_a_smooth_surface_differs_by_fresnels_reflectances():
    black_glass, crown = (microfacet.build(facets.flat(), index=n) for n in (1.567, 1.5))
    found = figures("gloss", crown, black_glass)
    at_60 = 100 * (optics.fresnel(0.5, 1.5).mean / optics.fresnel(0.5, 1.567).mean - 1)
    # The source of the meter subtends 0.75°, over which the ratio is nearly constant.
    assert found["gloss_60"].value == pytest.approx(at_60, abs=0.02)
    assert found["gloss"].value == max(abs(found[f"gloss_{angle}"].value) for angle in (20, 60, 85))


def test_pictures_of_a_darker_grey_differ_more_and_in_every_light():
    reference = lambert(0.3)
    nearly, darker = (figures("rendering", lambert(r), reference, n=256, side=24) for r in (0.297, 0.27))
    assert 0 < nearly["rendering"].value < 2 < darker["rendering"].value < 30
    assert {"rendering_studio", "rendering_sun", "log"} < set(darker)
    mean = (darker["rendering_studio"].value + darker["rendering_sun"].value) / 2
    assert darker["rendering"].value == pytest.approx(mean)
    assert darker["log"].value == pytest.approx(abs(np.log(0.9)), rel=0.05)  # the floor takes a little


def test_candidates_are_screened_by_the_error_of_logarithms():
    candidates = {"far": lambert(0.1), "near": lambert(0.29), "equal": lambert(0.3), "next": lambert(0.33)}
    assert metrics.screened(candidates, lambert(0.3), HEMISPHERE, keep=3, n=64) == ("equal", "near", "next")
