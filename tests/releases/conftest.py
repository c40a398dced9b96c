"""Results of a catalogue of one material, written without a build."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest
import samples
import xarray as xr

from brdfpipe import store
from brdfpipe.report import catalogue_csv, combine, lock, summarise

Release = Callable[..., Path]


@pytest.fixture
def release(tmp_path: Path) -> Release:
    """Writes results: ``release(name, materials={name: {stage: dataset}}, failures={})``."""

    def written(
        name: str,
        materials: Mapping[str, Mapping[str, xr.Dataset]],
        failures: Mapping[str, Mapping[str, str]] | None = None,
    ) -> Path:
        folder = tmp_path / name
        rows = []
        for material, datasets in materials.items():
            for stage, dataset in datasets.items():
                store.write_bytes(folder / material / f"{stage}.nc", b"")
                dataset.to_netcdf(folder / material / f"{stage}.nc")
            rows.append(summarise(datasets))
        catalogue = combine(rows)
        store.save_dataset(catalogue, folder / "catalogue.nc", stage="catalogue", material="catalogue")
        store.write_text(folder / "catalogue.csv", catalogue_csv(catalogue, failures or {}))
        store.write_text(folder / "catalogue.lock.json", lock(catalogue))
        return folder

    return written


@pytest.fixture(scope="session")
def plastic() -> Callable[..., dict[str, xr.Dataset]]:
    """The BSDF of a black plastic with a rough surface, stored with given parameters: ``plastic(a=0.1)``."""

    def made(material: str = "black", **parameters: Any) -> dict[str, xr.Dataset]:
        bsdf = samples.beckmann_bsdf(parameters.get("a", 0.1), n=1.5).assign_attrs(
            material=material,
            stage="bsdf",
            inputs="{}",
            parameters=store.canonical_json(parameters),
            software=store.canonical_json({"numpy": "2.4.0"}),
        )
        return {"bsdf": bsdf.assign_attrs(digest=store.digest(bsdf))}

    return made
