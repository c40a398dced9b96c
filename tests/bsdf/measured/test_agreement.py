from __future__ import annotations

import numpy as np
import pytest
import rig_primary
import samples
import xarray as xr

from brdfpipe.bsdf.measured import completion, smoothing
from brdfpipe.bsdf.measured.agreement import asymmetry, pair_differences, uncertainty_enlargement
from brdfpipe.bsdf.measured.reciprocity import reciprocity

INCIDENCES = (10.0, 30.0, 60.0)


@pytest.fixture(scope="module")
def smoothed() -> xr.Dataset:
    """A plastic that a rig measured at 10, 30 and 60 degree."""
    truth = rig_primary.of_model(samples.beckmann_bsdf(0.1, n=1.5).bsdf.nonspectral())
    return smoothing.smooth(rig_primary.measured(truth, INCIDENCES, (500.0, 550.0), noise=0.01))


@pytest.fixture(scope="module")
def completed(smoothed: xr.Dataset) -> xr.Dataset:
    """The same in all directions."""
    return completion.complete(smoothed)


def test_an_uncertainty_that_was_not_enlarged_is_that_of_the_smoothed_incidence(
    completed: xr.Dataset, smoothed: xr.Dataset
) -> None:
    assert uncertainty_enlargement(completed, smoothed) == pytest.approx(dict.fromkeys(INCIDENCES, 1.0), abs=1e-6)
    grown = completed.assign(coefficient_factor=2.5 * completed["coefficient_factor"])
    assert uncertainty_enlargement(grown, smoothed) == pytest.approx(dict.fromkeys(INCIDENCES, 2.5), rel=1e-6)


def test_the_uncertainties_of_a_pair_are_those_before_the_enlargement(completed: xr.Dataset) -> None:
    pairs = reciprocity(completed, 5)
    plain, reduced = (pair_differences(pairs, dict.fromkeys(INCIDENCES, factor)) for factor in (1.0, 2.0))
    for name, factor in {"difference": 1.0, "change_u": 1.0, "difference_u": 0.5, "score": 2.0}.items():
        np.testing.assert_allclose(reduced[name], factor * plain[name], rtol=1e-12)
    ratio = (pairs["forward"] / pairs["backward"]).median("wavelength")
    np.testing.assert_allclose(1 + plain["difference"], ratio, rtol=1e-12)
    product = (1 + plain["change_of_backward"]) / (1 + plain["change_of_forward"])
    # The medians of two wavelengths are means, which do not commute with a ratio.
    np.testing.assert_allclose(product, ratio, rtol=1e-3)


def test_only_a_significant_difference_of_the_two_sides_is_an_asymmetry(smoothed: xr.Dataset) -> None:
    one = smoothed.isel(incidence=1).sel(wavelength=500.0)
    assert asymmetry(one) == 0
    side = np.sign(np.sin(np.radians(one["phi_s"])))
    assert asymmetry(one.assign(residual=one["residual"] + 2 * side)) == pytest.approx(4.0, abs=1.0)
