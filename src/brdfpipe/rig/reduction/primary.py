"""The primary BRDF or BTDF of each cell: relative light times the calibration profile."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import date
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import specular_directions, vocabulary
from brdfpipe.errors import abbreviated
from brdfpipe.geometry import Array
from brdfpipe.rig.reduction.arrangements import ENTRANCE_EXCLUSION_RADIUS, CalibrationError, finite_median
from brdfpipe.rig.reduction.budget import BY_NAME, terms_of_brdf
from brdfpipe.rig.reduction.calibration import COMMON, PATH_U, finish, refuse_zeros

HORIZON = 0.01
"""Cosine of view below which part of a cell's field may be below the sample's horizon: half a degree."""

LAMP_TOLERANCE = 0.1
"""Largest plausible relative change of the lamp's spectrum between etalon and sample, a common factor aside."""

_BELOW_HORIZON = -0.05  # cosine of view below which a cell sees nothing of the sample
_FEWEST_BELOW_HORIZON = 5  # cells below the horizon that a stray-light estimate needs


def apply_profile(
    reduced: xr.Dataset,
    profile: xr.Dataset,
    *,
    index: xr.Dataset | None = None,
    lamp_hours: float = 0.0,
    override: bool = False,
) -> xr.Dataset:
    """The BRDF, or BTDF, of each cell.

    Parameters
    ----------
    reduced : kind ``reduced``, load ``sample``
    profile : kind ``calibration``
    index : kind ``index``, of the material, for the component ``polarisation``; without it that of a face of 1.5
    lamp_hours : hours the lamp had run when the sample was measured
    override : use an expired or doubtful profile; recorded in the dataset

    Returns
    -------
    Dataset of kind ``primary``: ``brdf(incidence, wavelength, cell)``, its combined standard uncertainty and its components, the
    terms of :data:`brdfpipe.rig.reduction.budget.TERMS`. The attribute ``stray`` is the stray light that was subtracted:
    BRDF times cosine of view [1/sr] of the cells below the sample's horizon.

    Raises
    ------
    CalibrationError : the profile is of another rig or has expired, the lamp's spectrum differs, wavelengths are not calibrated, or missing
        values were stored as zeros.
    """
    vocabulary.validate(reduced, "reduced")
    vocabulary.validate(profile, "calibration")
    if reduced.attrs["load"] != "sample":
        raise CalibrationError(
            f"the frames are of the {reduced.attrs['load']}; a profile is applied to frames of the sample"
        )
    _check_same_rig(reduced, profile)
    profile = profile.sel(wavelength=reduced["wavelength"].values)
    doubts = [
        *_profile_expiry(profile, date.fromisoformat(reduced.attrs["day"]), lamp_hours),
        *_lamp_change(reduced, profile),
    ]
    if doubts and not override:
        accept = "or accept this with `override: true`, which the results record"
        raise CalibrationError(f"{'; '.join(doubts)}; measure the etalon again, {accept}")
    incidence = reduced["incidence"].values
    cosine = specular_directions.cos_view(incidence[:, None], reduced["theta_s"].values, reduced["phi_s"].values)
    hidden = _hidden_cells(reduced, profile)
    refuse_zeros(reduced, (cosine > HORIZON) & ~hidden & np.isfinite(profile["cell_scale"].values).any(axis=0))
    # Light of each entrance over that of the etalon's first (incidence, wavelength): 1 for an entrance without the etalon.
    path, path_u = (
        profile[name].reindex(incidence=incidence, fill_value=unknown).transpose("incidence", "wavelength").values
        for name, unknown in (("path", 1.0), ("path_u", PATH_U))
    )
    scale = np.where(hidden[:, None], np.nan, profile["cell_scale"].values / path[..., None])
    # BRDF times cosine of view.
    projected = scale * reduced["signal"].values
    parts = _uncertainty_components(reduced, profile, scale, projected)
    parts["path"] = np.abs(projected) * (path_u / path)[..., None]
    stray, stray_u = _stray_light(projected, np.hypot(parts["noise"], parts["calibration"]), cosine)
    parts["stray"] = np.where(np.isfinite(projected), stray_u[:, None, None], np.nan)
    above = np.where(cosine > HORIZON, cosine, np.nan)[:, None]
    brdf = (projected - stray[:, None, None]) / above
    parts = {name: part / above for name, part in parts.items()}
    parts |= terms_of_brdf(reduced, brdf, profile["incidence"].values, index)
    primary = _primary_dataset(reduced, profile, brdf, parts, cosine)
    return finish(primary, "primary", reduced, doubts).assign_attrs(stray=stray.tolist(), stray_u=stray_u.tolist())


