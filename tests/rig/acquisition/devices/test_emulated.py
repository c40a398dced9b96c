"""Drivers, connection and doctor on pseudo-terminals, with emulated devices and every fault."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from brdfpipe.rig.acquisition.devices import serial_line
from brdfpipe.rig.acquisition.devices.connection import RigDevices, connect, open_monochromator, open_wheel
from brdfpipe.rig.acquisition.devices.errors import DeviceError, DeviceLost, WrongDevice
from brdfpipe.rig.acquisition.devices.serial_instrument import ANY_REPLY
from brdfpipe.rig.acquisition.doctor import Row, doctor
from brdfpipe.rig.description import Rig, SerialSettings
from brdfpipe.rig.emulator.clock import VirtualClock
from brdfpipe.rig.emulator.dialects import DIALECTS
from brdfpipe.rig.emulator.emulated_rig import EmulatedRig
from brdfpipe.rig.emulator.faults import KINDS, Faults
from brdfpipe.rig.emulator.instruments import ActonWheel, Monochromator, ThorlabsWheel
from brdfpipe.rig.emulator.port import Port
from brdfpipe.rig.raw_frame import RawFrame

QUICK = {"query_timeout": 0.4, "motion_timeout": 0.4}


@pytest.fixture(autouse=True)
def short_silence(monkeypatch: pytest.MonkeyPatch) -> None:
    # A pseudo-terminal holds no bytes back, so a shorter silence is enough.
    monkeypatch.setattr(serial_line, "QUIET", 0.02)
    monkeypatch.setattr(serial_line, "POLL", 0.01)


def acton(port: Port, **others: Any) -> SerialSettings:
    return SerialSettings("acton", port.path, 9600, **(QUICK | others))


def acton_wheel(port: Port, **others: Any) -> SerialSettings:
    return SerialSettings("acton-wheel", port.path, 9600, **(QUICK | others))


def thorlabs(port: Port, **others: Any) -> SerialSettings:
    return SerialSettings("thorlabs", port.path, 115200, **(QUICK | others))


# --- devices without faults


@pytest.mark.parametrize("case", ["upper", "lower"])
@pytest.mark.parametrize("echo", [True, False], ids=["RS-232", "USB"])
def test_a_monochromator_of_either_case_and_interface_is_driven(case: str, echo: bool) -> None:
    unit = Monochromator(VirtualClock(), case=case, echo=echo)
    with Port(unit) as port:
        device = open_monochromator(acton(port, case=case, serial_number="2330123"))
        assert device.identify() == "SP-2-300i 2330123"
        assert device.goto(546.0744) == pytest.approx(546.074)
        assert unit.wavelength == pytest.approx(546.074)
        device.close()


def test_a_monochromator_moves_at_a_speed_with_its_grating() -> None:
    unit = Monochromator(VirtualClock())
    with Port(unit) as port:
        device = open_monochromator(acton(port, speed=1200, grating=2, motion_timeout=5))
        assert device.goto(20) == pytest.approx(20)
        assert unit.grating == 2
        device.close()


def rig_of(wheel_dialect: str, rig: Rig, *, shared: bool = False, **devices: Any) -> Rig:
    """The description of a rig of quick devices with a wheel of a dialect, which may be on the monochromator's port."""
    monochromator = replace(rig.monochromator, **QUICK, **devices)
    port = monochromator.port if shared else rig.wheel.port
    baud = 115200 if wheel_dialect == "thorlabs" else 9600
    return replace(
        rig, monochromator=monochromator, wheel=replace(rig.wheel, dialect=wheel_dialect, port=port, baud=baud, **QUICK)
    )


WHEELS_OF_RIGS = {"thorlabs": ("thorlabs", False), "acton": ("acton-wheel", False), "shared": ("acton-wheel", True)}


