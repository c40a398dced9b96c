"""From the values of single cells to a smooth BSDF at each incidence, with the covariance of its coefficients.

``pspline``          the logarithm of the BSDF as a P-spline (:class:`brdfpipe.bsdf.measured.basis.PSpline`): never negative, with the same relative accuracy
                     over any range. Values keep their Gaussian errors, negative ones of noise included: a generalised linear
                     model with a logarithmic link, so that dim light is not biased as the mean of logarithms would be
``keldysh``          the preprint's sum of functions with its basis repaired, weighted by 1/u²; linear, may turn negative
``keldysh-printed``  basis and weights as printed, for comparison

The strength ε of smoothing minimises the generalised cross-validation, summed over the wavelengths of an incidence. χ² over the
degrees of freedom shows whether the fit agrees with the stated uncertainties.

References
----------
Voloboy et al. 2005 (Keldysh Institute preprint); Eilers & Marx 1996; McCullagh & Nelder 1989 (link functions); Wood 2017.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from brdfpipe import vocabulary
from brdfpipe.bsdf.measured import basis as bases
from brdfpipe.bsdf.measured.basis import Basis, Keldysh, PSpline
from brdfpipe.bsdf.measured.coordinates import ABOUT, of_cells
from brdfpipe.bsdf.measured.least_squares import Decomposed, StandardForm
from brdfpipe.errors import VocabularyError
from brdfpipe.geometry import Array, check_angles
from brdfpipe.specular_directions import cos_view

MODES = ("pspline", "keldysh", "keldysh-printed")

_STRENGTHS = np.geomspace(0.03, 3e6, 41)
"""Trial strengths for the logarithm: 1/√ε is the expected second derivative, which at a lobe's edge is about 6 in asinh(ϑ/3°)."""
_SHARES = np.geomspace(1e-14, 10, 41)
"""Trial strengths for gradients, relative to the largest squared singular value."""

_FINEST = 3.0
"""Least support of the finest scale of the Keldysh basis [degree]: two standard deviations of a narrow lobe, and a few cells."""
_ORDERS = 9
"""Number of its polynomials: five, as printed, leave errors of 9 % in a narrow lobe once n − k is even; more scales do not help."""

_PASSES = 12
_CONVERGED = 0.1
"""Share of its standard uncertainty that the fit must move by for another pass."""
_LARGEST_STEP = 3.0
"""Largest change of the logarithm in a pass: far from a value the exponential differs from its tangent."""
_EXPONENT = 60.0
"""Largest exponent, so that values neither overflow nor underflow."""
_TRIED = 5
"""Wavelengths on which coordinates are compared."""
_IMPOSSIBLE = 5.0
"""An exact zero so many standard uncertainties below its surroundings is a missing value that was stored as zero."""
_MISFIT = 1.5
"""χ² over the degrees of freedom from which a fit is warned about."""
_COORDINATES = ("incidence", "wavelength", "cell", "theta_s", "phi_s")
"""Coordinates that smoothed data take from the cells; names of cells are optional."""
_USED = ("measured", "below_noise")
"""Quality flags of fitted values; a value below the noise is valid within its uncertainty."""


class _Cells(NamedTuple):
    """What was measured at one incidence."""

    value: Array
    """(wavelength, cell), 0 where a value is not to be used."""
    u: Array
    """(wavelength, cell) of independent errors; infinite where a value is not to be used."""
    common: Array
    """(component, wavelength, cell) of common errors."""


@dataclass(frozen=True)
class _Fit:
    """One incidence, fitted; the wavelengths are those with values."""

    form: StandardForm
    parts: Decomposed
    strengths: Array
    strength: float
    solution: Array
    """(wavelength, coefficients) in the standard form."""
    spread: Array
    """(wavelength, coefficients, any) factor of their covariance."""
    shift: Array
    """(component, wavelength, coefficients)"""
    residual: Array
    """(wavelength, cell) over the uncertainty; missing where a value was not used."""
    used: NDArray[np.bool_]
    """(all wavelengths,) those with values."""
    zeros: int = 0
    """Missing values that were stored as zero."""

    @property
    def chi_squared_dof(self) -> Array:
        """χ² over the degrees of freedom left (wavelength,); missing where none are."""
        left = self.parts.counts - self.parts.effective(np.array([self.strength]))[:, 0]
        return np.where(left > 0.5, np.nansum(self.residual**2, axis=1) / np.maximum(left, 0.5), np.nan)


