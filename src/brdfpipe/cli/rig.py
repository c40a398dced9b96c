"""The commands of a rig: ``brdfpipe rig new``, ``doctor``, ``scan``, ``watch``, ``next``, ``directions`` and ``emulate``.

Exit codes: 0 done, 1 a device failed or the scan stopped before its end, 2 the command or a description cannot be used, 130 interrupted.
"""

from __future__ import annotations

import getpass
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from brdfpipe.cli.console import FILE, FOLDER, exit_on_error
from brdfpipe.errors import BrdfpipeError, InputError, abbreviated

if TYPE_CHECKING:
    from brdfpipe.bsdf.base import Representation
    from brdfpipe.rig.acquisition.scan import Summary
    from brdfpipe.rig.emulator.emulated_rig import EmulatedRig
    from brdfpipe.rig.plan import Arrangement, Plan

EMULATED = "emulated.yaml"
"""File name of the description of an emulated rig, while it runs."""

EMULATED_CAMERA = "emulated-camera"

_EMULATED_HEADER = "# An emulated rig; `brdfpipe rig emulate` wrote this file, and removes it when it ends.\n"

_DEFAULT_ARRANGEMENT = ("", "sample", "reflection")

_TRUTH = click.Path(path_type=Path, exists=True)
_SESSION = click.option(
    "--session", type=click.IntRange(0), default=0, show_default=True, help="Number of the day of the emulated rig."
)


@click.group()
def rig() -> None:
    """A camera rig: its devices, its scans, and an emulator of both."""


@rig.command(short_help="Start a rig in FOLDER, with commented files.")
@click.argument("folder", type=FOLDER)
@click.option("--fibres", type=int, default=150, show_default=True, help="Number of fibres of the hemisphere.")
@exit_on_error
def new(folder: Path, fibres: int) -> int:
    """Start a rig: FOLDER with a commented rig.yaml, fibres.csv and plan.yaml."""
    from brdfpipe.rig.templates import start

    plan, rig = start(folder, fibres), folder / "rig.yaml"
    click.echo(f"Describe your bench in {rig} and try its devices: `brdfpipe rig doctor {rig}`.")
    click.echo(f"Then fill in {plan} and estimate the scan: `brdfpipe rig scan {plan} --dry-run`.")
    return 0


@rig.command()
@click.argument("description", metavar="RIG.yaml", type=FILE)
@exit_on_error
def doctor(description: Path) -> int:
    """Identify, move and time each device of a rig. Exit code: 1 if one fails."""
    from brdfpipe.rig.acquisition.doctor import doctor as examine
    from brdfpipe.rig.description import Rig

    return 0 if all(row.passed for row in examine(Rig.load(description))) else 1


@rig.command()
@click.argument("plan_file", metavar="PLAN.yaml", type=FILE)
@click.option("--out", type=FOLDER, default=None, help="Folder of the run  [default: runs/SAMPLE beside the plan]")
@click.option("--yes", is_flag=True, help="Confirm every arrangement of mirrors and sample without asking.")
@click.option("--resume", is_flag=True, help="Continue the run in the folder, if there is one.")
@click.option("--dry-run", is_flag=True, help="Estimate frames, bytes and hours; use no device.")
@click.option(
    "--emulate",
    type=_TRUTH,
    default=None,
    help="A BSDF (.nc), or the folder of a built material: scan it with an emulated rig.",
)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of the emulated rig.")
@_SESSION
@exit_on_error
def scan(
    plan_file: Path,
    out: Path | None,
    yes: bool,
    resume: bool,
    dry_run: bool,
    emulate: Path | None,
    seed: int,
    session: int,
) -> int:
    """Take every frame of PLAN.yaml that its folder does not hold yet.

    Each frame is on the disk before the next is exposed. After any interruption the same command with --resume continues.
    """
    from brdfpipe.rig.acquisition.estimate import estimate
    from brdfpipe.rig.acquisition.scan import ScanStopped
    from brdfpipe.rig.plan import Plan

    plan = Plan.load(plan_file)
    if dry_run:
        click.echo(estimate(plan).text)
        return 0
    folder = out or plan_file.parent / "runs" / plan.sample
    options: dict[str, Any] = {"resume": resume, "progress": True, "on_warning": _print_line}
    try:
        if emulate is None:
            done = _real_scan(plan, folder, yes, options)
        else:
            from brdfpipe.rig.emulator.emulated_scan import scan_emulated

            done = scan_emulated(plan, folder, truth(emulate), seed=seed, session=session, **options)
        click.echo(done.text)
    except ScanStopped as stop:
        click.echo(f"brdfpipe: {stop}", err=True)
        return 1
    except KeyboardInterrupt:
        click.echo(f"brdfpipe: interrupted; finished frames are safe in {folder}; continue with --resume", err=True)
        return 130
    return 0


