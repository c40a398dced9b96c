"""Pages in a browser: opened from a file, with what the console said and what was requested."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any


def opened_page(browser: Any, path: Path) -> None:
    """Open a file, and forget the log of the pages before."""
    browser.get(
        "about:blank"
    )  # a page at the same address, and the requests of the browser's own first page, are left behind
    browser.get_log("browser")
    browser.get_log("performance")
    browser.get(path.as_uri())


def console_and_requests(browser: Any) -> tuple[list[str], list[str]]:
    """Messages of the console, and the addresses that were requested, since the page was opened."""
    events = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    sent = [e["params"]["request"]["url"] for e in events if e["method"] == "Network.requestWillBeSent"]
    return [entry["message"] for entry in browser.get_log("browser")], sent
