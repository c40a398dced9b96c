"""The relative error of a model as a standard uncertainty."""

import numpy as np
import xarray as xr

from brdfpipe.comparison.error_as_uncertainty import relative_error

PLANES = ["along the lay", "across the lay"]
BY_REGION = ("reference", "plane", "theta_i", "region")


def compared(valid: list[list[int]]) -> xr.Dataset:
    """Errors of traced rays, 3 % and -4 % in the planes, and of diffraction, 6 % and 8 %; uncertain by 3 %."""
    error = np.array([[0.03, -0.04], [0.06, 0.08]])[:, :, None, None] * np.ones((1, 1, 2, 1))
    return xr.Dataset(
        {
            "light_error": (BY_REGION, error),
            "light_error_u": (BY_REGION, np.full_like(error, 0.03)),
            "valid": (("reference", "theta_i"), valid),
        },
        {"reference": ["traced", "kirchhoff"], "plane": PLANES, "theta_i": [0.0, 60.0], "region": ["peak"]},
    )


def test_relative_error_is_that_of_the_reference_that_holds_in_the_worse_plane():
    error = relative_error(compared([[1, 0], [1, 1]]))
    assert error.dims == ("theta_i", "region")
    np.testing.assert_allclose(error[:, 0], [np.hypot(0.04, 0.03), np.hypot(0.08, 0.03)])


def test_relative_error_is_missing_where_no_reference_holds():
    assert relative_error(compared([[0, 1], [0, 0]])).isnull().values.ravel().tolist() == [True, False]
