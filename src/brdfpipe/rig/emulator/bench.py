"""The emulated rig: devices on pseudo-terminals, a lamp, and a camera that sees the light they let pass."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import replace
from types import TracebackType
from typing import Self

import numpy as np
import xarray as xr

from brdfpipe.geometry import Array
from brdfpipe.rig.acquisition.devices.camera import Picture, check_exposure
from brdfpipe.rig.description import Rig
from brdfpipe.rig.emulator.clock import VirtualClock
from brdfpipe.rig.emulator.effects import Effects, stream
from brdfpipe.rig.emulator.faults import Faults
from brdfpipe.rig.emulator.holder import EmulationError, Etalon, Setup, check
from brdfpipe.rig.emulator.instruments import GRATINGS, ActonWheel, Monochromator, ThorlabsWheel
from brdfpipe.rig.emulator.optics import Optics
from brdfpipe.rig.emulator.port import Port
from brdfpipe.rig.emulator.sensor import Sensor

READOUT = 1.0
"""Seconds that reading a frame takes."""

_INSTANTS = (1 / 6, 1 / 2, 5 / 6)
"""Of an exposure, at which the camera looks at lamp and devices: a move that is under way smears."""


class EmulatedRig:
    """A rig that behaves as its description says, and as rigs do.

    Inside a ``with`` block its devices answer on pseudo-terminals, whose paths :attr:`rig` has. Outside of one the same devices can be
    put anywhere by :meth:`restore`, without a line.

    Parameters
    ----------
    rig : the description
    truth : kind ``bsdf``, what lies in the holder as the sample
    seed : of all that is random, 0 or more
    session : what stays for a day: registration, wandering of the lamp, error of the certificate; 0 or more
    effects : what the rig does to its light
    faults : that befall the lines; one plan for both
    etalon : as certified
    clock : by default one that begins at 0, when lamp and camera are switched on

    Raises
    ------
    VocabularyError : the truth is no bsdf.
    EmulationError : a seed or session below 0.

    Notes
    -----
    The same seed, session, description and sequence of states give the same frames, byte for byte: the noise of a frame is keyed by how
    many were exposed before it, and everything else by virtual time.
    """

    def __init__(
        self,
        rig: Rig,
        truth: xr.Dataset,
        *,
        seed: int = 0,
        session: int = 0,
        effects: Effects | None = None,
        faults: Faults | None = None,
        etalon: Etalon | None = None,
        clock: VirtualClock | None = None,
    ) -> None:
        if seed < 0 or session < 0:
            raise EmulationError(f"seed {seed}, session {session}; accepted: 0 or more")
        effects = Effects() if effects is None else effects
        self.rig = replace(rig, camera=replace(rig.camera, kind="emulated"))
        self.clock = clock or VirtualClock()
        self.monochromator = _monochromator(rig, self.clock)
        self.wheel = _wheel(rig, self.clock)
        self.optics = Optics(rig, truth, effects, seed=seed, session=session, etalon=etalon or Etalon())
        self.setup = Setup(rig.entrances[0])
        self.camera = EmulatedCamera(self, Sensor(rig.camera, effects, seed), seed, session)
        self._faults = faults
        self._opened = ExitStack()

    def set_entrance(self, sigma: float, *, load: str = "sample", side: str = "reflection") -> None:
        """The operator's hands: mirrors, and what lies in the holder.

        Parameters
        ----------
        sigma : entrance the light comes through [degree]; the etalon turns its normal to it
        load : ``sample``, ``etalon``, ``target`` (the angular one of the description), or ``dark-trap``, which swallows all light
        side : ``reflection``, or ``transmission`` with the hemisphere behind the sample

        Raises
        ------
        EmulationError : the rig cannot be arranged so.
        """
        self.setup = check(Setup(float(sigma), load, side), self.rig)

    def restore(self, time: float, wavelength: float, position: int, frames: int) -> None:
        """Be as a rig that has stood still since a frame was read.

        Parameters
        ----------
        time : virtual time at which the next frame may begin [s]: that frame's beginning, its exposure and :data:`READOUT`
        wavelength, position : where the devices stand
        frames : exposed so far

        Raises
        ------
        EmulationError : that time is past.
        """
        if time < self.clock.now():
            raise EmulationError(f"it is {self.clock.now():g} s already; {time:g} s cannot come again")
        self.clock.advance_to(time)
        self.monochromator.restore(wavelength)
        self.wheel.restore(position)
        self.camera.frames = frames

    def __enter__(self) -> Self:
        with ExitStack() as opened:
            monochromator = opened.enter_context(Port(self.monochromator, self._faults, name="monochromator"))
            wheel = opened.enter_context(Port(self.wheel, self._faults, name="wheel"))
            self._opened = opened.pop_all()
        self.ports = monochromator, wheel
        self.rig = replace(
            self.rig,
            monochromator=replace(self.rig.monochromator, port=monochromator.path),
            wheel=replace(self.rig.wheel, port=wheel.path),
        )
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.clock.release()
        self._opened.close()


class EmulatedCamera:
    """The camera of an emulated rig: :class:`brdfpipe.rig.acquisition.devices.connection.Camera`."""

    def __init__(self, bench: EmulatedRig, sensor: Sensor, seed: int, session: int) -> None:
        self._bench, self._sensor, self._seed, self._session = bench, sensor, seed, session
        self.frames = 0
        """Exposed so far."""

    def identify(self) -> str:
        """Name the camera."""
        settings = self._bench.rig.camera
        return f"emulated camera, {settings.width} x {settings.height} pixels"

    def expose(self, seconds: float, *, shutter: bool = True) -> Picture:
        """Expose and read out, in virtual time.

        Raises
        ------
        DeviceError : the exposure is out of range.
        """
        check_exposure(seconds)
        clock = self._bench.clock
        started = clock.now()
        states: dict[tuple[float, int], float] = {}
        for instant in _INSTANTS:
            clock.advance_to(started + instant * seconds)
            state = self._bench.monochromator.wavelength, self._bench.wheel.position
            lamp = float(self._bench.optics.source.lamp(started + instant * seconds)) / len(_INSTANTS)
            states[state] = states.get(state, 0.0) + lamp
        temperature = self._sensor.temperature(started)
        light = seconds * self._light(states) if shutter else np.zeros(())
        noise = stream(self._seed, "frame", self._session, self.frames)
        counts = self._sensor.read(self._sensor.expected(light, seconds, temperature), noise)
        clock.advance_to(started + seconds + READOUT)
        self.frames += 1
        return Picture(counts, started, seconds, temperature)

    def _light(self, states: Mapping[tuple[float, int], float]) -> Array:
        """Electrons a second of the lamp's light in each state of the devices, all together."""
        optics, setup = self._bench.optics, self._bench.setup
        return np.sum([lamp * optics.rates(setup, *state) for state, lamp in states.items()], axis=0)


def _monochromator(rig: Rig, clock: VirtualClock) -> Monochromator:
    """One that is as the description has it."""
    settings = rig.monochromator
    gratings = {settings.grating: GRATINGS[1], **GRATINGS} if settings.grating else GRATINGS
    if settings.serial_number:
        return Monochromator(clock, gratings=gratings, serial_number=settings.serial_number)
    return Monochromator(clock, gratings=gratings)


def _wheel(rig: Rig, clock: VirtualClock) -> ActonWheel | ThorlabsWheel:
    kind = ThorlabsWheel if rig.wheel.dialect == "thorlabs" else ActonWheel
    return kind(clock, positions=rig.wheel.positions)
