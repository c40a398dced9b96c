"""Transactions on a serial line: a command, its echo, and the reply up to its terminator.

The echo synchronizes commands and replies. Bytes before it are noise, or the late reply to an earlier command that timed out. A reply is
accepted only between the echo of its own command and the terminator, with nothing after it. The devices send no checksum: the echo, the
strict form of each reply (:mod:`brdfpipe.rig.acquisition.devices.serial_instrument`) and the read-back after each move replace it.

Some controllers echo nothing. There, a reply counts once the line is silent, and only if it is alone. A late reply cannot go unnoticed for
long: a query is never answered in the form of a move, and no two queries of an identification have the same form.
"""

from __future__ import annotations

import errno
import os
import re
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

from brdfpipe.rig.acquisition.devices.errors import DeviceError, DeviceLost, NoEcho, NoReply, Refused
from brdfpipe.rig.description import SerialSettings

if TYPE_CHECKING:
    from serial import Serial

POLL = 0.05
"""Longest wait for a byte [s] between two checks of the deadline."""

QUIET = 0.1
"""Silence [s] after which no more bytes are expected: far above the 16 ms for which USB converters hold bytes back."""

WRITE_TIMEOUT = 2.0
"""Seconds after which a line that takes no bytes is an error."""

LONGEST_NOISE = 2.0
"""Seconds after which a line that is still not quiet is an error."""

LONGEST_REPLY = 16384
"""Bytes; the longest known reply, a list of nine gratings, has 300."""

Failure = TypeVar("Failure", bound=DeviceError)


@dataclass(frozen=True)
class Dialect:
    """Form of the commands and replies of a family of devices."""

    device: str
    """``monochromator`` or ``filter wheel``."""
    family: str
    end: re.Pattern[bytes]
    """Terminator of a reply, searched after the echo."""
    refusal: re.Pattern[bytes]
    """Reply to an unknown command, terminator included. It must match no reply of another family: it identifies a device that is
    connected to the wrong port."""
    wake: tuple[str, ...] = ("",)
    """Commands that reset the line. The empty one terminates a partial command left by an earlier program or a lost character."""
    lower: bool = False
    """Whether commands are always lower case, regardless of ``case`` in the description."""
    lead: re.Pattern[bytes] | None = None
    """What may come between the echo and a reply that is not empty."""


@dataclass
class Connection:
    """An open port, and how the controller behind it speaks; shared by the devices of one controller."""

    port: Serial | None
    """None once it is closed."""
    lower: bool
    """Whether commands are sent in lower case."""
    echoes: bool = True
    prelude: str | None = None
    """Line that is sent, and its answer ignored, before each command."""


