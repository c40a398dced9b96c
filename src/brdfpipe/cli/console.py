"""What the commands share: how they refuse, and the kinds of paths they take."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import ParamSpec

import click

from brdfpipe.errors import BrdfpipeError

Given = ParamSpec("Given")

FOLDER = click.Path(path_type=Path, file_okay=False)
FILE = click.Path(path_type=Path, dir_okay=False, exists=True)


def refusing(command: Callable[Given, int]) -> Callable[Given, None]:
    """Turn a refusal, the system's too, into one line and exit code 2, an interrupt into 130."""

    @wraps(command)
    def run(*args: Given.args, **kwargs: Given.kwargs) -> None:
        try:
            code = command(*args, **kwargs)
        except BrdfpipeError as refusal:
            click.echo(f"brdfpipe: {refusal}", err=True)
            code = 2
        except OSError as error:
            click.echo(f"brdfpipe: {error.filename or 'the system'}: {error.strerror or error}", err=True)
            code = 2
        except KeyboardInterrupt:
            click.echo("brdfpipe: interrupted; the same command resumes", err=True)
            code = 130
        sys.exit(code)

    return run
