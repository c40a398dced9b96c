"""Reasons for a change, where each can be told from the others."""

from __future__ import annotations

from typing import Any

import pytest

from brdfpipe.releases.causes import Cause, causes
from brdfpipe.releases.provenance import Provenance

SURFACE, FACETS = "5" * 64, "f" * 64


def chain(**changes: Any) -> dict[str, Provenance]:
    """A surface read from a file, and its facets."""
    version = changes.get("numpy", "2.4.0")
    return {
        "surface": Provenance(
            changes.get("surface", SURFACE),
            {"raw": changes.get("raw", "a" * 64)},
            {"form": changes.get("form", "plane")},
            {"numpy": version},
        ),
        "facets": Provenance(
            changes.get("facets", FACETS), {"surface": changes.get("surface", SURFACE)}, {}, {"numpy": version}
        ),
    }


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, []),
        ({"raw": "b" * 64, "surface": "6" * 64, "facets": "e" * 64}, [("input", "surface", "raw: another file")]),
        ({"form": "none", "surface": "6" * 64}, [("key", "surface", 'form: "plane" → "none"')]),
        ({"numpy": "2.5.0", "facets": "e" * 64}, [("software", "facets", "numpy 2.4.0 → 2.5.0")]),
        ({"facets": "e" * 64}, [("code", "facets", "the code of the stage, or of a library of the same version")]),
        ({"numpy": "2.5.0"}, []),
        # What follows from a changed result is no cause of its own, whatever the software.
        (
            {"raw": "b" * 64, "surface": "6" * 64, "facets": "e" * 64, "numpy": "2.5.0"},
            [("input", "surface", "raw: another file")],
        ),
    ],
)
def test_each_cause_is_named_where_it_enters(changes: dict[str, Any], expected: list[tuple[str, str, str]]) -> None:
    assert causes(chain(), chain(**changes)) == [Cause(*cause) for cause in expected]  # type: ignore[arg-type]


def test_a_file_that_comes_back_under_another_name_of_a_result_is_no_input() -> None:
    old, new = chain(), chain(surface="6" * 64, facets="e" * 64)
    assert [cause.stage for cause in causes(old, new)] == ["surface"]


def test_other_stages_are_a_cause_of_their_own() -> None:
    new = {**chain(), "wave": Provenance("3" * 64, {}, {}, {})}
    assert causes(chain(), new) == [Cause("model", "", "stages: with wave")]


def test_long_values_are_shortened() -> None:
    (cause,) = causes(chain(), chain(form="x" * 500, surface="6" * 64))
    assert len(cause.text) < 150
    assert cause.text.endswith("…")
