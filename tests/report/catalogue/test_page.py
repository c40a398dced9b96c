from __future__ import annotations

import base64
import hashlib
import json
import re
from html import unescape
from pathlib import Path

import numpy as np
import pytest
import samples
import xarray as xr
from catalogue_rows import FAILURES, Datasets
from catalogue_rows import row as _row
from catalogue_rows import table as _table

from brdfpipe import optics, store, vocabulary
from brdfpipe.appearance.preview import preview
from brdfpipe.appearance.quantities import quantities
from brdfpipe.bsdf import microfacet
from brdfpipe.errors import VocabularyError
from brdfpipe.report import catalogue_csv, catalogue_page, combine, lock, summarise


def test_a_row_contains_the_quantities_of_the_material(full: Datasets) -> None:
    row = summarise(full).isel(material=0)
    assert str(row["material"].values) == "abs-grain"
    assert [float(row[name]) for name in ("gloss_20", "gloss_60", "gloss_85")] == [3.21, 21.43, 48.94]
    assert [float(row[name]) for name in "Lab"] == [45.21, 41.05, 27.21]
    assert float(row["slope_rms"]) == 0.2
    assert float(row["anisotropy"]) == 1.25
    assert str(row["verdict"].values) == "warn"
    assert int(row["warning_count"]) == 1
    assert str(row["basis"].values) == "surface + spectrum"


def test_every_number_of_a_row_has_units_and_words(full: Datasets) -> None:
    row = summarise(full)
    for name in row.data_vars:
        assert row[name].attrs["long_name"]
        assert row[name].dtype.kind == "U" or row[name].attrs["units"]


def test_the_page_shows_known_uncertainties_below_their_values(full: Datasets) -> None:
    row = _row(full, "abs-grain")
    gloss = float(row["gloss_60"][0])
    known = catalogue_page(row.assign(gloss_60_u=xr.full_like(row["gloss_60_u"], 1.3)), {})
    assert f"<td>{gloss:.1f}<small>± 1.3</small>" in known
    unknown = catalogue_page(row.assign(gloss_60_u=xr.full_like(row["gloss_60_u"], np.nan)), {})
    assert f"<td>{gloss:.1f}<td" in unknown


def test_a_quantity_on_request_is_a_column_where_a_scene_asks_for_it(full: Datasets) -> None:
    plain = summarise(full)
    assert "veiling_luminance" not in plain
    luminance = xr.DataArray(251.4, attrs={"units": "cd m-2", "long_name": "luminance"})
    parts = {f"veiling_luminance{part}": luminance for part in ("", "_sun", "_sky")}
    asked = summarise(full | {"appearance": full["appearance"].assign(parts)})
    both = combine([asked, plain.assign_coords(material=["other"])])
    assert both["veiling_luminance"].attrs["units"] == "cd m-2"
    assert np.array_equal(both["veiling_luminance"], [251.4, np.nan], equal_nan=True)
    assert "veiling_luminance" in catalogue_csv(both, {}).splitlines()[0].split(",")
    assert "Veiling luminance, cd/m²" in catalogue_page(both, {})


def test_the_page_of_a_scene_says_what_it_is_for_and_links_to_the_pages_that_exist(full: Datasets) -> None:
    row = _row(full, "abs-grain")
    of_scene = catalogue_page(
        row,
        {},
        pages=(),
        scene={"name": "gloss-sheet", "purpose": "Gloss <b>"},
        others=[("catalogue", "../../index.html")],
    )
    assert "<h1>BRDF catalogue: gloss-sheet</h1>" in of_scene
    assert "Gloss &lt;b&gt;" in of_scene
    assert '<a href="../../index.html">catalogue</a>' in of_scene
    assert "report.html" not in of_scene
    default = catalogue_page(row, {})
    assert "<h1>BRDF catalogue</h1>" in default
    assert "Other scenes" not in default
    assert 'href="abs-grain/report.html"' in default


def test_the_page_links_to_what_changed_where_there_is_a_page_of_it(full: Datasets) -> None:
    row = _row(full, "a")
    assert '<a href="../../changes.html">What changed' in catalogue_page(row, {}, changes="../../changes.html")
    assert "changes.html" not in catalogue_page(row, {})


def test_unknown_quantities_are_nan(full: Datasets) -> None:
    row = summarise({"index": full["index"]})
    assert all(np.isnan(row[quantity.name].values).all() for quantity in quantities())
    assert np.isnan(row["srgb"].values).all()
    assert row["verdict"].values.tolist() == [""]


