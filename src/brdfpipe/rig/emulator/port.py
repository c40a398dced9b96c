"""An emulated device on a pseudo-terminal, which any program can open as a serial port."""

from __future__ import annotations

import os
import select
import tempfile
import threading
import tty
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Self

from brdfpipe.errors import BrdfpipeError
from brdfpipe.rig.emulator.faults import Faults, FaultyLine
from brdfpipe.rig.emulator.serial_device import SerialDevice

_CHUNK = 4096


class PortError(BrdfpipeError):
    """The operating system provides no pseudo-terminal."""


class Port:
    """An emulated device on a serial port, served by a thread until it is closed. Raises PortError: there is no pseudo-terminal.

    A pseudo-terminal gets a new number each time the device is connected. The path is a link to it, like ``/dev/serial/by-id``, and is absent while
    the device is disconnected. Both ends are raw: a cooked end would echo the device's replies back to it as commands. The far end stays open here
    too, so that the line survives the programs that open and close it. Only the thread uses the terminal; requests of other threads wait in a queue,
    and a byte on a pipe wakes the thread.

    Parameters
    ----------
    device : answers on the port
    faults : of the line; none by default
    other_device : answers after the fault ``wrong-device``; by default a device of the other dialect
    name : last part of :attr:`path`
    """

    def __init__(
        self,
        device: SerialDevice,
        faults: Faults | None = None,
        *,
        other_device: SerialDevice | None = None,
        name: str = "device",
    ) -> None:
        self.device = device
        self._line = FaultyLine(device, faults, other_device)
        self._folder = tempfile.TemporaryDirectory(prefix="brdfpipe-rig-")
        self.path = str(Path(self._folder.name) / name)
        self._device_end, self._host_end = -1, -1
        self._unsent = b""
        self._log: list[tuple[str, bytes]] = []
        self._log_lock = threading.Lock()
        self._requests: deque[tuple[Callable[[], None], threading.Event]] = deque()
        self._closed = False
        try:
            self._connect()
        except OSError as error:
            self._folder.cleanup()
            raise PortError(f"no pseudo-terminal available for the emulated {name} ({error.strerror})") from error
        self._wake_reader, self._wake_writer = os.pipe()
        self._thread = threading.Thread(target=self._serve, name=f"emulated {name}", daemon=True)
        self._thread.start()

    @property
    def log(self) -> list[tuple[str, bytes]]:
        """Sender (``host`` or ``device``) and bytes, in the order of transmission."""
        with self._log_lock:
            return list(self._log)

    def sent_by(self, sender: str) -> bytes:
        """All bytes sent by ``host`` or ``device``."""
        return b"".join(data for other, data in self.log if other == sender)

    def unplug(self) -> None:
        """Disconnect the device: the program that has the port open is hung up, and the path disappears."""
        self._request(self._disconnect)

    def replug(self) -> None:
        """Connect the device again, at the same path."""
        self._request(self._connect)

    def close(self) -> None:
        """Disconnect and end the thread; in real time, after the current move. May be called again."""
        if not self._closed:
            self._closed = True
            os.write(self._wake_writer, b"!")
            self._thread.join()
            self._disconnect()
            os.close(self._wake_reader)
            os.close(self._wake_writer)
            self._folder.cleanup()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _request(self, request: Callable[[], None]) -> None:
        if self._closed:
            return
        done = threading.Event()
        self._requests.append((request, done))
        os.write(self._wake_writer, b"!")
        while self._thread.is_alive() and not done.wait(0.1):
            pass

    def _serve(self) -> None:
        while not self._closed:
            connected = [self._device_end] if self._device_end >= 0 else []
            to_send = connected if self._unsent else []
            readable, writable, _ = select.select([*connected, self._wake_reader], to_send, [])
            if self._device_end in writable:
                self._send()
            if self._device_end in readable:
                self._receive()
            if self._wake_reader in readable:
                os.read(self._wake_reader, _CHUNK)
                while self._requests:
                    request, done = self._requests.popleft()
                    request()
                    done.set()

    def _receive(self) -> None:
        data = os.read(self._device_end, _CHUNK)
        self._log.append(("host", data))
        self._unsent += self._line.feed(data)
        if self._unsent:
            self._send()
        if self._line.dead:
            self._disconnect()

    def _send(self) -> None:
        with self._log_lock:  # an answer that a program has read is in the log
            try:
                sent = os.write(self._device_end, self._unsent)
            except BlockingIOError:  # the terminal is full because nobody reads
                return
            self._log.append(("device", self._unsent[:sent]))
        self._unsent = self._unsent[sent:]

    def _connect(self) -> None:
        if self._device_end >= 0:
            self._disconnect()
        self._device_end, self._host_end = os.openpty()
        tty.setraw(self._device_end)
        tty.setraw(self._host_end)
        os.set_blocking(self._device_end, False)
        self._line.replug()
        Path(self.path).symlink_to(os.ttyname(self._host_end))

    def _disconnect(self) -> None:
        if self._device_end < 0:
            return
        Path(self.path).unlink()
        os.close(self._host_end)
        os.close(self._device_end)
        self._device_end, self._host_end = -1, -1
        self._unsent = b""
        self._line.dead = True
