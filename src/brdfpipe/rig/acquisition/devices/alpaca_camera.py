"""A camera behind an ASCOM Alpaca server, by the library alpyca (the optional extra ``alpaca``)."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from brdfpipe.rig.acquisition.devices.camera import CHECK_SIZE, POLL, CameraDriver, check_exposure, unix_time
from brdfpipe.rig.acquisition.devices.errors import DeviceError, DeviceLost, single_line
from brdfpipe.rig.description import CameraSettings
from brdfpipe.rig.raw_frame import RawFrame, exposure_tolerance


class AlpacaCamera(CameraDriver):
    """Driver of an Alpaca camera; parameters as of the base class. Raises DeviceError: alpyca is not installed."""

    def __init__(self, settings: CameraSettings, **time_source: Any) -> None:
        super().__init__(settings, **time_source)
        try:
            from alpaca.camera import Camera  # type: ignore[import-not-found,import-untyped,unused-ignore]
        except ImportError as error:
            advice = "pip install 'brdfpipe[alpaca]'"
            raise DeviceError("camera", "Alpaca cameras need the library alpyca", advice=advice) from error
        self._camera = Camera(settings.address, settings.device)

    @property
    def port(self) -> str:
        return f"{self.settings.address} (camera {self.settings.device})"

    def identify(self) -> str:
        """Connect to the camera and name it. Raises DeviceError: no server, or a sensor that differs from the description."""
        camera = self._camera
        self._call("Connected = True", lambda: setattr(camera, "Connected", True))
        size = self._call("CameraXSize, CameraYSize", lambda: (camera.CameraXSize, camera.CameraYSize))
        binning = self._call("BinX, BinY", lambda: (camera.BinX, camera.BinY))
        expected = (self.settings.width, self.settings.height)
        if size != expected or binning != (1, 1):
            problem = f"sensor of {size[0]} × {size[1]} pixels with {binning[0]} × {binning[1]} binning"
            raise self.error(f"{problem}, expected {expected[0]} × {expected[1]} without binning", advice=CHECK_SIZE)
        return str(self._call("Name", lambda: camera.Name))

    def expose(self, seconds: float, *, shutter: bool = True) -> RawFrame:
        """Expose, wait, and read the counts.

        Raises DeviceError: the server or the camera refuses, takes too long, or returns another image; or a dark frame is requested
        from a camera without a shutter, which would expose it to light.
        """
        check_exposure(seconds)
        camera = self._camera
        if not shutter and not self._call("HasShutter", lambda: camera.HasShutter):
            advice = "use a camera with a shutter, or a lamp shutter behind a drop folder"
            raise self.error("no dark frames: the camera has no shutter", advice=advice)
        requested = time.time()
        command = f"StartExposure({seconds:g}, {shutter})"
        self._call(command, lambda: camera.StartExposure(float(seconds), bool(shutter)))
        self._wait(seconds, command)
        # Arrays of Alpaca are indexed by column, then row.
        image = np.asarray(self._call("ImageArray", lambda: camera.ImageArray)).T
        counts = self.valid_counts(image, "ImageArray")
        duration = float(self._optional("LastExposureDuration", seconds))
        if not abs(duration - seconds) <= exposure_tolerance(seconds):
            advice = "check that no other program uses the camera"
            raise self.error(f"exposure time {duration:g} s, {seconds:g} s requested", command, advice)
        started = unix_time(self._optional("LastExposureStartTime", ""), requested)
        return RawFrame(counts, started, duration, float(self._optional("CCDTemperature", math.nan)))

    def _wait(self, seconds: float, command: str) -> None:
        limit = seconds + self.settings.timeout
        deadline = self.clock() + limit
        while not self._call("ImageReady", lambda: self._camera.ImageReady):
            if self.clock() >= deadline:
                self._call("AbortExposure", self._camera.AbortExposure)
                raise self.error(f"no image after {limit:g} s", command, "raise `camera.timeout`, or check the server")
            self.sleep(POLL)

    def _optional(self, name: str, default: Any) -> Any:
        """A property that not every camera has."""
        try:
            return getattr(self._camera, name)
        except Exception as error:
            if type(error).__name__ in ("NotImplementedException", "InvalidOperationException"):
                return default
            raise self._converted(error, name) from error

    def _call(self, name: str, action: Callable[[], Any]) -> Any:
        try:
            return action()
        except Exception as error:
            raise self._converted(error, name) from error

    def _converted(self, error: Exception, name: str) -> DeviceError:
        # alpyca's exceptions have no common base; connection errors come from requests and are OSErrors.
        if isinstance(error, OSError):
            advice = "check that the server runs and that `camera.address` is host:port"
            return self.error(f"no reply ({type(error).__name__})", name, advice, DeviceLost)
        if type(error).__module__.startswith("alpaca."):
            reason = f"{type(error).__name__}: {single_line(str(error)[:200])}"
            return self.error(f"the server refuses ({reason})", name, "check the server")
        problem = f"unreadable reply ({type(error).__name__})"
        return self.error(problem, name, "check that `camera.address` is an Alpaca server")
