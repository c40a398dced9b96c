"""``brdfpipe doctor``."""

from __future__ import annotations

import json
import tomllib
from collections import namedtuple
from importlib.metadata import PackageNotFoundError
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
    assert "is not >=99.0; no-such-library is not installed" in found["libraries"].words
    assert found["extra excel"].words.endswith("pip install 'brdfpipe[excel]'")
    assert CliRunner().invoke(main, ["doctor"]).exit_code == 1


@pytest.mark.parametrize(
    ("requirement", "present", "sound"),
    [
        ("snakemake>=9.20,<10", "10.0", False),
        ("snakemake>=9.20,<10", "9.20", True),
        ("numpy>=2.0.0", "2.0", True),
        ("numpy>=2.0", "2.1.0rc1", True),
        ("no-such-library; python_version < '3'", "", True),
    ],
)
def test_versions_are_compared_as_the_package_index_does(
    monkeypatch: pytest.MonkeyPatch, requirement: str, present: str, sound: bool
) -> None:
    monkeypatch.setattr(doctor, "requires", lambda name: ["click", requirement])
    monkeypatch.setattr(doctor, "version", lambda name: "8.1" if name == "click" else present)
    libraries = next(one for one in doctor._libraries() if one.name == "libraries")
    assert libraries.state == ("ok" if sound else "fail")


def test_a_package_that_is_not_installed_is_a_finding(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def missing(name: str) -> None:
        raise PackageNotFoundError(name)

    for function in ("requires", "version"):
        monkeypatch.setattr(doctor, function, missing)
    states = {one.name: one.state for one in doctor.findings(tmp_path)}
    assert states["brdfpipe"] == "fail"
    assert states["libraries"] == states["extra plot"] == "note"
