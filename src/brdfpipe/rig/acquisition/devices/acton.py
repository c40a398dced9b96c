"""The Acton dialect: SpectraPro monochromators, and the FA-448 filter wheel.

The parameter precedes the word (``546.100 GOTO``). A reply ends with `` ok`` once the command is *completed*, and with `` ?`` if the word is
unknown. A monochromator asked for a wavelength beyond its range moves to the end of the range and answers ok; it also answers ok to a grating
that is not installed. Each move is therefore read back.

References: Acton Research, SP-750i and SpectraPro-300i manuals, "Operation using a computer"; Princeton Instruments, IsoPlane SCT 320 manual,
appendix A.4; FA-448 manual, IV-B.
"""

from __future__ import annotations

import math
import re
from contextlib import suppress

from brdfpipe.rig.acquisition.devices.errors import DeviceError, NoReply, Refused
from brdfpipe.rig.acquisition.devices.serial_instrument import (
    ANY_REPLY,
    ATTEMPTS,
    NAME,
    POSITION,
    SerialFilterWheel,
    SerialInstrument,
)
from brdfpipe.rig.acquisition.devices.serial_line import Dialect

TOLERANCE = 0.5
"""Largest difference [nm] between the requested wavelength and the one read back."""

LONGEST_WAVELENGTH = 20000.0
"""Nanometres; beyond the range of every grating of the family."""

_WAVELENGTH = re.compile(r"(-?\d+(?:\.\d+)?) *(?:nm)?", re.IGNORECASE)
_SPEED = re.compile(r"(\d+(?:\.\d+)?) *(?:nm/min)?", re.IGNORECASE)
_SERIAL = re.compile(rf"(?:{NAME.pattern})?")
_DONE = re.compile(r"[01]")
# The grating in use is marked by an arrow, one byte of the display's character set.
_GRATING_LINE = "[\x1a\xaf> ]*[1-9](?: [ -~]*)?"
_GRATING_LIST = re.compile(f"{_GRATING_LINE}(?:\r?\n{_GRATING_LINE})*")
_INSTALLED_GRATING = re.compile("[\x1a\xaf> ]*([1-9]) +([^ ].*g/mm.*)", re.IGNORECASE)
_POLL = 0.05

# RS-232 ports of Acton devices echo by default, USB ports only after the command ECHO. Some controllers refuse a word by the mark alone.
_END, _REFUSAL, _WAKE = re.compile(rb"(?:^|\s)(?:ok|\? ?)\r\n"), re.compile(rb"(?:^|\s)\? ?\r\n"), ("", "ECHO")

_SETTING = re.compile(r"(?s)(?:(?P<absent>no (?:motor|slit)).*|(?P<value>[!-~][ -~]*))")
_SETTINGS = {
    "grating": "?GRATING",
    "turret": "?TURRET",
    "entrance mirror": "ENT-MIRROR ?MIRROR",
    "exit mirror": "EXIT-MIRROR ?MIRROR",
    "front entrance slit": "FRONT-ENT-SLIT ?MICRONS",
    "side entrance slit": "SIDE-ENT-SLIT ?MICRONS",
    "front exit slit": "FRONT-EXIT-SLIT ?MICRONS",
    "side exit slit": "SIDE-EXIT-SLIT ?MICRONS",
}
"""Settings by which a monochromator decides which light passes → query."""


