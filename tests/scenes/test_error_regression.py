"""A quantity regressed on features."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import check_grad

from brdfpipe.scenes import error_regression
from brdfpipe.scenes.error_regression import Regression, expected_parameters


def sample(count: int, noise: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Features and logarithms of a quantity that follows from the first two of four."""
    rng = np.random.default_rng(seed)
    features = rng.normal(size=(count, 4))
    return features, np.sin(features[:, 0]) + 0.5 * features[:, 1] + noise * rng.normal(size=count)


def test_what_is_left_out_is_what_a_regression_without_it_predicts():
    features, logarithms = sample(30, 0.1, 0)
    regression = Regression(features, logarithms, expected_parameters(4))
    for number, left_out in enumerate(regression.left_out()):
        others = np.arange(30) != number
        found = Regression(features[others], logarithms[others], regression.parameters).at(features[number].tolist())
        assert found == pytest.approx(left_out, rel=1e-9)


def test_the_gradient_is_that_of_the_cost():
    features, logarithms = sample(25, 0.2, 1)
    at = np.array(expected_parameters(4)) + np.random.default_rng(2).normal(scale=0.3, size=6)

    def cost(parameters):
        return error_regression._cost(parameters, features, logarithms)

    missed = check_grad(lambda p: cost(p)[0], lambda p: cost(p)[1], at)
    assert missed < 1e-5 * np.linalg.norm(cost(at)[1])


@pytest.mark.parametrize("noise", [0.05, 0.5])
def test_new_materials_scatter_as_stated(noise):
    features, logarithms = sample(600, noise, 3)
    regression = Regression.fitted(features[:150], np.exp(logarithms[:150]))
    predictions = [regression.at(row.tolist()) for row in features[150:]]
    z = [(value - one.mean) / one.deviation for value, one in zip(logarithms[150:], predictions, strict=True)]
    # The rms of 450 normal deviates has a standard deviation of 0.033; the parameters are uncertain too.
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1, abs=0.2)
    share = np.mean([value < np.log(one.bound(2.33)) for value, one in zip(logarithms[150:], predictions, strict=True)])
    assert share > 0.97


def test_far_from_all_materials_nothing_is_known():
    features, logarithms = sample(60, 0.05, 4)
    regression = Regression.fitted(features, np.exp(logarithms))
    near, far = (regression.at([at] * 4).deviation for at in (0.0, 50.0))
    assert near < 0.3
    assert far > np.std(logarithms) / 2
    assert far > 3 * near


@pytest.mark.parametrize("features", [np.zeros((20, 3)), np.arange(60.0).reshape(20, 3)])
def test_equal_materials_and_equal_errors_are_no_obstacle(features):
    regression = Regression.fitted(features, np.full(20, 2.0))
    assert regression.at(features[0].tolist()).bound(0.0) == pytest.approx(2.0, rel=0.05)
    assert np.isfinite([value for one in regression.left_out() for value in one]).all()


def test_a_step_between_two_values_is_fitted():
    features = np.random.default_rng(5).normal(size=(80, 4))
    regression = Regression.fitted(features, np.where(features[:, 0] > 0.5, 10.0, 0.01))
    assert np.isfinite(regression.parameters).all()
