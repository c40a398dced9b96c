"""Files appear whole, carry their provenance, and are the same bytes for the same content."""

from __future__ import annotations

import json

import numpy as np
import pytest
import samples
import xarray as xr

import brdfpipe
from brdfpipe import netcdf_files, store
from brdfpipe.errors import InputError, VocabularyError


def save(dataset, path, **provenance):
    given = {"stage": "spectrum", "material": "grey", "inputs": {}, "parameters": {"scale": "percent"}}
    return store.save_dataset(dataset, path, **{**given, **provenance})


def test_a_dataset_is_read_as_it_was_written(tmp_path):
    saved = save(samples.spectrum(), tmp_path / "a.nc")
    xr.testing.assert_identical(brdfpipe.open_dataset(tmp_path / "a.nc"), saved)


def test_a_rewrite_gives_the_same_bytes(tmp_path):
    save(samples.beckmann_bsdf(), tmp_path / "a.nc")
    save(samples.beckmann_bsdf(), tmp_path / "b.nc")
    assert (tmp_path / "a.nc").read_bytes() == (tmp_path / "b.nc").read_bytes()


def test_the_order_attributes_were_set_in_does_not_matter(tmp_path):
    spectrum = samples.spectrum()
    reordered = spectrum.assign_attrs({})
    reordered.attrs = dict(reversed(spectrum.attrs.items()))
    save(spectrum, tmp_path / "a.nc")
    save(reordered, tmp_path / "b.nc")
    assert (tmp_path / "a.nc").read_bytes() == (tmp_path / "b.nc").read_bytes()


def test_the_digest_survives_the_file(tmp_path):
    saved = save(samples.beckmann_bsdf(), tmp_path / "a.nc")
    read = brdfpipe.open_dataset(tmp_path / "a.nc")
    assert store.digest(read) == saved.attrs["digest"]
    assert store.verify_digest(read, "a.nc") is read


@pytest.mark.parametrize(
    "change",
    [
        lambda d: d["total_reflectance"].__setitem__(3, 0.31),
        lambda d: d.attrs.__setitem__("geometry", "sce"),
        lambda d: d["wavelength"].attrs.__setitem__("long_name", "colour"),
    ],
)
def test_the_digest_sees_values_and_attributes(change):
    spectrum = samples.spectrum().copy(deep=True)
    before = store.digest(spectrum)
    change(spectrum)
    assert store.digest(spectrum) != before


def test_the_digest_ignores_software_versions():
    spectrum = samples.spectrum()
    assert store.digest(spectrum) == store.digest(spectrum.assign_attrs(software="another"))


def test_provenance_names_inputs_by_their_content(tmp_path):
    raw = tmp_path / "raw.txt"
    raw.write_text("400 0.3\n")
    source = save(samples.spectrum(), tmp_path / "source.nc")
    saved = save(samples.spectrum(), tmp_path / "a.nc", inputs={"raw": raw, "source": source})
    inputs = json.loads(saved.attrs["inputs"])
    assert inputs == {"raw": store.file_digest(raw), "source": source.attrs["digest"]}
    assert str(tmp_path) not in json.dumps(saved.attrs)


def test_nothing_is_left_behind_when_writing_fails(tmp_path, monkeypatch):
    def full(*_args, **_kwargs):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(netcdf_files, "write", full)
    with pytest.raises(store.StoreError, match="is the disk full"):
        save(samples.spectrum(), tmp_path / "a.nc")
    assert list(tmp_path.iterdir()) == []


def test_a_failed_write_leaves_the_former_file_alone(tmp_path):
    save(samples.spectrum(), tmp_path / "a.nc")
    before = (tmp_path / "a.nc").read_bytes()
    bad = samples.spectrum()
    bad["total_reflectance"][0] = np.nan
    with pytest.raises(VocabularyError):
        save(bad, tmp_path / "a.nc")
    assert (tmp_path / "a.nc").read_bytes() == before


