"""The calibration profile of a rig, from runs of an etalon with a certificate.

f = s L/(L′/T), s = (f_st cos ϑ_st / cos γ) / (L_st/(L′_st/T_st)) (Voloboy et al., Keldysh Institute preprint 2005, with the misprinted bracket
of s corrected). The transmittance of a cell's optical path divides out.
"""

from __future__ import annotations

from collections.abc import Iterator
from datetime import date
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import specular_directions, vocabulary
from brdfpipe.geometry import Array, unit_vector
from brdfpipe.rig.reduction import etalon_change
from brdfpipe.rig.reduction.arrangements import CalibrationError, finite_median
from brdfpipe.rig.reduction.certificate import Certificate
from brdfpipe.rig.reduction.control_chart import chart_points

GRAZING = 0.1
"""Cosine of the etalon's viewing angle below which a cell cannot be calibrated."""

DEAD = 0.02
"""A cell is dead if the etalon gives it less than this share of the median signal of its kind."""

PATH_U = 0.05
"""Relative standard uncertainty of the light of an entrance (at all wavelengths or at one) without an etalon measurement."""

COMMON = ("repeat", "reference", "nd", "glare")
"""Uncertainty components of the etalon that all cells share. Noise and geometry are independent and become ``calibration``."""

SUSPICIOUS_ZEROS = 0.005
"""Share of exact zeros among lit cells above which missing values must have been stored as 0."""

_HIDDEN_SIGMA, _HIDDEN_LEAST = 5.0, 0.03
"""A cell is partly hidden from an entrance if it lacks this many standard uncertainties of light, and at least this share of it."""
_ADJACENT = 1.5  # largest distance of the centres of adjacent disc cells over their width: corner to corner


class _EntranceScales(NamedTuple):
    """The scale of each cell through several entrances of the etalon; the first axis counts entrances."""

    scale: Array  # (entrance, wavelength, cell) BRDF times cos ϑ_st over the signal; missing where there is no light
    independent_u: Array  # (entrance, wavelength, cell) relative uncertainty that is independent from cell to cell
    common_u: dict[str, Array]  # relative uncertainties common to all cells, by component
    shape_u: Array  # (entrance, cell) relative uncertainty of the certified angular shape, and of the angle itself
    facing: NDArray[np.bool_]  # (entrance, cell) whether the cell faces the etalon


