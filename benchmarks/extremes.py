"""The public functions of every stage at their extremes: grazing light, hardly rough and hardly refracting surfaces, one cell, no light.

``python benchmarks/extremes.py`` runs every case and writes ``docs/extremes.md``: the error against a reference of 50 digits where there
is a closed form, the range of the values where there is none, or the refusal. ``tests/test_extremes.py`` runs the same cases.
"""

from __future__ import annotations

import json
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import sys
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import mpmath as mp
import numpy as np
import xarray as xr

from brdfpipe import installation, vocabulary
from brdfpipe.appearance.cabin import Cabin
from brdfpipe.appearance.gloss_meter import gloss
from brdfpipe.appearance.veiling_glare import veiling_luminance
from brdfpipe.bsdf.lambert_gauss import lambertian
from brdfpipe.bsdf.measured import smoothing
from brdfpipe.bsdf.microfacet.builder import build as build_facets
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.slab.builder import build as build_slab
from brdfpipe.bsdf.slab.coated import build as build_coated
from brdfpipe.bsdf.wave.builder import build as build_wave
from brdfpipe.errors import BrdfpipeError
from brdfpipe.facets.analytic_distributions import analytic, flat
from brdfpipe.facets.estimation import estimate
from brdfpipe.flakes.refraction import flake_angle
from brdfpipe.geometry import half_vector
from brdfpipe.masking.analytic_smith import beckmann_lambda, ggx_lambda
from brdfpipe.optics.fresnel_equations import fresnel
from brdfpipe.psd.analytic_spectra import analytic as analytic_spectrum
from brdfpipe.psd.estimation import estimate as roughness_spectrum
from brdfpipe.spectra import colorimetry
from brdfpipe.spectra.recovery import recover
from brdfpipe.surfaces.levelling import level

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import rig_primary
import samples

PAGE = "docs/extremes.md"

GRAZING = (0.0, 1e-6, 1.0, 30.0, 60.0, 85.0, 89.0, 89.9, 89.999)
"""Polar angles at which every BSDF is tried [degree]."""

ENERGY_SLACK = 1e-6
"""By which an albedo may exceed 1: the accuracy of its quadrature."""


@dataclass(frozen=True)
class Outcome:
    """What a case gave."""

    kind: str
    """``error``, ``range``, ``refused`` or ``warned``; ``wrong`` for all that must not be"""
    text: str
    limit: str = ""
    """What holds by the documentation."""


@dataclass(frozen=True)
class Case:
    """A stage at an extreme."""

    stage: str
    name: str
    run: Callable[[], Outcome]
    slow: bool = False
    """Whether it takes more than about a second."""

    def outcome(self) -> Outcome:
        """The outcome; an error of another kind than the project's own, and an unannounced warning of numpy, are wrong."""
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error", RuntimeWarning)
                return self.run()
        except BrdfpipeError as error:
            return Outcome("wrong", f"refused: {error}")
        except Exception as error:
            return Outcome("wrong", f"{type(error).__name__}: {error}")


def refused(compute: Callable[[], object]) -> Outcome:
    """The refusal of what must be refused."""
    try:
        found = compute()
    except BrdfpipeError as error:
        return Outcome("refused", str(error))
    return Outcome("wrong", f"not refused: {found!r:.80}")


def warned(compute: Callable[[], xr.Dataset], words: str) -> Outcome:
    """The warning of a dataset that must have one."""
    found = [text for text in json.loads(compute().attrs.get("warnings", "[]")) if words in text]
    return Outcome("warned", found[0]) if found else Outcome("wrong", f"no warning with {words!r}")


