"""The dialects of the emulated devices, byte by byte, and their moves in virtual time."""

from __future__ import annotations

import threading
import time
from itertools import pairwise

import pytest

from brdfpipe.rig.emulator.clock import VirtualClock
from brdfpipe.rig.emulator.instruments import ActonWheel, Grating, Monochromator, ThorlabsWheel


@pytest.fixture
def clock() -> VirtualClock:
    return VirtualClock()


@pytest.fixture
def monochromator(clock: VirtualClock) -> Monochromator:
    return Monochromator(clock, slew=100.0)


# --- time


def test_virtual_time_passes_only_when_advanced(clock: VirtualClock) -> None:
    assert clock.now() == 0
    clock.advance_to(2.5)
    clock.advance_to(2.0)
    assert clock.now() == 2.5
    clock.advance_to(4.0)
    assert clock.now() == 4.0


def test_time_never_runs_backwards_whichever_thread_advances_it(clock: VirtualClock) -> None:
    readings: list[list[float]] = [[] for _ in range(4)]

    def advance(number: int) -> None:
        for step in range(2000):
            clock.advance_to(0.25 * step + number)
            readings[number].append(clock.now())

    threads = [threading.Thread(target=advance, args=(number,), daemon=True) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert all(times == sorted(times) for times in readings)
    assert clock.now() == 0.25 * 1999 + 3


def test_a_move_in_real_time_takes_its_stated_time() -> None:
    monochromator = Monochromator(VirtualClock(realtime=True), slew=1000.0)
    started = time.monotonic()
    assert monochromator.feed(b"200 GOTO\r") == b"200 GOTO ok\r\n"
    assert 0.2 <= time.monotonic() - started < 120


def test_released_real_time_does_not_wait() -> None:
    clock = VirtualClock(realtime=True)
    threading.Timer(0.05, clock.release).start()
    started = time.monotonic()
    clock.advance_to(600)
    clock.advance_to(1e6)
    assert time.monotonic() - started < 300


def test_no_real_time_passes_otherwise(monochromator: Monochromator) -> None:
    started = time.monotonic()
    monochromator.feed(b"0.01 NM/MIN 1 NM\r")
    assert monochromator.clock.now() == pytest.approx(6000)
    assert time.monotonic() - started < 300


# --- Acton: the line


@pytest.mark.parametrize(
    ("command", "answer"),
    [
        (b"?NM", b" 546.100 nm  ok\r\n"),
        (b"?NM/MIN", b" 100.000 nm/min  ok\r\n"),
        (b"MODEL", b" SP-2-300i  ok\r\n"),
        (b"SERIAL", b" 2330123  ok\r\n"),
        (b"?GRATING", b" 1  ok\r\n"),
        (b"MONO-?DONE", b" 1  ok\r\n"),
        (b"435.8 GOTO", b" ok\r\n"),
        (b"", b" ok\r\n"),
        (b"MODLE", b"MODLE ? \r\n"),
        (b"\x00X\xf0~MODEL", b"\x00X\xf0~MODEL ? \r\n"),
        (b"1e3 GOTO", b"1e3 ? \r\n"),
        (b"nan GOTO", b"nan ? \r\n"),
    ],
)
def test_the_answers_of_a_monochromator(clock: VirtualClock, command: bytes, answer: bytes) -> None:
    monochromator = Monochromator(clock, wavelength=546.1)
    assert monochromator.feed(command + b"\r") == command + answer


def test_the_echo_can_be_switched_off_and_on(monochromator: Monochromator) -> None:
    assert monochromator.feed(b"NO-ECHO\r") == b"NO-ECHO ok\r\n"
    assert monochromator.feed(b"?GRATING\r") == b" 1  ok\r\n"
    assert monochromator.feed(b"ECHO\r") == b" ok\r\n"
    assert monochromator.feed(b"?GRATING\r") == b"?GRATING 1  ok\r\n"


def test_characters_are_echoed_as_they_come(monochromator: Monochromator) -> None:
    replies = [monochromator.feed(bytes([character])) for character in b"?GRATING\r"]
    assert replies == [b"?", b"G", b"R", b"A", b"T", b"I", b"N", b"G", b" 1  ok\r\n"]


def test_several_commands_in_one_write_are_answered_in_turn(monochromator: Monochromator) -> None:
    assert monochromator.feed(b"300 GOTO\r?NM\r?GRAT") == b"300 GOTO ok\r\n?NM 300.000 nm  ok\r\n?GRAT"
    assert monochromator.feed(b"ING\r") == b"ING 1  ok\r\n"


def test_several_commands_on_a_line_get_one_ok(monochromator: Monochromator) -> None:
    line = b"600 NM/MIN 500 GOTO ?NM ?NM/MIN"
    assert monochromator.feed(line + b"\r") == line + b" 500.000 nm  600.000 nm/min  ok\r\n"


def test_a_number_is_used_by_the_next_command_that_takes_one(monochromator: Monochromator) -> None:
    assert monochromator.feed(b"500 600\r") == b"500 600 ok\r\n"
    assert monochromator.feed(b"GOTO\r") == b"GOTO ok\r\n"
    assert monochromator.wavelength == 600
    assert monochromator.feed(b"GOTO\r") == b"GOTO ok\r\n"
    assert monochromator.wavelength == 500
    assert monochromator.feed(b"GOTO\r") == b"GOTOGOTO ? \r\n"


def test_an_unknown_command_ends_the_line_and_clears_the_numbers(monochromator: Monochromator) -> None:
    assert monochromator.feed(b"?GRATING 500 GTOO 600 GOTO\r").endswith(b" GOTO 1 GTOO ? \r\n")
    assert monochromator.feed(b"GOTO\r").endswith(b"GOTO ? \r\n")
    assert monochromator.wavelength == 0


def test_a_unit_that_knows_only_lower_case(clock: VirtualClock) -> None:
    monochromator = Monochromator(clock, case="lower")
    assert monochromator.feed(b"500 GOTO\r") == b"500 GOTOGOTO ? \r\n"
    assert monochromator.wavelength == 0
    assert monochromator.feed(b"500 goto\r") == b"500 goto ok\r\n"
    assert monochromator.wavelength == 500
    assert Monochromator(clock, case="upper").feed(b"?nm\r") == b"?nm?nm ? \r\n"


@pytest.mark.parametrize("marker", [0x1A, 0xAF])
def test_the_grating_in_place_is_marked(clock: VirtualClock, marker: int) -> None:
    gratings = {1: Grating(1200, "500NM"), 3: Grating(150, "2UM")}
    reply = Monochromator(clock, gratings=gratings, grating=3, echo=False, marker=marker).feed(b"?GRATINGS\r")
    lines = reply.decode("latin-1").split("\r\n")
    assert lines[:4] == [
        "",
        " 1 1200 g/mm BLZ=  500NM ",
        " 2  Not Installed     ",
        f"{chr(marker)}3  150 g/mm BLZ=    2UM ",
    ]
    assert lines[4:10] == [f" {number}  Not Installed     " for number in range(4, 10)]
    assert lines[10:] == [" ok", ""]


# --- Acton: moves


@pytest.mark.parametrize(("asked", "got"), [("-20", 0), ("0", 0), ("1400", 1400), ("1400.1", 1400), ("9999", 1400)])
def test_wavelengths_out_of_range_are_clamped_in_silence(monochromator: Monochromator, asked: str, got: float) -> None:
    assert monochromator.feed(f"{asked} GOTO\r".encode()).endswith(b"GOTO ok\r\n")
    assert monochromator.wavelength == got


@pytest.mark.parametrize("number", [0, 3, 9, 10, 1.5])
def test_an_absent_grating_is_answered_with_ok(monochromator: Monochromator, number: float) -> None:
    assert monochromator.feed(f"{number} GRATING\r".encode()).endswith(b"GRATING ok\r\n")
    assert monochromator.feed(b"?GRATING\r").endswith(b" 1  ok\r\n")
    assert monochromator.clock.now() == 0


def test_a_finer_grating_reaches_less_far(clock: VirtualClock) -> None:
    monochromator = Monochromator(clock, gratings={1: Grating(600, "1.0UM"), 2: Grating(2400, "240NM")})
    monochromator.feed(b"2500 GOTO\r")
    assert monochromator.wavelength == 2500
    monochromator.feed(b"2 GRATING\r")
    assert (monochromator.grating, monochromator.wavelength) == (2, 700)


def test_a_move_costs_its_distance_at_full_speed(monochromator: Monochromator) -> None:
    monochromator.feed(b"500 GOTO\r")
    assert monochromator.clock.now() == pytest.approx(5)
    monochromator.feed(b"450 <GOTO>\r")
    assert monochromator.clock.now() == pytest.approx(5.5)
    monochromator.feed(b"450 GOTO\r")
    assert monochromator.clock.now() == pytest.approx(5.5)


def test_a_scan_costs_its_distance_at_the_set_speed(monochromator: Monochromator) -> None:
    monochromator.feed(b"600 NM/MIN 50 NM\r")
    assert monochromator.wavelength == 50
    assert monochromator.clock.now() == pytest.approx(5)


@pytest.mark.parametrize(("asked", "got"), [("0", 0.01), ("-5", 0.01), ("1", 1), ("99999", 6000)])
def test_speeds_out_of_range_are_clamped_in_silence(monochromator: Monochromator, asked: str, got: float) -> None:
    monochromator.feed(f"{asked} NM/MIN\r".encode())
    assert monochromator.feed(b"?NM/MIN\r") == f"?NM/MIN {got:.3f} nm/min  ok\r\n".encode()


def test_a_frame_exposed_during_a_move_sees_the_wavelength_of_that_time(monochromator: Monochromator) -> None:
    monochromator.restore(500)
    assert monochromator.feed(b"1200 NM/MIN 700 >NM\r").endswith(b">NM ok\r\n")
    wavelengths = []
    for _ in range(6):
        wavelengths.append(monochromator.wavelength)
        monochromator.clock.advance_to(monochromator.clock.now() + 2)
    assert wavelengths == pytest.approx([500, 540, 580, 620, 660, 700])
    assert monochromator.wavelength == 700


def test_polling_for_the_end_of_a_move_takes_the_time_of_the_move(
    monochromator: Monochromator,
) -> None:
    monochromator.feed(b"1200 NM/MIN 99 >NM\r")
    answers = []
    while not answers or answers[-1].endswith(b" 0  ok\r\n"):
        answers.append(monochromator.feed(b"MONO-?DONE\r"))
    assert answers[-1] == b"MONO-?DONE 1  ok\r\n"
    assert len(answers) == 50
    assert monochromator.clock.now() == pytest.approx(4.95)
    assert monochromator.wavelength == 99


def test_stop_ends_a_move_at_the_current_position(monochromator: Monochromator) -> None:
    monochromator.feed(b"600 NM/MIN 100 >NM\r")
    monochromator.clock.advance_to(monochromator.clock.now() + 4)
    assert monochromator.feed(b"MONO-STOP\r") == b"MONO-STOP ok\r\n"
    stopped = monochromator.wavelength
    assert stopped == pytest.approx(41)
    monochromator.clock.advance_to(monochromator.clock.now() + 60)
    assert monochromator.wavelength == stopped
    assert monochromator.feed(b"MONO-?DONE\r") == b"MONO-?DONE 1  ok\r\n"


def test_a_new_move_starts_at_the_current_position(monochromator: Monochromator) -> None:
    monochromator.feed(b"600 NM/MIN 100 >NM\r")
    monochromator.clock.advance_to(monochromator.clock.now() + 1.9)
    monochromator.feed(b"0 >NM\r")  # at 20 nm: asking took 0.1 s more
    monochromator.clock.advance_to(monochromator.clock.now() + 1)
    assert monochromator.wavelength == pytest.approx(10)


def test_a_restored_device_is_at_rest(monochromator: Monochromator) -> None:
    monochromator.feed(b"600 NM/MIN 100 >NM\r")
    monochromator.restore(612.5)
    monochromator.clock.advance_to(monochromator.clock.now() + 100)
    assert monochromator.wavelength == 612.5
    assert monochromator.clock.now() == 100


# --- wheels


def test_the_answers_of_an_acton_wheel(clock: VirtualClock) -> None:
    wheel = ActonWheel(clock)
    assert wheel.feed(b"3 FILTER\r?FILTER\r") == b"3 FILTER ok\r\n?FILTER 3  ok\r\n"
    assert wheel.feed(b"FHOME ?FILTER\r") == b"FHOME ?FILTER 1  ok\r\n"
    assert wheel.feed(b"NO-ECHO\r?FILTER\r") == b"NO-ECHO ok\r\n 1  ok\r\n"
    for unknown in (b"MODEL", b"?NM", b"FILTER"):
        assert wheel.feed(unknown + b"\r") == unknown + b" ? \r\n"


@pytest.mark.parametrize("absent", [b"0", b"7", b"-1", b"2.5"])
def test_an_acton_wheel_answers_ok_to_a_filter_it_has_not(clock: VirtualClock, absent: bytes) -> None:
    wheel = ActonWheel(clock, position=4)
    assert wheel.feed(absent + b" FILTER\r").endswith(b"FILTER ok\r\n")
    assert (wheel.position, clock.now()) == (4, 0)


@pytest.mark.parametrize(
    ("command", "answer"),
    [
        (b"*idn?", b"THORLABS FW102C/FW212C Filter Wheel version 1.07\r> "),
        (b"pos?", b"4\r> "),
        (b"pcount?", b"6\r> "),
        (b"speed?", b"1\r> "),
        (b"sensors?", b"0\r> "),
        (b"trig?", b"0\r> "),
        (b"baud?", b"1\r> "),
        (b"save", b"> "),
        (b"pos=3", b"> "),
        (b"speed=0", b"> "),
        (b"", b"Command error CMD_NOT_DEFINED\r> "),
        (b"POS?", b"Command error CMD_NOT_DEFINED\r> "),
        (b"pos", b"Command error CMD_NOT_DEFINED\r> "),
        (b"pos = 3", b"Command error CMD_NOT_DEFINED\r> "),
        (b"\npos?", b"Command error CMD_NOT_DEFINED\r> "),
        (b"\xffpos?", b"Command error CMD_NOT_DEFINED\r> "),
        (b"pos=", b"Command error CMD_ARG_INVALID\r> "),
        (b"pos=0", b"Command error CMD_ARG_INVALID\r> "),
        (b"pos=7", b"Command error CMD_ARG_INVALID\r> "),
        (b"pos=2.5", b"Command error CMD_ARG_INVALID\r> "),
        (b"pos=-1", b"Command error CMD_ARG_INVALID\r> "),
        (b"speed=2", b"Command error CMD_ARG_INVALID\r> "),
        (b"pcount=12", b"> "),
        (b"pcount=7", b"Command error CMD_ARG_INVALID\r> "),
    ],
)
def test_the_answers_of_a_thorlabs_wheel(clock: VirtualClock, command: bytes, answer: bytes) -> None:
    wheel = ThorlabsWheel(clock, position=4)
    assert wheel.feed(command + b"\r") == command + b"\r" + answer


def test_settings_of_a_thorlabs_wheel_are_stored(clock: VirtualClock) -> None:
    wheel = ThorlabsWheel(clock)
    wheel.feed(b"sensors=1\rtrig=1\r")
    assert wheel.feed(b"sensors?\r") == b"sensors?\r1\r> "
    assert wheel.feed(b"trig?\r") == b"trig?\r1\r> "


def test_a_thorlabs_wheel_takes_a_second_a_filter_and_two_when_slow(clock: VirtualClock) -> None:
    wheel = ThorlabsWheel(clock, positions=12)
    wheel.feed(b"pos=5\r")
    assert clock.now() == pytest.approx(4)
    wheel.feed(b"speed=0\rpos=3\r")
    assert clock.now() == pytest.approx(8)


@pytest.mark.parametrize(("to", "expected"), [(3, [1, 2, 3, 3]), (5, [1, 6, 5, 5])])
def test_a_wheel_turns_the_shorter_way(clock: VirtualClock, to: int, expected: list[int]) -> None:
    wheel = ActonWheel(clock, position=1)
    wheel.receive(f"{to} FILTER\r".encode())  # the answer is not awaited
    positions = []
    for _ in range(4):
        positions.append(wheel.position)
        clock.advance_to(clock.now() + 1)
    assert positions == expected


def test_a_busy_wheel_reads_on_when_it_has_arrived(clock: VirtualClock) -> None:
    wheel = ThorlabsWheel(clock)
    wheel.receive(b"pos=4\r")
    assert (wheel.position, clock.now()) == (1, 0)
    assert wheel.feed(b"pos?\r") == b"pos?\r4\r> "
    assert clock.now() == pytest.approx(3)


@pytest.mark.parametrize("wheel_of", [ActonWheel, ThorlabsWheel])
def test_a_wheel_is_restored_at_rest(clock: VirtualClock, wheel_of: type[ActonWheel | ThorlabsWheel]) -> None:
    wheel = wheel_of(clock, positions=12)
    wheel.restore(11)
    clock.advance_to(clock.now() + 5)
    assert (wheel.position, clock.now()) == (11, 5)


def test_two_devices_that_move_at_once_take_the_time_of_the_slower(clock: VirtualClock) -> None:
    monochromator, wheel = Monochromator(clock, slew=100), ActonWheel(clock)
    monochromator.receive(b"500 GOTO\r")
    wheel.receive(b"3 FILTER\r")
    wheel.finish_move()
    assert clock.now() == pytest.approx(2)
    assert monochromator.wavelength == pytest.approx(200)
    monochromator.finish_move()
    assert clock.now() == pytest.approx(5)


def test_a_command_costs_well_under_a_third_of_a_millisecond(monochromator: Monochromator) -> None:
    """By processor time, which a busy machine does not lengthen."""
    moments = [time.process_time()]
    for _ in range(20):
        for _ in range(100):
            monochromator.feed(b"?NM\r")
        moments.append(time.process_time())
    assert min(after - before for before, after in pairwise(moments)) / 100 < 0.1e-3
