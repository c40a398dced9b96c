"""Opening the devices of a rig: monochromator, filter wheel and camera, and the tables of their drivers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from types import TracebackType
from typing import Protocol, TypeVar

from brdfpipe.rig.acquisition.devices import acton, thorlabs
from brdfpipe.rig.acquisition.devices.alpaca_camera import AlpacaCamera
from brdfpipe.rig.acquisition.devices.camera import Camera
from brdfpipe.rig.acquisition.devices.drop_folder import DropFolder
from brdfpipe.rig.acquisition.devices.errors import DeviceError
from brdfpipe.rig.acquisition.devices.serial_instrument import SerialFilterWheel, SerialInstrument
from brdfpipe.rig.acquisition.devices.serial_line import SerialLine
from brdfpipe.rig.description import CameraSettings, Rig, SerialSettings

MONOCHROMATORS: dict[str, type[acton.Monochromator]] = {"acton": acton.Monochromator}
WHEELS: dict[str, type[SerialFilterWheel]] = {"acton-wheel": acton.FilterWheel, "thorlabs": thorlabs.FilterWheel}
"""``dialect`` of the description → driver."""

CAMERAS: dict[str, Callable[[CameraSettings], Camera]] = {"drop-folder": DropFolder, "alpaca": AlpacaCamera}
"""``camera.kind`` of the description → driver."""

Driver = TypeVar("Driver", bound=SerialInstrument)


class Monochromator(Protocol):
    """Interface of a monochromator; every method raises DeviceError."""

    def identify(self) -> str:
        """Model and serial number; raises WrongDevice if a different device answers."""

    def goto(self, wavelength: float) -> float:
        """Move [nm], wait, read back; returns the wavelength read back, within 0.5 nm of the requested one."""

    def wavelength(self) -> float:
        """Current wavelength [nm]."""

    def stop(self) -> None:
        """Stop a move."""

    def close(self) -> None:
        """Close the port."""


class FilterWheel(Protocol):
    """Interface of a filter wheel; every method raises DeviceError."""

    def identify(self) -> str:
        """Model and serial number; raises WrongDevice if a different device answers."""

    def goto(self, position: int) -> int:
        """Move, wait, read back; returns the position read back, which is the requested one."""

    def position(self) -> int:
        """Current position."""

    def close(self) -> None:
        """Close the port."""


@dataclass(frozen=True)
class RigDevices:
    """The devices of a rig, identified and ready; close them, or use a ``with`` block."""

    monochromator: Monochromator
    wheel: FilterWheel
    camera: Camera
    _opened: ExitStack = field(repr=False, default_factory=ExitStack)

    def close(self) -> None:
        """Close the ports; may be called again."""
        self._opened.close()

    def __enter__(self) -> RigDevices:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()


def connect(rig: Rig, *, camera: Camera | None = None) -> RigDevices:
    """Open and identify the devices of a rig.

    Parameters
    ----------
    rig : the description
    camera : replaces the described one, e.g. the emulator's

    Raises
    ------
    DeviceLost : a port is missing or in use by another program.
    WrongDevice : a device differs from the description.
    DeviceError : a device does not reply, or rejects a setting of the description. No port stays open.
    """
    with ExitStack() as opened:
        monochromator = open_monochromator(rig.monochromator)
        opened.callback(monochromator.close)
        monochromator.identify()
        wheel = open_wheel(rig.wheel)
        opened.callback(wheel.close)
        wheel.identify()
        camera = camera or open_camera(rig.camera)
        camera.identify()
        return RigDevices(monochromator, wheel, camera, opened.pop_all())


def open_monochromator(settings: SerialSettings) -> Monochromator:
    """Driver of a monochromator on its open port; nothing has been sent yet."""
    return _open(MONOCHROMATORS, settings)


def open_wheel(settings: SerialSettings) -> FilterWheel:
    """Driver of a filter wheel on its open port; nothing has been sent yet."""
    return _open(WHEELS, settings)


def open_camera(settings: CameraSettings) -> Camera:
    """Driver of the described camera.

    Raises
    ------
    DeviceError : a camera that only the emulator has.
    """
    if settings.kind not in CAMERAS:
        advice = f"run `brdfpipe rig emulate`, or set `camera.kind` to {' or '.join(CAMERAS)}"
        raise DeviceError("camera", f"no driver for a camera of kind {settings.kind!r}", advice=advice)
    return CAMERAS[settings.kind](settings)


def _open(drivers: Mapping[str, type[Driver]], settings: SerialSettings) -> Driver:
    driver = drivers[settings.dialect]
    dialects = [other.dialect for other in (*MONOCHROMATORS.values(), *WHEELS.values())]
    return driver(SerialLine(settings, driver.dialect, other_dialects=dialects))
