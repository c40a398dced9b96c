"""Is this BSDF physically sound? Reciprocity, energy, positivity and closure, over directions that leave no corner out."""

from __future__ import annotations

import json
from typing import NamedTuple

import numpy as np
import xarray as xr

from brdfpipe import hemisphere, vocabulary
from brdfpipe.bsdf.grids import Angles, from_mirror
from brdfpipe.bsdf.registry import representation
from brdfpipe.geometry import Array

_DIRECTIONS, _ABOUT_NORMAL, _PROBES = 2048, 1024, 256
_BETWEEN, _BETWEEN_WHERE_COSTLY = 128, 40
"""How many incidences the energy is checked at besides the fixed ones; fewer where each costs a quadrature, or light passes."""
_INCIDENCES = np.array([0.0, 8.0, 15.0, 30.0, 45.0, 60.0, 70.0, 75.0, 80.0, 85.0, 88.0, 89.5, 89.9, 89.99])
_NEAREST, _FURTHEST = 1e-3, 90.0
"""How far from the mirror direction, or the normal, the directions lie that look closely there [degree]"""

RECIPROCITY_LIMIT = 1e-9
CLOSURE_LIMIT = 1e-6
INTEGRAL_LIMIT = 1e-3  # of the incident light: a counted density has kinks that cost the plain quadrature 1e-4
GROWTH_LIMIT = 3.0  # what grows as 1/cos θ grows tenfold from 89.9 to 89.99°, and a sound BRDF hardly at all
CERTAIN = 2.0  # standard uncertainties of a measured BSDF beyond which it breaks a law for sure
_BRIGHTEST = 4
"""Incidences whose light is held against its uncertainty."""
_NEGLIGIBLE = 1e-12
"""Share of the largest BRDF below which the two ways of a pair are not compared: rounding decides there."""


class _Verdict(NamedTuple):
    verdict: str
    text: str


class _Shares(NamedTuple):
    """What is reflected and what passes, (incidences, wavelength) each."""

    theta_i: Array
    phi_i: Array
    reflected: Array
    passed: Array

    @property
    def total(self) -> Array:
        return self.reflected + self.passed


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
    Directions follow a low-discrepancy sequence: uniform over the hemisphere (over the sphere where light passes), about the mirror
    directions, and about the normal, the last two at all scales. They are looked at, both ways, at the first, middle and last
    wavelength and at those of the largest and the smallest values; of a table every node counts for positivity. Incidences for energy
    go to 89.99°, a low-discrepancy sequence and a table's own nodes besides the fixed ones, from both sides where light passes, and
    all round where there is a lay. Reciprocal is f / n_o², n_o the index of the medium the light ends in.

    Energy may exceed 1 by the error of the albedo, see :attr:`brdfpipe.bsdf.base.Representation.albedo_accuracy`.
    """
    vocabulary.validate(bsdf, "bsdf")
    fixed = _shares(bsdf, *_fixed_incidences(bsdf), None)
    angles = _directions(representation(bsdf).transmits)
    telling = _telling_wavelengths(bsdf, angles, fixed)
    between = _shares(bsdf, *_incidences_between(bsdf), telling)
    forward, backward = _both_ways(bsdf, angles, telling)
    values = np.concatenate([forward.ravel(), backward.ravel(), representation(bsdf).stored_values().ravel()])
    found = {
        "reciprocity": _reciprocity(forward, backward, angles),
        "energy": _energy(bsdf, fixed, between),
        "beyond": _beyond_uncertainty(bsdf, fixed, between),
        "least": _least(bsdf, fixed, between),
        "grazing": _grazing(bsdf, telling),
        "integral": _integral(bsdf, telling),
    }
    spectral = ("wavelength",) if "wavelength" in bsdf.coords else ()

    def told(share: Array) -> tuple[tuple[str, ...], Array]:
        azimuths = _azimuths(bsdf).size
        mean = share[: _INCIDENCES.size * azimuths].reshape(_INCIDENCES.size, azimuths, -1).mean(axis=1)
        if not spectral:
            return ("theta_i",), mean[:, 0]
        return ("theta_i", *spectral), np.broadcast_to(mean, (_INCIDENCES.size, bsdf.sizes["wavelength"]))

    result = xr.Dataset(
        {
            "reciprocity_residual": found["reciprocity"].size,
            "albedo": told(fixed.reflected),
            "energy_excess": max(found["energy"].size - 1, 0.0),
            "negative_fraction": 1 - np.count_nonzero(values >= 0) / values.size,
            "closure_residual": _closure(bsdf),
            "integral_residual": found["integral"].size,
            "grazing_growth": found["grazing"].size,
            "floor": float(np.nanmin(values)),
        },
        coords={"theta_i": _INCIDENCES, **({"wavelength": bsdf["wavelength"].values} if spectral else {})},
    )
    if representation(bsdf).transmits:
        result["transmittance"] = told(fixed.passed)
    verdicts = _verdicts(result, found, bsdf)
    result.attrs["verdicts"] = json.dumps(
        {name: verdict._asdict() for name, verdict in verdicts.items()}, ensure_ascii=False
    )
    return vocabulary.label(result, "checks")


def _directions(both_sides: bool) -> Angles:
    """Pairs of directions: Roberts' additive recurrence of low discrepancy in four dimensions."""
    unit = _sequence(2 * _DIRECTIONS + _ABOUT_NORMAL, 4)
    cosine = unit[:, :2] if not both_sides else 2 * unit[:, :2] - 1
    theta_i, theta_o = np.degrees(np.arccos(cosine)).T
    phi_i, phi_o = 360 * unit[:, 2], 360 * unit[:, 3]
    lobe, normal = slice(_DIRECTIONS, 2 * _DIRECTIONS), slice(2 * _DIRECTIONS, None)
    offset = _NEAREST * (_FURTHEST / _NEAREST) ** unit[:, 1]
    theta_o[lobe], phi_o[lobe] = from_mirror(theta_i[lobe], phi_i[lobe], offset[lobe], phi_o[lobe])
    theta_o[normal] = np.where(theta_o[normal] > 90, 180 - offset[normal], offset[normal])
    return theta_i, phi_i, np.clip(theta_o, 0.0, 180.0), phi_o


