"""The BSDF of a surface with low slopes over a diffuse base, from its roughness spectrum.

References
----------
:mod:`brdfpipe.bsdf.wave.halo` has those of the halo. The coherent share of the mirror reflection is e^(−g): Davies 1954 (Proc. IEE 101
part IV, 209), Bennett & Porteus 1961 (J. Opt. Soc. Am. 51, 123).
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

from brdfpipe import hemisphere, vocabulary
from brdfpipe.bsdf.coupled_base import ellipse_of
from brdfpipe.bsdf.microfacet import energy
from brdfpipe.bsdf.microfacet.albedo_table import AlbedoTable
from brdfpipe.bsdf.microfacet.anisotropic_quadrature import arc_to_azimuth, azimuth_to_arc
from brdfpipe.bsdf.microfacet.builder import build as build_microfacet
from brdfpipe.bsdf.microfacet.builder import (
    index_on,
    interreflection_of,
    wavelengths_of,
    with_base,
    with_clamping_warning,
    with_diffuse_reflectance,
)
from brdfpipe.bsdf.microfacet.gloss_trap import trap_of
from brdfpipe.bsdf.microfacet.microsurface import Microsurface, ModelError
from brdfpipe.bsdf.microfacet.model import with_reflections
from brdfpipe.bsdf.microfacet.phase_variance import known_rms_height
from brdfpipe.bsdf.representations.microfacet import Microfacet
from brdfpipe.bsdf.representations.wave import Wave
from brdfpipe.bsdf.wave import height_transform, missed_light, planar_transform
from brdfpipe.bsdf.wave.halo import Halo
from brdfpipe.bsdf.wave.roughness import roughness
from brdfpipe.bsdf.wave.two_scale import (
    FACETS_ALONE,
    Angles,
    Corners,
    EnergyClosure,
    RoughSurface,
    characteristic_function,
    closure_arcs,
    closure_corners,
    closure_nodes,
    closure_place,
    facet_share_at,
    mirror_lobe,
    passage_phase,
)
from brdfpipe.facets.facet_dataset import azimuthal_average
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.facets.scaling import scaled, scaled_surface
from brdfpipe.geometry import Array
from brdfpipe.masking.modes import HALOS, MASKING_ADVISED, MULTIPLE_SCATTERING_ADVISED, SMITH_ERROR, WAVE_OPTICS
from brdfpipe.optics.fresnel_equations import fresnel
from brdfpipe.optics.index import refractive_index

if TYPE_CHECKING:
    from brdfpipe.bsdf.wave.halo_kernel import Sums
    from brdfpipe.bsdf.wave.lobe_integrals import LobeIntegrals

FINE_PHASE = 1.0
"""Phase variance of roughness that is too fine to be facets, at normal incidence and 550 nm."""

EXTRAPOLATED_LIMIT = 0.2
"""Share of the mean square height beyond the band of a measured spectrum above which a warning says so."""

CUT_FACTOR = 1.5
"""Factor by which the cut is moved to find how much the BRDF depends on it."""

LEAST_SLOPE_FACTOR = 0.97
"""Slopes of a relief over all slopes above which ``auto`` leaves the finer roughness to the facets."""

LARGEST_INCIDENCE = 85.0
"""Incidence [degree] up to which facets must reflect :data:`brdfpipe.bsdf.wave.two_scale.FACETS_ALONE` of the light, for ``auto`` to be them."""

COARSE_LIMIT = 20.0
"""Phase variance of the facets of ``composite`` below which a warning says that they are too smooth."""

WAVES_ALONE = 1e-4
"""Phase variance at normal incidence up to which ``auto`` leaves the facets out: the light that is scattered at all."""

ENERGY_LIMIT = 1e-3
"""Share of the incident light by which coherent part and halo may miss Fresnel's reflectance without a statement."""

SLOPE_LIMIT = 0.2
"""Rms slope √⟨p² + q²⟩ up to which the halo is used without a warning: it knows neither masking nor the local angle of incidence."""

_MIDDLE = 0.55
"""Wavelength at which a surface is judged [um]."""
_LEAST_SIGMA = 1e-9
"""Rms height below which a surface is as good as flat [um]."""
_BETWEEN_INCIDENCES = 4
"""Steps of the closure of the energy from one integrated incidence to the next: what heights say of coherent light varies faster than the halo."""
_NEARLY_GRAZING = 89.9999
"""Incidence in place of 90° [degree], at which what the facets return of the light has reached its limit."""
_LONG_LOBE = 0.5
"""Cosine of incidence below which an integral has twice as many azimuths about the mirror direction: a lobe is 1/cos θ times as long there as wide."""
_CLOSURE_WAVELENGTHS, _LAY_CLOSURE_WAVELENGTHS = 41, 12
"""Wavelengths of the closure of the energy."""
_ITERATIONS, _CLOSURES = 60, (1e-6, 2.0)
"""Of the factors that close the energy of the halo, and their limits."""
_SHARE_INCIDENCES = 49
"""Angles of incidence at which the share of the light that facets reflect is judged."""
_LAY_STEP = 15.0
"""Step of the azimuths of the table of reflectance, of a surface with a lay and without facets [degree]."""
_SMOOTH_SLOPE = 0.01
"""Angle [rad] near grazing on which the reflectance of a smooth surface varies."""
_GRAZING = np.linspace(89.0, 90.0, 51)
"""Angles near grazing [degree] of the table of a surface with facets, whose albedo may have a corner where a limit of the coherent light begins."""
_ROUGH_STEP = 0.5
"""Step of ln g where a table need not be exact."""
_BASE = ("diffuse", "diffuse_quality", "total_reflectance", "theta_m")
"""Variables of the base below the facets, which is closed anew."""
_OF_TABLE = ("directional_albedo", "mean_albedo")
"""Variables of the table of the facets' albedo, in whose place is that of the whole surface."""


