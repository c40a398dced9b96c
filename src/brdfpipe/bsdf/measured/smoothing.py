"""From the values of single cells to a smooth BSDF at each incidence, with the covariance of its coefficients.

``pspline``          a P-spline of the logarithm (:class:`brdfpipe.bsdf.measured.basis.PSpline`), positive and of even relative accuracy; a generalised
                     linear model with logarithmic link, so that dim light, negative noise included, is unbiased
``keldysh``          the preprint's functions with the basis repaired, weighted by 1/u²; linear, may become negative
``keldysh-printed``  basis and weights as printed, for comparison
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from brdfpipe import vocabulary
from brdfpipe.bsdf.measured import basis as bases
from brdfpipe.bsdf.measured.agreement import symmetry_warnings
from brdfpipe.bsdf.measured.basis import RESOLUTION, TOWARDS_GRAZING, Basis, Keldysh, PSpline
from brdfpipe.bsdf.measured.coordinates import ABOUT, cell_angles
from brdfpipe.bsdf.measured.least_squares import Decomposition, StandardForm
from brdfpipe.bsdf.measured.resolution import unresolved
from brdfpipe.errors import VocabularyError
from brdfpipe.geometry import Array, check_angles
from brdfpipe.specular_directions import cos_view

MODES = ("pspline", "keldysh", "keldysh-printed")

_STRENGTHS = np.geomspace(0.03, 3e6, 41)
"""Trial strengths for the logarithm: 1/√ε is the expected second derivative, which at a lobe's edge is about 6 in asinh(ϑ/3°)."""
_RELATIVE_STRENGTHS = np.geomspace(1e-14, 10, 41)  # for gradients, over the largest squared singular value
_FINEST_SUPPORT = 3.0
"""Smallest support of the Keldysh basis's finest scale [degree]: two standard deviations of a narrow lobe, and a few cells."""
_ORDERS = 9
"""Number of its polynomials: five, as printed, leave errors of 9 % in a narrow lobe once n − k is even; more scales do not help."""
_LAY_HARMONICS = (4, 8, 12)
"""Numbers of harmonics of φ of a surface with a lay; one is used if it predicts the cells better than the one before. The lobe of slopes three times as large across the
lay as along it is a narrow band in φ, and leaves four harmonics with errors of 10 % beside it. More do not change it beyond the noise."""
_FEW_CELLS = 10, 40
"""Numbers of cells up to which cross-validation tells nothing of the roughness between them, and from which it tells all."""
_PASSES = 12
_CONVERGED = 0.1  # change of the fit, in standard uncertainties, above which another pass follows
_LARGEST_STEP = 3.0  # of the logarithm in a pass: far from a value the exponential differs from its tangent
_LARGEST_EXPONENT = 60.0
_COMPARED_WAVELENGTHS = 5  # wavelengths on which coordinates and bases are compared
_IMPOSSIBLE = 5.0  # standard uncertainties below the fit at which an exact zero is a missing value stored as zero
_MISFIT = 1.5  # χ² over the degrees of freedom above which a fit causes a warning
_CELL_COORDINATES = ("incidence", "wavelength", "cell", "theta_s", "phi_s")  # names of cells are optional
_USED = ("measured", "below_noise")  # a value below the noise is valid within its uncertainty


class _CellValues(NamedTuple):
    """The values measured at one incidence."""

    value: Array  # (wavelength, cell), 0 where unused
    u: Array  # (wavelength, cell) of independent errors; infinite where unused
    common: Array  # (component, wavelength, cell) of common errors


class _Solution(NamedTuple):
    """Least squares of the wavelengths of an incidence."""

    problems: Decomposition
    strengths: Array
    strength: float
    coefficients: Array  # (wavelength, coefficients) in standard form
    fitted: Array  # (wavelength, cell) BSDF


