"""The microfacet BSDF of a rough interface over a diffuse base, or of a perfectly smooth one.

The choices of the patent and of other sources are modes by name; the checks find the laws that they violate.

References
----------
Patent US 9,395,299 (CRF), steps c to h; Heitz 2014 (JCGT 3(2)); Kelemen & Szirmay-Kalos 2001 (Eurographics short papers);
Walter 2007 (EGSR) for transmission; Kulla & Conty 2017 (SIGGRAPH course) for the light reflected more than once.
"""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from brdfpipe import vocabulary
from brdfpipe.bsdf.microfacet import energy, transmission
from brdfpipe.bsdf.microfacet.gloss_trap import trap_of, trapped_light
from brdfpipe.bsdf.microfacet.microsurface import NOT_PHYSICAL, Microsurface, ModelError
from brdfpipe.bsdf.microfacet.model import (
    CRF_DIFFUSE_SHARE,
    Model,
    diffuse_for,
    total_reflectance_at,
    with_albedo,
    without_lay,
)
from brdfpipe.bsdf.microfacet.second_reflection import LEAST_SHARE, lost_share
from brdfpipe.bsdf.representations.microfacet import Microfacet, Smooth
from brdfpipe.errors import BrdfpipeError
from brdfpipe.facets.facet_dataset import azimuthal_average
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.geometry import Array
from brdfpipe.masking.liu import energy_limit
from brdfpipe.masking.modes import (
    LARGEST_COMPARED,
    MASKING_ADVISED,
    MASKINGS_OF_MULTIPLE_SCATTERING,
    MASKINGS_WITHOUT_LAY,
    MODEL_DEFAULTS,
    MODES,
    MULTIPLE_SCATTERING_ADVISED,
    RECIPES,
    SMITH_ERROR,
    SMITH_MASKINGS,
    allows_several_reflections,
)
from brdfpipe.optics.fresnel_equations import mean_fresnel
from brdfpipe.optics.index import interpolate_index, refractive_index

WAVELENGTHS = np.arange(380.0, 781.0, 10.0)
"""Wavelengths of a BSDF that depends on them, and whose index and spectrum do not set them [nm]."""

_LIMIT_THETA = np.concatenate([np.arange(0.0, 84.0, 2.0), np.arange(84.0, 89.5, 0.5), [89.5, 89.7, 89.85, 89.95, 90.0]])