def relative(values: object, references: object, limit: float, floor: float = 0.0) -> Outcome:
    """The largest error over the reference, or over ``floor`` where the reference is smaller."""
    values, references = (
        np.ravel(np.asarray(values, dtype=float)).tolist(),
        list(np.ravel(np.asarray(references, dtype=object))),
    )
    if len(values) != len(references) or not values:
        return Outcome("wrong", f"{len(values)} values for {len(references)} references")
    errors = [
        float(abs(mp.mpf(v) - r) / max(abs(r), mp.mpf(floor))) if r or floor else float(abs(v))
        for v, r in zip(values, references, strict=True)
    ]
    worst = max(errors) if all(np.isfinite(errors)) else np.nan
    scale = f" relative, or of {floor:g}" if floor else " relative"
    return Outcome("error" if worst <= limit else "wrong", f"{worst:.1e}", f"{limit:g}{scale}")


def bounded(values: object, low: float, high: float, what: str) -> Outcome:
    """The range of values that must be finite and between limits."""
    values = np.asarray(values, dtype=float)
    inside = values.size > 0 and np.isfinite(values).all() and values.min() >= low and values.max() <= high
    text = f"{what} {values.min():.6g} to {values.max():.6g}" if values.size else "no values"
    return Outcome("range" if inside else "wrong", text, f"{low:g} to {high:g}")


# --- closed forms in 50 digits


def cosine(theta: float) -> mp.mpf:
    return mp.cos(mp.radians(mp.mpf(theta)))


def exact_fresnel(cos: mp.mpf, n: float, k: float = 0.0) -> tuple[mp.mpf, mp.mpf]:
    """R_s and R_p of Born & Wolf, §1.5.2."""
    index = mp.mpc(n, k)
    q = mp.sqrt(index**2 - 1 + cos**2)
    return abs((cos - q) / (cos + q)) ** 2, abs((index**2 * cos - q) / (index**2 * cos + q)) ** 2


def exact_lambda(kind: str, theta: float, width: float) -> mp.mpf:
    slope = mp.mpf(width) * mp.tan(mp.radians(mp.mpf(theta)))
    if kind == "ggx":
        return (mp.sqrt(1 + slope**2) - 1) / 2
    return (mp.exp(-1 / slope**2) * slope / mp.sqrt(mp.pi) - mp.erfc(1 / slope)) / 2 if slope else mp.mpf(0)


def exact_peak(theta: float, width: float, n: float) -> mp.mpf:
    """BRDF of Beckmann facets in the mirror direction: D F G2 / (4 cos²θ), height-correlated masking."""
    cos = cosine(theta)
    mean = sum(exact_fresnel(cos, n)) / 2
    return mean / (mp.pi * mp.mpf(width) ** 2 * (1 + 2 * exact_lambda("beckmann", theta, width)) * 4 * cos**2)


def exact_vectors(theta_i: float, theta_o: float, turn: float, n: float = 1.0) -> tuple[mp.mpf, mp.mpf]:
    """Slope of the facet or flake below a coat of index n that mirrors (θ_i, 0) into (θ_o, 180 + turn), and its local cosine."""
    i, o, phi = (mp.radians(mp.mpf(angle)) for angle in (theta_i, theta_o, 180.0 + turn))
    s_i, s_o = mp.sin(i) / n, mp.sin(o) / n
    x, y, z = s_i + s_o * mp.cos(phi), s_o * mp.sin(phi), mp.sqrt(1 - s_i**2) + mp.sqrt(1 - s_o**2)
    return mp.sqrt(x * x + y * y) / z, mp.sqrt(x * x + y * y + z * z) / 2


def exact_plate(theta: float, n: float, transmittance: float) -> tuple[mp.mpf, mp.mpf]:
    """Reflectance and transmittance of a plate for unpolarised light (Stokes 1862)."""
    cos = cosine(theta)
    path = 1 / mp.sqrt(1 - (1 - cos**2) / mp.mpf(n) ** 2)
    tau = mp.mpf(transmittance) ** path if transmittance else mp.mpf(0)
    reflected, passed = [], []
    for f in exact_fresnel(cos, n):
        series = (1 - f) ** 2 * tau / (1 - f * f * tau * tau)
        reflected.append(f + series * tau * f)
        passed.append(series)
    return sum(reflected) / 2, sum(passed) / 2


# --- a BSDF at every pair of extreme directions