def test_gloss_of_an_unknown_finish_is_nan(full: Datasets) -> None:
    row = summarise({stage: full[stage] for stage in ("spectrum", "appearance")})
    assert np.isnan([float(row[name][0]) for name in ("gloss_20", "gloss_60", "gloss_85", "haze")]).all()
    assert float(row["L"][0]) == 45.21


def test_combined_rows_are_sorted_by_name(full: Datasets) -> None:
    catalogue = combine([_row(full, name) for name in ("zinc", "ABS", "pp-10", "pp-2")])
    assert catalogue["material"].values.tolist() == ["ABS", "pp-10", "pp-2", "zinc"]


def test_values_stay_with_their_material(full: Datasets) -> None:
    second = {**full, "appearance": full["appearance"].assign(luminous_reflectance=0.5)}
    catalogue = combine(
        [_row({**full, "appearance": full["appearance"].assign(luminous_reflectance=0.25)}, "b"), _row(second, "a")]
    )
    assert catalogue["luminous_reflectance"].values.tolist() == [0.5, 0.25]


def test_combining_does_not_depend_on_the_order_or_the_grouping_of_rows(full: Datasets) -> None:
    a, b, c = (_row(full, name) for name in "abc")
    assert combine([c, a, b]).identical(combine([combine([b, a]), c]))


def test_no_rows_make_an_empty_catalogue_that_can_be_stored(tmp_path: Path) -> None:
    store.save_dataset(combine([]), tmp_path / "catalogue.nc", stage="catalogue", material="catalogue")
    empty = store.open_dataset(tmp_path / "catalogue.nc", "catalogue")
    assert empty.sizes["material"] == 0
    assert lock(empty) == "{}\n"
    assert _table(catalogue_csv(empty, {})) == []
    assert "The catalogue is empty" in catalogue_page(empty, {})


def test_a_stored_catalogue_gives_the_same_page_table_and_lock(full: Datasets, tmp_path: Path) -> None:
    catalogue = combine([_row(full, "a", "café"), _row({"index": full["index"]}, "b")])
    store.save_dataset(catalogue, tmp_path / "catalogue.nc", stage="catalogue", material="catalogue")
    again = store.open_dataset(tmp_path / "catalogue.nc", "catalogue")
    assert catalogue_page(again, FAILURES) == catalogue_page(catalogue, FAILURES)
    assert catalogue_csv(again, FAILURES) == catalogue_csv(catalogue, FAILURES)
    assert lock(again) == lock(catalogue)


def test_two_materials_of_one_name_are_refused(full: Datasets) -> None:
    with pytest.raises(VocabularyError, match="'a'"):
        combine([_row(full, "a"), _row(full, "a")])


def test_a_row_of_another_kind_is_refused(full: Datasets) -> None:
    with pytest.raises(VocabularyError, match="'facets'"):
        combine([full["facets"]])


def test_a_row_that_lacks_a_variable_is_refused(full: Datasets) -> None:
    with pytest.raises(VocabularyError, match="lacks 'haze'"):
        combine([_row(full, "a").drop_vars("haze")])


def test_the_page_links_each_material_and_counts_them(full: Datasets) -> None:
    html = catalogue_page(combine([_row(full, "a"), _row(full, "b b")]), {})
    assert 'href="a/report.html"' in html
    assert 'href="b%20b/report.html"' in html
    assert "2 materials built" in html


def test_failures_are_listed_before_the_table_with_stage_and_message(full: Datasets) -> None:
    html = catalogue_page(combine([_row(full, "a")]), FAILURES)
    assert "1 material could not be built" in html
    assert html.index("grain.txt: no unit") < html.index("<table")
    assert "<code>surface: unit</code>" in html


def test_the_policy_allows_the_one_script_by_its_hash_and_nothing_else(full: Datasets) -> None:
    html = catalogue_page(combine([_row(full, "a")]), FAILURES)
    scripts = re.findall(r"<script>(.*?)</script>", html, re.S)
    assert len(scripts) == 1
    digest = base64.b64encode(hashlib.sha256(scripts[0].encode()).digest()).decode()
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', html)
    assert policy is not None
    assert f"script-src 'sha256-{digest}'" in unescape(policy[1])
    assert "default-src 'none'" in policy[1]
    assert not re.search(r'(?:src|href)="(?:https?:)?//', html)