class _EntrancePaths(NamedTuple):
    """How the entrances differ."""

    light: Array  # (entrance, wavelength) light over that of the first entrance
    u: Array  # its relative standard uncertainty
    hidden: NDArray[np.bool_]  # (entrance, cell) whether something, usually the entrance itself, blocks the cell's view


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

    The etalon is lit at normal incidence through one or more entrances. Cells that several entrances share give the relative light of the
    entrances. A cell that one entrance hides may be calibrated through another, and all entrances together have less noise.

    Parameters
    ----------
    etalon : kind ``reduced``, load ``etalon``; its incidences are the entrances the etalon was lit through
    certificate : of the etalon
    name : of the profile in control charts; by default its day
    lamp_hours : hours the lamp had run by then
    valid_days, valid_hours : how long the profile may be used, in calendar days and in lamp hours
    override : use an expired certificate; recorded in the dataset

    Returns
    -------
    Dataset of kind ``calibration``: ``cell_scale(wavelength, cell)``, BRDF times cosine of view over the signal, as through the first
    entrance; ``path(incidence, wavelength)``, the light of each entrance over that of the first; ``hidden(incidence, cell)``;
    ``etalon_change(incidence, wavelength)``, the logarithm of the etalon's light after the sample over that before, if both were measured; and a control
    chart of one point, which :func:`brdfpipe.rig.reduction.control_chart.extend_chart` appends to an earlier chart.

    Raises
    ------
    CalibrationError : the frames do not show the etalon, or the certificate has expired.
    CertificateError : the certificate does not cover the wavelengths.
    """
    vocabulary.validate(etalon, "reduced")
    if etalon.attrs["load"] != "etalon":
        raise CalibrationError(
            f"the frames are of the {etalon.attrs['load']}; a calibration profile needs frames of the etalon"
        )
    day = str(etalon.attrs["day"])
    doubts = []
    if date.fromisoformat(day) > certificate.valid_until:
        doubts.append(
            f"the certificate {certificate.identity} was valid until {certificate.valid_until}, the etalon was measured on {day}"
        )
    if doubts and not override:
        accept = "or accept it with `override: true`, which the results record"
        raise CalibrationError(f"{doubts[0]}; have the etalon calibrated again, {accept}")
    lamp = finite_median(etalon["reference"].values, axis=0)
    if not np.isfinite(lamp).any():
        raise CalibrationError("no frame of the etalon shows the reference spot; measure it again")
    etalon = etalon.isel(wavelength=np.isfinite(lamp))
    scales = _entrance_scales(etalon, certificate)
    # A cell without light at all wavelengths is dead, and its zeros are genuine.
    refuse_zeros(etalon, np.asarray(np.isfinite(scales.scale).any(axis=1)))
    paths = _entrance_paths(scales, _adjacent_cells(etalon))
    wavelength = etalon["wavelength"].values
    profile = xr.Dataset(
        _mean_cell_scales(scales, paths, certificate.brdf(wavelength, np.zeros(1))[1])
        | {
            "path": (("incidence", "wavelength"), paths.light),
            "path_u": (("incidence", "wavelength"), paths.light * paths.u),
            "hidden": (("incidence", "cell"), paths.hidden, {"units": "1", "long_name": "hidden from the entrance"}),
            "lamp": ("wavelength", lamp[np.isfinite(lamp)]),
            **etalon_change.of_profile(etalon),
        },
        coords=etalon.coords,
        attrs={
            "certificate": certificate.identity,
            "certificate_valid_until": certificate.valid_until.isoformat(),
            "lamp_hours": float(lamp_hours),
            "valid_days": int(valid_days),
            "valid_hours": float(valid_hours),
            **{name: etalon.attrs[name] for name in ("day", "rig", "rig_digest", "filter", "filter_u")},
        },
    )
    profile = profile.assign(chart_points([name or day], [day], np.zeros((1, wavelength.size)), wavelength))
    profile = vocabulary.add_warning(profile, *_uncertified_angles(certificate, etalon, profile))
    return finish(profile, "calibration", etalon, doubts)


def refuse_zeros(reduced: xr.Dataset, lit: NDArray[np.bool_]) -> None:
    """Refuse missing values that were stored as zeros, in the lit cells (incidence, cell)."""
    zeros = np.broadcast_to(lit[:, None], reduced["signal"].shape) & (reduced["signal"].values == 0)
    share = float(zeros.sum() / max(lit.sum() * reduced.sizes["wavelength"], 1))
    if share > SUSPICIOUS_ZEROS:
        raise CalibrationError(
            f"{share:.1%} of the signals are exactly 0, which no measurement gives: missing values were stored as 0; store NaN instead; accepted: at most {SUSPICIOUS_ZEROS:.1%}"
        )


def finish(dataset: xr.Dataset, kind: str, source: xr.Dataset, doubts: list[str]) -> xr.Dataset:
    """A dataset of a kind with the warnings of its source, and the doubts that were overridden."""
    if doubts:
        dataset = dataset.assign_attrs(overridden="; ".join(doubts))
    warnings = [*vocabulary.warnings(source), *(f"{doubt}; used nevertheless" for doubt in doubts)]
    return vocabulary.validate(vocabulary.label(vocabulary.add_warning(dataset, *warnings), kind), kind)


def _uncertified_angles(certificate: Certificate, etalon: xr.Dataset, profile: xr.Dataset) -> Iterator[str]:
    """A warning of cells that see the etalon, through every entrance, at angles beyond the certificate's."""
    smallest = _etalon_angle(etalon).min(axis=0)
    calibrated = np.isfinite(profile["cell_scale"].values).any(axis=0)
    last = certificate.theta[-1]
    beyond = smallest[calibrated & (smallest > last)]
    if beyond.size:
        where = f"beyond {last:g}°" if last > 0 else "at any angle but 0°"
        yield (
            f"The certificate {certificate.identity} states no angular shape of the etalon's BRDF {where}, where {beyond.size} of "
            f"{calibrated.sum()} cells see it. The last stated value is used. Its standard uncertainty grows from "
            f"{certificate.shape_u_at(certificate.theta[-1:])[0]:.1%} to {certificate.shape_u_at(beyond).max():.1%}, as diffuse standards differ. "
            "Have the etalon measured there, and state `angles` in certificate.yaml."
        )


def _entrance_scales(etalon: xr.Dataset, certificate: Certificate) -> _EntranceScales:
    theta = _etalon_angle(etalon)
    cosine = np.cos(np.radians(theta))
    facing = cosine > GRAZING
    brdf = np.stack([certificate.brdf(etalon["wavelength"].values, angles)[0] for angles in theta])
    signal = np.where(facing[:, None], etalon["signal"].values, np.nan)
    signal = np.where(_lit(signal, etalon["kind"].values)[:, None] & (signal > 0), signal, np.nan)
    relative = {name: etalon[f"signal_u_{name}"].values / signal for name in (*COMMON, "noise", "geometry")}
    return _EntranceScales(
        brdf * cosine[:, None] / signal,
        np.hypot(relative["noise"], relative["geometry"]),
        {name: relative[name] for name in COMMON},
        np.stack([np.hypot(certificate.shape_u_at(angles), certificate.tilt_error(angles)) for angles in theta]),
        facing,
    )


def _etalon_angle(etalon: xr.Dataset) -> Array:
    """Viewing angle from the etalon's normal [degree], (entrance, cell); 90 for cells behind the etalon."""
    incidence = etalon["incidence"].values[:, None]
    cosine = specular_directions.cos_view_etalon(incidence, etalon["theta_s"].values, etalon["phi_s"].values)
    return np.asarray(np.degrees(np.arccos(np.clip(cosine, 0.0, 1.0))))


