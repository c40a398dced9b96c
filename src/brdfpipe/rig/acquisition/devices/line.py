"""One transaction on a serial line: a command, its echo, and the reply up to its terminator.

The echo is the sync token. Whatever stands before it is noise, or the late answer to an earlier command that timed out; a reply
counts when it stands between the echo of its own command and the terminator, and nothing follows. The devices send no checksum,
so this, the strict form of each reply (:mod:`brdfpipe.rig.acquisition.devices.instrument`) and the read-back of each move are what there is.
"""

from __future__ import annotations

import errno
import os
import re
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

from brdfpipe.rig.acquisition.devices.errors import DeviceError, DeviceLost, NoReply, Refused
from brdfpipe.rig.description import SerialSettings

POLL = 0.05
"""Longest wait for a byte [s] before the deadline is looked at."""

QUIET = 0.1
"""Silence [s] after which nothing more is on its way: far above the 16 ms that USB converters hold bytes back."""

WRITE_TIMEOUT = 2.0
CHATTER = 2.0
"""A line that is not quiet after so many seconds is not one of ours."""

LONGEST = 16384
"""Bytes of a reply; the longest known, a list of nine gratings, has 300."""

Failure = TypeVar("Failure", bound=DeviceError)


class SerialPort(Protocol):
    """What is used of ``serial.Serial``."""

    @property
    def in_waiting(self) -> int: ...
    def read(self, size: int = 1, /) -> bytes: ...
    def write(self, data: bytes, /) -> int | None: ...
    def close(self) -> None: ...


@dataclass(frozen=True)
class Dialect:
    """How a family of devices is spoken to."""

    device: str
    """What it is in the rig."""
    family: str
    end: re.Pattern[bytes]
    """What ends a reply."""
    refusal: re.Pattern[bytes]
    """What a reply holds when the command is not known, its end included."""
    wake: tuple[str, ...]
    """Commands that put the line in order. The empty one ends whatever half a command an earlier program, or a lost
    character, left in the device."""
    lower: bool = False
    """Whether words are lower case whatever the description says."""


# Acton's RS-232 ports echo unless told not to, its USB ports only when told to.
_ACTON_END = re.compile(rb"\s(?:ok|\? ?)\r\n")
_ACTON_REFUSAL = re.compile(rb"\s\? ?\r\n")

DIALECTS = {
    "acton": Dialect("monochromator", "Acton", _ACTON_END, _ACTON_REFUSAL, ("", "ECHO")),
    "acton-wheel": Dialect("filter wheel", "Acton", _ACTON_END, _ACTON_REFUSAL, ("", "ECHO")),
    "thorlabs": Dialect(
        "filter wheel", "Thorlabs", re.compile(rb"[\r\n]> ?"), re.compile(rb"CMD_[A-Z_]+"), ("",), lower=True
    ),
}