def drive(rig: Rig, dialect: str, faults: Faults | None = None) -> str:
    """Move the devices of an emulated rig in a dialect; the settings that they report, or the kind of a fault's error."""
    with EmulatedRig(rig, None, dialect=dialect, faults=faults) as emulated:
        try:
            with connect(emulated.rig, camera=Dark(rig)) as devices:
                for wavelength, position in ((546.1, 3), (700.0, 6), (390.0, 1)):
                    assert devices.monochromator.goto(wavelength) == pytest.approx(
                        emulated.monochromator.wavelength, abs=1e-3
                    )
                    assert abs(emulated.monochromator.wavelength - wavelength) <= 0.5
                    assert devices.wheel.goto(position) == position == emulated.wheel.position
                return str({**devices.monochromator.describe(), **devices.wheel.describe()})
        except DeviceError as error:
            return type(error).__name__ if error.advice else "no advice"


@pytest.mark.parametrize("wheel", WHEELS_OF_RIGS)
@pytest.mark.parametrize("dialect", DIALECTS)
def test_the_controllers_of_every_dialect_are_driven(rig: Rig, dialect: str, wheel: str) -> None:
    name, shared = WHEELS_OF_RIGS[wheel]
    reported = drive(rig_of(name, rig, shared=shared), dialect)
    assert "'grating': '1'" in reported
    assert ("'turret': '1'" in reported) == (dialect != "old")
    assert ("'exit mirror': 'front', 'side entrance slit': '480 um'" in reported) == (dialect != "old")
    assert ("position sensors" in reported) == (dialect == "firmware-1.0" and name == "thorlabs")


@pytest.mark.cases(8)
@pytest.mark.parametrize("ordinal", [5, 19])
@pytest.mark.parametrize("kind", ["silence", "garbage", "truncated", "clamp", "late-ok"])
@pytest.mark.parametrize("dialect", [name for name in DIALECTS if name != "usual"])
def test_a_fault_never_yields_a_wrong_state_in_any_dialect(rig: Rig, dialect: str, kind: str, ordinal: int) -> None:
    wheel, shared = WHEELS_OF_RIGS["thorlabs" if dialect == "firmware-1.0" else "shared"]
    result = drive(rig_of(wheel, rig, shared=shared), dialect, Faults.at({ordinal: kind}, seed=ordinal))
    assert result.startswith("{") or result in ("DeviceError", "NoReply")


@pytest.mark.slow
@pytest.mark.parametrize("dialect", ["no-echo", "bare-refusal", "usb-lower-case", "firmware-1.0"])
def test_a_fault_at_every_command_never_yields_a_wrong_state_in_any_dialect(rig: Rig, dialect: str) -> None:
    wheel, shared = WHEELS_OF_RIGS["thorlabs" if dialect == "firmware-1.0" else "shared"]
    described = rig_of(wheel, rig, shared=shared)
    count = Faults.at({})
    drive(described, dialect, count)
    kinds = ("silence", "garbage", "truncated", "clamp", "late-ok")
    for number, ordinal in enumerate(range(1, count.commands + 1)):
        for kind in (kinds[number % 5], kinds[(number + 2) % 5]):
            result = drive(described, dialect, Faults.at({ordinal: kind}, seed=ordinal))
            assert result.startswith("{") or result in ("DeviceError", "NoReply"), (kind, ordinal)


def test_a_wheel_whose_count_another_program_changed_is_refused() -> None:
    with Port(ThorlabsWheel(VirtualClock(), count=12)) as port:
        device = open_wheel(thorlabs(port))
        with pytest.raises(DeviceError, match=r"requested 6, device reports 12; .* send `pcount=6`"):
            device.identify()
        # As the advice says.
        device.ask_once("pcount=6", ANY_REPLY)
        assert device.identify().endswith("1.07")
        device.close()


def test_the_words_of_the_first_firmware_are_those_of_its_emulation() -> None:
    """Each command needs a line before it; `pcount` and `sensors` are unknown; the prompt comes before the reply, too."""
    unit = ThorlabsWheel(VirtualClock(), version="1.0")
    assert unit.feed(b"pos?\r") == b"pos?\r\r> 1\r> "
    assert b"CMD_NOT_DEFINED" in unit.feed(b"pos?\r")
    assert b"CMD_NOT_DEFINED" in unit.feed(b">\r")
    assert unit.feed(b"pos?\r") == b"pos?\r\r> 1\r> "
    for command in (b"pcount?", b"sensors=0"):
        unit.feed(b">\r")
        assert b"CMD_NOT_DEFINED" in unit.feed(command + b"\r")


