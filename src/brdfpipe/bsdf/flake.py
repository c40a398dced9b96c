"""Paints with effect pigments, from their colours at several geometries: representation ``flake``.

Flakes below a clear coat mirror light by their tilt, so the reflection is taken as a function of the flake angle θf alone, fitted
in each linear channel: ρ(θf) = A exp(−θf/B) + C or another named form (:mod:`brdfpipe.flakes.forms`).

``flake``           f = ρ/π, the patent's: ρ is the reflectance factor itself
``flake-physical``  f = (ρ/π) N(θi, θo)/N(0, 0) with N = (1−F_i)(1−F_o)/(4 n² cos θ_i' cos θ_o'), what single flakes of one
                    orientation density send through the smooth interface; and the gloss of the coat

References
----------
Patent US 7,991,596 (DuPont); Walter 2007 (EGSR), the Jacobian of a mirror; Burns 2020, recovery of spectra from colours.
"""

from __future__ import annotations

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.bsdf.representations.flake import PHYSICAL, ClearCoat, Flake
from brdfpipe.errors import InputError
from brdfpipe.flakes.fitting import Fit, fit, leave_one_out
from brdfpipe.flakes.forms import Form
from brdfpipe.flakes.refraction import flake_angle, largest_flake_angle
from brdfpipe.geometry import Array
from brdfpipe.spectra import colorimetry

MODELS = ("flake", PHYSICAL)

