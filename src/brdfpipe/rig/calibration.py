"""From relative light to BRDF: the etalon, its certificate, and a profile that expires.

f = s L/(L′/T),  s = (f_st cos ϑ_st / cos γ) / (L_st/(L′_st/T_st)):

whatever a cell's path does to light it does to the etalon's and to the sample's alike. The etalon is measured at normal incidence
through one entrance; where it was also measured through others, the cells they share tell how much more or less light each entrance
sends to the holder, what one of them grazes or hides another may see, and all of them together have less noise.

References
----------
Voloboy et al., Keldysh Institute preprint (2005), with the misprinted bracket of s put right (PHYSICS, rig).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import date
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import vocabulary
from brdfpipe.errors import BrdfpipeError
from brdfpipe.geometry import Array, unit_vector
from brdfpipe.rig import screen as screens
from brdfpipe.rig.certificate import Certificate

__all__ = ["CalibrationError", "Certificate", "apply", "calibrate", "charted", "drift_chart", "joined"]

GRAZING = 0.1
"""Cosine of the etalon's angle below which a cell cannot be calibrated."""

HORIZON = 0.01
"""Cosine of view below which part of what a cell sees may lie below the sample's horizon: half a degree."""

DEAD = 0.02
"""A cell with less of the light of the median cell of its kind from the etalon has none."""

HOLE = 4.0
"""Radius [degree] about an entrance in use within which nothing is trusted, where no etalon was looked at through it."""

PATH_U = 0.05
"""Relative standard uncertainty of the light of an entrance the etalon was not measured through."""

LAMP_TOLERANCE = 0.1
"""Relative change of the lamp's spectrum between etalon and sample, beyond a common factor, that is none of a lamp."""

SUSPICIOUS_ZEROS = 0.005
"""Share of exact zeros, where there is light, from which they are no measurement but missing values stored as 0."""

ALARM = 3.0
"""Standard deviations of a change between profiles that is no chance."""

_SCATTER, _PROFILES = 0.01, 3
"""Scatter of profiles that is expected of a rig, and how many profiles' worth that expectation is."""

_ODD, _ODD_LEAST = 5.0, 0.03
"""A cell is partly hidden from an entrance if it has less of its light than of others' by so many standard uncertainties, and so much."""

_BESIDE = 1.5
"""Distance of the middles of neighbouring cells of the disc, over their width, up to corner to corner."""

_SHADOW = -0.05
"""Cosine of view below which a cell sees nothing of the sample."""

_FEWEST_SHADOWED = 5
_TOLD = 5

_COMMON = ("repeat", "reference", "nd", "glare")
"""Components of the etalon's uncertainty that are common to all cells; noise and geometry are each cell's own: ``calibration``."""

_DIMS = ("incidence", "wavelength", "cell")


class CalibrationError(BrdfpipeError):
    """A profile that cannot be made, or may not be used."""


def joined(reduced: Sequence[xr.Dataset]) -> xr.Dataset:
    """Arrangements of one load and side as one dataset of kind ``reduced``, by rising incidence.

    Raises
    ------
    CalibrationError : there are none, or they are of several rigs, loads or sides, or of different wavelengths.
    """
    if not reduced:
        raise CalibrationError("there is no arrangement to join; check the plan's `runs` and `side`")
    for name in ("rig_digest", "load", "side", "filter"):
        if len(found := {str(each.attrs[name]) for each in reduced}) > 1:
            raise CalibrationError(
                f"the frames differ in {name}: {', '.join(sorted(found))}; reduce runs of one rig together"
            )
    if any(not np.array_equal(each["wavelength"].values, reduced[0]["wavelength"].values) for each in reduced):
        raise CalibrationError("the arrangements are of different wavelengths; measure them by one plan")
    # Pictures of single arrangements stay behind.
    values = [each[[name for name, field in each.data_vars.items() if "incidence" in field.dims]] for each in reduced]
    one = xr.concat(
        values, "incidence", data_vars="minimal", coords="minimal", compat="override", combine_attrs="override"
    )
    said = [text for each in reduced for text in vocabulary.warnings(each)]
    one.attrs.pop("warnings", None)
    one = vocabulary.add_warning(one.sortby("incidence"), *dict.fromkeys(said))
    return vocabulary.validate(one, "reduced")