@pytest.mark.parametrize("place", ["name", "description", "failure"])
def test_text_of_users_never_becomes_markup_in_the_catalogue(full: Datasets, place: str) -> None:
    attack = '"><script>alert(1)</script><img src=x onerror=alert(2)>'
    row = _row(full, attack if place == "name" else "a", attack if place == "description" else "")
    failures = {attack: {"stage": attack, "message": attack}} if place == "failure" else {}
    html = catalogue_page(combine([row]), failures)
    assert html.count("<script>") == 1
    assert "<img" not in html


def test_hidden_characters_are_shown_in_the_catalogue(full: Datasets) -> None:
    hidden = "a\x00\x1b[2J\u202egpj.exe"
    html = catalogue_page(combine([_row(full, "a", hidden)]), {"b": {"stage": hidden, "message": hidden}})
    assert html.count(r"a\x00\x1b[2J\u202egpj.exe") == 3
    assert not set(html) & set("\x00\x1b\u202e")


def test_a_thousand_materials_make_a_small_page(full: Datasets) -> None:
    catalogue = combine([_row(full, "a", "Grained panel")]).isel(material=np.zeros(1000, dtype=int))
    catalogue = catalogue.assign_coords(material=[f"material-{k:04d}" for k in range(1000)])
    html = catalogue_page(catalogue, {})
    assert html.count("<tr>") == 1001
    # A row of the table: eight bytes a number, 60 for the verdict and the name, 100 for the colour and the description, below 450. What
    # compares it: 296 for three cuts of 37 angles in 16 bits, 30 for the colour and the route. The scripts and the style take 110 kB.
    assert len(html.encode()) < 110_000 + 776_000


def test_rows_are_valid_datasets_of_their_kind(full: Datasets) -> None:
    vocabulary.validate(summarise(full), "catalogue")
    vocabulary.validate(summarise({"index": full["index"]}), "catalogue")


def _silent(dataset: xr.Dataset) -> xr.Dataset:
    """The dataset without its warnings."""
    silent = dataset.copy()
    silent.attrs.pop("warnings", None)
    return silent


def _verdict(datasets: Datasets, **verdicts: str) -> Datasets:
    """The material with other verdicts, and without the warnings of its stages."""
    described = {name: {"verdict": verdict, "text": f"{name} found"} for name, verdict in verdicts.items()}
    checks = datasets["checks"].assign_attrs(verdicts=json.dumps(described))
    return {**{stage: _silent(dataset) for stage, dataset in datasets.items()}, "checks": checks}


def _names(html: str) -> list[str]:
    return re.findall(r'<a href="[^"]*/report.html">([^<]*)</a>', html)


def test_the_page_shows_the_worst_verdict_first_and_then_by_name(full: Datasets) -> None:
    passed, warned, failed = (_verdict(full, energy=verdict) for verdict in ("pass", "warn", "fail"))
    unchecked = {"index": full["index"]}
    rows = [
        _row(unchecked, "a"),
        _row(passed, "b-10"),
        _row(passed, "B-2"),
        _row(failed, "y"),
        _row(warned, "x"),
        _row(failed, "c"),
    ]
    html = catalogue_page(combine(rows), {})
    assert _names(html) == ["c", "y", "x", "B-2", "b-10", "a"]
    assert "Sorted by verdict, worst first" in html
    assert "2 pass, 1 warn, 2 fail, 1 unchecked" in html


def test_a_row_names_the_checks_behind_its_verdict(full: Datasets) -> None:
    row = _row(_verdict(full, energy="fail", closure="warn", positivity="fail"), "a")
    assert str(row["verdict_checks"].values[0]) == "energy, positivity"
    html = catalogue_page(combine([row]), {})
    assert (
        'title="energy: energy found; positivity: positivity found">fail</b><small>energy, positivity</small>' in html
    )


def test_a_material_that_passes_has_no_check_to_name(full: Datasets) -> None:
    row = _row(_verdict(full, energy="pass"), "a")
    assert row["verdict_checks"].values.tolist() == row["verdict_text"].values.tolist() == [""]


