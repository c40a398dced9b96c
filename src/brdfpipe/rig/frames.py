"""Frames on disk: one exposure a FITS file, whole or not at all; and a run's folder read back as a ``frames`` dataset.

What a file holds depends on the exposure alone, not on the clock, the host or the path of the program that wrote it. The header
says what the devices *said they were at* while the frame was exposed; sums over header and data tell a damaged file. Files are not
trusted: a frame counts only if it is whole and says, in every keyword, that it is the exposure its name promises.
"""

from __future__ import annotations

import hashlib
import io
import math
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import store, vocabulary
from brdfpipe.errors import InputError
from brdfpipe.rig.acquisition.devices.camera import TIMING, Picture
from brdfpipe.rig.description import Rig
from brdfpipe.rig.plan import FRAMES, PLAN, Arrangement, Plan, Shot

WAVELENGTH_TOLERANCE = 0.5
"""Largest difference [nm] between the wavelength of a plan and the one read back."""

BLOCK = 2880
"""Bytes of which a FITS file has a whole number."""

EMULATED = "emulated"
"""What the name of a camera has in it that is none; one behind a drop folder is named by its folder."""

NOT_MEASURED = "the frames were made by the emulator, no laboratory measured them: use the result to try the pipeline, never as data of a material"

_LIGHT, _DARK = "Light Frame", "Dark Frame"
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_CARD = 60
_CHECKED = "sum of what stands here"
_LISTED = 8

Cards = dict[str, tuple[Any, str]]
"""Keyword of a header → value and comment."""


class FrameError(InputError):
    """A file is not the frame its name promises."""


@dataclass(frozen=True)
class State:
    """Where the devices said they were while a frame was exposed."""

    wavelength: float
    """Nanometres."""
    position: int


@dataclass(frozen=True)
class Frame:
    """An exposure read back."""

    counts: NDArray[np.uint16]
    state: State
    started: float
    """Seconds, of the camera's clock."""
    elapsed: float
    """Seconds since the start of the run."""
    temperature: float
    """Degree Celsius of the sensor, NaN if unknown."""
    camera: str
    """As it names itself."""
    digest: str
    """Of the file."""

    @property
    def origin(self) -> float:
        """When the run began, of the camera's clock."""
        return _microseconds(self.started - self.elapsed)


def write_frame(
    path: Path, picture: Picture, shot: Shot, plan: Plan, *, state: State, origin: float | None, camera: str
) -> Frame:
    """Write an exposure; return it as it will be read.

    Parameters
    ----------
    path : the file, which appears whole or not at all
    picture : what the camera gave, of the size the rig's description says
    shot : what was asked for
    state : where the devices were, as they said themselves
    origin : when the run began, of the camera's clock; None if this exposure begins it
    camera : as it names itself; the emulator's says so

    Raises
    ------
    StoreError : the disk is full or the folder cannot be written.
    """
    started = _microseconds(picture.started)
    elapsed = 0.0 if origin is None else _microseconds(started - origin)
    camera = _card(camera)
    content = _fits(picture, shot, plan, {**_measured(picture, state, started, elapsed), "INSTRUME": (camera, "")})
    store.write_bytes(path, content)
    digest = hashlib.sha256(content).hexdigest()
    return Frame(picture.counts, state, started, elapsed, _millikelvin(picture.temperature), camera, digest)


