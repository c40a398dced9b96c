"""Reflectance spectra from colours: the smoothest one in (0, 1) that has the colour exactly, or mixtures of four basis spectra."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from brdfpipe import vocabulary
from brdfpipe.errors import BrdfpipeError, InputError
from brdfpipe.optics import fresnel
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
    """(B, n) in (0, 1); NaN where the colour is out of reach."""
    reached: NDArray[np.bool_]
    """(B,) whether a reflectance in (0, 1) has this colour."""


def recover(
    lab: ArrayLike,
    *,
    illuminant: str,
    observer: int,
    method: str = "lhtss",
    threshold: float = mixing.THRESHOLD,
    seed: int = 0,
    specular_index: float | None = None,
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
    specular_index : if given, the colour includes the specular reflection of a smooth surface of this index, and the spectrum
        stays at or above its Fresnel reflectance
    theta : degree, incidence of the measurement
    geometry : ``sci`` or ``sce``, recorded; by default ``sci``
    checkpoint, progress : of a search: the file it resumes from, and whether to show a progress bar

    Returns
    -------
    Dataset of kind ``spectrum`` on 360 to 780 nm by 5; attributes ``geometry``, ``theta_i``, ``method``,
    ``residual_delta_e`` (ΔE*ab of the spectrum to ``lab``), ``illuminant``, ``observer`` and, if given, ``specular_index``. Where
    the other exact method, ``basis4`` or ``lhtss``, reaches the colour too, ``metamerism_<light>`` is ΔE00 to its spectrum under
    each of :data:`LIGHTS`: what the choice of the method may cost

    Raises
    ------
    InputError : not a colour; out of reach of any reflectance or of any mixture (with the nearest colour within reach); or
        darker than the specular reflection it is said to include.

    Notes
    -----
    With R_s = F(θ, n): XYZ′ = (XYZ − R_s XYZ_w)/(1 − R_s), r = R_s + (1 − R_s) r′, r′ recovered from XYZ′.
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
    specular = 0.0 if specular_index is None else float(fresnel(np.cos(np.radians(theta)), specular_index).mean)
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
        mixture = np.minimum(search.weights @ colorimetry.basis()[1], 1.0)
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
        **({} if specular_index is None else {"specular_index": float(specular_index)}),
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
    why = "was stopped on request" if search.ended == "stopped" else f"ended after {search.tried} mixtures"
    return vocabulary.add_warning(
        dataset,
        f"the search for a spectrum {why}, ΔE {search.delta_e:.3g} from the colour where {threshold:g} was wanted; remove "
        "spectrum.nc to search on, or use `spectrum.method: lhtss`, which is exact.",
    )


def metamerism(
    lab: ArrayLike,
    *,
    illuminant: str,
    observer: int,
    methods: Sequence[str] = METHODS,
    threshold: float = mixing.THRESHOLD,
    seed: int = 0,
    specular_index: float | None = None,
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
    of :data:`LIGHTS`; ``residual_delta_e(recovery)``, ΔE*ab to ``lab``

    Raises
    ------
    InputError : as :func:`recover`, for the first method that does not reach the colour.
    """
    found = [
        recover(
            lab,
            illuminant=illuminant,
            observer=observer,
            method=method,
            threshold=threshold,
            seed=seed,
            specular_index=specular_index,
            theta=theta,
        )
        for method in methods
    ]
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
            "recovery": list(methods),
            "other": list(methods),
            "light": list(LIGHTS),
            "wavelength": found[0]["wavelength"],
        },
        attrs={"illuminant": found[0].attrs["illuminant"], "observer": int(observer)},
    )
    for name in ("total_reflectance", "wavelength"):
        dataset[name].attrs = dict(found[0][name].attrs)
    return dataset