def test_a_full_disk_is_noticed_before_writing(tmp_path, monkeypatch):
    monkeypatch.setattr(store.shutil, "disk_usage", lambda _folder: type("Usage", (), {"free": 1000})())
    with pytest.raises(store.StoreError, match="free some disk space"):
        save(samples.spectrum(), tmp_path / "a.nc")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("keep", [0, 100, 3000])
def test_a_truncated_file_is_named_with_the_way_to_mend_it(tmp_path, keep):
    path = tmp_path / "a.nc"
    save(samples.beckmann_bsdf(), path)
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(store.StoreError, match=r"a\.nc: damaged or not a netCDF file.*brdfpipe build") as refusal:
        store.open_dataset(path)
    # The path once, as it was given, and not again inside the library's own words.
    assert str(refusal.value).count(str(tmp_path)) == 1


@pytest.fixture
def zeroed(tmp_path):
    """A file with zeros in the middle, where the heights of a surface are."""
    path = tmp_path / "zeroed.nc"
    save(samples.gaussian_surface(128), path)
    content = bytearray(path.read_bytes())
    middle = len(content) // 2
    content[middle : middle + 4096] = bytes(4096)
    path.write_bytes(bytes(content))
    return path


def test_a_zeroed_block_is_an_error_and_not_zeros(zeroed):
    with pytest.raises(store.StoreError, match="damaged"):
        brdfpipe.open_dataset(zeroed)


def test_opened_datasets_are_read_where_they_are_used(tmp_path, zeroed):
    whole = tmp_path / "whole.nc"
    save(samples.spectrum(0.5), whole)
    with store.opened({"grey": whole, "surface": zeroed}) as datasets:
        assert (datasets["grey"]["total_reflectance"].values == 0.5).all()
        assert datasets["surface"].attrs["kind"] == "surface"
    with (
        pytest.raises(store.StoreError, match=r"zeroed\.nc: damaged"),
        store.opened({"grey": whole, "surface": zeroed}) as datasets,
    ):
        datasets["surface"]["height"].sum()


def test_a_dataset_of_another_material_than_its_place_says_is_refused(tmp_path):
    path = tmp_path / "grey" / "spectrum.nc"
    save(samples.spectrum(), path, material="red")
    store.open_dataset(path)
    with store.owners_checked(lambda path: path.parent.name):
        save(samples.spectrum(), tmp_path / "red" / "spectrum.nc", material="red")
        store.open_dataset(tmp_path / "red" / "spectrum.nc")
        with pytest.raises(store.StoreError, match="is a dataset of the material red, not of grey"):
            store.open_dataset(path)
        with (
            pytest.raises(store.StoreError, match="is a dataset of the material red, not of grey"),
            store.opened({"spectrum": path}),
        ):
            pass
    store.open_dataset(path)


def test_a_shared_dataset_is_read_again_after_its_file_is_written(tmp_path):
    path = tmp_path / "a.nc"
    save(samples.spectrum(), path)
    shared = store.shared_dataset(path, "spectrum")
    assert store.shared_dataset(path) is shared
    xr.testing.assert_identical(shared, store.open_dataset(path))
    with pytest.raises(VocabularyError):
        store.shared_dataset(path, "bsdf")

    save(samples.beckmann_bsdf(), path)
    assert store.shared_dataset(path).attrs["kind"] == "bsdf"


def test_a_damaged_file_is_not_read_from_what_is_shared(tmp_path):
    path = tmp_path / "a.nc"
    save(samples.spectrum(), path)
    store.shared_dataset(path)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(store.StoreError, match="damaged"):
        store.shared_dataset(path)
    path.unlink()
    with pytest.raises(store.StoreError, match="no such dataset"):
        store.shared_dataset(path)


@pytest.mark.parametrize("limit", ["_MOST_SHARED", "_MOST_SHARED_BYTES"])
def test_shared_datasets_are_limited(tmp_path, monkeypatch, limit):
    paths = [tmp_path / "a.nc", tmp_path / "b.nc"]
    for path in paths:
        save(samples.spectrum(), path)
    monkeypatch.setattr(store, limit, 1)
    first = store.shared_dataset(paths[0])
    assert store.shared_dataset(paths[0]) is first
    store.shared_dataset(paths[1])
    assert store.shared_dataset(paths[0]) is not first


