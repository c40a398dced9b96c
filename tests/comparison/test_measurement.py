"""Measured values: their covariance is that of the components, and common errors do not average out."""

from __future__ import annotations

import comparison_primary
import numpy as np
import pytest
import xarray as xr
from samples import beckmann_bsdf

from brdfpipe import vocabulary
from brdfpipe.comparison.measurement import ComparisonError, Measurement


@pytest.fixture(scope="module")
def primary() -> xr.Dataset:
    """Few enough values for a whole covariance matrix; below the horizon cells are missing."""
    whole = comparison_primary.measured(
        beckmann_bsdf(0.1), 3, incidences=(10.0, 45.0, 60.0), wavelengths=(500.0, 600.0)
    )
    return whole.isel(cell=np.arange(0, whole.sizes["cell"], 40))


def of(primary: xr.Dataset) -> Measurement:
    return Measurement.of(primary, np.arange(primary.sizes["wavelength"]))


def nothing(measurement: Measurement) -> np.ndarray:
    return np.zeros_like(measurement.value)


def dense(measurement: Measurement, primary: xr.Dataset, model: np.ndarray) -> np.ndarray:
    """The covariance of the values used, value by value and component by component, as each error was drawn."""
    places = np.argwhere(measurement.used)
    total = np.zeros((len(places), len(places)))
    for name, own in comparison_primary.OWN.items():
        u = primary[f"brdf_u_{name}"].values
        if name not in ("noise", "glare"):
            u = u * np.abs(model / primary["brdf"].values)
        u = u[measurement.used]
        same = np.ones_like(total, dtype=bool)
        for axis, dim in enumerate(comparison_primary.DIMS):
            if dim in own:
                same &= places[:, None, axis] == places[None, :, axis]
        total += np.where(same, u[:, None] * u, 0.0)
    return total


def test_the_covariance_is_that_of_the_errors_one_by_one(primary) -> None:
    measurement = of(primary)
    model = measurement.value * (1 + 0.01 * np.random.default_rng(1).standard_normal(measurement.value.shape))
    covariance = measurement.covariance(model, nothing(measurement), np.zeros((0, *model.shape)))
    matrix, residual = dense(measurement, primary, model), measurement.value - model
    expected = residual[measurement.used] @ np.linalg.solve(matrix, residual[measurement.used])
    assert covariance.chi_squared(residual) == pytest.approx(expected, rel=1e-9)


def test_errors_of_the_model_join_those_of_the_measurement(primary) -> None:
    measurement = of(primary)
    model, own_u = measurement.value, 0.02 * measurement.value
    common = np.random.default_rng(2).standard_normal((2, *model.shape))
    matrix = dense(measurement, primary, model) + np.diag(own_u[measurement.used] ** 2)
    matrix += sum(np.outer(error[measurement.used], error[measurement.used]) for error in common)
    residual = np.random.default_rng(3).standard_normal(model.shape)
    expected = residual[measurement.used] @ np.linalg.solve(matrix, residual[measurement.used])
    chi_squared = measurement.covariance(model, own_u, common).chi_squared(residual)
    assert chi_squared == pytest.approx(expected, rel=1e-9)


def test_chi_squared_of_errors_of_the_stated_size_is_the_number_of_values() -> None:
    truth = beckmann_bsdf(0.1)
    right = of(comparison_primary.measured(truth, None)).value
    ratios = []
    for seed in range(8):
        measurement = of(comparison_primary.measured(truth, seed))
        covariance = measurement.covariance(right, nothing(measurement), np.zeros((0, *right.shape)))
        ratios.append(covariance.chi_squared(measurement.value - right) / measurement.used.sum())
    count = len(ratios) * measurement.used.sum()
    assert np.mean(ratios) == pytest.approx(1, abs=4 * np.sqrt(2 / count))


def test_a_common_error_is_not_averaged_over_the_cells() -> None:
    """1 % independent with 3 % common makes an albedo uncertain by 3.0 %, not by 0.04 %."""
    flat = np.ones((1, 1, 600))
    dims = comparison_primary.DIMS
    primary = xr.Dataset(
        {
            "brdf": (dims, flat),
            "brdf_u": (dims, np.hypot(0.01, 0.03) * flat),
            "brdf_u_noise": (dims, 0.01 * flat, {"correlation": "independent"}),
            "brdf_u_certificate": (dims, 0.03 * flat, {"correlation": "common"}),
        },
        coords={
            "incidence": [0.0],
            "wavelength": [550.0],
            "theta_s": ("cell", np.linspace(0, 80, 600)),
            "phi_s": ("cell", np.zeros(600)),
        },
    )
    measurement = of(vocabulary.label(primary, "primary"))
    weight = np.full(flat.shape, 1 / 600)
    assert measurement.sum_u(weight)[0, 0] == pytest.approx(np.hypot(0.03, 0.01 / np.sqrt(600)), rel=1e-12)


