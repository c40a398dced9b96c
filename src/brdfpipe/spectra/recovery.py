"""Reflectance spectra from colours: the smoothest one in (0, 1) that has the colour exactly, or mixtures of four basis spectra."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from brdfpipe import vocabulary
from brdfpipe.errors import BrdfpipeError, InputError
from brdfpipe.geometry import Array
from brdfpipe.optics.fresnel_equations import fresnel
from brdfpipe.optics.index import interpolate_index
from brdfpipe.spectra import colorimetry
from brdfpipe.spectra.colorimetry import Weights
from brdfpipe.spectra.recovery_methods import basis4, random_search
from brdfpipe.spectra.recovery_methods.lhtss import lhtss
from brdfpipe.spectra.recovery_methods.reachable_colours import largest_chroma, nearest_colour

METHODS = ("lhtss", "basis4", *random_search.SEARCHES)
"""Methods that recover a spectrum from a colour; see :func:`recover`."""
LIGHTS = ("A", "FL2", "LED-B3")
"""Illuminants under which spectra of one colour are compared."""

_KEY = "spectrum.lab"


def recover(
    lab: ArrayLike,
    *,
    illuminant: str,
    observer: int,
    method: str = "lhtss",
    threshold: float = random_search.THRESHOLD,
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
    illuminant, observer : of the colour, see :func:`brdfpipe.spectra.colorimetry.weights`
    method : a name of :data:`METHODS`: ``lhtss``, the smoothest; or a mixture of four basis spectra, ``basis4`` in closed form,
        ``random4`` and ``adaptive4`` by :func:`brdfpipe.spectra.recovery_methods.random_search.search`
    threshold, seed : of a search: ΔE*ab at which it ends, and of its random numbers
    specular_index : a number or a dataset of kind ``index``, if the colour includes the specular reflection of a smooth surface;
        the spectrum then stays at or above its Fresnel reflectance
    theta : degree, incidence of the measurement
    geometry : ``sci`` (default) or ``sce``, recorded
    checkpoint, progress : of a search: the file it resumes from, and whether to show a progress bar

    Returns
    -------
    Dataset of kind ``spectrum`` on 360 to 780 nm by 5; attributes ``geometry``, ``theta_i``, ``method``, ``residual_delta_e`` (ΔE*ab to
    ``lab``), ``illuminant``, ``observer``, ``specular_index`` (at 589.3 nm) if given, and ``metamerism_<light>``: ΔE00 under each of
    :data:`LIGHTS` to the spectrum of the other exact method, if that reaches the colour

    Raises
    ------
    InputError : not a colour; a colour that no reflectance or no mixture has (with the nearest possible colour); or one darker
        than the specular reflection that it includes.

    References
    ----------
    Burns, "Numerical methods for smoothest reflectance reconstruction", Color Res. Appl. 45 (2020) 8–21 (method LHTSS).
    """
    if method not in METHODS:
        raise _refusal(
            "unknown method of recovery", found=repr(method)[:40], accepted=", ".join(METHODS), key="spectrum.method"
        )
    if not (np.isfinite(threshold) and threshold > 0):
        raise _refusal(
            "invalid threshold", found=repr(threshold)[:40], accepted="a ΔE*ab above 0", key="spectrum.threshold"
        )
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise _refusal("invalid seed", found=repr(seed)[:40], accepted="a whole number >= 0", key="spectrum.seed")
    colour, table = check_lab(lab), _weights(illuminant, observer)
    specular = _floor(specular_index, theta, table)
    sodium_index = (
        interpolate_index(specular_index, 589.3)[0] if isinstance(specular_index, xr.Dataset) else specular_index
    )
    search = None
    if method in random_search.SEARCHES:
        _check_mixable(colour, table, specular, threshold)
        search = random_search.search(
            colour,
            table,
            method=method,
            threshold=threshold,
            seed=seed,
            floor=specular,
            checkpoint=checkpoint,
            progress=progress,
        )
        mixture = np.minimum(search.weights @ basis4.basis(), 1.0)
        reflectance: Array | None = specular + (1 - specular) * mixture
    else:
        reflectance = _spectrum(colour, table, specular, method)
    if reflectance is None:
        raise _refused(colour, table, specular, specular_index, method)
    lab_of_spectrum = colorimetry.xyz_to_lab(reflectance @ table.weights, table.white)
    attrs = {
        "geometry": geometry or "sci",
        "theta_i": float(theta),
        "method": method,
        "residual_delta_e": float(colorimetry.delta_e_ab(lab_of_spectrum, colour)),
        "illuminant": table.illuminant,
        "observer": int(observer),
        **({} if sodium_index is None else {"specular_index": float(sodium_index)}),
        **({"seed": int(seed), "threshold": float(threshold), "tried": search.tried} if search else {}),
        **_metamerism(reflectance, colour, table, specular, method),
    }
    dataset = xr.Dataset(
        {"total_reflectance": ("wavelength", reflectance)}, coords={"wavelength": table.wavelength}, attrs=attrs
    )
    sentence = f"recovered by {method} from L*a*b* {_words(colour)} ({table.illuminant}, {observer} degree)"
    dataset = vocabulary.add_history(vocabulary.label(dataset, "spectrum"), sentence)
    if search is None or search.ended == "threshold":
        return dataset
    why = f"{'was stopped on request' if search.ended == 'stopped' else 'ended'} after {search.tried} mixtures"
    return vocabulary.add_warning(
        dataset,
        f"the search for a spectrum {why}, at ΔE {search.delta_e:.3g} from the colour (threshold {threshold:g}); remove "
        "spectrum.nc to continue the search, or set `spectrum.method: lhtss`, which is exact.",
    )


