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
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from brdfpipe import specular_directions, vocabulary
from brdfpipe.errors import BrdfpipeError
from brdfpipe.geometry import Array, unit_vector
from brdfpipe.rig.reduction.certificate import Certificate

__all__ = ["CalibrationError", "Certificate", "apply", "calibrate", "charted", "joined"]

GRAZING = 0.1
"""Cosine of the etalon's angle below which a cell cannot be calibrated."""

HORIZON = 0.01
"""Cosine of view below which part of what a cell sees may lie below the sample's horizon: half a degree."""

DEAD = 0.02
"""A cell with less of the light of the median cell of its kind from the etalon has none."""

HOLE = 4.0
"""Radius [degree] about an entrance in use within which nothing is trusted, where no etalon was looked at through it."""

PATH_U = 0.05
"""Relative standard uncertainty of the light of an entrance the etalon was not measured through, all in all or at a wavelength."""

LAMP_TOLERANCE = 0.1
"""Relative change of the lamp's spectrum between etalon and sample, beyond a common factor, that is none of a lamp."""

SUSPICIOUS_ZEROS = 0.005
"""Share of exact zeros, where there is light, from which they are no measurement but missing values stored as 0."""

ALARM = 3.0
"""Standard deviations of a change between profiles that is no chance; of several at once, as many as are no likelier exceeded."""

_SCATTER = {"level": 0.01, "spectrum": 0.003}
"""Scatter of profiles that is expected of a rig: of all wavelengths together, and of each against all."""

_PROFILES = 3
"""How many profiles' worth that expectation is."""

_ANEW = "drop `previous` from calibration.yaml to begin a new chart"

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
    CalibrationError : there are none, or they are of several rigs, loads or sides.

    Notes
    -----
    A wavelength that some of them lack is missing there, and named in a warning.
    """
    if not reduced:
        raise CalibrationError("there is no arrangement to join; check the plan's `runs` and `side`")
    for name in ("rig_digest", "load", "side", "filter"):
        if len(found := {str(each.attrs[name]) for each in reduced}) > 1:
            raise CalibrationError(
                f"the frames differ in {name}: {', '.join(sorted(found))}; reduce runs of one rig together"
            )
    wavelengths = np.unique(np.concatenate([each["wavelength"].values for each in reduced]))
    # Pictures of single arrangements stay behind.
    values = [
        each[[name for name, field in each.data_vars.items() if "incidence" in field.dims]].reindex(
            wavelength=wavelengths, fill_value={"signal_quality": vocabulary.quality("missing")}
        )
        for each in reduced
    ]
    one = xr.concat(
        values, "incidence", data_vars="minimal", coords="minimal", compat="override", combine_attrs="override"
    )
    said = [text for each in reduced for text in vocabulary.warnings(each)] + list(_lacking(reduced, wavelengths))
    one.attrs.pop("warnings", None)
    one = vocabulary.add_warning(one.sortby("incidence"), *dict.fromkeys(said))
    return vocabulary.validate(one, "reduced")


def _lacking(reduced: Sequence[xr.Dataset], wavelengths: Array) -> Iterator[str]:
    """What arrangements lack that others have."""
    lost = {}
    for each in sorted(reduced, key=lambda each: float(each["incidence"][0])):
        missing = np.setdiff1d(wavelengths, each["wavelength"].values)
        if missing.size:
            listed = ", ".join(f"{wavelength:g}" for wavelength in missing[:_TOLD])
            lost[float(each["incidence"][0])] = listed + (", …" if missing.size > _TOLD else "")
    if lost:
        where = "; ".join(f"{incidence:g}° at {listed} nm" for incidence, listed in lost.items())
        yield (
            f"the {reduced[0].attrs['load']} in {reduced[0].attrs['side']} has no frame that can be used of {where}, and has of other "
            "incidences: these spectra are missing, and what is made of them is told from the incidences next to them; "
            "`brdfpipe rig scan … --resume` takes them again"
        )


# --- the profile


class _Runs(NamedTuple):
    """The etalon through several entrances; the first axis counts them."""

    scale: Array
    """(entrance, wavelength, cell) f cos ϑ_st over the signal; missing where there is no light."""
    relative: Array
    """Relative uncertainty of each cell's own."""
    common: dict[str, Array]
    """Relative uncertainties common to all cells."""
    shape_u: Array
    """(entrance, cell) relative uncertainty of what the certificate says of the angle."""
    facing: NDArray[np.bool_]
    """(entrance, cell) whether the etalon would be seen."""