class EnergyNodes(NamedTuple):
    """Numbers of nodes of the integrals over the lobe that close the energy of a surface, and give its reflectance."""

    incidences: int
    order: int
    """Points in each panel: along the radius about the mirror direction, or with a lay along and across it"""
    wavelengths: int
    """Over the others what varies slowly with wavelength is interpolated"""
    turns: int = 0
    """Azimuths about the mirror direction in half a turn; not with a lay"""
    closure_arcs: int = 1
    """Arcs of half a turn, in the sense of :func:`azimuth_to_arc`, at which the energy of the halo of a surface with a lay is closed"""
    arcs_a_half: int = 1
    """Arcs of half a turn at which the reflectance of a surface with a lay is integrated; odd, for interpolation"""
    arcs_a_turn: int = 1
    """Those of a whole turn, if the two halves differ"""


ENERGY_NODES = EnergyNodes(25, 8, 5, turns=12)
BRIGHT_ENERGY_NODES = EnergyNodes(25, 28, 5, turns=12)
"""Of a surface that reflects more than :data:`BRIGHT` at the normal, whose integrals err by as much more: counted slopes have kinks."""
BRIGHT = 0.2
LAY_ENERGY_NODES = EnergyNodes(25, 6, 5, closure_arcs=12, arcs_a_half=9, arcs_a_turn=21)
"""Of a surface with a lay."""


def build(
    psd: xr.Dataset,
    *,
    index: xr.Dataset | float | str,
    spectrum: xr.Dataset | None = None,
    wavelength: ArrayLike | None = None,
    form: str = HALOS[0],
    diffuse: str = "coupled",
    facets: xr.Dataset | None = None,
    predicted: xr.Dataset | None = None,
    visibility: xr.Dataset | None = None,
    optics: str = "wave",
    cut: float | None = None,
    states_cut_error: bool = True,
    phase_step: float = height_transform.PHASE_STEP,
    lay_energy_nodes: EnergyNodes = LAY_ENERGY_NODES,
) -> xr.Dataset:
    """BSDF of a surface by wave optics, by facets with finer roughness, or by both in turn.

    Parameters
    ----------
    psd : kind ``psd``, measured or analytic (:func:`brdfpipe.psd.analytic`)
    index : kind ``index``, a number or a plastic's name; the refractive index of the body relative to air. A metal has k > 0
    spectrum : kind ``spectrum``, as for :func:`brdfpipe.bsdf.microfacet.build`. Without a spectrum there is no diffuse part
    wavelength : [nm], increasing; by default those of the spectrum, else of the index, else :data:`brdfpipe.bsdf.microfacet.builder.WAVELENGTHS`
    form : one of :data:`brdfpipe.masking.modes.HALOS`
    diffuse : ``coupled``, or ``none``
    facets : kind ``facets``, of the same surface; needed unless ``optics`` is ``wave``. Whether the halo follows a lay is theirs to say
    predicted : kind ``bsdf``, built of the same facets, index and spectrum, with the modes of the facets; by default with the default modes.
        The surface alone (:func:`brdfpipe.bsdf.microfacet.builder.build`) is enough
    visibility : kind ``visibility``, if the masking of ``predicted`` is ``measured``
    optics : ``wave``; ``composite``, where roughness below a cut scatters upon facets; or ``auto``, which passes from ``wave`` to
        facets with the phase variance and the slope, with finer roughness upon them where it is measured and matters
    cut : frequency that parts facets from finer roughness [um-1]; by default that above which the roughness has a phase variance of
        :data:`FINE_PHASE`, at most half an inverse wavelength
    states_cut_error : add ``cut_error``, how much the lobe depends on the cut: three more tables of the finer roughness, which no value of
        the BSDF needs
    phase_step : step of the logarithm of the phase variance in tables of the halo without a lay [1]
    lay_energy_nodes : of integrals over the lobe of a surface with a lay

    Returns
    -------
    Dataset of kind ``bsdf``, representation ``wave``: the coherent share F e^(−g) of the mirror reflection is not part of the BSDF but of
    its specular reflectance, as that of a smooth surface. Of a surface that ``auto`` finds to be one of facets alone it is ``predicted``

    Raises
    ------
    ModelError : an unknown form, no usable wavelengths, an index below that of air without absorption, or facets that are missing.
    VocabularyError : a dataset of the wrong kind.

    Notes
    -----
    ``docs/model.md`` has the equations. With ``auto``, coherent part and halo of a perfect mirror return all light. Else they return at most
    Fresnel's reflectance F: where they would return more, the coherent part is reduced. Where they return less, the light enters the base,
    and ``energy_residual`` states how much.
    """
    vocabulary.validate(psd, "psd")
    index = vocabulary.validate(index, "index") if isinstance(index, xr.Dataset) else refractive_index(index)
    _check(form, diffuse, optics, facets)
    if spectrum is not None:
        vocabulary.validate(spectrum, "spectrum")
    given = wavelengths_of(spectrum, index, wavelength, ModelError)
    n, k, _, warnings = index_on(index, given)
    n, k = np.broadcast_to(n, given.shape), np.broadcast_to(k, given.shape)
    if np.any((n < 1) & (k == 0)):
        raise ModelError(
            f"the refractive index falls to {np.min(n):g}, below that of air, without absorption; accepted: n >= 1, or k > 0"
        )
    correlation, sigma = roughness(psd)
    relief = None if optics == "wave" or facets is None else Relief.of(correlation, sigma, psd, optics, cut, facets)
    if relief is not None and optics == "auto" and (4e3 * np.pi * sigma / given[0]) ** 2 < WAVES_ALONE:
        relief = None
    bsdf, theta_m = (
        xr.Dataset(coords={"wavelength": given}),
        8.0 if spectrum is None else float(spectrum.attrs["theta_i"]),
    )
    if relief is not None:
        assert facets is not None
        inputs: dict[str, Any] = {"index": index, "spectrum": spectrum, "visibility": visibility}
        if relief.slope_factor < 1:
            facets = scaled(facets, relief.slope_factor)
            predicted = _of_relief(facets, inputs, predicted)
        elif predicted is None:
            predicted = build_microfacet(facets, **inputs, diffuse=diffuse, surface_alone=True)
        complete = "directional_albedo" in predicted
        if optics == "auto" and relief.is_one_of_facets(given):
            predicted = predicted if complete else with_base(predicted, spectrum)
            return vocabulary.label(_facets_alone(predicted, relief, given), "bsdf")
        predicted = predicted if complete else with_reflections(predicted, theta_m)
        bsdf = _with_facets(bsdf, predicted, _angles_of_table(predicted, n, k, theta_m)).assign(
            facet_sigma=relief.sigma, resolved_slope=relief.slope, passage_phase=relief.passage
        )
        if relief.uses_fine:
            bsdf = _with_finer_roughness(bsdf, relief, facets, phase_step)
            if states_cut_error:
                middle = float(given[np.abs(given - 1e3 * _MIDDLE).argmin()])
                bsdf = bsdf.assign(cut_error=_cut_error(correlation, sigma, psd, relief, facets, middle))
    bsdf = bsdf.assign(n=("wavelength", n), k=("wavelength", k), sigma=sigma)
    attributes = {
        "optics": optics,
        "form": form,
        "spectrum": psd.attrs["form"],
        "diffuse_mode": diffuse,
        "transmission": "none",
    }
    bsdf.attrs |= {"representation": Wave.name, **attributes}
    if optics != "composite":
        bsdf = bsdf.merge(halo_table(correlation, sigma, psd, given, _has_lay(psd, facets), phase_step))
    bright = bool(_smooth(np.zeros(1), n, k).max() > BRIGHT)
    nodes = BRIGHT_ENERGY_NODES if bright else ENERGY_NODES
    bsdf = _with_albedo(bsdf, theta_m, psd, lay_energy_nodes if _has_azimuths(bsdf) else nodes)
    bsdf = _with_diffuse(bsdf, spectrum, theta_m)
    bsdf = vocabulary.add_warning(bsdf, *warnings, *_limits(bsdf, psd, correlation))
    return vocabulary.label(bsdf, "bsdf")


