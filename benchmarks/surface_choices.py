"""What the sources' choices for the model of a surface cost in accuracy and save in time."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import xarray as xr
from choice_table import Choice, Metric, Option, largest, rms, timed
from scipy.special import ndtr

from brdfpipe.appearance.gloss_meter import gloss
from brdfpipe.bsdf import approximation_error, traced
from brdfpipe.bsdf.lambert_gauss_fit import fit_lambert_gauss
from brdfpipe.bsdf.microfacet.builder import build as build_facets
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.registry import representation
from brdfpipe.facets.analytic_distributions import analytic
from brdfpipe.facets.estimation import estimate
from brdfpipe.geometry import Array
from brdfpipe.masking.visibility_choice import choose
from brdfpipe.optics.index import refractive_index
from brdfpipe.scenes.candidate_model import FITTED_INCIDENCES
from brdfpipe.scenes.candidate_model import build as build_candidate
from brdfpipe.scenes.ladders import FULLEST, Candidate
from brdfpipe.scenes.model_inputs import ModelInputs

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import relief_maps
import samples

INDEX = 1.5
SIZE = 256
"""Heights along each axis of a map."""
EVALUATED = 2**20
"""Directions of an evaluation that is timed; fewer than half as many are not given to the compiled kernel."""
MAPS: Mapping[str, Array] = {
    "slope 0.3": relief_maps.gaussian(0.3, SIZE, 0),
    "GGX": relief_maps.ggx_like(SIZE, 0),
    "cells": relief_maps.cells(SIZE, 0),
    "cells upside down": -relief_maps.cells(SIZE, 0),
}


def evaluation_time(bsdf: xr.Dataset, repeats: int = 3) -> float:
    """Processor time of a million random pairs of directions at one wavelength [s]."""
    rng, evaluator = np.random.default_rng(0), representation(bsdf)
    theta_i, theta_o = np.degrees(np.arccos(rng.random((2, EVALUATED))))
    phi_i, phi_o = 360 * rng.random((2, EVALUATED))
    seconds = timed(lambda: evaluator.evaluate(theta_i, phi_i, theta_o, phi_o, None), repeats)[1]
    return seconds * 1e6 / EVALUATED


# --- the model of a surface


_PATENT, _FITTED = "crf", "fitted"
"""Models that are no candidates of a planner."""
_BETWEEN = (5.0, 25.0, 45.0, 65.0, 77.5)
"""Incidences at which models are compared, between those at which Lambert + Gauss is fitted [degree]."""


def warm_up() -> None:
    """Compile what the models of a surface need, so that no time includes it."""
    surface = samples.gaussian_surface(64)
    facets = estimate(surface)
    inputs = ModelInputs(refractive_index(INDEX), samples.spectrum(0.3), facets, None, surface)
    measured = build_facets(
        facets, index=INDEX, masking="measured", visibility=choose(surface, facets, masking="measured")
    )
    for bsdf in (build_candidate(FULLEST, inputs), measured, traced.build(surface, index=INDEX, rays=10**4)):
        evaluation_time(nonspectral(bsdf), 1)


def model_of_a_surface() -> Choice:
    """Lambert + Gauss and the patent's facets beside the full model."""
    warm_up()
    models = {
        "Lambert alone": ("all gloss", Candidate(distribution="lambert")),
        "Lambert + Gauss (patent)": (
            "the shape of the lobe, and its growth between the fitted incidences",
            Candidate(
                distribution="lambert-gauss", optics="facets", masking="height-correlated", multiple_scattering="none"
            ),
        ),
        "the same, fitted to the full model": ("the same", _FITTED),
        "facets after the patent, `recipe: crf`": (
            "masking of the incident light, light reflected twice, the closure of the diffuse part",
            _PATENT,
        ),
        "facets, reflected once": (
            "masking that slopes do not show, light reflected twice",
            Candidate(optics="facets", masking="height-correlated", multiple_scattering="none"),
        ),
        "the full model": ("", FULLEST),
    }
    found: dict[str, list[tuple[Array, Array, Array, float, float, float]]] = {name: [] for name in models}
    for height in MAPS.values():
        surface = samples.surface(height)
        inputs = ModelInputs(refractive_index(INDEX), samples.spectrum(0.3), estimate(surface), None, surface)
        reference: xr.Dataset = nonspectral(build_candidate(FULLEST, inputs))
        for name, (_, candidate) in models.items():
            bsdf, seconds = timed(lambda candidate=candidate, inputs=inputs: _surface_model(candidate, inputs))
            reduced = nonspectral(bsdf)
            misfits = [_misfit(reduced, reference, angle) for angle in _BETWEEN]
            units = gloss(reduced).values - gloss(reference).values
            found[name].append(
                (
                    np.array([one.rms for one in misfits]),
                    np.array([one.reflectance for one in misfits]),
                    units,
                    seconds,
                    evaluation_time(reduced),
                    bsdf.nbytes,
                )
            )
    options = []
    for name, (leaves_out, _) in models.items():
        shape, light, units, seconds, evaluation, size = (np.array(part) for part in zip(*found[name], strict=True))
        errors = {"BRDF, rms": rms(shape), "reflectance": largest(light), "gloss": largest(units)}
        times = {"build": float(seconds.mean()), "10⁶ directions": float(evaluation.mean())}
        options.append(Option(name, leaves_out, errors, times, float(size.mean())))
    return Choice(
        "Model of a surface",
        f"Maps of {SIZE}² heights ({', '.join(MAPS)}), n = {INDEX:g}, total reflectance 0.3, against the full model. BRDF: error weighted with light, over the "
        f"BRDF so weighted, rms over the maps and incidences of {_listed(_BETWEEN)}. Reflectance and gloss (GU at 20, 60, 85°): the largest. "
        "Builds start from the slope density, whose estimate is not counted; the full model traces facets and rays on the map. Lambert + Gauss is fitted to facets that reflect once, in a build too.",
        {"BRDF, rms": Metric("%", 1e-4), "reflectance": Metric("%", 1e-4), "gloss": Metric("GU", 0.01)},
        "the full model",
        options,
        sources=["Lambert + Gauss (patent)", "facets after the patent, `recipe: crf`"],
        judged_by="BRDF, rms",
    )


