"""Cameras: what the scan needs of one, the drop folder, and ASCOM Alpaca.

A laboratory's camera speaks through software of its maker. The drop folder asks no more of it than a script that reads a small
JSON file and writes a FITS file; :func:`serve_folder` is that script for whatever is a :class:`Camera`.
"""

from __future__ import annotations

import importlib
import io
import json
import math
import re
import threading
import time
import uuid
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from brdfpipe import store
from brdfpipe.errors import BrdfpipeError, printable
from brdfpipe.rig.acquisition.devices.errors import DeviceError, DeviceLost, visible
from brdfpipe.rig.description import CameraSettings

Counts = NDArray[np.uint16]

LONGEST_EXPOSURE = 3600.0
"""Seconds."""

POLL = 0.02
"""Seconds between two looks for a frame."""

TIMING = 0.01
"""Largest relative difference of the exposure asked for and the one a frame states; one count of its clock, 1 ms, is allowed."""

_DEVICE = "camera"
_IDENTIFIER = re.compile(r"[0-9A-Za-z_-]{1,64}")
_LARGEST_REQUEST = 4096
_LARGEST_HEADER = 2**20
_CARDS = ("BITPIX", "EXPTIME", "DATE-OBS", "IMAGETYP", "CCD-TEMP", "REQUEST")


@dataclass(frozen=True)
class Picture:
    """One exposure as the sensor gave it.

    counts : uint16 (height, width)
    started : seconds, of the camera's clock: Unix time, or since the start of the run
    seconds : how long the exposure took
    temperature : degree Celsius of the sensor, NaN if unknown
    """

    counts: Counts
    started: float
    seconds: float
    temperature: float = math.nan


class Camera(Protocol):
    """What the scan needs of a camera."""

    def identify(self) -> str:
        """Name the camera; raises DeviceError if it is not there."""

    def expose(self, seconds: float, *, shutter: bool = True) -> Picture:
        """Expose and read out; without the shutter, a dark frame. Raises DeviceError if there is no whole, right frame."""


def open_camera(settings: CameraSettings) -> Camera:
    """The camera of a description.

    Raises
    ------
    DeviceError : it is one that only the emulator has.
    """
    kinds: dict[str, Callable[[CameraSettings], Camera]] = {"drop-folder": DropFolder, "alpaca": AlpacaCamera}
    if settings.kind not in kinds:
        advice = f"run `brdfpipe rig emulate`, or set `camera.kind` to {' or '.join(kinds)}"
        raise DeviceError(_DEVICE, f"a camera of kind {settings.kind!r} is no real one", advice=advice)
    return kinds[settings.kind](settings)


# --- the drop folder