class _Fit(NamedTuple):
    """The fit of one incidence, at the wavelengths with values."""

    solution: _Solution
    factor: Array  # (wavelength, coefficients, any) factor of their covariance
    shift: Array  # (component, wavelength, coefficients) by common errors
    residual: Array  # (wavelength, cell) over the uncertainty; missing where unused
    used: NDArray[np.bool_]  # (all wavelengths,) those with values
    zeros: int  # missing values that were stored as zero
    unresolved: dict[str, Array]  # (wavelength, terms of the basis) change by what cells do not tell, by component

    @property
    def chi_squared_dof(self) -> Array:
        """χ² over the degrees of freedom (wavelength,); missing without any."""
        problems, strength = self.solution.problems, np.array([self.solution.strength])
        left = problems.counts - problems.effective_parameters(strength)[:, 0]
        return np.where(left > 0.5, np.nansum(self.residual**2, axis=1) / np.maximum(left, 0.5), np.nan)


def smooth(
    primary: xr.Dataset,
    mode: str = "pspline",
    *,
    strength: float | None = None,
    mirror_symmetric: bool = True,
    isotropic: bool = True,
    about: str | None = None,
    scales: int | None = None,
) -> xr.Dataset:
    """Fit a smooth BSDF to the cells of each incidence and wavelength.

    Parameters
    ----------
    primary : kind ``primary``; values that are missing, below the horizon, or of another quality than measured or below noise are left out
    mode : ``pspline``, ``keldysh`` or ``keldysh-printed``
    strength : ε > 0; by default that of least generalised cross-validation, summed over the wavelengths of an incidence
    mirror_symmetric : whether the BSDF is even about the plane of incidence; a warning names incidences that contradict it
    isotropic : whether the sample may be rotated in its plane: at normal incidence there is no dependence on φ then, and the completion averages
        the two directions of light; a warning says where the values at normal incidence contradict it
    about : coordinates of the mode ``pspline``, see :mod:`brdfpipe.bsdf.measured.coordinates`; by default, for reflection, those that predict the
        cells better. The modes of the preprint, and transmission, use ``mirror``
    scales : of the mode ``keldysh``; by default as many as lead to supports of 3°. A warning says where the cells do not determine so many

    Returns
    -------
    Dataset of kind ``smoothed``: coefficients, the factor of their covariance, and their change by each common error; the residual of each
        cell over its uncertainty; against ε, means over the wavelengths of cross-validation, χ², roughness and effective parameters.
        An incidence and wavelength without a value has missing coefficients

    Raises
    ------
    VocabularyError : no dataset of kind ``primary``, an isotropic surface without mirror symmetry, a value without an uncertainty above 0, an unknown mode, or no value at all.

    References
    ----------
    Voloboy et al. 2005 (Keldysh Institute preprint); Eilers & Marx 1996; McCullagh & Nelder 1989 (link functions); Wood 2017.
    """
    vocabulary.validate(primary, "primary")
    _check_options(mode, about, strength, scales)
    if isotropic and not mirror_symmetric:
        raise VocabularyError(
            "an isotropic surface is symmetric about every plane of incidence; give `isotropic=False`"
        )
    side = str(primary.attrs.get("side", "reflection"))
    cells = _cell_values(primary)
    basis = _basis(mode, primary, mirror_symmetric, scales)
    if mode != "pspline" or side != "reflection":
        about = "mirror"
    tried: list[Basis] = [basis]
    if isinstance(basis, PSpline) and not isotropic:
        tried = [replace(basis, harmonics=number) for number in _LAY_HARMONICS]
    about, basis = _best_prediction(primary, cells, ABOUT if about is None else (about,), tried, isotropic)
    forms = [_standard_form(primary, basis, about, at, isotropic) for at in range(len(cells))]
    others = [
        {
            RESOLUTION: _standard_form(primary, basis, about, at, isotropic, coarse=True),
            TOWARDS_GRAZING: _standard_form(primary, basis, about, at, isotropic, resisted=False),
        }
        if isinstance(basis, PSpline)
        else {}
        for at in range(len(cells))
    ]
    preprint_weights = np.sqrt(_ring_weights(primary["theta_s"].values)) if mode == "keldysh-printed" else None
    fits = [
        _fit(form, values, mode, strength, preprint_weights, other)
        for form, values, other in zip(forms, cells, others, strict=True)
    ]
    link = "log" if mode == "pspline" else "identity"
    attrs = {name: primary.attrs[name] for name in ("history", "warnings") if name in primary.attrs}
    attrs |= {"mode": mode, "link": link, "about": about, "basis": bases.to_json(basis), "side": side}
    attrs |= {"isotropic": "true" if isotropic else "false"}
    attrs |= {name: primary.attrs[name] for name in vocabulary.MEASUREMENT if name in primary.attrs}
    smoothed = _with_notes(_dataset(primary, fits).assign_attrs(attrs), fits, strength)
    if mode == "keldysh":
        smoothed = vocabulary.add_warning(smoothed, *_undetermined(primary["incidence"].values, forms, cells))
    return vocabulary.validate(smoothed, "smoothed")