def test_a_material_with_a_warning_of_its_scan_does_not_pass(full: Datasets) -> None:
    """The checks find the BRDF of a scan that is hardly measured as sound as any."""
    passed = _verdict(full, energy="pass")
    with_warning = vocabulary.add_warning(
        passed["facets"], "one step of the heights: the shape is hardly measured; export more digits."
    )
    row = _row({**passed, "facets": with_warning}, "a")
    assert [str(row[name].values[0]) for name in ("verdict", "verdict_checks")] == ["warn", "facets"]
    assert "facets: one step of the heights" in str(row["verdict_text"].values[0])
    html = catalogue_page(combine([row]), {})
    assert "0 pass, 1 warn, 0 fail" in html
    assert 'hardly measured; export more digits">warn</b><small>facets</small>' in html
    assert _table(catalogue_csv(combine([row]), {}))[0]["verdict"] == "warn"


def test_a_warning_that_stages_pass_on_counts_where_it_arose(full: Datasets) -> None:
    passed = _verdict(full, energy="pass")
    with_warning = {stage: vocabulary.add_warning(passed[stage], "the same doubt") for stage in ("spectrum", "bsdf")}
    assert str(_row({**passed, **with_warning}, "a")["verdict_checks"].values[0]) == "spectrum"


def test_a_failed_check_is_worse_than_any_warning(full: Datasets) -> None:
    failed = _verdict(full, energy="fail")
    row = _row({**failed, "facets": vocabulary.add_warning(failed["facets"], "few facets")}, "a")
    assert [str(row[name].values[0]) for name in ("verdict", "verdict_checks")] == ["fail", "energy"]


@pytest.mark.parametrize("stage", ["lambert_gauss", "table", "preview"])
def test_warnings_of_by_products_do_not_change_the_verdict(full: Datasets, stage: str) -> None:
    passed = _verdict(full, energy="pass")
    by_product = vocabulary.add_warning(passed["lambert_gauss"] if stage == "lambert_gauss" else _picture(), "left out")
    row = _row({**passed, stage: by_product}, "a")
    assert str(row["verdict"].values[0]) == "pass"
    assert int(row["warning_count"][0]) == 1


def test_the_verdict_of_the_table_counts(full: Datasets) -> None:
    stated = json.dumps({"table": {"verdict": "fail", "text": "too coarse"}})
    row = _row({**full, "table": xr.Dataset(attrs={"verdicts": stated})}, "a")
    assert (str(row["verdict"].values[0]), str(row["verdict_checks"].values[0])) == ("fail", "table")


def _heads(html: str) -> list[str]:
    return re.findall(r'<th scope="col">([^<]*)</th>', html)


def test_only_columns_that_some_material_has_are_shown(full: Datasets) -> None:
    appearance = full["appearance"].isel(gloss_angle=[2]).assign(haze=np.nan)
    heads = _heads(catalogue_page(combine([_row({"appearance": appearance, "facets": full["facets"]}, "a")]), {}))
    assert heads == [
        *("Material", "Verdict", "Warnings", "Gloss 85°", "L*", "a*", "b*", "rms slope", "Anisotropy"),
        *("L* 45:0", "a* 45:0", "b* 45:0"),
    ]
    assert _heads(catalogue_page(combine([_row({"index": full["index"]}, "a")]), {})) == [
        "Material",
        "Verdict",
        "Warnings",
    ]


def _gloss(datasets: Datasets, *units: float) -> Datasets:
    """The material with other gloss units at 20, 60 and 85 degree."""
    appearance = datasets["appearance"].assign(gloss=("gloss_angle", list(units)), haze=units[1] - units[0])
    return {**datasets, "appearance": appearance}


def _metal(datasets: Datasets) -> Datasets:
    finish = datasets["facets"]
    return {
        **datasets,
        "bsdf": microfacet.build(
            finish, index=optics.refractive_index({"n": 2.9, "k": 3.1}), multiple_scattering="none"
        ),
    }


def test_haze_is_given_within_the_scope_of_its_standard_alone(full: Datasets) -> None:
    film, matt = _gloss(full, 80.5, 92.75, 95.0), full
    metal = _metal(_gloss(full, 1100.0, 200.0, 95.0))
    rows = [_row(film, "film"), _row(matt, "matt"), _row(metal, "metal")]
    assert [float(row["haze"][0]) for row in rows] == pytest.approx([12.25, np.nan, np.nan], nan_ok=True)
    assert [line["haze"] for line in _table(catalogue_csv(combine(rows), {}))] == ["12.25", "", ""]
    html = catalogue_page(combine(rows), {})
    assert "Haze D4039" in _heads(html)
    assert "<td>12.2<td>" in html  # 12.25 to the even digit
    assert "<td>18.2<td>" not in html
    assert '<td title="D4039 is for more than 70 gloss units at 60°. This surface has 21.4."><td>' in html
    assert '<td title="D4039 is for nonmetallic surfaces. This surface is a metal."><td>' in html
    assert "Haze D4039" not in _heads(catalogue_page(combine([rows[1], rows[2]]), {}))