@dataclass(frozen=True)
class _Paths:
    """What the entrances differ in."""

    path: Array
    """(entrance, wavelength) light over that of the first."""
    u: Array
    """Relative."""
    hidden: NDArray[np.bool_]
    """(entrance, cell) whether something stands between, the entrance itself as a rule."""


def calibrate(
    etalon: xr.Dataset,
    certificate: Certificate,
    *,
    name: str = "",
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
    name : what the profile is called in charts; its day if empty
    lamp_hours : hours the lamp had burnt by then
    valid_days, valid_hours : how long the profile may be used, of the calendar and of the lamp
    override : use a certificate that has run out; recorded in the dataset

    Returns
    -------
    Dataset of kind ``calibration``: ``cell_scale(wavelength, cell)``, BRDF times cosine of view over the signal, as through the first
    entrance; ``path(incidence, wavelength)``, the light of the entrances over that of the first, ``hidden(incidence, cell)``, and a chart
    of one point, which :func:`charted` adds to another profile's.

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
    day = str(etalon.attrs["day"])
    profile = xr.Dataset(
        _cell_scales(runs, paths, certificate.brdf(etalon["wavelength"].values, np.zeros(1))[1])
        | {
            "path": (("incidence", "wavelength"), paths.path),
            "path_u": (("incidence", "wavelength"), paths.path * paths.u),
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
    wavelength = etalon["wavelength"].values
    chart = _chart([name or day], [day], np.zeros((1, wavelength.size)), wavelength)
    profile = vocabulary.add_warning(profile.assign(chart), *_angles_not_stated(certificate, etalon, profile))
    return _finished(profile, "calibration", etalon, stale)


def _outdated(certificate: Certificate, day: date) -> Iterator[str]:
    if day > certificate.valid_until:
        yield f"the certificate {certificate.identity} was valid until {certificate.valid_until}, the etalon was measured on {day}"


def _angles_not_stated(certificate: Certificate, etalon: xr.Dataset, profile: xr.Dataset) -> Iterator[str]:
    """Cells that see the etalon at angles of which the certificate says nothing, through every entrance."""
    least = _angle(etalon).min(axis=0)
    known = np.isfinite(profile["cell_scale"].values).any(axis=0)
    beyond = least[known & (least > certificate.theta[-1])]
    if beyond.size:
        where = f"beyond {certificate.theta[-1]:g}°" if certificate.theta[-1] > 0 else "against the angle"
        last = certificate.shape_u_at(certificate.theta[-1:])[0]
        yield (
            f"the certificate {certificate.identity} does not say how the etalon's BRDF goes {where}, and {beyond.size} of {known.sum()} cells "
            f"see it there alone: they go by the last value it states, as uncertain as diffuse standards depart from it, by {last:.1%} growing to "
            f"{certificate.shape_u_at(beyond).max():.1%}; have the etalon measured there, and state `angles` in certificate.yaml"
        )


def _lamp(etalon: xr.Dataset) -> Array:
    """The lamp's spectrum, (wavelength,)."""
    lamp = _middle(etalon["reference"].values, axis=0)
    if not np.isfinite(lamp).any():
        raise CalibrationError("no frame of the etalon shows the reference spot; measure it anew")
    return lamp


def _runs(etalon: xr.Dataset, certificate: Certificate) -> _Runs:
    """The scale of each entrance."""
    theta = _angle(etalon)
    cosine = np.cos(np.radians(theta))
    facing = cosine > GRAZING
    brdf = np.stack([certificate.brdf(etalon["wavelength"].values, each)[0] for each in theta])
    signal = np.where(facing[:, None], etalon["signal"].values, np.nan)
    alive = _alive(signal, etalon["kind"].values)[:, None]
    signal = np.where(alive & (signal > 0), signal, np.nan)
    relative = {name: etalon[f"signal_u_{name}"].values / signal for name in (*_COMMON, "noise", "geometry")}
    return _Runs(
        brdf * cosine[:, None] / signal,
        np.hypot(relative["noise"], relative["geometry"]),
        {name: relative[name] for name in _COMMON},
        np.stack([certificate.shape_u_at(each) for each in theta]),
        facing,
    )


def _angle(etalon: xr.Dataset) -> Array:
    """Angle from the etalon's normal [degree] at which cells see it, (entrance, cell); 90 of those behind it."""
    incidence = etalon["incidence"].values[:, None]
    cosine = specular_directions.cos_view_etalon(incidence, etalon["theta_s"].values, etalon["phi_s"].values)
    return np.asarray(np.degrees(np.arccos(np.clip(cosine, 0.0, 1.0))))


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

    Mirrors reflect one wavelength better than another. Each wavelength is told for itself: hundreds of cells share it, so that its mean is
    known better than anything it is used with, and nothing is won by a smooth spectrum that may be wrong.

    A cell that is partly hidden has less light than through other entrances, so that its scale stands out: it is left out, and those
    beside it, of which a little may be hidden.
    """
    alive = np.isfinite(runs.scale).any(axis=1)
    # Dead through one entrance and not through another is hidden, not dead.
    hidden = runs.facing & ~alive & alive.any(axis=0)
    log_ratio = np.log(runs.scale[0] / runs.scale)
    as_first = np.log(runs.scale) + _middle(log_ratio, axis=2)[..., None]
    excess = as_first - np.fmin.reduce(as_first, axis=0)
    hidden |= _middle(excess - np.maximum(_ODD * runs.relative, _ODD_LEAST), axis=1) > 0
    hidden = hidden @ beside
    log_ratio = np.where((hidden | hidden[0])[:, None], np.nan, log_ratio)
    weight = np.nan_to_num(1 / (runs.relative[0] ** 2 + runs.relative**2)) * np.isfinite(log_ratio)
    total, count = np.maximum(weight.sum(axis=2), 1e-300), np.isfinite(log_ratio).sum(axis=2)
    mean = (weight * np.nan_to_num(log_ratio)).sum(axis=2) / total
    scatter = (weight * np.nan_to_num(log_ratio - mean[..., None]) ** 2).sum(axis=2)
    error = np.sqrt(np.maximum(scatter / np.maximum(count - 1, 1), 1.0) / total)
    # Cells see the etalon at other angles through other entrances: a wrong shape of it looks like more light.
    lean = np.abs((weight * (runs.shape_u[0] - runs.shape_u)[:, None]).sum(axis=2)) / total
    u = np.where(count > 0, np.hypot(error, lean), PATH_U)
    u[0] = 0.0
    return _Paths(np.exp(_between(mean, count > 0)), u, hidden)


def _between(values: Array, known: NDArray[np.bool_]) -> Array:
    """Values (entrance, wavelength), those that are not known told from the wavelengths next to them, or 0."""
    place = np.arange(values.shape[1])
    return np.stack(
        [
            np.interp(place, place[told], each[told]) if told.any() else np.zeros(place.size)
            for each, told in zip(values, known, strict=True)
        ]
    )


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
    scale = np.where(paths.hidden[:, None], np.nan, runs.scale * paths.path[..., None])
    weight = np.nan_to_num(1 / runs.relative**2) * np.isfinite(scale)
    total = weight.sum(axis=0)
    seen = total > 0
    share = weight / np.where(seen, total, 1.0)
    mean = np.where(seen, (share * np.nan_to_num(scale)).sum(axis=0), np.nan)
    relative = {
        name: (share * np.nan_to_num(each)).sum(axis=0) for name, each in runs.common.items()
    }  # added up, for nothing says that they differ from entrance to entrance
    relative["reference"] = np.hypot(relative["reference"], (share * paths.u[..., None]).sum(axis=0))
    relative["calibration"] = 1 / np.sqrt(np.where(seen, total, np.inf))
    # Level and shape of the etalon's BRDF, the same at every incidence.
    relative["certificate"] = np.hypot(certificate_u[:, None], (share * runs.shape_u[:, None]).sum(axis=0))
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
    repeat, reference, calibration, certificate, nd, glare, geometry, path``. The attribute ``stray`` is what cells below the sample's horizon
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
    cosine = specular_directions.cos_view(
        reduced["incidence"].values[:, None], reduced["theta_s"].values, reduced["phi_s"].values
    )
    hidden = _hidden(reduced, profile)
    _refuse_zeros(reduced, (cosine > HORIZON) & ~hidden & np.isfinite(profile["cell_scale"].values).any(axis=0))
    path, path_u = _path_of(profile, reduced["incidence"].values)
    # BRDF times cosine of view.
    per_signal = np.where(hidden[:, None], np.nan, profile["cell_scale"].values / path[..., None])
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
    parts["path"] = np.abs(seen) * path_u[..., None]
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
        raise CalibrationError(
            f"the etalon was not measured at {listed} nm; add them to the plan of its run, or take what is missing of it "
            "(`brdfpipe rig scan … --resume`)"
        )


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
    hidden = specular_directions.cos_view_etalon(
        incidences[:, None], reduced["theta_s"].values, reduced["phi_s"].values
    )
    hidden = hidden > np.cos(np.radians(HOLE))
    for place, entrance in enumerate(profile["incidence"].values):
        hidden[incidences == entrance] = profile["hidden"].values[place]
    return hidden & (reduced.attrs["side"] == "reflection")


def _path_of(profile: xr.Dataset, incidences: Array) -> tuple[Array, Array]:
    """Light of each entrance over that of the etalon's, (incidence, wavelength), and its relative uncertainty; 1 where the etalon was not
    measured through it."""
    path = profile["path"].reindex(incidence=incidences, fill_value=1.0).transpose("incidence", "wavelength").values
    u = profile["path_u"].reindex(incidence=incidences, fill_value=PATH_U).transpose("incidence", "wavelength").values
    return path, u / path


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
    correlation |= {"calibration": "independent", "certificate": "common", "path": "common"}
    quality = reduced["signal_quality"].values.copy()
    explained = np.isin(quality, [vocabulary.quality(name) for name in ("saturated", "missing")])
    quality[np.isnan(brdf) & ~explained] = vocabulary.quality("vignetted")
    quality[np.broadcast_to((cosine <= HORIZON)[:, None], quality.shape)] = vocabulary.quality("shadowed")
    total = np.sqrt(np.sum([part**2 for part in parts.values()], axis=0))
    variables: dict[str, Any] = {"brdf": (_DIMS, brdf), "brdf_u": (_DIMS, total), "brdf_quality": (_DIMS, quality)}
    variables |= {f"brdf_u_{name}": (_DIMS, part, {"correlation": correlation[name]}) for name, part in parts.items()}
    attrs = {name: reduced.attrs[name] for name in ("rig", "rig_digest", "sample", "day", "side", "disc_scale_u")}
    attrs |= {"certificate": profile.attrs["certificate"], "calibrated": profile.attrs["day"]}
    return _finished(xr.Dataset(variables, coords=reduced.coords, attrs=attrs), "primary", reduced, doubts)


def _finished(dataset: xr.Dataset, kind: str, source: xr.Dataset, doubts: Sequence[str]) -> xr.Dataset:
    """A dataset of a kind with the warnings of what it was made from, and what was overridden."""
    if doubts:
        dataset = dataset.assign_attrs(overridden="; ".join(doubts))
    told = [*vocabulary.warnings(source), *(f"{doubt}; used nevertheless" for doubt in doubts)]
    return vocabulary.validate(vocabulary.label(vocabulary.add_warning(dataset, *told), kind), kind)


# --- the chart


def charted(profile: xr.Dataset, previous: xr.Dataset) -> xr.Dataset:
    """A new profile with the control chart of the profile before, and its own point in it.

    What the rig loses, its etalon seems to win: a change common to the cells, of all wavelengths (``level``) or of one against all
    (``spectrum``), may be of either, and is watched. That of a single cell is its own, which a profile is there to follow: it is warned of.

    Parameters
    ----------
    profile, previous : kind ``calibration``, of one rig

    Returns
    -------
    The profile with ``scale_change(profile, wavelength)`` of all profiles up to this one, ``change(profile, watched)`` from the mean of
    those before that were no violation, its ``limit``, and ``violation``. If its own is no chance, the attribute ``drift_violation`` says
    so, and :func:`apply` refuses it.

    Raises
    ------
    CalibrationError : the profile before is of other optics, or of a later day, or has no entrance, cell or wavelength in common.
    """
    ratio = _since(profile, previous)
    step = _middle(ratio, axis=1)
    earlier = previous["scale_change"].reindex(wavelength=profile["wavelength"].values).values
    change = np.vstack([earlier, earlier[-1] + step])
    if not np.isfinite(change).all(axis=0).any():
        raise CalibrationError(f"{_of(previous)} has no wavelength, or no cell, in common with this one; {_ANEW}")
    names, days = (np.append(previous[name].values, profile[name].values[-1]) for name in ("profile", "profile_day"))
    profile = profile.drop_dims("profile").assign(_chart(names, days, change, profile["wavelength"].values))
    profile = vocabulary.add_warning(profile, *_changed_cells(profile, previous, ratio - step[:, None]))
    if violations := list(_violations(profile)):
        profile = profile.assign_attrs(drift_violation="; ".join(violations))
    return vocabulary.validate(profile, "calibration")


def _chart(names: ArrayLike, days: ArrayLike, scale_change: Array, wavelength: Array) -> xr.Dataset:
    """The points of profiles in the order they were made.

    The change is that from the mean of the sound ones before; of the spectrum, which is what each wavelength has beside the level, that
    of the wavelength that departs most. Only wavelengths of all profiles count.
    """
    shared = np.isfinite(scale_change).all(axis=0)
    level = scale_change[:, shared].mean(axis=1, keepdims=True)
    watched = level, scale_change[:, shared] - level
    shape = len(level), len(watched)
    change, limit, violation = np.zeros(shape), np.full(shape, np.nan), np.zeros(shape, dtype=bool)
    departing = np.full(len(level), np.nan)
    for new in range(1, len(level)):
        sound = ~violation[:new].any(axis=1)
        for place, (values, expected) in enumerate(zip(watched, _SCATTER.values(), strict=True)):
            before = values[:new][sound]
            away = values[new] - before.mean(axis=0)
            # The scatter seen so far, and what is expected of a rig before any was seen.
            seen = ((before - before.mean(axis=0)) ** 2).sum() / away.size
            variance = (_PROFILES * expected**2 + seen) / (_PROFILES + len(before) - 1)
            most = int(np.argmax(np.abs(away)))
            change[new, place] = away[most]
            limit[new, place] = _alarm(away.size) * np.sqrt(variance * (1 + 1 / len(before)))
        departing[new] = wavelength[shared][most]
        violation[new] = np.abs(change[new]) > limit[new]
    points = {"change": change, "limit": limit, "violation": violation}
    chart = xr.Dataset(
        {
            "profile_day": ("profile", np.asarray(days)),
            "scale_change": (("profile", "wavelength"), scale_change),
            "departing_wavelength": ("profile", departing),
            **{name: (("profile", "watched"), values) for name, values in points.items()},
        },
        coords={"profile": np.asarray(names), "watched": np.array(list(_SCATTER))},
    )
    return vocabulary.label(chart, "calibration")


def _alarm(count: int) -> float:
    """Standard deviations that the largest of so many exceeds no likelier than one alone exceeds those of an alarm."""
    return float(stats.norm.isf(stats.norm.sf(ALARM) / count))


def _violations(profile: xr.Dataset) -> Iterator[str]:
    """What the chart says against its last profile."""
    point = profile.isel(profile=-1)
    told = {
        "level": "{:+.1%} from those before",
        "spectrum": f"{{:+.1%}} more at {point['departing_wavelength']:g} nm than at all wavelengths together",
    }
    for watched, words in told.items():
        own = point.sel(watched=watched)
        if own["violation"]:
            change, limit = (np.expm1(float(own[name])) for name in ("change", "limit"))
            yield (
                f"the profile of {profile.attrs['day']} differs by {words.format(change)}, beyond {limit:.1%}: the etalon is dirty or aged, or the "
                f"optics were changed ({_ANEW} if they were)"
            )


def _of(profile: xr.Dataset) -> str:
    return f"the profile before, {profile['profile'].values[-1]} of {profile.attrs['day']},"


def _since(profile: xr.Dataset, previous: xr.Dataset) -> Array:
    """Logarithm of the scale over that of the profile before, (wavelength, cell); missing where either is."""
    if previous.attrs["rig_digest"] != profile.attrs["rig_digest"]:
        raise CalibrationError(
            f"{_of(previous)} is of other optics, for the rig's description was changed since, and a chart is of one rig; {_ANEW}"
        )
    if date.fromisoformat(previous.attrs["day"]) > date.fromisoformat(profile.attrs["day"]):
        raise CalibrationError(
            f"{_of(previous)} was measured after this one ({profile.attrs['day']}); `previous` in calibration.yaml is to name one that was "
            "measured before"
        )
    shared = np.intersect1d(profile["incidence"].values, previous["incidence"].values)
    if not shared.size:
        raise CalibrationError(
            f"{_of(previous)} was measured through other entrances; measure the etalon through one of them too (`etalon_entrances` in "
            f"plan.yaml), or {_ANEW}"
        )
    # Scales are as through the first entrance, which may be another one.
    now, before = (_scale_through(each, float(shared[0])) for each in (profile, previous))
    return np.asarray(np.log(now.values / _alike(before, profile)))


def _scale_through(profile: xr.Dataset, entrance: float) -> xr.DataArray:
    return profile["cell_scale"] / profile["path"].sel(incidence=entrance, drop=True)


def _changed_cells(profile: xr.Dataset, previous: xr.Dataset, apart: Array) -> Iterator[str]:
    """Cells that changed, (wavelength, cell), against the others by more than their noise, and so much."""
    own, before = (each["cell_scale_u_calibration"] / each["cell_scale"] for each in (profile, previous))
    u = _middle(np.hypot(own.values, _alike(before, profile)), axis=0)
    away = _middle(apart, axis=0)
    order = np.argsort(-np.abs(np.nan_to_num(away)), kind="stable")
    found = [int(place) for place in order if abs(away[place]) > max(_ODD * u[place], _ODD_LEAST)]
    if found:
        # Of what its scale wins a cell has lost the light.
        listed = ", ".join(
            f"{profile['cell'].values[place]} by {np.expm1(-away[place]):+.0%}" for place in found[:_TOLD]
        )
        yield (
            f"{len(found)} cell{'s' if len(found) > 1 else ''} changed against the others since {previous['profile'].values[-1]}: "
            f"{listed}{', …' if len(found) > _TOLD else ''}; clean fibres that lost light, and see that none was moved or exchanged"
        )


def _alike(values: xr.DataArray, profile: xr.Dataset) -> Array:
    """Values (wavelength, cell) at those of a profile, missing where there are none."""
    return np.asarray(values.reindex_like(profile["cell_scale"]).values)
