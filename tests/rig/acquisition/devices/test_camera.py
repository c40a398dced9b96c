"""The drop folder and the Alpaca camera: a frame is complete and as requested, or refused."""

from __future__ import annotations

import io
import json
import math
import sys
import threading
import time
import types
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ClassVar

import numpy as np
import pytest
from astropy.io import fits
from hypothesis import given, settings
from hypothesis import strategies as st
from serial_script import Clock

from brdfpipe.rig.acquisition.devices.alpaca_camera import AlpacaCamera
from brdfpipe.rig.acquisition.devices.connection import open_camera
from brdfpipe.rig.acquisition.devices.drop_folder import DropFolder, serve_folder
from brdfpipe.rig.acquisition.devices.errors import DeviceError, DeviceLost
from brdfpipe.rig.description import CameraSettings
from brdfpipe.rig.raw_frame import RawFrame

WIDTH, HEIGHT = 16, 12
COUNTS = (np.arange(WIDTH * HEIGHT, dtype=np.uint16) * 341).reshape(HEIGHT, WIDTH)


class Sensor:
    """A camera of known counts."""

    def __init__(self) -> None:
        self.exposures: list[tuple[float, bool]] = []

    def identify(self) -> str:
        return "sensor"

    def expose(self, seconds: float, *, shutter: bool = True) -> RawFrame:
        self.exposures.append((seconds, shutter))
        return RawFrame(COUNTS + np.uint16(len(self.exposures)), 1234567890.25, seconds, -20.5)


def settings_of(folder: Path, timeout: float = 600.0, **others: Any) -> CameraSettings:
    return CameraSettings("drop-folder", folder=str(folder), width=WIDTH, height=HEIGHT, timeout=timeout, **others)


def frame(counts: np.ndarray = COUNTS, **cards: Any) -> bytes:
    """A FITS file as a camera's script would write it."""
    content = io.BytesIO()
    header = fits.Header({"EXPTIME": 0.1, "IMAGETYP": "Light Frame", **cards})
    fits.PrimaryHDU(counts, fits.Header({key: value for key, value in header.items() if value is not None})).writeto(
        content
    )
    return content.getvalue()


class Laboratory:
    """A camera's script on a folder, which takes a step whenever the driver sleeps, in virtual seconds."""

    def __init__(self, folder: Path, answer: Callable[[Path], Iterator[None] | None], **others: Any) -> None:
        self.clock = Clock()
        self.camera = DropFolder(settings_of(folder, timeout=20.0, **others), clock=self.clock, sleep=self.sleep)
        self._folder, self._answer = folder, answer
        self._under_way: dict[str, Iterator[None]] = {}

    def sleep(self, seconds: float) -> None:
        self.clock.sleep(seconds)
        for request in self._folder.glob("*.json"):
            if request.name not in self._under_way:
                self._under_way[request.name] = self._answer(request) or iter(())
            next(self._under_way[request.name], None)


@contextmanager
def served(folder: Path, camera: Any, messages: list[str] | None = None) -> Iterator[None]:
    stop = threading.Event()
    report = messages.append if messages is not None else pytest.fail
    thread = threading.Thread(target=serve_folder, args=(folder, camera), kwargs={"stop": stop, "report": report})
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def expose_twice(folder: Path) -> None:
    """Two valid exposures: when the second is answered, the server has read every file of the folder at least twice."""
    for _ in range(2):
        DropFolder(settings_of(folder)).expose(0.1)


def drop(content: bytes) -> Callable[[Path], None]:
    """Answer by renaming a finished file into the folder."""

    def answer(request: Path) -> None:
        part = request.with_suffix(".part")
        part.write_bytes(content)
        part.rename(request.with_suffix(".fits"))

    return answer


def failing(folder: Path, answer: Callable[[Path], None], **others: Any) -> DeviceError:
    with pytest.raises(DeviceError) as caught:
        Laboratory(folder, answer, **others).camera.expose(0.1)
    return caught.value


