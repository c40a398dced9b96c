"""The measured BRDF beside the one predicted from the surface, and the inputs with which both agree.

Uncertain inputs are the refractive index, the slopes of the facets (a scan smooths, or is noisy), and the diffuse reflectance. They are fitted
with their prior uncertainties (:mod:`.adjustment`). A remaining misfit is one of the model's form.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import vocabulary
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.representations.microfacet import Microfacet, Smooth
from brdfpipe.bsdf.representations.wave import Wave
from brdfpipe.bsdf.wave.two_scale import FACETS_ALONE
from brdfpipe.comparison import comparison_dataset, findings
from brdfpipe.comparison.adjustment import Adjusted, adjust
from brdfpipe.comparison.measurement import ComparisonError, Measurement
from brdfpipe.comparison.prediction import INPUTS, NOMINAL, Predicted, PredictionAt, PredictionInputs, PredictionModel

PRIOR_U: Mapping[str, float] = {"index": 0.02, "slope": 0.1, "diffuse": 0.05}
"""Default standard uncertainty of the inputs: absolute for the index, relative for the others."""

MOST_WAVELENGTHS = 8
"""Wavelengths that are compared, evenly chosen from those of the rig that the prediction covers."""

_VISIBLE = 1e-4  # coherent reflectance below which no cell shows it
_SAME = 1e-3  # largest relative difference between a prediction and the same one rebuilt from its inputs


def compare(
    primary: xr.Dataset,
    predicted: xr.Dataset,
    *,
    facets: xr.Dataset,
    index: xr.Dataset | float | str,
    spectrum: xr.Dataset | None = None,
    wave: xr.Dataset | None = None,
    index_u: float = PRIOR_U["index"],
    slope_u: float = PRIOR_U["slope"],
    diffuse_u: float = PRIOR_U["diffuse"],
) -> xr.Dataset:
    """Compare a measured BRDF with the predicted one, and fit the uncertain inputs of the prediction.

    Parameters
    ----------
    primary : kind ``primary``, of reflection; light comes from azimuth 0, whatever the lay of the surface
    predicted : kind ``bsdf``. One of the representation ``microfacet`` is fitted, any other one only compared
    facets, index, spectrum : the inputs it was built from, see :func:`brdfpipe.bsdf.microfacet.build`
    wave : kind ``bsdf``, of the same surface by wave optics (:func:`brdfpipe.bsdf.wave.build`). It is compared, without a fit, in place of
        ``predicted`` if at any measured incidence less than :data:`FACETS_ALONE` of the light is reflected as by facets
    index_u : standard uncertainty of the refractive index [1]
    slope_u, diffuse_u : relative standard uncertainty of the facets' slopes, and of the diffuse reflectance
        below them; an input with an uncertainty of 0 is not changed

    Returns
    -------
    Dataset of kind ``comparison``: ``brdf`` and its uncertainties; along ``model`` (``predicted``, and ``adjusted`` with the fitted inputs)
        the BRDF, the ratio of measured to modelled and ``z``, the difference over the uncertainty; per incidence the median ratio, the rms
        of z and the reflectance into the cells; χ² over the degrees of freedom, common errors taken into account; ``prior`` and
        ``posterior`` of each ``input`` and their ``correlation``. ``findings`` states the results in sentences

    Raises
    ------
    ComparisonError : the two share no wavelength, no cell was measured, the surface mirrors light into one single direction, the light was
        transmitted, or the prediction was made from something else.
    VocabularyError : a dataset of the wrong kind.

    Notes
    -----
    The values of ``primary`` are those in the middle of the cells: the reduction corrects their means for the curvature of the light. The
    remaining error where a lobe is about as narrow as a cell, and the uncertainty of the scanned facets, are uncertainties of the prediction
    (``brdf_model_u``), which z and χ² include.
    """
    predicted = _with_waves(predicted, wave, primary)
    prior_u = {"index": index_u, "slope": slope_u, "diffuse": diffuse_u}
    _check(primary, predicted, facets, prior_u)
    measurement = Measurement.of(primary, _shared(primary, predicted))
    models: dict[str, Predicted] = {"predicted": Predicted(predicted, measurement)}
    fit: Adjusted[PredictionAt] | None = None
    if isinstance(representation(predicted), Microfacet):
        given = PredictionInputs.of(predicted, facets, index, spectrum, measurement.wavelength)
        # Inputs that may be changed and have an effect.
        fixed = set() if predicted["diffuse"].values.any() else {"diffuse"}
        fitted = {name: prior_u[name] for name in INPUTS if prior_u[name] > 0 and name not in fixed}
        model = PredictionModel(given, measurement, fitted)
        _check_same(models["predicted"], model.start)
        models["predicted"] = model.start
        if fitted:
            fit = adjust(measurement, model.at, len(fitted), model.start)
            models["adjusted"] = fit.model
    comparison = comparison_dataset.compared(measurement, models, fit)
    if fit is not None:
        comparison = comparison_dataset.with_inputs(comparison, model, fit)
    comparison = vocabulary.add_warning(findings.with_findings(comparison, predicted), *_coherent(predicted, primary))
    comparison = vocabulary.label(comparison, "comparison")
    return vocabulary.validate(comparison, "comparison")


def adjusted(
    comparison: xr.Dataset,
    predicted: xr.Dataset,
    *,
    facets: xr.Dataset,
    index: xr.Dataset | float | str,
    spectrum: xr.Dataset | None = None,
) -> xr.Dataset:
    """The BSDF built with the fitted inputs of a comparison; arguments as for :func:`compare`.

    Raises
    ------
    ComparisonError : the comparison has no fit.
    """
    if "posterior" not in comparison:
        raise ComparisonError("nothing was fitted: the prediction has no inputs that could be changed")
    names = map(str, comparison["input"].values)
    changed = dict(zip(names, comparison["posterior"].values.tolist(), strict=True))
    return PredictionInputs.of(predicted, facets, index, spectrum).bsdf({**NOMINAL, **changed})


def _check(primary: xr.Dataset, predicted: xr.Dataset, facets: xr.Dataset, prior_u: Mapping[str, float]) -> None:
    for dataset, kind in ((primary, "primary"), (predicted, "bsdf"), (facets, "facets")):
        vocabulary.validate(dataset, kind)
    if wrong := [name for name, u in prior_u.items() if not (np.isfinite(u) and u >= 0)]:
        raise ComparisonError(
            f"the standard uncertainty of the input {wrong[0]!r} is {prior_u[wrong[0]]:g}; accepted: 0 or more"
        )
    if primary.attrs.get("side", "reflection") != "reflection":
        raise ComparisonError(
            "the rig measured transmitted light, but a prediction is compared with reflected light only: measure "
            "`side: [reflection]` too"
        )
    if isinstance(representation(predicted), Smooth):
        raise ComparisonError(
            "the predicted surface is perfectly flat and mirrors light into one single direction, of which no cell shows a BRDF; "
            "give the surface a roughness, measured or assumed"
        )


def _with_waves(predicted: xr.Dataset, wave: xr.Dataset | None, primary: xr.Dataset) -> xr.Dataset:
    """The BSDF that is compared: that of the facets where they reflect all light at the measured incidences, else that with waves."""
    if wave is None:
        return predicted
    model = representation(vocabulary.validate(wave, "bsdf"))
    if not isinstance(model, Wave):
        return wave
    _, share = model.regime(primary["incidence"].values.astype(float), wave["wavelength"].values)
    alone = share.min() >= FACETS_ALONE and "log_fine_halo" not in wave
    return predicted if alone else wave


def _coherent(predicted: xr.Dataset, primary: xr.Dataset) -> list[str]:
    """A warning where the prediction mirrors light into the single direction that no BRDF holds."""
    incidence = primary["incidence"].values.astype(float)
    share = float(representation(predicted).specular(incidence, np.zeros_like(incidence), None)[0].max())
    if share < _VISIBLE:
        return []
    return [
        f"up to {share:.2g} of the light is reflected coherently, into the mirror direction itself; the predicted BRDF leaves it out, so a cell "
        "that holds this direction is predicted too dark"
    ]


def _shared(primary: xr.Dataset, predicted: xr.Dataset) -> NDArray[np.int64]:
    """Indices of the rig's wavelengths that are compared."""
    own = primary["wavelength"].values
    covered = np.arange(own.size)
    if "wavelength" in predicted.coords:
        low, high = predicted["wavelength"].values[[0, -1]]
        covered = np.flatnonzero((own >= low) & (own <= high))
        if not covered.size:
            raise ComparisonError(
                f"the rig measured from {own[0]:g} to {own[-1]:g} nm and the prediction covers {low:g} to {high:g} nm: they share no "
                "wavelength; give a `spectrum` (or an `index`) that covers the rig's"
            )
    indices = np.linspace(0, covered.size - 1, min(covered.size, MOST_WAVELENGTHS)).round().astype(int)
    return np.asarray(covered[indices], dtype=np.int64)


def _check_same(predicted: Predicted, rebuilt: Predicted) -> None:
    """Refuse inputs that are not those of the prediction: their fit would mean nothing."""
    used = predicted.measurement.used & (predicted.values > 0)
    # Between the wavelengths of the spectrum the two may differ; of other inputs nearly all values do.
    if used.any() and np.median(np.abs(rebuilt.values[used] / predicted.values[used] - 1)) > _SAME:
        raise ComparisonError(
            "the prediction was not made from these facets, this index and this spectrum: one rebuilt from them differs; run `brdfpipe build`"
        )
