"""The common scale of the frames of one wavelength: references, filters, and overlapping frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import rig_emulated
from hypothesis import given, settings
from hypothesis import strategies as st

from brdfpipe.rig.description import Filter, Rig
from brdfpipe.rig.reduction import brackets, cells
from brdfpipe.rig.reduction.brackets import Bracket, DarkFrames
from brdfpipe.rig.reduction.exposures import ExposureError

FLOOR = 450.0
LAMP = 2000.0
"""Electrons a second and pixel of the reference spot."""
STEPS = ((0.1, 3), (2.0, 3), (2.0, 2), (2.0, 1), (10.0, 1))
"""Exposure and filter."""


def a_rig() -> Rig:
    return rig_emulated.plan().rig


def scene() -> np.ndarray:
    """Relative light per electron of the reference: a disc with a lobe, from faint to bright."""
    rows, columns = np.mgrid[:240, :320]
    distance = np.hypot(columns - 159.5, rows - 119.5)
    return np.where(distance < 78, 3e-3 + 60 * np.exp(-(distance**2) / (2 * 15**2)), 0.0)


def photographed(rig: Rig, errors: dict[int, float], seed: int = 0, steps=STEPS) -> tuple[Bracket, np.ndarray]:
    """A bracket with filters of given errors (of ln transmittance by position), and its true k."""
    random = np.random.default_rng(seed)
    spot = cells.disk(rig.camera, 159.5 + 3 * 49, 119.5 - 3 * 36, 4.5).toarray().reshape(240, 320)
    light, k = [], []
    for seconds, position in steps:
        true = rig.filter_at(position).transmittance * np.exp(errors.get(position, 0.0))
        through = true if rig.nd_location == "reference" else 1.0
        lamp = LAMP * seconds * through
        k.append(lamp * spot.sum() * (1.0 if rig.nd_location == "reference" else true))
        expected = scene() * k[-1] + lamp * spot
        light.append(random.poisson(expected) + np.sqrt(FLOOR) * random.standard_normal(expected.shape))
    stacked = np.array(light, dtype=np.float32)
    exposure, positions = (np.array(column) for column in zip(*steps, strict=True))
    return Bracket(stacked, stacked < 25000, exposure, positions, np.full(len(steps), FLOOR)), np.array(k)


def scale_of(rig: Rig, bracket: Bracket) -> brackets.Scale:
    return brackets.scale_bracket(bracket, brackets.locate_reference_spot(rig, bracket), rig)


@settings(max_examples=6, deadline=None)
@given(st.floats(-0.04, 0.04), st.floats(-0.04, 0.04), st.integers(0, 1000))
def test_overlaps_give_filters_and_short_exposures_far_better_than_description_and_reference(two, three, seed):
    bracket, true = photographed(a_rig(), {2: two, 3: three}, seed)
    scale = scale_of(a_rig(), bracket)
    error = np.log(scale.k / true)
    u = np.sqrt(np.diag(scale.reference + scale.filters))
    # The shortest exposure's own reference has a noise of 4 %, the filters are described to 2 %.
    assert u.max() < 0.005
    assert np.abs(error / u).max() < 4.5


def test_errors_of_scales_agree_with_their_stated_uncertainty():
    z = []
    for seed in range(12):
        errors = dict(zip((2, 3), np.random.default_rng(seed).normal(0, 0.02, 2), strict=True))
        bracket, true = photographed(a_rig(), errors, seed)
        scale = scale_of(a_rig(), bracket)
        z.append(np.log(scale.k / true) / np.sqrt(np.diag(scale.reference + scale.filters)))
    assert 0.6 < np.sqrt(np.mean(np.square(z))) < 1.25


def test_filters_without_an_overlap_are_as_uncertain_as_described():
    bracket, _ = photographed(a_rig(), {}, steps=((0.01, 3), (10.0, 1)))
    dim = replace(bracket, light=bracket.light * np.float32(1e-5), usable=np.ones_like(bracket.usable))
    spot = brackets.locate_reference_spot(a_rig(), bracket)
    dim.light[:, ~spot.outside] = bracket.light[:, ~spot.outside]
    scale = brackets.scale_bracket(dim, spot, a_rig())
    assert np.sqrt(np.diag(scale.filters)) == pytest.approx([0.02, 0.0], abs=1e-9)


def test_filters_in_both_beams_divide_out_and_leave_no_uncertainty():
    rig = replace(a_rig(), nd_location="reference")
    bracket, true = photographed(rig, {2: 0.05, 3: -0.05}, steps=((10.0, 3), (10.0, 2), (2.0, 1), (10.0, 1)))
    scale = scale_of(rig, bracket)
    assert scale.filters == pytest.approx(0.0, abs=1e-15)
    assert scale.k == pytest.approx(true, rel=0.02)
    assert np.abs(np.log(scale.k / true) / np.sqrt(np.diag(scale.reference))).max() < 4.5


def test_the_lamp_is_given_in_electrons_per_second_without_a_filter():
    for location in ("sample", "reference"):
        rig = replace(a_rig(), nd_location=location)
        bracket, _ = photographed(rig, {}, steps=((10.0, 2), (2.0, 1), (10.0, 1)))
        scale, true = scale_of(rig, bracket), LAMP * np.pi * 4.5**2
        assert scale.lamp == pytest.approx(true, rel=0.02)
        # Noise of three frames, and a filter known to 2 % before one of them.
        behind = 0.02 / 3 if location == "reference" else 0.0
        assert behind < scale.lamp_u / true < behind + 0.003


def test_a_frame_without_a_reference_takes_the_lamp_of_the_others():
    bracket, true = photographed(a_rig(), {})
    spot = brackets.locate_reference_spot(a_rig(), bracket)
    bracket.usable[4, ~spot.outside] = False
    scale = brackets.scale_bracket(bracket, spot, a_rig())
    assert scale.k == pytest.approx(true, rel=0.02)
    # The frames it overlaps give it better than the lamp's steadiness, 1 %.
    assert np.sqrt(scale.reference[4, 4]) < 0.01


def test_a_wavelength_without_any_reference_has_no_scale():
    bracket, _ = photographed(a_rig(), {})
    spot = brackets.locate_reference_spot(a_rig(), bracket)
    bracket.usable[:, ~spot.outside] = False
    assert np.isnan(brackets.scale_bracket(bracket, spot, a_rig()).lamp)


def test_a_shifted_reference_spot_is_found():
    bracket, _true = photographed(a_rig(), {})
    moved = replace(bracket, light=np.roll(bracket.light, 2, 1), usable=np.roll(bracket.usable, 2, 1))
    assert scale_of(a_rig(), moved).k == pytest.approx(scale_of(a_rig(), bracket).k, rel=2e-3)


def test_overlaps_of_flat_light_near_the_limit_are_not_biased_by_the_choice_of_pixels():
    """Every pixel is at the limit of usable light: those with positive noise must not be preferred."""
    flat = np.where(scene() > 0, 500 / (0.1 * 10 * LAMP * 64), 0.0)
    random, errors = np.random.default_rng(0), []
    for _ in range(8):
        expected = np.array([flat * 10 * LAMP * 64 * through for through in (0.1, 1.0)])
        light = random.poisson(expected) + np.sqrt(FLOOR) * random.standard_normal(expected.shape)
        bracket = Bracket(
            light.astype(np.float32),
            np.ones(light.shape, dtype=bool),
            np.full(2, 10.0),
            np.array([2, 1]),
            np.full(2, FLOOR),
        )
        k = np.array([0.1, 1.0]) * 10 * LAMP * 64
        errors += [overlap[2] for overlap in brackets._overlaps(bracket, k, np.ones((240, 320), dtype=bool))]
    assert len(errors) == 8
    # The two frames have 2e6 and 2e7 electrons.
    assert abs(np.mean(errors)) < 5e-4


def test_an_exposure_without_dark_frames_is_refused_by_name():
    frames = rig_emulated.frames()
    some = rig_emulated.without(frames, purpose="dark", exposure=2.0)
    with pytest.raises(ExposureError, match=r"no dark frame of 2 s"):
        brackets.read_bracket(
            frames.isel(frame=frames["purpose"].values == "sample"), DarkFrames.of(some, a_rig()), a_rig()
        )


def test_two_filters_may_have_the_same_transmittance():
    twins = replace(
        a_rig(), filters=(Filter(1, 1.0, 0.0), Filter(2, 0.1, 0.02), Filter(3, 0.01, 0.02), Filter(4, 0.1, 0.02))
    )
    bracket, true = photographed(twins, {4: 0.02}, steps=(*STEPS, (2.0, 4)))
    assert scale_of(twins, bracket).k == pytest.approx(true, rel=0.01)