@rig.command("next", short_help="Propose what to measure next.")
@click.argument("results", type=FOLDER)
@click.argument("plan_file", metavar="PLAN.yaml", type=FILE)
@exit_on_error
def propose_next(results: Path, plan_file: Path) -> int:
    """Propose the next incidences and wavelengths of a sample, from the RESULTS of its material and the PLAN.yaml of its rig."""
    from brdfpipe.bsdf.measured.proposals import propose
    from brdfpipe.rig.plan import Plan
    from brdfpipe.store import open_dataset

    for name in ("primary-reflection.nc", "measured.nc"):
        if not (results / name).is_file():
            accepted = "the folder of a built material with a run of a rig, `results/NAME`"
            raise InputError(results, f"no {name}", accepted=accepted)
    primary = open_dataset(results / "primary-reflection.nc", "primary")
    measured = open_dataset(results / "measured.nc", "bsdf")
    found = propose(primary, measured, Plan.load(plan_file).rig.entrances)
    for at, error in found.again:
        click.echo(f"again {at:g}°: contradicts the other incidences by {error:.1f} times its uncertainty")
    for at, error in found.incidences:
        click.echo(f"incidence {at:g}°: uncertain by {error:.1%} more than the measured ones")
    for at, error in found.wavelengths:
        click.echo(f"wavelength {at:g} nm: linear interpolation errs by about {error:.1%}")
    if not any(found):
        click.echo(
            "Nothing more to measure: interpolation errs by less than 1 %, and no incidence contradicts the others."
        )
    return 0


@rig.command(short_help="Find the directions of the fibres.")
@click.argument("run", type=FOLDER)
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), default=None, help="A new fibres.csv to write.")
@exit_on_error
def directions(run: Path, out: Path | None) -> int:
    """Find the directions of the fibres in a RUN of a plan with `runs: [target, mirror]`."""
    import numpy as np

    from brdfpipe import store
    from brdfpipe.rig.description import fibre_table
    from brdfpipe.rig.frames import read_run
    from brdfpipe.rig.plan import PLAN, Plan
    from brdfpipe.rig.reduction.mirror_frames import calibrate_directions

    if out is not None and out.exists():
        raise InputError(
            out, "the file exists already", accepted="another --out: a run keeps the table it was taken with"
        )
    frames, rig = read_run(run), Plan.load(run / PLAN).rig
    found = calibrate_directions(frames, rig)
    known = np.isfinite(found.moved)
    lost = [fibre.name for fibre, is_known in zip(rig.fibres, known, strict=True) if not is_known]
    u = found.directions.u[: known.size][known]
    click.echo(
        f"{known.sum()} of {known.size} fibres: {np.median(found.moved[known]):.2f}° from {rig.name}'s table (median), at most "
        f"{found.moved[known].max():.2f}°; u {np.median(u):.2f}° (median), at most {u.max():.2f}°"
    )
    click.echo(f"mount turned by {found.directions.turn:.2f}° against the disc; misfit {found.directions.misfit:.1%}")
    if lost:
        click.echo(f"not lit well enough, and as described: {abbreviated(lost, 12)}")
    if out is not None:
        store.write_text(
            out, fibre_table(found.fibres, f"Directions found on {frames.attrs['day']} with a turned mirror.")
        )
        click.echo(f"{out}: name it in rig.yaml (`fibres.file`) before the next measurement")
    return 0


@rig.command()
@click.argument("description", metavar="RIG.yaml", type=FILE)
@click.option(
    "--truth",
    "truth_path",
    type=_TRUTH,
    required=True,
    help="A BSDF (.nc), or the folder of a built material: the sample in the holder.",
)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of the emulated rig.")
@_SESSION
@click.option("--out", type=FOLDER, default=None, help=f"Folder for {EMULATED}  [default: beside RIG.yaml]")
@click.option("--realtime", is_flag=True, help="Let exposures and moves take real time.")
@click.option("--dialect", default="usual", show_default=True, help="How the controllers speak: see docs/rig.md.")
@exit_on_error
def emulate(
    description: Path, truth_path: Path, seed: int, session: int, out: Path | None, realtime: bool, dialect: str
) -> int:
    """Emulate a rig on its own serial ports, until Ctrl-C.

    Type what an operator does by hand: the entrance in degree, the load of the holder (sample, etalon, target, mirror
    or dark-trap; line-lamp for another lamp), the side (reflection or transmission), and of a mirror the direction to
    which it sends the light.
    """
    from brdfpipe.rig.description import Rig
    from brdfpipe.rig.emulator.clock import VirtualClock
    from brdfpipe.rig.emulator.emulated_rig import EmulatedRig

    # A service manager ends it with SIGTERM; ports and description are removed as after Ctrl-C.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    real, clock = Rig.load(description), VirtualClock(realtime=realtime)
    with (
        EmulatedRig(real, truth(truth_path), seed=seed, session=session, clock=clock, dialect=dialect) as emulated,
        _emulated_description(description, emulated, out or description.parent) as written,
        _camera_serving(written.parent / EMULATED_CAMERA, emulated),
    ):
        try:
            advice = f"Try `brdfpipe rig doctor {written}`, or scan a plan with `rig: {EMULATED}`."
            click.echo(f"Emulated rig ready: {written}. {advice}")
            click.echo(f"Type each arrangement, as `{real.entrances[0]:g} sample reflection`; Ctrl-C ends the rig.")
            _apply_typed_arrangements(emulated)
        except KeyboardInterrupt:
            click.echo("Emulated rig stopped.")
    return 0


