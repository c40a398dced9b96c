"""The reference solution that holds on a map is chosen by roughness and slope, and a map on which none holds is refused."""

from __future__ import annotations

import numpy as np
import pytest
import random_surfaces
import samples
from scipy.optimize import brentq

from brdfpipe import vocabulary
from brdfpipe.bsdf.reference_solution import SMOOTH_FACETS, WAVELENGTH, build, facet_smoothness, holds
from brdfpipe.references.height_mesh import HeightMapError


def scaled(sigma: float, pitch: float, size: int = 128):
    """A Gaussian map of an rms height [um], correlated over sixteen samples."""
    height = samples.gaussian_surface(size, correlation=16.0)["height"].values
    return samples.surface(height / height.std() * sigma, (pitch, pitch))


@pytest.mark.parametrize(
    ("sigma", "pitch", "representation"),
    [(2.0, 4.0, "traced"), (0.05, 0.5, "kirchhoff"), (0.25, 1.0, "kirchhoff"), (0.4, 1.0, "traced")],
)
def test_rays_hold_on_rough_maps_and_diffraction_on_smooth_ones(sigma, pitch, representation):
    bsdf = build(scaled(sigma, pitch), index=1.5, spectrum=samples.spectrum(0.3), rays=640)
    assert bsdf.attrs["representation"] == representation
    assert vocabulary.validate(bsdf, "bsdf") is bsdf


def two_scales(fine: float, size: int = 256):
    """A Gaussian relief of 0.45 µm, ℓ 6 µm, with a finer roughness of ℓ 0.6 µm, at a pitch of 0.2 µm."""
    parts = [
        random_surfaces.heights(random_surfaces.gaussian(*shape), (size, size), (0.2, 0.2), seed)
        for shape, seed in (((0.45, 6.0), 1), ((max(fine, 1e-9), 0.6), 7))
    ]
    return samples.surface(parts[0] + parts[1], (0.2, 0.2))


def expected_smoothness(parts: list[tuple[float, float]], theta_i: float) -> float:
    """Mean square height difference where it gives a phase variance of 2, over that of the slopes, of Gaussian spectra of σ and ℓ [um]."""
    target = 2 / (4e3 * np.pi * np.cos(np.radians(theta_i)) / WAVELENGTH) ** 2
    r = brentq(lambda r: sum(2 * s**2 * -np.expm1(-((r / length) ** 2)) for s, length in parts) - target, 1e-3, 10)
    return target / sum(2 * (s * r / length) ** 2 for s, length in parts)


@pytest.mark.parametrize("fine", [0.0, 0.035])
def test_the_smoothness_of_facets_is_that_of_the_structure_function(fine):
    theta_i = np.array([0.0, 20.0])
    expected = [expected_smoothness([(0.45, 6.0), (fine, 0.6)], angle) for angle in theta_i]
    # Slopes are those between the samples.
    found = facet_smoothness(two_scales(fine), theta_i)
    np.testing.assert_allclose(found, expected, rtol=0.1 if fine else 0.005)
    assert ((found >= SMOOTH_FACETS) == (fine == 0)).all()


def test_of_one_scale_the_smoothness_is_that_of_the_phase_variance():
    g = (4e3 * np.pi * 0.45 / WAVELENGTH) ** 2
    assert expected_smoothness([(0.45, 6.0)], 0.0) == pytest.approx(1 - 1 / (2 * g), rel=1e-4)


def test_finer_roughness_than_facets_is_diffracted_though_the_phase_variance_is_large():
    assert build(two_scales(0.035, 128), index=1.5, rays=640).attrs["representation"] == "kirchhoff"
    assert build(two_scales(0.0), index=1.5, rays=640).attrs["representation"] == "traced"


def test_rays_that_fail_at_grazing_incidence_say_so():
    bsdf = build(scaled(0.3, 0.1), index=1.5, rays=640)
    assert bsdf.attrs["representation"] == "traced"
    assert any("rays hold up to 49°" in text for text in vocabulary.warnings(bsdf))


def test_a_map_on_which_no_reference_holds_is_refused():
    with pytest.raises(HeightMapError, match=r"no reference solution holds on this map.*Set `model.truth: check`"):
        build(scaled(0.1, 0.05), index=1.5)


def test_a_line_profile_is_refused():
    with pytest.raises(HeightMapError, match="a line profile has no second dimension"):
        build(samples.surface(np.arange(100.0) % 7), index=1.5)


def test_conditions_are_those_of_phase_slope_and_masking():
    theta_i = np.array([0.0, 75.0, 89.0])
    held = holds(np.array([300.0, 20.0, 0.1]), 0.1, theta_i)
    assert held.traced.tolist() == [True, True, False]
    # At 75 degree facets of slope 0.1 mask each other; at 89 degree the light is coherent.
    assert held.kirchhoff.tolist() == [True, False, True]
    assert not holds(np.array([300.0, 20.0, 0.1]), 0.3, theta_i).kirchhoff.any()
