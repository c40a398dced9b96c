"""A serial port that plays a script: what the host must send and what it receives, in virtual time."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence

from brdfpipe.rig.acquisition.devices.connection import MONOCHROMATORS, WHEELS
from brdfpipe.rig.acquisition.devices.serial_line import POLL, SerialLine
from brdfpipe.rig.description import SerialSettings

Chunk = tuple[float, bytes]
"""Delay after the command [s], bytes."""

Exchange = tuple[bytes, bytes | Sequence[Chunk] | Exception]


class Clock:
    """Virtual seconds."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


class ScriptedPort:
    """Replacement of ``serial.Serial``: a read ends after POLL seconds without a byte."""

    def __init__(self, reply: Callable[[bytes], bytes | Sequence[Chunk] | Exception], clock: Clock) -> None:
        self.reply = reply
        self.clock = clock
        self.sent: list[bytes] = []
        self.closed = False
        self._coming: deque[Chunk] = deque()
        self._here = b""
        self._failure: Exception | None = None

    @property
    def in_waiting(self) -> int:
        self._arrive()
        if self._failure and not self._here:
            raise self._failure
        return len(self._here)

    def read(self, size: int = 1, /) -> bytes:
        if not self._here:
            due = self._coming[0][0] if self._coming else self.clock.now + POLL
            self.clock.now = max(self.clock.now, min(due, self.clock.now + POLL))
            self._arrive()
        if self._failure and not self._here:
            raise self._failure
        read, self._here = self._here[:size], self._here[size:]
        return read

    def write(self, data: bytes, /) -> int:
        if self.closed:
            raise OSError("the port is closed")
        if self._failure:
            raise self._failure
        self.sent.append(data)
        answer = self.reply(data)
        if isinstance(answer, Exception):
            self._failure = answer
            return len(data)
        chunks = [(0.0, answer)] if isinstance(answer, bytes) else answer
        self._coming.extend((self.clock.now + delay, content) for delay, content in chunks if content)
        return len(data)

    def close(self) -> None:
        self.closed = True

    def _arrive(self) -> None:
        while self._coming and self._coming[0][0] <= self.clock.now:
            self._here += self._coming.popleft()[1]


class Script:
    """Exchanges in order; any other command of the host fails the test."""

    def __init__(self, *exchanges: Exchange) -> None:
        self._left = deque(exchanges)

    def __call__(self, sent: bytes) -> bytes | Sequence[Chunk] | Exception:
        assert self._left, f"the host sent {sent!r} after the end of the script"
        expected, reply = self._left.popleft()
        assert sent == expected, f"the host sent {sent!r}, the script expects {expected!r}"
        return reply

    @property
    def finished(self) -> bool:
        return not self._left


def line_on_port(settings: SerialSettings, open_port: Callable[..., ScriptedPort], clock: Clock) -> SerialLine:
    """The line of a described device, on any port."""
    drivers = {**MONOCHROMATORS, **WHEELS}
    dialects = [driver.dialect for driver in drivers.values()]
    dialect = drivers[settings.dialect].dialect
    return SerialLine(settings, dialect, open_port, other_dialects=dialects, clock=clock, sleep=clock.sleep)


def scripted_line(
    settings: SerialSettings, reply: Callable[[bytes], bytes | Sequence[Chunk] | Exception], clock: Clock | None = None
) -> SerialLine:
    """The line of a described device, on a port that plays a script."""
    clock = clock or Clock()
    return line_on_port(settings, lambda **_: ScriptedPort(reply, clock), clock)
