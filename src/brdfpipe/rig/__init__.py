"""The camera rig: its devices, the scan, an emulator, and the way from frames to a BSDF.

Names load when they are first used: who drives a monochromator does not wait for what smooths a BSDF.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

_HOMES = {
    "Certificate": "calibration",
    "Plan": "plan",
    "Rig": "description",
    "apply": "calibration",
    "calibrate": "calibration",
    "complete": "completion",
    "read_run": "frames",
    "reduce": "reduction",
    "smooth": "smoothing",
}

__all__ = [*_HOMES]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