def _check(form: str, diffuse: str, optics: str, facets: xr.Dataset | None) -> None:
    for name, key, found, accepted in (
        ("form", "halo", form, HALOS),
        ("diffuse", "diffuse", diffuse, ("coupled", "none")),
        ("optics", "optics", optics, WAVE_OPTICS),
    ):
        if found not in accepted:
            raise ModelError(
                f"unknown {name} of the wave model {found!r}; accepted: {', '.join(accepted)}; set `model.{key}`"
            )
    if optics != "wave" and (facets is None or vocabulary.validate(facets, "facets")["slope_density"].size == 0):
        raise ModelError(
            f"optics {optics!r} needs the facets of a rough surface; give `facets`, or `model.optics: wave`"
        )


# --- the roughness


def halo_table(
    correlation: height_transform.Autocorrelation,
    sigma: float,
    psd: xr.Dataset,
    wavelength: Array,
    lay: bool,
    phase_step: float = height_transform.PHASE_STEP,
) -> xr.Dataset:
    """Logarithm of the halo over phase variance and frequency, of a roughness with its rms height ``sigma`` [um], for wavelengths [nm]."""
    shortest = float(wavelength[0]) * 1e-3
    largest_phase = (4 * np.pi * max(sigma, _LEAST_SIGMA) / shortest) ** 2
    if lay:
        planar, stretch = planar_transform.spectrum_with_lay(psd, correlation)
        return planar_transform.tabulated(planar, stretch, correlation.length, largest_phase, 2 / shortest)
    table = height_transform.tabulated(correlation, largest_phase, 2 / shortest, phase_step=phase_step)
    if psd.attrs["form"] != "measured":
        table = table.assign({name: float(psd[name]) for name in ("fit_length", "fit_slope")})
    return table


def _has_lay(psd: xr.Dataset, facets: xr.Dataset | None) -> bool:
    """Whether the halo follows the spectrum over both frequencies: facets without a lay say that it is averaged."""
    return "psd_planar" in psd and (facets is None or facets["slope_density"].ndim == 2)


# --- the relief that is one of facets


@dataclass(frozen=True)
class Relief:
    """Roughness that is parted into a relief of facets and finer roughness upon them."""

    cut: float
    """Frequency that parts both [um-1]"""
    sigma: float
    """Rms height of the relief [um]"""
    slope: float
    """Rms slope √⟨p² + q²⟩ of all roughness at scales above the wavelength [1]"""
    slope_factor: float
    """Slopes of the relief over the slopes that were counted [1]"""
    fine: height_transform.Autocorrelation
    fine_sigma: float
    """Rms height of the finer roughness [um]"""
    passage: float
    """Phase variance at which half of the light is reflected as by facets [1]"""
    uses_fine: bool
    """Whether the finer roughness is modelled"""

    @classmethod
    def of(
        cls,
        correlation: height_transform.Autocorrelation,
        sigma: float,
        psd: xr.Dataset,
        optics: str,
        cut: float | None,
        facets: xr.Dataset,
    ) -> Relief:
        """``auto`` leaves the finer roughness out where it changes the slopes little, or where no scan shows it."""
        parted = _cut(correlation, sigma) if cut is None else cut
        fine, fine_sigma, facet_sigma = height_transform.split(correlation, sigma, parted)
        # The slopes that were counted, and those of them that are coarser than the cut.
        measured = psd.attrs["form"] == "measured"
        # Facets are of the first of several scans.
        counted = float(psd["scan_band_high"][0] if "scan_band_high" in psd else psd["band_high"])
        counted = counted if measured else 1e4 / correlation.length
        whole = height_transform.slope_variance(correlation, sigma, counted)
        coarse = whole - height_transform.slope_variance(fine, fine_sigma, counted)
        factor = float(np.sqrt(np.clip(coarse / max(whole, 1e-300), 1e-6, 1.0)))
        slope = float(np.sqrt(height_transform.slope_variance(correlation, sigma, 1 / _MIDDLE)))
        # The finer halo widens the lobe by the slopes of the finer roughness, whatever its phase variance.
        matters = factor < LEAST_SLOPE_FACTOR
        passage = passage_phase(_normality(facets, whole))
        shown = not (measured and parted >= float(psd["band_high"]))
        if optics == "composite" or cut is not None or (matters and shown):
            return cls(parted, facet_sigma, slope, factor, fine, fine_sigma, passage, True)
        return cls(parted, sigma, slope, 1.0, fine, fine_sigma, passage, False)

    def share(self, theta: Array, wavelength: Array) -> Array:
        """Share of the light that is reflected as by facets, of mirror reflection, (incidences, wavelength)."""
        return facet_share_at(self.sigma, self.slope, self.passage, 2 * np.cos(np.radians(theta)), wavelength)

    def is_one_of_facets(self, wavelength: Array) -> bool:
        """Whether facets alone describe the surface up to :data:`LARGEST_INCIDENCE`."""
        incidences = np.linspace(0.0, LARGEST_INCIDENCE, _SHARE_INCIDENCES)
        return not self.uses_fine and bool(self.share(incidences, wavelength).min() >= FACETS_ALONE)