def evaluate(smoothed: xr.Dataset, theta_s: ArrayLike, phi_s: ArrayLike) -> xr.DataArray:
    """The fit of each incidence at directions about the mirror direction [degree]: BSDF [sr-1], (incidence, wavelength, direction)."""
    values = _values_and_rows(smoothed, theta_s, phi_s)[0]
    return _over_directions(smoothed, values, vocabulary.QUANTITIES["brdf"].long_name)


def uncertainty(smoothed: xr.Dataset, theta_s: ArrayLike, phi_s: ArrayLike) -> xr.DataArray:
    """Standard uncertainty of :func:`evaluate` [sr-1], (incidence, wavelength, direction): noise, smoothing and common errors."""
    values, rows = _values_and_rows(smoothed, theta_s, phi_s)
    variance = ((rows[:, None] @ smoothed["coefficient_factor"].values) ** 2).sum(axis=-1)
    if "coefficient_common" in smoothed:
        common = smoothed["coefficient_common"].values
        variance += ((rows[:, None] @ common[..., None])[..., 0] ** 2).sum(axis=0)
    u = np.sqrt(variance)
    if smoothed.attrs["link"] == "log":
        # The error to the larger side: a value that is far too low is within it.
        u = values * np.expm1(np.minimum(u, _LARGEST_EXPONENT))
    return _over_directions(smoothed, u, "standard uncertainty of the BSDF")


