"""What the sources' choices for colours cost in accuracy and save in time: a spectrum from a colour, an effect paint from a few."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import colour_recovery
import numpy as np
import xarray as xr
from choice_table import Choice, Metric, Option, largest, timed

from brdfpipe.bsdf import flake
from brdfpipe.bsdf.registry import representation
from brdfpipe.flakes.geometries import SETS, directions
from brdfpipe.flakes.reading import ingest
from brdfpipe.flakes.refraction import flake_angle, refract
from brdfpipe.geometry import Array, unit_vector
from brdfpipe.optics.fresnel_equations import fresnel
from brdfpipe.spectra import colorimetry
from brdfpipe.spectra.recovery import LIGHTS
from brdfpipe.spectra.recovery_methods import basis4, random_search
from brdfpipe.spectra.recovery_methods.lhtss import lhtss

# --- the spectrum of a colour

COLOURS = 60


def spectrum_of_a_colour() -> Choice:
    """The patent's random search beside other ways to a spectrum."""
    view = colour_recovery.VIEW
    truth = colour_recovery.random_reflectances(COLOURS)
    labs = colorimetry.xyz_to_lab(truth @ view.weights, view.white)
    methods: dict[str, tuple[str, Array, Array]] = {}
    for threshold in (2.0, random_search.THRESHOLD):
        name = f"random search (patent), to ΔE*ab {threshold:g}"
        methods[name] = ("the last of the colour; saturated colours", *_searched(labs, "random4", threshold))
    name = f"random steps from the best so far, to ΔE*ab {random_search.THRESHOLD:g}"
    methods[name] = ("the same", *_searched(labs, "adaptive4", random_search.THRESHOLD))
    methods["the same mixture in closed form"] = ("saturated colours", *_exact(labs, basis4.closed_form))
    methods["LHTSS"] = ("", *_exact(labs, lhtss))
    common = np.all([np.isfinite(spectra).all(axis=1) for _, spectra, _ in methods.values()], axis=0)
    options = []
    for name, (leaves_out, spectra, seconds) in methods.items():
        found = spectra[common]
        errors = {
            "ΔE00 to the colour, median": float(np.median(_difference(found, truth[common], "D65"))),
            "ΔE00 to the source, other lights, median": float(
                np.median([_difference(found, truth[common], light) for light in LIGHTS])
            ),
            "not reached": 1 - float(np.isfinite(spectra).all(axis=1).mean()),
        }
        options.append(Option(name, leaves_out, errors, {"a colour": float(np.nanmean(seconds))}))
    return Choice(
        "Spectrum of a colour",
        f"{COLOURS} colours of random reflectances (D65, 10°), one a call; errors are of the {common.sum()} colours that all reach. Other lights: "
        f"{', '.join(LIGHTS)}, under which no method knows the colour. A search that cannot reach a colour is not begun, and its time not counted.",
        {
            "ΔE00 to the colour, median": Metric("", 1e-6),
            "ΔE00 to the source, other lights, median": Metric("", 0.02),
            "not reached": Metric("%", 0.001),
        },
        "LHTSS",
        options,
        sources=[f"random search (patent), to ΔE*ab {random_search.THRESHOLD:g}"],
        judged_by="ΔE00 to the colour, median",
    )


def _searched(labs: Array, method: str, threshold: float) -> tuple[Array, Array]:
    """Spectra (colours, wavelength), NaN where the colour was not reached, and processor times (colours,)."""
    view = colour_recovery.VIEW
    spectra, seconds = np.full((len(labs), view.wavelength.size), np.nan), np.full(len(labs), np.nan)
    reached = basis4.closed_form(colorimetry.lab_to_xyz(labs, view.white), view).reached
    for number, lab in enumerate(labs):
        if not reached[number] and colorimetry.delta_e_ab(basis4.nearest(lab, view), lab) >= threshold:
            continue
        result, seconds[number] = timed(
            lambda lab=lab: random_search.search(lab, view, method=method, threshold=threshold)
        )
        if result.ended == "threshold":
            spectra[number] = result.weights @ basis4.basis()
    return spectra, seconds


def _exact(labs: Array, method: Callable[..., Any]) -> tuple[Array, Array]:
    """The same of an exact method, after a first call."""
    view = colour_recovery.VIEW
    xyz = colorimetry.lab_to_xyz(labs, view.white)
    method(xyz[0], view)
    found = [timed(lambda one=one: method(one, view)) for one in xyz]
    spectra = np.stack([np.where(result.reached[0], result.reflectance[0], np.nan) for result, _ in found])
    return spectra, np.array([seconds for _, seconds in found])


