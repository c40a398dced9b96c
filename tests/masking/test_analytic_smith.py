from __future__ import annotations

import mpmath
import numpy as np
import pytest

from brdfpipe.facets import analytic
from brdfpipe.masking.analytic_smith import beckmann_lambda, ggx_lambda


def test_the_masking_of_beckmann_is_the_closed_form() -> None:
    # G1 of Beckmann a = 0.3 at 60, 75, 85 degree
    g1 = 1 / (1 + beckmann_lambda(np.array([60.0, 75.0, 85.0]), 0.3))
    np.testing.assert_allclose(g1, [0.99963733, 0.96249761, 0.64581632], atol=1e-8)


def test_the_masking_of_ggx_is_that_of_its_slope_density() -> None:
    facets = analytic("ggx", 0.2)
    theta = np.array([45.0, 70.0, 85.0])
    own = 1 / (1 + np.interp(theta, facets["theta"].values, facets["lambda_smith"].values))
    np.testing.assert_allclose(1 / (1 + ggx_lambda(theta, 0.2)), own, atol=2e-3)


@pytest.mark.parametrize(("theta", "width"), [(1e-3, 1e-6), (1e-6, 0.1), (60.0, 1e-6), (89.9, 10.0)])
def test_ggx_keeps_its_digits_where_little_is_masked(theta, width):
    with mpmath.workdps(50):
        slope = mpmath.mpf(width) * mpmath.tan(mpmath.radians(mpmath.mpf(theta)))
        expected = float((mpmath.sqrt(1 + slope**2) - 1) / 2)
    assert float(ggx_lambda(theta, width)) == pytest.approx(expected, rel=1e-12, abs=0)
