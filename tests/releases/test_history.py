"""Numbers of a material over releases."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import xarray as xr

from brdfpipe.releases.differences import read_releases
from brdfpipe.releases.history import histories


def test_each_material_has_its_numbers_and_gaps(
    release: Callable[..., Path], plastic: Callable[..., dict[str, xr.Dataset]]
) -> None:
    first = release("first", {"black": plastic()})
    second = release("second", {"black": plastic(), "grey": plastic("grey")})
    found = histories([read_releases(folder) for folder in (first, second, first)])
    assert set(found) == {("", "black"), ("", "grey")}
    assert found["", "black"].gloss_60.shape == (3,)
    # These results have no appearance, so neither gloss nor colour is known.
    assert np.isnan(found["", "grey"].gloss_60).all()
    assert np.isnan(found["", "black"].colour).all()


def test_colours_are_compared_with_the_first_that_is_known() -> None:
    from brdfpipe.releases.history import _history

    series = np.array([[5.0, np.nan, np.nan, np.nan], [6.0, 50, 0, 0], [7.0, 51, 0, 0], [8.0, 50, 0, 0]])
    found = _history(series)
    assert list(found.gloss_60) == [5, 6, 7, 8]
    assert np.isnan(found.colour[0])
    assert found.colour[1] == found.colour[3] == 0
    assert 0.9 < found.colour[2] < 1.1  # at L* = 50 a step of lightness weighs 1
