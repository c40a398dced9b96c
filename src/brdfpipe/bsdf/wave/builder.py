"""The BSDF of a surface with low slopes over a diffuse base, from its roughness spectrum.

References
----------
:mod:`brdfpipe.bsdf.wave.halo` has those of the halo. The coherent share of the mirror reflection is e^(−g): Davies 1954 (Proc. IEE 101
part IV, 209), Bennett & Porteus 1961 (J. Opt. Soc. Am. 51, 123).
"""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from brdfpipe import hemisphere, vocabulary
from brdfpipe.bsdf.microfacet import energy
from brdfpipe.bsdf.microfacet.builder import (
    index_on,
    trap_of,
    wavelengths_of,
    with_clamping_warning,
    with_diffuse_reflectance,
)
from brdfpipe.bsdf.microfacet.microsurface import ModelError
from brdfpipe.bsdf.representations.wave import Wave
from brdfpipe.bsdf.wave import height_transform
from brdfpipe.bsdf.wave.two_scale import RoughSurface, characteristic_function
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.geometry import Array
from brdfpipe.masking.modes import HALOS, OPTICS
from brdfpipe.optics.fresnel_equations import fresnel
from brdfpipe.optics.index import refractive_index

FINE_PHASE = 0.02
"""Phase variance of roughness that is too fine to be facets, at normal incidence and 550 nm."""

LEAST_SLOPE = 3.0
"""Least exponent with which a measured spectrum is continued beyond its band: at 2 the heights beyond it have no end."""

EXTRAPOLATED_LIMIT = 0.2
"""Share of the mean square height beyond the band of a measured spectrum above which a warning says so."""

COARSE_LIMIT = 20.0
"""Phase variance of the facets of ``composite`` below which a warning says that they are too smooth."""

ENERGY_LIMIT = 1e-3
"""Share of the incident light by which coherent part and halo may miss Fresnel's reflectance without a statement."""

ENERGY_WARNING = 0.01
"""The same, above which the statement is a warning."""

SLOPE_LIMIT = 0.2
"""Rms slope √⟨p² + q²⟩ up to which the halo is used without a warning: it knows neither masking nor the local angle of incidence."""

_MIDDLE = 0.55
"""Wavelength at which a surface is judged [um]."""
_LEAST_SIGMA = 1e-9
"""Rms height below which a surface is as good as flat [um]."""
_INCIDENCES = 33


