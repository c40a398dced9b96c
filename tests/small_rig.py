"""A small rig, its plan, a truth, and devices without a serial line, for the tests of plan, frames and scan."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import samples
import xarray as xr

from brdfpipe.bsdf import lambert_gauss
from brdfpipe.bsdf.registry import representation
from brdfpipe.rig.acquisition.devices.connection import RigDevices, connect
from brdfpipe.rig.acquisition.devices.errors import DeviceError
from brdfpipe.rig.acquisition.scan import Summary, scan
from brdfpipe.rig.emulator.emulated_rig import EmulatedRig
from brdfpipe.rig.emulator.emulated_scan import automatic_operator, restore_state
from brdfpipe.rig.plan import Arrangement, Plan
from brdfpipe.rig.raw_frame import RawFrame

RIG = """\
name: small
monochromator: {dialect: acton, port: /dev/ttyUSB0, query_timeout: TIMEOUT, motion_timeout: TIMEOUT}
wheel: {dialect: WHEEL, port: /dev/ttyUSB1, query_timeout: TIMEOUT, motion_timeout: TIMEOUT}
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


def write(folder: Path, plan: str = PLAN, *, wheel: str = "thorlabs", timeout: float = 60) -> Path:
    """Write a plan beside its rig. The devices may take a minute to reply, on however busy a machine."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "rig.yaml").write_text(RIG.replace("WHEEL", wheel).replace("TIMEOUT", f"{timeout:g}"))
    (folder / "fibres.csv").write_text(FIBRES)
    (folder / "plan.yaml").write_text(plan)
    return folder / "plan.yaml"


def truth(reflectance: float = 0.8) -> xr.Dataset:
    """A matt white tile."""
    return lambert_gauss.lambertian(samples.spectrum(reflectance))


# --- devices without a serial line


@dataclass
class FakeMonochromator:
    """Moves at once and records its moves; ``report`` may falsify the wavelength it reports."""

    state: float = 0.0
    moves: list[float] = field(default_factory=list)
    report: Callable[[float], float] = lambda state: state
    settings: dict[str, str] = field(default_factory=dict)

    def identify(self) -> str:
        return "fake monochromator"

    def describe(self) -> dict[str, str]:
        return self.settings

    def goto(self, wavelength: float) -> float:
        self.moves.append(wavelength)
        self.state = wavelength
        return self.wavelength()

    def wavelength(self) -> float:
        return self.report(self.state)

    def stop(self) -> None: ...

    def close(self) -> None: ...


@dataclass
class FakeWheel:
    state: int = 1
    moves: list[int] = field(default_factory=list)
    report: Callable[[int], int] = lambda state: state

    def identify(self) -> str:
        return "fake wheel"

    def describe(self) -> dict[str, str]:
        return {}

    def goto(self, position: int) -> int:
        self.moves.append(position)
        self.state = position
        return self.position()

    def position(self) -> int:
        return self.report(self.state)

    def close(self) -> None: ...


@dataclass
class FakeCamera:
    """Every pixel of an image holds the number of the exposure; ``before`` is called before each."""

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


def fake_bench(**devices: Any) -> RigDevices:
    return RigDevices(**{"monochromator": FakeMonochromator(), "wheel": FakeWheel(), "camera": FakeCamera(), **devices})


def failing(ordinals: set[int], error: Exception) -> Callable[[int], None]:
    """Raise an error at these exposures."""

    def before(number: int) -> None:
        if number in ordinals:
            raise error

    return before


def camera_error(problem: str = "no frame") -> DeviceError:
    return DeviceError("camera", problem)


def take(plan: Plan, bench: RigDevices, folder: Path, **options: Any) -> Summary:
    """A scan whose operator confirms everything, with a clock that always reads 0; the pictures of fake cameras are not judged."""
    plan = replace(plan, bad_frames="accept")
    return scan(plan, bench, folder, **{"clock": lambda: 0.0, "confirm": lambda arrangement, words: True, **options})


# --- the emulated rig


@dataclass
class RecordingCamera:
    """The emulated camera, which records the true state of the devices during each exposure."""

    rig: EmulatedRig
    states: dict[float, tuple[float, int, Arrangement]] = field(default_factory=dict)
    """Start of the exposure → wavelength, position and arrangement."""
    moved: list[float] = field(default_factory=list)
    """Starts of exposures during which a device moved."""

    def identify(self) -> str:
        return self.rig.camera.identify()

    def expose(self, seconds: float, *, shutter: bool = True) -> RawFrame:
        before = self._state()
        raw = self.rig.camera.expose(seconds, shutter=shutter)
        setup = self.rig.setup
        self.states[round(raw.started, 6)] = (*before, Arrangement(setup.load, setup.side, setup.entrance))
        if before != self._state():
            self.moved.append(round(raw.started, 6))
        return raw

    def _state(self) -> tuple[float, int]:
        return self.rig.monochromator.wavelength, self.rig.wheel.position


@contextmanager
def emulated(
    plan: Plan, *, folder: Path | None = None, seed: int = 1, **options: Any
) -> Iterator[tuple[EmulatedRig, RecordingCamera]]:
    """An emulated rig of a plan; with the folder of a run, in the state after its last finished frame."""
    with EmulatedRig(plan.rig, representation(truth()), seed=seed, **options) as rig:
        if folder is not None:
            restore_state(rig, plan, folder)
        yield rig, RecordingCamera(rig)


def take_emulated(plan: Plan, folder: Path, rig: EmulatedRig, camera: RecordingCamera, **options: Any) -> Summary:
    """A scan of an emulated rig over its ports."""
    with connect(rig.rig, camera=camera) as devices:
        return scan(plan, devices, folder, clock=rig.clock.now, confirm=automatic_operator(rig), **options)


def contents(folder: Path) -> dict[str, bytes]:
    """The frames of a run, by name."""
    return {path.name: path.read_bytes() for path in sorted((folder / "frames").iterdir())}
