"""Faults of serial lines: a plan of which command meets which, and the line that carries it out.

=================  ==========================================================================================================
kind               what happens to the command that meets it
=================  ==========================================================================================================
``silence``        carried out; nothing comes back, not even the echo
``garbage``        noise before its echo
``truncated``      carried out; the answer breaks off before its terminator, and the rest never comes
``clamp``          the move ends elsewhere, and is answered as if it had not; a command that moves nothing is spared
``late-ok``        carried out; its echo comes now, its answer only before the echo of the next command
``unplug``         carried out; the line goes dead behind its echo, and stays so until it is plugged in again
``wrong-device``   not carried out: another device answers from now on, until the line is plugged in again
=================  ==========================================================================================================

A move whose answer does not come is still under way when the driver gives up: its virtual time passes when the device is spoken to
again, and a frame exposed before that sees the beginning of the move.
"""

from __future__ import annotations

import random
import threading
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from brdfpipe.errors import BrdfpipeError
from brdfpipe.rig.emulator.instruments import Monochromator, ThorlabsWheel
from brdfpipe.rig.emulator.terminal import Instrument, commands

KINDS = ("silence", "garbage", "truncated", "clamp", "late-ok", "unplug", "wrong-device")


class FaultError(BrdfpipeError):
    """A plan of faults that cannot be."""


class Injected(NamedTuple):
    """A fault that happened."""

    ordinal: int
    """Of the command, counted from 1."""
    kind: str
    command: bytes


class Faults:
    """Which commands meet which fault: see :meth:`at` and :meth:`seeded`.

    One plan may serve several ports; it then counts the commands of all of them.
    """

    def __init__(self, plan: Mapping[int, str], rate: float, kinds: Sequence[str], seed: int) -> None:
        unknown = sorted({*plan.values(), *kinds} - {*KINDS})
        if unknown:
            raise FaultError(f"no kind of fault {unknown[0]!r}; accepted: {', '.join(KINDS)}")
        if any(ordinal < 1 for ordinal in plan):
            raise FaultError(f"no command has the ordinal {min(plan)}; accepted: 1 for the first, and so on")
        if not 0 <= rate <= 1 or (rate and not kinds):
            raise FaultError(
                f"faults at a rate of {rate} among {len(kinds)} kinds; accepted: 0 to 1, among one or more"
            )
        self._plan, self._rate, self._kinds = dict(plan), rate, tuple(kinds)
        self._random = random.Random(seed)
        self._commands = 0
        self._injected: list[Injected] = []
        self._lock = threading.Lock()

    @classmethod
    def at(cls, plan: Mapping[int, str], *, seed: int = 0) -> Faults:
        """Each fault once, at a command of that ordinal, counted from 1; the seed decides noise and where answers break off.

        Raises
        ------
        FaultError : an unknown kind, or an ordinal below 1.
        """
        return cls(plan, 0.0, (), seed)

    @classmethod
    def seeded(cls, seed: int, rate: float, kinds: Sequence[str] = KINDS) -> Faults:
        """A fault at every command with probability ``rate``, all ``kinds`` equally likely.

        Raises
        ------
        FaultError : an unknown kind, or a rate that is no probability.
        """
        return cls({}, rate, kinds, seed)

    @property
    def commands(self) -> int:
        """Commands that have begun."""
        return self._commands

    @property
    def injected(self) -> list[Injected]:
        """The faults that happened, in their order."""
        return list(self._injected)

    def draw(self) -> tuple[int, str]:
        """Ordinal of the command that begins, and the fault it meets; empty for none."""
        with self._lock:
            self._commands += 1
            kind = self._plan.get(self._commands, "")
            if self._rate and self._random.random() < self._rate:
                kind = self._random.choice(self._kinds)
            return self._commands, kind

    def record(self, ordinal: int, kind: str, command: bytes) -> None:
        """Note that a fault happened."""
        with self._lock:
            self._injected.append(Injected(ordinal, kind, command))

    def noise(self) -> bytes:
        """A few bytes of a bad line."""
        with self._lock:
            return self._random.randbytes(self._random.randint(1, 12))

    def cut(self, answer: bytes) -> bytes:
        """A beginning of an answer, without its end."""
        with self._lock:
            return answer[: self._random.randrange(len(answer))]


class FaultyLine:
    """A device behind a line that misbehaves.

    Parameters
    ----------
    instrument : the device
    faults : none by default
    stranger : who answers after ``wrong-device``; by default a device of the other dialect
    """

    def __init__(
        self, instrument: Instrument, faults: Faults | None = None, stranger: Instrument | None = None
    ) -> None:
        self.dead = False
        """Unplugged: what is fed is lost."""
        self._own = self._device = instrument
        self._faults = faults or Faults.at({})
        self._stranger = stranger or _other_dialect(instrument)
        self._late = b""
        self._forget()

    def feed(self, data: bytes) -> bytes:
        """What comes back for bytes that are sent."""
        came = b""
        for piece in commands(data):
            if self.dead:
                break
            came += self._serve(piece)
        return came

    def replug(self) -> None:
        """Plug the right device in again."""
        self.dead = False
        self._device = self._own
        self._late = b""
        self._forget()

    def _serve(self, piece: bytes) -> bytes:
        came, self._late = self._late, b""
        if not self._command:
            came += self._begin()
        self._command += piece
        self._device.astray = self._kind == "clamp"
        echo, answer = self._device.receive(piece)
        if self._kind == "silence":
            echo = b""
        if not piece.endswith(b"\r"):
            return came + echo
        return came + echo + self._end(answer)

    def _begin(self) -> bytes:
        self._ordinal, self._kind = self._faults.draw()
        if self._kind == "wrong-device":
            self._device = self._stranger
        return self._faults.noise() if self._kind == "garbage" else b""

    def _end(self, answer: bytes) -> bytes:
        kind, spared = self._kind, self._kind == "clamp" and self._device.astray
        self._device.astray = False
        if kind and not spared:
            self._faults.record(self._ordinal, kind, self._command)
        self._forget()
        if kind == "silence":
            return b""
        if kind == "late-ok":
            self._late = answer
            return b""
        if kind == "unplug":
            self.dead = True
            return b""
        self._device.settle()
        return self._faults.cut(answer) if kind == "truncated" else answer

    def _forget(self) -> None:
        self._command = b""
        self._ordinal, self._kind = 0, ""


def _other_dialect(instrument: Instrument) -> Instrument:
    return (Monochromator if isinstance(instrument, ThorlabsWheel) else ThorlabsWheel)(instrument.clock)
