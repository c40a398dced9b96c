"""One table of quantities: what it lists is computed, shown on every page, written to every file and documented."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import samples
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.appearance import compute_appearance
from brdfpipe.appearance.cabin import Cabin
from brdfpipe.appearance.quantities import (
    _TABLE,
    AppearanceQuantity,
    Applicability,
    _luminous_reflectance,
    docs_table,
    quantities,
    register,
)
from brdfpipe.bsdf import microfacet, slab
from brdfpipe.errors import BrdfpipeError
from brdfpipe.facets import analytic, flat
from brdfpipe.report import catalogue_csv, catalogue_page, combine, material_page, summarise

Datasets = dict[str, xr.Dataset]
DOCS = Path(__file__).parents[2] / "docs" / "quantities.md"


@pytest.fixture
def toy() -> Iterator[AppearanceQuantity]:
    """A quantity that only one file, this one, knows."""
    yield register(
        AppearanceQuantity(
            "toy_sparkle",
            "Toy sparkle",
            "S",
            "GU",
            2,
            "toy definition of sparkle",
            "Toy standard 1",
            compute=lambda bsdf: 12.345,
            applicability=Applicability("toy_sparkle", "rough surfaces", lambda datasets: ""),
            hint="toy hint",
        )
    )
    del _TABLE["toy_sparkle"]


def test_a_quantity_registered_in_one_place_is_computed_shown_written_and_documented(toy: AppearanceQuantity) -> None:
    bsdf = samples.beckmann_bsdf(0.1, reflectance=0.2)
    appearance = compute_appearance(bsdf, gloss_angles=[60], haze=[]).assign_attrs(material="a")
    assert float(appearance["toy_sparkle"]) == 12.345
    assert appearance["toy_sparkle"].attrs == {"units": "1", "long_name": "toy definition of sparkle"}
    datasets = {"bsdf": bsdf, "appearance": appearance}
    page = material_page(datasets)
    assert (
        '<dt>Toy sparkle</dt><dd><span class="value">12.35<small> GU</small></span><span class="hint">toy hint' in page
    )
    catalogue = combine([summarise(datasets)])
    assert float(catalogue["toy_sparkle"][0]) == 12.345
    (row,) = csv.DictReader(io.StringIO(catalogue_csv(catalogue, {})))
    assert row["toy_sparkle"] == "12.345"
    html = catalogue_page(catalogue, {})
    assert '<th scope="col">Toy sparkle</th>' in html
    assert "<td>12.35" in html
    assert "| `toy_sparkle` | Toy sparkle | S | GU | 2 | toy definition of sparkle | Toy standard 1 |" in docs_table()


def test_a_quantity_is_registered_once(toy: AppearanceQuantity) -> None:
    with pytest.raises(BrdfpipeError, match="'toy_sparkle' is registered twice"):
        register(toy)


def test_the_documented_table_is_current() -> None:
    assert DOCS.read_text("utf-8") == docs_table(), f"{DOCS.name} is stale; its head names the command that writes it"


def test_every_quantity_has_label_definition_and_unit() -> None:
    for quantity in quantities():
        assert quantity.label
        assert quantity.definition
        assert quantity.unit in ("1", "GU", "um", "degree")


def test_haze_of_transmission_is_on_the_page_of_the_material_and_in_the_catalogue() -> None:
    sheet = slab.build(flat(), flat(), index=1.5)
    appearance = compute_appearance(sheet, gloss_angles=[60], haze=[])
    datasets = {"bsdf": sheet, "appearance": appearance.assign(transmission_haze=0.1234)}
    page = material_page(datasets)
    assert '<dt>Haze D1003</dt><dd><span class="value">12.3<small> %</small>' in page
    assert '<dt>Transmittance</dt><dd><span class="value">' in page
    html = catalogue_page(combine([summarise(datasets)]), {})
    assert '<th scope="col">Haze D1003</th>' in html
    assert "<td>0.123<td>" in html


def test_haze_beside_the_mirror_direction_is_on_the_page_and_in_the_catalogue() -> None:
    bsdf = samples.beckmann_bsdf(0.1, reflectance=0.2).assign_attrs(route="measured")
    datasets = {"bsdf": bsdf, "appearance": compute_appearance(bsdf, gloss_angles=[60])}
    haze = float(datasets["appearance"]["reflectance_haze"][0])
    assert f'<dt>Haze ISO 13803</dt><dd><span class="value">{haze:.1f}<small> GU</small>' in material_page(datasets)
    row = summarise(datasets)
    assert float(row["reflectance_haze"][0]) == haze
    assert f"<td>{haze:.1f}<td>" in catalogue_page(row, {})


def test_haze_of_other_windows_is_not_that_of_iso_13803() -> None:
    bsdf = samples.beckmann_bsdf(0.1).assign_attrs(route="measured")
    window = {"angle": 30, "offset": 5, "aperture": [1, 2]}
    row = summarise({"bsdf": bsdf, "appearance": compute_appearance(bsdf, gloss_angles=[60], haze=[window])})
    assert np.isnan(float(row["reflectance_haze"][0]))
    assert "Add it to `appearance.haze`" in str(row["no_reflectance_haze"].values[0])


def test_the_catalogue_contains_the_flop_index_or_the_reason_why_not() -> None:
    bsdf = samples.beckmann_bsdf(0.1, reflectance=0.2).assign_attrs(route="measured")
    appearance = compute_appearance(bsdf, gloss_angles=[60], haze=[])
    assert float(summarise({"bsdf": bsdf, "appearance": appearance})["flop_index"][0]) == float(
        appearance["flop_index"]
    )
    rising = appearance["lab"].copy()
    rising.loc[{"geometry": "45as110", "component": "L*"}] = 99.0
    row = summarise({"bsdf": bsdf, "appearance": appearance.assign(flop_index=np.nan, lab=rising)})
    assert "darken away from the mirror direction" in str(row["no_flop"].values[0])
    black = appearance.assign(flop_index=np.nan, lab=xr.zeros_like(appearance["lab"]))
    assert "not defined for black" in str(summarise({"bsdf": bsdf, "appearance": black})["no_flop"].values[0])
    assert "perfectly diffuse" in str(summarise({"appearance": appearance})["no_flop"].values[0])


def test_a_plastic_has_no_flop_index_and_is_told_why() -> None:
    bsdf = samples.beckmann_bsdf(0.1, reflectance=0.06)
    row = summarise(
        {"bsdf": bsdf, "facets": samples.beckmann(0.1), "appearance": compute_appearance(bsdf, parts=["colour"])}
    )
    assert np.isnan(float(row["flop_index"][0]))
    assert "for paints with effect pigments" in str(row["no_flop"].values[0])


def test_the_catalogue_has_the_colours_without_specular_and_at_45_0(full: Datasets) -> None:
    bsdf = samples.beckmann_bsdf(0.02, reflectance=0.3)
    appearance = compute_appearance(bsdf, parts=["colour"])
    row = summarise({"bsdf": bsdf, "facets": samples.beckmann(0.02), "appearance": appearance})
    at_45 = [float(row[f"{name}_45_0"][0]) for name in "Lab"]
    assert at_45 == appearance["lab"].sel(geometry="45:0").values.tolist()
    without = [float(row[f"{name}_sce"][0]) for name in "Lab"]
    assert without == appearance["lab_sce"].values.tolist()
    # A glossy body without its gloss is darker than all it reflects; 45:0 sees no gloss either, only the base through the surface.
    assert without[0] < float(row["L"][0]) - 1
    assert np.isnan(float(summarise({"facets": full["facets"]})["L_sce"][0]))


def test_the_catalogue_has_numbers_of_the_scan_that_pages_do_not_list(full: Datasets) -> None:
    row, shown = summarise(full), catalogue_page(summarise(full), {})
    assert float(row["Sq"][0]) == pytest.approx(float(full["surface"]["Sq"]))
    assert float(row["pitch"][0]) == full["surface"].attrs["pitch_x"]
    assert float(row["missing_share"][0]) == pytest.approx(np.isnan(full["surface"]["height"].values).mean())
    assert np.isnan(float(row["lay_azimuth"][0]))
    assert "Pitch" not in shown
    brushed = analytic("beckmann", a_x=0.05, a_y=0.2, azimuth=-30)
    of_brushed = vocabulary.validate(summarise({"facets": brushed}), "catalogue")
    assert float(of_brushed["lay_azimuth"][0]) == pytest.approx(150.0)


def test_the_luminous_reflectance_of_a_constant_spectrum_is_that_constant(full: Datasets) -> None:
    grey = full["spectrum"].assign(total_reflectance=xr.full_like(full["spectrum"]["total_reflectance"], 0.25))
    # Y = 100 for the perfect diffuser by definition of the weights: only rounding remains.
    assert _luminous_reflectance({"spectrum": grey}) == pytest.approx(0.25, rel=1e-12)


def test_the_luminous_reflectance_is_nan_without_a_spectrum(full: Datasets) -> None:
    assert np.isnan(_luminous_reflectance({"facets": full["facets"]}))


def test_a_reflectance_without_its_specular_part_is_not_the_luminous_one(full: Datasets) -> None:
    excluded = full["spectrum"].assign_attrs(geometry="sce")
    assert np.isnan(_luminous_reflectance({"spectrum": excluded}))
    bsdf = microfacet.build(full["facets"], index=full["index"], spectrum=excluded, multiple_scattering="none")
    both = _luminous_reflectance({"spectrum": excluded, "bsdf": bsdf})
    # The facets of n = 1.55 mirror 4.9 % at most, of which the measurement excluded some.
    assert 0 < both - _luminous_reflectance({"spectrum": full["spectrum"]}) < 0.05


def test_the_total_of_a_measurement_is_not_that_of_the_spectrum_given_for_a_prediction(full: Datasets) -> None:
    measured = full["bsdf"].drop_vars("total_reflectance").assign_attrs(route="measured")
    assert np.isnan(_luminous_reflectance({"spectrum": full["spectrum"], "bsdf": measured}))


def test_veiling_luminance_is_computed_and_shown_only_where_it_is_asked_for() -> None:
    bsdf = samples.beckmann_bsdf(0.3, reflectance=0.05)
    plain = compute_appearance(bsdf, gloss_angles=[60], haze=[])
    asked = compute_appearance(bsdf, gloss_angles=[60], haze=[], cabin=Cabin())
    assert "veiling_luminance" not in plain
    xr.testing.assert_identical(asked[list(plain.data_vars)], plain)
    value = float(asked["veiling_luminance"])
    assert value == float(asked["veiling_luminance_sun"] + asked["veiling_luminance_sky"]) > 0
    assert "Veiling luminance" not in material_page({"bsdf": bsdf, "appearance": plain})
    page = material_page({"bsdf": bsdf, "appearance": asked})
    assert f'<dt>Veiling luminance</dt><dd><span class="value">{value:.3g}<small> cd/m²</small>' in page
    assert "veiling_luminance" not in summarise({"bsdf": bsdf, "appearance": plain})
    assert summarise({"bsdf": bsdf, "appearance": asked})["veiling_luminance"].item() == value
    assert "| `veiling_luminance` |" in docs_table()
