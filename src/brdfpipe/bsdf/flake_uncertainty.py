"""The changes of the BSDF of an effect paint by the uncertainties of its colours, its clear coat and its fit.

A change of a colour, or of the coat above it, changes the values that are fitted; to first order A, B and C of every channel change in proportion
(:func:`brdfpipe.flakes.fitting.sensitivity`). An error of L* of one geometry thus changes X, Y and Z together, and all directions with them.
What the form of the fit misses is a change of its own.

References
----------
JCGM 102:2011, 6.2 and 6.3 (covariance from common inputs); Draper & Smith 1998, *Applied Regression Analysis*, 24.2 (parameters of a nonlinear fit).
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import vocabulary
from brdfpipe.bsdf.change_variables import DIMENSION, MODEL, NOT_STATED, SOURCE
from brdfpipe.bsdf.flake import below_coat, spectra_of_chromaticity, viewing_of
from brdfpipe.bsdf.representations.flake import ClearCoat
from brdfpipe.flakes.fitting import Fit, relative_scale, sensitivity
from brdfpipe.flakes.forms import FORMS
from brdfpipe.flakes.reading import lab_slopes
from brdfpipe.geometry import Array
from brdfpipe.spectra import colorimetry

COLOURS, INDEX, CLEAR_COAT = "colours", "index", "clear_coat"
"""Sources beside the error of the model."""

_KEPT_VARIANCE = 0.999
"""Share of the variance of the misfits that their main components have."""
_LEAST_DECAY = 0.1
"""Decay after a change over that before, at least: what is more uncertain is unknown."""
_CHROMATICITY_STEP = 1e-3
"""Relative step of X/Y and Z/Y in derivatives of a spectrum."""


def uncertainty(
    bsdf: xr.Dataset,
    multiangle: xr.Dataset,
    *,
    scale_uncertainty: float | None = None,
    index_uncertainty: float | None = None,
    clear_coat_uncertainty: float | None = None,
) -> xr.Dataset:
    """Changes of the BSDF of an effect paint by the uncertainties of its inputs.

    Parameters
    ----------
    bsdf : kind ``bsdf``, representation ``flake``
    multiangle : kind ``multiangle``, the colours that it was fitted to, with their uncertainties where these are known
    scale_uncertainty : relative standard uncertainty that all colours have in common
    index_uncertainty, clear_coat_uncertainty : standard uncertainty of the refractive index of the coat, and of its slope

    Returns
    -------
    Dataset of kind ``uncertainty``: changes of ``flake_amplitude``, ``flake_decay``, ``flake_constant``, ``flake_spectrum``, ``clear_coat_index`` and
    ``clear_coat_slope``, from the sources ``colours``, ``index``, ``clear_coat`` and ``model``. The attribute ``uncertainty_not_stated`` names the
    sources that are not known: ``model`` where the fit has as many parameters as there are geometries, so that it cannot miss them

    Raises
    ------
    VocabularyError : a dataset of the wrong kind.

    Notes
    -----
    Of reflectance factors, an error is common to all wavelengths. Colours without a stated uncertainty have that of their scatter about the fit,
    if there are more geometries than parameters. Of ``model``, the relative misfits less what the uncertainties of the colours explain, over the
    degrees of freedom; they hold between the measured flake angles, not beyond.
    """
    vocabulary.validate(bsdf, "bsdf")
    vocabulary.validate(multiangle, "multiangle")
    paint = _Paint(bsdf, multiangle)
    changes: list[_Change] = [(COLOURS, {}, change) for change in paint.by_colours(scale_uncertainty)]
    if index_uncertainty:
        changes.append((INDEX, {"clear_coat_index": index_uncertainty}, paint.by_coat(index=index_uncertainty)))
    if clear_coat_uncertainty and "clear_coat_slope" in bsdf:
        changes.append(
            (CLEAR_COAT, {"clear_coat_slope": clear_coat_uncertainty}, paint.by_coat(slope=clear_coat_uncertainty))
        )
    changes += [(MODEL, {}, change) for change in paint.by_misfit()]
    result = paint.stacked(changes)
    stated = {source for source, _, _ in changes}
    expected = [COLOURS, INDEX, *([CLEAR_COAT] if bsdf.attrs["clear_coat"] != "none" else []), MODEL]
    missing = [source for source in expected if source not in stated]
    return vocabulary.label(result.assign_attrs({NOT_STATED: ", ".join(missing)}), "uncertainty")


_Change: TypeAlias = tuple[str, dict[str, float], Array]
"""Source; change of scalars of the coat; changes of the parameters (…, channels, parameters)."""


class _Paint:
    """A fitted paint, and how its parameters change with its values."""

    def __init__(self, bsdf: xr.Dataset, multiangle: xr.Dataset) -> None:
        self._bsdf, self._multiangle = bsdf, multiangle
        self._name = "tristimulus" if "tristimulus" in multiangle else "reflectance_factor"
        self._coat = ClearCoat.of(bsdf)
        self._theta_f, self._values, self._share = below_coat(multiangle, self._coat)
        amplitude, decay, constant = (bsdf[f"flake_{name}"].values for name in ("amplitude", "decay", "constant"))
        self._fit = Fit(FORMS[bsdf.attrs["form"]], amplitude, decay, constant, np.empty(0))
        u = multiangle.get(f"{self._name}_u")
        self._u = None if u is None else u.values / self._share
        self._sensitivity = sensitivity(self._theta_f, self._values, self._fit, bsdf.attrs["form"], self._u)
        self._freedom = self._theta_f.size - self._fit.form.parameters

    def _of_values(self, change: Array) -> Array:
        """Changes of the parameters (…, channels, parameters) by those of the values (…, geometries, channels)."""
        return np.einsum("kpg,...gk->...kp", self._sensitivity, change)

    def by_colours(self, scale_uncertainty: float | None) -> Array:
        """(changes, channels, parameters)"""
        errors = [self._independent_errors()]
        if scale_uncertainty:
            errors.append(scale_uncertainty * (self._multiangle[self._name].values / self._share)[None])
        changes = self._of_values(np.concatenate(errors))
        rows = changes.reshape(len(changes), self._sensitivity.shape[0] * self._sensitivity.shape[1])
        # Fewer changes of the same covariance.
        return changes if len(rows) <= rows.shape[1] else np.linalg.qr(rows)[1].reshape(-1, *changes.shape[1:])

    def _independent_errors(self) -> Array:
        """Independent errors of the values, (errors, geometries, channels), each of one geometry."""
        multiangle, channels = self._multiangle, self._values.shape[1]
        if self._u is None:
            by_component = relative_scale(self._values)[:, None] * self._misfit_components()
        elif "lab_u" in multiangle:
            white = colorimetry.weights(*viewing_of(multiangle)).white
            lab = colorimetry.xyz_to_lab(multiangle["tristimulus"].values, white)
            by_component = lab_slopes(lab, white) * multiangle["lab_u"].values[:, :, None] / self._share[:, None]
        elif self._name == "tristimulus":
            by_component = self._u[:, None] * np.eye(channels)
        else:
            by_component = self._u[:, None]
        one_geometry = np.eye(self._theta_f.size)[:, None, :, None] * by_component[:, :, None]
        return one_geometry.reshape(-1, self._theta_f.size, channels)

    def by_misfit(self) -> Array:
        """(changes, channels, parameters): every curve higher or lower by what it misses."""
        components = self._misfit_components()
        if self._u is not None and self._freedom > 0:
            reduced = (
                float(np.square((self._fit(self._theta_f) - self._values) / self._u).mean())
                * self._theta_f.size
                / self._freedom
            )
            components = components * np.sqrt(max(0.0, 1 - 1 / max(reduced, 1e-300)))
        # B stays; A of every term and C grow.
        grown = np.zeros((self._values.shape[1], self._fit.form.parameters))
        grown[:, 0:-1:2], grown[:, -1] = self._fit.amplitude.T, self._fit.constant
        return components[:, :, None] * grown

    def _misfit_components(self) -> Array:
        """Independent parts of the relative misfits, (parts, channels); none if there are no degrees of freedom."""
        if self._freedom <= 0:
            return np.empty((0, self._values.shape[1]))
        misfit = (self._fit(self._theta_f) - self._values) / relative_scale(self._values)
        _, sizes, directions = np.linalg.svd(misfit / np.sqrt(self._freedom), full_matrices=False)
        power = np.cumsum(np.square(sizes))
        kept = 1 + int(np.searchsorted(power, _KEPT_VARIANCE * power[-1]))
        return sizes[:kept, None] * directions[:kept]

    def by_coat(self, index: float = 0.0, slope: float = 0.0) -> Array:
        """(1, channels, parameters): the fit to the same colours below another coat."""
        coat = self._coat
        other = replace(coat, index=coat.index + index, slope=None if coat.slope is None else coat.slope + slope)
        moved = below_coat(self._multiangle, other)
        # A shifted flake angle is a change of the value that the curve should have.
        shifted = self._fit(moved.theta_f) - self._fit(self._theta_f)
        return self._of_values((moved.values - self._values - shifted)[None])

    def stacked(self, changes: list[_Change]) -> xr.Dataset:
        """The changes of the dataset's variables, one after another; what a change leaves as it is has 0."""
        rows = [
            (source, scalars, row)
            for source, scalars, block in changes
            for row in np.reshape(block, (-1, *block.shape[-2:]))
        ]
        if not rows:
            return xr.Dataset()
        across = str(self._multiangle[self._name].dims[1])
        by_channel = np.stack([row for _, _, row in rows])
        by_parameter = np.moveaxis(by_channel, 2, 1)
        decay = np.maximum(by_parameter[:, 1:-1:2], (_LEAST_DECAY - 1) * self._fit.decay)
        amplitude, constant = by_parameter[:, 0:-1:2], by_parameter[:, -1]
        fields: dict[str, Any] = {
            "flake_amplitude_change": ((DIMENSION, "term", across), amplitude),
            "flake_decay_change": ((DIMENSION, "term", across), decay),
            "flake_constant_change": ((DIMENSION, across), constant),
        }
        for name in ("clear_coat_index", "clear_coat_slope"):
            if any(name in scalars for _, scalars, _ in rows):
                fields[f"{name}_change"] = (DIMENSION, np.array([scalars.get(name, 0.0) for _, scalars, _ in rows]))
        if "flake_spectrum" in self._bsdf:
            spectrum = np.stack([self._spectrum_change(*one) for one in zip(amplitude, decay, constant, strict=True)])
            fields["flake_spectrum_change"] = ((DIMENSION, "theta_f", "wavelength"), spectrum)
        return xr.Dataset(fields).assign_coords({SOURCE: (DIMENSION, [source for source, _, _ in rows])})

    def _spectrum_change(self, amplitude: Array, decay: Array, constant: Array) -> NDArray[np.float32]:
        """Change of the spectrum of Y = 1 at each flake angle, whose X/Y and Z/Y are those of the changed curves."""
        nodes = self._bsdf["theta_f"].values
        fit = self._fit
        changed = Fit(
            fit.form,
            np.maximum(fit.amplitude + amplitude, 0.0),
            fit.decay + decay,
            np.maximum(fit.constant + constant, 0.0),
            fit.covariance,
        )
        moved = _chromaticity(changed(nodes)) - _chromaticity(fit(nodes))
        return np.asarray(np.einsum("nc,cnw->nw", np.nan_to_num(moved), self._spectrum_slopes), dtype=np.float32)

    @cached_property
    def _spectrum_slopes(self) -> Array:
        """Derivatives of the spectrum of Y = 1 by X/Y and Z/Y, (2, theta_f, wavelength); 0 where no spectrum has the colour."""
        xyz, given = self._fit(self._bsdf["theta_f"].values), self._bsdf["flake_spectrum"].values
        table = colorimetry.weights(*viewing_of(self._multiangle))
        slopes = []
        for channel in (0, 2):
            step = np.where(np.arange(3) == channel, 1 + _CHROMATICITY_STEP, 1.0)
            spectrum, reached = spectra_of_chromaticity(xyz * step, table)
            change = _CHROMATICITY_STEP * xyz[:, channel] / np.where(reached, xyz[:, 1], 1.0)
            reached &= change > 0
            difference = np.where(reached[:, None], spectrum - given, 0.0)
            slopes.append(difference / np.where(reached, change, 1.0)[:, None])
        return np.stack(slopes)


def _chromaticity(xyz: Array) -> Array:
    """X/Y and Z/Y, (…, 2); NaN of black."""
    return np.asarray(xyz[:, [0, 2]] / np.where(xyz[:, 1:2] > 0, xyz[:, 1:2], np.nan))
