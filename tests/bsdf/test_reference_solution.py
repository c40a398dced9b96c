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


RELIEFS = (0.45, 6.0, 1), (0.035, 0.6, 7)
"""Rms height [um], correlation length [um] and seed of a relief, and of a finer roughness on it."""


def two_scales(reliefs, size: int = 256):
    """A Gaussian relief, alone or with a finer roughness, at a pitch of 0.2 µm."""
    return samples.surface(sum(heights_of(relief, size) for relief in reliefs), (0.2, 0.2))


def heights_of(relief: tuple[float, float, int], size: int = 256) -> np.ndarray:
    sigma, length, seed = relief
    return random_surfaces.heights(random_surfaces.gaussian(sigma, length), (size, size), (0.2, 0.2), seed)


def expected_smoothness(parts: list[tuple[float, float]], theta_i: float, pitch: float = 1e-3) -> float:
    """Mean square height difference where it gives a phase variance of 2, over that of even slopes between heights a ``pitch`` apart, of
    Gaussian spectra of σ and ℓ [um]."""
    target = 2 / (4e3 * np.pi * np.cos(np.radians(theta_i)) / WAVELENGTH) ** 2

    def difference(r: float) -> float:
        return sum(2 * s**2 * -np.expm1(-((r / length) ** 2)) for s, length in parts)

    r = brentq(lambda r: difference(r) - target, 1e-3, 10)
    return target / (difference(pitch) * (r / pitch) ** 2)


def as_steep(relief: tuple[float, float, int], axis: int) -> tuple[float, float]:
    """σ and ℓ of a relief whose differences between neighbours along an axis are those of this map: a small one is steeper or gentler by chance."""
    length = relief[1]
    square = np.square(np.diff(heights_of(relief), axis=axis)).mean()
    return float(np.sqrt(square / (2 * -np.expm1(-((0.2 / length) ** 2))))), length


@pytest.mark.parametrize("reliefs", [RELIEFS[:1], RELIEFS])
def test_the_smoothness_of_facets_is_that_of_the_structure_function(reliefs):
    theta_i = np.array([0.0, 20.0])
    along_axes = [[as_steep(relief, axis) for relief in reliefs] for axis in (0, 1)]
    expected = [min(expected_smoothness(parts, angle, 0.2) for parts in along_axes) for angle in theta_i]
    found = facet_smoothness(two_scales(reliefs), theta_i)
    # The shape of the structure function of so small a map; one relief, whose smoothness is nearly 1, has as much.
    np.testing.assert_allclose(found, expected, rtol=0.005)
    assert ((found >= SMOOTH_FACETS) == (len(reliefs) == 1)).all()


def test_of_one_scale_the_smoothness_is_that_of_the_phase_variance():
    g = (4e3 * np.pi * 0.45 / WAVELENGTH) ** 2
    assert expected_smoothness([(0.45, 6.0)], 0.0) == pytest.approx(1 - 1 / (2 * g), rel=1e-4)


def test_finer_roughness_than_facets_is_diffracted_though_the_phase_variance_is_large():
    assert build(two_scales(RELIEFS, 128), index=1.5, rays=640).attrs["representation"] == "kirchhoff"
    assert build(two_scales(RELIEFS[:1]), index=1.5, rays=640).attrs["representation"] == "traced"


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