def _check_same_rig(reduced: xr.Dataset, profile: xr.Dataset) -> None:
    if reduced.attrs["rig_digest"] != profile.attrs["rig_digest"]:
        raise CalibrationError(
            f"the profile is of another rig ({profile.attrs['rig']}) than the frames ({reduced.attrs['rig']}), or the rig's description "
            "changed since; measure the etalon with this rig"
        )
    if list(reduced["cell"].values) != list(profile["cell"].values):
        raise CalibrationError("profile and frames have different cells; reduce both with the same version of brdfpipe")
    if missing := sorted(set(reduced["wavelength"].values) - set(profile["wavelength"].values)):
        listed = abbreviated([f"{wavelength:g}" for wavelength in missing], 5)
        raise CalibrationError(
            f"the etalon was not measured at {listed} nm; add these wavelengths to the plan of its run, or take its missing frames "
            "(`brdfpipe rig scan … --resume`)"
        )


def _profile_expiry(profile: xr.Dataset, day: date, lamp_hours: float) -> Iterator[str]:
    """Reasons not to use a profile on a day."""
    attrs, made = profile.attrs, date.fromisoformat(profile.attrs["day"])
    age, lamp_run = (day - made).days, lamp_hours - float(attrs["lamp_hours"])
    if age > int(attrs["valid_days"]):
        yield f"the profile of {made} has expired: it is {age} days old and valid for {attrs['valid_days']} days"
    if age < 0:
        yield f"the profile is of {made}, after the sample was measured ({day})"
    if lamp_run > float(attrs["valid_hours"]):
        yield (
            f"the profile of {made} has expired: the lamp has run {lamp_run:g} h since, and the profile is valid for {attrs['valid_hours']:g} h"
        )
    if lamp_run < 0:
        yield f"the lamp was changed since the profile of {made}: its hour counter is {-lamp_run:g} h lower"
    if day > date.fromisoformat(attrs["certificate_valid_until"]):
        yield f"the etalon's certificate {attrs['certificate']} was valid until {attrs['certificate_valid_until']}"
    if attrs.get("drift_violation"):
        yield str(attrs["drift_violation"])


def _lamp_change(reduced: xr.Dataset, profile: xr.Dataset) -> Iterator[str]:
    """Whether the reference light has another spectrum: the lamp was changed, or wavelengths are mislabelled."""
    with np.errstate(divide="ignore", invalid="ignore"):
        log_ratio = np.log(reduced["reference"].values / profile["lamp"].values)
    change = np.abs(log_ratio - finite_median(log_ratio, axis=-1)[..., None])
    if np.isfinite(change).any() and (largest := float(np.nanmax(change))) > LAMP_TOLERANCE:
        wavelength = float(reduced["wavelength"].values[int(np.nanargmax(np.fmax.reduce(change, axis=0)))])
        yield (
            f"the lamp's spectrum differs from that of the etalon's run by {np.expm1(largest):.0%} at {wavelength:g} nm: the wavelengths of one "
            "run are mislabelled or in another order, or the lamp was changed"
        )


def _hidden_cells(reduced: xr.Dataset, profile: xr.Dataset) -> NDArray[np.bool_]:
    """Cells (incidence, cell) that the entrance in use hides; none in transmission, where light comes from behind the sample."""
    incidences = reduced["incidence"].values
    towards_entrance = specular_directions.cos_view_etalon(
        incidences[:, None], reduced["theta_s"].values, reduced["phi_s"].values
    )
    hidden = towards_entrance > np.cos(np.radians(ENTRANCE_EXCLUSION_RADIUS))
    for entrance, observed in zip(profile["incidence"].values, profile["hidden"].values, strict=True):
        hidden[incidences == entrance] = observed
    return hidden & (reduced.attrs["side"] == "reflection")


