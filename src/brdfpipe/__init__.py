"""brdfpipe: trustworthy BRDFs for a catalogue of plastics, paints and films, from what a laboratory has.

Submodules load when they are first used, so that ``import brdfpipe`` costs nothing and a stage depends on what it needs alone.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import os

    import xarray as xr

_SUBMODULES = (
    "appearance",
    "bsdf",
    "catalogue",
    "exchange",
    "facets",
    "flakes",
    "geometry",
    "hemisphere",
    "masking",
    "optics",
    "raycast",
    "report",
    "rig",
    "routes",
    "spectra",
    "store",
    "surfaces",
    "vocabulary",
)

__all__ = ["flake", "microfacet", "open_dataset", "save_dataset", *_SUBMODULES]


def open_dataset(path: str | os.PathLike[str], kind: str | None = None) -> xr.Dataset:
    """Read a stored dataset; a ``bsdf`` dataset answers to ``.bsdf``. See :func:`brdfpipe.store.open_dataset`."""
    importlib.import_module("brdfpipe.bsdf")
    return importlib.import_module("brdfpipe.store").open_dataset(path, kind)


def __getattr__(name: str) -> Any:
    if name in _SUBMODULES:
        return importlib.import_module(f"brdfpipe.{name}")
    if name == "save_dataset":
        return importlib.import_module("brdfpipe.store").save_dataset
    if name in ("flake", "microfacet"):
        return importlib.import_module(f"brdfpipe.bsdf.{name}")
    raise AttributeError(f"module 'brdfpipe' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
