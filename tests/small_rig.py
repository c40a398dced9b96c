"""A small rig, its plan, a truth, and devices without a line: what the tests of plan, frames and scan start from."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import samples
import xarray as xr

from brdfpipe.bsdf import lambert_gauss
from brdfpipe.rig.acquisition.devices.connection import RigDevices, connect
from brdfpipe.rig.acquisition.devices.errors import DeviceError
from brdfpipe.rig.acquisition.scan import Summary, scan
from brdfpipe.rig.emulator.effects import Effects
from brdfpipe.rig.emulator.emulated_rig import EmulatedRig
from brdfpipe.rig.emulator.emulated_scan import automatic_operator, restore_state
from brdfpipe.rig.plan import Arrangement, Plan
from brdfpipe.rig.raw_frame import RawFrame

RIG = """\
name: small
monochromator: {dialect: acton, port: /dev/ttyUSB0, query_timeout: 0.15, motion_timeout: 0.15}
wheel: {dialect: WHEEL, port: /dev/ttyUSB1, query_timeout: 0.15, motion_timeout: 0.15}
camera: {kind: drop-folder, folder: camera, width: 96, height: 72, timeout: 600}
nd_location: sample
filters: [{position: 1, transmittance: 1, u: 0}, {position: 2, transmittance: 0.1}, {position: 4, transmittance: 0.01}]
entrances: [0, 10, 20, 45]
fibres: {file: fibres.csv}
screen: {scale: 0.9, centre: [47.5, 35.5], reference: [45, 33], reference_radius: 3, fibre_radius: 2}
"""

FIBRES = """\
name,theta_s,phi_s,x,y
A,15,0,34,0
B,30,90,36,12
C,45,180,-36,10
D,60,270,-40,-12
"""

PLAN = """\
rig: rig.yaml
sample: tile
incidences: [20]
wavelengths: [500, 550]
bracket: [{exposure: 1, position: 2}, {exposure: 1, position: 1}]
drift: {every: 4}
"""


def write(folder: Path, plan: str = PLAN, *, wheel: str = "thorlabs") -> Path:
    """A plan beside its rig, in a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "rig.yaml").write_text(RIG.replace("WHEEL", wheel))
    (folder / "fibres.csv").write_text(FIBRES)
    (folder / "plan.yaml").write_text(plan)
    return folder / "plan.yaml"


def truth(reflectance: float = 0.8) -> xr.Dataset:
    """A matt white tile."""
    return lambert_gauss.lambertian(samples.spectrum(reflectance))


# --- devices without a line


@dataclass
class FakeMonochromator:
    """Goes where it is told, and remembers; what it says of itself may be bent."""

    place: float = 0.0
    moves: list[float] = field(default_factory=list)
    bend: Callable[[float], float] = lambda place: place

    def identify(self) -> str:
        return "fake monochromator"

    def goto(self, wavelength: float) -> float:
        self.moves.append(wavelength)
        self.place = wavelength
        return self.wavelength()

    def wavelength(self) -> float:
        return self.bend(self.place)

    def stop(self) -> None: ...

    def close(self) -> None: ...


@dataclass
class FakeWheel:
    place: int = 1
    moves: list[int] = field(default_factory=list)
    bend: Callable[[int], int] = lambda place: place

    def identify(self) -> str:
        return "fake wheel"

    def goto(self, position: int) -> int:
        self.moves.append(position)
        self.place = position
        return self.position()

    def position(self) -> int:
        return self.bend(self.place)

    def close(self) -> None: ...


@dataclass
class FakeCamera:
    """Its pictures hold the number of the exposure; what it does before it gives one may be bent."""

    shape: tuple[int, int] = (72, 96)
    exposures: list[tuple[float, bool]] = field(default_factory=list)
    before: Callable[[int], None] = lambda number: None
    started: Callable[[int], float] = lambda number: 1.7e9 + 10.0 * number

    def identify(self) -> str:
        return "fake camera"

    def expose(self, seconds: float, *, shutter: bool = True) -> RawFrame:
        number = len(self.exposures) + 1
        self.exposures.append((seconds, shutter))
        self.before(number)
        return RawFrame(np.full(self.shape, number, dtype=np.uint16), self.started(number), seconds, math.nan)


def fake_bench(**parts: Any) -> RigDevices:
    return RigDevices(
        parts.get("monochromator", FakeMonochromator()),
        parts.get("wheel", FakeWheel()),
        parts.get("camera", FakeCamera()),
    )


def failing(ordinals: set[int], error: Exception) -> Callable[[int], None]:
    """Raise an error at these exposures."""

    def before(number: int) -> None:
        if number in ordinals:
            raise error

    return before


def camera_error(problem: str = "no frame") -> DeviceError:
    return DeviceError("camera", problem)


def take(plan: Plan, bench: RigDevices, folder: Path, **options: Any) -> Summary:
    """A scan by an operator who agrees to everything, at a clock that stands."""
    told: dict[str, Any] = {"clock": lambda: 0.0, "confirm": lambda arrangement, words: True, **options}
    return scan(plan, bench, folder, **told)


# --- the emulated rig


@dataclass
class Witness:
    """The emulator's own log: where the devices truly were while each frame was exposed."""

    stand: EmulatedRig
    seen: dict[float, tuple[float, int, Arrangement]] = field(default_factory=dict)
    """Start of the exposure → wavelength, position, and what was arranged."""
    moved: list[float] = field(default_factory=list)
    """Starts of exposures during which a device moved."""

    def identify(self) -> str:
        return self.stand.camera.identify()

    def expose(self, seconds: float, *, shutter: bool = True) -> RawFrame:
        before = self._state()
        picture = self.stand.camera.expose(seconds, shutter=shutter)
        setup = self.stand.setup
        self.seen[round(picture.started, 6)] = (*before, Arrangement(setup.load, setup.side, setup.entrance))
        if before != self._state():
            self.moved.append(round(picture.started, 6))
        return picture

    def _state(self) -> tuple[float, int]:
        return self.stand.monochromator.wavelength, self.stand.wheel.position


@contextmanager
def emulated(
    plan: Plan, *, folder: Path | None = None, seed: int = 1, **options: Any
) -> Iterator[tuple[EmulatedRig, Witness]]:
    """An emulated rig of a plan; with the folder of a run, as it stood after the last finished frame of it."""
    with EmulatedRig(plan.rig, truth(), seed=seed, effects=options.pop("effects", Effects()), **options) as stand:
        if folder is not None:
            restore_state(stand, plan, folder)
        yield stand, Witness(stand)


def take_emulated(plan: Plan, folder: Path, stand: EmulatedRig, witness: Witness, **options: Any) -> Summary:
    """A scan of an emulated rig over its ports."""

    with connect(stand.rig, camera=witness) as bench:
        return scan(plan, bench, folder, clock=stand.clock.now, confirm=automatic_operator(stand), **options)


def contents(folder: Path) -> dict[str, bytes]:
    """The frames of a run, by name."""
    return {path.name: path.read_bytes() for path in sorted((folder / "frames").iterdir())}