@pytest.mark.parametrize("component", ["nd", "reference"])
def test_cells_of_different_frames_have_the_variance_of_the_better_known_one_in_common(component) -> None:
    """Frames form a chain: cells of the next darker frame have the errors of the clearest one, and their own."""
    value, own, chained = np.array([2.0, 3.0, 5.0, 7.0]), 0.001, np.array([0.01, 0.01, 0.02, 0.02])
    dims = comparison_primary.DIMS
    primary = xr.Dataset(
        {
            "brdf": (dims, value[None, None]),
            "brdf_u": (dims, np.hypot(own, chained * value)[None, None]),
            "brdf_u_noise": (dims, np.full((1, 1, 4), own), {"correlation": "independent"}),
            f"brdf_u_{component}": (dims, (chained * value)[None, None], {"correlation": "common"}),
        },
        coords={
            "incidence": [0.0],
            "wavelength": [550.0],
            "theta_s": ("cell", np.linspace(0, 30, 4)),
            "phi_s": ("cell", np.zeros(4)),
        },
    )
    measurement = of(vocabulary.label(primary, "primary"))
    residual = np.array([0.01, -0.02, 0.1, 0.05])
    matrix = own**2 * np.eye(4) + np.minimum.outer(chained, chained) ** 2 * np.outer(value, value)
    covariance = measurement.covariance(measurement.value, nothing(measurement), np.zeros((0, 1, 1, 4)))
    assert covariance.chi_squared(residual[None, None]) == pytest.approx(
        residual @ np.linalg.solve(matrix, residual), rel=1e-9
    )


def test_unmeasured_values_do_not_count(primary) -> None:
    measurement = of(primary)
    assert not measurement.used.all()
    model = np.where(measurement.used, measurement.value, 1e9)
    residual = np.where(measurement.used, 0.0, 1e9)
    covariance = measurement.covariance(model, nothing(measurement), np.full((1, *model.shape), 1e9))
    assert covariance.chi_squared(residual) == 0
    assert (measurement.value[~measurement.used] == 0).all()


@pytest.mark.parametrize("flag", ["saturated", "clamped", "vignetted", "shadowed", "extrapolated"])
def test_a_doubtful_value_is_left_out(primary, flag) -> None:
    quality = primary["brdf_quality"].copy()
    quality[0, 0, 0] = vocabulary.quality(flag)
    assert of(primary).used[0, 0, 0]
    assert not of(primary.assign(brdf_quality=quality)).used[0, 0, 0]


def test_a_value_below_the_noise_is_used(primary) -> None:
    quality = primary["brdf_quality"].copy()
    quality[0, 0, 0] = vocabulary.quality("below_noise")
    assert of(primary.assign(brdf_quality=quality)).used[0, 0, 0]


def test_a_component_has_its_stated_correlation(primary) -> None:
    stated = primary["brdf_u_calibration"].assign_attrs(correlation="common")
    before, after = (
        of(dataset).correlated(among_cells=True) for dataset in (primary, primary.assign(brdf_u_calibration=stated))
    )
    u = np.where(of(primary).used, primary["brdf_u_calibration"].values, 0.0)
    np.testing.assert_allclose(after, np.hypot(before, u))


def test_without_components_the_combined_uncertainty_is_independent(primary) -> None:
    plain = primary.drop_vars([name for name in primary.data_vars if str(name).startswith("brdf_u_")])
    measurement = of(plain)
    np.testing.assert_array_equal(measurement.correlated(among_cells=False), measurement.u)
    assert not measurement.correlated(among_cells=True).any()


def test_nothing_measured_is_refused(primary) -> None:
    with pytest.raises(ComparisonError, match="no cell of the rig has a measured value"):
        of(primary.assign(brdf=primary["brdf"] * np.nan))


def test_a_value_without_an_uncertainty_is_refused(primary) -> None:
    u = primary["brdf_u_noise"].copy()
    u[1, 0, 2] = 0.0
    with pytest.raises(ComparisonError, match=r"no independent uncertainty.*45°, 500 nm, cell 2"):
        of(primary.assign(brdf_u_noise=u))


def test_an_unknown_correlation_is_refused(primary) -> None:
    with pytest.raises(ComparisonError, match="accepted: independent, common"):
        of(primary.assign(brdf_u_noise=primary["brdf_u_noise"].assign_attrs(correlation="some")))
