"""Frames on disk: one exposure per FITS file, complete or absent.

The header states what the devices reported while the frame was exposed. Files are untrusted input: a frame is accepted only if it is
complete, its checksum is right, and every keyword identifies the exposure that its name promises.
"""

from __future__ import annotations

import hashlib
import io
import math
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from brdfpipe import store
from brdfpipe.errors import InputError
from brdfpipe.rig.description import Rig
from brdfpipe.rig.plan import Plan, Shot
from brdfpipe.rig.raw_frame import (
    Counts,
    RawFrame,
    expected_format,
    exposure_tolerance,
    has_expected_format,
    image_format,
    is_number,
    read_fits,
)

WAVELENGTH_TOLERANCE = 0.5
"""Largest difference [nm] between the planned wavelength and the one read back."""

FITS_BLOCK = 2880
"""A FITS file is a whole number of blocks of so many bytes."""

_LIGHT, _DARK = "Light Frame", "Dark Frame"
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_LONGEST_TEXT = 60
# astropy's default comment is the time of writing, which would change the bytes of equal frames. Stored frames have this one.
_CHECKSUM_COMMENT = "sum of what stands here"

Cards = dict[str, tuple[Any, str]]
"""Header keyword → value and comment."""


class FrameError(InputError):
    """A file is not the frame its name promises."""


@dataclass(frozen=True)
class DeviceState:
    """Wavelength and filter that the devices reported."""

    wavelength: float
    """Nanometres."""
    position: int
    """Position of the filter wheel."""

    def __str__(self) -> str:
        return f"{self.wavelength:g} nm and filter {self.position}"


@dataclass(frozen=True)
class Frame:
    """A labelled exposure."""

    counts: Counts
    state: DeviceState
    started: float
    """Seconds of the camera's clock."""
    elapsed: float
    """Seconds since the start of the run."""
    temperature: float
    """Degree Celsius of the sensor, NaN if unknown."""
    camera: str
    """Name the camera gives itself."""
    digest: str
    """SHA-256 of the file."""

    @property
    def run_start(self) -> float:
        """Start of the run, in seconds of the camera's clock."""
        return _round_time(self.started - self.elapsed)


def write_frame(
    path: Path, raw: RawFrame, shot: Shot, plan: Plan, *, state: DeviceState, run_start: float | None, camera: str
) -> Frame:
    """Write an exposure atomically and return it as :func:`read_frame` will. Raises StoreError: disk full, or folder not writable.

    Parameters
    ----------
    raw, shot : the exposure, of the size the rig's description states, and as planned
    state : what the devices reported during the exposure
    run_start : start of the run in seconds of the camera's clock; None if this exposure starts it
    camera : name the camera gives itself; the emulator's contains "emulated"
    """
    started = _round_time(raw.started)
    elapsed = 0.0 if run_start is None else _round_time(started - run_start)
    camera = _header_text(camera)
    content = _fits(raw, shot, plan, {**_measured_cards(raw, state, started, elapsed), "INSTRUME": (camera, "")})
    store.write_bytes(path, content)
    digest = hashlib.sha256(content).hexdigest()
    return Frame(raw.counts, state, started, elapsed, _round_temperature(raw.temperature), camera, digest)


def read_frame(path: Path, shot: Shot, plan: Plan) -> Frame:
    """Read and verify the frame of a planned exposure.

    Raises FrameError: the file is missing, damaged, or labelled as another exposure, rig or sample.
    """
    content = _read_bytes(path, plan.rig)
    header, counts = _parse_fits(path, content)
    _check_labels(path, header, shot, plan)
    camera = plan.rig.camera
    if not has_expected_format(counts, camera):
        raise FrameError(path, "wrong image size or type", found=image_format(counts), accepted=expected_format(camera))
    if counts.max() > camera.full:
        problem, accepted = "counts exceed the camera's range", f"at most {camera.full}"
        raise FrameError(path, problem, found=counts.max(), accepted=accepted)
    temperature = header["CCD-TEMP"]
    return Frame(
        counts=counts,
        state=DeviceState(float(header["WAVELEN"]), int(header["NDPOS"])),
        started=float(header["STARTED"]),
        elapsed=float(header["ELAPSED"]),
        temperature=float(temperature) if isinstance(temperature, int | float) else math.nan,
        camera=str(header.get("INSTRUME", "")),
        digest=hashlib.sha256(content).hexdigest(),
    )