# --- the drop folder


def test_a_camera_behind_a_folder_gives_the_same_frames(tmp_path: Path) -> None:
    sensor = Sensor()
    camera = DropFolder(settings_of(tmp_path))
    assert camera.identify() == f"drop folder {tmp_path.name}"
    with served(tmp_path, sensor):
        first, dark = camera.expose(0.1), camera.expose(0.125, shutter=False)
    np.testing.assert_array_equal(first.counts, COUNTS + 1)
    np.testing.assert_array_equal(dark.counts, COUNTS + 2)
    assert first.counts.dtype == np.uint16
    assert (first.started, first.seconds, first.temperature) == (1234567890.25, 0.1, -20.5)
    assert sensor.exposures == [(0.1, True), (0.125, False)]


def test_nothing_is_ever_removed_from_the_folder(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with served(tmp_path, Sensor()):
        DropFolder(settings_of(tmp_path)).expose(0.1)
    names = sorted(path.suffix for path in tmp_path.iterdir())
    assert names == [".fits", ".json", ".txt"]


def test_a_request_has_three_keys_and_a_unique_name(tmp_path: Path) -> None:
    requests: list[dict[str, Any]] = []

    def note(request: Path) -> None:
        requests.append(json.loads(request.read_text()) | {"name": request.stem})
        drop(frame(EXPTIME=0.1))(request)

    camera = Laboratory(tmp_path, note).camera
    camera.expose(0.1)
    camera.expose(0.1)
    assert [set(request) for request in requests] == [{"id", "seconds", "shutter", "name"}] * 2
    assert all(request["id"] == request["name"] for request in requests)
    assert requests[0]["id"] != requests[1]["id"]


def test_a_frame_without_date_and_temperature_has_the_time_of_its_request(tmp_path: Path) -> None:
    before = time.time()
    picture = Laboratory(tmp_path, drop(frame())).camera.expose(0.1)
    assert before <= picture.started <= time.time()
    assert math.isnan(picture.temperature)


def test_a_frame_is_read_when_it_is_completely_written(tmp_path: Path) -> None:
    content = frame()

    def slowly(request: Path) -> Iterator[None]:
        with request.with_suffix(".fits").open("wb") as handle:
            handle.truncate(len(content))  # some set the size first, and the file reads as zeros
            for start in range(0, len(content), 320):
                yield
                handle.write(content[start : start + 320])
                handle.flush()

    laboratory = Laboratory(tmp_path, slowly)
    np.testing.assert_array_equal(laboratory.camera.expose(0.1).counts, COUNTS)
    assert laboratory.clock.now > 0.1


@pytest.mark.parametrize("end", [0, 1, 2000, 2880, 2880 + 2 * WIDTH * HEIGHT, -1])
def test_a_truncated_frame_is_refused(tmp_path: Path, end: int) -> None:
    error = failing(tmp_path, drop(frame()[:end]))
    assert "truncated or invalid FITS file" in error.problem
    assert str(tmp_path) in error.port


@given(noise=st.binary(max_size=6000))
@settings(max_examples=25, deadline=None)
def test_a_file_of_noise_is_refused(noise: bytes) -> None:
    with TemporaryDirectory() as folder:
        assert "truncated or invalid FITS file" in failing(Path(folder), drop(noise)).problem


def test_a_frame_under_another_name_is_refused_by_that_name(tmp_path: Path) -> None:
    (tmp_path / "earlier.fits").write_bytes(frame())

    def elsewhere(request: Path) -> None:
        (tmp_path / "other.fits").write_bytes(frame())

    error = failing(tmp_path, elsewhere)
    assert error.problem == "no frame after 20.1 s, but a file of another name: other.fits"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (frame(COUNTS[:-1]), "image of 16 × 11 uint16, expected 16 × 12 uint16"),
        (frame(COUNTS.T), "image of 12 × 16 uint16"),
        (frame(COUNTS[None]), "image of 16 × 12 × 1 uint16"),
        (frame(COUNTS.astype(np.float32)), "BITPIX -32"),
        (frame(COUNTS.astype(np.int32)), "BITPIX 32"),
        (frame(COUNTS.astype(np.uint8)), "BITPIX 8"),
        (frame((COUNTS.astype(np.int32) - 32768).astype(np.int16)), "counts from -32768"),
        (frame(EXPTIME=0.2), "exposure time 0.2 s stated by the frame, 0.1 s requested"),
        (frame(EXPTIME=None), "EXPTIME of the frame is None"),
        (frame(EXPTIME="long"), "EXPTIME of the frame is 'long'"),
        (frame(IMAGETYP="Dark Frame"), "IMAGETYP of the frame is 'Dark Frame', a light frame was requested"),
        (frame(IMAGETYP="Bias Frame"), "IMAGETYP of the frame is 'Bias Frame'"),
        (frame(REQUEST="another"), "the frame states another request: 'another'"),
    ],
)
def test_a_frame_other_than_requested_is_refused_at_once(tmp_path: Path, content: bytes, message: str) -> None:
    laboratory = Laboratory(tmp_path, drop(content))
    with pytest.raises(DeviceError) as caught:
        laboratory.camera.expose(0.1)
    assert message in caught.value.problem
    assert caught.value.advice
    assert laboratory.clock.now < 0.1