@pytest.mark.parametrize("unit", [ActonWheel(VirtualClock()), ThorlabsWheel(VirtualClock())], ids=["Acton", "Thorlabs"])
def test_a_wheel_goes_to_each_position(unit: ActonWheel | ThorlabsWheel) -> None:
    with Port(unit) as port:
        device = open_wheel(acton_wheel(port) if isinstance(unit, ActonWheel) else thorlabs(port))
        device.identify()
        for position in (1, 4, 6, 2):
            assert device.goto(position) == position == unit.position
        device.close()


def test_a_wavelength_beyond_the_range_is_refused() -> None:
    with Port(Monochromator(VirtualClock())) as port:
        device = open_monochromator(acton(port))
        with pytest.raises(DeviceError, match=r"requested 1500 nm, device reports 1400 nm"):
            device.goto(1500)
        device.close()


def test_an_absent_grating_is_refused() -> None:
    with Port(Monochromator(VirtualClock())) as port:
        device = open_monochromator(acton(port, grating=3))
        with pytest.raises(DeviceError, match="grating 3 is not installed; installed: 1"):
            device.identify()
        device.close()


def test_a_second_program_on_the_port_is_one_clear_refusal() -> None:
    with Port(Monochromator(VirtualClock())) as port:
        first = open_monochromator(acton(port))
        with pytest.raises(DeviceLost, match="the port is in use by another program"):
            open_monochromator(acton(port))
        first.identify()
        first.close()
        open_monochromator(acton(port)).close()


def test_an_absent_port_is_one_clear_refusal() -> None:
    with pytest.raises(DeviceLost, match="monochromator on /dev/no-such-port: the port does not exist; connect"):
        open_monochromator(SerialSettings("acton", "/dev/no-such-port", 9600))


def test_a_file_is_not_accepted_as_a_port(tmp_path: Any) -> None:
    (tmp_path / "tty").write_text("")
    with pytest.raises(DeviceLost, match="cannot be opened"):
        open_monochromator(SerialSettings("acton", str(tmp_path / "tty"), 9600))


# --- every fault


def checked_kind(error: DeviceError, device: str, port: str) -> str:
    """Type of an error that must name its device, its port, and advice."""
    assert (error.device, error.port) == (device, port)
    assert error.advice
    return type(error).__name__


def monochromator_meets(kind: str, ordinal: int) -> tuple[int, str]:
    """A series of moves with one fault; the number of commands, and the result."""
    unit, faults = Monochromator(VirtualClock()), Faults.at({ordinal: kind}, seed=ordinal)
    with Port(unit, faults) as port:
        try:
            device = open_monochromator(acton(port, grating=2))
            device.identify()
            for wavelength in (546.1, 700.0, 390.0):
                reached = device.goto(wavelength)
                assert reached == pytest.approx(unit.wavelength, abs=1e-3)
                assert abs(reached - wavelength) <= 0.5
                assert unit.grating == 2
            device.close()
        except DeviceError as error:
            return faults.commands, checked_kind(error, "monochromator", port.path)
    return faults.commands, "recovered"


def wheel_meets(kind: str, ordinal: int, dialect: str) -> tuple[int, str]:
    unit = (ActonWheel if dialect == "acton-wheel" else ThorlabsWheel)(VirtualClock())
    faults = Faults.at({ordinal: kind}, seed=ordinal)
    with Port(unit, faults) as port:
        try:
            device = open_wheel(SerialSettings(dialect, port.path, 9600, **QUICK))
            device.identify()
            for position in (3, 6, 1):
                assert device.goto(position) == position == unit.position
            device.close()
        except DeviceError as error:
            return faults.commands, checked_kind(error, "filter wheel", port.path)
    return faults.commands, "recovered"


