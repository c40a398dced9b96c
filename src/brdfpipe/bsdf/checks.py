"""Is this BSDF physically sound? Reciprocity, energy, positivity and closure, over directions that leave no corner out."""

from __future__ import annotations

import json
from typing import NamedTuple

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.bsdf import representations
from brdfpipe.bsdf.grids import Angles, from_mirror
from brdfpipe.geometry import Array

_DIRECTIONS = 2048
_INCIDENCES = np.array([0.0, 8.0, 15.0, 30.0, 45.0, 60.0, 70.0, 75.0, 80.0, 85.0, 88.0, 89.5, 89.9, 89.99])
_AZIMUTHS = np.arange(0.0, 360.0, 45.0)
_NEAREST, _FURTHEST = 1e-3, 90.0
"""How far from the mirror direction the directions lie that look into the lobe [degree]"""

RECIPROCITY_LIMIT = 1e-9
ENERGY_LIMIT = 1e-6  # the accuracy of the albedo between its nodes
CLOSURE_LIMIT = 1e-6
INTEGRAL_LIMIT = 1e-3  # of the incident light: a counted density has kinks that cost the plain quadrature 1e-4
GROWTH_LIMIT = 3.0  # what grows as 1/cos θ grows tenfold from 89.9 to 89.99°, and a sound BRDF hardly at all
NAMED_MASKINGS = ("crf", "liu", "none")
"""Modes of the sources that are known to break energy or reciprocity: chosen on purpose, they are warned about."""

_NEGLIGIBLE = 1e-12
"""Share of the largest BRDF below which the two ways of a pair are not compared: rounding decides there."""


class _Verdict(NamedTuple):
    verdict: str
    text: str


class _Residual(NamedTuple):
    """Something that ought to be small, and where it is largest."""

    size: float
    where: str


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
    Directions follow a low-discrepancy sequence, one half uniform over the hemisphere (over the sphere where light passes), one half
    about the mirror directions, at all scales. Incidences for energy go to 89.99°, from both sides where light passes, and all
    round where there is a lay. Reciprocal is f / n_o², n_o the index of the medium the light ends in.
    """
    vocabulary.validate(bsdf, "bsdf")
    middle = _middle_wavelength(bsdf)
    angles = _directions(representations.transmits(bsdf))
    forward, backward = _both_ways(bsdf, angles, middle)
    sound = np.isfinite(forward) & (forward >= 0)
    reflected, passed = _shares(bsdf)
    found = {
        "reciprocity": _reciprocity(forward, backward, angles),
        "energy": _energy(reflected + passed, bsdf),
        "grazing": _grazing(bsdf, middle),
        "integral": _integral(bsdf, middle),
    }
    spectral = ("wavelength",) if "wavelength" in bsdf.coords else ()
    from_above = slice(0, _INCIDENCES.size)

    def told(share: Array) -> tuple[tuple[str, ...], Array]:
        mean = share[from_above].mean(axis=1)
        if not spectral:
            return ("theta_i",), mean[:, 0]
        return ("theta_i", *spectral), np.broadcast_to(mean, (_INCIDENCES.size, bsdf.sizes["wavelength"]))

    result = xr.Dataset(
        {
            "reciprocity_residual": found["reciprocity"].size,
            "albedo": told(reflected),
            "energy_excess": max(found["energy"].size - 1, 0.0),
            "negative_fraction": 1 - np.count_nonzero(sound) / sound.size,
            "closure_residual": _closure(bsdf),
            "integral_residual": found["integral"].size,
            "grazing_growth": found["grazing"].size,
            "floor": float(np.nanmin(forward)),
        },
        coords={"theta_i": _INCIDENCES, **({"wavelength": bsdf["wavelength"].values} if spectral else {})},
    )
    if representations.transmits(bsdf):
        result["transmittance"] = told(passed)
    verdicts = _verdicts(result, found, bsdf)
    result.attrs["verdicts"] = json.dumps(
        {name: verdict._asdict() for name, verdict in verdicts.items()}, ensure_ascii=False
    )
    return vocabulary.label(result, "checks")


def _directions(both_sides: bool) -> Angles:
    """Pairs of directions: Roberts' additive recurrence of low discrepancy in four dimensions."""
    ratio = 1.1673039782614187  # the positive root of x⁵ = x + 1
    unit = (0.5 + np.arange(1, 2 * _DIRECTIONS + 1)[:, None] * ratio ** -np.arange(1.0, 5.0)) % 1
    cosine = unit[:, :2] if not both_sides else 2 * unit[:, :2] - 1
    theta_i, theta_o = np.degrees(np.arccos(cosine)).T
    phi_i, phi_o = 360 * unit[:, 2], 360 * unit[:, 3]
    lobe = slice(_DIRECTIONS, None)
    offset = _NEAREST * (_FURTHEST / _NEAREST) ** unit[lobe, 1]
    theta_o[lobe], phi_o[lobe] = from_mirror(theta_i[lobe], phi_i[lobe], offset, phi_o[lobe])
    return theta_i, phi_i, np.clip(theta_o, 0.0, 180.0), phi_o


