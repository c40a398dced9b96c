"""Paints with effect pigments, from their colours at several geometries: representation ``flake``.

Flakes below a clear coat mirror light according to their tilt, so the reflection is modelled as a function of the flake angle θf,
fitted in each linear channel: ρ(θf) = A exp(−θf/B) + C or another named form (:mod:`brdfpipe.flakes.forms`).

``flake``           f = ρ/π, the patent's: ρ is the reflectance factor itself
``flake-physical``  f = (ρ/π) N(i, o)/N(0, 0) with N = T(i, o)/(4 n² cos θ_i' cos θ_o'), single reflection by flakes of one orientation
                    density below a smooth interface; and the gloss of the coat. T is the share of unpolarised light that both passages
                    of the interface let through, s and p apart (:meth:`brdfpipe.bsdf.representations.flake.ClearCoat.share`)

References
----------
Germer & Marx 2004 (Appl. Opt. 43, 1266), flakes below a smooth coat, with polarisation;
Patent US 7,991,596 (DuPont); Walter 2007 (EGSR), the Jacobian of a mirror; Burns 2020, recovery of spectra from colours.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.special import chdtri, ndtri

from brdfpipe import vocabulary
from brdfpipe.bsdf.representations.flake import PHYSICAL, ClearCoat, Flake
from brdfpipe.errors import InputError
from brdfpipe.flakes.fitting import Fit, fit, leave_one_out
from brdfpipe.flakes.forms import Form
from brdfpipe.flakes.refraction import flake_angle, largest_flake_angle
from brdfpipe.geometry import Array
from brdfpipe.spectra import colorimetry

MODELS = ("flake", PHYSICAL)

_SPECTRUM_NODES = 160
"""Flake angles at which the spectrum of the fitted colour is recovered."""
_RECOVERY_Y = 0.01
"""Y at which the spectrum of a chromaticity is recovered: far below 1, where the recovery does not depend on it."""
_CHI_SQUARED_PROBABILITY = 1e-3
"""Probability of a reduced χ² below which there is a warning."""
_OUTLIER = 3.0
"""Misfit of a single value, in standard uncertainties, above which there is a warning."""
_OUTLIER_PROBABILITY = 0.05
"""Probability of that warning by chance; the limit is raised for many values."""
_POOR_COLOUR = 3.0
"""CIEDE2000 between fit and measured colour above which there is a warning."""


def build(
    multiangle: xr.Dataset,
    *,
    index: float = 1.5,
    form: str = "exponential",
    model: str = "flake",
    clear_coat: str | float | None = None,
) -> xr.Dataset:
    """The BSDF of a paint with effect pigments.

    Parameters
    ----------
    multiangle : kind ``multiangle``: colours or reflectance factors at three geometries or more
    index : refractive index of the clear coat, above 1 and below 5
    form : of the decay along the flake angle, a key of :data:`brdfpipe.flakes.forms.FORMS`
    model : ``flake`` or ``flake-physical``
    clear_coat : ``none``, ``smooth``, or the root mean square slope of a rough one; by default ``smooth`` with ``flake-physical``
        and ``none`` with ``flake``, whose ρ includes all the light

    Returns
    -------
    Dataset of kind ``bsdf``, representation ``flake``: ``flake_amplitude`` A, ``flake_decay`` B and ``flake_constant`` C for each
        channel (on the scale of Y = 100) or wavelength; of colours ``flake_spectrum(theta_f, wavelength)``, scaled to Y = 1; per
        geometry ``theta_f_measured``, ``delta_e_00`` of the fit, ``leave_one_out``, and the relative ``misfit`` and
        ``leave_one_out_misfit`` of each channel; ``reduced_chi_squared``, for more than three colours of known uncertainty

    Raises
    ------
    InputError : an impossible index, form, model or coat, too few flake angles, or A, B or C out of range.

    Notes
    -----
    ``docs/model.md`` describes the fit. The uncertainties of A, B and C assume that the form is right, and neglect correlations between
    X, Y and Z. Below the smallest measured flake angle, and above the largest, the reflection is extrapolated
    (:meth:`brdfpipe.bsdf.representations.flake.Flake.quality`).
    """
    vocabulary.validate(multiangle, "multiangle")
    coat, finish = _clear_coat(index, model, clear_coat)
    is_colour = "tristimulus" in multiangle
    name = "tristimulus" if is_colour else "reflectance_factor"
    across = str(multiangle[name].dims[1])
    theta_f, values, share = below_coat(multiangle, coat)
    if (values < 0).any():
        problem = "the gloss of the clear coat alone is more than a measured colour"
        accepted = "a smaller slope, or geometries farther from the mirror direction"
        raise _refusal("clear_coat", problem, f"slope {coat.slope:g}", accepted)
    u = multiangle[f"{name}_u"].values / share if f"{name}_u" in multiangle else None
    fitted = fit(theta_f, values, form, [_channel_title(across, value) for value in multiangle[across].values], u)
    bsdf = xr.Dataset(
        {
            "clear_coat_index": coat.index,
            "flake_amplitude": (("term", across), fitted.amplitude),
            "flake_decay": (("term", across), fitted.decay),
            "flake_constant": (across, fitted.constant),
            **_uncertainties(fitted, across),
            "theta_f_measured": ("geometry", theta_f),
        },
        coords={"geometry": multiangle["geometry"].values, across: multiangle[across].values},
        attrs={
            "representation": Flake.name,
            "model": model,
            "form": form,
            "clear_coat": finish,
            "transmission": "none",
        },
    )
    if coat.slope is not None:
        bsdf["clear_coat_slope"] = coat.slope
    if is_colour:
        bsdf.attrs |= {key: multiangle.attrs[key] for key in ("illuminant", "observer")}
        bsdf = _with_spectra(bsdf, fitted)
    bsdf = _with_errors(bsdf, multiangle, fitted, values, u)
    return vocabulary.label(_with_warnings(bsdf, coat, fitted, 100.0 if is_colour else 1.0), "bsdf")


class BelowCoat(NamedTuple):
    """Colours as they are without the clear coat, at normal incidence and view: what is fitted."""

    theta_f: Array
    """(geometries,) degree"""
    values: Array
    """(geometries, channels); below 0 where the gloss of the coat alone exceeds the colour"""
    share: Array
    """(geometries, 1), by which light without gloss was divided"""


def below_coat(multiangle: xr.Dataset, coat: ClearCoat) -> BelowCoat:
    """Flake angles, and the measured values without the gloss and the losses of a coat."""
    theta_i, phi_i, theta_o, phi_o = (multiangle[name].values for name in ("theta_i", "phi_i", "theta_o", "phi_o"))
    at = theta_i, phi_i, theta_o, phi_o
    is_colour = "tristimulus" in multiangle
    white = colorimetry.weights(*viewing_of(multiangle)).white if is_colour else np.array([1.0])
    measured = multiangle["tristimulus" if is_colour else "reflectance_factor"].values
    share = coat.share(*at)[:, None]
    return BelowCoat(flake_angle(*at, coat.index), (measured - np.pi * coat.gloss(*at)[:, None] * white) / share, share)


def _clear_coat(index: float, model: str, clear_coat: str | float | None) -> tuple[ClearCoat, str]:
    if model not in MODELS:
        raise _refusal("model", "unknown model", repr(model)[:40], ", ".join(MODELS))
    if isinstance(index, bool) or not isinstance(index, int | float | np.number) or not 1 < index < 5:
        raise _refusal("index", "invalid refractive index of the clear coat", repr(index)[:40], "above 1 and below 5")
    physical = model == PHYSICAL
    finish = ("smooth" if physical else "none") if clear_coat is None else clear_coat
    slope = float(finish) if isinstance(finish, int | float) and not isinstance(finish, bool) else None
    if slope is None and finish not in ("none", "smooth"):
        raise _refusal("clear_coat", "unknown clear coat", repr(finish)[:40], "none, smooth, or its rms slope")
    if slope is not None and not 1e-4 <= slope <= 1:
        raise _refusal("clear_coat", "invalid rms slope of the clear coat", f"{slope:g}", "0.0001 to 1")
    if finish != "none" and not physical:
        problem = "the model `flake` includes all measured light; additional gloss would violate energy conservation"
        raise _refusal("clear_coat", problem, repr(finish), "none, or `model: flake-physical`")
    return ClearCoat(float(index), physical, slope), "rough" if slope is not None else str(finish)


def _channel_title(across: str, value: Any) -> str:
    return f"{value}" if across == "channel" else f"{value:g} nm"


def _uncertainties(fitted: Fit, across: str) -> dict[str, tuple[tuple[str, ...], Array]]:
    names = [f"{symbol}{term + 1}" for term in range(fitted.form.terms) for symbol in "AB"] + ["C"]
    if np.isnan(fitted.covariance).all():
        return {}
    spread = np.sqrt(np.diagonal(fitted.covariance, axis1=1, axis2=2)).T
    return {
        "flake_amplitude_u": (("term", across), spread[0:-1:2]),
        "flake_decay_u": (("term", across), spread[1:-1:2]),
        "flake_constant_u": ((across,), spread[-1]),
        "flake_covariance": ((across, "parameter", "parameter_2"), fitted.covariance),
        "parameter": (("parameter",), np.array(names)),
    }


def _with_spectra(bsdf: xr.Dataset, fitted: Fit) -> xr.Dataset:
    """Add the spectrum of the fitted chromaticity at each flake angle, scaled to Y = 1."""
    measured = bsdf["theta_f_measured"].values
    stretched = np.expm1(np.linspace(0, 3, _SPECTRUM_NODES + 1)) / np.expm1(3.0)
    nodes = largest_flake_angle(float(bsdf["clear_coat_index"])) * stretched
    # A measured angle replaces the node next to it, so that measured colours do not depend on interpolation.
    nodes = np.unique(np.concatenate([nodes[np.abs(nodes[:, None] - measured).min(axis=1) > 0.02], measured]))
    nodes = nodes[np.concatenate([[True], np.diff(nodes) > 1e-6])]
    xyz = fitted(nodes)
    visible = xyz[:, 1] > 0
    table = colorimetry.weights(bsdf.attrs["illuminant"], int(bsdf.attrs["observer"]))
    spectrum, reached = spectra_of_chromaticity(xyz, table)
    if reached.any():
        index = np.flatnonzero(reached)
        nearest = index[np.abs(nodes[:, None] - nodes[index]).argmin(axis=1)]
        spectrum = spectrum[np.where(reached, np.arange(nodes.size), nearest)]
    else:
        spectrum = np.ones_like(spectrum)
    bsdf = bsdf.assign_coords(theta_f=nodes, wavelength=table.wavelength)
    bsdf["flake_spectrum"] = (("theta_f", "wavelength"), spectrum)
    impossible = nodes[visible & ~reached]
    if impossible.size:
        bsdf = vocabulary.add_warning(
            bsdf,
            f"no reflectance has the fitted colour at flake angles of {impossible.min():.3g} to {impossible.max():.3g} degree; the colour "
            "of the nearest angle is used: check the colours, or measure more geometries",
        )
    return vocabulary.add_history(
        bsdf,
        f"spectra recovered from fitted X, Y, Z ({bsdf.attrs['illuminant']}, {bsdf.attrs['observer']} degree) at {nodes.size} flake "
        "angles, with the smallest slope of the logarithm; exact under this illuminant, a guess under others",
    )


def spectra_of_chromaticity(xyz: Array, table: colorimetry.Weights) -> tuple[Array, NDArray[np.bool_]]:
    """Spectra (colours, wavelength) of Y = 1 with the chromaticity of X, Y, Z (colours, 3), and which colours have one."""
    from brdfpipe.spectra.recovery_methods.lhtss import lhtss

    visible = xyz[:, 1] > 0
    chromaticity = np.where(visible[:, None], xyz / np.where(visible, xyz[:, 1], 1.0)[:, None], np.nan)
    recovered = lhtss(100 * _RECOVERY_Y * np.nan_to_num(chromaticity), table)
    return recovered.reflectance / _RECOVERY_Y, recovered.reached & visible


def _with_errors(bsdf: xr.Dataset, multiangle: xr.Dataset, fitted: Fit, values: Array, u: Array | None) -> xr.Dataset:
    theta_f = bsdf["theta_f_measured"].values
    model, left_out = fitted(theta_f), leave_one_out(theta_f, values, bsdf.attrs["form"], u)
    dims = ("geometry", "channel" if "channel" in multiangle.dims else "wavelength")
    if u is not None:
        bsdf = _with_chi_squared(bsdf, (model - values) / u, fitted.form, dims[1])
    not_black = np.where(values > 0, values, np.nan)
    bsdf["misfit"] = (dims, model / not_black - 1)
    bsdf["leave_one_out_misfit"] = (dims, left_out / not_black - 1)
    measured, predicted, without = (_lab(multiangle, part) for part in (values, model, np.nan_to_num(left_out)))
    bsdf["delta_e_00"] = ("geometry", colorimetry.delta_e_00(measured, predicted))
    difference = colorimetry.delta_e_00(measured, without)
    bsdf["leave_one_out"] = ("geometry", np.where(np.isnan(left_out).any(axis=1), np.nan, difference))
    return bsdf


def _with_chi_squared(bsdf: xr.Dataset, misfit: Array, form: Form, across: str) -> xr.Dataset:
    """Add the reduced χ² of each channel, and warnings of misfits that are improbable by chance; misfits over uncertainties."""
    # The functions behind those of scipy.stats, whose import takes longer than the fit.
    freedom = len(misfit) - form.parameters
    if freedom > 0:
        reduced = (misfit**2).sum(axis=0) / freedom
        text = "sum of squared misfits over their uncertainties, over the degrees of freedom"
        bsdf["reduced_chi_squared"] = ((across,), reduced, {"units": "1", "long_name": text})
        if reduced.max() > chdtri(freedom, _CHI_SQUARED_PROBABILITY / reduced.size) / freedom:
            bsdf = vocabulary.add_warning(
                bsdf,
                f"the fit misses the colours by more than their uncertainties (reduced χ² up to {reduced.max():.3g}), so the uncertainties "
                f"of A, B and C are too small: try another `multiangle.form` ({form.others}), or check the uncertainties of the colours",
            )
    misfit = np.abs(misfit)
    # Of hundreds of wavelengths some exceed 3 u by chance.
    outlier = misfit > max(_OUTLIER, -float(ndtri(_OUTLIER_PROBABILITY / (2 * misfit.size))))
    if not outlier.any():
        return bsdf
    geometry, channel = np.unravel_index(int(misfit.argmax()), misfit.shape)
    return vocabulary.add_warning(
        bsdf,
        f"the fit misses {int(outlier.sum())} of {outlier.size} values by more than {_OUTLIER:g} standard uncertainties, "
        f"{_channel_title(across, bsdf[across].values[channel])} at {bsdf['geometry'].values[geometry]} by {misfit.max():.3g}: try "
        f"another `multiangle.form` ({form.others}), or check the uncertainties",
    )


def viewing_of(multiangle: xr.Dataset) -> tuple[str, int]:
    """Illuminant and observer of the colours."""
    return str(multiangle.attrs.get("illuminant", "D65")), int(multiangle.attrs.get("observer", 10))


def _lab(multiangle: xr.Dataset, values: Array) -> Array:
    viewing = viewing_of(multiangle)
    if "channel" not in multiangle.dims:
        values = colorimetry.reflectance_to_xyz(multiangle["wavelength"].values, values, *viewing)
    return colorimetry.xyz_to_lab(values, colorimetry.weights(*viewing).white)


def _with_warnings(bsdf: xr.Dataset, coat: ClearCoat, fitted: Fit, unit: float) -> xr.Dataset:
    measured = bsdf["theta_f_measured"].values
    warnings = [
        f"flake angles below {measured.min():.3g} and above {measured.max():.3g} degree were not measured: the reflection near the gloss "
        "and far from it is extrapolated; add geometries there if it matters"
    ]
    worst = float(bsdf["delta_e_00"].max())
    if worst > _POOR_COLOUR:
        name = str(bsdf["geometry"].values[int(bsdf["delta_e_00"].values.argmax())])
        warnings.append(
            f"the fit misses the colour at {name} by ΔE00 = {worst:.1f}: try another `multiangle.form` ({fitted.form.others})"
        )
    if coat.physical:
        reflectance = _flake_reflectance(fitted, coat, unit)
        if reflectance > 1:
            warnings.append(
                f"the reflectance of the flakes is {reflectance:.2f}, above 1: check the scale of the colours (`multiangle.scale`)"
            )
        bsdf = bsdf.assign_attrs(flake_reflectance=round(reflectance, 6))
    clamped = fitted.constant == 0
    if clamped.any() and measured.size > fitted.form.parameters:
        text = f"the constant C was held at 0 in {int(clamped.sum())} of {clamped.size} channels"
        bsdf = vocabulary.add_history(bsdf, text)
    return vocabulary.add_warning(bsdf, *warnings)


def _flake_reflectance(fitted: Fit, coat: ClearCoat, unit: float) -> float:
    """Reflectance of the flakes times their cover: ∫ D cos θf dω over the visible flake angles, mean over wavelength or of Y."""
    theta = np.linspace(0, largest_flake_angle(coat.index), 2001)
    rho = fitted(theta) / unit
    mean = rho[:, 1] if rho.shape[1] == 3 and unit == 100 else rho.mean(axis=1)
    density = mean * 4 * coat.index**2 / (np.pi * coat.normal_transmittance**2)
    angle = np.radians(theta)
    return float(np.trapezoid(density * np.cos(angle) * 2 * np.pi * np.sin(angle), angle))


def _refusal(key: str, problem: str, found: str, accepted: str) -> InputError:
    return InputError(
        "material.yaml", problem, where=f"multiangle.{key}", found=found, accepted=accepted, key=f"multiangle.{key}"
    )
