"""The checks of frames on a stored run."""

from __future__ import annotations

import numpy as np
import pytest
import rig_emulated

from brdfpipe import vocabulary
from brdfpipe.rig.checks.run_checks import relevant, run_findings
from brdfpipe.rig.reduction.relative_light import ReductionError, reduce


def test_an_honest_run_has_no_finding():
    frames, rig = rig_emulated.frames(), rig_emulated.plan().rig
    assert run_findings(relevant(frames, "sample", "reflection", 30.0), rig) == []
    assert run_findings(frames, rig) == []


def swapped(frames):
    """The counts of the two wavelengths of the sample at 30 degree exchanged."""
    frames = frames.copy(deep=True)
    own = (frames["purpose"].values == "sample") & (frames["incidence"].values == 30.0)
    low, high = (np.flatnonzero(own & (frames["wavelength"].values == nm)) for nm in rig_emulated.WAVELENGTHS)
    counts = frames["counts"].values
    counts[low], counts[high] = counts[high].copy(), counts[low].copy()
    return frames


def test_exchanged_wavelengths_are_refused_by_name_unless_accepted():
    frames, rig = swapped(rig_emulated.frames()), rig_emulated.plan().rig
    with pytest.raises(ReductionError, match=r"frames contradict their labels: frame .* the reference light at"):
        reduce(frames, rig, incidence=30.0)
    accepted = reduce(frames, rig, incidence=30.0, override=True)
    assert any("the reference light at" in text for text in vocabulary.warnings(accepted))


def test_a_repeated_frame_is_left_out_with_a_warning():
    frames, rig = rig_emulated.frames().copy(deep=True), rig_emulated.plan().rig
    own = np.flatnonzero((frames["purpose"].values == "sample") & (frames["incidence"].values == 30.0))
    frames["counts"].values[own[3]] = frames["counts"].values[own[2]]
    measured = reduce(frames, rig, incidence=30.0)
    assert any("identical to frame" in text and "not used" in text for text in vocabulary.warnings(measured))
    whole = reduce(rig_emulated.frames(), rig, incidence=30.0)
    difference = np.abs(measured["signal"].values - whole["signal"].values)
    u = np.hypot(measured["signal_u_noise"].values, measured["signal_u_reference"].values)
    assert np.nanpercentile(difference / u, 95) < 4


def own_frames(frames, wavelength=None):
    own = (frames["purpose"].values == "sample") & (frames["incidence"].values == 30.0)
    return np.flatnonzero(own & ((wavelength is None) | (frames["wavelength"].values == wavelength)))


@pytest.mark.parametrize("even", [100, 2000])
def test_a_wavelength_of_even_frames_is_left_out_by_name(even):
    frames, rig = rig_emulated.frames().copy(deep=True), rig_emulated.plan().rig
    low, high = rig_emulated.WAVELENGTHS
    frames["counts"].values[own_frames(frames, low)] = even
    measured = reduce(frames, rig, incidence=30.0)
    assert measured["wavelength"].values.tolist() == [high]
    text = f"since none of their frames can be used: {low:g} nm"
    assert any(text in warning for warning in vocabulary.warnings(measured))
    frames["counts"].values[own_frames(frames)] = even
    with pytest.raises(ReductionError, match=r"no frame of the sample at 30 degree can be used.*every pixel"):
        reduce(frames, rig, incidence=30.0)


def test_bad_dark_frames_do_not_enter_the_mean():
    frames, rig = rig_emulated.frames().copy(deep=True), rig_emulated.plan().rig
    exposure = frames["exposure"].values
    dark = np.flatnonzero((frames["purpose"].values == "dark") & (exposure == exposure.max()))
    frames["counts"].values[dark[0]] = 3000
    frames["counts"].values[dark[1]] = 65535
    measured = reduce(frames, rig, incidence=30.0)
    texts = [text for text in vocabulary.warnings(measured) if "The frame is not used" in text]
    assert [text.split(":")[0] for text in texts] == [f"Frame {frames['shot'].values[at]}" for at in dark[:2]]
    without = reduce(frames.isel(frame=~np.isin(np.arange(frames.sizes["frame"]), dark[:2])), rig, incidence=30.0)
    assert np.array_equal(measured["signal"].values, without["signal"].values, equal_nan=True)
    frames["counts"].values[dark] = 3000
    with pytest.raises(ReductionError, match=r"no dark frame of .* s can be used. Frame .* every pixel"):
        reduce(frames, rig, incidence=30.0)


def test_bad_frames_of_a_separate_target_run_remove_none_of_the_sample():
    frames, rig = rig_emulated.frames(), rig_emulated.plan().rig
    target = frames.copy(deep=True)
    dark = int(np.flatnonzero(frames["purpose"].values == "dark")[0])
    target["counts"].values[dark] = 3000
    # The ordinal of the bad frame is that of a frame of the sample in the other run.
    own = int(own_frames(frames)[3])
    shots = target["shot"].values.copy()
    shots[[dark, own]] = shots[[own, dark]]
    target = target.assign_coords(shot=("frame", shots))
    measured = reduce(frames, rig, incidence=30.0, target=target)
    (text,) = (text for text in vocabulary.warnings(measured) if "not used" in text)
    assert text.startswith(f"Target run, frame {frames['shot'].values[own]}: every pixel")
    alone = reduce(frames, rig, incidence=30.0)
    np.testing.assert_allclose(measured["signal"].values, alone["signal"].values, rtol=1e-3, atol=1e-9)


def test_a_wavelength_in_the_headers_beside_the_label_is_warned_of():
    frames, rig = rig_emulated.frames(), rig_emulated.plan().rig
    read = frames["wavelength_read"].copy()
    read.values[own_frames(frames, 550.0)] += 0.45
    measured = reduce(frames.assign_coords(wavelength_read=read), rig, incidence=30.0)
    (text,) = (text for text in vocabulary.warnings(measured) if "reports" in text)
    assert "the monochromator reports 550.45 nm where 550 nm was requested" in text
