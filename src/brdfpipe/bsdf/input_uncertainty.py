"""The changes of a predicted BSDF that the uncertainties of its inputs make, to first order and without building it anew.

Each independent change of an input by one standard uncertainty changes variables of the dataset; :mod:`brdfpipe.bsdf.source_changes`
evaluates what follows. A changed slope density has its own masking and its own directional albedo; the diffuse part changes with it, so
that the total reflectance stays the measured one. The light that is reflected more than once, traced visibility over Smith's, and roughness
finer than facets are taken as unchanged.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, TypeAlias

import numpy as np
import xarray as xr

from brdfpipe import hemisphere, vocabulary
from brdfpipe.bsdf.base import Representation
from brdfpipe.bsdf.change_variables import (
    DIMENSION,
    MODEL,
    MODEL_INCIDENCES,
    MODEL_REGIONS,
    NOT_STATED,
    OF_MAP,
    SOURCE,
    between_incidences,
)
from brdfpipe.bsdf.microfacet.gloss_trap import trapped_light
from brdfpipe.bsdf.microfacet.model import Model
from brdfpipe.bsdf.microfacet.phase_variance import unresolved_rms_height
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.source_changes import SourceChanges
from brdfpipe.bsdf.wave.height_transform import log_transform
from brdfpipe.bsdf.wave.roughness import roughness
from brdfpipe.facets import planar_density
from brdfpipe.facets.density_changes import CHANGES
from brdfpipe.facets.facet_dataset import azimuthal_average
from brdfpipe.facets.planar_density import PlanarDensity
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.geometry import Array
from brdfpipe.masking.smith import excess_slope
from brdfpipe.optics.fresnel_equations import fresnel
from brdfpipe.psd.spectrum_dataset import NOISE_CHANGES, own_variance

_THETA = np.array([0.0, 20.0, 40.0, 55.0, 65.0, 72.0, 78.0, 82.0, 85.0, 87.0, 88.5, 89.5, 90.0])
"""Incidences of the changes of the directional albedo [degree]."""
_LAY_TURNS = np.array([0.0, 90.0])
"""Azimuths from the lay over which the changes of an albedo are averaged [degree]."""
_MASKING_STEP = 6
"""Nodes of Λ from one change that is computed to the next; between them the change is linear."""
_MASKING_TURNS: Array = np.arange(0.0, 360.0, 22.5)
"""Turns of the azimuth of a surface with a lay at which the change of Λ is computed [degree]."""

_LEAST_LEFT = 0.1
"""Least share of a ring of the spectrum that is left as its noise grows."""
_BANDS, _PHASE_STEP = 3, 8
"""Bands of a roughness spectrum of the same mean square height; nodes of the phase variance from one changed halo to the next."""

MIDDLE_WAVELENGTH = 0.55
"""Of visible light [um]."""

Fields: TypeAlias = dict[str, xr.DataArray]
"""Change of each variable."""


class Change(NamedTuple):
    source: str
    fields: Fields


def uncertainty(
    bsdf: xr.Dataset,
    *,
    facets: xr.Dataset | None = None,
    psd: xr.Dataset | None = None,
    index: xr.Dataset | None = None,
    spectrum: xr.Dataset | None = None,
    relative_error: xr.DataArray | None = None,
    reference_light_u: xr.DataArray | None = None,
    gloss_error: xr.Dataset | None = None,
) -> xr.Dataset:
    """Changes of a predicted BSDF by the uncertainties of its inputs.

    Parameters
    ----------
    bsdf : kind ``bsdf`` of representation ``microfacet``, ``smooth``, ``wave`` or ``lambert_gauss``, predicted from the inputs
    facets : kind ``facets``; its ``slope_density_change`` are the changes of sources ``facets`` and ``noise``
    psd : kind ``psd``; its uncertainty is that of a ``wave``
    index : kind ``index``; ``n_u`` is common to all wavelengths
    spectrum : kind ``spectrum``; ``total_reflectance_u`` is common to all wavelengths
    relative_error : of the model over ``theta_i`` [degree] and ``region``
        (:func:`brdfpipe.comparison.error_as_uncertainty.relative_light_error`), NaN where it is not known
    reference_light_u : of the same: relative uncertainty of the reference by the finite map of which prediction and reference are
    gloss_error : of the model over ``gloss_angle`` [gloss units]
        (:func:`brdfpipe.comparison.error_as_uncertainty.gloss_error`), NaN where it is not known

    Returns
    -------
    Dataset of kind ``uncertainty``: ``<variable>_change`` of variables of the BSDF, ``uncertainty_source`` of each change,
    ``relative_error``, with its part ``finer_roughness_loss`` by roughness finer than the pitch, ``model_gloss_error`` and ``reference_gloss_u``. The attribute
    ``uncertainty_not_stated`` names the inputs whose uncertainty is not known, as
    ``model beyond 60°`` where it is known of some incidences: none is assumed

    Raises
    ------
    VocabularyError : a dataset of the wrong kind.
    """
    vocabulary.validate(bsdf, "bsdf")
    changes: list[Change] = []
    base = _Base(bsdf, spectrum)
    if facets is not None and "slope_density" in bsdf and CHANGES in vocabulary.validate(facets, "facets"):
        changes += [Change(source, base.completed(fields)) for source, fields in changes_of_facets(bsdf, facets)]
    if psd is not None and "log_halo" in bsdf:
        merged = False
        for source, fields in changes_of_roughness(bsdf, vocabulary.validate(psd, "psd")):
            # The noise of the heights is one: that of the facets and that of the spectrum change together.
            # The first noise of a spectrum is that of the scans whose facets are counted, if theirs is uncertain.
            same = next((n for n, one in enumerate(changes) if one.source == source == "noise" and not merged), None)
            merged |= source == "noise"
            if same is None:
                changes.append(Change(source, fields))
            else:
                changes[same] = Change(source, changes[same].fields | fields)
    if index is not None and "n" in bsdf and "n_u" in vocabulary.validate(index, "index"):
        changes.append(Change("index", base.completed({"n": _on_wavelengths(index["n_u"], bsdf["n"])})))
    if spectrum is not None and "total_reflectance_u" in vocabulary.validate(spectrum, "spectrum"):
        changes.append(Change("spectrum", base.of_total(spectrum["total_reflectance_u"])))
    result = stacked(changes)
    stated = {change.source for change in changes}
    missing = [name for name in _expected(bsdf, facets, psd, spectrum) if name not in stated]
    if relative_error is not None and relative_error.notnull().any():
        if reference_light_u is not None:
            relative_error = _with_finite_map(bsdf, result, relative_error, reference_light_u)
        result = result.assign(relative_error=relative_error.rename(theta_i="error_theta"))
        if gloss_error is not None:
            result = result.merge(gloss_error.rename(gloss_angle="error_gloss_angle"))
        angles = relative_error["theta_i"].values
        known = angles[relative_error.notnull().any("region").values]
        unknown = [f"{MODEL} beyond {known[-1]:g}°"] if known[-1] < angles[-1] else []
        missing = [name for name in missing if name != MODEL] + unknown
    if "n" in bsdf and (unresolved := unresolved_rms_height(psd)):
        loss = _finer_roughness_loss(unresolved, result.get("error_theta"))
        both = xr.DataArray(np.hypot(result["relative_error"], loss)) if "relative_error" in result else loss
        result = result.assign(relative_error=both.transpose("error_theta", "region"), finer_roughness_loss=loss)
    return vocabulary.label(result.assign_attrs({NOT_STATED: ", ".join(missing)}), "uncertainty")


def _with_finite_map(
    bsdf: xr.Dataset, changes: xr.Dataset, error: xr.DataArray, reference_u: xr.DataArray
) -> xr.DataArray:
    """The relative error of the model with what a finite map makes of its reference.

    Prediction and reference are of one map. That it is finite counts once: as that of facets and spectrum, and here by what it makes of the light
    of the reference in a region beyond that. With a lay it counts here as a whole, which may be too much.
    """
    of_reference = reference_u.transpose(*error.dims).fillna(0.0).values
    if not of_reference.any():
        return error
    counted = _light_of_map(bsdf, changes, error["theta_i"].values)
    return error.copy(data=np.sqrt(error.values**2 + np.maximum(of_reference**2 - counted**2, 0.0)))


def _light_of_map(bsdf: xr.Dataset, changes: xr.Dataset, theta: Array) -> Array:
    """Relative standard uncertainty of the light of the surface by region from facets and spectrum, (incidences, regions); coherent light is of
    the peak. 0 with a lay."""
    given = representation(bsdf)
    bare = given.without_diffuse()
    result = np.zeros((theta.size, len(MODEL_REGIONS)))
    of_map = np.isin(changes[SOURCE].values, OF_MAP) if SOURCE in changes.coords else np.zeros(0, dtype=bool)
    if not of_map.any() or not given.isotropic:
        return result
    kept = changes.isel({DIMENSION: of_map}).drop_vars("diffuse_change", errors="ignore")
    light = SourceChanges((bsdf if bare is None else bare).merge(kept, combine_attrs="override"))
    wavelength = bsdf["wavelength"].values if "wavelength" in bsdf.coords else None
    middle = None if wavelength is None else wavelength[[np.abs(wavelength - 1e3 * MIDDLE_WAVELENGTH).argmin()]]
    slope, limits = given.lobe_slope or 1.0, np.array(list(MODEL_REGIONS.values()))
    for row, theta_i in enumerate(theta):
        rule = hemisphere.around_mirror(float(theta_i), slope, order=4, turns=8)
        before, *after = (
            _light_by_direction(one, float(theta_i), rule, middle) for one in (light.given, *light.of_inputs)
        )
        # The last is the coherent light.
        brdf = before[:-1] / rule.weight
        number = np.append(np.argmax(brdf[:, None] >= limits * brdf.max(), axis=1), 0)
        changed = [np.bincount(number, one - before, minlength=limits.size) for one in after]
        total = np.bincount(number, before, minlength=limits.size)
        result[row] = np.sqrt(np.square(changed).sum(axis=0)) / np.maximum(total, 1e-300)
    return result


def _light_by_direction(
    reflector: Representation, theta_i: float, rule: hemisphere.Directions, wavelength: Array | None
) -> Array:
    """Light of every direction of a rule, and coherent light, at one wavelength, (directions + 1,)."""
    incident = np.full_like(rule.theta, theta_i), np.zeros_like(rule.theta)
    brdf = reflector.evaluate(*incident, rule.theta, rule.phi, wavelength)[:, 0]
    return np.append(brdf * rule.weight, reflector.specular(np.array([theta_i]), np.zeros(1), wavelength)[0][0, 0])


def _finer_roughness_loss(sigma: float, theta: xr.DataArray | None) -> xr.DataArray:
    """Relative light that roughness finer than the pitch, of an rms height [um], would take out of the lobe, at incidences ``theta`` [degree].

    It takes 1 − e^(−g), g = (4πσ cos θ/λ)² at 550 nm, and scatters it so far that the rest of the BSDF is taken as unchanged.
    """
    angles = MODEL_INCIDENCES if theta is None else theta.values
    return of_lobes(-np.expm1(-((4 * np.pi * sigma * np.cos(np.radians(angles)) / MIDDLE_WAVELENGTH) ** 2)), angles)


def of_lobes(loss: Array, theta: Array = MODEL_INCIDENCES) -> xr.DataArray:
    """A loss [1] at incidences ``theta`` [degree] that peak and shoulder of a lobe have, and the rest has not, over ``error_theta`` and ``region``."""
    of_region = np.array([name != "rest" for name in MODEL_REGIONS], dtype=float)
    coordinates = {"error_theta": theta, "region": list(MODEL_REGIONS)}
    return xr.DataArray(loss[:, None] * of_region, coordinates, ("error_theta", "region"))


def _expected(
    bsdf: xr.Dataset, facets: xr.Dataset | None, psd: xr.Dataset | None, spectrum: xr.Dataset | None
) -> Iterator[str]:
    """Sources that any such BSDF has."""
    if "slope_density" in bsdf:
        yield "facets"
    surface = ("slope_density", facets), ("log_halo", psd)
    if any(name in bsdf and data is not None and float(data.get("noise_sigma", 0.0)) for name, data in surface):
        yield "noise"
    if "log_halo" in bsdf:
        yield "psd"
    if "n" in bsdf:
        yield "index"
    if spectrum is not None:
        yield "spectrum"
    if "n" in bsdf:
        yield MODEL


def changes_of_index(bsdf: xr.Dataset, more: xr.DataArray) -> Fields:
    """Changes of the variables of a BSDF without a diffuse part as its index is ``more``; those of albedos over ``change_theta``."""
    return _Base(bsdf, None).completed({"n": more})


def stacked(changes: list[Change]) -> xr.Dataset:
    """All changes in one dataset; a variable that a change leaves as it is has 0 there."""
    result = xr.Dataset()
    if not changes:
        return result
    names = dict.fromkeys(name for change in changes for name in change.fields)
    for name in names:
        like = next(change.fields[name] for change in changes if name in change.fields)
        parts = [change.fields.get(name, xr.zeros_like(like)) for change in changes]
        values = np.stack([part.transpose(*like.dims).values for part in parts])
        coordinates = {dim: like[dim] for dim in like.dims if dim in ("change_theta", "change_phase")}
        result[f"{name}_change"] = xr.DataArray(values, coordinates, (DIMENSION, *like.dims))
    return result.assign_coords({SOURCE: (DIMENSION, [change.source for change in changes])})


def _on_wavelengths(u: xr.DataArray, like: xr.DataArray) -> xr.DataArray:
    """An uncertainty at the wavelengths of a variable, or its mean if that has none."""
    if "wavelength" not in like.dims:
        return xr.DataArray(float(u.mean()))
    values = np.interp(like["wavelength"].values, u["wavelength"].values, u.values)
    return xr.DataArray(values, dims="wavelength")


# --- facets


def changes_of_facets(bsdf: xr.Dataset, facets: xr.Dataset) -> Iterator[tuple[str, Fields]]:
    """Source, and change of slope density and masking, for each change of the facets."""
    if bsdf["slope_density"].ndim == 1:
        facets = azimuthal_average(facets)
        nodes = facets["slope"].values
        # The relief upon which finer roughness scatters has all slopes scaled.
        factor = float(bsdf["slope"].values[-1] / nodes[-1])
        changed = (facets["slope_density"].values + facets[CHANGES].values) / factor**2
        of_masking = _radial_masking(bsdf)
    else:
        factor = float(bsdf["slope_along"].values[-1] / facets["slope_along"].values[-1])
        changed = (facets["slope_density"].values + facets[CHANGES].values) / factor**2
        of_masking = _planar_masking(bsdf)
    given = bsdf["slope_density"]
    for source, values in zip(facets[SOURCE].values, changed, strict=True):
        yield (
            str(source),
            {
                "slope_density": xr.DataArray(values - given.values, dims=given.dims),
                "lambda_smith": xr.DataArray(of_masking(values), dims=bsdf["lambda_smith"].dims),
            },
        )


def _radial_masking(bsdf: xr.Dataset) -> Callable[[Array], Array]:
    """Change of Λ on its nodes for a changed density."""
    mu, slope = 1 / np.tan(np.radians(bsdf["theta"].values)), bsdf["slope"].values
    picked = np.unique(np.append(np.arange(0, mu.size, _MASKING_STEP), mu.size - 1))
    given = excess_slope(RadialDensity(slope, bsdf["slope_density"].values), mu[picked])

    def change(density: Array) -> Array:
        excess = excess_slope(RadialDensity(slope, density), mu[picked]) - given
        return np.asarray(np.interp(-mu, -mu[picked], excess) / mu)

    return change


def _planar_masking(bsdf: xr.Dataset) -> Callable[[Array], Array]:
    """The same of a surface with a lay; over the turn of the azimuth, the change is linear between a few."""
    density = PlanarDensity.of(bsdf)
    given = planar_density.smith_lambda(density, _MASKING_TURNS)
    turn = density.ellipse.towards(given["phi"].values)[1]
    asked = density.ellipse.towards(bsdf["phi"].values)[1]

    def change(values: Array) -> Array:
        table = planar_density.smith_lambda(replace(density, density=values), _MASKING_TURNS)
        difference = table.values - given.values
        return np.stack([np.interp(asked, turn, row, period=360.0) for row in difference])

    return change


# --- roughness spectrum


def changes_of_roughness(bsdf: xr.Dataset, psd: xr.Dataset) -> Iterator[tuple[str, Fields]]:
    """Source, and change of the rms height, the halo (over ``change_phase``) and the coherent part: for each band of a measured spectrum and longer waves, as each noise
    in it grows, and of the heights that the coherent light knows.

    Rings of a spectrum are independent but for its noise, so the variance of a band is the sum of theirs; a band changes as a whole. Where the
    heights themselves say what is coherent, a band moves light within the halo alone.
    """
    frequency, density, u = (psd[name].values for name in ("frequency", "psd", "psd_uncertainty"))
    if (
        "log_halo" not in bsdf
        or psd.attrs["form"] != "measured"
        or not (density.any() and np.isfinite(u).all() and u.any())
    ):
        return
    noise_changes = psd[NOISE_CHANGES].values if NOISE_CHANGES in psd else np.empty((0, frequency.size))
    u = np.sqrt(own_variance(u, noise_changes))
    weight = frequency**2 * np.gradient(np.log(frequency))
    power = np.cumsum(weight * density)
    band = np.minimum((_BANDS * (power - power[0] / 2) / power[-1]).astype(int), _BANDS - 1)
    given, sigma = roughness(psd)
    rows = np.arange(0, bsdf.sizes["phase_variance"] - 1, _PHASE_STEP)
    rows = np.append(rows, bsdf.sizes["phase_variance"] - 1)
    phase, nodes = bsdf["phase_variance"].values, bsdf["halo_frequency"].values
    isotropic = bsdf["log_halo"].ndim == 2
    before = log_transform(given, phase[rows], nodes) if isotropic else np.empty(0)
    after: list[tuple[str, Array]] = []
    for number in np.unique(band):
        inside = band == number
        relative = np.sqrt(np.square((weight * u)[inside]).sum()) / max(float((weight * density)[inside].sum()), 1e-300)
        after.append(("psd", density * np.where(inside, 1 + relative, 1.0)))
    after += [("noise", np.maximum(density + change, _LEAST_LEFT * density)) for change in noise_changes]
    spectra = [(source, psd.assign(psd=("frequency", values))) for source, values in after]
    if float(psd.get("long_sigma_u", 0.0)) > 0:
        higher = 1 + float(psd["long_sigma_u"] / psd["long_sigma"])
        longer = {name: psd[name] * higher for name in ("long_sigma", "long_slope")}
        spectra.append(("psd", psd.assign(longer)))
    for source, spectrum in spectra:
        changed, changed_sigma = roughness(spectrum)
        fields = {"sigma": xr.DataArray(changed_sigma - sigma)}
        if "coherent_loss" in bsdf:
            growth = (changed_sigma / max(sigma, 1e-300)) ** 2
            of_heights = source == "psd" and "coherent_sigma" in psd
            fields |= _halo_kept(bsdf, growth) if of_heights else _coherent_change(bsdf, growth)
        if isotropic:
            difference = log_transform(changed, phase[rows], nodes) - before
            fields["log_halo"] = xr.DataArray(
                difference, {"change_phase": phase[rows]}, ("change_phase", "halo_frequency")
            )
        yield source, fields
    if "coherent_loss" in bsdf and "coherent_sigma_u" in psd:
        cosine, wavelength = _closure_nodes(bsdf)
        change = 4 * np.pi * cosine / wavelength
        height, height_u = (
            np.interp(change, psd["phase_per_height"].values, psd[name].values)
            for name in ("coherent_sigma", "coherent_sigma_u")
        )
        # Roughness finer than the scan loses coherent light too.
        growth = (1 + height * height_u / np.maximum(height**2, max(float(bsdf["sigma"]) ** 2, 1e-300))) ** 2
        exponent = bsdf["coherent_loss"].values * cosine / wavelength**2
        yield "psd", _coherent_change(bsdf, growth) | _closure_change(bsdf, _scattered_ratio(exponent, growth))


def _closure_nodes(bsdf: xr.Dataset) -> tuple[Array, Array]:
    """Cosines of incidence (incidences, 1), with a lay (incidences, 1, 1), and wavelengths [um] of the energy closure."""
    cosine = np.cos(np.radians(bsdf["closure_incidence"].values))
    return np.expand_dims(cosine, tuple(range(1, bsdf["halo_closure"].ndim))), bsdf["closure_wavelength"].values * 1e-3


def _scattered_ratio(exponent: Array, growth: Array | float) -> Array:
    """Light 1 − e^(−x) that is not coherent as x grows by a factor, over that before."""
    exponent = np.maximum(exponent, 1e-12)
    return np.asarray(np.expm1(-growth * exponent) / np.expm1(-exponent))


def _coherent_change(bsdf: xr.Dataset, growth: Array | float) -> Fields:
    """Change of the coherent part e^(−x) as x, and the variance of the heights, grows by a factor."""
    loss = bsdf["coherent_loss"]
    return {"coherent_loss": xr.DataArray(loss.values * (growth - 1), dims=loss.dims)}


def _closure_change(bsdf: xr.Dataset, light: Array) -> Fields:
    """Change of the factor of either direction of the halo that gives it so many times its light."""
    factor = bsdf["halo_closure"]
    return {"halo_closure": xr.DataArray(factor.values * (np.sqrt(light) - 1), dims=factor.dims)}


def _halo_kept(bsdf: xr.Dataset, growth: float) -> Fields:
    """Change of that factor as the halo's variance of the heights grows, so that it holds the light that is not coherent, as before."""
    cosine, wavelength = _closure_nodes(bsdf)
    phase_variance = (4 * np.pi * float(bsdf["sigma"]) * cosine / wavelength) ** 2
    return _closure_change(bsdf, 1 / _scattered_ratio(phase_variance, growth))