def _normality(facets: xr.Dataset, slope_variance: float) -> float:
    """Density of the smaller half of the slopes over that of normally distributed ones of a mean square; with a lay, of their own mean square."""
    surface = Microsurface.of(facets)
    if isinstance(surface.density, RadialDensity):
        return float(np.log(2) * slope_variance / surface.typical_slope**2)
    return float(surface.density_at(np.zeros(1), np.zeros(1))[0] * 2 * np.pi * surface.typical_slope**2)


def _facets_alone(predicted: xr.Dataset, relief: Relief, wavelength: Array) -> xr.Dataset:
    share = relief.share(np.array([LARGEST_INCIDENCE]), wavelength).min()
    text = (
        f"optics auto: facets alone; with an rms height of {relief.sigma:.3g} µm and a slope of {relief.slope:.2g} at scales above the "
        f"wavelength they reflect at least {share:.1%} of the light up to {LARGEST_INCIDENCE:g}° incidence"
    )
    return vocabulary.add_history(predicted.assign_attrs(optics="auto"), text)


def _of_relief(facets: xr.Dataset, inputs: Mapping[str, Any], predicted: xr.Dataset | None) -> xr.Dataset:
    """Other facets with the modes of ``predicted``, the surface alone; with the default ones without it."""
    if predicted is None:
        return build_microfacet(facets, **inputs, surface_alone=True)
    modes = {name: predicted.attrs[name] for name in ("masking", "multiple_scattering")}
    isotropic, traced = predicted["slope_density"].ndim == 1, interreflection_of(predicted)
    bsdf = build_microfacet(facets, **inputs, **modes, isotropic=isotropic, interreflection=traced, surface_alone=True)
    advised = {name: mode for name, mode in predicted.attrs.items() if name == MULTIPLE_SCATTERING_ADVISED}
    return bsdf.assign_attrs(advised)


def _angles_of_table(predicted: xr.Dataset, n: Array, k: Array, theta_m: float) -> dict[str, Array]:
    """Angles of the table of the albedo of a surface with facets [degree]: those of the facets' furnace, where they have one."""
    if "furnace_albedo" in predicted:
        return {name: predicted[name].values for name in ("theta_i", "phi_i") if name in predicted.coords}
    density, exact = Microsurface.of(predicted).density, np.array([0.0, theta_m, 90.0])
    if isinstance(density, RadialDensity):
        theta = energy.refined(lambda theta: _smooth(theta, n, k), _SMOOTH_SLOPE, exact).theta
        return {"theta_i": np.concatenate([theta[theta < _GRAZING[0]], _GRAZING])}
    return dict(zip(("theta_i", "phi_i"), energy.lay_nodes(density, exact), strict=True))


def _smooth(theta: Array, n: Array, k: Array) -> Array:
    """Reflectance of a smooth surface of the same index, (incidences, wavelength), of θ [degree]."""
    cosine = np.where(theta >= 90, 0.0, np.cos(np.radians(theta)))
    return np.asarray(fresnel(cosine[:, None], n, k).mean)


def _with_facets(bsdf: xr.Dataset, predicted: xr.Dataset, around: Mapping[str, Array]) -> xr.Dataset:
    """Add the facets' BSDF but for its base and the table of its albedo, at the angles of the table of both."""
    names = [name for name in (*Microfacet.kind.required, *Microfacet.kind.optional) if name in predicted]
    of_table = _OF_TABLE if "furnace_albedo" in predicted else (*_OF_TABLE, "mean_furnace_albedo")
    kept = predicted[names].drop_vars([*_BASE, *of_table, "n", "k"], errors="ignore")
    if "wavelength" in kept.dims and not np.array_equal(kept["wavelength"], bsdf["wavelength"]):
        kept = kept.interp(wavelength=bsdf["wavelength"].values)
    names_of_modes = (
        "masking",
        MASKING_ADVISED,
        SMITH_ERROR,
        "multiple_scattering",
        MULTIPLE_SCATTERING_ADVISED,
        "band",
    )
    attributes = {name: predicted.attrs[name] for name in names_of_modes if name in predicted.attrs}
    return bsdf.merge(kept).assign_coords(around).assign_attrs(attributes)


def _with_finer_roughness(bsdf: xr.Dataset, relief: Relief, facets: xr.Dataset, phase_step: float) -> xr.Dataset:
    """Add the halo of the roughness upon the facets of a relief."""
    # Of slopes with a lay the mean over azimuth: what the finer roughness spreads is wider than the lobe.
    radial = RadialDensity.of(azimuthal_average(facets))
    table = _fine_table(relief, radial, float(bsdf["wavelength"][0]), phase_step).rename(
        log_halo="log_fine_halo",
        phase_variance="fine_phase_variance",
        halo_frequency="fine_frequency",
        frequency_scale="fine_scale",
    )
    return bsdf.merge(table).assign(fine_sigma=relief.fine_sigma)


def _fine_table(
    relief: Relief, slopes: RadialDensity, shortest: float, phase_step: float = height_transform.PHASE_STEP
) -> xr.Dataset:
    """The transform of the finer roughness, spread by the slopes of the relief, for wavelengths from the shortest [nm]."""
    distribution, fine_sigma = characteristic_function(slopes), max(relief.fine_sigma, _LEAST_SIGMA)

    def of_slopes(distance: Array, root_g: float) -> Array:
        return distribution(distance * (root_g / fine_sigma))

    largest = (4e3 * np.pi * fine_sigma / shortest) ** 2
    return height_transform.tabulated(relief.fine, largest, 2e3 / shortest, of_slopes, phase_step)


