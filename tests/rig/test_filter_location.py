"""Location and transmittances of the filters, from frames of known truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import small_rig

from brdfpipe.rig.filter_location import OverlapCheck, check_overlaps
from brdfpipe.rig.frame_file import DeviceState, Frame
from brdfpipe.rig.frames import frames_dataset
from brdfpipe.rig.plan import Plan
from brdfpipe.rig.screen import spot_masks

PLAN = small_rig.PLAN.replace(
    "bracket: [{exposure: 1, position: 2}, {exposure: 1, position: 1}]",
    "bracket: [{exposure: 2, position: 4}, {exposure: 2, position: 2}, {exposure: 0.5, position: 1}]",
)

DARK = 100


@pytest.fixture
def plan(tmp_path):
    return Plan.load(small_rig.write(tmp_path, PLAN))


def pictured(plan, *, sample_power=1, reference_power=0, light=1500.0, errors=None, seed=0):
    """Frames of a scene of known light: counts = dark + exposure × light × transmittance^power, noisy."""
    generator = np.random.default_rng(seed)
    reference, sample = spot_masks(plan.rig)
    scene = sample * np.exp(generator.uniform(-4, 0, sample.shape))
    taken = {}
    for shot in plan.shots:
        passed = plan.rig.filter_at(shot.position).transmittance * (errors or {}).get(shot.position, 1)
        counts = np.full(sample.shape, float(DARK))
        if not shot.dark:
            counts += shot.exposure * (
                light * scene * passed**sample_power + 0.1 * light * reference * passed**reference_power
            )
        counts = generator.poisson(np.maximum(counts, 0)).clip(0, 65535).astype(np.uint16)
        state = DeviceState(shot.wavelength, shot.position)
        taken[shot] = Frame(counts, state, 0.0, float(shot.ordinal), 20.0, "camera", "")
    return frames_dataset(taken, plan)


def described(plan, **changes):
    return replace(plan.rig, **changes)


@pytest.mark.parametrize(("location", "power"), [("sample", 0), ("reference", 1)])
def test_filters_in_the_described_location_give_no_warning(plan, location, power):
    check = check_overlaps(pictured(plan, reference_power=power, light=20_000), described(plan, nd_location=location))
    assert check.nd_location == location
    assert check.warnings == ()
    assert {overlap.positions for overlap in check.overlaps} >= {(2, 1)}
    for overlap in check.overlaps:
        # Hundreds of pixels of a hundred counts and more; but the reference's may be forty each, on a dark of a hundred: 6 %.
        assert overlap.sample == pytest.approx(overlap.expected, rel=0.02)
        assert overlap.exponent == pytest.approx(1 - power, abs=0.1)


@pytest.mark.parametrize(("location", "power", "truth"), [("sample", 1, "reference"), ("reference", 0, "sample")])
def test_filters_in_the_other_place_are_detected_and_named(plan, location, power, truth):
    check = check_overlaps(pictured(plan, reference_power=power, light=20_000), described(plan, nd_location=location))
    assert check.nd_location == truth
    (warning,) = check.warnings
    assert f"`nd_location: {location}`" in warning
    assert f"`nd_location: {truth}`" in warning
    widest = max(max(overlap.expected, 1 / overlap.expected) for overlap in check.overlaps)
    assert f"would disagree by {widest:.3g} = T1/T{4 if widest == 100 else 2};" in warning
    assert "correct `nd_location` in rig.yaml" in warning


def test_filters_before_the_reference_alone_disagree_by_the_square(plan):
    """The formula of the preprint, f = s L T/L', is right if only the reference passes the filter."""
    check = check_overlaps(pictured(plan, sample_power=0, reference_power=1, light=20_000), described(plan))
    assert check.nd_location == ""
    (warning,) = check.warnings
    assert "the reference beam alone" in warning
    assert "²" in warning
    factor = float(warning.split("disagree by ")[1].split(" ")[0])
    widest = max(max(overlap.expected, 1 / overlap.expected) for overlap in check.overlaps)
    assert factor == pytest.approx(widest**2, rel=0.01)


def test_a_wrong_transmittance_is_named(plan):
    check = check_overlaps(pictured(plan, light=20_000, errors={2: 1.15}), described(plan))
    assert check.nd_location == "sample"
    assert check.warnings[0].startswith("filters 2 and 1: the measured ratio of transmittances deviates by +1")
    deviation = float(check.warnings[0].split(" deviates by ")[1].split("%")[0])
    assert deviation == pytest.approx(15, abs=0.5)
    assert "`filters` in rig.yaml" in check.warnings[0]


def test_a_transmittance_within_its_uncertainty_is_in_order(plan):
    assert check_overlaps(pictured(plan, light=20_000, errors={2: 1.03}), described(plan)).warnings == ()


@pytest.mark.parametrize("light", [1.0, 1e6])
def test_without_pixels_well_exposed_twice_there_is_no_warning(plan, light):
    assert check_overlaps(pictured(plan, light=light), described(plan)) == OverlapCheck((), "", ())


def test_hot_pixels_are_not_taken_for_light(plan):
    """In an image too faint to compare, only hot pixels are well exposed, equally behind both filters."""
    frames = pictured(plan, light=3.0)
    hot = np.random.default_rng(1).uniform(size=frames["counts"].shape[1:]) < 0.05
    glow = 1000 * hot * frames["exposure"].values[:, None, None]
    frames["counts"] = (frames["counts"].dims, (frames["counts"].values + glow).astype(np.uint16))
    assert check_overlaps(frames, plan.rig).overlaps == ()
    frames = pictured(plan, light=20_000)
    without = check_overlaps(frames, plan.rig)
    frames["counts"] = (frames["counts"].dims, (frames["counts"].values + glow).clip(0, 65535).astype(np.uint16))
    for one, other in zip(check_overlaps(frames, plan.rig).overlaps, without.overlaps, strict=True):
        assert one.sample == pytest.approx(other.sample, rel=0.005)


def test_frames_of_different_wavelengths_or_incidences_are_not_compared(plan):
    frames = pictured(plan, light=20_000)
    assert check_overlaps(frames, plan.rig).overlaps
    for name in ("wavelength", "incidence"):
        apart = frames.copy()
        apart[name] = ("frame", np.arange(frames.sizes["frame"]) * 0.1 + 400.0)
        assert check_overlaps(apart, plan.rig).overlaps == ()


def test_without_dark_frames_there_is_no_warning(plan):
    frames = pictured(plan, light=20_000)
    assert check_overlaps(frames.isel(frame=frames["purpose"].values != "dark"), plan.rig).overlaps == ()
