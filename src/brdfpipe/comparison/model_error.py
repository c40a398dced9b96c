"""How far a predicted BSDF is from reference solutions on the height map that it was predicted from."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import xarray as xr

from brdfpipe import hemisphere, vocabulary
from brdfpipe.appearance.gloss_meter import gloss
from brdfpipe.bsdf import kirchhoff, traced
from brdfpipe.bsdf.nonspectral import nonspectral, normalised_response
from brdfpipe.bsdf.registry import representation
from brdfpipe.errors import VocabularyError
from brdfpipe.geometry import Array
from brdfpipe.references.height_mesh import HeightMapError

INCIDENCES = np.array([0.0, 30.0, 60.0, 75.0])
"""Angles of incidence at which light is compared [degree]."""
GLOSS_ANGLES = (20, 60, 85)
REGIONS = {"peak": 0.3, "shoulder": 0.03, "rest": 0.0}
"""Regions by the smallest share of the predicted peak [1]."""
REFERENCES = ("traced", "kirchhoff")
RAYS = 100_000
"""Rays of each incidence of the tracer: a few seconds altogether, and 1 % in a region that holds a tenth of the light."""
GEOMETRIC = 20.0
"""Variance of the phase from which rays are valid: waves then are within 10 % of facets."""
COHERENT = 1.0
"""Variance of the phase up to which most light is coherent, and no facet masks another."""
UNMASKED = 3.0
"""Cotangent of the incidence, in typical slopes, from which masking is negligible: Λ of a Gaussian surface is below 4e-4."""
SIGNIFICANT = 3.0
"""Standard uncertainties beyond which a difference is significant."""
LIGHT_LIMIT, GLOSS_LIMIT = 0.1, 1.0
"""Relative error in the peak, and error in gloss units, above which the result warns."""

TABLE_ERROR = 0.02
"""Relative error of traced light by its table: rms in the peak, 0.8 % on Gaussian maps and 2.2 % on grains."""
GLOSS_TABLE_ERROR = np.array([0.02, 0.02, 0.05])
"""The same of gloss at :data:`GLOSS_ANGLES`, against tables of finer bins and ten times the rays."""

_WAVELENGTH = 555.0
_UNKNOWN_SLOPE = 0.05  # of a BSDF that states none
_AZIMUTHS = 8


class _Light(NamedTuple):
    """Light by incidence and region, with its relative standard uncertainty, and gloss with its standard uncertainty."""

    light: Array
    relative_u: Array
    gloss: Array
    gloss_u: Array


def model_error(surface: xr.Dataset, predicted: xr.Dataset, *, rays: int = RAYS, seed: int = 0) -> xr.Dataset:
    """Compare the light of a predicted BSDF with that of traced rays and of Kirchhoff's diffraction on its own height map.

    Parameters
    ----------
    surface : kind ``surface``, the levelled map
    predicted : kind ``bsdf``, of an opaque body, predicted from that map and from a refractive index
    rays, seed : of the tracer, see :func:`brdfpipe.bsdf.traced.build`

    Returns
    -------
    Dataset of kind ``model_error``: ``light_error(reference, theta_i, region)``, predicted over reference light less 1;
    ``gloss_error(reference, gloss_angle)``, predicted less reference gloss; both with ``_u`` and what they are made of.
    ``valid(reference, theta_i)`` and ``gloss_valid`` say where a reference holds. NaN where a reference refuses the map, as the attribute
    ``refusals`` (JSON) says

    Raises
    ------
    VocabularyError : a dataset of the wrong kind, or a BSDF that transmits or has no refractive index.

    Notes
    -----
    The diffuse part is left out, and the BSDF is averaged over V(λ)·D65 and the azimuth of incidence. Regions are those of the predicted
    BRDF: above 0.3 of its peak, above 0.03, and the rest. Rays are valid where the variance of the phase (4πσ cos θ/λ)² is at
    least 20; diffraction where slopes are low (:data:`brdfpipe.bsdf.kirchhoff.SLOPE_LIMIT`) and either masking is negligible or most light
    is coherent.
    The uncertainty of traced light is the noise of the rays and :data:`TABLE_ERROR`; that of diffracted light the scatter between patches of the map.
    """
    vocabulary.validate(surface, "surface")
    vocabulary.validate(predicted, "bsdf")
    index = _index(predicted)
    bare = representation(predicted).without_diffuse()
    model = nonspectral(predicted if bare is None else bare)
    references, refusals = _references(surface, index, rays, seed)
    by_rays = references["traced"]
    slope = float(by_rays["smith_slope"]) if by_rays is not None else representation(model).lobe_slope or _UNKNOWN_SLOPE
    regions, light = _regions(model, slope)
    of_model = gloss(model, GLOSS_ANGLES).values
    found = [_reference_light(name, one, regions, rays) for name, one in references.items()]
    values = _Light(*(np.stack(field) for field in zip(*found, strict=True)))
    by_region, by_gloss = ("reference", "theta_i", "region"), ("reference", "gloss_angle")
    phase = (4 * np.pi * float(np.nanstd(surface["height"].values)) / (_WAVELENGTH * 1e-3)) ** 2

    def valid(angle: Array) -> Array:
        variance = phase * np.cos(np.radians(angle)) ** 2
        unmasked = np.tan(np.radians(90 - angle)) >= UNMASKED * slope
        low_slopes = np.sqrt(2) * slope <= kirchhoff.SLOPE_LIMIT
        holds = {"traced": variance >= GEOMETRIC, "kirchhoff": low_slopes & (unmasked | (variance <= COHERENT))}
        return np.stack([holds[name] & (references[name] is not None) for name in REFERENCES]).astype(np.int8)

    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.where(values.light > 0, light / values.light, np.nan)
    result = xr.Dataset(
        {
            "light": (by_region[1:], light),
            "reference_light": (by_region, values.light),
            "light_error": (by_region, ratio - 1),
            "light_error_u": (by_region, ratio * values.relative_u),
            "valid": (by_region[:2], valid(INCIDENCES)),
            "gloss": (by_gloss[1:], of_model),
            "reference_gloss": (by_gloss, values.gloss),
            "gloss_error": (by_gloss, of_model - values.gloss),
            "gloss_error_u": (by_gloss, values.gloss_u),
            "gloss_valid": (by_gloss, valid(np.array(GLOSS_ANGLES))),
            "phase_variance": ("theta_i", phase * np.cos(np.radians(INCIDENCES)) ** 2),
        },
        coords={
            "reference": list(REFERENCES),
            "theta_i": INCIDENCES,
            "region": list(REGIONS),
            "gloss_angle": np.array(GLOSS_ANGLES, dtype=float),
        },
        attrs={"rays": rays, "seed": seed, "refusals": json.dumps(refusals, ensure_ascii=False)},
    )
    return vocabulary.label(vocabulary.add_warning(result, *_warnings(result)), "model_error")


def relative_error(result: xr.Dataset) -> xr.DataArray:
    """Relative error of the model as a standard uncertainty: √(error² + u²), because the error is not corrected.

    Parameters
    ----------
    result : kind ``model_error``

    Returns
    -------
    DataArray [1] over ``theta_i`` [degree] and ``region``, of traced rays where they hold, else of diffraction, else NaN. Regions are those of
    the predicted BRDF at the incidence: above 0.3 of its peak, above 0.03, and the rest
    """
    size = ((result["light_error"] ** 2 + result["light_error_u"] ** 2) ** 0.5).where(result["valid"] > 0)
    size = size.max([dim for dim in size.dims if dim not in ("reference", "theta_i", "region")])
    traced_rays, diffraction = (size.sel(reference=name, drop=True) for name in REFERENCES)
    return traced_rays.fillna(diffraction).transpose("theta_i", "region").rename("relative_error")


def _references(
    surface: xr.Dataset, index: xr.Dataset, rays: int, seed: int
) -> tuple[dict[str, xr.Dataset | None], dict[str, str]]:
    """The reference solutions, None where one refuses the map, and why it does."""
    builders: dict[str, Callable[[], xr.Dataset]] = {
        "traced": lambda: traced.build(surface, index=index, rays=rays, seed=seed),
        "kirchhoff": lambda: nonspectral(kirchhoff.build(surface, index=index, wavelength=[_WAVELENGTH])),
    }
    references: dict[str, xr.Dataset | None] = {}
    refusals = {}
    for name in REFERENCES:
        try:
            references[name] = builders[name]()
        except HeightMapError as error:
            references[name], refusals[name] = None, str(error)
    return references, refusals


def _index(predicted: xr.Dataset) -> xr.Dataset:
    """One refractive index for all wavelengths, with the weights of the mean over wavelength."""
    model = representation(predicted)
    if model.transmits or "n" not in predicted:
        raise VocabularyError(
            f"a BSDF of representation {model.name!r} has no reference solution; accepted: an opaque body with a refractive index"
        )
    response = normalised_response(predicted)
    mean = None if response is None else model.mean_index(response)
    n, k = mean or (float(predicted[name].values.flat[0]) for name in ("n", "k"))
    fields = {name: ("wavelength", np.full(2, value)) for name, value in (("n", n), ("k", k))}
    dataset = xr.Dataset(fields, {"wavelength": [360.0, 830.0]}, {"source": "mean over wavelength"})
    return vocabulary.label(dataset, "index")


class _Regions(NamedTuple):
    """Directions of one incidence, with projected solid angles, and the region of each."""

    theta_i: float
    theta: Array
    phi: Array
    weight: Array
    region: Array


def _regions(model: xr.Dataset, slope: float) -> tuple[list[_Regions], Array]:
    """Regions of every incidence, and the light of the model in them, (theta_i, region)."""
    regions, light = [], []
    limits = np.array(list(REGIONS.values()))
    for theta_i in INCIDENCES:
        rule = hemisphere.around_mirror(theta_i, slope)
        brdf = _azimuthal_mean(model, theta_i, rule.theta, rule.phi)
        # The first region whose limit is exceeded.
        region = np.argmax(brdf[:, None] >= limits * brdf.max(), axis=1)
        regions.append(_Regions(float(theta_i), rule.theta, rule.phi, rule.weight, region))
        mirrored = float(representation(model).specular(np.array([theta_i]), np.zeros(1), None)[0].mean())
        light.append(_by_region(region, rule.weight * brdf) + mirrored * (np.arange(len(REGIONS)) == 0))
    return regions, np.stack(light)


def _reference_light(name: str, reference: xr.Dataset | None, regions: list[_Regions], rays: int) -> _Light:
    if reference is None:
        missing = np.full((INCIDENCES.size, len(REGIONS)), np.nan)
        return _Light(missing, missing, *np.full((2, len(GLOSS_ANGLES)), np.nan))
    model, light, relative_u = representation(reference), [], []
    for part in regions:
        incidence = np.full_like(part.theta, part.theta_i), np.zeros_like(part.phi)
        directions = *incidence, part.theta, part.phi
        mirrored = float(model.specular(np.array([part.theta_i]), np.zeros(1), None)[0].mean())
        amount = _by_region(part.region, part.weight * model.evaluate(*directions, None)[:, 0])
        amount[0] += mirrored
        light.append(amount)
        scatter = _by_region(part.region, part.weight * model.uncertainty(*directions, None)[:, 0])
        total = float(amount.sum())
        of_rays = np.hypot(np.sqrt(total / np.maximum(rays * amount, 1e-300)), TABLE_ERROR)
        relative_u.append(of_rays if name == "traced" else scatter / np.maximum(amount, 1e-300))
    units = gloss(reference, GLOSS_ANGLES).values
    return _Light(
        np.stack(light), np.stack(relative_u), units, units * _gloss_noise(name, reference, units, rays, relative_u)
    )


def _gloss_noise(name: str, reference: xr.Dataset, units: Array, rays: int, relative_u: list[Array]) -> Array:
    """Relative standard uncertainty of gloss: of the rays in the receptor, or that of the peak at the nearest incidence."""
    if name != "traced":
        nearest = [int(np.argmin(np.abs(INCIDENCES - angle))) for angle in GLOSS_ANGLES]
        return np.array([relative_u[row][0] for row in nearest])
    angle = np.array(GLOSS_ANGLES, dtype=float)
    reflected = representation(reference).albedo(angle, np.zeros_like(angle), None)[:, 0]
    # Black glass of 100 units reflects .0491, .1001 and .6191 (n = 1.567).
    in_receptor = units / 100 * np.array([0.0491, 0.1001, 0.6191])
    return np.hypot(np.sqrt(reflected / np.maximum(rays * in_receptor, 1e-300)), GLOSS_TABLE_ERROR)


def _azimuthal_mean(model: xr.Dataset, theta_i: float, theta: Array, phi: Array) -> Array:
    one = representation(model)
    turns = np.zeros(1) if one.isotropic else np.arange(_AZIMUTHS) * 360 / _AZIMUTHS
    signs = (1,) if one.isotropic else (1, -1)
    values = [
        one.evaluate(np.full_like(theta, theta_i), np.full_like(phi, turn), theta, sign * phi + turn, None)[:, 0]
        for turn in turns
        for sign in signs
    ]
    return np.asarray(np.mean(values, axis=0))


def _by_region(region: Array, light: Array) -> Array:
    return np.bincount(region, light, minlength=len(REGIONS)).astype(float)


def _warnings(result: xr.Dataset) -> list[str]:
    """Significant errors beyond the limits, of valid references."""
    warnings = []
    for name in REFERENCES:
        peak = result.sel(reference=name, region="peak")
        error, uncertainty = peak["light_error"].values, peak["light_error_u"].values
        wrong = (peak["valid"].values > 0) & (np.abs(error) > np.maximum(LIGHT_LIMIT, SIGNIFICANT * uncertainty))
        if wrong.any():
            row = int(np.argmax(np.where(wrong, np.abs(error), 0)))
            warnings.append(
                f"the predicted light in the peak is {error[row]:+.0%} (± {uncertainty[row]:.1%}) off {_REFERENCE_WORDS[name]} at {INCIDENCES[row]:.0f}°"
            )
        instrument = result.sel(reference=name)
        difference, uncertainty = instrument["gloss_error"].values, instrument["gloss_error_u"].values
        wrong = (instrument["gloss_valid"].values > 0) & (
            np.abs(difference) > np.maximum(GLOSS_LIMIT, SIGNIFICANT * uncertainty)
        )
        if wrong.any():
            row = int(np.argmax(np.where(wrong, np.abs(difference), 0)))
            warnings.append(
                f"the predicted gloss is {difference[row]:+.1f} (± {uncertainty[row]:.1f}) gloss units off {_REFERENCE_WORDS[name]} at "
                f"{GLOSS_ANGLES[row]}°"
            )
    if not (result["valid"].sum("reference") > 0).all():
        refusals = json.loads(result.attrs["refusals"])
        reason = " ".join(f"{name}: {text}." for name, text in refusals.items())
        warnings.append(
            "no reference solution holds at every angle of incidence, so the error of the model is not known there; compare with a "
            f"measurement. {reason}".strip()
        )
    return warnings


_REFERENCE_WORDS = {"traced": "rays traced over the map", "kirchhoff": "diffraction on the map"}