def test_counts_beyond_the_bits_of_the_camera_are_refused(tmp_path: Path) -> None:
    assert "12 bits hold 0 to 4095" in failing(tmp_path, drop(frame()), bits=12).problem


def test_signed_counts_without_an_offset_are_read(tmp_path: Path) -> None:
    counts = (COUNTS // 4).astype(np.int16)
    picture = Laboratory(tmp_path, drop(frame(counts))).camera.expose(0.1)
    assert picture.counts.dtype == np.uint16
    np.testing.assert_array_equal(picture.counts, counts)


def test_a_header_that_violates_the_standard_is_read_without_a_warning(tmp_path: Path) -> None:
    content = frame(NOTE="x")
    bent = content.replace(b"NOTE    = 'x       '", b"note    = unquoted\0\0")
    assert bent != content
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        picture = Laboratory(tmp_path, drop(bent)).camera.expose(0.1)
    np.testing.assert_array_equal(picture.counts, COUNTS)


def test_a_file_too_large_to_be_the_frame_is_never_read(tmp_path: Path) -> None:
    def huge(request: Path) -> None:
        with request.with_suffix(".fits").open("wb") as handle:
            handle.truncate(2**33)

    assert "a file of 8589934592 bytes" in failing(tmp_path, huge).problem


def test_a_link_out_of_the_folder_is_not_followed(tmp_path: Path) -> None:
    outside = tmp_path / "outside.dat"
    outside.write_bytes(frame())
    inside = tmp_path / "in"
    inside.mkdir()
    error = failing(inside, lambda request: request.with_suffix(".fits").symlink_to(outside))
    assert "not a regular file" in error.problem


def test_a_missing_answer_is_reported_with_folder_request_and_advice(tmp_path: Path) -> None:
    error = failing(tmp_path, lambda request: None)
    assert error.problem == "no frame after 20.1 s"
    assert error.command.endswith(".json")
    assert "script runs" in error.advice


def test_a_missing_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DeviceLost, match="the folder does not exist"):
        DropFolder(settings_of(tmp_path / "gone")).expose(0.1)


def test_a_folder_that_disappears_is_reported_as_lost(tmp_path: Path) -> None:
    folder = tmp_path / "mounted"
    folder.mkdir()

    def replaced(request: Path) -> None:
        request.unlink()
        folder.rmdir()
        folder.write_text("no folder")

    assert isinstance(failing(folder, replaced), DeviceLost)