def _both_ways(bsdf: xr.Dataset, angles: Angles, wavelength: Array | None) -> tuple[Array, Array]:
    """f / n_o² of pairs of directions and of the same pairs the other way round."""
    module = representations.representation(bsdf)
    theta_i, phi_i, theta_o, phi_o = angles
    squared = representations.index_below(bsdf, wavelength) ** 2
    forward = module.evaluate(bsdf, theta_i, phi_i, theta_o, phi_o, wavelength)[..., 0]
    backward = module.evaluate(bsdf, theta_o, phi_o, theta_i, phi_i, wavelength)[..., 0]
    return forward / np.where(theta_o > 90, squared, 1.0), backward / np.where(theta_i > 90, squared, 1.0)


def _middle_wavelength(bsdf: xr.Dataset) -> Array | None:
    if "wavelength" not in bsdf.coords:
        return None
    own = bsdf["wavelength"].values
    return own[[own.size // 2]]


def _azimuths(bsdf: xr.Dataset) -> Array:
    return _AZIMUTHS[:1] if representations.isotropic(bsdf) else _AZIMUTHS


def _all_incidences(bsdf: xr.Dataset) -> Array:
    if not representations.transmits(bsdf):
        return _INCIDENCES
    return np.concatenate([_INCIDENCES, 180 - _INCIDENCES])


def _shares(bsdf: xr.Dataset) -> tuple[Array, Array]:
    """Reflectance and transmittance, (incidences, azimuths, wavelength)."""
    theta_i, phi_i = np.meshgrid(_all_incidences(bsdf), _azimuths(bsdf), indexing="ij")
    reflected = representations.albedo(bsdf, theta_i, phi_i, None)
    return reflected, representations.transmittance(bsdf, theta_i, phi_i, None)


def _reciprocity(forward: Array, backward: Array, angles: Angles) -> _Residual:
    mean = (np.abs(forward) + np.abs(backward)) / 2
    counts = np.isfinite(mean) & (mean > _NEGLIGIBLE * np.nanmax(mean))
    residual = np.divide(np.abs(forward - backward), mean, out=np.zeros_like(mean), where=counts)
    worst = int(residual.argmax())
    theta_i, phi_i, theta_o, phi_o = (float(angle[worst]) for angle in angles)
    where = f"between θ = {theta_i:.2f}° and θ = {theta_o:.2f}°, {(phi_o - phi_i) % 360:.0f}° apart in azimuth"
    return _Residual(float(residual[worst]), where)


def _energy(total: Array, bsdf: xr.Dataset) -> _Residual:
    by_angle = np.nan_to_num(total, nan=np.inf).max(axis=-1)
    worst = np.unravel_index(int(by_angle.argmax()), by_angle.shape)
    where = f"at θ_i = {_all_incidences(bsdf)[worst[0]]:g}°"
    if not representations.isotropic(bsdf):
        where += f", φ_i = {_azimuths(bsdf)[worst[1]]:g}°"
    return _Residual(float(by_angle[worst]), where)


def _grazing(bsdf: xr.Dataset, wavelength: Array | None) -> _Residual:
    """Largest growth of the BRDF from 89.9 to 89.99°, of either direction; NaN where a value is not finite."""
    module = representations.representation(bsdf)
    steep, phi_i, phi_o = (
        axis.ravel()
        for axis in np.meshgrid([0.0, 30.0, 60.0], _azimuths(bsdf), np.arange(0.0, 360.0, 30.0), indexing="ij")
    )
    worst = _Residual(0.0, "")
    for side in ("θ_o", "θ_i"):
        values = []
        for grazing in (89.9, 89.99):
            pair = (steep, np.full_like(steep, grazing))
            theta_i, theta_o = pair if side == "θ_o" else pair[::-1]
            values.append(module.evaluate(bsdf, theta_i, phi_i, theta_o, phi_o + phi_i, wavelength)[..., 0])
        before, after = values
        if not np.isfinite(values).all():
            return _Residual(float("nan"), f"at {side} = 89.99°")
        counts = after > _NEGLIGIBLE * max(float(after.max()), 1.0)
        growth = np.divide(after, before, out=np.zeros_like(after), where=counts & (before > 0))
        if growth.max() > worst.size:
            worst = _Residual(float(growth.max()), f"towards {side} = 90°")
    return worst


def _integral(bsdf: xr.Dataset, wavelength: Array | None) -> _Residual:
    """Largest difference between the shares the BSDF tells and what it integrates to, as anybody else would."""
    worst = _Residual(0.0, "")
    phi_i = np.array([0.0 if representations.isotropic(bsdf) else 20.0])
    transmits = representations.transmits(bsdf)
    for theta in (8.0, 45.0, 75.0, *((135.0,) if transmits else ())):
        at = np.array([theta]), phi_i
        mirror, straight = representations.specular(bsdf, *at, wavelength)
        told = [representations.albedo(bsdf, *at, wavelength) - mirror]
        if transmits:
            told.append(representations.transmittance(bsdf, *at, wavelength) - straight)
        for through, share in enumerate(told):
            rough = representations.integrated(bsdf, *at, wavelength, through=bool(through), relative=1e-5).value
            size = float(np.abs(rough - share).max())
            if not size <= worst.size:
                worst = _Residual(size, f"at θ_i = {theta:g}°")
    return worst


def _closure(bsdf: xr.Dataset) -> float:
    """Largest difference between the reflectance the material was said to have and the one its BSDF integrates to."""
    if "total_reflectance" not in bsdf or "theta_m" not in bsdf:
        return float("nan")
    phi = _azimuths(bsdf)
    integrated = representations.albedo(bsdf, np.full(phi.size, float(bsdf["theta_m"])), phi, None).mean(axis=0)
    return float(np.max(np.abs(integrated - np.atleast_1d(bsdf["total_reflectance"].values))))


def _verdicts(result: xr.Dataset, found: dict[str, _Residual], bsdf: xr.Dataset) -> dict[str, _Verdict]:
    negative, closure = float(result["negative_fraction"]), float(result["closure_residual"])
    named = _named_mode(bsdf)
    broken = "warn" if named else "fail"
    known = f"; known of {named}" if named else ""
    reciprocal = found["reciprocity"].size <= RECIPROCITY_LIMIT
    keeps = found["energy"].size <= 1 + ENERGY_LIMIT
    spends = "reflects and transmits" if representations.transmits(bsdf) else "reflects"
    verdicts = {
        "reciprocity": _Verdict(
            "pass" if reciprocal else "warn",
            f"f(i,o) and f(o,i) differ by at most {found['reciprocity'].size:.1e} of their mean"
            + ("" if reciprocal else f", {found['reciprocity'].where}{known}"),
        ),
        "energy": _Verdict(
            "pass" if keeps else broken,
            f"{spends} at most {found['energy'].size:.4f} of the light, up to {_INCIDENCES[-1]:g}° incidence"
            + ("" if keeps else f"; most {found['energy'].where}{known}"),
        ),
        "positivity": _Verdict(
            "pass" if negative == 0 else "fail",
            "finite and not negative in every direction"
            if negative == 0
            else f"negative or undefined in {negative:.2%} of the directions",
        ),
        "grazing": _grazing_verdict(found["grazing"], known),
    }
    integrates = found["integral"].size <= INTEGRAL_LIMIT
    verdicts["integral"] = _Verdict(
        "pass" if integrates else broken,
        f"the BRDF integrates to its albedo within {found['integral'].size:.1e}"
        + ("" if integrates else f", {found['integral'].where}{known}"),
    )
    if np.isfinite(closure):
        clamped = bool((bsdf.get("diffuse_quality", xr.DataArray(0)) == vocabulary.quality("clamped")).any())
        closes = closure <= CLOSURE_LIMIT
        verdicts["closure"] = _Verdict(
            "pass" if closes else "warn",
            f"the total reflectance at {float(bsdf['theta_m']):g}° is the given one to {closure:.1e}"
            + ("; the diffuse part was clamped where the given one is below the specular part" if clamped else "")
            + ("" if closes else known),
        )
    return verdicts


def _grazing_verdict(growth: _Residual, known: str) -> _Verdict:
    if not np.isfinite(growth.size):
        return _Verdict("fail", f"undefined or infinite {growth.where}")
    if growth.size <= GROWTH_LIMIT:
        return _Verdict("pass", "finite up to 89.99°, of both directions")
    return _Verdict("warn", f"grows {growth.size:.0f}-fold from 89.9 to 89.99°, {growth.where}{known}")


def _named_mode(bsdf: xr.Dataset) -> str:
    """The source's choice that is known to break energy or reciprocity; empty where there is none."""
    if "recipe" in bsdf.attrs:
        return f"recipe {bsdf.attrs['recipe']}"
    masking = bsdf.attrs.get("masking")
    return f"masking {masking}" if masking in NAMED_MASKINGS else ""
