"""The control chart of calibration profiles."""

from __future__ import annotations

import functools

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from rig_reduced import WAVELENGTHS, certificate, reduced

from brdfpipe import store, vocabulary
from brdfpipe.rig.reduction.arrangements import CalibrationError
from brdfpipe.rig.reduction.calibration import calibrate
from brdfpipe.rig.reduction.control_chart import extend_chart
from brdfpipe.rig.reduction.primary import apply_profile


def profile_of(place: int, level: float = 0.0, spectrum=0.0, cells=0.0, entrances=(10.0, 30.0), **attrs) -> xr.Dataset:
    """The profile of a day, its scales changed by logarithms of all, of each wavelength and of each cell."""
    etalon = reduced(
        "etalon",
        entrances,
        efficiency=np.exp(-level - np.asarray(cells)),
        **{"day": f"2026-03-{place + 1:02d}", **attrs},
    )
    etalon["signal"] = etalon["signal"] * np.exp(-np.broadcast_to(spectrum, WAVELENGTHS.shape))[:, None]
    return calibrate(etalon, certificate(), name=f"bench-{place + 1}")


def chain(*changes: dict[str, object] | float) -> xr.Dataset:
    """The last of several profiles, each with the one before it as previous; a number is a change of the level."""
    options = [change if isinstance(change, dict) else {"level": change} for change in changes]
    return functools.reduce(
        lambda previous, profile: extend_chart(profile, previous),
        [profile_of(place, **given) for place, given in enumerate(options)],
    )


STEADY = (0.0, 0.003, -0.004, 0.001, 0.002)


def test_the_chart_distinguishes_a_step_from_scatter():
    chart = chain(*STEADY, 0.08)
    assert chart["profile"].values.tolist() == [f"bench-{number}" for number in range(1, 7)]
    assert chart["profile_day"].values.tolist() == [f"2026-03-0{number}" for number in range(1, 7)]
    assert chart["scale_change"].values == pytest.approx(np.tile([*STEADY, 0.08], (5, 1)).T, abs=1e-9)
    level = chart.sel(watched="level")
    before = [0.0, *(np.mean(STEADY[:count]) for count in range(1, 6))]
    assert level["change"].values == pytest.approx(np.subtract([*STEADY, 0.08], before), abs=1e-9)
    assert level["violation"].values.tolist() == [False] * 5 + [True]
    assert not chart.sel(watched="spectrum")["violation"].values.any()


def test_the_control_limit_is_a_prediction_from_earlier_profiles_and_the_expected_scatter():
    """Three expected values of a scatter of 1 %, and the sum of squares of four seen with three degrees of freedom."""
    chart = chain(*STEADY)
    seen = np.array(STEADY[:4])
    scatter = np.sqrt((3 * 0.01**2 + ((seen - seen.mean()) ** 2).sum()) / 6)
    assert chart.sel(watched="level")["limit"].values[-1] == pytest.approx(3 * scatter * np.sqrt(1 + 1 / 4), rel=1e-6)
    assert np.isnan(chart["limit"].values[0]).all()
    # One of five is beyond 3.4602 standard deviations as seldom as one alone is beyond 3: Φ(−3) / 5 = 2.70e-4 = Φ(−3.4602).
    expected = 3.4602 * 0.003 * np.sqrt(3 / 6) * np.sqrt(1 + 1 / 4)
    assert chart.sel(watched="spectrum")["limit"].values[-1] == pytest.approx(expected, rel=1e-3)


def test_false_alarms_have_the_rate_of_three_standard_deviations():
    """A rig of exactly the scatter that is expected of one: over many charts the first comparison is false in 0.27 % of them."""
    random = np.random.default_rng(0)
    z = random.normal(0, 0.01, (200_000, 2))
    limit = float(chain(0.0, 0.001).sel(watched="level")["limit"][-1])
    assert np.mean(np.abs(z[:, 1] - z[:, 0]) > limit) == pytest.approx(0.0027, rel=0.15)


def test_a_profile_that_violates_the_chart_is_refused_unless_overridden():
    marked = chain(0.0, 0.003, -0.004, 0.08)
    assert "differs by +8.4% from the earlier ones" in marked.attrs["drift_violation"]
    sample = reduced("sample", day="2026-03-05")
    with pytest.raises(CalibrationError, match="etalon is dirty or aged"):
        apply_profile(sample, marked)
    primary = apply_profile(sample, marked, override=True)
    assert "dirty or aged" in primary.attrs["overridden"]
    assert "drift_violation" not in chain(0.0, 0.003, -0.004).attrs


