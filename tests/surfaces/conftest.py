"""Surfaces whose heights are known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from brdfpipe.surfaces.heights import Heights, surface_dataset


@pytest.fixture
def asymmetric() -> xr.Dataset:
    """A map that equals none of its mirror images or its transpose, with unequal sides and pitches, and one gap."""
    x, y = np.arange(50) * 0.5, np.arange(40)[:, None] * 0.7
    height = 0.5 * np.sin(x / 3) + 0.2 * np.cos(y / 2) + 0.01 * x * y / 10 + 0.001 * y**2
    height[3, 7] = np.nan
    return surface_dataset(Heights(height, 0.5, 0.7))


@pytest.fixture
def line() -> xr.Dataset:
    """A profile of 200 heights at 0.25 um."""
    x = np.arange(200) * 0.25
    return surface_dataset(Heights(0.3 * np.sin(x / 2) + 0.05 * np.cos(3 * x) + 1, 0.25))
