"""The folder of a run read as one ``frames`` dataset, with warnings about frames that are missing or unusable."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.errors import InputError, abbreviated
from brdfpipe.rig.acquisition import journal as journals
from brdfpipe.rig.frame_file import Frame, FrameError, read_frame, utc
from brdfpipe.rig.plan import FRAMES, JOURNAL, LINE_LAMP, MIRROR, PLAN, Arrangement, Plan, Shot

EMULATED = "emulated"
"""Part of the name of an emulated camera. A camera behind a drop folder is named by its folder."""

NOT_MEASURED = "The frames come from the rig emulator, not from a laboratory: use the result to test the pipeline, not as data of a material"


def read_run(folder: str | Path, incidence: float | None = None) -> xr.Dataset:
    """Read the frames of a run.

    Parameters
    ----------
    folder : of the run, finished or not
    incidence : if given, read only the frames of this entrance, all dark and target frames, and the lamp monitor readings of every
        entrance. The bracket frames that those readings repeat count as lamp monitor readings of the other entrances

    Returns
    -------
    A dataset of kind ``frames`` in the order of the exposures. ``wavelength`` and ``exposure`` are the planned values, by which frames
    are grouped; ``wavelength_read`` is what the monochromator reported. Warnings name files that cannot be used and what is missing.

    Raises
    ------
    InputError : the folder holds no run, the plan has no such incidence, or no frame is usable.
    """
    folder = Path(folder)
    plan = Plan.load(folder / PLAN)
    shots = [shot for shot in plan.shots if _is_requested(shot, incidence) or _repeats_monitor_reading(shot, plan)]
    planned = sorted({arrangement.incidence for arrangement in plan.arrangements})
    if incidence is not None and incidence not in planned:
        accepted = ", ".join(f"{angle:g}" for angle in planned)
        raise InputError(folder / PLAN, "incidence not in the plan", found=f"{incidence:g}", accepted=accepted)
    results = dict(_unchanged(folder, read_shots(folder, plan, shots)))
    frames = {shot: result for shot, result in results.items() if isinstance(result, Frame)}
    problems = {shot: result for shot, result in results.items() if isinstance(result, FrameError)}
    not_needed = journals.left_out(journals.read(folder / JOURNAL))
    wanted = [shot for shot in shots if shot.ordinal not in not_needed]
    missing = [shot for shot in wanted if shot not in frames and _is_requested(shot, incidence)]
    messages = [f"{problem}; not used" for shot, problem in problems.items() if _is_requested(shot, incidence)]
    messages += _unexpected_files(folder, plan)
    messages += _missing_frames(plan.shots, missing)
    if all(shot.dark for shot in frames):
        if problems and all(problem.where == "RIGHASH" for problem in problems.values()):
            problem = "the description of the rig was changed after the frames of this run were taken"
            accepted = "the description that the scan copied to the run's folder, or a new scan with the corrected one"
            raise InputError(plan.rig.name, problem, accepted=accepted)
        raise InputError(folder, "no usable frame", found="; ".join(messages[:3]), accepted="a run started by a scan")
    others = {shot: replace(shot, purpose="drift") for shot in frames if not _is_requested(shot, incidence)}
    labelled = {others.get(shot, shot): frame for shot, frame in frames.items()}
    return vocabulary.add_warning(frames_dataset(labelled, plan), *messages)


def _unchanged(
    folder: Path, results: Iterator[tuple[Shot, Frame | FrameError]]
) -> Iterator[tuple[Shot, Frame | FrameError]]:
    """Results in which a frame that differs from the one the journal recorded, or belongs to a rejected arrangement, is an error."""
    events = journals.read(folder / JOURNAL)
    recorded, rejected = journals.recorded_digests(events), journals.rejected_digests(events)
    for shot, result in results:
        if isinstance(result, Frame):
            path = folder / FRAMES / shot.name
            if recorded.get(shot.ordinal, result.digest) != result.digest:
                result = FrameError(path, "changed since it was taken", accepted="the file that the journal recorded")
            elif result.digest in rejected:
                problem = "of an arrangement that the scan rejected"
                result = FrameError(path, problem, accepted="a frame taken again by `--resume`")
        yield shot, result


def read_shots(folder: Path, plan: Plan, shots: Iterable[Shot]) -> Iterator[tuple[Shot, Frame | FrameError]]:
    """The frame of each shot whose file exists, or the error that prevents its use."""
    for shot in shots:
        path = folder / FRAMES / shot.name
        if path.is_symlink() or path.exists():
            try:
                yield shot, read_frame(path, shot, plan)
            except FrameError as error:
                yield shot, error


def frames_dataset(frames: Mapping[Shot, Frame], plan: Plan) -> xr.Dataset:
    """Frames as a dataset of kind ``frames``."""
    shots = sorted(frames, key=lambda shot: shot.ordinal)
    camera = plan.rig.camera
    counts = np.empty((len(shots), camera.height, camera.width), dtype=np.uint16)
    np.stack([frames[shot].counts for shot in shots], out=counts)
    coordinates = {
        "shot": [shot.ordinal for shot in shots],
        "purpose": [shot.purpose for shot in shots],
        **{key: [getattr(shot.arrangement, key) for shot in shots] for key in ("load", "side", "incidence")},
        "wavelength": [shot.wavelength for shot in shots],
        "wavelength_read": [frames[shot].state.wavelength for shot in shots],
        "exposure": [shot.exposure for shot in shots],
        "nd_position": [shot.position for shot in shots],
        "nd_transmittance": [plan.rig.filter_at(shot.position).transmittance for shot in shots],
        "elapsed": [frames[shot].elapsed for shot in shots],
        "temperature": [frames[shot].temperature for shot in shots],
    }
    if any(shot.arrangement.aim for shot in shots):
        aims = [shot.arrangement.aim or (np.nan, np.nan) for shot in shots]
        coordinates |= {"aim_theta": [theta for theta, _ in aims], "aim_phi": [phi for _, phi in aims]}
    dataset = xr.Dataset(
        {"counts": (("frame", "y", "x"), counts)},
        coords={name: ("frame", np.asarray(values)) for name, values in coordinates.items()},
        attrs={
            "day": utc(min(frame.started for frame in frames.values()))[:10],
            "sample": plan.sample,
            "rig": plan.rig.name,
            "rig_digest": plan.rig.digest,
            "drift_tolerance": plan.drift.tolerance,
            **({"line_tolerance": plan.lines.tolerance, "lines": list(plan.lines.lines)} if plan.lines else {}),
            "camera": ", ".join(sorted({frame.camera for frame in frames.values()})),
        },
    )
    if any(EMULATED in frame.camera for frame in frames.values()):
        dataset = vocabulary.add_warning(dataset, NOT_MEASURED)
    return vocabulary.validate(vocabulary.label(dataset, "frames"), "frames")


def _is_requested(shot: Shot, incidence: float | None) -> bool:
    if shot.purpose == MIRROR:
        return incidence is None
    return shot.purpose in ("dark", "target", LINE_LAMP, "drift") or incidence in (None, shot.arrangement.incidence)


def _repeats_monitor_reading(shot: Shot, plan: Plan) -> bool:
    """Whether a bracket frame is taken under the same conditions as the lamp monitor readings of its arrangement."""
    return (shot.step, shot.wavelength) == (plan.drift.step, plan.drift.wavelength) and any(
        other.purpose == "drift" and other.arrangement == shot.arrangement for other in plan.shots
    )


# --- missing and unexpected files


def _unexpected_files(folder: Path, plan: Plan) -> Iterator[str]:
    """Files among the frames that do not belong to the plan."""
    planned = {shot.name for shot in plan.shots}
    for path in sorted((folder / FRAMES).glob("*.fits")):
        if path.name in planned:
            continue
        problem = "not a frame of the plan"
        if (prefix := path.name[:5]).isascii() and prefix.isdigit() and 1 <= int(prefix) <= len(plan.shots):
            problem = f"second file of frame {int(prefix)}, whose file is {plan.shots[int(prefix) - 1].name}"
        yield f"{FrameError(path, problem, accepted='file names of the plan')}; not used"


def _missing_frames(planned: Sequence[Shot], missing: Sequence[Shot]) -> Iterator[str]:
    """What the missing frames leave uncovered, and how to take them again."""
    remedy = "take them again with `brdfpipe rig scan … --resume`"
    totals = Counter(map(_frame_group, planned))
    for group, count in Counter(map(_frame_group, missing)).items():
        arrangement, purpose, detail = group
        total = totals[group]
        if purpose == "dark":
            yield f"{count} of {total} dark frames of {detail:g} s are missing; {remedy}"
        elif purpose == "drift":
            yield f"{count} of {total} lamp monitor readings {_at(arrangement)} are missing; {remedy}"
        else:
            wavelengths = [f"{shot.wavelength:g}" for shot in missing if _frame_group(shot) == group]
            details = f"{purpose}: {abbreviated(wavelengths, 8)} nm"
            yield f"bracket step {detail} is missing at {count} of {total} wavelengths {_at(arrangement)} ({details}); {remedy}"


def _frame_group(shot: Shot) -> tuple[Arrangement | None, str, float | int]:
    """Frames of one group replace each other or differ only in wavelength."""
    if shot.dark:
        return None, "dark", shot.exposure
    return shot.arrangement, shot.purpose, shot.step


def _at(arrangement: Arrangement | None) -> str:
    if arrangement is None:
        return ""
    side = " in transmission" if arrangement.side == "transmission" else ""
    return f"at {arrangement.incidence:g} degree{side}"
