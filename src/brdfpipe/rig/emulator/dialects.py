"""Controllers as they differ in laboratories: the devices of an emulated rig by the name of a dialect.

References: manuals and transcripts of the units, as of :mod:`brdfpipe.rig.emulator.instruments`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from brdfpipe.rig.description import Rig
from brdfpipe.rig.emulator.clock import VirtualClock
from brdfpipe.rig.emulator.effects import EmulationError
from brdfpipe.rig.emulator.instruments import GRATINGS, SERIAL_NUMBER, ActonWheel, Monochromator, ThorlabsWheel


@dataclass(frozen=True)
class ControllerDialect:
    """How the controllers of a rig differ from the usual ones."""

    meaning: str
    acton: Mapping[str, Any] = field(default_factory=dict)
    """Parameters of both Acton devices."""
    monochromator: Mapping[str, Any] = field(default_factory=dict)
    thorlabs: Mapping[str, Any] = field(default_factory=dict)


DIALECTS = {
    "usual": ControllerDialect("both letter cases, echo, every word of the manual"),
    "lower-case": ControllerDialect("only lower case is known", acton={"case": "lower"}),
    "upper-case": ControllerDialect("only upper case is known", acton={"case": "upper"}),
    "usb": ControllerDialect("no echo before the command ECHO", acton={"echo": False}),
    "usb-lower-case": ControllerDialect("the same in lower case", acton={"echo": False, "case": "lower"}),
    "no-echo": ControllerDialect("no echo, and no command ECHO", acton={"echo": False, "without": ("ECHO",)}),
    "no-echo-lower-case": ControllerDialect(
        "the same in lower case", acton={"echo": False, "without": ("ECHO",), "case": "lower"}
    ),
    "bare-refusal": ControllerDialect(
        "no echo; an unknown word is answered by `?` alone",
        acton={"echo": False, "without": ("ECHO", "SERIAL"), "bare_refusal": True},
    ),
    "old": ControllerDialect(
        "none of the words MODEL, SERIAL and TURRET, and no motors",
        acton={"without": ("MODEL", "SERIAL", "?TURRET", "?MIRROR", "?MICRONS")},
        monochromator={"mirrors": {}, "slits": {}},
    ),
    "firmware-1.0": ControllerDialect(
        "Thorlabs wheel without `pcount` and `sensors`, with a leading `>`", thorlabs={"version": "1.0"}
    ),
}
"""Name → differences."""


def emulated_devices(
    rig: Rig, clock: VirtualClock, dialect: str = "usual"
) -> tuple[Monochromator, ActonWheel | ThorlabsWheel]:
    """Monochromator, with the grating and serial number of the description, and wheel.

    Raises EmulationError: no such dialect.
    """
    if dialect not in DIALECTS:
        raise EmulationError(f"unknown dialect {dialect!r}; accepted: {', '.join(DIALECTS)}")
    differences, settings = DIALECTS[dialect], rig.monochromator
    wheel: ActonWheel | ThorlabsWheel
    if rig.wheel.dialect == "thorlabs":
        wheel = ThorlabsWheel(clock, positions=rig.wheel.positions, **differences.thorlabs)
    else:
        wheel = ActonWheel(clock, positions=rig.wheel.positions, **differences.acton)
    monochromator = Monochromator(
        clock,
        gratings={settings.grating: GRATINGS[1], **GRATINGS} if settings.grating else GRATINGS,
        serial_number=settings.serial_number or SERIAL_NUMBER,
        wheel=wheel if rig.shared_port and isinstance(wheel, ActonWheel) else None,
        **{**differences.acton, **differences.monochromator},
    )
    return monochromator, wheel
