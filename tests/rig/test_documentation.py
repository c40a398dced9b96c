"""docs/rig.md agrees with the program: tables, commands, keywords, links, and code that runs."""

from __future__ import annotations

import ast
import json
import re
import shlex
from dataclasses import fields, replace
from itertools import takewhile
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest
import small_rig

import brdfpipe
from brdfpipe.cli import main as cli
from brdfpipe.cli import rig as commands
from brdfpipe.rig import description, frame_file, rig_keys
from brdfpipe.rig.acquisition import scan
from brdfpipe.rig.acquisition.devices import connection as devices
from brdfpipe.rig.acquisition.devices.errors import WrongDevice
from brdfpipe.rig.description import CameraSettings, Rig
from brdfpipe.rig.emulator.clock import VirtualClock
from brdfpipe.rig.emulator.dialects import DIALECTS
from brdfpipe.rig.emulator.effects import Effects
from brdfpipe.rig.emulator.faults import KINDS, Faults
from brdfpipe.rig.emulator.port import Port
from brdfpipe.rig.plan import Arrangement, Plan
from brdfpipe.rig.raw_frame import RawFrame
from brdfpipe.store import save_dataset

PROJECT = Path(__file__).parents[2]
DOCUMENT = PROJECT / "docs" / "rig.md"
TEXT = DOCUMENT.read_text(encoding="utf-8")
PAGES = (
    *(PROJECT / "docs" / name for name in ("benchmarks.md", "materials.md", "model.md", "rig.md")),
    PROJECT / "README.md",
    PROJECT / "examples" / "README.md",
)

# --- tables


def section(title: str) -> str:
    """Text below a heading, up to the next one."""
    match = re.search(rf"^#+ {re.escape(title)}\n(.*?)(?=^#+ |\Z)", _without_code(TEXT), re.MULTILINE | re.DOTALL)
    assert match, f"no heading {title!r}"
    return match[1]


def _without_code(text: str) -> str:
    """Without fenced code, whose comments look like headings."""
    return re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)


def rows(text: str, first: str) -> list[dict[str, str]]:
    """Rows of the table with this title of its first column; cells by title."""
    lines = text.splitlines()
    starts = [number for number, line in enumerate(lines) if line.startswith(f"| {first} |")]
    assert len(starts) == 1, f"{len(starts)} tables of {first!r}"
    titles = _cells(lines[starts[0]])
    body = takewhile(lambda line: line.startswith("|"), lines[starts[0] + 2 :])
    return [dict(zip(titles, _cells(line), strict=True)) for line in body]


def _cells(row: str) -> list[str]:
    return [cell.strip() for cell in row.strip().strip("|").split("|")]


def words(cell: str) -> list[str]:
    """Words in backquotes."""
    return re.findall(r"`([^`]*)`", cell)


# --- keys of the descriptions; tests/catalogue/test_generated_files.py compares the tables


def test_the_speeds_of_lines_are_those_of_the_dialects():
    (row,) = [row for row in rows(section("rig.yaml"), "Key") if "wheel.baud" in row["Key"]]
    documented = {word: int(part.split()[0]) for part in row["Default"].split(";") for word in words(part)}
    assert documented == rig_keys.BAUD


def test_the_wiring_has_every_dialect():
    documented = [word for row in rows(section("Wiring"), "Device") for word in words(row["`dialect`"])]
    assert sorted(documented) == sorted({**devices.MONOCHROMATORS, **devices.WHEELS})


def test_every_dialect_of_the_description_has_a_driver():
    assert set(devices.MONOCHROMATORS) == set(rig_keys.MONOCHROMATORS)
    assert set(devices.WHEELS) == set(rig_keys.WHEELS)


def test_the_columns_of_the_fibres_are_named():
    documented = [word for row in rows(section("fibres.csv"), "Column") for word in words(row["Column"])]
    assert tuple(documented) == (*description.COLUMNS, description.DIRECTION_COLUMN)
    assert f"`{','.join(description.COLUMNS)}`" in section("fibres.csv")


def test_the_page_says_what_makes_another_rig(rig_file):
    """Ports, dialects and the connection of the camera do not; all other keys do."""
    (exceptions,) = re.findall(r"all keys above except(.*?)\. The digest", section("rig.yaml"), re.DOTALL)
    assert words(exceptions) == [
        *("monochromator", "wheel", "kind", "folder", "address", "device", "timeout", "linearity_u")
    ]
    text = rig_file.read_text()
    before = Rig.load(rig_file).digest
    other = text.replace(
        "kind: drop-folder, folder: camera",
        "kind: alpaca, address: 'host:1', device: 2, timeout: 5, linearity_u: 0.002",
    )
    other = other.replace("port: /dev/ttyUSB0", "port: COM3, grating: 2")
    other = other.replace("dialect: thorlabs, port: /dev/ttyUSB1", "dialect: acton-wheel, port: COM4, positions: 5")
    assert other.count("COM") == 2
    assert digest(rig_file, other) == before
    for old, new in (("nd_location: sample", "nd_location: reference"), ("0.1}", "0.11}"), ("scale: 3", "scale: 3.1")):
        assert digest(rig_file, text.replace(old, new)) != before, new


