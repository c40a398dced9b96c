"""The microfacet BSDF of a rough interface over a diffuse base, or of a perfectly smooth one.

Specular part: SC = D F G2 / (4 cos θ_i cos θ_o), D from the measured slope density, Smith masking from the same density, so
that energy and reciprocity hold by construction. Diffuse part: coupled to what the facets let through (Kelemen &
Szirmay-Kalos), so that the total reflectance at the measuring geometry is the measured one, exactly. The choices of the
patent and of other sources are modes by name; what they break is found by the checks.

References
----------
Patent US 9,395,299 (CRF), steps c to h; Heitz 2014 (JCGT 3(2)); Kelemen & Szirmay-Kalos 2001 (Eurographics short papers);
Walter 2007 (EGSR) for transmission; Kulla & Conty 2017 (SIGGRAPH course) for the light reflected more than once.
"""

from __future__ import annotations

import numpy as np
import xarray as xr

from brdfpipe import hemisphere, vocabulary
from brdfpipe.bsdf.microfacet import energy, transmission
from brdfpipe.bsdf.microfacet.microsurface import MASKINGS, NOT_PHYSICAL, Microsurface, ModelError
from brdfpipe.bsdf.microfacet.model import CRF_DIFFUSE_SHARE, Model
from brdfpipe.bsdf.microfacet.reflectance import diffuse_for, total_reflectance_at, with_albedo
from brdfpipe.bsdf.representations.microfacet import Microfacet
from brdfpipe.bsdf.representations.smooth import Smooth
from brdfpipe.facets.facet_dataset import azimuthal_average
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.geometry import Array
from brdfpipe.masking.liu import energy_limit
from brdfpipe.optics.index import interpolate_index, refractive_index

DIFFUSE_MODES = ("coupled", "crf", "none")

MULTIPLE_SCATTERING_MODES = ("none", "compensated")

RECIPES = {"crf": {"masking": "crf", "diffuse": "crf", "multiple_scattering": "none"}}
"""Choices that belong together, by the name of their source."""

SPECULAR_TRAP = 5.0
"""Half angle of the gloss trap of a sphere instrument, unless the spectrum says otherwise [degree]."""