def _surface_model(model: Candidate | str, inputs: ModelInputs) -> xr.Dataset:
    """The model of a candidate, the facets of the patent, or Lambert + Gauss fitted to the full model."""
    if isinstance(model, Candidate):
        return build_candidate(model, inputs)
    if model == _FITTED:
        return fit_lambert_gauss(build_candidate(FULLEST, inputs), FITTED_INCIDENCES)
    return build_facets(inputs.facets, index=inputs.index, spectrum=inputs.spectrum, recipe=model)


def _misfit(bsdf: xr.Dataset, reference: xr.Dataset, theta_i: float) -> approximation_error.Misfit:
    rule = approximation_error.directions(reference, theta_i)
    values = (approximation_error.brdf_at(one, theta_i, 0.0, rule)[:, 0] for one in (bsdf, reference))
    return approximation_error.misfit(rule.weight, *values)


def _listed(angles: tuple[float, ...]) -> str:
    return ", ".join(f"{angle:g}" for angle in angles) + "°"


# --- the slope density of a line

LINE = 2**18
"""Heights of a line, 1 µm apart."""
_LINES = 4
_WIDTH = 0.2


def slopes_of_a_line() -> Choice:
    """The patent's histogram of a line's slopes beside inversions to the density of the surface."""
    leaves_out = {
        "crf": "that a line shows one component of each slope",
        "abel": "",
        "mixture": "",
    }
    truths = {
        title: (kind, _facet_bsdf(analytic(kind, a=_WIDTH)))
        for title, kind in (("normal slopes", "beckmann"), ("GGX", "ggx"))
    }
    estimate(samples.surface(_line("beckmann")), isotropic=True)  # loads what the first estimate needs
    options = []
    for name, text in leaves_out.items():
        errors, seconds = {}, []
        for title, (kind, truth) in truths.items():
            shapes, peaks, units = [], [], []
            for seed in range(_LINES):
                line = samples.surface(_line(kind, seed))
                facets, took = timed(
                    lambda name=name, line=line: estimate(line, method=name, isotropic=True, noise=0.0)
                )
                bsdf = _facet_bsdf(facets)
                shapes += [_misfit(bsdf, truth, angle).rms for angle in (5.0, 45.0)]
                peaks.append(_along_normal(bsdf) / _along_normal(truth) - 1)
                units.append(gloss(bsdf).values - gloss(truth).values)
                seconds.append(took)
            errors |= {
                f"{title}: BRDF": rms(shapes),
                f"{title}: peak": rms(peaks),
                f"{title}: gloss": largest(np.concatenate(units)),
            }
        title = "crf (patent)" if name == "crf" else name
        options.append(Option(title, text, errors, {"estimate": float(np.mean(seconds))}))
    return Choice(
        "Slope density of a line profile",
        f"{_LINES} lines of {LINE} heights whose slopes are correlated over 3 of them, of normal slopes and of slopes with the long tail of GGX (width {_WIDTH:g}), against the "
        f"density that it was drawn from; chance among the slopes is in all errors. BRDF of light reflected once, n = {INDEX:g}, at 5 and 45°, and its peak along the normal, rms; the largest error of gloss.",
        {
            name: Metric("GU" if name.endswith("gloss") else "%", 0.02 if name.endswith("gloss") else 0.002)
            for name in options[0].errors
        },
        "mixture",
        options,
        sources=["crf (patent)"],
        judged_by="GGX: BRDF",
    )


