"""Penalised least squares, against normal equations, and against 60 digits where these fail."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
import rig_primary

from brdfpipe.bsdf.measured.basis import Keldysh
from brdfpipe.bsdf.measured.least_squares import Decomposition, StandardForm

EPSILON = (1e-3, 1.0, 1e3)


@pytest.fixture(scope="module")
def problem():
    """Rows, roughness, weights with masks of their own, and values."""
    random = np.random.default_rng(0)
    rows, roughness = random.standard_normal((60, 12)), random.standard_normal((10, 12))
    weight, values = random.uniform(0.5, 2, (3, 60)), random.standard_normal((3, 60))
    weight[1, :30] = 0
    weight[2, 8:] = 0  # fewer values than coefficients
    return rows, roughness, weight, values


@pytest.mark.parametrize("epsilon", EPSILON)
def test_the_solution_is_that_of_the_normal_equations(problem, epsilon):
    rows, roughness, weight, values = problem
    parts = Decomposition.of(StandardForm.of(rows, roughness), weight, values)
    solution, spread = parts.solution(epsilon) @ parts.form.to_basis.T, parts.covariance_factor(epsilon)
    at = np.array([epsilon])
    for k in range(3):
        weighted = weight[k][:, None] * rows
        matrix = weighted.T @ weighted + epsilon * roughness.T @ roughness
        expected = np.linalg.solve(matrix, weighted.T @ (weight[k] * values[k]))
        assert solution[k] == pytest.approx(expected, rel=1e-9)
        factor = parts.form.to_basis @ spread[k]
        assert factor @ factor.T == pytest.approx(np.linalg.inv(matrix), rel=1e-7, abs=1e-9)
        smoother = weighted @ np.linalg.solve(matrix, weighted.T)
        residual = weight[k] * values[k] - weighted @ expected
        assert parts.effective_parameters(at)[k, 0] == pytest.approx(np.trace(smoother))
        assert parts.chi_squared(at)[k, 0] == pytest.approx((residual**2).sum(), rel=1e-6, abs=1e-9)
        assert parts.roughness(at)[k, 0] == pytest.approx(((roughness @ expected) ** 2).sum(), rel=1e-6)


def test_cross_validation_is_generalised_from_leaving_one_out():
    # Where every value has the same leverage the two are the same: a circulant smoother.
    count = 16
    angle = 2 * np.pi * np.arange(count) / count
    rows = np.stack([np.cos(k * angle) for k in range(5)] + [np.sin(k * angle) for k in range(1, 5)], axis=1)
    frequency = np.array([0, 1, 2, 3, 4, 1, 2, 3, 4])
    values = np.random.default_rng(2).standard_normal(count)
    parts = Decomposition.of(StandardForm.of(rows, np.diag(frequency**2.0)), np.ones((1, count)), values[None])
    epsilon = 0.05
    left_out = []
    for k in range(count):
        weight = np.ones(count)
        weight[k] = 0
        fit = Decomposition.of(parts.form, weight[None], values[None]).solution(epsilon)[0]
        left_out.append(values[k] - parts.form.rows[k] @ fit)
    assert parts.cross_validation(np.array([epsilon]))[0, 0] == pytest.approx(np.mean(np.square(left_out)), rel=1e-9)


def test_cross_validation_is_infinite_without_degrees_of_freedom(problem):
    rows, roughness, weight, values = problem
    parts = Decomposition.of(StandardForm.of(rows, roughness), weight, values)
    assert np.isinf(parts.cross_validation(np.array([1e-12]))[2, 0])


def test_some_problems_may_be_replaced(problem):
    rows, roughness, weight, values = problem
    form = StandardForm.of(rows, roughness)
    whole = Decomposition.of(form, weight, values)
    mixed = Decomposition.of(form, weight, 0 * values).replaced(
        np.array([0, 2]), Decomposition.of(form, weight[::2], values[::2])
    )
    assert mixed.solution(1.0)[[0, 2]] == pytest.approx(whole.solution(1.0)[[0, 2]])
    assert mixed.solution(1.0)[1] == pytest.approx(0)


def test_redundant_functions_are_left_out():
    random = np.random.default_rng(3)
    rows, roughness = random.standard_normal((20, 4)), random.standard_normal((6, 4))
    doubled = StandardForm.of(np.hstack([rows, rows[:, :2]]), np.hstack([roughness, roughness[:, :2]]))
    assert doubled.rows.shape[1] == 4
    values = random.standard_normal((1, 20))
    once = Decomposition.of(StandardForm.of(rows, roughness), np.ones((1, 20)), values)
    twice = Decomposition.of(doubled, np.ones((1, 20)), values)
    assert twice.solution(0.5) @ doubled.rows.T == pytest.approx(once.solution(0.5) @ once.form.rows.T)


def test_a_narrow_lobe_is_solved_where_normal_equations_lose_their_digits():
    # Weights 1/u² of a lobe over five decades, hardly any smoothing: the reference has 60 digits.
    theta, phi = (angle[::4] for angle in rig_primary.cells())
    seen = theta < 100
    theta, phi = theta[seen], phi[seen]
    functions = Keldysh(90.0, 6, 9, 0)
    rows, roughness = functions.rows(theta, phi, theta), functions.roughness(theta, phi)
    truth = 1e-2 + 2500 * rig_primary.gaussian(theta, 1.5)
    weight, epsilon = 50 / truth, 1e-10
    parts = Decomposition.of(StandardForm.of(rows, roughness), weight[None], truth[None])
    fitted = (parts.solution(epsilon) @ parts.form.rows.T)[0]
    with mpmath.workdps(60):
        weighted = mpmath.matrix((weight[:, None] * rows).tolist())
        penalty = mpmath.matrix(roughness.tolist())
        right = weighted.T * mpmath.matrix((weight * truth).tolist())
        exact = mpmath.lu_solve(weighted.T * weighted + epsilon * (penalty.T * penalty), right)
        expected = np.array((mpmath.matrix(rows.tolist()) * exact).tolist(), dtype=float)[:, 0]
    assert np.abs(weight * (fitted - expected)).max() < 1e-7
    matrix = (weight[:, None] * rows).T @ (weight[:, None] * rows) + epsilon * roughness.T @ roughness
    assert np.linalg.cond(matrix) > 1e20
    normal = rows @ np.linalg.solve(matrix, rows.T @ (weight**2 * truth))
    assert np.abs(weight * (normal - expected)).max() > 1e-5
