"""Files that Radiance has loaded. Its library crashes when one is freed, so all are kept to the end."""

from __future__ import annotations

from pathlib import Path
from typing import Any

_KEPT: list[Any] = []


def load(radiance: Any, path: Path) -> Any:
    """A BSDF, by the module ``pyradiance.bsdf``."""
    _KEPT.append(radiance.load_file(str(path)))
    return _KEPT[-1]
