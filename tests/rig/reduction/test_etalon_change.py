"""An etalon measured before and after the sample: interpolated, and its change stated."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import rig_accuracy as accuracy
import rig_emulated
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.rig import screen as screens
from brdfpipe.rig.checks.run_checks import run_findings
from brdfpipe.rig.plan import ETALON_AFTER, Plan
from brdfpipe.rig.reduction.calibration import calibrate
from brdfpipe.rig.reduction.relative_light import reduce


@cache
def plan() -> Plan:
    return replace(rig_emulated.plan(), etalon_after=True)


@cache
def frames() -> xr.Dataset:
    return accuracy.frames_of(plan(), accuracy.TRUTHS["plastic, 10 sr⁻¹, 3°"](), seed=1)


def dimmed(share: float) -> xr.Dataset:
    """The run with an etalon that lost a share of its light while the sample was measured."""
    changed = frames().copy(deep=True)
    counts, exposure, purpose = (changed[name].values for name in ("counts", "exposure", "purpose"))
    _, sample = screens.spot_masks(plan().rig)
    dark = {at: counts[(purpose == "dark") & (exposure == at)].mean(axis=0) for at in np.unique(exposure)}
    for at in np.flatnonzero(purpose == ETALON_AFTER):
        level = dark[exposure[at]]
        light = level + (counts[at] - level) * np.where(sample, 1 - share, 1.0)
        counts[at] = np.rint(np.clip(light, 0, 65535))
    return changed


def test_the_etalon_is_arranged_again_after_the_sample():
    again = [shot for shot in plan().shots if shot.purpose == ETALON_AFTER]
    assert {shot.arrangement.load for shot in again} == {"etalon"}
    assert all(shot.arrangement.again for shot in again)
    assert min(shot.ordinal for shot in again) > max(shot.ordinal for shot in plan().shots if shot.purpose == "sample")
    before = [shot for shot in plan().shots if shot.purpose == "etalon"]
    assert [(shot.wavelength, shot.step) for shot in again] == [(shot.wavelength, shot.step) for shot in before]
    assert len(plan().arrangements) == len(set(plan().arrangements)) == 7


def test_an_honest_run_has_no_finding():
    assert run_findings(frames(), plan().rig) == []


def etalon(run: xr.Dataset) -> xr.Dataset:
    return reduce(run, plan().rig, load="etalon", incidence=10.0)


def shares() -> np.ndarray:
    """(wavelength,) time from the etalon's first measurement at 10° to the sample, over the time to its second."""
    purpose, elapsed = frames()["purpose"].values, frames()["elapsed"].values
    own, sample = frames()["incidence"].values == 10.0, elapsed[frames()["load"].values == "sample"].mean()
    before, after = (
        np.array(
            [
                elapsed[(purpose == name) & own & (frames()["wavelength"].values == nm)].mean()
                for nm in plan().wavelengths
            ]
        )
        for name in ("etalon", ETALON_AFTER)
    )
    return (sample - before) / (after - before)


def test_an_etalon_that_does_not_change_is_known_better_than_from_one_measurement():
    twice, once = etalon(frames()), etalon(rig_emulated.without(frames(), purpose=ETALON_AFTER))
    assert np.nanmedian(np.abs(twice["etalon_change"].values)) < 0.005
    assert not any("etalon's light changed" in text for text in vocabulary.warnings(twice))
    ratio = np.nanmedian(twice["signal_u_noise"].values / once["signal_u_noise"].values, axis=2)[0]
    assert ratio == pytest.approx(np.hypot(shares(), 1 - shares()), abs=0.01)
    assert np.nanmedian(twice["signal_u_glare"].values / once["signal_u_glare"].values) == pytest.approx(1, abs=0.05)
    assert "etalon_change" not in once


def test_a_change_is_stated_and_interpolated_to_the_time_of_the_sample():
    measured, unchanged = etalon(dimmed(0.04)), etalon(frames())
    change = measured["etalon_change"].values
    assert np.nanmedian(change) == pytest.approx(np.log(0.96), abs=0.003)
    assert any("etalon's light changed by -4." in text for text in vocabulary.warnings(measured))
    ratio = np.nanmedian(measured["signal"].values / unchanged["signal"].values, axis=2)[0]
    assert ratio == pytest.approx(1 - 0.04 * shares(), abs=0.001)
    profile = calibrate(measured, accuracy.certificate())
    assert profile["etalon_change"].dims == ("incidence", "wavelength")
    assert profile["etalon_change"].values == pytest.approx(np.log(0.96), abs=0.004)


def test_a_wavelength_that_is_missing_after_the_sample_is_that_of_before():
    low = rig_emulated.WAVELENGTHS[0]
    partly = rig_emulated.without(dimmed(0.04), purpose=ETALON_AFTER, wavelength=low)
    measured, before = etalon(partly), etalon(rig_emulated.without(frames(), purpose=ETALON_AFTER))
    first, second = (dataset["signal"].sel(wavelength=low).values for dataset in (measured, before))
    np.testing.assert_allclose(first, second, rtol=2e-3)
    assert np.isnan(measured["etalon_change"].sel(wavelength=low).values).all()
