"""Base of the emulated serial devices: commands that end with CR, their echo, and motors that move in virtual time."""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import NamedTuple

from brdfpipe.rig.emulator.clock import VirtualClock

_COMMAND = re.compile(rb"[^\r]*\r|[^\r]+")


def split_commands(data: bytes) -> Iterator[bytes]:
    """Split received bytes after every CR; the last piece may be an incomplete command."""
    return (match.group() for match in _COMMAND.finditer(data))


class SerialDevice(ABC):
    """A device on a serial line: bytes in, bytes out, moves in virtual time."""

    def __init__(self, clock: VirtualClock) -> None:
        self.clock = clock
        self.miss_next_move = False
        """The next move ends at a wrong position without an error; set by the fault ``clamp``."""
        self._line = b""
        self._busy_until = -math.inf

    def feed(self, data: bytes) -> bytes:
        """Reply to received bytes, after the virtual time of the moves it waits for."""
        reply = b""
        for piece in split_commands(data):
            echo, answer = self.receive(piece)
            self.finish_move()
            reply += echo + answer
        return reply

    def receive(self, piece: bytes) -> tuple[bytes, bytes]:
        """Echo of one piece, read when the device is not busy, and the answer that is due after the move it may have started."""
        self.finish_move()
        echo = self.echoed(piece)
        self._line += piece
        if not piece.endswith(b"\r"):
            return echo, b""
        line, self._line = self._line[:-1], b""
        return echo, self.answer(line)

    def finish_move(self) -> None:
        """Advance time until the device is no longer busy."""
        self.clock.advance_to(self._busy_until)

    @abstractmethod
    def echoed(self, piece: bytes) -> bytes:
        """Echo of a received piece."""

    @abstractmethod
    def answer(self, line: bytes) -> bytes:
        """Carry out a command (without CR) and return the answer with its terminator."""

    @abstractmethod
    def restore(self, state: float) -> None:
        """Set the position, at rest."""

    def _misses_move(self) -> bool:
        misses, self.miss_next_move = self.miss_next_move, False
        return misses


class Motor:
    """A motor of constant speed. The motion is one immutable value, so that the camera can read it from another thread at any time."""

    def __init__(self, clock: VirtualClock, position: float) -> None:
        self._clock = clock
        self._motion = _Motion(0.0, position, position, 1.0)

    @property
    def position(self) -> float:
        """Current position."""
        return self._motion.at(self._clock.now())

    @property
    def arrival(self) -> float:
        """End of the current or last move [s]."""
        return self._motion.end

    def go(self, target: float, rate: float) -> None:
        """Start a move from the current position at ``rate`` > 0 per second."""
        now = self._clock.now()
        self._motion = _Motion(now, self._motion.at(now), target, rate)

    def set(self, position: float) -> None:
        """Set the position, at rest."""
        self._motion = _Motion(self._clock.now(), position, position, 1.0)


class _Motion(NamedTuple):
    start: float
    origin: float
    target: float
    rate: float

    @property
    def end(self) -> float:
        return self.start + abs(self.target - self.origin) / self.rate

    def at(self, time: float) -> float:
        if time >= self.end:
            return self.target
        return self.origin + math.copysign(self.rate * max(0.0, time - self.start), self.target - self.origin)