def smooth(
    primary: xr.Dataset,
    mode: str = "pspline",
    *,
    strength: float | None = None,
    symmetric: bool = True,
    about: str | None = None,
    scales: int | None = None,
) -> xr.Dataset:
    """Fit a smooth BSDF to the cells of each incidence and wavelength.

    Parameters
    ----------
    primary : kind ``primary``; values that are missing, below the horizon, or of another quality than measured or below noise are left out
    mode : ``pspline``, ``keldysh`` or ``keldysh-printed``
    strength : ε > 0; by default that of least cross-validation, an incidence
    symmetric : whether the BSDF is even about the plane of incidence
    about : coordinates of the mode ``pspline``, see :mod:`brdfpipe.bsdf.measured.coordinates`; by default, for reflection, those that predict the
        cells better. The modes of the preprint, and transmission, use ``mirror``
    scales : of the mode ``keldysh``; by default as many as lead to supports of 3°

    Returns
    -------
    Dataset of kind ``smoothed``: coefficients, the factor of their covariance, and their change by each common error; the residual of each
        cell over its uncertainty; against ε, means over the wavelengths of cross-validation, χ², roughness and effective parameters.
        An incidence and wavelength without a value has missing coefficients

    Raises
    ------
    VocabularyError : no dataset of kind ``primary``, a value without an uncertainty above 0, an unknown mode, or no value at all.
    """
    vocabulary.validate(primary, "primary")
    _check(mode, about, strength, scales)
    side = str(primary.attrs.get("side", "reflection"))
    cells = _cells(primary)
    basis = _basis(mode, primary, symmetric, scales)
    if mode != "pspline" or side != "reflection":
        about = "mirror"
    elif about is None:
        about = _better_coordinates(primary, cells, basis)
    forms = [_form(primary, basis, about, at) for at in range(len(cells))]
    printed = np.sqrt(_ring_weights(primary["theta_s"].values)) if mode == "keldysh-printed" else None
    fits = [_fit(form, each, mode, strength, printed) for form, each in zip(forms, cells, strict=True)]
    link = "log" if mode == "pspline" else "identity"
    attrs = {name: primary.attrs[name] for name in ("history", "warnings") if name in primary.attrs}
    attrs |= {"mode": mode, "link": link, "about": about, "basis": bases.to_json(basis), "side": side}
    smoothed = _with_notes(_labelled(primary, fits).assign_attrs(attrs), fits, strength)
    return vocabulary.validate(smoothed, "smoothed")


def evaluate(smoothed: xr.Dataset, theta_s: ArrayLike, phi_s: ArrayLike) -> xr.DataArray:
    """The fit of each incidence at directions about the mirror direction [degree]: BSDF [sr-1], (incidence, wavelength, direction)."""
    values = _at(smoothed, theta_s, phi_s)[0]
    return _over_directions(smoothed, values, vocabulary.QUANTITIES["brdf"].long_name)


def uncertainty(smoothed: xr.Dataset, theta_s: ArrayLike, phi_s: ArrayLike) -> xr.DataArray:
    """Standard uncertainty of :func:`evaluate` [sr-1], (incidence, wavelength, direction): noise, smoothing and common errors."""
    values, rows = _at(smoothed, theta_s, phi_s)
    variance = ((rows[:, None] @ smoothed["coefficient_factor"].values) ** 2).sum(axis=-1)
    if "coefficient_common" in smoothed:
        common = smoothed["coefficient_common"].values
        variance += ((rows[:, None] @ common[..., None])[..., 0] ** 2).sum(axis=0)
    u = np.sqrt(variance) * (values if smoothed.attrs["link"] == "log" else 1.0)
    return _over_directions(smoothed, u, "standard uncertainty of the BSDF")


def _at(smoothed: xr.Dataset, theta_s: ArrayLike, phi_s: ArrayLike) -> tuple[Array, Array]:
    """Values (incidence, wavelength, direction) and rows (incidence, direction, term)."""
    basis = bases.from_json(smoothed.attrs["basis"])
    angles = check_angles("theta_s", theta_s, 0, 180), check_angles("phi_s", phi_s, -720, 720)
    theta, phi = (np.atleast_1d(angle).ravel() for angle in np.broadcast_arrays(*angles))
    rows = np.stack(
        [
            basis.rows(*of_cells(smoothed.attrs["about"], incidence, theta, phi), cos_view(incidence, theta, phi))
            for incidence in smoothed["incidence"].values
        ]
    )
    values = smoothed["coefficient"].values @ np.swapaxes(rows, 1, 2)
    return (_exponential(values) if smoothed.attrs["link"] == "log" else values), rows


