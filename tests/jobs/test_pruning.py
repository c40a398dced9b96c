"""Results of materials that left the catalogue are deleted, and nothing else."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
import xarray as xr

from brdfpipe.catalogue.catalogue import load
from brdfpipe.catalogue.names import LOCK
from brdfpipe.errors import BrdfpipeError
from brdfpipe.jobs.index import INDEX, Index
from brdfpipe.jobs.pruning import prune
from brdfpipe.releases.verification import verify_results

COLOUR = "spectrum: {lab: [50, 0, 0], illuminant: D65, observer: 10, geometry: sci}\n"


@pytest.fixture
def folders(tmp_path: Path) -> tuple[Path, Path]:
    """A catalogue of a material and one that cannot be built, and results of these and of what left."""
    catalogue, results = tmp_path / "catalogue", tmp_path / "results"
    for name, text in (("stays", COLOUR), ("broken", "spectrum: [")):
        (catalogue / name).mkdir(parents=True)
        (catalogue / name / "material.yaml").write_text(text)
    (catalogue / "calibrations" / "bench-1").mkdir(parents=True)
    for path in (
        *(
            f"{name}/bsdf.nc"
            for name in ("stays", "broken", "left", "scenes/gloss-sheet/left", "scenes/gloss-sheet/stays")
        ),
        *("logs/left/bsdf.log", "logs/stays/bsdf.log", "logs/scenes/gloss-sheet/left/appearance.log", "logs/build.log"),
        *("calibrations/bench-1.nc", "calibrations/bench-0.nc", "calibrations/bench-0/reduced.nc"),
        *("catalogue.nc", "notes/read.txt"),
    ):
        (results / path).parent.mkdir(parents=True, exist_ok=True)
        (results / path).write_text("12345678")
        if path.endswith("/bsdf.nc"):
            dataset(results / path, (results / path).parent.name)
    return catalogue, results


def dataset(path: Path, material: str) -> None:
    """A stored dataset of a material."""
    xr.Dataset(attrs={"material": material}).to_netcdf(path)


def files(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


LEFT = {
    "left/bsdf.nc",
    "scenes/gloss-sheet/left/bsdf.nc",
    "logs/left/bsdf.log",
    "logs/scenes/gloss-sheet/left/appearance.log",
    "calibrations/bench-0.nc",
    "calibrations/bench-0/reduced.nc",
}


def test_only_what_left_the_catalogue_is_deleted(folders: tuple[Path, Path]) -> None:
    catalogue, results = folders
    before, size = files(results), sum((results / name).stat().st_size for name in LEFT)
    pruned = prune(results, load(catalogue))
    assert before - files(results) == LEFT
    assert files(results) <= before
    assert pruned.size == size
    assert prune(results, load(catalogue)).paths == ()


def test_a_dry_run_deletes_nothing(folders: tuple[Path, Path]) -> None:
    catalogue, results = folders
    before = files(results)
    assert len(prune(results, load(catalogue), dry_run=True).paths) == 6
    assert files(results) == before


def test_the_results_of_another_catalogue_are_left_alone(folders: tuple[Path, Path], tmp_path: Path) -> None:
    (tmp_path / "other" / "new").mkdir(parents=True)
    (tmp_path / "other" / "new" / "material.yaml").write_text(COLOUR)
    before = files(folders[1])
    with pytest.raises(BrdfpipeError, match="give the catalogue that was built there"):
        prune(folders[1], load(tmp_path / "other"))
    assert files(folders[1]) == before


def test_links_are_neither_followed_nor_deleted(folders: tuple[Path, Path], tmp_path: Path) -> None:
    catalogue, results = folders
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "bsdf.nc").write_text("precious")
    (results / "linked").symlink_to(tmp_path / "elsewhere")
    prune(results, load(catalogue))
    assert (tmp_path / "elsewhere" / "bsdf.nc").read_text() == "precious"
    assert (results / "linked").is_symlink()


def test_raw_files_are_not_taken_for_results(folders: tuple[Path, Path], tmp_path: Path) -> None:
    raw = tmp_path / "raw"
    for path in ("calibrations/bench-0/counts.txt", "stays/scan.nc", "measured/scan.nc"):
        (raw / path).parent.mkdir(parents=True)
        (raw / path).write_text("precious")
    (raw / LOCK).touch()  # as prune itself leaves it
    before = files(raw)
    with pytest.raises(BrdfpipeError, match="give the folder of the results"):
        prune(raw, load(folders[0]))
    assert files(raw) == before


def test_a_copy_of_results_under_another_name_is_left_alone(folders: tuple[Path, Path]) -> None:
    catalogue, results = folders
    shutil.copytree(results / "stays", results / "stays-before")
    prune(results, load(catalogue))
    assert (results / "stays-before" / "bsdf.nc").exists()


def test_pruned_results_are_not_missing(folders: tuple[Path, Path]) -> None:
    catalogue, results = folders
    index = Index(results)
    for path in sorted(files(results)):
        if path != INDEX and not path.startswith("logs/"):
            index.finish("p", "c", (), [path])
    assert verify_results(results) == []
    prune(results, load(catalogue))
    assert verify_results(results) == []


def test_the_last_logs_of_snakemake_stay(folders: tuple[Path, Path]) -> None:
    catalogue, results = folders
    prune(results, load(catalogue))
    place = results / ".snakemake" / "log"
    place.mkdir(parents=True)
    logs = [place / f"2026-01-0{day}T120000.000000.snakemake.log" for day in range(1, 6)]
    for path in (*logs, place / "notes.txt"):
        path.write_text("a log")
    assert prune(results, load(catalogue)).paths == ()
    assert set(prune(results, load(catalogue), keep=2).paths) == {str(path.relative_to(results)) for path in logs[:3]}
    assert set(place.iterdir()) == {*logs[3:], place / "notes.txt"}