def everywhere(bsdf: xr.Dataset) -> Outcome:
    """Values >= 0 and finite, the same with both directions exchanged, and albedos within 0 and 1."""
    of = representation(bsdf)
    theta_i, theta_o, phi_o = (a.ravel() for a in np.meshgrid(GRAZING, GRAZING, [0.0, 77.0, 180.0], indexing="ij"))
    zero = np.zeros_like(theta_i)
    values = of.evaluate(theta_i, zero, theta_o, phi_o, None)
    swapped = of.evaluate(theta_o, phi_o, theta_i, zero, None)
    albedo = of.albedo(np.array(GRAZING), np.zeros(len(GRAZING)), None)
    if of.transmits and not of.transmits_into_body:
        albedo = albedo + of.transmittance(np.array(GRAZING), np.zeros(len(GRAZING)), None)
    if not (np.isfinite(values).all() and np.isfinite(albedo).all()):
        return Outcome("wrong", "not finite")
    asymmetry = float((np.abs(values - swapped) / np.maximum(np.abs(values), 1e-30)).max())
    right = values.min() >= 0 and albedo.min() >= 0 and albedo.max() <= 1 + ENERGY_SLACK and asymmetry < 1e-9
    text = f"BRDF {values.min():.2g} to {values.max():.2g} sr⁻¹, albedo {albedo.min():.6f} to {albedo.max():.6f}, reciprocal to {asymmetry:.0e}"
    return Outcome("range" if right else "wrong", text, "≥ 0; 0 to 1; 1e-9")


# --- the cases


def _index(n: float) -> str:
    return f"{n:g}" if n < 1 or n > 1 + 1e-6 or n == 1 else f"1 + {n - 1:.1g}"


def _optics() -> Iterator[Case]:
    for n, k in ((1 + 1e-9, 0.0), (1.5, 0.0), (4.0, 0.0), (1.5, 1e-12), (1.5, 100.0), (0.1, 100.0), (4.0, 100.0)):

        def at(n: float = n, k: float = k) -> Outcome:
            cosines = [float(np.cos(np.radians(theta))) for theta in GRAZING]
            found = [fresnel(cos, n, k) for cos in cosines]
            exact = [exact_fresnel(mp.mpf(cos), n, k) for cos in cosines]
            return relative([[f.s, f.p] for f in found], [list(pair) for pair in exact], 1e-10)

        yield Case("Fresnel", f"n = {_index(n)}, k = {k:g}, θ to 89.999°", at)
    yield Case("Fresnel", "no angles", lambda: bounded([fresnel(np.empty(0), 1.5).mean.size], 0, 0, "values"))
    yield Case(
        "Fresnel",
        "single precision",
        lambda: relative(fresnel(np.float32(0.5), np.float32(1.5)).s, exact_fresnel(mp.mpf(0.5), 1.5)[0], 1e-10),
    )
    yield Case("Fresnel", "cos θ = 1.1", lambda: refused(lambda: fresnel(1.1, 1.5)))


def _geometry() -> Iterator[Case]:
    pairs = (
        (45.0, 45 + 1e-6, 0.0),
        (89.999, 89.998, 0.0),
        (89.999, 89.999, 1e-6),
        (0.0, 1e-7, 0.0),
        (89.999, 0.0, 0.0),
        (30.0, 60.0, 90.0),
    )

    def slopes() -> Outcome:
        found = [np.sqrt(half_vector(i, 0.0, o, 180 + turn).slope_squared) for i, o, turn in pairs]
        return relative(found, [exact_vectors(*pair)[0] for pair in pairs], 1e-10, 1e-2)

    def flakes(index: float) -> Outcome:
        found = [np.radians(flake_angle(i, 0.0, o, 180 + turn, index)) for i, o, turn in pairs]
        return relative(found, [mp.atan(exact_vectors(*pair, index)[0]) for pair in pairs], 1e-10, 1e-2)

    yield Case("directions", "slope of the facet, beside the mirror direction and grazing", slopes)
    for index in (1 + 1e-9, 1.5, 4.0):
        yield Case("effect pigments", f"flake angle below a coat of n = {_index(index)}", partial(flakes, index))
    yield Case(
        "effect pigments",
        "a coat that reflects totally, n = 0.9",
        lambda: refused(lambda: flake_angle(80, 0, 10, 0, 0.9)),
    )


