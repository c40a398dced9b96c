"""How accurate the way from frames to a BSDF is, where the truth is known: whole measurements by the emulated rig, with every effect on.

``python -m brdfpipe.rig.accuracy`` takes samples of known BSDF through scan, reduction, calibration, smoothing and completion, and
compares each value with the truth. Every measurement is of a day of its own: another lamp, another place of the picture, another error of
the etalon's certificate; each rig (seed) has its own fibres, filters, mirrors and sensor. Nothing of the emulator is told to the
reduction but the description of the rig and the certificate.

References
----------
RIG, acceptance in the emulator; Voloboy et al. 2005 (Keldysh Institute preprint): accuracy 4–8 %, repeatability 1–3 %, range 0.01–2500.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np
import xarray as xr

from brdfpipe import catalogue, store, vocabulary
from brdfpipe.bsdf.accessor import BSDFAccessor
from brdfpipe.errors import BrdfpipeError
from brdfpipe.geometry import Array
from brdfpipe.rig import completion, screen, smoothing
from brdfpipe.rig.calibration import apply, calibrate, joined
from brdfpipe.rig.certificate import Certificate
from brdfpipe.rig.description import Target
from brdfpipe.rig.emulator.bench import EmulatedRig
from brdfpipe.rig.emulator.effects import Effects
from brdfpipe.rig.emulator.holder import Etalon
from brdfpipe.rig.frames import Frame, State, dataset
from brdfpipe.rig.plan import Plan, Step
from brdfpipe.rig.reduction import reduce
from brdfpipe.rig.starting import start

SEEDS = (1, 2, 3, 4, 5)
"""One rig each."""

WAVELENGTHS = (470.0, 550.0, 650.0)
INCIDENCES = (0.0, 10.0, 20.0, 30.0, 45.0, 60.0)
BETWEEN = (5.0, 15.0, 25.0, 37.5, 52.5)
"""Incidences at which only the completed BSDF tells."""

TARGET = Target(
    theta_s=(0.0, *(3.0,) * 4, *(6.0,) * 4, *(9.0,) * 4),
    phi_s=(0.0, *(0.0, 90.0, 180.0, 270.0) * 2, 45.0, 135.0, 225.0, 315.0),
    radius=0.3,
)

DAYS = {"glare": 0, "no glare": 10, "repeated": 20, "range": 30}
"""First session of each kind of measurement."""

FIBRE_MEDIAN, DISC_MEDIAN, DISC_95, REPEATABILITY = 0.01, 0.03, 0.10, 0.01
Z_RMS = (0.8, 1.3)
"""What is required (RIG, acceptance)."""

DECADES = ((0.009, 0.03), (0.03, 0.3), (0.3, 3.0), (3.0, 30.0), (30.0, 300.0), (300.0, 2600.0))
"""Of the dynamic range [1/sr]."""

GRAZING = 0.1
"""Cosine of view above which smoothed and completed values are compared."""


def _lobes(base: float, *lobes: tuple[float, float]) -> xr.Dataset:
    """A BRDF of the angle from the mirror direction alone, and so reciprocal: a base and Gaussians of (peak [1/sr], σ [degree])."""
    theta = np.unique(np.concatenate([np.arange(0, 12, 0.05), np.arange(12, 60, 0.5), np.arange(60, 181, 5.0)]))
    brdf = base + sum((peak * np.exp(-(theta**2) / (2 * sigma**2)) for peak, sigma in lobes), np.zeros(theta.size))
    table = xr.Dataset(
        {"brdf": (("theta_i", "theta_s", "phi_s"), np.broadcast_to(brdf[None, :, None], (2, theta.size, 2)).copy())},
        coords={"theta_i": [0.0, 90.0], "theta_s": theta, "phi_s": [0.0, 180.0]},
        attrs={"representation": "table"},
    )
    return vocabulary.validate(vocabulary.label(table, "bsdf"), "bsdf")


TRUTHS: Mapping[str, Callable[[], xr.Dataset]] = {
    "milk glass": lambda: _lobes(0.25, (0.02, 15.0)),
    "plastic, 10 sr⁻¹, 3°": lambda: _lobes(0.127, (10.0, 3.0)),
    "narrow, 300 sr⁻¹, 1.5°, on metallic 14°": lambda: _lobes(0.05, (3.0, 14.0), (300.0, 1.5)),
}

RANGE = "2500 sr⁻¹, 1.3°, on 0.01 sr⁻¹"


@dataclass(frozen=True)
class Measured:
    """A measurement and its truth, value by value."""

    error: Array
    """Relative."""
    z: Array
    """Error over the stated standard uncertainty."""
    apart: Array
    """The same without what all values share: their mean error, and the uncertainty of the etalon's certificate."""
    of_disc: Array
    truth: Array
    primary: xr.Dataset

    def on(self, disc: bool) -> Array:
        """Errors on the disc, or in the fibres."""
        return self.error[self.of_disc == disc]