def build(
    psd: xr.Dataset,
    *,
    index: xr.Dataset | float | str,
    spectrum: xr.Dataset | None = None,
    wavelength: ArrayLike | None = None,
    form: str = HALOS[0],
    diffuse: str = "coupled",
    facets: xr.Dataset | None = None,
    optics: str = "wave",
    cut: float | None = None,
) -> xr.Dataset:
    """Wave-optical BSDF of a surface, alone or together with facets.

    Parameters
    ----------
    psd : kind ``psd``, measured or analytic (:func:`brdfpipe.psd.analytic`)
    index : kind ``index``, a number or a plastic's name; the refractive index of the body relative to air. A metal has k > 0
    spectrum : kind ``spectrum``, as for :func:`brdfpipe.bsdf.microfacet.build`. Without a spectrum there is no diffuse part
    wavelength : [nm], increasing; by default those of the spectrum, else of the index, else :data:`brdfpipe.bsdf.microfacet.builder.WAVELENGTHS`
    form : one of :data:`brdfpipe.masking.modes.HALOS`
    diffuse : ``coupled``, or ``none``
    facets : kind ``facets``, of the same surface; needed unless ``optics`` is ``wave``
    optics : ``wave``; ``composite``, where roughness below a cut scatters upon facets; or ``auto``, which passes from ``wave`` to
        ``composite`` with the phase variance and the slope
    cut : frequency that parts facets from finer roughness [um-1]; by default that above which the roughness has a phase variance of
        :data:`FINE_PHASE`, at most half an inverse wavelength

    Returns
    -------
    Dataset of kind ``bsdf``, representation ``wave``: the coherent share F e^(−g) of the mirror reflection is not part of the BSDF but of
    its specular reflectance, as that of a smooth surface

    Raises
    ------
    ModelError : an unknown form, no usable wavelengths, or an index below that of air without absorption.
    VocabularyError : a dataset of the wrong kind.

    Notes
    -----
    ``docs/model.md`` has the equations. Coherent part and halo together return at most Fresnel's reflectance F: where they would return
    more, the coherent part is reduced. Where they return less, the light enters the base, and ``energy_residual`` states how much.
    """
    vocabulary.validate(psd, "psd")
    index = vocabulary.validate(index, "index") if isinstance(index, xr.Dataset) else refractive_index(index)
    if form not in HALOS:
        raise ModelError(f"unknown form of the wave model {form!r}; accepted: {', '.join(HALOS)}; set `model.halo`")
    if diffuse not in ("coupled", "none"):
        raise ModelError(f"unknown diffuse {diffuse!r} of the wave model; accepted: coupled, none; set `model.diffuse`")
    if optics not in OPTICS[1:]:
        raise ModelError(
            f"unknown optics {optics!r} of the wave model; accepted: {', '.join(OPTICS[1:])}; set `model.optics`"
        )
    if optics != "wave" and (facets is None or facets["slope_density"].ndim != 1 or facets["slope_density"].size == 0):
        raise ModelError(
            f"optics {optics!r} needs facets of a rough surface without a lay; set `surface.isotropic: true` to average over its azimuth, or "
            "`model.optics: wave`"
        )
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
    bsdf = _halo_table(correlation, sigma, psd, given).assign_coords(wavelength=given)
    bsdf = bsdf.assign(n=("wavelength", n), k=("wavelength", k))
    attributes = {"optics": optics, "form": form, "diffuse_mode": diffuse, "transmission": "none"}
    bsdf.attrs |= {"representation": Wave.name, **attributes}
    if optics != "wave":
        bsdf = _with_relief(bsdf, correlation, psd, facets, cut)
    theta_m = 8.0 if spectrum is None else float(spectrum.attrs["theta_i"])
    bsdf = _with_albedo(bsdf, theta_m)
    bsdf = _with_diffuse(bsdf, spectrum, theta_m)
    bsdf = vocabulary.add_warning(bsdf, *warnings, *_limits(bsdf, psd, correlation))
    return vocabulary.label(bsdf, "bsdf")


# --- the roughness


def roughness(psd: xr.Dataset) -> tuple[height_transform.Autocorrelation, float]:
    """Roughness of a spectrum, and its rms height [um]."""
    form, length, slope = psd.attrs["form"], float(psd["fit_length"]), float(psd["fit_slope"])
    fitted: height_transform.Autocorrelation | None = None
    if np.isfinite(length) and length > 0:
        by_slope = np.isfinite(slope) and slope > 2
        fitted = height_transform.k_correlation(length, slope) if by_slope else height_transform.gaussian(length)
    if form != "measured":
        if fitted is None:
            raise ModelError(
                f"a roughness spectrum of the form {form!r} has no `fit_length`; give one, or measured values"
            )
        return fitted, float(psd["fit_sigma"])
    if not psd["psd"].values.any():
        return height_transform.gaussian(1.0), 0.0
    if fitted is not None and np.isfinite(slope) and slope < LEAST_SLOPE:
        fitted = height_transform.k_correlation(length, LEAST_SLOPE)
    return height_transform.measured(psd["frequency"].values, psd["psd"].values, fitted)


def _halo_table(
    correlation: height_transform.Autocorrelation, sigma: float, psd: xr.Dataset, wavelength: Array
) -> xr.Dataset:
    shortest = float(wavelength[0]) * 1e-3
    largest_phase = (4 * np.pi * max(sigma, _LEAST_SIGMA) / shortest) ** 2
    table = height_transform.tabulated(correlation, largest_phase, 2 / shortest).assign(sigma=sigma)
    table.attrs["spectrum"] = psd.attrs["form"]
    if psd.attrs["form"] != "measured":
        table = table.assign({name: float(psd[name]) for name in ("fit_length", "fit_slope")})
    return table


