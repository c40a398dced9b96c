"""The emulated devices as a program sees them: pyserial on a pseudo-terminal."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import termios
import threading
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import serial

from brdfpipe.rig.emulator import port as port_module
from brdfpipe.rig.emulator.clock import VirtualClock
from brdfpipe.rig.emulator.faults import Faults
from brdfpipe.rig.emulator.instruments import Monochromator, ThorlabsWheel
from brdfpipe.rig.emulator.port import Port, PortError

QUIET = 0.05
"""Seconds without a byte after which a line counts as quiet; an answer takes a fiftieth of a millisecond."""

PATIENCE = 300.0
"""Seconds to wait for an answer: only a broken device needs as long, on however busy a machine."""


@pytest.fixture
def monochromator() -> Monochromator:
    return Monochromator(VirtualClock())


@pytest.fixture
def port(monochromator: Monochromator) -> Iterator[Port]:
    with Port(monochromator) as emulated:
        yield emulated


def _open(port: Port, **options: object):
    return serial.Serial(port.path, 9600, timeout=PATIENCE, write_timeout=PATIENCE, **options)


def _ask(line, command: bytes, terminator: bytes = b" ok\r\n") -> bytes:
    line.write(command + b"\r")
    return line.read_until(terminator)


def _heard_in_quiet(line) -> bytes:
    """All bytes until the line is quiet."""
    line.timeout = QUIET
    reply = line.read(65536)
    line.timeout = PATIENCE
    return reply


def _wait_for(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.005)


def test_a_program_moves_the_monochromator_over_its_port(port: Port, monochromator: Monochromator) -> None:
    with _open(port, exclusive=True) as line:
        assert _ask(line, b"MODEL") == b"MODEL SP-2-300i  ok\r\n"
        assert _ask(line, b"546.1 GOTO") == b"546.1 GOTO ok\r\n"
        assert _ask(line, b"?NM") == b"?NM 546.100 nm  ok\r\n"
    assert monochromator.wavelength == pytest.approx(546.1)
    assert port.sent_by("host") == b"MODEL\r546.1 GOTO\r?NM\r"
    assert port.sent_by("device") == b"MODEL SP-2-300i  ok\r\n546.1 GOTO ok\r\n?NM 546.100 nm  ok\r\n"
    assert port.log[0] == ("host", b"MODEL\r")


def test_a_program_turns_a_thorlabs_wheel(monochromator: Monochromator) -> None:
    with Port(ThorlabsWheel(monochromator.clock)) as port, serial.Serial(port.path, 115200, timeout=PATIENCE) as line:
        assert _ask(line, b"pos=5", b"> ") == b"pos=5\r> "
        assert _ask(line, b"pos?", b"> ") == b"pos?\r5\r> "


def test_every_byte_passes_as_it_is(port: Port) -> None:
    """A cooked terminal would translate CR and LF, act on ^C, ^D and ^S, and echo."""
    every = bytes(value for value in range(256) if value != 0x0D)
    with _open(port) as line:
        line.write(every + b"\r")
        reply = line.read_until(b" ? \r\n")
    assert reply[: len(every)] == every
    assert port.sent_by("host") == every + b"\r"
    assert reply == port.sent_by("device")


def test_the_line_is_raw_before_any_program_has_set_it(port: Port) -> None:
    far = os.open(port.path, os.O_RDWR | os.O_NOCTTY)
    try:
        _, output, _, local, *_ = termios.tcgetattr(far)
    finally:
        os.close(far)
    assert not output & termios.OPOST
    assert not local & (termios.ECHO | termios.ICANON | termios.ISIG)


def test_the_banner_of_a_device_is_not_echoed_back_to_it(port: Port) -> None:
    with _open(port) as line:
        _ask(line, b"?GRATINGS")
        assert _heard_in_quiet(line) == b""
    assert port.sent_by("host") == b"?GRATINGS\r"


def test_bytes_may_come_one_by_one_and_slowly(port: Port) -> None:
    with _open(port) as line:
        for character in b"500 GOTO\r?NM\r":
            line.write(bytes([character]))
            time.sleep(0.002)
        assert line.read_until(b"nm  ok\r\n") == b"500 GOTO ok\r\n?NM 500.000 nm  ok\r\n"


def test_several_commands_may_come_in_one_write(port: Port) -> None:
    with _open(port) as line:
        line.write(b"500 GOTO\r?NM\rMODEL\r?GRA")
        assert line.read_until(b"?GRA") == b"500 GOTO ok\r\n?NM 500.000 nm  ok\r\nMODEL SP-2-300i  ok\r\n?GRA"


def test_answers_that_are_read_late_are_not_lost(port: Port) -> None:
    once = Monochromator(VirtualClock()).feed(b"?GRATINGS\r")
    with _open(port) as line:
        for _ in range(500):
            line.write(b"?GRATINGS\r")
        assert line.read(500 * len(once)) == 500 * once
    assert 500 * len(once) > 100_000
    assert port.sent_by("device") == 500 * once


def test_a_program_that_comes_later_finds_the_device_as_it_was_left(port: Port) -> None:
    with _open(port) as line:
        _ask(line, b"NO-ECHO")
        _ask(line, b"500 GOTO")
    with _open(port) as line:
        assert _ask(line, b"?NM") == b" 500.000 nm  ok\r\n"


def test_a_second_program_is_refused_the_port(port: Port) -> None:
    with _open(port, exclusive=True) as line:
        with pytest.raises(serial.SerialException, match="exclusive"):
            _open(port, exclusive=True)
        assert _ask(line, b"?GRATING") == b"?GRATING 1  ok\r\n"
    with _open(port, exclusive=True) as line:
        assert _ask(line, b"?GRATING") == b"?GRATING 1  ok\r\n"


def test_a_program_killed_in_the_middle_of_a_command_frees_the_port(port: Port) -> None:
    script = (
        "import serial, sys, time\n"
        "line = serial.Serial(sys.argv[1], 9600, exclusive=True)\n"
        "line.write(b'500 GOTO\\r54')\n"
        "print('written', flush=True)\n"
        "time.sleep(3600)\n"
    )
    with subprocess.Popen([sys.executable, "-c", script, port.path], stdout=subprocess.PIPE) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == b"written\n"
        with pytest.raises(serial.SerialException, match="exclusive"):
            _open(port, exclusive=True)
        other.send_signal(signal.SIGKILL)
    with _open(port, exclusive=True) as line:
        _wait_for(lambda: port.sent_by("device").endswith(b"54"))
        _heard_in_quiet(line)
        # The partial command of the killed program is still in the device's buffer, as in a laboratory.
        assert _ask(line, b"6.1 GOTO ?NM").endswith(b" 546.100 nm  ok\r\n")


def test_an_unplugged_device_hangs_the_program_up_and_is_gone(port: Port) -> None:
    with _open(port) as line:
        _ask(line, b"500 GOTO")
        port.unplug()
        with pytest.raises(serial.SerialException):
            line.read(1)
    assert not Path(port.path).exists()
    with pytest.raises(serial.SerialException, match="No such file"):
        _open(port)
    port.unplug()
    port.replug()
    with _open(port) as line:
        assert _ask(line, b"?NM") == b"?NM 500.000 nm  ok\r\n"


def test_a_program_that_waits_for_an_answer_is_woken_by_the_unplugging(port: Port) -> None:
    with _open(port) as line:
        threading.Timer(0.05, port.unplug).start()
        with pytest.raises(serial.SerialException):  # a read that only times out raises nothing
            line.read(1)


def test_a_fault_unplugs_in_the_middle_of_a_move(monochromator: Monochromator) -> None:
    with Port(monochromator, Faults.at({2: "unplug"})) as port:
        with _open(port) as line:
            _ask(line, b"MODEL")
            line.write(b"500 GOTO\r")
            with pytest.raises(serial.SerialException):
                line.read_until(b" ok\r\n")
        assert not Path(port.path).exists()
        assert monochromator.wavelength == 0
        port.replug()
        with _open(port) as line:
            assert _ask(line, b"?NM") == b"?NM 500.000 nm  ok\r\n"


@pytest.mark.parametrize("kind", ["silence", "truncated", "late-ok"])
def test_a_program_waits_in_vain_for_a_terminator(monochromator: Monochromator, kind: str) -> None:
    with Port(monochromator, Faults.at({1: kind})) as port, _open(port) as line:
        line.write(b"500 GOTO\r")
        assert not _heard_in_quiet(line).endswith(b" ok\r\n")
        assert _ask(line, b"?NM", b"nm  ok\r\n").endswith(b"?NM 500.000 nm  ok\r\n")


def test_a_wrong_device_answers_until_the_right_one_is_plugged_in(monochromator: Monochromator) -> None:
    with Port(monochromator, Faults.at({1: "wrong-device"})) as port:
        with _open(port) as line:
            assert _ask(line, b"MODEL", b"> ") == b"MODEL\rCommand error CMD_NOT_DEFINED\r> "
        port.replug()
        with _open(port) as line:
            assert _ask(line, b"MODEL") == b"MODEL SP-2-300i  ok\r\n"


def test_ports_leave_no_descriptor_no_thread_and_no_file_behind(monochromator: Monochromator) -> None:
    def held() -> tuple[list[Path], int]:
        return sorted(Path("/proc/self/fd").iterdir()), threading.active_count()

    before = held()
    folders = set()
    for turn in range(30):
        with Port(monochromator, name="monochromator") as port, _open(port) as line:
            assert _ask(line, b"?GRATING") == b"?GRATING 1  ok\r\n"
            folders.add(Path(port.path).parent)
            if turn % 3 == 1:
                port.unplug()
            if turn % 3 == 2:
                port.replug()
        port.close()
        port.unplug()
        port.replug()
    assert held() == before
    assert not any(folder.exists() for folder in folders)


def test_a_port_closes_under_a_program_that_is_reading(port: Port) -> None:
    with _open(port) as line:
        threading.Timer(0.05, port.close).start()
        with pytest.raises(serial.SerialException):
            line.read(1)


def test_a_port_in_real_time_closes_in_the_middle_of_a_move_once_its_clock_is_released() -> None:
    clock = VirtualClock(realtime=True)
    with Port(Monochromator(clock, slew=1.0)) as port, _open(port) as line:
        line.write(b"1000 GOTO\r")
        started = time.monotonic()
        assert _heard_in_quiet(line) == b""
        clock.release()
    assert time.monotonic() - started < PATIENCE


def test_without_pseudo_terminals_there_is_one_clear_error(
    monochromator: Monochromator, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse() -> tuple[int, int]:
        raise OSError(28, "No space left on device")

    before = sorted(Path("/proc/self/fd").iterdir())
    monkeypatch.setattr(port_module.os, "openpty", refuse)
    with pytest.raises(PortError, match="no pseudo-terminal available for the emulated wheel"):
        Port(monochromator, name="wheel")
    assert sorted(Path("/proc/self/fd").iterdir()) == before


ANSWER = b"?NM 0.000 nm  ok\r\n"


def _seconds_of_transactions(terminal: int) -> float:
    """Processor time of both sides."""
    started = time.process_time()
    for _ in range(20):
        os.write(terminal, b"?NM\r")
        reply = b""
        while not reply.endswith(b" ok\r\n"):
            reply += os.read(terminal, 100)
    assert reply == ANSWER
    return time.process_time() - started


def test_a_transaction_takes_little_longer_than_the_terminal_and_a_thread_need(port: Port) -> None:
    """It takes 4 times as long as a constant answer on a bare terminal. Best rounds of both, in turn: a slow or busy machine lengthens both."""
    own, host = os.openpty()
    tty.setraw(own)
    tty.setraw(host)

    def answer() -> None:
        while os.read(own, 100) == b"?NM\r":
            os.write(own, ANSWER)

    thread = threading.Thread(target=answer)
    thread.start()
    rounds: list[tuple[float, float]] = []
    try:
        with _open(port) as line:
            os.set_blocking(line.fd, True)  # the reading of pyserial is not measured
            for _ in range(30):
                rounds.append((_seconds_of_transactions(line.fd), _seconds_of_transactions(host)))
    finally:
        os.write(host, b"end\r")
        thread.join()
        os.close(own)
        os.close(host)
    emulated, bare = map(min, zip(*rounds, strict=True))
    assert emulated < 15 * bare