def read_frame(path: Path, shot: Shot, plan: Plan) -> Frame:
    """Read the frame of a shot.

    Raises
    ------
    FrameError : the file is missing, damaged, or says that it is another exposure, another rig's or another sample's.
    """
    content = _content(path, plan.rig)
    header, counts = _opened(path, content)
    _check_labels(path, header, shot, plan)
    rig, shape = plan.rig, (plan.rig.camera.height, plan.rig.camera.width)
    if counts.dtype != np.uint16 or counts.shape != shape:
        found = f"{' × '.join(map(str, reversed(counts.shape)))} of {counts.dtype}"
        raise FrameError(path, "another size or type of picture", found=found, accepted=f"{shape[1]} × {shape[0]}")
    if counts.max() > rig.camera.full:
        accepted = f"at most {rig.camera.full}"
        raise FrameError(path, "counts beyond the camera's", found=counts.max(), accepted=accepted)
    temperature = header["CCD-TEMP"]
    return Frame(
        counts=counts,
        state=State(float(header["WAVELEN"]), int(header["NDPOS"])),
        started=float(header["STARTED"]),
        elapsed=float(header["ELAPSED"]),
        temperature=float(temperature) if isinstance(temperature, int | float) else math.nan,
        camera=str(header.get("INSTRUME", "")),
        digest=hashlib.sha256(content).hexdigest(),
    )


def size(plan: Plan) -> int:
    """Bytes of one frame."""
    blank = Picture(np.zeros((plan.rig.camera.height, plan.rig.camera.width), dtype=np.uint16), 0.0, 1.0)
    shot = plan.shots[0]
    return len(_fits(blank, shot, plan, _measured(blank, State(shot.wavelength, shot.position), 0.0, 0.0)))


def read_run(folder: str | Path, incidence: float | None = None) -> xr.Dataset:
    """Read what a run's folder holds.

    Parameters
    ----------
    folder : as the scan left it, finished or not
    incidence : if given, only the frames taken through this entrance, all dark ones and those of the target, and the looks at the lamp
        through others, among which the frames count that they repeat

    Returns
    -------
    A dataset of kind ``frames``, in the order of the exposures. ``wavelength`` and ``exposure`` are the plan's, by which frames
    belong together; ``wavelength_read`` is what the monochromator said. Files that cannot be used, and what is thereby missing, are
    in its warnings.

    Raises
    ------
    InputError : the folder holds no run, nothing was planned at this incidence, or no frame of it can be used.
    """
    folder = Path(folder)
    plan = Plan.load(folder / PLAN)
    shots = [shot for shot in plan.shots if _belongs(shot, incidence) or _repeats(shot, plan)]
    planned = sorted({arrangement.incidence for arrangement in plan.arrangements})
    if incidence is not None and incidence not in planned:
        accepted = ", ".join(f"{angle:g}" for angle in planned)
        raise InputError(folder / PLAN, "no such incidence in the plan", found=f"{incidence:g}", accepted=accepted)
    problems: dict[Shot, FrameError] = {}
    frames: dict[Shot, Frame] = {}
    for shot, found in read_shots(folder, plan, shots):
        if isinstance(found, Frame):
            frames[shot] = found
        else:
            problems[shot] = found
    lost = [shot for shot in shots if shot not in frames and _belongs(shot, incidence)]
    told = [f"{problem}; not used" for shot, problem in problems.items() if _belongs(shot, incidence)]
    told += _strangers(folder, plan)
    told += _gaps(plan.shots, lost)
    if not any(not shot.dark for shot in frames):
        if problems and all(problem.where == "RIGHASH" for problem in problems.values()):
            raise InputError(
                plan.rig.name,
                "the rig is described otherwise than when the frames of this run were taken",
                accepted="the description as the scan left it in the run's folder; with a corrected one the run is scanned anew",
            )
        raise InputError(folder, "no usable frame", found="; ".join(told[:3]), accepted="a run begun by a scan")
    elsewhere = {shot for shot in frames if not _belongs(shot, incidence)}
    used = {replace(shot, purpose="drift") if shot in elsewhere else shot: each for shot, each in frames.items()}
    return vocabulary.add_warning(dataset(used, plan), *told)


def read_shots(folder: Path, plan: Plan, shots: Iterable[Shot]) -> Iterator[tuple[Shot, Frame | FrameError]]:
    """The frames of some shots as far as there are files, or what is wrong with those."""
    for shot in shots:
        path = folder / FRAMES / shot.name
        if path.is_symlink() or path.exists():
            try:
                found: Frame | FrameError = read_frame(path, shot, plan)
            except FrameError as error:
                found = error
            yield shot, found