EXPECTED = {kind: {"recovered"} for kind in KINDS} | {
    "unplug": {"DeviceLost"},
    "wrong-device": {"WrongDevice"},
    # A turret that did not turn is an error at once; a wrong wavelength or position is corrected by a second move.
    "clamp": {"recovered", "DeviceError"},
}


@pytest.mark.cases(8)
@pytest.mark.parametrize("ordinal", [3, 9, 13])
@pytest.mark.parametrize("kind", KINDS)
def test_a_fault_at_a_command_of_the_monochromator_is_recovered_or_reported(kind: str, ordinal: int) -> None:
    assert monochromator_meets(kind, ordinal)[1] in EXPECTED[kind]


@pytest.mark.cases(8)
@pytest.mark.parametrize("dialect", ["acton-wheel", "thorlabs"])
@pytest.mark.parametrize("ordinal", [2, 9])
@pytest.mark.parametrize("kind", KINDS)
def test_a_fault_at_a_command_of_the_wheel_is_recovered_or_reported(kind: str, ordinal: int, dialect: str) -> None:
    assert wheel_meets(kind, ordinal, dialect)[1] in EXPECTED[kind]


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_fault_at_every_command_is_recovered_or_reported(kind: str) -> None:
    count, _ = monochromator_meets(kind, 10_000)
    assert {monochromator_meets(kind, ordinal)[1] for ordinal in range(1, count + 1)} <= EXPECTED[kind]
    for dialect in ("acton-wheel", "thorlabs"):
        count, _ = wheel_meets(kind, 10_000, dialect)
        assert {wheel_meets(kind, ordinal, dialect)[1] for ordinal in range(1, count + 1)} <= EXPECTED[kind]


@pytest.mark.slow
def test_a_bad_line_never_yields_a_wrong_wavelength() -> None:
    """One command in five has a fault; every returned wavelength is the true one."""
    met, refusals = 0, list[DeviceError]()
    for seed in range(5):
        unit = Monochromator(VirtualClock())
        faults = Faults.seeded(seed, 0.2, ("silence", "garbage", "truncated", "clamp", "late-ok"))
        with Port(unit, faults) as port:
            device = open_monochromator(acton(port))
            for wavelength in range(400, 700, 10):
                try:
                    assert device.goto(wavelength) == pytest.approx(unit.wavelength, abs=1e-3)
                    assert abs(unit.wavelength - wavelength) <= 0.5
                except DeviceError as error:
                    refusals.append(error)
            device.close()
        met += len(faults.injected)
    assert met > 60
    assert len(refusals) < 15
    assert not any(isinstance(error, WrongDevice | DeviceLost) for error in refusals)


# --- connection


class Dark:
    """A camera that gives dark frames."""

    def __init__(self, rig: Rig, level: int = 300) -> None:
        self.shape, self.level = (rig.camera.height, rig.camera.width), level

    def identify(self) -> str:
        return "dark"

    def expose(self, seconds: float, *, shutter: bool = True) -> RawFrame:
        return RawFrame(np.full(self.shape, self.level, np.uint16), 0.0, seconds)


@pytest.fixture
def plugged(rig: Rig) -> Iterator[tuple[Rig, Monochromator, ThorlabsWheel]]:
    clock = VirtualClock()
    monochromator, wheel = Monochromator(clock, wavelength=500.0), ThorlabsWheel(clock, position=2)
    with Port(monochromator) as first, Port(wheel) as second:
        yield replace(rig, monochromator=acton(first), wheel=thorlabs(second)), monochromator, wheel


def test_the_devices_of_a_rig_are_opened_identified_and_closed(
    plugged: tuple[Rig, Monochromator, ThorlabsWheel],
) -> None:
    rig, monochromator, wheel = plugged
    for _ in range(2):
        with connect(rig, camera=Dark(rig)) as bench:
            assert isinstance(bench, RigDevices)
            bench.monochromator.goto(600)
            bench.wheel.goto(5)
    assert (round(monochromator.wavelength), wheel.position) == (600, 5)


