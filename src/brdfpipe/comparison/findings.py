"""The findings of a comparison in sentences, and its warnings."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.representations.microfacet import Microfacet

MISFIT = 1.5
"""χ² over the degrees of freedom above which a model does not agree with a measurement."""

_CERTAIN = 3.0  # standard uncertainties above which a change is significant
_FAR = 3.0  # prior standard uncertainties above which a change is implausible
_DOUBTFUL = 5.0  # prior standard uncertainties of a change that is hardly one of the input
_UNINFORMATIVE = 0.8  # posterior over prior uncertainty above which the measurement does not constrain an input
_CORRELATED = 0.9  # correlation above which two inputs cannot be separated
_REFERENCE = 550.0  # wavelength at which an index is quoted [nm]

NAMES = {
    "index": "refractive index",
    "slope": "slope scale",
    "diffuse": "diffuse scale",
    "finer": "roughness finer than the scan",
}


def with_findings(comparison: xr.Dataset, predicted: xr.Dataset) -> xr.Dataset:
    """A comparison with its findings as the attribute ``findings``, a list in JSON, and its warnings."""
    findings = [*_agreement(comparison), *input_findings(comparison, predicted)]
    comparison = comparison.assign_attrs(findings=json.dumps(findings, ensure_ascii=False))
    return vocabulary.add_warning(comparison, *_warnings(comparison, predicted))


def sentences(comparison: xr.Dataset) -> list[str]:
    """The findings of a comparison."""
    return list(json.loads(comparison.attrs["findings"]))


def plus_minus(value: float, u: float, sign: str = "") -> str:
    """A value and its standard uncertainty, with two figures of the latter: ``1.070 ± 0.011``."""
    decimals = max(0, 1 - math.floor(math.log10(u))) if u > 0 else 4
    return f"{value:{sign}.{decimals}f} ± {u:.{decimals}f}".replace("-", "−")


def _agreement(comparison: xr.Dataset) -> Iterator[str]:
    before, *after = comparison["chi_squared_dof"].values.tolist()
    ratios = comparison["median_ratio"].sel(model="predicted").values
    incidences = ", ".join(f"{angle:g}°" for angle in comparison["incidence"].values)
    yield (
        f"measured over predicted, median at {incidences} of incidence: {', '.join(f'{ratio:.3f}' for ratio in ratios)}; "
        f"χ² over the degrees of freedom {before:.3g}"
    )
    if after:
        verdict = (
            "the prediction describes the measurement" if after[0] <= MISFIT else "they do not explain the difference"
        )
        yield f"with the inputs below χ² over the degrees of freedom is {after[0]:.3g}: {verdict}"


def input_findings(comparison: xr.Dataset, predicted: xr.Dataset) -> Iterator[str]:
    """Sentences on the inputs that were fitted, of a dataset with ``prior``, ``posterior`` and their uncertainties by ``input``."""
    yield from _inputs(comparison, predicted)
    yield from _correlated_inputs(comparison)


def _inputs(comparison: xr.Dataset, predicted: xr.Dataset) -> Iterator[str]:
    if "posterior" not in comparison:
        return
    for name in map(str, comparison["input"].values):
        one = comparison.sel(input=name)
        value, u, before = (float(one[part]) for part in ("posterior", "posterior_u", "prior"))
        stated = f"{NAMES[name]} {_stated(name, value, u, predicted)}"
        far = abs(value - before) / float(one["prior_u"])
        if far > _DOUBTFUL:
            yield f"{stated}: {_meaning(name, value)}, {far:.2g} times its assumed uncertainty from what was given; the error may lie elsewhere"
        elif u > _UNINFORMATIVE * float(one["prior_u"]):
            yield f"{stated}: the measurement does not constrain it beyond the assumed uncertainty"
        elif abs(value - before) < _CERTAIN * u:
            yield f"{stated}: unchanged within its uncertainty"
        else:
            yield f"{stated}: {_meaning(name, value)}"


def _stated(name: str, value: float, u: float, predicted: xr.Dataset) -> str:
    if name == "finer":
        return height_words(value, u)
    if name != "index":
        return f"× {plus_minus(value, u)}"
    given = predicted["n"]
    if given.ndim:
        wavelength = float(given["wavelength"].sel(wavelength=_REFERENCE, method="nearest"))
        given, at = given.sel(wavelength=wavelength), f" at {wavelength:g} nm"
    else:
        at = ""
    return f"{plus_minus(float(given) + value, u)}{at} instead of {float(given):.4g} (shifted by {plus_minus(value, u, '+')})"


def height_words(variance: float, u: float) -> str:
    """An rms height in nm, from a mean square height [um²] of 0 or more and its standard uncertainty."""
    if variance < _CERTAIN * u:
        return f"{1e3 * math.sqrt(variance):.2g} nm rms, below {1e3 * math.sqrt(variance + 2 * u):.2g} nm (95 %)"
    height = math.sqrt(variance)
    return f"{plus_minus(1e3 * height, 1e3 * u / (2 * height))} nm rms"


def _meaning(name: str, value: float) -> str:
    if name == "finer":
        return "gloss is lost to roughness that the scan does not resolve, or to a film or dirt on the surface"
    if name == "index":
        return f"the facets reflect as if the index were {'higher' if value > 0 else 'lower'} than given"
    percent = f"{float(f'{100 * abs(value - 1):.2g}'):g} %"
    if name == "slope":
        return f"the surface scatters as if {percent} {'rougher' if value > 1 else 'smoother'} than its facets say"
    return f"below the facets the body is {percent} {'brighter' if value > 1 else 'darker'} than the spectrum says"


def _correlated_inputs(comparison: xr.Dataset) -> Iterator[str]:
    if "correlation" not in comparison:
        return
    names, correlation = [str(name) for name in comparison["input"].values], comparison["correlation"].values
    for first, second in np.argwhere(np.triu(np.abs(correlation) > _CORRELATED, 1)):
        number = f"{correlation[first, second]:.2f}".replace("-", "−")
        yield f"{NAMES[names[first]]} and {NAMES[names[second]]} are hard to separate (correlation {number}): a change of one may compensate the other"


def _warnings(comparison: xr.Dataset, predicted: xr.Dataset) -> Iterator[str]:
    yield from _fit_warnings(comparison)
    if "posterior" in comparison:
        for name in map(str, comparison["input"].values):
            one = comparison.sel(input=name)
            moved = abs(float(one["posterior"] - one["prior"])) / float(one["prior_u"])
            if moved > _FAR:
                yield (
                    f"measurement and prediction agree only if the {NAMES[name]} changes by {moved:.1f} times its assumed standard uncertainty. "
                    f"Check it, or raise `comparison.{name}_u`."
                )
    if not isinstance(representation(predicted), Microfacet):
        yield (
            f"the prediction ({representation(predicted).name}) was compared and not fitted: index, slopes and diffuse "
            "reflectance are fitted for opaque bodies alone"
        )
    if not representation(predicted).isotropic:
        lay = representation(predicted).lay
        along = "" if lay is None else f", along {lay:.0f}°"
        yield (
            f"the surface has a lay{along}, and the rig saw it in one plane of incidence, taken for that of azimuth 0; lay "
            "the sample into the rig as it lay under the profilometer"
        )


def _fit_warnings(comparison: xr.Dataset) -> Iterator[str]:
    left = float(comparison["chi_squared_dof"].values[-1])
    fitted = "posterior" in comparison
    if fitted and not comparison.attrs["converged"]:
        yield "The fit of the prediction's inputs did not converge: its result is only indicative."
    if left > MISFIT and fitted:
        yield (
            f"no change of the prediction's inputs makes it agree with the measurement (χ² over the degrees of freedom {left:.3g}): the form of "
            f"the model, or an uncertainty, is wrong; the uncertainties of the inputs were enlarged {comparison.attrs['enlarged']:.2g} times"
        )
    elif left > MISFIT:
        yield f"prediction and measurement do not agree (χ² over the degrees of freedom {left:.3g})"
