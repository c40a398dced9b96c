"""Thorlabs FW102C and FW212C filter wheels: lower case, ``pos=3`` and ``pos?``, and a prompt when the command is done.

The prompt may come before the wheel has arrived: it is the answer to the next command that waits, so a position is read back with
the time of a move.

References
----------
Thorlabs, FW102C/FW212C operating manual, rev. H, 5.2.
"""

from __future__ import annotations

import re

from brdfpipe.rig.acquisition.devices.acton import check_position
from brdfpipe.rig.acquisition.devices.instrument import ANYTHING, Instrument

_NUMBER = re.compile(r"\d{1,2}")


class FilterWheel(Instrument):
    """An FW102C (6 positions) or FW212C (12 positions) wheel."""

    def goto(self, position: int) -> int:
        """Move, wait, and read back; a wheel that stands elsewhere is sent once more.

        Parameters
        ----------
        position : from 1 to the number of positions

        Raises
        ------
        DeviceError : there is no such position, it stands elsewhere, or does not answer.
        """
        check_position(self, position)
        if self._moved(position) != position and (found := self._moved(position)) != position:
            raise self._mismatch("position", position, found, "check that the wheel turns freely")
        return int(position)

    def position(self) -> int:
        """The position it says it is at."""
        return int(self.ask("pos?", _NUMBER, self.settings.query_timeout)[0])

    def _moved(self, position: int) -> int:
        self.ask(f"pos={position}", ANYTHING, self.settings.motion_timeout)
        return int(self.ask("pos?", _NUMBER, self.settings.motion_timeout)[0])

    def _names(self) -> tuple[str, str]:
        # Model and firmware in one line; the wheel does not tell its serial number.
        name = self._name("*idn?")
        self._once("pos?", _NUMBER)
        return name, ""

    def _prepare(self) -> None:
        count = int(self._once("pcount?", _NUMBER)[0])
        if count != self.settings.positions:
            advice = f"set `positions: {count}`, if that is the wheel"
            raise self._mismatch("number of positions", self.settings.positions, count, advice)
        # The sensors' own light is stray light.
        self._once("sensors=0", ANYTHING)
        found = int(self._once("sensors?", _NUMBER)[0])
        if found:
            raise self._mismatch("sensors", 0, found, "its sensors light the sample; update its firmware")
