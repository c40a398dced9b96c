"""Reading the datasets of a material for its page and for its row in the catalogue."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import xarray as xr

from brdfpipe import store
from brdfpipe.bsdf.change_variables import DIMENSION


@contextmanager
def opened(
    files: Mapping[str, str | Sequence[str]], *, evaluated: Sequence[str] = ()
) -> Iterator[dict[str, xr.Dataset]]:
    """The datasets of a material by stage, whose variables are read when they are used, inside the block.

    Parameters
    ----------
    files : stage → its dataset, or several, which are then named as their files
    evaluated : names of BSDFs that are evaluated. They are read at once, without the changes by uncertain inputs, which are large; other stages
        have computed the uncertainties that a page shows

    Raises
    ------
    StoreError : a file is missing or damaged.
    """
    with store.opened(_by_stage(files)) as datasets:
        for name in set(evaluated) & set(datasets):
            datasets[name] = datasets[name].drop_dims(DIMENSION, errors="ignore").load()
        yield datasets


def relative(files: Mapping[str, str | Sequence[str]], *, to: str) -> dict[str, str]:
    """The same files by stage, in relation to the folder of a page, as links of it have them."""
    folder = Path(to).parent
    return {stage: Path(os.path.relpath(path, folder)).as_posix() for stage, path in _by_stage(files).items()}


def _by_stage(files: Mapping[str, str | Sequence[str]]) -> dict[str, str]:
    paths: dict[str, str] = {}
    for stage, given in files.items():
        paths |= {stage: given} if isinstance(given, str) else {Path(path).stem: path for path in given}
    return paths
