"""Names, units and kinds of all datasets, quality flags, and their validation.

:data:`QUANTITIES` defines the names of variables, :data:`KINDS` the variables of each kind of dataset. A stage builds plain arrays
with these names, :func:`label` attaches units and long names, :func:`validate` checks the result.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf

import numpy as np
import xarray as xr
from numpy.typing import NDArray

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
    "missing",
)
"""Meanings of the values 0, 1, 2 … of every ``<field>_quality`` variable."""


@dataclass(frozen=True)
class Quantity:
    """Definition of a name: unit, long name and range."""

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
    "slope_along": Quantity("1", "surface slope along the lay"),
    "slope_across": Quantity("1", "surface slope across the lay, 90 degree counter-clockwise from it"),
    "x": Quantity("um", "position along x"),
    "y": Quantity("um", "position along y"),
    "scale": Quantity("1", "distance between the heights a slope is taken from, in pixels", 1),
    "second_theta_i": Quantity("degree", "polar angle of incidence on the first of two facets", 0, 90),
    "second_theta_o": Quantity("degree", "polar angle of light from the second of two facets", 0, 90),
    "second_plane": Quantity(
        "degree", "azimuth of the plane in the middle of both directions of a second reflection", 0, 180
    ),
    "second_phi": Quantity("degree", "azimuth of the second reflection by a surface with a lay", 0, 360),
    "second_azimuth": Quantity("1", "azimuth from the forward plane, scaled to the width of the lobe", 0, 1),
    "theta_s": Quantity("degree", "angle of the outgoing direction from the mirror direction", 0, 180),
    "phi_s": Quantity("degree", "azimuth about the mirror direction, 0 towards the normal", -720, 720),
    "direction_u": Quantity("degree", "standard uncertainty of the direction that a fibre sees", 0, 180),
    "theta_h": Quantity("degree", "polar angle of the half vector, from the normal", 0, 90),
    "phi_h": Quantity("degree", "azimuth of the half vector", -720, 720),
    "theta_d": Quantity("degree", "angle of incidence from the half vector", 0, 90),
    "phi_d": Quantity("degree", "azimuth of incidence about the half vector", -720, 720),
    "gloss_angle": Quantity("degree", "nominal gloss geometry", 0, 90),
    "solid_angle": Quantity("sr", "solid angle of the cell", 0, missing=True),
    "incidence": Quantity("degree", "angle of incidence of the rig's entrance", 0, 90),
    # Surface
    "height": Quantity("um", "height above the levelling form", missing=True),
    "missing_fraction": Quantity("1", "share of heights that are missing", 0, 1),
    # Facets
    "slope_density": Quantity("1", "probability density of facets in slope space, P22", 0),
    "D": Quantity("sr-1", "facet distribution D(m): area of facets per solid angle and projected area", 0),
    "count": Quantity("1", "number of facets in the bin", 0),
    "line_count": Quantity("1", "number of slopes along lines, of either sign, at the node nearest to them", 0),
    "line_count_along": Quantity("1", "number of slopes of lines along the lay at the node nearest to them", 0),
    "line_count_across": Quantity("1", "number of slopes of lines across the lay at the node nearest to them", 0),
    "lambda_smith": Quantity("1", "Smith's masking function Λ", 0),
    "median_slope": Quantity("1", "slope that half of the facets exceed", 0),
    "median_slope_log_u": Quantity("1", "standard uncertainty of the logarithm of the median slope", 0),
    "tail": Quantity("1", "tail of the slope density, 0 for Beckmann and 1 for GGX", 0, 1),
    "tail_u": Quantity("1", "standard uncertainty of the tail", 0),
    "gloss_chi_squared": Quantity("1", "χ² of the gloss readings with the slope density that agrees best", 0),
    "slope_rms": Quantity(
        "1",
        "root mean square slope of the facets, without spikes; missing where it is not finite",
        0,
        missing=True,
    ),
    "tail_slope": Quantity("1", "slope from which the slope density is extrapolated", 0),
    "tail_share": Quantity("1", "share of the facets in the extrapolated tail of the slope density", 0, 1),
    "tail_contribution": Quantity("1", "share of the counted mean square slope that the facets of the tail hold", 0, 1),
    "slope_rms_scale": Quantity("1", "root mean square slope against the distance it is taken over", 0, missing=True),
    "anisotropy": Quantity("1", "larger over smaller principal slope rms", 1, missing=True),
    "lay": Quantity("degree", "azimuth of the smaller principal slope rms, of an axis", 0, 180, missing=True),
    "facet_count": Quantity("1", "number of facets", 0),
    "effective_count": Quantity("1", "number of independent facets", 0),
    "correlation_length": Quantity("um", "distance at which the height correlation falls to 1/e", 0, missing=True),
    "noise_ratio": Quantity("1", "rms slope over one pixel divided by rms slope over two", 0, missing=True),
    # Roughness spectrum
    "frequency": Quantity("um-1", "spatial frequency of the heights", 1e-300),
    "frequency_x": Quantity("um-1", "spatial frequency of the heights along x"),
    "frequency_y": Quantity("um-1", "spatial frequency of the heights along y"),
    "psd": Quantity("um4", "two-sided power spectral density of the heights, mean over azimuth, without noise", 0),
    "psd_uncertainty": Quantity("um4", "standard uncertainty of: power spectral density of the heights", 0),
    "psd_planar": Quantity("um4", "two-sided power spectral density of the heights, without noise", 0),
    "apparent_frequency": Quantity("um-1", "spatial frequency of the heights, also outside the band", 1e-300),
    "apparent_psd": Quantity(
        "um4", "two-sided power spectral density of the heights, mean over azimuth, with noise", 0
    ),
    "noise_psd": Quantity("um4", "power spectral density of the noise that was subtracted", 0),
    "psd_noise_change": Quantity(
        "um4", "change of the power spectral density as the noise of some scans grows by its standard uncertainty"
    ),
    "sigma": Quantity("um", "rms height of the roughness spectrum in its band", 0),
    "long_sigma": Quantity("um", "rms height of the waves longer than the band of the roughness spectrum", 0),
    "long_slope": Quantity("1", "rms slope of the waves longer than the band of the roughness spectrum", 0),
    "sigma_heights": Quantity("um", "rms height of the levelled heights, without noise", 0),
    "noise_sigma": Quantity("um", "rms height of the noise that was subtracted", 0),
    "unresolved_sigma": Quantity("um", "rms height of what may be noise or roughness finer than the pitch", 0),
    "scan": Quantity("1", "number of a scan of the surface, from 1", 1),
    "scan_band_low": Quantity("um-1", "frequency above which a scan measures the roughness spectrum", 0),
    "scan_band_high": Quantity("um-1", "frequency below which a scan measures the roughness spectrum", 0),
    "band_low": Quantity("um-1", "frequency above which the roughness spectrum is measured", 0),
    "band_high": Quantity("um-1", "frequency below which the roughness spectrum is measured", 0),
    "coherent_sigma": Quantity("um", "rms of normal heights that reflect as much light coherently", 0),
    "coherent_sigma_u": Quantity(
        "um", "standard uncertainty of that rms, from the scatter between parts of the scan", 0
    ),
    "fit_sigma": Quantity("um", "rms height of the fitted form over all frequencies", 0),
    "fit_length": Quantity("um", "correlation length of the fitted form", 0),
    "fit_slope": Quantity("1", "exponent of the decay of the fitted form at high frequencies", 0, missing=True),
    "fit_residual_log": Quantity("1", "rms of the logarithm of the spectrum over the fitted form", 0),
    # Masking
    "g1": Quantity("1", "visible fraction of the facets that face the direction, by ray casting", 0, 1 + 1e-9),
    "lambda_empirical": Quantity("1", "Smith's masking function Λ of the slopes along the lines cast", 0),
    "g2": Quantity(
        "1", "fraction of facets facing both directions that both see, by ray casting", 0, 1 + 1e-9, missing=True
    ),
    "g2_raycast": Quantity("1", "G2 of the mirror direction by ray casting", 0, 1 + 1e-9, missing=True),
    "g2_separable": Quantity("1", "separable G2 after Smith, of the slopes along the lines", 0, 1 + 1e-9),
    "g2_height_correlated": Quantity(
        "1", "height-correlated G2 after Smith, of the slopes along the lines", 0, 1 + 1e-9
    ),
    "grazing": Quantity(
        "1", "1 / (1 + cot ζ / w), ζ the angle of a facet's normal to both directions, w the median slope", 0, 1
    ),
    "steepness": Quantity("1", "asinh(slope / w) of a facet, w the median slope", 0),
    "asymmetry": Quantity("1", "difference of the cosines of both directions over the largest possible one", 0, 1),
    "visibility_ratio": Quantity(
        "1", "facets of the map visible from both directions, over Smith's height-correlated G2", 0
    ),
    "visibility_ratio_u": Quantity("1", "standard uncertainty of: ratio of the visible facets to Smith's", 0),
    "steepness_towards": Quantity("1", "asinh(t / w), t the slope by which a facet falls towards a direction"),
    "single_ratio": Quantity("1", "facets visible from one direction, over Smith's G1", 0),
    "single_ratio_u": Quantity(
        "1", "standard uncertainty of: ratio of the facets visible from one direction to Smith's", 0
    ),
    "visible_share": Quantity(
        "1", "share of the once reflected light that no other facet intercepts, traced", 0, 1 + 1e-9
    ),
    "visible_share_u": Quantity("1", "standard uncertainty of: share of the light that no facet intercepts", 0),
    "smith_visible_share": Quantity("1", "the same share after Smith", 0, 1 + 1e-9),
    "smith_error": Quantity("1", "once reflected light after Smith over traced light, less 1", -1),
    "smith_error_u": Quantity("1", "standard uncertainty of: error of the light after Smith", 0),
    "limit_theta": Quantity("degree", "polar angle of the limit of the visibility", 0, 90),
    "visibility_limit": Quantity("1", "factor of either direction that keeps perfect mirrors from gaining light", 0, 1),
    # Spectrum and index
    "total_reflectance": Quantity("1", "total (diffuse and specular) reflectance", 0),
    "specular_excluded_reflectance": Quantity(
        "1", "total reflectance with the specular component excluded", 0, missing=True
    ),
    "n": Quantity("1", "real part of the refractive index", 0),
    "k": Quantity("1", "imaginary part of the refractive index (extinction coefficient)", 0),
    "internal_transmittance": Quantity(
        "1", "share of the light that passes a body straight from face to face", 0, 1 + 1e-9
    ),
    "thickness": Quantity("mm", "thickness of a body", 0),
    # BSDF
    "brdf": Quantity("sr-1", "bidirectional reflectance distribution function"),
    "spectrum_of_rgb": Quantity("1", "recovered reflectance of linear sRGB red, green and blue under D65"),
    "brdf_xyz": Quantity("sr-1", "tristimulus values of the BRDF; Y of a perfect white diffuser is 1/π"),
    "directional_albedo": Quantity("1", "directional albedo of the facets' specular reflection", 0, 1 + 1e-9),
    "mean_albedo": Quantity("1", "cosine-weighted mean of the directional albedo", 0, 1 + 1e-9),
    "furnace_albedo": Quantity("1", "directional albedo of the same facets as perfect mirrors", 0, 1 + 1e-9),
    "mean_furnace_albedo": Quantity("1", "cosine-weighted mean of the furnace albedo", 0),
    "compensation": Quantity("1", "reflectance of what leaves the facets after more than one reflection", 0, 1 + 1e-9),
    "second_reflection": Quantity("1", "factor A of the light reflected by two facets and more, docs/model.md", 0),
    "second_reflection_u": Quantity("1", "standard uncertainty of the traced second reflection over its value", 0),
    "second_share": Quantity(
        "1", "light that the map reflects more than once, traced, over the incident light", 0, 1 + 1e-9
    ),
    "second_share_u": Quantity("1", "standard uncertainty of: light reflected more than once", 0),
    "second_slope": Quantity("1", "typical slope to which the nodes of the second reflection are scaled", 0),
    "second_weight": Quantity("1", "factor of either direction of the second reflection by a surface with a lay", 0),
    "diffuse": Quantity("1", "diffuse reflectance d' below the facets", 0),
    "theta_m": Quantity("degree", "incidence at which the total reflectance was measured", 0, 90),
    "front_slope": Quantity("1", "magnitude of the slope of the front face", 0),
    "back_slope": Quantity("1", "magnitude of the slope of the back face", 0),
    "front_theta": Quantity("degree", "polar angle before the front face, from its normal", 0, 90),
    "back_theta": Quantity("degree", "polar angle behind the back face, from its normal", 0, 90),
    "front_slope_density": Quantity("1", "probability density of facets of the front face in slope space, P22", 0),
    "back_slope_density": Quantity("1", "probability density of facets of the back face in slope space, P22", 0),
    "front_lambda_smith": Quantity("1", "Smith's masking function Λ of the front face", 0),
    "back_lambda_smith": Quantity("1", "Smith's masking function Λ of the back face", 0),
    "front_diffuse": Quantity("sr-1/2", "factor of either angle in the diffuse reflection of the front face", 0),
    "back_diffuse": Quantity("sr-1/2", "factor of either angle in the diffuse reflection of the back face", 0),
    "reflectance": Quantity("1", "share of the light that returns to its side", 0, 1 + 1e-9),
    "absorptance": Quantity("1", "share of the light that is absorbed", 0, 1 + 1e-9),
    "theta_low": Quantity("degree", "smaller of two polar angles, each from its own face", 0, 90),
    "log_scattered": Quantity("1", "natural logarithm of the BSDF [sr-1] of light that has been inside a slab"),
    "log_shift": Quantity(
        "1", "what an uncertain input adds to the logarithm of the light that has been inside a slab"
    ),
    "shift_low": Quantity("degree", "smaller of two polar angles, each from its own face", 0, 90),
    "node_weight": Quantity("1", "weight of a node of the table of a coated body at a wavelength"),
    "faces_reflectance": Quantity(
        "1", "directional reflectance of the faces of a coated body, without light from its body"
    ),
    "faces_specular": Quantity("1", "share of it that is mirrored into one direction"),
    "body_share": Quantity(
        "1", "light that enters the body below a coat, over the root of the étendue of its direction"
    ),
    "body_weight": Quantity(
        "1", "light of the body below a coat: the BRDF is the product of two body_share times it over 2π", 0
    ),
    "lobe_scale": Quantity("degree", "width up to which the table of a slab counts distances evenly", 0),
    "index_node": Quantity("1", "refractive index at which a slab is tabulated", 1),
    "wavelength_node": Quantity("nm", "wavelength at which a slab with waves is tabulated", 100, 20000),
    "depth_node": Quantity("1", "root of the internal optical depth, √(-ln τ), at which a slab is tabulated", 0),
    "quadrature_error": Quantity(
        "1", "share of light by which sums over nodes missed what they were then scaled to", 0
    ),
    "interpolation_error": Quantity("1", "error of the tabulated part between its nodes, in the worst incidence", 0),
    "traced_incidence": Quantity("degree", "angle of incidence of traced rays", 0, 90),
    "half_slope_along": Quantity(
        "1", "slope of the half vector along the plane of incidence, positive towards the light"
    ),
    "half_slope_across": Quantity("1", "slope of the half vector across the plane of incidence, without sign", 0),
    "single_density": Quantity("1", "density in slope space of facets that reflect traced light once", 0),
    "multiple_density": Quantity("1", "the same of facets that would reflect the light traced over more than one", 0),
    "smith_slope": Quantity("1", "slope rms along one axis of the Gaussian masking that divides traced densities", 0),
    "slope_scale": Quantity("1", "slope up to which the nodes of traced densities are evenly spaced", 0),
    "traced_reflectance": Quantity(
        "1", "reflectance of a facet under light from everywhere, of the index traced", 0, 1 + 1e-9
    ),
    "reflected": Quantity(
        "1", "share of the light that leaves after one, two, and three or more reflections", 0, 1 + 1e-9
    ),
    "refracted": Quantity("1", "share of the light refracted at the first, second, and any further facet", 0, 1 + 1e-9),
    "lost": Quantity("1", "share of the traced light that was lost", 0, 1 + 1e-9),
    "phase_per_height": Quantity("um-1", "change of the phase of reflected light with height [rad/um]", 0),
    "light": Quantity("1", "share of the light that a model sends into a region", 0, 1 + 1e-9),
    "reference_light": Quantity("1", "the same of a reference solution", 0, 1 + 1e-9, missing=True),
    "light_error": Quantity("1", "predicted over reference light, less 1", missing=True),
    "valid": Quantity("1", "whether a reference solution holds at an incidence", 0, 1),
    "reference_gloss": Quantity("1", "gloss units of a reference solution", 0, missing=True),
    "gloss_error": Quantity("1", "predicted less reference gloss units", missing=True),
    "gloss_valid": Quantity("1", "whether a reference solution holds at a gloss angle", 0, 1),
    "spatial_frequency": Quantity("um-1", "spatial frequency that diffracts light into a direction", 0),
    "frequency_scale": Quantity("um-1", "frequency up to which a table counts frequencies evenly", 0),
    "log_phase_spectrum": Quantity(
        "1", "natural logarithm of the spectrum of the reflected field [um2] over (rad/um)²"
    ),
    "measured_area": Quantity("um2", "area of the measured heights of a map", 0),
    "coherent_share": Quantity("1", "share of the mirror reflection that is coherent", 0, 1 + 1e-9),
    "mixture": Quantity("1", "share of a wavelength in a mean over wavelengths", 0),
    "mixed_wavelength": Quantity("nm", "wavelength of a mean over wavelengths", 100, 20000),
    "tristimulus": Quantity("1", "CIE tristimulus values, Y = 100 for the perfect diffuser", 0),
    "reflectance_factor": Quantity(
        "1", "light over that of the perfect diffuser in the same directions, π times the BRDF", 0
    ),
    "theta_f": Quantity("degree", "flake angle: tilt of the flake that mirrors one direction into the other", 0, 90),
    "theta_f_measured": Quantity("degree", "flake angle of a measured geometry", 0, 90),
    "clear_coat_index": Quantity("1", "refractive index of the clear coat above the flakes", 1),
    "clear_coat_slope": Quantity("1", "root mean square slope of the clear coat", 0),
    "flake_amplitude": Quantity(
        "1", "A of the fit along the flake angle, on the scale of Y = 100 or of the reflectance factor", 0
    ),
    "flake_decay": Quantity("degree", "B of the fit: the flake angle over which the term falls to 1/e", 0),
    "flake_constant": Quantity("1", "C of the fit, on the scale of A", 0),
    "flake_covariance": Quantity("1", "covariance of A, B and C of a fit, in their units", missing=True),
    "flake_spectrum": Quantity(
        "1", "reflectance factor over its Y as a fraction, of the chromaticity at a flake angle", 0
    ),
    "misfit": Quantity("1", "fitted over measured value, less 1; missing for black", missing=True),
    "leave_one_out_misfit": Quantity(
        "1", "value of the fit to the other geometries over the measured one, less 1", missing=True
    ),
    "delta_e_00": Quantity("1", "CIEDE2000 of the fitted from the measured colour", 0),
    "leave_one_out": Quantity(
        "1", "CIEDE2000 of the colour that the fit to the other geometries gives", 0, missing=True
    ),
    "lambert": Quantity("1", "reflectance of the Lambertian part", 0),
    "gauss_peak": Quantity("sr-1", "peak G0 of the Gaussian part, at the specular direction", 0),
    "gauss_fwhm_parallel": Quantity("degree", "full width at half maximum in the plane of incidence", 0),
    "gauss_fwhm_perpendicular": Quantity("degree", "full width at half maximum across the plane of incidence", 0),
    "gauss_reflectance": Quantity("1", "reflectance of the Gaussian part, R_gauss", 0),
    "fit_residual": Quantity("1", "flux-weighted rms residual of the fit over the flux-weighted rms BRDF", 0),
    "fit_error_max": Quantity("1", "largest error of the fit over the BRDF or that of a Lambertian as bright", 0),
    "reflectance_error": Quantity("1", "error of the total reflectance of the fit over that of the model"),
    "pdf": Quantity("sr-1", "density of the samples per solid angle; missing for specular rays", 0, missing=True),
    "weight": Quantity("1", "BSDF times |cos θ_o| over the density: its mean is what leaves altogether"),
    "weight_variance": Quantity("1", "variance of the weights", 0),
    # Rig
    "signal": Quantity("1", "light of the cell over that of the reference behind the filter, L/(L′/T)", missing=True),
    "reference": Quantity("s-1", "electrons of the reference spot behind no filter", 0, missing=True),
    "drift_elapsed": Quantity("s", "time of a lamp monitor reading since the start of the run"),
    "drift_wavelength": Quantity("nm", "wavelength of a lamp monitor reading", 100, 20000),
    "drift_reference": Quantity(
        "s-1", "electrons of the reference spot without filter, in a lamp monitor reading", 0, missing=True
    ),
    "cell_scale": Quantity("sr-1", "BRDF times the cosine of view over the signal", 0, missing=True),
    "path": Quantity("1", "light an entrance sends to the holder, over that of the first", 0),
    "lamp": Quantity("s-1", "electrons of the reference spot behind no filter, during the etalon's run", 0),
    "scale_change": Quantity(
        "1", "logarithm of the cells' scale over that of the chart's first profile, median of the cells", missing=True
    ),
    "departing_wavelength": Quantity("nm", "wavelength that changed most against all", 100, 20000, missing=True),
    "change": Quantity("1", "change of a profile's logarithmic scale from the mean of those before it in the chart"),
    "limit": Quantity("1", "smallest significant change", 0, missing=True),
    "violation": Quantity("1", "whether a profile changed by more than the limit", 0, 1),
    "coefficient": Quantity(
        "1", "coefficient of the BSDF [sr-1], or of its natural logarithm, in the basis of the fit"
    ),
    "coefficient_factor": Quantity(
        "1", "factor L of the covariance L Lᵀ of the coefficients that independent errors cause"
    ),
    "coefficient_common": Quantity(
        "1", "change of the coefficients as a common error of one standard uncertainty makes"
    ),
    "residual": Quantity(
        "1", "measured less fitted value over its standard uncertainty; missing where not used", missing=True
    ),
    "strength": Quantity("1", "strength ε of smoothing", 0),
    "chosen_strength": Quantity("1", "strength ε of smoothing of the fit", 0),
    "gcv": Quantity("1", "generalised cross-validation, mean over wavelengths", 0, missing=True),
    "chi_squared": Quantity("1", "χ², mean over wavelengths", 0, missing=True),
    "chi_squared_dof": Quantity("1", "χ² over the degrees of freedom left", 0, missing=True),
    "roughness": Quantity("1", "penalty of the fit without its strength, mean over wavelengths", 0, missing=True),
    "effective_parameters": Quantity("1", "effective number of parameters, trace of the smoother", 0, missing=True),
    "horizon": Quantity("degree", "largest polar angle at which a cell was measured, from the normal", 0, 90),
    "transmitted": Quantity("1", "1 for a node of transmission, 0 for one of reflection", 0, 1),
    "lowest": Quantity("1", "smallest fitted value at a cell that was measured, or its logarithm"),
    "highest": Quantity("1", "largest fitted value at a cell that was measured, or its logarithm"),
    "incidence_error": Quantity(
        "1", "standard uncertainty of the logarithm of the BSDF in one direction of light, rms over wavelength", 0
    ),
    "error_angle": Quantity("degree", "angle from the mirror direction at which that uncertainty is known", 0, 180),
    "error_azimuth": Quantity("degree", "azimuth about the mirror direction at which it is known", 0, 180),
    "log_halo": Quantity("1", "natural logarithm of the halo's transform [um2] over the phase variance"),
    "phase_variance": Quantity("1", "variance g of the phase that the heights give to reflected light", 0),
    "halo_frequency": Quantity("um-1", "spatial frequency that scatters light into a direction", 0),
    "halo_azimuth": Quantity("degree", "azimuth of that frequency from the lay, after the stretch", 0, 180),
    "halo_lay": Quantity("degree", "azimuth along the lay of the roughness spectrum", 0, 180),
    "halo_stretch": Quantity("1", "factor by which frequencies along the lay are stretched, and across it divided", 1),
    "log_fine_halo": Quantity("1", "the same of roughness finer than facets, convolved with the facets' slopes"),
    "fine_phase_variance": Quantity("1", "phase variance of the roughness finer than facets", 0),
    "fine_frequency": Quantity("um-1", "spatial frequency that scatters light of the roughness finer than facets", 0),
    "fine_scale": Quantity("um-1", "frequency up to which that table counts frequencies evenly", 0),
    "fine_sigma": Quantity("um", "rms height of the roughness finer than facets", 0),
    "cut_error": Quantity("1", "relative change of the lobe if the cut between facets and finer roughness moves", 0),
    "facet_sigma": Quantity("um", "rms height of the relief that is one of facets", 0),
    "resolved_slope": Quantity("1", "root mean square slope at scales above the wavelength", 0),
    "halo_closure": Quantity(
        "1", "factor of either direction by which the halo of a perfect mirror returns all light", 0
    ),
    "coherent_loss": Quantity(
        "um2", "minus the logarithm of the coherent share, times the squared wavelength over the cosine", 0
    ),
    "closure_incidence": Quantity("degree", "angle of incidence of the factor of the halo", 0, 90),
    "closure_arc": Quantity("degree", "arc of half a turn of incidence of the factor of the halo, with a lay", 0, 180),
    "closure_wavelength": Quantity("nm", "wavelength of the factor of the halo", 0),
    "passage_phase": Quantity("1", "phase variance at which half of the light is reflected as by facets", 0),
    "facet_share": Quantity(
        "1", "share of the light that is reflected as by facets, towards the mirror direction", 0, 1 + 1e-9
    ),
    "coherent_excess": Quantity(
        "1", "reflectance by which the coherent part is reduced, so that no light is gained", 0
    ),
    "energy_residual": Quantity("1", "share of the light that coherent part and halo miss of Fresnel's reflectance", 0),
    # Texture beside the BRDF
    "texture_frequency": Quantity("um-1", "spatial frequency of a ring in the power spectrum of a texture", 0),
    "sample_psd": Quantity("um4", "power spectral density of the heights of a scan on the pixels of its texture", 0),
    "tile_psd": Quantity("um4", "power spectral density of the heights of a texture", 0),
    "relative_light": Quantity("1", "light of a texture over its mean, which is that of the BRDF", 0),
    "sample_contrast_psd": Quantity("um2", "power spectral density of the relative light of a picture", 0),
    "tile_contrast_psd": Quantity("um2", "power spectral density of the relative light of a texture", 0),
    "quantile": Quantity("1", "share of the places of a picture that are darker", 0, 1),
    "light_quantile": Quantity("1", "relative light of a picture that a share of its places does not exceed", 0),
    "illumination_range": Quantity("1", "largest illumination of a picture over the least, less 1; divided out", 0),
    "sparkle_density": Quantity("mm-2", "sparkles of a picture per area", 0),
    "sparkle_area": Quantity("um2", "mean area of a sparkle", 0),
    "sparkle_contrast": Quantity("1", "mean of the peaks of the sparkles over the background, less 1", 0),
    "graininess": Quantity("1", "rms contrast of the pattern of a picture that an eye sees at the distance stated", 0),
    "tile_sparkle_density": Quantity("mm-2", "sparkles of a texture per area", 0),
    "tile_graininess": Quantity("1", "the same rms contrast of a texture", 0),
    "level_pixel": Quantity("um", "side of a pixel of a texture that was tried for a viewing distance", 0),
    "level_difference": Quantity(
        "1",
        "largest relative difference of the contrasts that an eye sees with this pixel and with the finest",
        0,
    ),
    "unresolved_share": Quantity(
        "1", "share of the mean square slope that the pixels of a texture do not resolve", 0, 1
    ),
    "split_difference": Quantity(
        "1", "share of the facets at other slopes when those of a texture and of the rest are put together", 0, 1
    ),
    "spectrum_difference": Quantity(
        "1",
        "largest relative difference of the power spectra of texture and sample up to half the Nyquist frequency",
        0,
    ),
    "value_difference": Quantity(
        "1", "largest difference of the cumulated distributions of values, Kolmogorov's", 0, 1
    ),
    "slope_difference": Quantity("1", "the same of the differences of neighbouring pixels", 0, 1),
    # Uncertain inputs of a prediction
    "change_theta": Quantity("degree", "incidence at which the change of an albedo is known", 0, 90),
    "change_phase": Quantity("1", "phase variance at which the change of a halo is known", 0),
    "error_theta": Quantity(
        "degree",
        "incidence at which the relative error of a model is known; beyond 90 on the back side of a sheet",
        0,
        180,
    ),
    "relative_error": Quantity(
        "1", "relative error of a model, as a standard uncertainty; missing where not known", 0, missing=True
    ),
    "transmitted_loss": Quantity(
        "1",
        "share of the light straight through a sheet that finer roughness may scatter, as a standard uncertainty",
        0,
        1,
    ),
    "finer_roughness_loss": Quantity(
        "1", "share of the light of a lobe that finer roughness may scatter, as a standard uncertainty", 0, 1
    ),
    "error_gloss_angle": Quantity("degree", "angle at which the error of the gloss of a model is compared", 0, 90),
    "model_gloss_error": Quantity(
        "1", "error of the gloss of a model [gloss units], as a standard uncertainty with its sign", missing=True
    ),
    "reference_gloss_u": Quantity(
        "1",
        "standard uncertainty of the gloss it is compared with [gloss units], by the finite map that both are of",
        0,
        missing=True,
    ),
    # Comparison of two routes
    "brdf_model": Quantity("sr-1", "bidirectional reflectance distribution function of a model", 0),
    "ratio": Quantity("1", "measured over modelled value; missing where not used", missing=True),
    "z": Quantity(
        "1", "measured less modelled value over the standard uncertainty; missing where not used", missing=True
    ),
    "read_value": Quantity("1", "reading of an instrument, in the unit of the reading"),
    "read_u": Quantity("1", "standard uncertainty of a reading", 0),
    "predicted_value": Quantity("1", "what the BSDF predicts of a reading; missing where it does not", missing=True),
    "predicted_u": Quantity("1", "standard uncertainty of it; missing where not known", 0, missing=True),
    "z_adjusted": Quantity("1", "the same with the inputs that agree best", missing=True),
    "median_ratio": Quantity("1", "median of measured over modelled value over cells and wavelengths", missing=True),
    "rms_z": Quantity("1", "root mean square of z over cells and wavelengths", 0, missing=True),
    "seen_reflectance": Quantity("1", "share of the light that leaves into the directions of the cells used"),
    "seen_reflectance_model": Quantity("1", "the same of a model", 0),
    "prior": Quantity("1", "input as it was given: 0 for a shift, 1 for a factor"),
    "posterior": Quantity("1", "input that agrees best with measurement and prior"),
    "correlation": Quantity("1", "correlation of the errors of the inputs", -1 - 1e-9, 1 + 1e-9),
    # Checks
    "albedo": Quantity("1", "directional reflectance", 0),
    "transmittance": Quantity("1", "share of the light that leaves on the other side", 0),
    "grazing_growth": Quantity("1", "largest BRDF at 89.99 degree over that at 89.9 degree", 0, missing=True),
    "reciprocity_residual": Quantity("1", "largest |f(i,o) - f(o,i)| over their mean", 0, missing=True),
    "energy_excess": Quantity("1", "largest directional reflectance above 1", 0),
    "negative_fraction": Quantity("1", "share of directions with a negative or undefined BRDF", 0, 1),
    "closure_residual": Quantity("1", "largest |integrated - given| total reflectance", 0, missing=True),
    "integral_residual": Quantity("1", "largest |integrated BRDF - albedo| over a few incidences", 0),
    "floor": Quantity("sr-1", "smallest BRDF over the directions checked"),
    # Appearance
    "gloss": Quantity("1", "gloss units, D523-style", 0),
    "gloss_along": Quantity("1", "gloss units, plane of incidence along the lay, D523-style", 0),
    "gloss_across": Quantity("1", "gloss units, plane of incidence across the lay, D523-style", 0),
    "haze": Quantity("1", "gloss at 60 degree minus gloss at 20 degree, D4039-style", missing=True),
    "reflectance_haze": Quantity(
        "1", "light beside the mirror image of a source, black glass being 100, ISO 13803-style", 0
    ),
    "lab_sce": Quantity("1", "CIE 1976 L*a*b* at 8 degree, specular component excluded"),
    "lab_along": Quantity("1", "CIE 1976 L*a*b*, plane of incidence along the lay", missing=True),
    "lab_across": Quantity("1", "CIE 1976 L*a*b*, plane of incidence across the lay", missing=True),
    "luminous_transmittance": Quantity(
        "1", "total transmittance at normal incidence, weighted with V(λ) and D65", 0, 1 + 1e-9, missing=True
    ),
    "transmission_haze": Quantity(
        "1",
        "share of the transmitted light scattered by more than 2.5 degree at normal incidence, D1003-style",
        0,
        1 + 1e-9,
        True,
    ),
    "specular_reflectance": Quantity("1", "share of the light mirrored into one single direction", 0, 1 + 1e-9),
    "specular_transmittance": Quantity("1", "share of the light that passes into one single direction", 0, 1 + 1e-9),
    "lab": Quantity("1", "CIE 1976 L*a*b*", missing=True),
    "luminous_reflectance": Quantity("1", "total reflectance at 8 degree, weighted with V(λ) and D65", 0, missing=True),
    "flop_index": Quantity("1", "flop index", missing=True),
    "picture": Quantity("1", "sRGB picture of a material", 0, 255),
    "picture_in": Quantity("1", "sRGB picture of a material in a further light", 0, 255),
    "srgb": Quantity("1", "sRGB preview colour", 0, 1, missing=True),
    # Plan of a scene
    "expected_error": Quantity(
        "1",
        "error of a candidate that is expected from other materials, in the unit of the scene's metric; missing where too few were tried",
        0,
        missing=True,
    ),
    "error_bound": Quantity(
        "1",
        "upper bound of the error of a candidate, the expected error with a margin, in the unit of the scene's metric; missing where too few were tried",
        0,
        missing=True,
    ),
    "expected_cost": Quantity(
        "s", "processor time of the model of a candidate that is expected from other materials", 0, missing=True
    ),
    "chosen": Quantity("1", "whether the candidate was chosen", 0, 1),
    "feature_value": Quantity("1", "feature of a material from which errors of models are expected"),
    # Camera rig
    "counts": Quantity("1", "counts of the camera", 0),
    "shot": Quantity("1", "number of an exposure in its plan", 1),
    "exposure": Quantity("s", "exposure time", 0),
    "wavelength_read": Quantity("nm", "wavelength the monochromator said it was at", 0, 20000),
    "nd_position": Quantity("1", "position of the wheel of neutral filters", 1),
    "nd_transmittance": Quantity("1", "transmittance of the neutral filter, as described", 0, 1),
    "elapsed": Quantity("s", "time since the start of the run"),
    "temperature": Quantity("degC", "temperature of the camera's sensor", -273.15, missing=True),
    "aim_theta": Quantity(
        "degree", "angle from the mirror direction to which a turned mirror sends the light", 0, 180, missing=True
    ),
    "aim_phi": Quantity("degree", "azimuth to which a turned mirror sends the light", missing=True),
}


@dataclass(frozen=True)
class Kind:
    """Definition of a kind of dataset: variables with their possible dimensions, and attributes."""

    required: Mapping[str, Sequence[tuple[str, ...]]]
    optional: Mapping[str, Sequence[tuple[str, ...]]] = field(default_factory=dict)
    attributes: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()
    """Variables that may have missing values in this kind, even if their quantity forbids it."""


_ISOTROPIC: Sequence[tuple[str, ...]] = [("slope",)]
SLOPES: Sequence[tuple[str, ...]] = [("slope",), ("slope_across", "slope_along")]
SPECTRAL: Sequence[tuple[str, ...]] = [("wavelength",), ()]
SCALAR: Sequence[tuple[str, ...]] = [()]
VISIBILITY_COORDINATES: Sequence[tuple[str, ...]] = [("grazing", "steepness", "asymmetry")]
SINGLE_VISIBILITY_COORDINATES: Sequence[tuple[str, ...]] = [("grazing", "steepness_towards")]
SECOND_REFLECTION: dict[str, Sequence[tuple[str, ...]]] = {
    "second_reflection": [
        ("second_theta_i", "second_theta_o", "second_azimuth", *plane, *spectral)
        for plane in ((), ("second_plane",))
        for spectral in (("wavelength",), ())
    ],
    "second_slope": SCALAR,
    "second_weight": [("second_theta_i", "second_phi")],
}
"""Variables of the light that is reflected more than once."""
_INCIDENCE: Sequence[tuple[str, ...]] = [("theta_i",)]
_CELLS: Sequence[tuple[str, ...]] = [("incidence", "wavelength", "cell")]
_CELL: dict[str, Sequence[tuple[str, ...]]] = {"theta_s": [("cell",)], "phi_s": [("cell",)]}
_TRIALS: Sequence[tuple[str, ...]] = [("incidence", "trial")]

_FACETS = Kind(
    required={
        "slope_density": SLOPES,
        "D": [("alpha",), ("alpha", "beta")],
        "lambda_smith": [("theta",), ("theta", "phi")],
        "slope_rms": SCALAR,
    },
    optional={
        "count": SLOPES,
        "line_count": [("slope",)],
        "line_count_along": [("slope_along",)],
        "line_count_across": [("slope_across",)],
        "anisotropy": SCALAR,
        "lay": SCALAR,
        "facet_count": SCALAR,
        "effective_count": SCALAR,
        "correlation_length": SCALAR,
        "noise_ratio": SCALAR,
        "noise_sigma": SCALAR,
        "noise_sigma_u": SCALAR,
        "slope_rms_scale": [("scale",)],
        **dict.fromkeys(("median_slope", "median_slope_log_u", "tail", "tail_u", "gloss_chi_squared"), SCALAR),
        **dict.fromkeys(("tail_slope", "tail_share", "tail_contribution"), SCALAR),
        "slope_density_change": [("uncertain_change", *slopes) for slopes in SLOPES],
    },
    attributes=("method", "band"),
)

_CANDIDATE: Sequence[tuple[str, ...]] = [("candidate",)]

MEASUREMENT = ("day", "rig", "calibrated", "certificate")
"""Attributes of what a rig measured, kinds ``primary``, ``smoothed`` and ``bsdf``: the day and the rig, and the day and the certificate of the
calibration. Of both sides of a sheet those of reflection come first."""


KINDS: Mapping[str, Kind] = {
    "plan": Kind(
        {
            **dict.fromkeys(("expected_error", "error_bound", "expected_cost", "chosen"), _CANDIDATE),
            "feature_value": [("feature",)],
        },
        attributes=("scene", "metric", "unit", "tolerance", "choice", "numerics", "numerical_error"),
    ),
    "surface": Kind({"height": [("y", "x"), ("x",)]}, attributes=("pitch_x", "levelling", "band")),
    "facets": _FACETS,
    "psd": Kind(
        {
            "psd": [("frequency",)],
            "psd_uncertainty": [("frequency",)],
            **dict.fromkeys(("sigma", "sigma_heights", "noise_sigma", "band_low", "band_high"), SCALAR),
            **{f"fit_{name}{u}": SCALAR for name in ("sigma", "length", "slope") for u in ("", "_u")},
        },
        optional={
            "psd_planar": [("frequency_y", "frequency_x")],
            "coherent_sigma": [("phase_per_height",)],
            "coherent_sigma_u": [("phase_per_height",)],
            "psd_quality": [("frequency",)],
            "psd_noise_change": [("uncertain_noise", "frequency")],
            "apparent_psd": [("apparent_frequency",)],
            **{f"scan_band_{end}": [("scan",)] for end in ("low", "high")},
            **dict.fromkeys(("sigma_u", "noise_sigma_u", "unresolved_sigma", "noise_psd", "fit_residual_log"), SCALAR),
            **dict.fromkeys(("long_sigma", "long_sigma_u", "long_slope"), SCALAR),
        },
        attributes=("form", "method"),
    ),
    "spectrum": Kind(
        {"total_reflectance": [("wavelength",)]},
        optional={
            name: [("wavelength",)]
            for name in ("total_reflectance_u", "specular_excluded_reflectance", "specular_excluded_reflectance_u")
        },
        attributes=("geometry", "theta_i", "method"),
    ),
    "index": Kind(
        {"n": [("wavelength",)], "k": [("wavelength",)]}, optional={"n_u": [("wavelength",)]}, attributes=("source",)
    ),
    "interior": Kind(
        {"internal_transmittance": [("wavelength",)], "thickness": SCALAR},
        optional={"internal_transmittance_u": [("wavelength",)]},
        attributes=("source", "dispersion"),
    ),
    "multiangle": Kind(
        {angle: [("geometry",)] for angle in ("theta_i", "phi_i", "theta_o", "phi_o")},
        optional={f"tristimulus{u}": [("geometry", "channel")] for u in ("", "_u")}
        | {"lab_u": [("geometry", "component")]}
        | {f"reflectance_factor{u}": [("geometry", "wavelength")] for u in ("", "_u")},
    ),
    "colours": Kind({"lab": [("geometry", "component")]}, attributes=("illuminant", "observer")),
    "reduced": Kind(
        {**_CELL, "signal": _CELLS, "reference": [("incidence", "wavelength")]},
        optional={
            **{name: [("incidence", "wavelength")] for name in ("reference_u", "elapsed")},
            **{f"drift_{name}": [("look",)] for name in ("elapsed", "wavelength", "reference", "reference_u")},
        },
        missing=("elapsed",),
    ),
    "calibration": Kind(
        {**_CELL, "cell_scale": [("wavelength", "cell")], "lamp": [("wavelength",)]}
        | {"path": [("incidence", "wavelength")]},
        optional={
            "profile_day": [("profile",)],
            "departing_wavelength": [("profile",)],
            "scale_change": [("profile", "wavelength")],
            **{name: [("profile", "watched")] for name in ("change", "limit", "violation")},
        },
        attributes=("certificate", "day", "rig_digest"),
    ),
    "primary": Kind(
        {**_CELL, "brdf": _CELLS, "brdf_u": _CELLS},
        optional={"brdf_quality": _CELLS, "solid_angle": [("cell",)]},
        missing=("brdf",),
    ),
    "smoothed": Kind(
        {
            **_CELL,
            "coefficient": [("incidence", "wavelength", "term")],
            "coefficient_factor": [("incidence", "wavelength", "term", "factor")],
            "residual": _CELLS,
            "chi_squared_dof": [("incidence", "wavelength")],
            "chosen_strength": [("incidence",)],
            **dict.fromkeys(("strength", "gcv", "chi_squared", "roughness", "effective_parameters"), _TRIALS),
        },
        optional={"coefficient_common": [("component", "incidence", "wavelength", "term")]},
        attributes=("mode", "link", "about", "basis", "side"),
        missing=("coefficient", "coefficient_factor", "coefficient_common"),
    ),
    "comparison": Kind(
        {
            **dict.fromkeys(("brdf", "brdf_u", "brdf_u_independent", "brdf_u_common"), _CELLS),
            **{
                name: [("model", "incidence", "wavelength", "cell")]
                for name in ("brdf_model", "brdf_model_u", "ratio", "z")
            },
            **{name: [("model", "incidence")] for name in ("median_ratio", "rms_z")},
            **{name: [("incidence", "wavelength")] for name in ("seen_reflectance", "seen_reflectance_u")},
            "seen_reflectance_model": [("model", "incidence", "wavelength")],
            "chi_squared_dof": [("model",)],
        }
        | _CELL,
        optional={
            **{name: [("input",)] for name in ("prior", "prior_u", "posterior", "posterior_u")},
            "correlation": [("input", "input_2")],
        },
        attributes=("findings",),
        missing=("brdf",),
    ),
    "readings": Kind(
        {name: [("reading",)] for name in ("read_value", "read_u", "predicted_value", "predicted_u", "z")},
        optional={
            "z_adjusted": [("reading",)],
            **{name: [("input",)] for name in ("prior", "prior_u", "posterior", "posterior_u")},
            "correlation": [("input", "input_2")],
        },
        attributes=("verdicts", "units_of_readings", "not_predicted"),
    ),
    "model_error": Kind(
        required={
            "light": [("plane", "theta_i", "region")],
            **{
                name: [("reference", "plane", "theta_i", "region")]
                for name in ("reference_light", "light_error", "light_error_u")
            },
            "valid": [("reference", "theta_i")],
            "gloss": [("plane", "gloss_angle")],
            **{
                name: [("reference", "plane", "gloss_angle")]
                for name in ("reference_gloss", "gloss_error", "gloss_error_u")
            },
            "gloss_valid": [("reference", "gloss_angle")],
            **dict.fromkeys(("phase_variance", "g2_raycast", "g2_raycast_u", "g2_height_correlated"), _INCIDENCE),
        },
        attributes=("rays", "seed", "refusals", "advice"),
    ),
    "uncertainty": Kind(
        {},
        optional={
            **{
                key: [("error_theta", "region")]
                for key in ("relative_error", "transmitted_loss", "finer_roughness_loss")
            },
            **{key: [("error_gloss_angle",)] for key in ("model_gloss_error", "reference_gloss_u")},
        },
        attributes=("uncertainty_not_stated",),
    ),
    "bsdf": Kind({}, attributes=("representation",)),
    # A scene asks for some of it.
    "appearance": Kind(
        {},
        optional={
            "gloss": [("gloss_angle",)],
            "haze": SCALAR,
            "lab": [("geometry", "component")],
            "lab_sce": [("component",)],
            "flop_index": SCALAR,
            "luminous_reflectance": SCALAR,
            "srgb": [("channel",)],
            "gloss_u": [("gloss_angle",)],
            "gloss_quality": [("gloss_angle",)],
            "haze_u": SCALAR,
            "reflectance_haze": [("haze_window",)],
            "reflectance_haze_u": [("haze_window",)],
            "lab_u": [("geometry", "component")],
            "lab_quality": [("geometry",)],
            "flop_index_u": SCALAR,
            "luminous_reflectance_u": SCALAR,
            "gloss_u_source": [("source", "gloss_angle")],
            "reflectance_haze_u_source": [("source", "haze_window")],
            "lab_u_source": [("source", "geometry", "component")],
            **{f"{name}_u_source": [("source",)] for name in ("haze", "flop_index", "luminous_reflectance")},
            **{f"{name}_u": SCALAR for name in ("luminous_transmittance", "transmission_haze")},
            **{f"{name}_u_source": [("source",)] for name in ("luminous_transmittance", "transmission_haze")},
            "lay": SCALAR,
            "gloss_along": [("gloss_angle",)],
            "gloss_across": [("gloss_angle",)],
            "lab_along": [("geometry", "component")],
            "lab_across": [("geometry", "component")],
            "luminous_transmittance": SCALAR,
            "transmission_haze": SCALAR,
        },
    ),
    "export": Kind({}, attributes=("format", "side", "files", "records")),
    "texture": Kind(
        {},
        optional={
            "height": [("y", "x")],
            **{key: [("texture_frequency",)] for key in ("sample_psd", "tile_psd")},
            **dict.fromkeys(("unresolved_share", "split_difference"), SCALAR),
            "level_difference": [("level_pixel",)],
            **{key: [(), ("geometry",)] for key in ("spectrum_difference", "value_difference", "slope_difference")},
            "relative_light": [("geometry", "y", "x")],
            "sample_contrast_psd": [("geometry", "texture_frequency")],
            "tile_contrast_psd": [("geometry", "texture_frequency")],
            "light_quantile": [("geometry", "quantile")],
            **{key: [("geometry",)] for key in ("theta_f", "illumination_range", "graininess", "tile_graininess")},
            **{
                key: [("geometry",)]
                for key in ("sparkle_density", "sparkle_area", "sparkle_contrast", "tile_sparkle_density")
            },
        },
        attributes=("source", "pixel", "method", "seed"),
        missing=("theta_f",),
    ),
    "preview": Kind(
        {"picture": [("row", "column", "channel")]},
        optional={
            "picture_in": [("lighting", "row", "column", "channel")],
            "light_of": [("lighting",)],
            "illuminant_of": [("lighting",)],
        },
        attributes=("illuminant", "light", "white_level"),
    ),
    "checks": Kind(
        {
            "reciprocity_residual": SCALAR,
            "albedo": [("theta_i", "wavelength"), ("theta_i",)],
            "energy_excess": SCALAR,
            "negative_fraction": SCALAR,
            "closure_residual": SCALAR,
            "integral_residual": SCALAR,
            "floor": SCALAR,
        },
        optional={"transmittance": [("theta_i", "wavelength"), ("theta_i",)], "grazing_growth": SCALAR},
        attributes=("verdicts",),
    ),
    "parameters": Kind({"missing_fraction": SCALAR}, attributes=("levelling", "band")),
    "raycast": Kind({}, attributes=("method",)),
    "visibility": Kind(
        {},
        optional=dict.fromkeys(
            ("visibility_ratio", "visibility_ratio_u", "visibility_ratio_quality"), VISIBILITY_COORDINATES
        )
        | dict.fromkeys(("single_ratio", "single_ratio_u", "single_ratio_quality"), SINGLE_VISIBILITY_COORDINATES)
        | {
            name: [("theta_i", "region")]
            for name in ("visible_share", "visible_share_u", "smith_visible_share", "smith_error", "smith_error_u")
        },
    ),
    "interreflection": Kind(
        {},
        optional={
            **dict.fromkeys(("n", "k"), SPECTRAL),
            **{name: [("theta_i",)] for name in ("second_share", "second_share_u")},
            **SECOND_REFLECTION,
            "second_reflection_u": [("second_theta_i", "second_theta_o", "second_azimuth")],
        },
        attributes=("multiple_scattering", "reason"),
    ),
    "samples": Kind(
        {"theta_o": [("sample",)], "phi_o": [("sample",)], "pdf": [("sample",)], "specular": [("sample",)]}
        | {"weight": [("sample",), ("sample", "wavelength")], "weight_variance": SPECTRAL}
    ),
    "nonspectral": Kind({"rms": [("theta_i",)], "largest": [("theta_i",)], "reflectance_error": [("theta_i",)]}),
    "frames": Kind(
        {"counts": [("frame", "y", "x")]}
        | {
            name: [("frame",)]
            for name in (
                *("shot", "purpose", "side", "incidence", "wavelength", "wavelength_read", "exposure"),
                *("nd_position", "nd_transmittance", "elapsed", "temperature"),
            )
        },
        {name: [("frame",)] for name in ("aim_theta", "aim_phi")},
        attributes=("day", "sample", "rig", "rig_digest"),
    ),
    "catalogue": Kind({}, missing=("reflectance_haze",)),
}

REPRESENTATIONS: dict[str, Kind] = {}
"""Further variables of a ``bsdf`` by representation; each class of :mod:`brdfpipe.bsdf.representations` adds its entry when it is imported."""


def label(dataset: xr.Dataset, kind: str) -> xr.Dataset:
    """Attach units, long names, flag meanings and the kind to a stage's plain arrays.

    Names that are not in the vocabulary need attributes ``units`` and ``long_name``.
    """
    labelled = dataset.copy()
    labelled.attrs = {"Conventions": CONVENTIONS, "kind": kind, **dataset.attrs}
    # Variables, not arrays with coordinates, which take much longer to make.
    for name, variable in ((str(name), variable) for name, variable in labelled.variables.items()):
        known = quantity(name)
        if known is not None:
            variable.attrs = {"units": known.units, "long_name": known.long_name, **variable.attrs}
        elif name.endswith("_quality"):
            variable.attrs = {
                "units": "1",
                "long_name": f"quality of {name.removesuffix('_quality')}",
                "flag_values": np.arange(len(QUALITY_FLAGS), dtype=np.int8),
                "flag_meanings": " ".join(QUALITY_FLAGS),
                **variable.attrs,
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
    VocabularyError : with the file, the variable and what is expected.
    """
    where = f"{source}: " if source else ""
    if kind not in KINDS:
        raise VocabularyError(f"{where}unknown kind of dataset {kind!r}; accepted: {', '.join(KINDS)}")
    if not isinstance(dataset, xr.Dataset):
        found = f"{type(dataset).__name__}; brdfpipe.open_dataset reads one from a file"
        raise VocabularyError(f"{where}expected a dataset of kind {kind!r}, found {found}")
    stated = dataset.attrs.get("kind", kind)
    if stated != kind:
        raise VocabularyError(f"{where}expected a dataset of kind {kind!r}, found kind {stated!r}")
    _check_members(dataset, KINDS[kind], kind, where)
    if kind == "bsdf":
        # A stage that evaluates a BSDF has imported its representation; a stage that copies it need not.
        representation = dataset.attrs["representation"]
        if representation in REPRESENTATIONS:
            _check_members(dataset, REPRESENTATIONS[representation], f"bsdf ({representation})", where)
    for name, variable in dataset.variables.items():
        _check_values(str(name), variable, where, missing=name in KINDS[kind].missing)
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
        if name in dataset and tuple(dataset.variables[name].dims) not in accepted:
            raise VocabularyError(
                f"{where}{name!r} has dimensions {dataset.variables[name].dims}; a {title!r} dataset accepts "
                + " or ".join(map(str, accepted))
            )


