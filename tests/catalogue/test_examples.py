"""``brdfpipe examples`` copies a catalogue that is ready to be built."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from brdfpipe.catalogue.catalogue import load
from brdfpipe.catalogue.configuration import load_config
from brdfpipe.catalogue.examples import copy_examples
from brdfpipe.catalogue.names import CatalogueError
from brdfpipe.cli.main import main


def test_the_copy_is_a_catalogue_without_mistakes(tmp_path: Path) -> None:
    found = CliRunner().invoke(main, ["examples", str(tmp_path / "materials")])
    assert found.exit_code == 0, found.output
    loaded = load(tmp_path / "materials", load_config())
    assert loaded.failures == {}
    assert {material.name for material in loaded.materials} >= {"abs-grain", "milk-glass", "paint-lab"}
    assert not list((tmp_path / "materials").rglob("*.py"))


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(CatalogueError, match="give a new folder"):
        copy_examples(tmp_path)
