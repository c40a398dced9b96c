"""The devices of a rig: monochromator, filter wheel and camera, opened together and given back together."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from types import TracebackType
from typing import Protocol

from brdfpipe.rig.acquisition.devices import acton, thorlabs
from brdfpipe.rig.acquisition.devices.camera import Camera, Picture, open_camera, serve_folder
from brdfpipe.rig.acquisition.devices.errors import DeviceError, DeviceLost, NoReply, Refused, WrongDevice
from brdfpipe.rig.acquisition.devices.line import Line
from brdfpipe.rig.description import Rig, SerialSettings

__all__ = [
    "Bench",
    "Camera",
    "DeviceError",
    "DeviceLost",
    "FilterWheel",
    "Monochromator",
    "NoReply",
    "Picture",
    "Refused",
    "WrongDevice",
    "connect",
    "open_camera",
    "open_monochromator",
    "open_wheel",
    "serve_folder",
]


class Monochromator(Protocol):
    """What the scan needs of a monochromator; every method raises DeviceError."""

    def identify(self) -> str:
        """Model and serial number; raises WrongDevice if it is another device."""

    def goto(self, wavelength: float) -> float:
        """Move [nm], wait, read back; returns what was read back, within 0.5 nm of what was asked."""

    def wavelength(self) -> float:
        """The wavelength it is at [nm]."""

    def stop(self) -> None:
        """Stop a move."""

    def close(self) -> None:
        """Give the port back."""


class FilterWheel(Protocol):
    """What the scan needs of a filter wheel; every method raises DeviceError."""

    def identify(self) -> str:
        """Model and serial number; raises WrongDevice if it is another device."""

    def goto(self, position: int) -> int:
        """Move, wait, read back; returns what was read back, which is what was asked."""

    def position(self) -> int:
        """The position it is at."""

    def close(self) -> None:
        """Give the port back."""


_MONOCHROMATORS: dict[str, Callable[[Line], Monochromator]] = {"acton": acton.Monochromator}
_WHEELS: dict[str, Callable[[Line], FilterWheel]] = {
    "acton-wheel": acton.FilterWheel,
    "thorlabs": thorlabs.FilterWheel,
}


@dataclass(frozen=True)
class Bench:
    """The devices of a rig, identified and ready; close it, or use it in a ``with`` block."""

    monochromator: Monochromator
    wheel: FilterWheel
    camera: Camera
    _opened: ExitStack = field(repr=False, default_factory=ExitStack)

    def close(self) -> None:
        """Give the ports back; may be called again."""
        self._opened.close()

    def __enter__(self) -> Bench:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()


def connect(rig: Rig, *, camera: Camera | None = None) -> Bench:
    """Open and identify the devices of a rig.

    Parameters
    ----------
    rig : the description
    camera : instead of the one described, as the emulator's

    Raises
    ------
    DeviceLost : a port is absent or held by another program.
    WrongDevice : another device than the described one answers.
    DeviceError : a device does not answer, or does not take a setting of the description. No port stays open.
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
        return Bench(monochromator, wheel, camera, opened.pop_all())


def open_monochromator(settings: SerialSettings) -> Monochromator:
    """A monochromator's driver on its open port; it has not been spoken to."""
    return _MONOCHROMATORS[settings.dialect](Line(settings))


def open_wheel(settings: SerialSettings) -> FilterWheel:
    """A filter wheel's driver on its open port; it has not been spoken to."""
    return _WHEELS[settings.dialect](Line(settings))