_STEPS = 160
_DIM = 0.01
"""Y at which the spectrum of a chromaticity is recovered: far from 1, where recovery does not depend on it."""
_CHANCE = 1e-3
"""Probability below which a misfit is no chance."""
_MISSED = 3.0
"""Over its standard uncertainty, from where on the misfit of a single value is warned about."""
_SOME_CHANCE = 0.05
"""Probability that chance alone makes that warning, where there are so many values that 3 would be exceeded more often."""
_POOR = 3.0
"""CIEDE2000 of the fit from a measured colour, from where on it is warned about."""


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
    form : of the fall along the flake angle, a key of :data:`brdfpipe.flakes.forms.FORMS`
    model : ``flake`` or ``flake-physical``
    clear_coat : ``none``, ``smooth``, or the root mean square slope of a rough one; by default ``smooth`` with ``flake-physical``
        and ``none`` with ``flake``, whose ρ holds all the light already

    Returns
    -------
    Dataset of kind ``bsdf``, representation ``flake``: ``flake_amplitude`` A, ``flake_decay`` B and ``flake_constant`` C a
        channel (on the scale of Y = 100) or a wavelength; of colours, ``flake_spectrum(theta_f, wavelength)``, the spectrum of the
        chromaticity at each flake angle, of Y = 1; per geometry ``theta_f_measured``, ``delta_e_00`` of the fit and
        ``leave_one_out``, and relative ``misfit`` and ``leave_one_out_misfit`` a channel; ``reduced_chi_squared`` a channel of more
        than three colours of known uncertainty

    Raises
    ------
    InputError : an index, form, model or coat that cannot be, too few flake angles, or A, B or C out of range.

    Notes
    -----
    A fit to three geometries is exact; to more it is of least squares, over the uncertainties where they are known and else over
    the values. The uncertainties of A, B and C hold where the form does; those of X, Y and Z of one geometry are not taken to hang
    together, since every channel is fitted alone. The reflection below the smallest flake angle measured, and above the largest, is
    extrapolated: see :meth:`brdfpipe.bsdf.representations.flake.Flake.quality`. Colours carry no spectrum; the one given back has the smallest slope of its logarithm (LHTSS
    far below 1), so that the fitted X, Y and Z at every flake angle return exactly, however bright.
    """
    vocabulary.validate(multiangle, "multiangle")
    coat, finish = _clear_coat(index, model, clear_coat)
    at = [multiangle[angle].values for angle in ("theta_i", "phi_i", "theta_o", "phi_o")]
    theta_f = flake_angle(at[0], at[1], at[2], at[3], coat.index)
    name = "tristimulus" if "tristimulus" in multiangle else "reflectance_factor"
    across = str(multiangle[name].dims[1])
    unit = 100.0 if name == "tristimulus" else 1.0
    measured = multiangle[name].values
    white = np.array([1.0]) if name == "reflectance_factor" else colorimetry.weights(*_viewing(multiangle)).white
    values = _reduced(measured, coat, at, white)
    doubt = (
        None if f"{name}_u" not in multiangle else multiangle[f"{name}_u"].values / coat.share(at[0], at[2])[:, None]
    )
    titles = [f"{each}" if across == "channel" else f"{each:g} nm" for each in multiangle[across].values]
    found = fit(theta_f, values, form, titles, doubt)
    bsdf = xr.Dataset(
        {
            "clear_coat_index": coat.index,
            "flake_amplitude": (("term", across), found.amplitude),
            "flake_decay": (("term", across), found.decay),
            "flake_constant": (across, found.constant),
            **_uncertainties(found, across),
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
    if name == "tristimulus":
        bsdf.attrs |= {key: multiangle.attrs[key] for key in ("illuminant", "observer")}
        bsdf = _with_spectra(bsdf, found)
    bsdf = _with_errors(bsdf, multiangle, found, values, doubt)
    return vocabulary.label(_with_warnings(bsdf, coat, found, unit), "bsdf")


def _clear_coat(index: float, model: str, clear_coat: str | float | None) -> tuple[ClearCoat, str]:
    if model not in MODELS:
        raise _refusal("model", "unknown model", repr(model)[:40], ", ".join(MODELS))
    if isinstance(index, bool) or not isinstance(index, int | float | np.number) or not 1 < index < 5:
        raise _refusal("index", "no refractive index of a clear coat", repr(index)[:40], "above 1 and below 5")
    physical = model == PHYSICAL
    finish = ("smooth" if physical else "none") if clear_coat is None else clear_coat
    slope = float(finish) if isinstance(finish, int | float) and not isinstance(finish, bool) else None
    if slope is None and finish not in ("none", "smooth"):
        raise _refusal("clear_coat", "unknown clear coat", repr(finish)[:40], "none, smooth, or its rms slope")
    if slope is not None and not 1e-4 <= slope <= 1:
        raise _refusal("clear_coat", "no slope of a clear coat", f"{slope:g}", "0.0001 to 1")
    if finish != "none" and not physical:
        problem = "the model `flake` takes the measured light for all there is; a gloss on top of it would break energy"
        raise _refusal("clear_coat", problem, repr(finish), "none, or `model: flake-physical`")
    return ClearCoat(float(index), physical, slope), "rough" if slope is not None else str(finish)


def _reduced(measured: Array, coat: ClearCoat, at: list[Array], white: Array) -> Array:
    """The measured values without gloss, as at normal incidence and view."""
    below = measured - np.pi * coat.gloss(at[0], at[1], at[2], at[3])[:, None] * white
    if (below < 0).any():
        problem = "the gloss of the clear coat alone is more than a measured colour"
        raise _refusal(
            "clear_coat", problem, f"slope {coat.slope:g}", "a smaller slope, or geometries farther from the mirror"
        )
    return np.asarray(below / coat.share(at[0], at[2])[:, None])


def _uncertainties(found: Fit, across: str) -> dict[str, tuple[tuple[str, ...], Array]]:
    names = [f"{symbol}{term + 1}" for term in range(found.form.terms) for symbol in "AB"] + ["C"]
    if np.isnan(found.covariance).all():
        return {}
    spread = np.sqrt(np.diagonal(found.covariance, axis1=1, axis2=2)).T
    return {
        "flake_amplitude_u": (("term", across), spread[0:-1:2]),
        "flake_decay_u": (("term", across), spread[1:-1:2]),
        "flake_constant_u": ((across,), spread[-1]),
        "flake_covariance": ((across, "parameter", "parameter_2"), found.covariance),
        "parameter": (("parameter",), np.array(names)),
    }


def _with_spectra(bsdf: xr.Dataset, found: Fit) -> xr.Dataset:
    """Add the spectrum of the fitted chromaticity at each flake angle, of Y = 1."""
    from brdfpipe.spectra.recovery_methods.lhtss import lhtss

    measured = bsdf["theta_f_measured"].values
    stretched = np.expm1(np.linspace(0, 3, _STEPS + 1)) / np.expm1(3.0)
    nodes = largest_flake_angle(float(bsdf["clear_coat_index"])) * stretched
    # A measured angle replaces the node next to it, so that measured colours do not depend on what lies between nodes.
    nodes = np.unique(np.concatenate([nodes[np.abs(nodes[:, None] - measured).min(axis=1) > 0.02], measured]))
    nodes = nodes[np.concatenate([[True], np.diff(nodes) > 1e-6])]
    xyz = found(nodes)
    seen = xyz[:, 1] > 0
    chromaticity = np.where(seen[:, None], xyz / np.where(seen, xyz[:, 1], 1.0)[:, None], np.nan)
    viewing = {"illuminant": bsdf.attrs["illuminant"], "observer": int(bsdf.attrs["observer"])}
    recovered = lhtss(100 * _DIM * np.nan_to_num(chromaticity), **viewing)
    reached = recovered.reached & seen
    spectrum = recovered.reflectance / _DIM
    if reached.any():
        index = np.flatnonzero(reached)
        nearest = index[np.abs(nodes[:, None] - nodes[index]).argmin(axis=1)]
        spectrum = spectrum[np.where(reached, np.arange(nodes.size), nearest)]
    else:
        spectrum = np.ones_like(spectrum)
    bsdf = bsdf.assign_coords(theta_f=nodes, wavelength=recovered.wavelength)
    bsdf["flake_spectrum"] = (("theta_f", "wavelength"), spectrum)
    missed = nodes[seen & ~reached]
    if missed.size:
        bsdf = vocabulary.add_warning(
            bsdf,
            f"no light has the colour that the fit gives at flake angles of {missed.min():.3g} to {missed.max():.3g} degree; that of the "
            "nearest angle is taken: check the colours, or measure more geometries",
        )
    return vocabulary.add_history(
        bsdf,
        f"spectra recovered from fitted X, Y, Z ({bsdf.attrs['illuminant']}, {bsdf.attrs['observer']} degree) at {nodes.size} flake "
        "angles: the smallest slope of the logarithm; colours under this illuminant are exact, under others they are a guess",
    )


def _with_errors(
    bsdf: xr.Dataset, multiangle: xr.Dataset, found: Fit, values: Array, doubt: Array | None
) -> xr.Dataset:
    theta_f = bsdf["theta_f_measured"].values
    fitted, left_out = found(theta_f), leave_one_out(theta_f, values, bsdf.attrs["form"], doubt)
    dims = ("geometry", "channel" if "channel" in multiangle.dims else "wavelength")
    if doubt is not None and theta_f.size > found.form.parameters:
        bsdf = _with_chi_squared(bsdf, (fitted - values) / doubt, found.form, dims[1])
    if doubt is not None:
        bsdf = _with_misses(bsdf, np.abs(fitted - values) / doubt, found.form)
    black = np.where(values > 0, values, np.nan)
    bsdf["misfit"] = (dims, fitted / black - 1)
    bsdf["leave_one_out_misfit"] = (dims, left_out / black - 1)
    colours = [_lab(multiangle, each) for each in (values, fitted, np.nan_to_num(left_out))]
    bsdf["delta_e_00"] = ("geometry", colorimetry.delta_e_00(colours[0], colours[1]))
    difference = colorimetry.delta_e_00(colours[0], colours[2])
    bsdf["leave_one_out"] = ("geometry", np.where(np.isnan(left_out).any(axis=1), np.nan, difference))
    return bsdf


def _with_chi_squared(bsdf: xr.Dataset, misfit: Array, form: Form, across: str) -> xr.Dataset:
    """Add the reduced χ² of each channel, and a warning where chance would hardly make it as large."""
    from scipy.stats import chi2

    freedom = len(misfit) - form.parameters
    reduced = (misfit**2).sum(axis=0) / freedom
    words = {"units": "1", "long_name": "sum of squared misfits over their uncertainties, over the degrees of freedom"}
    bsdf["reduced_chi_squared"] = ((across,), reduced, words)
    if reduced.max() <= chi2.isf(_CHANCE / reduced.size, freedom) / freedom:
        return bsdf
    return vocabulary.add_warning(
        bsdf,
        f"the fit misses the colours by more than their uncertainties (reduced χ² up to {reduced.max():.3g}), so that those of A, B "
        f"and C are too small: try another `multiangle.form` ({form.others}), or check the uncertainties",
    )


def _with_misses(bsdf: xr.Dataset, misfit: Array, form: Form) -> xr.Dataset:
    """Add a warning where single values are missed by far more than their uncertainties, which no degree of freedom need tell."""
    from scipy.stats import norm

    # Of hundreds of wavelengths some lie beyond 3 u by chance.
    missed = misfit > max(_MISSED, float(norm.isf(_SOME_CHANCE / (2 * misfit.size))))
    if not missed.any():
        return bsdf
    geometry, channel = np.unravel_index(int(misfit.argmax()), misfit.shape)
    across = "channel" if "channel" in bsdf["flake_constant"].dims else "wavelength"
    title = f"{bsdf[across].values[channel]}" if across == "channel" else f"{bsdf[across].values[channel]:g} nm"
    return vocabulary.add_warning(
        bsdf,
        f"the fit misses {int(missed.sum())} of {missed.size} values by more than {_MISSED:g} standard uncertainties, {title} at "
        f"{bsdf['geometry'].values[geometry]} by {misfit.max():.3g}: try another `multiangle.form` ({form.others}), or check the "
        "uncertainties",
    )


def _viewing(multiangle: xr.Dataset) -> tuple[str, int]:
    return str(multiangle.attrs.get("illuminant", "D65")), int(multiangle.attrs.get("observer", 10))


def _lab(multiangle: xr.Dataset, values: Array) -> Array:
    viewing = _viewing(multiangle)
    white = colorimetry.weights(*viewing).white
    if "channel" in multiangle.dims:
        return colorimetry.xyz_to_lab(values, white)
    return colorimetry.xyz_to_lab(
        colorimetry.reflectance_to_xyz(multiangle["wavelength"].values, values, *viewing), white
    )


def _with_warnings(bsdf: xr.Dataset, coat: ClearCoat, found: Fit, unit: float) -> xr.Dataset:
    known = bsdf["theta_f_measured"].values
    sentences = [
        f"flake angles below {known.min():.3g} and above {known.max():.3g} degree were not measured: near the gloss and far from it the "
        "reflection is extrapolated; measure geometries there if that matters"
    ]
    worst = float(bsdf["delta_e_00"].max())
    if worst > _POOR:
        name = str(bsdf["geometry"].values[int(bsdf["delta_e_00"].values.argmax())])
        sentences.append(
            f"the fit misses the colour at {name} by ΔE00 = {worst:.1f}: try another `multiangle.form` ({found.form.others})"
        )
    if coat.physical:
        share = _mirror_share(found, coat, unit)
        if share > 1:
            sentences.append(
                f"the flakes would mirror {share:.2f} of the light that meets them, more than all: check the scale of the colours"
            )
        bsdf = bsdf.assign_attrs(flake_reflectance=round(share, 6))
    clamped = found.constant == 0
    if clamped.any() and known.size > found.form.parameters:
        bsdf = vocabulary.add_history(
            bsdf, f"the constant C was held at 0 in {int(clamped.sum())} of {clamped.size} channels"
        )
    return vocabulary.add_warning(bsdf, *sentences)


def _mirror_share(found: Fit, coat: ClearCoat, unit: float) -> float:
    """Reflectance of the flakes times their cover: ∫ D cos θf dω, mean over wavelength or of Y; C beyond the reach of light left out."""
    theta = np.linspace(0, largest_flake_angle(coat.index), 2001)
    rho = found(theta) / unit
    mean = rho[:, 1] if rho.shape[1] == 3 and unit == 100 else rho.mean(axis=1)
    density = mean * 4 * coat.index**2 / (np.pi * coat.normal_transmittance**2)
    angle = np.radians(theta)
    return float(np.trapezoid(density * np.cos(angle) * 2 * np.pi * np.sin(angle), angle))


def _refusal(key: str, problem: str, found: str, accepted: str) -> InputError:
    return InputError(
        "material.yaml", problem, where=f"multiangle.{key}", found=found, accepted=accepted, key=f"multiangle.{key}"
    )