# --- the profile


class _Runs(NamedTuple):
    """The etalon through several entrances; the first axis counts them."""

    scale: Array
    """(entrance, wavelength, cell) f cos ϑ_st over the signal; missing where there is no light."""
    relative: Array
    """Relative uncertainty of each cell's own."""
    common: dict[str, Array]
    """Relative uncertainties common to all cells."""
    facing: NDArray[np.bool_]
    """(entrance, cell) whether the etalon would be seen."""


@dataclass(frozen=True)
class _Paths:
    """What the entrances differ in."""

    path: Array
    """(entrance,) light over that of the first."""
    u: Array
    """Relative."""
    hidden: NDArray[np.bool_]
    """(entrance, cell) whether something stands between, the entrance itself as a rule."""


def calibrate(
    etalon: xr.Dataset,
    certificate: Certificate,
    *,
    lamp_hours: float = 0.0,
    valid_days: int = 90,
    valid_hours: float = 200.0,
    override: bool = False,
) -> xr.Dataset:
    """A calibration profile from runs of the etalon.

    Parameters
    ----------
    etalon : kind ``reduced``, load ``etalon``; the incidences are the entrances it was lit through
    certificate : of the etalon
    lamp_hours : hours the lamp had burnt by then
    valid_days, valid_hours : how long the profile may be used, of the calendar and of the lamp
    override : use a certificate that has run out; recorded in the dataset

    Returns
    -------
    Dataset of kind ``calibration``: ``cell_scale(wavelength, cell)``, BRDF times cosine of view over the signal, as through the first
    entrance; ``path(incidence)``, the light of the entrances over that of the first, and ``hidden(incidence, cell)``.

    Raises
    ------
    CalibrationError : the frames show no etalon, or the certificate has run out.
    CertificateError : it does not cover the wavelengths.
    """
    vocabulary.validate(etalon, "reduced")
    if etalon.attrs["load"] != "etalon":
        raise CalibrationError(
            f"the frames are of the {etalon.attrs['load']}; a profile is made from those of the etalon"
        )
    stale = list(_outdated(certificate, date.fromisoformat(etalon.attrs["day"])))
    if stale and not override:
        raise CalibrationError(f"{stale[0]}; have the etalon calibrated anew, or set `override` if you know why")
    lamp = _lamp(etalon)
    etalon = etalon.isel(wavelength=np.isfinite(lamp))
    runs = _runs(etalon, certificate)
    # A cell without light at any wavelength is dead.
    _refuse_zeros(etalon, np.asarray(np.isfinite(runs.scale).any(axis=1)))
    paths = _paths(runs, _neighbours(etalon))
    profile = xr.Dataset(
        _cell_scales(runs, paths, certificate.brdf(etalon["wavelength"].values, np.zeros(1))[1])
        | {
            "path": ("incidence", paths.path),
            "path_u": ("incidence", paths.u),
            "hidden": (("incidence", "cell"), paths.hidden, {"units": "1", "long_name": "hidden from the entrance"}),
            "lamp": ("wavelength", lamp[np.isfinite(lamp)]),
        },
        coords={
            name: etalon[name]
            for name in ("wavelength", "cell", "theta_s", "phi_s", "kind", "incidence", "solid_angle")
        },
        attrs={
            "certificate": certificate.identity,
            "certificate_valid_until": certificate.valid_until.isoformat(),
            "lamp_hours": float(lamp_hours),
            "valid_days": int(valid_days),
            "valid_hours": float(valid_hours),
            **{name: etalon.attrs[name] for name in ("day", "rig", "rig_digest", "filter", "filter_u")},
        },
    )
    return _finished(profile, "calibration", etalon, stale)


def _outdated(certificate: Certificate, day: date) -> Iterator[str]:
    if day > certificate.valid_until:
        yield f"the certificate {certificate.identity} was valid until {certificate.valid_until}, the etalon was measured on {day}"