def _cut_error(
    correlation: height_transform.Autocorrelation,
    sigma: float,
    psd: xr.Dataset,
    relief: Relief,
    facets: xr.Dataset,
    wavelength: float,
) -> float:
    """Largest relative change of the lobe, above 0.3 of its peak, if the cut is moved by the factor :data:`CUT_FACTOR` either way.

    Of perfect mirrors without a lay, in the plane of incidence.
    """
    facets = azimuthal_average(facets)
    theta_i, slope = np.meshgrid([0.0, 45.0], np.linspace(-2.0, 2.0, 41) * Microsurface.of(facets).typical_slope)
    view = theta_i + 2 * np.degrees(np.arctan(slope))
    theta_o, phi_o = np.abs(view).ravel(), np.where(view < 0, 0.0, 180.0).ravel()
    angles = theta_i.ravel(), np.zeros(view.size), np.minimum(theta_o, 89.0), phi_o
    lobes = []
    for factor in (1.0, CUT_FACTOR, 1 / CUT_FACTOR):
        other = Relief.of(correlation, sigma, psd, "composite", relief.cut * factor, facets)
        changed = scaled_surface(facets, other.slope_factor / relief.slope_factor)
        table = _fine_table(other, RadialDensity.of(changed), wavelength, _ROUGH_STEP).assign(sigma=other.fine_sigma)
        table.attrs = {"form": "ssa1", "spectrum": "measured"}
        lobes.append(mirror_lobe(Microsurface.of(changed), Halo.of(table), angles, wavelength).reshape(view.shape))
    peak = lobes[0] > 0.3 * lobes[0].max(axis=0)
    return float(max(np.abs(other[peak] / lobes[0][peak] - 1).max() for other in lobes[1:]))


def _cut(correlation: height_transform.Autocorrelation, sigma: float) -> float:
    """Frequency above which the roughness has the phase variance :data:`FINE_PHASE`, at most half an inverse wavelength [um-1]."""
    limit, low, high = np.sqrt(FINE_PHASE) * _MIDDLE / (4 * np.pi), 1e-2 / correlation.length, 0.5 / _MIDDLE
    cuts = np.geomspace(low, high, 60).tolist() if low < high else []
    # The roughness above a cut decreases with the cut.
    rough = bisect_left(cuts, True, key=lambda cut: height_transform.split(correlation, sigma, cut)[1] <= limit)
    return float(cuts[rough - 1]) if rough else high


# --- energy and the diffuse base


def _with_albedo(bsdf: xr.Dataset, theta_m: float, psd: xr.Dataset, nodes: EnergyNodes) -> xr.Dataset:
    """Add the reflectance of the surface, and what it misses of Fresnel's."""
    n, k, wavelength = (bsdf[name].values for name in ("n", "k", "wavelength"))

    def smooth(theta: Array) -> Array:
        return _smooth(theta, n, k)

    surface, arcs = RoughSurface.of(bsdf), _arcs(bsdf, nodes)
    azimuths, theta = _azimuths(bsdf, arcs.values), closure_nodes(nodes.incidences)
    if closed := surface.halo is not None and surface.halo.first_order is not None:
        bsdf, unmatched, found = _with_closure(surface, bsdf, theta, psd, nodes)
        surface = replace(surface, closure=EnergyClosure.of(bsdf))
        scattered = _closed_scattered(surface, bsdf, theta, azimuths, found, nodes)
    else:
        scattered = _scattered(surface, bsdf, theta, azimuths, nodes)
    missing = smooth(theta)[:, None] * (1 - surface.coherent_share(theta[:, None], azimuths, wavelength)) - scattered
    waves = 1 - surface.facet_share(2 * np.cos(np.radians(theta)), wavelength)
    if not closed:
        unmatched = missing.mean(axis=1)
    unmatched = unmatched * waves
    if surface.relief is not None:
        table = AlbedoTable(bsdf["theta_i"].values, smooth(bsdf["theta_i"].values))
    elif azimuths.size == 1:
        table = energy.refined(smooth, _SMOOTH_SLOPE, np.array([0.0, theta_m, 90.0]))
    else:
        angles = np.unique(np.append(np.degrees(np.arccos(np.cos(np.linspace(0, np.pi / 2, 48)) ** 2)), theta_m))
        table = AlbedoTable(angles, smooth(angles))
        around = arc_to_azimuth(ellipse_of(bsdf), np.arange(0.0, 360.0, _LAY_STEP))
        bsdf = bsdf.assign_coords(phi_i=np.sort(np.round(around, 9) % 360))

    def between(values: Array) -> Array:
        return _between_incidences(values, closure_place(np.cos(np.radians(table.theta)), theta.size))

    returned, phi = between(scattered), np.zeros(1)
    if lay := "phi_i" in bsdf.coords:
        phi = bsdf["phi_i"].values
        of_arcs = _between_azimuths(azimuth_to_arc(ellipse_of(bsdf), phi), *arcs)
        returned = np.einsum("tal,pa->tpl", returned, of_arcs)
    smooth_reflects = table.values[:, None]
    coherent = smooth_reflects * surface.coherent_share(table.theta[:, None], phi, wavelength)
    reflected = coherent + returned
    if closed:
        # At least half of what would enter a smooth surface enters this one.
        excess = np.clip(reflected - (1 + smooth_reflects) / 2, 0.0, coherent)
    else:
        # Facets may reflect more than a smooth surface; waves may not.
        of_waves = between(np.maximum(-missing.mean(axis=1, keepdims=True), 0.0) * waves[:, None])
        excess = np.broadcast_to(np.maximum(of_waves, 0.0), reflected.shape)
    values = np.clip(reflected - excess, 0.0, 1.0)
    if lay:
        albedo, dims = AlbedoTable(table.theta, values, phi, ellipse_of(bsdf)), ["theta_i", "phi_i"]
    else:
        albedo, dims, excess = AlbedoTable(table.theta, values[:, 0]), ["theta_i"], excess[:, 0]
    bsdf = _with_energy_statement(bsdf, unmatched.max(axis=1), theta)
    if surface.relief is not None:
        share = surface.facet_share(2 * np.cos(np.radians(table.theta)), wavelength)
        bsdf = bsdf.assign(facet_share=(("theta_i", "wavelength"), share))
    return bsdf.assign_coords(theta_i=table.theta).assign(
        directional_albedo=((*dims, "wavelength"), albedo.values),
        coherent_excess=((*dims, "wavelength"), excess),
        mean_albedo=("wavelength", albedo.mean()),
        energy_residual=float(np.max(unmatched, initial=0.0)),
    )


