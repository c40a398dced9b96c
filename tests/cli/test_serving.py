"""``brdfpipe serve``: what it gives, and what it never gives."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from http.client import HTTPConnection
from pathlib import Path

import pytest
from click.testing import CliRunner

from brdfpipe.cli.main import main
from brdfpipe.cli.serving import server


@pytest.fixture
def address(tmp_path: Path) -> Iterator[tuple[str, int]]:
    results = tmp_path / "results"
    (results / "a b").mkdir(parents=True)
    (results / "index.html").write_text("catalogue")
    (results / "a b" / "report.html").write_text("page")
    (results / ".index.jsonl").write_text("hidden")
    (tmp_path / "secret").write_text("secret")
    (results / "link").symlink_to(tmp_path / "secret")
    for number, index in enumerate(("index.html", "index.htm")):
        (results / f"folder{number}").mkdir()
        (results / f"folder{number}" / index).symlink_to(tmp_path / "secret")
    running = server(results, 0)
    thread = threading.Thread(target=running.serve_forever, daemon=True)
    thread.start()
    yield running.server_address[0], running.server_address[1]  # type: ignore[misc]
    running.shutdown()
    running.server_close()
    thread.join()


def _answer(address: tuple[str, int], path: str, method: str = "GET", host: str | None = None) -> tuple[int, bytes]:
    connection = HTTPConnection(*address, timeout=60)
    connection.request(method, path, headers={"Host": host} if host else {})
    answer = connection.getresponse()
    content = answer.read()
    connection.close()
    return answer.status, content


def test_pages_are_served_on_the_loopback_address(address: tuple[str, int]) -> None:
    assert address[0] == "127.0.0.1"
    assert _answer(address, "/") == (200, b"catalogue")
    assert _answer(address, "/a%20b/report.html") == (200, b"page")


@pytest.mark.parametrize(
    "path",
    [
        "/../secret",
        "/%2e%2e/secret",
        "/a%20b/..%2f..%2fsecret",
        "//secret",
        "/link",
        "/.index.jsonl",
        "/a%20b/",
        "/folder0/",
        "/folder1/",
    ],
)
def test_nothing_else_is_served(address: tuple[str, int], path: str) -> None:
    status, content = _answer(address, path)
    assert status == 404
    assert content != b"secret"
    assert b"hidden" not in content


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE"])
def test_nothing_is_written(address: tuple[str, int], method: str) -> None:
    assert _answer(address, "/index.html", method)[0] == 501


def test_pages_of_the_web_cannot_read_results_under_another_name(address: tuple[str, int]) -> None:
    assert _answer(address, "/", host="evil.example")[0] == 403


def test_a_port_in_use_and_a_folder_without_a_catalogue_are_refused(tmp_path: Path) -> None:
    refused = CliRunner().invoke(main, ["serve", str(tmp_path)])
    assert refused.exit_code == 2
    assert "no index.html" in refused.output
    (tmp_path / "index.html").touch()
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        refused = CliRunner().invoke(main, ["serve", str(tmp_path), "--port", str(taken.getsockname()[1])])
    assert refused.exit_code == 2
    assert "--port" in refused.output
