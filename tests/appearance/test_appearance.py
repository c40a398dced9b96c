"""The appearance as config.yaml asks for it."""

from __future__ import annotations

from pathlib import Path

import pytest
import samples
import yaml

from brdfpipe import appearance, catalogue, store
from brdfpipe.appearance.haze import WINDOWS
from brdfpipe.errors import InputError
from brdfpipe.flakes import SETS


def test_the_configuration_offers_every_set_of_geometries_and_no_other():
    schema = yaml.safe_load(
        (catalogue.project_folder() / "config" / "schemas" / "config.schema.yaml").read_text("utf-8")
    )
    offered = schema["properties"]["appearance"]["properties"]["geometries"]["items"]["enum"]
    assert sorted(offered) == sorted(SETS)


def test_the_configuration_s_own_windows_are_those_of_the_function():
    asked = catalogue.load_config()["appearance"]
    assert asked["geometries"] == []
    assert [(each["angle"], each["offset"], tuple(each["aperture"])) for each in asked["haze"]] == list(WINDOWS)


def test_a_configuration_may_ask_for_geometries_and_windows(tmp_path: Path):
    own = tmp_path / "own.yaml"
    window = "{angle: 30, offset: 2, aperture: [0.5, 3]}"
    own.write_text(f"appearance: {{geometries: [DIN 6175-2], haze: [{window}]}}\n")
    found = appearance.appraise(samples.beckmann_bsdf(0.1), **catalogue.load_config(own)["appearance"])
    path = tmp_path / "appearance.nc"
    store.save_dataset(found, path, stage="appearance", material="m")
    kept = store.open_dataset(path, "appearance")
    assert kept["haze_window"].values.tolist() == ["30° ± 2°, 0.5° × 3°"]
    assert "45as75" in kept["geometry"].values.tolist()


@pytest.mark.parametrize(
    "asked",
    ["geometries: [E2195]", "haze: [{angle: 20, offset: 1.9}]", "windows: []", "haze: [{angle: 20, offset: -2}]"],
)
def test_what_the_appearance_cannot_give_is_refused_at_once(tmp_path: Path, asked: str):
    own = tmp_path / "own.yaml"
    own.write_text(f"appearance: {{{asked}}}\n")
    with pytest.raises(InputError, match="appearance"):
        catalogue.load_config(own)