def _stray_light(projected: Array, u: Array, cosine: Array) -> tuple[Array, Array]:
    """Stray light, BRDF times cosine of view (incidence,), from the cells below the sample's horizon, and its standard uncertainty.

    Walls and mirrors scatter it everywhere; glare that was removed insufficiently or too much adds to it. An incidence with few such cells
    takes the mean of the others, with an uncertainty as large as that mean. Without any it is 0.
    """
    dark = (cosine < _BELOW_HORIZON)[:, None] & np.isfinite(projected) & (u > 0)
    weight = np.where(dark, 1 / np.where(dark, u, 1.0) ** 2, 0.0)
    total, count = weight.sum(axis=(1, 2)), dark.any(axis=1).sum(axis=1)
    mean = (weight * np.nan_to_num(projected)).sum(axis=(1, 2)) / np.where(total > 0, total, 1.0)
    squares = (weight * np.nan_to_num(projected - mean[:, None, None]) ** 2).sum(axis=(1, 2))
    scatter = squares / np.maximum(dark.sum(axis=(1, 2)) - 1, 1)
    known = count >= _FEWEST_BELOW_HORIZON
    if not known.any():
        return np.zeros(count.size), np.zeros(count.size)
    error = np.sqrt(np.maximum(scatter, 1.0) / np.where(total > 0, total, 1.0))
    mean_of_known = float(mean[known].mean())
    return np.where(known, mean, mean_of_known), np.where(known, error, np.hypot(error[known].mean(), mean_of_known))


def _uncertainty_components(
    reduced: xr.Dataset, profile: xr.Dataset, scale: Array, projected: Array
) -> dict[str, Array]:
    """Components of the uncertainty of BRDF times cosine, of the frames and of the profile."""
    prefix = "signal_u_"
    names = [name.removeprefix(prefix) for name in map(str, reduced.data_vars) if name.startswith(prefix)]
    parts = {name: np.abs(scale) * reduced[prefix + name].values for name in names}
    for name in (*COMMON, "calibration", "certificate", "etalon"):
        if f"cell_scale_u_{name}" not in profile:  # a profile of an earlier version, whose shape is in ``certificate``
            continue
        relative = (profile[f"cell_scale_u_{name}"] / profile["cell_scale"]).values
        parts[name] = np.hypot(parts.get(name, 0.0), np.abs(projected) * relative)
    if reduced.attrs["filter"] != profile.attrs["filter"]:  # the same one would divide out
        filter_u = np.hypot(reduced.attrs["filter_u"], profile.attrs["filter_u"])
        parts["nd"] = np.hypot(parts["nd"], np.abs(projected) * filter_u)
    return parts


def _primary_dataset(
    reduced: xr.Dataset, profile: xr.Dataset, brdf: Array, parts: dict[str, Array], cosine: Array
) -> xr.Dataset:
    quality = reduced["signal_quality"].values.copy()
    explained = np.isin(quality, [vocabulary.quality(name) for name in ("saturated", "missing")])
    quality[np.isnan(brdf) & ~explained] = vocabulary.quality("vignetted")
    quality[np.broadcast_to((cosine <= HORIZON)[:, None], quality.shape)] = vocabulary.quality("shadowed")
    total = np.sqrt(np.sum([part**2 for part in parts.values()], axis=0))
    dims = ("incidence", "wavelength", "cell")
    variables: dict[str, Any] = {"brdf": (dims, brdf), "brdf_u": (dims, total), "brdf_quality": (dims, quality)}
    variables |= {
        f"brdf_u_{name}": (dims, part, {"correlation": BY_NAME[name].correlation}) for name, part in parts.items()
    }
    attrs = {name: reduced.attrs[name] for name in ("rig", "rig_digest", "sample", "day", "side", "disc_scale_u")}
    attrs |= {"certificate": profile.attrs["certificate"], "calibrated": profile.attrs["day"]}
    return xr.Dataset(variables, coords=reduced.coords, attrs=attrs)
