from __future__ import annotations

import numpy as np
import pytest

from brdfpipe.facets import analytic, student_slopes
from brdfpipe.facets.radial_density import RadialDensity


@pytest.mark.parametrize(("name", "tail"), [("beckmann", 0.0), ("ggx", 1.0)])
def test_the_ends_of_the_family_are_the_named_densities(name: str, tail: float) -> None:
    facets = analytic(name, 0.2)
    slope = facets["slope"].values
    np.testing.assert_allclose(
        student_slopes.density(slope, 0.2, tail), facets["slope_density"].values, rtol=1e-9, atol=1e-290
    )


@pytest.mark.parametrize("tail", [0.0, 0.25, 0.5, 1.0])
def test_a_density_is_normalised_and_has_its_median(tail: float) -> None:
    slope = 0.3 * np.sinh(np.linspace(0, np.arcsinh(1e7 if tail else 8.3), 1024))
    density = RadialDensity(slope, student_slopes.density(slope, 0.3, tail))
    # Beyond the last slope of a tail there are 1e-14 of the facets; the rest is the spline between 1024 nodes.
    assert density.mass == pytest.approx(1, abs=1e-6)
    # Linear between the nodes of a quadrature.
    assert density.median_slope == pytest.approx(0.3 * student_slopes.median_over_width(tail), rel=0.01)


def test_the_family_is_continuous_at_beckmann() -> None:
    slope = np.linspace(0, 1, 50)
    near, at = (student_slopes.density(slope, 0.3, tail) for tail in (1e-7, 0.0))
    np.testing.assert_allclose(near, at, rtol=1e-4)