def _over_directions(smoothed: xr.Dataset, values: Array, long_name: str) -> xr.DataArray:
    coords = {name: smoothed[name] for name in ("incidence", "wavelength")}
    dims = ("incidence", "wavelength", "direction")
    return xr.DataArray(values, coords, dims, "brdf", {"units": "sr-1", "long_name": long_name})


# --- what is fitted


def _check(mode: str, about: str | None, strength: float | None, scales: int | None) -> None:
    if mode not in MODES:
        raise VocabularyError(f"unknown mode of smoothing {mode!r}; known: {', '.join(MODES)}")
    if about is not None and about not in ABOUT:
        raise VocabularyError(f"unknown coordinates {about!r}; known: {', '.join(ABOUT)}")
    if strength is not None and not (np.isfinite(strength) and strength > 0):
        raise VocabularyError(f"the strength of smoothing is {strength!r}; it must be a number above 0")
    if scales is not None and not (isinstance(scales, int) and 1 <= scales <= 12):
        raise VocabularyError(f"the number of scales is {scales!r}; accepted are 1 to 12")


def _cells(primary: xr.Dataset) -> list[_Cells]:
    """The values of each incidence that count, with their uncertainties taken apart."""
    value = primary["brdf"].values
    independent, common = _uncertainties(primary)
    incidence = primary["incidence"].values[:, None, None]
    used = np.isfinite(value) & (cos_view(incidence, primary["theta_s"].values, primary["phi_s"].values) > 0)
    if "brdf_quality" in primary:
        used &= np.isin(primary["brdf_quality"].values, [vocabulary.quality(name) for name in _USED])
    wrong = used & ~(np.isfinite(independent) & (independent > 0))
    if wrong.any():
        at, wavelength, cell = (int(index[0]) for index in np.nonzero(wrong))
        raise VocabularyError(
            f"the uncertainty is {independent[at, wavelength, cell]:g} where a value was measured (incidence "
            f"{primary['incidence'].values[at]:g}°, {primary['wavelength'].values[wavelength]:g} nm, cell {cell}); "
            "every value needs one above 0, or is missing (NaN)"
        )
    if not used.any():
        raise VocabularyError("no cell has a value that can be fitted: check the quality flags of the primary data")
    u = np.where(used, independent, np.inf)
    common = np.where(used, np.nan_to_num(common), 0.0)
    return [_Cells(np.where(used[at], value[at], 0.0), u[at], common[:, at]) for at in range(value.shape[0])]


def _uncertainties(primary: xr.Dataset) -> tuple[Array, Array]:
    """Independent (incidence, wavelength, cell) and common (component, …) standard uncertainties.

    Without independent components the combined uncertainty counts as independent.
    """
    whole = primary["brdf_u"]
    independent = [_part(primary, name) for name in _components(primary, "independent")]
    if not independent:
        return whole.values, np.zeros((0, *whole.shape))
    common = [_part(primary, name) for name in _components(primary, "common")]
    stacked = np.stack(common) if common else np.zeros((0, *whole.shape))
    return np.sqrt(np.sum(np.square(independent), axis=0)), stacked


def _components(primary: xr.Dataset, correlation: str) -> list[str]:
    names = sorted(name for name in map(str, primary.data_vars) if name.startswith("brdf_u_"))
    return [name for name in names if primary[name].attrs.get("correlation", "common") == correlation]


def _part(primary: xr.Dataset, name: str) -> Array:
    whole = primary["brdf_u"]
    return np.asarray(primary[name].broadcast_like(whole).transpose(*whole.dims).values, dtype=float)


def _basis(mode: str, primary: xr.Dataset, symmetric: bool, scales: int | None) -> Basis:
    if mode == "pspline":
        return PSpline.default(symmetric=symmetric)
    if mode == "keldysh-printed":
        return Keldysh(symmetric=symmetric, printed=True)
    domain = 90.0 + float(primary["incidence"].max())
    return Keldysh(domain, scales or int(np.log2(domain / _FINEST)) + 1, _ORDERS, symmetric=symmetric)