def dataset(frames: Mapping[Shot, Frame], plan: Plan) -> xr.Dataset:
    """Frames as a dataset of kind ``frames``."""
    shots = sorted(frames, key=lambda shot: shot.ordinal)
    camera = plan.rig.camera
    counts = np.empty((len(shots), camera.height, camera.width), dtype=np.uint16)
    for place, shot in enumerate(shots):
        counts[place] = frames[shot].counts
    of_frame = {
        "shot": [shot.ordinal for shot in shots],
        "purpose": [shot.purpose for shot in shots],
        "load": [shot.arrangement.load for shot in shots],
        "side": [shot.arrangement.side for shot in shots],
        "incidence": [shot.arrangement.incidence for shot in shots],
        "wavelength": [shot.wavelength for shot in shots],
        "wavelength_read": [frames[shot].state.wavelength for shot in shots],
        "exposure": [shot.exposure for shot in shots],
        "nd_position": [shot.position for shot in shots],
        "nd_transmittance": [plan.rig.transmittance(shot.position).transmittance for shot in shots],
        "elapsed": [frames[shot].elapsed for shot in shots],
        "temperature": [frames[shot].temperature for shot in shots],
    }
    found = xr.Dataset(
        {"counts": (("frame", "y", "x"), counts)},
        coords={name: ("frame", np.asarray(values)) for name, values in of_frame.items()},
        attrs={
            "day": _date(min(frame.started for frame in frames.values()))[:10],
            "sample": plan.sample,
            "rig": plan.rig.name,
            "rig_digest": plan.rig.digest,
            "drift_tolerance": plan.drift.tolerance,
            "camera": ", ".join(sorted({frame.camera for frame in frames.values()})),
        },
    )
    emulated = any(EMULATED in frame.camera for frame in frames.values())
    told = vocabulary.add_warning(found, *([NOT_MEASURED] if emulated else []))
    return vocabulary.validate(vocabulary.label(told, "frames"), "frames")


def _belongs(shot: Shot, incidence: float | None) -> bool:
    return shot.purpose in ("dark", "target", "drift") or incidence in (None, shot.arrangement.incidence)


def _repeats(shot: Shot, plan: Plan) -> bool:
    """Whether a frame of a bracket is the one that looks at the lamp repeat, in an arrangement in which there are any."""
    return (shot.step, shot.wavelength) == (plan.drift.step, plan.drift.wavelength) and any(
        each.purpose == "drift" and each.arrangement == shot.arrangement for each in plan.shots
    )


# --- one file


def _fits(picture: Picture, shot: Shot, plan: Plan, measured: Cards) -> bytes:
    from astropy.io import fits  # type: ignore[import-untyped]

    image = fits.PrimaryHDU(picture.counts)
    for keyword, (value, comment) in {**_planned(shot, plan), **measured}.items():
        image.header[keyword] = (value, comment)
    # Their comments are the time of writing unless something else is said.
    image.add_datasum(when=_CHECKED)
    image.add_checksum(when=_CHECKED, override_datasum=True)
    content = io.BytesIO()
    image.writeto(content)
    return content.getvalue()


def _measured(picture: Picture, state: State, started: float, elapsed: float) -> Cards:
    """Keywords whose values the devices decide."""
    known = math.isfinite(picture.temperature)
    return {
        "WAVELEN": (state.wavelength, "wavelength read back [nm]"),
        "NDPOS": (state.position, "position of the filter wheel read back"),
        "EXPTIME": (float(picture.seconds), "exposure [s]"),
        "DATE-OBS": (_date(started), "start of the exposure, UTC"),
        "STARTED": (started, "start of the exposure, camera's clock [s]"),
        "ELAPSED": (elapsed, "since the start of the run [s]"),
        "CCD-TEMP": (_millikelvin(picture.temperature) if known else None, "sensor [degree Celsius]"),
    }