def plan_of(
    wavelengths: Sequence[float] = WAVELENGTHS, incidences: Sequence[float] = INCIDENCES, fibres: int = 150
) -> Plan:
    """The plan that ``brdfpipe rig new`` writes, with an angular target and the etalon through every entrance, at fewer wavelengths."""
    with tempfile.TemporaryDirectory() as folder:
        plan = Plan.load(start(Path(folder), fibres))
    nearest = min(wavelengths, key=lambda each: abs(each - plan.drift.wavelength))
    return replace(
        plan,
        rig=replace(plan.rig, target=TARGET),
        wavelengths=tuple(wavelengths),
        incidences=tuple(incidences),
        etalon_entrances=tuple(sorted({*incidences, plan.rig.etalon_entrance})),
        runs=("target", "etalon", "sample"),
        drift=replace(plan.drift, wavelength=nearest),
    )


def frames_of(
    plan: Plan, truth: xr.Dataset, *, seed: int = 0, session: int = 0, effects: Effects | None = None
) -> xr.Dataset:
    """The frames of a plan, taken by the emulated rig without serial lines and files: kind ``frames``."""
    stand = EmulatedRig(plan.rig, truth, seed=seed, session=session, effects=effects)
    frames = {}
    for shot in plan.shots:
        stand.set_entrance(shot.arrangement.incidence, load=shot.arrangement.load, side=shot.arrangement.side)
        stand.monochromator.restore(shot.wavelength)
        stand.wheel.restore(shot.position)
        picture = stand.camera.expose(shot.exposure, shutter=not shot.dark)
        frames[shot] = Frame(
            counts=picture.counts,
            state=State(shot.wavelength, shot.position),
            started=picture.started,
            elapsed=picture.started,
            temperature=picture.temperature,
            camera=stand.camera.identify(),
            digest="",
        )
    return dataset(frames, plan)


def certificate(valid_until: date = date(2030, 1, 1)) -> Certificate:
    """What the emulated etalon is certified for; that of a day differs by what a certificate is uncertain."""
    etalon, theta = Etalon(), np.arange(0.0, 91.0, 2.0)
    return Certificate(
        identity="emulated",
        valid_until=valid_until,
        wavelength=np.array([300.0, 900.0]),
        reflectance_factor=np.full(2, etalon.reflectance),
        u=np.full(2, Effects().certificate),
        theta=theta,
        shape=etalon.brdf(theta) / float(etalon.brdf(np.zeros(1))[0]),
    )


def reduced(plan: Plan, frames: xr.Dataset, load: str) -> xr.Dataset:
    """All arrangements of a load."""
    incidences = plan.etalon_entrances if load == "etalon" else plan.incidences
    return joined([reduce(frames, plan.rig, load=load, incidence=incidence) for incidence in incidences])


def measured(plan: Plan, truth: xr.Dataset, **circumstances: int | Effects | None) -> Measured:
    """A calibrated measurement of a truth, compared with it.

    Parameters
    ----------
    circumstances : ``seed``, ``session`` and ``effects`` of the emulated rig
    """
    frames = frames_of(plan, truth, **circumstances)  # type: ignore[arg-type]
    profile = calibrate(reduced(plan, frames, "etalon"), certificate())
    return compared(apply(reduced(plan, frames, "sample"), profile), truth)


def compared(primary: xr.Dataset, truth: xr.Dataset) -> Measured:
    """Values of kind ``primary`` that are measured, against the truth in the same direction."""
    theta_s, phi_s = primary["theta_s"].values, primary["phi_s"].values
    true = np.full(primary["brdf"].shape, np.nan)
    for place, incidence in enumerate(primary["incidence"].values):
        theta_o, phi_o = screen.outgoing(float(incidence), theta_s, phi_s)
        above = theta_o < 90
        found = BSDFAccessor(truth).evaluate(float(incidence), 0.0, theta_o[above], phi_o[above])
        true[place][:, above] = found.values.reshape(above.sum(), -1).T
    value, u, shared = (primary[name].values for name in ("brdf", "brdf_u", "brdf_u_certificate"))
    used = np.isfinite(value) & np.isin(
        primary["brdf_quality"].values, [vocabulary.quality(name) for name in ("measured", "below_noise")]
    )
    error, own = (value / true - 1)[used], (np.sqrt(u**2 - shared**2) / true)[used]
    mean = (error / own**2).sum() / (1 / own**2).sum()
    of_disc = np.broadcast_to(primary["kind"].values == "disc", value.shape)
    return Measured(error, ((value - true) / u)[used], (error - mean) / own, of_disc[used], true[used], primary)


