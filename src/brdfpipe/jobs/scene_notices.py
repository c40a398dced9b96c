"""What a scene asks for and does not get, in a sentence each."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from brdfpipe.scenes.scene import Scene, shipped_scenes
from brdfpipe.scenes.scene_keys import CHEAPEST, METRIC_UNITS, METRICS_OF_DOMAINS
from brdfpipe.stages import EVERYWHERE, geometries_in

_WITHOUT_GEOMETRIES = {
    "haze": "`haze` has no result: no haze window of the configuration has its mirror direction in the domain",
    "colour": "`colour` has the total reflectance alone: the domain lists no pair of directions, and holds none of the configuration",
}


def scene_notices(scenes: Iterable[Scene], config: Mapping[str, Any]) -> Iterator[str]:
    """Results without a geometry in the domain of the scene that asks for them, and tolerances that are not checked.

    Parameters
    ----------
    scenes : shipped ones have no notices of their tolerance
    config : the configuration, with the angles and geometries of instruments
    """
    known = geometries_in(EVERYWHERE, config)
    for scene in scenes:
        for part, found in geometries_in(scene.domain, config).items():
            # A catalogue with a scene that asks for gloss without an angle is refused.
            if part in _WITHOUT_GEOMETRIES and scene.asks(part) and known[part] and not found:
                yield f"scene {scene.name}: {_WITHOUT_GEOMETRIES[part]}; add directions to `domain`, or leave the result out"
        if scene.name not in shipped_scenes() and (reason := _why_not_checked(scene)):
            content = scene.content
            tolerance = f"{content['tolerance']:g} {METRIC_UNITS[content['metric']]}".strip()
            yield f"scene {scene.name}: the tolerance, {tolerance}, is not checked, and every material has the fullest model: {reason}"


def _why_not_checked(scene: Scene) -> str:
    """Empty for a scene that plans, or asks for the fullest model itself."""
    content = scene.content
    if content["model"] != CHEAPEST or scene.plans:
        return ""
    if not scene.accepts_cheapest:
        named = [f"`{name}`" for name in ("uncertainty", "model_error", "comparison") if scene.asks(name)]
        return f"the scene asks for {' and '.join(named)} of that model"
    same = (
        "metric, bands, polarisation and domain"
        if content["metric"] in METRICS_OF_DOMAINS
        else "metric, bands and polarisation"
    )
    return f"errors were measured for no scene of the same {same}"
