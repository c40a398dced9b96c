"""Opening the devices of a rig: monochromator, filter wheel and camera, and the tables of their drivers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass
from typing import TypeVar

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


@dataclass(frozen=True)
class RigDevices:
    """The devices of a rig, identified and ready."""

    monochromator: acton.Monochromator
    wheel: SerialFilterWheel
    camera: Camera


@contextmanager
def connect(rig: Rig, *, camera: Camera | None = None) -> Iterator[RigDevices]:
    """Open and identify the devices of a rig, for a ``with`` block; its end, or a refusal, closes the ports.

    ``camera`` replaces the described one, for example by the emulator's.

    Raises
    ------
    DeviceLost : a port is missing or in use by another program.
    WrongDevice : a device differs from the description.
    DeviceError : a device does not reply, or rejects a setting of the description.
    """
    with closing(open_monochromator(rig.monochromator)) as monochromator:
        monochromator.identify()
        with closing(open_wheel(rig.wheel, monochromator if rig.shared_port else None)) as wheel:
            wheel.identify()
            camera = camera or open_camera(rig.camera)
            camera.identify()
            yield RigDevices(monochromator, wheel, camera)


def open_monochromator(settings: SerialSettings) -> acton.Monochromator:
    """Driver of a monochromator on its open port; nothing has been sent yet."""
    return _open(MONOCHROMATORS, settings)


def open_wheel(settings: SerialSettings, controller: SerialInstrument | None = None) -> SerialFilterWheel:
    """Driver of a filter wheel on its open port, or on that of the device whose controller turns it; nothing has been sent yet."""
    return _open(WHEELS, settings, controller)


def open_camera(settings: CameraSettings) -> Camera:
    """Driver of the described camera. Raises DeviceError: a camera that only the emulator has."""
    if settings.kind not in CAMERAS:
        advice = f"run `brdfpipe rig emulate`, or set `camera.kind` to {' or '.join(CAMERAS)}"
        raise DeviceError("camera", f"no driver for a camera of kind {settings.kind!r}", advice=advice)
    return CAMERAS[settings.kind](settings)


def _open(
    drivers: Mapping[str, type[Driver]], settings: SerialSettings, controller: SerialInstrument | None = None
) -> Driver:
    driver = drivers[settings.dialect]
    dialects = [other.dialect for other in (*MONOCHROMATORS.values(), *WHEELS.values())]
    shared = None if controller is None else controller.line
    return driver(SerialLine(settings, driver.dialect, sharing=shared, other_dialects=dialects))