def build(
    facets: xr.Dataset,
    *,
    index: xr.Dataset | float | str,
    spectrum: xr.Dataset | None = None,
    visibility: xr.Dataset | None = None,
    interreflection: xr.Dataset | None = None,
    masking: str | None = None,
    diffuse: str | None = None,
    multiple_scattering: str | None = None,
    recipe: str | None = None,
    isotropic: bool = False,
    transparent: bool = False,
    surface_alone: bool = False,
) -> xr.Dataset:
    """Microfacet BSDF of a surface.

    Parameters
    ----------
    facets : kind ``facets``, isotropic, with a lay, or perfectly flat (:func:`brdfpipe.facets.flat`)
    index : kind ``index``, a number or a plastic's name; the refractive index of the body relative to air. A metal has k > 0
    spectrum : kind ``spectrum``; the total reflectance at incidence ``theta_i``, specular included (``sci``), or excluded (``sce``)
        by a gloss trap of half angle ``specular_trap`` (attribute, 5 degree by default); the light that the facets mirror into
        the trap is then added. Without a spectrum there is no diffuse part
    visibility : kind ``visibility``, traced on the heights of the facets; needed for masking ``measured``. Masking ``auto`` follows its
        attribute ``masking``
    interreflection : kind ``interreflection``, traced on the height map of the facets; needed for multiple scattering ``measured``. ``auto``
        follows its attribute ``multiple_scattering``, and without it Smith's surface
    masking, diffuse, multiple_scattering : names of :data:`brdfpipe.masking.modes.MODES`; the first of each is the default
    recipe : ``crf`` sets the patent's modes together; other given modes must agree
    isotropic : average a surface with a lay over azimuth, with a warning
    transparent : the interface of a clear body, with light on the other side too (θ > 90 degree)
    surface_alone : leave out the table of the albedo, most of the work, and the light from below the surface. The dataset is not complete:
        :func:`with_base` adds both, :func:`brdfpipe.bsdf.microfacet.model.with_reflections` the light that is reflected more than once

    Returns
    -------
    Dataset of kind ``bsdf``, representation ``microfacet``; ``smooth`` for a flat surface, whose mirror reflection is not part of the
    BSDF

    Raises
    ------
    ModelError : an unknown mode, or modes that exclude each other.
    VocabularyError : a dataset of the wrong kind.

    Notes
    -----
    ``docs/model.md`` has the equations. Where R < E(θ_m), the diffuse part is clamped at 0, flagged, and a warning names the wavelengths.
    """
    vocabulary.validate(facets, "facets")
    index = vocabulary.validate(index, "index") if isinstance(index, xr.Dataset) else refractive_index(index)
    chosen = _choices(recipe, masking=masking, diffuse=diffuse, multiple_scattering=multiple_scattering)
    chosen["masking"], *choices = _resolved_masking(chosen, visibility, transparent)
    if spectrum is not None:
        vocabulary.validate(spectrum, "spectrum")
    n, k, wavelength, warnings = index_on(index, None if spectrum is None else spectrum["wavelength"].values)
    if np.any((n < 1) & (k == 0)):
        raise ModelError(
            f"the refractive index falls to {np.min(n):g}, below that of air, without absorption; accepted: n >= 1, or k > 0"
        )
    if transparent:
        _check_transparent(chosen, spectrum, n, k, facets["slope_density"].size > 0)
    surface = azimuthal_average(facets) if isotropic else facets
    if chosen["masking"] in MASKINGS_WITHOUT_LAY and surface["slope_density"].ndim == 2:
        raise ModelError(
            f"masking {chosen['masking']!r} is for isotropic surfaces, and this one has a lay; set `surface.isotropic: true` or another "
            "`model.masking`"
        )
    bsdf = _surface_of(surface)
    chosen["multiple_scattering"], choice = _resolved_multiple_scattering(
        chosen, interreflection, bsdf, n, k, transparent
    )
    bsdf.attrs = {
        "representation": Microfacet.name if "slope_density" in bsdf else Smooth.name,
        "masking": chosen["masking"],
        "diffuse_mode": chosen["diffuse"],
        "multiple_scattering": chosen["multiple_scattering"],
        "transmission": "interface" if transparent else "none",
        "band": facets.attrs["band"],
    }
    if visibility is not None and "smith_error" in visibility:
        bsdf.attrs[MASKING_ADVISED] = visibility.attrs["masking"]
        errors = visibility["smith_error"].sel(region="peak", theta_i=slice(None, LARGEST_COMPARED)).values
        bsdf.attrs[SMITH_ERROR] = float(errors[np.abs(errors).argmax()])
    if choice:
        bsdf.attrs[MULTIPLE_SCATTERING_ADVISED] = chosen["multiple_scattering"]
    if recipe is not None:
        bsdf.attrs["recipe"] = recipe
    if chosen["masking"] == "measured" and "slope_density" in bsdf:
        bsdf = with_visibility(bsdf, visibility)
    for text in filter(None, [*choices, choice]):
        bsdf = vocabulary.add_history(bsdf, text)
    if wavelength is not None:
        bsdf = bsdf.assign_coords(wavelength=wavelength)
    spectral = () if n.ndim == 0 else ("wavelength",)
    bsdf = vocabulary.add_warning(bsdf.assign(n=(spectral, n), k=(spectral, k)), *warnings)
    if chosen["multiple_scattering"] == "measured" and "slope_density" in bsdf:
        bsdf = with_interreflection(bsdf, interreflection)
    if surface is not facets:
        bsdf = vocabulary.add_warning(bsdf, *vocabulary.warnings(surface))
    return bsdf if surface_alone else with_base(bsdf, spectrum)


