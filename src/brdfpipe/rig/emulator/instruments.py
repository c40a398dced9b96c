"""Emulated monochromator and filter wheels.

Where manuals and transcripts leave the behaviour open, the device takes the choice that is harder for a driver:

- Acton: echo of every character but the CR; the answer begins with a space. Several words on a line give one `` ok``. A word that is
  unknown, or lacks its number, ends the line with ``WORD ? `` and clears all numbers. Wavelengths and speeds out of range are
  clamped without an error; a grating or filter that does not exist gives ok and no move. The wheel does not know ``MODEL``.
- Thorlabs: echo with its CR; the prompt comes when the wheel has arrived; no serial number in ``*idn?``. The count of positions can be set to
  that of another wheel.

References: Acton Research, SpectraPro SP-750i and FA-448 manuals (commands, ok on completion, shortest way); Princeton Instruments, IsoPlane
SCT 320 manual, appendix A; Thorlabs, FW102C/FW212C manual, rev. H, §5.2. Forms of the answers, clamps, durations: the drivers of
Odemis, yaqd-acton and fsc2 (SpectraPro 300i, FW212C), which quote transcripts. Answers of units without a motor: MSL-Equipment, ScopeFoundry.
Firmware 1.0 of the wheel: pylablib.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

from brdfpipe.rig.emulator.clock import VirtualClock
from brdfpipe.rig.emulator.serial_device import Motor, SerialDevice

_NUMBER = re.compile(rb"[+-]?(?:\d+\.?\d*|\.\d+)")

_TRAVEL = 1200 * 1400.0
"""Grooves per mm × longest wavelength [nm] of the sine drive."""

_SLOWEST, _DEFAULT_SPEED = 0.01, 100.0
"""Speeds of moves [nm/min]: the lowest, and the one after power-up."""

_GRATING_CHANGE = 20.0
"""Longest time of a turn of the turret [s], by the manual."""

_POLL = 0.1
"""Virtual time of a command during a ``>NM`` move [s]: without it a driver would poll for ever."""

_GRATING_NUMBERS = range(1, 10)

SERIAL_NUMBER = "2330123"
"""Serial number of a monochromator whose description states none."""


@dataclass(frozen=True)
class Grating:
    """A grating of the turret: grooves per mm, and blaze as printed by the device."""

    grooves: int
    blaze: str

    @property
    def longest(self) -> float:
        """Wavelength at the end of the drive [nm]."""
        return _TRAVEL / self.grooves


MIRRORS = {"EXIT-MIRROR": "front"}
SLITS = {"SIDE-ENT-SLIT": 480, "SIDE-EXIT-SLIT": 480}
"""Diverter mirrors and slits with a motor: position, and width [µm]."""

_NO_MOTOR = b" no motor\r\n"

GRATINGS = {1: Grating(1200, "500NM"), 2: Grating(600, "1.0UM")}


class _Acton(SerialDevice):
    """The Acton dialect: words separated by spaces, a number before the word that takes it."""

    def __init__(
        self, clock: VirtualClock, *, case: str, echo: bool, without: Collection[str], bare_refusal: bool
    ) -> None:
        super().__init__(clock)
        self._case = case
        self._echo = echo
        self._without = {word.encode() for word in without}
        self._bare_refusal = bare_refusal
        self._numbers: list[float] = []
        self._words: dict[bytes, Callable[[], bytes]] = {
            b"ECHO": partial(self._set_echo, True),
            b"NO-ECHO": partial(self._set_echo, False),
        }

    def echoed(self, piece: bytes) -> bytes:
        return piece.rstrip(b"\r") if self._echo else b""

    def answer(self, line: bytes) -> bytes:
        reply = b""
        for word in line.split():
            if _NUMBER.fullmatch(word):
                self._numbers.append(float(word))
                continue
            self.finish_move()
            try:
                reply += self._action(word)()
            except LookupError:
                self._numbers.clear()
                return b"?\r\n" if self._bare_refusal else reply + word + b" ? \r\n"
        return reply + b" ok\r\n"

    def _action(self, word: bytes) -> Callable[[], bytes]:
        accepted = {"any": word, "upper": word.upper(), "lower": word.lower()}[self._case]
        if word != accepted or word.upper() in self._without:
            raise LookupError
        return self._words[word.upper()]

    def _set_echo(self, echo: bool) -> bytes:
        self._echo = echo
        return b""


class Monochromator(_Acton):
    """A SpectraPro.

    Parameters
    ----------
    clock : virtual time
    wavelength : initial [nm]
    gratings : installed gratings by number, 1 to 9
    grating : number of the grating in use
    slew : highest speed [nm/s]
    case : ``any``, or the only accepted case: ``upper``, ``lower``
    echo : whether characters are echoed, as on RS-232 but not on USB
    without : words that this unit does not know, for example ``ECHO`` or ``SERIAL``
    bare_refusal : refuse an unknown word by ``?`` alone, without repeating it
    marker : byte that marks the grating in use: 0x1A, or 0xAF on other units
    model, serial_number : as reported
    turret : number of the installed turret
    mirrors : positions of the diverter mirrors that have a motor
    slits : widths of the slits that have a motor [µm]
    wheel : filter wheel on the same controller
    """

    def __init__(
        self,
        clock: VirtualClock,
        *,
        wavelength: float = 0.0,
        gratings: Mapping[int, Grating] = GRATINGS,
        grating: int = 1,
        slew: float = 100.0,
        case: str = "any",
        echo: bool = True,
        without: Collection[str] = (),
        bare_refusal: bool = False,
        marker: int = 0x1A,
        model: str = "SP-2-300i",
        serial_number: str = SERIAL_NUMBER,
        turret: int = 1,
        mirrors: Mapping[str, str] = MIRRORS,
        slits: Mapping[str, int] = SLITS,
        wheel: ActonWheel | None = None,
    ) -> None:
        super().__init__(clock, case=case, echo=echo, without=without, bare_refusal=bare_refusal)
        self._wheel = wheel
        self._designated = ""
        self.grating = grating
        self._gratings = dict(gratings)
        self._motor = Motor(clock, wavelength)
        self._slew = slew
        self._speed = _DEFAULT_SPEED
        self._marker = bytes([marker])
        slew_to, scan_to = (lambda: self._move(self._slew)), (lambda: self._move(self._speed / 60))
        self._words |= {
            b"GOTO": slew_to,
            b"<GOTO>": slew_to,
            b"NM": scan_to,
            b"<NM>": scan_to,
            b">NM": lambda: self._move(self._speed / 60, wait=False),
            b"?NM": lambda: f" {self.wavelength:.3f} nm ".encode(),
            b"NM/MIN": self._set_speed,
            b"?NM/MIN": lambda: f" {self._speed:.3f} nm/min ".encode(),
            b"MONO-?DONE": lambda: b" 1 " if self.clock.now() >= self._motor.arrival else b" 0 ",
            b"MONO-STOP": self._stop,
            b"GRATING": self._change_grating,
            b"?GRATING": lambda: f" {self.grating} ".encode(),
            b"?GRATINGS": self._list_gratings,
            b"MODEL": lambda: f" {model} ".encode("latin-1"),
            b"SERIAL": lambda: f" {serial_number} ".encode("latin-1"),
            b"?TURRET": lambda: f" {turret} ".encode(),
            b"?MIRROR": lambda: self._report(mirrors, ""),
            b"?MICRONS": lambda: self._report(slits, " um"),
            **{name.encode(): partial(self._designate, name, mirrors) for name in ("ENT-MIRROR", "EXIT-MIRROR")},
            **{
                name.encode(): partial(self._designate, name, slits)
                for name in (f"{side}-{end}-SLIT" for side in ("FRONT", "SIDE") for end in ("ENT", "EXIT"))
            },
            **({} if wheel is None else {word: partial(self._turn_wheel, word) for word in wheel.words}),
        }

    @property
    def wavelength(self) -> float:
        """Current wavelength [nm]."""
        return self._motor.position

    def restore(self, state: float) -> None:
        """Set the wavelength [nm], at rest."""
        self._motor.set(state)

    def answer(self, line: bytes) -> bytes:
        now, arrival = self.clock.now(), self._motor.arrival
        if now < arrival:
            self.clock.advance_to(min(now + _POLL, arrival))
        return super().answer(line)

    def _move(self, rate: float, *, wait: bool = True) -> bytes:
        target, longest = self._numbers.pop(), self._gratings[self.grating].longest
        if self._misses_move():
            target = 0.0 if target > longest / 2 else longest
        self._motor.go(min(max(target, 0.0), longest), rate)
        if wait:
            self._busy_until = self._motor.arrival
        return b""

    def _stop(self) -> bytes:
        self._motor.set(self._motor.position)
        return b""

    def _set_speed(self) -> bytes:
        self._speed = min(max(self._numbers.pop(), _SLOWEST), 60 * self._slew)
        return b""

    def _change_grating(self) -> bytes:
        number = self._numbers.pop()
        if number in self._gratings and number != self.grating and not self._misses_move():
            self.grating = int(number)
            self._motor.set(min(self.wavelength, self._gratings[self.grating].longest))
            self._busy_until = self.clock.now() + _GRATING_CHANGE
        return b""

    def _designate(self, name: str, motors: Mapping[str, object]) -> bytes:
        self._designated = name
        return b"" if name in motors else _NO_MOTOR

    def _report(self, motors: Mapping[str, object], unit: str) -> bytes:
        return f" {motors[self._designated]}{unit} ".encode() if self._designated in motors else _NO_MOTOR

    def _turn_wheel(self, word: bytes) -> bytes:
        assert self._wheel is not None
        self._wheel.miss_next_move = self.miss_next_move
        reply = self._wheel.carry_out(word, self._numbers)
        self.miss_next_move = self._wheel.miss_next_move
        return reply

    def finish_move(self) -> None:
        super().finish_move()
        if self._wheel is not None:
            self._wheel.finish_move()

    def _list_gratings(self) -> bytes:
        reply = b"\r\n"
        for number in _GRATING_NUMBERS:
            grating = self._gratings.get(number)
            text = f"{grating.grooves:4d} g/mm BLZ={grating.blaze:>7} " if grating else " Not Installed     "
            reply += (self._marker if number == self.grating else b" ") + f"{number} {text}\r\n".encode("latin-1")
        return reply


class _Wheel(SerialDevice):
    """A wheel of filters, numbered from 1, that turns the shorter way."""

    filters: range
    _motor: Motor

    @property
    def position(self) -> int:
        """Filter in the beam; the nearer one during a move."""
        return math.floor(self._motor.position - 0.5) % len(self.filters) + 1

    def restore(self, state: float) -> None:
        """Set the position, at rest."""
        self._motor.set(int(state))

    def _mount(self, positions: int, position: int) -> None:
        self.filters, self._motor = range(1, positions + 1), Motor(self.clock, position)

    def _turn(self, target: int, rate: float) -> None:
        """Start a move to a position, or to the next one for a missed move; ``rate``: filters per second."""
        count, position = len(self.filters), self._motor.position
        distance = (target + self._misses_move() - position + count / 2) % count - count / 2
        self._motor.go(position + distance, rate)
        self._busy_until = self._motor.arrival


class ActonWheel(_Acton, _Wheel):
    """An FA-448.

    Parameters
    ----------
    clock : virtual time
    positions : number of filters
    position : of the filter in the beam
    seconds : from one filter to the next
    case, echo, without, bare_refusal : as for :class:`Monochromator`
    """

    def __init__(
        self,
        clock: VirtualClock,
        *,
        positions: int = 6,
        position: int = 1,
        seconds: float = 1.0,
        case: str = "any",
        echo: bool = True,
        without: Collection[str] = (),
        bare_refusal: bool = False,
    ) -> None:
        super().__init__(clock, case=case, echo=echo, without=without, bare_refusal=bare_refusal)
        self._mount(positions, position)
        self._rate = 1 / seconds
        self._words |= {word: partial(self.carry_out, word, self._numbers) for word in self.words}

    words: ClassVar = (b"FILTER", b"?FILTER", b"FHOME")
    """Words of the wheel, which the controller of a monochromator may know too."""

    def carry_out(self, word: bytes, numbers: list[float]) -> bytes:
        """Carry out one of :attr:`words`, whose parameter is the last of the numbers."""
        if word == b"?FILTER":
            return f" {self.position} ".encode()
        return self._turn_if_present(numbers.pop() if word == b"FILTER" else 1)

    def _turn_if_present(self, target: float) -> bytes:
        if target in self.filters:
            self._turn(int(target), self._rate)
        return b""


class ThorlabsWheel(_Wheel):
    """An FW102C or FW212C.

    Parameters
    ----------
    clock : virtual time
    positions : 6 or 12
    position : of the filter in the beam
    version : of the firmware, as reported. Version 1.0 knows only ``*idn?``, ``pos`` and ``trig``, sends its prompt before a reply, too,
        and takes a command only after a line of its own prompt or an empty one
    count : number of positions that the wheel believes to have, as another program set it; by default the true one
    """

    def __init__(
        self,
        clock: VirtualClock,
        *,
        positions: int = 6,
        position: int = 1,
        version: str = "1.07",
        count: int | None = None,
    ) -> None:
        super().__init__(clock)
        self._mount(positions, position)
        self._identity = f"THORLABS FW102C/FW212C Filter Wheel version {version}"
        # A pseudo-terminal has no speed: it accepts only the present one.
        self._settings = {"speed": 1, "sensors": 0, "trig": 0, "pcount": count or positions, "baud": 1}
        self._choices = {"speed": (0, 1), "sensors": (0, 1), "trig": (0, 1), "pcount": (6, 12), "baud": (1,)}
        self._first_firmware = version == "1.0"
        if self._first_firmware:
            self._settings = {"trig": 0}
        self._ready = True

    def echoed(self, piece: bytes) -> bytes:
        return piece

    def answer(self, line: bytes) -> bytes:
        if self._first_firmware:
            ready, self._ready = self._ready, line in (b"", b">")
            if not ready:
                line = b""
        reply = self._carry_out(line.decode("latin-1"))
        lead = "\r> " if self._first_firmware else ""
        return f"{lead}{reply}\r> ".encode() if reply else b"> "

    def _carry_out(self, line: str) -> str:
        if line == "*idn?":
            return self._identity
        if line == "save":
            return ""
        if line == "pos?":
            return str(self.position)
        if line.endswith("?") and line[:-1] in self._settings:
            return str(self._settings[line[:-1]])
        keyword, equals, argument = line.partition("=")
        if not equals or keyword not in {"pos", *self._settings}:
            return "Command error CMD_NOT_DEFINED"
        value = int(argument) if re.fullmatch("[0-9]{1,3}", argument) else -1
        if value not in (self.filters if keyword == "pos" else self._choices[keyword]):
            return "Command error CMD_ARG_INVALID"
        if keyword == "pos":
            # About 1 s from filter to filter, 2 s at the slow speed.
            self._turn(value, 1.0 if self._settings.get("speed", 1) else 0.5)
        else:
            self._settings[keyword] = value
        return ""
