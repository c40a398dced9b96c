"""The BSDF of Kirchhoff's integral on a map, from coherent reflection to facets."""

from __future__ import annotations

import json
from functools import cache

import numpy as np
import pytest
import samples

from brdfpipe import vocabulary
from brdfpipe.appearance import gloss
from brdfpipe.bsdf import kirchhoff
from brdfpipe.bsdf.accessor import open_dataset
from brdfpipe.bsdf.checks import check
from brdfpipe.bsdf.kirchhoff import build
from brdfpipe.bsdf.microfacet.builder import build as build_microfacet
from brdfpipe.bsdf.registry import representation
from brdfpipe.facets.estimation import estimate
from brdfpipe.optics.fresnel_equations import fresnel
from brdfpipe.references.height_mesh import HeightMapError
from brdfpipe.store import save_dataset


def gaussian_map(sigma: float, seed: int = 1, size: int = 512):
    """A periodic map of rms height ``sigma`` [um], correlation exp(−r²/ℓ²) with ℓ = 5 µm, pitch 0.5 µm."""
    height = samples.gaussian_surface(size, correlation=10.0, seed=seed)["height"].values
    return samples.surface(height / height.std() * sigma, pitch=(0.5, 0.5))


@cache
def diffracted(sigma: float = 0.05, spectral: bool = False):
    spectrum = samples.spectrum(np.linspace(0.1, 0.5, samples.WAVELENGTH.size)) if spectral else None
    return build(gaussian_map(sigma), index=1.5, spectrum=spectrum, wavelength=None if spectral else [550.0])


@pytest.mark.parametrize(
    ("sigma", "expected", "tolerance"),
    # Coherent + halo of an infinite surface, 550 nm: independent quadrature of the series. One map of 512 × 512 heights scatters.
    [(0.013, [77.889, 88.280, 98.913], 0.3), (0.05, [40.282, 77.629, 98.1], 1.5), (0.2, [2.211, 24.144, 85.7], 2.5)],
)
def test_gloss_is_that_of_waves(sigma, expected, tolerance):
    np.testing.assert_allclose(gloss(diffracted(sigma), [20, 60, 85]), expected, atol=tolerance)


def test_nothing_is_diffracted_beside_the_lobe_of_a_smooth_map():
    # Orders 1 to 3 of an infinite surface, down to 3e-8 of the peak; three maps scatter, and a ring has its mean of a steep fall.
    frequency, zero = np.array([0.05, 0.1, 0.15, 0.2, 0.25, 0.3]), np.zeros(6)
    theta = np.degrees(np.arcsin(0.55 * frequency))
    given = [build(gaussian_map(0.003, seed, 256), index=1.5, wavelength=[550.0]) for seed in range(3)]
    found = np.mean([representation(one).evaluate(zero, zero, theta, zero, None)[:, 0] for one in given], axis=0)
    variance = (2 * np.pi / 0.55 * (1 + np.cos(np.radians(theta))) * 0.003) ** 2
    order, factorial = np.array([[1.0], [2.0], [3.0]]), np.array([[1.0], [2.0], [6.0]])
    orders = variance**order / (factorial * order) * np.exp(-((np.pi * 5.0 * frequency) ** 2) / order)
    lobe = np.pi * 5.0**2 * np.exp(-variance) * orders.sum(axis=0)
    expected = fresnel(np.cos(np.radians(theta / 2)), 1.5).mean * lobe / 0.55**2
    np.testing.assert_allclose(found, expected, rtol=0.4)


def test_mirror_reflection_is_the_coherent_share():
    bsdf = diffracted(0.05)
    theta = np.array([0.0, 45.0, 80.0, 90.0])
    mirrored = representation(bsdf).specular(theta, np.zeros(4), None)[0][:, 0]
    cosine = np.cos(np.radians(theta))
    expected = fresnel(np.clip(cosine, 0, 1), 1.5).mean * np.exp(-((4 * np.pi * 0.05 * cosine / 0.55) ** 2))
    np.testing.assert_allclose(mirrored[:3], expected[:3], rtol=0.03)  # rms height of one map
    assert mirrored[3] == 0


def test_the_coherent_share_between_the_nodes_of_the_phase_is_that_of_the_heights():
    bsdf, theta = diffracted(0.05), np.linspace(0, 85, 200)
    cosine = np.cos(np.radians(theta))
    found = representation(bsdf).specular(theta, np.zeros(200), None)[0][:, 0] / fresnel(cosine, 1.5).mean
    # −ln(share)/q², the mean square height, hardly changes from node to node.
    phase = bsdf["phase_per_height"].values
    square = np.interp(4 * np.pi * cosine / 0.55, phase, -np.log(bsdf["coherent_share"].values) / phase**2)
    np.testing.assert_allclose(found, np.exp(-((4 * np.pi * cosine / 0.55) ** 2) * square), atol=1.5e-3)


def test_all_light_is_fresnels_reflectance():
    bsdf = diffracted(0.05)
    theta = np.array([0.0, 30.0, 60.0])
    np.testing.assert_allclose(
        representation(bsdf).albedo(theta, np.zeros(3), None)[:, 0],
        fresnel(np.cos(np.radians(theta)), 1.5).mean,
        rtol=0.01,
    )