def lhtss(xyz: ArrayLike, *, illuminant: str, observer: int) -> Recovered:
    """Spectra of many colours at once, by least hyperbolic tangent slope squared.

    Parameters
    ----------
    xyz : (B, 3) tristimulus values, Y = 100 for the perfect diffuser
    illuminant, observer : see :func:`brdfpipe.spectra.colorimetry.weights`

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
    colours = np.atleast_2d(np.asarray(xyz, dtype=float)) / 100
    # Chunks keep the systems in the cache and the memory small.
    parts = [_newton(colours[start : start + _CHUNK], table.weights / 100) for start in range(0, len(colours), _CHUNK)]
    z = np.concatenate(parts) if parts else np.empty((0, table.wavelength.size))
    reached = np.asarray(np.isfinite(z).all(axis=1))
    return Recovered(table.wavelength, _logistic(z), reached)


def largest_chroma(lab: ArrayLike, *, illuminant: str, observer: int, specular: float = 0.0) -> float:
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
        reached = lhtss((xyz - specular * white) / (1 - specular), illuminant=illuminant, observer=observer).reached
        last = int(np.argmin(reached)) - 1 if not reached.all() else pieces
        if last < 0:
            return 0.0
        low, high = scale[last], scale[min(last + 1, pieces)]
    return float(low * np.hypot(*colour[1:]))


def nearest_colour(lab: ArrayLike, *, illuminant: str, observer: int, specular: float = 0.0) -> Array:
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
    of object colours, where reflectances are 0 or 1; a step of some per mille towards grey is within reach.
    """
    from scipy.optimize import minimize

    wanted, table = np.asarray(lab, dtype=float), colorimetry.weights(illuminant, observer)

    def square(r: Array) -> tuple[float, Array]:
        xyz = r @ table.weights
        off = colorimetry.xyz_to_lab(xyz, table.white) - wanted
        return float(off @ off), 2 * table.weights @ (_lab_slopes(xyz, table.white).T @ off)

    y = float(np.clip(colorimetry.lab_to_xyz(wanted, table.white)[1] / 100, specular + 1e-3, 1 - 1e-3))
    size = table.wavelength.size
    bounds = [(specular, 1.0)] * size
    best = minimize(square, np.full(size, y), jac=True, bounds=bounds, method="L-BFGS-B", options={"maxiter": 2000}).x
    grey = float(np.clip(best @ table.weights[:, 1] / 100, specular + 1e-3, 1 - 1e-3))
    for share in (0.0, *np.geomspace(1e-3, 1, 25)):
        xyz = ((1 - share) * best + share * grey) @ table.weights
        near = np.round(colorimetry.xyz_to_lab(xyz, table.white), 2) + 0.0
        if _spectrum(near, illuminant, observer, specular) is not None:
            break
    return near


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
    reflectance: Array, lab: Array, illuminant: str, observer: int, specular: float, method: str
) -> dict[str, float | str]:
    against = "basis4" if method == "lhtss" else "lhtss"
    other = _spectrum(lab, illuminant, observer, specular, against)
    if other is None:
        return {}
    apart = {f"metamerism_{light}": float(_difference(reflectance, other, light, observer)) for light in LIGHTS}
    return {"metamerism_against": against, **apart}


def _spectrum(lab: Array, illuminant: str, observer: int, specular: float, method: str = "lhtss") -> Array | None:
    table = colorimetry.weights(illuminant, observer)
    if lab[1] == 0 and lab[2] == 0 and lab[0] in ((0.0, 100.0) if method == "lhtss" else (0.0,)):
        return None if lab[0] == 0 and specular > 0 else np.full(table.wavelength.size, lab[0] / 100)
    xyz = colorimetry.lab_to_xyz(lab, table.white)
    within = (xyz - specular * table.white) / (1 - specular)
    exact = lhtss if method == "lhtss" else mixing.closed_form
    found = exact(within, illuminant=illuminant, observer=observer)
    return specular + (1 - specular) * found.reflectance[0] if found.reached[0] else None


def _check_mixable(lab: Array, illuminant: str, observer: int, specular: float, threshold: float) -> None:
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