def _form(primary: xr.Dataset, basis: Basis, about: str, at: int) -> StandardForm:
    """The basis at the cells of an incidence; at normal incidence, where there is symmetry, without φ."""
    incidence, theta, phi = float(primary["incidence"][at]), primary["theta_s"].values, primary["phi_s"].values
    seen = of_cells(about, incidence, theta, phi)
    rows, roughness = basis.rows(*seen, cos_view(incidence, theta, phi)), basis.roughness(*seen)
    printed = isinstance(basis, Keldysh) and basis.printed
    if printed:
        weight = np.sqrt(_ring_weights(theta) / bases.solid_angles(theta, phi))
        roughness = roughness * np.concatenate([weight, weight])[:, None]
    kept = (basis.harmonic == 0) | (incidence > 0) | printed | (not basis.symmetric)
    form = StandardForm.of(rows[:, kept], roughness[:, kept])
    back = np.zeros((kept.size, form.back.shape[1]))
    back[kept] = form.back
    return StandardForm(form.rows, form.free, back)


def _ring_weights(theta: Array) -> Array:
    """sin ϑ Δϑ as printed, Δϑ the distance of neighbouring rings of cells."""
    rings = np.unique(np.round(theta, 1))
    wide = np.gradient(rings) if rings.size > 1 else np.ones(1)
    return np.maximum(np.sin(np.radians(theta)), 1e-3) * np.interp(theta, rings, np.radians(wide))


def _better_coordinates(primary: xr.Dataset, cells: list[_Cells], basis: Basis) -> str:
    """The coordinates of less cross-validation, on a few wavelengths of all incidences."""
    few = np.unique(np.linspace(0, primary.sizes["wavelength"] - 1, _TRIED).round().astype(int))
    score = dict.fromkeys(ABOUT, 0.0)
    for at, each in enumerate(cells):
        value, u = each.value[few], each.u[few]
        if float(primary["incidence"][at]) == 0 or not np.isfinite(u).any():
            continue
        for about in ABOUT:
            mean = np.maximum(value, _finite(u, 1.0))
            parts = Decomposed.of(_form(primary, basis, about, at), mean / u, _response(value, mean))
            score[about] += float(_summed(parts, _STRENGTHS).min())
    return min(ABOUT, key=lambda about: score[about])


# --- the fit of one incidence


class _Solved(NamedTuple):
    """Least squares of the wavelengths of an incidence."""

    parts: Decomposed
    strengths: Array
    strength: float
    solution: Array
    """(wavelength, coefficients) in the standard form."""
    fitted: Array
    """(wavelength, cell) BSDF."""


def _fit(form: StandardForm, cells: _Cells, mode: str, strength: float | None, printed: Array | None) -> _Fit:
    """Exact zeros among bright cells are left out; where cells are dim they may be noise, and count."""
    used = np.asarray(np.isfinite(cells.u).any(axis=1))
    value, u, common = cells.value[used], cells.u[used], cells.common[:, used]

    def solve(u: Array) -> _Solved:
        if mode == "pspline":
            return _iterated(form, value, u, strength)
        return _linear(form, value, _weight(u, printed), strength)

    zero = (value == 0) & np.isfinite(u)
    without = np.where(zero & ~(zero | np.isinf(u)).all(axis=1, keepdims=True), np.inf, u)
    solved = solve(without)
    missing = zero & (solved.fitted > _IMPOSSIBLE * _finite(u))
    u = np.where(missing, np.inf, u)
    if (np.isfinite(u) != np.isfinite(without)).any():
        solved = solve(u)
    parts, strengths, chosen, solution, fitted = solved
    spread = parts.spread(chosen)
    if mode == "pspline":
        shift = _shifts(form, spread, fitted / u**2 * common)
    else:
        weight = _weight(u, printed)
        shift = _shifts(form, spread, weight**2 * common)
        spread = spread if printed is None else _carried(form, spread, weight, u)
    residual = np.where(np.isfinite(u), (value - fitted) / _finite(u, 1.0), np.nan)
    return _Fit(form, parts, strengths, chosen, solution, spread, shift, residual, used, int(missing.sum()))


def _weight(u: Array, printed: Array | None) -> Array:
    return 1 / u if printed is None else np.where(np.isfinite(u), printed, 0.0)


def _linear(form: StandardForm, value: Array, weight: Array, strength: float | None) -> _Solved:
    parts = Decomposed.of(form, weight, value)
    strengths = _SHARES * float((parts.singular**2).max(initial=1e-300))
    chosen = _least(parts, strengths) if strength is None else strength
    solution = parts.solution(chosen)
    return _Solved(parts, strengths, chosen, solution, solution @ form.rows.T)


