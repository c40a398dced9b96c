"""Physical checks of a BSDF: reciprocity, energy conservation, positivity, growth at grazing angles, integral and closure."""

from __future__ import annotations

import json
from typing import NamedTuple

import numpy as np
import xarray as xr

from brdfpipe import hemisphere, vocabulary
from brdfpipe.bsdf import specular_difference
from brdfpipe.bsdf.base import Representation
from brdfpipe.bsdf.grids import Angles, from_mirror
from brdfpipe.bsdf.registry import representation
from brdfpipe.geometry import Array

_PAIRS, _PAIRS_ABOUT_NORMAL, _PROBED_PAIRS = 2048, 1024, 256
_INCIDENCES = np.array([0.0, 8.0, 15.0, 30.0, 45.0, 60.0, 70.0, 75.0, 80.0, 85.0, 88.0, 89.5, 89.9, 89.99])
_FURTHER_INCIDENCES, _FURTHER_INCIDENCES_BY_QUADRATURE = 128, 40
"""Number of further incidences of the energy check; smaller if each needs a quadrature or if light is transmitted."""
_NEAREST, _FURTHEST = 1e-3, 90.0
"""Range of the angles from the mirror direction, or from the normal, of the pairs about these [degree]."""

RECIPROCITY_LIMIT = 1e-9
CLOSURE_LIMIT = 1e-4  # of the incident light: the last digit of a spectrum in percent, with two decimals
CLOSURE_FAIL_LIMIT = 1e-3  # of the incident light: 0.3 of L* of a black plastic
NOT_CLOSED = ("crf", "none")
"""Modes of the diffuse part that do not keep the total reflectance."""
INTEGRAL_LIMIT = 1e-3  # of the incident light: the kinks of a counted density cost the plain quadrature 1e-4
_INTEGRAL_ACCURACY = 1e-4  # estimated, of the plain quadrature; the real error is 100 times smaller
_ONE_WITHOUT_LIGHT = 1.999  # of the mean: 2 where one of two values is 0
GROWTH_LIMIT = 3.0  # 1/cos θ grows tenfold from 89.9 to 89.99°, and a sound BRDF hardly at all
SIGNIFICANCE_LIMIT = 2.0  # standard uncertainties of a measured BSDF beyond which a violation is significant
_BRIGHTEST = 4
"""Number of incidences at which an excess of energy is compared with its uncertainty."""
_NEGLIGIBLE = 1e-12
"""Share of the largest BRDF below which values are not compared: rounding dominates."""


class _Fluxes(NamedTuple):
    """Directional reflectance and transmittance, (incidences, wavelength) each."""

    theta_i: Array
    phi_i: Array
    reflectance: Array
    transmittance: Array

    @property
    def total(self) -> Array:
        return self.reflectance + self.transmittance


class _Residual(NamedTuple):
    """The largest deviation, and where it occurs."""

    size: float
    where: str


