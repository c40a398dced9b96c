"""The BSDF of a candidate, built from the laboratory's inputs of a material."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.bsdf.lambert_gauss import lambertian
from brdfpipe.bsdf.lambert_gauss_fit import fit_lambert_gauss
from brdfpipe.bsdf.microfacet import interreflection
from brdfpipe.bsdf.microfacet.builder import build as build_microfacet
from brdfpipe.bsdf.wave.builder import build as build_wave
from brdfpipe.facets.analytic_distributions import analytic
from brdfpipe.facets.facet_dataset import azimuthal_average
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.masking import visibility_choice
from brdfpipe.optics.index import interpolate_index
from brdfpipe.scenes.ladders import Candidate
from brdfpipe.scenes.model_inputs import ONE_WAVELENGTH, ModelInputs
from brdfpipe.scenes.numerics import FINE, NUMERICS

FITTED_INCIDENCES = np.array([0.0, 10, 20, 30, 40, 50, 60, 70, 75, 80, 85])
"""Angles of incidence at which Lambert + Gauss is fitted [degree]."""

THREE_WAVELENGTHS = (450.0, 550.0, 650.0)
"""Wavelengths of three bands [nm]."""

MEDIAN_WIDTH = {"beckmann": 1 / math.sqrt(math.log(2)), "ggx": 1.0}
"""Width over the median slope of a named density: half of the facets are below a √ln 2 (Beckmann), or below a (GGX) [1]."""

WIDE_STEP = 40.0
"""Step of the bands ``every 40 nm`` [nm]."""

ADVICE_ON_MODELS = "`model."
"""In warnings that advise a key of the model in the description: the choice of a candidate is not the user's."""


def build(candidate: Candidate, inputs: ModelInputs, numerics: str = FINE) -> xr.Dataset:
    """The BSDF of a candidate.

    Parameters
    ----------
    candidate : rungs that differ for these inputs
    inputs : of the material; the facets are not a perfectly flat surface
    numerics : a name of :data:`brdfpipe.scenes.numerics.NUMERICS`

    Returns
    -------
    Dataset of kind ``bsdf``, without warnings of what the candidate leaves out

    Raises
    ------
    ValueError : a candidate that these inputs do not allow.
    BrdfpipeError : the model refuses these inputs.
    """
    index, spectrum = banded(candidate, inputs)
    numbers = NUMERICS[numerics]
    if candidate.distribution == "lambert":
        if spectrum is None:
            raise ValueError("a Lambertian material needs a spectrum")
        return lambertian(spectrum, gloss_matters=False)
    if inputs.facets is None:
        raise ValueError(f"{candidate} needs facets")
    base = "coupled" if candidate.diffuse == "coupled" else "none"
    if candidate.optics == "wave":
        if inputs.psd is None:
            raise ValueError(f"{candidate} needs a roughness spectrum")
        waves_alone = build_wave(
            inputs.psd,
            index=index,
            spectrum=spectrum,
            diffuse=base,
            optics="wave",
            phase_step=numbers.phase_step,
            lay_energy_nodes=numbers.lay_energy_nodes,
        )
        texts = vocabulary.warnings(waves_alone)
        return _with_warnings(waves_alone, [text for text in texts if ADVICE_ON_MODELS not in text])
    facets = _facets(candidate.distribution, inputs.facets)
    visibility = reflections = None
    if inputs.surface is not None and candidate.distribution in ("counted", "isotropic"):
        if candidate.masking == "auto":
            visibility = visibility_choice.choose(inputs.surface, inputs.facets, quick=not numbers.compares_all)
        if candidate.multiple_scattering == "auto":
            reflections = interreflection.choose(
                inputs.surface,
                inputs.facets,
                index=index,
                spectrum=spectrum,
                rays=numbers.rays,
                nodes=numbers.reflection_nodes,
            )
    waves = inputs.psd if candidate.optics == "auto" and candidate.distribution != "lambert-gauss" else None
    bsdf = build_microfacet(
        facets,
        index=index,
        spectrum=spectrum,
        visibility=visibility,
        interreflection=reflections,
        masking=candidate.masking,
        diffuse=base,
        multiple_scattering=candidate.multiple_scattering,
        surface_alone=waves is not None,
    )
    if candidate.distribution == "lambert-gauss":
        return _with_warnings(fit_lambert_gauss(bsdf, FITTED_INCIDENCES), vocabulary.warnings(bsdf))
    if waves is None:
        return bsdf
    return build_wave(
        waves,
        index=index,
        spectrum=spectrum,
        diffuse=base,
        facets=facets,
        predicted=bsdf,
        visibility=visibility,
        optics="auto",
        states_cut_error=False,
        phase_step=numbers.phase_step,
        lay_energy_nodes=numbers.lay_energy_nodes,
    )


def banded(candidate: Candidate, inputs: ModelInputs) -> tuple[xr.Dataset, xr.Dataset | None]:
    """Index and spectrum at the wavelengths of the bands of a candidate, and without dispersion where it leaves that out."""
    index, spectrum = inputs.index, inputs.spectrum
    if candidate.index == "constant" or candidate.bands == "one":
        index = _at_one_wavelength(index)
    if spectrum is None or candidate.bands == "all":
        return index, spectrum
    known = spectrum["wavelength"].values
    if candidate.bands == "one":
        chosen = spectrum.sel(wavelength=[ONE_WAVELENGTH], method="nearest")
        return index, chosen.assign(
            total_reflectance=chosen["total_reflectance"].copy(data=[inputs.luminous_reflectance])
        )
    wanted = (
        THREE_WAVELENGTHS if candidate.bands == "three" else np.arange(known[0], known[-1] + WIDE_STEP / 2, WIDE_STEP)
    )
    nearest = np.unique(np.abs(known[:, None] - np.asarray(wanted)).argmin(axis=0))
    return index, spectrum.isel(wavelength=nearest)


def _with_warnings(bsdf: xr.Dataset, texts: Sequence[str]) -> xr.Dataset:
    """A BSDF with these warnings in place of its own."""
    attributes = {name: value for name, value in bsdf.attrs.items() if name != "warnings"}
    return vocabulary.add_warning(bsdf.drop_attrs(deep=False).assign_attrs(attributes), *texts)


def _at_one_wavelength(index: xr.Dataset) -> xr.Dataset:
    """A constant index, that at :data:`ONE_WAVELENGTH`."""
    n, k = interpolate_index(index, np.array([ONE_WAVELENGTH]))
    ends = index["wavelength"].values[[0, -1]]
    values = {"n": ("wavelength", np.repeat(n, 2)), "k": ("wavelength", np.repeat(k, 2))}
    return vocabulary.label(xr.Dataset(values, {"wavelength": ends}, index.attrs), "index")


def _facets(distribution: str, counted: xr.Dataset) -> xr.Dataset:
    """Facets of a rung of the distribution: counted, their mean over azimuth, or a named density of the same median slope."""
    if distribution in ("counted", "lambert-gauss"):
        return counted
    isotropic = azimuthal_average(counted)
    if distribution == "isotropic":
        return isotropic
    return analytic(distribution, a=MEDIAN_WIDTH[distribution] * RadialDensity.of(isotropic).median_slope)