def _masking() -> Iterator[Case]:
    for kind, function in (("beckmann", beckmann_lambda), ("ggx", ggx_lambda)):

        def at(kind: str = kind, function: Callable[..., object] = function) -> Outcome:
            pairs = [(theta, width) for theta in GRAZING[1:] for width in (1e-6, 1e-3, 0.1, 1.0, 10.0)]
            found = [function(*pair) for pair in pairs]
            return relative(found, [exact_lambda(kind, *pair) for pair in pairs], 1e-10, 1e-30)

        yield Case("Smith's Λ", f"{kind}, widths 1e-6 to 10, θ to 89.999°", at)


def _facets() -> Iterator[Case]:
    for width in (1e-6, 1e-3, 0.1, 1.0, 10.0):

        def peak(width: float = width) -> Outcome:
            of = representation(build_facets(analytic("beckmann", width), index=1.5, multiple_scattering="none"))
            theta = np.array(GRAZING)
            found = of.evaluate(theta, 0 * theta, theta, 0 * theta + 180, None)[:, 0]
            return relative(found, [exact_peak(float(angle), width, 1.5) for angle in theta], 1e-8)

        yield Case("microfacet BRDF", f"mirror direction, slope rms {width:g}; masking is interpolated", peak)
        for kind in ("beckmann", "ggx"):
            full = partial(build_facets, index=1.5, spectrum=samples.spectrum(0.3))
            yield Case(
                "microfacet BRDF",
                f"{kind}, width {width:g}, R = 0.3",
                lambda kind=kind, width=width, full=full: everywhere(full(analytic(kind, width))),
            )
    for ratio in (1.0, 10.0, 100.0):
        lay = partial(analytic, "beckmann", a_x=0.003 * ratio**0.5, a_y=0.003 / ratio**0.5)
        build = partial(build_facets, index=1.5, multiple_scattering="none")
        yield Case(
            "microfacet BRDF", f"anisotropy {ratio:g}", lambda lay=lay, build=build: everywhere(build(lay())), slow=True
        )
    yield Case("microfacet BRDF", "anisotropy 101", lambda: refused(lambda: analytic("beckmann", a_x=1.01, a_y=0.01)))
    for reflectance in (0.0, 1.0):
        yield Case(
            "microfacet BRDF",
            f"R = {reflectance:g}",
            lambda r=reflectance: everywhere(
                build_facets(analytic("beckmann", 0.2), index=1.5, spectrum=samples.spectrum(r))
            ),
        )
        yield Case(
            "microfacet BRDF",
            f"polished, R = {reflectance:g}",
            lambda r=reflectance: everywhere(build_facets(flat(), index=1.5, spectrum=samples.spectrum(r))),
        )
    for n in (1.0, 1 + 1e-9, 4.0):
        yield Case(
            "microfacet BRDF",
            f"n = {_index(n)}",
            lambda n=n: everywhere(build_facets(analytic("beckmann", 0.2), index=n, spectrum=samples.spectrum(0.3))),
        )
    yield Case(
        "microfacet BRDF",
        "metal, n = 0.1, k = 100",
        lambda: everywhere(build_facets(analytic("beckmann", 0.2), index=_metal())),
    )
    one = samples.spectrum(0.3).isel(wavelength=[38])
    yield Case(
        "microfacet BRDF",
        "one wavelength",
        lambda: everywhere(build_facets(analytic("beckmann", 0.2), index=1.5, spectrum=one)),
    )
    yield Case(
        "microfacet BRDF",
        "R < 0",
        lambda: refused(lambda: build_facets(analytic("beckmann", 0.2), index=1.5, spectrum=samples.spectrum(-1e-9))),
    )
    yield Case(
        "microfacet BRDF",
        "no directions",
        lambda: bounded(
            [
                samples.beckmann_bsdf(0.2).bsdf.evaluate(np.empty(0), 0, np.empty(0), 0).size,
                samples.beckmann_bsdf(0.2).bsdf.albedo(np.empty(0)).size,
            ],
            0,
            0,
            "values",
        ),
    )
    yield Case(
        "microfacet BRDF",
        "wavelength in m",
        lambda: refused(lambda: samples.beckmann_bsdf(0.2).bsdf.evaluate(30, 0, 40, 170, wavelength=[550e-9])),
    )
    yield Case(
        "microfacet BRDF",
        "angle NaN",
        lambda: refused(lambda: samples.beckmann_bsdf(0.2).bsdf.evaluate(np.nan, 0, 40, 170)),
    )