def _planned(shot: Shot, plan: Plan) -> Cards:
    """Keywords whose values the plan and the rig decide alone."""
    rig = plan.rig
    return {
        "IMAGETYP": (_DARK if shot.dark else _LIGHT, "whether the shutter was open"),
        "GAIN": (rig.camera.gain, "electrons per count"),
        "WLBAND": (rig.slit, "spectral width [nm]"),
        "INCANG": (shot.arrangement.incidence, "entrance confirmed by the operator [degree]"),
        "NDTRANS": (rig.transmittance(shot.position).transmittance, "transmittance of the filter"),
        "SAMPLEID": (plan.sample_id(shot.arrangement), "what lies in the holder"),
        "SHOT": (shot.ordinal, "number in the plan"),
        "PURPOSE": (shot.purpose, "sample, etalon, target, dark or drift"),
        "SIDE": (shot.arrangement.side, "reflection or transmission"),
        "STEP": (shot.step, "number in the bracket, 0 for none"),
        "RIGNAME": (rig.name, "rig"),
        "RIGHASH": (rig.digest, ""),
    }


def _content(path: Path, rig: Rig) -> bytes:
    """The bytes of a plain file that is no larger than a frame can be."""
    if path.is_symlink() or not path.is_file():
        raise FrameError(path, "missing" if not path.exists() else "not a plain file", accepted="a FITS file")
    limit = 2 * rig.camera.width * rig.camera.height + 20 * BLOCK
    try:
        if (found := path.stat().st_size) > limit:
            raise FrameError(path, "too large for a frame", found=f"{found} bytes", accepted=f"at most {limit}")
        content = path.read_bytes()
    except OSError as error:
        raise FrameError(path, f"cannot be read ({error.strerror})") from error
    if not content.startswith(b"SIMPLE  ="):  # what astropy would unpack, compressed files, is no frame
        raise FrameError(path, "no FITS file" if content else "empty", accepted="a frame as the scan writes it")
    if len(content) % BLOCK or not _sums_up(content):
        raise FrameError(path, "damaged or cut off", found=f"{len(content)} bytes whose checksum does not fit")
    return content


def _sums_up(content: bytes) -> bool:
    """Whether the words of a FITS file sum to −0 in ones' complement, as its checksum makes them; every byte counts.

    astropy sums the cards it has read, in which a damaged byte between them is mended already.
    """
    total = int(np.frombuffer(content, dtype=">u4").sum(dtype=np.uint64))
    while total >> 32:
        total = (total & 0xFFFFFFFF) + (total >> 32)
    return total == 0xFFFFFFFF


def _opened(path: Path, content: bytes) -> tuple[Mapping[str, Any], NDArray[Any]]:
    from astropy.io import fits

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # of files that are cut off, astropy but warns
            with fits.open(io.BytesIO(content), memmap=False) as images:
                image = images[0]
                header = dict(image.header)
                place = image.fileinfo()
                if header.get("NAXIS") != 2 or place["datLoc"] + place["datSpan"] != len(content):
                    raise FrameError(path, "not one picture and nothing else", accepted="a frame as the scan writes it")
                return header, np.asarray(image.data)
    except FrameError:
        raise
    except Exception as error:  # astropy raises OSError, ValueError, TypeError, KeyError, VerifyError, warnings …
        found = " ".join(str(error).split())[:100] or type(error).__name__
        raise FrameError(path, "not readable as FITS", found=found) from error


def _check_labels(path: Path, header: Mapping[str, Any], shot: Shot, plan: Plan) -> None:
    # The rig first: with another one nothing else need agree.
    for keyword, (expected, _) in reversed(_planned(shot, plan).items()):
        _check(path, header, keyword, expected, 0.0)
    _check(path, header, "NDPOS", shot.position, 0.0)
    _check(path, header, "WAVELEN", shot.wavelength, WAVELENGTH_TOLERANCE)
    _check(path, header, "EXPTIME", shot.exposure, TIMING * shot.exposure + 1e-3)
    for keyword in ("STARTED", "ELAPSED"):
        value = header.get(keyword)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise FrameError(path, "a keyword is missing or no number", where=keyword, found=repr(value))
    if "CCD-TEMP" not in header:
        raise FrameError(path, "a keyword is missing", where="CCD-TEMP", accepted="a temperature, or no value")