class DropFolder:
    """A folder into which requests are put and from which frames are taken; nothing in it is ever removed.

    A request is ``<id>.json`` with the keys ``id``, ``seconds`` and ``shutter`` (false: a dark frame); its answer is ``<id>.fits``,
    one image of unsigned 16-bit counts with the exposure in EXPTIME, and, where the camera knows them, DATE-OBS, IMAGETYP and
    CCD-TEMP; or ``<id>.error`` with a line that says why there is none.
    """

    def __init__(
        self,
        settings: CameraSettings,
        *,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.settings = settings
        self.folder = Path(settings.folder)
        self._clock = clock
        self._sleep = sleep

    def identify(self) -> str:
        """Name the folder."""
        if not self.folder.is_dir():
            raise self._error(
                DeviceLost, "there is no such folder", advice="make or mount it, or correct `camera.folder`"
            )
        return f"drop folder {self.folder.name}"

    def expose(self, seconds: float, *, shutter: bool = True) -> Picture:
        """Ask for an exposure and wait for its frame.

        Raises
        ------
        DeviceError : no frame came in time, or it is cut off, of another size, type, exposure or request.
        """
        check_exposure(seconds)
        self.identify()
        identifier = uuid.uuid4().hex
        asked = time.time()
        request = {"id": identifier, "seconds": float(seconds), "shutter": bool(shutter)}
        try:
            earlier = self._frames()
            store.write_text(self.folder / f"{identifier}.json", store.canonical_json(request) + "\n")
            header, counts = self._awaited(identifier, seconds, earlier)
        except OSError as error:
            problem = f"the folder went away ({error.strerror or error})"
            raise self._error(DeviceLost, problem, identifier, "mount it again") from error
        self._check(header, identifier, seconds, shutter)
        return Picture(counts, _started(header, asked), float(header["EXPTIME"]), _temperature(header))

    def _awaited(self, identifier: str, seconds: float, earlier: set[str]) -> tuple[Mapping[str, Any], Counts]:
        """The frame, once it is whole: its writer may still be at it, or have set its size before its content."""
        path = self.folder / f"{identifier}.fits"
        limit = seconds + self.settings.timeout
        deadline = self._clock() + limit
        state = "no frame"
        seen = tried = None
        while True:
            late = self._clock() >= deadline
            if (told := self._told(identifier)) is not None:
                raise self._error(DeviceError, f"the camera's side says: {told}", identifier)
            marks = self._marks(path)
            if marks is not None and marks == seen != tried:
                try:
                    header, raw = _read_fits(path.read_bytes())
                except PermissionError:  # on Windows, as long as its writer holds it
                    state = "a frame that may not be read"
                except _NotWhole as reason:
                    tried = marks
                    state = f"a frame that is cut off or no FITS file ({marks[0]} bytes; {reason})"
                else:
                    return header, self._checked_counts(header, raw, identifier)
            seen = marks
            if late:
                break
            self._sleep(POLL)
        others = sorted(self._frames() - earlier - {path.name})
        under = f", but under another name {', '.join(others[:3])}" if others else ""
        raise self._error(
            DeviceError,
            f"{state} in {limit:g} s{under}",
            identifier,
            "is the camera's script running on this folder? It answers <id>.json by <id>.fits",
        )

    def _marks(self, path: Path) -> tuple[int, int] | None:
        """Size and time of a file, by which it is seen to be finished."""
        try:
            status = path.lstat()
        except FileNotFoundError:
            return None
        if not path.is_file() or path.is_symlink():
            raise self._error(
                DeviceError, f"{path.name} is no plain file", path.stem, "write the frame into the folder itself"
            )
        pixels = self.settings.width * self.settings.height
        if status.st_size > 8 * pixels + _LARGEST_HEADER:
            wanted = f"{self.settings.width} × {self.settings.height}"
            raise self._error(DeviceError, f"a file of {status.st_size} bytes for {wanted} pixels", path.stem, _SIZE)
        return status.st_size, status.st_mtime_ns

    def _told(self, identifier: str) -> str | None:
        path = self.folder / f"{identifier}.error"
        if not path.is_file() or path.is_symlink():
            return None
        with path.open("rb") as handle:
            text = handle.read(500).decode("utf-8", "replace")
        return visible(text)

    def _frames(self) -> set[str]:
        return {printable(path.name) for path in self.folder.glob("*.fits")}

    def _checked_counts(self, header: Mapping[str, Any], raw: NDArray[Any], identifier: str) -> Counts:
        """The counts, if they are what the sensor of the description gives."""
        shape = (self.settings.height, self.settings.width)
        if header["BITPIX"] != 16 or raw.dtype.kind not in "iu":
            problem = f"a frame of BITPIX {header['BITPIX']} that reads as {raw.dtype.name}"
            raise self._error(
                DeviceError, problem, identifier, "write unsigned 16-bit counts: BITPIX 16 with BZERO 32768"
            )
        if raw.shape != shape:
            found = " × ".join(map(str, reversed(raw.shape)))
            problem = f"a frame of {found} pixels; the description says {shape[1]} × {shape[0]}"
            raise self._error(DeviceError, problem, identifier, _SIZE)
        if not (raw.min() >= 0 and raw.max() <= self.settings.full):
            problem = (
                f"counts from {raw.min()} to {raw.max()}; {self.settings.bits} bits hold 0 to {self.settings.full}"
            )
            raise self._error(
                DeviceError, problem, identifier, "correct `camera.bits`, or write counts without an offset"
            )
        return np.ascontiguousarray(raw, dtype=np.uint16)

    def _check(self, header: Mapping[str, Any], identifier: str, seconds: float, shutter: bool) -> None:
        """Refuse a frame that says it is of another request, exposure or kind."""
        request = header.get("REQUEST", identifier)
        if request != identifier:
            raise self._error(DeviceError, f"the frame is of another request, {request!r}", identifier, _SCRIPT)
        stated = header.get("EXPTIME")
        if isinstance(stated, bool) or not isinstance(stated, int | float):
            raise self._error(
                DeviceError, f"the frame's EXPTIME is {stated!r}", identifier, "write the exposure in seconds"
            )
        if not abs(stated - seconds) <= TIMING * seconds + 1e-3:
            problem = f"the frame's exposure is {stated:g} s; asked for {seconds:g} s"
            raise self._error(DeviceError, problem, identifier, _SCRIPT)
        kind = str(header.get("IMAGETYP", ""))
        dark = any(word in kind.lower() for word in ("dark", "bias"))
        if kind and dark == shutter:
            wanted = "light" if shutter else "dark"
            problem = f"the frame's IMAGETYP is {kind!r}; asked for a {wanted} frame"
            raise self._error(DeviceError, problem, identifier, _SCRIPT)

    def _error(
        self, kind: type[DeviceError], problem: str, identifier: str = "", advice: str = "look at the camera's script"
    ) -> DeviceError:
        command = f"{identifier}.json" if identifier else ""
        return kind(_DEVICE, problem, port=f"folder {self.folder}", command=command, advice=advice)


_SIZE = "correct `camera.width` and `camera.height`, or switch binning and regions off"
_SCRIPT = "the camera's script must answer each request by a frame of its own"


def serve_folder(
    folder: str | Path,
    camera: Camera,
    *,
    stop: threading.Event,
    report: Callable[[str], None] = print,
    pause: float = POLL,
) -> None:
    """Answer the requests of a drop folder by a camera's frames, until stopped.

    Parameters
    ----------
    folder : where requests appear; what is no request, or has its answer, is left alone
    stop : set it to end
    report : told of requests that are refused
    pause : seconds between two looks
    """
    folder, refused = Path(folder), set[str]()
    while not stop.is_set():
        for path in sorted(folder.glob("*.json")):
            if path.name in refused or _answered(path):
                continue
            try:
                identifier, seconds, shutter = _request(path)
            except _NoRequest as reason:
                refused.add(path.name)
                report(f"{printable(path.name)}: no request: {reason}")
                continue
            try:
                picture = camera.expose(seconds, shutter=shutter)
            except BrdfpipeError as refusal:
                report(f"{path.name}: {refusal}")
                store.write_text(path.with_suffix(".error"), f"{refusal}\n")
            else:
                _write_fits(path.with_suffix(".fits"), picture, identifier, shutter)
        stop.wait(pause)


class _NoRequest(Exception):
    """A file that is no request."""


def _answered(path: Path) -> bool:
    return path.with_suffix(".fits").exists() or path.with_suffix(".error").exists()


def _request(path: Path) -> tuple[str, float, bool]:
    """The content of a request: identifier, seconds, shutter."""
    if not _IDENTIFIER.fullmatch(path.stem):
        raise _NoRequest("its name is not of letters, digits, - and _, at most 64")
    if path.is_symlink() or not path.is_file() or path.stat().st_size > _LARGEST_REQUEST:
        raise _NoRequest(f"not a plain file of at most {_LARGEST_REQUEST} bytes")
    try:
        content = json.loads(path.read_bytes())
    except (ValueError, RecursionError) as error:
        raise _NoRequest("not JSON") from error
    if not isinstance(content, dict) or set(content) != {"id", "seconds", "shutter"}:
        raise _NoRequest("its keys are not id, seconds, shutter")
    seconds = content["seconds"]
    if content["id"] != path.stem:
        raise _NoRequest("its id is not its name")
    if isinstance(seconds, bool) or not isinstance(seconds, int | float) or not 0 <= seconds <= LONGEST_EXPOSURE:
        raise _NoRequest(f"its seconds are not a number from 0 to {LONGEST_EXPOSURE:g}")
    if not isinstance(content["shutter"], bool):
        raise _NoRequest("its shutter is neither true nor false")
    return path.stem, float(seconds), content["shutter"]


# --- FITS, read and written by astropy: unsigned 16-bit counts are an offset away from what the file holds


class _NotWhole(Exception):
    """Bytes that are no whole FITS file, or not yet."""


def _read_fits(content: bytes) -> tuple[dict[str, Any], NDArray[Any]]:
    """Header and data of the first image."""
    from astropy.io import fits  # type: ignore[import-untyped]

    try:
        with warnings.catch_warnings():
            # Cameras' headers bend the standard; a file that is cut off is found by its length below.
            warnings.simplefilter("ignore")
            with fits.open(io.BytesIO(content), memmap=False) as images:
                image = images[0]
                # Of the other cards some may not even parse.
                header = {card: image.header[card] for card in _CARDS if card in image.header}
                place = image.fileinfo()
                missing = place["datLoc"] + place["datSpan"] - len(content)
                if missing > 0:
                    raise _NotWhole(f"{missing} bytes are missing")
                if image.data is None:
                    raise _NotWhole("the first image is empty")
                return header, np.asarray(image.data)
    except _NotWhole:
        raise
    except (
        Exception
    ) as error:  # astropy raises OSError, ValueError, TypeError, KeyError, VerifyError on what is no FITS file
        raise _NotWhole(type(error).__name__) from error


def _write_fits(path: Path, picture: Picture, identifier: str, shutter: bool) -> None:
    from astropy.io import fits

    header = fits.Header()
    header["EXPTIME"] = (picture.seconds, "exposure [s]")
    header["DATE-OBS"] = (datetime.fromtimestamp(picture.started, UTC).strftime("%Y-%m-%dT%H:%M:%S.%f"), "start, UTC")
    header["IMAGETYP"] = "Light Frame" if shutter else "Dark Frame"
    if math.isfinite(picture.temperature):
        header["CCD-TEMP"] = (picture.temperature, "sensor [degree Celsius]")
    header["REQUEST"] = identifier
    content = io.BytesIO()
    fits.PrimaryHDU(picture.counts, header).writeto(content)
    store.write_bytes(path, content.getvalue())


def _started(header: Mapping[str, Any], otherwise: float) -> float:
    """Unix time of the start; of the request, where the frame does not tell."""
    try:
        return _unix_time(str(header["DATE-OBS"]))
    except (KeyError, ValueError):
        return otherwise


def _unix_time(text: str) -> float:
    """Unix time of a FITS date and time, which is UTC."""
    moment = datetime.fromisoformat(text.strip())
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()


def _temperature(header: Mapping[str, Any]) -> float:
    value = header.get("CCD-TEMP")
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else math.nan


def check_exposure(seconds: float) -> None:
    """Refuse what is no exposure."""
    if not 0 <= seconds <= LONGEST_EXPOSURE:  # NaN fails too
        raise DeviceError(_DEVICE, f"cannot expose {seconds!r} s", advice=f"0 to {LONGEST_EXPOSURE:g} s")


# --- ASCOM Alpaca


class AlpacaCamera:
    """A camera behind an ASCOM Alpaca server, by the library alpyca (the optional extra ``alpaca``)."""

    def __init__(
        self,
        settings: CameraSettings,
        *,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.settings = settings
        self._clock = clock
        self._sleep = sleep
        try:
            library = importlib.import_module("alpaca.camera")
        except ImportError as error:
            advice = "pip install 'brdfpipe[alpaca]'"
            raise DeviceError(_DEVICE, "Alpaca cameras need the library alpyca", advice=advice) from error
        self._camera = library.Camera(settings.address, settings.device)

    def identify(self) -> str:
        """Connect, and name the camera.

        Raises
        ------
        DeviceError : no server answers, or its sensor is not that of the description.
        """
        camera = self._camera
        self._done("Connected = True", lambda: setattr(camera, "Connected", True))
        size = self._done("CameraXSize, CameraYSize", lambda: (camera.CameraXSize, camera.CameraYSize))
        binned = self._done("BinX, BinY", lambda: (camera.BinX, camera.BinY))
        wanted = (self.settings.width, self.settings.height)
        if size != wanted or binned != (1, 1):
            problem = f"a sensor of {size[0]} × {size[1]} pixels, binned {binned[0]} × {binned[1]}"
            raise self._error(f"{problem}; the description says {wanted[0]} × {wanted[1]}, not binned", advice=_SIZE)
        return str(self._done("Name", lambda: camera.Name))

    def expose(self, seconds: float, *, shutter: bool = True) -> Picture:
        """Expose, wait, and fetch the counts.

        Raises
        ------
        DeviceError : the server or the camera refuses, takes too long, or gives another picture; or a dark frame is asked of a camera
            without a shutter, which would expose it to light.
        """
        check_exposure(seconds)
        camera = self._camera
        if not shutter and not self._done("HasShutter", lambda: camera.HasShutter):
            advice = "use a camera with a shutter, or a lamp shutter behind a drop folder"
            raise self._error("it has no shutter, so it cannot take dark frames", advice=advice)
        asked = time.time()
        command = f"StartExposure({seconds:g}, {shutter})"
        self._done(command, lambda: camera.StartExposure(float(seconds), bool(shutter)))
        self._wait(seconds, command)
        # An array of Alpaca is indexed by column, then row.
        counts = self._counts(np.asarray(self._done("ImageArray", lambda: camera.ImageArray)).T)
        duration = float(self._told("LastExposureDuration", seconds))
        if not abs(duration - seconds) <= TIMING * seconds + 1e-3:
            raise self._error(f"the exposure took {duration:g} s", command, "is another program using the camera?")
        try:
            started = _unix_time(str(self._told("LastExposureStartTime", "")))
        except ValueError:
            started = asked
        return Picture(counts, started, duration, float(self._told("CCDTemperature", math.nan)))

    def _wait(self, seconds: float, command: str) -> None:
        limit = seconds + self.settings.timeout
        deadline = self._clock() + limit
        while not self._done("ImageReady", lambda: self._camera.ImageReady):
            if self._clock() >= deadline:
                self._done("AbortExposure", self._camera.AbortExposure)
                raise self._error(
                    f"no picture in {limit:g} s", command, "raise `camera.timeout`, or look at the server"
                )
            self._sleep(POLL)

    def _counts(self, raw: NDArray[Any]) -> Counts:
        shape = (self.settings.height, self.settings.width)
        if raw.shape != shape or raw.dtype.kind not in "iu":
            problem = f"a picture of {' × '.join(map(str, reversed(raw.shape)))} {raw.dtype.name}"
            raise self._error(f"{problem}; expected {shape[1]} × {shape[0]} whole counts", "ImageArray", _SIZE)
        if not (raw.min() >= 0 and raw.max() <= self.settings.full):
            raise self._error(
                f"counts from {raw.min()} to {raw.max()}; {self.settings.bits} bits hold 0 to {self.settings.full}",
                "ImageArray",
                "correct `camera.bits`",
            )
        return np.ascontiguousarray(raw, dtype=np.uint16)

    def _told(self, name: str, otherwise: Any) -> Any:
        """A property that cameras need not have."""
        try:
            return getattr(self._camera, name)
        except Exception as error:
            if type(error).__name__ in ("NotImplementedException", "InvalidOperationException"):
                return otherwise
            raise self._failed(error, name) from error

    def _done(self, name: str, action: Callable[[], Any]) -> Any:
        try:
            return action()
        except Exception as error:
            raise self._failed(error, name) from error

    def _failed(self, error: Exception, name: str) -> DeviceError:
        # alpyca's exceptions have no common base; those of the connection come from requests, whose are OSErrors.
        if isinstance(error, OSError):
            advice = "is the server running there, and `camera.address` host:port?"
            return self._error(f"no answer ({type(error).__name__})", name, advice, DeviceLost)
        if type(error).__module__.startswith("alpaca."):
            told = f"{type(error).__name__}: {visible(str(error)[:200])}"
            return self._error(f"the server refuses ({told})", name, "look at the server")
        return self._error(f"an answer that cannot be read ({type(error).__name__})", name, "is it an Alpaca server?")

    def _error(
        self, problem: str, command: str = "", advice: str = "", kind: type[DeviceError] = DeviceError
    ) -> DeviceError:
        place = f"{self.settings.address} (camera {self.settings.device})"
        return kind(_DEVICE, problem, port=place, command=command, advice=advice)
