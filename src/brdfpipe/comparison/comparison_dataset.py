"""The dataset of kind ``comparison``: measured and modelled values, their ratio and z, and the fitted inputs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from brdfpipe.bsdf.measured.basis import solid_angles
from brdfpipe.comparison.adjustment import Adjusted
from brdfpipe.comparison.measurement import DIMS, Measurement
from brdfpipe.comparison.prediction import NOMINAL, Predicted, PredictionAt, PredictionModel
from brdfpipe.geometry import Array

_PICTURES = ("incidence", "wavelength")


def compared(
    measurement: Measurement, models: Mapping[str, Predicted], fit: Adjusted[PredictionAt] | None
) -> xr.Dataset:
    """Measured values beside those of models, and their agreement."""
    best = list(models.values())[-1]
    covariance = measurement.covariance(best.values, best.own_u, best.common) if fit is None else fit.covariance
    count, fitted = int(measurement.used.sum()), 0 if fit is None else fit.change.size
    chi_squared = {name: covariance.chi_squared(measurement.value - model.values) for name, model in models.items()}
    freedom = {name: max(count - (0 if name == "predicted" else fitted), 1) for name in models}
    comparison = xr.Dataset(
        _measured(measurement) | _modelled(measurement, [*models.values()]),
        coords={
            "model": [*models],
            "incidence": measurement.incidence,
            "wavelength": measurement.wavelength,
            "theta_s": ("cell", measurement.theta_s),
            "phi_s": ("cell", measurement.phi_s),
        },
        attrs={"values": count, "enlarged": 1.0 if fit is None else fit.enlarged},
    ).assign(chi_squared_dof=("model", [chi_squared[name] / freedom[name] for name in models]))
    return comparison if fit is None else comparison.assign_attrs(converged=int(fit.converged))


def _measured(measurement: Measurement) -> dict[str, Any]:
    own, common = (measurement.correlated(among_cells=shared) for shared in (False, True))
    fields = {"brdf": measurement.value, "brdf_u": measurement.u, "brdf_u_independent": own, "brdf_u_common": common}
    attrs = {f"brdf_u_{correlation}": {"correlation": correlation} for correlation in ("independent", "common")}
    variables = {
        name: (DIMS, np.where(measurement.used, field, np.nan), attrs.get(name, {})) for name, field in fields.items()
    }
    weight = _weight(measurement)
    return variables | {
        "seen_reflectance": (_PICTURES, (weight * measurement.value).sum(axis=-1)),
        "seen_reflectance_u": (_PICTURES, measurement.sum_u(weight)),
    }


def _modelled(measurement: Measurement, models: Sequence[Predicted]) -> dict[str, Any]:
    values, u = (np.array([getattr(model, name) for model in models]) for name in ("values", "u"))
    comparable = measurement.used & (values > 0)
    missing = np.full_like(values, np.nan)
    ratio = np.divide(measurement.value, values, out=missing.copy(), where=comparable)
    both_u, used = np.hypot(measurement.u, u), np.broadcast_to(measurement.used, values.shape)
    z = np.divide(measurement.value - values, both_u, out=missing.copy(), where=used)
    along = ("model", *DIMS)
    return {
        "brdf_model": (along, values),
        "brdf_model_u": (along, u),
        "ratio": (along, ratio),
        "z": (along, z),
        "median_ratio": (("model", "incidence"), _by_incidence(np.nanmedian, ratio)),
        "rms_z": (("model", "incidence"), np.sqrt(_by_incidence(np.nanmean, z**2))),
        "seen_reflectance_model": (("model", *_PICTURES), (_weight(measurement) * values).sum(axis=-1)),
    }


def _weight(measurement: Measurement) -> Array:
    """Projected solid angle of each value used [sr]."""
    solid_angle = solid_angles(measurement.theta_s, measurement.phi_s) * measurement.cosine
    return np.where(measurement.used, solid_angle[:, None], 0.0)


def _by_incidence(statistic: Callable[..., Array], fields: Array) -> Array:
    """A statistic of each incidence, (model, incidence); missing where nothing was measured."""
    flat = fields.reshape(*fields.shape[:2], -1)
    known = np.asarray(np.isfinite(flat).any(axis=-1))
    return np.where(known, statistic(np.where(known[..., None], flat, 0.0), axis=-1), np.nan)


def with_inputs(comparison: xr.Dataset, model: PredictionModel, fit: Adjusted[PredictionAt]) -> xr.Dataset:
    """A comparison with the prior and posterior inputs."""
    names = [*model.prior_u]
    prior, after = (np.array([inputs[name] for name in names]) for inputs in (NOMINAL, model.inputs(fit.change)))
    u, spread = np.array([*model.prior_u.values()]), np.sqrt(np.diag(fit.spread))
    factor = np.where(np.array(names) == "index", 1.0, after)
    return comparison.assign(
        prior=("input", prior),
        prior_u=("input", u),
        posterior=("input", after),
        posterior_u=("input", factor * u * spread),
        correlation=(("input", "input_2"), fit.spread / np.outer(spread, spread)),
    ).assign_coords(input=names, input_2=names)
