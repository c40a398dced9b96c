"""The datasets of a material for its page: by name, without changes by uncertain inputs where a BSDF is evaluated."""

from __future__ import annotations

import samples
import xarray as xr

from brdfpipe import store
from brdfpipe.bsdf.change_variables import DIMENSION
from brdfpipe.report import reading


def stored(folder, name: str, dataset: xr.Dataset) -> str:
    path = str(folder / f"{name}.nc")
    store.save_dataset(dataset, path, stage=name, material="sample")
    return path


def test_a_stage_with_several_datasets_gives_them_the_names_of_their_files(tmp_path):
    one, two, three = (
        stored(tmp_path, name, samples.spectrum(0.5)) for name in ("spectrum", "reduced-10", "reduced-60")
    )
    with reading.opened({"spectrum": one, "reduced": [two, three]}) as datasets:
        assert [(name, dataset.attrs["stage"]) for name, dataset in datasets.items()] == [
            (name, name) for name in ("spectrum", "reduced-10", "reduced-60")
        ]
        assert (datasets["spectrum"]["total_reflectance"].values == 0.5).all()


def test_a_bsdf_that_is_evaluated_has_its_values_and_no_changes(tmp_path):
    given = samples.glossy_bsdf(0.1, 1.5)
    change = xr.DataArray([[0.1], [0.2]], dims=(DIMENSION, "wavelength")) * given["n"]
    path = stored(tmp_path, "bsdf", given.assign(n_change=change.assign_attrs(units="1", long_name="change")))
    with reading.opened({"bsdf": path}, evaluated=("bsdf", "predicted")) as datasets:
        bsdf = datasets["bsdf"]
    assert DIMENSION not in bsdf.dims
    xr.testing.assert_identical(bsdf.drop_attrs(), store.open_dataset(path).drop_dims(DIMENSION).drop_attrs())


def test_links_of_a_page_lead_from_its_folder_to_the_datasets():
    files = {"appearance": "scenes/g/a b/appearance.nc", "reduced": ["a b/reduced-10.nc", "a b/reduced-60.nc"]}
    assert reading.relative(files, to="scenes/g/a b/report.html") == {
        "appearance": "appearance.nc",
        "reduced-10": "../../../a b/reduced-10.nc",
        "reduced-60": "../../../a b/reduced-60.nc",
    }
