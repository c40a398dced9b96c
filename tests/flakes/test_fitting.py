"""Fits along the flake angle."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from brdfpipe.errors import InputError
from brdfpipe.flakes import directions, fit, flake_angle, leave_one_out
from brdfpipe.flakes.forms import FORMS, ChannelData, curve
from brdfpipe.flakes.least_squares_fit import least_squares_curve

PATENT = np.array([float(flake_angle(*directions(name), 1.524)) for name in ("45:-30", "45:0", "45:65")])
TEN = np.array([3.3, 5.0, 7.1, 9.0, 11.5, 14.0, 18.0, 23.0, 28.0, 33.0])


def column(*values):
    return np.array(values, dtype=float)[:, None]


def test_the_patents_luminances_give_the_reference_parameters():
    # 0.33986494 belongs to L* = 3.07 with the rounded constant 903.3, as the patent's time used it.
    fitted = fit(PATENT, column(7.96026763, 1.45052385, 0.33986494))
    assert float(fitted.amplitude[0, 0]) == pytest.approx(17.78740303, abs=5e-8)
    assert float(fitted.decay[0, 0]) == pytest.approx(5.03256792, abs=5e-8)
    assert float(fitted.constant[0]) == pytest.approx(0.30947027, abs=5e-9)


@given(
    st.floats(0.01, 1e4),
    st.floats(1, 60),
    st.floats(0, 100),
    st.tuples(st.floats(0, 12), st.floats(1, 15), st.floats(1, 15)),
    st.sampled_from(["exponential", "gaussian"]),
)
def test_three_points_are_met_exactly(amplitude, decay, constant, steps, form):
    theta = np.cumsum(steps)
    power = FORMS[form].power
    values = curve(theta, column(amplitude), column(decay), np.array([constant]), power)
    # What rounding hides cannot be found again, nor what is next to black.
    if values[1, 0] < 1e-8:
        return
    if abs(values[1, 0] - values[2, 0]) < 1e-6 * values[0, 0] or (theta[2] / decay) ** power < 0.1:
        return
    fitted = fit(theta, values, form)
    assert fitted(theta) == pytest.approx(values, rel=1e-9)
    assert float(fitted.decay[0, 0]) == pytest.approx(decay, rel=1e-3)


def test_the_order_of_the_geometries_does_not_matter():
    values = column(7.96, 1.45, 0.34)
    order = [2, 0, 1]
    assert fit(PATENT[order], values[order]).decay == pytest.approx(fit(PATENT, values).decay)


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        (
            (1.0, 2.0, 0.5),
            "A of the fit is out of range: the colour is brighter at a flake angle of 13.82 than at 4.246 degree",
        ),
        ((3.0, 1.0, 1.5), "A of the fit is out of range: the colour is brighter at a flake angle of 32.07"),
        ((3.0, 3.0, 1.0), "B of the fit is out of range: the colour is the same"),
        ((3.0, 1.0, 1.0), "B of the fit is out of range: the colour does not fall from 13.82"),
        ((3.0, 2.9, 0.1), "B of the fit is out of range: the colour falls linearly or ever faster"),
        (
            (10.0, 4.0, 0.1),
            r"C of the fit is out of range: the colour falls so slowly with the flake angle that C would be negative \(-",
        ),
    ],
)
def test_parameters_out_of_range_are_refused_with_the_reason(values, reason):
    with pytest.raises(InputError, match=reason) as refused:
        fit(PATENT, column(*values), channels=["Y"])
    assert "channel Y" in str(refused.value)
    assert "multiangle.form" in str(refused.value)


def test_a_channel_that_does_not_depend_on_the_angle_is_constant():
    fitted = fit(PATENT, column(2.0, 2.0, 2.0))
    assert (float(fitted.amplitude[0, 0]), float(fitted.constant[0])) == (0.0, 2.0)


@pytest.mark.parametrize("angles", [PATENT, TEN])
def test_black_stays_black(angles):
    fitted = fit(angles, np.zeros((angles.size, 1)))
    assert (fitted(np.linspace(0, 40, 9)) == 0).all()


def test_black_far_from_the_gloss_is_accepted_if_the_curve_ends_at_0():
    theta = np.array([0.0, 10.0, 800.0])
    fitted = fit(theta, column(10.0, 1.0, 0.0))
    assert fitted(theta) == pytest.approx(column(10.0, 1.0, 0.0), abs=1e-12)


@pytest.mark.parametrize("form", list(FORMS))
def test_more_geometries_without_noise_give_the_parameters_back(form):
    terms, power = FORMS[form].terms, FORMS[form].power
    amplitude, decay = np.array([[20.0], [8.0]])[:terms], np.array([[3.5], [14.0]])[:terms]
    values = curve(TEN, amplitude, decay, np.array([0.3]), power)
    fitted = fit(TEN, values, form)
    # Two decays of a few degrees are resolved to about the square root of rounding.
    assert fitted.decay == pytest.approx(decay, rel=1e-6)
    assert fitted.amplitude == pytest.approx(amplitude, rel=1e-6)
    assert fitted(TEN) == pytest.approx(values, rel=1e-12)


def test_ten_geometries_with_2_percent_noise_are_recovered_within_3_percent():
    random = np.random.default_rng(7)
    truth = curve(TEN, column(18.0), column(5.0), np.array([0.31]), 1)
    between = np.linspace(TEN.min(), TEN.max(), 101)
    exact = curve(between, column(18.0), column(5.0), np.array([0.31]), 1)
    errors = []
    for _ in range(40):
        noisy = truth * (1 + 0.02 * random.standard_normal(truth.shape))
        errors.append(np.abs(fit(TEN, noisy)(between) / exact - 1))
    assert np.median(errors) < 0.03
    assert max(np.median(error) for error in errors) < 0.03


def test_the_covariance_is_that_of_repeated_fits():
    random = np.random.default_rng(3)
    truth = curve(TEN, column(18.0), column(5.0), np.array([0.31]), 1)
    fits = [fit(TEN, truth * (1 + 0.02 * random.standard_normal(truth.shape))) for _ in range(60)]
    spread = np.std([fitted.decay[0, 0] for fitted in fits])
    stated = np.median([np.sqrt(fitted.covariance[0, 1, 1]) for fitted in fits])
    # The spread of 60 is known to 9 %, each estimate from 7 degrees of freedom to 27 %, its median to some 5 %.
    assert stated == pytest.approx(spread, rel=0.3)


def test_an_exact_fit_to_values_of_unknown_uncertainty_has_no_covariance():
    assert np.isnan(fit(PATENT, column(8, 1.5, 0.3)).covariance).all()


def emulated(count: int, relative: float, absolute: float, theta=TEN, form="exponential", seed=5):
    """Pulls (fitted less true over stated uncertainty) of the parameters of many noisy paints: (count, parameters)."""
    random = np.random.default_rng(seed)
    terms = FORMS[form].terms
    amplitude, decay = np.array([[18.0], [6.0]])[:terms], np.array([[4.0], [16.0]])[:terms]
    truth = curve(theta, amplitude, decay, np.array([2.0]), FORMS[form].power)
    u = relative * truth + absolute
    noisy = truth + u * random.standard_normal((theta.size, count))
    fitted = fit(theta, noisy, form, uncertainty=np.broadcast_to(u, noisy.shape))
    parameters = np.stack(
        [
            *[parameter for pair in zip(fitted.amplitude, fitted.decay, strict=True) for parameter in pair],
            fitted.constant,
        ]
    )
    true = np.array([*np.stack([amplitude[:, 0], decay[:, 0]], axis=1).ravel(), 2.0])
    return (parameters.T - true) / np.sqrt(np.diagonal(fitted.covariance, axis1=1, axis2=2))


@pytest.mark.cases(1)
@pytest.mark.parametrize(
    ("relative", "absolute", "form"),
    [(0.01, 0.0, "exponential"), (0.002, 0.03, "exponential"), (0.0, 0.05, "gaussian")],
)
def test_parameters_are_as_far_off_as_the_uncertainties_of_the_values_say(relative, absolute, form):
    pulls = emulated(400, relative, absolute, form=form)
    # 400 samples know their standard deviation to 3.5 %, and their mean to 5 % of it.
    assert pulls.std(axis=0) == pytest.approx(1.0, abs=0.12)
    assert pulls.mean(axis=0) == pytest.approx(0.0, abs=0.16)
    assert np.mean(np.abs(pulls) > 3) < 0.012


@pytest.mark.parametrize(("paints", "within"), [(15, 0.55), pytest.param(60, 0.3, marks=pytest.mark.slow)])
def test_two_terms_are_as_far_off_as_the_uncertainties_of_the_values_say(paints, within):
    pulls = emulated(paints, 0.0005, 0.0, np.linspace(2, 40, 14), "double-exponential")
    # The standard deviation of 15 samples is known to 18 %, of 60 to 9 %.
    assert pulls.std(axis=0) == pytest.approx(1.0, abs=within)


def test_three_geometries_have_an_uncertainty_where_their_values_do():
    pulls = emulated(600, 0.003, 0.0, PATENT)
    assert pulls.std(axis=0) == pytest.approx(1.0, abs=0.12)


def test_a_value_of_large_uncertainty_hardly_counts():
    values = curve(TEN, column(18.0), column(5.0), np.array([0.31]), 1)
    u = 0.01 * values
    values[4], u[4] = 1.5 * values[4], 100 * values[4]
    assert float(fit(TEN, values, uncertainty=u).decay[0, 0]) == pytest.approx(5.0, rel=1e-4)
    assert abs(float(fit(TEN, values).decay[0, 0]) - 5) > 0.1
    left_out = leave_one_out(TEN, values, uncertainty=u)
    assert left_out[4] == pytest.approx(values[4] / 1.5, rel=1e-4)


def test_a_dark_channel_within_its_uncertainty_is_constant():
    # Brighter far from the gloss by 10 %, or by chance at one geometry: without uncertainties both are refused.
    rising, dark = column(*np.linspace(0.2, 0.22, 10)), column(0.25, *[0.2] * 9)
    for values, parameter in ((rising * [[0.8]] + column(*[0.0] * 9, 0.08), "A"), (dark, "B")):
        with pytest.raises(InputError, match=f"{parameter} of the fit is out of range"):
            fit(TEN, values)
        fitted = fit(TEN, values, uncertainty=np.full((10, 1), 0.03))
        assert float(fitted.constant[0]) == pytest.approx(values.mean(), rel=1e-9)
        assert float(np.sqrt(fitted.covariance[0, 2, 2])) == pytest.approx(0.03 / np.sqrt(10))


@given(st.floats(1e-6, 1e6))
def test_equal_relative_uncertainties_change_the_covariance_alone(factor):
    values = curve(TEN, column(18.0), column(5.0), np.array([0.31]), 1) * (1 + 0.02 * np.sin(7 * TEN))[:, None]
    # Squares are flat at their least: rounding moves it by about its square root.
    plain, weighed = fit(TEN, values), fit(TEN, values, uncertainty=factor * values)
    assert weighed.decay == pytest.approx(plain.decay, rel=1e-7)
    assert weighed.amplitude == pytest.approx(plain.amplitude, rel=1e-7)


@pytest.mark.parametrize("u", [np.zeros((10, 1)), np.full((10, 1), np.nan), np.full((10, 1), -1.0), np.ones((9, 1))])
def test_invalid_uncertainties_are_refused(u):
    with pytest.raises(InputError, match="invalid uncertainties"):
        fit(TEN, np.ones((10, 1)), uncertainty=u)


def test_leaving_one_out_of_perfect_data_predicts_it():
    values = curve(TEN, column(18.0), column(5.0), np.array([0.31]), 1)
    assert leave_one_out(TEN, values) == pytest.approx(values, rel=1e-9)


def test_leaving_one_out_of_three_is_not_possible():
    assert np.isnan(leave_one_out(PATENT, column(8, 1.5, 0.3))).all()


def test_leaving_one_out_reveals_a_wrong_geometry():
    values = curve(TEN, column(18.0), column(5.0), np.array([0.31]), 1)
    values[4] *= 1.3
    error = np.abs(leave_one_out(TEN, values) / values - 1)
    assert int(error.argmax()) == 4


@pytest.mark.parametrize(
    ("theta", "found"),
    [
        (np.array([5.0, 5.0, 20.0]), "2 in 3 geometries"),
        (np.array([5.0, 5.0 + 1e-5, 20.0, 20.0]), "2 in 4 geometries"),
        (np.array([5.0, 20.0]), "2 in 2 geometries"),
    ],
)
def test_too_few_different_flake_angles_are_refused(theta, found):
    with pytest.raises(InputError, match=f"too few different flake angles.*{found}"):
        fit(theta, np.linspace(2, 1, theta.size)[:, None])


def test_repeated_geometries_are_averaged_in_relative_squares():
    theta, values = np.array([5.0, 5.0, 15.0, 30.0]), column(8.0, 8.2, 1.5, 0.4)
    fitted = fit(theta, values)
    assert float(fitted(5.0)[0]) == pytest.approx(8.1, rel=2e-3)
    assert fitted(np.array([15.0, 30.0])) == pytest.approx(values[2:], rel=1e-6)


def test_noise_that_pulls_the_constant_below_0_leaves_it_at_0():
    fitted = fit(TEN, curve(TEN, column(18.0), column(8.0), np.array([0.0]), 1) - 0.1)
    assert float(fitted.constant[0]) == 0


@pytest.mark.parametrize(
    ("values", "parameter"),
    [(1 + TEN, "A"), (1200 - TEN**2, "C"), (33.5 - TEN, "C"), (np.where(TEN < 4, 50.0, 1.0), "B")],
)
def test_many_geometries_of_another_shape_are_refused(values, parameter):
    with pytest.raises(InputError, match=f"{parameter} of the fit is out of range"):
        fit(TEN, values[:, None])


@pytest.mark.parametrize("values", [column(1, np.nan, 1), column(1, -0.1, 1), column(np.inf, 1, 1)])
def test_undefined_and_negative_values_are_refused(values):
    with pytest.raises(InputError, match="negative or undefined"):
        fit(PATENT, values)


def test_an_unknown_form_is_refused():
    with pytest.raises(InputError, match="accepted: exponential, gaussian, double-exponential"):
        fit(PATENT, column(3, 2, 1), "cauchy")


@settings(max_examples=40, deadline=None)
@given(st.lists(st.floats(0, 100), min_size=6, max_size=6))
def test_any_data_is_fitted_within_the_constraints_or_refused(values):
    theta = np.array([2.0, 6.0, 10.0, 15.0, 22.0, 31.0])
    try:
        fitted = fit(theta, np.array(values)[:, None])
    except InputError:
        return
    assert (fitted.amplitude >= 0).all()
    assert (fitted.decay > 0).all()
    assert (fitted.constant >= 0).all()
    assert np.isfinite(fitted(np.linspace(0, 41, 20))).all()


def test_a_term_that_vanished_comes_last_in_every_channel():
    theta = np.array([4.0, 9.0, 15.0, 24.0, 33.0])
    one = curve(theta, column(90.0), column(6.0), np.array([1.0]), 1)
    two = curve(theta, column(60.0, 20.0), column(5.0, 15.0), np.array([0.5]), 1)
    # A fall that is straighter than any decay leaves one term alone.
    bent = 80 * np.exp(-((theta / 14) ** 2))[:, None]
    fitted = fit(
        theta, np.concatenate([one, two, bent], axis=1), "double-exponential", uncertainty=np.full((5, 3), 0.3)
    )
    gone = fitted.amplitude == 0
    assert gone.any()
    assert not gone[0].any()
    there = ~gone.any(axis=0)
    assert there.any()
    assert (np.diff(fitted.decay[:, there], axis=0) > 0).all()


@pytest.mark.parametrize("steep", np.linspace(0.063, 0.12, 20))
def test_a_term_below_rounding_error_has_no_amplitude(steep):
    # At the first geometry this term is below 1e-15 of its amplitude: whether rounding leaves it one depends on the processor.
    theta, values = np.array([4.3, 7.5, 14.1, 23.8, 32.6]), np.array([152.0, 104.1, 28.6, 8.0, 5.3])
    data = ChannelData("1", FORMS["double-exponential"], theta, values, 0.01 * values, 0.05 * values, True)
    fitted = least_squares_curve(data, np.array([steep, 5.6]))
    assert (fitted.amplitude > 0).tolist() == [True, False]


@pytest.mark.parametrize(("width", "power", "constant", "seed"), [(6.0, 1.0, 1.0, 3), (14.0, 2.0, 0.2, 8)])
def test_a_grid_of_decays_does_not_beat_the_fit_of_two_terms(width, power, constant, seed):
    beaten_by_no_grid(width, power, constant, seed)


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(st.floats(4, 25), st.floats(0.6, 3), st.floats(0, 2), st.integers(0, 99))
def test_no_grid_of_decays_beats_the_fit_of_two_terms(width, power, constant, seed):
    beaten_by_no_grid(width, power, constant, seed)


def beaten_by_no_grid(width: float, power: float, constant: float, seed: int) -> None:
    from scipy.optimize import nnls

    random = np.random.default_rng(seed)
    theta = np.cumsum(random.uniform(3, 9, 5))
    values = (100 * np.exp(-((theta / width) ** power)) + constant) * np.exp(0.08 * random.standard_normal(5))
    u = 0.003 * values + 0.005
    data = ChannelData("1", FORMS["double-exponential"], theta, values, u, u, True)
    fitted = least_squares_curve(data)
    misfit = (data.predicted(fitted) - values) / u
    decays = np.geomspace(*data.decay_range, 40)
    falls = np.exp(-theta[:, None] / decays) / u[:, None]
    pairs = ((a, b) for a in range(decays.size) for b in range(a))
    grid = min(nnls(np.stack([falls[:, a], falls[:, b], 1 / u], axis=1), values / u)[1] for a, b in pairs)
    assert misfit @ misfit <= grid**2 * (1 + 1e-6) + 1e-9


@pytest.mark.parametrize("form", list(FORMS))
def test_the_advice_leaves_out_the_form_that_failed(form):
    with pytest.raises(InputError) as refused:
        fit(TEN, np.linspace(1, 9, TEN.size)[:, None], form)
    advised = str(refused.value).split("another form (")[1].split(")")[0].split(", ")
    assert sorted([*advised, form]) == sorted(FORMS)
