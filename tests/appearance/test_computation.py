"""The appearance as config.yaml asks for it."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import numpy as np
import pytest
import samples

from brdfpipe import appearance, catalogue, flakes, store, vocabulary
from brdfpipe.appearance.haze import WINDOWS
from brdfpipe.bsdf import flake
from brdfpipe.catalogue.config_keys import Appearance
from brdfpipe.descriptions.reading import declared
from brdfpipe.errors import BrdfpipeError, InputError
from brdfpipe.flakes import SETS


def test_the_configuration_offers_every_set_of_geometries_and_no_other():
    items = get_args(declared(Appearance, ["geometries"]).annotation)[0]
    assert sorted(declared(items).choices) == sorted(SETS)


def test_the_configuration_s_own_windows_are_those_of_the_function():
    asked = catalogue.load_config()["appearance"]
    assert asked["geometries"] == []
    assert [(window["angle"], window["offset"], tuple(window["aperture"])) for window in asked["haze"]] == list(WINDOWS)


def test_a_configuration_may_ask_for_geometries_and_windows(tmp_path: Path):
    own = tmp_path / "own.yaml"
    window = "{angle: 30, offset: 2, aperture: [0.5, 3]}"
    own.write_text(f"appearance: {{geometries: [DIN 6175-2], haze: [{window}]}}\n")
    computed = appearance.compute_appearance(samples.beckmann_bsdf(0.1), **catalogue.load_config(own)["appearance"])
    path = tmp_path / "appearance.nc"
    store.save_dataset(computed, path, stage="appearance", material="m")
    kept = store.open_dataset(path, "appearance")
    assert kept["haze_window"].values.tolist() == ["30° ± 2°, 0.5° × 3°"]
    assert "45as75" in kept["geometry"].values.tolist()


@pytest.mark.parametrize(
    "asked",
    ["geometries: [E2195]", "haze: [{angle: 20, offset: 1.9}]", "windows: []", "haze: [{angle: 20, offset: -2}]"],
)
def test_impossible_settings_of_the_appearance_are_refused(tmp_path: Path, asked: str):
    own = tmp_path / "own.yaml"
    own.write_text(f"appearance: {{{asked}}}\n")
    with pytest.raises(InputError, match="appearance"):
        catalogue.load_config(own)


LAB = {"45as15": (33.90, -7.58, -36.61), "45as45": (12.29, 1.19, -25.77), "45as110": (3.07, 2.09, -13.24)}


def paint(**options):
    listed = [{"geometry": name, "lab": list(lab)} for name, lab in LAB.items()]
    return flake.build(flakes.ingest({"colours": listed, "illuminant": "D65", "observer": 10}), index=1.524, **options)


@pytest.mark.parametrize(
    ("options", "mend"),
    [
        ({}, "`multiangle.model: flake-physical`"),
        ({"model": "flake-physical", "clear_coat": "none"}, "`multiangle.clear_coat: smooth`"),
    ],
)
def test_the_gloss_of_flakes_without_a_clear_coat_has_a_warning_with_the_remedy(tmp_path: Path, options, mend):
    path = tmp_path / "appearance.nc"
    store.save_dataset(appearance.compute_appearance(paint(**options)), path, stage="appearance", material="m")
    computed = store.open_dataset(path, "appearance")
    assert mend in computed.attrs["no_gloss"]
    assert vocabulary.warnings(computed) == [computed.attrs["no_gloss"]]
    for name in ("gloss", "gloss_u", "haze", "reflectance_haze"):
        assert computed[name].attrs["comment"] == "of the flakes alone: no clear coat is modelled"
    assert "comment" not in computed["lab"].attrs
    # What a gloss meter would see of any such paint is a hundred times this.
    assert float(computed["gloss"].max()) < 1


@pytest.mark.parametrize("coat", ["smooth", 0.02])
def test_the_gloss_of_a_paint_with_its_coat_is_given_without_reserve(coat):
    computed = appearance.compute_appearance(paint(model="flake-physical", clear_coat=coat))
    assert float(computed["gloss"].sel(gloss_angle=60)) > 50
    assert "no_gloss" not in computed.attrs
    assert not vocabulary.warnings(computed)
    assert "comment" not in computed["gloss"].attrs


def test_only_flakes_lack_a_coat():
    assert "no_gloss" not in appearance.compute_appearance(samples.beckmann_bsdf(0.3)).attrs


def test_a_colour_beyond_the_measured_flake_angles_is_flagged(tmp_path: Path):
    path = tmp_path / "appearance.nc"
    store.save_dataset(
        appearance.compute_appearance(paint(), geometries=["MA-T6"]), path, stage="appearance", material="m"
    )
    computed = store.open_dataset(path, "appearance")
    flags = computed["lab_quality"].to_series().map(dict(enumerate(vocabulary.QUALITY_FLAGS))).to_dict()
    assert flags["45as-15"] == "extrapolated"
    assert flags["45as15"] == flags["45as110"] == "measured"
    assert flags["45as25"] == "interpolated"
    assert flags["8:total"] == "completed"
    assert "lab_quality" not in appearance.compute_appearance(samples.beckmann_bsdf(0.3))


def test_every_quantity_of_instruments_has_its_uncertainty():
    computed = appearance.compute_appearance(paint(model="flake-physical", clear_coat=0.02))
    for name in ("gloss", "haze", "reflectance_haze", "flop_index"):
        assert (computed[f"{name}_u"] > 0).all(), name
        assert (computed[f"{name}_u"] < 0.2 * abs(computed[name])).all(), name
    single = computed["lab_u"].drop_sel(geometry="8:total")
    assert (single > 0).all()
    assert computed["lab_u"].sel(geometry="8:total").isnull().all()
    vocabulary.validate(computed, "appearance")


def test_only_the_asked_parts_are_computed_with_the_values_of_the_whole() -> None:
    bsdf = samples.beckmann_bsdf(0.1, reflectance=0.2)
    whole = appearance.compute_appearance(bsdf)
    gloss = appearance.compute_appearance(bsdf, parts=["gloss"], gloss_angles=[60])
    assert set(gloss.data_vars) == {"gloss", "gloss_u", "haze", "haze_u"}
    assert gloss["gloss"].item() == float(whole["gloss"].sel(gloss_angle=60))
    haze = appearance.compute_appearance(bsdf, parts=["haze"])
    assert set(haze.data_vars) == {"reflectance_haze", "reflectance_haze_u"}
    assert float(haze["reflectance_haze"].item()) == float(whole["reflectance_haze"].item())
    names = ["45as25", "45as45"]
    colours = appearance.compute_appearance(bsdf, parts=["colour"], geometries=names, standard_geometries=False)
    assert list(colours["geometry"].values) == ["8:total", *names]
    assert set(colours.data_vars) == {"lab", "lab_u", "lab_sce", "luminous_reflectance", "srgb"}
    # Rounding: the light is summed in another order.
    assert np.allclose(colours["lab"].sel(geometry="45as45"), whole["lab"].sel(geometry="45as45"), atol=1e-9)
    total = appearance.compute_appearance(bsdf, parts=["colour"], geometries=[], standard_geometries=False)
    assert list(total["geometry"].values) == ["8:total"]
    assert set(total.data_vars) == set(colours.data_vars)
    for part in (gloss, haze, colours, total):
        vocabulary.validate(part, "appearance")


def test_an_unknown_part_is_refused() -> None:
    with pytest.raises(BrdfpipeError, match="no part 'glos'"):
        appearance.compute_appearance(samples.beckmann_bsdf(0.1), parts=["glos"])