@pytest.mark.parametrize("seconds", [-1.0, float("nan"), float("inf"), 1e6])
def test_an_invalid_exposure_time_is_never_requested(tmp_path: Path, seconds: float) -> None:
    with pytest.raises(DeviceError, match=r"exposure time .* out of range"):
        DropFolder(settings_of(tmp_path)).expose(seconds)
    assert not list(tmp_path.iterdir())


# --- the camera's side of the folder


def test_the_folder_passes_on_an_error_of_the_camera(tmp_path: Path) -> None:
    class Broken(Sensor):
        def expose(self, seconds: float, *, shutter: bool = True) -> RawFrame:
            raise DeviceError("camera", "the cooler failed\x1b[31m")

    messages: list[str] = []
    with (
        served(tmp_path, Broken(), messages),
        pytest.raises(DeviceError, match=r"the camera's script reports: .*cooler failed") as caught,
    ):
        DropFolder(settings_of(tmp_path)).expose(0.1)
    assert "\x1b" not in str(caught.value)
    assert len(messages) == 1


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("a.json", b"{", "not JSON"),
        ("a.json", b"[" * 4000, "not JSON"),
        ("a.json", b"\xff\xfe", "not JSON"),
        ("a.json", b" " * 5000, "at most 4096 bytes"),
        ("a.json", b"[1]", "keys"),
        ("a.json", b'{"id": "a", "seconds": 1}', "keys"),
        ("a.json", b'{"id": "a", "seconds": 1, "shutter": true, "path": "/etc"}', "keys"),
        ("a.json", b'{"id": "b", "seconds": 1, "shutter": true}', "id differs from the name"),
        ("a.json", b'{"id": "a", "seconds": true, "shutter": true}', "seconds"),
        ("a.json", b'{"id": "a", "seconds": NaN, "shutter": true}', "seconds"),
        ("a.json", b'{"id": "a", "seconds": 1e9, "shutter": true}', "seconds"),
        ("a.json", b'{"id": "a", "seconds": "1", "shutter": true}', "seconds"),
        ("a.json", b'{"id": "a", "seconds": 1, "shutter": 1}', "shutter"),
        ("a b.json", b'{"id": "a b", "seconds": 1, "shutter": true}', "its name"),
        ("..json", b'{"id": ".", "seconds": 1, "shutter": true}', "its name"),
    ],
)
def test_an_invalid_request_is_reported_once_and_never_exposed(
    tmp_path: Path, name: str, content: bytes, reason: str
) -> None:
    (tmp_path / name).write_bytes(content)
    sensor, messages = Sensor(), list[str]()
    with served(tmp_path, sensor, messages):
        expose_twice(tmp_path)
    assert len(sensor.exposures) == 2
    assert len(messages) == 1
    assert reason in messages[0]
    assert not [path for path in tmp_path.glob(f"{Path(name).stem}.*") if path.name != name]


def test_a_link_is_not_accepted_as_a_request(tmp_path: Path) -> None:
    outside = tmp_path / "outside"
    outside.write_text('{"id": "a", "seconds": 1, "shutter": true}')
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "a.json").symlink_to(outside)
    messages: list[str] = []
    with served(tmp_path / "in", Sensor(), messages):
        expose_twice(tmp_path / "in")
    assert "regular file" in messages[0]


def test_an_answered_request_is_not_answered_again(tmp_path: Path) -> None:
    sensor = Sensor()
    with served(tmp_path, sensor):
        DropFolder(settings_of(tmp_path)).expose(0.1)
    with served(tmp_path, sensor):
        expose_twice(tmp_path)
    assert len(sensor.exposures) == 3


def test_no_answer_is_ever_incomplete(tmp_path: Path) -> None:
    """Every file with its final name is complete."""
    sensor, remainders = Sensor(), list[int]()
    with served(tmp_path, sensor):
        camera = DropFolder(settings_of(tmp_path))
        for _ in range(5):
            camera.expose(0.1)
            remainders += [path.stat().st_size % 2880 for path in tmp_path.glob("*.fits")]
    assert set(remainders) == {0}


