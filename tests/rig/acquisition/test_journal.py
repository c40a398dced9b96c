"""The journal: complete lines only, after any end of the program."""

from __future__ import annotations

import json
import os

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from brdfpipe.rig.acquisition.journal import Journal, read, recorded_digests, rejected_digests
from brdfpipe.store import StoreError


def opened(path, clock=lambda: 1.25):
    return Journal(path, clock)


def test_events_come_back_in_order(tmp_path):
    with opened(tmp_path / "j") as journal:
        journal.append("begun", rig="bench ×")
        journal.append("frame", shot=1, temperature=None)
    assert read(tmp_path / "j") == [
        {"clock": 1.25, "event": "begun", "rig": "bench ×"},
        {"clock": 1.25, "event": "frame", "shot": 1, "temperature": None},
    ]


def test_a_journal_only_grows(tmp_path):
    for number in range(3):
        before = (tmp_path / "j").read_bytes() if number else b""
        with opened(tmp_path / "j") as journal:
            journal.append("frame", shot=number)
        assert (tmp_path / "j").read_bytes().startswith(before)
    assert [event["shot"] for event in read(tmp_path / "j")] == [0, 1, 2]


def test_an_event_is_on_the_disk_when_it_is_noted(tmp_path, monkeypatch):
    synced = []
    fsync = os.fsync
    with opened(tmp_path / "j") as journal:
        monkeypatch.setattr(os, "fsync", lambda file: (synced.append((tmp_path / "j").stat().st_size), fsync(file)))
        journal.append("frame", shot=1)
    assert synced == [(tmp_path / "j").stat().st_size]


@given(cut=st.integers(0, 10_000), padding=st.integers(0, 9000))
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_an_incomplete_last_line_is_removed_wherever_it_ends(tmp_path, cut, padding):
    path = tmp_path / "j"
    path.unlink(missing_ok=True)
    with opened(path) as journal:
        for number in range(3):
            journal.append("frame", shot=number, text=padding * "x")
    whole = path.read_bytes()
    cut = min(cut, len(whole))
    path.write_bytes(whole[: len(whole) - cut])
    complete = whole[: whole.rfind(b"\n", 0, len(whole) - cut) + 1]
    with opened(path) as journal:
        journal.append("resumed")
    assert path.read_bytes().startswith(complete)
    events = [json.loads(line) for line in path.read_text().splitlines()]
    assert events == read(path)
    incomplete = len(whole) - cut - len(complete)
    assert [event["event"] for event in events[complete.count(b"\n") :]] == (["repaired"] if incomplete else []) + [
        "resumed"
    ]


def test_lines_that_are_not_events_are_skipped(tmp_path):
    path = tmp_path / "j"
    path.write_bytes(
        b'{"event":"a"}\n\xff\xfe\n[1]\n{"no": 1}\n{"event": 3}\n' + b"[" * 9999 + b'\n{"event":"b"}\n{"ev'
    )
    assert [event["event"] for event in read(path)] == ["a", "b"]


def test_a_missing_journal_has_no_events(tmp_path):
    assert read(tmp_path / "none") == []


def test_a_full_disk_leaves_no_incomplete_line(tmp_path, monkeypatch):
    with opened(tmp_path / "j") as journal:
        journal.append("frame", shot=1)
        before = (tmp_path / "j").read_bytes()
        write = os.write

        def half(file, data):
            if len(data) < 20:
                raise OSError(28, "No space left on device")
            return write(file, data[: len(data) // 2])

        monkeypatch.setattr(os, "write", half)
        with pytest.raises(StoreError, match=r"No space left on device.*is the disk full"):
            journal.append("frame", shot=2)
        monkeypatch.undo()
        assert (tmp_path / "j").read_bytes() == before
        journal.append("frame", shot=2)
    assert [event["shot"] for event in read(tmp_path / "j")] == [1, 2]


def test_a_journal_that_cannot_be_opened_is_reported(tmp_path):
    with pytest.raises(StoreError, match="could not be written"):
        opened(tmp_path / "no" / "j")


def test_rejected_frames_may_be_accepted_later_and_entries_of_other_types_are_ignored():
    events = [
        {"event": "frame", "shot": 1, "sha256": "a"},
        {"event": "frame", "shot": [2], "sha256": "b"},
        {"event": "adopted", "shot": 3, "sha256": {}},
        {"event": "rejected", "sha256": ["a", ["b"], None, "c"]},
        {"event": "rejected", "sha256": 5},
        {"event": "rejected"},
        {"event": "accepted", "sha256": ["a"]},
    ]
    assert recorded_digests(events) == {1: "a"}
    assert rejected_digests(events[:4]) == {"a", "c"}
    assert rejected_digests(events) == {"c"}