def _with_relief(
    bsdf: xr.Dataset,
    correlation: height_transform.Autocorrelation,
    psd: xr.Dataset,
    facets: xr.Dataset | None,
    cut: float | None,
) -> xr.Dataset:
    """Add the facets of the coarse relief, and the halo of the roughness upon them."""
    assert facets is not None
    vocabulary.validate(facets, "facets")
    sigma, shortest = float(bsdf["sigma"]), float(bsdf["wavelength"][0]) * 1e-3
    cut = _cut(correlation, sigma) if cut is None else cut
    fine, fine_sigma, facet_sigma = height_transform.split(correlation, sigma, cut)
    # The slopes that were counted, and those of them that are coarser than the cut.
    measured_to = (
        psd["scan_band_high"][0] if "scan_band_high" in psd else psd["band_high"]
    )  # facets are of the first scan
    counted = float(measured_to) if psd.attrs["form"] == "measured" else 1e4 / correlation.length
    whole = height_transform.slope_variance(correlation, sigma, counted)
    coarse = whole - height_transform.slope_variance(fine, fine_sigma, counted)
    factor = float(np.sqrt(np.clip(coarse / max(whole, 1e-300), 1e-6, 1.0)))
    # All slopes `factor` times as steep: Λ keeps its value where cot θ is as many times as large.
    relief = RadialDensity(facets["slope"].values * factor, facets["slope_density"].values / factor**2)
    theta = np.radians(facets["theta"].values)
    slopes = characteristic_function(relief)

    def of_slopes(distance: Array, root_g: float) -> Array:
        return slopes(distance * (root_g / fine_sigma))

    largest = (4 * np.pi * max(fine_sigma, _LEAST_SIGMA) / shortest) ** 2
    table = height_transform.tabulated(fine, largest, 2 / shortest, of_slopes)
    names = {"log_halo": "log_fine_halo", "phase_variance": "fine_phase_variance", "halo_frequency": "fine_frequency"}
    table = table.rename({**names, "frequency_scale": "fine_scale"})
    resolved = np.sqrt(height_transform.slope_variance(correlation, sigma, 1 / _MIDDLE))
    return (
        bsdf.assign({name: table[name] for name in ("log_fine_halo", "fine_scale")})
        .assign(
            slope_density=("slope", relief.density),
            lambda_smith=("theta", facets["lambda_smith"].values),
            fine_sigma=fine_sigma,
            facet_sigma=facet_sigma,
            resolved_slope=float(resolved),
        )
        .assign_coords(slope=relief.slope, theta=np.degrees(np.arctan2(np.sin(theta) / factor, np.cos(theta))))
    )


def _cut(correlation: height_transform.Autocorrelation, sigma: float) -> float:
    """Frequency above which the roughness has the phase variance :data:`FINE_PHASE`, at most half an inverse wavelength [um-1]."""
    limit = np.sqrt(FINE_PHASE) * _MIDDLE / (4 * np.pi)
    cuts = (
        np.geomspace(1e-2 / correlation.length, 0.5 / _MIDDLE, 60)
        if 1e-2 / correlation.length < 0.5 / _MIDDLE
        else np.empty(0)
    )
    rough = [cut for cut in cuts if height_transform.split(correlation, sigma, float(cut))[1] > limit]
    return float(max(rough, default=0.5 / _MIDDLE))


# --- energy and the diffuse base