def check_recoverable(
    lab: ArrayLike,
    *,
    illuminant: str,
    observer: int,
    method: str = METHODS[0],
    threshold: float = random_search.THRESHOLD,
    specular_index: float | xr.Dataset | None = None,
    theta: float = 8.0,
) -> None:
    """Refuse a colour that :func:`recover` will refuse, without its search; parameters and errors as there."""
    colour, table = check_lab(lab), _weights(illuminant, observer)
    specular = _floor(specular_index, theta, table)
    if method in random_search.SEARCHES:
        _check_mixable(colour, table, specular, threshold)
    elif _spectrum(colour, table, specular, method) is None:
        raise _refused(colour, table, specular, specular_index, method)


def _floor(specular_index: float | xr.Dataset | None, theta: float, table: Weights) -> Array:
    """Least reflectance of a spectrum at each wavelength: the specular reflection that the colour includes."""
    if specular_index is None:
        return np.zeros(table.wavelength.size)
    return specular_reflectance(specular_index, theta, table.wavelength)


def metamerism(
    lab: ArrayLike,
    *,
    illuminant: str,
    observer: int,
    methods: Sequence[str] = METHODS,
    threshold: float = random_search.THRESHOLD,
    seed: int = 0,
    specular_index: float | xr.Dataset | None = None,
    theta: float = 8.0,
) -> xr.Dataset:
    """Metamerism between the spectra that different methods recover from one colour.

    Parameters
    ----------
    lab, illuminant, observer, threshold, seed, specular_index, theta : see :func:`recover`
    methods : those to compare

    Returns
    -------
    Dataset : ``total_reflectance(recovery, wavelength)``; ``delta_e00(light, recovery, other)``, ΔE00 between two methods under each
    of :data:`LIGHTS`; ``residual_delta_e(recovery)``, ΔE*ab to ``lab``. Methods that do not reach the colour are left out, with a
    warning

    Raises
    ------
    InputError : as :func:`recover` if no method reaches the colour; or an unknown method.
    """
    spectrum_of: dict[str, xr.Dataset] = {}
    errors: dict[str, InputError] = {}
    colour: dict[str, Any] = {"illuminant": illuminant, "observer": observer}
    colour |= {"specular_index": specular_index, "theta": theta}
    for method in methods:
        try:
            spectrum_of[method] = recover(lab, method=method, threshold=threshold, seed=seed, **colour)
        except InputError as error:
            if method not in METHODS:
                raise
            errors[method] = error
    if not spectrum_of:
        raise next(iter(errors.values()))
    recovered, names = list(spectrum_of.values()), list(spectrum_of)
    spectra = np.stack([spectrum["total_reflectance"].values for spectrum in recovered])
    pairs = np.stack([_difference(spectra[:, None], spectra[None], light, observer) for light in LIGHTS])
    residuals = [spectrum.attrs["residual_delta_e"] for spectrum in recovered]
    difference = {"units": "1", "long_name": "colour difference CIEDE2000"}
    dataset = xr.Dataset(
        {
            "total_reflectance": (("recovery", "wavelength"), spectra),
            "delta_e00": (("light", "recovery", "other"), pairs, difference),
            "residual_delta_e": ("recovery", residuals, {"units": "1", "long_name": "ΔE*ab to the given colour"}),
        },
        {"recovery": names, "other": names, "light": list(LIGHTS), "wavelength": recovered[0]["wavelength"]},
        {"illuminant": recovered[0].attrs["illuminant"], "observer": int(observer)},
    )
    for name in ("total_reflectance", "wavelength"):
        dataset[name].attrs = dict(recovered[0][name].attrs)
    reasons = [f"method {method} was left out: {error}" for method, error in errors.items()]
    return vocabulary.add_warning(dataset, *reasons)


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


def _difference(first: Array, second: Array, light: str, observer: int) -> Array:
    """ΔE00 between reflectances (..., n) on the grid, under a light."""
    table = colorimetry.weights(light, observer)
    return colorimetry.delta_e_00(*(colorimetry.xyz_to_lab(r @ table.weights, table.white) for r in (first, second)))


