"""Is this BSDF physically sound? Reciprocity, energy, positivity and closure, over directions that leave no corner out."""

from __future__ import annotations

import json
from typing import NamedTuple

import numpy as np
import xarray as xr

from brdfpipe import hemisphere, vocabulary
from brdfpipe.bsdf import representations
from brdfpipe.geometry import Array

_DIRECTIONS = 2048
_INCIDENCES = np.array([0.0, 8.0, 15.0, 30.0, 45.0, 60.0, 70.0, 75.0, 80.0, 85.0, 88.0, 89.5])

RECIPROCITY_LIMIT = 1e-9
ENERGY_LIMIT = 1e-6  # the accuracy of the albedo between its nodes
CLOSURE_LIMIT = 1e-6
INTEGRAL_LIMIT = 1e-3  # of the incident light: a counted density has kinks that cost the plain quadrature 1e-4


class _Verdict(NamedTuple):
    verdict: str
    text: str


def check(bsdf: xr.Dataset) -> xr.Dataset:
    """Check a BSDF; never refuses one for what it finds.

    Parameters
    ----------
    bsdf : kind ``bsdf``

    Returns
    -------
    Dataset of kind ``checks``; the attribute ``verdicts`` is JSON {name: {verdict: pass|warn|fail, text}}

    Notes
    -----
    Directions follow a low-discrepancy sequence, uniform in both hemispheres; incidences for energy go to 89.5°.
    """
    vocabulary.validate(bsdf, "bsdf")
    module = representations.representation(bsdf)
    middle = _middle_wavelength(bsdf)
    theta_i, phi_i, theta_o, phi_o = _directions()
    forward = module.evaluate(bsdf, theta_i, phi_i, theta_o, phi_o, middle)[..., 0]
    backward = module.evaluate(bsdf, theta_o, phi_o, theta_i, phi_i, middle)[..., 0]
    albedo = representations.albedo(bsdf, _INCIDENCES, np.zeros_like(_INCIDENCES), None)
    spectral = ("wavelength",) if "wavelength" in bsdf.coords else ()
    mean = (np.abs(forward) + np.abs(backward)) / 2
    difference = np.abs(forward - backward)
    sound = np.isfinite(forward) & (forward >= 0)
    result = xr.Dataset(
        {
            "reciprocity_residual": np.max(np.divide(difference, mean, out=np.zeros_like(mean), where=mean > 0)),
            "albedo": (("theta_i", *spectral), albedo if spectral else albedo[:, 0]),
            "energy_excess": max(float(albedo.max()) - 1, 0.0),
            "negative_fraction": 1 - np.count_nonzero(sound) / sound.size,
            "closure_residual": _closure(bsdf),
            "integral_residual": _integral_residual(bsdf, middle),
            "floor": float(np.nanmin(forward)),
        },
        coords={"theta_i": _INCIDENCES, **({"wavelength": bsdf["wavelength"].values} if spectral else {})},
    )
    result.attrs["verdicts"] = json.dumps(
        {name: verdict._asdict() for name, verdict in _verdicts(result, bsdf).items()}, ensure_ascii=False
    )
    return vocabulary.label(result, "checks")


def _directions() -> tuple[Array, Array, Array, Array]:
    """Pairs of directions, uniform in both hemispheres: Roberts' additive recurrence of low discrepancy in four dimensions."""
    ratio = 1.1673039782614187  # the positive root of x⁵ = x + 1
    unit = (0.5 + np.arange(1, _DIRECTIONS + 1)[:, None] * ratio ** -np.arange(1.0, 5.0)) % 1
    theta_i, theta_o = np.degrees(np.arccos(unit[:, 0])), np.degrees(np.arccos(unit[:, 1]))
    return theta_i, 360 * unit[:, 2], theta_o, 360 * unit[:, 3]


def _middle_wavelength(bsdf: xr.Dataset) -> Array | None:
    if "wavelength" not in bsdf.coords:
        return None
    own = bsdf["wavelength"].values
    return own[[own.size // 2]]


def _integral_residual(bsdf: xr.Dataset, wavelength: Array | None) -> float:
    """Largest difference between the albedo and the BRDF integrated over outgoing directions, as anybody else would."""
    module = representations.representation(bsdf)
    slope = representations.lobe_slope(bsdf) or 0.005
    worst = 0.0
    for theta in (8.0, 45.0, 75.0):
        rule = hemisphere.around_mirror(theta, slope)
        incidence = np.full_like(rule.theta, theta)
        brdf = module.evaluate(bsdf, incidence, np.zeros_like(rule.phi), rule.theta, rule.phi, wavelength)[:, 0]
        albedo = representations.albedo(bsdf, np.array([theta]), np.zeros(1), wavelength)[0, 0]
        worst = max(worst, abs(float(rule.weight @ brdf - albedo)))
    return worst


def _closure(bsdf: xr.Dataset) -> float:
    """Largest difference between the reflectance the material was said to have and the one its BSDF integrates to."""
    if "total_reflectance" not in bsdf or "theta_m" not in bsdf:
        return float("nan")
    at = np.atleast_1d(float(bsdf["theta_m"]))
    integrated = representations.albedo(bsdf, at, np.zeros(1), None)[0]
    return float(np.max(np.abs(integrated - np.atleast_1d(bsdf["total_reflectance"].values))))


def _verdicts(result: xr.Dataset, bsdf: xr.Dataset) -> dict[str, _Verdict]:
    reciprocity, excess = float(result["reciprocity_residual"]), float(result["energy_excess"])
    negative, closure = float(result["negative_fraction"]), float(result["closure_residual"])
    verdicts = {
        "reciprocity": _Verdict(
            "pass" if reciprocity <= RECIPROCITY_LIMIT else "warn",
            f"f(i,o) and f(o,i) differ by at most {reciprocity:.1e} of their mean",
        ),
        "energy": _Verdict(
            "pass" if excess <= ENERGY_LIMIT else "fail",
            f"reflects at most {float(result['albedo'].max()):.4f} of the light, up to {_INCIDENCES[-1]:g}° incidence",
        ),
        "positivity": _Verdict(
            "pass" if negative == 0 else "fail",
            "finite and not negative in every direction"
            if negative == 0
            else f"negative or undefined in {negative:.2%} of the directions",
        ),
    }
    integral = float(result["integral_residual"])
    verdicts["integral"] = _Verdict(
        "pass" if integral <= INTEGRAL_LIMIT else "fail",
        f"the BRDF integrates to its albedo within {integral:.1e}",
    )
    if np.isfinite(closure):
        clamped = bool((bsdf.get("diffuse_quality", xr.DataArray(0)) == vocabulary.quality("clamped")).any())
        closes = closure <= CLOSURE_LIMIT
        verdicts["closure"] = _Verdict(
            "pass" if closes else "warn",
            f"the total reflectance at {float(bsdf['theta_m']):g}° is the given one to {closure:.1e}"
            + ("; the diffuse part was clamped where the given one is below the specular part" if clamped else ""),
        )
    return verdicts