def _with_closure(
    surface: RoughSurface, bsdf: xr.Dataset, theta: Array, psd: xr.Dataset, nodes: EnergyNodes
) -> tuple[xr.Dataset, Array, list[Sums]]:
    """Add what closes the energy of coherent light and halo; the light that this leaves missing, (incidences, wavelength); and the integrals
    over the lobes of the incidences, without a lay.

    The coherent light of a perfect mirror loses what its surface scatters. That is g at steep incidence, and the light of first order
    where g is small, which near grazing is more than g, and with a lay depends on the azimuth. Of the halo the factor of both
    directions, N(θ_i)N(θ_o), with a lay N(θ_i, φ_i)N(θ_o, φ_o), is found by iteration.
    """
    wavelength, lay = bsdf["wavelength"].values, _has_azimuths(bsdf)
    arcs = closure_arcs(nodes.closure_arcs)
    azimuths = _azimuths(bsdf, arcs)
    few, directions = _evenly(wavelength.size, nodes.wavelengths), _directions(bsdf, azimuths, nodes)
    many = _evenly(wavelength.size, _LAY_CLOSURE_WAVELENGTHS if lay else _CLOSURE_WAVELENGTHS, few)
    between = closure_nodes((theta.size - 1) * _BETWEEN_INCIDENCES + 1)
    integrals = _lobe_integrals(surface, bsdf, few, between.size * arcs.size)
    first_order = np.zeros((theta.size, arcs.size, few.size))
    kernel = np.zeros((few.size, *first_order.shape[:2], between.size * arcs.size))
    found: list[Sums] = []
    for row, angle in enumerate(np.minimum(theta, _NEARLY_GRAZING)):
        for number, (weight, angles) in enumerate(directions(float(angle))):
            corners = _closure_corners(bsdf, angles, between.size, arcs.size)
            # With a lay the light is integrated at other azimuths.
            sums = integrals(weight, angles, corners, closes=True, scatters=not lay)
            first_order[row, number], kernel[:, row, number] = sums.first_order, sums.mirror.T
            if not lay:
                found.append(sums)
    # Integrals of the halo vary slowly with incidence and wavelength; what the heights say of coherent light does not.
    place = np.arange(between.size) / _BETWEEN_INCIDENCES
    cosine = np.cos(np.radians(np.minimum(between, _NEARLY_GRAZING)))
    scale = cosine[:, None, None] / (wavelength * 1e-3) ** 2
    # Towards grazing the light of small slopes vanishes as the cosine does, that of `ghs` does not.
    slow = scale if bsdf.attrs["form"] != "ghs" else scale / cosine[:, None, None]
    first_order = _between_incidences(first_order / slow[::_BETWEEN_INCIDENCES, :, few], place)
    first_order = np.maximum(_between_wavelengths(first_order, wavelength[few], wavelength[many]), 0.0)
    change = 4e3 * np.pi * cosine[:, None] / wavelength[many]
    loss = first_order * (slow / scale)[..., many] * _height_variance(psd, float(bsdf["sigma"]), change)[:, None]
    target, of_few = -np.expm1(-loss * scale[..., many]), np.searchsorted(many, few)
    to_between = _between_incidences(np.eye(theta.size), place)

    def halo_of(factor: Array) -> Array:
        """Light of the halo over the factor of its incidence, for the factor of its exit, (incidences, arcs, few wavelengths) both."""
        integrated = (kernel @ factor.reshape(-1, few.size).T[:, None, :, None])[..., 0]
        return np.asarray(np.einsum("bt,wta->baw", to_between, integrated))

    wanted = target[..., of_few]
    factor = np.ones_like(wanted)
    for _ in range(_ITERATIONS):
        light = factor * halo_of(factor)
        factor = np.clip(factor * np.sqrt(wanted / np.maximum(light, 1e-300)), *_CLOSURES)
    light = halo_of(factor)
    left = np.abs(wanted - factor * light)[::_BETWEEN_INCIDENCES].max(axis=1)
    if many.size > few.size:
        light = _between_wavelengths(light, wavelength[few], wavelength[many])
        factor = np.clip(target / np.maximum(light, 1e-300), *_CLOSURES)
    bsdf = bsdf.assign_coords(closure_wavelength=wavelength[many], closure_incidence=between)
    dims = ["closure_incidence", "closure_wavelength"]
    if lay:
        bsdf, dims = bsdf.assign_coords(closure_arc=arcs), ["closure_incidence", "closure_arc", "closure_wavelength"]
    else:
        factor, loss = factor[:, 0], loss[:, 0]
    bsdf = bsdf.assign(halo_closure=(dims, factor), coherent_loss=(dims, loss))
    return bsdf, _between_wavelengths(left, wavelength[few], wavelength), found


def _lobe_integrals(surface: RoughSurface, bsdf: xr.Dataset, few: NDArray[np.int64], nodes: int) -> LobeIntegrals:
    """At some of the wavelengths."""
    # It takes a while to load, and waves alone do without it.
    from brdfpipe.bsdf.wave.lobe_integrals import LobeIntegrals

    wavelength, n, k = (bsdf[name].values[few] for name in ("wavelength", "n", "k"))
    return LobeIntegrals(surface, wavelength, n, k, nodes)


def _closure_corners(bsdf: xr.Dataset, angles: Angles, incidences: int, arcs: int) -> Corners:
    """Nodes of the closure about each outgoing direction."""
    ellipse = ellipse_of(bsdf) if arcs > 1 else None
    return closure_corners(np.cos(np.radians(angles[2])), angles[3], incidences, arcs, ellipse, compiled=True)


def _height_variance(psd: xr.Dataset, sigma: float, change: Array) -> Array:
    """Variance of the heights that the coherent light knows, over that of the roughness spectrum [1], of q [rad/um]; 1 without a scan.

    The spectrum takes heights as normal. What it has above its band is added to the measured heights.
    """
    if "coherent_sigma" not in psd:
        return np.ones_like(change)
    of_scan = np.interp(change, psd["phase_per_height"].values, psd["coherent_sigma"].values)
    beyond = max(sigma**2 - known_rms_height(psd) ** 2, 0.0)
    return np.asarray((of_scan**2 + beyond) / max(sigma**2, 1e-300))