class Monochromator(SerialInstrument):
    """A SpectraPro monochromator."""

    dialect = Dialect("monochromator", "Acton", _END, _REFUSAL, _WAKE)

    def goto(self, wavelength: float) -> float:
        """Move to a wavelength [nm] in steps of 0.001, wait, and return the wavelength read back; repeated once if it is another.

        Raises DeviceError: not within :data:`TOLERANCE` of the requested wavelength, as at the end of the range; or no reply.
        """
        if not (math.isfinite(wavelength) and 0 <= wavelength <= LONGEST_WAVELENGTH):
            advice = f"accepted: 0 to {LONGEST_WAVELENGTH:g} nm"
            raise self.line.error(DeviceError, f"wavelength {wavelength!r} nm out of range", advice=advice)
        reached = self._move(wavelength)
        if abs(reached - wavelength) > TOLERANCE:
            reached = self._move(wavelength)
        if abs(reached - wavelength) > TOLERANCE:
            advice = "choose a wavelength within the range of the grating: beyond it the monochromator stops without an error"
            raise self.mismatch("wavelength", f"{wavelength:g} nm", f"{reached:g} nm", advice)
        return reached

    def wavelength(self) -> float:
        """Wavelength [nm] that the monochromator reports."""
        return float(self.ask("?NM", _WAVELENGTH, self.settings.query_timeout)[1])

    def describe(self) -> dict[str, str]:
        """Grating and turret in use, positions of the mirrors, widths of the slits; those without a motor are left out."""
        if not self._identity:
            self.identify()
        return {name: value for name, query in _SETTINGS.items() if (value := self._setting(query))}

    def _setting(self, query: str) -> str:
        """Reply to a query that not every model knows, empty if it does not."""
        for _ in range(ATTEMPTS):
            try:
                return self.ask_once(query, _SETTING)["value"] or ""
            except Refused:
                return ""
            except NoReply:
                self._identify_once()
        return "unreadable"

    def stop(self) -> None:
        """Stop a move at a set speed; moves at full speed cannot be stopped."""
        self.ask("MONO-STOP", ANY_REPLY, self.settings.query_timeout)

    def read_identity(self) -> tuple[str, str]:
        """Model and serial number, where the unit states them."""
        model = _optional_name(self, "MODEL") or "monochromator"
        self.ask_once("?NM", _WAVELENGTH)  # refused by a filter wheel of the same family
        return model, _optional_name(self, "SERIAL")

    def configure(self) -> None:
        """Select the grating and set the speed of the description."""
        if self.settings.grating:
            self._select_grating(self.settings.grating)
        if self.settings.speed:
            self._set_speed(self.settings.speed)

    def _select_grating(self, grating: int) -> None:
        installed = _installed_gratings(self.ask_once("?GRATINGS", _GRATING_LIST)[0])
        if grating not in installed:
            available = ", ".join(f"{number} ({text})" for number, text in installed.items())
            raise self.line.error(DeviceError, f"grating {grating} is not installed", advice=f"installed: {available}")
        if int(self.ask_once("?GRATING", POSITION)[0]) == grating:
            return
        self.ask_once(f"{grating} GRATING", ANY_REPLY, self.settings.motion_timeout)
        selected = int(self.ask_once("?GRATING", POSITION)[0])
        if selected != grating:
            raise self.mismatch("grating", grating, selected, "check that the grating belongs to the installed turret")

    def _set_speed(self, speed: float) -> None:
        self.ask_once(f"{speed:.2f} NM/MIN", ANY_REPLY)
        reported = float(self.ask_once("?NM/MIN", _SPEED)[1])
        if abs(reported - speed) > 0.01 * speed:
            advice = "set `speed` to a speed that the monochromator supports"
            raise self.mismatch("speed", f"{speed:g} nm/min", f"{reported:g} nm/min", advice)

    def _move(self, wavelength: float) -> float:
        if self.settings.speed:
            self._scan_to(wavelength)
        else:
            self.ask(f"{wavelength:.3f} GOTO", ANY_REPLY, self.settings.motion_timeout)
        return self.wavelength()

    def _scan_to(self, wavelength: float) -> None:
        distance = abs(wavelength - self.wavelength())
        limit = self.settings.motion_timeout + 60 * distance / self.settings.speed
        deadline = self.line.clock() + limit
        try:
            self.ask(f"{wavelength:.3f} >NM", ANY_REPLY, self.settings.query_timeout)
            while self.ask("MONO-?DONE", _DONE, self.settings.query_timeout)[0] == "0":
                if self.line.clock() > deadline:
                    advice = "raise `speed` or `motion_timeout`"
                    raise self.line.error(DeviceError, f"move not finished after {limit:.0f} s", advice=advice)
                self.line.sleep(_POLL)
        except BaseException:
            with suppress(DeviceError):
                self.stop()
            raise
        self.stop()  # the manual requires it after a finished move too


class FilterWheel(SerialFilterWheel):
    """An FA-448 filter wheel."""

    dialect = Dialect("filter wheel", "Acton", _END, _REFUSAL, _WAKE)
    stuck_advice = "check that the wheel turns freely and that its controller is set to remote"

    def position(self) -> int:
        """Position that the wheel reports."""
        return int(self.ask("?FILTER", POSITION, self.settings.query_timeout)[0])

    def move(self, position: int) -> int:
        """Move once, wait, and return the position read back."""
        self.ask(f"{position} FILTER", ANY_REPLY, self.settings.motion_timeout)
        return self.position()

    def recover(self) -> None:
        """Move to the home position."""
        self.ask("FHOME", ANY_REPLY, self.settings.motion_timeout)

    def read_identity(self) -> tuple[str, str]:
        """Model and serial number, as far as the wheel knows the words: its manual lists only three commands."""
        model, serial_number = _optional_name(self, "MODEL") or "filter wheel", _optional_name(self, "SERIAL")
        self.ask_once("?FILTER", POSITION)  # refused by a monochromator
        return model, serial_number

    def configure(self) -> None:
        """Nothing to set: the wheel moves to its home position when it is switched on."""


def _optional_name(instrument: SerialInstrument, command: str) -> str:
    """Text with which a device identifies itself; empty if it does not know the command, or has no serial number."""
    with suppress(Refused):
        return instrument.ask_once(command, _SERIAL if command == "SERIAL" else NAME)[0].strip()
    return ""


def _installed_gratings(reply: str) -> dict[int, str]:
    """Number → description. Empty places of the turret have the text "Not Installed", or only their number."""
    matches = (_INSTALLED_GRATING.fullmatch(line.strip(" \r")) for line in reply.split("\n"))
    return {int(match[1]): " ".join(match[2].split()) for match in matches if match}