def build(
    facets: xr.Dataset,
    *,
    index: xr.Dataset | float | str,
    spectrum: xr.Dataset | None = None,
    masking: str | None = None,
    diffuse: str | None = None,
    multiple_scattering: str | None = None,
    recipe: str | None = None,
    isotropic: bool = False,
    transparent: bool = False,
) -> xr.Dataset:
    """Microfacet BSDF of a surface.

    Parameters
    ----------
    facets : kind ``facets``, isotropic, with a lay, or perfectly flat (:func:`brdfpipe.facets.flat`)
    index : kind ``index``, a number or a plastic's name; the refractive index of the body, against air. A metal's has k > 0
    spectrum : kind ``spectrum``; the total reflectance at incidence ``theta_i``, specular included (``sci``), or excluded
        (``sce``): then what the facets mirror into the instrument's gloss trap, a cone of half angle ``specular_trap``
        (attribute, 5 degree by default) about the mirror direction, is added. Without it the specular part stands alone
    masking : one of :data:`brdfpipe.bsdf.microfacet.microsurface.MASKINGS`; ``height-correlated`` by default
    diffuse : ``coupled`` (default), ``crf`` (the patent's: R less the facets' share, under the masking of a flat distribution)
        or ``none``
    multiple_scattering : ``none`` (default): light that leaves the facets only after a second reflection is lost, as in the plain
        model; ``compensated``: it comes back, diffuse, coloured by the average reflectance of the facets once more
    recipe : ``crf`` sets the patent's choices together; a choice given beside it must be the same
    isotropic : average a surface with a lay over azimuth, with a warning
    transparent : the interface of a clear body: light passes to the other side and comes from there too (θ > 90 degree)

    Returns
    -------
    Dataset of kind ``bsdf``, representation ``microfacet``; ``smooth`` of a flat surface, whose mirror image is no density but
    a share of the light

    Raises
    ------
    ModelError : an unknown mode, or choices that exclude each other.
    VocabularyError : a dataset of the wrong kind.

    Notes
    -----
    f = SC + d′ (1 − E(θ_i)) (1 − E(θ_o)) / [π (1 − Ē)] with E the directional albedo of SC, Ē = 2 ∫ E μ dμ and
    d′ = (R − E(θ_m)) / (1 − E(θ_m)). Where R < E(θ_m), d′ is clamped at 0, flagged, and a warning names the wavelengths.
    Compensated, SC also holds F_ms (1 − E₁(θ_i)) (1 − E₁(θ_o)) / [π (1 − Ē₁)], E₁ the albedo of perfect mirrors and
    F_ms = F̄² Ē₁ / (1 − F̄ (1 − Ē₁)), F̄ = 2 ∫ F μ dμ: exactly what is missing where F = 1.
    """
    vocabulary.validate(facets, "facets")
    index = vocabulary.validate(index, "index") if isinstance(index, xr.Dataset) else refractive_index(index)
    chosen = _choices(recipe, masking=masking, diffuse=diffuse, multiple_scattering=multiple_scattering)
    if spectrum is not None:
        vocabulary.validate(spectrum, "spectrum")
    n, k, wavelength, held = _index_on(index, None if spectrum is None else spectrum["wavelength"].values)
    if np.any((n < 1) & (k == 0)):
        raise ModelError(
            f"the refractive index is {np.min(n):g} somewhere, below that of air, and nothing absorbs; accepted: n >= 1, or k > 0"
        )
    if transparent:
        _check_transparent(chosen, spectrum, n, k, facets["slope_density"].size > 0)
    surface = azimuthal_average(facets) if isotropic else facets
    if chosen["masking"] == "liu" and surface["slope_density"].ndim == 2:
        raise ModelError(
            "masking 'liu' knows isotropic surfaces alone, and this one has a lay; set `surface.isotropic: true` or another `model.masking`"
        )
    bsdf = _surface_of(surface)
    bsdf.attrs = {
        "representation": Microfacet.name if "slope_density" in bsdf else Smooth.name,
        "masking": chosen["masking"],
        "diffuse_mode": chosen["diffuse"],
        "multiple_scattering": chosen["multiple_scattering"],
        "transmission": "interface" if transparent else "none",
        "band": facets.attrs["band"],
    }
    if recipe is not None:
        bsdf.attrs["recipe"] = recipe
    if wavelength is not None:
        bsdf = bsdf.assign_coords(wavelength=wavelength)
    spectral = () if n.ndim == 0 else ("wavelength",)
    bsdf = vocabulary.add_warning(bsdf.assign(n=(spectral, n), k=(spectral, k)), *held)
    theta_m = 8.0 if spectrum is None else float(spectrum.attrs["theta_i"])
    bsdf = with_albedo(bsdf, theta_m)
    bsdf = _with_diffuse(bsdf, spectrum, theta_m)
    bsdf = _with_source_warning(bsdf)
    if surface is not facets:
        bsdf = vocabulary.add_warning(bsdf, *vocabulary.warnings(surface))
    return vocabulary.label(bsdf, "bsdf")


# --- what was chosen


