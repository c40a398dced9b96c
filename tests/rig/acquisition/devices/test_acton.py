"""The Acton drivers against scripts written from the manuals, and against a device on a line that damages its replies."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from serial_script import Chunk, Exchange, Script, ScriptedPort, scripted_line

from brdfpipe.rig.acquisition.devices.acton import FilterWheel, Monochromator
from brdfpipe.rig.acquisition.devices.errors import DeviceError, DeviceLost, NoReply, WrongDevice
from brdfpipe.rig.description import SerialSettings

SETTINGS = SerialSettings("acton", "/dev/ttyUSB0", 9600)
WHEEL = SerialSettings("acton-wheel", "/dev/ttyUSB1", 9600)

Reply = Callable[[bytes], bytes | Sequence[Chunk] | Exception]


def monochromator(reply: Reply, given: SerialSettings = SETTINGS) -> Monochromator:
    return Monochromator(scripted_line(given, reply))


def wheel(reply: Reply, given: SerialSettings = WHEEL) -> FilterWheel:
    return FilterWheel(scripted_line(given, reply))


WAKE: tuple[Exchange, ...] = ((b"\r", b" ok\r\n"), (b"ECHO\r", b"ECHO ok\r\n"))
NAMES: tuple[Exchange, ...] = (
    (b"MODEL\r", b"MODEL SP-2-300i  ok\r\n"),
    (b"?NM\r", b"?NM 0.000 nm  ok\r\n"),
    (b"SERIAL\r", b"SERIAL 2330123  ok\r\n"),
)
GREETING = (*WAKE, *NAMES, *NAMES)


def finished(driver: Monochromator | FilterWheel, *exchanges: Exchange) -> Script:
    """The port of the driver continues with these exchanges."""
    script = Script(*exchanges)
    port = driver.line.connection.port
    assert isinstance(port, ScriptedPort)
    port.reply = script
    return script


# --- transcripts


def test_a_monochromator_is_identified_by_model_and_serial_number_read_twice() -> None:
    script = Script(*GREETING)
    assert monochromator(script).identify() == "SP-2-300i 2330123"
    assert script.finished


def test_a_move_is_sent_waited_for_and_read_back() -> None:
    script = Script(
        *GREETING,
        (b"546.074 GOTO\r", [(0, b"546.074 GOTO"), (8.0, b" ok\r\n")]),
        (b"?NM\r", b"?NM 546.070 nm  ok\r\n"),
    )
    assert monochromator(script).goto(546.0744) == 546.07
    assert script.finished


@pytest.mark.parametrize("reply", [b" 546.10  ok\r\n", b"\r546.100 nm ok\r\n", b" 546.100 NM  ok\r\n"])
def test_the_wavelength_is_read_as_every_model_writes_it(reply: bytes) -> None:
    assert monochromator(Script(*GREETING, (b"?NM\r", b"?NM" + reply))).wavelength() == pytest.approx(546.1)


def test_a_unit_of_lower_case_is_spoken_to_in_lower_case_alone() -> None:
    script = Script(*((sent.lower(), reply.lower()) for sent, reply in GREETING if isinstance(reply, bytes)))
    device = monochromator(script, replace(SETTINGS, case="lower"))
    assert device.identify() == "sp-2-300i 2330123"
    assert script.finished


def test_a_unit_that_knows_no_command_is_refused_with_the_hint_about_case() -> None:
    with pytest.raises(WrongDevice, match=r"'\?NM'.*\?NM \?.*case: upper"):
        monochromator(lambda sent: sent.rstrip(b"\r") + b" ? \r\n", replace(SETTINGS, case="upper")).identify()


def test_a_unit_that_knows_no_command_in_either_case_is_refused() -> None:
    sent: list[bytes] = []

    def refuse(command: bytes) -> bytes:
        sent.append(command)
        return command.rstrip(b"\r") + b" ? \r\n"

    with pytest.raises(WrongDevice, match=r"unknown command; sent '\?NM'.*device of the description is connected"):
        monochromator(refuse).identify()
    assert {b"?NM\r", b"?nm\r"} <= set(sent)


def test_an_old_unit_without_a_serial_number_is_named_by_its_model() -> None:
    names = (*NAMES[:2], (b"SERIAL\r", b"SERIAL ? \r\n"))
    assert monochromator(Script(*WAKE, *names, *names)).identify() == "SP-2-300i"


def test_a_serial_number_that_is_not_the_described_one_is_another_device() -> None:
    with pytest.raises(WrongDevice, match="serial number of 'SP-2-300i 2330123' is not '999'"):
        monochromator(Script(*GREETING), replace(SETTINGS, serial_number="999")).identify()


def test_the_described_serial_number_is_accepted() -> None:
    device = monochromator(Script(*GREETING), replace(SETTINGS, serial_number="2330123"))
    assert device.identify() == "SP-2-300i 2330123"


def test_a_clamped_wavelength_is_never_taken_for_the_requested_one() -> None:
    end = (b"?NM\r", b"?NM 1400.000 nm  ok\r\n")
    script = Script(*GREETING, *((b"1500.000 GOTO\r", b"1500.000 GOTO ok\r\n"), end) * 2)
    with pytest.raises(
        DeviceError, match=r"monochromator on /dev/ttyUSB0.*requested 1500 nm, device reports 1400 nm.*range"
    ):
        monochromator(script).goto(1500)
    assert script.finished


def test_a_garbled_digit_never_yields_another_wavelength() -> None:
    move = (b"500.000 GOTO\r", b"500.000 GOTO ok\r\n")
    script = Script(*GREETING, move, (b"?NM\r", b"?NM 900.000 nm  ok\r\n"), move, (b"?NM\r", b"?NM 500.000 nm  ok\r\n"))
    assert monochromator(script).goto(500) == 500


@pytest.mark.parametrize("wavelength", [float("nan"), float("inf"), -1.0, 1e9])
def test_an_invalid_wavelength_is_never_sent(wavelength: float) -> None:
    script = Script(*GREETING)
    device = monochromator(script)
    device.identify()
    with pytest.raises(DeviceError, match="out of range"):
        device.goto(wavelength)


GRATINGS = b"?GRATINGS \r\n 1  1200 g/mm BLZ=  500NM \r\n%s2   300 g/mm BLZ=  1.0UM \r\n 3  Not Installed     \r\n 4 \r\n ok\r\n"


@pytest.mark.parametrize("arrow", [b"\x1a", b"\xaf"])
def test_the_described_grating_is_selected_and_verified(arrow: bytes) -> None:
    script = Script(
        *GREETING,
        (b"?GRATINGS\r", GRATINGS % arrow),
        (b"?GRATING\r", b"?GRATING 2  ok\r\n"),
        (b"1 GRATING\r", [(0, b"1 GRATING"), (18.0, b" ok\r\n")]),
        (b"?GRATING\r", b"?GRATING 1  ok\r\n"),
    )
    monochromator(script, replace(SETTINGS, grating=1)).identify()
    assert script.finished


def test_a_grating_in_place_is_left_alone() -> None:
    script = Script(*GREETING, (b"?GRATINGS\r", GRATINGS % b"\x1a"), (b"?GRATING\r", b"?GRATING 2  ok\r\n"))
    monochromator(script, replace(SETTINGS, grating=2)).identify()
    assert script.finished


@pytest.mark.parametrize("grating", [3, 4, 7])
def test_an_absent_grating_is_refused_though_the_device_would_answer_ok(grating: int) -> None:
    script = Script(*GREETING, (b"?GRATINGS\r", GRATINGS % b"\x1a"))
    with pytest.raises(
        DeviceError, match=rf"grating {grating} is not installed; installed: 1 \(1200 g/mm BLZ= 500NM\), 2"
    ):
        monochromator(script, replace(SETTINGS, grating=grating)).identify()


def test_a_grating_that_answers_ok_but_is_not_in_place_is_refused() -> None:
    script = Script(
        *GREETING,
        (b"?GRATINGS\r", GRATINGS % b"\x1a"),
        (b"?GRATING\r", b"?GRATING 2  ok\r\n"),
        (b"1 GRATING\r", b"1 GRATING ok\r\n"),
        (b"?GRATING\r", b"?GRATING 2  ok\r\n"),
    )
    with pytest.raises(DeviceError, match="wrong grating: requested 1, device reports 2"):
        monochromator(script, replace(SETTINGS, grating=1)).identify()


SPEED = (b"600.00 NM/MIN\r", b"600.00 NM/MIN ok\r\n")


def test_a_move_at_a_speed_is_polled_and_ended_by_a_stop() -> None:
    script = Script(
        *GREETING,
        SPEED,
        (b"?NM/MIN\r", b"?NM/MIN 600.000 nm/min  ok\r\n"),
        (b"?NM\r", b"?NM 500.000 nm  ok\r\n"),
        (b"510.000 >NM\r", b"510.000 >NM ok\r\n"),
        (b"MONO-?DONE\r", b"MONO-?DONE 0  ok\r\n"),
        (b"MONO-?DONE\r", b"MONO-?DONE 1  ok\r\n"),
        (b"MONO-STOP\r", b"MONO-STOP ok\r\n"),
        (b"?NM\r", b"?NM 510.000 nm  ok\r\n"),
    )
    assert monochromator(script, replace(SETTINGS, speed=600)).goto(510) == 510
    assert script.finished


def test_a_speed_the_device_clamps_is_refused() -> None:
    script = Script(*GREETING, SPEED, (b"?NM/MIN\r", b"?NM/MIN 100.000 nm/min  ok\r\n"))
    with pytest.raises(DeviceError, match="wrong speed: requested 600 nm/min, device reports 100 nm/min"):
        monochromator(script, replace(SETTINGS, speed=600)).identify()


def test_a_move_at_a_speed_that_does_not_end_is_stopped() -> None:
    sent: list[bytes] = []

    def never_done(command: bytes) -> bytes:
        sent.append(command)
        if command == b"MONO-?DONE\r":
            return b"MONO-?DONE 0  ok\r\n"
        replies = dict(GREETING) | {b"?NM/MIN\r": b"?NM/MIN 600.000 nm/min  ok\r\n"}
        reply = replies.get(command, command.rstrip(b"\r") + b" ok\r\n")
        assert isinstance(reply, bytes)
        return reply

    device = monochromator(never_done, replace(SETTINGS, speed=600, motion_timeout=1))
    with pytest.raises(DeviceError, match="move not finished after 2 s"):
        device.goto(10)
    assert sent[-1] == b"MONO-STOP\r"


# --- faults: after a lost reply the device is identified and the command repeated


def test_a_late_ok_is_never_read_as_a_wavelength() -> None:
    """The ok of a GOTO that timed out comes after the echo of the next query, before its reply."""
    device = monochromator(Script(*GREETING))
    device.identify()
    script = finished(
        device,
        (b"700.000 GOTO\r", b"700.000 GOTO"),
        *WAKE[:1],
        (b"ECHO\r", b""),
        (b"MODEL\r", b"MODEL ok\r\n SP-2-300i  ok\r\n"),  # still busy: this reply does not count
        *WAKE,
        *NAMES,
        (b"700.000 GOTO\r", b"700.000 GOTO ok\r\n"),
        (b"?NM\r", b"?NM 700.000 nm  ok\r\n"),
    )
    assert device.goto(700) == 700
    assert script.finished


def test_a_device_without_replies_is_refused_after_three_attempts() -> None:
    device = monochromator(Script(*GREETING))
    device.identify()
    script = finished(device, (b"?NM\r", b""), *(*WAKE, *NAMES, (b"?NM\r", b"")) * 2)
    with pytest.raises(
        NoReply, match=r"monochromator on /dev/ttyUSB0: no reply in 1 s, 3 times; sent '\?NM'; got nothing; check"
    ):
        device.wavelength()
    assert script.finished


def test_an_exchanged_device_is_detected() -> None:
    device = monochromator(Script(*GREETING))
    device.identify()
    other = ((b"MODEL\r", b"MODEL SP-2-150i  ok\r\n"), *NAMES[1:])
    finished(device, (b"?NM\r", b""), *WAKE, *other, *other)
    with pytest.raises(WrongDevice, match="'SP-2-150i 2330123' answers instead of 'SP-2-300i 2330123'"):
        device.wavelength()


def test_a_garbled_name_is_not_taken_for_another_device() -> None:
    device = monochromator(Script(*GREETING))
    device.identify()
    garbled = ((b"MODEL\r", b"MODEL SP-2-3~0i  ok\r\n"), *NAMES[1:])
    script = finished(
        device, (b"?NM\r", b""), *WAKE, *garbled, *NAMES, *WAKE, *NAMES, (b"?NM\r", b"?NM 1.000 nm  ok\r\n")
    )
    assert device.wavelength() == 1
    assert script.finished


def test_after_a_power_failure_the_grating_is_selected_again_before_the_command() -> None:
    device = monochromator(
        Script(*GREETING, (b"?GRATINGS\r", GRATINGS % b"\x1a"), (b"?GRATING\r", b"?GRATING 2  ok\r\n")),
        replace(SETTINGS, grating=2),
    )
    device.identify()
    script = finished(
        device,
        (b"?NM\r", b""),
        *WAKE,
        *NAMES,
        (b"?GRATINGS\r", GRATINGS % b" "),
        (b"?GRATING\r", b"?GRATING 1  ok\r\n"),
        (b"2 GRATING\r", b"2 GRATING ok\r\n"),
        (b"?GRATING\r", b"?GRATING 2  ok\r\n"),
        (b"?NM\r", b"?NM 546.100 nm  ok\r\n"),
    )
    assert device.wavelength() == 546.1
    assert script.finished


def test_a_thorlabs_wheel_on_the_port_of_a_monochromator_is_named() -> None:
    def thorlabs(sent: bytes) -> bytes:
        return sent + b"Command error CMD_NOT_DEFINED\r> "

    with pytest.raises(WrongDevice, match=r"a device of the Thorlabs dialect answers.*correct `port` or `dialect`"):
        monochromator(thorlabs).identify()


def test_a_filter_wheel_on_the_port_of_a_monochromator_is_refused() -> None:
    """It may know MODEL, but it has no wavelength."""

    def filter_wheel(sent: bytes) -> bytes:
        known = {b"MODEL": b" FA-448 ", b"ECHO": b"", b"": b"", b"?FILTER": b" 1 "}
        word = sent.rstrip(b"\r")
        return word + known[word] + b" ok\r\n" if word in known else word + b" ? \r\n"

    with pytest.raises(WrongDevice, match=r"'\?NM'"):
        monochromator(filter_wheel).identify()


# --- a device with a state, on a line that damages its replies


@dataclass
class Unit:
    """A monochromator that carries out each command even if its reply is damaged."""

    mangle: Callable[[int, bytes], bytes | Exception] = lambda _, reply: reply
    wavelength: float = 0.0
    ordinal: int = 0
    been: set[float] = field(default_factory=lambda: {0.0})

    def __call__(self, sent: bytes) -> bytes | Exception:
        command = sent.rstrip(b"\r")
        self.ordinal += 1
        if command.endswith(b" GOTO"):
            self.wavelength = min(max(float(command.split()[0]), 0.0), 1400.0)
            self.been.add(self.wavelength)
        answers = {
            b"MODEL": b" SP-2-300i ",
            b"SERIAL": b" 2330123 ",
            b"?NM": b" %.3f nm " % self.wavelength,
        }
        known = command in (b"", b"ECHO") or command.endswith(b" GOTO")
        body = answers.get(command, b"" if known else b" ?")
        return self.mangle(self.ordinal, command + body + (b" \r\n" if body == b" ?" else b" ok\r\n"))


# No driver can detect complete replies to other queries: the line has no checksum.
FRAGMENTS = st.sampled_from([b" ok\r\n", b"?NM", b" ", b"\r\n", b"\r> ", b" ? \r\n", b"nm", b"7", b"MODEL", b"\x1a"])
NOISE = st.one_of(st.binary(max_size=6), st.lists(FRAGMENTS, max_size=4).map(b"".join))
WAVELENGTHS = st.floats(0, 1500, allow_nan=False)


@given(noise=NOISE, command=st.integers(1, 30), wavelengths=st.lists(WAVELENGTHS, min_size=1, max_size=3))
@settings(max_examples=200)
def test_noise_before_any_reply_never_yields_a_wrong_wavelength(
    noise: bytes, command: int, wavelengths: list[float]
) -> None:
    unit = Unit(lambda ordinal, reply: noise + reply if ordinal == command else reply)
    device = monochromator(unit)
    for wavelength in wavelengths:
        try:
            reached = device.goto(wavelength)
        except DeviceError:
            assert wavelength > 1400.5
        else:
            assert reached == pytest.approx(unit.wavelength, abs=1e-3)
            assert abs(reached - wavelength) <= 0.5


@given(
    cuts=st.dictionaries(st.integers(1, 40), st.integers(0, 30), max_size=6),
    wavelengths=st.lists(WAVELENGTHS, min_size=1, max_size=3),
)
@settings(max_examples=200)
def test_truncated_replies_are_recovered_or_give_one_error(cuts: dict[int, int], wavelengths: list[float]) -> None:
    def cut(ordinal: int, reply: bytes) -> bytes:
        end = cuts.get(ordinal)
        return reply if end is None else reply[: min(end, len(reply) - 1)]

    unit = Unit(cut)
    device = monochromator(unit)
    for wavelength in wavelengths:
        try:
            reached = device.goto(wavelength)
        except DeviceError as error:
            failure = error
            break
        assert reached == pytest.approx(unit.wavelength, abs=1e-3)
        assert abs(reached - wavelength) <= 0.5
    else:
        return
    assert failure.device == "monochromator"
    assert failure.port == "/dev/ttyUSB0"
    assert failure.advice


@pytest.mark.parametrize("command", range(1, 12))
def test_one_lost_reply_is_always_recovered(command: int) -> None:
    unit = Unit(lambda ordinal, reply: b"" if ordinal == command else reply)
    assert monochromator(unit).goto(546.1) == pytest.approx(546.1)


@pytest.mark.parametrize("command", range(1, 12))
def test_a_device_unplugged_at_any_command_is_lost_with_its_port_named(command: int) -> None:
    unit = Unit(lambda ordinal, reply: OSError(5, "Input/output error") if ordinal >= command else reply)
    device = monochromator(unit)
    with pytest.raises(DeviceLost, match="monochromator on /dev/ttyUSB0: the port was disconnected"):
        [device.goto(wavelength) for wavelength in (500.0, 600.0)]


# --- the wheel

WHEEL_NAMES: tuple[Exchange, ...] = (
    (b"MODEL\r", b"MODEL ? \r\n"),
    (b"SERIAL\r", b"SERIAL ? \r\n"),
    (b"?FILTER\r", b"?FILTER 1  ok\r\n"),
)
WHEEL_GREETING = (*WAKE, *WHEEL_NAMES, *WHEEL_NAMES)


def test_a_wheel_without_a_model_is_named_by_its_kind() -> None:
    assert wheel(Script(*WHEEL_GREETING)).identify() == "filter wheel"


def test_a_wheel_is_moved_and_read_back() -> None:
    script = Script(*WHEEL_GREETING, (b"3 FILTER\r", b"3 FILTER ok\r\n"), (b"?FILTER\r", b"?FILTER 3  ok\r\n"))
    device = wheel(script)
    assert device.goto(np.int64(3)) == 3
    assert script.finished


def test_a_wheel_at_a_wrong_position_is_sent_home_and_moved_again() -> None:
    move = (b"3 FILTER\r", b"3 FILTER ok\r\n")
    script = Script(
        *WHEEL_GREETING,
        move,
        (b"?FILTER\r", b"?FILTER 4  ok\r\n"),
        (b"FHOME\r", b"FHOME ok\r\n"),
        move,
        (b"?FILTER\r", b"?FILTER 3  ok\r\n"),
    )
    assert wheel(script).goto(3) == 3


def test_a_wheel_that_stays_at_a_wrong_position_is_refused() -> None:
    stuck = ((b"3 FILTER\r", b"3 FILTER ok\r\n"), (b"?FILTER\r", b"?FILTER 4  ok\r\n"))
    script = Script(*WHEEL_GREETING, *stuck, (b"FHOME\r", b"FHOME ok\r\n"), *stuck)
    with pytest.raises(
        DeviceError, match="filter wheel on /dev/ttyUSB1: wrong position: requested 3, device reports 4; check"
    ):
        wheel(script).goto(3)


@pytest.mark.parametrize("position", [0, 7, -1])
def test_a_position_the_wheel_has_not_is_never_sent(position: int) -> None:
    with pytest.raises(DeviceError, match=f"no position {position}; accepted: 1 to 6"):
        wheel(Script()).goto(position)


def test_a_monochromator_on_the_port_of_a_wheel_is_refused() -> None:
    with pytest.raises(WrongDevice, match=r"'\?FILTER'"):
        wheel(Unit()).identify()