def _lamp(etalon: xr.Dataset) -> Array:
    """The lamp's spectrum, (wavelength,)."""
    lamp = _middle(etalon["reference"].values, axis=0)
    if not np.isfinite(lamp).any():
        raise CalibrationError("no frame of the etalon shows the reference spot; measure it anew")
    return lamp


def _runs(etalon: xr.Dataset, certificate: Certificate) -> _Runs:
    """The scale of each entrance."""
    cosine = screens.cos_view_etalon(
        etalon["incidence"].values[:, None], etalon["theta_s"].values, etalon["phi_s"].values
    )
    facing = cosine > GRAZING
    theta = np.degrees(np.arccos(np.clip(cosine, 0.0, 1.0)))
    brdf = np.stack([certificate.brdf(etalon["wavelength"].values, each)[0] for each in theta])
    signal = np.where(facing[:, None], etalon["signal"].values, np.nan)
    alive = _alive(signal, etalon["kind"].values)[:, None]
    signal = np.where(alive & (signal > 0), signal, np.nan)
    relative = {name: etalon[f"signal_u_{name}"].values / signal for name in (*_COMMON, "noise", "geometry")}
    return _Runs(
        brdf * cosine[:, None] / signal,
        np.hypot(relative["noise"], relative["geometry"]),
        {name: relative[name] for name in _COMMON},
        facing,
    )


def _alive(signal: Array, kinds: Array) -> NDArray[np.bool_]:
    """Whether a cell has any light worth the name, (entrance, cell)."""
    alive = np.zeros((signal.shape[0], signal.shape[2]), dtype=bool)
    for kind in np.unique(kinds):
        own = np.where(kinds == kind, signal, np.nan)
        share = own / _middle(own, axis=2)[..., None]
        alive |= _middle(share, axis=1) > DEAD
    return alive


