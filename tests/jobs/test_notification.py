"""A command that learns of the end of a build: what it gets, and what becomes of its faults."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from brdfpipe.errors import BrdfpipeError
from brdfpipe.jobs import notification


def python(code: str) -> str:
    return f"{sys.executable} -c '{code}'"


def test_the_command_gets_the_text_and_no_shell_reads_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    code = 'import sys, pathlib; pathlib.Path("got").write_text(sys.stdin.read() + " ".join(sys.argv[1:]))'
    notification.notify(python(code) + " $HOME ; touch pwned", "{}")
    assert (tmp_path / "got").read_text() == "{}$HOME ; touch pwned"
    assert not (tmp_path / "pwned").exists()


def test_any_text_of_the_command_is_read(tmp_path: Path) -> None:
    write = 'import sys; sys.stdout.buffer.write(b"\\xff"); sys.stderr.buffer.write(b"\\xff\\x1b"); sys.exit(int(sys.argv[1]))'
    notification.notify(python(write) + " 0", "µ")
    with pytest.raises(BrdfpipeError, match=r"exit code 1: \\xff\\x1b"):
        notification.notify(python(write) + " 1", "µ")


@pytest.mark.parametrize(
    ("command", "problem"),
    [
        ("", "is empty"),
        ("'", "is no command"),
        ("/no/such/program", "could not start"),
        (python("import sys; print(1, file=sys.stderr); sys.exit(3)"), "failed with exit code 3: 1"),
        (python("import sys; sys.exit(3)"), "failed with exit code 3, and wrote nothing to its standard error$"),
    ],
)
def test_a_command_that_does_not_work_is_named(command: str, problem: str) -> None:
    with pytest.raises(BrdfpipeError, match=problem):
        notification.notify(command, "{}")


def test_a_command_that_hangs_is_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(notification, "PATIENCE", 0.2)
    with pytest.raises(BrdfpipeError, match="took more than"):
        notification.notify(python("import time; time.sleep(60)"), "{}")