# --- Alpaca


class FakeAlpaca:
    """The part of ``alpaca.camera.Camera`` that the driver uses."""

    CameraXSize, CameraYSize, BinX, BinY = WIDTH, HEIGHT, 1, 1
    Name, HasShutter, ImageReady = "Simulated", True, True
    ImageArray: Any = COUNTS.T.tolist()
    LastExposureDuration: Any = 0.1
    LastExposureStartTime: Any = "2009-02-13T23:31:30.25"
    CCDTemperature: Any = -10.0

    def __init__(self, address: str, device: int) -> None:
        self.address, self.device = address, device
        self.started: list[tuple[float, bool]] = []
        self.aborted = False
        self.Connected = False

    def StartExposure(self, seconds: float, light: bool) -> None:
        self.started.append((seconds, light))

    def AbortExposure(self) -> None:
        self.aborted = True


NotImplementedException = type("NotImplementedException", (Exception,), {"__module__": "alpaca.exceptions"})
DriverException = type("DriverException", (Exception,), {"__module__": "alpaca.exceptions"})


def raising(error: Exception) -> property:
    def fail(_: object) -> None:
        raise error

    return property(fail)


@pytest.fixture
def alpaca(monkeypatch: pytest.MonkeyPatch) -> Callable[..., AlpacaCamera]:
    def make(timeout: float = 0.1, **attributes: Any) -> AlpacaCamera:
        library = types.ModuleType("alpaca.camera")
        library.Camera = type("Camera", (FakeAlpaca,), attributes)  # type: ignore[attr-defined]
        monkeypatch.setitem(sys.modules, "alpaca", types.ModuleType("alpaca"))
        monkeypatch.setitem(sys.modules, "alpaca.camera", library)
        described = CameraSettings("alpaca", address="localhost:11111", width=WIDTH, height=HEIGHT, timeout=timeout)
        return AlpacaCamera(described)

    return make


def test_an_alpaca_picture_has_its_rows_and_columns_in_place(alpaca: Callable[..., AlpacaCamera]) -> None:
    camera = alpaca()
    assert camera.identify() == "Simulated"
    picture = camera.expose(0.1)
    np.testing.assert_array_equal(picture.counts, COUNTS)
    assert picture.counts.dtype == np.uint16
    assert (picture.started, picture.seconds, picture.temperature) == (1234567890.25, 0.1, -10.0)


def test_optional_properties_of_an_alpaca_camera_may_be_missing(alpaca: Callable[..., AlpacaCamera]) -> None:
    unknown = raising(NotImplementedException("no"))
    camera = alpaca(LastExposureDuration=unknown, LastExposureStartTime=unknown, CCDTemperature=unknown)
    before = time.time()
    picture = camera.expose(0.25)
    assert picture.seconds == 0.25
    assert math.isnan(picture.temperature)
    assert before <= picture.started <= time.time()


@pytest.mark.parametrize(
    ("attributes", "message"),
    [
        ({"CameraXSize": 20}, "sensor of 20 × 12 pixels"),
        ({"BinX": 2}, "2 × 1 binning"),
        ({"Name": raising(ConnectionError("refused"))}, "no reply"),
        ({"Name": raising(DriverException("cooler\x1b[0m"))}, "the server refuses"),
        ({"CameraXSize": raising(KeyError("Value"))}, "unreadable reply"),
    ],
)
def test_an_alpaca_camera_that_is_not_the_described_one_is_refused(
    alpaca: Callable[..., AlpacaCamera], attributes: dict[str, Any], message: str
) -> None:
    with pytest.raises(DeviceError, match=message) as caught:
        alpaca(**attributes).identify()
    assert "localhost:11111" in str(caught.value)
    assert "\x1b" not in str(caught.value)


