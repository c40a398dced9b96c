from __future__ import annotations

import base64
import csv
import hashlib
import io
import json
import re
from html import unescape
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from brdfpipe import store, vocabulary
from brdfpipe.errors import VocabularyError
from brdfpipe.report import catalogue_csv, catalogue_page, combine, lock, summarise
from brdfpipe.report.catalogue import NUMBERS

Datasets = dict[str, xr.Dataset]

FAILURES = {"broken": {"stage": "surface", "message": "grain.txt: no unit; set `surface: unit` in material.yaml"}}


def _renamed(datasets: Datasets, name: str) -> Datasets:
    return {stage: dataset.assign_attrs(material=name) for stage, dataset in datasets.items()}


def _row(datasets: Datasets, name: str, description: str = "") -> xr.Dataset:
    return summarise(_renamed(datasets, name), description=description)


def _table(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text)))


def test_a_row_holds_the_numbers_people_search_by(full: Datasets) -> None:
    row = summarise(full).isel(material=0)
    assert str(row["material"].values) == "abs-grain"
    assert [float(row[name]) for name in ("gloss_20", "gloss_60", "gloss_85", "haze")] == [3.21, 21.43, 48.94, 18.22]
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


def test_what_is_not_known_is_nan(full: Datasets) -> None:
    row = summarise({"index": full["index"]})
    assert all(np.isnan(row[name].values).all() for name in NUMBERS)
    assert np.isnan(row["srgb"].values).all()
    assert row["verdict"].values.tolist() == [""]


def test_gloss_of_a_finish_nobody_measured_is_not_known(full: Datasets) -> None:
    row = summarise({stage: full[stage] for stage in ("spectrum", "appearance")})
    assert np.isnan([float(row[name][0]) for name in ("gloss_20", "gloss_60", "gloss_85", "haze")]).all()
    assert float(row["L"][0]) == 45.21


def test_combined_rows_are_sorted_by_name(full: Datasets) -> None:
    catalogue = combine([_row(full, name) for name in ("zinc", "ABS", "pp-10", "pp-2")])
    assert catalogue["material"].values.tolist() == ["ABS", "pp-10", "pp-2", "zinc"]


def test_values_stay_with_their_material(full: Datasets) -> None:
    second = {**full, "appearance": full["appearance"].assign(haze=99.0)}
    catalogue = combine([_row(full, "b"), _row(second, "a")])
    assert catalogue["haze"].values.tolist() == [99.0, 18.22]


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


def test_the_table_lists_built_and_failed_materials_by_name(full: Datasets) -> None:
    table = _table(catalogue_csv(combine([_row(full, "a"), _row(full, "z")]), FAILURES))
    assert [(line["material"], line["status"]) for line in table] == [
        ("a", "built"),
        ("broken", "failed"),
        ("z", "built"),
    ]
    assert table[1]["message"].startswith("grain.txt: no unit")
    assert (table[0]["gloss_60"], table[0]["warnings"], table[0]["srgb"]) == ("21.43", "1", "#a8333b")
    assert table[1]["gloss_60"] == table[1]["warnings"] == ""


@pytest.mark.parametrize("text", ["=1+1", "+cmd|' /C calc'!A0", "-2+3", "@SUM(A1)", "\t=1", "\r=1", " =1", "\n=1"])
def test_no_text_of_a_user_becomes_a_formula(full: Datasets, text: str) -> None:
    table = _table(catalogue_csv(combine([_row(full, "a", text)]), {text: {"stage": text, "message": text}}))
    cells = [
        cell for line in table for name, cell in line.items() if name in ("material", "description", "stage", "message")
    ]
    assert sum(cell == "'" + text.strip() for cell in cells) == 4


def test_negative_numbers_stay_numbers(full: Datasets) -> None:
    green = {**full, "appearance": full["appearance"].assign(lab=-full["appearance"]["lab"])}
    assert float(_table(catalogue_csv(combine([_row(green, "a")]), {}))[0]["a"]) == -41.05


def test_the_lock_lists_the_digest_of_every_stage(full: Datasets) -> None:
    locked = json.loads(lock(combine([_row(full, "b"), _row({"index": full["index"]}, "a")])))
    assert locked["b"] == {stage: dataset.attrs["digest"] for stage, dataset in full.items()}
    assert list(locked["a"]) == ["index"]