def frame_size(plan: Plan) -> int:
    """Bytes of one frame."""
    blank = RawFrame(np.zeros((plan.rig.camera.height, plan.rig.camera.width), dtype=np.uint16), 0.0, 1.0)
    shot = plan.shots[0]
    return len(_fits(blank, shot, plan, _measured_cards(blank, DeviceState(shot.wavelength, shot.position), 0.0, 0.0)))


def utc(unix_time: float) -> str:
    """Date and time in UTC, as FITS headers have it."""
    return (_EPOCH + timedelta(seconds=unix_time)).strftime("%Y-%m-%dT%H:%M:%S.%f")


def _fits(raw: RawFrame, shot: Shot, plan: Plan, measured: Cards) -> bytes:
    from astropy.io import fits  # type: ignore[import-untyped]

    image = fits.PrimaryHDU(raw.counts)
    image.header.update({**_planned_cards(shot, plan), **measured})
    image.add_datasum(when=_CHECKSUM_COMMENT)
    image.add_checksum(when=_CHECKSUM_COMMENT, override_datasum=True)
    content = io.BytesIO()
    image.writeto(content)
    return content.getvalue()


# Keywords and comments are stored in every frame: changing one changes the bytes of new frames.
def _measured_cards(raw: RawFrame, state: DeviceState, started: float, elapsed: float) -> Cards:
    """Keywords whose values the devices report."""
    known = math.isfinite(raw.temperature)
    return {
        "WAVELEN": (state.wavelength, "wavelength read back [nm]"),
        "NDPOS": (state.position, "position of the filter wheel read back"),
        "EXPTIME": (float(raw.seconds), "exposure [s]"),
        "DATE-OBS": (utc(started), "start of the exposure, UTC"),
        "STARTED": (started, "start of the exposure, camera's clock [s]"),
        "ELAPSED": (elapsed, "since the start of the run [s]"),
        "CCD-TEMP": (_round_temperature(raw.temperature) if known else None, "sensor [degree Celsius]"),
    }


def _planned_cards(shot: Shot, plan: Plan) -> Cards:
    """Keywords whose values follow from the plan and the rig."""
    rig = plan.rig
    return {
        "IMAGETYP": (_DARK if shot.dark else _LIGHT, "whether the shutter was open"),
        "GAIN": (rig.camera.gain, "electrons per count"),
        "WLBAND": (rig.slit, "spectral width [nm]"),
        "INCANG": (shot.arrangement.incidence, "entrance confirmed by the operator [degree]"),
        "NDTRANS": (rig.filter_at(shot.position).transmittance, "transmittance of the filter"),
        "SAMPLEID": (plan.sample_id(shot.arrangement), "object in the holder"),
        "SHOT": (shot.ordinal, "number in the plan"),
        "PURPOSE": (shot.purpose, "sample, etalon, target, dark or drift"),
        "SIDE": (shot.arrangement.side, "reflection or transmission"),
        "STEP": (shot.step, "number in the bracket, 0 for none"),
        **_aim_cards(shot),
        "RIGNAME": (rig.name, "rig"),
        "RIGHASH": (rig.digest, ""),
    }


def _aim_cards(shot: Shot) -> Cards:
    """Keywords of a turned mirror; other frames have none."""
    if shot.arrangement.aim is None:
        return {}
    theta, phi = shot.arrangement.aim
    return {
        "AIMTHETA": (theta, "angle to which the mirror sends light [degree]"),
        "AIMPHI": (phi, "its azimuth [degree]"),
    }