def _difference(spectra: Array, truth: Array, light: str) -> Array:
    """ΔE00 of each spectrum to its source under a light."""
    view = colorimetry.weights(light, colour_recovery.VIEW.observer)
    return colorimetry.delta_e_00(*(colorimetry.xyz_to_lab(one @ view.weights, view.white) for one in (spectra, truth)))


# --- effect paints

INDEX = 1.5
"""Of the clear coat."""
NOISE = 0.005
"""Relative standard deviation of a measured reflectance, the same at all wavelengths."""
DRAWS = 4
_WAVELENGTH = np.arange(400.0, 701.0, 10.0)
_THREE = ("45as15", "45as45", "45as110")
_TEN = (*SETS["MA-T6"], "45as20", "45as35", "45as60", "45as90")
_IN_PLANE = tuple(f"45as{angle}" for angle in (-25, -20, 18, 22, 30, 40, 52, 67, 82, 100))
_ELSEWHERE = (
    *(f"{incidence}as{angle}" for incidence in (15, 30, 60) for angle in (-20, 20, 35, 50, 70)),
    *(f"45as{angle}az{turn}" for angle in (20, 30, 40) for turn in (60, 90, 120)),
)
"""Geometries that no option was fitted to."""


class Paint(NamedTuple):
    """Flakes of two populations in a coat that absorbs, over a base that scatters."""

    flakes: tuple[tuple[float, float], ...]
    """Amplitude and width [degree] of each population"""
    absorption: Array
    """Of a passage along the normal, by wavelength"""
    base: float
    """Reflectance of the base"""


PAINTS = {
    "silver": Paint(((0.55, 6.5), (0.22, 17.0)), np.full(_WAVELENGTH.size, 0.02), 0.03),
    "blue": Paint(((0.5, 8.0), (0.25, 20.0)), 0.05 + 0.6 / (1 + np.exp(-(_WAVELENGTH - 530) / 30)), 0.02),
}


def reflectance_factor(paint: Paint, names: tuple[str, ...]) -> Array:
    """π·BRDF of a paint below a smooth coat, (geometries, wavelength), from the fields of light and independent of the fitted forms.

    Light enters the coat, is absorbed on its way, is mirrored once by a flake or scattered once by the base, and leaves.
    """
    pairs = [directions(name) for name in names]
    theta_i, phi_i, theta_o, phi_o = (np.array(angles) for angles in zip(*pairs, strict=True))
    passed, diffuse, cos_i, cos_o = (np.empty(len(pairs)) for _ in range(4))
    for number, pair in enumerate(pairs):
        passed[number], diffuse[number], cos_i[number], cos_o[number] = _passed(*pair)
    turn = flake_angle(theta_i, phi_i, theta_o, phi_o, INDEX)
    density = sum(amplitude * np.exp(-((turn / width) ** 2)) for amplitude, width in paint.flakes)
    mirrored = density * passed / (cos_i * cos_o)
    absorbed = np.exp(-paint.absorption * (1 / cos_i + 1 / cos_o)[:, None])
    return np.asarray((mirrored + paint.base * diffuse)[:, None] * absorbed)


def _passed(theta_i: float, phi_i: float, theta_o: float, phi_o: float) -> tuple[float, float, float, float]:
    """Share of unpolarised light that both passages let through, mirrored in between or depolarised; and the cosines inside."""
    outside = unit_vector([theta_i, theta_o], [phi_i, phi_o])
    inside = refract(outside, INDEX)
    normal = inside.sum(axis=0) / np.linalg.norm(inside.sum(axis=0))
    planes, shares = [], []
    for ray, theta, towards in zip(inside, (theta_i, theta_o), (-1, 1), strict=True):
        across = np.cross(ray, [0.0, 0.0, 1.0])
        s = across / np.linalg.norm(across) if np.linalg.norm(across) > 1e-9 else np.array([0.0, 1.0, 0.0])
        planes.append((s, np.cross(towards * ray, s)))
        interface = fresnel(np.cos(np.radians(theta)), INDEX)
        shares.append((float(1 - interface.s), float(1 - interface.p)))
    mirrored = 0.0
    for axis, share in zip(planes[0], shares[0], strict=True):
        turned = axis - 2 * (axis @ normal) * normal
        mirrored += share / 2 * sum(part * (turned @ to) ** 2 for part, to in zip(shares[1], planes[1], strict=True))
    return mirrored, float(np.mean(shares[0]) * np.mean(shares[1])), float(inside[0, 2]), float(inside[1, 2])