def _choices(recipe: str | None, **given: str | None) -> dict[str, str]:
    accepted = {
        "masking": MASKINGS,
        "diffuse": DIFFUSE_MODES,
        "multiple_scattering": MULTIPLE_SCATTERING_MODES,
    }
    if recipe is not None and recipe not in RECIPES:
        raise ModelError(f"unknown recipe {recipe!r}; accepted: {', '.join(RECIPES)}; set `model.recipe`")
    chosen = {"masking": "height-correlated", "diffuse": "coupled", "multiple_scattering": "none"}
    chosen |= RECIPES[recipe] if recipe else {}
    for name, value in given.items():
        if value is None:
            continue
        if value not in accepted[name]:
            raise ModelError(f"unknown {name} {value!r}; accepted: {', '.join(accepted[name])}; set `model.{name}`")
        if recipe and value != chosen[name]:
            raise ModelError(
                f"recipe {recipe!r} has {name} {chosen[name]!r}, but {value!r} was asked for; drop `model.recipe` or `model.{name}`"
            )
        chosen[name] = value
    if chosen["multiple_scattering"] == "compensated" and chosen["masking"] not in ("height-correlated", "separable"):
        raise ModelError(
            f"what masking {chosen['masking']!r} loses cannot be compensated: it does not keep energy; "
            "set `model.masking: height-correlated`"
        )
    return chosen


def _check_transparent(chosen: dict[str, str], spectrum: xr.Dataset | None, n: Array, k: Array, rough: bool) -> None:
    if rough and np.any(n == 1):
        raise ModelError("a rough interface to a body of index 1 is no interface; accepted: n > 1, or a flat surface")
    if spectrum is not None:
        raise ModelError("a transparent interface has no diffuse base; leave out the `spectrum`, or the transparency")
    if np.any(k > 0):
        raise ModelError(
            f"the body of a transparent interface absorbs (k up to {k.max():g}); give a real index, and the absorption to the slab"
        )
    if chosen["masking"] not in transmission.MASKING:
        raise ModelError(
            f"masking {chosen['masking']!r} is not defined through an interface; accepted: {', '.join(transmission.MASKING)}"
        )
    if chosen["multiple_scattering"] != "none":
        raise ModelError(
            "multiple scattering is compensated for opaque bodies alone; set `model.multiple_scattering: none`"
        )


def _with_source_warning(bsdf: xr.Dataset) -> xr.Dataset:
    """Say from which incidence on a source's own masking reflects more than it receives."""
    masking = bsdf.attrs["masking"]
    if masking not in NOT_PHYSICAL or "slope_density" not in bsdf:
        return bsdf
    surface = Microsurface.of(bsdf)
    if masking == "liu":
        assert isinstance(surface.density, RadialDensity)
        return vocabulary.add_warning(bsdf, str(energy_limit(surface.density, surface.liu)))
    theta = np.arange(0.5, 89.75, 0.5)
    mirrors = energy.directional_albedo(
        surface, masking, np.ones(1), np.zeros(1), theta, reflectance=energy.perfect_mirror
    )
    beyond = theta[mirrors[:, 0] > 1.001]
    if beyond.size == 0:
        return bsdf
    return vocabulary.add_warning(
        bsdf,
        f"masking {masking!r} {NOT_PHYSICAL[masking]}: perfect mirrors would reflect more than they receive from {beyond[0]:g}° "
        "on; set `model.masking: height-correlated` for steeper light",
    )


_KEPT = ("slope_density", "lambda_smith", "lay")


def _surface_of(facets: xr.Dataset) -> xr.Dataset:
    if facets["slope_density"].size == 0:
        return xr.Dataset()
    kept = facets[[name for name in _KEPT if name in facets and (name != "lay" or facets["slope_density"].ndim == 2)]]
    used = {dim for name in kept.data_vars for dim in kept[name].dims}
    kept = kept.drop_vars([name for name in kept.coords if name not in used])
    return xr.Dataset(
        {name: (field.dims, field.values) for name, field in kept.data_vars.items()},
        coords={name: (field.dims, field.values, _own(field)) for name, field in kept.coords.items()},
    )


def _own(coordinate: xr.DataArray) -> dict[str, object]:
    """What a coordinate carries beside its unit and name: the scale of a slope axis."""
    return {name: value for name, value in coordinate.attrs.items() if name not in ("units", "long_name")}


# --- what is left to the base


