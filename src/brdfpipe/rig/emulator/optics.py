"""From what lies in the holder to electrons on each pixel.

A pixel is as bright as what it looks at: the BRDF of the sample times the cosine of view, or the etalon's. The spot of the reference
shows the lamp. Both are worth so many electrons a second (:data:`SAMPLE_RATE`, :data:`REFERENCE_RATE`) where the lamp is 1.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
import xarray as xr

from brdfpipe.geometry import Array
from brdfpipe.rig.description import Rig
from brdfpipe.rig.emulator.effects import Effects
from brdfpipe.rig.emulator.holder import Etalon, Holder, Setup
from brdfpipe.rig.emulator.source import Source
from brdfpipe.rig.emulator.spread import PointSpread
from brdfpipe.rig.emulator.view import view

SAMPLE_RATE = 5000.0
"""Electrons a second and pixel for BRDF × cosine of view = 1 sr⁻¹, at the lamp's middle and without a filter.

Nine pixels together reach a signal-to-noise ratio of 50 at 500 electrons each, 1/50 of the linear range: 0.01 sr⁻¹ takes 10 s, and 2500 sr⁻¹
just stay in the range through a filter of 1 % in 0.2 s. Five frames a factor of 8.4 apart overlap over the whole.
"""

REFERENCE_RATE = 25_000.0
"""Electrons a second and pixel of the reference spot, if the splitter sent all light there: it stays linear for 12 s."""

_STEP = 10_000
"""Wavelengths so far apart are evaluated together, through the one asked for: a scan asks for the others next [pm]."""

_KEPT_SIGNALS, _KEPT_PICTURES = 400, 64


class Optics:
    """Light on the sensor, for every state of the rig.

    Parameters
    ----------
    rig : description
    truth : kind ``bsdf``, the sample
    effects, seed, session : see :mod:`brdfpipe.rig.emulator.effects`
    etalon : as certified

    Raises
    ------
    VocabularyError : the truth is no bsdf.

    Notes
    -----
    Filters and mirrors are taken at the middle of the band of wavelengths.
    """

    def __init__(
        self, rig: Rig, truth: xr.Dataset, effects: Effects, *, seed: int, session: int, etalon: Etalon
    ) -> None:
        self._rig = rig
        self.source = Source(rig, effects, seed, session)
        self._holder = Holder(rig, truth, self.source, effects, seed=seed, session=session, etalon=etalon)
        self._view = view(rig, effects, seed, session)
        self._spread = PointSpread(self._view.reference.shape, effects.core, effects.halo, effects.halo_radius)
        self._reference = REFERENCE_RATE * self._spread(self._view.reference)
        self._signals: dict[tuple[Setup, int], Array] = {}
        self._picture: Callable[[Setup, int], Array] = lru_cache(_KEPT_PICTURES)(self._pictured)

    def rates(self, setup: Setup, wavelength: float, position: int) -> Array:
        """Electrons a second on each pixel (height, width) where the lamp gives its steady light.

        Parameters
        ----------
        setup : what is arranged
        wavelength : of the monochromator [nm]
        position : of the filter wheel

        Raises
        ------
        EmulationError : a setup that cannot be, or a truth that mirrors light as no rough surface does.
        """
        passed = self.source.filter(position, wavelength)
        nodes, light = self.source.band(wavelength)
        reference = float((light * self.source.split(nodes)).sum())
        if self._rig.nd_location == "reference":
            reference *= passed
        return passed * self._picture(setup, round(1000 * wavelength)) + reference * self._reference

    def _pictured(self, setup: Setup, picometres: int) -> Array:
        """What comes from the holder, without a filter."""
        if (setup, picometres) not in self._signals:
            self._evaluate(setup, picometres)
        picture = np.zeros(self._view.reference.shape)
        picture.ravel()[self._view.pixels] = self._signals[setup, picometres]
        return self._spread(picture)

    def _evaluate(self, setup: Setup, picometres: int) -> None:
        """Signals of the lit pixels at this wavelength and at all that lie whole steps from it."""
        low, high = (round(1000 * wavelength) for wavelength in self._rig.wavelengths)
        # One that the rig does not reach, as on a monochromator's way from rest, stands alone.
        reached = low <= picometres <= high
        teeth = range(low + (picometres - low) % _STEP, high + 1, _STEP) if reached else [picometres]
        wavelengths = np.array(teeth) / 1000
        bright = self._holder.brightness(setup, self._view.theta_s, self._view.phi_s, wavelengths)
        signals = self._view.matrix @ bright
        signals *= SAMPLE_RATE * self.source.path(setup.entrance, wavelengths)
        if len(self._signals) + len(teeth) > _KEPT_SIGNALS:
            self._signals.clear()
        self._signals |= {(setup, tooth): signals[:, k].copy() for k, tooth in enumerate(teeth)}