def test_a_shared_dataset_of_another_material_is_refused(tmp_path):
    path = tmp_path / "grey" / "spectrum.nc"
    save(samples.spectrum(), path, material="red")
    store.shared_dataset(path)
    with (
        store.owners_checked(lambda path: path.parent.name),
        pytest.raises(store.StoreError, match="is a dataset of the material red, not of grey"),
    ):
        store.shared_dataset(path)


def test_an_error_of_another_cause_is_not_that_of_an_opened_file(tmp_path):
    path = tmp_path / "a.nc"
    save(samples.spectrum(), path)
    with pytest.raises(ValueError, match="unlucky"), store.opened({"grey": path}):
        raise ValueError("unlucky")


@pytest.mark.parametrize("keep", [None, 0, 100])
def test_a_missing_or_truncated_file_cannot_be_opened(tmp_path, keep):
    path = tmp_path / "a.nc"
    if keep is not None:
        save(samples.spectrum(), path)
        path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(store.StoreError, match="brdfpipe build"), store.opened({"grey": path}):
        pass


def test_the_refusal_of_a_missing_dataset_names_the_command_that_makes_it(tmp_path):
    with pytest.raises(store.StoreError, match="brdfpipe build"):
        brdfpipe.open_dataset(tmp_path / "none.nc")


def test_a_missing_raw_file_is_an_input_error(tmp_path):
    with pytest.raises(InputError, match=r"none\.txt: cannot be read"):
        store.file_digest(tmp_path / "none.txt")


def test_text_files_keep_their_line_ends(tmp_path):
    store.write_text(tmp_path / "a.csv", "a\nµ\n")
    assert (tmp_path / "a.csv").read_bytes() == "a\nµ\n".encode()


def test_what_was_written_is_not_read_again_where_datasets_are_remembered(tmp_path, monkeypatch):
    path = tmp_path / "a.nc"
    with store.remembering():
        saved = save(samples.spectrum(), path)
    read = []
    monkeypatch.setattr(netcdf_files, "read", lambda path: read.append(path) or saved)
    with store.remembering():
        again = store.open_dataset(path)
        with store.opened({"spectrum": path}) as datasets:
            xr.testing.assert_identical(datasets["spectrum"], saved)
    xr.testing.assert_identical(again, saved)
    assert read == []
    store.open_dataset(path)  # outside of stages
    assert read == [path]


def test_a_remembered_dataset_is_read_again_after_its_file_changed(tmp_path):
    path = tmp_path / "a.nc"
    with store.remembering():
        save(samples.spectrum(0.5), path)
        save(samples.spectrum(0.6), tmp_path / "b.nc")
        (tmp_path / "b.nc").replace(path)
        assert (store.open_dataset(path)["total_reflectance"].values == 0.6).all()
        path.write_bytes(path.read_bytes()[:3000])
        with pytest.raises(store.StoreError, match="damaged"):
            store.open_dataset(path)


def test_who_changes_a_remembered_dataset_changes_it_for_nobody_else(tmp_path):
    path = tmp_path / "a.nc"
    with store.remembering():
        save(samples.spectrum(0.5), path)
        store.open_dataset(path).attrs["geometry"] = "changed"
        mine = store.open_dataset(path)
        mine["total_reflectance"] = mine["total_reflectance"] * 2
        assert store.open_dataset(path).attrs["geometry"] != "changed"
        assert (store.open_dataset(path)["total_reflectance"].values == 0.5).all()


@pytest.mark.parametrize("limit", [("_MOST_REMEMBERED_BYTES", 0), ("_MOST_BYTES_OF_ONE", 0)])
def test_remembered_datasets_are_limited(tmp_path, monkeypatch, limit):
    monkeypatch.setattr(store, *limit)
    with store.remembering():
        save(samples.spectrum(), tmp_path / "a.nc")
        store.open_dataset(tmp_path / "a.nc")
    assert not store._remembered