def digest(path: Path, text: str) -> str:
    path.write_text(text)
    return Rig.load(path).digest


# --- files of a run


def test_every_keyword_of_a_frame_is_explained(tmp_path):
    plan = Plan.load(small_rig.write(tmp_path / "bench"))
    # Of a turned mirror, whose frames have all keywords.
    shot = replace(
        plan.shots[0], purpose="mirror", arrangement=Arrangement("mirror", "reflection", 10.0, aim=(20.0, 45.0))
    )
    picture = RawFrame(np.zeros((72, 96), dtype=np.uint16), 1.7e9, shot.exposure, 20.0)
    state = frame_file.DeviceState(shot.wavelength, shot.position)
    path = tmp_path / "frame.fits"
    frame_file.write_frame(path, picture, shot, plan, state=state, run_start=None, camera="a camera")
    cards = path.read_bytes()[:5760].decode("ascii", "replace")
    written = {
        cards[place : place + 8].strip() for place in range(0, len(cards), 80) if cards[place + 8 : place + 10] == "= "
    }
    structure = {"SIMPLE", "BITPIX", "NAXIS", "NAXIS1", "NAXIS2", "EXTEND", "BSCALE", "BZERO"}
    explained = {word for row in rows(section("Frames"), "Keyword") for word in words(row["Keyword"])}
    assert explained == written - structure


def test_every_event_of_the_journal_is_explained():
    written = set()
    for module in (scan, scan.journals):
        for node in ast.walk(ast.parse(Path(module.__file__).read_text(encoding="utf-8"))):
            called = isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr
            if called in ("append", "_record_end") and node.args and isinstance(node.args[0], ast.Constant):
                written.add(node.args[0].value)
    explained = {
        word for row in rows(section("Resuming"), "Event in the journal") for word in words(row["Event in the journal"])
    }
    assert explained == written


def test_every_exit_code_is_explained():
    codes = [int(row["Exit code"]) for row in rows(section("What a scan checks"), "Exit code")]
    assert codes == [0, 1, 2, 130]
    assert all(str(code) in commands.__doc__ for code in codes)


# --- the emulator


def test_the_table_of_effects_is_complete_with_defaults():
    documented = {
        words(row["Effect"])[0]: ast.literal_eval(words(row["Default"])[0])
        for row in rows(section("The emulator"), "Effect")
    }
    assert documented == {field.name: field.default for field in fields(Effects)}
    assert list(documented) == [field.name for field in fields(Effects)]


def test_the_table_of_faults_is_complete():
    assert [words(row["Fault"])[0] for row in rows(section("The emulator"), "Fault")] == list(KINDS)


def test_every_error_of_a_bench_has_its_test() -> None:
    table = rows(section("What each frame must show"), "Error")
    assert len(table) > 10
    sources = "".join(path.read_text(encoding="utf-8") for path in (PROJECT / "tests" / "rig").rglob("test_*.py"))
    missing = [name for row in table for name in words(row["Test"]) if f"def {name}(" not in sources]
    assert missing == []


def test_every_dialect_of_the_controllers_is_documented() -> None:
    table = rows(section("The emulator"), "Dialect of the controllers (`--dialect`)")
    documented = {words(row["Dialect of the controllers (`--dialect`)"])[0]: row["They differ in"] for row in table}
    assert documented == {name: dialect.meaning for name, dialect in DIALECTS.items()}


# --- commands and links