# --- the diffuse base below the surface


@dataclass(frozen=True)
class _Base:
    """The diffuse base of a BSDF, which keeps the total reflectance at that of its spectrum."""

    bsdf: xr.Dataset
    spectrum: xr.Dataset | None

    @property
    def _of_facets(self) -> bool:
        """Whether the surface is one of facets alone, or perfectly smooth."""
        return self.bsdf.attrs["representation"] in ("microfacet", "smooth")

    @cached_property
    def _model(self) -> Model:
        return Model.of(self.bsdf, None)

    @cached_property
    def _incidences(self) -> tuple[Array, Array, int]:
        """θ and φ [degree] at which an albedo is compared, and how many azimuths there are of each θ."""
        isotropic = "phi_i" not in self.bsdf["directional_albedo"].dims
        turns = np.zeros(1) if isotropic else float(self.bsdf.get("lay", 0.0)) + _LAY_TURNS
        theta, phi = (grid.ravel() for grid in np.meshgrid(_THETA, turns, indexing="ij"))
        return theta, phi, turns.size

    @cached_property
    def _reflected_once(self) -> Array:
        theta, phi, _ = self._incidences
        return self._model.specular(theta, phi, self._model.n)

    def completed(self, fields: Fields) -> Fields:
        """Add what a change of the surface makes of its albedo and of the base."""
        if self.bsdf.attrs["representation"] == "wave":
            albedo = self._wave_albedo(fields)
        elif self._of_facets:
            albedo = self._interface_albedo(fields)
        else:
            return fields
        if not albedo.any():
            return fields
        spectral = ("wavelength",) if "wavelength" in self.bsdf["directional_albedo"].dims else ()
        own = albedo if spectral else albedo[:, :1]
        theta = np.radians(np.linspace(0.0, 90.0, 181))
        mean = np.trapezoid(
            between_incidences(_THETA, own, np.degrees(theta)) * np.sin(2 * theta)[:, None], theta, axis=0
        )
        of_table = own if spectral else own[:, 0]
        fields = fields | {
            "directional_albedo": xr.DataArray(of_table, {"change_theta": _THETA}, ("change_theta", *spectral)),
            "mean_albedo": xr.DataArray(mean if spectral else mean[0], dims=spectral),
        }
        # What a surface reflects more does not enter the base: 1 − d of its change is missing in the total.
        missing = 1.0 if str(self.bsdf.attrs["diffuse_mode"]) == "crf" else 1 - self.bsdf["diffuse"].values
        of_surface = between_incidences(_THETA, albedo, np.array([float(self.bsdf.get("theta_m", 8.0))]))[0]
        return fields | self._diffuse(self._trapped(fields) - missing * of_surface)

    def of_total(self, u: xr.DataArray) -> Fields:
        """Change of the base by that of the measured total reflectance."""
        if "total_reflectance" not in self.bsdf or "wavelength" not in self.bsdf["total_reflectance"].dims:
            return {}
        change = _on_wavelengths(u, self.bsdf["total_reflectance"])
        fields: Fields = {"total_reflectance": change}
        if "lambert" in self.bsdf:
            return fields | {"lambert": change}
        return fields | self._diffuse(change.values)

    def _diffuse(self, change: Array) -> Fields:
        """Change of the diffuse reflectance by that of the light the base has to return, at the incidence of the spectrum (wavelength,)."""
        diffuse = self.bsdf["diffuse"]
        if self.spectrum is None or "wavelength" not in diffuse.dims or str(self.bsdf.attrs["diffuse_mode"]) == "none":
            return {}
        values = diffuse.values
        if str(self.bsdf.attrs["diffuse_mode"]) != "crf":
            theta_m = float(self.bsdf["theta_m"])
            table = self.bsdf["directional_albedo"]
            table = table.mean("phi_i") if "phi_i" in table.dims else table
            entering = np.maximum(1 - table.sel(theta_i=theta_m, method="nearest").values, 1e-6)
            change = change / entering
        return {"diffuse": xr.DataArray(np.clip(values + change, 0.0, 1 - 2e-8) - values, dims="wavelength")}

    def _changed_model(self, fields: Mapping[str, xr.DataArray]) -> Model:
        """The model with other facets or another index; its tables are those of the given one."""
        used = {
            name: self.bsdf[name].copy(data=self.bsdf[name].values + fields[name].values)
            for name in fields
            if name in ("slope_density", "lambda_smith", "n")
        }
        return Model.of(self.bsdf.assign(used), None)

    def _interface_albedo(self, fields: Fields) -> Array:
        """Change of the light that the facets reflect once, (change_theta, wavelength or 1)."""
        theta, phi, turns = self._incidences
        changed = self._changed_model(fields)
        change = changed.specular(theta, phi, changed.n) - self._reflected_once
        return np.asarray(change.reshape(_THETA.size, turns, -1).mean(axis=1))

    def _wave_albedo(self, fields: Fields) -> Array:
        """Change of Fresnel's reflectance, which a surface with waves keeps, (change_theta, wavelength)."""
        n, k = (self.bsdf[name].values for name in ("n", "k"))
        if "n" not in fields:
            return np.zeros((_THETA.size, n.size))
        cosine = np.cos(np.radians(_THETA))[:, None]
        return np.asarray(fresnel(cosine, n + fields["n"].values, k).mean - fresnel(cosine, n, k).mean)

    def _trapped(self, fields: Fields) -> Array:
        """Change of the light in a gloss trap, which a spectrum with the specular excluded is without, (wavelength or 1,)."""
        if self.spectrum is None or self.spectrum.attrs["geometry"] != "sce" or not self._of_facets:
            return np.zeros(1)
        theta_m = float(self.bsdf["theta_m"])
        bare = self.bsdf.assign(diffuse=xr.zeros_like(self.bsdf["diffuse"]))
        models = _Base(bare, self.spectrum)._changed_model(fields), Model.of(bare, None)
        changed, given = (trapped_light(model, self.spectrum, theta_m) for model in models)
        return np.asarray(changed - given)
