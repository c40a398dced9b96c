"""Files other programs read: one module a format, one registry."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path

import xarray as xr

from brdfpipe.exchange import astm
from brdfpipe.exchange.astm import ExchangeError

WRITERS: Mapping[str, Callable[[xr.Dataset, str | os.PathLike[str]], None]] = {"astm": astm.write}
"""Formats by name; a file's extension is a format's name."""


def write(bsdf: xr.Dataset, path: str | os.PathLike[str], format: str | None = None) -> None:
    """Write a BSDF for another program.

    Parameters
    ----------
    bsdf : kind ``bsdf``; ``astm`` takes a non-spectral ``table`` (see ``bsdf.nonspectral()`` and ``bsdf.tabulate(grid)``)
    path : the file; it appears whole or not at all
    format : ``astm``; by default what the extension says

    Raises
    ------
    ExchangeError : the format is unknown, or does not take such a BSDF.
    """
    name = format or Path(path).suffix.removeprefix(".")
    if name not in WRITERS:
        raise ExchangeError(f"{Path(path).name}: unknown format {name!r}; accepted: {', '.join(WRITERS)}")
    WRITERS[name](bsdf, path)
