"""Each kind of fault, at its command and at the next."""

from __future__ import annotations

from collections import Counter

import pytest

from brdfpipe.rig.emulator.clock import VirtualClock
from brdfpipe.rig.emulator.effects import EmulationError
from brdfpipe.rig.emulator.faults import KINDS, Faults, FaultyLine, InjectedFault
from brdfpipe.rig.emulator.instruments import ActonWheel, Monochromator, ThorlabsWheel


@pytest.fixture
def monochromator() -> Monochromator:
    return Monochromator(VirtualClock(), slew=100.0)


def _line(monochromator: Monochromator, kind: str, *, ordinal: int = 1, seed: int = 0) -> tuple[FaultyLine, Faults]:
    faults = Faults.at({ordinal: kind}, seed=seed)
    return FaultyLine(monochromator, faults), faults


def test_silence_carries_out_the_command_without_a_reply(monochromator: Monochromator) -> None:
    line, faults = _line(monochromator, "silence")
    assert line.feed(b"500 GOTO\r") == b""
    assert line.feed(b"?NM\r") == b"?NM 500.000 nm  ok\r\n"
    assert faults.injected == [InjectedFault(1, "silence", b"500 GOTO\r")]


def test_silence_swallows_the_echo_of_every_piece(monochromator: Monochromator) -> None:
    line, _ = _line(monochromator, "silence")
    assert [line.feed(bytes([character])) for character in b"?NM\r"] == [b""] * 4


def test_garbage_comes_before_the_echo(monochromator: Monochromator) -> None:
    for seed in range(20):
        line, _ = _line(monochromator, "garbage", seed=seed)
        reply = line.feed(b"?GRATING\r")
        assert reply.endswith(b"?GRATING 1  ok\r\n")
        assert 1 <= len(reply) - len(b"?GRATING 1  ok\r\n") <= 12
        assert line.feed(b"?GRATING\r") == b"?GRATING 1  ok\r\n"


def test_a_truncated_answer_has_no_terminator_and_is_never_made_good(monochromator: Monochromator) -> None:
    whole = b"?NM/MIN 100.000 nm/min  ok\r\n"
    lengths = set()
    for seed in range(200):
        line, _ = _line(monochromator, "truncated", seed=seed)
        reply = line.feed(b"?NM/MIN\r")
        assert whole.startswith(reply)
        lengths.add(len(reply))
        assert line.feed(b"?NM/MIN\r") == whole
    assert lengths == set(range(len(b"?NM/MIN"), len(whole)))


def test_a_clamped_move_ends_at_a_wrong_position_with_ok(monochromator: Monochromator) -> None:
    line, faults = _line(monochromator, "clamp")
    assert line.feed(b"546.1 GOTO\r") == b"546.1 GOTO ok\r\n"
    assert line.feed(b"?NM\r") == b"?NM 1400.000 nm  ok\r\n"
    assert line.feed(b"546.1 GOTO ?NM\r") == b"546.1 GOTO ?NM 546.100 nm  ok\r\n"
    assert [kind for _, kind, _ in faults.injected] == ["clamp"]


@pytest.mark.parametrize("asked", [0, 300, 699, 701, 1400])
def test_a_clamped_move_never_ends_at_the_requested_position(monochromator: Monochromator, asked: float) -> None:
    line, _ = _line(monochromator, "clamp")
    line.feed(f"{asked} GOTO\r".encode())
    assert abs(monochromator.wavelength - asked) >= 699


@pytest.mark.parametrize("wheel_of", [ActonWheel, ThorlabsWheel])
@pytest.mark.parametrize("asked", range(1, 7))
def test_a_clamped_wheel_stops_at_another_filter(wheel_of: type[ActonWheel | ThorlabsWheel], asked: int) -> None:
    wheel = wheel_of(VirtualClock(), position=3)
    command = b"%d FILTER\r" if wheel_of is ActonWheel else b"pos=%d\r"
    reply = FaultyLine(wheel, Faults.at({1: "clamp"})).feed(command % asked)
    assert reply in (b"%d FILTER ok\r\n" % asked, b"pos=%d\r> " % asked)
    assert wheel.position == asked % 6 + 1


def test_a_clamped_grating_stays(monochromator: Monochromator) -> None:
    line, _ = _line(monochromator, "clamp")
    assert line.feed(b"2 GRATING\r") == b"2 GRATING ok\r\n"
    assert monochromator.grating == 1


@pytest.mark.parametrize("command", [b"?NM", b"MODEL", b"FOO", b"9 GRATING", b"100 NM/MIN"])
def test_a_clamp_does_not_affect_other_commands(monochromator: Monochromator, command: bytes) -> None:
    line, faults = _line(monochromator, "clamp")
    line.feed(command + b"\r")
    line.feed(b"500 GOTO\r")
    assert monochromator.wavelength == 500
    assert faults.injected == []


def test_a_late_ok_comes_before_the_echo_of_the_next_command(monochromator: Monochromator) -> None:
    line, _ = _line(monochromator, "late-ok")
    assert line.feed(b"500 GOTO\r") == b"500 GOTO"
    assert line.feed(b"?NM\r") == b" ok\r\n?NM 500.000 nm  ok\r\n"
    assert line.feed(b"?NM\r") == b"?NM 500.000 nm  ok\r\n"


def test_a_frame_exposed_before_the_late_ok_shows_the_move(monochromator: Monochromator) -> None:
    line, _ = _line(monochromator, "late-ok")
    line.feed(b"500 GOTO\r")
    assert monochromator.wavelength == 0
    monochromator.clock.advance_to(monochromator.clock.now() + 2)
    assert monochromator.wavelength == pytest.approx(200)
    line.feed(b"MODEL\r")
    assert monochromator.wavelength == 500
    assert monochromator.clock.now() == pytest.approx(5)


