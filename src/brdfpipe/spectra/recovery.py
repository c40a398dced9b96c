"""Reflectance spectra from colours: the smoothest one in (0, 1) that has the colour exactly, or mixtures of four basis spectra."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from brdfpipe import vocabulary
from brdfpipe.errors import BrdfpipeError, InputError
from brdfpipe.optics.fresnel_equations import fresnel
from brdfpipe.optics.index import interpolate_index
from brdfpipe.spectra import colorimetry, mixing

Array = NDArray[np.float64]

METHODS = ("lhtss", "basis4", *mixing.SEARCHES)
"""Ways from a colour to a spectrum; see :func:`recover`."""
LIGHTS = ("A", "FL2", "LED-B3")
"""Illuminants under which spectra of one colour are compared."""

_KEY = "spectrum.lab"
_TOLERANCE = 1e-8
# On tristimulus values with Y = 1 for white: 4e-8 in L*a*b*, whose slope is 3900 at black.
_COLOUR_TOLERANCE = 1e-11
# r = 1/(1 + e^(2·25)) is 2e-22: beyond, a colour is out of reach and the system has lost its rank.
_LARGEST_Z = 25.0
_LONGEST_STEP = 2.0
_ITERATIONS = 100
_CHUNK = 256


class Recovered(NamedTuple):
    """Spectra of many colours."""

    wavelength: Array
    """(n,) nm: 360 to 780 by 5."""
    reflectance: Array
    """(B, n) from the floor to 1; NaN where the colour is out of reach."""
    reached: NDArray[np.bool_]
    """(B,) whether a reflectance between the floor and 1 has this colour."""


def recover(
    lab: ArrayLike,
    *,
    illuminant: str,
    observer: int,
    method: str = "lhtss",
    threshold: float = mixing.THRESHOLD,
    seed: int = 0,
    specular_index: float | xr.Dataset | None = None,
    theta: float = 8.0,
    geometry: str | None = None,
    checkpoint: Path | None = None,
    progress: bool = False,
) -> xr.Dataset:
    """Total reflectance of one colour.

    Parameters
    ----------
    lab : (3,) CIE 1976 L*, a*, b*; 0 <= L* <= 100
    illuminant, observer : what the colour was measured for, see :func:`brdfpipe.spectra.colorimetry.weights`
    method : ``lhtss``, least hyperbolic tangent slope squared; or a mixture of four basis spectra: ``basis4``, in closed form,
        ``random4`` and ``adaptive4``, by random search (:func:`brdfpipe.spectra.mixing.search`)
    threshold, seed : of a search: ΔE*ab at which it ends, and of its random numbers
    specular_index : if given, a number or a dataset of kind ``index``: the colour includes the specular reflection of a smooth
        surface of this index, and the spectrum stays at or above its Fresnel reflectance, wavelength by wavelength
    theta : degree, incidence of the measurement
    geometry : ``sci`` or ``sce``, recorded; by default ``sci``
    checkpoint, progress : of a search: the file it resumes from, and whether to show a progress bar

    Returns
    -------
    Dataset of kind ``spectrum`` on 360 to 780 nm by 5; attributes ``geometry``, ``theta_i``, ``method``,
    ``residual_delta_e`` (ΔE*ab of the spectrum to ``lab``), ``illuminant``, ``observer`` and, if given, ``specular_index``. Where
    the other exact method, ``basis4`` or ``lhtss``, reaches the colour too, ``metamerism_<light>`` is ΔE00 to its spectrum under
    each of :data:`LIGHTS`: what the choice of the method may cost. ``specular_index`` of a dispersive index is that at 589.3 nm

    Raises
    ------
    InputError : not a colour; out of reach of any reflectance or of any mixture (with the nearest colour within reach); or
        darker than the specular reflection it is said to include.

    Notes
    -----
    r = R_s + (1 − R_s) r′ with R_s = F(θ, n(λ)); r′ is the smoothest whose XYZ under the weights (1 − R_s) W are those of the
    colour less R_s W. For a constant index that is r′ recovered from XYZ′ = (XYZ − R_s XYZ_w)/(1 − R_s).
    L* = 0 and L* = 100 without chroma are 0 and 1 at every wavelength, the limits that atanh does not reach.

    References
    ----------
    Burns, "Numerical methods for smoothest reflectance reconstruction", Color Res. Appl. 45 (2020) 8–21 (method LHTSS).
    """
    if method not in METHODS:
        raise _refusal("unknown method of recovery", found=repr(method)[:40], accepted=", ".join(METHODS))
    if not (np.isfinite(threshold) and threshold > 0):
        raise _refusal("no threshold", found=repr(threshold)[:40], accepted="a ΔE*ab above 0", key="spectrum.threshold")
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise _refusal("no seed", found=repr(seed)[:40], accepted="a whole number from 0", key="spectrum.seed")
    colour = _checked_lab(lab)
    illuminant, table = _viewing(illuminant, observer)
    specular = np.zeros(table.wavelength.size)
    if specular_index is not None:
        specular = specular_reflectance(specular_index, theta, table.wavelength)
    search = mixing.Found(np.empty(0), 0.0, 0, "threshold")
    if method in mixing.SEARCHES:
        _check_mixable(colour, illuminant, observer, specular, threshold)
        search = mixing.search(
            colour,
            illuminant=illuminant,
            observer=observer,
            method=method,
            threshold=threshold,
            seed=seed,
            floor=specular,
            checkpoint=checkpoint,
            progress=progress,
        )
        mixture = np.minimum(search.weights @ mixing.basis(), 1.0)
        reflectance: Array | None = specular + (1 - specular) * mixture
    else:
        reflectance = _spectrum(colour, illuminant, observer, specular, method)
    if reflectance is None:
        if method == "basis4":
            _check_mixable(colour, illuminant, observer, specular, 0.0)
        raise _unreachable(colour, illuminant, observer, specular, specular_index)
    found = colorimetry.xyz_to_lab(reflectance @ table.weights, table.white)
    attrs = {
        "geometry": geometry or "sci",
        "theta_i": float(theta),
        "method": method,
        "residual_delta_e": float(colorimetry.delta_e_ab(found, colour)),
        "illuminant": illuminant,
        "observer": int(observer),
        **({} if specular_index is None else {"specular_index": _sodium_index(specular_index)}),
        **({"seed": int(seed), "threshold": float(threshold), "tried": search.tried} if search.tried else {}),
        **_metamerism(reflectance, colour, illuminant, observer, specular, method),
    }
    dataset = xr.Dataset(
        {"total_reflectance": ("wavelength", reflectance)}, coords={"wavelength": table.wavelength}, attrs=attrs
    )
    sentence = f"recovered by {method} from L*a*b* {_words(colour)} ({illuminant}, {observer} degree)"
    dataset = vocabulary.add_history(vocabulary.label(dataset, "spectrum"), sentence)
    if search.ended == "threshold":
        return dataset
    why = f"{'was stopped on request' if search.ended == 'stopped' else 'ended'} after {search.tried} mixtures"
    return vocabulary.add_warning(
        dataset,
        f"the search for a spectrum {why}, ΔE {search.delta_e:.3g} from the colour where {threshold:g} was wanted; remove "
        "spectrum.nc to search on from there, or use `spectrum.method: lhtss`, which is exact.",
    )


def metamerism(
    lab: ArrayLike,
    *,
    illuminant: str,
    observer: int,
    methods: Sequence[str] = METHODS,
    threshold: float = mixing.THRESHOLD,
    seed: int = 0,
    specular_index: float | xr.Dataset | None = None,
    theta: float = 8.0,
) -> xr.Dataset:
    """How far the spectra that different methods give one colour differ under other light.

    Parameters
    ----------
    lab, illuminant, observer, threshold, seed, specular_index, theta : see :func:`recover`
    methods : those to compare

    Returns
    -------
    Dataset : ``total_reflectance(recovery, wavelength)``; ``delta_e00(light, recovery, other)``, ΔE00 between two methods under each
    of :data:`LIGHTS`; ``residual_delta_e(recovery)``, ΔE*ab to ``lab``. Methods that do not reach the colour are left out, and a
    warning says so and why

    Raises
    ------
    InputError : as :func:`recover`, where no method reaches the colour; or an unknown method.
    """
    spectrum_of: dict[str, xr.Dataset] = {}
    left_out: dict[str, InputError] = {}
    for method in methods:
        try:
            spectrum_of[method] = recover(
                lab,
                illuminant=illuminant,
                observer=observer,
                method=method,
                threshold=threshold,
                seed=seed,
                specular_index=specular_index,
                theta=theta,
            )
        except InputError as error:
            if method not in METHODS:
                raise
            left_out[method] = error
    if not spectrum_of:
        raise next(iter(left_out.values()))
    found = list(spectrum_of.values())
    spectra = np.stack([spectrum["total_reflectance"].values for spectrum in found])
    pairs = np.stack([_difference(spectra[:, None], spectra[None], light, observer) for light in LIGHTS])
    own = [spectrum.attrs["residual_delta_e"] for spectrum in found]
    dataset = xr.Dataset(
        {
            "total_reflectance": (("recovery", "wavelength"), spectra),
            "delta_e00": (
                ("light", "recovery", "other"),
                pairs,
                {"units": "1", "long_name": "colour difference CIEDE2000"},
            ),
            "residual_delta_e": ("recovery", own, {"units": "1", "long_name": "ΔE*ab to the colour wanted"}),
        },
        coords={
            "recovery": list(spectrum_of),
            "other": list(spectrum_of),
            "light": list(LIGHTS),
            "wavelength": found[0]["wavelength"],
        },
        attrs={"illuminant": found[0].attrs["illuminant"], "observer": int(observer)},
    )
    for name in ("total_reflectance", "wavelength"):
        dataset[name].attrs = dict(found[0][name].attrs)
    reasons = [f"{method} was left out: {error}" for method, error in left_out.items()]
    return vocabulary.add_warning(dataset, *reasons) if reasons else dataset


def specular_reflectance(index: float | xr.Dataset, theta: float, wavelength: Array) -> Array:
    """Fresnel reflectance (n,) of a smooth surface for unpolarised light.

    Parameters
    ----------
    index : a number, or a dataset of kind ``index``; beyond its wavelengths it is held at its ends
    theta : degree, incidence
    wavelength : (n,) nm
    """
    if isinstance(index, xr.Dataset):
        known = index["wavelength"].values
        n, k = interpolate_index(index, np.clip(wavelength, known.min(), known.max()))
    else:
        n, k = np.full(wavelength.size, float(index)), np.zeros(wavelength.size)
    return np.asarray(fresnel(np.cos(np.radians(theta)), n, k).mean, dtype=np.float64)


def lhtss(xyz: ArrayLike, *, illuminant: str, observer: int, floor: ArrayLike = 0.0) -> Recovered:
    """Spectra of many colours at once, by least hyperbolic tangent slope squared.

    Parameters
    ----------
    xyz : (B, 3) tristimulus values, Y = 100 for the perfect diffuser
    illuminant, observer : see :func:`brdfpipe.spectra.colorimetry.weights`
    floor : () or (n,), what every spectrum has beneath the smoothest (specular), 0 <= floor < 1: R = floor + (1 − floor) r

    Returns
    -------
    Recovered : a colour out of reach gives NaN and ``reached`` False, never a wrong spectrum

    Notes
    -----
    Minimises Σ (z_{i+1} − z_i)² subject to XYZ(r) = XYZ, with r = (1 + tanh z)/2, by Newton's method on the stationarity
    conditions, from z = atanh(2Y − 1). A step is shortened as a whole to |Δz| <= 2: shortening each element on its own turns
    the step away and loses one saturated colour in eight.

    References
    ----------
    Burns, "Numerical methods for smoothest reflectance reconstruction", Color Res. Appl. 45 (2020) 8–21.
    """
    table = colorimetry.weights(illuminant, observer)
    under = np.broadcast_to(np.asarray(floor, dtype=float), table.wavelength.size)
    above = table.weights * (1 - under)[:, None]
    # Y = 1 for r = 1 throughout.
    white = float(above[:, 1].sum())
    colours = (np.atleast_2d(np.asarray(xyz, dtype=float)) - under @ table.weights) / white
    # Chunks keep the steps in the cache.
    parts = [_newton(colours[start : start + _CHUNK], above / white) for start in range(0, len(colours), _CHUNK)]
    z = np.concatenate(parts) if parts else np.empty((0, table.wavelength.size))
    reached = np.asarray(np.isfinite(z).all(axis=1))
    return Recovered(table.wavelength, under + (1 - under) * _logistic(z), reached)


def largest_chroma(lab: ArrayLike, *, illuminant: str, observer: int, specular: ArrayLike = 0.0) -> float:
    """Largest C*ab that a reflectance reaches at the L* and hue of a colour, from below, to 0.1 % of its own C*.

    Parameters
    ----------
    lab : (3,), 0 < L* < 100
    illuminant, observer : see :func:`brdfpipe.spectra.colorimetry.weights`
    specular : reflectance every wavelength has at least [1]
    """
    colour, white = np.asarray(lab, dtype=float), colorimetry.weights(illuminant, observer).white
    low, high, pieces = 0.0, 1.0, 32
    for _ in range(2):
        scale = np.linspace(low, high, pieces + 1)
        xyz = colorimetry.lab_to_xyz(colour * np.stack([np.ones_like(scale), scale, scale], axis=1), white)
        reached = lhtss(xyz, illuminant=illuminant, observer=observer, floor=specular).reached
        last = int(np.argmin(reached)) - 1 if not reached.all() else pieces
        if last < 0:
            return 0.0
        low, high = scale[last], scale[min(last + 1, pieces)]
    return float(low * np.hypot(*colour[1:]))


def nearest_colour(lab: ArrayLike, *, illuminant: str, observer: int, specular: ArrayLike = 0.0) -> Array:
    """Colour that a reflectance reaches, about nearest to one out of reach by ΔE*ab.

    Parameters
    ----------
    lab : (3,) CIE 1976 L*, a*, b*, of two decimals
    illuminant, observer : see :func:`brdfpipe.spectra.colorimetry.weights`
    specular : reflectance every wavelength has at least [1]

    Returns
    -------
    lab : (3,) rounded to two decimals; :func:`lhtss` reaches it

    Notes
    -----
    Minimises ΔE*ab² over the reflectance at every wavelength within its bounds. The minimum lies on the boundary of the solid
    of object colours, where reflectances are at their bounds; a small step towards grey is within reach.
    """
    from scipy.optimize import minimize

    wanted, table = np.asarray(lab, dtype=float), colorimetry.weights(illuminant, observer)

    def square(r: Array) -> tuple[float, Array]:
        xyz = r @ table.weights
        off = colorimetry.xyz_to_lab(xyz, table.white) - wanted
        return float(off @ off), 2 * table.weights @ (_lab_slopes(xyz, table.white).T @ off)

    floor = np.broadcast_to(np.asarray(specular, dtype=float), table.wavelength.size)
    start = np.clip(colorimetry.lab_to_xyz(wanted, table.white)[1] / 100, floor + 1e-3, 1 - 1e-3)
    # Far out ΔE² is large and falls slowly: a looser bound on its relative fall ends the descent a few ΔE short.
    options: Any = {"maxiter": 5000, "maxfun": 50_000, "ftol": 1e-14, "gtol": 1e-9}
    bounds = [(float(lowest), 1.0) for lowest in floor]
    best = minimize(square, start, jac=True, bounds=bounds, method="L-BFGS-B", options=options).x
    grey = np.clip(best @ table.weights[:, 1] / 100, floor + 1e-3, 1 - 1e-3)
    share = np.append(0.0, np.geomspace(1e-6, 1, 64))[:, None]
    xyz = ((1 - share) * best + share * grey) @ table.weights
    near = np.round(colorimetry.xyz_to_lab(xyz, table.white), 2) + 0.0
    within = lhtss(colorimetry.lab_to_xyz(near, table.white), illuminant=illuminant, observer=observer, floor=floor)
    return np.asarray(near[np.argmax(within.reached)])


def _lab_slopes(xyz: Array, white: Array) -> Array:
    """∂(L*, a*, b*)/∂(X, Y, Z), (3, 3)."""
    t = xyz / white
    slope = np.where(t > 216 / 24389, np.cbrt(np.maximum(t, 1e-6)) ** -2 / 3, 24389 / 27 / 116) / white
    mixed = np.array([[0, 116, 0], [500, -500, 0], [0, 200, -200]], dtype=float)
    return np.asarray(mixed * slope)


def _difference(first: Array, second: Array, light: str, observer: int) -> Array:
    """ΔE00 between reflectances (..., n) on the grid, under a light."""
    table = colorimetry.weights(light, observer)
    return colorimetry.delta_e_00(
        colorimetry.xyz_to_lab(first @ table.weights, table.white),
        colorimetry.xyz_to_lab(second @ table.weights, table.white),
    )


def _metamerism(
    reflectance: Array, lab: Array, illuminant: str, observer: int, specular: Array, method: str
) -> dict[str, float | str]:
    against = "basis4" if method == "lhtss" else "lhtss"
    other = _spectrum(lab, illuminant, observer, specular, against)
    if other is None:
        return {}
    apart = {f"metamerism_{light}": float(_difference(reflectance, other, light, observer)) for light in LIGHTS}
    return {"metamerism_against": against, **apart}


def _spectrum(lab: Array, illuminant: str, observer: int, specular: Array, method: str = "lhtss") -> Array | None:
    table = colorimetry.weights(illuminant, observer)
    if lab[1] == 0 and lab[2] == 0 and lab[0] in ((0.0, 100.0) if method == "lhtss" else (0.0,)):
        return None if lab[0] == 0 and specular.any() else np.full(table.wavelength.size, lab[0] / 100)
    exact = lhtss if method == "lhtss" else mixing.closed_form
    found = exact(colorimetry.lab_to_xyz(lab, table.white), illuminant=illuminant, observer=observer, floor=specular)
    return np.asarray(found.reflectance[0]) if found.reached[0] else None


def _check_mixable(lab: Array, illuminant: str, observer: int, specular: Array, threshold: float) -> None:
    """Refuse a colour that no mixture comes near enough to; a search for it would not end."""
    if _spectrum(lab, illuminant, observer, specular, "basis4") is not None:
        return
    near = mixing.nearest(lab, illuminant=illuminant, observer=observer, floor=specular)
    apart = float(colorimetry.delta_e_ab(near, lab))
    if apart >= threshold:
        raise _refusal(
            "no mixture of the four basis spectra has this colour",
            found=f"L*a*b* {_words(lab)}",
            accepted=f"lhtss; or a colour like the nearest one, L*a*b* {_words(np.round(near, 2) + 0.0)}, ΔE {apart:.2f} away",
            key="spectrum.method",
        )


def _unreachable(
    lab: Array, illuminant: str, observer: int, specular: Array, index: float | xr.Dataset | None
) -> InputError:
    if index is not None and _spectrum(lab, illuminant, observer, np.zeros_like(specular)) is not None:
        return InputError(
            "material.yaml",
            f"no spectrum of this colour stays above {_span(specular, '.4f')}, the specular reflectance of index "
            f"{index_words(index)}; was the specular excluded (SCE)",
            where=_KEY,
            found=f"L*a*b* {_words(lab)}",
            accepted=f"a colour measured with the specular included, the nearest being {_near(lab, illuminant, observer, specular)}; "
            "`geometry: sce`, or the index of this material",
            key="spectrum.geometry",
        )
    chroma = float(np.hypot(lab[1], lab[2]))
    if 0 < lab[0] < 100:
        largest = largest_chroma(lab, illuminant=illuminant, observer=observer)
        accepted = f"C* up to {largest:.2f} at this L* and hue; check illuminant and observer"
    else:
        accepted = "a* = b* = 0 at L* = 0 and L* = 100"
    return _refusal(
        "no reflectance has this colour",
        found=f"L*a*b* {_words(lab)}, C* = {chroma:.2f}",
        accepted=f"{accepted}. The nearest colour is {_near(lab, illuminant, observer, np.zeros_like(specular))}",
    )


def index_words(index: float | xr.Dataset) -> str:
    """A refractive index in words: a number, or from least to largest."""
    return _span(np.atleast_1d(index["n"].values if isinstance(index, xr.Dataset) else index), ".4g")


def _span(values: Array, form: str) -> str:
    least, most = (f"{value:{form}}" for value in (values.min(), values.max()))
    return least if least == most else f"{least} to {most}"


def _sodium_index(index: float | xr.Dataset) -> float:
    return float(interpolate_index(index, 589.3)[0] if isinstance(index, xr.Dataset) else index)


def _near(lab: Array, illuminant: str, observer: int, specular: Array) -> str:
    near = nearest_colour(lab, illuminant=illuminant, observer=observer, specular=specular)
    return f"L*a*b* {_words(near)}, ΔE {float(colorimetry.delta_e_ab(near, lab)):.2f} away"


def _newton(xyz: Array, a: Array) -> Array:
    """The z (B, n) of colours (B, 3) for weights (n, 3), both with Y = 1 for white; NaN where no solution was reached."""
    count, size = len(xyz), len(a)
    z = np.full((count, size), np.nan)
    active = np.flatnonzero((xyz > 0).all(axis=1) & (xyz[:, 1] < 1))
    z_now = np.repeat(np.arctanh(2 * xyz[active, 1:2] - 1), size, axis=1)
    multiplier = np.zeros((active.size, 3))
    tolerance = np.concatenate([np.full(size, _TOLERANCE), np.full(3, _COLOUR_TOLERANCE)])
    for _ in range(_ITERATIONS):
        if active.size == 0:
            break
        r = _logistic(z_now)
        pull = multiplier @ a.T
        slope = 2 * r * (1 - r)
        residual = np.concatenate([_roughness_slope(z_now) + slope * pull, r @ a - xyz[active]], axis=1)
        done = (np.abs(residual) < tolerance).all(axis=1)
        z[active[done]] = z_now[done]
        active, z_now, multiplier = active[~done], z_now[~done], multiplier[~done]
        curvature = 2 * slope * (1 - 2 * r) * pull
        step = _step(a, slope[~done], curvature[~done], residual[~done])
        longest = np.abs(step[:, :size]).max(axis=1)
        step *= np.minimum(1.0, _LONGEST_STEP / np.maximum(longest, _TOLERANCE))[:, None]
        z_now, multiplier = z_now + step[:, :size], multiplier + step[:, size:]
        alive = np.isfinite(step).all(axis=1) & (np.abs(z_now).max(axis=1) < _LARGEST_Z)
        active, z_now, multiplier = active[alive], z_now[alive], multiplier[alive]
    return z


def _roughness_slope(z: Array) -> Array:
    """∂ Σ (z_{i+1} − z_i)² / ∂z, (B, n)."""
    rises = np.diff(z, axis=1)
    return 2 * (np.pad(rises, ((0, 0), (1, 0))) - np.pad(rises, ((0, 0), (0, 1))))


def _step(a: Array, slope: Array, curvature: Array, residual: Array) -> Array:
    """Newton's step (B, n + 3): of the z, whose rows form a tridiagonal matrix, and of the three multipliers that border it.

    All z but the last are eliminated in turn. The last stays with the multipliers, four unknowns solved with pivoting: as long as
    the multipliers are 0 the tridiagonal matrix, a second difference, has no inverse of its own.
    """
    count, size = slope.shape
    diagonal = curvature.T + np.where(np.isin(np.arange(size), (0, size - 1)), 2.0, 4.0)[:, None]
    # The border's three columns and the right side, (n, 4, B).
    rows = np.concatenate([a[:, :, None] * slope.T[:, None, :], -residual[:, None, :size].T], axis=1)
    pivot = np.empty_like(diagonal)
    pivot[0] = _off_zero(diagonal[0])
    for i in range(1, size):
        pivot[i] = _off_zero(diagonal[i] - 4 / pivot[i - 1])
        rows[i] += rows[i - 1] * (2 / pivot[i - 1])
    border, right = rows[:, :3], rows[:, 3]
    part = border[:-1] / pivot[:-1, None]
    system, constant = np.empty((count, 4, 4)), np.empty((count, 4))
    system[:, 0, 0] = pivot[-1]
    system[:, 0, 1:] = system[:, 1:, 0] = border[-1].T
    # Far below any weight: keeps a lost row from being singular without moving the solution.
    system[:, 1:, 1:] = -1e-14 * np.eye(3) - np.einsum("nib,njb->bij", part, border[:-1], optimize=True)
    constant[:, 0] = right[-1]
    constant[:, 1:] = -residual[:, size:] - np.einsum("nib,nb->bi", part, right[:-1])
    ends = _solved(system, constant)
    right = right - np.einsum("nib,bi->nb", border, ends[:, 1:])
    step = np.empty((size, count))
    step[-1] = ends[:, 0]
    for i in range(size - 2, -1, -1):
        step[i] = (right[i] + 2 * step[i + 1]) / pivot[i]
    return np.concatenate([step.T, ends[:, 1:]], axis=1)


def _off_zero(pivot: Array) -> Array:
    # A pivot may vanish where the matrix is indefinite; moved by less than a step's rounding, it costs Newton at most a step.
    return np.where(np.abs(pivot) < 1e-12, 1e-12, pivot)


def _solved(system: Array, constant: Array) -> Array:
    try:
        return np.asarray(np.linalg.solve(system, constant[..., None])[..., 0], dtype=np.float64)
    except np.linalg.LinAlgError:
        # One lost colour must not take the others with it.
        ranks = np.linalg.matrix_rank(system) == system.shape[1]
        found = np.full_like(constant, np.nan)
        found[ranks] = np.linalg.solve(system[ranks], constant[ranks][..., None])[..., 0]
        return found


def _logistic(z: Array) -> Array:
    # (1 + tanh z)/2, with full relative precision near 0.
    r: Array = 1 / (1 + np.exp(-2 * z))
    return r


def _viewing(illuminant: str, observer: int) -> tuple[str, colorimetry.Weights]:
    """The illuminant's name as CIE spells it, and the weights; refused with the key that mends it."""
    try:
        name = colorimetry.illuminant_name(illuminant)
    except BrdfpipeError as error:
        raise InputError("material.yaml", str(error), where="spectrum", key="spectrum.illuminant") from error
    try:
        return name, colorimetry.weights(name, observer)
    except BrdfpipeError as error:
        raise InputError("material.yaml", str(error), where="spectrum", key="spectrum.observer") from error


def _checked_lab(lab: ArrayLike) -> Array:
    try:
        colour = np.asarray(lab, dtype=float)
    except (TypeError, ValueError):
        colour = np.empty(0)
    if colour.shape != (3,) or not np.isfinite(colour).all() or not 0 <= colour[0] <= 100:
        raise _refusal("not a colour", found=repr(lab)[:60], accepted="[L*, a*, b*] with 0 <= L* <= 100")
    return colour


def _words(lab: Sequence[float] | Array) -> str:
    return "({})".format(", ".join(f"{value:g}" for value in lab))


def _refusal(problem: str, *, found: str, accepted: str, key: str = _KEY) -> InputError:
    return InputError("material.yaml", problem, where=_KEY, found=found, accepted=accepted, key=key)