def _metal() -> xr.Dataset:
    ends = {"n": ("wavelength", [0.1, 0.1], {"units": "1"}), "k": ("wavelength", [100.0, 100.0], {"units": "1"})}
    return vocabulary.label(xr.Dataset(ends, {"wavelength": [400.0, 700.0]}, {"source": "metal"}), "index")


def _heights() -> Iterator[Case]:
    noise = np.random.default_rng(0).normal(size=(64, 64))
    surface, slope = samples.surface, lambda heights: float(estimate(samples.surface(heights))["slope_rms"])
    yield Case(
        "levelling",
        "constant map, 5 m high",
        lambda: bounded(level(surface(np.full((16, 16), 5e6)))["height"], 0, 0, "heights"),
    )
    for name, heights in (
        ("constant map", np.full((64, 64), 5.0)),
        ("one facet, 2 × 2 heights", noise[:2, :2]),
        ("one row of heights", noise[:1]),
        ("heights in m taken for µm, × 1e9", 1e9 * noise),
        ("no height", np.full((64, 64), np.nan)),
        ("tilted plane", np.add.outer(0.1 * np.arange(64), np.zeros(64))),
    ):
        yield Case("facets of a scan", name, lambda heights=heights: refused(lambda: estimate(surface(heights))))
    yield Case(
        "facets of a scan",
        "single precision",
        lambda: relative(slope(noise.astype(np.float32)), mp.mpf(slope(noise)), 1e-6),
    )
    yield Case(
        "facets of a scan",
        "heights × 1e-9",
        lambda: relative(slope(1e-9 * noise), mp.mpf(1e-9) * mp.mpf(slope(noise)), 1e-10),
    )
    for name, heights in (
        ("constant map", np.full((64, 64), 5.0)),
        ("2 × 2 heights", noise[:2, :2]),
        ("a line of 2 heights", noise[0, :2]),
    ):
        yield Case(
            "roughness spectrum", name, lambda heights=heights: refused(lambda: roughness_spectrum(surface(heights)))
        )


def _waves() -> Iterator[Case]:
    for sigma in (0.0, 1e-9, 1e-4, 0.05, 1.0, 4.4):
        phase = (4 * np.pi * sigma / 0.55) ** 2
        spectrum = partial(analytic_spectrum, "gaussian", sigma=sigma, length=5.0)
        yield Case(
            "waves",
            f"phase variance g = {phase:.2g} at normal incidence",
            lambda s=spectrum: everywhere(build_wave(s(), index=1.5, wavelength=[550.0])),
        )


