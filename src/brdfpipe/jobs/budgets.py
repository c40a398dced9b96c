"""Which materials cost more than the budget of their scene: time of their jobs, size of their results."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from pathlib import Path

from brdfpipe.catalogue.catalogue import Catalogue


def exceeded(results: Path, catalogue: Catalogue, names: Iterable[str]) -> Iterator[str]:
    """A sentence for each material that exceeds the budget of its scene.

    The time is that of the last run of each job, by the clock; both include what the scene shares with others.
    """
    for name in names:
        scene = catalogue.scene_of(name)
        budget = scene.content.get("budget", {})
        places = list(dict.fromkeys(["", scene.folder])) if budget else []
        if "seconds" in budget:
            records = [path for place in places for path in (results / "logs" / place / name).glob("*.json")]
            seconds = sum(json.loads(path.read_text(encoding="utf-8"))["wall_s"] for path in records)
            if seconds > budget["seconds"]:
                yield f"{name}: took {seconds:.1f} s; the budget of the scene {scene.name} is {budget['seconds']:g} s"
        if "bytes" in budget:
            files = [path for place in places for path in (results / place / name).rglob("*") if path.is_file()]
            size = sum(path.stat().st_size for path in files)
            if size > budget["bytes"]:
                yield f"{name}: takes {size} bytes; the budget of the scene {scene.name} is {budget['bytes']}"
