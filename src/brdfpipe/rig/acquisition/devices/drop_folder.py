"""A camera behind a drop folder: requests as JSON files, frames as FITS files.

The camera of a laboratory is controlled by its manufacturer's software. The drop folder only requires a script that reads a small JSON file and
writes a FITS file. :func:`serve_folder` is that script for any :class:`~brdfpipe.rig.acquisition.devices.camera.Camera` in Python.
"""

from __future__ import annotations

import io
import json
import math
import re
import threading
import time
import uuid
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from brdfpipe import store
from brdfpipe.errors import BrdfpipeError, printable
from brdfpipe.rig.acquisition.devices.camera import (
    CHECK_SIZE,
    LONGEST_EXPOSURE,
    POLL,
    Camera,
    CameraDriver,
    check_exposure,
    unix_time,
)
from brdfpipe.rig.acquisition.devices.errors import DeviceLost, single_line
from brdfpipe.rig.raw_frame import RawFrame, exposure_tolerance, is_number, read_fits

_IDENTIFIER = re.compile(r"[0-9A-Za-z_-]{1,64}")
_LARGEST_REQUEST = 4096
_LARGEST_HEADER = 2**20
_KEYWORDS = ("BITPIX", "EXPTIME", "DATE-OBS", "IMAGETYP", "CCD-TEMP", "REQUEST")


class DropFolder(CameraDriver):
    """Driver: writes requests into a folder and reads frames from it; removes nothing.

    A request is ``<id>.json`` with the keys ``id``, ``seconds`` and ``shutter`` (false: a dark frame). The answer is ``<id>.fits``, one image of
    unsigned 16-bit counts with the exposure time in EXPTIME and, if the camera knows them, DATE-OBS, IMAGETYP and CCD-TEMP; or ``<id>.error``
    with one line that states why there is no frame.
    """

    @property
    def folder(self) -> Path:
        """Of requests and frames."""
        return Path(self.settings.folder)

    @property
    def port(self) -> str:
        return f"folder {self.folder}"

    def identify(self) -> str:
        """Name the folder."""
        if not self.folder.is_dir():
            advice = "create or mount it, or correct `camera.folder`"
            raise self.error("the folder does not exist", advice=advice, kind=DeviceLost)
        return f"drop folder {self.folder.name}"

    def expose(self, seconds: float, *, shutter: bool = True) -> RawFrame:
        """Request an exposure and wait for its frame.

        Raises DeviceError: no frame in time, or one that is truncated or of another size, type, exposure time or request.
        """
        check_exposure(seconds)
        self.identify()
        request = self.folder / f"{uuid.uuid4().hex}.json"
        requested = time.time()
        content = {"id": request.stem, "seconds": float(seconds), "shutter": bool(shutter)}
        try:
            earlier = self._fits_files()
            store.write_text(request, store.canonical_json(content) + "\n")
            header, image = self._await_frame(request, seconds, earlier)
        except OSError as error:
            problem = f"the folder is no longer accessible ({error.strerror or error})"
            raise self.error(problem, request.name, "mount it again", DeviceLost) from error
        if header["BITPIX"] != 16 or image.dtype.kind not in "iu":
            problem = f"image with BITPIX {header['BITPIX']} read as {image.dtype.name}"
            raise self.error(problem, request.name, "write unsigned 16-bit counts: BITPIX 16 with BZERO 32768")
        counts = self.valid_counts(image, request.name)
        self._check_labels(header, request, seconds, shutter)
        temperature = header.get("CCD-TEMP")
        return RawFrame(
            counts=counts,
            started=unix_time(header.get("DATE-OBS"), requested),
            seconds=float(header["EXPTIME"]),
            temperature=float(temperature) if is_number(temperature) else math.nan,
        )

    def _await_frame(self, request: Path, seconds: float, earlier: set[str]) -> tuple[Mapping[str, Any], NDArray[Any]]:
        """Header and image, once the file is complete. Its writer may be writing, or have set its size before its content."""
        path = request.with_suffix(".fits")
        limit = seconds + self.settings.timeout
        deadline = self.clock() + limit
        state = "no frame"
        previous = tried = None
        while True:
            late = self.clock() >= deadline
            self._check_reported_error(request)
            status = self._file_status(path)
            if status is not None and status == previous != tried:
                try:
                    return _read_fits(path.read_bytes())
                except PermissionError:  # on Windows, while the writer has the file open
                    state = "a frame that cannot be opened"
                except _InvalidFile as problem:
                    tried = status
                    state = f"a truncated or invalid FITS file ({status[0]} bytes; {problem})"
            previous = status
            if late:
                break
            self.sleep(POLL)
        others = sorted(self._fits_files() - earlier - {path.name})
        misnamed = f", but a file of another name: {', '.join(others[:3])}" if others else ""
        advice = "check that the camera's script runs on this folder and answers <id>.json with <id>.fits"
        raise self.error(f"{state} after {limit:g} s{misnamed}", request.name, advice)

    def _file_status(self, path: Path) -> tuple[int, int] | None:
        """Size and modification time of a file, which show when it is finished."""
        try:
            status = path.lstat()
        except FileNotFoundError:
            return None
        request = f"{path.stem}.json"
        if not path.is_file() or path.is_symlink():
            raise self.error(f"{path.name} is not a regular file", request, "write the frame into the folder itself")
        width, height = self.settings.width, self.settings.height
        if status.st_size > 8 * width * height + _LARGEST_HEADER:
            raise self.error(f"a file of {status.st_size} bytes for {width} × {height} pixels", request, CHECK_SIZE)
        return status.st_size, status.st_mtime_ns

    def _check_reported_error(self, request: Path) -> None:
        path = request.with_suffix(".error")
        if path.is_file() and not path.is_symlink():
            with path.open("rb") as handle:
                reason = single_line(handle.read(500).decode("utf-8", "replace"))
            raise self.error(f"the camera's script reports: {reason}", request.name, "check the camera's script")

    def _fits_files(self) -> set[str]:
        return {printable(path.name) for path in self.folder.glob("*.fits")}

    def _check_labels(self, header: Mapping[str, Any], request: Path, seconds: float, shutter: bool) -> None:
        """Refuse a frame that states another request, exposure time or type."""
        advice = "the camera's script must answer each request with its own frame"
        identifier = header.get("REQUEST", request.stem)
        if identifier != request.stem:
            raise self.error(f"the frame states another request: {identifier!r}", request.name, advice)
        stated = header.get("EXPTIME")
        if not is_number(stated):
            problem = f"EXPTIME of the frame is {stated!r}, not a number"
            raise self.error(problem, request.name, "write the exposure time in seconds")
        if not abs(stated - seconds) <= exposure_tolerance(seconds):
            problem = f"exposure time {stated:g} s stated by the frame, {seconds:g} s requested"
            raise self.error(problem, request.name, advice)
        image_type = str(header.get("IMAGETYP", ""))
        dark = any(word in image_type.lower() for word in ("dark", "bias"))
        if image_type and dark == shutter:
            problem = f"IMAGETYP of the frame is {image_type!r}, a {'light' if shutter else 'dark'} frame was requested"
            raise self.error(problem, request.name, advice)