_FLAKE_FITS: Mapping[str, tuple[str, tuple[str, ...], dict[str, str]]] = {
    "three points, exponential (patent)": (
        "the coat's transmission, a mean over noise, the tail of the flakes",
        _THREE,
        {},
    ),
    "six geometries, exponential": ("the coat's transmission, the tail of the flakes", SETS["MA-T6"], {}),
    "ten geometries, exponential": ("the same", _TEN, {}),
    "ten geometries, double exponential": ("the coat's transmission", _TEN, {"form": "double-exponential"}),
    "three points, physical": ("a mean over noise, the tail of the flakes", _THREE, {"model": "flake-physical"}),
    "six geometries, physical": ("the tail of the flakes", SETS["MA-T6"], {"model": "flake-physical"}),
    "ten geometries, physical, double exponential": (
        "",
        _TEN,
        {"model": "flake-physical", "form": "double-exponential"},
    ),
}


def effect_paint() -> Choice:
    """The patent's three points beside more geometries and the physical form."""
    rng = np.random.default_rng(4)
    places = {"45°, in plane": _IN_PLANE, "other incidences and planes": _ELSEWHERE}
    found: dict[str, dict[str, list[Array]]] = {name: {place: [] for place in places} for name in _FLAKE_FITS}
    seconds: dict[str, list[float]] = {name: [] for name in _FLAKE_FITS}
    for paint in PAINTS.values():
        truth = {place: _lab(reflectance_factor(paint, names)) for place, names in places.items()}
        for _ in range(DRAWS):
            noise = dict(zip(_TEN, 1 + NOISE * rng.standard_normal(len(_TEN)), strict=True))
            for name, (_, measured, options) in _FLAKE_FITS.items():
                factor = reflectance_factor(paint, measured) * np.array([noise[one] for one in measured])[:, None]
                listed = [
                    {"geometry": one, "lab": lab.tolist()} for one, lab in zip(measured, _lab(factor), strict=True)
                ]
                multiangle = ingest({"colours": listed, "illuminant": "D65", "observer": 10})
                bsdf, took = timed(
                    lambda multiangle=multiangle, options=options: flake.build(multiangle, index=INDEX, **options)
                )
                seconds[name].append(took)
                for place, names in places.items():
                    found[name][place].append(colorimetry.delta_e_00(truth[place], _predicted(bsdf, names)))
    options = []
    for name, (leaves_out, _, _) in _FLAKE_FITS.items():
        errors = {}
        for place, differences in found[name].items():
            every = np.concatenate(differences)
            errors |= {f"{place}, median": float(np.median(every)), f"{place}, largest": largest(every)}
        options.append(Option(name, leaves_out, errors, {"fit": float(np.mean(seconds[name]))}))
    return Choice(
        "Effect paint",
        f"ΔE00 (D65, 10°) at geometries that were not measured, of two synthetic paints: flakes of two populations of normals in a coat of n = {INDEX:g} that "
        f"absorbs, over a scattering base, from the fields of light. No fitted form has its density, its absorption or its base. {DRAWS} draws of {NOISE:.1%} "
        "noise of each colour. The time includes the spectrum at every flake angle.",
        {name: Metric("ΔE00", 0.05) for name in options[0].errors},
        "ten geometries, physical, double exponential",
        options,
        sources=["three points, exponential (patent)"],
        judged_by="other incidences and planes, median",
    )


def _lab(factor: Array) -> Array:
    view = colorimetry.weights("D65", 10)
    return colorimetry.xyz_to_lab(colorimetry.reflectance_to_xyz(_WAVELENGTH, factor, "D65", 10), view.white)


def _predicted(bsdf: xr.Dataset, names: tuple[str, ...]) -> Array:
    """L*a*b* of a fit at geometries."""
    at = (np.array(angles) for angles in zip(*(directions(name) for name in names), strict=True))
    xyz = representation(bsdf).tristimulus(*at, "D65", 10)
    assert xyz is not None
    return colorimetry.xyz_to_lab(xyz, colorimetry.weights("D65", 10).white)
