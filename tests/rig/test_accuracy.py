"""A small version of the acceptance in the emulator, and its page. ``make rig-accuracy`` runs all of it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import rig_accuracy as accuracy
import xarray as xr
from click.testing import CliRunner
from rig_accuracy import Departure, Job, Outcome

from brdfpipe.bsdf.measured import completion, smoothing
from brdfpipe.rig.plan import Plan

APART = (0.6, 1.3)
"""Limits of the rms of z without the certificate. The page requires 0.8: with few pictures the repeatability is uncertain, and its assumed value
exceeds the emulator's error."""


def plan(*incidences: float) -> Plan:
    """At one wavelength, with a bright monitor reading of the lamp after every frame for its repeatability."""
    small = accuracy.plan_of((550.0,), incidences, fibres=80)
    return replace(small, drift=replace(small.drift, every=1, step=4))


@pytest.mark.parametrize(
    "truth",
    [pytest.param(name, marks=() if name == accuracy.FACETS else pytest.mark.slow) for name in accuracy.TRUTHS],
)
def test_a_measurement_of_a_known_sample_is_as_accurate_as_stated(truth):
    """One rig, one wavelength, two incidences, every effect on; the page has the limits over all rigs."""
    values = accuracy.measured(plan(10.0, 45.0), accuracy.TRUTHS[truth](), seed=3, session=1)
    assert np.median(np.abs(values.on(disc=False))) < 0.015
    assert np.median(np.abs(values.on(disc=True))) < 0.015
    # Cells are no finer than the flanks of the narrow lobe.
    assert np.percentile(np.abs(values.on(disc=True)), 95) < (0.05 if truth.startswith("narrow") else 0.03)
    assert np.sqrt(np.mean(values.z**2)) < 2.5
    assert APART[0] < np.sqrt(np.mean(values.apart**2)) < APART[1]
    # All fibres that are alive and above the horizon, and the whole disc.
    assert values.of_disc.sum() > 2 * 370
    assert (~values.of_disc).sum() > 2 * 45


@pytest.mark.slow
def test_transmission_is_as_accurate_as_stated():
    truth = accuracy.SAMPLES[accuracy.THROUGH]()
    _, behind = accuracy.primaries(replace(plan(30.0), side=("reflection", "transmission")), truth, seed=3, session=1)
    assert behind.attrs["side"] == "transmission"
    values = accuracy.compared(behind, truth)
    assert np.median(np.abs(values.on(disc=True))) < 0.015
    assert APART[0] < np.sqrt(np.mean(values.apart**2)) < APART[1]


def test_etalon_and_sample_are_of_two_days():
    """The position of the picture and the drift of the lamp differ between the days."""
    etalon, sample = accuracy.two_days(plan(10.0), accuracy.TRUTHS["milk glass"](), seed=3, session=1)
    assert "sample" not in etalon["purpose"].values
    assert "etalon" not in sample["purpose"].values
    longest = [
        frames["counts"][frames["purpose"].values == "target"][-1].values.astype(float) for frames in (etalon, sample)
    ]
    # Of one day they would be the same, count by count.
    assert np.abs(longest[0] - longest[1]).max() > 1000


# --- the completed BSDF


@cache
def plastic() -> tuple[xr.Dataset, xr.Dataset, xr.Dataset]:
    """The plastic of facets at three incidences, the same completed, and the truth."""
    truth = accuracy.TRUTHS[accuracy.FACETS]()
    (primary,) = accuracy.primaries(plan(10.0, 30.0, 60.0), truth, seed=3, session=1)
    return primary, completion.complete(smoothing.smooth(primary)), truth


def test_directions_of_the_regions_are_where_their_names_say():
    for name, directions in accuracy.REGIONS.items():
        for side in ("reflection", "transmission"):
            theta_i, theta_o, _ = directions(side)
            low = np.abs(90 - theta_o)
            assert ((theta_o < 90) == (side == "reflection")).all()
            assert (low <= 5.001).all() if "horizon" in name else (low > 5.7).all()
            assert (theta_i > 60).all() if "larger" in name else (theta_i <= 60).all()


@pytest.mark.slow
def test_a_completed_bsdf_is_compared_region_by_region():
    _, bsdf, truth = plastic()
    regions = accuracy.departures(bsdf, truth)
    assert list(regions) == list(accuracy.REGIONS)
    assert all(np.isfinite(departure.error).all() and np.isfinite(departure.z).all() for departure in regions.values())
    assert np.median(np.abs(regions["measured incidences, within 10°"].error)) < 0.03
    # A BSDF against itself is off by nothing.
    assert not any(departure.error.any() or departure.z.any() for departure in accuracy.departures(bsdf, bsdf).values())


@pytest.mark.slow
def test_gloss_of_a_completed_bsdf_is_that_of_the_truth_where_it_was_measured():
    _, bsdf, truth = plastic()
    true, measured, u, flags = accuracy.glosses(bsdf, truth)
    assert measured[1] == pytest.approx(true[1], abs=4 * u[1])
    assert u[2] / measured[2] > 10 * u[1] / measured[1]
    assert list(flags) == [1, 0, 3]


@pytest.mark.slow
def test_errors_in_the_description_of_a_surface_are_recovered():
    inputs, u = accuracy.recovered(plastic()[0])
    assert inputs == pytest.approx(list(accuracy.DOUBTED.values()), abs=0.01)
    assert (u < 0.01).all()


