"""A scene that does not get what it asks for says so."""

from __future__ import annotations

import re
from typing import Any

import pytest

from brdfpipe.catalogue.configuration import load_config
from brdfpipe.jobs.scene_notices import scene_notices
from brdfpipe.scenes.scene import Scene, load_scene, shipped_scenes

MINE: dict[str, Any] = {**load_scene("gloss-sheet").content, "results": ["gloss", "haze", "colour"]}
"""The domain of ``gloss-sheet`` holds the mirror directions of gloss meters, and no geometry of colour."""
AT_45 = {"geometries": [{"theta_i": 45.0, "phi_i": 0.0, "theta_o": 0.0, "phi_o": 180.0}], "side": "reflection"}


def notices(**keys: object) -> list[str]:
    return list(scene_notices([Scene("mine", MINE | keys)], load_config()))


def test_a_shipped_scene_gets_what_it_asks_for() -> None:
    assert list(scene_notices(map(load_scene, shipped_scenes()), load_config())) == []


def test_results_without_a_geometry_in_the_domain_are_named() -> None:
    (colour,) = notices()
    assert colour.startswith("scene mine: `colour` has the total reflectance alone")
    (haze,) = notices(domain=AT_45)
    assert haze.startswith("scene mine: `haze` has no result")
    assert notices(domain=AT_45, results=["colour", "preview"]) == []
    config = load_config()
    without_haze = config | {"appearance": config["appearance"] | {"haze": []}}
    mine = Scene("mine", MINE | {"domain": AT_45, "results": ["haze"]})
    assert list(scene_notices([mine], without_haze)) == [], "the configuration asks for none"


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        (
            {"metric": "colour"},
            "1 ΔE00, is not checked, .* no scene of the same metric, bands, polarisation and domain",
        ),
        ({"bands": "rgb"}, "1 GU, is not checked, .* no scene of the same metric, bands and polarisation"),
        ({"results": ["gloss", "uncertainty"]}, "the scene asks for `uncertainty` of that model"),
    ],
)
def test_a_tolerance_that_is_not_checked_is_named_with_the_reason(keys: dict[str, Any], words: str) -> None:
    (notice,) = notices(**{"results": ["gloss"]} | keys)
    assert re.search(words, notice)
    assert notices(**{"results": ["gloss"]} | keys, model="fullest") == []