def with_base(surface: xr.Dataset, spectrum: xr.Dataset | None) -> xr.Dataset:
    """The ``bsdf`` dataset of a surface alone (:func:`build`): with the table of its albedo, and the base that closes the spectrum."""
    theta_m = 8.0 if spectrum is None else float(spectrum.attrs["theta_i"])
    bsdf = _with_diffuse(with_albedo(surface, theta_m), spectrum, theta_m)
    return vocabulary.label(_with_source_warning(bsdf), "bsdf")


# --- modes


def _choices(recipe: str | None, **given: str | None) -> dict[str, str]:
    if recipe is not None and recipe not in RECIPES:
        raise ModelError(f"unknown recipe {recipe!r}; accepted: {', '.join(RECIPES)}; set `model.recipe`")
    chosen = MODEL_DEFAULTS | (RECIPES[recipe] if recipe else {})
    for name, value in given.items():
        if value is None:
            continue
        if value not in MODES[name]:
            raise ModelError(f"unknown {name} {value!r}; accepted: {', '.join(MODES[name])}; set `model.{name}`")
        if recipe and value != chosen[name]:
            raise ModelError(
                f"recipe {recipe!r} has {name} {chosen[name]!r}, but {name} is {value!r}; drop `model.recipe` or `model.{name}`"
            )
        chosen[name] = value
    accepted = MASKINGS_OF_MULTIPLE_SCATTERING[chosen["multiple_scattering"]]
    if chosen["masking"] not in accepted:
        raise ModelError(
            f"`multiple_scattering: {chosen['multiple_scattering']}` is defined for Smith's masking, and masking is {chosen['masking']!r}; "
            f"accepted: {' or '.join(accepted)}; set `model.masking`"
        )
    return chosen


def _resolved_masking(chosen: dict[str, str], visibility: xr.Dataset | None, transparent: bool) -> tuple[str, str]:
    """The masking that ``auto`` means, and a statement where heights decided it."""
    if chosen["masking"] != "auto":
        return chosen["masking"], ""
    if visibility is None:
        return SMITH_MASKINGS[0], ""
    traced, reason = vocabulary.validate(visibility, "visibility").attrs["masking"], visibility.attrs["reason"]
    if traced == "measured" and transparent:
        return SMITH_MASKINGS[
            0
        ], f"masking {SMITH_MASKINGS[0]}, although {reason}: a transparent interface needs Smith's masking"
    return traced, f"masking {traced}: {reason}"


def _resolved_multiple_scattering(
    chosen: dict[str, str],
    interreflection: xr.Dataset | None,
    surface: xr.Dataset,
    n: Array,
    k: Array,
    transparent: bool,
) -> tuple[str, str]:
    """The mode that ``auto`` means, and a statement where the heights or Smith's surface decided it."""
    mode = chosen["multiple_scattering"]
    if mode != "auto":
        return mode, ""
    allowed = allows_several_reflections(chosen["masking"], chosen["diffuse"])
    if transparent or not allowed or "slope_density" not in surface:
        return "none", ""
    if interreflection is None and "slope" not in surface.dims:
        # The weights that close its energy at each azimuth do not converge for every density.
        mode, reason = "none", "facets with a lay, which no map shows, are not relied upon for it"
    elif interreflection is None:
        mode, reason = smith_choice(Microsurface.of(surface), np.atleast_1d(n), np.atleast_1d(k))
    else:
        interreflection = vocabulary.validate(interreflection, "interreflection")
        mode, reason = interreflection.attrs["multiple_scattering"], interreflection.attrs["reason"]
    return mode, f"multiple scattering {mode}: {reason}"


def smith_choice(surface: Microsurface, n: Array, k: Array) -> tuple[str, str]:
    """Multiple scattering ``directional`` or ``none``, by the light that Smith's surface reflects more than once, and the reason."""
    share, theta = lost_share(without_lay(surface), n, k)
    mode = "directional" if share > LEAST_SHARE else "none"
    if share == 0:
        return mode, f"after Smith, facets reflect less than {LEAST_SHARE:.0%} of the light more than once"
    return mode, f"after Smith, facets reflect {share:.1%} of the light more than once at {theta:g}°"