def _carried(form: StandardForm, spread: Array, weight: Array, u: Array) -> Array:
    """Factor of the covariance where weights are not those of the noise: it is carried through the smoother."""
    gain = spread @ (np.swapaxes(spread, 1, 2) @ (form.rows.T * (weight**2 * _finite(u))[:, None, :]))
    return np.swapaxes(np.asarray(np.linalg.qr(np.swapaxes(gain, 1, 2), mode="r")), 1, 2)


def _iterated(form: StandardForm, value: Array, u: Array, strength: float | None) -> _Solved:
    """Least squares on the logarithm.

    Each pass linearises about the fit of the last: Newton's method with the expected Hessian. Wavelengths that would move by
    little are left as they are.
    """
    mean = np.maximum(value, _finite(u, 1.0))
    parts = Decomposed.of(form, mean / u, _response(value, mean))
    for left in reversed(range(_PASSES)):
        chosen = _least(parts, _STRENGTHS) if strength is None else strength
        solution, before = parts.solution(chosen), mean
        fitted = _exponential(solution @ form.rows.T)
        moves = _movement(parts, solution, before, fitted, value, u, chosen) > _CONVERGED**2
        if not (moves.any() and left):
            break
        mean = np.where(moves, fitted, before)
        moving = np.flatnonzero(moves)
        again = Decomposed.of(form, mean[moving] / u[moving], _response(value[moving], mean[moving]))
        parts = parts.updated(moving, again)
    return _Solved(parts, _STRENGTHS, chosen, solution, fitted)


def _response(value: Array, mean: Array) -> Array:
    """The logarithm of the values, on its tangent at the mean."""
    return np.log(mean) + _misfit(value, mean)


def _misfit(value: Array, mean: Array) -> Array:
    """Relative misfit, cut on both sides: errors even about the mean stay so, and what is far below the noise moves by steps."""
    return np.clip((value - mean) / mean, -_LARGEST_STEP, _LARGEST_STEP)


def _exponential(logarithm: Array) -> Array:
    return np.exp(np.clip(logarithm, -_EXPONENT, _EXPONENT))


def _movement(
    parts: Decomposed, solution: Array, before: Array, mean: Array, value: Array, u: Array, strength: float
) -> Array:
    """How far one more pass would move the fitted values: squared, over their variance, mean a parameter; (wavelength, 1)."""
    form = parts.form
    penalty = np.where(np.arange(solution.shape[1]) < form.free, 0.0, strength)
    slope = ((mean / u) ** 2 * _misfit(value, mean)) @ form.rows - penalty * solution
    # The Hessian is that of the last pass; what it grew or shrank by since is taken to be alike for all coefficients.
    grown = ((mean / u) ** 2).sum(axis=1, keepdims=True) / ((before / u) ** 2).sum(axis=1, keepdims=True)
    step = _solved(parts.spread(strength), slope) / grown
    moved = np.clip(step @ form.rows.T, -_LARGEST_STEP, _LARGEST_STEP) * mean / u
    return (moved**2).sum(axis=1, keepdims=True) / parts.effective(np.array([strength]))


def _least(parts: Decomposed, strengths: Array) -> float:
    """ε that minimises the cross-validation; the largest where there are too few values."""
    score = _summed(parts, strengths)
    return float(strengths[int(score.argmin())] if np.isfinite(score).any() else strengths[-1])


def _summed(parts: Decomposed, strengths: Array) -> Array:
    """Cross-validation summed over the wavelengths with enough values."""
    score = parts.cross_validation(strengths)
    usable = np.isfinite(score).any(axis=1)
    return score[usable].sum(axis=0) if usable.any() else np.full(strengths.size, np.inf)


def _shifts(form: StandardForm, spread: Array, weighted: Array) -> Array:
    """Change of the solution by common errors δz (component, wavelength, cell), given as W² δz."""
    return _solved(spread, weighted @ form.rows)


def _solved(spread: Array, slope: Array) -> Array:
    return (spread @ (np.swapaxes(spread, 1, 2) @ slope[..., None]))[..., 0]


def _finite(u: Array, instead: float = 0.0) -> Array:
    return np.where(np.isfinite(u), u, instead)


# --- the dataset


