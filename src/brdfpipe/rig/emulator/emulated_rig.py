"""The emulated rig: serial devices on pseudo-terminals, and a camera that sees the light they transmit."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import replace
from typing import Self

import numpy as np

from brdfpipe.geometry import Array
from brdfpipe.rig.acquisition.devices.camera import check_exposure
from brdfpipe.rig.description import Rig
from brdfpipe.rig.emulator.clock import VirtualClock
from brdfpipe.rig.emulator.dialects import emulated_devices
from brdfpipe.rig.emulator.effects import Effects, EmulationError, random_stream
from brdfpipe.rig.emulator.faults import Faults
from brdfpipe.rig.emulator.optics import Optics
from brdfpipe.rig.emulator.port import Port
from brdfpipe.rig.emulator.sample_holder import Etalon, Setup, Truth, check_setup
from brdfpipe.rig.emulator.sensor import Sensor
from brdfpipe.rig.raw_frame import RawFrame
from brdfpipe.rig.turned_mirror import Aim

READOUT = 1.0
"""Seconds to read out a frame."""

_SAMPLING_TIMES = (1 / 6, 1 / 2, 5 / 6)
"""Fractions of an exposure at which lamp and devices are sampled, so that a move during the exposure blurs the frame."""


class EmulatedRig:
    """A rig as described, with the imperfections of a real one.

    Inside a ``with`` block the devices answer on pseudo-terminals, whose paths are in :attr:`rig`. :meth:`restore` sets their state without a
    serial line. Equal seed, session, description and sequence of states give equal frames, byte for byte: the noise of a frame depends on
    the number of frames before it, everything else on virtual time.

    Parameters
    ----------
    rig : the description
    truth : the sample, :func:`brdfpipe.bsdf.registry.representation` of a ``bsdf`` dataset. None: a sample that reflects nothing
    seed : of all random properties, 0 or more. Raises EmulationError for a negative seed or session
    session : of the properties that change from day to day: registration, drift of the lamp, error of the certificate; 0 or more
    effects : imperfections of the rig
    faults : of the serial lines; one plan for both
    etalon : as certified
    clock : default: starts at 0, when lamp and camera are switched on
    dialect : of the controllers, one of :data:`brdfpipe.rig.emulator.dialects.DIALECTS`
    """

    def __init__(
        self,
        rig: Rig,
        truth: Truth | None,
        *,
        seed: int = 0,
        session: int = 0,
        effects: Effects | None = None,
        faults: Faults | None = None,
        etalon: Etalon | None = None,
        clock: VirtualClock | None = None,
        dialect: str = "usual",
    ) -> None:
        if seed < 0 or session < 0:
            raise EmulationError(f"negative seed or session: {seed}, {session}; accepted: 0 or more")
        effects = effects or Effects()
        self.rig = replace(rig, camera=replace(rig.camera, kind="emulated"))
        self.clock = clock or VirtualClock()
        self.monochromator, self.wheel = emulated_devices(rig, self.clock, dialect)
        self.optics = Optics(rig, truth, effects, seed=seed, session=session, etalon=etalon or Etalon())
        self.setup = Setup(rig.entrances[0])
        self.camera = EmulatedCamera(self, Sensor(rig.camera, effects, seed), seed, session)
        self._faults = faults
        self._opened = ExitStack()

    def set_entrance(
        self, sigma: float, *, load: str = "sample", side: str = "reflection", aim: Aim | None = None
    ) -> None:
        """Manual arrangement: mirrors, and object in the holder. Raises EmulationError if it is impossible.

        Parameters
        ----------
        sigma : entrance [degree]; the normal of the etalon points to it
        load : ``sample``, ``etalon``, ``target`` (the angular target of the description), ``mirror``, ``dark-trap``, which absorbs all light, or
            ``line-lamp``, which burns in place of the rig's lamp
        side : ``reflection``, or ``transmission`` with the hemisphere behind the sample
        aim : direction about the mirror direction to which the mirror is turned to send the light
        """
        self.setup = check_setup(Setup(float(sigma), load, side, aim), self.rig)

    def restore(self, time: float, wavelength: float, position: int, frames: int) -> None:
        """Restore the state after a frame was read. Raises EmulationError if the time is past.

        Parameters
        ----------
        time : virtual time at which the next frame may start [s]: start and exposure time of that frame, and :data:`READOUT`
        wavelength, position : of the devices
        frames : number of frames exposed so far
        """
        if time < self.clock.now():
            raise EmulationError(f"cannot return to {time:g} s: virtual time is {self.clock.now():g} s")
        self.clock.advance_to(time)
        self.monochromator.restore(wavelength)
        self.wheel.restore(position)
        self.camera.frames = frames

    def __enter__(self) -> Self:
        with ExitStack() as opened:
            monochromator = opened.enter_context(Port(self.monochromator, self._faults, name="monochromator"))
            wheel = monochromator
            if not self.rig.shared_port:
                wheel = opened.enter_context(Port(self.wheel, self._faults, name="wheel"))
            self._opened = opened.pop_all()
        self.ports = monochromator, wheel
        settings = (replace(self.rig.monochromator, port=monochromator.path), replace(self.rig.wheel, port=wheel.path))
        self.rig = replace(self.rig, monochromator=settings[0], wheel=settings[1])
        return self

    def __exit__(self, *error: object) -> None:
        self.clock.release()
        self._opened.close()


class EmulatedCamera:
    """Camera of an emulated rig, a :class:`brdfpipe.rig.acquisition.devices.camera.Camera`."""

    def __init__(self, rig: EmulatedRig, sensor: Sensor, seed: int, session: int) -> None:
        self._rig, self._sensor, self._seed, self._session = rig, sensor, seed, session
        self.frames = 0
        """Number of frames exposed so far."""

    def identify(self) -> str:
        """Name the camera."""
        settings = self._rig.rig.camera
        return f"emulated camera, {settings.width} x {settings.height} pixels"

    def expose(self, seconds: float, *, shutter: bool = True) -> RawFrame:
        """Expose and read out, in virtual time; raises DeviceError if the exposure time is out of range."""
        check_exposure(seconds)
        clock = self._rig.clock
        started = clock.now()
        states: dict[tuple[float, int], float] = {}
        for fraction in _SAMPLING_TIMES:
            clock.advance_to(started + fraction * seconds)
            state = self._rig.monochromator.wavelength, self._rig.wheel.position
            lamp = float(self._rig.optics.illumination.lamp(started + fraction * seconds)) / len(_SAMPLING_TIMES)
            states[state] = states.get(state, 0.0) + lamp
        temperature = self._sensor.temperature(started)
        light = seconds * self._light(states) if shutter else np.zeros(())
        noise = random_stream(self._seed, "frame", self._session, self.frames)
        counts = self._sensor.read(self._sensor.expected(light, seconds, temperature), noise)
        clock.advance_to(started + seconds + READOUT)
        self.frames += 1
        return RawFrame(counts, started, seconds, temperature)

    def _light(self, states: Mapping[tuple[float, int], float]) -> Array:
        """Electrons per second, summed over the states of the devices: (wavelength, position) → light of the lamp."""
        optics, setup = self._rig.optics, self._rig.setup
        return np.sum([lamp * optics.rates(setup, *state) for state, lamp in states.items()], axis=0)