@pytest.mark.parametrize(
    ("attributes", "message"),
    [
        ({"ImageArray": COUNTS.tolist()}, "image of 12 × 16"),
        ({"ImageArray": (COUNTS.T / 2).tolist()}, "float64"),
        ({"ImageArray": (COUNTS.T.astype(int) - 5).tolist()}, "counts from -5"),
        ({"LastExposureDuration": 0.4}, "exposure time 0.4 s"),
        ({"ImageReady": raising(DriverException("overheated"))}, "overheated"),
    ],
)
def test_an_alpaca_image_other_than_requested_is_refused(
    alpaca: Callable[..., AlpacaCamera], attributes: dict[str, Any], message: str
) -> None:
    with pytest.raises(DeviceError, match=message):
        alpaca(**attributes).expose(0.1)


def test_no_dark_frame_is_requested_from_an_alpaca_camera_without_a_shutter(
    alpaca: Callable[..., AlpacaCamera],
) -> None:
    with pytest.raises(DeviceError, match="no shutter"):
        alpaca(HasShutter=False).expose(0.1, shutter=False)


def test_an_alpaca_exposure_that_does_not_end_is_aborted(alpaca: Callable[..., AlpacaCamera]) -> None:
    camera = alpaca(ImageReady=False)
    with pytest.raises(DeviceError, match=r"no image after 0\.1 s"):
        camera.expose(0.0)
    assert camera._camera.aborted


def test_without_the_library_alpaca_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "alpaca.camera", None)
    with pytest.raises(DeviceError, match=r"need the library alpyca; pip install 'brdfpipe\[alpaca\]'"):
        AlpacaCamera(CameraSettings("alpaca", address="localhost:11111"))


def test_an_emulated_camera_has_no_driver() -> None:
    with pytest.raises(DeviceError, match="rig emulate"):
        open_camera(CameraSettings("emulated"))


class _AlpacaServer(BaseHTTPRequestHandler):
    """Replies of an Alpaca server whose image is :data:`COUNTS`."""

    values: ClassVar[dict[str, Any]] = {
        "cameraxsize": WIDTH,
        "cameraysize": HEIGHT,
        "binx": 1,
        "biny": 1,
        "name": "Simulated",
        "hasshutter": True,
        "imageready": True,
        "imagearray": COUNTS.T.tolist(),
        "lastexposureduration": 0.1,
        "lastexposurestarttime": "2009-02-13T23:31:30.25",
    }

    def answer(self) -> None:
        length = int(self.headers.get("Content-Length") or 0)
        self.rfile.read(length)
        name = self.path.split("?")[0].rsplit("/", 1)[-1]
        known = self.command == "PUT" or name in self.values
        # 0x400: not implemented, as the temperature of a camera without a cooler.
        content = {"Value": self.values.get(name), "ErrorNumber": 0 if known else 0x400, "ErrorMessage": ""}
        body = json.dumps(content | {"Type": 2, "Rank": 2}).encode()
        self.send_response(200)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    do_GET = do_PUT = answer

    def log_message(self, *_: Any) -> None:
        pass


def test_the_library_alpyca_is_used_as_it_is() -> None:
    pytest.importorskip("alpaca.camera", reason="the optional extra alpaca is not installed")
    with ThreadingHTTPServer(("127.0.0.1", 0), _AlpacaServer) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            address = f"127.0.0.1:{server.server_port}"
            camera = AlpacaCamera(CameraSettings("alpaca", address=address, width=WIDTH, height=HEIGHT))
            assert camera.identify() == "Simulated"
            picture = camera.expose(0.1)
        finally:
            server.shutdown()
            thread.join()
    np.testing.assert_array_equal(picture.counts, COUNTS)
    assert picture.started == 1234567890.25
    assert math.isnan(picture.temperature)
    with pytest.raises(DeviceLost, match="no reply"):
        camera.identify()
