"""One transaction on a line: echo, terminator, deadline; and the port itself."""

from __future__ import annotations

import errno
import pickle
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from serial import SerialException
from serial_script import Chunk, Clock, Exchange, Script, ScriptedPort, line_on_port, scripted_line

from brdfpipe.rig.acquisition.devices.errors import DeviceError, DeviceLost, NoReply, Refused, WrongDevice
from brdfpipe.rig.acquisition.devices.serial_line import SerialLine
from brdfpipe.rig.description import SerialSettings

ACTON = SerialSettings("acton", "/dev/ttyUSB0", 9600)
THORLABS = SerialSettings("thorlabs", "COM4", 115200)


def line_with(*exchanges: Exchange, settings: SerialSettings = ACTON) -> SerialLine:
    return line_on(Script(*exchanges), settings)


def line_on(
    reply: Callable[[bytes], bytes | Sequence[Chunk] | Exception], settings: SerialSettings = ACTON
) -> SerialLine:
    return scripted_line(settings, reply)


def refused(line: SerialLine, command: str, timeout: float = 1.0) -> NoReply:
    with pytest.raises(NoReply) as caught:
        line.transact(command, timeout)
    return caught.value


# --- replies as the manuals print them


def test_a_reply_is_the_text_between_the_echo_and_the_ok() -> None:
    assert line_with((b"?NM\r", b"?NM 546.100 nm  ok\r\n")).transact("?NM", 1) == "546.100 nm"


def test_a_move_is_answered_by_ok_alone() -> None:
    line = line_with((b"546.100 GOTO\r", [(0, b"546.100 GOTO"), (12.0, b" ok\r\n")]))
    assert line.transact("546.100 GOTO", 30) == ""
    assert line.clock() == pytest.approx(12.0, abs=0.06)


def test_a_list_of_gratings_keeps_its_lines_and_its_arrow() -> None:
    listed = b"\r\n\x1a1  1200 g/mm BLZ=  500NM \r\n 2   300 g/mm BLZ=  1.0UM \r\n\xaf3  Not Installed     \r\n"
    text = line_with((b"?GRATINGS\r", b"?GRATINGS " + listed + b" ok\r\n")).transact("?GRATINGS", 1)
    assert text.split("\r\n") == [
        "\x1a1  1200 g/mm BLZ=  500NM ",
        " 2   300 g/mm BLZ=  1.0UM ",
        "\xaf3  Not Installed",
    ]


@pytest.mark.parametrize(
    "reply", [b"pos?\r3\r> ", b"pos?\r\n3\r\n> ", b"pos?\r3\r>"], ids=["as documented", "lines", "bare prompt"]
)
def test_a_reply_of_a_thorlabs_wheel_ends_at_its_prompt(reply: bytes) -> None:
    assert line_with((b"pos?\r", reply), settings=THORLABS).transact("pos?", 1) == "3"


def test_a_command_of_a_thorlabs_wheel_is_answered_by_the_prompt_alone() -> None:
    assert line_with((b"pos=3\r", b"pos=3\r> "), settings=THORLABS).transact("pos=3", 1) == ""


def test_words_are_sent_in_the_case_of_the_description() -> None:
    lower = SerialSettings("acton", "/dev/ttyUSB0", 9600, case="lower")
    assert line_with((b"546.100 goto\r", b"546.100 goto ok\r\n"), settings=lower).transact("546.100 GOTO", 1) == ""
    assert line_with((b"*idn?\r", b"*idn?\rX\r> "), settings=THORLABS).transact("*IDN?", 1) == "X"


# --- invalid replies


def test_an_unknown_command_is_refused_with_the_hint_about_case() -> None:
    upper = SerialSettings("acton", "/dev/ttyUSB0", 9600, case="upper")
    error = refused(line_with((b"MODEL\r", b"MODEL ? \r\n"), settings=upper), "MODEL")
    assert isinstance(error, Refused)
    assert "case: upper" in str(error)


def test_a_question_mark_alone_refuses_a_word() -> None:
    assert isinstance(refused(line_with((b"MODEL\r", b"MODEL?\r\n")), "MODEL"), Refused)


def silent_line(*exchanges: Exchange) -> SerialLine:
    """The line of a controller that echoes nothing."""
    line = line_with(*exchanges)
    line.connection.echoes = False
    return line


def test_without_an_echo_a_reply_counts_once_the_line_is_silent() -> None:
    assert silent_line((b"?NM\r", b" 546.100 nm  ok\r\n")).transact("?NM", 1) == "546.100 nm"
    assert isinstance(refused(silent_line((b"MODEL\r", b"?\r\n")), "MODEL"), Refused)
    late = silent_line((b"?NM\r", [(0.0, b" ok\r\n"), (0.05, b" 546.100 nm  ok\r\n")]))
    assert refused(late, "?NM").problem == "more than one reply"