def _facet_bsdf(facets: xr.Dataset) -> xr.Dataset:
    return build_facets(facets, index=INDEX, multiple_scattering="none")


def _along_normal(bsdf: xr.Dataset) -> float:
    zero = np.zeros(1)
    return float(representation(bsdf).evaluate(zero, zero, zero, zero, None)[0, 0])


def _line(kind: str, seed: int = 0) -> Array:
    """Heights whose slopes are normally distributed, or those of GGX: normal ones whose variance is an inverse exponential variable."""
    rng = np.random.default_rng(seed)
    slope = _smooth_noise(rng, 3.0) * _WIDTH / np.sqrt(2)
    if kind == "ggx":
        # Of the product of the two, the squared slope of a surface over the squared width is the ratio of two exponential variables.
        share = ndtr(_smooth_noise(rng, 40.0))
        slope = _smooth_noise(rng, 3.0) * _WIDTH / np.sqrt(-2 * np.log(np.clip(share, 1e-9, 1 - 1e-9)))
    return np.concatenate([[0.0], np.cumsum(slope)])


def _smooth_noise(rng: np.random.Generator, length: float) -> Array:
    """Normal variables of variance 1 (LINE,), correlated over a length."""
    noise = np.fft.rfft(rng.standard_normal(LINE))
    noise *= np.exp(-((np.pi * np.fft.rfftfreq(LINE) * length) ** 2) / 2)
    values = np.fft.irfft(noise)
    return np.asarray(values / values.std())


# --- the diffuse part


def diffuse_part() -> Choice:
    """The patent's diffuse part beside one that is coupled to the facets."""
    leaves_out = {
        "none": "light from below the surface",
        "crf": "light that the facets reflect before it enters, and after",
        "coupled": "",
    }
    spectrum = samples.spectrum(0.3)
    eight, zero, measured = np.array([8.0]), np.zeros(1), 0.3
    low, high = np.array([10.0]), np.array([75.0])
    options = []
    for name, text in leaves_out.items():
        closure, reciprocity, seconds = [], [], []
        for slope in (0.1, 0.3):
            facets = analytic("beckmann", a=slope * np.sqrt(2))
            bsdf, took = timed(
                lambda facets=facets, name=name: build_facets(
                    facets, index=INDEX, spectrum=spectrum, diffuse=name, multiple_scattering="none"
                )
            )
            model = representation(nonspectral(bsdf))
            closure.append(float(model.albedo(eight, zero, None)[0, 0]) / measured - 1)
            there, back = (model.evaluate(one, zero, other, zero, None) for one, other in ((low, high), (high, low)))
            reciprocity.append(float((there / back - 1)[0, 0]))
            seconds.append(took)
        errors = {"total reflectance at 8°": largest(closure), "reciprocity": largest(reciprocity)}
        title = "crf (patent)" if name == "crf" else name
        options.append(Option(title, text, errors, {"build": float(np.mean(seconds))}))
    return Choice(
        "Diffuse part",
        f"Facets of normal slopes of 0.1 and 0.3, n = {INDEX:g}, over a body whose total reflectance of 0.3 was measured at 8°: the larger of the relative errors of that reflectance; and of "
        "|f(10°→75°)/f(75°→10°) − 1|.",
        {name: Metric("%", 1e-6) for name in options[0].errors},
        "coupled",
        options,
        sources=["crf (patent)"],
        judged_by="total reflectance at 8°",
    )