def _lit(signal: Array, kinds: Array) -> NDArray[np.bool_]:
    """Whether a cell is lit, not dead, (entrance, cell)."""
    lit = np.zeros((signal.shape[0], signal.shape[2]), dtype=bool)
    for kind in np.unique(kinds):
        of_kind = np.where(kinds == kind, signal, np.nan)
        share = of_kind / finite_median(of_kind, axis=2)[..., None]
        lit |= finite_median(share, axis=1) > DEAD
    return lit


def _entrance_paths(scales: _EntranceScales, adjacent: NDArray[np.bool_]) -> _EntrancePaths:
    """How much light each entrance sends, from the cells it shares with the first, and which cells it hides.

    Each wavelength is evaluated by itself: hundreds of cells give its mean more accurately than needed. A partly hidden cell has less light
    than through other entrances, so its scale is too large; it is left out, with the adjacent cells, which may be hidden in part.
    """
    lit = np.isfinite(scales.scale).any(axis=1)
    # Without light through one entrance but not through another: hidden, not dead.
    hidden = scales.facing & ~lit & lit.any(axis=0)
    log_ratio = np.log(scales.scale[0] / scales.scale)
    as_first = np.log(scales.scale) + finite_median(log_ratio, axis=2)[..., None]
    excess = as_first - np.fmin.reduce(as_first, axis=0)
    hidden |= finite_median(excess - np.maximum(_HIDDEN_SIGMA * scales.independent_u, _HIDDEN_LEAST), axis=1) > 0
    hidden = hidden @ adjacent
    log_ratio = np.where((hidden | hidden[0])[:, None], np.nan, log_ratio)
    weight = np.nan_to_num(1 / (scales.independent_u[0] ** 2 + scales.independent_u**2)) * np.isfinite(log_ratio)
    total, count = np.maximum(weight.sum(axis=2), 1e-300), np.isfinite(log_ratio).sum(axis=2)
    mean = (weight * np.nan_to_num(log_ratio)).sum(axis=2) / total
    scatter = (weight * np.nan_to_num(log_ratio - mean[..., None]) ** 2).sum(axis=2)
    standard_error = np.sqrt(np.maximum(scatter / np.maximum(count - 1, 1), 1.0) / total)
    # Cells see the etalon at different angles through different entrances: an error of its angular shape looks like more light.
    shape_error = np.abs((weight * (scales.shape_u[0] - scales.shape_u)[:, None]).sum(axis=2)) / total
    u = np.where(count > 0, np.hypot(standard_error, shape_error), PATH_U)
    u[0] = 0.0
    return _EntrancePaths(np.exp(_fill_spectra(mean, count > 0)), u, hidden)


def _fill_spectra(values: Array, known: NDArray[np.bool_]) -> Array:
    """Values (entrance, wavelength) with unknown ones interpolated from the neighbouring wavelengths; 0 where none is known."""
    filled, index = np.zeros_like(values), np.arange(values.shape[1])
    for at in np.flatnonzero(known.any(axis=1)):
        filled[at] = np.interp(index, index[known[at]], values[at, known[at]])
    return filled


def _adjacent_cells(reduced: xr.Dataset) -> NDArray[np.bool_]:
    """(cell, cell) whether cells of the disc are adjacent, or one cell; fibres have no neighbours."""
    direction = unit_vector(reduced["theta_s"].values, reduced["phi_s"].values)
    width = np.sqrt(np.nan_to_num(reduced["solid_angle"].values))
    distance = np.linalg.norm(direction[:, None] - direction, axis=-1)
    near = distance < _ADJACENT * (width[:, None] + width) / 2
    return near & (width > 0) & (width[:, None] > 0) | np.eye(width.size, dtype=bool)


def _mean_cell_scales(scales: _EntranceScales, paths: _EntrancePaths, certificate_u: Array) -> dict[str, Any]:
    """The scale of each cell as through the first entrance, the weighted mean of the entrances, and its uncertainties."""
    scale = np.where(paths.hidden[:, None], np.nan, scales.scale * paths.light[..., None])
    weight = np.nan_to_num(1 / scales.independent_u**2) * np.isfinite(scale)
    total = weight.sum(axis=0)
    calibrated = total > 0
    share = weight / np.where(calibrated, total, 1.0)
    mean = np.where(calibrated, (share * np.nan_to_num(scale)).sum(axis=0), np.nan)
    # Common errors may be the same for all entrances: they add linearly.
    relative = {name: (share * np.nan_to_num(u)).sum(axis=0) for name, u in scales.common_u.items()}
    relative["reference"] = np.hypot(relative["reference"], (share * paths.u[..., None]).sum(axis=0))
    relative["calibration"] = 1 / np.sqrt(np.where(calibrated, total, np.inf))
    # Level and shape of the etalon's BRDF, the same at every incidence.
    relative["certificate"] = np.broadcast_to(certificate_u[:, None], mean.shape)
    relative["etalon"] = (share * scales.shape_u[:, None]).sum(axis=0)
    dims = ("wavelength", "cell")
    correlation = dict.fromkeys(relative, "common") | {"calibration": "independent"}
    return {"cell_scale": (dims, mean)} | {
        f"cell_scale_u_{name}": (dims, mean * u, {"correlation": correlation[name]}) for name, u in relative.items()
    }