def _values_and_rows(smoothed: xr.Dataset, theta_s: ArrayLike, phi_s: ArrayLike) -> tuple[Array, Array]:
    """Values (incidence, wavelength, direction) and rows of the basis (incidence, direction, term)."""
    basis = bases.from_json(smoothed.attrs["basis"])
    angles = check_angles("theta_s", theta_s, 0, 180), check_angles("phi_s", phi_s, -720, 720)
    theta, phi = (np.atleast_1d(angle).ravel() for angle in np.broadcast_arrays(*angles))
    rows = np.stack(
        [
            basis.rows(*cell_angles(smoothed.attrs["about"], incidence, theta, phi), cos_view(incidence, theta, phi))
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


def _check_options(mode: str, about: str | None, strength: float | None, scales: int | None) -> None:
    if mode not in MODES:
        raise VocabularyError(f"unknown mode of smoothing {mode!r}; accepted: {', '.join(MODES)}")
    if about is not None and about not in ABOUT:
        raise VocabularyError(f"unknown coordinates {about!r}; accepted: {', '.join(ABOUT)}")
    if strength is not None and not (np.isfinite(strength) and strength > 0):
        raise VocabularyError(f"the strength of smoothing is {strength!r}; it must be a number above 0")
    if scales is not None and not (isinstance(scales, int) and 1 <= scales <= 12):
        raise VocabularyError(f"the number of scales is {scales!r}; accepted are 1 to 12")


def _cell_values(primary: xr.Dataset) -> list[_CellValues]:
    """The usable values of each incidence. Without independent components the combined uncertainty counts as independent."""
    value, independent = primary["brdf"].values, primary["brdf_u"].values
    common = np.zeros((0, *value.shape))
    if components := _components(primary, "independent"):
        independent = np.sqrt(np.sum(np.square([*components.values()]), axis=0))
        common = np.reshape([*_components(primary, "common").values()], (-1, *value.shape))
    incidence = primary["incidence"].values[:, None, None]
    used = np.isfinite(value) & (cos_view(incidence, primary["theta_s"].values, primary["phi_s"].values) > 0)
    if "brdf_quality" in primary:
        used &= np.isin(primary["brdf_quality"].values, [vocabulary.quality(name) for name in _USED])
    wrong = used & ~(np.isfinite(independent) & (independent > 0))
    if wrong.any():
        at, wavelength, cell = np.argwhere(wrong)[0]
        raise VocabularyError(
            f"the uncertainty is {independent[at, wavelength, cell]:g} where a value was measured (incidence "
            f"{primary['incidence'].values[at]:g}°, {primary['wavelength'].values[wavelength]:g} nm, cell {cell}); "
            "every value needs one above 0, or is missing (NaN)"
        )
    if not used.any():
        raise VocabularyError("no cell has a value that can be fitted: check the quality flags of the primary data")
    value, u = np.where(used, value, 0.0), np.where(used, independent, np.inf)
    common = np.where(used, np.nan_to_num(common), 0.0)
    return [_CellValues(value[at], u[at], common[:, at]) for at in range(value.shape[0])]


def _components(primary: xr.Dataset, correlation: str) -> dict[str, Array]:
    """Uncertainty components (incidence, wavelength, cell) of a correlation, by name."""
    whole = primary["brdf_u"]
    names = sorted(name for name in map(str, primary.data_vars) if name.startswith("brdf_u_"))
    return {
        name.removeprefix("brdf_u_"): np.asarray(
            primary[name].broadcast_like(whole).transpose(*whole.dims), dtype=float
        )
        for name in names
        if primary[name].attrs.get("correlation", "common") == correlation
    }


def _basis(mode: str, primary: xr.Dataset, symmetric: bool, scales: int | None) -> Basis:
    if mode == "pspline":
        return PSpline.default(symmetric=symmetric)
    if mode == "keldysh-printed":
        return Keldysh(symmetric=symmetric, printed=True)
    domain = 90.0 + float(primary["incidence"].max())
    return Keldysh(domain, scales or int(np.log2(domain / _FINEST_SUPPORT)) + 1, _ORDERS, symmetric=symmetric)


def _standard_form(
    primary: xr.Dataset,
    basis: Basis,
    about: str,
    at: int,
    isotropic: bool,
    *,
    coarse: bool = False,
    resisted: bool = True,
) -> StandardForm:
    """The basis at the cells of an incidence, or that with every second knot, or of less resistance; without φ at normal incidence if isotropic."""
    incidence, theta, phi = float(primary["incidence"][at]), primary["theta_s"].values, primary["phi_s"].values
    angles = cell_angles(about, incidence, theta, phi)
    rows = basis.rows(*angles, cos_view(incidence, theta, phi))
    roughness = basis.roughness(*angles, resisted=resisted)
    printed = isinstance(basis, Keldysh) and basis.printed
    if printed:
        weight = np.sqrt(_ring_weights(theta) / bases.solid_angles(theta, phi))
        roughness = roughness * np.concatenate([weight, weight])[:, None]
    terms = (basis.harmonic == 0) | (incidence > 0) | printed | (not isotropic)
    finer = np.eye(terms.size)[:, terms]
    if coarse and isinstance(basis, PSpline):
        finer = basis.coarser * terms[:, None]
        finer = finer[:, finer.any(axis=0)]
    form = StandardForm.of(rows @ finer, roughness @ finer)
    to_basis = finer @ form.to_basis
    return StandardForm(form.rows, form.free, to_basis)


def _ring_weights(theta: Array) -> Array:
    """sin ϑ Δϑ as printed, with Δϑ the distance of neighbouring rings of cells."""
    rings = np.unique(np.round(theta, 1))
    width = np.gradient(rings) if rings.size > 1 else np.ones(1)
    return np.maximum(np.sin(np.radians(theta)), 1e-3) * np.interp(theta, rings, np.radians(width))


def _best_prediction(
    primary: xr.Dataset, cells: list[_CellValues], abouts: Sequence[str], tried: Sequence[Basis], isotropic: bool
) -> tuple[str, Basis]:
    """The coordinates of least cross-validation, on a few wavelengths of all incidences, and the first basis that the next does not improve on.

    A smaller error of prediction counts if it differs by more than its standard deviation, relative √(2/n) of n values: the rule of one standard error
    (Hastie, Tibshirani & Friedman 2009, §7.10).
    """
    few = np.unique(np.linspace(0, primary.sizes["wavelength"] - 1, _COMPARED_WAVELENGTHS).round().astype(int))
    chosen, least = (abouts[0], tried[0]), np.inf
    for basis in tried if len(abouts) * len(tried) > 1 else ():
        score, count = np.zeros(len(abouts)), 0
        for at, values in enumerate(cells):
            value, u = values.value[few], values.u[few]
            # Coordinates are the same at normal incidence, where an isotropic surface has no harmonics.
            if (float(primary["incidence"][at]) == 0 and isotropic) or not np.isfinite(u).any():
                continue
            count += int(np.isfinite(u).sum())
            mean = np.maximum(value, _finite(u, 1.0))
            for number, about in enumerate(abouts):
                form = _standard_form(primary, basis, about, at, isotropic)
                problems = Decomposition.of(form, mean / u, _working_response(value, mean))
                score[number] += float(_summed_cross_validation(problems, _STRENGTHS).min())
        if basis is not tried[0] and not score.min() < least * (1 - np.sqrt(2 / max(count, 2))):
            break
        chosen, least = (abouts[int(score.argmin())], basis), float(score.min())
    return chosen


# --- the fit of one incidence


def _fit(
    form: StandardForm,
    cells: _CellValues,
    mode: str,
    strength: float | None,
    printed: Array | None,
    others: Mapping[str, StandardForm],
) -> _Fit:
    """Fit one incidence. Exact zeros among bright cells are left out; among dim cells they may be noise, and count."""
    used = np.asarray(np.isfinite(cells.u).any(axis=1))
    value, u, common = cells.value[used], cells.u[used], cells.common[:, used]

    def solve(u: Array) -> _Solution:
        if mode == "pspline":
            return _solve_logarithm(form, value, u, strength)
        return _solve_linear(form, value, _weight(u, printed), strength)

    zero = (value == 0) & np.isfinite(u)
    without_zeros = np.where(zero & ~(zero | np.isinf(u)).all(axis=1, keepdims=True), np.inf, u)
    solution = solve(without_zeros)
    missing = zero & (solution.fitted > _IMPOSSIBLE * _finite(u))
    u = np.where(missing, np.inf, u)
    if (np.isfinite(u) != np.isfinite(without_zeros)).any():
        solution = solve(u)
    factor = solution.problems.covariance_factor(
        _strength_of_uncertainty(solution) if mode == "pspline" else solution.strength
    )
    weight = _weight(u, printed)
    # Common errors δz change the solution by its covariance times Bᵀ W² δz.
    squared_weight = solution.fitted / u**2 if mode == "pspline" else weight**2
    shift = _times_covariance(factor, squared_weight * common @ form.rows)
    if printed is not None:
        # Weights that are not those of the noise: its covariance is carried through the smoother.
        gain = factor @ (np.swapaxes(factor, 1, 2) @ (form.rows.T * (weight**2 * _finite(u))[:, None, :]))
        factor = np.swapaxes(np.asarray(np.linalg.qr(np.swapaxes(gain, 1, 2), mode="r")), 1, 2)
    residual = np.where(np.isfinite(u), (value - solution.fitted) / _finite(u, 1.0), np.nan)
    uncertain = {}
    for name, other in others.items():
        working = solution.fitted / u, _working_response(value, solution.fitted)
        uncertain[name] = unresolved(name, other, solution.problems, *working, solution.strength)
    return _Fit(solution, factor, shift, residual, used, int(missing.sum()), uncertain)


def _strength_of_uncertainty(solution: _Solution) -> float:
    """The strength of the covariance: of few cells that of the roughest BSDF, because they cannot tell how rough it is between them."""
    cells = float(solution.problems.counts.max(initial=0.0))
    known = float(np.clip((cells - _FEW_CELLS[0]) / (_FEW_CELLS[1] - _FEW_CELLS[0]), 0.0, 1.0))
    roughest = min(solution.strength, float(_STRENGTHS[0]))
    return float(roughest ** (1 - known) * solution.strength**known)


def _weight(u: Array, printed: Array | None) -> Array:
    return 1 / u if printed is None else np.where(np.isfinite(u), printed, 0.0)


def _solve_linear(form: StandardForm, value: Array, weight: Array, strength: float | None) -> _Solution:
    problems = Decomposition.of(form, weight, value)
    strengths = _RELATIVE_STRENGTHS * float((problems.singular**2).max(initial=1e-300))
    chosen = _best_strength(problems, strengths) if strength is None else strength
    coefficients = problems.solution(chosen)
    return _Solution(problems, strengths, chosen, coefficients, coefficients @ form.rows.T)


def _solve_logarithm(form: StandardForm, value: Array, u: Array, strength: float | None) -> _Solution:
    """Least squares on the logarithm by Newton's method with the expected Hessian; converged wavelengths are not solved again."""
    mean = np.maximum(value, _finite(u, 1.0))
    problems = Decomposition.of(form, mean / u, _working_response(value, mean))
    for passes_left in reversed(range(_PASSES)):
        chosen = _best_strength(problems, _STRENGTHS) if strength is None else strength
        coefficients, before = problems.solution(chosen), mean
        fitted = _exponential(coefficients @ form.rows.T)
        unconverged = _movement(problems, coefficients, before, fitted, value, u, chosen) > _CONVERGED**2
        if not (unconverged.any() and passes_left):
            break
        mean = np.where(unconverged, fitted, before)
        at = np.flatnonzero(unconverged)
        updated = Decomposition.of(form, mean[at] / u[at], _working_response(value[at], mean[at]))
        problems = problems.replaced(at, updated)
    return _Solution(problems, _STRENGTHS, chosen, coefficients, fitted)


def _working_response(value: Array, mean: Array) -> Array:
    """The logarithm of the values, on its tangent at the mean."""
    return np.log(mean) + _relative_misfit(value, mean)


def _relative_misfit(value: Array, mean: Array) -> Array:
    """(value − mean)/mean, limited on both sides: symmetric errors stay so, and values far below the noise move step by step."""
    return np.clip((value - mean) / mean, -_LARGEST_STEP, _LARGEST_STEP)


def _exponential(logarithm: Array) -> Array:
    return np.exp(np.clip(logarithm, -_LARGEST_EXPONENT, _LARGEST_EXPONENT))


def _movement(
    problems: Decomposition, coefficients: Array, before: Array, mean: Array, value: Array, u: Array, strength: float
) -> Array:
    """Squared change of the fitted values by one more pass, over their variance and per parameter (wavelength, 1)."""
    form = problems.form
    penalty = np.where(np.arange(coefficients.shape[1]) < form.free, 0.0, strength)
    gradient = ((mean / u) ** 2 * _relative_misfit(value, mean)) @ form.rows - penalty * coefficients
    # The Hessian is that of the last pass; its growth since is taken to be the same for all coefficients.
    growth = ((mean / u) ** 2).sum(axis=1, keepdims=True) / ((before / u) ** 2).sum(axis=1, keepdims=True)
    step = _times_covariance(problems.covariance_factor(strength), gradient) / growth
    change = np.clip(step @ form.rows.T, -_LARGEST_STEP, _LARGEST_STEP) * mean / u
    return (change**2).sum(axis=1, keepdims=True) / problems.effective_parameters(np.array([strength]))


def _best_strength(problems: Decomposition, strengths: Array) -> float:
    """ε of least cross-validation; the largest if there are too few values."""
    score = _summed_cross_validation(problems, strengths)
    return float(strengths[int(score.argmin())] if np.isfinite(score).any() else strengths[-1])


def _summed_cross_validation(problems: Decomposition, strengths: Array) -> Array:
    """Cross-validation summed over the wavelengths with enough values."""
    score = problems.cross_validation(strengths)
    usable = np.isfinite(score).any(axis=1)
    return score[usable].sum(axis=0) if usable.any() else np.full(strengths.size, np.inf)


def _times_covariance(factor: Array, vectors: Array) -> Array:
    return (factor @ (np.swapaxes(factor, 1, 2) @ vectors[..., None]))[..., 0]


def _finite(u: Array, instead: float = 0.0) -> Array:
    return np.where(np.isfinite(u), u, instead)


# --- the dataset


def _dataset(primary: xr.Dataset, fits: list[_Fit]) -> xr.Dataset:
    shape = (len(fits), primary.sizes["wavelength"])
    terms, width = fits[0].solution.problems.form.to_basis.shape[0], max(fit.factor.shape[2] for fit in fits)
    coefficient = np.full((*shape, terms), np.nan)
    factor = np.zeros((*shape, terms, width), dtype=np.float32)
    components = [*_components(primary, "common"), *fits[0].unresolved]
    common = np.full((len(components), *shape, terms), np.nan)
    residual, chi_squared_dof = np.full((*shape, primary.sizes["cell"]), np.nan), np.full(shape, np.nan)
    for at, fit in enumerate(fits):
        to_basis = fit.solution.problems.form.to_basis
        coefficient[at, fit.used] = fit.solution.coefficients @ to_basis.T
        # A fit with χ² above the degrees of freedom has its uncertainty enlarged accordingly.
        inflation = np.sqrt(np.maximum(np.nan_to_num(fit.chi_squared_dof), 1.0))
        factor[at, fit.used, :, : fit.factor.shape[2]] = to_basis @ (fit.factor * inflation[:, None, None])
        factor[at, ~fit.used] = np.nan
        common[: len(fit.shift), at, fit.used] = fit.shift @ to_basis.T
        for place, change in enumerate(fit.unresolved.values(), len(fit.shift)):
            common[place, at, fit.used] = change
        residual[at, fit.used], chi_squared_dof[at, fit.used] = fit.residual, fit.chi_squared_dof
    smoothed = xr.Dataset(
        {
            "coefficient": (("incidence", "wavelength", "term"), coefficient),
            "coefficient_factor": (("incidence", "wavelength", "term", "factor"), factor),
            "residual": (("incidence", "wavelength", "cell"), residual),
            "chi_squared_dof": (("incidence", "wavelength"), chi_squared_dof),
            "chosen_strength": ("incidence", np.array([fit.solution.strength for fit in fits])),
            **_curves(fits),
        },
        coords={name: primary[name].variable for name in _CELL_COORDINATES if name in primary.coords},
    )
    if common.size:
        smoothed = smoothed.assign_coords(component=components)
        smoothed["coefficient_common"] = (("component", "incidence", "wavelength", "term"), common)
    return vocabulary.label(smoothed, "smoothed")


def _curves(fits: list[_Fit]) -> dict[str, tuple[tuple[str, str], Array]]:
    """Criteria for the choice of ε at the trial strengths: means over the wavelengths of an incidence."""
    criteria = {
        "gcv": Decomposition.cross_validation,
        "chi_squared": Decomposition.chi_squared,
        "roughness": Decomposition.roughness,
        "effective_parameters": Decomposition.effective_parameters,
    }
    curves = {"strength": (("incidence", "trial"), np.stack([fit.solution.strengths for fit in fits]))}
    for name, criterion in criteria.items():
        means = np.full((len(fits), fits[0].solution.strengths.size), np.nan)
        for row, fit in zip(means, fits, strict=True):
            if fit.used.any():
                row[:] = criterion(fit.solution.problems, fit.solution.strengths).mean(axis=0)
        curves[name] = (("incidence", "trial"), np.where(np.isfinite(means), means, np.nan))
    return curves


def _undetermined(incidences: Array, forms: list[StandardForm], cells: list[_CellValues]) -> list[str]:
    """Warnings of incidences at which the cells do not determine all functions, because the finest of these fit between them."""
    warnings = []
    for incidence, form, values in zip(incidences, forms, cells, strict=True):
        used = np.isfinite(values.u).any(axis=0)
        functions, known = int((form.to_basis != 0).any(axis=1).sum()), int(np.linalg.matrix_rank(form.rows[used]))
        if used.any() and known < functions:
            warnings.append(
                f"The cells at {incidence:g}° determine only {known} of {functions} functions: between cells the fit may be off by many times its "
                "uncertainty. Give fewer `scales`, or use `pspline`."
            )
    return warnings


def _with_notes(smoothed: xr.Dataset, fits: list[_Fit], strength: float | None) -> xr.Dataset:
    mode, about = smoothed.attrs["mode"], smoothed.attrs["about"]
    how = "as given" if strength is not None else "of least cross-validation"
    history = f"smoothed by {mode} in {about} coordinates, ε {how}, each wavelength with its own mask and weights 1/u²"
    warnings = []
    if mode == "keldysh-printed":
        warnings.append(
            "The basis and the weights of the preprint are for comparison only: their errors at narrow lobes exceed 100 %. Use `pspline`."
        )
    if zeros := sum(fit.zeros for fit in fits):
        warnings.append(
            f"{zeros} values of exactly 0 lie among bright ones: taken for missing values and left out. Store missing values as NaN."
        )
    if empty := sum(int((~fit.used).sum()) for fit in fits):
        warnings.append(
            f"{empty} of {smoothed['chi_squared_dof'].size} fits, one for each incidence and wavelength, have no cell with a value."
        )
    for fit, incidence in zip(fits, smoothed["incidence"].values, strict=True):
        if mode == "pspline" and fit.used.any() and (most := fit.solution.problems.counts.max()) < _FEW_CELLS[0]:
            number = f"{most:g} cells with values, which do" if most > 1 else "1 cell with a value, which does"
            warnings.append(
                f"The fit at {incidence:g}° has only {number} not tell how far off it is "
                "elsewhere: its uncertainty is that of the roughest BSDF. Measure more cells."
            )
        elif fit.used.any() and np.isnan(fit.chi_squared_dof).any():
            warnings.append(
                f"The fit at {incidence:g}° has as many parameters as cells with values: nothing tells how far off it is between them, and its "
                "uncertainty there is too small. Measure more cells."
            )
    if mode == "pspline" and strength is not None and strength < _STRENGTHS[0]:
        warnings.append(
            f"The given strength ε = {strength:g} is below {_STRENGTHS[0]:g}: between distant cells the fit is hardly bounded, and may be off by "
            "many times its uncertainty. Give a larger strength, or none."
        )
    poor = smoothed["chi_squared_dof"].max("wavelength")
    for incidence, worst in zip(poor["incidence"].values, poor.values, strict=True):
        if worst > _MISFIT and mode != "keldysh-printed":
            warnings.append(
                f"Poor fit at {incidence:g}°: the rms residual is {np.sqrt(worst):.1f} times the stated uncertainty, and the fit's uncertainty was enlarged. "
                "Check the map of residuals for wrong cells, or for a lobe narrower than the cells resolve."
            )
    warnings += symmetry_warnings(smoothed)
    return vocabulary.add_warning(vocabulary.add_history(smoothed, history), *warnings)
