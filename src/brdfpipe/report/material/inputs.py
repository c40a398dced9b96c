"""Sections on the inputs of a prediction: measured surface, facets, effect pigments, spectrum and refractive index."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import xarray as xr

from brdfpipe.appearance.origin import is_measured
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.representations.wave import Wave
from brdfpipe.facets.planar_density import PlanarDensity
from brdfpipe.report.cards import Section, Table
from brdfpipe.report.formatting import attribute_note, fixed, grouped, number, quantity
from brdfpipe.report.plots import dispersion, flake_angle_plot, masking, slope_density
from brdfpipe.report.plots.spectrum import spectrum_figure
from brdfpipe.report.plots.surface import height_map, height_profile
from brdfpipe.report.plots.svg import Figure
from brdfpipe.surfaces.texture_parameters import NAMES

_FACET_TITLES = {
    "median_slope": "Median slope",
    "median_slope_log_u": "Median slope, standard uncertainty of its logarithm",
    "tail": "Tail, 0 for Beckmann and 1 for GGX",
    "tail_u": "Tail, standard uncertainty",
    "gloss_chi_squared": "χ² of the gloss readings with the best slopes",
    "slope_rms": "rms slope, without spikes",
    "tail_slope": "Slope from which the density is extrapolated",
    "tail_share": "Facets in the extrapolated tail, of all",
    "tail_contribution": "Their part of the mean square slope",
    "anisotropy": "Anisotropy, larger over smaller principal rms slope",
    "lay": "Lay, azimuth of the smaller principal rms slope",
    "facet_count": "Facets",
    "effective_count": "Independent facets",
    "correlation_length": "Correlation length of the heights (1/e)",
    "noise_ratio": "rms slope over 1 pixel / over 2 pixels",
}
_COUNTS = ("facet_count", "effective_count")

_GEOMETRY_NOTE = (
    "θf: flake angle. ΔE00: difference of the fitted colour from the measured one. Left out: difference of the colour that a fit to "
    "all other geometries predicts; needs four geometries or more."
)

_INCIDENCES = np.array([0.0, 30.0, 60.0, 75.0, 85.0])
_LEAST_OF_FACETS = 1e-3
"""Share of the reflection at these incidences from which masking of facets matters."""

_MIDDLE, _LIT = 550.0, 8.0
_COAT_NOTE = "At 550 nm. Not modelled: interference, a coat that follows the relief below it, and roughness of the size of the wavelength at either face."

_LINES_F_D_C = np.array([486.1, 587.6, 656.3])
"""Wavelengths at which refractive indices are quoted [nm]."""


def surface_section(datasets: Mapping[str, xr.Dataset]) -> Section:
    """Heights and surface texture parameters."""
    section = Section("Surface")
    if (surface := datasets.get("surface")) is None:
        return section
    section.figures.append(height_map(surface) if surface["height"].ndim == 2 else height_profile(surface))
    parameters = [surface[name] for name in NAMES if name in surface]
    if parameters:
        rows = [
            (str(parameter.name).replace("_", " "), quantity(parameter), str(parameter.attrs.get("long_name", "")))
            for parameter in parameters
        ]
        note = attribute_note(surface, ("levelling", "band"))
        section.tables.append(Table("Surface parameters", ("Parameter", "Value", "Definition"), rows, note))
    return section


# --- facets


def facet_section(datasets: Mapping[str, xr.Dataset]) -> Section:
    """Slope density and masking."""
    section = Section("Facets")
    masks = facets_reflect(datasets.get("bsdf"))
    if "facets" in datasets:
        section.figures += facet_figures(datasets["facets"], masks)
        section.tables.append(_facet_table(datasets["facets"]))
    if "visibility" in datasets and masks:
        section.figures += filter(None, [masking.visibility_figure(datasets["visibility"])])
    return section


def facets_reflect(bsdf: xr.Dataset | None) -> bool:
    """Whether facets reflect light that others may mask; not where all is coherent, scattered as waves are, or diffracted."""
    if bsdf is None:
        return True
    evaluator = representation(bsdf)
    if isinstance(evaluator, Wave):
        return bool(evaluator.regime(_INCIDENCES, bsdf["wavelength"].values)[1].max() > _LEAST_OF_FACETS)
    return bsdf.attrs["representation"] != "kirchhoff"


def facet_figures(facets: xr.Dataset, masks: bool = True) -> list[Figure]:
    """The figures for which a ``facets`` dataset has the variables, isotropic (slope density over ``slope``) or with a lay.

    ``masks``: whether to show masking too.
    """
    figures: list[Figure] = []
    if "slope_density" in facets:
        density, masked = facets["slope_density"], masks and "lambda_smith" in facets
        if density.size == 0:
            note = "The surface is perfectly flat: all facets are level, and none masks another."
            return [Figure("Slopes", note=note)]
        if density.dims == ("slope",):
            figures += [slope_density.slope_density(facets), slope_density.facet_distribution(facets)]
            figures += [masking.smith_masking(facets)] if masked else []
        else:
            planar = PlanarDensity.of(facets)
            figures += slope_density.figures_with_lay(facets, planar)
            figures += [masking.smith_masking_with_lay(facets, planar.azimuth)] if masked else []
    by_scale = slope_density.slope_by_scale(facets)
    return [*figures, by_scale] if by_scale else figures


def _facet_table(facets: xr.Dataset) -> Table:
    rows = [(title, _facet_value(name, facets[name])) for name, title in _FACET_TITLES.items() if name in facets]
    if "slope_rms_scale" in facets and "scale" in facets.coords:
        rows += [
            (f"rms slope over {scale:g} pixel{'s' if scale != 1 else ''}", number(value))
            for scale, value in zip(facets["scale"].values, facets["slope_rms_scale"].values, strict=True)
        ]
    return Table("Facets in numbers", ("Quantity", "Value"), rows, attribute_note(facets, ("method", "band")))


def _facet_value(name: str, scalar: xr.DataArray) -> str:
    if name in _COUNTS:
        return grouped(float(scalar))
    return slope_density.axis_degrees(float(scalar)) if name == "lay" else quantity(scalar)


# --- effect pigments


def effect_pigment_section(datasets: Mapping[str, xr.Dataset]) -> Section:
    """Measured geometries, and the fit."""
    section = Section("Effect pigments")
    flake, multiangle = datasets.get("flake"), datasets.get("multiangle")
    if flake is None or multiangle is None:
        return section
    section.figures.append(flake_angle_plot.flake_angle_plot(flake, multiangle))
    rows = flake_angle_plot.geometry_rows(flake, multiangle)
    section.tables.append(Table("Measured geometries", *rows, _GEOMETRY_NOTE))
    scale = "A and C on the scale of Y = 100." if "channel" in flake.dims else "A and C as fractions."
    section.tables.append(Table("Fit along the flake angle", *flake_angle_plot.parameter_rows(flake), scale))
    return section


# --- a coat on an opaque body


def coat_section(datasets: Mapping[str, xr.Dataset]) -> Section:
    """The coat and the body below it, and where the light comes from."""
    section = Section("Coat")
    coated = datasets.get("coated")
    if coated is None:
        return section
    if "base_facets" in datasets:
        section.figures += [
            replace(figure, title=f"{figure.title}, face of the body below")
            for figure in facet_figures(datasets["base_facets"], masks=False)
        ]
    section.tables.append(Table("Coat and body", ("Quantity", "Value"), _coat_rows(datasets, coated), _COAT_NOTE))
    return section


def _coat_rows(datasets: Mapping[str, xr.Dataset], coated: xr.Dataset) -> list[tuple[str, str]]:
    rows = []
    if "interior" in datasets:
        interior = datasets["interior"]
        rows += [
            ("Thickness of the coat", quantity(interior["thickness"])),
            ("Internal transmittance of the coat", number(_at_middle(interior["internal_transmittance"]))),
        ]
    rows.append(("Index of the coat", fixed(_at_middle(coated["n"]), 4)))
    if "base_index" in datasets:
        n, k = (_at_middle(datasets["base_index"][name]) for name in ("n", "k"))
        rows.append(("Index of the body", fixed(n, 4) + (f" + {fixed(k, 4)} i" if k else "")))
    if "base_facets" in datasets:
        rows.append(("rms slope of the face of the body", quantity(datasets["base_facets"]["slope_rms"])))
    model, lit = representation(coated), (np.array([_LIT]), np.zeros(1))
    dark = representation(coated.assign(body_weight=xr.zeros_like(coated["body_weight"])))
    nm = np.array([_MIDDLE])
    faces, total = (float(one.albedo(*lit, nm)[0, 0]) for one in (dark, model))
    rows.append((f"Light that both faces reflect, at {_LIT:g}° incidence", f"{faces:.2%}"))
    rows.append((f"Light that comes back from the body, at {_LIT:g}°", f"{total - faces:.2%}"))
    return rows


def _at_middle(spectral: xr.DataArray) -> float:
    return float(np.interp(_MIDDLE, spectral["wavelength"].values, spectral.values))


# --- spectrum and refractive index


def spectrum_section(datasets: Mapping[str, xr.Dataset]) -> Section:
    """Spectrum and refractive index, the inputs of the modelled BRDF."""
    section = Section("Spectrum and index")
    predictions = [datasets[name] for name in ("predicted", "sheet", "coated") if name in datasets]
    model = next(iter(predictions), None) if is_measured(datasets) else datasets.get("bsdf")
    if "spectrum" in datasets:
        section.figures.append(spectrum_figure(datasets["spectrum"], model))
        section.tables += filter(None, [_recovery_table(datasets["spectrum"])])
    if "index" in datasets:
        section.figures += dispersion.dispersion(datasets["index"], model)
        section.tables += [_index_table(datasets["index"])] if dispersion.dispersive(datasets["index"]) else []
    return section


def _recovery_table(spectrum: xr.Dataset) -> Table | None:
    """Residual of a spectrum recovered from a colour, and its difference from another recovery under other illuminants."""
    residual = float(spectrum.attrs.get("residual_delta_e", math.nan))
    if not math.isfinite(residual):
        return None
    other_method = str(spectrum.attrs.get("metamerism_against", ""))
    differences = {
        name.removeprefix("metamerism_"): float(value)
        for name, value in spectrum.attrs.items()
        if name.startswith("metamerism_") and name != "metamerism_against"
    }
    rows = [("ΔE*ab to the given colour", fixed(residual, 2))]
    rows += [(f"ΔE00 to {other_method} under {light}", fixed(value, 2)) for light, value in differences.items()]
    note = f"Recovered by {spectrum.attrs['method']}. Many spectra have the same colour."
    if differences:
        note += f" ΔE00: colour difference from the spectrum that {other_method} recovers, under another illuminant."
    else:
        note += " No other exact method reaches this colour: its uncertainty under another illuminant is not known."
    return Table("Recovery of the spectrum", ("Quantity", "Value"), rows, note)


def _index_table(index: xr.Dataset) -> Table:
    wavelength = np.atleast_1d(index["wavelength"].values) if "wavelength" in index.coords else _LINES_F_D_C
    n, k = (
        np.interp(_LINES_F_D_C, wavelength, np.broadcast_to(index[name].values, wavelength.shape))
        for name in ("n", "k")
    )
    rows = [(f"{line:g} nm", fixed(n, 4), number(k)) for line, n, k in zip(_LINES_F_D_C, n, k, strict=True)]
    return Table("Refractive index at the lines F, d and C", ("Wavelength", "n", "k"), rows)