def test_an_etalon_that_turned_yellow_is_detected_though_the_mean_is_unchanged():
    """3 % of the light is lost at one end of the spectrum and gained at the other: the mean is unchanged."""
    chart = chain(0.0, 0.002, -0.001, {"spectrum": [0.03, 0.01, 0.0, -0.015, -0.025]})
    assert chart["violation"].values[-1].tolist() == [False, True]
    assert "differs by +3.0% more at 430 nm than at all wavelengths together" in chart.attrs["drift_violation"]
    assert chart["departing_wavelength"].values[-1] == 430
    with pytest.raises(CalibrationError, match="430 nm"):
        apply_profile(reduced("sample", day="2026-03-05"), chart)


def test_later_profiles_are_not_compared_with_a_violation():
    chart = chain(*STEADY, 0.08, 0.001)
    assert chart.sel(watched="level")["violation"].values.tolist() == [False] * 5 + [True, False]
    assert chart.sel(watched="level")["change"].values[-1] == pytest.approx(0.001 - np.mean(STEADY), abs=1e-9)
    assert "drift_violation" not in chart.attrs


def test_cells_that_changed_are_named_in_a_warning():
    """A new profile corrects such changes; but a fibre that was moved or exchanged changes too."""
    cells = np.zeros(80)
    seen = np.flatnonzero(np.isfinite(profile_of(0)["cell_scale"].values).all(axis=0))
    cells[seen[[3, 8]]] = 0.5, -0.1
    chart = chain(0.0, {"cells": cells})
    (warning,) = vocabulary.warnings(chart)
    assert f"2 cells changed against the others since bench-1: F{seen[3]} by -39%, F{seen[8]} by +11%." in warning
    assert "drift_violation" not in chart.attrs
    assert chart["scale_change"].values[-1] == pytest.approx(np.zeros(5), abs=1e-9)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000))
def test_cells_that_differ_by_their_noise_are_not_named(seed):
    random = np.random.default_rng(seed)
    one, other = (profile_of(place) for place in range(2))
    for profile in (one, other):
        u = (profile["cell_scale_u_calibration"] / profile["cell_scale"]).values
        profile["cell_scale"] = profile["cell_scale"] * np.exp(u * random.standard_normal(u.shape))
    assert vocabulary.warnings(extend_chart(other, one)) == []


def test_a_scattering_rig_has_wider_limits():
    steady, wild = (chain(*(np.array([1, -1, 1, -1, 1, -1]) * size)) for size in (1e-3, 0.02))
    assert wild["limit"].values[-1, 0] > 1.5 * steady["limit"].values[-1, 0]


def test_a_chart_continues_with_another_first_entrance_and_other_wavelengths():
    """Scales are as through the first entrance, which sends 10 % less light here; that is no change of the rig."""
    through = chain(0.0, {"entrances": (0.0, 10.0, 30.0)}, {"level": 0.001, "entrances": (0.0, 10.0)})
    assert through["scale_change"].values[:, 0] == pytest.approx([0, 0, 0.001], abs=1e-9)
    fewer = profile_of(3).sel(wavelength=[430.0, 550.0])
    chart = extend_chart(profile_of(4, 0.002), extend_chart(fewer, through))
    assert np.isfinite(chart["scale_change"].values).all(axis=0).tolist() == [True, False, False, True, False]
    assert chart["change"].sel(watched="level").values[-1] == pytest.approx(0.002 - 0.001 / 4, abs=1e-9)


def test_a_first_profile_begins_a_chart_and_violates_nothing():
    one = calibrate(reduced("etalon"), certificate())
    assert one["profile"].values.tolist() == ["2026-03-01"]
    assert not one["violation"].values.any()
    assert one["scale_change"].values == pytest.approx(np.zeros((1, 5)))


@pytest.mark.parametrize(
    ("previous", "words"),
    [
        ({"rig_digest": "other"}, "bench-1 of 2026-03-01, is of other optics.*remove `previous`"),
        ({"day": "2026-03-09"}, "bench-1 of 2026-03-09, was measured after this one"),
        ({"entrances": (60.0,)}, "other entrances.*`etalon_entrances`"),
    ],
)
def test_profiles_that_cannot_extend_a_chart_are_refused_with_what_to_do(previous, words):
    with pytest.raises(CalibrationError, match=words):
        extend_chart(profile_of(1), profile_of(0, **previous))


def test_profiles_without_a_common_wavelength_cannot_extend_a_chart():
    with pytest.raises(CalibrationError, match="shares no wavelength, or no cell"):
        extend_chart(profile_of(1).isel(wavelength=[0, 1]), profile_of(0).isel(wavelength=[2, 3]))


def test_the_chart_is_stored_in_the_file_of_the_last_profile(tmp_path):
    chart = chain(*STEADY)
    store.save_dataset(chart, tmp_path / "bench-5.nc", stage="calibration", material="calibrations.bench-5")
    stored = store.open_dataset(tmp_path / "bench-5.nc", "calibration")
    xr.testing.assert_equal(extend_chart(profile_of(5), stored)["change"], extend_chart(profile_of(5), chart)["change"])
