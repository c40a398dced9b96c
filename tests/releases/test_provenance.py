"""The origin of a stored dataset is read as it was recorded."""

from __future__ import annotations

from pathlib import Path

import pytest
import samples

from brdfpipe import store
from brdfpipe.releases.provenance import of_material, read_provenance
from brdfpipe.store import StoreError


def test_what_storing_records_is_read_again(tmp_path: Path) -> None:
    raw = tmp_path / "raw.txt"
    raw.write_text("1 2")
    saved = store.save_dataset(
        samples.spectrum(),
        tmp_path / "a" / "spectrum.nc",
        stage="spectrum",
        material="a",
        inputs={"raw": raw},
        parameters={"scale": "percent"},
    )
    found = of_material(tmp_path, "", "a")["spectrum"]
    assert found.digest == saved.attrs["digest"]
    assert found.inputs == {"raw": store.file_digest(raw)}
    assert found.parameters == {"scale": "percent"}
    assert "numpy" in found.software


def test_a_scene_has_its_own_results_beside_those_that_scenes_share(tmp_path: Path) -> None:
    for place, stage in (("a", "spectrum"), ("scenes/gloss-sheet/a", "appearance")):
        store.save_dataset(samples.spectrum(), tmp_path / place / f"{stage}.nc", stage=stage, material="a")
    assert set(of_material(tmp_path, "", "a")) == {"spectrum"}
    assert set(of_material(tmp_path, "scenes/gloss-sheet", "a")) == {"spectrum", "appearance"}


@pytest.mark.parametrize("content", [b"", b"\x89HDF\r\n\x1a\n"])
def test_a_file_without_provenance_is_refused_by_name(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.nc").write_bytes(content)
    with pytest.raises(StoreError, match=r"a\.nc: no dataset with provenance"):
        read_provenance(tmp_path / "a.nc")
