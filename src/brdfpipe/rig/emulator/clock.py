"""Virtual time: a scan of hours passes in seconds, and the same in every run."""

from __future__ import annotations

import threading
import time

from brdfpipe.errors import BrdfpipeError


class ClockError(BrdfpipeError):
    """Time was to run backwards."""


class VirtualClock:
    """Time that passes only where something says so: an exposure, a readout, a move.

    Parameters
    ----------
    start : first reading [s]
    realtime : follow the wall clock instead, and let :meth:`advance` take as long as it says; for trying programs by hand

    Notes
    -----
    Safe to use from several threads.
    """

    def __init__(self, start: float = 0.0, *, realtime: bool = False) -> None:
        self._now = start
        self._realtime = realtime
        self._origin = time.monotonic() - start
        self._released = threading.Event()
        self._lock = threading.Lock()

    def now(self) -> float:
        """Seconds."""
        return time.monotonic() - self._origin if self._realtime else self._now

    def advance(self, seconds: float) -> None:
        """Let time pass.

        Raises
        ------
        ClockError : negative, or no number.
        """
        if not seconds >= 0:
            raise ClockError(f"the clock cannot advance by {seconds} s; accepted: 0 or more")
        if self._realtime:
            self._released.wait(seconds)
            return
        with self._lock:
            self._now += seconds

    def advance_to(self, moment: float) -> None:
        """Let time pass up to a moment [s]; one in the past is already reached."""
        if self._realtime:
            self._released.wait(max(0.0, moment - self.now()))
            return
        with self._lock:
            self._now = max(self._now, moment)

    def release(self) -> None:
        """End all waiting in real time, now and later: the rig is being closed."""
        self._released.set()