def truth(path: Path) -> Representation:
    """The BSDF in a file, or of a material whose folder of results is given.

    Raises InputError: the material is not built; StoreError, VocabularyError: no BSDF.
    """
    from brdfpipe.bsdf.registry import representation
    from brdfpipe.store import open_dataset

    if path.is_dir():
        if not (path / "bsdf.nc").is_file():
            accepted = "a BSDF (.nc), or a folder of results with bsdf.nc, which `brdfpipe build` writes"
            raise InputError(path, "a folder without a built material", accepted=accepted)
        path = path / "bsdf.nc"
    return representation(open_dataset(path, "bsdf"))


def _real_scan(plan: Plan, folder: Path, yes: bool, options: dict[str, Any]) -> Summary:
    from brdfpipe.rig.acquisition.devices.connection import connect
    from brdfpipe.rig.acquisition.scan import scan as take

    def confirm(arrangement: Arrangement, instruction: str) -> bool:
        try:
            return yes or click.confirm(f"{instruction}. Done?", default=True, err=True)
        except click.Abort:
            raise KeyboardInterrupt from None

    operator = "--yes" if yes else _user()
    with connect(plan.rig) as devices:
        return take(plan, devices, folder, clock=time.time, confirm=confirm, operator=operator, **options)


@contextmanager
def _emulated_description(description: Path, emulated: EmulatedRig, folder: Path) -> Iterator[Path]:
    """The description of an emulated rig while it runs: the real one, with the emulated ports and camera folder."""
    import yaml

    from brdfpipe import documents, store

    content = documents.read_yaml(description)
    path = folder / EMULATED
    if path.exists() and not path.read_text(encoding="utf-8", errors="replace").startswith(_EMULATED_HEADER):
        problem = "exists already and does not belong to an emulated rig"
        raise InputError(path, problem, accepted="another folder for --out")
    name = content["fibres"]["file"]
    fibres = documents.file_beside(description, name, "fibres.file", "the rig's folder")
    if not (folder / name).exists():
        store.write_bytes(folder / name, fibres.read_bytes())
    camera = {key: value for key, value in content["camera"].items() if key not in ("address", "device")}
    content["camera"] = {**camera, "kind": "drop-folder", "folder": str(folder.resolve() / EMULATED_CAMERA)}
    for device in ("monochromator", "wheel"):
        content[device]["port"] = getattr(emulated.rig, device).port
    (folder / EMULATED_CAMERA).mkdir(parents=True, exist_ok=True)
    store.write_text(path, _EMULATED_HEADER + yaml.safe_dump(content, sort_keys=False, allow_unicode=True))
    try:
        yield path
    finally:
        path.unlink(missing_ok=True)


@contextmanager
def _camera_serving(folder: Path, emulated: EmulatedRig) -> Iterator[None]:
    """Serve frames for the requests in a folder, in a thread."""
    from brdfpipe.rig.acquisition.devices.drop_folder import serve_folder

    stop = threading.Event()
    serve = partial(serve_folder, folder, emulated.camera, stop=stop, report=click.echo)
    camera = threading.Thread(target=serve)
    camera.start()
    try:
        yield
    finally:
        stop.set()
        emulated.clock.release()  # an exposure under way ends now
        camera.join()


def _apply_typed_arrangements(emulated: EmulatedRig) -> None:
    """Apply the arrangements that the operator types, until Ctrl-C."""
    for words in filter(None, map(str.split, sys.stdin)):
        try:
            entrance, load, side = [*words, *_DEFAULT_ARRANGEMENT[len(words) :]][:3]
            aim = (_degrees(words[3]), _degrees(words[4])) if len(words) == 5 else None
            emulated.set_entrance(_degrees(entrance), load=load, side=side, aim=aim)
            click.echo(f"{_degrees(entrance):g} degree, {load}, {side}")
        except BrdfpipeError as refusal:
            click.echo(str(refusal))
    threading.Event().wait()  # no keyboard


def _degrees(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        accepted = "`20 sample reflection`, for example"
        raise InputError("keyboard", "not an angle of incidence", found=repr(word), accepted=accepted) from None


def _user() -> str:
    with suppress(KeyError, OSError, ImportError):  # an account without a name
        return getpass.getuser()
    return "operator"


def _print_line(line: str) -> None:
    from tqdm import tqdm

    tqdm.write(line, file=sys.stderr)