def dense(bsdf: xr.Dataset, truth: xr.Dataset, incidences: Sequence[float]) -> tuple[Array, Array]:
    """Relative errors of a completed BSDF on a grid about the mirror direction, within its lobe's 10° and beyond."""
    theta = np.concatenate([np.arange(0.25, 10, 0.5), np.arange(12, 100, 4.0)])
    theta_s, phi_s = (angle.ravel() for angle in np.meshgrid(theta, np.arange(0, 360, 30.0), indexing="ij"))
    within, beyond = [], []
    for incidence in incidences:
        seen = screen.cos_view(incidence, theta_s, phi_s) > GRAZING
        direction = incidence, 0.0, *screen.outgoing(incidence, theta_s[seen], phi_s[seen])
        found, true = (BSDFAccessor(each).evaluate(*direction).values.reshape(seen.sum(), -1) for each in (bsdf, truth))
        error = found / true - 1
        within.append(error[theta_s[seen] < 10].ravel())
        beyond.append(error[theta_s[seen] >= 10].ravel())
    return np.concatenate(within), np.concatenate(beyond)


# --- what is measured


class Job(NamedTuple):
    """A measurement to be made."""

    kind: str
    truth: str
    seed: int
    session: int


class Outcome(NamedTuple):
    """What came of it; errors and z by value, and the completed BSDF's errors at incidences that were measured and between them."""

    job: Job
    error: Array
    z: Array
    apart: Array
    of_disc: Array
    truth: Array
    value: Array
    """All values (incidence, wavelength, cell)."""
    completed: tuple[tuple[Array, Array], tuple[Array, Array]] | None


def jobs() -> Iterator[Job]:
    """Every measurement of the acceptance."""
    for kind in ("glare", "no glare"):
        for day, truth in enumerate(TRUTHS):
            for seed in SEEDS:
                yield Job(kind, truth, seed, DAYS[kind] + day)
    for day in range(len(SEEDS)):
        yield Job("repeated", list(TRUTHS)[1], SEEDS[0], DAYS["repeated"] + day)
    for seed in SEEDS:
        yield Job("range", RANGE, seed, DAYS["range"])


def outcome(job: Job) -> Outcome:
    """Make one measurement."""
    plan = plan_of()
    truth = TRUTHS[job.truth]() if job.truth in TRUTHS else _lobes(0.01, (2499.99, 1.3))
    if job.kind == "range":
        plan = replace(plan, bracket=(Step(0.1, plan.bracket[0].position), *plan.bracket[1:]))
    effects = Effects(halo=0.0) if job.kind == "no glare" else Effects()
    found = measured(plan, truth, seed=job.seed, session=job.session, effects=effects)
    completed = None
    if job.kind == "glare":
        bsdf = completion.complete(smoothing.smooth(found.primary))
        completed = dense(bsdf, truth, INCIDENCES), dense(bsdf, truth, BETWEEN)
    value = found.primary["brdf"].values
    return Outcome(job, found.error, found.z, found.apart, found.of_disc, found.truth, value, completed)