def test_without_an_echo_one_that_comes_after_all_makes_the_transaction_void() -> None:
    line = silent_line((b"?NM\r", b"?NM 546.100 nm  ok\r\n"))
    assert "an echo" in refused(line, "?NM").problem


def test_an_error_of_a_thorlabs_wheel_is_refused() -> None:
    error = refused(line_with((b"foo\r", b"foo\rCommand error CMD_NOT_DEFINED\r> "), settings=THORLABS), "foo")
    assert isinstance(error, Refused)
    assert "CMD_NOT_DEFINED" in str(error)


def test_silence_ends_at_the_deadline() -> None:
    line = line_with((b"?NM\r", b""))
    error = refused(line, "?NM", 1.0)
    assert line.clock() == pytest.approx(1.0, abs=0.06)
    assert str(error) == (
        "monochromator on /dev/ttyUSB0: no reply in 1 s; sent '?NM'; got nothing; "
        "check that it is switched on, its cable, and the baud rate (9600)"
    )


def test_a_reply_without_an_echo_is_never_parsed() -> None:
    assert "no echo" in refused(line_with((b"?NM\r", b" 546.100 nm  ok\r\n")), "?NM").problem


@pytest.mark.parametrize("end", range(len(b"?NM 546.100 nm  ok\r\n")))
def test_a_truncated_reply_is_never_parsed(end: int) -> None:
    refused(line_with((b"?NM\r", b"?NM 546.100 nm  ok\r\n"[:end])), "?NM")


def test_bytes_before_the_command_are_not_read_as_its_reply() -> None:
    line = line_with((b"?NM\r", [(0, b"?NM 546.100 nm  ok\r\n"), (0.5, b"?NM 700.000 nm  ok\r\n")]), (b"?NM\r", b""))
    assert line.transact("?NM", 1) == "546.100 nm"
    line.sleep(1)
    refused(line, "?NM", 1)


def test_a_late_ok_before_the_echo_is_skipped() -> None:
    assert line_with((b"?NM\r", b" ok\r\n?NM 700.000 nm  ok\r\n")).transact("?NM", 1) == "700.000 nm"


def test_a_late_ok_behind_the_echo_makes_the_transaction_void() -> None:
    assert refused(line_with((b"?NM\r", b"?NM ok\r\n 700.000 nm  ok\r\n")), "?NM").problem == "more than one reply"


def test_another_family_is_named_without_waiting_for_the_deadline() -> None:
    line = line_with((b"546.100 GOTO\r", b"546.100 GOTO\rCommand error CMD_NOT_DEFINED\r> "))
    error = refused(line, "546.100 GOTO", 30)
    assert error.problem == "a device of the Thorlabs dialect answers"
    assert line.clock() < 1


def test_a_line_that_never_ends_is_left() -> None:
    line = line_with((b"?NM\r", [(0.001 * k, b"?NM" + b"x" * 100) for k in range(1000)]))
    refused(line, "?NM", 30)
    assert line.clock() < 1


@given(noise=st.binary(max_size=40))
def test_noise_before_the_echo_changes_nothing(noise: bytes) -> None:
    """Unless the noise is itself an echo or ends like a device of another family; then there is no reply at all."""
    line = line_with((b"?NM\r", noise + b"?NM 546.100 nm  ok\r\n"))
    if b"?NM" in noise:
        try:
            assert "546.100 nm" in line.transact("?NM", 1)
        except NoReply:
            return
    else:
        assert line.transact("?NM", 1) == "546.100 nm"


REPLY = b"?NM 546.100 nm  ok\r\n"
PIECES = st.lists(
    st.one_of(st.binary(max_size=4), st.sampled_from([b"?NM", b" ok\r\n", b" 700.000 nm", b" ? \r\n", b"\r> ", REPLY])),
    max_size=6,
).map(b"".join)


@given(noise=PIECES, end=st.integers(0, len(REPLY)), cuts=st.lists(st.integers(0, 60), max_size=8))
def test_a_reply_is_read_whole_or_not_at_all_however_it_arrives(noise: bytes, end: int, cuts: list[int]) -> None:
    """Noise of the device's own replies, a reply truncated anywhere, bytes in pieces of any size."""
    whole = noise + REPLY[:end]
    edges = sorted({0, len(whole), *(cut for cut in cuts if cut < len(whole))})
    chunks = [(0.001 * k, whole[a:b]) for k, (a, b) in enumerate(pairwise(edges))]
    line = line_with((b"?NM\r", chunks))
    try:
        text = line.transact("?NM", 0.5)
    except NoReply:
        return
    # The result is the text between the first echo and a received terminator.
    behind = whole.split(b"?NM", 1)[1].decode("latin-1").lstrip(" \r\n")
    assert behind.startswith(text)
    assert behind[len(text) :].lstrip(" \r\n").startswith("ok\r\n")


