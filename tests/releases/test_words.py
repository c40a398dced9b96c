"""Differences in words."""

from __future__ import annotations

import json

from brdfpipe.releases.causes import Cause
from brdfpipe.releases.differences import Difference
from brdfpipe.releases.words import lines, plain

CHANGED = Difference(
    "black",
    "",
    "changed",
    colour=1.234,
    brdf={"rms": 0.0213, "percentile_95": 0.05, "albedo": 0.001},
    quantities={"gloss_60": (21.43, 23.1), "haze": (None, 0.5), "L": (50.0, 51.0)},
    verdict=("pass", "warn"),
    causes=(Cause("key", "surface", 'form: "plane" → "none"'),),
)


def test_a_material_has_one_line_and_its_causes_below() -> None:
    text = lines([CHANGED, Difference("grey", "", "unchanged"), Difference("new", "", "added", built=(False, True))])
    assert text == [
        "catalogue: 1 changed, 1 added, 0 removed, 1 unchanged",
        "  black: ΔE00 1.23; gloss_60 21.4 → 23.1; BRDF 2.13% rms, 5.00% at the 95th percentile; verdict pass → warn; haze none → 0.5",
        '    key (surface): form: "plane" → "none"',
        "  new: added",
    ]


def test_differences_below_the_digits_of_the_table_are_left_to_the_json() -> None:
    noise = Difference(
        "black",
        "",
        "changed",
        colour=1e-6,
        brdf={"rms": 1e-7, "percentile_95": 2e-7, "albedo": 1e-7},
        quantities={"gloss_60": (21.4300001, 21.43), "gloss_60_u": (0.123, 0.1231), "L": (50.0, 50.0000001)},
    )
    assert lines([noise])[1] == "  black: nothing differs within the digits of the table"
    assert plain([noise])[0]["colour"] == 1e-6


def test_a_change_of_sign_below_the_digits_is_no_difference() -> None:
    noise = Difference("black", "", "changed", quantities={"haze": (-0.01, 0.01)})
    assert lines([noise])[1] == "  black: nothing differs within the digits of the table"


def test_a_change_of_a_lobe_that_few_directions_see_is_named() -> None:
    narrow = Difference("black", "", "changed", brdf={"rms": 0.08, "percentile_95": 0.0, "albedo": 0.0})
    assert lines([narrow])[1] == "  black: BRDF 8.00% rms, 0.00% at the 95th percentile"


def test_the_first_further_quantities_are_named_and_the_others_counted() -> None:
    names = ("haze", "gloss_60_u", "warning_count", "another", "one more")
    many = Difference("black", "", "changed", quantities=dict.fromkeys(names, (1.0, 2.0)))
    assert lines([many])[1].endswith("warning_count 1 → 2; 2 further quantities differ")


def test_a_material_that_fails_now_says_why() -> None:
    broken = Difference("black", "gloss-sheet", "changed", built=(True, False), failure="surface: no unit")
    assert lines([broken])[1] == "  black: not built any more: surface: no unit"


def test_plain_values_are_json_without_unchanged_materials() -> None:
    (entry,) = json.loads(json.dumps(plain([CHANGED, Difference("grey", "", "unchanged")])))
    assert entry["quantities"]["gloss_60"] == [21.43, 23.1]
    assert entry["causes"][0]["kind"] == "key"


def test_a_new_material_that_fails_says_why() -> None:
    broken = Difference("black", "", "added", built=(False, False), failure="surface: no unit")
    assert lines([broken])[1] == "  black: added, not built: surface: no unit"
