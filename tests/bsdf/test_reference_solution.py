"""The reference solution that holds on a map is chosen by roughness and slope, and a map on which none holds is refused."""

from __future__ import annotations

import numpy as np
import pytest
import samples

from brdfpipe import vocabulary
from brdfpipe.bsdf.reference_solution import build, holds
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