def _sequence(size: int, dimensions: int) -> Array:
    """Low discrepancy in the unit cube, by powers of the positive root of x^(d+1) = x + 1."""
    root = {1: 1.618033988749895, 2: 1.324717957244746, 4: 1.1673039782614187}[dimensions]
    return np.asarray((0.5 + np.arange(1, size + 1)[:, None] * root ** -np.arange(1.0, dimensions + 1)) % 1)


def _telling_wavelengths(bsdf: xr.Dataset, angles: Angles, fixed: _Shares) -> Array | None:
    """First, middle and last wavelength, and those where the BSDF, or what leaves in all, is largest or smallest."""
    if "wavelength" not in bsdf.coords:
        return None
    own = bsdf["wavelength"].values
    chosen = {0, own.size // 2, own.size - 1}
    step = angles[0].size // _PROBES
    theta_i, phi_i, theta_o, phi_o = (angle[::step] for angle in angles)
    probed = representation(bsdf).evaluate(theta_i, phi_i, theta_o, phi_o, None)
    for field in (probed, representation(bsdf).stored_values(), fixed.total):
        by_wavelength = field.reshape(-1, field.shape[-1])
        if by_wavelength.size and by_wavelength.shape[1] == own.size:
            # An undefined value is the first that counts, for argmax and argmin alike.
            chosen |= {int(np.abs(by_wavelength).max(axis=0).argmax()), int(by_wavelength.min(axis=0).argmin())}
    return np.asarray(own[sorted(chosen)])


def _both_ways(bsdf: xr.Dataset, angles: Angles, wavelength: Array | None) -> tuple[Array, Array]:
    """f / n_o² of pairs of directions and of the same pairs the other way round, (pairs, wavelength)."""
    evaluator = representation(bsdf)
    theta_i, phi_i, theta_o, phi_o = angles
    each = [None] if wavelength is None else [np.array([one]) for one in wavelength]
    squared = np.array([representation(bsdf).index_below(one) for one in each]) ** 2
    forward = evaluator.evaluate(theta_i, phi_i, theta_o, phi_o, wavelength)
    backward = evaluator.evaluate(theta_o, phi_o, theta_i, phi_i, wavelength)
    over = np.where(theta_o[:, None] > 90, squared, 1.0), np.where(theta_i[:, None] > 90, squared, 1.0)
    return forward / over[0], backward / over[1]


def _azimuths(bsdf: xr.Dataset) -> Array:
    return hemisphere.azimuths(representation(bsdf).isotropic)


def _fixed_incidences(bsdf: xr.Dataset) -> tuple[Array, Array]:
    """θ_i and φ_i of the incidences that are told, those from above first."""
    polar = _INCIDENCES
    if representation(bsdf).transmits:
        polar = np.concatenate([polar, 180 - polar])
    theta_i, phi_i = np.meshgrid(polar, _azimuths(bsdf), indexing="ij")
    return theta_i.ravel(), phi_i.ravel()


def _incidences_between(bsdf: xr.Dataset) -> tuple[Array, Array]:
    """θ_i and φ_i off every axis, closer towards grazing, where energy is hardest to keep; and a table's own."""
    evaluator = representation(bsdf)
    transmits, even = evaluator.transmits, evaluator.isotropic
    costly = evaluator.albedo_needs_quadrature or transmits
    unit = _sequence(_BETWEEN_WHERE_COSTLY if costly else _BETWEEN, 1 if even else 2)
    theta_i = np.minimum(90 * (1 - unit[:, 0] ** 2), _INCIDENCES[-1])
    phi_i = np.zeros_like(theta_i) if even else 360 * unit[:, 1]
    if transmits:
        theta_i[1::2] = 180 - theta_i[1::2]
    if evaluator.albedo_needs_quadrature:
        return theta_i, phi_i
    own_theta, own_phi = evaluator.stored_incidences()
    return np.concatenate([theta_i, np.minimum(own_theta, _INCIDENCES[-1])]), np.concatenate([phi_i, own_phi])


def _shares(bsdf: xr.Dataset, theta_i: Array, phi_i: Array, wavelength: Array | None) -> _Shares:
    reflected = representation(bsdf).albedo(theta_i, phi_i, wavelength)
    return _Shares(theta_i, phi_i, reflected, representation(bsdf).transmittance(theta_i, phi_i, wavelength))


def _reciprocity(forward: Array, backward: Array, angles: Angles) -> _Residual:
    mean = (np.abs(forward) + np.abs(backward)) / 2
    counts = np.isfinite(mean) & (mean > _NEGLIGIBLE * np.nanmax(mean))
    residual = np.divide(np.abs(forward - backward), mean, out=np.zeros_like(mean), where=counts)
    worst = int(residual.max(axis=1).argmax())
    theta_i, phi_i, theta_o, phi_o = (float(angle[worst]) for angle in angles)
    where = f"between θ = {theta_i:.2f}° and θ = {theta_o:.2f}°, {(phi_o - phi_i) % 360:.0f}° apart in azimuth"
    return _Residual(float(residual[worst].max()), where)


def _energy(bsdf: xr.Dataset, *shares: _Shares) -> _Residual:
    """The largest share of the light that leaves; infinite where one is undefined."""
    found = [(np.nan_to_num(each.total, nan=np.inf).max(axis=1), each.theta_i, each.phi_i) for each in shares]
    total, theta_i, phi_i = (np.concatenate(parts) for parts in zip(*found, strict=True))
    worst = int(total.argmax())
    return _Residual(float(total[worst]), _incidence(bsdf, theta_i[worst], phi_i[worst]))


def _beyond_uncertainty(bsdf: xr.Dataset, *shares: _Shares) -> _Residual:
    """By how many standard uncertainties the light that leaves exceeds 1; infinite where none is stated."""
    evaluator = representation(bsdf)
    if not evaluator.states_uncertainty:
        return _Residual(np.inf, "")
    worst = _Residual(0.0, "")
    for each in shares:
        total = each.total.max(axis=1)
        brightest = np.argsort(total)[-_BRIGHTEST:]
        for at in brightest[total[brightest] > 1]:
            u = evaluator.albedo_uncertainty(each.theta_i[[at]], each.phi_i[[at]], None).max()
            size = float((total[at] - 1) / u) if u > 0 else np.inf
            if size > worst.size:
                worst = _Residual(size, _incidence(bsdf, each.theta_i[at], each.phi_i[at]))
    return worst


def _least(bsdf: xr.Dataset, *shares: _Shares) -> _Residual:
    """The smallest share that is reflected, or that passes."""
    found = [
        (np.minimum(each.reflected.min(axis=1), each.passed.min(axis=1)), each.theta_i, each.phi_i) for each in shares
    ]
    share, theta_i, phi_i = (np.concatenate(parts) for parts in zip(*found, strict=True))
    worst = int(share.argmin())
    return _Residual(float(share[worst]), _incidence(bsdf, theta_i[worst], phi_i[worst]))


def _incidence(bsdf: xr.Dataset, theta_i: float, phi_i: float) -> str:
    where = f"at θ_i = {_rounded(theta_i)}°"
    return where if representation(bsdf).isotropic else where + f", φ_i = {_rounded(phi_i)}°"


def _rounded(angle: float) -> str:
    return f"{round(float(angle), 2):g}"


def _grazing(bsdf: xr.Dataset, wavelength: Array | None) -> _Residual:
    """Largest growth of the BRDF from 89.9 to 89.99°, of either direction; NaN where a value is not finite."""
    evaluator = representation(bsdf)
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
            values.append(evaluator.evaluate(theta_i, phi_i, theta_o, phi_o + phi_i, wavelength))
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
    phi_i = np.array([0.0 if representation(bsdf).isotropic else 20.0])
    transmits = representation(bsdf).transmits
    for theta in (8.0, 45.0, 75.0, *((135.0,) if transmits else ())):
        at = np.array([theta]), phi_i
        mirror, straight = representation(bsdf).specular(*at, wavelength)
        told = [representation(bsdf).albedo(*at, wavelength) - mirror]
        if transmits:
            told.append(representation(bsdf).transmittance(*at, wavelength) - straight)
        for through, share in enumerate(told):
            rough = representation(bsdf).integrate(*at, wavelength, through=bool(through), relative=1e-5).value
            size = float(np.abs(rough - share).max())
            if not size <= worst.size:
                worst = _Residual(size, f"at θ_i = {theta:g}°")
    return worst


def _closure(bsdf: xr.Dataset) -> float:
    """Largest difference between the reflectance the material was said to have and the one its BSDF integrates to."""
    if "total_reflectance" not in bsdf or "theta_m" not in bsdf:
        return float("nan")
    phi = _azimuths(bsdf)
    integrated = representation(bsdf).albedo(np.full(phi.size, float(bsdf["theta_m"])), phi, None).mean(axis=0)
    return float(np.max(np.abs(integrated - np.atleast_1d(bsdf["total_reflectance"].values))))


def _verdicts(result: xr.Dataset, found: dict[str, _Residual], bsdf: xr.Dataset) -> dict[str, _Verdict]:
    negative, closure = float(result["negative_fraction"]), float(result["closure_residual"])
    unphysical = representation(bsdf).unphysical_choice
    broken = "warn" if unphysical else "fail"
    known = f"; known of {unphysical}" if unphysical else ""
    reciprocal = found["reciprocity"].size <= RECIPROCITY_LIMIT
    # A representation that averages both ways is reciprocal whatever was measured.
    averaged = float(bsdf.attrs.get("contradiction", 0.0))
    limit = representation(bsdf).albedo_accuracy
    keeps, gives = found["energy"].size <= 1 + limit, found["least"].size >= -limit
    doubtful = not keeps and found["beyond"].size <= CERTAIN
    spends = "reflects and transmits" if representation(bsdf).transmits else "reflects"
    verdicts = {
        "reciprocity": _Verdict(
            "pass" if reciprocal and averaged <= CERTAIN else "warn",
            f"f(i,o) and f(o,i) differ by at most {found['reciprocity'].size:.1e} of their mean"
            + ("" if reciprocal else f", {found['reciprocity'].where}{known}")
            + (
                f"; made so: as measured they differ by up to {averaged:.1f} times their uncertainty"
                if averaged
                else ""
            ),
        ),
        "energy": _Verdict(
            "fail" if not gives else "pass" if keeps else "warn" if doubtful else broken,
            f"{spends} at most {found['energy'].size:.4f} of the light, up to {_INCIDENCES[-1]:g}° incidence"
            + ("" if keeps else f"; most {found['energy'].where}{known}")
            + (f"; within its uncertainty: {found['beyond'].size:.1f} times that above 1" if doubtful else "")
            + ("" if gives else f"; a negative share, {found['least'].size:.2g}, {found['least'].where}"),
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
    stated = float(bsdf.get("interpolation_error", 0.0))
    expected = found["integral"].size <= stated
    verdicts["integral"] = _Verdict(
        "pass" if integrates else "warn" if expected else broken,
        f"what leaves in all directions adds up to the told share within {found['integral'].size:.1e} of the light"
        + ("" if integrates else f" (at most {INTEGRAL_LIMIT:g} is wanted), {found['integral'].where}{known}")
        + (
            f"; the table of angles states an error of {stated:.1e}: take shares from `albedo` and `transmittance`"
            if expected and not integrates
            else ""
        ),
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
