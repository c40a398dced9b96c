"""``brdfpipe rig watch``: a run in a browser on this machine while it is measured, to read alone."""

from __future__ import annotations

import json
from functools import partial
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from brdfpipe.cli.console import FOLDER, exit_on_error
from brdfpipe.cli.serving import LOOPBACK, is_local, loopback_server, serve_until_interrupted

if TYPE_CHECKING:
    from brdfpipe.report.rig.watch_page import RunPage

DEFAULT_PORT = 8009

_FILES = {
    "/": ("watch.html", "text/html; charset=utf-8"),
    "/watch.js": ("watch.js", "text/javascript; charset=utf-8"),
    "/watch.css": ("watch.css", "text/css; charset=utf-8"),
}
_STATE = "/state.json"
_POLICY = "default-src 'none'; script-src 'self'; style-src 'self'; img-src data:; connect-src 'self'"


class _Handler(BaseHTTPRequestHandler):
    """Page and state of one run, for GET alone."""

    server_version = "brdfpipe"
    sys_version = ""

    def __init__(self, page: RunPage, *args: Any) -> None:
        self._page = page
        super().__init__(*args)

    def do_GET(self) -> None:
        if not is_local(self.headers.get("Host", "")):
            self.send_error(HTTPStatus.FORBIDDEN, f"only {LOOPBACK} and localhost are served")
        elif self.path in _FILES:
            name, kind = _FILES[self.path]
            self._answer(files("brdfpipe.report").joinpath("templates", name).read_bytes(), kind)
        elif self.path == _STATE:
            content = json.dumps(self._page.state(), ensure_ascii=False, allow_nan=False)
            self._answer(content.encode("utf-8", "replace"), "application/json; charset=utf-8")
        else:
            self.send_error(HTTPStatus.NOT_FOUND)

    def _answer(self, content: bytes, kind: str) -> None:
        self.send_response(HTTPStatus.OK)
        headers = {
            "Content-Type": kind,
            "Content-Length": str(len(content)),
            "Cache-Control": "no-store",
            "Content-Security-Policy": _POLICY,
            "X-Content-Type-Options": "nosniff",
        }
        for name, value in headers.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, format: str, *args: object) -> None:
        """No line for each request."""


def server(run: Path, port: int) -> ThreadingHTTPServer:
    """A server of the page of a run on the loopback address; port 0 takes a free one.

    Raises
    ------
    InputError : the folder holds no run.
    BrdfpipeError : the port is in use.
    """
    from brdfpipe.report.rig.watch_page import RunPage

    return loopback_server(partial(_Handler, RunPage(run)), port)


@click.command(short_help="Show a run in a browser while it is measured.")
@click.argument("run", type=FOLDER)
@click.option(
    "--port", type=click.IntRange(0, 65535), default=DEFAULT_PORT, show_default=True, help="0 takes a free port."
)
@exit_on_error
def watch(run: Path, port: int) -> int:
    """Show the last frame of RUN with the signal to noise of its cells, progress, time left and warnings, until Ctrl+C.

    The page is on the loopback address and changes nothing. The scan may run meanwhile, or be finished.
    """
    return serve_until_interrupted(server(run, port))
