"""The vocabulary every stage speaks: names, units, kinds of dataset, quality flags, and their validation.

One table says what a name means (:data:`QUANTITIES`), one says what a kind of dataset holds (:data:`KINDS`). A stage builds
plain arrays under these names, :func:`label` attaches units and long names, :func:`validate` checks the result.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import inf

import numpy as np
import xarray as xr

from brdfpipe.errors import VocabularyError

CONVENTIONS = "CF-1.11"

QUALITY_FLAGS = (
    "measured",
    "interpolated",
    "extrapolated",
    "completed",
    "shadowed",
    "saturated",
    "below_noise",
    "vignetted",
    "clamped",
)
"""Meanings of the values 0, 1, 2 … of every ``<field>_quality`` variable."""


@dataclass(frozen=True)
class Quantity:
    """What a name means: its unit, its words, and the values it may take."""

    units: str
    long_name: str
    low: float = -inf
    high: float = inf
    missing: bool = False
    """Whether NaN (missing) is allowed."""


QUANTITIES: Mapping[str, Quantity] = {
    # Coordinates
    "wavelength": Quantity("nm", "wavelength in air", 100, 20000),
    "theta_i": Quantity("degree", "polar angle of incidence, from the normal", 0, 180),
    "phi_i": Quantity("degree", "azimuth of incidence", -720, 720),
    "theta_o": Quantity("degree", "polar angle of the outgoing direction, from the normal", 0, 180),
    "phi_o": Quantity("degree", "azimuth of the outgoing direction", -720, 720),
    "phi": Quantity("degree", "azimuth, counter-clockwise seen from above", -720, 720),
    "alpha": Quantity("degree", "polar angle of the facet normal", 0, 90),
    "beta": Quantity("degree", "azimuth of the facet normal", -720, 720),
    "theta": Quantity("degree", "polar angle, from the normal", 0, 90),
    "slope": Quantity("1", "magnitude of the surface slope", 0),
    "slope_x": Quantity("1", "surface slope along x"),
    "slope_y": Quantity("1", "surface slope along y"),
    "slope_towards": Quantity("1", "slope of the facet towards the viewer"),
    "x": Quantity("um", "position along x"),
    "y": Quantity("um", "position along y"),
    "scale": Quantity("1", "distance between the heights a slope is taken from, in pixels", 1),
    "gloss_angle": Quantity("degree", "nominal gloss geometry", 0, 90),
    # Surface
    "height": Quantity("um", "height above the levelling form", missing=True),
    "missing_fraction": Quantity("1", "share of heights that are missing", 0, 1),
    # Facets
    "slope_density": Quantity("1", "probability density of facets in slope space, P22", 0),
    "D": Quantity("sr-1", "facet distribution D(m): area of facets per solid angle and projected area", 0),
    "count": Quantity("1", "number of facets in the bin", 0),
    "lambda_smith": Quantity("1", "Smith's masking function Λ", 0),
    "slope_rms": Quantity("1", "root mean square slope of the facets; missing where it is not finite", 0, missing=True),
    "slope_rms_scale": Quantity("1", "root mean square slope against the distance it is taken over", 0, missing=True),
    "anisotropy": Quantity("1", "larger over smaller principal slope rms", 1, missing=True),
    "lay": Quantity("degree", "azimuth of the smaller principal slope rms", -180, 180, missing=True),
    "facet_count": Quantity("1", "number of facets", 0),
    "effective_count": Quantity("1", "number of independent facets", 0),
    "correlation_length": Quantity("um", "distance at which the height correlation falls to 1/e", 0, missing=True),
    "noise_ratio": Quantity("1", "rms slope over one pixel divided by rms slope over two", 0, missing=True),
    # Masking
    "g1": Quantity("1", "visible fraction of the facets that face the direction, by ray casting", 0, 1 + 1e-9),
    "g1_by_slope": Quantity("1", "visible fraction of facets of one slope, by ray casting", 0, 1 + 1e-9, missing=True),
    "slope_count": Quantity("1", "number of facets of the slope that face the direction", 0),
    "lambda_empirical": Quantity("1", "Smith's masking function Λ of the slopes along the lines cast", 0),
    "g1_raycast": Quantity("1", "G1 by ray casting, mean over the azimuths", 0, 1 + 1e-9),
    "g1_smith": Quantity("1", "G1 after Smith, of the facet distribution", 0, 1 + 1e-9),
    "g2": Quantity(
        "1", "fraction of facets facing both directions that both see, by ray casting", 0, 1 + 1e-9, missing=True
    ),
    "g2_raycast": Quantity("1", "G2 of the mirror direction by ray casting", 0, 1 + 1e-9, missing=True),
    "g2_separable": Quantity("1", "separable G2 after Smith, of the slopes along the lines", 0, 1 + 1e-9),
    "g2_height_correlated": Quantity(
        "1", "height-correlated G2 after Smith, of the slopes along the lines", 0, 1 + 1e-9
    ),
    # Spectrum and index
    "total_reflectance": Quantity("1", "total (diffuse and specular) reflectance", 0),
    "n": Quantity("1", "real part of the refractive index", 0),
    "k": Quantity("1", "imaginary part of the refractive index (extinction coefficient)", 0),
    # BSDF
    "brdf": Quantity("sr-1", "bidirectional reflectance distribution function"),
    "directional_albedo": Quantity("1", "directional albedo of the facets' specular reflection", 0, 1 + 1e-9),
    "mean_albedo": Quantity("1", "cosine-weighted mean of the directional albedo", 0, 1 + 1e-9),
    "diffuse": Quantity("1", "diffuse reflectance d' below the facets", 0),
    "theta_m": Quantity("degree", "incidence at which the total reflectance was measured", 0, 90),
    "lambert": Quantity("1", "reflectance of the Lambertian part", 0),
    "gauss_peak": Quantity("sr-1", "peak G0 of the Gaussian part, at the specular direction", 0),
    "gauss_fwhm_parallel": Quantity("degree", "full width at half maximum in the plane of incidence", 0),
    "gauss_fwhm_perpendicular": Quantity("degree", "full width at half maximum across the plane of incidence", 0),
    "gauss_reflectance": Quantity("1", "reflectance of the Gaussian part, R_gauss", 0),
    "fit_residual": Quantity("1", "flux-weighted rms residual of the fit over the flux-weighted rms BRDF", 0),
    # Checks
    "albedo": Quantity("1", "directional reflectance", 0),
    "reciprocity_residual": Quantity("1", "largest |f(i,o) - f(o,i)| over their mean", 0, missing=True),
    "energy_excess": Quantity("1", "largest directional reflectance above 1", 0),
    "negative_fraction": Quantity("1", "share of directions with a negative or undefined BRDF", 0, 1),
    "closure_residual": Quantity("1", "largest |integrated - given| total reflectance", 0, missing=True),
    "integral_residual": Quantity("1", "largest |integrated BRDF - albedo| over a few incidences", 0),
    "floor": Quantity("sr-1", "smallest BRDF over the directions checked"),
    # Appearance
    "gloss": Quantity("1", "gloss units, D523-style", 0),
    "haze": Quantity("1", "gloss at 60 degree minus gloss at 20 degree, D4039-style", missing=True),
    "lab": Quantity("1", "CIE 1976 L*a*b*", missing=True),
    "luminous_reflectance": Quantity("1", "total reflectance at 8 degree, weighted with V(λ) and D65", 0, missing=True),
    "flop_index": Quantity("1", "flop index", missing=True),
    "srgb": Quantity("1", "sRGB preview colour", 0, 1, missing=True),
}


@dataclass(frozen=True)
class Kind:
    """What a kind of dataset holds: variables with the dimensions they may have, and attributes."""

    required: Mapping[str, Sequence[tuple[str, ...]]]
    optional: Mapping[str, Sequence[tuple[str, ...]]] = field(default_factory=dict)
    attributes: tuple[str, ...] = ()


_ISOTROPIC: Sequence[tuple[str, ...]] = [("slope",)]
_SLOPES: Sequence[tuple[str, ...]] = [("slope",), ("slope_y", "slope_x")]
_SPECTRAL: Sequence[tuple[str, ...]] = [("wavelength",), ()]
_SCALAR: Sequence[tuple[str, ...]] = [()]
_POLAR: Sequence[tuple[str, ...]] = [("theta",)]

_FACETS = Kind(
    required={
        "slope_density": _SLOPES,
        "D": [("alpha",), ("alpha", "beta")],
        "lambda_smith": [("theta",), ("theta", "phi")],
        "slope_rms": _SCALAR,
    },
    optional={
        "count": _SLOPES,
        "anisotropy": _SCALAR,
        "lay": _SCALAR,
        "facet_count": _SCALAR,
        "effective_count": _SCALAR,
        "correlation_length": _SCALAR,
        "noise_ratio": _SCALAR,
        "slope_rms_scale": [("scale",)],
    },
    attributes=("method", "band"),
)

KINDS: Mapping[str, Kind] = {
    "surface": Kind({"height": [("y", "x"), ("x",)]}, attributes=("pitch_x", "levelling", "band")),
    "facets": _FACETS,
    "spectrum": Kind({"total_reflectance": [("wavelength",)]}, attributes=("geometry", "theta_i", "method")),
    "index": Kind({"n": [("wavelength",)], "k": [("wavelength",)]}, attributes=("source",)),
    "bsdf": Kind({}, attributes=("representation",)),
    "appearance": Kind(
        {
            "gloss": [("gloss_angle",)],
            "haze": _SCALAR,
            "lab": [("geometry", "component")],
            "flop_index": _SCALAR,
            "luminous_reflectance": _SCALAR,
            "srgb": [("channel",)],
        },
        attributes=("illuminant", "observer"),
    ),
    "checks": Kind(
        {
            "reciprocity_residual": _SCALAR,
            "albedo": [("theta_i", "wavelength"), ("theta_i",)],
            "energy_excess": _SCALAR,
            "negative_fraction": _SCALAR,
            "closure_residual": _SCALAR,
            "integral_residual": _SCALAR,
            "floor": _SCALAR,
        },
        attributes=("verdicts",),
    ),
    "parameters": Kind({"missing_fraction": _SCALAR}, attributes=("levelling", "band")),
    "raycast": Kind({}, attributes=("method",)),
    "masking": Kind(
        required={"g1_raycast": _POLAR, "g1_raycast_u": _POLAR, "g1_smith": _POLAR},
        optional={"g2_raycast": _POLAR, "g2_raycast_u": _POLAR, "g2_separable": _POLAR, "g2_height_correlated": _POLAR},
        attributes=("method",),
    ),
    "catalogue": Kind({}),
}

REPRESENTATIONS: Mapping[str, Kind] = {
    "microfacet": Kind(
        required={
            "slope_density": _ISOTROPIC,
            "lambda_smith": [("theta",)],
            "n": _SPECTRAL,
            "k": _SPECTRAL,
            "directional_albedo": [("theta_i", "wavelength"), ("theta_i",)],
            "mean_albedo": _SPECTRAL,
            "diffuse": _SPECTRAL,
        },
        optional={"total_reflectance": _SPECTRAL, "theta_m": _SCALAR},
        attributes=("masking", "diffuse_mode"),
    ),
    "lambert_gauss": Kind(
        required={
            "lambert": [("theta_i", "wavelength"), ("theta_i",), ("wavelength",), ()],
            "gauss_peak": [("theta_i",)],
            "gauss_fwhm_parallel": [("theta_i",)],
            "gauss_fwhm_perpendicular": [("theta_i",)],
        },
        optional={
            "gauss_reflectance": [("theta_i",)],
            "fit_residual": [("theta_i",)],
            "total_reflectance": _SPECTRAL,
            "theta_m": _SCALAR,
        },
    ),
    "table": Kind(
        required={"brdf": [("theta_i", "theta_o", "phi_o"), ("theta_i", "theta_o", "phi_o", "wavelength")]},
        optional={"total_reflectance": _SPECTRAL, "theta_m": _SCALAR},
    ),
}
"""Variables a ``bsdf`` of each representation needs to be evaluated anywhere."""


def label(dataset: xr.Dataset, kind: str) -> xr.Dataset:
    """Attach units, long names, flag meanings and the kind to a stage's plain arrays.

    Names that the vocabulary does not know must bring ``units`` and ``long_name`` of their own.
    """
    labelled = dataset.copy()
    labelled.attrs = {"Conventions": CONVENTIONS, "kind": kind, **dataset.attrs}
    for name in map(str, labelled.variables):
        known = _quantity(name)
        if known is not None:
            labelled[name].attrs = {"units": known.units, "long_name": known.long_name, **labelled[name].attrs}
        elif name.endswith("_quality"):
            labelled[name].attrs = {
                "units": "1",
                "long_name": f"quality of {name.removesuffix('_quality')}",
                "flag_values": np.arange(len(QUALITY_FLAGS), dtype=np.int8),
                "flag_meanings": " ".join(QUALITY_FLAGS),
                **labelled[name].attrs,
            }
    return labelled


def validate(dataset: xr.Dataset, kind: str, source: str | None = None) -> xr.Dataset:
    """Check a dataset against its kind; return it unchanged.

    Parameters
    ----------
    dataset : any dataset
    kind : a key of :data:`KINDS`
    source : the file it came from, for the message

    Raises
    ------
    VocabularyError : naming the file, the variable and the expectation.
    """
    where = f"{source}: " if source else ""
    if kind not in KINDS:
        raise VocabularyError(f"{where}unknown kind of dataset {kind!r}; known: {', '.join(KINDS)}")
    found = dataset.attrs.get("kind", kind)
    if found != kind:
        raise VocabularyError(f"{where}expected a dataset of kind {kind!r}, found kind {found!r}")
    _check_members(dataset, KINDS[kind], kind, where)
    if kind == "bsdf":
        representation = dataset.attrs["representation"]
        if representation not in REPRESENTATIONS:
            raise VocabularyError(
                f"{where}unknown representation {representation!r}; known: {', '.join(REPRESENTATIONS)}"
            )
        _check_members(dataset, REPRESENTATIONS[representation], f"bsdf ({representation})", where)
    for name in map(str, dataset.variables):
        _check_values(name, dataset[name], where)
    return dataset


def _check_members(dataset: xr.Dataset, kind: Kind, title: str, where: str) -> None:
    for attribute in kind.attributes:
        if attribute not in dataset.attrs:
            raise VocabularyError(f"{where}a dataset of kind {title!r} needs the attribute {attribute!r}")
    for name in kind.required:
        if name not in dataset:
            raise VocabularyError(
                f"{where}a dataset of kind {title!r} needs the variable {name!r}; found {', '.join(map(str, dataset))}"
            )
    for name, accepted in {**kind.required, **kind.optional}.items():
        if name in dataset and tuple(dataset[name].dims) not in accepted:
            raise VocabularyError(
                f"{where}{name!r} has dimensions {dataset[name].dims}; a {title!r} dataset accepts "
                + " or ".join(map(str, accepted))
            )


def _check_values(name: str, variable: xr.DataArray, where: str) -> None:
    if variable.dtype.kind in "OUS":
        return
    if "units" not in variable.attrs:
        raise VocabularyError(f"{where}{name!r} has no units")
    known = _quantity(name)
    if known is None or variable.size == 0:
        return
    if variable.attrs["units"] != known.units:
        raise VocabularyError(f"{where}{name!r} is in {variable.attrs['units']!r}, expected {known.units!r}")
    values = variable.values
    if np.isinf([known.low, known.high]).all() and name not in variable.dims and np.isfinite(values.sum(dtype=float)):
        return  # any value will do, and one pass shows that none is missing or infinite
    low, high = float(values.min()), float(values.max())
    if np.isnan(low):  # minima of whole arrays propagate NaN: only then is it worth looking for what is missing
        missing = np.isnan(values)
        if not known.missing:
            raise VocabularyError(f"{where}{name!r} has {int(missing.sum())} missing values; none are allowed")
        if missing.all():
            return
        low, high = float(np.nanmin(values)), float(np.nanmax(values))
    if low < known.low or high > known.high or not np.isfinite([low, high]).all():
        raise VocabularyError(
            f"{where}{name!r} spans {low:g} to {high:g} {known.units}, expected finite values in [{known.low:g}, {known.high:g}]"
        )
    if name in variable.dims and values.size > 1 and not (np.diff(values) > 0).all():
        raise VocabularyError(f"{where}the coordinate {name!r} must increase strictly")


def _quantity(name: str) -> Quantity | None:
    if name in QUANTITIES:
        return QUANTITIES[name]
    base, mark, component = name.partition("_u")
    if mark and base in QUANTITIES and (component == "" or component.startswith("_")):
        quantity = QUANTITIES[base]
        return Quantity(quantity.units, f"standard uncertainty of: {quantity.long_name}", 0, missing=True)
    return None


def quality(name: str) -> np.int8:
    """The flag value of a quality: ``quality("extrapolated")``."""
    return np.int8(QUALITY_FLAGS.index(name))


def add_history(dataset: xr.Dataset, *sentences: str) -> xr.Dataset:
    """Record in words what was corrected, without touching the original."""
    lines = [line for line in dataset.attrs.get("history", "").splitlines() if line]
    return dataset.assign_attrs(history="\n".join([*lines, *sentences]))


def add_warning(dataset: xr.Dataset, *sentences: str) -> xr.Dataset:
    """Record warnings that the report and the catalogue show. Every warning says what to do."""
    if not sentences:
        return dataset
    return dataset.assign_attrs(warnings=json.dumps([*warnings(dataset), *sentences], ensure_ascii=False))


def warnings(dataset: xr.Dataset) -> list[str]:
    """The warnings a dataset carries."""
    return list(json.loads(dataset.attrs.get("warnings", "[]")))
