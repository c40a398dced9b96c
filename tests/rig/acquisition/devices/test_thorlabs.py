"""The Thorlabs wheel against scripts written from its manual, and on a line that damages its replies."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from serial_script import Chunk, Exchange, Script, scripted_line

from brdfpipe.rig.acquisition.devices.errors import DeviceError, WrongDevice
from brdfpipe.rig.acquisition.devices.thorlabs import FilterWheel
from brdfpipe.rig.description import SerialSettings

SETTINGS = SerialSettings("thorlabs", "/dev/ttyUSB1", 115200)

WAKE: tuple[Exchange, ...] = ((b"\r", b"\rCommand error CMD_NOT_DEFINED\r> "),)
NAMES: tuple[Exchange, ...] = (
    (b"*idn?\r", b"*idn?\rTHORLABS FW102C/FW212C Filter Wheel version 1.07\r> "),
    (b"pos?\r", b"pos?\r1\r> "),
)
READY: tuple[Exchange, ...] = (
    (b"pcount?\r", b"pcount?\r6\r> "),
    (b"sensors=0\r", b"sensors=0\r> "),
    (b"sensors?\r", b"sensors?\r0\r> "),
)
GREETING = (*WAKE, *NAMES, *NAMES, *READY)


def wheel(
    reply: Callable[[bytes], bytes | Sequence[Chunk] | Exception], given: SerialSettings = SETTINGS
) -> FilterWheel:
    return FilterWheel(scripted_line(given, reply))


def test_a_wheel_is_named_counted_and_its_sensors_darkened() -> None:
    script = Script(*GREETING)
    assert wheel(script).identify() == "THORLABS FW102C/FW212C Filter Wheel version 1.07"
    assert script.finished


def test_a_wheel_is_moved_and_read_back() -> None:
    script = Script(*GREETING, (b"pos=3\r", b"pos=3\r> "), (b"pos?\r", b"pos?\r3\r> "))
    assert wheel(script).goto(3) == 3
    assert script.finished


def test_a_read_back_has_the_time_of_a_move() -> None:
    """The prompt comes at once; the wheel arrives and replies later."""
    script = Script(*GREETING, (b"pos=3\r", b"pos=3\r> "), (b"pos?\r", [(4.0, b"pos?\r3\r> ")]))
    assert wheel(script).goto(3) == 3


def test_a_wheel_at_a_wrong_position_is_moved_again_and_then_refused() -> None:
    stuck = ((b"pos=3\r", b"pos=3\r> "), (b"pos?\r", b"pos?\r2\r> "))
    with pytest.raises(
        DeviceError, match="filter wheel on /dev/ttyUSB1: wrong position: requested 3, device reports 2; check"
    ):
        wheel(Script(*GREETING, *stuck * 2)).goto(3)


def test_a_wheel_of_another_size_is_refused_with_the_key_that_mends_it() -> None:
    script = Script(*GREETING[:5], (b"pcount?\r", b"pcount?\r12\r> "))
    with pytest.raises(DeviceError, match="requested 6, device reports 12; set `positions: 12`"):
        wheel(script).identify()


def test_sensors_that_stay_lit_are_refused() -> None:
    script = Script(*GREETING[:-1], (b"sensors?\r", b"sensors?\r1\r> "))
    with pytest.raises(DeviceError, match="sensors reaches the sample"):
        wheel(script).identify()


def test_an_expected_serial_number_must_be_part_of_the_identity() -> None:
    assert wheel(Script(*GREETING), replace(SETTINGS, serial_number="1.07")).identify()
    with pytest.raises(WrongDevice, match="is not 'TP0123'"):
        wheel(Script(*GREETING), replace(SETTINGS, serial_number="TP0123")).identify()


def test_an_acton_device_on_the_port_of_the_wheel_is_named() -> None:
    with pytest.raises(WrongDevice, match="a device of the Acton dialect answers"):
        wheel(lambda sent: sent.rstrip(b"\r") + b" ? \r\n").identify()


@pytest.mark.parametrize("position", [0, 7])
def test_a_position_the_wheel_has_not_is_never_sent(position: int) -> None:
    with pytest.raises(DeviceError, match=f"no position {position}; accepted: 1 to 6"):
        wheel(Script()).goto(position)


class Unit:
    """A wheel with a position; a reply may be truncated, or have noise before it."""

    def __init__(self, cuts: dict[int, int], noise: dict[int, bytes]) -> None:
        self.position, self.ordinal = 1, 0
        self.cuts, self.noise = cuts, noise

    def __call__(self, sent: bytes) -> bytes:
        self.ordinal += 1
        command = sent.rstrip(b"\r").decode()
        answers = {"*idn?": "THORLABS FW102C", "pcount?": "6", "sensors?": "0", "": "Command error CMD_NOT_DEFINED"}
        if command.startswith("pos="):
            self.position = int(command[4:])
        text = answers.get(command, str(self.position) if command == "pos?" else "")
        reply = sent + (f"{text}\r> " if text else "> ").encode()
        if self.ordinal in self.cuts:  # a prompt without its space is complete
            reply = reply[: min(self.cuts[self.ordinal], len(reply) - 2)]
        return self.noise.get(self.ordinal, b"") + reply


FRAGMENTS = st.sampled_from([b"\r> ", b"pos?", b"3", b"\r", b" ok\r\n", b"CMD_NOT_DEFINED", b"*idn?"])
NOISE = st.one_of(st.binary(max_size=6), st.lists(FRAGMENTS, max_size=3).map(b"".join))


@given(
    cuts=st.dictionaries(st.integers(1, 30), st.integers(0, 40), max_size=4),
    noise=st.dictionaries(st.integers(1, 30), NOISE, max_size=2),
    positions=st.lists(st.integers(1, 6), min_size=1, max_size=4),
)
@settings(max_examples=200)
def test_truncated_and_noisy_replies_never_yield_a_wrong_position(
    cuts: dict[int, int], noise: dict[int, bytes], positions: list[int]
) -> None:
    unit = Unit(cuts, noise)
    device = wheel(unit)
    for position in positions:
        try:
            assert device.goto(position) == position == unit.position
        except DeviceError:
            return