def detections() -> Iterator[tuple[str, str]]:
    """What must not pass unnoticed, and the refusal it met; empty if it met none."""
    plan = plan_of((430.0, 470.0, 510.0, 550.0, 650.0), (10.0, 30.0))
    truth = TRUTHS["plastic, 10 sr⁻¹, 3°"]()
    frames = frames_of(plan, truth, seed=SEEDS[0])
    etalon, sample = reduced(plan, frames, "etalon"), reduced(plan, frames, "sample")
    profile = calibrate(etalon, certificate())
    day = date.fromisoformat(sample.attrs["day"])
    turned = sample.copy(deep=True)
    turned["reference"] = turned["reference"][:, ::-1].variable
    turned["signal"] = turned["signal"][:, ::-1].variable
    holes = sample.copy(deep=True)
    lost = np.random.default_rng(0).random(holes["signal"].shape) < 0.05
    holes["signal"] = holes["signal"].where(~lost, 0.0)
    wrong = replace(plan.rig, nd_location="reference")
    yield "wrong nd_location", _refusal(lambda: reduce(frames, wrong, incidence=10.0))
    yield (
        "expired profile",
        _refusal(lambda: apply(sample.assign_attrs(day=str(date.fromordinal(day.toordinal() + 91))), profile)),
    )
    yield (
        "stale etalon: its certificate has run out",
        _refusal(lambda: calibrate(etalon, certificate(date(1969, 12, 31)))),
    )
    yield "lamp has burnt too long since the etalon", _refusal(lambda: apply(sample, profile, lamp_hours=201.0))
    yield "swapped wavelength axis", _refusal(lambda: apply(turned, profile))
    yield (
        "etalon of another rig",
        _refusal(lambda: apply(sample, profile.assign_attrs(rig_digest="another", rig="bench-2"))),
    )
    yield "5 % of the values missing, stored as zeros", _refusal(lambda: apply(holes, profile))


def _refusal(action: Callable[[], object]) -> str:
    try:
        action()
    except BrdfpipeError as refusal:
        return str(refusal)
    return ""


# --- what a person reads


@dataclass(frozen=True)
class Check:
    """A figure and what it must be."""

    what: str
    found: str
    required: str
    met: bool


def checks(outcomes: Sequence[Outcome]) -> Iterator[Check]:
    """Each figure of the acceptance."""
    for kind in ("no glare", "glare"):
        for truth in TRUTHS:
            own = [each for each in outcomes if each.job[:2] == (kind, truth)]
            error, of_disc = (np.concatenate([getattr(each, name) for each in own]) for name in ("error", "of_disc"))
            size = np.abs(error)
            where = f"{truth}, {kind}"
            yield _below(f"{where}: fibres, median", np.median(size[~of_disc]), FIBRE_MEDIAN)
            yield _below(f"{where}: disc, median", np.median(size[of_disc]), DISC_MEDIAN)
            yield _below(f"{where}: disc, 95th percentile", np.percentile(size[of_disc], 95), DISC_95)
    repeated = np.array([each.value for each in outcomes if each.job.kind == "repeated"])
    with np.errstate(invalid="ignore"):
        scatter = repeated.std(axis=0, ddof=1) / repeated.mean(axis=0)
    yield _below("repeatability over 5 runs, median", np.nanmedian(scatter), REPEATABILITY)
    for name, what in (("z", "z-rms overall"), ("apart", "z-rms without what all values of a measurement share")):
        z = np.concatenate([getattr(each, name) for each in outcomes if each.job.kind in ("glare", "no glare")])
        rms = float(np.sqrt((z**2).mean()))
        yield Check(what, f"{rms:.2f}", f"{Z_RMS[0]} to {Z_RMS[1]}", Z_RMS[0] <= rms <= Z_RMS[1])
    ranged = [each for each in outcomes if each.job.kind == "range"]
    true, z = (np.concatenate([getattr(each, name) for each in ranged]) for name in ("truth", "z"))
    for low, high in DECADES:
        within = z[(true >= low) & (true < high)]
        rms = float(np.sqrt((within**2).mean()))
        what = f"{RANGE}: z-rms from {low:g} to {high:g} sr⁻¹"
        yield Check(what, f"{rms:.2f}", f"at most {Z_RMS[1]}", bool(within.size) and rms <= Z_RMS[1])


def _below(what: str, found: float, limit: float) -> Check:
    return Check(what, f"{100 * found:.2f} %", f"below {100 * limit:g} %", bool(found < limit))


