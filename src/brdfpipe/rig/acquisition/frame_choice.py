"""Which frames of a bracket are needed, from the last frames of the same cells.

The light of the cells changes little from one wavelength to the next. The frames taken there show which frames of the bracket a cell needs to be
measured as well as with all of them, or with a signal-to-noise ratio of :data:`ENOUGH`. Once the frames of a bracket are taken they are judged by
their own light: frames that were left out and turn out to be needed are taken after all.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from brdfpipe.geometry import Array
from brdfpipe.rig.acquisition.estimate import frame_range
from brdfpipe.rig.plan import LINE_LAMP, MIRROR, Arrangement, Plan, Shot, Step
from brdfpipe.rig.raw_frame import Counts
from brdfpipe.rig.reduction import cells as rig_cells
from brdfpipe.rig.screen import linear_limit

ENOUGH = 200.0
"""Signal-to-noise ratio of a cell beyond which more light does not help: 0.5 %, less than the repeatability of a lamp."""

_LOSS = 0.97  # share of the signal-to-noise ratio of all frames that a cell below ENOUGH must keep
_FEW = 0.005  # share of the cells that may lose more, but at most half of it: the peak of a lobe may be one cell
_MARGIN = 2.0  # factor by which a pixel may be brighter than at the wavelength before
_SHOWN = 5.0  # ratio of light to noise from which a frame predicts the light of a cell


@dataclass
class FrameChoice:
    """Chooses the frames of the brackets of a plan, in the order in which they are taken."""

    plan: Plan
    _rates: dict[Arrangement, tuple[Array, Array]] = field(default_factory=dict)
    """Light of each cell and of its brightest pixel [e⁻/s] without filter, in the last bracket of an arrangement."""
    _own: dict[tuple[Arrangement, float], tuple[Array, Array, Array]] = field(default_factory=dict)
    """The same in a bracket that is being taken, with the ratio of light to noise of the frame that shows it best."""

    _chosen: dict[tuple[Arrangement, float], frozenset[int]] = field(default_factory=dict)
    """Steps of each bracket that are taken."""

    def order(self, missing: Sequence[Shot], leave_out: Callable[[list[Shot]], None]) -> Iterator[Shot]:
        """The frames to take, in order; each must be learnt before the next is asked for.

        ``leave_out`` is called with the frames of a bracket that are not needed, once the others are taken.
        """
        last = {(shot.arrangement, shot.wavelength): shot for shot in missing if shot.step}
        for shot in missing:
            if not shot.step:
                yield shot
                continue
            key = shot.arrangement, shot.wavelength
            if key not in self._chosen:
                self._chosen[key] = self.before(*key)
            if shot.step in self._chosen[key]:
                yield shot
            if shot != last[key]:
                continue
            # All frames that were chosen are taken: they show whether others are needed.
            further = self.after(*key) - self._chosen[key]
            others = [other for other in missing if other.step and (other.arrangement, other.wavelength) == key]
            others = [other for other in others if other.step not in self._chosen[key]]
            self._chosen[key] |= further
            yield from (other for other in others if other.step in further)
            if spared := [other for other in others if other.step not in further]:
                leave_out(spared)

    def last_step(self, shot: Shot) -> int:
        """The last step of a frame's bracket that is taken, as far as it is known."""
        everything = frozenset({len(self.plan.bracket)})
        return max(self._chosen.get((shot.arrangement, shot.wavelength), everything))

    @cached_property
    def _weights(self) -> sparse.csr_array:
        return rig_cells.weights(self.plan.rig, self.plan.rig.screen)

    @cached_property
    def _pixels(self) -> Array:
        """(cell,) pixels of a cell; NaN for one outside the picture."""
        area = np.asarray(self._weights.sum(axis=1), dtype=float).ravel()
        return np.where(area > 0, area, np.nan)

    def learn(self, shot: Shot, counts: Counts, dark: Array | None) -> None:
        """Learn the light of the cells from a frame of a bracket (y, x); ``dark`` is the mean of its dark frames."""
        if not shot.step or dark is None:
            return
        rig = self.plan.rig
        light = rig.camera.gain * (counts - dark)
        sums, noise = self._sums(light)
        brightest = self._brightest(light)
        usable = (brightest < linear_limit(rig)) & (sums > _SHOWN * noise)
        # Out of range, a cell is at least so bright.
        snr = np.where(usable, sums / noise, np.where(brightest >= linear_limit(rig), 0.0, -1.0))
        scale = self._scale(shot.exposure, shot.position)
        rate, peak = sums / scale, brightest / scale
        key = shot.arrangement, shot.wavelength
        known = self._own.get(key, (np.zeros_like(rate), np.zeros_like(peak), np.full(rate.shape, -2.0)))
        better = snr > known[2]
        own = tuple(np.where(better, new, old) for new, old in zip((rate, peak, snr), known, strict=True))
        self._own[key] = own[0], own[1], own[2]
        self._rates[shot.arrangement] = own[0], own[1]

    def before(self, arrangement: Arrangement, wavelength: float) -> frozenset[int]:
        """Steps, from 1, of a bracket that are taken first, by the light at the wavelength before; all without one."""
        everything = frozenset(range(1, len(self.plan.bracket) + 1))
        if arrangement.load in ("target", MIRROR, LINE_LAMP) or arrangement not in self._rates:
            return everything
        rate, peak = self._rates[arrangement]
        return self._kept(arrangement, wavelength, rate, peak * _MARGIN)

    def after(self, arrangement: Arrangement, wavelength: float) -> frozenset[int]:
        """Steps that the frames of the bracket itself show to be needed."""
        own = self._own.get((arrangement, wavelength))
        return frozenset() if own is None else self._kept(arrangement, wavelength, own[0], own[1])

    def _kept(self, arrangement: Arrangement, wavelength: float, rate: Array, peak: Array) -> frozenset[int]:
        """The fewest frames with which the cells are measured well enough, dropping the longest exposures first."""
        bracket = self.plan.bracket
        information = np.stack([self._information(step, rate, peak) for step in bracket])
        kept = set(range(len(bracket)))
        wanted = np.minimum(ENOUGH, _LOSS * np.sqrt(information.sum(axis=0)))
        # Monitor readings of the lamp repeat one frame of the bracket.
        monitored = {self.plan.drift.step - 1} if wavelength == self.plan.drift.wavelength else set()
        for index in sorted(kept - monitored, key=lambda index: -bracket[index].exposure):
            left = kept - {index}
            snr = np.sqrt(information[sorted(left)].sum(axis=0))
            enough = np.nanmean(snr < wanted) <= _FEW and not (snr < wanted / 2).any()
            if left and enough and self._overlap([bracket[at] for at in sorted(left)]):
                kept = left
        return frozenset(index + 1 for index in kept)

    def _information(self, step: Step, rate: Array, peak: Array) -> Array:
        """(cell,) square of the signal-to-noise ratio that a frame gives; 0 for a cell out of range."""
        rig, scale = self.plan.rig, self._scale(step.exposure, step.position)
        light = np.maximum(rate, 0.0) * scale
        variance = light + self._pixels * rig.camera.read_noise**2
        return np.where(peak * scale < linear_limit(rig), light**2 / variance, 0.0)

    def _overlap(self, steps: Sequence[Step]) -> bool:
        """Whether neighbouring frames have cells in common, so that their scales can be compared."""
        gains = sorted(self._scale(step.exposure, step.position) for step in steps)
        return all(brighter / darker < frame_range(self.plan.rig) for darker, brighter in pairwise(gains))

    def _scale(self, exposure: float, position: int) -> float:
        return exposure * self.plan.rig.filter_at(position).transmittance

    def _sums(self, light: Array) -> tuple[Array, Array]:
        variance = np.maximum(light, 0.0) + self.plan.rig.camera.read_noise**2
        sums = rig_cells.cell_sums(self._weights, light[None])[0]
        noise = np.sqrt(rig_cells.cell_sums(self._weights.power(2), variance[None])[0])
        return sums, np.where(noise > 0, noise, np.inf)

    def _brightest(self, light: Array) -> Array:
        """(cell,) light of the brightest pixel of each cell [e⁻]."""
        weights = self._weights
        filled: NDArray[np.bool_] = np.diff(weights.indptr) > 0
        brightest = np.zeros(weights.shape[0])
        brightest[filled] = np.maximum.reduceat(light.ravel()[weights.indices], weights.indptr[:-1][filled])
        return brightest