def _unreachable(lab: Array, illuminant: str, observer: int, specular: float, index: float | None) -> InputError:
    if specular and _spectrum(lab, illuminant, observer, 0.0) is not None:
        return InputError(
            "material.yaml",
            f"no spectrum of this colour stays above {specular:.4f}, the specular reflectance of index {index:g}; "
            "was the specular excluded (SCE)",
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
        accepted=f"{accepted}. The nearest colour is {_near(lab, illuminant, observer, 0.0)}",
    )


def _near(lab: Array, illuminant: str, observer: int, specular: float) -> str:
    near = nearest_colour(lab, illuminant=illuminant, observer=observer, specular=specular)
    return f"L*a*b* {_words(near)}, ΔE {float(colorimetry.delta_e_ab(near, lab)):.2f} away"


def _newton(xyz: Array, a: Array) -> Array:
    """The z (B, n) of colours (B, 3) for weights (n, 3), both with Y = 1 for white; NaN where no solution was reached."""
    count, size = len(xyz), len(a)
    z = np.full((count, size), np.nan)
    active = np.flatnonzero((xyz > 0).all(axis=1) & (xyz[:, 1] < 1))
    z_now = np.repeat(np.arctanh(2 * xyz[active, 1:2] - 1), size, axis=1)
    multiplier = np.zeros((active.size, 3))
    smooth = _second_difference(size)
    tolerance = np.concatenate([np.full(size, _TOLERANCE), np.full(3, _COLOUR_TOLERANCE)])
    for _ in range(_ITERATIONS):
        if active.size == 0:
            break
        r = _logistic(z_now)
        pull = multiplier @ a.T
        slope = 2 * r * (1 - r)
        residual = np.concatenate([z_now @ smooth + slope * pull, r @ a - xyz[active]], axis=1)
        done = (np.abs(residual) < tolerance).all(axis=1)
        z[active[done]] = z_now[done]
        active, z_now, multiplier = active[~done], z_now[~done], multiplier[~done]
        curvature = 2 * slope * (1 - 2 * r) * pull
        step = _step(smooth, a, slope[~done], curvature[~done], residual[~done])
        longest = np.abs(step[:, :size]).max(axis=1)
        step *= np.minimum(1.0, _LONGEST_STEP / np.maximum(longest, _TOLERANCE))[:, None]
        z_now, multiplier = z_now + step[:, :size], multiplier + step[:, size:]
        alive = np.isfinite(step).all(axis=1) & (np.abs(z_now).max(axis=1) < _LARGEST_Z)
        active, z_now, multiplier = active[alive], z_now[alive], multiplier[alive]
    return z


def _step(smooth: Array, a: Array, slope: Array, curvature: Array, residual: Array) -> Array:
    count, size = slope.shape
    system = np.zeros((count, size + 3, size + 3))
    system[:, :size, :size] = smooth
    diagonal = np.arange(size)
    system[:, diagonal, diagonal] += curvature
    system[:, :size, size:] = slope[:, :, None] * a
    system[:, size:, :size] = np.swapaxes(system[:, :size, size:], 1, 2)
    # Far below any weight: keeps a lost row from being singular without moving the solution.
    system[:, [size, size + 1, size + 2], [size, size + 1, size + 2]] = -1e-14
    try:
        return np.asarray(np.linalg.solve(system, -residual[..., None])[..., 0], dtype=np.float64)
    except np.linalg.LinAlgError:
        # One lost colour must not take the others with it.
        ranks = np.linalg.matrix_rank(system) == size + 3
        step = np.full((count, size + 3), np.nan)
        step[ranks] = np.linalg.solve(system[ranks], -residual[ranks][..., None])[..., 0]
        return step


def _second_difference(size: int) -> Array:
    edges = np.diff(np.eye(size), axis=0)
    return np.asarray(2 * edges.T @ edges, dtype=np.float64)


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