class SerialLine:
    """A serial line to one device, opened exclusively. Raises DeviceLost: no such port, no permission, or used by another program.

    Parameters
    ----------
    settings : port, speed, case
    dialect : of the device
    open_port : called like ``serial.Serial``, the default
    sharing : line of another device of the same controller, whose port is used
    other_dialects : of devices that may be connected by mistake
    clock, sleep : seconds
    """

    def __init__(
        self,
        settings: SerialSettings,
        dialect: Dialect,
        open_port: Callable[..., Serial] | None = None,
        *,
        sharing: SerialLine | None = None,
        other_dialects: Sequence[Dialect] = (),
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.settings = settings
        self.dialect = dialect
        self.clock = clock
        self.sleep = sleep
        self._foreign = [other for other in other_dialects if other.family != dialect.family]
        if sharing is None:
            self.connection = Connection(self._open(open_port), dialect.lower or settings.case == "lower")
        else:
            self.connection = sharing.connection

    def transact(self, command: str, timeout: float, *, empty: bool = True) -> str:
        """Send a command and return its reply within ``timeout`` seconds, without echo, terminator and surrounding blanks.

        The command has no carriage return; it is sent in the case that the device requires. ``empty``: whether the reply may be empty.

        Raises
        ------
        NoReply : no echo, no terminator in time, or more than one reply.
        Refused : the device does not know the command.
        DeviceLost : the port was disconnected.
        """
        command = self._in_case(command)
        if (prelude := self.connection.prelude) is not None:
            self._write(prelude)
            self._await_silence(prelude)
        self._write(command, discard_input=True)
        received = b""
        last_byte = self.clock()
        deadline = last_byte + timeout
        while True:
            if chunk := self._read(command):
                received, last_byte = received + chunk, self.clock()
            body = self._after_echo(command, received)
            if body is not None and not empty and self.dialect.lead is not None:
                body = self.dialect.lead.sub(b"", body, count=1)
            ended = None if body is None else self.dialect.end.search(body)
            # Without the order that an echo gives, a reply must be alone.
            if ended and (self.connection.echoes or self.clock() - last_byte >= QUIET):
                break
            # Replies of another dialect never end with this one's terminator.
            foreign = body is not None and self.foreign_family(body)
            late = self.clock() >= deadline and not ended
            if foreign or late or len(received) > LONGEST_REPLY:
                raise self._no_reply(command, received, timeout)
        assert body is not None
        return self._text(command, body, received)

    def reset(self) -> None:
        """Terminate partial commands, switch the echo on, and wait until the line is quiet.

        Raises NoReply: the line does not become quiet; DeviceLost: the port was disconnected.
        """
        for command in map(self._in_case, self.dialect.wake):
            self._write(command)
            self._await_silence(command)

    def foreign_family(self, received: bytes | str | None) -> str:
        """Family of another dialect whose refusal was received; empty if there is none."""
        if not isinstance(received, bytes):
            return ""
        return next((dialect.family for dialect in self._foreign if dialect.refusal.search(received)), "")

    def error(
        self, kind: type[Failure], problem: str, command: str = "", reply: bytes | str | None = None, advice: str = ""
    ) -> Failure:
        """An error that names this device and its port."""
        return kind(self.dialect.device, problem, port=self.settings.port, command=command, reply=reply, advice=advice)

    def close(self) -> None:
        """Close the port; may be called again."""
        port, self.connection.port = self.connection.port, None
        if port is not None:
            with suppress(OSError):  # a disconnected port need not be closed
                port.close()

    def _in_case(self, command: str) -> str:
        return command.lower() if self.connection.lower else command.upper()

    def _after_echo(self, command: str, received: bytes) -> bytes | None:
        """What follows the echo; None before it. Everything, where the controller echoes nothing."""
        if not self.connection.echoes:
            return received
        echo = command.encode("latin-1")
        start = received.find(echo)
        return None if start < 0 else received[start + len(echo) :]

    def _text(self, command: str, body: bytes, received: bytes) -> str:
        """The reply in what follows the echo. Raises NoReply: more than one; Refused."""
        # A refusal may repeat the unknown word.
        echoed = not self.connection.echoes and command and body.lstrip().startswith(command.encode("latin-1"))
        if echoed and not self.dialect.refusal.search(body):
            raise self.error(NoReply, "an echo of a device that echoed nothing before", command, received)
        ended = self.dialect.end.search(body)
        if ended is None or body[ended.end() :]:
            raise self.error(NoReply, "more than one reply", command, received)
        if self.dialect.refusal.search(body):
            # The dialect decides the case, or the description, or each was tried.
            stated = not self.dialect.lower and self.settings.case != "auto"
            case = f" and that `case: {self.settings.case}` is right" if stated else ""
            advice = f"check that the device of the description is connected{case}"
            raise self.error(Refused, "unknown command", command, received, advice)
        return body[: ended.start()].decode("latin-1").strip(" \r\n")

    def _await_silence(self, command: str) -> None:
        received = b""
        start = last_byte = self.clock()
        while self.clock() - last_byte < QUIET:
            if chunk := self._read(command):
                received, last_byte = (received + chunk)[-LONGEST_REPLY:], self.clock()
            if last_byte - start > LONGEST_NOISE:
                advice = f"check the baud rate ({self.settings.baud}) and which device is connected"
                raise self.error(NoReply, "the line does not become quiet", command, received, advice)

    def _read(self, command: str) -> bytes:
        with self._open_port(command) as port:
            return port.read(port.in_waiting or 1)

    def _write(self, command: str, *, discard_input: bool = False) -> None:
        with self._open_port(command) as port:
            while discard_input and (waiting := port.in_waiting):
                port.read(waiting)
            port.write(f"{command}\r".encode("latin-1"))

    @contextmanager
    def _open_port(self, command: str) -> Iterator[Serial]:
        """The port; closed, with DeviceLost, if it was disconnected."""
        if self.connection.port is None:
            raise self.error(DeviceLost, "the port is closed", command, advice="connect the device and start again")
        try:
            yield self.connection.port
        except OSError as error:
            self.close()
            problem = f"the port was disconnected ({error.strerror or error})"
            advice = "check cable and power, and that no other program reads from this port; then start again"
            raise self.error(DeviceLost, problem, command, advice=advice) from error

    def _no_reply(self, command: str, received: bytes, timeout: float) -> NoReply:
        baud = f"the baud rate ({self.settings.baud})"
        kind: type[NoReply] = NoReply
        if family := self.foreign_family(received):
            problem, advice = f"a device of the {family} dialect answers", "correct `port` or `dialect`"
        elif not received:
            problem, advice = f"no reply in {timeout:g} s", f"check that it is switched on, its cable, and {baud}"
        elif self._after_echo(command, received) is None:
            problem = f"no echo of the command in {timeout:g} s"
            advice = f"check which device is connected, {baud}, and that its echo is on"
            kind = NoEcho if self.dialect.end.search(received) else NoReply
        else:
            problem = f"incomplete reply after {timeout:g} s"
            advice = "check its cable; if the device needs more time, raise its timeout in rig.yaml"
        return self.error(kind, problem, command, received, advice)

    def _open(self, open_port: Callable[..., Serial] | None) -> Serial:
        from serial import Serial

        settings = self.settings
        try:
            return (open_port or Serial)(
                port=settings.port, baudrate=settings.baud, timeout=POLL, write_timeout=WRITE_TIMEOUT, exclusive=True
            )
        except (OSError, ValueError) as error:  # pyserial raises OSErrors, and a ValueError for an impossible speed
            problem, advice = _explain_open_failure(error)
            raise self.error(DeviceLost, problem, advice=advice) from error


def _explain_open_failure(error: OSError | ValueError) -> tuple[str, str]:
    """Problem and advice; on Windows pyserial states the reason in the text alone."""
    number, text = getattr(error, "errno", None), str(error)
    denied = number == errno.EACCES or "PermissionError" in text
    if number in (errno.EAGAIN, errno.EWOULDBLOCK, errno.EBUSY) or (denied and os.name == "nt"):
        advice = "close the other program (a second scan, a terminal, the manufacturer's software)"
        return "the port is in use by another program", advice
    if denied:
        advice = "add your account to the group that owns the port (often dialout), and log in again"
        return "no permission to open the port", advice
    if number in (errno.ENOENT, errno.ENXIO, errno.ENODEV) or "FileNotFoundError" in text:
        return "the port does not exist", f"connect the device, or correct `port`; {_available_ports()}"
    return f"the port cannot be opened ({text})", f"check `port` and `baud`; {_available_ports()}"


def _available_ports() -> str:
    from serial.tools import list_ports

    names = sorted(port.device for port in list_ports.comports())[:8]
    return f"available ports: {', '.join(names)}" if names else "this computer has no serial port"
