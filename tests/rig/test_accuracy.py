"""The acceptance in the emulator, in small; and that its page tells what is not met. ``make rig-accuracy`` is the whole of it."""

from __future__ import annotations

import numpy as np
import pytest
from click.testing import CliRunner

from brdfpipe.rig import accuracy
from brdfpipe.rig.accuracy import Job, Outcome


@pytest.mark.parametrize("truth", accuracy.TRUTHS)
def test_a_measurement_of_a_known_sample_is_as_accurate_as_it_says(truth):
    """One rig, one wavelength, two incidences, every effect on; the page has the limits over all rigs."""
    plan = accuracy.plan_of((550.0,), (10.0, 45.0), fibres=80)
    found = accuracy.measured(plan, accuracy.TRUTHS[truth](), seed=3, session=1)
    assert np.median(np.abs(found.on(disc=False))) < 0.015
    assert np.median(np.abs(found.on(disc=True))) < 0.015
    assert np.percentile(np.abs(found.on(disc=True)), 95) < 0.03
    assert np.sqrt(np.mean(found.z**2)) < 2.5
    assert 0.75 < np.sqrt(np.mean(found.apart**2)) < 1.3
    # All fibres that are alive and above the horizon, and the whole disc.
    assert found.of_disc.sum() > 2 * 370
    assert (~found.of_disc).sum() > 2 * 45


def test_what_must_not_pass_does_not_pass():
    refusals = dict(accuracy.detections())
    assert len(refusals) == 7
    assert all(refusals.values()), refusals
    assert "nd_location: sample" in refusals["wrong nd_location"]
    assert "91 days old" in refusals["expired profile"]
    assert "spectrum differs" in refusals["swapped wavelength axis"]


def test_the_truths_are_reciprocal():
    for truth in accuracy.TRUTHS.values():
        bsdf = truth()
        there = bsdf.bsdf.evaluate(20.0, 0.0, [10.0, 40.0, 70.0], [180.0, 100.0, 0.0]).values
        back = [float(bsdf.bsdf.evaluate(theta, 0.0, 20.0, -phi)) for theta, phi in ((10, 180), (40, 100), (70, 0))]
        assert there.ravel() == pytest.approx(back, rel=1e-6)


# --- the page


def outcomes(error: float, z: float) -> list[Outcome]:
    """Made up: errors of this size everywhere."""
    found = []
    for job in accuracy.jobs():
        signs = np.resize([1.0, -1.0], 600)
        truth = np.geomspace(0.0091, 2500, 600)
        value = np.full((2, 3, 4), 1 + error * (job.session % 2))
        dense = ((error * signs, error * signs), (error * signs, error * signs)) if job.kind == "glare" else None
        of_disc = np.arange(600) % 2 == 0
        found.append(Outcome(job, error * signs, z * signs, z * signs, of_disc, truth, value, dense))
    return found


def test_every_figure_of_the_acceptance_is_judged():
    assert all(check.met for check in accuracy.checks(outcomes(0.005, 1.0)))
    unmet = [check.what for check in accuracy.checks(outcomes(0.2, 2.0)) if not check.met]
    made = list(accuracy.checks(outcomes(0.2, 2.0)))
    assert len(unmet) == len(made) == 18 + 3 + 6


def test_uncertainties_that_are_too_large_are_not_honest_either():
    unmet = [check.what for check in accuracy.checks(outcomes(0.005, 0.5)) if not check.met]
    assert unmet == ["z-rms overall", "z-rms without what all values of a measurement share"]


def test_the_page_shows_what_is_not_met_and_what_was_not_refused():
    text, met = accuracy.report(outcomes(0.005, 1.0), [("wrong nd_location", "the filters are elsewhere")])
    assert met
    assert "**not met**" not in text
    text, met = accuracy.report(outcomes(0.005, 1.0), [("wrong nd_location", "")])
    assert not met
    assert "| wrong nd_location | passed | refused | **not met** |" in text
    text, met = accuracy.report(outcomes(0.02, 1.0), [("wrong nd_location", "the filters are elsewhere")])
    assert not met
    assert text.count("**not met**") == 7


def test_the_jobs_are_all_truths_with_all_rigs_each_on_a_day_of_its_own():
    jobs = list(accuracy.jobs())
    assert len(jobs) == len(set(jobs)) == 2 * 3 * 5 + 5 + 5
    days = [(job.seed, job.session) for job in jobs]
    assert len(days) == len(set(days))
    assert {job.seed for job in jobs} == set(accuracy.SEEDS)


def test_the_command_writes_its_page_and_fails_if_something_is_not_met(tmp_path, monkeypatch):
    made = iter([outcomes(0.005, 1.0), outcomes(0.2, 1.0)])

    class Pool:
        def __init__(self, cores: int) -> None: ...
        def __enter__(self):
            return self

        def __exit__(self, *error):
            return False

        def map(self, of, jobs):
            return iter(next(made))

    monkeypatch.setattr(accuracy, "ProcessPoolExecutor", Pool)
    monkeypatch.setattr(accuracy, "detections", lambda: iter([("wrong nd_location", "refused")]))
    page = tmp_path / "page.md"
    good = CliRunner().invoke(accuracy.main, ["--out", str(page)])
    assert good.exit_code == 0
    assert page.read_text(encoding="utf-8") in good.output
    bad = CliRunner().invoke(accuracy.main, ["--out", str(page)])
    assert bad.exit_code == 1
    assert "**not met**" in page.read_text(encoding="utf-8")


def test_a_job_names_what_is_measured():
    assert Job("glare", "milk glass", 1, 0) in set(accuracy.jobs())