# --- reset


def test_a_reset_ends_a_partial_command_switches_the_echo_on_and_waits_for_silence() -> None:
    script = Script(
        (b"\r", b"54MODEL ? \r\n"), (b"ECHO\r", [(0, b" ok"), (0.05, b"\r\n")]), (b"?NM\r", b"?NM 1.0 nm  ok\r\n")
    )
    line = line_on(script)
    line.reset()
    assert line.transact("?NM", 1) == "1.0 nm"
    assert script.finished


def test_a_reset_refuses_a_line_that_is_never_quiet() -> None:
    line = line_with((b"\r", [(0.02 * k, b"?") for k in range(1000)]))
    with pytest.raises(NoReply, match=r"does not become quiet.*baud rate"):
        line.reset()
    assert line.clock() < 3


# --- the port


def opening(error: Exception, settings: SerialSettings = ACTON) -> DeviceLost:
    def open_port(**_: Any) -> ScriptedPort:
        raise error

    with pytest.raises(DeviceLost) as caught:
        line_on_port(settings, open_port, Clock())
    return caught.value


def test_the_port_is_opened_for_this_program_alone() -> None:
    asked: dict[str, Any] = {}

    def open_port(**options: Any) -> ScriptedPort:
        asked.update(options)
        return ScriptedPort(Script(), Clock())

    line_on_port(ACTON, open_port, Clock())
    assert asked["exclusive"] is True
    assert (asked["port"], asked["baudrate"]) == ("/dev/ttyUSB0", 9600)


@pytest.mark.parametrize(
    ("error", "problem"),
    [
        (SerialException(errno.EAGAIN, "Could not exclusively lock port"), "the port is in use by another program"),
        (SerialException(errno.EBUSY, "could not open port"), "the port is in use by another program"),
        (SerialException(errno.EACCES, "could not open port"), "no permission to open the port"),
        (SerialException(errno.ENOENT, "could not open port"), "the port does not exist"),
        (SerialException("could not open port 'COM9': FileNotFoundError(2, …)"), "the port does not exist"),
        (SerialException("Could not configure port: (25, 'ENOTTY')"), "cannot be opened"),
        (ValueError("Invalid baud rate: -1"), "cannot be opened"),
    ],
)
def test_a_port_that_cannot_be_opened_gives_the_reason_and_advice(error: Exception, problem: str) -> None:
    refusal = opening(error)
    assert problem in refusal.problem
    assert refusal.port == "/dev/ttyUSB0"
    assert refusal.advice


def test_on_windows_denied_means_held(monkeypatch: pytest.MonkeyPatch) -> None:
    denied = SerialException("could not open port 'COM4': PermissionError(13, 'Access is denied.', None, 5)")
    with monkeypatch.context() as windows:  # a failing assertion needs the paths of this system
        windows.setattr("brdfpipe.rig.acquisition.devices.serial_line.os.name", "nt")
        refusal = opening(denied, THORLABS)
    assert refusal.problem == "the port is in use by another program"


def test_a_device_unplugged_in_mid_read_is_lost_and_stays_lost() -> None:
    line = line_with((b"?NM\r", OSError(errno.EIO, "Input/output error")))
    with pytest.raises(DeviceLost, match=r"disconnected \(Input/output error\).*'\?NM'.*cable"):
        line.transact("?NM", 1)
    with pytest.raises(DeviceLost, match="the port is closed"):
        line.transact("?NM", 1)


def test_a_closed_line_may_be_closed_again() -> None:
    line = line_with()
    line.close()
    line.close()
    with pytest.raises(DeviceLost):
        line.reset()


# --- errors


@pytest.mark.parametrize("kind", [DeviceError, DeviceLost, WrongDevice, NoReply, Refused])
def test_errors_cross_process_borders(kind: type[DeviceError]) -> None:
    error = kind("monochromator", "no", port="COM3", command="?NM", reply=b"\x1b[31m\xff", advice="do")
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is kind
    assert str(again) == str(error)
    assert (again.device, again.port, again.command, again.reply, again.advice) == (
        "monochromator",
        "COM3",
        "?NM",
        b"\x1b[31m\xff",
        "do",
    )


@given(reply=st.binary(max_size=300))
def test_no_reply_can_write_control_characters_to_a_terminal(reply: bytes) -> None:
    text = str(DeviceError("camera", "odd", reply=reply))
    assert text.isascii() or "…" in text
    assert all(character >= " " for character in text)
    assert len(text) < 200