def test_a_device_that_is_missing_leaves_no_port_open(plugged: tuple[Rig, Monochromator, ThorlabsWheel]) -> None:
    rig, _, _ = plugged
    broken = replace(rig, wheel=replace(rig.wheel, port="/dev/no-such-port"))
    with pytest.raises(DeviceLost, match="filter wheel on /dev/no-such-port"), connect(broken, camera=Dark(rig)):
        pass
    with connect(rig, camera=Dark(rig)):
        pass


# --- the doctor


def examined(rig: Rig, camera: Any) -> tuple[list[Row], str]:
    lines: list[str] = []
    rows = doctor(rig, camera, lines.append)
    return rows, "\n".join(lines)


def test_the_doctor_moves_every_device_and_back(
    plugged: tuple[Rig, Monochromator, ThorlabsWheel],
) -> None:
    rig, monochromator, wheel = plugged
    rows, table = examined(rig, Dark(rig))
    assert all(row.passed for row in rows), table
    assert monochromator.wavelength == pytest.approx(500)
    assert wheel.position == 2
    assert [row.check for row in rows if row.device == "filter wheel"][5:] == [f"to {k}" for k in (1, 2, 3, 4, 5, 6, 2)]
    assert "SP-2-300i 2330123" in table
    assert "ms per transaction" in table
    assert table.splitlines()[-1] == f"{len(rows)} passed, 0 failed"


def test_a_failed_device_does_not_prevent_the_checks_of_the_others(
    plugged: tuple[Rig, Monochromator, ThorlabsWheel],
) -> None:
    class Broken(Dark):
        def expose(self, seconds: float, *, shutter: bool = True) -> RawFrame:
            raise ZeroDivisionError("a bug\x1b[31m")

    rig, _, _ = plugged
    swapped = replace(rig, monochromator=replace(rig.monochromator, port="/dev/no-such-port"))
    rows, table = examined(swapped, Broken(rig))
    failed = [(row.device, row.check) for row in rows if not row.passed]
    assert failed == [("monochromator", "port"), ("camera", "dark frame")]
    assert sum(row.device == "filter wheel" for row in rows) == 12
    assert all(row.advice for row in rows if not row.passed)
    assert "→ connect the device" in table
    assert "\x1b" not in table


def test_the_doctor_detects_swapped_ports(plugged: tuple[Rig, Monochromator, ThorlabsWheel]) -> None:
    rig, _, _ = plugged
    swapped = replace(
        rig,
        monochromator=replace(rig.monochromator, port=rig.wheel.port),
        wheel=replace(rig.wheel, port=rig.monochromator.port),
    )
    rows, _ = examined(swapped, Dark(rig))
    table = " ".join(row.result for row in rows)
    assert "a device of the Thorlabs dialect answers" in table
    assert "a device of the Acton dialect answers" in table


def test_the_doctor_examines_a_wheel_on_the_monochromators_controller(rig: Rig) -> None:
    with EmulatedRig(rig_of("acton-wheel", rig, shared=True), None, dialect="usb-lower-case") as emulated:
        rows, table = examined(emulated.rig, Dark(rig))
    assert all(row.passed for row in rows), table
    assert {row.result for row in rows if row.check == "port"} == {emulated.rig.wheel.port}


def test_a_dark_frame_that_sees_light_fails(plugged: tuple[Rig, Monochromator, ThorlabsWheel]) -> None:
    rig, _, _ = plugged
    rows, table = examined(rig, Dark(rig, level=60000))
    assert not rows[-1].passed
    assert "close the shutter" in table


def test_lines_of_the_table_fit_a_page(plugged: tuple[Rig, Monochromator, ThorlabsWheel]) -> None:
    rig, _, _ = plugged
    missing = replace(rig, wheel=replace(rig.wheel, port="/dev/no-such-port"))
    _, table = examined(missing, Dark(rig))
    assert max(map(len, table.splitlines())) <= 118