def _evenly(size: int, count: int, also: NDArray[np.int64] | None = None) -> NDArray[np.int64]:
    """Numbers of so many of all, evenly spread, and of others."""
    chosen = np.unique(np.linspace(0, size - 1, min(size, count)).round().astype(int))
    return chosen if also is None else np.union1d(chosen, also)


def _between_incidences(values: Array, place: Array) -> Array:
    """Values (incidences, …) at places among their numbers, by a spline."""
    return np.asarray(CubicSpline(np.arange(len(values)), values)(place))


def _between_wavelengths(values: Array, known: Array, wanted: Array) -> Array:
    """Values (…, known wavelengths) at the wanted ones, by a spline."""
    return values if known.size == wanted.size else np.asarray(CubicSpline(known, values, axis=-1)(wanted))


def _directions(
    bsdf: xr.Dataset, azimuths: Array, nodes: EnergyNodes
) -> Callable[[float], Iterator[tuple[Array, Angles]]]:
    """Weights and directions of an integral over the lobe, by azimuths of incidence, as a function of its angle [degree]."""
    if azimuths.size > 1:
        (along, across), lay = Wave.widths_of(bsdf), ellipse_of(bsdf).lay
    else:
        slopes = Wave.lobe_slopes_of(bsdf)

    def at_incidence(theta_i: float) -> Iterator[tuple[Array, Angles]]:
        if azimuths.size == 1:
            # The rule covers one side of the plane of incidence.
            slope = min(slopes(0.0), slopes(theta_i))
            turns = nodes.turns * (1 if np.cos(np.radians(theta_i)) > _LONG_LOBE else 2)
            rules = [hemisphere.around_mirror(theta_i, slope, order=nodes.order, turns=turns)]
        else:
            rules = [
                hemisphere.around_mirror_with_lay(theta_i, float(phi), along, across, lay, nodes.order)
                for phi in azimuths
            ]
        for azimuth, (theta, phi, weight) in zip(azimuths, rules, strict=True):
            yield weight, (np.full_like(theta, theta_i), np.full_like(theta, azimuth), theta, phi)

    return at_incidence


def _count(directions: Callable[[float], Iterator[tuple[Array, Angles]]], theta: Array) -> int:
    """About how many directions the integrals at all angles of incidence have."""
    return theta.size * sum(weight.size for weight, _ in directions(45.0))


def _with_energy_statement(bsdf: xr.Dataset, missing: Array, theta: Array) -> xr.Dataset:
    """Say how much light coherent part and halo miss, (incidences,), if that is more than they should."""
    worst = int(missing.argmax())
    if missing[worst] <= ENERGY_LIMIT:
        return bsdf
    text = (
        f"coherent part and halo miss up to {missing[worst]:.4f} of the incident light that Fresnel's equations reflect, at "
        f"{theta[worst]:.0f}° incidence; it enters the base"
    )
    if missing[worst] <= missed_light.LIMITS[0]:
        return vocabulary.add_history(bsdf, text)
    return vocabulary.add_warning(bsdf, f"{text}. {missed_light.advice(bsdf)}")


def _scattered(surface: RoughSurface, bsdf: xr.Dataset, theta: Array, azimuths: Array, nodes: EnergyNodes) -> Array:
    """∫ f cos θ_o dω_o without coherent and diffuse light, (incidences, azimuths, wavelength)."""
    n, k, wavelength = (bsdf[name].values for name in ("n", "k", "wavelength"))
    few, directions = _evenly(wavelength.size, nodes.wavelengths), _directions(bsdf, azimuths, nodes)
    surface = surface.prepared_for(_count(directions, theta) * few.size)
    result = np.zeros((theta.size, azimuths.size, few.size))
    for row, angle in enumerate(np.minimum(theta, _NEARLY_GRAZING)):
        for number, (weight, angles) in enumerate(directions(float(angle))):
            result[row, number] = weight @ surface.evaluate(angles, wavelength[few], n[few], k[few])
    return _of_all_wavelengths(result, bsdf, theta, few)


def _closed_scattered(
    surface: RoughSurface, bsdf: xr.Dataset, theta: Array, azimuths: Array, found: list[Sums], nodes: EnergyNodes
) -> Array:
    """The same of a surface whose energy is closed; ``found`` are the integrals over its lobes, where they are known."""
    wavelength, closure, factor = bsdf["wavelength"].values, surface.closure, bsdf["halo_closure"]
    assert closure is not None
    few, directions = _evenly(wavelength.size, nodes.wavelengths), _directions(bsdf, azimuths, nodes)
    incidences, arcs = factor.shape[0], nodes.closure_arcs
    integrals = _lobe_integrals(surface, bsdf, few, incidences * arcs)
    # The light is linear in the factors of the outgoing directions.
    of_nodes = factor.sel(closure_wavelength=wavelength[few]).values.reshape(-1, few.size)
    result = np.zeros((theta.size, azimuths.size, few.size))
    for row, angle in enumerate(np.minimum(theta, _NEARLY_GRAZING)):
        sums = found[row : row + 1] or [
            integrals(weight, angles, _closure_corners(bsdf, angles, incidences, arcs), scatters=True)
            for weight, angles in directions(float(angle))
        ]
        cosine = np.full(azimuths.size, np.cos(np.radians(angle)))
        of_incidence = closure.of_halo(cosine, azimuths, wavelength[few])
        for number, one in enumerate(sums):
            result[row, number] = of_incidence[number] * np.einsum("nw,nw->w", of_nodes, one.halo) + one.facets
    return _of_all_wavelengths(result, bsdf, theta, few)


def _of_all_wavelengths(values: Array, bsdf: xr.Dataset, theta: Array, few: NDArray[np.int64]) -> Array:
    """Reflectances (incidences, azimuths, few wavelengths) at all, between which their ratio to Fresnel's is interpolated."""
    n, k, wavelength = (bsdf[name].values for name in ("n", "k", "wavelength"))
    smooth = np.maximum(_smooth(theta, n, k)[:, None], 1e-12)
    return _between_wavelengths(values / smooth[..., few], wavelength[few], wavelength) * smooth


