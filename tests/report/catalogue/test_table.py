from __future__ import annotations

import json

import numpy as np
import pytest
from catalogue_rows import FAILURES, Datasets
from catalogue_rows import row as _row
from catalogue_rows import table as _table

from brdfpipe.appearance.quantities import quantities
from brdfpipe.report import catalogue_csv, combine, lock


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


def test_no_column_of_text_becomes_a_formula(full: Datasets) -> None:
    row = _row(full, "a")
    text = {
        name: value.copy(data=np.full(value.shape, "=1+1")) for name, value in row.items() if value.dtype.kind in "UO"
    }
    (line,) = _table(catalogue_csv(combine([row]).assign(text), {}))
    assert not [name for name, cell in line.items() if cell.startswith("=")]
    assert "'=1+1" in line.values()


def test_negative_numbers_stay_numbers(full: Datasets) -> None:
    green = {**full, "appearance": full["appearance"].assign(lab=-full["appearance"]["lab"])}
    assert float(_table(catalogue_csv(combine([_row(green, "a")]), {}))[0]["a"]) == -41.05


def test_the_lock_lists_the_digest_of_every_stage(full: Datasets) -> None:
    locked = json.loads(lock(combine([_row(full, "b"), _row({"index": full["index"]}, "a")])))
    assert locked["b"] == {stage: dataset.attrs["digest"] for stage, dataset in full.items()}
    assert list(locked["a"]) == ["index"]


def test_rounding_errors_of_zero_are_zero_in_the_table(full: Datasets) -> None:
    lab = full["appearance"]["lab"].copy(data=[[50.0, 5.55112e-14, -3e-15], [50.0, 0.0, 0.0]])
    line = _table(catalogue_csv(combine([_row({**full, "appearance": full["appearance"].assign(lab=lab)}, "a")]), {}))[
        0
    ]
    assert [line[name] for name in "Lab"] == ["50", "0", "0"]


def test_newer_columns_stand_behind_the_older_ones(full: Datasets) -> None:
    (header, *_) = catalogue_csv(combine([_row(full, "a")]), {}).splitlines()
    names = header.split(",")
    older = names[: names.index("message") + 1]
    assert older[:8] == [
        "material",
        "status",
        "route",
        "basis",
        "verdict",
        "verdict_checks",
        "verdict_text",
        "warnings",
    ]
    assert older[-5:] == ["uncertainty_not_stated", "srgb", "description", "stage", "message"]
    newer = {column for one in quantities() if one.appended for column in (one.name, one.u_name) if column}
    assert newer
    assert newer | {"refused_exports"} == set(names[len(older) :])