def _check_transparent(chosen: dict[str, str], spectrum: xr.Dataset | None, n: Array, k: Array, rough: bool) -> None:
    problem = ""
    if rough and np.any(n == 1):
        problem = "the index of the body below a rough interface is 1; accepted: n > 1, or a flat surface"
    elif spectrum is not None:
        problem = "a transparent interface has no diffuse base; leave out the `spectrum`, or the transparency"
    elif np.any(k > 0):
        problem = f"the body of a transparent interface absorbs (k up to {k.max():g}); give a real index, and the absorption to the slab"
    elif chosen["masking"] not in transmission.MASKING:
        accepted = ", ".join(transmission.MASKING)
        problem = f"masking {chosen['masking']!r} is not defined for transmission; accepted: {accepted}"
    elif chosen["multiple_scattering"] not in ("auto", "none"):
        problem = "multiple scattering is compensated for opaque bodies alone; set `model.multiple_scattering: none`"
    if problem:
        raise ModelError(problem)


def _with_source_warning(bsdf: xr.Dataset) -> xr.Dataset:
    """Add a warning with the incidence from which a masking mode violates energy conservation."""
    masking = bsdf.attrs["masking"]
    if masking not in NOT_PHYSICAL or "slope_density" not in bsdf:
        return bsdf
    surface = Microsurface.of(bsdf)
    if masking == "liu":
        assert isinstance(surface.density, RadialDensity)
        return vocabulary.add_warning(bsdf, str(energy_limit(surface.density, surface.liu)))
    theta = np.arange(0.5, 89.75, 0.5)
    excessive = theta[energy.mirror_albedo(surface, masking, theta) > 1.001]
    if excessive.size == 0:
        return bsdf
    return vocabulary.add_warning(
        bsdf,
        f"masking {masking!r} {NOT_PHYSICAL[masking]}: perfect mirrors would reflect more than they receive from {excessive[0]:g}° "
        "on; set `model.masking: height-correlated` for larger angles of incidence",
    )


def _surface_of(facets: xr.Dataset) -> xr.Dataset:
    """Slope density, masking and lay alone; of the coordinates' attributes only the scale of a slope axis is copied."""
    if facets["slope_density"].size == 0:
        return xr.Dataset()
    names = [
        "slope_density",
        "lambda_smith",
        *(["lay"] if facets["slope_density"].ndim == 2 and "lay" in facets else []),
    ]
    coords = {}
    for dim in dict.fromkeys(dim for name in names for dim in facets[name].dims):
        attrs = {key: value for key, value in facets[dim].attrs.items() if key not in ("units", "long_name")}
        coords[dim] = (dim, facets[dim].values, attrs)
    return xr.Dataset({name: (facets[name].dims, facets[name].values) for name in names}, coords)


def with_visibility(bsdf: xr.Dataset, visibility: xr.Dataset | None) -> xr.Dataset:
    """Add the traced visibility of the facets, limited so that perfect mirrors gain no light."""
    if visibility is None or "visibility_ratio" not in visibility:
        raise ModelError(
            "masking 'measured' needs the visibility of the facets, traced on their heights "
            "(`brdfpipe.masking.visibility_choice.choose`); give `visibility`, or set `model.masking: height-correlated`"
        )
    vocabulary.validate(visibility, "visibility")
    for name in ("visibility_ratio", "single_ratio"):
        if name in visibility:
            ratio = visibility[name]
            axes = {dim: (dim, ratio[dim].values) for dim in map(str, ratio.dims)}
            bsdf = bsdf.assign_coords(axes).assign({name: (ratio.dims, ratio.values)})
    # The uncertainty of the table may return too much light; a factor for either direction keeps it reciprocal.
    excess = np.maximum(energy.mirror_albedo(Microsurface.of(bsdf), "measured", _LIMIT_THETA), 1.0)
    if excess.max() == 1:
        return bsdf
    around = np.maximum(excess, np.maximum(np.append(excess[1:], 1.0), np.append(1.0, excess[:-1])))
    bsdf = bsdf.assign_coords(limit_theta=_LIMIT_THETA).assign(visibility_limit=("limit_theta", 1 / around))
    return vocabulary.add_history(
        bsdf,
        f"the traced visibility was reduced by up to {1 - 1 / excess.max():.4f}, at an incidence of {_LIMIT_THETA[excess.argmax()]:g}°, so that "
        "perfect mirrors reflect no more than they receive",
    )