class _Arcs(NamedTuple):
    """Arcs at which the reflectance of a surface with a lay is integrated."""

    values: Array
    """[degree]"""
    period: float
    """Part of a turn that they cover [degree]"""


def _arcs(bsdf: xr.Dataset, nodes: EnergyNodes) -> _Arcs:
    """Of half a turn, after which the halo is the same. The slopes of a scan are not, and near grazing incidence that shows."""
    count, period = (nodes.arcs_a_turn, 360.0) if "slope_along" in bsdf.coords else (nodes.arcs_a_half, 180.0)
    return _Arcs(np.arange(count) * period / count, period)


def _azimuths(bsdf: xr.Dataset, arcs: Array) -> Array:
    """Azimuths of incidence of arcs [degree]; one for a surface without a lay."""
    return arc_to_azimuth(ellipse_of(bsdf), arcs) if _has_azimuths(bsdf) else np.zeros(1)


def _has_azimuths(bsdf: xr.Dataset) -> bool:
    """Whether the halo or the facets of a surface have a lay."""
    return "halo_azimuth" in bsdf.dims or "phi_i" in bsdf.coords


def _between_azimuths(arcs: Array, nodes: Array, period: float) -> Array:
    """Weights (arcs, nodes) of trigonometric interpolation between an odd number of nodes over a period [degree]."""
    turn = 2 * np.pi / period * (arcs[:, None] - nodes)
    harmonics = sum(np.cos(order * turn) for order in range(1, (nodes.size - 1) // 2 + 1))
    return np.asarray((1 + 2 * harmonics) / nodes.size)


def _with_diffuse(bsdf: xr.Dataset, spectrum: xr.Dataset | None, theta_m: float) -> xr.Dataset:
    """Add the diffuse base that closes the total reflectance."""
    bare = bsdf.assign(diffuse=("wavelength", np.zeros(bsdf.sizes["wavelength"])), theta_m=theta_m)
    if spectrum is None or bsdf.attrs["diffuse_mode"] == "none":
        return bare
    model = Wave(bare)
    trapped = _trapped(model, spectrum, theta_m)
    total = spectrum["total_reflectance"].values.astype(float) + trapped
    phi = hemisphere.azimuths(model.isotropic)
    of_surface = model.albedo(np.full(phi.size, theta_m), phi, None).mean(axis=0)
    # Below 1 by the error of the albedo's table, so that a white base does not violate energy conservation.
    base = np.minimum((total - of_surface) / np.maximum(1 - of_surface, 1e-12), 1 - 2e-8)
    result = with_diffuse_reflectance(bare, base, total)
    if spectrum.attrs["geometry"] == "sce":
        result = vocabulary.add_history(
            result,
            f"specular excluded: the light reflected into a gloss trap of half angle {trap_of(spectrum):g}°, "
            f"{float(np.mean(trapped)):.4f} of the incident light, was added to the measured reflectance",
        )
    return with_clamping_warning(result, spectrum, base < 0, of_surface - total, "specular albedo of the surface")


def _trapped(model: Wave, spectrum: xr.Dataset, theta_m: float) -> Array:
    """Light that the surface reflects into the gloss trap, (wavelength or 1,); 0 if the specular was included."""
    if spectrum.attrs["geometry"] != "sce":
        return np.zeros(1)
    rule = hemisphere.around_mirror(theta_m, model.lobe_slope, trap_of(spectrum))
    zero = np.zeros_like(rule.theta)
    scattered = rule.weight @ model.evaluate(zero + theta_m, zero, rule.theta, rule.phi, None)
    return np.asarray(scattered + model.specular(np.array([theta_m]), np.zeros(1), None)[0][0])


# --- limits of the model


def _limits(bsdf: xr.Dataset, psd: xr.Dataset, correlation: height_transform.Autocorrelation) -> list[str]:
    """Warnings about what the model does not hold."""
    texts = []
    sigma = float(bsdf["sigma"])
    shortest = float(bsdf["wavelength"].min()) * 1e-3
    grid = np.geomspace(1e-6 / correlation.length, 1 / shortest, 4001)
    slope_rms = sigma * float(np.sqrt(8 * np.pi**3 * np.trapezoid(correlation.spectrum(grid) * grid**4, np.log(grid))))
    if slope_rms > SLOPE_LIMIT and bsdf.attrs["optics"] == "wave":
        texts.append(
            f"the rms slope at scales above the wavelength is {slope_rms:.2g}; the wave model, which has no masking and no local angle of "
            f"incidence, is accurate up to {SLOPE_LIMIT:g}. Set `model.optics: auto`"
        )
    if bsdf.attrs["optics"] == "composite":
        phase = (2 * np.pi * float(bsdf["facet_sigma"]) / _MIDDLE) ** 2
        if phase < COARSE_LIMIT:
            texts.append(
                f"the relief that is taken as facets has a phase variance of {phase:.2g} at 60° incidence (550 nm); facets need "
                f"{COARSE_LIMIT:g}. Set `model.optics: auto`"
            )
    if "facet_share" in bsdf and bsdf["facet_share"].values[0].min() >= FACETS_ALONE:
        return texts  # waves matter near grazing alone, where coarse roughness scatters
    beyond = max(0.0, 1 - (known_rms_height(psd) / sigma) ** 2) if psd.attrs["form"] == "measured" else 0.0
    if beyond > EXTRAPOLATED_LIMIT:
        texts.append(
            f"{100 * beyond:.0f} % of the mean square height are beyond the band of the roughness spectrum, from its fitted form. Scan "
            "with a smaller pitch"
        )
    # The share of the light that roughness beyond the band scatters, by the fitted form.
    scattered = beyond * (4 * np.pi * sigma / shortest) ** 2
    if psd.attrs["form"] == "measured" and float(psd["band_high"]) < 1 / shortest and scattered > ENERGY_LIMIT:
        texts.append(
            f"the roughness spectrum is measured up to {float(psd['band_high']):.3g} µm⁻¹; light scattered by more than "
            f"{np.degrees(np.arcsin(min(1.0, float(psd['band_high']) * shortest))):.2g}° at {1e3 * shortest:g} nm and normal incidence "
            "follows from its fitted form. Scan with a smaller pitch"
        )
    return texts