def _labelled(primary: xr.Dataset, fits: list[_Fit]) -> xr.Dataset:
    shape = (len(fits), primary.sizes["wavelength"])
    terms, width = fits[0].form.back.shape[0], max(fit.spread.shape[2] for fit in fits)
    coefficient = np.full((*shape, terms), np.nan)
    factor = np.zeros((*shape, terms, width), dtype=np.float32)
    common = np.full((fits[0].shift.shape[0], *shape, terms), np.nan)
    residual, reduced = np.full((*shape, primary.sizes["cell"]), np.nan), np.full(shape, np.nan)
    for at, fit in enumerate(fits):
        back = fit.form.back
        coefficient[at, fit.used] = fit.solution @ back.T
        # A fit with χ² above the degrees of freedom has its uncertainty enlarged accordingly.
        inflation = np.sqrt(np.maximum(np.nan_to_num(fit.chi_squared_dof), 1.0))
        factor[at, fit.used, :, : fit.spread.shape[2]] = back @ (fit.spread * inflation[:, None, None])
        factor[at, ~fit.used] = np.nan
        common[:, at, fit.used] = fit.shift @ back.T
        residual[at, fit.used], reduced[at, fit.used] = fit.residual, fit.chi_squared_dof
    smoothed = xr.Dataset(
        {
            "coefficient": (("incidence", "wavelength", "term"), coefficient),
            "coefficient_factor": (("incidence", "wavelength", "term", "factor"), factor),
            "residual": (("incidence", "wavelength", "cell"), residual),
            "chi_squared_dof": (("incidence", "wavelength"), reduced),
            "chosen_strength": ("incidence", np.array([fit.strength for fit in fits])),
            **_curves(fits),
        },
        coords={name: primary[name].variable for name in _COORDINATES if name in primary.coords},
    )
    if common.size:
        names = [name.removeprefix("brdf_u_") for name in _components(primary, "common")]
        smoothed = smoothed.assign_coords(component=names)
        smoothed["coefficient_common"] = (("component", "incidence", "wavelength", "term"), common)
    return vocabulary.label(smoothed, "smoothed")


def _curves(fits: list[_Fit]) -> dict[str, tuple[tuple[str, str], Array]]:
    """Criteria of the choice of ε against the trial strengths: means over the wavelengths of an incidence."""
    functions = {
        "gcv": Decomposed.cross_validation,
        "chi_squared": Decomposed.chi_squared,
        "roughness": Decomposed.roughness,
        "effective_parameters": Decomposed.effective,
    }
    curves = {"strength": (("incidence", "trial"), np.stack([fit.strengths for fit in fits]))}
    for name, function in functions.items():
        means = np.full((len(fits), fits[0].strengths.size), np.nan)
        for row, fit in zip(means, fits, strict=True):
            if fit.used.any():
                row[:] = function(fit.parts, fit.strengths).mean(axis=0)
        curves[name] = (("incidence", "trial"), np.where(np.isfinite(means), means, np.nan))
    return curves


def _with_notes(smoothed: xr.Dataset, fits: list[_Fit], strength: float | None) -> xr.Dataset:
    mode, about = smoothed.attrs["mode"], smoothed.attrs["about"]
    how = "as given" if strength is not None else "of least cross-validation"
    history = [
        f"smoothed by {mode} in {about} coordinates, ε {how}, each wavelength with its own mask and weights 1/u²"
    ]
    warnings = []
    if mode == "keldysh-printed":
        warnings.append(
            "The basis and the weights of the preprint are for comparison only: their errors at narrow lobes exceed 100 %. Use `pspline`."
        )
    zeros = sum(fit.zeros for fit in fits)
    if zeros:
        warnings.append(
            f"{zeros} values are exactly 0 among bright ones and were left out. Store missing values as NaN, not as 0."
        )
    empty = sum(int((~fit.used).sum()) for fit in fits)
    if empty:
        warnings.append(
            f"{empty} of {smoothed['chi_squared_dof'].size} fits, one for each incidence and wavelength, have no cell with a value."
        )
    poor = smoothed["chi_squared_dof"].max("wavelength")
    for incidence, worst in zip(poor["incidence"].values, poor.values, strict=True):
        if worst > _MISFIT and mode != "keldysh-printed":
            warnings.append(
                f"Poor fit at {incidence:g}°: the rms residual is {np.sqrt(worst):.1f} times the stated uncertainty, and the fit's uncertainty was enlarged. "
                "Check the map of residuals for wrong cells, or for a lobe narrower than the cells resolve."
            )
    return vocabulary.add_warning(vocabulary.add_history(smoothed, *history), *warnings)