def _metamerism(reflectance: Array, lab: Array, table: Weights, specular: Array, method: str) -> dict[str, float | str]:
    """ΔE00 under other lights to the spectrum of the other exact method, as attributes."""
    against = "basis4" if method == "lhtss" else "lhtss"
    other = _spectrum(lab, table, specular, against)
    if other is None:
        return {}
    differences = {light: float(_difference(reflectance, other, light, table.observer)) for light in LIGHTS}
    return {"metamerism_against": against, **{f"metamerism_{light}": value for light, value in differences.items()}}


def _spectrum(lab: Array, table: Weights, specular: Array, method: str = "lhtss") -> Array | None:
    if lab[1] == 0 and lab[2] == 0 and lab[0] in ((0.0, 100.0) if method == "lhtss" else (0.0,)):
        return None if lab[0] == 0 and specular.any() else np.full(table.wavelength.size, lab[0] / 100)
    exact = lhtss if method == "lhtss" else basis4.closed_form
    result = exact(colorimetry.lab_to_xyz(lab, table.white), table, specular)
    return np.asarray(result.reflectance[0]) if result.reached[0] else None


def _check_mixable(lab: Array, table: Weights, specular: Array, threshold: float) -> None:
    """Refuse a colour that no mixture approaches within the threshold; its search would not end."""
    if _spectrum(lab, table, specular, "basis4") is not None:
        return
    near = basis4.nearest(lab, table, specular)
    if colorimetry.delta_e_ab(near, lab) >= threshold:
        raise _refusal(
            "no mixture of the four basis spectra has this colour",
            found=f"L*a*b* {_words(lab)}",
            accepted=f"lhtss; or a colour like the nearest one, {_distance_words(np.round(near, 2) + 0.0, lab)}",
            key="spectrum.method",
        )


def _refused(lab: Array, table: Weights, specular: Array, index: float | xr.Dataset | None, method: str) -> InputError:
    """Why an exact method does not reach a colour."""
    if method == "basis4":
        _check_mixable(lab, table, specular, 0.0)
    return _unreachable(lab, table, specular, index)


def _unreachable(lab: Array, table: Weights, specular: Array, index: float | xr.Dataset | None) -> InputError:
    none = np.zeros_like(specular)
    if index is not None and _spectrum(lab, table, none) is not None:
        return _refusal(
            f"every spectrum of this colour falls below {_span(specular, '.4f')}, the specular reflectance of index "
            f"{index_words(index)}; perhaps the specular was excluded (SCE)",
            found=f"L*a*b* {_words(lab)}",
            accepted="a colour measured with the specular included, the nearest being "
            f"{_distance_words(nearest_colour(lab, table, specular), lab)}; or `geometry: sce`; or the index of this material",
            key="spectrum.geometry",
        )
    accepted = "a* = b* = 0 at L* = 0 and L* = 100"
    if 0 < lab[0] < 100:
        accepted = f"C* up to {largest_chroma(lab, table):.2f} at this L* and hue; check illuminant and observer"
    return _refusal(
        "impossible colour: no reflectance has it",
        found=f"L*a*b* {_words(lab)}, C* = {float(np.hypot(lab[1], lab[2])):.2f}",
        accepted=f"{accepted}. The nearest colour is {_distance_words(nearest_colour(lab, table), lab)}",
    )


def _distance_words(near: Array, lab: Array) -> str:
    return f"L*a*b* {_words(near)}, ΔE {float(colorimetry.delta_e_ab(near, lab)):.2f} away"


def index_words(index: float | xr.Dataset) -> str:
    """A refractive index in words: a number, or from least to largest."""
    return _span(np.atleast_1d(index["n"].values if isinstance(index, xr.Dataset) else index), ".4g")


def _span(values: Array, form: str) -> str:
    least, most = (f"{value:{form}}" for value in (values.min(), values.max()))
    return least if least == most else f"{least} to {most}"


def _weights(illuminant: str, observer: int) -> Weights:
    """Weights of the colour; errors name the key to correct."""
    key = "illuminant"
    try:
        name = colorimetry.illuminant_name(illuminant)
        key = "observer"
        return colorimetry.weights(name, observer)
    except BrdfpipeError as error:
        raise InputError("material.yaml", str(error), where="spectrum", key=f"spectrum.{key}") from error


def check_lab(lab: ArrayLike) -> Array:
    """A colour as three numbers, (3,).

    Raises InputError: it is not three finite numbers L*, a*, b* with 0 <= L* <= 100; the key is that of ``spectrum``.
    """
    try:
        colour = np.asarray(lab, dtype=float)
    except (TypeError, ValueError):
        colour = np.empty(0)
    if colour.shape != (3,) or not np.isfinite(colour).all() or not 0 <= colour[0] <= 100:
        raise _refusal("invalid colour", found=repr(lab)[:60], accepted="[L*, a*, b*] with 0 <= L* <= 100")
    return colour


def _words(lab: Sequence[float] | Array) -> str:
    return "({})".format(", ".join(f"{value:g}" for value in lab))


def _refusal(problem: str, *, found: str, accepted: str, key: str = _KEY) -> InputError:
    return InputError("material.yaml", problem, where=key, found=found, accepted=accepted, key=key)
