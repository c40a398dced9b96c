"""What the preprint's choices for a camera rig cost in accuracy and save in time."""

from __future__ import annotations

import sys
from pathlib import Path
from unittest.mock import patch

import numpy as np
import xarray as xr
from choice_table import Choice, Metric, Option, rms, timed
from rig_smoothing import INCIDENCES, WAVELENGTHS

from brdfpipe.bsdf.measured import completion, smoothing
from brdfpipe.bsdf.measured.basis import PSpline
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.registry import representation

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import rig_primary
import samples

NARROW = "peak 300 sr-1, 1.5 degree"
"""The narrowest lobe, of which the relative error within 3° is stated too."""
COMPARED = (20.0, 45.0)
"""Incidences at which the fit is compared with the truth [degree]."""


def smoothing_of_a_rig() -> Choice:
    """The preprint's basis beside P-splines, and both with fewer and with more functions."""
    fits = {
        "preprint's basis and weights, as printed": (
            "uncertainty of cells, a constant, smoothness at ϑ = 0",
            "keldysh-printed",
            {},
            None,
        ),
        "preprint's basis, repaired, 3 scales": ("narrow lobes", "keldysh", {"scales": 3}, None),
        "preprint's basis, repaired, 6 scales": ("even relative accuracy", "keldysh", {}, None),
        "preprint's basis, repaired, 8 scales": (
            "that cells are not as fine as its functions",
            "keldysh",
            {"scales": 8},
            None,
        ),
        "P-spline, every third knot": ("narrow lobes", "pspline", {}, _spline(3, 4)),
        "P-spline, harmonics to 1": ("lobes that are not round", "pspline", {}, _spline(1, 1)),
        "P-spline": ("", "pspline", {}, _spline(1, 4)),
        "P-spline, harmonics to 8": ("", "pspline", {}, _spline(1, 8)),
    }
    truths = _truths()
    options = []
    for name, (leaves_out, mode, more, basis) in fits.items():
        errors, seconds, terms = {}, [], 0
        for lobe, truth in truths.items():
            primary = rig_primary.measured(truth, INCIDENCES.tolist(), WAVELENGTHS.tolist(), seed=3)
            with patch.object(smoothing, "_basis", return_value=basis) if basis else patch.dict({}):
                smoothed, took = timed(
                    lambda primary=primary, mode=mode, more=more: smoothing.smooth(primary, mode, **more)
                )
            seconds.append(took)
            terms = smoothed.sizes["term"]
            errors[lobe] = rms([_smoothing_error(smoothed, truth, incidence) for incidence in COMPARED])
            if lobe == NARROW:
                errors["the same, in the lobe"] = rms([_smoothing_error(smoothed, truth, one, 3.0) for one in COMPARED])
        options.append(Option(f"{name} ({terms} functions)", leaves_out, errors, {"210 fits": float(np.mean(seconds))}))
    return Choice(
        "Smoothing of a rig's cells",
        f"{INCIDENCES.size} incidences of {WAVELENGTHS.size} wavelengths, noise of 2 %, strength by cross-validation. Relative rms error of the BRDF on a dense grid "
        f"above cos γ = 0.1, at incidences of {COMPARED[0]:g} and {COMPARED[1]:g}°, by lobe; in the lobe: within 3° of the mirror direction. Facets: slope 0.2 over a diffuse base of 0.1. "
        "As printed, the BRDF is 0 beyond 90° from the mirror direction.",
        {name: Metric("%", 5e-4) for name in options[0].errors},
        next(option.name for option in options if option.name.startswith("P-spline (")),
        options,
        sources=[options[0].name],
        judged_by="facets",
    )


def _spline(step: int, harmonics: int) -> PSpline:
    """The default P-spline with every ``step``-th knot and other harmonics."""
    default = PSpline.default()
    inner = default.edges[:-1:step]
    # An even number of intervals.
    edges = (*inner, default.edges[-1]) if len(inner) % 2 == 0 else (*inner[:-1], default.edges[-1])
    return PSpline(edges, harmonics=harmonics)


def _truths() -> dict[str, rig_primary.Truth]:
    """BSDFs that are known: lobes about the mirror direction, and facets, whose lobe stretches and leans with the incidence."""
    facets = nonspectral(samples.beckmann_bsdf(0.2, reflectance=0.1))
    return {name: rig_primary.lobe(name) for name in rig_primary.LOBES} | {"facets": rig_primary.of_model(facets)}


def _smoothing_error(smoothed: xr.Dataset, truth: rig_primary.Truth, incidence: float, within: float = 180.0) -> float:
    """Relative rms error over directions up to so many degrees from the mirror direction, and the wavelengths."""
    theta, phi = rig_primary.dense(incidence)
    theta, phi = theta[theta <= within], phi[theta <= within]
    values = smoothing.evaluate(smoothed.sel(incidence=[incidence]), theta, phi).values[0]
    return rig_primary.rms(values, truth(incidence, theta, phi, np.ones(1)))


def normal_incidence_of_a_rig() -> Choice:
    """The preprint's extrapolation to normal incidence beside one that is even in the incidence."""
    leaves_out = {"linear": "that a BRDF is even in the incidence", "even-quadratic": ""}
    errors: dict[str, dict[str, float]] = {name: {} for name in leaves_out}
    seconds: dict[str, list[float]] = {name: [] for name in leaves_out}
    for slope in (0.1, 0.3):
        model = samples.beckmann_bsdf(slope, reflectance=None)
        primary = rig_primary.measured(
            rig_primary.of_model(model), [10.0, 20.0, 30.0, 45.0, 60.0], noise=1e-3, dark=1e-5, seed=1
        )
        smoothed = smoothing.smooth(primary)
        theta, zero = np.linspace(0, 40, 41), np.zeros(41)
        truth = representation(model).evaluate(zero, zero, theta, zero, None)[:, 0]
        lit = truth > 1e-2 * truth.max()
        for name in leaves_out:
            completed, took = timed(lambda name=name, smoothed=smoothed: completion.complete(smoothed, normal=name), 2)
            found = representation(completed).evaluate(zero, zero, theta, zero, None)[:, 0]
            errors[name][f"slope {slope:g}"] = rms((found / truth - 1)[lit])
            seconds[name].append(took)
    options = [
        Option(
            f"{name}{' (preprint)' if name == 'linear' else ''}",
            text,
            errors[name],
            {"completion": float(np.mean(seconds[name]))},
        )
        for name, text in leaves_out.items()
    ]
    return Choice(
        "Normal incidence of a rig without it",
        "Beckmann facets at incidences of 10 to 60°, noise of 0.1 %, completed. Relative rms error of the BRDF along the normal where it is above 1 % of its peak.",
        {name: Metric("%", 1e-3) for name in options[0].errors},
        "even-quadratic",
        options,
        sources=["linear (preprint)"],
        judged_by="slope 0.1",
    )