def _read_bytes(path: Path, rig: Rig) -> bytes:
    """Bytes of a regular file that is no larger than a frame can be and has a valid FITS checksum."""
    if path.is_symlink() or not path.is_file():
        raise FrameError(path, "not a regular file" if path.exists() else "missing", accepted="a FITS file")
    limit = 2 * rig.camera.width * rig.camera.height + 20 * FITS_BLOCK
    try:
        size = path.stat().st_size
        if size > limit:
            raise FrameError(path, "too large for a frame", found=f"{size} bytes", accepted=f"at most {limit}")
        content = path.read_bytes()
    except OSError as error:
        raise FrameError(path, f"cannot be read ({error.strerror})") from error
    if not content.startswith(b"SIMPLE  ="):  # astropy would also unpack compressed files
        raise FrameError(path, "not a FITS file" if content else "empty", accepted="a frame written by the scan")
    if len(content) % FITS_BLOCK or not _checksum_valid(content):
        raise FrameError(path, "damaged or truncated", found=f"{len(content)} bytes with an invalid checksum")
    return content


def _checksum_valid(content: bytes) -> bool:
    """Whether the 32-bit words of a FITS file sum to −0 in ones' complement, as its CHECKSUM requires; covers every byte.

    astropy verifies the cards it has parsed, and repairs damaged bytes between them first.
    """
    total = int(np.frombuffer(content, dtype=">u4").sum(dtype=np.uint64))
    while total >> 32:
        total = (total & 0xFFFFFFFF) + (total >> 32)
    return total == 0xFFFFFFFF


def _parse_fits(path: Path, content: bytes) -> tuple[Mapping[str, Any], NDArray[Any]]:
    try:
        header, counts, excess = read_fits(content, "error")  # astropy only warns about truncated files
    except Exception as error:  # see read_fits
        reason = " ".join(str(error).split())[:100] or type(error).__name__
        raise FrameError(path, "not readable as FITS", found=reason) from error
    if header.get("NAXIS") != 2 or counts is None or excess:
        raise FrameError(path, "more or other content than one image", accepted="a frame written by the scan")
    return header, counts


def _check_labels(path: Path, header: Mapping[str, Any], shot: Shot, plan: Plan) -> None:
    labels: dict[str, tuple[Any, float]] = {
        # RIGHASH comes first: the frames of another rig may differ in every keyword.
        **{keyword: (expected, 0.0) for keyword, (expected, _) in reversed(_planned_cards(shot, plan).items())},
        "NDPOS": (shot.position, 0.0),
        "WAVELEN": (shot.wavelength, WAVELENGTH_TOLERANCE),
        "EXPTIME": (shot.exposure, exposure_tolerance(shot.exposure)),
    }
    for keyword, (expected, tolerance) in labels.items():
        if keyword not in header:
            raise FrameError(path, "keyword missing", where=keyword, accepted=f"{expected} (plan)")
        value = header[keyword]
        if isinstance(expected, str) or not is_number(value):
            agrees = value == expected and isinstance(value, str)
        else:
            agrees = abs(value - expected) <= tolerance + 1e-9 * abs(expected)
        if not agrees:
            raise FrameError(path, "label differs from the plan", where=keyword, found=value, accepted=str(expected))
    for keyword in ("STARTED", "ELAPSED"):
        value = header.get(keyword)
        if not is_number(value):
            raise FrameError(path, "keyword missing or not a number", where=keyword, found=repr(value))
    if "CCD-TEMP" not in header:
        raise FrameError(path, "keyword missing", where="CCD-TEMP", accepted="a temperature, or no value")


def _round_time(seconds: float) -> float:
    # A FITS card does not hold more digits, so unrounded times would not be read back as written.
    return round(float(seconds), 6)


def _round_temperature(temperature: float) -> float:
    # Sensors resolve less, and temperatures derived from a clock may differ in the last digit.
    return round(float(temperature), 3)


def _header_text(text: str) -> str:
    """Text as a FITS card can hold it: printable ASCII, without quotes."""
    plain = text.replace("×", "x").replace("'", " ").encode("ascii", "replace").decode()
    return "".join(character if character.isprintable() else "?" for character in plain)[:_LONGEST_TEXT]
