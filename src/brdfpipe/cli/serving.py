"""``brdfpipe serve``: a folder of results for a browser on this machine, to read alone."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import click

from brdfpipe.cli.console import PRESENT, exit_on_error
from brdfpipe.errors import BrdfpipeError

LOOPBACK = "127.0.0.1"

DEFAULT_PORT = 8008


class _ResultsHandler(SimpleHTTPRequestHandler):
    """Files of one folder, for GET and HEAD: no listings, no hidden files, and no file outside the folder, by a symbolic link either."""

    server_version = "brdfpipe"
    sys_version = ""

    def send_head(self):  # type: ignore[no-untyped-def]
        if not is_local(self.headers.get("Host", "")):
            return self.send_error(HTTPStatus.FORBIDDEN, f"only {LOOPBACK} and localhost are served")
        folder, path = Path(self.directory).resolve(), Path(self.translate_path(self.path))
        try:
            inside = path.resolve().relative_to(folder)
            for index in ("index.html", "index.htm"):  # which stands for its folder
                (path / index).resolve().relative_to(folder)
        except (ValueError, OSError):
            return self.send_error(HTTPStatus.NOT_FOUND)
        if any(part.startswith(".") for part in inside.parts):
            return self.send_error(HTTPStatus.NOT_FOUND)
        return super().send_head()

    def list_directory(self, path):  # type: ignore[no-untyped-def]
        return self.send_error(HTTPStatus.NOT_FOUND)

    def end_headers(self) -> None:
        self.send_header("Cache-Control", "no-cache")
        self.send_header("X-Content-Type-Options", "nosniff")
        super().end_headers()

    def log_message(self, format: str, *args: object) -> None:
        """No line for each file."""


def is_local(host: str) -> bool:
    """Whether a Host header names this machine: another name that resolves to it would let a page of the web read what is served."""
    return (host.rpartition(":")[0] or host) in (LOOPBACK, "localhost")


def loopback_server(handler: Callable[..., BaseHTTPRequestHandler], port: int) -> ThreadingHTTPServer:
    """A server on the loopback address; port 0 takes a free one. Raises BrdfpipeError: the port is in use."""
    try:
        return ThreadingHTTPServer((LOOPBACK, port), handler)
    except OSError as error:
        reason = error.strerror or error
        raise BrdfpipeError(
            f"port {port} of {LOOPBACK}: {reason}; choose another with --port, or 0 for a free one"
        ) from error


def server(results: Path, port: int) -> ThreadingHTTPServer:
    """A server of a folder of results on the loopback address; port 0 takes a free one.

    Raises
    ------
    BrdfpipeError : the folder has no catalogue page, or the port is in use.
    """
    if not (results / "index.html").is_file():
        raise BrdfpipeError(
            f"{results}: no index.html; expected a folder of results that `brdfpipe build` has finished"
        )
    return loopback_server(partial(_ResultsHandler, directory=str(results)), port)


def serve_until_interrupted(running: ThreadingHTTPServer, page: str = "") -> int:
    """Name the address of a page, serve until Ctrl+C, and return the exit code."""
    with running:
        click.echo(f"http://{LOOPBACK}:{running.server_address[1]}/{page} (Ctrl+C ends it)")
        try:
            running.serve_forever()
        except KeyboardInterrupt:
            return 0
    return 0


@click.command(short_help="Show RESULTS in a browser on this machine.")
@click.argument("results", type=PRESENT)
@click.option(
    "--port", type=click.IntRange(0, 65535), default=DEFAULT_PORT, show_default=True, help="0 takes a free port."
)
@exit_on_error
def serve(results: Path, port: int) -> int:
    """Serve the pages and files of RESULTS on the loopback address until Ctrl+C, to read alone.

    No other machine can reach it. Pages also open without it, as files.
    """
    return serve_until_interrupted(server(results, port), "index.html")
