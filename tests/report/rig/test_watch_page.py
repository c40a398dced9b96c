"""``brdfpipe rig watch``: the state of a run, the page that shows it, and what it never gives."""

from __future__ import annotations

import json
import shutil
import threading
import time
from collections.abc import Iterator
from http.client import HTTPConnection
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import small_rig
from browser_pages import console_and_requests
from click.testing import CliRunner

from brdfpipe.cli.main import main
from brdfpipe.cli.watching import server
from brdfpipe.errors import InputError
from brdfpipe.rig.acquisition.estimate import ARRANGEMENT_TIME, durations
from brdfpipe.rig.acquisition.run_state import WatchedRun
from brdfpipe.rig.plan import Plan

HOSTILE = '</script><script>document.title = "broken"</script><img src=x onerror=alert(1)>'
LIGHT = 8
"""Light frames before the run that is watched was stopped."""


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run."""
    folder = tmp_path_factory.mktemp("whole")
    plan = Plan.load(small_rig.write(folder / "bench"))
    with small_rig.emulated(plan) as (rig, camera):
        small_rig.take_emulated(plan, folder / "run", rig, camera)
    return folder / "run"


@pytest.fixture
def run(whole: Path, tmp_path: Path) -> Path:
    """The same while its etalon is measured: without the later frames and events."""
    folder = tmp_path / "run"
    shutil.copytree(whole, folder)
    plan = Plan.load(folder / "plan.yaml")
    kept = [shot for shot in plan.shots if shot.ordinal <= 5 + LIGHT]
    for shot in plan.shots[len(kept) :]:
        (folder / "frames" / shot.name).unlink()
    lines = [json.loads(line) for line in (folder / "journal.jsonl").read_text().splitlines()]
    lines = [event for event in lines if event["event"] != "finished" and event.get("shot", 0) <= len(kept)]
    (folder / "journal.jsonl").write_text("".join(json.dumps(event) + "\n" for event in lines))
    return folder


def noted(run: Path, text: str) -> None:
    """A warning of the scan."""
    with (run / "journal.jsonl").open("a") as journal:
        journal.write(
            json.dumps({"clock": 0, "event": "noticed", "shot": 9, "check": "cosmic", "problem": text}) + "\n"
        )


# --- the state


def test_the_state_of_a_run_is_its_progress_and_the_time_left(run: Path) -> None:
    watched = WatchedRun(run)
    state, plan = watched.state(), watched.plan
    assert (state.status, state.finished, state.frames) == ("running", 5 + LIGHT, len(plan.shots))
    missing = plan.shots[5 + LIGHT :]
    assert state.last == plan.shots[4 + LIGHT]
    to_confirm = {shot.arrangement for shot in missing} - {state.last.arrangement}
    expected = sum(durations(plan)[shot] for shot in missing) + ARRANGEMENT_TIME * len(to_confirm)
    assert state.seconds_left == pytest.approx(expected)
    before = sorted(path.stat().st_mtime_ns for path in run.rglob("*"))
    watched.light(state.last)
    assert sorted(path.stat().st_mtime_ns for path in run.rglob("*")) == before


def test_a_finished_run_has_nothing_left(whole: Path) -> None:
    state = WatchedRun(whole).state()
    assert (state.status, state.seconds_left) == ("finished", 0)
    assert state.finished == state.frames


def test_warnings_are_those_of_the_journal_the_latest_last(run: Path) -> None:
    assert WatchedRun(run).state().warnings == ()
    noted(run, "many hits")
    noted(run, "a light leak")
    noted(run, "many hits")
    assert WatchedRun(run).state().warnings == ("frame 9, noticed: many hits", "frame 9, noticed: a light leak")


def test_bright_cells_show_well_and_dark_ones_do_not(whole: Path) -> None:
    watched = WatchedRun(whole)
    light = [shot for shot in watched.plan.shots if shot.purpose == "etalon" and shot.position == 1]
    dark = next(shot for shot in watched.plan.shots if shot.dark)
    shown, unlit = (watched.light(shot) for shot in (light[-1], dark))
    assert shown is not None
    assert unlit is not None
    picture, cells = shown
    assert picture.shape == (watched.plan.rig.camera.height, watched.plan.rig.camera.width)
    disc = watched.cells.of_disc
    assert np.nanmin(cells.snr[disc]) > 30
    # The noise of a dark frame: a few cells in a hundred are above three times theirs.
    assert np.nanpercentile(np.abs(unlit[1].snr), 90) < 4
    assert cells.snr.shape == (len(watched.cells.names),)


def test_a_damaged_frame_is_no_error(run: Path) -> None:
    watched = WatchedRun(run)
    last = watched.state().last
    assert last is not None
    (run / "frames" / last.name).write_bytes(b"SIMPLE  =")
    assert watched.light(last) is None


# --- the server


@pytest.fixture
def address(run: Path) -> Iterator[tuple[str, int]]:
    noted(run, HOSTILE)
    running = server(run, 0)
    thread = threading.Thread(target=running.serve_forever, daemon=True)
    thread.start()
    yield running.server_address[0], running.server_address[1]  # type: ignore[misc]
    running.shutdown()
    running.server_close()
    thread.join()


def answer(
    address: tuple[str, int], path: str, method: str = "GET", host: str | None = None
) -> tuple[int, bytes, dict[str, str]]:
    connection = HTTPConnection(*address, timeout=60)
    connection.request(method, path, headers={"Host": host} if host else {})
    given = connection.getresponse()
    content = given.read()
    connection.close()
    return given.status, content, dict(given.getheaders())


def test_the_page_is_on_the_loopback_address_with_its_state(address: tuple[str, int]) -> None:
    assert address[0] == "127.0.0.1"
    for path in ("/", "/watch.js", "/watch.css"):
        status, content, headers = answer(address, path)
        assert (status, bool(content)) == (200, True)
        assert "default-src 'none'" in headers["Content-Security-Policy"]
    status, content, _ = answer(address, "/state.json")
    state = json.loads(content)
    assert status == 200
    assert (state["sample"], state["finished"], state["status"]) == ("tile", 5 + LIGHT, "running")
    assert state["picture"].startswith("data:image/png;base64,")
    assert state["warnings"][-1] == f"frame 9, noticed: {HOSTILE}"
    assert {cell["name"] for cell in state["cells"]} >= {"A", "B", "C", "D", "disc-1"}


@pytest.mark.parametrize("path", ["/journal.jsonl", "/../plan.yaml", "/frames/", "/%2e%2e/rig.yaml", "/state.json/x"])
def test_nothing_else_is_served(address: tuple[str, int], path: str) -> None:
    assert answer(address, path)[0] == 404


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE"])
def test_nothing_is_written(address: tuple[str, int], method: str) -> None:
    assert answer(address, "/state.json", method)[0] == 501


def test_pages_of_the_web_cannot_read_the_state_under_another_name(address: tuple[str, int]) -> None:
    assert answer(address, "/state.json", host="evil.example")[0] == 403
    assert answer(address, "/state.json", host="localhost:1")[0] == 200


def test_a_folder_without_a_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"plan\.yaml"):
        server(tmp_path, 0)
    result = CliRunner().invoke(main, ["rig", "watch", str(tmp_path)])
    assert result.exit_code == 2
    assert "plan.yaml" in result.output


# --- the page in a browser


def waited(browser: Any, script: str, expected: Any) -> Any:
    deadline = time.monotonic() + 120
    while (value := browser.execute_script(script)) != expected and time.monotonic() < deadline:
        time.sleep(0.1)
    return value


@pytest.mark.slow
def test_the_page_shows_frames_as_they_are_taken(
    browser: Any, address: tuple[str, int], whole: Path, run: Path
) -> None:
    browser.get(f"http://{address[0]}:{address[1]}/")
    title = f"tile: {5 + LIGHT} of {len(list((whole / 'frames').iterdir()))} frames"
    assert waited(browser, "return document.title", title) == title
    count = len(WatchedRun(run).cells.names)
    assert waited(browser, "return document.querySelectorAll('#picture circle').length", count) == count
    rows = "return [...document.querySelectorAll('#cells tr')].map((row) => row.lastChild.textContent)"
    faintest = [float(text) for text in browser.execute_script(rows) if text[0].isdigit()]
    assert len(faintest) >= count - 4
    assert faintest == sorted(faintest)
    assert "min left" in browser.execute_script("return document.getElementById('status').textContent")
    # Text of devices is text, and no element.
    assert browser.execute_script("return document.querySelector('#warnings li').textContent").endswith(HOSTILE)
    assert browser.execute_script("return document.querySelectorAll('#warnings img, #warnings script').length") == 0
    # The scan goes on.
    before = browser.execute_script("return document.querySelector('#picture image').getAttribute('href')")
    events = [
        line for line in (whole / "journal.jsonl").read_text().splitlines() if json.loads(line)["event"] == "frame"
    ]
    later = [json.loads(line) for line in events if json.loads(line)["shot"] > 5 + LIGHT]
    for event in later:
        shutil.copy(whole / "frames" / event["file"], run / "frames")
        with (run / "journal.jsonl").open("a") as journal:
            journal.write(json.dumps(event) + "\n")
    total = len(list((whole / "frames").iterdir()))
    title = f"tile: {total} of {total} frames"
    assert waited(browser, "return document.title", title) == title
    assert browser.execute_script("return document.querySelector('#picture image').getAttribute('href')") != before
    console, requests = console_and_requests(browser)
    assert [line for line in console if "favicon" not in line] == []
    assert {request.split("/")[2] for request in requests if request.startswith("http")} == {
        f"{address[0]}:{address[1]}"
    }
