"""Thorlabs FW102C and FW212C filter wheels: lower-case commands ``pos=3`` and ``pos?``, and a prompt when a command is done.

The prompt may come before the wheel has arrived. The reply to the next query then waits for the arrival, so a position is read back with the
motion timeout. Reference: Thorlabs, FW102C/FW212C operating manual, rev. H, 5.2.
"""

from __future__ import annotations

import re

from brdfpipe.rig.acquisition.devices.serial_instrument import ANY_REPLY, POSITION, SerialFilterWheel
from brdfpipe.rig.acquisition.devices.serial_line import Dialect

_PROMPT = ">"
_FIRST_FIRMWARE = re.compile(r"version 1\.0\b")


class FilterWheel(SerialFilterWheel):
    """An FW102C (6 positions) or FW212C (12 positions) wheel."""

    dialect = Dialect(
        "filter wheel",
        "Thorlabs",
        end=re.compile(rb"[\r\n]> ?"),
        refusal=re.compile(rb"CMD_[A-Z_]+"),
        lower=True,
        lead=re.compile(rb"\A[\r\n]*> ?"),
    )

    def position(self) -> int:
        """Position that the wheel reports."""
        return int(self.ask("pos?", POSITION, self.settings.query_timeout)[0])

    def move(self, position: int) -> int:
        """Move once, wait, and return the position read back."""
        self.ask(f"pos={position}", ANY_REPLY, self.settings.motion_timeout)
        return int(self.ask("pos?", POSITION, self.settings.motion_timeout)[0])

    def read_identity(self) -> tuple[str, str]:
        """Model and firmware; the wheel states no serial number."""
        identity = self.ask_name("*idn?")
        # Firmware 1.0 takes a command only after a line of its own prompt.
        self.line.connection.prelude = _PROMPT if _FIRST_FIRMWARE.search(identity) else None
        self.ask_once("pos?", POSITION)
        return identity, ""

    @property
    def _first_firmware(self) -> bool:
        return self.line.connection.prelude is not None

    def describe(self) -> dict[str, str]:
        """Position sensors that cannot be switched off: their light is stray light."""
        return {"position sensors": "on, firmware 1.0 cannot switch them off"} if self._first_firmware else {}

    def configure(self) -> None:
        """Verify the number of positions, and switch the position sensors off. Firmware 1.0 knows neither."""
        if self._first_firmware:
            return
        count = int(self.ask_once("pcount?", POSITION)[0])
        if count != self.settings.positions:
            advice = (
                f"set `positions: {count}` if this is the right wheel; if another program changed the wheel's own count, send "
                f"`pcount={self.settings.positions}`"
            )
            raise self.mismatch("number of positions", self.settings.positions, count, advice)
        self.ask_once("sensors=0", ANY_REPLY)
        sensors = int(self.ask_once("sensors?", POSITION)[0])
        if sensors:
            advice = "the light of its sensors reaches the sample: update the firmware of the wheel"
            raise self.mismatch("state of the sensors", 0, sensors, advice)
