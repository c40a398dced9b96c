"""Base of the drivers of serial devices: a command is repeated after a lost reply, once the device has been identified again.

A lost reply does not show whether the command was carried out. Before a command is repeated, the line is reset and the device identified:
devices answer in order, so a complete and correct identity proves that no earlier reply is still to come. Only queries and moves to an
absolute position are sent, which may be repeated.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from typing import ClassVar

from brdfpipe.rig.acquisition.devices.errors import DeviceError, NoEcho, NoReply, Refused, WrongDevice
from brdfpipe.rig.acquisition.devices.serial_line import Dialect, SerialLine

ATTEMPTS = 3
"""A command and two repetitions."""

ANY_REPLY = re.compile(r"(?s).*")
"""Reply to a move; its result is read back."""

POSITION = re.compile(r"\d{1,2}")

NAME = re.compile(r"[!-~][ -~]*")
_CHECK_PORT = "connect the device of the description to this port, or correct `port`, `dialect` or `serial_number`"


class SerialInstrument(ABC):
    """A device on a serial line, which :meth:`close` closes."""

    dialect: ClassVar[Dialect]

    def __init__(self, line: SerialLine) -> None:
        self.line = line
        self.settings = line.settings
        self._identity = ""

    @abstractmethod
    def read_identity(self) -> tuple[str, str]:
        """Model and serial number; empty where the device states none."""

    @abstractmethod
    def configure(self) -> None:
        """Apply the settings of the description and verify them."""

    def describe(self) -> dict[str, str]:
        """Settings that the driver leaves as they are but that decide the light, by name, as far as the device knows them."""
        return {}

    def identify(self) -> str:
        """Model and serial number, where the device states them. The device then has the settings of the description.

        Raises WrongDevice: a different device answers, or the serial number differs from the description; DeviceError: no reply, or a
        setting is not accepted.
        """
        attempt = 0
        while True:
            attempt += 1
            try:
                return self._identify_once()
            except NoReply as error:
                if attempt < ATTEMPTS:
                    continue
                if isinstance(error, Refused):  # every device of the dialect knows the command
                    details = (error.problem, error.command, error.reply, error.advice)
                    raise self.line.error(WrongDevice, *details) from error
                raise self._final_error(error) from error

    def ask(self, command: str, reply: re.Pattern[str], timeout: float) -> re.Match[str]:
        """Send a command until a reply of the expected form comes, at most :data:`ATTEMPTS` times.

        Parameters
        ----------
        command : a query, or a move to an absolute position
        reply : form of the whole reply
        timeout : seconds, of each attempt

        Raises
        ------
        NoReply : no reply of this form.
        WrongDevice : the device was exchanged.
        DeviceLost : the port was disconnected.
        """
        if not self._identity:
            self.identify()
        failures: list[NoReply] = []
        while len(failures) < ATTEMPTS:
            try:
                if failures:
                    self._identify_once()
                return self.ask_once(command, reply, timeout)
            except NoReply as failure:
                failures.append(failure)
        raise self._final_error(*failures)

    def ask_once(self, command: str, reply: re.Pattern[str], timeout: float | None = None) -> re.Match[str]:
        """One transaction, verified against the expected form; used while the device is identified. Default: the query timeout."""
        timeout = self.settings.query_timeout if timeout is None else timeout
        text = self.line.transact(command, timeout, empty=reply.fullmatch("") is not None)
        match = reply.fullmatch(text)
        if match is None:
            advice = "check the cable, and that the device of the description is connected"
            raise self.line.error(NoReply, "unexpected form of reply", command, text, advice)
        return match

    def ask_name(self, command: str) -> str:
        """Text with which the device identifies itself."""
        return self.ask_once(command, NAME)[0].strip()

    def close(self) -> None:
        """Close the port."""
        self.line.close()

    def mismatch(self, quantity: str, requested: object, reported: object, advice: str) -> DeviceError:
        """Error for a read-back that differs from the requested value."""
        problem = f"wrong {quantity}: requested {requested}, device reports {reported}"
        return self.line.error(DeviceError, problem, advice=advice)

    def _identify_once(self) -> str:
        """Reset the line, identify the device, and apply its settings, which a device that lost power has lost."""
        self.line.reset()
        names = self.read_identity() if self._identity else self._first_identity()
        identity = " ".join(filter(None, names))
        if identity != self._identity and self.read_identity() != names:
            raise self.line.error(NoReply, "the identity changes between two queries", reply=identity)
        if self._identity and identity != self._identity:
            problem = f"device exchanged: {identity!r} answers instead of {self._identity!r}"
            raise self.line.error(WrongDevice, problem, advice=_CHECK_PORT)
        if self.settings.serial_number not in ("", names[1], *identity.split()):
            problem = f"serial number of {identity!r} is not {self.settings.serial_number!r}"
            raise self.line.error(WrongDevice, problem, advice=_CHECK_PORT)
        self.configure()
        self._identity = identity
        return identity

    def _first_identity(self) -> tuple[str, str]:
        """The identity of a device of which it is not known yet in which case it takes commands, and whether it echoes them."""
        connection = self.line.connection
        before = connection.lower, connection.echoes
        failures: list[NoReply] = []
        for echoes in (True, False):
            for lower in self._cases():
                connection.lower, connection.echoes = lower, echoes
                try:
                    if failures:  # a unit of the other case refused even the command that switches the echo on
                        self.line.reset()
                    return self.read_identity()
                except NoEcho as error:
                    failures.append(error)
                    break
                except NoReply as error:
                    failures.append(error)
                    if not isinstance(error, Refused):
                        break
            if not isinstance(failures[-1], NoEcho):
                break
        connection.lower, connection.echoes = before
        raise failures[0] if isinstance(failures[-1], Refused) else failures[-1]

    def _cases(self) -> tuple[bool, ...]:
        """Whether commands are in lower case: the choices, the likelier first."""
        automatic = self.settings.case == "auto" and not self.line.dialect.lower
        lower = self.line.connection.lower
        return (lower, not lower) if automatic else (lower,)

    def _final_error(self, *failures: NoReply) -> DeviceError:
        """Error after the last attempt: another device answers, or how the first attempt failed."""
        foreign = next((failure for failure in failures if self.line.foreign_family(failure.reply)), None)
        failure, kind = (foreign, WrongDevice) if foreign else (failures[0], type(failures[0]))
        problem = failure.problem if foreign else f"{failure.problem}, {ATTEMPTS} times"
        return self.line.error(kind, problem, failure.command, failure.reply, failure.advice)


class SerialFilterWheel(SerialInstrument):
    """A filter wheel, whose positions count from 1."""

    stuck_advice = "check that the wheel turns freely"

    @abstractmethod
    def position(self) -> int:
        """Position that the wheel reports."""

    @abstractmethod
    def move(self, position: int) -> int:
        """Move once, wait, and return the position read back."""

    def recover(self) -> None:
        """Prepare for a second move after one that ended at another position."""

    def goto(self, position: int) -> int:
        """Move to a position from 1 on, wait, and read back; repeated once if the wheel reports another position.

        Raises DeviceError: no such position, another position reported, or no reply.
        """
        if position not in range(1, self.settings.positions + 1):
            advice = f"accepted: 1 to {self.settings.positions} (`wheel.positions` of the description)"
            raise self.line.error(DeviceError, f"no position {position!r}", advice=advice)
        if self.move(position) != position:
            self.recover()
            if (reported := self.move(position)) != position:
                raise self.mismatch("position", position, reported, self.stuck_advice)
        return int(position)
