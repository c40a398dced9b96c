"""Spectrum over both frequencies, of a surface with a lay: on axes that are finest at zero."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe.geometry import Array
from brdfpipe.psd.periodograms import Periodogram, Rings, Scan
from brdfpipe.psd.spectrum_dataset import rms_height

_NODES = 65


def planar_spectrum(levels: Sequence[Periodogram], spectrum: Rings, noise: float, scan: Scan) -> xr.Dataset:
    """``psd_planar(frequency_y, frequency_x)`` without ``noise`` [um4]: the means of the modes nearest to each node.

    Between the modes of long waves a node has the value of the nearest one, and so it has below the band; beyond the band it has 0. The
    values are scaled so that their integral is that of ``spectrum``.
    """
    low, high = float(spectrum.frequency[0]), float(spectrum.frequency[-1])
    axes = [_axis(low, 0.5 / pitch) for pitch in scan.pitch]
    total, count = np.zeros((2, _NODES, _NODES))
    beyond = np.inf
    for level in levels:
        radius = level.radius
        row, column = np.nonzero((radius >= level.low) & (radius < beyond))
        beyond = min(beyond, level.low)
        values = level.spectra.mean(axis=0)[row, column]
        # A real transform has one half of the plane: each mode has a twin.
        for sign in (1, -1):
            nodes = tuple(
                _nearest(sign * frequency[index], axis)
                for frequency, index, axis in zip(level.axes, (row, column), axes, strict=True)
            )
            np.add.at(total, nodes, values)
            np.add.at(count, nodes, 1.0)
    density = _filled(total / np.maximum(count, 1.0), count > 0) - noise
    fy, fx = axes
    density = np.where(np.hypot(fx, fy[:, None]) <= high * (1 + 1e-9), np.maximum(density, 0.0), 0.0)
    integral = float(np.gradient(fy) @ density @ np.gradient(fx))
    density *= rms_height(spectrum)[0] ** 2 / integral if integral else 1.0
    return xr.Dataset(
        {"psd_planar": (("frequency_y", "frequency_x"), density)}, coords={"frequency_y": fy, "frequency_x": fx}
    )


def slope_ratio(planar: xr.Dataset) -> float:
    """Larger over smaller principal rms slope of a spectrum over both frequencies; infinite where one vanishes."""
    fy, fx = planar["frequency_y"].values, planar["frequency_x"].values
    weight = planar["psd_planar"].values * np.gradient(fy)[:, None] * np.gradient(fx)
    xx, yy, xy = (weight * fx**2).sum(), (weight * fy[:, None] ** 2).sum(), (weight * fx * fy[:, None]).sum()
    smaller, larger = np.linalg.eigvalsh([[xx, xy], [xy, yy]])
    return float(np.sqrt(larger / smaller)) if smaller > 0 else float("inf")


def _axis(low: float, high: float) -> Array:
    nodes = low * np.sinh(np.linspace(0, np.arcsinh(high / low), _NODES // 2 + 1))
    return np.concatenate([-nodes[:0:-1], nodes])


def _nearest(frequency: Array, axis: Array) -> NDArray[np.intp]:
    return np.asarray(np.searchsorted((axis[1:] + axis[:-1]) / 2, frequency))


def _filled(values: Array, present: NDArray[np.bool_]) -> Array:
    from scipy.ndimage import distance_transform_edt

    nearest = distance_transform_edt(~present, return_distances=False, return_indices=True)
    return np.asarray(values[tuple(nearest)])
