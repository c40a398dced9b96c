"""Shared by all commands: exit codes of errors, and types of path arguments."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec

import click

from brdfpipe.errors import BrdfpipeError, printable
from brdfpipe.jobs.interrupts import Terminated

Arguments = ParamSpec("Arguments")

FOLDER = click.Path(path_type=Path, file_okay=False)
PRESENT = click.Path(path_type=Path, file_okay=False, exists=True)
FILE = click.Path(path_type=Path, dir_okay=False, exists=True)

FILE_KINDS = ("bsdf", "surface", "spectrum", "index")
"""What a file may hold that a command reads."""


class Commands(click.Group):
    """A group whose errors of usage have the form of all others: one line, with exit code 2."""

    def main(self, *args: Any, **extra: Any) -> Any:
        alone = extra.pop("standalone_mode", True)
        run: Callable[..., Any] = super().main
        if not alone:
            return run(*args, standalone_mode=False, **extra)
        try:
            code = run(*args, standalone_mode=False, **extra)
        except click.exceptions.NoArgsIsHelpError as usage:
            usage.show()
            code = 2
        except click.ClickException as refusal:
            code = refusal.exit_code
            words = printable(refusal.format_message()).rstrip(".")
            context = getattr(refusal, "ctx", None)
            hint = f"; see `{context.command_path} --help`" if context else ""
            click.echo(f"brdfpipe: {words[:1].lower()}{words[1:]}{hint}", err=True)
        except click.Abort:
            code = 130
        sys.exit(code if isinstance(code, int) else 0)


def print_json(plain: object) -> None:
    """Plain values as JSON on the standard output, for scripts; ASCII alone, so that no character of a name acts on a terminal."""
    click.echo(json.dumps(plain, indent=1))


def exit_on_error(command: Callable[Arguments, int]) -> Callable[Arguments, None]:
    """Exit with the code that a command returns; with 2 and a line for each mistake after an error, with 130 after an interrupt, 143 after SIGTERM."""

    @wraps(command)
    def run(*args: Arguments.args, **kwargs: Arguments.kwargs) -> None:
        try:
            code = command(*args, **kwargs)
        except BrdfpipeError as refusal:
            click.echo(f"brdfpipe: {printable(str(refusal))}", err=True)
            for further in getattr(refusal, "others", ()):
                click.echo(f"  also {printable(further)}", err=True)
            code = 2
        except OSError as error:
            click.echo(f"brdfpipe: {error.filename or 'operating system'}: {error.strerror or error}", err=True)
            code = 2
        except KeyboardInterrupt as interrupt:
            terminated = isinstance(interrupt, Terminated)
            click.echo(f"brdfpipe: {'terminated' if terminated else 'interrupted'}; the same command resumes", err=True)
            code = 143 if terminated else 130
        sys.exit(code)

    return run
