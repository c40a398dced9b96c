"""What changed between two builds, against changes that are known."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import xarray as xr

from brdfpipe import store
from brdfpipe.errors import BrdfpipeError
from brdfpipe.releases import differences as releases_differences
from brdfpipe.releases.differences import Difference, read_releases
from brdfpipe.report import combine, summarise

Release = Callable[..., Path]
Plastic = Callable[..., dict[str, xr.Dataset]]


def differences(old: Path, new: Path) -> list[Difference]:
    return releases_differences.differences(read_releases(old), read_releases(new))


def by_name(found: list[Difference]) -> dict[str, Difference]:
    return {item.material: item for item in found}


def test_a_release_does_not_differ_from_itself(release: Release, plastic: Plastic) -> None:
    folder = release("old", {"black": plastic(), "grey": plastic("grey")})
    assert {item.status for item in differences(folder, folder)} == {"unchanged"}


def test_a_changed_key_is_found_with_its_effect_on_the_brdf(release: Release, plastic: Plastic) -> None:
    old = release("old", {"black": plastic(a=0.1), "grey": plastic("grey")})
    new = release("new", {"black": plastic(a=0.1002), "grey": plastic("grey")})
    found = by_name(differences(old, new))
    assert found["grey"].status == "unchanged"
    assert [(cause.kind, cause.text) for cause in found["black"].causes] == [("key", "a: 0.1 → 0.1002")]
    # The peak of a lobe of slopes goes as 1 / a², its width as a: no direction where there is light changes by much more.
    assert 0.0005 < found["black"].brdf["rms"] < 0.02
    assert found["black"].brdf["percentile_95"] >= found["black"].brdf["rms"] / 2


def test_materials_that_came_and_went_and_failed_are_named(release: Release, plastic: Plastic) -> None:
    broken = {"stage": "surface", "message": "no unit"}
    old = release("old", {"gone": plastic("gone"), "breaks": plastic("breaks")}, {"mended": broken, "bad": broken})
    new = release("new", {"fresh": plastic("fresh"), "mended": plastic("mended")}, {"breaks": broken, "bad": broken})
    found = by_name(differences(old, new))
    assert {name: item.status for name, item in found.items()} == {
        "gone": "removed",
        "fresh": "added",
        "breaks": "changed",
        "mended": "changed",
        "bad": "unchanged",
    }
    assert found["breaks"].built == (True, False)
    assert found["breaks"].failure == "surface: no unit"
    assert found["mended"].built == (False, True)


def test_quantities_and_colour_of_the_table_are_compared(release: Release, plastic: Plastic) -> None:
    folders = []
    for name, lightness in (("old", 50.0), ("new", 51.0)):
        folder = release(name, {"black": plastic(a=0.1 if name == "old" else 0.2)})
        row = combine([summarise(plastic(a=0.1 if name == "old" else 0.2))])
        numbers = {"L": lightness, "a": 0.0, "b": 0.0, "gloss_60": 2 * lightness}
        row = row.assign({key: row[key].copy(data=[value]) for key, value in numbers.items()})
        store.save_dataset(row, folder / "catalogue.nc", stage="catalogue", material="catalogue")
        folders.append(folder)
    (found,) = differences(*folders)
    assert found.quantities["gloss_60"] == (100.0, 102.0)
    assert found.colour == pytest.approx(1.0, abs=0.02)  # at L* = 50 a step of lightness weighs 1 (CIE 142)


def test_a_damaged_dataset_is_named_and_stops_no_other_material(release: Release, plastic: Plastic) -> None:
    old = release("old", {"black": plastic(a=0.1), "grey": plastic("grey", a=0.1)})
    new = release("new", {"black": plastic(a=0.2), "grey": plastic("grey", a=0.2)})
    (new / "black" / "bsdf.nc").write_bytes(b"\x89HDF damaged")
    found = by_name(differences(old, new))
    assert "bsdf.nc" in found["black"].problem
    assert found["grey"].brdf
    assert not found["grey"].problem


def test_folders_that_cannot_be_compared_are_refused(tmp_path: Path, release: Release, plastic: Plastic) -> None:
    folder = release("old", {"black": plastic()})
    with pytest.raises(BrdfpipeError, match="no results of a catalogue"):
        differences(folder, tmp_path)
    other = tmp_path / "other" / "scenes" / "gloss-sheet"
    other.parent.mkdir(parents=True)
    release("moved", {"black": plastic()}).rename(other)
    with pytest.raises(BrdfpipeError, match="no scene in common"):
        differences(folder, tmp_path / "other")


def test_a_table_of_earlier_results_is_refused(release: Release, plastic: Plastic) -> None:
    folder = release("new", {"black": plastic(), "grey": plastic("grey")})
    summary = folder / "grey" / "summary.nc"
    # As after a build of `grey` alone: first with the results of the table, then with others.
    store.save_dataset(summarise(plastic("grey")), summary, stage="summary", material="grey")
    assert {difference.status for difference in differences(folder, folder)} == {"unchanged"}
    store.save_dataset(summarise(plastic("grey", a=0.2)), summary, stage="summary", material="grey")
    with pytest.raises(BrdfpipeError, match="grey built again after the table of the catalogue"):
        differences(folder, folder)


@pytest.mark.parametrize("content", [b"material\nblack\n", b"\xff", b"material,status\nblack,failed\n", b"a" * 200_000])
def test_a_damaged_table_is_one_error(release: Release, plastic: Plastic, content: bytes) -> None:
    folder = release("old", {"black": plastic()})
    (folder / "catalogue.csv").write_bytes(content)
    with pytest.raises(BrdfpipeError, match="damaged; run `brdfpipe build`"):
        differences(folder, folder)