def _check_values(name: str, variable: xr.Variable, where: str, missing: bool) -> None:
    if variable.dtype.kind in "OUS":
        return
    if "units" not in variable.attrs:
        raise VocabularyError(f"{where}{name!r} has no units")
    known = quantity(name)
    if known is None or variable.size == 0:
        return
    if variable.attrs["units"] != known.units:
        raise VocabularyError(f"{where}{name!r} is in {variable.attrs['units']!r}, expected {known.units!r}")
    values = variable.values
    if np.isinf([known.low, known.high]).all() and name not in variable.dims and np.isfinite(values.sum(dtype=float)):
        return  # any finite value is allowed, and the sum shows that all are finite
    # Of increasing coordinates the ends are the extremes, and none is missing.
    increasing = name in variable.dims and _increases(values)
    low, high = map(float, (values[0], values[-1]) if increasing else (values.min(), values.max()))
    if np.isnan(low):  # the minimum propagates NaN, so missing values are counted only if there are some
        absent = np.isnan(values)
        if not (known.missing or missing):
            raise VocabularyError(f"{where}{name!r} has {int(absent.sum())} missing values; all must be present")
        if absent.all():
            return
        low, high = float(np.nanmin(values)), float(np.nanmax(values))
    if low < known.low or high > known.high or not np.isfinite([low, high]).all():
        raise VocabularyError(
            f"{where}{name!r} spans {low:g} to {high:g} {known.units}, expected finite values in [{known.low:g}, {known.high:g}]"
        )
    if name in variable.dims and values.size > 1 and not increasing:
        raise VocabularyError(f"{where}the coordinate {name!r} must increase strictly")