def test_it_tends_to_the_facets_of_the_map():
    surface = gaussian_map(0.4)
    bsdf = build(surface, index=1.5, wavelength=[550.0])
    facet_model = build_microfacet(estimate(surface, isotropic=True), index=1.5, multiple_scattering="none")
    theta_o = np.linspace(21.0, 39.0, 7)
    angles = np.full(7, 30.0), np.zeros(7), theta_o, np.full(7, 180.0)
    waves, rays = (representation(one).evaluate(*angles, None)[:, 0] for one in (bsdf, facet_model))
    assert np.mean(waves / rays) == pytest.approx(1, abs=0.08)


def test_all_checks_pass():
    verdicts = json.loads(check(diffracted()).attrs["verdicts"])
    assert {entry["verdict"] for entry in verdicts.values()} == {"pass"}, verdicts


def test_the_total_reflectance_is_that_of_the_spectrum():
    bsdf = diffracted(spectral=True)
    reflectance = representation(bsdf).albedo(np.array([8.0]), np.zeros(1), None)[0]
    np.testing.assert_allclose(reflectance, bsdf["total_reflectance"], rtol=1e-9)


def test_the_mean_over_wavelength_is_that_of_every_wavelength():
    bsdf = diffracted(spectral=True)
    weight = np.exp(-(((bsdf["wavelength"].values - 555) / 50) ** 2))
    weight /= weight.sum()
    mean = representation(representation(bsdf).nonspectral(weight))
    angles = np.array([[20.0], [0.0], [23.0], [180.0]])
    expected = representation(bsdf).evaluate(*angles, None) @ weight
    # Wavelengths of a thousandth of the largest weight are left out; the base is averaged by itself.
    np.testing.assert_allclose(mean.evaluate(*angles, None)[:, 0], expected, rtol=0.01)
    mirrored = representation(bsdf).specular(angles[0], angles[1], None)[0] @ weight
    np.testing.assert_allclose(mean.specular(angles[0], angles[1], None)[0][:, 0], mirrored, rtol=0.01)


def test_it_is_stored_and_read_and_sampled(tmp_path):
    save_dataset(diffracted(), tmp_path / "kirchhoff.nc", stage="predicted", material="test")
    again = representation(open_dataset(tmp_path / "kirchhoff.nc"))
    drawn = again.sample(2000, 1, 30.0, 0.0, None)
    assert float(drawn["weight"].mean()) == pytest.approx(
        float(again.albedo(np.array([30.0]), np.zeros(1), None)[0, 0]), rel=0.05
    )
    assert (again.uncertainty(*np.array([[30.0], [0.0], [35.0], [180.0]]), None) > 0).all()


def test_each_change_of_diffracted_light_leaves_all_light_and_together_they_are_its_uncertainty():
    one = representation(diffracted())
    incidence = np.array([20.0, 60.0]), np.zeros(2), None
    assert len(one.changed) == 9
    for changed in one.changed:
        np.testing.assert_allclose(changed.albedo(*incidence), one.albedo(*incidence), rtol=2e-3)
    at = np.array([30.0, 60.0]), np.zeros(2), np.array([35.0, 65.0]), np.full(2, 180.0), None
    differences = np.array([changed.evaluate(*at) - one.evaluate(*at) for changed in one.changed])
    np.testing.assert_allclose(np.sqrt(np.square(differences).sum(axis=0)), one.uncertainty(*at), rtol=0.1)


def test_limits_of_the_method_are_reported(monkeypatch):
    steep = build(samples.gaussian_surface(128, sigma=0.3), index=1.5, wavelength=[5000.0])
    assert any("typical slope of the surface is 0.4" in text for text in vocabulary.warnings(steep))
    assert any("up to" in text and "mirror direction" in text for text in vocabulary.warnings(diffracted()))
    assert diffracted().attrs["diffracted_light_scaling"] == pytest.approx(1, abs=0.02)
    assert not any("was scaled by" in text for text in vocabulary.warnings(diffracted()))
    monkeypatch.setattr(kirchhoff, "SCALING_LIMIT", 1e-9)
    scaled = build(gaussian_map(0.05, size=64), index=1.5, wavelength=[550.0])
    assert any("diffracted light was scaled by" in text for text in vocabulary.warnings(scaled))


def test_more_light_than_there_is_at_grazing_incidence_is_reported():
    # The table of reflectances ends at 1, so that the checks do not see it.
    def excess(sigma: float) -> list[str]:
        return [text for text in vocabulary.warnings(diffracted(sigma)) if "leaves out masking, and" in text]

    assert len(excess(0.2)) == 1
    assert excess(0.013) == []
    assert representation(diffracted(0.2)).albedo(np.array([89.9]), np.zeros(1), None) <= 1


def test_unusable_input_is_refused():
    with pytest.raises(HeightMapError, match="increasing list of wavelengths"):
        build(gaussian_map(0.05), index=1.5, wavelength=[600.0, 500.0])
    with pytest.raises(HeightMapError, match="leave out `wavelength`"):
        build(gaussian_map(0.05), index=1.5, spectrum=samples.spectrum(), wavelength=[550.0])
    with pytest.raises(HeightMapError, match="line profile"):
        build(samples.surface(np.zeros(100)), index=1.5, wavelength=[550.0])
