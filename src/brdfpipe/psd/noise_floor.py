"""White noise of heights: from the plateau of their spectrum, from two scans of one place, or given.

White noise of rms height σ adds S = σ² ΔA to the spectrum at all frequencies, and 2σ²/d² to the mean square slope between heights at
a pitch d. It shows where the spectrum of the surface has fallen below it: a plateau up to the highest frequencies. The surface decays there
like a power, so the sum of a constant and a power is fitted. Without a plateau nothing is claimed.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr

from brdfpipe.geometry import Array
from brdfpipe.psd.k_correlation import PsdError
from brdfpipe.psd.periodograms import Rings, Scan, full_pitch, rings

_PATCH = {1: 512, 2: 128}
_MOST_PATCHES, _FEW_PATCHES = 64, 9
_PATCHES_ALONG_LINE = 5
"""Patches of a short line, besides those that overlap them: enough to show whether they scatter as white noise."""
_WHITENESS = 0.03
"""Relative scatter of the floor of an instrument that still counts as white."""
_SURFACE_SHARE = 0.5
"""Largest surface over noise at half the power of two below the Nyquist frequency: beyond it, no plateau is seen."""
_LARGEST_FALL = 1.2 * (1 + _SURFACE_SHARE)
"""Largest ratio of the spectrum there to that at its highest frequency."""
_SIGNIFICANT = 3.0
_CERTAIN = 2.0
"""Standard uncertainties, or square root of an excess of χ², beyond which a spectrum has a plateau, or has none."""
_STEADY = 0.1
"""Relative uncertainty of the rings from the scatter of the patches that is always accepted."""
_EXCESS_SCATTER = 1.5
"""Largest uncertainty of the rings over that of white noise in as many modes, if it is more: a short line has few."""
_LARGEST_NOISE = 0.5
"""Largest noise over the rms of the heights."""
_LARGEST_EXCESS = 1.1
"""Largest given noise over that of heights that are noise alone: it is known to a few per cent."""
_POSSIBLE = (1e-9, 1e9)
"""Rms of heights [um]; the transform of others may overflow."""
_SAMPLED = 512
_MISFIT = 2.0
_UNCERTAIN = 0.3
"""Largest relative uncertainty of the level of the plateau."""
_FEWEST_RINGS = 6
_POWERS = 1.0, 20.0
"""Powers of the frequency with which a surface may decay towards its plateau."""
_WEIGHINGS = 3
_TRIALS, _NARROWINGS = 64, 4
"""Powers that are tried at a time, and times their range is narrowed to the neighbours of the best."""


PLATEAU = "plateau of the spectrum at the highest frequencies"
"""Source of a noise that nobody stated."""
COARSE_PITCH = 1.1
"""Pitch [um], two wavelengths of 550 nm, above which roughness that scatters visible light is folded back into the band as a plateau."""


class NoiseFloor(NamedTuple):
    """White noise of heights."""

    sigma: float
    """Rms height [um]; 0 where no noise is known."""
    uncertainty: float
    """Standard uncertainty of it [um]; 0 where that is not stated."""
    source: str
    """How it is known, in words."""
    given: bool = False
    """Whether it was stated, not found in the heights."""

    def __str__(self) -> str:
        """The noise and its uncertainty, for a person."""
        return noise_in_words(self.sigma, self.uncertainty)

    def unresolved(self, scan: Scan) -> float:
        """Rms height [um] of a plateau that may be roughness finer than a coarse pitch just as well as noise; 0 where noise is known otherwise."""
        return self.sigma if self.source == PLATEAU and max(scan.pitch) > COARSE_PITCH else 0.0

    def density(self, scan: Scan) -> float:
        """Two-sided spectrum of the noise [um4; of a line um3]."""
        return self.sigma**2 * scan.cell

    def density_uncertainty(self, scan: Scan) -> float:
        """Standard uncertainty of that spectrum."""
        return 2 * self.sigma * self.uncertainty * scan.cell


def noise_in_words(sigma: float, uncertainty: float) -> str:
    """A height noise and its standard uncertainty [um], where that is stated."""
    return f"{1000 * sigma:.3g} nm ({f'± {1000 * uncertainty:.2g} nm' if uncertainty else 'uncertainty not stated'})"


UNKNOWN = NoiseFloor(0.0, 0.0, "the spectrum has no plateau at its highest frequencies")


def noise_floor(surface: xr.Dataset, noise: float | xr.Dataset | NoiseFloor | None = None) -> NoiseFloor:
    """White noise of a scan: known, given [um], from a second scan of the same place, or from the plateau of its spectrum.

    Raises
    ------
    PsdError : as :func:`given` and :func:`from_repeats`.
    """
    if isinstance(noise, NoiseFloor):
        return noise
    scan = Scan.of(surface)
    if noise is None:
        return plateau(scan)
    if isinstance(noise, xr.Dataset):
        return from_repeats(scan, [Scan.of(noise)])
    return given(scan, noise, float(surface.attrs.get("lambda_s", 0.0)))


def noise_besides_rounding(floor: NoiseFloor, step: float) -> float:
    """Rms of the noise besides that of rounding heights to a ``step`` [um]; 0 where rounding explains the noise.

    Noise that was given is noise however uncertain it is.
    """
    rest = floor.sigma**2 - step**2 / 12
    explained = 0.0 if floor.given else _SIGNIFICANT * 2 * floor.sigma * floor.uncertainty
    return float(np.sqrt(rest)) if rest > explained else 0.0


def plateau(scan: Scan) -> NoiseFloor:
    """White noise of a scan, from the plateau of its spectrum; :data:`UNKNOWN` where none is seen.

    The surface over the noise must be below 1/2 at 0.7 of the Nyquist frequency, by two standard uncertainties, and the fit good to 3 %, or to the
    scatter of the modes of a short line. Of a line the plateau is that of its own spectrum. One that holds most of the heights may be the surface itself.
    """
    sample = scan.height[tuple(slice(None, None, max(1, n // _SAMPLED)) for n in scan.height.shape)].astype(float)
    sample = sample[np.isfinite(sample)]
    with np.errstate(over="ignore", invalid="ignore"):
        rms = float(sample.std()) if sample.size else 0.0
    if not _POSSIBLE[0] < rms < _POSSIBLE[1]:
        return UNKNOWN
    # A few patches tell a spectrum that falls to the end.
    for most, steepest in ((_FEW_PATCHES, 2 * _LARGEST_FALL), (_MOST_PATCHES, _LARGEST_FALL)):
        try:
            fine, _ = full_pitch(scan, _patch(scan), most)
            # In the corners of the frequency plane the surface has fallen even further.
            ends = (axis[axis.size // 2 if k < len(fine.axes) - 1 else -1] for k, axis in enumerate(fine.axes))
            high = float(np.sqrt(sum(end**2 for end in ends)))
            spectrum = rings([fine], high)
        except PsdError:
            return UNKNOWN
        shoulder = spectrum.between(scan.nyquist / np.sqrt(2), scan.nyquist)
        if shoulder.frequency.size == 0 or _falls(shoulder, spectrum, steepest):
            return UNKNOWN
    # The scatter of constant patches is that of their number of modes alone.
    of_modes = rings([fine._replace(spectra=np.ones_like(fine.spectra))], high)
    floor = _fit(spectrum, of_modes, scan.nyquist)
    if floor is None:
        return UNKNOWN
    level, uncertainty = floor
    sigma = float(np.sqrt(level / scan.cell))
    if sigma > _LARGEST_NOISE * rms:
        return UNKNOWN
    return NoiseFloor(sigma, sigma * uncertainty / (2 * level), PLATEAU)


def _falls(shoulder: Rings, spectrum: Rings, most: float) -> bool:
    """Whether the spectrum falls from its shoulder to its end by more than a factor, beyond its scatter."""
    scatter = np.hypot(shoulder.uncertainty[0], most * spectrum.uncertainty[-1])
    return bool(shoulder.density[0] - most * spectrum.density[-1] > _CERTAIN * scatter)


def _patch(scan: Scan) -> int:
    """Heights along a side of a patch that shows a plateau."""
    size = _PATCH[scan.height.ndim]
    return min(size, scan.height.size // _PATCHES_ALONG_LINE) if scan.height.ndim == 1 else size


def from_repeats(scan: Scan, others: Sequence[Scan]) -> NoiseFloor:
    """White noise of a scan and others of the same place, alike, from the upper octave of the spectra of their differences.

    Raises
    ------
    PsdError : the scans differ in shape or pitch, are identical, or all patches of a difference have gaps.
    """
    levels, scatter = np.array([_level_of_difference(scan, other) for other in others]).T
    level = float(levels.mean())
    # Whiteness is that of the instrument, the scatter of each difference its own; all share the first scan.
    relative = float(np.hypot(np.sqrt(np.mean(scatter**2) * (1 + 1 / len(others)) / 2), _WHITENESS))
    sigma = float(np.sqrt(level / scan.cell))
    return NoiseFloor(
        sigma, sigma * relative / 2, f"difference of {_COUNTS.get(len(others), len(others) + 1)} scans of one place"
    )


_COUNTS = {1: "two", 2: "three", 3: "four"}


def _level_of_difference(scan: Scan, other: Scan) -> tuple[float, float]:
    """Spectrum of the noise of each of two scans of one place, and its relative scatter."""
    if scan.height.shape != other.height.shape or not np.allclose(scan.pitch, other.pitch, rtol=1e-3):
        raise PsdError(
            f"two scans of one place have {scan.height.shape} and {other.height.shape} heights at pitches of {scan.pitch} and {other.pitch} um; "
            "accepted: the same positions"
        )
    difference = scan._replace(height=scan.height.astype(float) - other.height)
    if not np.nanmax(np.abs(difference.height), initial=0.0) > 0:
        raise PsdError("two scans of one place have identical heights; accepted: a second measurement")
    fine, _ = full_pitch(difference, _PATCH[scan.height.ndim], _MOST_PATCHES)
    octave = rings([fine], scan.nyquist).between(scan.nyquist / 2, np.inf)
    mean = float(octave.density.mean())
    return mean / 2, float(octave.density.std()) / mean


def given(scan: Scan, sigma: float, lambda_s: float = 0.0, uncertainty: float = 0.0) -> NoiseFloor:
    """White noise of a stated rms height and standard uncertainty [um].

    Raises
    ------
    PsdError : the noise is negative or not below the rms of the heights, or above all differences of neighbouring heights, the heights were smoothed with ``lambda_s`` [um], or the
        uncertainty is negative or above the noise.
    """
    rms = float(np.sqrt(scan.variance))
    if not 0 <= sigma < rms:
        raise PsdError(
            f"a height noise of {1000 * sigma:.4g} nm was given; accepted: 0 to the rms of the levelled heights, {1000 * rms:.4g} nm; correct `surface.noise`"
        )
    most = _LARGEST_EXCESS * _rms_between_neighbours(scan) / np.sqrt(2)
    if sigma > most and not lambda_s:
        raise PsdError(
            f"a height noise of {1000 * sigma:.4g} nm was given, but neighbouring heights differ by less than such noise alone would; accepted: 0 to "
            f"{1000 * most:.4g} nm; correct `surface.noise`"
        )
    if sigma and lambda_s:
        raise PsdError(
            f"a height noise was given for heights that were smoothed with λs = {lambda_s:g} um, after which noise is not white; "
            "accepted: one of `surface.noise` and `surface.lambda_s`"
        )
    if not 0 <= uncertainty <= sigma:
        raise PsdError(
            f"an uncertainty of {1000 * uncertainty:.4g} nm was given for a height noise of {1000 * sigma:.4g} nm; accepted: 0 to the noise itself; correct "
            "`surface.noise_uncertainty`"
        )
    return NoiseFloor(sigma, uncertainty, "description of the material", given=True)


def _rms_between_neighbours(scan: Scan) -> float:
    """Smallest rms difference of neighbouring heights of the axes [um], on some lines along each; infinite where none is known."""
    found = [np.inf]
    for axis in range(scan.height.ndim):
        along = np.moveaxis(scan.height, axis, -1)
        lines = along[:: max(1, along.shape[0] // _SAMPLED)] if along.ndim == 2 else along
        difference = np.diff(lines.astype(float), axis=-1)
        present = difference[np.isfinite(difference)]
        found += [float(np.sqrt(np.mean(present**2)))] if present.size else []
    return min(found)


def _fit(spectrum: Rings, of_modes: Rings, nyquist: float) -> tuple[float, float] | None:
    """Level of the plateau and its standard uncertainty; None if there is no plateau.

    ``of_modes`` is a spectrum of 1 with the uncertainty of as many modes.
    """
    # From higher and higher frequencies: a surface need not follow one power over several octaves.
    for start in nyquist * 2.0 ** np.arange(-3, -0.4, 0.5):
        part = spectrum.between(start, np.inf)
        # Spikes or a lay make the patches or directions differ: that is not white noise.
        steady = max(_STEADY, _EXCESS_SCATTER * float(np.median(of_modes.between(start, np.inf).uncertainty)))
        if part.frequency.size < _FEWEST_RINGS or np.median(part.uncertainty / part.density) > steady:
            return None
        noise, noise_u, above_surface, misfit = _constant_and_power(part, nyquist)
        if misfit <= _MISFIT:
            return (noise, noise * noise_u) if above_surface and noise_u < _UNCERTAIN else None
    return None


def _constant_and_power(part: Rings, nyquist: float) -> tuple[float, float, bool, float]:
    """Constant of a fitted sum of a constant and a power, its relative uncertainty, whether it is surely above the surface, and χ² per ring.

    Sure is what rings of their scatter tell from a power of half the constant at 0.7 of the Nyquist frequency: a short line has few modes.
    """
    x, scale = np.log(part.frequency / nyquist), float(part.density[-1])
    density, relative_u = part.density / scale, np.hypot(part.uncertainty / part.density, _WHITENESS)
    fitted = density
    # Rings that are low by chance would weigh more than others: the fit tells what they scatter about.
    for _ in range(_WEIGHINGS):
        weight, powers = 1 / (relative_u * fitted), np.geomspace(*_POWERS, _TRIALS)
        for _ in range(_NARROWINGS):
            noise, surface, power, misfit = _best_of(powers, x, density, weight)
            step = (powers[-1] / powers[0]) ** (1 / (_TRIALS - 1))
            powers = np.clip(np.geomspace(power / step, power * step, _TRIALS), *_POWERS)
        above = surface * np.exp(-power * x)
        fitted = noise + above
    jacobian = np.stack([np.full_like(x, noise), above, -x * above], axis=1) * weight[:, None]
    relative = float(np.hypot(np.sqrt(np.linalg.pinv(jacobian.T @ jacobian)[0, 0]), _WHITENESS))
    shoulder = surface * float(np.exp(power * np.log(2) / 2))
    excess = _misfit_of_share(_SURFACE_SHARE, x, density, weight) - misfit
    above_surface = shoulder < _SURFACE_SHARE * noise and excess > _CERTAIN**2
    return scale * noise, relative, above_surface, misfit / (part.frequency.size - 3)


def _misfit_of_share(share: float, x: Array, density: Array, weight: Array) -> float:
    """χ² of the best sum of a constant and a power that is a ``share`` of it at 0.7 of the Nyquist frequency."""
    powers = np.geomspace(*_POWERS, _TRIALS)
    shape = 1 + share * np.exp(-powers[:, None] * (x + np.log(2) / 2))
    square = weight**2
    level = shape @ (square * density) / (shape**2 @ square)
    return float(np.square((level[:, None] * shape - density) * weight).sum(axis=1).min())


def _best_of(powers: Array, x: Array, density: Array, weight: Array) -> tuple[float, float, float, float]:
    """Constant, amplitude of the power, power, and χ², of the best of many powers, from which both others follow linearly."""
    above, square = np.exp(-powers[:, None] * x), weight**2
    one, both, two = square.sum(), above @ square, above**2 @ square
    first, second = float(square @ density), above @ (square * density)
    determinant = np.maximum(one * two - both**2, 1e-300)
    noise, surface = (first * two - second * both) / determinant, (second * one - first * both) / determinant
    # Neither may be negative: then the other alone.
    noise, surface = (
        np.where(surface < 0, first / one, np.maximum(noise, 0.0)),
        np.where(noise < 0, second / two, np.maximum(surface, 0.0)),
    )
    misfit = np.square((noise[:, None] + surface[:, None] * above - density) * weight).sum(axis=1)
    best = int(np.argmin(misfit))
    return float(noise[best]), float(surface[best]), float(powers[best]), float(misfit[best])