@pytest.mark.parametrize("sixty", [69.99, 70.0])
def test_seventy_gloss_units_are_not_yet_high_gloss(full: Datasets, sixty: float) -> None:
    assert np.isnan(float(_row(_gloss(full, 50.0, sixty, 90.0), "a")["haze"][0]))


def test_haze_takes_both_angles(full: Datasets) -> None:
    appearance = full["appearance"].assign(gloss=("gloss_angle", [80.0, 92.0, 95.0])).isel(gloss_angle=[1, 2])
    row = _row({**full, "appearance": appearance}, "a")
    assert np.isnan(float(row["haze"][0]))
    assert "needs gloss at 20° and at 60°" in str(row["no_haze"].values[0])


def test_flakes_without_their_clear_coat_have_no_gloss_but_a_reason(full: Datasets) -> None:
    film = _gloss(full, 80.5, 92.75, 95.0)["appearance"]
    known = {
        "multiangle": xr.Dataset(coords={"geometry": list("abc")}),
        "bsdf": samples.beckmann_bsdf(0.2).assign_attrs(route="flake"),
    }
    row = _row({**known, "appearance": film.assign_attrs(no_gloss="No coat. Set `multiangle.model`.")}, "a")
    coated = _row({**known, "appearance": film}, "b")
    assert np.isnan([float(row[name][0]) for name in ("gloss_20", "gloss_60", "gloss_85", "haze")]).all()
    assert [float(coated[name][0]) for name in ("gloss_60", "haze")] == [92.75, 12.25]
    html = catalogue_page(combine([row, coated]), {})
    assert html.count('<td title="No coat. Set multiangle.model.">–') == 3
    assert html.count('<td title="No coat. Set multiangle.model."><td>') == 1


def _picture() -> xr.Dataset:
    """Noise: the worst that a compressor can meet."""
    pixels = np.random.default_rng(1).integers(0, 256, (256, 512, 3)).astype(np.uint8)
    attrs = {"illuminant": "D65", "light": "studio", "white_level": 0.75}
    picture = xr.Dataset({"picture": (("row", "column", "channel"), pixels)}, {"channel": list("RGB")}, attrs)
    return vocabulary.label(picture, "preview")


def test_a_material_with_a_preview_shows_it_and_another_its_colour(full: Datasets, tmp_path: Path) -> None:
    rows = [_row({**full, "preview": _picture()}, "a"), _row(full, "b")]
    html = catalogue_page(combine(rows), {})
    (source,) = re.findall(r'<img src="([^"]*)" alt="">', html)
    assert source.startswith("data:image/webp;base64,")
    assert html.count('<i style="background:#a8333b">') == 1
    store.save_dataset(combine(rows), tmp_path / "catalogue.nc", stage="catalogue", material="catalogue")
    assert catalogue_page(store.open_dataset(tmp_path / "catalogue.nc", "catalogue"), {}) == html


def test_a_picture_that_is_none_never_becomes_markup(full: Datasets) -> None:
    row = _row(full, "a")
    row["thumbnail"] = ("material", np.array(['"><script>alert(1)</script>']))
    assert catalogue_page(row, {}).count("<script>") == 1


def test_a_thousand_pictured_materials_make_a_page_of_one_or_two_megabytes(full: Datasets) -> None:
    shown = preview(samples.beckmann_bsdf(0.02))
    catalogue = combine([_row({**full, "preview": shown}, "a", "Grained panel")]).isel(
        material=np.zeros(1000, dtype=int)
    )
    catalogue = catalogue.assign_coords(material=[f"material-{k:04d}" for k in range(1000)])
    assert len(catalogue_page(catalogue, {}).encode()) < 2_000_000


def test_failures_have_their_columns(full: Datasets) -> None:
    html = catalogue_page(
        combine([_row(full, "a")]), {"b": {"stage": "surface", "message": "m"}, "c": {"message": "n"}}
    )
    assert html.count('<span class="stage-name">') == 2