def _check(path: Path, header: Mapping[str, Any], keyword: str, expected: Any, tolerance: float) -> None:
    if keyword not in header:
        raise FrameError(path, "a keyword is missing", where=keyword, accepted=f"{expected} (of the plan)")
    found = header[keyword]
    if isinstance(expected, str) or isinstance(found, bool) or not isinstance(found, int | float):
        agrees = found == expected and isinstance(found, str)
    else:
        agrees = abs(found - expected) <= tolerance + 1e-9 * abs(expected)
    if not agrees:
        raise FrameError(path, "labelled otherwise than planned", where=keyword, found=found, accepted=str(expected))


def _microseconds(seconds: float) -> float:
    # More digits than a FITS card holds would not come back as they were.
    return round(float(seconds), 6)


def _millikelvin(temperature: float) -> float:
    # No sensor knows more, and what is computed from a clock need not agree in its last digit.
    return round(float(temperature), 3)


def _card(text: str) -> str:
    """Text as a card of a header can hold it."""
    plain = text.replace("×", "x").replace("'", " ").encode("ascii", "replace").decode()
    return "".join(character if character.isprintable() else "?" for character in plain)[:_CARD]


def _date(started: float) -> str:
    return (_EPOCH + timedelta(seconds=started)).strftime("%Y-%m-%dT%H:%M:%S.%f")


# --- what is missing from a run


def _strangers(folder: Path, plan: Plan) -> Iterator[str]:
    """Files among the frames that are none of the plan's."""
    known = {shot.name for shot in plan.shots}
    for path in sorted((folder / FRAMES).glob("*.fits")):
        if path.name not in known:
            number = path.name[:5]
            claimed = int(number) if number.isascii() and number.isdigit() else 0
            also = f", which {plan.shots[claimed - 1].name} is" if 1 <= claimed <= len(plan.shots) else ""
            what = f"a second frame of shot {claimed}{also}" if also else "no frame of the plan"
            yield str(FrameError(path, what, accepted="the names of the plan")) + "; not used"


def _gaps(shots: Sequence[Shot], lost: list[Shot]) -> Iterator[str]:
    """What the frames that are not there, or cannot be used, leave uncovered, and what to do."""
    remedy = "`brdfpipe rig scan … --resume` takes them again"
    planned, missing = Counter(map(_part, shots)), Counter(map(_part, lost))
    for part, count in missing.items():
        arrangement, purpose, detail = part
        total = planned[part]
        if purpose == "dark":
            yield f"{count} of {total} dark frames of {detail:g} s are missing, {total - count} are left; {remedy}"
        elif purpose == "drift":
            yield f"{count} of {total} looks at the lamp {_at(arrangement)} are missing; {remedy}"
        else:
            where = [shot.wavelength for shot in lost if _part(shot) == part]
            listed = ", ".join(f"{each:g}" for each in where[:_LISTED]) + (", …" if count > _LISTED else "")
            have = "has" if total == 1 else "have"
            what = f"{count} of {total} wavelengths {_at(arrangement)} {have} no bracket step {detail}"
            yield f"{what} ({purpose}: {listed} nm); {remedy}"


def _part(shot: Shot) -> tuple[Arrangement | None, str, float | int]:
    """What a frame is one of several for."""
    if shot.dark:
        return None, "dark", shot.exposure
    return shot.arrangement, shot.purpose, shot.step


def _at(arrangement: Arrangement | None) -> str:
    if arrangement is None:
        return ""
    side = " in transmission" if arrangement.side == "transmission" else ""
    return f"at {arrangement.incidence:g} degree{side}"
