"""A device on a pseudo-terminal, which any program opens as it would open a serial port."""

from __future__ import annotations

import os
import select
import tempfile
import threading
import tty
from collections import deque
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Self

from brdfpipe.errors import BrdfpipeError
from brdfpipe.rig.emulator.faults import Faults, FaultyLine
from brdfpipe.rig.emulator.terminal import Instrument

_CHUNK = 4096


class PortError(BrdfpipeError):
    """The system gives no pseudo-terminal."""


class Port:
    """An emulated device on a serial port, served by a thread until it is closed.

    Parameters
    ----------
    instrument : the device
    faults : that befall its line; none by default
    stranger : who answers after the fault ``wrong-device``; by default a device of the other dialect
    name : last part of :attr:`path`

    Raises
    ------
    PortError : the system gives no pseudo-terminal.

    Notes
    -----
    A pseudo-terminal gets another number each time it is plugged in; the path is a link that follows it, as ``/dev/serial/by-id``
    does, and is not there while the device is unplugged. Both ends are raw: a cooked end would echo the device's own words back to
    it as commands. The far end is held open here too, so that the line outlives the programs that come and go. Only the thread
    touches the terminal; what others want of it waits in a queue, and a byte on a pipe wakes the thread.
    """

    def __init__(
        self,
        instrument: Instrument,
        faults: Faults | None = None,
        *,
        stranger: Instrument | None = None,
        name: str = "device",
    ) -> None:
        self.instrument = instrument
        self._line = FaultyLine(instrument, faults, stranger)
        self._folder = tempfile.TemporaryDirectory(prefix="brdfpipe-rig-")
        self.path = str(Path(self._folder.name) / name)
        self._near, self._far = -1, -1
        self._waiting = b""
        self._log: list[tuple[str, bytes]] = []
        self._speaking = threading.Lock()
        self._requests: deque[tuple[Callable[[], None], threading.Event]] = deque()
        self._serving, self._closed = True, False
        try:
            self._plug_in()
        except OSError as error:
            self._folder.cleanup()
            raise PortError(f"no pseudo-terminal for the emulated {name} ({error.strerror})") from error
        self._alarm, self._wake = os.pipe()
        self._thread = threading.Thread(target=self._serve, name=f"emulated {name}", daemon=True)
        self._thread.start()

    @property
    def log(self) -> list[tuple[str, bytes]]:
        """Who spoke, ``host`` or ``device``, and what, in the order it went over the line."""
        with self._speaking:
            return list(self._log)

    def heard(self, speaker: str) -> bytes:
        """All that ``host`` or ``device`` has said."""
        return b"".join(data for who, data in self.log if who == speaker)

    def unplug(self) -> None:
        """Pull the plug: the program that holds the port is hung up, and the path is gone."""
        self._ask(self._pull_out)

    def replug(self) -> None:
        """Plug the device in again, at the same path."""
        self._ask(self._plug_in)

    def close(self) -> None:
        """Unplug for good and end the thread; in real time, when the move under way is over."""
        if self._closed:
            return
        self._ask(self._stop)
        self._closed = True
        self._thread.join()
        self._pull_out()
        os.close(self._alarm)
        os.close(self._wake)
        self._folder.cleanup()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def _ask(self, request: Callable[[], None]) -> None:
        if self._closed:
            return
        done = threading.Event()
        self._requests.append((request, done))
        os.write(self._wake, b"!")
        while self._thread.is_alive() and not done.wait(0.1):
            pass

    def _serve(self) -> None:
        while self._serving:
            plugged = [self._near] if self._near >= 0 else []
            readable, writable, _ = select.select([*plugged, self._alarm], plugged if self._waiting else [], [])
            if self._near in writable:
                self._send()
            if self._near in readable:
                self._listen()
            if self._alarm in readable:
                os.read(self._alarm, _CHUNK)
                self._oblige()

    def _listen(self) -> None:
        data = os.read(self._near, _CHUNK)
        self._log.append(("host", data))
        self._waiting += self._line.feed(data)
        if self._waiting:
            self._send()
        if self._line.dead:
            self._pull_out()

    def _send(self) -> None:
        with self._speaking:  # whoever has read an answer finds it in the log
            try:
                sent = os.write(self._near, self._waiting)
            except BlockingIOError:  # nobody reads, and the terminal is full
                return
            self._log.append(("device", self._waiting[:sent]))
        self._waiting = self._waiting[sent:]

    def _oblige(self) -> None:
        while self._requests:
            request, done = self._requests.popleft()
            request()
            done.set()

    def _plug_in(self) -> None:
        if self._near >= 0:
            self._pull_out()
        self._near, self._far = os.openpty()
        tty.setraw(self._near)
        tty.setraw(self._far)
        os.set_blocking(self._near, False)
        self._line.replug()
        Path(self.path).symlink_to(os.ttyname(self._far))

    def _pull_out(self) -> None:
        if self._near < 0:
            return
        Path(self.path).unlink()
        os.close(self._far)
        os.close(self._near)
        self._near, self._far = -1, -1
        self._waiting = b""
        self._line.dead = True

    def _stop(self) -> None:
        self._serving = False
