"""Ctrl-C and SIGTERM end a build at once; the next build resumes."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


class Terminated(KeyboardInterrupt):
    """The process was asked to end, as by ``kill``, a batch system or a shutdown."""


class Interrupts:
    """Handlers of both signals."""

    def __init__(self, end: Callable[[], None]) -> None:
        self._end = end
        self._received: list[int] = []

    def install(self) -> None:
        """Handle both signals; again after another part of the program has set its own handler."""
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                if signal.getsignal(number) != self._stop:
                    signal.signal(number, self._stop)

    def check(self) -> None:
        """Raise KeyboardInterrupt or Terminated if a signal was received: snakemake turns it into a failed run."""
        if self._received:
            raise Terminated if self._received[0] == signal.SIGTERM else KeyboardInterrupt

    def _stop(self, number: int, frame: FrameType | None) -> None:
        self._received.append(number)
        self._end()
        self.check()


@contextmanager
def interruptible(end: Callable[[], None]) -> Iterator[Interrupts]:
    """Call a function and raise when one of the signals is received inside the block, in the main thread."""
    interrupts = Interrupts(end)
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    interrupts.install()
    try:
        yield interrupts
    finally:
        end()
        if threading.current_thread() is threading.main_thread():
            for number, handler in before.items():
                signal.signal(number, handler)