def commands_in(path: Path) -> list[str]:
    """Commands of shell blocks and of quoted code."""
    text = path.read_text(encoding="utf-8")
    blocks = re.findall(r"^```sh\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    quoted = re.findall(r"`(brdfpipe [^`]*)`", _without_code(text))
    lines = [line.split(" #")[0].strip() for block in blocks for line in block.splitlines()]
    return [command for command in (*lines, *quoted) if command.startswith("brdfpipe ")]


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.name)
def test_quoted_commands_and_options_exist(path):
    for quoted in commands_in(path):
        _, *parts = shlex.split(quoted.replace("…", ""))
        command: click.Command = cli.main
        while isinstance(command, click.Group) and parts and not parts[0].startswith("-"):
            name = parts.pop(0)
            assert name in command.commands, quoted
            command = command.commands[name]
        known = {option for parameter in command.params for option in parameter.opts}
        assert {part for part in parts if part.startswith("--")} <= known, quoted


def test_the_commands_of_a_rig_are_all_shown():
    shown = {quoted.split()[2] for quoted in commands_in(DOCUMENT) if quoted.startswith("brdfpipe rig ")}
    assert shown == set(commands.rig.commands)


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.name)
def test_links_have_targets(path):
    for target in re.findall(r"\]\(([^)\s]+)\)", _without_code(path.read_text(encoding="utf-8"))):
        if target.startswith("http"):
            continue
        file, _, anchor = target.partition("#")
        page = (path.parent / file).resolve() if file else path
        assert page.exists(), target
        assert not anchor or anchor in _anchors(page), target


def _anchors(path: Path) -> set[str]:
    titles = re.findall(r"^#+ (.*)$", _without_code(path.read_text(encoding="utf-8")), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


# --- code that runs


def blocks() -> list[str]:
    return re.findall(r"^```python\n(.*?)^```$", TEXT, re.MULTILINE | re.DOTALL)


@pytest.fixture
def drivers(monkeypatch):
    """A table of drivers that a test may extend."""
    monkeypatch.setattr(devices, "WHEELS", dict(devices.WHEELS))


def test_the_camera_of_the_drop_folder_serves_it(tmp_path, monkeypatch):
    (tmp_path / "camera").mkdir()
    monkeypatch.chdir(tmp_path)
    names = example("serve_folder")
    try:
        served = devices.open_camera(CameraSettings("drop-folder", folder=str(tmp_path / "camera"), timeout=600.0))
        picture = served.expose(0.5)
        dark = served.expose(0.25, shutter=False)
    finally:
        names["stop"].set()
    assert picture.counts.shape == (240, 320)
    assert (picture.seconds, picture.temperature, dark.seconds) == (0.5, -20.0, 0.25)
    (shown,) = re.findall(r"`(\{\"id\".*?\})`", section("The camera"))
    for request in (tmp_path / "camera").glob("*.json"):
        assert json.loads(request.read_text()).keys() == json.loads(shown).keys()


def test_the_emulated_rig_of_the_example_sees_light_through_both_faults(tmp_path, monkeypatch):
    small_rig.write(tmp_path / "bench", timeout=0.4)
    (tmp_path / "results" / "opal-glass").mkdir(parents=True)
    truth = tmp_path / "results" / "opal-glass" / "bsdf.nc"
    save_dataset(small_rig.truth(), truth, stage="truth", material="tile")
    monkeypatch.chdir(tmp_path)
    names = example("EmulatedRig(")
    assert sorted(fault.kind for fault in names["faults"].injected) == ["garbage", "late-ok"]
    rig: Rig = names["plan"].rig
    assert names["raw"].counts.shape == (rig.camera.height, rig.camera.width)
    assert names["raw"].counts.max() > 2 * np.median(names["raw"].counts)
    assert names["truth"].dataset.identical(brdfpipe.open_dataset(truth))


def example(*marks: str) -> dict[str, Any]:
    """Names defined by the blocks of code that contain these words, run one after the other."""
    names: dict[str, Any] = {}
    for mark in marks:
        (code,) = [block for block in blocks() if mark in block]
        exec(code, names)
    return names


def test_the_device_of_the_example_is_driven_through_faults(drivers, capsys):
    names = example('WHEELS["dotted"]', "class DottedWheel")
    assert capsys.readouterr().out.startswith("Dotted wheel 17 3 5 ")
    assert [fault.kind for fault in names["faults"].injected] == ["truncated", "late-ok"]


@pytest.fixture(scope="module")
def dotted():
    """Names defined by both blocks of the example; the table of drivers is restored."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(devices, "WHEELS", dict(devices.WHEELS))
        return example('WHEELS["dotted"]', "class DottedWheel")


@pytest.fixture
def known(dotted, drivers):
    """The device of the example, registered."""
    devices.WHEELS["dotted"] = dotted["FilterWheel"]
    return dotted


SETTINGS = description.SerialSettings("dotted", "", 9600, query_timeout=0.3, motion_timeout=0.3)


@pytest.mark.cases(2)
@pytest.mark.parametrize("kind", ["silence", "garbage", "truncated", "late-ok"])
def test_the_device_of_the_example_recovers_from_a_fault_at_any_command(known, kind):
    for ordinal in range(1, 8):  # the commands of an identification, a move and its read-back
        faults = Faults.at({ordinal: kind})
        with Port(known["DottedWheel"](VirtualClock()), faults) as port:
            wheel = devices.open_wheel(replace(SETTINGS, port=port.path))
            assert wheel.goto(3) == 3
            assert port.device.place == 3
            wheel.close()
        assert len(faults.injected) == 1


def test_the_device_of_the_example_is_recognised_where_another_is_expected(known):
    """By the refusal in its dialect's entry."""
    with Port(known["DottedWheel"](VirtualClock())) as port:
        wheel = devices.open_wheel(replace(SETTINGS, dialect="thorlabs", port=port.path))
        with pytest.raises(WrongDevice, match="a device of the Dotted dialect answers"):
            wheel.identify()
        wheel.close()
