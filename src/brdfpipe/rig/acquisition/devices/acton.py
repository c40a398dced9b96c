"""The Acton dialect: SpectraPro monochromators, and the FA-448 filter wheel.

The parameter stands before the word (``546.100 GOTO``), a reply ends in `` ok`` when the command is *completed*, a word that is not
known in `` ?``. Out of its range a monochromator goes to the end of it and says ok; a grating that is not installed is answered ok
too. Each move is therefore read back.

References
----------
Acton Research, SP-750i and SpectraPro-300i manuals, "Operation using a computer"; Princeton Instruments, IsoPlane SCT 320 manual,
appendix A.4; FA-448 manual, IV-B.
"""

from __future__ import annotations

import math
import re
from contextlib import suppress

from brdfpipe.rig.acquisition.devices.errors import DeviceError, Refused
from brdfpipe.rig.acquisition.devices.instrument import ANYTHING, Instrument

TOLERANCE = 0.5
"""Largest difference [nm] between the wavelength asked for and the one read back."""

LONGEST_WAVELENGTH = 20000.0
"""Nanometres; no grating of the family reaches it."""

_WAVELENGTH = re.compile(r"(-?\d+(?:\.\d+)?) *(?:nm)?", re.IGNORECASE)
_SPEED = re.compile(r"(\d+(?:\.\d+)?) *(?:nm/min)?", re.IGNORECASE)
_DONE = re.compile(r"[01]")
_NUMBER = re.compile(r"\d{1,2}")
# The grating in place is marked by an arrow, which is one byte of the display's own character set.
_ROW = "[\x1a\xaf> ]*[1-9](?: [ -~]*)?"
_GRATINGS = re.compile(f"{_ROW}(?:\r?\n{_ROW})*")
_GRATING = re.compile("[\x1a\xaf> ]*([1-9]) +([^ ].*g/mm.*)", re.IGNORECASE)
_POLL = 0.05


class Monochromator(Instrument):
    """A SpectraPro monochromator."""

    def goto(self, wavelength: float) -> float:
        """Move, wait, and read back; a monochromator that stands elsewhere is sent once more.

        Parameters
        ----------
        wavelength : nm, in steps of 0.001

        Returns
        -------
        The wavelength read back [nm], within :data:`TOLERANCE` of the one asked for.

        Raises
        ------
        DeviceError : it stands elsewhere, as at the end of its range, or does not answer.
        """
        if not (math.isfinite(wavelength) and 0 <= wavelength <= LONGEST_WAVELENGTH):
            advice = f"0 to {LONGEST_WAVELENGTH:g} nm"
            raise self.line.error(DeviceError, f"cannot go to {wavelength!r} nm", advice=advice)
        reached = self._moved(wavelength)
        if abs(reached - wavelength) > TOLERANCE:
            reached = self._moved(wavelength)
        if abs(reached - wavelength) > TOLERANCE:
            advice = (
                "is the wavelength within the range of the grating? A monochromator stops at its end without a word"
            )
            raise self._mismatch("wavelength", f"{wavelength:g} nm", f"{reached:g} nm", advice)
        return reached

    def wavelength(self) -> float:
        """The wavelength [nm] it says it is at."""
        return float(self.ask("?NM", _WAVELENGTH, self.settings.query_timeout)[1])

    def stop(self) -> None:
        """Stop a move at a set speed; the fast ones cannot be stopped."""
        self.ask("MONO-STOP", ANYTHING, self.settings.query_timeout)

    def _names(self) -> tuple[str, str]:
        model = self._name("MODEL")
        self._once("?NM", _WAVELENGTH)  # a device of the dialect that has no wavelength is no monochromator
        return model, self._serial_number()

    def _serial_number(self) -> str:
        try:
            return self._name("SERIAL")
        except Refused:  # old units do not know the word
            return ""

    def _prepare(self) -> None:
        if self.settings.grating:
            self._select(self.settings.grating)
        if self.settings.speed:
            self._set_speed(self.settings.speed)

    def _select(self, grating: int) -> None:
        installed = _gratings(self._once("?GRATINGS", _GRATINGS)[0])
        if grating not in installed:
            listed = ", ".join(f"{number} ({text})" for number, text in installed.items())
            raise self.line.error(DeviceError, f"grating {grating} is not installed", advice=f"installed: {listed}")
        if int(self._once("?GRATING", _NUMBER)[0]) == grating:
            return
        self._once(f"{grating} GRATING", ANYTHING, self.settings.motion_timeout)
        found = int(self._once("?GRATING", _NUMBER)[0])
        if found != grating:
            raise self._mismatch("grating", grating, found, "does it belong to the turret in place?")

    def _set_speed(self, speed: float) -> None:
        self._once(f"{speed:.2f} NM/MIN", ANYTHING)
        found = float(self._once("?NM/MIN", _SPEED)[1])
        if abs(found - speed) > 0.01 * speed:
            raise self._mismatch("speed", f"{speed:g} nm/min", f"{found:g} nm/min", "set `speed` to one it can do")

    def _moved(self, wavelength: float) -> float:
        if self.settings.speed:
            self._scan_to(wavelength)
        else:
            self.ask(f"{wavelength:.3f} GOTO", ANYTHING, self.settings.motion_timeout)
        return self.wavelength()

    def _scan_to(self, wavelength: float) -> None:
        distance = abs(wavelength - self.wavelength())
        limit = self.settings.motion_timeout + 60 * distance / self.settings.speed
        deadline = self.line.clock() + limit
        try:
            self.ask(f"{wavelength:.3f} >NM", ANYTHING, self.settings.query_timeout)
            while self.ask("MONO-?DONE", _DONE, self.settings.query_timeout)[0] == "0":
                if self.line.clock() > deadline:
                    advice = "raise `speed` or `motion_timeout`"
                    raise self.line.error(DeviceError, f"the move did not end in {limit:.0f} s", advice=advice)
                self.line.sleep(_POLL)
        except BaseException:
            with suppress(DeviceError):
                self.stop()
            raise
        self.stop()  # the manual asks for it after a finished move too


