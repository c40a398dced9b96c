"""Light of a BSDF in the bins of traced rays: of the half vector's slope, at one angle of incidence.

A model that is integrated over the bins in which rays are counted is compared with the rays themselves, and not with a table made from them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import hemisphere
from brdfpipe.appearance import apertures
from brdfpipe.appearance.apertures import Beam, Rule
from brdfpipe.appearance.gloss_meter import RECEPTOR
from brdfpipe.bsdf.base import Representation
from brdfpipe.bsdf.registry import representation
from brdfpipe.geometry import Array, angles_of, half_vector, slope_towards
from brdfpipe.references.tracer import SlopeBins

_POINTS = 3  # along each axis of a bin
_APERTURES = Rule((2, 3), 4)
_AZIMUTHS = 8


class LobeBins(NamedTuple):
    """Directions that fill the bins of one angle of incidence."""

    bins: SlopeBins
    theta_i: float
    """degree"""
    phi_i: float | None
    """degree; None for the mean over the azimuth of incidence, with slopes along and across the plane of incidence"""
    theta: Array
    """Outgoing directions above the horizon [degree]"""
    phi: Array
    weight: Array
    """cos θ_o dω_o of each [sr]"""
    bin: NDArray[np.intp]
    """Number of its bin, row by row"""

    @classmethod
    def of(cls, bins: SlopeBins, theta_i: float, phi_i: float | None) -> LobeBins:
        """Directions of the bins of :func:`brdfpipe.references.tracer.trace` for the same incidence."""
        node, node_weight = hemisphere.panel_rule(bins.step * np.arange(-bins.half, bins.half + 1), _POINTS)
        slope, width = bins.width * np.sinh(node), bins.width * np.cosh(node) * node_weight
        number = np.arange(slope.size) // _POINTS
        # The mean over azimuth has no sign of the slope across: its bins are the upper half.
        across = np.arange(slope.size) if phi_i is not None else np.arange(slope.size // 2, slope.size)
        p, q = slope, slope[across, None]
        area = width * width[across, None] * (1 if phi_i is not None else 2)
        azimuth = np.radians(phi_i or 0.0)
        sin, cos = np.sin(np.radians(theta_i)), np.cos(np.radians(theta_i))
        in_x, in_y = sin * np.cos(azimuth), sin * np.sin(azimuth)
        square = 1 + p * p + q * q
        towards = cos - p * in_x - q * in_y
        out = np.stack(
            [
                np.broadcast_to(value, square.shape)
                for value in (
                    -2 * towards * p / square - in_x,
                    -2 * towards * q / square - in_y,
                    2 * towards / square - cos,
                )
            ],
            axis=-1,
        )
        above = (towards > 0) & (out[..., 2] > 0)
        theta, phi = angles_of(out[above])
        # dω_o = 4 cos ζ cos³α dp dq
        weight = (out[..., 2] * 4 * towards / square**2 * area)[above]
        by_bin = (number[across, None] * (2 * bins.half) + number)[above]
        return cls(bins, theta_i, phi_i, theta, phi, weight, by_bin)

    def brdf(self, model: Representation) -> Array:
        """BRDF [sr-1] of each direction, of a model without wavelength."""
        turns = [self.phi_i] if self.phi_i is not None else [0.0]
        if self.phi_i is None and not model.isotropic:
            turns = list(np.arange(_AZIMUTHS) * 360 / _AZIMUTHS)
        values = []
        for turn in turns:
            # The mean over azimuth folds both sides of the plane of incidence.
            sides = (self.phi + turn, turn - self.phi) if self.phi_i is None else (self.phi,)
            for phi in sides[: 1 if model.isotropic else 2]:
                incidence = np.full_like(self.theta, self.theta_i), np.full_like(self.theta, turn)
                values.append(model.evaluate(*incidence, self.theta, phi, None)[:, 0])
        return np.asarray(np.mean(values, axis=0))

    def total(self, values: Array) -> Array:
        """∫ values cos θ_o dω_o over each bin, of values of each direction, (bins,)."""
        return np.bincount(self.bin, self.weight * values, minlength=self.bins.number).astype(float)


def gloss_by_bin(model: xr.Dataset, bins: SlopeBins, theta_i: float, phi_i: float | None) -> Array:
    """Gloss units that the light of each bin contributes, (bins,); their sum is the gloss of the scattered light.

    ``model`` is without wavelength; ``theta_i`` is a gloss angle, ``phi_i`` as in :class:`LobeBins`.
    """
    sample, azimuth = apertures.sample_of(model, phi_i), phi_i or 0.0
    light = apertures.source(theta_i, _APERTURES)
    window = apertures.centred(*RECEPTOR[theta_i])
    nodes = apertures.window_nodes(Beam(theta_i, light, window, _APERTURES.window), sample.lobe)
    incidence, around, outgoing, leaving = nodes.directions
    around, leaving = around + azimuth, leaving + 180 + azimuth
    brdf = representation(model).evaluate(incidence, around, outgoing, leaving, None)[:, 0]
    p, q = slope_towards(half_vector(incidence, around, outgoing, leaving), around, leaving)
    if phi_i is None:
        cos, sin = np.cos(np.radians(around)), np.sin(np.radians(around))
        p, q = p * cos + q * sin, np.abs(q * cos - p * sin)
    column, row = (
        np.clip(np.floor(np.arcsinh(slope / bins.width) / bins.step) + bins.half, 0, 2 * bins.half - 1).astype(np.intp)
        for slope in (p, q)
    )
    units = 100 / float(light.weight @ light.glass)
    flux = nodes.weight * light.weight[nodes.source_point] * brdf * units
    return np.bincount(row * (2 * bins.half) + column, flux, minlength=bins.number).astype(float)
