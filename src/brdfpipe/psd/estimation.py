"""Roughness spectrum of a measured surface."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import vocabulary
from brdfpipe.geometry import Array
from brdfpipe.psd.coherent_height import coherent_height
from brdfpipe.psd.k_correlation import LEAST_SHARE, FittedForm, Gaussian, PsdError, fit
from brdfpipe.psd.line_inversion import invert, inverted_change, with_variance_of
from brdfpipe.psd.long_waves import long_waves
from brdfpipe.psd.noise_floor import NoiseFloor, noise_floor
from brdfpipe.psd.periodograms import PatchCount, Rings, Scan, periodograms, rings
from brdfpipe.psd.planar_spectrum import planar_spectrum, slope_ratio
from brdfpipe.psd.spectrum_dataset import own_variance, spectrum_dataset

LAY_LIMIT = 1.2
"""Ratio of the principal rms slopes in the band above which a spectrum over both frequencies is stored too."""

_SIGNIFICANT = 3.0
_FEWEST_RINGS = 6
_LEAST_LEFT = 0.1
"""Least share of a ring that is left as its noise grows."""
_CONTRADICTED = 10.0
"""Line spectrum over that of the fitted form beyond which the form does not stand for it."""
_USABLE = 0.5
"""Largest relative uncertainty of an inverted ring where the form does not stand for it."""
_POOR_FIT = 0.3
"""Rms of the logarithm of measured over fitted spectrum above which the form is not that of the surface."""


def estimate(surface: xr.Dataset, *, noise: float | xr.Dataset | NoiseFloor | None = None) -> xr.Dataset:
    """Roughness spectrum of a levelled map or line without its noise, with its band and uncertainty.

    Parameters
    ----------
    surface : kind ``surface``, levelled
    noise : rms of white height noise [um], 0 for none; a known one; a second scan of the same place, of which the difference is noise;
        or None: from the plateau of the spectrum at its highest frequencies, where it has one

    Returns
    -------
    Dataset of kind ``psd`` and form ``measured``, on rings of frequency from ``band_low``, two waves across the scan, to ``band_high``,
        where noise, the pitch or the filter λs ends it. Longer waves have ``long_sigma`` and ``long_slope``. ``apparent_psd`` of a map
        includes the noise and all frequencies. A map
        with a lay has ``psd_planar`` besides, 0 beyond the band. A line counts as one across an isotropic surface;
        ``psd_quality`` is ``measured`` where its spectrum was inverted, ``interpolated`` where the fitted form is more certain

    Raises
    ------
    PsdError : no patch without gaps; fewer than four frequencies above the noise; a noise that is impossible, or given for filtered
        heights; a second scan of other shape or pitch.
    VocabularyError : a dataset is not of kind ``surface``.
    """
    vocabulary.validate(surface, "surface")
    scan = Scan.of(surface)
    if isinstance(noise, xr.Dataset):
        vocabulary.validate(noise, "surface")
    floor = noise_floor(surface, noise)
    levels, count = periodograms(scan)
    apparent = rings(levels, scan.nyquist)
    if not (apparent.density > 0).any():
        raise PsdError(
            "no roughness spectrum: the surface is perfectly flat; check the height unit and the missing heights"
        )
    above = _without_noise(apparent, floor, scan, surface.attrs)
    line = scan.height.ndim == 1
    noise_change = np.full((1, above.frequency.size), -floor.density_uncertainty(scan))
    if line:
        spectrum, fitted, quality, noise_change = _areal(above, noise_change)
    else:
        spectrum, fitted, quality = above, fit(*above), _measured(above)
    result = spectrum_dataset(
        spectrum,
        fitted,
        quality,
        form="measured",
        method=f"{count.used} windowed patches of {_size(count.side, line)} heights"
        + (", Abel inversion or fit" if line else ""),
        noise_changes=noise_change,
    ).assign(
        sigma_heights=float(np.sqrt(max(scan.variance - floor.sigma**2, 0.0))),
        noise_sigma=floor.sigma,
        noise_sigma_u=floor.uncertainty,
    )
    if unresolved := floor.unresolved(scan):
        result = result.assign(unresolved_sigma=unresolved)
    if not line:
        result = result.assign(apparent_psd=("apparent_frequency", apparent.density), noise_psd=floor.density(scan))
        result = result.assign_coords(apparent_frequency=apparent.frequency)
        planar = planar_spectrum(levels, spectrum, floor.density(scan), scan)
        if slope_ratio(planar) > LAY_LIMIT:
            result = result.merge(planar)
    result = result.merge(long_waves(scan, float(result["band_low"]), float(result["sigma"]), floor.sigma))
    result = result.merge(coherent_height(surface["height"].values, floor.sigma))
    result = vocabulary.add_history(
        result, *_history(count, floor, quality, fitted, line, bool(floor.unresolved(scan)))
    )
    return vocabulary.label(vocabulary.add_warning(result, *_warnings(count)), "psd")


def _without_noise(apparent: Rings, floor: NoiseFloor, scan: Scan, attributes: Mapping[str, Any]) -> Rings:
    """The rings of the band, less the noise: up to the first at which the surface is not significant."""
    level, level_u = floor.density(scan), floor.density_uncertainty(scan)
    density = apparent.density - level
    limit = (
        _SIGNIFICANT
        * level
        * np.hypot(apparent.uncertainty / np.maximum(apparent.density, level), level_u / max(level, 1e-300))
    )
    low, high = 1 / attributes.get("lambda_c", np.inf), 1 / attributes.get("lambda_s", 1e-300)
    outside = (density <= limit) | (apparent.frequency > high)
    start = int(min(np.searchsorted(apparent.frequency, low), outside.size - _FEWEST_RINGS))
    end = start + max(int(np.argmax(np.append(outside[start:], True))), _FEWEST_RINGS)
    uncertainty = np.hypot(apparent.uncertainty, level_u)
    # Where noise leaves hardly anything, the few rings that a spectrum needs keep a tenth of their uncertainty.
    density = np.maximum(density, 0.1 * uncertainty)
    return Rings(apparent.frequency[start:end], density[start:end], uncertainty[start:end])


def _areal(line: Rings, noise_change: Array) -> tuple[Rings, FittedForm, NDArray[np.int8], Array]:
    """Plane spectrum of a line spectrum: inverted, or that of the fitted form, whichever is more certain; with the variance of the line.

    With its change (1, rings) as the line spectrum changes by ``noise_change`` (1, rings), a part of its uncertainty that is common to all rings.
    """
    fitted, noisy = fit(*line, line=True), bool(noise_change.any())
    own = line._replace(uncertainty=np.sqrt(own_variance(line.uncertainty, noise_change))) if noisy else line
    inverted = invert(own)
    change = inverted_change(line, noise_change[0]) if noisy else np.zeros_like(inverted.density)
    inverted = inverted._replace(uncertainty=np.hypot(inverted.uncertainty, change))
    model = fitted.model.areal(inverted.frequency)
    relative = np.sqrt(
        np.interp(inverted.frequency, line.frequency, fitted.relative_uncertainty) ** 2 + fitted.residual**2
    )
    # By the form: rings that are high by chance would seem more certain than those that are low.
    use = (inverted.density > 0) & (inverted.uncertainty < relative * model)
    kept, use = _supported(line, fitted, inverted, use)
    inverted = Rings(*(values[kept] for values in inverted))
    model, relative, use, change = model[kept], relative[kept], use[kept], change[kept]
    quality = np.where(use, vocabulary.quality("measured"), vocabulary.quality("interpolated")).astype(np.int8)
    density, uncertainty = np.where(use, inverted, np.stack([inverted.frequency, model, relative * model]))[1:]
    if noisy and not use.all():
        less = np.maximum(line.density + noise_change[0], _LEAST_LEFT * line.density)
        after = fit(*line._replace(density=less), line=True).model.areal(inverted.frequency)
        change = np.where(use, change, after - model)
        uncertainty = np.where(use, uncertainty, np.hypot(uncertainty, change))
    spectrum = with_variance_of(line, Rings(inverted.frequency, density, uncertainty))
    return spectrum, fitted, quality, change[None] * spectrum.density / density


def _supported(
    line: Rings, fitted: FittedForm, inverted: Rings, use: NDArray[np.bool_]
) -> tuple[slice, NDArray[np.bool_]]:
    """The rings up to which the line tells the plane spectrum, and which of them are inverted.

    Rings that are too weak for the fit are extrapolated by the form. Where the line spectrum is far above it the form is no stand-in: such a ring
    counts if its inversion is certain by itself, and the first that does not ends the band, as noise does. Rounding of the heights leaves a plateau
    there, whose inversion is 0 within its scatter, while a Gaussian form falls below all numbers.
    """
    # By the logarithm: spectra span many decades.
    of_line = np.exp(np.interp(np.log(inverted.frequency), np.log(line.frequency), np.log(line.density)))
    part = of_line * inverted.frequency
    beyond = (part < LEAST_SHARE * part.max()) & (np.arange(part.size) > int(np.argmax(part)))
    contradicted = beyond & (of_line > _CONTRADICTED * fitted.model.line(inverted.frequency))
    certain = (inverted.density > 0) & (inverted.uncertainty < _USABLE * inverted.density)
    lost = contradicted & ~certain
    lost[: _FEWEST_RINGS - 2] = False
    return slice(int(np.argmax(np.append(lost, True)))), np.where(contradicted, certain, use)


def _measured(spectrum: Rings) -> NDArray[np.int8]:
    return np.full(spectrum.frequency.size, vocabulary.quality("measured"))


def _size(side: int, line: bool) -> str:
    return f"{side}" if line else f"{side} x {side}"


def _history(
    count: PatchCount, floor: NoiseFloor, quality: NDArray[np.int8], fitted: FittedForm, line: bool, unresolved: bool
) -> list[str]:
    history = [
        f"The spectrum is the mean of {count.used} of {count.positions} patches of {_size(count.side, line)} heights, each levelled by a plane and "
        "multiplied by a Hann window; long waves are from means of neighbouring heights, and from the whole scan"
        + (f", of which {count.filled} missing heights were filled in from their neighbours." if count.filled else ".")
    ]
    if floor.sigma:
        history.append(
            f"White noise of {floor} was subtracted from the spectrum; from the {floor.source}."
            + (" It may be roughness finer than the pitch." if unresolved else "")
        )
    else:
        history.append(f"No noise was subtracted: {floor.source}.")
    if line:
        share = float(np.mean(quality == vocabulary.quality("measured")))
        history.append(
            f"The line was taken to cross an isotropic surface: its spectrum was inverted (Abel) at {share:.0%} of the frequencies, and replaced by "
            "that of the fitted form where that is more certain; then it was adjusted so that its line spectrum has the variance of the line."
        )
    if fitted.residual > _POOR_FIT:
        history.append(
            f"The {_name(fitted)} does not fit: measured over fitted values scatter by a factor of {np.exp(fitted.residual):.2g}."
        )
    return history


def _name(fitted: FittedForm) -> str:
    return "Gaussian" if isinstance(fitted.model, Gaussian) else "K-correlation"


def _warnings(count: PatchCount) -> list[str]:
    if count.complete:
        return []
    return [
        f"most parts of the scan have gaps: {count.filled} missing heights were filled in from their neighbours, and the roughness "
        "spectrum is too low at high frequencies; measure again with fewer missing heights"
    ]