def with_interreflection(bsdf: xr.Dataset, interreflection: xr.Dataset | None) -> xr.Dataset:
    """Add the traced light that is reflected more than once; of another index it changes as the squared mean reflectance does."""
    if interreflection is None or "second_reflection" not in interreflection:
        raise ModelError(
            "multiple scattering 'measured' needs the light that the height map reflects more than once, traced on it "
            "(`brdfpipe.bsdf.microfacet.interreflection.choose`); give `interreflection`, or set `model.multiple_scattering: directional`"
        )
    traced = vocabulary.validate(interreflection, "interreflection")
    if bsdf["slope_density"].ndim == 1 and "second_plane" in traced.dims:
        traced = traced.mean("second_plane")
    if "wavelength" in traced.dims:
        if bsdf["n"].ndim == 0:
            traced = traced.mean("wavelength")
        else:
            traced = traced.interp(wavelength=np.clip(bsdf["wavelength"].values, *traced["wavelength"].values[[0, -1]]))
            traced = traced.assign_coords(wavelength=bsdf["wavelength"].values)
    index = [[np.atleast_1d(one[name].values) for name in ("n", "k")] for one in (bsdf, traced)]
    factor = (mean_fresnel(*index[0]) / mean_fresnel(*index[1])) ** 2
    scale = xr.DataArray(factor, dims="wavelength") if bsdf["n"].ndim else float(factor[0])
    return bsdf.assign(second_reflection=traced["second_reflection"] * scale, second_slope=traced["second_slope"])


def interreflection_of(bsdf: xr.Dataset) -> xr.Dataset | None:
    """The traced light of a ``bsdf`` dataset, representation ``microfacet``, for one of other facets or of another index; None without it."""
    if bsdf.attrs["multiple_scattering"] != "measured" or "second_reflection" not in bsdf:
        return None
    traced = bsdf[["n", "k", "second_reflection", "second_slope"]]
    traced.attrs = {"multiple_scattering": "measured", "reason": "of the prediction"}
    return vocabulary.label(traced, "interreflection")


# --- the diffuse base


def _with_diffuse(bsdf: xr.Dataset, spectrum: xr.Dataset | None, theta_m: float) -> xr.Dataset:
    bare = bsdf.assign(diffuse=0.0, theta_m=theta_m)
    if spectrum is None or bsdf.attrs["diffuse_mode"] == "none":
        return bare
    model = Model.of(bare, None)
    trapped = trapped_light(model, spectrum, theta_m)
    total = spectrum["total_reflectance"].values.astype(float) + trapped
    diffuse = diffuse_for(model, total, theta_m)
    bsdf = with_diffuse_reflectance(bsdf, diffuse, total).assign(theta_m=theta_m)
    if spectrum.attrs["geometry"] == "sce":
        bsdf = vocabulary.add_history(
            bsdf,
            f"specular excluded: the light mirrored into a gloss trap of half angle {trap_of(spectrum):g}°, "
            f"{float(np.mean(trapped)):.4f} of the incident light, was added to the measured reflectance",
        )
    if bsdf.attrs["diffuse_mode"] == "crf":
        bsdf = vocabulary.add_history(
            bsdf,
            f"the patent's masking of the diffuse part leaves {CRF_DIFFUSE_SHARE:.4f} of it: the total reflectance is not the measured one",
        )
    if not (diffuse < 0).any():
        return bsdf
    below = total_reflectance_at(model, theta_m) - total
    return with_clamping_warning(bsdf, spectrum, diffuse < 0, below, "specular albedo of the facets")


