"""The judgement of frames during a scan: every error of a bench that would pass without a word is named, and honest runs pass."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
import rig_accuracy as accuracy
import rig_emulated
from scipy import ndimage

from brdfpipe.bsdf.registry import representation
from brdfpipe.rig.checks.frame_judge import Finding, FrameJudge
from brdfpipe.rig.emulator.effects import Effects
from brdfpipe.rig.emulator.emulated_rig import EmulatedRig
from brdfpipe.rig.plan import Arrangement, Plan, Shot
from brdfpipe.rig.raw_frame import Counts

PLASTIC, MILK_GLASS, FACETS = "plastic, 10 sr⁻¹, 3°", "milk glass", "plastic of facets, slope 0.08"


@pytest.fixture(scope="module")
def plan() -> Plan:
    return rig_emulated.plan()


def run(plan: Plan, truth: str = PLASTIC, seed: int = 1, **options: object) -> list[tuple[Shot, Counts]]:
    """The frames of a plan on an emulated rig, with the shots that they are of."""
    frames = (
        rig_emulated.frames(truth, seed)
        if not options
        else accuracy.frames_of(plan, accuracy.TRUTHS[truth](), seed=seed, **options)
    )
    return list(zip(plan.shots, frames["counts"].values, strict=True))


def findings(plan: Plan, frames: list[tuple[Shot, Counts]]) -> list[tuple[Shot, Finding]]:
    """Findings of a judge who learns the frames that are not bad."""
    judge, found = FrameJudge(plan.rig), []
    for shot, counts in frames:
        own = judge.judge(shot, counts, wavelength_read=shot.wavelength, last_of_bracket=shot.step == len(plan.bracket))
        found += [(shot, finding) for finding in own]
        if not any(finding.severity == "bad" for finding in own):
            judge.learn(shot, counts)
    return found


def bad(plan: Plan, frames: list[tuple[Shot, Counts]]) -> list[tuple[int, str]]:
    return [(shot.ordinal, finding.name) for shot, finding in findings(plan, frames) if finding.severity == "bad"]


def changed(
    frames: list[tuple[Shot, Counts]], chosen: Callable[[Shot], bool], change: Callable[[Counts], Counts]
) -> list[tuple[Shot, Counts]]:
    return [(shot, change(counts) if chosen(shot) else counts) for shot, counts in frames]


def of(load: str, incidence: float | None = None) -> Callable[[Shot], bool]:
    return lambda shot: shot.purpose == load and incidence in (None, shot.arrangement.incidence)


# --- honest runs


@pytest.mark.parametrize("truth", [PLASTIC, FACETS])
def test_an_honest_run_has_no_finding(plan, truth):
    assert findings(plan, run(plan, truth)) == []


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(50))
def test_fifty_honest_runs_have_no_bad_frame_and_no_warning(plan, seed):
    truth = (PLASTIC, MILK_GLASS, FACETS, "narrow, 300 sr⁻¹, 1.5°, on metallic 14°")[seed % 4]
    frames = accuracy.frames_of(plan, accuracy.TRUTHS[truth](), seed=100 + seed, session=seed)
    assert findings(plan, list(zip(plan.shots, frames["counts"].values, strict=True))) == []


# --- the camera


def test_a_frame_that_repeats_an_earlier_one_is_bad(plan):
    frames = run(plan)
    at = next(number for number, (shot, _) in enumerate(frames) if shot.purpose == "sample" and shot.step == 3)
    frames[at] = frames[at][0], frames[at - 1][1]
    assert bad(plan, frames) == [(frames[at][0].ordinal, "identical")]


def test_a_whole_run_of_one_frame_is_bad_from_the_second_frame_on(plan):
    frames = run(plan)
    found = bad(plan, [(shot, frames[40][1]) for shot, _ in frames])
    # The first frame, with the shutter closed, shows the reference; so do its repetitions.
    assert found[0] == (1, "dark shows light")
    assert len(found) >= len(plan.shots) - 1


@pytest.mark.parametrize(("count", "name"), [(0, "constant"), (100, "constant"), (65535, "saturated")])
def test_an_even_frame_is_bad(plan, count, name):
    frames = changed(run(plan), lambda shot: True, lambda counts: np.full_like(counts, count))
    assert bad(plan, frames) == [(shot.ordinal, name) for shot in plan.shots]


def test_light_frames_that_are_dark_frames_are_bad_when_the_first_bracket_ends(plan):
    darks = EmulatedRig(plan.rig, None, seed=1)
    frames = [(shot, darks.camera.expose(shot.exposure, shutter=False).counts) for shot in plan.shots]
    first = next(shot for shot in plan.shots if shot.step == len(plan.bracket))
    assert bad(plan, frames)[0] == (first.ordinal, "equal to its dark")


def test_a_shutter_that_stays_closed_for_one_frame_is_noticed(plan):
    frames, darks = run(plan), EmulatedRig(plan.rig, None, seed=1)
    at = next(number for number, (shot, _) in enumerate(frames) if of("sample", 30)(shot) and shot.step == 4)
    frames[at] = frames[at][0], darks.camera.expose(frames[at][0].exposure, shutter=False).counts
    assert bad(plan, frames) == [(frames[at][0].ordinal, "equal to its dark")]


def test_a_shutter_that_stays_open_for_dark_frames_is_noticed(plan):
    frames = run(plan)
    bright = next(counts for shot, counts in frames if of("etalon")(shot) and shot.step == 1)
    at = next(
        number for number, (shot, _) in enumerate(frames) if shot.dark and shot.exposure == plan.bracket[0].exposure
    )
    frames[at] = frames[at][0], bright
    assert bad(plan, frames)[0] == (frames[at][0].ordinal, "dark shows light")


@pytest.mark.parametrize(("pixels", "axis"), [(2, 0), (-4, 1), (5, 0), (-7, 1)])
def test_a_picture_that_moved_is_bad(plan, pixels, axis):
    frames = changed(run(plan), of("sample"), lambda counts: np.roll(counts, pixels, axis))
    found = bad(plan, frames)
    assert {name for _, name in found} >= {"shifted"}
    # The first frame that shows the reference clearly.
    assert min(ordinal for ordinal, _ in found) <= next(
        shot.ordinal for shot in plan.shots if of("sample")(shot) and shot.step == 2
    )


@pytest.mark.parametrize(("pixels", "axis"), [(5, 1), (-6, 0), (7, 1), (-7, 0)])
def test_a_picture_that_is_not_where_it_is_described_is_bad_from_the_first_light_on(plan, pixels, axis):
    """Even if the reference spot comes to lie at the edge of the picture."""
    frames = changed(run(plan), lambda shot: not shot.dark, lambda counts: np.roll(counts, pixels, axis))
    found = bad(plan, frames)
    first = next(shot for shot in plan.shots if not shot.dark)
    assert found[0] == (first.ordinal, "shifted")
    assert {name for _, name in found} == {"shifted"}


def test_a_slow_drift_of_the_picture_is_warned_of(plan):
    def moved(counts: Counts) -> Counts:
        return np.rint(ndimage.shift(counts.astype(float), (0.6, 0), order=1, mode="nearest")).astype(np.uint16)

    found = findings(plan, changed(run(plan), of("sample", 30), moved))
    # The shift spreads hot pixels over pixels that are not known as hot.
    found = [(shot, finding) for shot, finding in found if finding.name != "cosmic"]
    assert found
    assert {(finding.name, finding.severity) for _, finding in found} == {("shifted", "warning")}
    assert "moved by 0.6 pixels" in found[0][1].text


def test_many_cosmic_hits_are_warned_of(plan):
    frames = run(plan, effects=replace(Effects(), cosmic=150.0))
    found = findings(plan, frames)
    warned = [shot for shot, finding in found if finding.name == "cosmic"]
    assert len(warned) >= sum(not shot.dark for shot in plan.shots)
    # Few frames are bad because a hit lies in the reference spot; they are taken again.
    assert sum(finding.severity == "bad" for _, finding in found) <= 3


def test_a_wavelength_beside_the_requested_one_is_warned_of(plan):
    judge = FrameJudge(plan.rig)
    shot, counts = next((shot, counts) for shot, counts in run(plan) if shot.purpose == "etalon")
    (finding,) = judge.judge(shot, counts, wavelength_read=shot.wavelength + 0.45)
    assert (finding.name, finding.severity) == ("wavelength", "warning")
    assert f"reports {shot.wavelength + 0.45:g} nm where {shot.wavelength:g} nm was requested" in finding.text


# --- lamp and monochromator


def test_frames_of_two_exchanged_wavelengths_are_bad(plan):
    frames = run(plan)
    places = {(shot.wavelength, shot.step): number for number, (shot, _) in enumerate(frames) if of("sample", 30)(shot)}
    low, high = plan.wavelengths
    for step in range(1, len(plan.bracket) + 1):
        one, other = places[low, step], places[high, step]
        (frames[one], frames[other]) = (frames[one][0], frames[other][1]), (frames[other][0], frames[one][1])
    found = bad(plan, frames)
    assert found
    assert {name for _, name in found} == {"reference"}
    assert {plan.shots[ordinal - 1].arrangement.incidence for ordinal, _ in found} == {30.0}


# --- the operator


def arranged(plan: Plan, truth: str, setup: Callable[[Arrangement], Arrangement]) -> Iterator[tuple[Shot, Counts]]:
    """A run whose operator arranges something else than asked."""
    rig = EmulatedRig(plan.rig, representation(accuracy.TRUTHS[truth]()), seed=1)
    for shot in plan.shots:
        actual = setup(shot.arrangement)
        rig.set_entrance(actual.incidence, load=actual.load, side=actual.side)
        rig.monochromator.restore(shot.wavelength)
        rig.wheel.restore(shot.position)
        yield shot, rig.camera.expose(shot.exposure, shutter=not shot.dark).counts


@pytest.mark.parametrize("truth", [PLASTIC, MILK_GLASS, FACETS])
def test_an_operator_who_moves_nothing_is_noticed_at_the_first_arrangement(plan, truth):
    frames = list(arranged(plan, truth, lambda asked: Arrangement("sample", "reflection", 10.0)))
    found = [(shot, finding) for shot, finding in findings(plan, frames) if finding.severity == "bad"]
    assert found[0][1].name in ("target", "etalon")
    assert found[0][1].arrangement
    assert found[0][0].arrangement.load == "target"


@pytest.mark.parametrize("truth", [PLASTIC, MILK_GLASS, FACETS])
def test_mirrors_that_were_not_moved_for_the_sample_are_noticed(plan, truth):
    def setup(asked: Arrangement) -> Arrangement:
        return replace(asked, incidence=10.0) if asked.load == "sample" else asked

    found = [
        (shot, finding)
        for shot, finding in findings(plan, list(arranged(plan, truth, setup)))
        if finding.severity == "bad"
    ]
    assert {(shot.arrangement.incidence, finding.name) for shot, finding in found} == {(30.0, "alike")}
    assert "that of the sample at 10°" in found[0][1].text


def test_the_etalon_left_in_the_holder_for_the_sample_is_noticed(plan):
    def setup(asked: Arrangement) -> Arrangement:
        return Arrangement("etalon", "reflection", 30.0) if asked.load == "sample" else asked

    found = bad(plan, list(arranged(plan, PLASTIC, setup)))
    assert {name for _, name in found} == {"alike"}


def test_a_sample_in_place_of_the_etalon_is_noticed(plan):
    def setup(asked: Arrangement) -> Arrangement:
        return Arrangement("sample", "reflection", asked.incidence) if asked.load == "etalon" else asked

    found = bad(plan, list(arranged(plan, PLASTIC, setup)))
    assert {name for _, name in found} <= {"etalon", "alike"}
    assert found


def test_a_target_that_is_missing_is_noticed(plan):
    def setup(asked: Arrangement) -> Arrangement:
        return Arrangement("etalon", "reflection", 10.0) if asked.load == "target" else asked

    found = findings(plan, list(arranged(plan, PLASTIC, setup)))
    assert found[0][1].name == "target"
    assert "0 of 13 spots of the angular target found" in found[0][1].text


def test_a_scan_that_is_resumed_remembers_the_spots_of_the_frames_before(plan):
    """The frames before the interruption are learnt without being judged again."""
    frames, judge = run(plan), FrameJudge(plan.rig)
    for shot, counts in frames:
        last = shot.step == len(plan.bracket)
        if shot.purpose in ("etalon", "target") and last:
            own = judge.judge(shot, counts, wavelength_read=shot.wavelength, last_of_bracket=True)
            assert [finding.text for finding in own if finding.name in ("spots", "target")] == []
        judge.learn(shot, counts)
    # The darkest frame alone shows too few.
    assert all(judge._spots_found.values())


@pytest.mark.parametrize(("missing", "seconds"), [(0.5, 600), (0.3, 60), (0.8, 300)])
def test_a_lamp_that_warms_during_the_run_is_no_error(plan, missing, seconds):
    """``missing``: share of the light that is missing at first; ``seconds``: time constant."""
    frames = rig_emulated.frames(PLASTIC, 1)
    counts, exposure = frames["counts"].values.astype(float), frames["exposure"].values
    dark = frames["purpose"].values == "dark"
    warmed = []
    for shot, own, elapsed in zip(plan.shots, counts, frames["elapsed"].values, strict=True):
        level = counts[dark & (exposure == shot.exposure)].mean(axis=0)
        light = own if shot.dark else level + (own - level) * (1 - missing * np.exp(-elapsed / seconds))
        warmed.append((shot, np.rint(np.clip(light, 0, 65535)).astype(np.uint16)))
    assert bad(plan, warmed) == []
