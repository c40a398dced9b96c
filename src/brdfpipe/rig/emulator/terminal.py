"""What emulated devices share: a command line that ends with CR, its echo, and motors whose place is a function of virtual time."""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass

from brdfpipe.rig.emulator.clock import VirtualClock

_COMMAND = re.compile(rb"[^\r]*\r|[^\r]+")


def commands(data: bytes) -> Iterator[bytes]:
    """Cut what arrives behind every CR; the last piece may be the beginning of a command."""
    return (match.group() for match in _COMMAND.finditer(data))


class Instrument(ABC):
    """A device at the far end of a serial line: bytes in, bytes out, moves in virtual time."""

    def __init__(self, clock: VirtualClock) -> None:
        self.clock = clock
        self.astray = False
        """Its next move will end elsewhere without a word: what the fault ``clamp`` sets."""
        self._line = b""
        self._ready = -math.inf

    def feed(self, data: bytes) -> bytes:
        """What it sends in return for bytes that arrive; moves it waits for have taken their virtual time."""
        sent = b""
        for piece in commands(data):
            echo, answer = self.receive(piece)
            self.settle()
            sent += echo + answer
        return sent

    def receive(self, piece: bytes) -> tuple[bytes, bytes]:
        """Take one piece of :func:`commands`: its echo, and the answer due when the move it may have begun is over.

        A device that is still busy reads on only when it has arrived.
        """
        self.settle()
        echo = self.echoed(piece)
        self._line += piece
        if not piece.endswith(b"\r"):
            return echo, b""
        line, self._line = self._line[:-1], b""
        return echo, self.answer(line)

    def settle(self) -> None:
        """Let time pass until it is no longer busy."""
        self.clock.advance_to(self._ready)

    @abstractmethod
    def echoed(self, piece: bytes) -> bytes:
        """What it repeats of what it hears."""

    @abstractmethod
    def answer(self, line: bytes) -> bytes:
        """Carry out a command without its CR; the answer, with its terminator."""

    @abstractmethod
    def restore(self, state: float) -> None:
        """Put it where it stood, at once and at rest."""

    def _goes_astray(self) -> bool:
        astray, self.astray = self.astray, False
        return astray


class Drive:
    """A motor of constant speed.

    The motion is one immutable value, replaced whole: the camera may look from another thread at any moment.
    """

    def __init__(self, clock: VirtualClock, place: float) -> None:
        self._clock = clock
        self._motion = _Motion(0.0, place, place, 1.0)

    @property
    def place(self) -> float:
        """Where it is now."""
        return self._motion.at(self._clock.now())

    @property
    def arrival(self) -> float:
        """When it comes or came to rest [s]."""
        return self._motion.end

    def go(self, target: float, rate: float) -> None:
        """Set out from where it is, at ``rate`` > 0 per second."""
        now = self._clock.now()
        self._motion = _Motion(now, self._motion.at(now), target, rate)

    def put(self, place: float) -> None:
        """Be there, at rest."""
        self._motion = _Motion(self._clock.now(), place, place, 1.0)


@dataclass(frozen=True)
class _Motion:
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