def test_a_late_prompt_of_a_thorlabs_wheel() -> None:
    line = FaultyLine(ThorlabsWheel(VirtualClock()), Faults.at({1: "late-ok", 2: "late-ok"}))
    assert line.feed(b"pos=4\r") == b"pos=4\r"
    assert line.feed(b"pos?\r") == b"> pos?\r"
    assert line.feed(b"*idn?\r").startswith(b"4\r> *idn?\rTHORLABS")


def test_an_unplugged_line_is_dead_until_it_is_plugged_in_again(monochromator: Monochromator) -> None:
    line, faults = _line(monochromator, "unplug")
    assert line.feed(b"500 GOTO\r?NM\r") == b"500 GOTO"
    assert line.dead
    assert line.feed(b"?NM\r") == b""
    line.replug()
    assert line.feed(b"?NM\r") == b"?NM 500.000 nm  ok\r\n"
    assert faults.commands == 2
    assert faults.injected == [InjectedFault(1, "unplug", b"500 GOTO\r")]


def test_the_wrong_device_answers_in_its_dialect_until_the_right_one_is_connected(
    monochromator: Monochromator,
) -> None:
    line, faults = _line(monochromator, "wrong-device", ordinal=2)
    assert line.feed(b"MODEL\r") == b"MODEL SP-2-300i  ok\r\n"
    assert line.feed(b"500 GOTO\r") == b"500 GOTO\rCommand error CMD_NOT_DEFINED\r> "
    assert line.feed(b"*idn?\r").startswith(b"*idn?\rTHORLABS FW102C")
    assert monochromator.wavelength == 0
    line.replug()
    assert line.feed(b"MODEL\r") == b"MODEL SP-2-300i  ok\r\n"
    assert [kind for _, kind, _ in faults.injected] == ["wrong-device"]


def test_a_monochromator_answers_for_a_thorlabs_wheel() -> None:
    line = FaultyLine(ThorlabsWheel(VirtualClock()), Faults.at({1: "wrong-device"}))
    assert line.feed(b"*idn?\r") == b"*idn?*idn? ? \r\n"


def test_another_monochromator_may_answer(monochromator: Monochromator) -> None:
    other = Monochromator(monochromator.clock, serial_number="999")
    line = FaultyLine(monochromator, Faults.at({1: "wrong-device"}), other)
    assert line.feed(b"SERIAL\r") == b"SERIAL 999  ok\r\n"
    line.feed(b"500 GOTO\r")
    assert (monochromator.wavelength, other.wavelength) == (0, 500)


@pytest.mark.parametrize("kind", KINDS)
def test_a_fault_happens_once_and_at_its_command(monochromator: Monochromator, kind: str) -> None:
    line, faults = _line(monochromator, kind, ordinal=3)
    for _ in range(2):
        assert line.feed(b"?GRATING\r") == b"?GRATING 1  ok\r\n"
    assert line.feed(b"2 GRATING\r") != b"2 GRATING ok\r\n" or kind == "clamp"
    line.replug()
    for _ in range(3):
        assert line.feed(b"?NM\r") == b"?NM 0.000 nm  ok\r\n"
    assert [(ordinal, kind_) for ordinal, kind_, _ in faults.injected] == [(3, kind)]


def test_the_seed_determines_the_faults_and_the_rate_is_met() -> None:
    def disturbed(seed: int) -> tuple[bytes, list[InjectedFault]]:
        faults = Faults.seeded(seed, 0.1, ["silence", "garbage", "truncated", "late-ok"])
        line = FaultyLine(Monochromator(VirtualClock()), faults)
        return b"".join(line.feed(b"?NM\r") for _ in range(2000)), faults.injected

    reply, injected = disturbed(7)
    assert (reply, injected) == disturbed(7)
    assert injected != disturbed(8)[1]
    counted = Counter(kind for _, kind, _ in injected)
    # 50 expected of each, standard deviation 7; 200 of all, 13.
    assert set(counted) == {"silence", "garbage", "truncated", "late-ok"}
    assert all(20 < count < 80 for count in counted.values())
    assert 150 < len(injected) < 250


def test_a_plan_may_serve_two_lines_and_counts_the_commands_of_both(monochromator: Monochromator) -> None:
    faults = Faults.at({3: "silence"})
    lines = FaultyLine(monochromator, faults), FaultyLine(ActonWheel(monochromator.clock), faults)
    assert lines[0].feed(b"?NM\r")
    assert lines[1].feed(b"?FILTER\r")
    assert not lines[1].feed(b"?FILTER\r")
    assert faults.commands == 3


@pytest.mark.parametrize(
    ("plan", "message"),
    [
        (lambda: Faults.at({1: "fire"}), "unknown kind of fault 'fire'; accepted: silence, garbage"),
        (lambda: Faults.at({0: "silence"}), "accepted: 1 or more"),
        (lambda: Faults.seeded(1, 0.5, ["late"]), "unknown kind of fault 'late'"),
        (lambda: Faults.seeded(1, 1.5), "accepted: 0 to 1"),
        (lambda: Faults.seeded(1, float("nan")), "accepted: 0 to 1"),
        (lambda: Faults.seeded(1, 0.5, []), "with 0 kinds"),
    ],
)
def test_an_invalid_plan_of_faults_is_refused(plan, message: str) -> None:
    with pytest.raises(EmulationError, match=message):
        plan()
