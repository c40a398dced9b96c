"""Refusals of devices: which one, on which port, what was sent, what came back, and what to do."""

from __future__ import annotations

from brdfpipe.errors import BrdfpipeError, printable

_SHOWN = 90


class DeviceError(BrdfpipeError):
    """A device did not do what it was told, or its reply cannot be trusted.

    Parameters
    ----------
    device : what it is in the rig (``monochromator``, ``filter wheel``, ``camera``)
    problem : what is wrong, in a few words
    port : serial port, folder or address
    command, reply : what was sent, and the bytes or text that came back
    advice : what a person can do
    """

    def __init__(
        self,
        device: str,
        problem: str,
        *,
        port: str = "",
        command: str = "",
        reply: bytes | str | None = None,
        advice: str = "",
    ) -> None:
        self.device = device
        self.problem = problem
        self.port = port
        self.command = command
        self.reply = reply
        self.advice = advice
        super().__init__(printable("; ".join(filter(None, (self.found, advice)))))

    @property
    def found(self) -> str:
        """The message without the advice."""
        place = f"{self.device} on {self.port}" if self.port else self.device
        parts = [f"{place}: {self.problem}"]
        if self.command:
            parts.append(f"sent {self.command!r}")
        if self.reply is not None:
            parts.append(f"got {_shown(self.reply)}")
        return printable("; ".join(parts))

    def __reduce__(self) -> tuple[object, ...]:
        # Errors cross process borders; the default would rebuild them from the message alone.
        parts = (self.device, self.problem, self.port, self.command, self.reply, self.advice)
        return (_rebuild, (type(self), *parts))


class DeviceLost(DeviceError):
    """The port is absent, held by another program, or went away."""


class WrongDevice(DeviceError):
    """Another device answers on the port."""


class NoReply(DeviceError):
    """No whole, readable reply came in time; the command may be repeated once the device is known to be in order."""


class Refused(NoReply):
    """The device answered that it does not know the command: another device, another case, or a character lost on the way."""


def visible(text: str) -> str:
    """Text from outside on one line, without what could steer a terminal."""
    return ascii(" ".join(text.split()))[1:-1]


def _shown(reply: bytes | str) -> str:
    if not reply:
        return "nothing"
    # Devices answer in one-byte characters.
    text = ascii(reply.decode("latin-1") if isinstance(reply, bytes) else reply)
    return text if len(text) <= _SHOWN else f"{text[: _SHOWN // 2]}…{text[-_SHOWN // 2 :]}"


def _rebuild(
    kind: type[DeviceError],
    device: str,
    problem: str,
    port: str,
    command: str,
    reply: bytes | str | None,
    advice: str,
) -> DeviceError:
    return kind(device, problem, port=port, command=command, reply=reply, advice=advice)
