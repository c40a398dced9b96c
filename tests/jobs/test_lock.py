"""A folder of results belongs to one build at a time."""

from __future__ import annotations

from pathlib import Path

import pytest

from brdfpipe.jobs.lock import BuildError, locked


def test_a_second_build_is_refused_until_the_first_ends(tmp_path: Path) -> None:
    with (
        locked(tmp_path / "results"),
        pytest.raises(BuildError, match="another build is running"),
        locked(tmp_path / "results"),
    ):
        pass
    with locked(tmp_path / "results"):
        assert (tmp_path / "results").is_dir()


def test_a_folder_that_cannot_be_made_is_one_error(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(BuildError, match="cannot be written"), locked(tmp_path / "file" / "results"):
        pass