def _with_diffuse(bsdf: xr.Dataset, spectrum: xr.Dataset | None, theta_m: float) -> xr.Dataset:
    bare = bsdf.assign(diffuse=0.0, theta_m=theta_m)
    if spectrum is None or bsdf.attrs["diffuse_mode"] == "none":
        return bare
    model = Model.of(bare, None)
    measured = spectrum["total_reflectance"].values.astype(float)
    trapped = _trapped(model, spectrum, theta_m)
    total = measured + trapped
    wanted = diffuse_for(model, total, theta_m)
    clamped = wanted < 0
    quality = np.where(clamped, vocabulary.quality("clamped"), vocabulary.quality("measured")).astype(np.int8)
    bsdf = bsdf.assign(
        diffuse=("wavelength", np.maximum(wanted, 0.0)),
        diffuse_quality=("wavelength", quality),
        total_reflectance=("wavelength", total),
        theta_m=theta_m,
    )
    if spectrum.attrs["geometry"] == "sce":
        bsdf = vocabulary.add_history(
            bsdf,
            f"the specular was excluded: what the facets mirror into a gloss trap of half angle {trap_of(spectrum):g}°, "
            f"{float(np.mean(trapped)):.4f} of the light, was added to the measured reflectance",
        )
    if bsdf.attrs["diffuse_mode"] == "crf":
        bsdf = vocabulary.add_history(
            bsdf,
            f"the patent's diffuse part is masked like a flat distribution of facets, which keeps {CRF_DIFFUSE_SHARE:.4f} of it: the "
            "total reflectance is not the measured one",
        )
    if clamped.any():
        where = spectrum["wavelength"].values[clamped]
        deficit = float((total_reflectance_at(model, theta_m) - total)[clamped].max())
        bsdf = vocabulary.add_warning(
            bsdf,
            f"the total reflectance lies up to {deficit:.4f} below the specular albedo of the facets at {where.size} wavelengths "
            f"({where.min():g} to {where.max():g} nm); the diffuse part was set to 0 there. Was the specular excluded "
            "(`spectrum.geometry: sce`), or is the refractive index or the surface another one?",
        )
    return bsdf


def trap_of(spectrum: xr.Dataset) -> float:
    """Half angle of the gloss trap that excluded the specular [degree]."""
    return float(spectrum.attrs.get("specular_trap", SPECULAR_TRAP))


def _trapped(model: Model, spectrum: xr.Dataset, theta_m: float) -> Array:
    """Light that the facets mirror into the gloss trap, (wavelength or 1,); 0 where the specular was included.

    A trap takes the light within a few degrees of the mirror direction; a rough surface mirrors most of it elsewhere, where
    the instrument collects it as if it were diffuse.
    """
    if spectrum.attrs["geometry"] != "sce":
        return np.zeros(1)
    if model.surface is None:
        return total_reflectance_at(model, theta_m)
    theta, phi, weight = hemisphere.around_mirror(theta_m, model.surface.median_slope, trap_of(spectrum))
    return np.asarray(weight @ model.evaluate(np.full_like(theta, theta_m), np.zeros_like(phi), theta, phi))


def _index_on(index: xr.Dataset, wavelength: Array | None) -> tuple[Array, Array, Array | None, list[str]]:
    """n and k on the wavelengths of the model, scalars where they do not depend on wavelength, and what to warn about."""
    n, k = index["n"].values.astype(float), index["k"].values.astype(float)
    if np.ptp(n) == 0 and np.ptp(k) == 0:
        return n[0], k[0], wavelength, []
    known = index["wavelength"].values
    if wavelength is None:
        return n, k, known, []
    n, k = interpolate_index(index, np.clip(wavelength, known[0], known[-1]))
    if known[0] <= wavelength[0] and wavelength[-1] <= known[-1]:
        return n, k, wavelength, []
    held = (
        f"the refractive index is known from {known[0]:g} to {known[-1]:g} nm and was held constant beyond, out to "
        f"{wavelength[0]:g} and {wavelength[-1]:g} nm; give a table that covers the spectrum"
    )
    return n, k, wavelength, [held]