def check(bsdf: xr.Dataset, spectrum: xr.Dataset | None = None) -> xr.Dataset:
    """Check a BSDF. A violated law is a verdict, not an error.

    Parameters
    ----------
    bsdf : kind ``bsdf``
    spectrum : kind ``spectrum``; where it has the reflectance with the specular component excluded too, their difference is compared with
        the light that the BSDF mirrors

    Returns
    -------
    Dataset of kind ``checks``; the attribute ``verdicts`` is JSON {name: {verdict: pass|warn|fail, text}}

    Notes
    -----
    Pairs of directions follow a low-discrepancy sequence: uniform over the hemisphere (the sphere if light is transmitted), about the
    mirror directions, and about the normal, the last two on all scales. Each pair is evaluated both ways, at the first, middle and
    last wavelength and at those of the largest and smallest values; positivity includes every node of a table. Energy is checked at
    fixed incidences up to 89.99°, at a low-discrepancy sequence of incidences and at the nodes of a table; from both sides if light
    is transmitted; at several azimuths if there is a lay. The reciprocal quantity is f / n_o², with n_o the index
    of the medium of the outgoing light.

    Energy may exceed 1 by :attr:`brdfpipe.bsdf.base.Representation.albedo_accuracy`.
    """
    vocabulary.validate(bsdf, "bsdf")
    model = representation(bsdf)
    fixed = _fluxes(model, *_fixed_incidences(model), None)
    pairs = _direction_pairs(model.transmits)
    wavelengths = _checked_wavelengths(model, pairs, fixed)
    fluxes = fixed, _fluxes(model, *_further_incidences(model), wavelengths)
    forward, backward = _both_ways(model, pairs, wavelengths)
    values = np.concatenate([forward.ravel(), backward.ravel(), model.stored_values().ravel()])
    residuals = {
        "reciprocity": _reciprocity(forward, backward, pairs),
        "energy": _largest(model, fluxes, [np.nan_to_num(part.total, nan=np.inf).max(axis=1) for part in fluxes]),
        "significance": _energy_significance(model, fluxes),
        "negative": _largest(
            model,
            fluxes,
            [-np.minimum(part.reflectance.min(axis=1), part.transmittance.min(axis=1)) for part in fluxes],
        ),
        "grazing": _grazing_growth(model, wavelengths),
        "integral": _integral_difference(model, wavelengths),
    }
    spectral = ("wavelength",) if "wavelength" in bsdf.coords else ()

    def azimuthal_mean(flux: Array) -> tuple[tuple[str, ...], Array]:
        count = hemisphere.azimuths(model.isotropic).size
        mean = flux[: _INCIDENCES.size * count].reshape(_INCIDENCES.size, count, -1).mean(axis=1)
        if not spectral:
            return ("theta_i",), mean[:, 0]
        return ("theta_i", *spectral), np.broadcast_to(mean, (_INCIDENCES.size, bsdf.sizes["wavelength"]))

    result = xr.Dataset(
        {
            "reciprocity_residual": residuals["reciprocity"].size,
            "albedo": azimuthal_mean(fixed.reflectance),
            "energy_excess": max(residuals["energy"].size - 1, 0.0),
            "negative_fraction": 1 - np.count_nonzero(values >= 0) / values.size,
            "closure_residual": _closure(model),
            "integral_residual": residuals["integral"].size,
            "grazing_growth": residuals["grazing"].size,
            "floor": float(np.nanmin(values)),
        },
        coords={"theta_i": _INCIDENCES, **({"wavelength": bsdf["wavelength"].values} if spectral else {})},
    )
    if model.transmits:
        result["transmittance"] = azimuthal_mean(fixed.transmittance)
    verdicts = _verdicts(result, residuals, model)
    if spectrum is not None and (found := specular_difference.compare(bsdf, spectrum)) is not None:
        verdicts["specular_difference"] = specular_difference.verdict(found)
    described = {name: {"verdict": verdict, "text": text} for name, (verdict, text) in verdicts.items()}
    result.attrs["verdicts"] = json.dumps(described, ensure_ascii=False)
    return vocabulary.label(result, "checks")


# --- directions and wavelengths


def _direction_pairs(both_sides: bool) -> Angles:
    unit = _low_discrepancy(2 * _PAIRS + _PAIRS_ABOUT_NORMAL, 4)
    cosine = unit[:, :2] if not both_sides else 2 * unit[:, :2] - 1
    theta_i, theta_o = np.degrees(np.arccos(cosine)).T
    phi_i, phi_o = 360 * unit[:, 2], 360 * unit[:, 3]
    lobe, normal = slice(_PAIRS, 2 * _PAIRS), slice(2 * _PAIRS, None)
    offset = _NEAREST * (_FURTHEST / _NEAREST) ** unit[:, 1]
    theta_o[lobe], phi_o[lobe] = from_mirror(theta_i[lobe], phi_i[lobe], offset[lobe], phi_o[lobe])
    theta_o[normal] = np.where(theta_o[normal] > 90, 180 - offset[normal], offset[normal])
    return theta_i, phi_i, np.clip(theta_o, 0.0, 180.0), phi_o


def _low_discrepancy(size: int, dimensions: int) -> Array:
    """Roberts' additive recurrence in the unit cube, by powers of the positive root of x^(d+1) = x + 1."""
    root = {1: 1.618033988749895, 2: 1.324717957244746, 4: 1.1673039782614187}[dimensions]
    return np.asarray((0.5 + np.arange(1, size + 1)[:, None] * root ** -np.arange(1.0, dimensions + 1)) % 1)