def _sheets() -> Iterator[Case]:
    for n, transmittance in ((1.5, 0.0), (1.5, 1e-300), (1.5, 0.5), (1.5, 1.0), (1 + 1e-9, 1.0), (4.0, 1.0)):

        def at(n: float = n, transmittance: float = transmittance) -> Outcome:
            of = representation(build_slab(flat(), flat(), index=n, internal_transmittance=transmittance))
            theta = np.array(GRAZING)
            found = [f(theta, 0 * theta, None)[:, 0] for f in (of.albedo, of.transmittance)]
            exact = np.array([exact_plate(float(angle), n, transmittance) for angle in theta], dtype=object).T
            return relative(found, exact, 1e-10, 1e-2)

        yield Case("clear sheets", f"smooth faces, n = {_index(n)}, internal transmittance {transmittance:g}", at)
    for transmittance in (0.0, 1.0):
        rough = partial(build_slab, index=1.5, internal_transmittance=transmittance)
        yield Case(
            "clear sheets",
            f"rough face, internal transmittance {transmittance:g}",
            lambda rough=rough: everywhere(rough(analytic("beckmann", 0.1), flat())),
            slow=True,
        )
    yield Case(
        "clear sheets",
        "internal transmittance 1.1",
        lambda: refused(lambda: build_slab(flat(), flat(), index=1.5, internal_transmittance=1.1)),
    )


COAT_REACH = 2e-3
"""Share of the light that the directions of a coat's light may lose or gain in total."""


def closed(bsdf: xr.Dataset) -> Outcome:
    """As :func:`everywhere`, and the reflectance integrated over the hemisphere, with the mirrored light, against the albedo."""
    found = everywhere(bsdf)
    if found.kind == "wrong":
        return found
    of = representation(bsdf)
    theta, theta_u = np.polynomial.legendre.leggauss(400)
    theta, weight = 45 * (theta + 1), np.radians(45 * theta_u)
    phi = np.arange(0.0, 360.0, 2.0)
    angles = [a.ravel() for a in np.meshgrid([5.0, 45.0, 75.0], theta, phi, indexing="ij")]
    values = of.evaluate(angles[0], 0 * angles[0], angles[1], angles[2], None).mean(axis=-1).reshape(3, theta.size, -1)
    radians = np.radians(theta)
    scattered = 2 * np.pi * (values.mean(axis=2) * np.cos(radians) * np.sin(radians) * weight).sum(axis=1)
    incidence = np.array([5.0, 45.0, 75.0])
    mirrored, _ = of.specular(incidence, 0 * incidence, None)
    albedo = of.albedo(incidence, 0 * incidence, None).mean(axis=-1)
    off = float(np.abs(scattered + mirrored.mean(axis=-1) - albedo).max())
    right = off <= COAT_REACH
    return Outcome(
        "range" if right else "wrong", f"{found.text}, light closed to {off:.0e}", f"{found.limit}; {COAT_REACH:g}"
    )


def _coats() -> Iterator[Case]:
    grey = recover([40.0, 0.0, 0.0], illuminant="D65", observer=10)
    smooth, rough = flat(), analytic("beckmann", 0.2)
    waves = np.random.default_rng(1).normal(size=4096)
    line = estimate(samples.surface(np.convolve(waves, np.hanning(21), mode="same")), isotropic=True)
    bodies: dict[str, dict[str, Any]] = {
        "smooth coat without absorption": {"coat": smooth},
        "smooth coat on a rough body": {"coat": smooth, "surface": rough},
        "rough coat on a rough body": {"coat": rough, "surface": rough},
        "very smooth facets, slope 1e-6": {"coat": analytic("beckmann", 1e-6)},
        "very rough coat, slope 1": {"coat": analytic("beckmann", 1.0)},
        "coat that absorbs nearly everything, transmittance 1e-12": {"internal_transmittance": 1e-12, "spectrum": None},
        "coat that absorbs everything, transmittance 0": {"internal_transmittance": 0.0, "spectrum": None},
        "coat 1 m thick, 1e6 / mm": {"absorption": 1e6, "thickness": 1000.0, "spectrum": None},
        "coat 1 nm thick": {"absorption": 1.0, "thickness": 1e-6},
        "coat of the index of air, n = 1": {"coat_index": 1.0},
        "coat and body of the same index": {"index": 1.5},
        "coat of index 4": {"coat_index": 4.0, "spectrum": None},
        "metal below a smooth coat": {"coat": smooth, "index": _metal(), "spectrum": None},
        "metal below a rough coat": {"index": _metal(), "spectrum": None},
        "slopes of a line scan": {"coat": line},
    }
    quick = ("smooth coat without absorption",)
    for name, changes in bodies.items():
        options = {"coat": rough, "coat_index": 1.5, "index": 1.55, "spectrum": grey} | changes
        # The lobe of the smoothest facets is narrower than the steps of the integral.
        judge = everywhere if "1e-6" in name else closed
        yield Case(
            "coated bodies",
            name,
            lambda options=options, judge=judge: judge(build_coated(**options)),
            slow=name not in quick,
        )
    yield Case(
        "coated bodies",
        "internal transmittance 1.1",
        lambda: refused(lambda: build_coated(smooth, coat_index=1.5, index=1.5, internal_transmittance=1.1)),
    )