# --- the camera's side of the folder


def serve_folder(
    folder: str | Path,
    camera: Camera,
    *,
    stop: threading.Event,
    report: Callable[[str], None] = print,
) -> None:
    """Answer the requests of a drop folder with frames of a camera, until stopped.

    Parameters
    ----------
    folder : where requests appear; answered requests and other files are left alone
    stop : set it to end
    report : called with each refused request
    """
    folder, refused = Path(folder), set[str]()
    while not stop.is_set():
        for path in sorted(folder.glob("*.json")):
            if path.name in refused or any(path.with_suffix(suffix).exists() for suffix in (".fits", ".error")):
                continue
            try:
                identifier, seconds, shutter = _read_request(path)
            except _InvalidFile as reason:
                refused.add(path.name)
                report(f"{printable(path.name)}: invalid request: {reason}")
                continue
            try:
                raw = camera.expose(seconds, shutter=shutter)
            except BrdfpipeError as error:
                report(f"{path.name}: {error}")
                store.write_text(path.with_suffix(".error"), f"{error}\n")
            else:
                _write_fits(path.with_suffix(".fits"), raw, identifier, shutter)
        stop.wait(POLL)


def _read_request(path: Path) -> tuple[str, float, bool]:
    """Identifier, exposure time and shutter of a request."""
    if not _IDENTIFIER.fullmatch(path.stem):
        raise _InvalidFile("its name must have 1 to 64 letters, digits, - and _")
    if path.is_symlink() or not path.is_file() or path.stat().st_size > _LARGEST_REQUEST:
        raise _InvalidFile(f"not a regular file of at most {_LARGEST_REQUEST} bytes")
    try:
        content = json.loads(path.read_bytes())
    except (ValueError, RecursionError) as error:
        raise _InvalidFile("not JSON") from error
    if not isinstance(content, dict) or set(content) != {"id", "seconds", "shutter"}:
        raise _InvalidFile("its keys must be id, seconds, shutter")
    seconds = content["seconds"]
    if content["id"] != path.stem:
        raise _InvalidFile("id differs from the name of the file")
    if not is_number(seconds) or not 0 <= seconds <= LONGEST_EXPOSURE:
        raise _InvalidFile(f"seconds must be a number from 0 to {LONGEST_EXPOSURE:g}")
    if not isinstance(content["shutter"], bool):
        raise _InvalidFile("shutter must be true or false")
    return path.stem, float(seconds), content["shutter"]


# --- FITS: astropy converts unsigned 16-bit counts, which the file stores with an offset


class _InvalidFile(Exception):
    """A file is not, or not yet, a complete FITS file or a valid request."""


def _read_fits(content: bytes) -> tuple[dict[str, Any], NDArray[Any]]:
    """Header and data of the first image."""
    try:
        # Headers of cameras often violate the standard: warnings are ignored, and other keywords may not even be readable.
        header, image, excess = read_fits(content, "ignore", _KEYWORDS)
    except Exception as error:  # see read_fits
        raise _InvalidFile(type(error).__name__) from error
    if excess < 0:
        raise _InvalidFile(f"{-excess} bytes are missing")
    if image is None:
        raise _InvalidFile("the first image is empty")
    return header, image


def _write_fits(path: Path, raw: RawFrame, identifier: str, shutter: bool) -> None:
    from astropy.io import fits  # type: ignore[import-untyped]

    header = fits.Header()
    header["EXPTIME"] = (raw.seconds, "exposure [s]")
    header["DATE-OBS"] = (datetime.fromtimestamp(raw.started, UTC).strftime("%Y-%m-%dT%H:%M:%S.%f"), "start, UTC")
    header["IMAGETYP"] = "Light Frame" if shutter else "Dark Frame"
    if math.isfinite(raw.temperature):
        header["CCD-TEMP"] = (raw.temperature, "sensor [degree Celsius]")
    header["REQUEST"] = identifier
    content = io.BytesIO()
    fits.PrimaryHDU(raw.counts, header).writeto(content)
    store.write_bytes(path, content.getvalue())