def _with_albedo(bsdf: xr.Dataset, theta_m: float) -> xr.Dataset:
    """Add the reflectance of the surface, and what it misses of Fresnel's."""
    n, k, wavelength = (bsdf[name].values for name in ("n", "k", "wavelength"))

    def smooth(theta: Array) -> Array:
        cosine = np.where(theta >= 90, 0.0, np.cos(np.radians(theta)))
        return np.asarray(fresnel(cosine[:, None], n, k).mean)

    # Dense towards the normal and towards grazing.
    theta = np.degrees(np.arccos((1 + np.cos(np.linspace(np.pi, 0, _INCIDENCES))) / 2))[::-1]
    theta[-1] = 90.0
    surface = RoughSurface.of(bsdf)
    scattered = _scattered(surface, Wave.slope_of(bsdf), theta, wavelength, n, k)
    missing = smooth(theta) * (1 - surface.coherent_share(theta, wavelength)) - scattered
    # Facets may reflect more than a smooth surface; waves may not.
    waves = 1 - surface.facet_share(2 * np.cos(np.radians(theta)), wavelength)
    excess = np.maximum(-missing, 0.0) * waves
    table = energy.refined(smooth, 0.01, np.array([0.0, theta_m, 90.0]))

    def between(values: Array) -> Array:
        cosines = np.cos(np.radians(theta))[::-1]
        return np.asarray(CubicSpline(cosines, values[::-1])(np.cos(np.radians(table.theta))))

    albedo = np.clip(table.values - between(missing + excess), 0.0, 1.0)
    excess = np.maximum(between(excess), 0.0) if excess.any() else np.zeros_like(albedo)
    mean = energy.AlbedoTable(table.theta, albedo).mean()
    if surface.relief is None:
        bsdf = _with_energy_statement(bsdf, missing.max(axis=1), theta)
    else:
        share = surface.facet_share(2 * np.cos(np.radians(table.theta)), wavelength)
        bsdf = bsdf.assign(facet_share=(("theta_i", "wavelength"), share))
    return bsdf.assign_coords(theta_i=table.theta).assign(
        directional_albedo=(("theta_i", "wavelength"), albedo),
        coherent_excess=(("theta_i", "wavelength"), excess),
        mean_albedo=("wavelength", mean),
        energy_residual=float(np.max(missing * waves, initial=0.0)),
    )


def _with_energy_statement(bsdf: xr.Dataset, missing: Array, theta: Array) -> xr.Dataset:
    """Say how much light coherent part and halo miss, (incidences,), if that is more than they should."""
    worst = int(missing.argmax())
    if missing[worst] <= ENERGY_LIMIT:
        return bsdf
    text = (
        f"coherent part and halo miss up to {missing[worst]:.4f} of the incident light that Fresnel's equations reflect, at "
        f"{theta[worst]:.0f}° incidence; it enters the base"
    )
    if missing[worst] <= ENERGY_WARNING:
        return vocabulary.add_history(bsdf, text)
    return vocabulary.add_warning(bsdf, f"{text}. Set `model.optics: auto` if this matters")


def _scattered(surface: RoughSurface, slope: float, theta: Array, wavelength: Array, n: Array, k: Array) -> Array:
    """∫ f cos θ_o dω_o without coherent and diffuse light, (incidences, wavelength)."""
    result = np.zeros((theta.size, wavelength.size))
    for row, angle in enumerate(theta):
        if angle >= 90:
            continue
        rule = hemisphere.around_mirror(float(angle), slope, order=5, turns=12)
        zero = np.zeros_like(rule.theta)
        values = surface.evaluate((zero + angle, zero, rule.theta, rule.phi), wavelength, n, k)
        result[row] = rule.weight @ values
    return result


def _with_diffuse(bsdf: xr.Dataset, spectrum: xr.Dataset | None, theta_m: float) -> xr.Dataset:
    """Add the diffuse base that closes the total reflectance."""
    bare = bsdf.assign(diffuse=("wavelength", np.zeros(bsdf.sizes["wavelength"])), theta_m=theta_m)
    if spectrum is None or bsdf.attrs["diffuse_mode"] == "none":
        return bare
    model = Wave(bare)
    trapped = _trapped(model, spectrum, theta_m)
    total = spectrum["total_reflectance"].values.astype(float) + trapped
    of_surface = model.albedo(np.array([theta_m]), np.zeros(1), None)[0]
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
    if psd.attrs["form"] == "measured":
        beyond = 1 - (float(psd["sigma"]) / sigma) ** 2
        if beyond > EXTRAPOLATED_LIMIT:
            texts.append(
                f"{100 * beyond:.0f} % of the mean square height are beyond the band of the roughness spectrum, from its fitted form. Scan "
                "with a smaller pitch"
            )
    if psd.attrs["form"] == "measured" and float(psd["band_high"]) < 1 / shortest:
        texts.append(
            f"the roughness spectrum is measured up to {float(psd['band_high']):.3g} µm⁻¹; light scattered by more than "
            f"{np.degrees(np.arcsin(min(1.0, float(psd['band_high']) * shortest))):.2g}° at {1e3 * shortest:g} nm and normal incidence "
            "follows from its fitted form. Scan with a smaller pitch"
        )
    return texts
