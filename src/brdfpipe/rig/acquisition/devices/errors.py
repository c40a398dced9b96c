"""Device errors: which device, on which port, what was sent, what came back, and what to do."""

from __future__ import annotations

from functools import partial

from brdfpipe.errors import BrdfpipeError, printable

_LONGEST_REPLY = 90


class DeviceError(BrdfpipeError):
    """A device did not carry out a command, or its reply is invalid.

    Parameters
    ----------
    device : ``monochromator``, ``filter wheel`` or ``camera``
    problem : what is wrong, in a few words
    port : serial port, folder or address
    command, reply : what was sent, and the bytes or text that came back
    advice : what the operator can do
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
        super().__init__(printable("; ".join(filter(None, (self.summary, advice)))))

    @property
    def summary(self) -> str:
        """The message without the advice."""
        place = f"{self.device} on {self.port}" if self.port else self.device
        parts = [f"{place}: {self.problem}"]
        if self.command:
            parts.append(f"sent {self.command!r}")
        if self.reply is not None:
            parts.append(f"got {_abbreviated(self.reply)}")
        return printable("; ".join(parts))

    def __reduce__(self) -> tuple[object, ...]:
        # The default would rebuild an unpickled error from the message alone.
        rebuild = partial(type(self), port=self.port, command=self.command, reply=self.reply, advice=self.advice)
        return rebuild, (self.device, self.problem)


class DeviceLost(DeviceError):
    """The port is missing, in use by another program, or was disconnected."""


class WrongDevice(DeviceError):
    """A different device answers on the port."""


class NoReply(DeviceError):
    """No complete, valid reply in time; the command may be repeated after the device has been identified again."""


class Refused(NoReply):
    """The device does not know the command: a different device, the wrong case, or a lost character."""


class NoEcho(NoReply):
    """A complete reply without the echo of the command: noise before it, or a controller that echoes nothing."""


def single_line(text: str) -> str:
    """Untrusted text on one line, without control characters."""
    return ascii(" ".join(text.split()))[1:-1]


def _abbreviated(reply: bytes | str) -> str:
    if not reply:
        return "nothing"
    # Devices answer in one-byte characters.
    text = ascii(reply.decode("latin-1") if isinstance(reply, bytes) else reply)
    return text if len(text) <= _LONGEST_REPLY else f"{text[: _LONGEST_REPLY // 2]}…{text[-_LONGEST_REPLY // 2 :]}"
