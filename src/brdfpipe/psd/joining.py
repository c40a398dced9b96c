"""One roughness spectrum from several scans of a surface: of one magnification, or of several whose bands overlap."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import vocabulary
from brdfpipe.geometry import Array
from brdfpipe.psd.estimation import estimate
from brdfpipe.psd.k_correlation import PsdError, fit
from brdfpipe.psd.periodograms import RINGS_PER_DECADE, Rings
from brdfpipe.psd.scans import sort_scans
from brdfpipe.psd.spectrum_dataset import NOISE_CHANGES, spectrum_dataset

_DISAGREEMENT = 0.2
"""Relative difference of two spectra in their common band that is worth a warning, if it is significant too."""
_SIGNIFICANT = 3.0
_SCALARS = ("sigma_heights", "noise_sigma", "noise_sigma_u", "unresolved_sigma")


def estimate_joined(
    scans: Sequence[xr.Dataset], *, noise: float | None = None, noise_uncertainty: float | None = None
) -> xr.Dataset:
    """Roughness spectrum of all scans of one surface, of any magnification.

    Parameters
    ----------
    scans : kind ``surface``, levelled; those whose attribute ``repeat`` is true show the noise of the first, and are not joined
    noise : rms of white height noise of the first scan and those of its magnification [um]; None as for :func:`brdfpipe.psd.estimate`.
        That of other magnifications is looked for in the plateau of their spectra
    noise_uncertainty : standard uncertainty of a given noise [um]

    Returns
    -------
    Dataset of kind ``psd``, as of :func:`join`

    Raises
    ------
    PsdError : as :func:`brdfpipe.psd.estimate` and :func:`brdfpipe.psd.scans.sort_scans`.
    """
    found = sort_scans(scans, noise, noise_uncertainty)
    psds = *(estimate(scan, noise=found.noise) for scan in found.counted), *map(estimate, found.extending)
    # The noise of the scans of one magnification is that of one instrument.
    return _joined(psds, np.maximum(np.arange(len(psds)) - len(found.counted) + 1, 0))


def join(*psds: xr.Dataset) -> xr.Dataset:
    """Join the spectra of several scans of one surface.

    Parameters
    ----------
    psds : kind ``psd``, of form ``measured``

    Returns
    -------
    Dataset of kind ``psd`` over the union of the bands, on rings of 1/20 decade. Where bands overlap it is the mean of the logarithms, weighted by
        the inverse squares of the relative uncertainties, and its uncertainty grows with their disagreement. The
        heights' and the noise's rms are those of the scan with the widest band, as is ``psd_planar``; waves longer than the band are those of
        the scan that reaches lowest. ``scan_band_low`` and ``scan_band_high`` are the bands, in the order given. The noise of each scan is
        taken as independent of that of the others. A single spectrum is returned unchanged

    Raises
    ------
    PsdError : no spectrum, or one that is not measured.
    VocabularyError : a dataset is not of kind ``psd``.
    """
    return _joined(psds, np.arange(len(psds)))


def _joined(psds: Sequence[xr.Dataset], instrument: NDArray[np.intp]) -> xr.Dataset:
    """As :func:`join`; the noise of spectra of the same number of an ``instrument`` (psds,) grows together."""
    for psd in psds:
        vocabulary.validate(psd, "psd")
    if not psds or any(psd.attrs["form"] != "measured" for psd in psds):
        raise PsdError(
            "roughness spectra to join must be measured, and at least one; accepted: results of `psd.estimate`"
        )
    if len(psds) == 1:
        return psds[0]
    low, high = min(float(psd["band_low"]) for psd in psds), max(float(psd["band_high"]) for psd in psds)
    grid = np.geomspace(low, high, int(np.ceil(RINGS_PER_DECADE * np.log10(high / low))) + 1)
    parts = [_on_grid(psd, grid) for psd in psds]
    logs, relative = np.array([part[0] for part in parts]), np.array([part[1] for part in parts])
    weight = np.where(np.isfinite(logs), 1 / relative**2, 0.0)
    covered = weight.any(axis=0)
    grid, logs, weight = grid[covered], np.where(np.isfinite(logs), logs, 0.0)[:, covered], weight[:, covered]
    share = weight / weight.sum(axis=0)
    mean = (weight * logs).sum(axis=0) / weight.sum(axis=0)
    count = (weight > 0).sum(axis=0)
    misfit = (weight * (logs - mean) ** 2).sum(axis=0) / np.maximum(count - 1, 1)
    density = np.exp(mean)
    spectrum = Rings(grid, density, density * np.sqrt(np.maximum(1.0, misfit) / weight.sum(axis=0)))
    widest = max(psds, key=lambda psd: float(psd["band_high"] / psd["band_low"]))
    method = f"{len(psds)} scans joined: {widest.attrs['method']}"
    quality = _quality(psds, grid)
    of_scans = density * share * np.array([_relative_noise_change(psd, grid) for psd in psds])
    of_noises = np.array([of_scans[instrument == number].sum(axis=0) for number in np.unique(instrument)])
    result = spectrum_dataset(
        spectrum,
        fit(*spectrum),
        quality,
        form="measured",
        method=method,
        noise_changes=of_noises[of_noises.any(axis=1)],
    )
    result = result.assign({name: widest[name].variable for name in _SCALARS if name in widest})
    longest = min(psds, key=lambda psd: float(psd["band_low"]))
    result = result.assign(
        {name: longest[name].variable for name in ("long_sigma", "long_sigma_u", "long_slope") if name in longest}
    )
    if "psd_planar" in widest:
        result = result.merge(widest[["psd_planar"]])
    for end in ("low", "high"):
        result[f"scan_band_{end}"] = ("scan", [float(psd[f"band_{end}"]) for psd in psds])
    result = result.assign_coords(scan=np.arange(1.0, len(psds) + 1))
    bands = "; ".join(f"{float(psd['band_low']):.3g} to {float(psd['band_high']):.3g} µm⁻¹" for psd in psds)
    result = vocabulary.add_history(result, f"The spectra of {len(psds)} scans were joined, of the bands {bands}.")
    warnings = dict.fromkeys(text for psd in psds for text in vocabulary.warnings(psd))
    return vocabulary.label(vocabulary.add_warning(result, *warnings, *_gap(grid), *_disagreements(psds)), "psd")


def _on_grid(psd: xr.Dataset, grid: Array) -> tuple[Array, Array]:
    """Logarithm and relative uncertainty of a spectrum at the frequencies of its band; NaN and 1 outside."""
    frequency, density = psd["frequency"].values, psd["psd"].values
    inside = (grid >= frequency[0] * (1 - 1e-9)) & (grid <= frequency[-1] * (1 + 1e-9))
    logs = np.interp(np.log(grid), np.log(frequency), np.log(density))
    relative = np.interp(np.log(grid), np.log(frequency), psd["psd_uncertainty"].values / density)
    return np.where(inside, logs, np.nan), np.where(inside, np.maximum(relative, 1e-6), 1.0)


def _relative_noise_change(psd: xr.Dataset, grid: Array) -> Array:
    """Relative change of a spectrum at frequencies as its noise grows by its standard uncertainty."""
    if NOISE_CHANGES not in psd:
        return np.zeros(grid.size)
    # A joined spectrum has the noise of several instruments.
    change = psd[NOISE_CHANGES].values.sum(axis=0) / psd["psd"].values
    return np.interp(np.log(grid), np.log(psd["frequency"].values), change)


def _quality(psds: Sequence[xr.Dataset], grid: Array) -> NDArray[np.int8]:
    """``measured`` where any of the spectra is."""
    measured = np.zeros(grid.size, dtype=bool)
    for psd in psds:
        frequency = psd["frequency"].values
        nearest = np.abs(np.log(grid[:, None] / frequency)).argmin(axis=1)
        inside = (grid >= frequency[0] * (1 - 1e-9)) & (grid <= frequency[-1] * (1 + 1e-9))
        measured |= inside & (psd["psd_quality"].values[nearest] == vocabulary.quality("measured"))
    return np.where(measured, vocabulary.quality("measured"), vocabulary.quality("interpolated")).astype(np.int8)


def _gap(grid: Array) -> list[str]:
    step = np.diff(np.log10(grid))
    widest = int(np.argmax(step))
    if step[widest] <= 2.5 / RINGS_PER_DECADE:
        return []
    return [
        f"the bands of the scans leave a gap: no scan measures the roughness spectrum between {grid[widest]:.3g} and {grid[widest + 1]:.3g} µm⁻¹; "
        "add a scan of a magnification between (`surface.scans`)"
    ]


def _disagreements(psds: Sequence[xr.Dataset]) -> list[str]:
    """Warnings of pairs of spectra that differ in their common band, by the weighted mean of the logarithm of their ratio."""
    warnings = []
    for (one, first), (two, second) in combinations(enumerate(psds, start=1), 2):
        low = max(float(first["band_low"]), float(second["band_low"]))
        high = min(float(first["band_high"]), float(second["band_high"]))
        if high <= low * 1.2:
            continue
        grid = np.geomspace(low, high, int(np.ceil(RINGS_PER_DECADE * np.log10(high / low))) + 1)
        (a, u_a), (b, u_b) = _on_grid(first, grid), _on_grid(second, grid)
        both = np.isfinite(a + b)
        weight = 1 / (u_a[both] ** 2 + u_b[both] ** 2)
        ratio = float((weight * (b - a)[both]).sum() / weight.sum())
        if abs(ratio) > max(np.log1p(_DISAGREEMENT), _SIGNIFICANT / np.sqrt(weight.sum())):
            warnings.append(
                f"the roughness spectra of scans {one} and {two} differ by a factor of {np.exp(abs(ratio)):.2g} between {low:.3g} and {high:.3g} µm⁻¹, "
                f"scan {two if ratio > 0 else one} being the rougher; check their heights' calibration, and that they show the same finish"
            )
    return warnings
