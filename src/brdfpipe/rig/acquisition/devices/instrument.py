"""A device that is asked again when a reply is lost, after it has shown that it is in order and still the same.

A lost reply does not say what the device did. Before a command is repeated, the line is put in order and the device is asked who
it is: devices answer in the order they are asked, so a name, whole and right, proves that no earlier reply is still to come. Only
queries and moves to a stated place are sent, which may be repeated.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod

from brdfpipe.rig.acquisition.devices.errors import DeviceError, NoReply, Refused, WrongDevice
from brdfpipe.rig.acquisition.devices.line import Line

ATTEMPTS = 3
"""A command and two repetitions."""

ANYTHING = re.compile(r"(?s).*")
"""The reply to a move: what it did is read back."""

_NAME = re.compile(r"[!-~][ -~]*")


class Instrument(ABC):
    """A device on a serial line.

    Parameters
    ----------
    line : held and closed by the instrument
    """

    def __init__(self, line: Line) -> None:
        self.line = line
        self.settings = line.settings
        self._identity = ""

    def identify(self) -> str:
        """Model and serial number, as far as the device tells them; it is then ready, with the settings of the description.

        Raises
        ------
        WrongDevice : another device answers, or one that has not the serial number of the description.
        DeviceError : no answer, or a setting that it does not take.
        """
        failure: NoReply | None = None
        for _ in range(ATTEMPTS):
            try:
                return self._introduced()
            except NoReply as error:
                failure = error
        assert failure is not None
        if isinstance(failure, Refused):  # a word that all devices of the dialect know
            parts = (failure.problem, failure.command, failure.reply, failure.advice)
            raise self.line.error(WrongDevice, *parts) from failure
        raise self._given_up(failure)

    def ask(self, command: str, reply: re.Pattern[str], timeout: float) -> re.Match[str]:
        """Send a command until a reply of the right form comes, at most :data:`ATTEMPTS` times.

        Parameters
        ----------
        command : a query, or a move to a stated place
        reply : the whole reply's form
        timeout : seconds, of each attempt

        Raises
        ------
        NoReply : none came.
        WrongDevice : the device was exchanged meanwhile.
        DeviceLost : the port went away.
        """
        if not self._identity:
            self.identify()
        failures: list[NoReply] = []
        for attempt in range(ATTEMPTS):
            try:
                if attempt:
                    self._introduced()
                return self._once(command, reply, timeout)
            except NoReply as failure:
                failures.append(failure)
        raise self._given_up(*failures)

    def close(self) -> None:
        """Give the port back."""
        self.line.close()

    @abstractmethod
    def _names(self) -> tuple[str, str]:
        """Model and serial number, or whatever else the device tells of itself; empty where it tells none."""

    @abstractmethod
    def _prepare(self) -> None:
        """Bring the device to the settings of the description, and check that it took them."""

    def _once(self, command: str, reply: re.Pattern[str], timeout: float | None = None) -> re.Match[str]:
        """One transaction with a reply of the right form; the timeout is that of queries by default."""
        text = self.line.transact(command, self.settings.query_timeout if timeout is None else timeout)
        found = reply.fullmatch(text)
        if found is None:
            advice = "check its cable, and that it is the device of the description"
            raise self.line.error(NoReply, "a reply of another form", command, text, advice)
        return found

    def _name(self, command: str) -> str:
        """A name the device tells of itself."""
        return self._once(command, _NAME)[0].strip()

    def _introduced(self) -> str:
        """Put the line in order, make sure of the device, and of its settings: one that lost its power lost them."""
        self.line.settle()
        names = self._names()
        identity = " ".join(filter(None, names))
        if identity != self._identity and self._names() != names:
            raise self.line.error(NoReply, "it tells another name each time", reply=identity)
        if self._identity and identity != self._identity:
            problem = f"{identity!r} answers where {self._identity!r} did"
            raise self.line.error(WrongDevice, problem, advice=_REPLUG)
        if self.settings.serial_number not in ("", names[1], *identity.split()):
            problem = f"{identity!r} has not the serial number {self.settings.serial_number!r}"
            raise self.line.error(WrongDevice, problem, advice=_REPLUG)
        self._prepare()
        self._identity = identity
        return identity

    def _given_up(self, *failures: NoReply) -> DeviceError:
        """What to tell after the last attempt: that another device answers, or how the first attempt failed."""
        foreign = next((each for each in failures if self.line.speaks(each.reply)), None)
        told, kind = (foreign, WrongDevice) if foreign else (failures[0], type(failures[0]))
        problem = told.problem if foreign else f"{told.problem}, {ATTEMPTS} times"
        return self.line.error(kind, problem, told.command, told.reply, told.advice)

    def _mismatch(self, what: str, asked: object, found: object, advice: str) -> DeviceError:
        return self.line.error(DeviceError, f"{what}: asked for {asked}, it says {found}", advice=advice)


_REPLUG = "connect the device of the description to this port, or correct `port`, `dialect` or `serial_number`"
