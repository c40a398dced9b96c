"""Faults of serial lines: which command is affected, and how.

=================  ==========================================================================================================
kind               effect on the command
=================  ==========================================================================================================
``silence``        carried out; no reply, not even the echo
``garbage``        noise before its echo
``truncated``      carried out; the answer ends before its terminator
``clamp``          the move ends at a wrong position, with a normal answer; other commands are not affected
``late-ok``        carried out; the echo comes at once, the answer only before the echo of the next command
``unplug``         carried out; the line is dead after the echo, until the device is connected again
``wrong-device``   not carried out; another device answers, until the line is connected again
=================  ==========================================================================================================

A move without an answer is still in progress when the driver gives up. Its virtual time passes with the next command, and a frame exposed before
that sees the beginning of the move.
"""

from __future__ import annotations

import random
import threading
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from brdfpipe.rig.emulator.effects import EmulationError
from brdfpipe.rig.emulator.instruments import Monochromator, ThorlabsWheel
from brdfpipe.rig.emulator.serial_device import SerialDevice, split_commands

KINDS = ("silence", "garbage", "truncated", "clamp", "late-ok", "unplug", "wrong-device")


class InjectedFault(NamedTuple):
    """A fault that happened."""

    ordinal: int
    """Number of the command, from 1."""
    kind: str
    command: bytes


class Faults:
    """Faults by command: see :meth:`at` and :meth:`seeded`. One plan may serve several ports and then counts the commands of all.

    Raises EmulationError for an unknown kind, a number of a command below 1, or a rate outside 0 to 1.
    """

    def __init__(self, plan: Mapping[int, str], rate: float, kinds: Sequence[str], seed: int) -> None:
        unknown = sorted({*plan.values(), *kinds} - {*KINDS})
        if unknown:
            raise EmulationError(f"unknown kind of fault {unknown[0]!r}; accepted: {', '.join(KINDS)}")
        if any(ordinal < 1 for ordinal in plan):
            raise EmulationError(f"invalid number of a command: {min(plan)}; accepted: 1 or more")
        if not 0 <= rate <= 1 or (rate and not kinds):
            problem = f"invalid fault rate {rate} with {len(kinds)} kinds"
            raise EmulationError(f"{problem}; accepted: 0 to 1, with at least one kind")
        self._plan, self._rate, self._kinds = dict(plan), rate, tuple(kinds)
        self._random = random.Random(seed)
        self._commands = 0
        self._injected: list[InjectedFault] = []
        self._lock = threading.Lock()

    @classmethod
    def at(cls, plan: Mapping[int, str], *, seed: int = 0) -> Faults:
        """Each fault once, by the number of the command from 1; the seed determines the noise and where answers are truncated."""
        return cls(plan, 0.0, (), seed)

    @classmethod
    def seeded(cls, seed: int, rate: float, kinds: Sequence[str] = KINDS) -> Faults:
        """A fault at every command with probability ``rate``, all ``kinds`` equally likely."""
        return cls({}, rate, kinds, seed)

    @property
    def commands(self) -> int:
        """Number of commands so far."""
        return self._commands

    @property
    def injected(self) -> list[InjectedFault]:
        """Faults that happened, in order."""
        return list(self._injected)

    def draw(self) -> tuple[int, str]:
        """Number of the command that begins, and its fault; empty for none."""
        with self._lock:
            self._commands += 1
            kind = self._plan.get(self._commands, "")
            if self._rate and self._random.random() < self._rate:
                kind = self._random.choice(self._kinds)
            return self._commands, kind

    def record(self, ordinal: int, kind: str, command: bytes) -> None:
        """Record that a fault happened."""
        with self._lock:
            self._injected.append(InjectedFault(ordinal, kind, command))

    def noise(self) -> bytes:
        """Noise of a few bytes."""
        with self._lock:
            return self._random.randbytes(self._random.randint(1, 12))

    def truncate(self, answer: bytes) -> bytes:
        """Beginning of an answer, without its end."""
        with self._lock:
            return answer[: self._random.randrange(len(answer))]


class FaultyLine:
    """A device behind a line with faults; ``other_device`` answers after ``wrong-device``, by default one of the other dialect."""

    def __init__(
        self, device: SerialDevice, faults: Faults | None = None, other_device: SerialDevice | None = None
    ) -> None:
        self.dead = False
        """Disconnected: bytes fed are lost."""
        self._own = self._device = device
        self._faults = faults or Faults.at({})
        other_dialect = Monochromator if isinstance(device, ThorlabsWheel) else ThorlabsWheel
        self._other_device = other_device or other_dialect(device.clock)
        self._late_answer = b""
        self._clear_command()

    def feed(self, data: bytes) -> bytes:
        """Reply to bytes that are sent."""
        reply = b""
        for piece in split_commands(data):
            if self.dead:
                break
            reply += self._serve(piece)
        return reply

    def replug(self) -> None:
        """Connect the right device again."""
        self.dead = False
        self._device = self._own
        self._late_answer = b""
        self._clear_command()

    def _serve(self, piece: bytes) -> bytes:
        reply, self._late_answer = self._late_answer, b""
        if not self._command:
            reply += self._begin_command()
        self._command += piece
        self._device.miss_next_move = self._kind == "clamp"
        echo, answer = self._device.receive(piece)
        if self._kind == "silence":
            echo = b""
        if not piece.endswith(b"\r"):
            return reply + echo
        return reply + echo + self._end_command(answer)

    def _begin_command(self) -> bytes:
        self._ordinal, self._kind = self._faults.draw()
        if self._kind == "wrong-device":
            self._device = self._other_device
        return self._faults.noise() if self._kind == "garbage" else b""

    def _end_command(self, answer: bytes) -> bytes:
        kind, not_affected = self._kind, self._kind == "clamp" and self._device.miss_next_move
        self._device.miss_next_move = False
        if kind and not not_affected:
            self._faults.record(self._ordinal, kind, self._command)
        self._clear_command()
        if kind in ("silence", "late-ok", "unplug"):
            self._late_answer = answer if kind == "late-ok" else b""
            self.dead = kind == "unplug"
            return b""
        self._device.finish_move()
        return self._faults.truncate(answer) if kind == "truncated" else answer

    def _clear_command(self) -> None:
        self._command = b""
        self._ordinal, self._kind = 0, ""