def _increases(values: NDArray[np.float64]) -> bool:
    """Whether more than one value increase strictly; in parts that stay in the cache."""
    parts = (values[start : start + _PART + 1] for start in range(0, values.size - 1, _PART))
    return values.size > 1 and all(bool((part[1:] > part[:-1]).all()) for part in parts)


_PART = 2**15

WAVES_AT_FACES = {f"{side}_wave_": f"{side} face" for side in ("front", "back")}
"""Prefix of the variables of a ``wave`` BSDF in that of a sheet, and what they belong to."""


def quantity(name: str) -> Quantity | None:
    if name in QUANTITIES:
        return QUANTITIES[name]
    if name.endswith("_change") and (base := name.removesuffix("_change")) in QUANTITIES:
        changed = QUANTITIES[base]
        return Quantity(changed.units, f"change by one standard uncertainty of: {changed.long_name}")
    for prefix, place in WAVES_AT_FACES.items():
        if name.startswith(prefix) and (of_waves := quantity(name.removeprefix(prefix))) is not None:
            return replace(of_waves, long_name=f"{of_waves.long_name}; of the {place}")
    base, mark, component = name.partition("_u")
    if mark and base in QUANTITIES and (component == "" or component.startswith("_")):
        uncertain = QUANTITIES[base]
        return Quantity(uncertain.units, f"standard uncertainty of: {uncertain.long_name}", 0, missing=True)
    return None


def quality(name: str) -> np.int8:
    """The flag value of a quality: ``quality("extrapolated")``."""
    return np.int8(QUALITY_FLAGS.index(name))


def add_history(dataset: xr.Dataset, *sentences: str) -> xr.Dataset:
    """Add sentences about corrections to the history of a copy."""
    if not sentences:
        return dataset
    lines = [line for line in dataset.attrs.get("history", "").splitlines() if line]
    return dataset.assign_attrs(history="\n".join([*lines, *sentences]))


def add_warning(dataset: xr.Dataset, *sentences: str) -> xr.Dataset:
    """Add warnings to a copy, for the report and the catalogue; a warning says what to do."""
    if not sentences:
        return dataset
    return dataset.assign_attrs(warnings=json.dumps([*warnings(dataset), *sentences], ensure_ascii=False))


def warnings(dataset: xr.Dataset) -> list[str]:
    """The warnings of a dataset."""
    return list(json.loads(dataset.attrs.get("warnings", "[]")))