class Line:
    """A serial line to one device, held by this program alone.

    Parameters
    ----------
    settings : port, speed, dialect
    open_port : called like ``serial.Serial``, which it is by default
    clock, sleep : seconds

    Raises
    ------
    DeviceLost : the port is absent, may not be opened, or is held by another program.
    """

    def __init__(
        self,
        settings: SerialSettings,
        open_port: Callable[..., SerialPort] | None = None,
        *,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.settings = settings
        self.dialect = DIALECTS[settings.dialect]
        self.clock = clock
        self.sleep = sleep
        self._port: SerialPort | None = self._opened(open_port or _serial())

    def transact(self, command: str, timeout: float) -> str:
        """Send a command and return its reply, without echo, terminator and the blanks about it.

        Parameters
        ----------
        command : without the carriage return; sent in the case the device wants
        timeout : seconds

        Raises
        ------
        NoReply : no echo, no terminator in time, or more than one reply.
        Refused : the device does not know the command.
        DeviceLost : the port went away.
        """
        command = self._spelled(command)
        self._drain(command)
        self._write(f"{command}\r".encode("latin-1"), command)
        echo = command.encode("latin-1")
        received = b""
        deadline = self.clock() + timeout
        while True:
            received += self._read(command)
            start = received.find(echo)
            ended = self.dialect.end.search(received, start + len(echo)) if start >= 0 else None
            if ended:
                break
            if start >= 0 and self.speaks(received[start:]):  # it will not end as ours do
                raise self._unanswered(command, received, timeout)
            if self.clock() >= deadline or len(received) > LONGEST:
                raise self._unanswered(command, received, timeout)
        if received[ended.end() :]:
            raise self.error(NoReply, "more than one reply", command, received)
        if self.dialect.refusal.search(received, start + len(echo)):
            spelling = "" if self.dialect.lower else f", and that `case: {self.settings.case}` is what it wants"
            advice = f"check that it is the device of the description{spelling}"
            raise self.error(Refused, "the command is not known", command, received, advice)
        return received[start + len(echo) : ended.start()].decode("latin-1").strip(" \r\n")

    def settle(self) -> None:
        """Put the line in order: end half-received commands, have the device echo, and wait until it is quiet.

        Raises
        ------
        NoReply : the line does not become quiet.
        DeviceLost : the port went away.
        """
        for command in map(self._spelled, self.dialect.wake):
            self._write(f"{command}\r".encode("latin-1"), command)
            received = b""
            begin = heard = self.clock()
            while self.clock() - heard < QUIET:
                if chunk := self._read(command):
                    received, heard = (received + chunk)[-LONGEST:], self.clock()
                if heard - begin > CHATTER:
                    advice = f"check the baud rate ({self.settings.baud}) and what is connected to the port"
                    raise self.error(NoReply, "the line does not become quiet", command, received, advice)

    def speaks(self, received: bytes | str | None) -> str:
        """The family whose refusal stands in what was received, if it is not the one of the description; else nothing."""
        if not isinstance(received, bytes):
            return ""
        others = (each for each in DIALECTS.values() if each.family != self.dialect.family)
        return next((each.family for each in others if each.refusal.search(received)), "")

    def error(
        self, kind: type[Failure], problem: str, command: str = "", reply: bytes | str | None = None, advice: str = ""
    ) -> Failure:
        """A refusal that names this device and its port."""
        return kind(self.dialect.device, problem, port=self.settings.port, command=command, reply=reply, advice=advice)

    def close(self) -> None:
        """Give the port back; may be called again."""
        port, self._port = self._port, None
        if port is not None:
            with suppress(OSError):  # a port that went away need not be given back
                port.close()

    def _spelled(self, command: str) -> str:
        lower = self.dialect.lower or self.settings.case == "lower"
        return command.lower() if lower else command.upper()

    def _drain(self, command: str) -> None:
        port = self._open(command)
        try:
            while waiting := port.in_waiting:
                port.read(waiting)
        except OSError as error:
            raise self._lost(error, command) from error

    def _read(self, command: str) -> bytes:
        port = self._open(command)
        try:
            return port.read(port.in_waiting or 1)
        except OSError as error:
            raise self._lost(error, command) from error

    def _write(self, content: bytes, command: str) -> None:
        port = self._open(command)
        try:
            port.write(content)
        except OSError as error:
            raise self._lost(error, command) from error

    def _open(self, command: str) -> SerialPort:
        if self._port is None:
            raise self.error(DeviceLost, "the port is closed", command, advice="plug the device in and start again")
        return self._port

    def _lost(self, error: OSError, command: str) -> DeviceLost:
        self.close()
        cause = error.strerror or str(error)
        advice = "check its cable and power, and that no other program reads from this port; then start again"
        return self.error(DeviceLost, f"the port went away ({cause})", command, advice=advice)

    def _unanswered(self, command: str, received: bytes, timeout: float) -> NoReply:
        baud = f"the baud rate ({self.settings.baud})"
        if family := self.speaks(received):
            problem, advice = f"a device of the {family} dialect answers", "correct `port` or `dialect`"
        elif not received:
            problem, advice = f"no answer in {timeout:g} s", f"check that it is switched on, its cable, and {baud}"
        elif command.encode("latin-1") not in received:
            problem = f"no echo of the command in {timeout:g} s"
            advice = f"check what is connected to the port, {baud}, and that its echo is on"
        else:
            problem = f"the reply did not end in {timeout:g} s"
            advice = "check its cable; a device that needs longer needs a longer timeout in the rig's description"
        return self.error(NoReply, problem, command, received, advice)

    def _opened(self, open_port: Callable[..., SerialPort]) -> SerialPort:
        settings = self.settings
        try:
            return open_port(
                port=settings.port,
                baudrate=settings.baud,
                timeout=POLL,
                write_timeout=WRITE_TIMEOUT,
                exclusive=True,
            )
        except (
            OSError,
            ValueError,
        ) as error:  # pyserial's own errors are OSErrors; a speed it cannot set is a ValueError
            problem, advice = _why_closed(error)
            raise self.error(DeviceLost, problem, advice=advice) from error


def _serial() -> Callable[..., Any]:
    import serial

    return serial.Serial


def _why_closed(error: OSError | ValueError) -> tuple[str, str]:
    """What keeps a port from being opened, and what to do; on Windows pyserial tells it in the text alone."""
    number, text = getattr(error, "errno", None), str(error)
    denied = number == errno.EACCES or "PermissionError" in text
    if number in (errno.EAGAIN, errno.EWOULDBLOCK, errno.EBUSY) or (denied and os.name == "nt"):
        return (
            "another program holds the port",
            "close the other program (a second scan, a terminal, the vendor's software)",
        )
    if denied:
        return (
            "no permission to open the port",
            "add your account to the group that owns it (often dialout), and log in again",
        )
    if number in (errno.ENOENT, errno.ENXIO, errno.ENODEV) or "FileNotFoundError" in text:
        return "there is no such port", f"plug the device in, or correct `port`; {_ports()}"
    return f"the port cannot be opened ({text})", f"check `port` and `baud`; {_ports()}"


def _ports() -> str:
    """The serial ports of this computer, for a person who looks for the right one."""
    from serial.tools import list_ports

    names = sorted(each.device for each in list_ports.comports())[:8]
    return f"this computer has {', '.join(names)}" if names else "this computer has no serial port now"
