"""Emulated devices against short models, for random sequences of commands."""

from __future__ import annotations

from dataclasses import dataclass

import hypothesis.strategies as st
import pytest
from hypothesis import given, settings
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from brdfpipe.rig.emulator.clock import VirtualClock
from brdfpipe.rig.emulator.faults import Faults, FaultyLine
from brdfpipe.rig.emulator.instruments import ActonWheel, Grating, Monochromator, ThorlabsWheel
from brdfpipe.rig.emulator.serial_device import SerialDevice

LIMITS = {1: 1400.0, 2: 2800.0, 4: 700.0}
GRATINGS = {1: Grating(1200, "500NM"), 2: Grating(600, "1.0UM"), 4: Grating(2400, "240NM")}

wavelengths = st.integers(-200_000, 3_000_000).map(lambda picometres: picometres / 1000)
chunk_sizes = st.lists(st.integers(1, 9), min_size=1, max_size=6)


class MonochromatorAgainstAModel(RuleBasedStateMachine):
    """The model: time, position and target, computed at every step."""

    def __init__(self) -> None:
        super().__init__()
        self.clock = VirtualClock()
        self.device = Monochromator(self.clock, gratings=GRATINGS, slew=80.0)
        self.time = self.place = 0.0
        self.aim, self.rate = 0.0, 1.0
        self.speed, self.grating, self.echo = 100.0, 1, True

    def pass_time(self, seconds: float) -> None:
        step = self.rate * seconds
        self.time += seconds
        self.place = self.aim if step >= abs(self.aim - self.place) else self.place + step * self.sign()

    def sign(self) -> int:
        return 1 if self.aim > self.place else -1

    def left(self) -> float:
        return abs(self.aim - self.place) / self.rate

    def say(self, command: str, chunks: list[int], expected: str = "") -> None:
        """Send in pieces; the answer must be what the model expects."""
        self.pass_time(min(0.1, self.left()))
        data, reply = f"{command}\r".encode(), b""
        while data:
            size = chunks.pop() if chunks else len(data)
            reply += self.device.feed(data[:size])
            data = data[size:]
        assert reply == f"{command if self.echo else ''}{expected} ok\r\n".encode()

    @rule(destination=wavelengths, chunks=chunk_sizes)
    def goto(self, destination: float, chunks: list[int]) -> None:
        self.say(f"{destination:.3f} GOTO", chunks)
        self.aim, self.rate = min(max(destination, 0.0), LIMITS[self.grating]), 80.0
        self.pass_time(self.left())

    @rule(destination=wavelengths, chunks=chunk_sizes)
    def scan(self, destination: float, chunks: list[int]) -> None:
        self.say(f"{destination:.3f} >NM", chunks)
        self.aim, self.rate = min(max(destination, 0.0), LIMITS[self.grating]), self.speed / 60

    @rule(speed=st.integers(1, 4000))
    def set_speed(self, speed: int) -> None:
        self.say(f"{speed} NM/MIN", [])
        self.speed = float(speed)

    @rule()
    def ask_for_the_speed(self) -> None:
        self.say("?NM/MIN", [], f" {self.speed:.3f} nm/min ")

    @rule(number=st.integers(0, 10))
    def change_grating(self, number: int) -> None:
        self.say(f"{number} GRATING", [])
        if number in LIMITS and number != self.grating:
            self.grating = number
            self.place = self.aim = min(self.place, LIMITS[number])
            self.time += 20

    @rule()
    def ask_for_the_grating(self) -> None:
        self.say("?GRATING", [], f" {self.grating} ")

    @rule()
    def stop(self) -> None:
        self.say("MONO-STOP", [])
        self.aim = self.place

    @precondition(lambda self: self.left() == 0 or self.left() > 0.2)
    @rule()
    def ask_whether_it_is_done(self) -> None:
        self.say("MONO-?DONE", [], " 0 " if self.left() else " 1 ")

    @rule(word=st.sampled_from(["ECHO", "NO-ECHO"]))
    def switch_the_echo(self, word: str) -> None:
        self.say(word, [])
        self.echo = word == "ECHO"

    @rule(seconds=st.floats(0, 30))
    def wait(self, seconds: float) -> None:
        self.clock.advance_to(self.clock.now() + seconds)
        self.pass_time(seconds)

    @rule(state=st.integers(0, 700))
    def restore(self, state: int) -> None:
        self.device.restore(state)
        self.place = self.aim = float(state)

    @invariant()
    def it_is_where_the_model_is(self) -> None:
        # To rounding: the model adds steps, the device computes from the start of its move.
        assert self.device.wavelength == pytest.approx(self.place, abs=1e-6)
        assert self.clock.now() == pytest.approx(self.time, abs=1e-6)
        assert 0 <= self.device.wavelength <= LIMITS[self.device.grating]