def _middle(values: Array, axis: int) -> Array:
    """Median of what is there; missing where nothing is."""
    ordered = np.sort(values, axis=axis)  # missing values last
    count = np.isfinite(ordered).sum(axis=axis, keepdims=True)
    pair = [np.take_along_axis(ordered, np.maximum(each, 0), axis) for each in ((count - 1) // 2, count // 2)]
    return np.where(count > 0, (pair[0] + np.where(count % 2 == 1, pair[0], pair[1])) / 2, np.nan).squeeze(axis)


def _paths(runs: _Runs, beside: NDArray[np.bool_]) -> _Paths:
    """How much light each entrance sends, by the cells it shares with the first, and which cells it hides.

    A cell that is partly hidden has less light than through other entrances, so that its scale stands out: it is left out, and those
    beside it, of which a little may be hidden.
    """
    alive = np.isfinite(runs.scale).any(axis=1)
    # Dead through one entrance and not through another is hidden, not dead.
    hidden = runs.facing & ~alive & alive.any(axis=0)
    log_ratio = np.log(runs.scale[0] / runs.scale)
    as_first = np.log(runs.scale) + _middle(log_ratio.reshape(len(log_ratio), -1), axis=1)[:, None, None]
    excess = as_first - np.fmin.reduce(as_first, axis=0)
    hidden |= _middle(excess - np.maximum(_ODD * runs.relative, _ODD_LEAST), axis=1) > 0
    hidden = hidden @ beside
    log_ratio = np.where((hidden | hidden[0])[:, None], np.nan, log_ratio)
    weight = np.nan_to_num(1 / (runs.relative[0] ** 2 + runs.relative**2)) * np.isfinite(log_ratio)
    total, count = weight.sum(axis=(1, 2)), np.isfinite(log_ratio).sum(axis=(1, 2))
    mean = (weight * np.nan_to_num(log_ratio)).sum(axis=(1, 2)) / np.maximum(total, 1e-300)
    scatter = (weight * np.nan_to_num(log_ratio - mean[:, None, None]) ** 2).sum(axis=(1, 2))
    error = np.sqrt(np.maximum(scatter / np.maximum(count - 1, 1), 1.0) / np.maximum(total, 1e-300))
    error[0] = 0.0
    return _Paths(np.where(count > 0, np.exp(mean), 1.0), np.where(count > 0, error, PATH_U), hidden)


def _neighbours(reduced: xr.Dataset) -> NDArray[np.bool_]:
    """(cell, cell) whether one is the other or lies beside it; fibres stand alone."""
    direction = unit_vector(reduced["theta_s"].values, reduced["phi_s"].values)
    width = np.sqrt(np.nan_to_num(reduced["solid_angle"].values))
    apart = np.linalg.norm(direction[:, None] - direction, axis=-1)
    return (apart < _BESIDE * (width[:, None] + width) / 2) & (width > 0) & (width[:, None] > 0) | np.eye(
        width.size, dtype=bool
    )


def _cell_scales(runs: _Runs, paths: _Paths, certificate_u: Array) -> dict[str, Any]:
    """The scale of each cell as through the first entrance, the mean of all that show it, and its uncertainties."""
    scale = np.where(paths.hidden[:, None], np.nan, runs.scale * paths.path[:, None, None])
    weight = np.nan_to_num(1 / runs.relative**2) * np.isfinite(scale)
    total = weight.sum(axis=0)
    seen = total > 0
    share = weight / np.where(seen, total, 1.0)
    mean = np.where(seen, (share * np.nan_to_num(scale)).sum(axis=0), np.nan)
    relative = {
        name: (share * np.nan_to_num(each)).sum(axis=0) for name, each in runs.common.items()
    }  # added up, for nothing says that they differ from entrance to entrance
    relative["reference"] = np.hypot(relative["reference"], (share * paths.u[:, None, None]).sum(axis=0))
    relative["calibration"] = 1 / np.sqrt(np.where(seen, total, np.inf))
    relative["certificate"] = np.broadcast_to(certificate_u[:, None], mean.shape)
    dims = ("wavelength", "cell")
    return {"cell_scale": (dims, mean)} | {
        f"cell_scale_u_{name}": (
            dims,
            mean * each,
            {"correlation": "independent" if name == "calibration" else "common"},
        )
        for name, each in relative.items()
    }


# --- its use


def apply(reduced: xr.Dataset, profile: xr.Dataset, *, lamp_hours: float = 0.0, override: bool = False) -> xr.Dataset:
    """The BRDF, or BTDF, of each cell.

    Parameters
    ----------
    reduced : kind ``reduced``, load ``sample``
    profile : kind ``calibration``
    lamp_hours : hours the lamp had burnt by then
    override : use a profile that may not be used; recorded in the dataset

    Returns
    -------
    Dataset of kind ``primary``: ``brdf(incidence, wavelength, cell)``, its combined standard uncertainty and the components ``noise,
    repeat, reference, calibration, certificate, nd, glare, geometry``. The attribute ``stray`` is what cells below the sample's horizon
    see, BRDF times cosine of view [1/sr], which was subtracted from all.

    Raises
    ------
    CalibrationError : another rig's profile, an expired one, a lamp of another spectrum, other wavelengths, zeros in place of missing
        values.
    """
    vocabulary.validate(reduced, "reduced")
    vocabulary.validate(profile, "calibration")
    if reduced.attrs["load"] != "sample":
        raise CalibrationError(f"the frames are of the {reduced.attrs['load']}; a profile is applied to the sample's")
    _check_same(reduced, profile)
    profile = profile.sel(wavelength=reduced["wavelength"].values)
    doubts = [
        *_expired(profile, date.fromisoformat(reduced.attrs["day"]), lamp_hours),
        *_changed_lamp(reduced, profile),
    ]
    if doubts and not override:
        raise CalibrationError(f"{'; '.join(doubts)}; measure the etalon anew, or set `override` if you know why")
    cosine = screens.cos_view(reduced["incidence"].values[:, None], reduced["theta_s"].values, reduced["phi_s"].values)
    hidden = _hidden(reduced, profile)
    _refuse_zeros(reduced, (cosine > HORIZON) & ~hidden & np.isfinite(profile["cell_scale"].values).any(axis=0))
    path, path_u = _path_of(profile, reduced["incidence"].values)
    # BRDF times cosine of view.
    per_signal = np.where(hidden[:, None], np.nan, profile["cell_scale"].values / path[:, None, None])
    seen = per_signal * reduced["signal"].values
    own = {
        name.removeprefix("signal_u_"): np.abs(per_signal) * reduced[name].values
        for name in map(str, reduced.data_vars)
        if name.startswith("signal_u_")
    }
    parts = own | {
        name: np.hypot(
            own.get(name, 0.0), np.abs(seen) * (profile[f"cell_scale_u_{name}"] / profile["cell_scale"]).values
        )
        for name in (*_COMMON, "calibration", "certificate")
    }
    parts["reference"] = np.hypot(parts["reference"], np.abs(seen) * path_u[:, None, None])
    parts["nd"] = np.hypot(parts["nd"], np.abs(seen) * _other_filter(reduced, profile))
    stray, stray_u = _stray(seen, np.hypot(parts["noise"], parts["calibration"]), cosine)
    parts["glare"] = np.hypot(parts["glare"], stray_u[:, None, None])
    above = np.where(cosine > HORIZON, cosine, np.nan)[:, None]
    brdf = (seen - stray[:, None, None]) / above
    return _primary(
        reduced, profile, brdf, {name: part / above for name, part in parts.items()}, cosine, doubts
    ).assign_attrs(stray=stray.tolist(), stray_u=stray_u.tolist())


def _refuse_zeros(reduced: xr.Dataset, lit: NDArray[np.bool_]) -> None:
    """Refuse missing values that were stored as zeros, in cells (incidence, cell) that have light."""
    signal = np.broadcast_to(lit[:, None], reduced["signal"].shape) & (reduced["signal"].values == 0)
    share = float(signal.sum() / max(lit.sum() * reduced.sizes["wavelength"], 1))
    if share > SUSPICIOUS_ZEROS:
        raise CalibrationError(
            f"{share:.1%} of the signals are exactly 0, which no measurement gives: missing values were stored as zeros; store NaN"
        )


def _check_same(reduced: xr.Dataset, profile: xr.Dataset) -> None:
    if reduced.attrs["rig_digest"] != profile.attrs["rig_digest"]:
        raise CalibrationError(
            f"the profile is of another rig ({profile.attrs['rig']}) than the frames ({reduced.attrs['rig']}), or of the same before "
            "something of its description changed; measure the etalon with this one"
        )
    if list(reduced["cell"].values) != list(profile["cell"].values):
        raise CalibrationError("profile and frames have other cells; reduce both with the same program")
    if missing := sorted(set(reduced["wavelength"].values) - set(profile["wavelength"].values)):
        listed = ", ".join(f"{each:g}" for each in missing[:_TOLD]) + (", …" if len(missing) > _TOLD else "")
        raise CalibrationError(f"the etalon was not measured at {listed} nm; add them to the plan of its run")


def _expired(profile: xr.Dataset, day: date, lamp_hours: float) -> Iterator[str]:
    """Reasons not to use a profile any more."""
    made, attrs = date.fromisoformat(profile.attrs["day"]), profile.attrs
    age, burnt = (day - made).days, lamp_hours - float(attrs["lamp_hours"])
    if age > int(attrs["valid_days"]):
        yield f"the profile of {made} has expired: it is {age} days old, and was to be used for {attrs['valid_days']}"
    if age < 0:
        yield f"the profile is of {made}, after the sample was measured ({day})"
    if burnt > float(attrs["valid_hours"]):
        yield (
            f"the profile of {made} has expired: the lamp has burnt {burnt:g} h since, and it was to be used for {attrs['valid_hours']:g}"
        )
    if burnt < 0:
        yield f"the lamp was changed since the profile of {made}: it has burnt {-burnt:g} h less"
    if day > date.fromisoformat(attrs["certificate_valid_until"]):
        yield f"the etalon's certificate {attrs['certificate']} was valid until {attrs['certificate_valid_until']}"
    if attrs.get("drift_violation"):
        yield str(attrs["drift_violation"])


def _changed_lamp(reduced: xr.Dataset, profile: xr.Dataset) -> Iterator[str]:
    """Whether the reference saw another spectrum: the lamp was changed, or wavelengths were mislabelled."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.log(reduced["reference"].values / profile["lamp"].values)
    spread = np.abs(ratio - _middle(ratio, axis=-1)[..., None])
    if np.isfinite(spread).any() and (worst := float(np.nanmax(spread))) > LAMP_TOLERANCE:
        where = float(reduced["wavelength"].values[int(np.nanargmax(np.fmax.reduce(spread, axis=0)))])
        yield (
            f"the lamp's spectrum differs from that of the etalon's run by {np.expm1(worst):.0%} at {where:g} nm: the wavelengths of one of "
            "them are mislabelled or in another order, or the lamp was changed"
        )


def _hidden(reduced: xr.Dataset, profile: xr.Dataset) -> NDArray[np.bool_]:
    """Cells (incidence, cell) that the entrance in use hides; through a sample the light comes from behind."""
    incidences = reduced["incidence"].values
    hidden = screens.cos_view_etalon(incidences[:, None], reduced["theta_s"].values, reduced["phi_s"].values)
    hidden = hidden > np.cos(np.radians(HOLE))
    for place, entrance in enumerate(profile["incidence"].values):
        hidden[incidences == entrance] = profile["hidden"].values[place]
    return hidden & (reduced.attrs["side"] == "reflection")


def _path_of(profile: xr.Dataset, incidences: Array) -> tuple[Array, Array]:
    """Light of each entrance over that of the etalon's, 1 with its uncertainty where the etalon was not measured through it."""
    known = {float(each): place for place, each in enumerate(profile["incidence"].values)}
    places = [known.get(float(each)) for each in incidences]
    path = [1.0 if place is None else float(profile["path"].values[place]) for place in places]
    u = [PATH_U if place is None else float(profile["path_u"].values[place]) for place in places]
    return np.array(path), np.array(u)


def _other_filter(reduced: xr.Dataset, profile: xr.Dataset) -> float:
    """Relative uncertainty of the filters that all others are referred to: none if they are the same, for then it divides out."""
    if reduced.attrs["filter"] == profile.attrs["filter"]:
        return 0.0
    return float(np.hypot(reduced.attrs["filter_u"], profile.attrs["filter_u"]))


def _stray(seen: Array, u: Array, cosine: Array) -> tuple[Array, Array]:
    """What cells that see nothing of the sample see, BRDF times cosine of view (incidence,), and its standard uncertainty.

    Walls and mirrors send it everywhere; what glare was not removed, or too much of it, is in it too. An incidence with few such cells
    takes the mean of the others, and is as uncertain as that is large; without any it is 0.
    """
    dark = (cosine < _SHADOW)[:, None] & np.isfinite(seen) & (u > 0)
    weight = np.where(dark, 1 / np.where(dark, u, 1.0) ** 2, 0.0)
    total, count = weight.sum(axis=(1, 2)), dark.any(axis=1).sum(axis=1)
    mean = (weight * np.nan_to_num(seen)).sum(axis=(1, 2)) / np.where(total > 0, total, 1.0)
    scatter = (weight * np.nan_to_num(seen - mean[:, None, None]) ** 2).sum(axis=(1, 2)) / np.maximum(
        dark.sum(axis=(1, 2)) - 1, 1
    )
    known = count >= _FEWEST_SHADOWED
    if not known.any():
        return np.zeros(count.size), np.zeros(count.size)
    error = np.sqrt(np.maximum(scatter, 1.0) / np.where(total > 0, total, 1.0))
    elsewhere = float(mean[known].mean())
    return np.where(known, mean, elsewhere), np.where(known, error, np.hypot(error[known].mean(), elsewhere))


def _primary(
    reduced: xr.Dataset,
    profile: xr.Dataset,
    brdf: Array,
    parts: dict[str, Array],
    cosine: Array,
    doubts: list[str],
) -> xr.Dataset:
    correlation = {
        name: reduced[f"signal_u_{name}"].attrs["correlation"] for name in parts if f"signal_u_{name}" in reduced
    }
    correlation |= {"calibration": "independent", "certificate": "common"}
    quality = reduced["signal_quality"].values.copy()
    quality[np.isnan(brdf) & (quality != vocabulary.quality("saturated"))] = vocabulary.quality("vignetted")
    quality[np.broadcast_to((cosine <= HORIZON)[:, None], quality.shape)] = vocabulary.quality("shadowed")
    total = np.sqrt(np.sum([part**2 for part in parts.values()], axis=0))
    variables: dict[str, Any] = {"brdf": (_DIMS, brdf), "brdf_u": (_DIMS, total), "brdf_quality": (_DIMS, quality)}
    variables |= {f"brdf_u_{name}": (_DIMS, part, {"correlation": correlation[name]}) for name, part in parts.items()}
    attrs = {name: reduced.attrs[name] for name in ("rig", "rig_digest", "sample", "day", "side")}
    attrs |= {"certificate": profile.attrs["certificate"], "calibrated": profile.attrs["day"]}
    return _finished(xr.Dataset(variables, coords=reduced.coords, attrs=attrs), "primary", reduced, doubts)


def _finished(dataset: xr.Dataset, kind: str, source: xr.Dataset, doubts: Sequence[str]) -> xr.Dataset:
    """A dataset of a kind with the warnings of what it was made from, and what was overridden."""
    if doubts:
        dataset = dataset.assign_attrs(overridden="; ".join(doubts))
    told = [*vocabulary.warnings(source), *(f"{doubt}; used nevertheless" for doubt in doubts)]
    return vocabulary.validate(vocabulary.label(vocabulary.add_warning(dataset, *told), kind), kind)


# --- the chart


def drift_chart(profiles: Sequence[xr.Dataset]) -> xr.Dataset:
    """How the rig's efficiency went from profile to profile, against its scatter.

    Parameters
    ----------
    profiles : kind ``calibration``, of one rig, in the order they were made

    Returns
    -------
    ``change(profile)``, the mean logarithm of the scale against the first, ``limit(profile)``, how far it may be from the mean of those
    before, and ``violation(profile)``, whether it is farther.

    Raises
    ------
    CalibrationError : there is no profile, or they are of several rigs.
    """
    if len(rigs := {profile.attrs["rig_digest"] for profile in profiles}) != 1:
        raise CalibrationError(f"the profiles are of {len(rigs)} rigs; a chart is of one")
    first = np.log(profiles[0]["cell_scale"])
    change = np.array([float((np.log(profile["cell_scale"]) - first).mean()) for profile in profiles])
    limit, away = np.full(change.size, np.nan), np.zeros(change.size)
    for place in range(1, change.size):
        before = change[:place]
        # The scatter seen so far, and what is expected of a rig before any was seen.
        variance = (_PROFILES * _SCATTER**2 + ((before - before.mean()) ** 2).sum()) / (_PROFILES + place - 1)
        limit[place] = ALARM * np.sqrt(variance * (1 + 1 / place))
        away[place] = change[place] - before.mean()
    words = {
        "change": (change, "mean logarithm of the scale against the first profile"),
        "limit": (limit, "change from the mean of those before that is no chance"),
        "violation": (np.abs(away) > np.nan_to_num(limit, nan=np.inf), "whether it changed by more"),
    }
    return xr.Dataset(
        {name: ("profile", values, {"units": "1", "long_name": long}) for name, (values, long) in words.items()},
        coords={"profile": ("profile", np.array([profile.attrs["day"] for profile in profiles]))},
    )


def charted(profile: xr.Dataset, earlier: Sequence[xr.Dataset]) -> xr.Dataset:
    """A new profile, which the chart of the earlier ones of its rig forbids to use if it is no chance that it differs from them."""
    chart = drift_chart([*earlier, profile])
    if not bool(chart["violation"].values[-1]):
        return profile
    change = float(chart["change"].values[-1] - chart["change"].values[:-1].mean())
    limit = float(chart["limit"].values[-1])
    return profile.assign_attrs(
        drift_violation=f"the profile of {profile.attrs['day']} differs by {np.expm1(change):+.1%} from those before, beyond {np.expm1(limit):.1%}: "
        "the etalon is dirty or aged, or the optics were changed"
    )
