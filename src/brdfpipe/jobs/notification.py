"""Tell another program of the end of a build."""

from __future__ import annotations

import shlex
import subprocess

from brdfpipe.errors import BrdfpipeError, printable

PATIENCE = 60.0
"""Seconds that the program may take."""


def notify(command: str, text: str) -> None:
    """Run a command without a shell, with a text as its standard input.

    Raises
    ------
    BrdfpipeError : it cannot be started, fails, or takes longer than :data:`PATIENCE`; the build itself is done.
    """
    try:
        words = shlex.split(command)
    except ValueError as error:
        raise BrdfpipeError(f"the notification {command!r} is no command ({error})") from error
    if not words:
        raise BrdfpipeError("the notification is empty; accepted: a command, as `mail -s brdfpipe lab@example.org`")
    try:
        done = subprocess.run(words, input=text.encode(), capture_output=True, timeout=PATIENCE, check=False)
    except OSError as error:
        raise BrdfpipeError(f"the notification could not start: {words[0]}: {error.strerror}") from error
    except subprocess.TimeoutExpired as error:
        raise BrdfpipeError(f"the notification {words[0]} took more than {PATIENCE:g} s and was stopped") from error
    if done.returncode:
        last = printable(done.stderr.decode(errors="backslashreplace").strip().rpartition("\n")[2])
        reason = f": {last}" if last else ", and wrote nothing to its standard error"
        raise BrdfpipeError(f"the notification {words[0]} failed with exit code {done.returncode}{reason}")
