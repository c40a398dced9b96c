"""The adjustment on fast models: its errors agree with the stated uncertainties."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.comparison.adjustment import adjust
from brdfpipe.comparison.measurement import Measurement

CELLS = 200
PLACE = np.linspace(0, 1, CELLS)
DIMS = ("incidence", "wavelength", "cell")


@dataclass(frozen=True)
class Lobe:
    """A lobe of a height and a width over a base, which change exponentially, with prior uncertainties of 10 %."""

    change: np.ndarray

    @property
    def values(self) -> np.ndarray:
        height, width, base = np.exp(0.1 * self.change)
        return (30 * height * np.exp(-((PLACE / (0.2 * width)) ** 2) / 2) + 0.2 * base)[None, None]

    @property
    def own_u(self) -> np.ndarray:
        return np.zeros((1, 1, CELLS))

    @property
    def common(self) -> np.ndarray:
        return np.zeros((0, 1, 1, CELLS))

    def slopes(self) -> np.ndarray:
        step = 1e-5 * np.eye(3)
        return np.array([(Lobe(self.change + change).values - self.values) / 1e-5 for change in step])


def measured(
    truth: np.ndarray, seed: int | None, *, noise: float = 0.02, scale: float = 0.03, hidden: float = 0.0
) -> Measurement:
    """Values with noise, and with one scale error for all of them; ``hidden`` is noise that is not stated."""
    random = np.random.default_rng(seed)
    size = 0.0 if seed is None else 1.0
    value = truth * (1 + size * scale * random.standard_normal())
    value = value + size * np.hypot(noise, hidden) * truth * random.standard_normal(truth.shape)
    parts = {"noise": (noise * truth, "independent"), "certificate": (scale * np.abs(value), "common")}
    primary = xr.Dataset(
        {
            "brdf": (DIMS, value),
            "brdf_u": (DIMS, np.hypot(*(part for part, _ in parts.values()))),
            **{f"brdf_u_{name}": (DIMS, part, {"correlation": words}) for name, (part, words) in parts.items()},
        },
        coords={
            "incidence": [0.0],
            "wavelength": [550.0],
            "theta_s": ("cell", 60 * PLACE),
            "phi_s": ("cell", np.zeros(CELLS)),
        },
    )
    return Measurement.of(vocabulary.label(primary, "primary"), np.array([0]))


def fitted(measurement: Measurement):
    return adjust(measurement, Lobe, 3, Lobe(np.zeros(3)))


@pytest.mark.slow
def test_errors_of_changes_agree_with_their_stated_uncertainty() -> None:
    """Truths drawn from the prior, errors from the stated uncertainties: (fit − true)/u has an rms of 1, and no bias."""
    random = np.random.default_rng(7)
    pulls, scatter = [], []
    for seed in range(300):
        truth = random.standard_normal(3)
        measurement = measured(Lobe(truth).values, seed)
        fit = fitted(measurement)
        assert fit.converged
        pulls.append((fit.change - truth) / np.sqrt(np.diag(fit.spread)))
        scatter.append(fit.covariance.chi_squared(measurement.value - fit.model.values) / (CELLS - 3))
    # Of 300 pulls an rms is known to 4 %, a mean to 6 %, and a mean χ² over the degrees of freedom to 0.6 %.
    np.testing.assert_allclose(np.sqrt(np.mean(np.square(pulls), axis=0)), 1, atol=0.13)
    np.testing.assert_allclose(np.mean(pulls, axis=0), 0, atol=0.2)
    assert np.mean(scatter) == pytest.approx(1, abs=0.02)


def test_a_scale_error_of_all_values_does_not_pull_the_fit_below_them() -> None:
    """Peelle's puzzle: relative to measured values the error would favour the smallest of them."""
    truth = Lobe(np.zeros(3)).values
    ratios = []
    for seed in range(40):
        measurement = measured(truth, seed, noise=0.1, scale=0.2)
        ratios.append(np.mean(measurement.value / fitted(measurement).model.values))
    # The prior of 10 % holds the height against the scale of 20 %: on average neither is drawn.
    assert np.mean(ratios) == pytest.approx(1, abs=4 * 0.2 / np.sqrt(40))


def test_a_scale_error_leaves_the_height_uncertain_and_the_width_not() -> None:
    height, width, _ = np.sqrt(np.diag(fitted(measured(Lobe(np.zeros(3)).values, None)).spread)) * 0.1
    # The scale is known to 3 %, and by the priors of height and base, of 10 % each; the width is free of it.
    assert height == pytest.approx((1 / 0.03**2 + 2 / 0.1**2) ** -0.5, rel=0.01)
    assert width < 0.004


@pytest.mark.parametrize("change", [(10.0, 5.0, -8.0), (-10.0, -9.0, 12.0), (0.0, 15.0, 0.0)])
def test_the_fit_converges_from_far_away(change) -> None:
    measurement = measured(Lobe(np.array(change)).values, 1, noise=0.005, scale=1e-6)
    fit = fitted(measurement)
    assert fit.converged
    variance = np.diag(fit.spread)
    # The prior draws a change by its share of the knowledge.
    assert (np.abs(fit.change - change) < 4 * np.sqrt(variance) + variance * np.abs(change)).all()
    assert (variance[:2] < 0.2).all()  # below the widest lobe the base is not seen


def test_a_measurement_without_information_changes_nothing() -> None:
    fit = fitted(measured(Lobe(np.zeros(3)).values, None))
    np.testing.assert_allclose(fit.change, 0, atol=1e-9)
    assert fit.enlarged == 1


def test_uncertainties_grow_if_the_data_scatter_more_than_stated() -> None:
    truth = Lobe(np.zeros(3)).values
    honest, hidden = (fitted(measured(truth, 5, scale=1e-6, hidden=hidden)) for hidden in (0.0, 0.06))
    assert honest.enlarged == pytest.approx(1, abs=0.1)
    assert hidden.enlarged == pytest.approx(np.hypot(2, 6) / 2, rel=0.15)
    ratio = np.sqrt(np.diag(hidden.spread) / np.diag(honest.spread))
    np.testing.assert_allclose(ratio, hidden.enlarged, rtol=0.15)