def test_the_samples_of_the_acceptance_reflect_no_more_than_the_incident_light():
    for name, truth in accuracy.SAMPLES.items():
        bsdf = truth().bsdf
        total = bsdf.albedo(0.0, wavelength=550.0).item() + bsdf.transmittance(0.0, wavelength=550.0).item()
        assert (total > 1) == (name == accuracy.RANGE), name


def test_mistakes_are_refused():
    refusals = dict(accuracy.detections())
    assert len(refusals) == 7
    assert all(refusals.values()), refusals
    assert "nd_location: sample" in refusals["wrong nd_location"]
    assert "91 days old" in refusals["expired profile"]
    assert "spectrum differs" in refusals["swapped wavelength axis"]


def test_the_truths_are_reciprocal():
    for truth in accuracy.SAMPLES.values():
        bsdf = truth().bsdf
        forward = bsdf.evaluate(20.0, 0.0, [10.0, 40.0, 70.0], [180.0, 100.0, 0.0], 550.0).values
        backward = [
            bsdf.evaluate(theta, phi, 20.0, 0.0, 550.0).item() for theta, phi in ((10, 180), (40, 100), (70, 0))
        ]
        assert forward.ravel() == pytest.approx(backward, rel=1e-6)


# --- the page


def outcomes(error: float, z: float) -> list[Outcome]:
    """Invented outcomes with errors of one size everywhere."""
    results = []
    for job in accuracy.jobs():
        signs = np.resize([1.0, -1.0], 600)
        truth = np.geomspace(0.0091, 2500, 600)
        value = np.full((2, 3, 4), 1 + error * (job.session % 2))
        of_disc = np.arange(600) % 2 == 0
        made = Outcome(job, error * signs, z * signs, z * signs, of_disc, truth, value)
        if job.kind in ("glare", "through"):
            made = made._replace(completed=dict.fromkeys(accuracy.REGIONS, Departure(error * signs, z * signs)))
        if job.kind == "glare":
            made = made._replace(
                gloss=np.array([[80.0, 90.0, 95.0], [80.5, 90.0, 50.0], [0.5, 0.5, 90.0], [1.0, 0.0, 3.0]])
            )
        if job.truth == accuracy.FACETS:
            made = made._replace(recovered=np.array([[0.02, 1.1, 1.004], [0.001, 0.001, 0.002]]))
        results.append(made)
    return results


def test_every_figure_of_the_acceptance_is_judged():
    assert all(check.met for check in accuracy.checks(outcomes(0.005, 1.0)))
    unmet = [check.what for check in accuracy.checks(outcomes(0.2, 2.0)) if not check.met]
    made = list(accuracy.checks(outcomes(0.2, 2.0)))
    assert len(unmet) == len(made) == 24 + 3 + 6


def test_too_large_uncertainties_do_not_meet_the_requirement():
    unmet = [check.what for check in accuracy.checks(outcomes(0.005, 0.5)) if not check.met]
    assert unmet == ["rms of z, all values", "rms of z without the common error of a measurement"]


def test_the_page_shows_what_is_not_met_and_what_was_not_refused():
    text, met = accuracy.report(outcomes(0.005, 1.0), [("wrong nd_location", "the filters are elsewhere")])
    assert met
    assert "**not met**" not in text
    text, met = accuracy.report(outcomes(0.005, 1.0), [("wrong nd_location", "")])
    assert not met
    assert "| wrong nd_location | passed | refused | **not met** |" in text
    text, met = accuracy.report(outcomes(0.02, 1.0), [("wrong nd_location", "the filters are elsewhere")])
    assert not met
    assert text.count("**not met**") == 9


def test_the_page_shows_the_completed_bsdf_its_gloss_and_the_comparison():
    text, _ = accuracy.report(outcomes(0.005, 1.5), [])
    for sample in (*accuracy.TRUTHS, accuracy.THROUGH):
        for region in accuracy.REGIONS:
            assert f"| {sample} | {region} | 0.50 / 0.50 | 1.50 | 1.50 |" in text
    for row in ("20° | 80.5 ± 0.5 | 80 | interpolated | 1.00", "60° | 90 ± 0.5 | 90 | measured | 0.00"):
        assert f"| milk glass | {row} |" in text
    assert "| milk glass | 85° | 50 ± 90 | 95 | completed | 0.50 |" in text
    assert "| diffuse | 1 | 1.00400 | 0.00200 | 2.00 |" in text
    assert "above 1.3: milk glass: measured incidences, within 10° (1.50); " in text
    assert "above 1.3: nowhere." in accuracy.report(outcomes(0.005, 1.0), [])[0]
    assert "it would reflect 2.5 times the incident light" in text
    assert "below 0.34 % on half of all days" in text


def test_the_jobs_are_all_truths_with_all_rigs_each_on_its_own_day():
    jobs = list(accuracy.jobs())
    assert len(jobs) == len(set(jobs)) == 2 * 4 * 5 + 5 + 5 + 5 + 5 + 5
    days = [(job.seed, job.session + later) for job in jobs for later in (0, accuracy.ETALON)]
    assert len(days) == len(set(days))
    assert {job.seed for job in jobs} == set(accuracy.SEEDS)


def test_the_command_writes_its_page_and_fails_if_something_is_not_met(tmp_path, monkeypatch):
    made = iter([outcomes(0.005, 1.0), outcomes(0.2, 1.0)])

    class Pool:
        def __init__(self, cores: int, context: object) -> None: ...
        def __enter__(self):
            return self

        def __exit__(self, *error):
            return False

        def map(self, of, jobs):
            return iter(next(made))

    monkeypatch.setattr(accuracy, "ProcessPoolExecutor", Pool)
    for name in accuracy.ONE_THREAD:
        monkeypatch.setenv(name, "1")
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
