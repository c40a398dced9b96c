"""``brdfpipe doctor``."""

from __future__ import annotations

import json
import tomllib
from collections import namedtuple
from pathlib import Path

import pytest
from click.testing import CliRunner

from brdfpipe.cli import doctor
from brdfpipe.cli.main import main

PROJECT = Path(__file__).parents[2]


def test_a_sound_installation_is_ready() -> None:
    found = CliRunner().invoke(main, ["doctor", "--json"])
    states = {one["name"]: one["state"] for one in json.loads(found.output)}
    assert states["libraries"] == states["datasets"] == states["brdfpipe"] == "ok"
    assert found.exit_code == (1 if "fail" in states.values() else 0)


def test_every_extra_is_named() -> None:
    project = tomllib.loads((PROJECT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert set(doctor.EXTRAS) == set(project["optional-dependencies"])


def test_what_is_missing_fails_and_says_what_to_do(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(doctor, "requires", lambda name: ["numpy>=99.0", "no-such-library", "xlrd; extra == 'excel'"])
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(doctor.shutil, "disk_usage", lambda folder: usage(1, 1, 10**6))
    found = {one.name: one for one in doctor.findings(tmp_path)}
    assert found["libraries"].state == found["disk"].state == "fail"
    assert "older than 99.0; no-such-library is not installed" in found["libraries"].words
    assert found["extra excel"].words.endswith("pip install 'brdfpipe[excel]'")
    assert CliRunner().invoke(main, ["doctor"]).exit_code == 1
