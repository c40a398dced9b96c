"""Virtual time: a scan of hours takes seconds, and is the same in every run."""

from __future__ import annotations

import threading
import time


class VirtualClock:
    """Time that advances only by exposures, readouts and moves. Safe to use from several threads.

    Parameters
    ----------
    realtime : follow the wall clock, and let :meth:`advance_to` take real time; for interactive tests of programs
    """

    def __init__(self, *, realtime: bool = False) -> None:
        self._now = 0.0
        self._realtime = realtime
        self._origin = time.monotonic()
        self._released = threading.Event()
        self._lock = threading.Lock()

    def now(self) -> float:
        """Seconds."""
        return time.monotonic() - self._origin if self._realtime else self._now

    def advance_to(self, target: float) -> None:
        """Advance to a time [s]; does nothing if it is past."""
        if self._realtime:
            self._released.wait(max(0.0, target - self.now()))
        else:
            with self._lock:
                self._now = max(self._now, target)

    def release(self) -> None:
        """End all waiting in real time, now and later; called when the rig is closed."""
        self._released.set()