def with_diffuse_reflectance(bsdf: xr.Dataset, diffuse: Array, total: Array) -> xr.Dataset:
    """Add the diffuse reflectance, 0 where it would be negative, with its flags, and the total reflectance, (wavelength,) each."""
    quality = np.where(diffuse < 0, vocabulary.quality("clamped"), vocabulary.quality("measured")).astype(np.int8)
    return bsdf.assign(
        diffuse=("wavelength", np.maximum(diffuse, 0.0)),
        diffuse_quality=("wavelength", quality),
        total_reflectance=("wavelength", total),
    )


def doubted_geometry(spectrum: xr.Dataset) -> str:
    """What of the geometry of a spectrum to check where its reflectance is too small; nothing where the specular is stated to be excluded."""
    return (
        "" if spectrum.attrs["geometry"] == "sce" else "whether the specular was excluded (`spectrum.geometry: sce`), "
    )


def with_clamping_warning(
    bsdf: xr.Dataset, spectrum: xr.Dataset, clamped: NDArray[np.bool_], deficit: Array, surface_reflectance: str
) -> xr.Dataset:
    """Add a warning where the surface alone reflects more than the spectrum; ``deficit`` is by how much, (wavelength,)."""
    if not clamped.any():
        return bsdf
    where = spectrum["wavelength"].values[clamped]
    return vocabulary.add_warning(
        bsdf,
        f"the total reflectance is up to {float(deficit[clamped].max()):.4f} below the {surface_reflectance} at {where.size} wavelengths "
        f"({where.min():g} to {where.max():g} nm); the diffuse part was set to 0 there. Check {doubted_geometry(spectrum)}"
        "the refractive index and the surface.",
    )


def wavelengths_of(
    spectrum: xr.Dataset | None, index: xr.Dataset, wavelength: ArrayLike | None, error: type[BrdfpipeError]
) -> Array:
    """Wavelengths [nm] of a BSDF that depends on them: of the spectrum, given, of the index, or :data:`WAVELENGTHS`; ``error`` refuses others."""
    if spectrum is not None:
        if wavelength is not None:
            raise error("the wavelengths are those of the spectrum; leave out `wavelength`")
        return np.asarray(spectrum["wavelength"].values, dtype=float)
    if wavelength is None:
        constant = np.ptp(index["n"].values) == 0 and np.ptp(index["k"].values) == 0
        return WAVELENGTHS if constant else np.asarray(index["wavelength"].values, dtype=float)
    given = np.atleast_1d(np.asarray(wavelength, dtype=float))
    if given.ndim != 1 or given.size == 0 or not (given > 0).all() or not (np.diff(given) > 0).all():
        raise error(
            "`wavelength` is not an increasing list of wavelengths in nm; accepted: one number or several, above 0"
        )
    return given


def index_on(index: xr.Dataset, wavelength: Array | None) -> tuple[Array, Array, Array | None, list[str]]:
    """n and k on given wavelengths, scalars if they do not depend on wavelength; the wavelengths; and warnings."""
    n, k = index["n"].values.astype(float), index["k"].values.astype(float)
    if np.ptp(n) == 0 and np.ptp(k) == 0:
        return n[0], k[0], wavelength, []
    known = index["wavelength"].values
    if wavelength is None:
        return n, k, known, []
    n, k = interpolate_index(index, np.clip(wavelength, known[0], known[-1]))
    if known[0] <= wavelength[0] and wavelength[-1] <= known[-1]:
        return n, k, wavelength, []
    warning = (
        f"the refractive index is known from {known[0]:g} to {known[-1]:g} nm and was held constant beyond; give a table that covers "
        f"{wavelength[0]:g} to {wavelength[-1]:g} nm"
    )
    return n, k, wavelength, [warning]