def _colours() -> Iterator[Case]:
    def of(*lab: float) -> xr.Dataset:
        return recover(lab, illuminant="D65", observer=10)

    for lightness in (0.0, 1e-3, 99.99, 100.0):

        def grey(lightness: float = lightness) -> Outcome:
            high = mp.mpf(lightness) > 8
            exact = ((mp.mpf(lightness) + 16) / 116) ** 3 if high else mp.mpf(lightness) * 27 / 24389
            return relative(
                of(lightness, 0.0, 0.0)["total_reflectance"],
                [exact] * len(of(lightness, 0.0, 0.0)["total_reflectance"]),
                1e-6,
                1e-6,
            )

        yield Case("spectrum of a colour", f"grey, L* = {lightness:g}", grey)
    for lab in ((0.0, 5.0, 5.0), (100.0, 50.0, 50.0), (50.0, 150.0, 0.0), (101.0, 0.0, 0.0), (50.0, np.nan, 0.0)):
        yield Case(
            "spectrum of a colour",
            f"L*a*b* {lab[0]:g}, {lab[1]:g}, {lab[2]:g}",
            lambda lab=lab: refused(lambda: of(*lab)),
        )
    in_metres = np.linspace(400e-9, 700e-9, 31)
    yield Case(
        "colours", "wavelengths in m", lambda: refused(lambda: colorimetry.reflectance_to_xyz(in_metres, np.ones(31)))
    )
    yield Case(
        "colours",
        "one wavelength",
        lambda: relative(colorimetry.reflectance_to_xyz([550.0], [1.0])[1], mp.mpf(100), 1e-10),
    )
    yield Case(
        "colours",
        "ΔE00 of black and black",
        lambda: bounded(colorimetry.delta_e_00([0, 0, 0], [0, 0, 0]), 0, 0, "ΔE00"),
    )


def _rig() -> Iterator[Case]:
    name = "peak 10 sr-1, 3 degree"
    at = rig_primary.dense(45.0)
    truth = rig_primary.LOBES[name](*at)

    def data(keep: slice = slice(None)) -> xr.Dataset:
        primary = rig_primary.measured(rig_primary.lobe(name), seed=1)
        seen = np.flatnonzero(np.isfinite(primary["brdf"].values[0, 0]))
        gone = np.setdiff1d(seen, seen[keep])
        primary["brdf"][:, :, gone] = np.nan
        return primary

    def error(primary: xr.Dataset, **options: float) -> float:
        return rig_primary.rms(smoothing.evaluate(smoothing.smooth(primary, **options), *at).values[0], truth)

    yield Case(
        "fit to cells",
        "all cells but one",
        lambda: bounded(error(data(slice(1, None)), strength=1.0), 0, 0.02, "rms relative error"),
    )
    yield Case(
        "fit to cells",
        "one cell",
        lambda: warned(lambda: smoothing.smooth(data(slice(1))), "only 1 cell with a value"),
    )
    yield Case("fit to cells", "no cell", lambda: refused(lambda: smoothing.smooth(data(slice(0)))))
    for strength in (0.0, np.inf, np.nan):
        yield Case(
            "fit to cells",
            f"strength {strength:g}",
            lambda s=strength: refused(lambda: smoothing.smooth(data(), strength=s)),
        )
    yield Case(
        "fit to cells",
        "strength 1e-12",
        lambda: warned(lambda: smoothing.smooth(data(), strength=1e-12), "hardly bounded"),
    )
    yield Case(
        "fit to cells",
        "functions finer than the cells",
        lambda: warned(lambda: smoothing.smooth(data(), "keldysh", scales=8), "determine only"),
    )
    yield Case(
        "fit to cells",
        "strength 1e30: a constant",
        lambda: warned(lambda: smoothing.smooth(data(), strength=1e30), "Poor fit"),
    )
    yield Case(
        "fit to cells",
        "strength 1e30: its values",
        lambda: bounded(
            smoothing.evaluate(smoothing.smooth(data(), strength=1e30), *at), truth.min(), truth.max(), "BSDF"
        ),
    )


