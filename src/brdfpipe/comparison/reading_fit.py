"""The doubtful inputs of a prediction with which it would agree with readings of instruments. Nothing applies them: they say where to look.

``index``    the refractive index, with the same shift at all wavelengths: n + Δ
``slope``    the slopes of all facets, and with waves all heights, times a factor: a scan smooths, or is noisy
``diffuse``  the diffuse reflectance below the facets, times a factor
``finer``    the mean square height of roughness finer than the scan [um²], which takes 1 − e^(−g), g = (4πσ cos θ/λ)², out of the lobe and scatters it so
             far that no receptor of gloss or haze sees it (Davies 1954)
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import xarray as xr
from scipy.optimize import least_squares

from brdfpipe import vocabulary
from brdfpipe.bsdf.input_uncertainty import MIDDLE_WAVELENGTH
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.representations.microfacet import Microfacet
from brdfpipe.bsdf.representations.wave import Wave
from brdfpipe.bsdf.wave.two_scale import FACETS_ALONE
from brdfpipe.comparison import findings
from brdfpipe.comparison.measured_predicted import PRIOR_U
from brdfpipe.comparison.prediction import NOMINAL, PredictionInputs
from brdfpipe.comparison.readings import WARN_ABOVE, Reading, predicted_values, readings_of
from brdfpipe.comparison.wave_prediction import WavePredictionInputs
from brdfpipe.geometry import Array

FINER_U = 0.03**2
"""Standard uncertainty of the mean square height of roughness finer than the scan [um²]: that of 30 nm."""

INPUTS = ("index", "slope", "diffuse", "finer")

_SAME = 1e-2
"""Relative difference between a prediction and the same one rebuilt from its inputs, above which it is not fitted."""

_FACET_INCIDENCES = np.array([20.0, 60.0])
"""Incidences at which facets must reflect the light, if the BSDF knows waves [degree]."""

_STEP = 0.05
"""Of an input for a derivative, in prior standard uncertainties."""

_SAME_SLOPES = 0.3
"""Change of the inputs for which derivatives count as the same, in prior standard uncertainties."""

_LONGEST = 10.0
"""Largest change of an input, in prior standard uncertainties."""


@dataclass(frozen=True)
class _Model:
    """The readings as a function of the inputs."""

    given: PredictionInputs | WavePredictionInputs
    readings: Sequence[Reading]
    prior_u: Mapping[str, float]
    base: Array
    """Values of the BSDF that was compared."""
    _known: dict[tuple[float, ...], tuple[Array, Array]] = field(default_factory=dict, init=False, repr=False)

    def inputs(self, change: Array) -> dict[str, float]:
        """Inputs after changes in prior standard uncertainties; factors change exponentially, so that none becomes negative."""
        by = {name: float(one) * self.prior_u[name] for name, one in zip(self.prior_u, change, strict=True)}
        factors = {name: math.exp(by.get(name, 0.0)) for name in ("slope", "diffuse")}
        return {"index": by.get("index", 0.0), "finer": by.get("finer", 0.0)} | factors

    def __call__(self, change: Array) -> Array:
        """Values of the readings."""
        inputs = self.inputs(change)
        after, surface = self._rebuilt(tuple(inputs[name] for name in NOMINAL))
        before, _ = self._rebuilt(tuple(NOMINAL.values()))
        loss = -np.expm1(-inputs["finer"] * self._phase_per_variance)
        after = after - loss * surface
        # What waves add to facets stays: a share of gloss and haze, a difference of a colour.
        of_gloss = np.array([one.unit == "GU" for one in self.readings])
        ratio = np.divide(after, before, out=np.ones_like(after), where=before != 0)
        return np.where(of_gloss, self.base * ratio, self.base + after - before)

    def _rebuilt(self, inputs: tuple[float, ...]) -> tuple[Array, Array]:
        """Values of the BSDF with other inputs, and the part of gloss and haze that its surface reflects."""
        if inputs not in self._known:
            bsdf = self.given.bsdf(dict(zip(NOMINAL, inputs, strict=True)))
            bare = representation(bsdf).without_diffuse()
            glossy = [one for one in self.readings if one.unit == "GU"]
            surface = np.zeros(len(self.readings))
            if glossy and bare is not None:
                surface[[one.unit == "GU" for one in self.readings]] = predicted_values(bare, glossy)
            self._known[inputs] = predicted_values(bsdf, self.readings), surface
        return self._known[inputs]

    @property
    def _phase_per_variance(self) -> Array:
        """g over the mean square height [um-2] at the incidence of each reading."""
        incidence = np.array([float(one.at.get("gloss_angle", 20.0)) for one in self.readings])
        return np.asarray((4 * np.pi * np.cos(np.radians(incidence)) / MIDDLE_WAVELENGTH) ** 2)


def with_fit(
    readings: xr.Dataset,
    measured: Mapping[str, object],
    bsdf: xr.Dataset,
    *,
    predicted: xr.Dataset | None = None,
    facets: xr.Dataset | None = None,
    psd: xr.Dataset | None = None,
    index: xr.Dataset | None = None,
    spectrum: xr.Dataset | None = None,
    index_u: float = PRIOR_U["index"],
    slope_u: float = PRIOR_U["slope"],
    diffuse_u: float = PRIOR_U["diffuse"],
) -> xr.Dataset:
    """Readings with the inputs of the prediction that agree with them, where they disagree.

    Parameters
    ----------
    readings : kind ``readings``, of :func:`brdfpipe.comparison.readings.compare_readings`
    measured : the key of that name
    bsdf : kind ``bsdf`` that they were compared with
    predicted, facets, index, spectrum : the BSDF of facets and what it was built from; None without a prediction from facets
    psd : the roughness spectrum, of a BSDF in which waves reflect light
    index_u, slope_u, diffuse_u : standard uncertainty of the inputs before the readings, absolute of the index, relative of the others; the uncertainty
        that the index states comes first; an input with an uncertainty of 0 is not changed

    Returns
    -------
    The same with ``prior`` and ``posterior`` of each ``input`` and their ``correlation``, ``z_adjusted`` of each reading with these inputs, and the
    attribute ``findings``, sentences in JSON. Where nothing is fitted, one sentence says why

    Notes
    -----
    Least squares with the prior (JCGM 100:2008). The uncertainties of readings and predictions count as independent of each other, so that those of inputs
    that are fitted count twice where the prediction states them: the posterior is a little too wide. ``finer`` is 0 or more.
    """
    reason = _not_fitted(readings, bsdf, predicted, facets, psd, index)
    if reason:
        return readings.assign_attrs(findings=json.dumps([reason], ensure_ascii=False))
    assert predicted is not None
    assert facets is not None
    assert index is not None
    known = np.isfinite(readings["z"].values)
    used = [one for one, is_known in zip(readings_of(measured), known, strict=True) if is_known]
    prior_u = {"index": index_u, "slope": slope_u, "diffuse": diffuse_u, "finer": FINER_U}
    if "n_u" in index:
        prior_u["index"] = float(index["n_u"].mean())
    if not predicted["diffuse"].values.any():
        del prior_u["diffuse"]
    if not any(one.unit == "GU" for one in used):
        del prior_u["finer"]
    prior_u = {name: u for name, u in prior_u.items() if u > 0}
    base = readings["predicted_value"].values[known]
    of_facets = PredictionInputs.of(predicted, facets, index, spectrum)
    if _reflects_as_facets(bsdf):
        model, direct = _Model(of_facets, used, prior_u, base), predicted_values(predicted, used)
    else:
        assert psd is not None
        by_waves = WavePredictionInputs.of(bsdf, of_facets, psd)
        model, direct = _Model(by_waves, used, prior_u, base), predicted_values(bsdf, used)
    nominal, _ = model._rebuilt(tuple(NOMINAL.values()))
    if np.abs(nominal - direct).max() > _SAME * np.abs(direct).max():
        other = "The readings were not fitted: the prediction cannot be built anew from facets, index and spectrum."
        return readings.assign_attrs(findings=json.dumps([other], ensure_ascii=False))
    value, u, of_prediction = (readings[name].values[known] for name in ("read_value", "read_u", "predicted_u"))
    total_u = np.hypot(u, np.nan_to_num(of_prediction))
    return _with_result(readings, known, model, predicted, _minimise(model, value, total_u), value, total_u)


def _not_fitted(
    readings: xr.Dataset,
    bsdf: xr.Dataset,
    predicted: xr.Dataset | None,
    facets: xr.Dataset | None,
    psd: xr.Dataset | None,
    index: xr.Dataset | None,
) -> str:
    """Why nothing is fitted; empty where it is."""
    z = np.abs(readings["z"].values)
    if not (np.isfinite(z).any() and np.nanmax(z) > WARN_ABOVE):
        return "The readings ask for no change of the inputs of the prediction."
    because = "the inputs of a prediction are fitted for opaque bodies with facets alone"
    if json.loads(readings.attrs["fitted"]):
        because = "the slopes are already those that have this gloss; what is left is an error of readings, index or colour, or of the form of the slopes"
    elif bsdf.attrs.get("route", "predicted") == "predicted" and predicted is not None and facets is not None:
        evaluator = representation(bsdf)
        if isinstance(evaluator, Wave):
            if psd is None and not _reflects_as_facets(bsdf):
                because = "waves reflect the light of gloss, and there is no roughness spectrum"
            elif index is not None:
                because = ""
        elif isinstance(evaluator, Microfacet) and index is not None:
            because = ""
        if not isinstance(representation(predicted), Microfacet):
            because = "the surface is perfectly flat"
    return f"The readings were not fitted: {because}." if because else ""


def _reflects_as_facets(bsdf: xr.Dataset) -> bool:
    """Whether facets alone reflect the light of gloss."""
    evaluator = representation(bsdf)
    if not isinstance(evaluator, Wave):
        return True
    _, share = evaluator.regime(_FACET_INCIDENCES, bsdf["wavelength"].values)
    return bool(share.min() >= FACETS_ALONE)


def _minimise(model: _Model, value: Array, u: Array) -> tuple[Array, Array]:
    """Changes in prior standard uncertainties, and their covariance."""

    def residual(change: Array) -> Array:
        return np.concatenate([(model(change) - value) / u, change])

    names = list(model.prior_u)
    low = np.array([0.0 if name == "finer" else -_LONGEST for name in names])
    # At a bound the derivative is one-sided, and the fit starts inside.
    start = np.where(low == 0, 0.1, 0.0)
    found = least_squares(
        residual,
        start,
        jac=_derivatives(residual),
        bounds=(low, np.full(len(names), _LONGEST)),
        xtol=1e-3,
        ftol=1e-3,
        max_nfev=12,
    )
    jacobian = np.asarray(found.jac)
    covariance = np.linalg.inv(jacobian.T @ jacobian)
    return np.asarray(found.x), np.asarray(covariance)


def _derivatives(residual: Callable[[Array], Array]) -> Callable[[Array], Array]:
    """Forward differences with a step larger than the noise of a quadrature, kept while the inputs hardly change: each takes a BSDF."""
    known: list[tuple[Array, Array]] = []

    def jacobian(change: Array) -> Array:
        if not known or np.abs(change - known[-1][0]).max() > _SAME_SLOPES:
            at = residual(change)
            slopes = np.array([(residual(change + _STEP * one) - at) / _STEP for one in np.eye(change.size)]).T
            known.append((change.copy(), slopes))
        return known[-1][1]

    return jacobian


def _with_result(
    readings: xr.Dataset,
    known: Array,
    model: _Model,
    predicted: xr.Dataset,
    fit: tuple[Array, Array],
    value: Array,
    u: Array,
) -> xr.Dataset:
    change, covariance = fit
    names, deviation = list(model.prior_u), np.sqrt(np.diag(covariance))
    after = model.inputs(change)
    posterior = np.array([after[name] for name in names])
    # Of a factor e^(u·x) the uncertainty is relative.
    scale = np.array([model.prior_u[name] * (after[name] if name in ("slope", "diffuse") else 1.0) for name in names])
    z = np.full(known.size, np.nan)
    z[known] = (value - model(change)) / u
    freedom = max(int(known.sum()) - len(names), 1)
    result = readings.assign(
        z_adjusted=("reading", z),
        prior=("input", [{"slope": 1.0, "diffuse": 1.0}.get(name, 0.0) for name in names]),
        prior_u=("input", [model.prior_u[name] for name in names]),
        posterior=("input", posterior),
        posterior_u=("input", deviation * scale),
        correlation=(("input", "input_2"), covariance / np.outer(deviation, deviation)),
    ).assign_coords(input=names, input_2=names)
    sentences = [*_agreement(readings["z"].values, z, freedom), *findings.input_findings(result, predicted)]
    return vocabulary.label(result.assign_attrs(findings=json.dumps(sentences, ensure_ascii=False)), "readings")


def _agreement(before: Array, after: Array, freedom: int) -> Iterator[str]:
    worst = float(np.nanmax(np.abs(after)))
    explained = worst <= WARN_ABOVE
    yield (
        f"with the inputs below the furthest reading is {worst:.2g} instead of {float(np.nanmax(np.abs(before))):.2g} standard uncertainties off: "
        + (
            "they would explain the readings"
            if explained
            else "they do not explain the readings; the form of the model, or a reading, is wrong"
        )
    )