def report(outcomes: Sequence[Outcome], refusals: Sequence[tuple[str, str]]) -> tuple[str, bool]:
    """The page, in Markdown, and whether everything required is met."""
    made = list(checks(outcomes))
    made += [Check(what, "refused" if said else "passed", "refused", bool(said)) for what, said in refusals]
    lines = [
        "# Accuracy of the camera rig",
        "",
        "Written by `make rig-accuracy`: whole measurements by the emulated rig, every effect on, seeds "
        f"{', '.join(map(str, SEEDS))} (a rig each; every measurement on a day of its own), {len(WAVELENGTHS)} wavelengths, the entrances at "
        f"{', '.join(f'{each:g}' for each in INCIDENCES)}°, the etalon through each of them. An emulator's effects are those somebody thought of: "
        "a laboratory will find more.",
        "",
        *_table(
            ("", "found", "required", ""),
            ((each.what, each.found, each.required, "met" if each.met else "**not met**") for each in made),
        ),
        "",
        "## By rig",
        "",
        "Relative errors of single values against the truth in per cent (median / 95th percentile), and the rms of error over stated uncertainty. "
        "The error of the etalon's certificate, 0.5 %, is one number for all values of a measurement: it makes the z-rms of each a matter of "
        "chance, and what all values share is left out of the second figure above.",
        "",
        *_table(("sample", "", "seed", "fibres 50 / 95", "disc 50 / 95", "z-rms"), _by_rig(outcomes)),
        "",
        f"## From 0.01 to 2500 sr⁻¹ ({RANGE})",
        "",
        "Glare of the peak is many times as bright as what surrounds it: the uncertainty there says so.",
        "",
        *_table(("BRDF, sr⁻¹", "values", "error 50 / 95", "z-rms"), _by_decade(outcomes)),
        "",
        "## Smoothed and completed",
        "",
        "Relative error of the BSDF between the cells, in per cent (rms / 95th percentile): within 10° of the mirror direction and beyond, "
        "at incidences that were measured and between them; with glare.",
        "",
        *_table(
            ("sample", "measured, within", "measured, beyond", "between, within", "between, beyond"),
            _completed(outcomes),
        ),
        "",
        "## Refused",
        "",
        *(f"- {what}: {said or '**nothing**'}" for what, said in refusals),
        "",
    ]
    return "\n".join(lines), all(each.met for each in made)


def _table(titles: Sequence[str], rows: Iterator[Sequence[str]]) -> Iterator[str]:
    yield f"| {' | '.join(titles)} |"
    yield f"|{'---|' * len(titles)}"
    for row in rows:
        yield f"| {' | '.join(row)} |"


def _by_rig(outcomes: Sequence[Outcome]) -> Iterator[tuple[str, ...]]:
    for each in outcomes:
        if each.job.kind in ("glare", "no glare"):
            spread = [_percentiles(each.error[each.of_disc == disc]) for disc in (False, True)]
            yield each.job.truth, each.job.kind, str(each.job.seed), *spread, f"{np.sqrt((each.z**2).mean()):.2f}"


def _by_decade(outcomes: Sequence[Outcome]) -> Iterator[tuple[str, ...]]:
    ranged = [each for each in outcomes if each.job.kind == "range"]
    true, error, z = (np.concatenate([getattr(each, name) for each in ranged]) for name in ("truth", "error", "z"))
    for low, high in DECADES:
        own = (true >= low) & (true < high)
        yield f"{low:g} to {high:g}", str(own.sum()), _percentiles(error[own]), f"{np.sqrt((z[own] ** 2).mean()):.2f}"


def _completed(outcomes: Sequence[Outcome]) -> Iterator[tuple[str, ...]]:
    for truth in TRUTHS:
        own = [each.completed for each in outcomes if each.job.truth == truth and each.completed is not None]
        fields = [np.concatenate([each[place][where] for each in own]) for place in (0, 1) for where in (0, 1)]
        yield (
            truth,
            *(
                f"{100 * np.sqrt((field**2).mean()):.2f} / {100 * np.percentile(np.abs(field), 95):.2f}"
                for field in fields
            ),
        )


def _percentiles(error: Array) -> str:
    return " / ".join(f"{100 * each:.2f}" for each in np.percentile(np.abs(error), [50, 95]))


@click.command()
@click.option(
    "--out",
    type=click.Path(path_type=Path, dir_okay=False),
    default=lambda: catalogue.project_folder() / "docs" / "rig-accuracy.md",
    help="The page to write  [default: docs/rig-accuracy.md]",
)
@click.option("--cores", type=click.IntRange(1), default=2, show_default=True)
def main(out: Path, cores: int) -> None:
    """Measure samples of known BSDF with emulated rigs, and write how far off the results are."""
    from tqdm import tqdm

    todo = list(jobs())
    with ProcessPoolExecutor(cores) as pool:
        outcomes = list(tqdm(pool.map(outcome, todo), total=len(todo), unit="measurement", dynamic_ncols=True))
    text, met = report(outcomes, list(detections()))
    click.echo(text)
    store.write_text(out, text)
    if not met:
        sys.exit("a requirement is not met")


if __name__ == "__main__":
    main()