def _appearance() -> Iterator[Case]:
    glass = partial(build_facets, index=1.567, multiple_scattering="none")
    yield Case(
        "gloss",
        "black glass, slope rms 1e-6",
        lambda: relative(gloss(glass(analytic("beckmann", 1e-6))), [100] * 3, 1e-5),
    )
    yield Case("gloss", "slope rms 10", lambda: bounded(gloss(glass(analytic("beckmann", 10.0))), 0, 0.01, "GU"))
    yield Case(
        "gloss",
        "no contrast, n = 1",
        lambda: bounded(gloss(build_facets(analytic("beckmann", 0.1), index=1.0)), 0, 0, "GU"),
    )
    for name, build in (
        ("white", lambda: lambertian(samples.spectrum(1.0))),
        ("black", lambda: lambertian(samples.spectrum(0.0))),
        ("slope rms 1e-6", lambda: glass(analytic("beckmann", 1e-6))),
    ):
        yield Case(
            "veiling glare",
            name,
            lambda build=build: bounded(veiling_luminance(build(), Cabin())["veiling_luminance"], 0, 1e5, "cd/m²"),
        )


def cases() -> list[Case]:
    """All cases, in the order of the page."""
    groups = (_optics, _geometry, _masking, _facets, _heights, _waves, _sheets, _coats, _colours, _rig, _appearance)
    return [case for group in groups for case in group()]


_HEAD = """\
# Extremes

`make extremes` writes this page. Each row is a public function at an extreme of its inputs: the largest error against a reference of 50 digits (mpmath) where there
is a closed form, the range of the values where there is none, or the refusal or the warning. BSDFs are evaluated at every pair of the polar angles
{angles}°.

| Stage | Extreme | Outcome | Holds |
|---|---|---|---|
"""

_TAIL = """
Slopes and flake angles below 0.01 are accurate to 1e-12 absolutely, not relatively: they are small differences of directions that are given in degrees.
Smith's Λ is accurate relatively down to 1e-30; below it no light is masked. Masking of tabulated densities is interpolated: their BRDF is accurate to 1e-8.
"""


def page(rows: list[tuple[Case, Outcome]]) -> str:
    """The page of the documentation."""
    text = _HEAD.format(angles=", ".join(f"{angle:g}" for angle in GRAZING))
    for case, outcome in rows:
        words = {"error": "error ", "refused": "refused: ", "warned": "warning: ", "wrong": "**wrong**: "}.get(
            outcome.kind, ""
        )
        cells = (case.stage, case.name, words + outcome.text, outcome.limit)
        text += (
            "| "
            + " | ".join(cell.replace("|", "\\|").replace("*", "\\*").replace("\n", " ") for cell in cells)
            + " |\n"
        )
    return text + _TAIL


def main() -> None:
    """Run all cases and write the page; the exit code is 1 if one is wrong."""
    mp.mp.dps = 50
    rows = []
    for case in cases():
        rows.append((case, case.outcome()))
        print(f"{case.stage}: {case.name}: {rows[-1][1].kind} {rows[-1][1].text}", flush=True)
    (installation.project_folder() / PAGE).write_text(page(rows), encoding="utf-8")
    sys.exit(any(outcome.kind == "wrong" for _, outcome in rows))


if __name__ == "__main__":
    main()
