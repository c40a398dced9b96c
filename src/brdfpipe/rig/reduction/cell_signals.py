"""Sums of the merged pictures over cells, without their glare, and their uncertainties."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import sparse

from brdfpipe import vocabulary
from brdfpipe.geometry import Array
from brdfpipe.rig import screen as screens
from brdfpipe.rig.description import Rig, Screen
from brdfpipe.rig.reduction import cells as rig_cells
from brdfpipe.rig.reduction import glare as glares
from brdfpipe.rig.reduction import pictures, thumbnails
from brdfpipe.rig.reduction.brackets import Scale
from brdfpipe.rig.reduction.cells import cell_sums
from brdfpipe.rig.reduction.curvature import curvature_correction, curvature_u
from brdfpipe.rig.reduction.exposures import Mask, Merged
from brdfpipe.rig.reduction.registration import Registration

_BELOW_NOISE = 2.0  # ratio of a cell's light to its noise below which it is below the noise
_WHOLE = 0.98  # smallest share of a cell within the picture, and within the rim of the disc, that is not vignetted


def cell_signals(
    rig: Rig,
    registration: Registration,
    wavelengths: Array,
    merged: list[Merged | None],
    scales: list[Scale],
    repeat_u: float,
) -> xr.Dataset:
    """Mean light of each cell at each wavelength, its uncertainty components and quality.

    ``merged`` has a picture for each wavelength, None without a reference; ``repeat_u`` is the relative uncertainty of light over its reference.
    """
    cells, weights = rig_cells.cells_of(rig), rig_cells.weights(rig, registration.screen)
    area, whole = _cell_areas(rig, registration.screen, cells, weights)
    lit = [index for index, picture in enumerate(merged) if picture is not None]
    shown = [picture for picture in merged if picture is not None]
    background = pictures.background(rig, registration.screen)
    light = np.array([pictures.fill_saturated(picture) for picture in shown], dtype=float)
    halo = glares.estimate(*pictures.lamp_weighted_mean(merged, scales), background)
    clean = glares.subtract(light, halo)
    clean -= clean[:, background].mean(axis=1)[:, None, None] if background.any() else 0.0
    correction, bends = curvature_correction(rig, registration, weights, clean, area, cells.of_disc)
    signal = cell_sums(weights, clean) - correction
    saturated = cell_sums(weights, np.array([picture.saturated for picture in shown], dtype=float)) > 0
    reference_u, nd_u = _frame_uncertainties(weights, clean, shown, [scales[index] for index in lit])
    variance = np.array([np.nan_to_num(picture.variance) for picture in shown])
    # Each picture's light over that of their mean; a black picture may be all noise, and counts as 0 at least.
    total = np.maximum(clean.reshape(len(clean), -1).sum(axis=1, keepdims=True), 0.0)
    brightness = total / max(float(total.mean()), 1e-300)
    u = {
        # The noise of the light is in its curvature too.
        "noise": np.sqrt(cell_sums((weights - bends).power(2), variance)),
        "repeat": repeat_u * np.abs(signal),
        "reference": reference_u * np.abs(signal),
        "nd": nd_u * np.abs(signal),
        "glare": brightness * glares.uncertainty(clean.mean(axis=0), halo, weights),
        "geometry": np.hypot(
            _misregistration(rig, registration, weights, clean, cells.of_disc), curvature_u(correction, signal)
        ),
    }
    missing = saturated | ~whole
    values = {"signal": signal} | {f"signal_u_{name}": component for name, component in u.items()}
    spectra = {name: np.full((len(merged), len(area)), np.nan) for name in values}
    for name, sums in values.items():
        spectra[name][lit] = np.where(missing, np.nan, sums / np.maximum(area, 1e-9))
    quality = np.full((len(merged), len(area)), vocabulary.quality("below_noise"), dtype=np.int8)
    quality[lit] = _quality(signal, u["noise"], saturated, whole)
    drawing = thumbnails.drawing(light.mean(axis=0), rig, registration.screen, weights)
    drawing.attrs["glare_share"] = halo.share if np.isfinite(halo.misfit) else np.nan
    return drawing.assign(
        {name: (("wavelength", "cell"), field) for name, field in spectra.items()}
        | {"signal_quality": (("wavelength", "cell"), quality)}
        | {"reference": ("wavelength", np.array([scale.lamp for scale in scales]))}
        | {"reference_u": ("wavelength", np.array([scale.lamp_u for scale in scales]))}
    ).assign_coords(
        wavelength=("wavelength", wavelengths),
        cell=("cell", np.array(cells.names)),
        kind=("cell", np.array(cells.kinds)),
        theta_s=("cell", cells.theta_s),
        phi_s=("cell", cells.phi_s),
        solid_angle=("cell", cells.solid_angle),
    )


def _quality(signal: Array, noise: Array, saturated: Mask, whole: Mask) -> NDArray[np.int8]:
    """Quality flags (wavelength, cell)."""
    quality = np.full(signal.shape, vocabulary.quality("measured"), dtype=np.int8)
    quality[np.abs(signal) < _BELOW_NOISE * noise] = vocabulary.quality("below_noise")
    quality[saturated] = vocabulary.quality("saturated")
    quality[:, ~whole] = vocabulary.quality("vignetted")
    return quality


def _cell_areas(rig: Rig, screen: Screen, cells: rig_cells.Cells, weights: sparse.csr_array) -> tuple[Array, Mask]:
    """Area that the light of each cell is divided by [pixel], and whether the whole cell is visible.

    A fibre's end is smaller than the circle of its sum: the area is that of the description, the same in every session.
    """
    visible = weights.sum(axis=1)
    radius = rig_cells.fibre_radii(rig, screen)
    fibres = radius.size
    stretch = screen.scale**2 / screens.disc_solid_angle(screen, cells.theta_s[fibres:])
    expected = np.append(np.pi * radius**2, cells.solid_angle[fibres:] * stretch)
    within = np.append(np.ones(fibres), weights[fibres:] @ pictures.within_disc(rig, screen).ravel())
    within[fibres:] /= np.maximum(visible[fibres:], 1e-9)
    nominal = np.pi * rig_cells.fibre_radii(rig, rig.screen) ** 2
    return np.append(nominal, visible[fibres:]), (visible >= 1) & (np.minimum(visible / expected, 1) * within >= _WHOLE)


def _misregistration(
    rig: Rig, registration: Registration, weights: sparse.csr_array, clean: Array, of_disc: Mask
) -> Array:
    """Standard uncertainty of the cells' light from the position of the picture and, on the disc, of the mirror direction.

    The viewing direction of a fibre is taken as described.
    """
    centre_u = np.radians(registration.direction_u) * rig.screen.focal_length * rig.screen.scale
    shift_u = np.hypot(registration.shift_u, np.where(of_disc, centre_u, 0.0))
    down, across = (np.asarray(slope) for slope in np.gradient(clean, axis=(1, 2)))
    return np.hypot(cell_sums(weights, across), cell_sums(weights, down)) * shift_u


def _frame_uncertainties(
    weights: sparse.csr_array, clean: Array, merged: list[Merged], scales: list[Scale]
) -> tuple[Array, Array]:
    """Relative uncertainties (wavelength, cell) of the frames' references and of their filters, by each frame's share in a cell."""
    variances = []
    for light, picture, scale in zip(clean, merged, scales, strict=True):
        shares = cell_sums(weights, picture.shares * np.abs(light))
        shares /= np.maximum(shares.sum(axis=0), 1e-300)
        variances.append([np.einsum("fc,fg,gc->c", shares, part, shares) for part in (scale.reference, scale.filters)])
    reference_u, nd_u = np.sqrt(np.maximum(np.array(variances).swapaxes(0, 1), 0.0))
    return reference_u, nd_u