def _checked_wavelengths(model: Representation, pairs: Angles, fixed: _Fluxes) -> Array | None:
    """First, middle and last wavelength, and those at which the BSDF, or the total flux, is largest or smallest."""
    if "wavelength" not in model.dataset.coords:
        return None
    own = model.dataset["wavelength"].values
    chosen = {0, own.size // 2, own.size - 1}
    step = pairs[0].size // _PROBED_PAIRS
    theta_i, phi_i, theta_o, phi_o = (angle[::step] for angle in pairs)
    probed = model.evaluate(theta_i, phi_i, theta_o, phi_o, None)
    for field in (probed, model.stored_values(), fixed.total):
        by_wavelength = field.reshape(-1, field.shape[-1])
        if by_wavelength.size and by_wavelength.shape[1] == own.size:
            # argmax and argmin return the first NaN.
            chosen |= {int(np.abs(by_wavelength).max(axis=0).argmax()), int(by_wavelength.min(axis=0).argmin())}
    return np.asarray(own[sorted(chosen)])


def _fixed_incidences(model: Representation) -> tuple[Array, Array]:
    """θ_i and φ_i; incidences from above first."""
    polar = np.concatenate([_INCIDENCES, 180 - _INCIDENCES]) if model.transmits else _INCIDENCES
    theta_i, phi_i = np.meshgrid(polar, hemisphere.azimuths(model.isotropic), indexing="ij")
    return theta_i.ravel(), phi_i.ravel()


def _further_incidences(model: Representation) -> tuple[Array, Array]:
    """θ_i and φ_i of a low-discrepancy sequence, denser towards grazing, where energy is hardest to conserve; and of a table's nodes."""
    costly = model.albedo_needs_quadrature or model.transmits
    count = _FURTHER_INCIDENCES_BY_QUADRATURE if costly else _FURTHER_INCIDENCES
    unit = _low_discrepancy(count, 1 if model.isotropic else 2)
    theta_i = np.minimum(90 * (1 - unit[:, 0] ** 2), _INCIDENCES[-1])
    phi_i = np.zeros_like(theta_i) if model.isotropic else 360 * unit[:, 1]
    if model.transmits:
        theta_i[1::2] = 180 - theta_i[1::2]
    if model.albedo_needs_quadrature:
        return theta_i, phi_i
    own_theta, own_phi = model.stored_incidences()
    return np.concatenate([theta_i, np.minimum(own_theta, _INCIDENCES[-1])]), np.concatenate([phi_i, own_phi])


# --- residuals


def _fluxes(model: Representation, theta_i: Array, phi_i: Array, wavelength: Array | None) -> _Fluxes:
    reflectance = model.albedo(theta_i, phi_i, wavelength)
    return _Fluxes(theta_i, phi_i, reflectance, model.transmittance(theta_i, phi_i, wavelength))


def _both_ways(model: Representation, pairs: Angles, wavelength: Array | None) -> tuple[Array, Array]:
    """f / n_o² of pairs of directions and of the reversed pairs, (pairs, wavelength)."""
    theta_i, phi_i, theta_o, phi_o = pairs
    single = [None] if wavelength is None else [np.array([nm]) for nm in wavelength]
    index_squared = np.array([model.index_below(nm) for nm in single]) ** 2
    forward = model.evaluate(theta_i, phi_i, theta_o, phi_o, wavelength)
    backward = model.evaluate(theta_o, phi_o, theta_i, phi_i, wavelength)
    return (
        forward / np.where(theta_o[:, None] > 90, index_squared, 1.0),
        backward / np.where(theta_i[:, None] > 90, index_squared, 1.0),
    )


def _reciprocity(forward: Array, backward: Array, pairs: Angles) -> _Residual:
    mean = (np.abs(forward) + np.abs(backward)) / 2
    compared = np.isfinite(mean) & (mean > _NEGLIGIBLE * np.nanmax(mean))
    residual = np.divide(np.abs(forward - backward), mean, out=np.zeros_like(mean), where=compared)
    worst = int(residual.max(axis=1).argmax())
    theta_i, phi_i, theta_o, phi_o = (float(angle[worst]) for angle in pairs)
    where = f"between θ = {theta_i:.2f}° and θ = {theta_o:.2f}°, {(phi_o - phi_i) % 360:.0f}° apart in azimuth"
    return _Residual(float(residual[worst].max()), where)


def _largest(model: Representation, fluxes: tuple[_Fluxes, ...], sizes: list[Array]) -> _Residual:
    size = np.concatenate(sizes)
    theta_i, phi_i = (np.concatenate([part[angle] for part in fluxes]) for angle in (0, 1))
    worst = int(size.argmax())
    return _Residual(float(size[worst]), _incidence(model, theta_i[worst], phi_i[worst]))


def _energy_significance(model: Representation, fluxes: tuple[_Fluxes, ...]) -> _Residual:
    """Excess of the total flux over 1, in standard uncertainties; infinite if no uncertainty is stated."""
    if not model.states_uncertainty:
        return _Residual(np.inf, "")
    worst = _Residual(0.0, "")
    for part in fluxes:
        total = part.total.max(axis=1)
        brightest = np.argsort(total)[-_BRIGHTEST:]
        for at in brightest[total[brightest] > 1]:
            u = model.albedo_uncertainty(part.theta_i[[at]], part.phi_i[[at]], None).max()
            size = float((total[at] - 1) / u) if u > 0 else np.inf
            if size > worst.size:
                worst = _Residual(size, _incidence(model, part.theta_i[at], part.phi_i[at]))
    return worst


def _incidence(model: Representation, theta_i: float, phi_i: float) -> str:
    theta_i, phi_i = round(float(theta_i), 2), round(float(phi_i), 2)
    return f"at θ_i = {theta_i:g}°" + ("" if model.isotropic else f", φ_i = {phi_i:g}°")


def _grazing_growth(model: Representation, wavelength: Array | None) -> _Residual:
    """Largest growth of the BRDF from 89.9 to 89.99° of either direction; NaN if a value is not finite."""
    axes = np.meshgrid(
        [0.0, 30.0, 60.0], hemisphere.azimuths(model.isotropic), np.arange(0.0, 360.0, 30.0), indexing="ij"
    )
    steep, phi_i, phi_o = (axis.ravel() for axis in axes)
    worst = _Residual(0.0, "")
    for side in ("θ_o", "θ_i"):
        values = []
        for grazing in (89.9, 89.99):
            pair = (steep, np.full_like(steep, grazing))
            theta_i, theta_o = pair if side == "θ_o" else pair[::-1]
            values.append(model.evaluate(theta_i, phi_i, theta_o, phi_o + phi_i, wavelength))
        before, after = values
        if not np.isfinite(values).all():
            return _Residual(float("nan"), f"at {side} = 89.99°")
        compared = (after > _NEGLIGIBLE * max(float(after.max()), 1.0)) & (before > 0)
        growth = np.divide(after, before, out=np.zeros_like(after), where=compared)
        if growth.max() > worst.size:
            worst = _Residual(float(growth.max()), f"towards {side} = 90°")
    return worst


def _integral_difference(model: Representation, wavelength: Array | None) -> _Residual:
    """Largest difference between the directional reflectance or transmittance and a plain quadrature over the BSDF."""
    worst = _Residual(0.0, "")
    phi_i = np.array([0.0 if model.isotropic else 20.0])
    for theta in (8.0, 45.0, 75.0, *((135.0,) if model.transmits else ())):
        at = np.array([theta]), phi_i
        mirror, straight = model.specular(*at, wavelength)
        expected = [model.albedo(*at, wavelength) - mirror]
        if model.transmits:
            expected.append(model.transmittance(*at, wavelength) - straight)
        for through, flux in enumerate(expected):
            integral = model.integrate(
                *at, wavelength, transmitted_side=bool(through), relative=_INTEGRAL_ACCURACY
            ).value
            size = float(np.abs(integral - flux).max())
            if not size <= worst.size:
                worst = _Residual(size, f"at θ_i = {theta:g}°")
    return worst


def _closure(model: Representation) -> float:
    """Largest difference between the given total reflectance and the integral of the BSDF; NaN if none was given."""
    if "total_reflectance" not in model.dataset or "theta_m" not in model.dataset:
        return float("nan")
    phi = hemisphere.azimuths(model.isotropic)
    integrated = model.albedo(np.full(phi.size, float(model.dataset["theta_m"])), phi, None).mean(axis=0)
    return float(np.max(np.abs(integrated - np.atleast_1d(model.dataset["total_reflectance"].values))))


# --- verdicts


def _share(size: float) -> str:
    """A share as a percentage of two digits; one that is rounding alone as less than 0.0001 %."""
    if size < 1e-6:
        return "less than 0.0001%" if size else "0"
    if not size < 1e4:
        return f"{size:.0e}"
    return f"{np.format_float_positional(100 * size, precision=2, fractional=False, trim='-')}%"


def _verdicts(result: xr.Dataset, residuals: dict[str, _Residual], model: Representation) -> dict[str, tuple[str, str]]:
    """Verdict and text of each check."""
    bsdf, unphysical = model.dataset, model.unphysical_choice
    broken, known = ("warn", f"; a known property of {unphysical}") if unphysical else ("fail", "")
    names = ("reciprocity", "energy", "negative", "grazing", "integral")
    reciprocity, energy, negative, growth, integral = (residuals[name] for name in names)
    verdicts = {}

    reciprocal = reciprocity.size <= RECIPROCITY_LIMIT
    # A representation that averages both ways is reciprocal even if the measured values are not.
    contradiction = float(bsdf.attrs.get("contradiction", 0.0))
    text = f"f(i,o) and f(o,i) differ by at most {_share(reciprocity.size)} of their mean"
    if not reciprocal:
        text += " (one is without light)" if reciprocity.size > _ONE_WITHOUT_LIGHT else ""
        text += f", {reciprocity.where}{known}"
    if contradiction:
        text += f"; the BSDF is their average, and the measured ones differ by up to {contradiction:.1f} standard uncertainties"
    verdicts["reciprocity"] = "pass" if reciprocal and contradiction <= SIGNIFICANCE_LIMIT else "warn", text

    excess = energy.size > 1 + model.albedo_accuracy
    insignificant = excess and residuals["significance"].size <= SIGNIFICANCE_LIMIT
    below_zero = not negative.size <= model.albedo_accuracy
    text = "reflects and transmits" if model.transmits else "reflects"
    text += f" at most {energy.size:.4f} of the light, up to {_INCIDENCES[-1]:g}° incidence"
    if excess:
        text += f"; maximum {energy.where}{known}"
    if insignificant:
        text += (
            f"; within its uncertainty: 1 is exceeded by {residuals['significance'].size:.1f} standard uncertainties"
        )
    if below_zero:
        text += f"; negative reflectance or transmittance, {-negative.size:.2g} {negative.where}"
    verdicts["energy"] = "fail" if below_zero else "warn" if insignificant else broken if excess else "pass", text

    fraction = float(result["negative_fraction"])
    verdicts["positivity"] = (
        ("pass", "finite and not negative in every direction")
        if fraction == 0
        else ("fail", f"negative or undefined: {fraction:.2%} of the checked values")
    )

    if not np.isfinite(growth.size):
        verdicts["grazing"] = "fail", f"undefined or infinite {growth.where}"
    elif growth.size <= GROWTH_LIMIT:
        verdicts["grazing"] = "pass", "finite up to 89.99°, for both directions"
    else:
        verdicts["grazing"] = "warn", f"grows {growth.size:.0f}-fold from 89.9 to 89.99°, {growth.where}{known}"

    quantities = "reflectance and transmittance" if model.transmits else "reflectance"
    text = f"integral of the BSDF equals the directional {quantities} within {_share(integral.size)} of the light"
    if integral.size <= INTEGRAL_LIMIT:
        verdicts["integral"] = "pass", text
    else:
        interpolation_error = float(bsdf.get("interpolation_error", 0.0))
        stated = integral.size <= interpolation_error
        text += f", {integral.where}; accepted: {_share(INTEGRAL_LIMIT)}{known}"
        if stated:
            text += f"; the stated interpolation error is {_share(interpolation_error)}: integrate with `albedo` and `transmittance`"
        verdicts["integral"] = "warn" if stated else broken, text

    closure = float(result["closure_residual"])
    if np.isfinite(closure):
        text = f"total reflectance at {float(bsdf['theta_m']):g}° equals the given one within {_share(closure)} of the light"
        stated = closure <= float(bsdf.get("interpolation_error", 0.0))
        chosen = bsdf.attrs.get("diffuse_mode") in NOT_CLOSED
        clamped = bool((bsdf.get("diffuse_quality", xr.DataArray(0)) == vocabulary.quality("clamped")).any())
        if clamped:
            text += "; the diffuse part was set to 0 where the given reflectance is below the specular part"
        if closure <= CLOSURE_LIMIT:
            verdicts["closure"] = "pass", text
        elif closure <= CLOSURE_FAIL_LIMIT or clamped or stated or chosen:
            verdicts["closure"] = "warn", text + known
        else:
            verdicts["closure"] = broken, f"{text}; accepted: {_share(CLOSURE_LIMIT)}{known}"
    return verdicts