def test_the_page_links_each_material_and_counts_them(full: Datasets) -> None:
    html = catalogue_page(combine([_row(full, "a"), _row(full, "b b")]), {})
    assert 'href="a/report.html"' in html
    assert 'href="b%20b/report.html"' in html
    assert "2 materials built" in html


def test_failures_stand_before_the_table_with_stage_and_message(full: Datasets) -> None:
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
def test_what_users_wrote_never_becomes_markup_in_the_catalogue(full: Datasets, place: str) -> None:
    attack = '"><script>alert(1)</script><img src=x onerror=alert(2)>'
    row = _row(full, attack if place == "name" else "a", attack if place == "description" else "")
    failures = {attack: {"stage": attack, "message": attack}} if place == "failure" else {}
    html = catalogue_page(combine([row]), failures)
    assert html.count("<script>") == 1
    assert "<img" not in html


def test_a_thousand_materials_make_a_light_page(full: Datasets) -> None:
    catalogue = combine([_row(full, "a", "Grained panel")]).isel(material=np.zeros(1000, dtype=int))
    catalogue = catalogue.assign_coords(material=[f"material-{k:04d}" for k in range(1000)])
    html = catalogue_page(catalogue, {})
    assert html.count("<tr>") == 1001
    assert len(html.encode()) < 400_000


def test_rows_are_valid_datasets_of_their_kind(full: Datasets) -> None:
    vocabulary.validate(summarise(full), "catalogue")
    vocabulary.validate(summarise({"index": full["index"]}), "catalogue")


def _verdict(datasets: Datasets, **verdicts: str) -> Datasets:
    told = {name: {"verdict": verdict, "text": f"{name} found"} for name, verdict in verdicts.items()}
    return {**datasets, "checks": datasets["checks"].assign_attrs(verdicts=json.dumps(told))}


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
    assert "Worst first" in html
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


def test_the_verdict_of_the_table_counts(full: Datasets) -> None:
    told = json.dumps({"table": {"verdict": "fail", "text": "too coarse"}})
    row = _row({**full, "table": xr.Dataset(attrs={"verdicts": told})}, "a")
    assert (str(row["verdict"].values[0]), str(row["verdict_checks"].values[0])) == ("fail", "table")


def _heads(html: str) -> list[str]:
    return re.findall(r'<th scope="col">([^<]*)</th>', html)


def test_only_columns_that_some_material_has_are_shown(full: Datasets) -> None:
    appearance = full["appearance"].isel(gloss_angle=[2]).assign(haze=np.nan)
    heads = _heads(catalogue_page(combine([_row({"appearance": appearance, "facets": full["facets"]}, "a")]), {}))
    assert heads == ["Material", "Gloss 85°", "L*", "a*", "b*", "rms slope", "Anisotropy", "Verdict", "Warnings"]
    assert _heads(catalogue_page(combine([_row({"index": full["index"]}, "a")]), {})) == [
        "Material",
        "Verdict",
        "Warnings",
    ]


def test_haze_is_shown_for_high_gloss_alone(full: Datasets) -> None:
    appearance = full["appearance"].assign(gloss=("gloss_angle", [80.5, 92.75, 95.0]), haze=12.25)
    glossy, matt = _row({**full, "appearance": appearance}, "glossy"), _row(full, "matt")
    assert "Haze" not in _heads(catalogue_page(combine([matt]), {}))
    html = catalogue_page(combine([glossy, matt]), {})
    assert "Haze" in _heads(html)
    assert "<td>12.2<td>" in html  # 12.25 to the even digit
    assert "<td>18.2<td>" not in html


def test_what_rounding_leaves_of_zero_is_zero_in_the_table(full: Datasets) -> None:
    lab = full["appearance"]["lab"].copy(data=[[50.0, 5.55112e-14, -3e-15], [50.0, 0.0, 0.0]])
    line = _table(catalogue_csv(combine([_row({**full, "appearance": full["appearance"].assign(lab=lab)}, "a")]), {}))[
        0
    ]
    assert [line[name] for name in "Lab"] == ["50", "0", "0"]


def test_failures_stand_in_columns(full: Datasets) -> None:
    html = catalogue_page(
        combine([_row(full, "a")]), {"b": {"stage": "surface", "message": "m"}, "c": {"message": "n"}}
    )
    assert html.count('<span class="stage-name">') == 2