TestMonochromatorAgainstAModel = MonochromatorAgainstAModel.TestCase
TestMonochromatorAgainstAModel.settings = settings(max_examples=60, stateful_step_count=40, deadline=None)


@dataclass
class _Dialect:
    wheel: ActonWheel | ThorlabsWheel
    move: str
    accepted: str
    refused: str
    ask: str
    position_reply: str


def _acton(count: int) -> _Dialect:
    wheel = ActonWheel(VirtualClock(), positions=count)
    return _Dialect(wheel, "{} FILTER\r", "{} FILTER ok\r\n", "{} FILTER ok\r\n", "?FILTER\r", "?FILTER {}  ok\r\n")


def _thorlabs(count: int) -> _Dialect:
    wheel = ThorlabsWheel(VirtualClock(), positions=count)
    refused = "pos={}\rCommand error CMD_ARG_INVALID\r> "
    return _Dialect(wheel, "pos={}\r", "pos={}\r> ", refused, "pos?\r", "pos?\r{}\r> ")


@pytest.mark.parametrize("dialect", [_acton, _thorlabs])
@given(count=st.integers(2, 13), moves=st.lists(st.integers(0, 14), max_size=12))
def test_a_wheel_reaches_its_last_target_by_the_shorter_way(dialect, count, moves) -> None:
    spoken = dialect(count)
    position, seconds = 1, 0
    for target in moves:
        reply = spoken.wheel.feed(spoken.move.format(target).encode())
        if 1 <= target <= count:
            assert reply == spoken.accepted.format(target).encode()
            seconds += min(abs(target - position), count - abs(target - position))
            position = target
        else:
            assert reply == spoken.refused.format(target).encode()
        assert spoken.wheel.feed(spoken.ask.encode()) == spoken.position_reply.format(position).encode()
        assert (spoken.wheel.position, spoken.wheel.clock.now()) == (position, pytest.approx(seconds))


ACTON = [b"500 GOTO", b"?NM", b"1200 NM/MIN", b"650.5 >NM", b"MONO-?DONE", b"MONO-STOP", b"2 GRATING", b"FOO", b"700"]
THORLABS = [b"pos=3", b"pos=6", b"pos?", b"speed=0", b"pos=9", b"foo", b"*idn?"]
HARMLESS = ["silence", "garbage", "truncated", "late-ok"]


def _state(device: SerialDevice) -> tuple[float, float]:
    device.finish_move()
    place = device.wavelength if isinstance(device, Monochromator) else device.position
    return place, device.clock.now()


@pytest.mark.parametrize(("device_of", "words"), [(Monochromator, ACTON), (ThorlabsWheel, THORLABS)])
@given(data=st.data())
def test_a_bad_line_changes_replies_but_not_moves(device_of, words, data) -> None:
    script = data.draw(st.lists(st.sampled_from(words), max_size=10))
    plan = data.draw(st.dictionaries(st.integers(1, 10), st.sampled_from(HARMLESS)))
    plain, disturbed = device_of(VirtualClock()), device_of(VirtualClock())
    line = FaultyLine(disturbed, Faults.at(plan))
    for command in script:
        plain.feed(command + b"\r")
        line.feed(command + b"\r")
    assert _state(disturbed) == _state(plain)


@pytest.mark.parametrize(("device_of", "words"), [(Monochromator, ACTON), (ThorlabsWheel, THORLABS)])
@given(data=st.data())
def test_a_line_without_faults_is_the_device_however_it_is_cut(device_of, words, data) -> None:
    script = b"".join(word + b"\r" for word in data.draw(st.lists(st.sampled_from(words), max_size=8)))
    whole, line = device_of(VirtualClock()), FaultyLine(device_of(VirtualClock()))
    reply, rest = b"", script
    while rest:
        size = data.draw(st.integers(1, len(rest)))
        reply += line.feed(rest[:size])
        rest = rest[size:]
    assert reply == whole.feed(script)


@pytest.mark.parametrize(("device_of", "words"), [(Monochromator, ACTON), (ThorlabsWheel, THORLABS)])
@given(data=st.data())
def test_late_answers_are_late_and_nothing_else(device_of, words, data) -> None:
    script = data.draw(st.lists(st.sampled_from(words), min_size=1, max_size=8))
    late = data.draw(st.sets(st.integers(1, len(script))))
    plain = device_of(VirtualClock())
    line = FaultyLine(device_of(VirtualClock()), Faults.at(dict.fromkeys(late, "late-ok")))
    reply = b""
    for ordinal, command in enumerate(script, start=1):
        reply += line.feed(command + b"\r")
        if ordinal in late:
            assert reply.endswith(command + (b"\r" if device_of is ThorlabsWheel else b""))
    assert reply + line.feed(words[1] + b"\r") == plain.feed(
        b"".join(command + b"\r" for command in [*script, words[1]])
    )
