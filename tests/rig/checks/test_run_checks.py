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