class FilterWheel(Instrument):
    """An FA-448 filter wheel."""

    def goto(self, position: int) -> int:
        """Move, wait, and read back; a wheel that stands elsewhere is sent to its home and tried once more.

        Parameters
        ----------
        position : from 1 to the number of positions

        Raises
        ------
        DeviceError : there is no such position, it stands elsewhere, or does not answer.
        """
        check_position(self, position)
        if self._moved(position) != position:
            self.ask("FHOME", ANYTHING, self.settings.motion_timeout)
            if (found := self._moved(position)) != position:
                advice = "check that the wheel turns freely and that its controller is set to remote"
                raise self._mismatch("position", position, found, advice)
        return int(position)

    def position(self) -> int:
        """The position it says it is at."""
        return int(self.ask("?FILTER", _NUMBER, self.settings.query_timeout)[0])

    def _moved(self, position: int) -> int:
        self.ask(f"{position} FILTER", ANYTHING, self.settings.motion_timeout)
        return self.position()

    def _names(self) -> tuple[str, str]:
        names = [self._told("MODEL") or "filter wheel", self._told("SERIAL")]
        self._once("?FILTER", _NUMBER)  # a device of the dialect that has no position is no wheel
        return names[0], names[1]

    def _told(self, command: str) -> str:
        """A name, empty where the device does not know the word: the FA-448's manual knows three in all."""
        try:
            return self._name(command)
        except Refused:
            return ""

    def _prepare(self) -> None:
        """A wheel has no settings: it homes itself when it is switched on."""


def check_position(wheel: Instrument, position: int) -> None:
    """Refuse a position that the wheel has not."""
    if position not in range(1, wheel.settings.positions + 1):
        advice = f"1 to {wheel.settings.positions} (`positions` of the description)"
        raise wheel.line.error(DeviceError, f"cannot go to position {position!r}", advice=advice)


def _gratings(listed: str) -> dict[int, str]:
    """The lines that describe a grating; those without one say "Not Installed", or only their number."""
    found = (_GRATING.fullmatch(line.strip(" \r")) for line in listed.split("\n"))
    return {int(match[1]): " ".join(match[2].split()) for match in found if match}
