"""Small tables beside a BSDF file: total reflectance and transmittance, and the Lambert + Gaussian parameters.

Light that is reflected or transmitted into a single direction has no density, so no row of a BSDF file can hold it. These tables have
a column for it.
"""

from __future__ import annotations

import os
from collections.abc import Mapping

import numpy as np
import pandas as pd
import xarray as xr

from brdfpipe import hemisphere, store, vocabulary
from brdfpipe.bsdf.change_variables import NOT_STATED
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.source_changes import SourceChanges, in_quadrature, uncertain
from brdfpipe.geometry import Array

_LAMBERT_GAUSS_COLUMNS = {
    "theta_i": "theta_i_deg",
    "lambert": "lambert_reflectance",
    "gauss_peak": "gauss_peak_per_sr",
    "gauss_fwhm_parallel": "fwhm_parallel_deg",
    "gauss_fwhm_perpendicular": "fwhm_perpendicular_deg",
    "gauss_reflectance": "gauss_reflectance",
    "fit_residual": "relative_residual",
}

_LARGEST_DELTA_E = 5.0
"""As of the other fits; above it the table says so."""


def write_total_reflectance(bsdf: xr.Dataset, path: str | os.PathLike[str]) -> None:
    """Write the total reflectance at 8° that the BSDF integrates to, as a commented CSV of nm and fraction.

    Together with the non-spectral ``.astm`` it makes the "ASTM form" of the patent US 9,395,299. A column has the standard uncertainty, where that of
    what decides the total is known.
    """
    vocabulary.validate(bsdf, "bsdf")
    wavelength, reflectance = representation(bsdf).total_reflectance()
    frame = pd.DataFrame({"wavelength_nm": wavelength, "total_reflectance": reflectance})
    mirrored = representation(bsdf).specular(np.array([8.0]), np.zeros(1), None)[0][0]
    title = f"total reflectance of {_material(bsdf)} at 8 degree incidence, specular included, fraction"
    if mirrored.any():
        frame["specular_reflectance"] = np.broadcast_to(mirrored, wavelength.shape)
        title += "; specular_reflectance: the part of it that is mirrored into one single direction, which no BSDF file contains"
    if (u := _total_uncertainty(bsdf)) is not None:
        frame["total_reflectance_u"] = np.broadcast_to(u, wavelength.shape)
        title += "; total_reflectance_u: standard uncertainty"
    _write(frame, path, title, bsdf)


def _total_uncertainty(bsdf: xr.Dataset) -> Array | None:
    """Standard uncertainty of the reflectance at 8° (wavelength or 1,), mean over azimuth; None where it is not known."""
    if uncertain(bsdf) and "spectrum" not in str(bsdf.attrs.get(NOT_STATED, "")).split(", "):
        from brdfpipe.appearance.colours import total_reflectance

        changes = SourceChanges.of(bsdf)
        given, *changed = (total_reflectance(bsdf, one)[1] for one in (changes.given, *changes.changed))
        return in_quadrature(changes.by_source(np.array(changed) - given))
    evaluator = representation(bsdf)
    if uncertain(bsdf) or not evaluator.states_uncertainty:
        return None
    azimuths = hemisphere.azimuths(evaluator.isotropic)
    return evaluator.albedo_uncertainty(np.full(azimuths.size, 8.0), azimuths, None).mean(axis=0)


def write_total_transmittance(bsdf: xr.Dataset, path: str | os.PathLike[str]) -> None:
    """Write the total transmittance at normal incidence that the BSDF integrates to, as a commented CSV of nm and fraction."""
    from brdfpipe.appearance import transmission

    vocabulary.validate(bsdf, "bsdf")
    wavelength, transmittance = representation(bsdf).total_transmittance()
    frame = pd.DataFrame({"wavelength_nm": wavelength, "total_transmittance": transmittance})
    haze = transmission.transmission_haze(bsdf)
    title = (
        f"total transmittance of {_material(bsdf)} at normal incidence, fraction; D1003-style haze, the share of it scattered by more "
        f"than {transmission.HAZE_CONE:g} degree, weighted with V(lambda) and D65: {haze:.6f}"
    )
    straight = representation(bsdf).specular(np.zeros(1), np.zeros(1), None)[1][0]
    if straight.any():
        frame["specular_transmittance"] = np.broadcast_to(straight, wavelength.shape)
        title += "; specular_transmittance: the part of it that passes into one single direction, which no BSDF file contains"
    _write(frame, path, title, bsdf)


def write_lambert_gauss(
    fit: xr.Dataset,
    path: str | os.PathLike[str],
    *,
    model: xr.Dataset | None = None,
    azimuths: Mapping[float, xr.Dataset] | None = None,
) -> None:
    """Write the parameters of a Lambert + Gaussian fit, a row an incidence, as a commented CSV.

    Parameters
    ----------
    fit : kind ``bsdf``, representation ``lambert_gauss``
    path : the file; it appears whole or not at all
    model : the BSDF it was fitted to; if it mirrors light into a single direction, a column gives that share, which no Gaussian describes
    azimuths : of a surface with a lay, fits by the azimuth of incidence [degree]; written instead of ``fit``, with a column ``phi_i_deg``
    """
    fits = {0.0: fit} if azimuths is None else azimuths
    frames = [_parameters(single, model) for single in fits.values()]
    frame = pd.concat(frames, keys=fits, names=["phi_i_deg"]).reset_index("phi_i_deg")
    frame = frame if azimuths is not None else frame.drop(columns="phi_i_deg")
    title = (
        f"Lambert + Gaussian fit of {_material(fit)}: BRDF = lambert/pi + G0 exp(-d_par^2/(2 s_par^2) - d_perp^2/(2 s_perp^2)) about the "
        "mirror direction, FWHM = 2.3548 s; weighted with V(lambda) and D65"
    )
    if azimuths is not None:
        title += "; NOT isotropic: the surface has a lay, each row holds for light from azimuth phi_i_deg alone, the first along the lay"
    if model is not None and azimuths is None and representation(model).isotropic:
        title += f"; {_colour_difference(fit, model)}"
    if "specular_reflectance" in frame:
        title += "; specular_reflectance: mirrored into one single direction, and not part of the fit"
    _write(frame, path, title, fit)


def _colour_difference(fit: xr.Dataset, model: xr.Dataset) -> str:
    """CIEDE2000 of the fit off the lobe, in words."""
    from brdfpipe.exchange.fits.light import COLOUR_GEOMETRIES, delta_e_of_greys

    size = delta_e_of_greys(nonspectral(model), representation(fit).evaluate)
    beyond = f", ABOVE the limit of {_LARGEST_DELTA_E:g}: use the format of a table" if size > _LARGEST_DELTA_E else ""
    return f"CIEDE2000 {size:.2f} of greys of both luminances at {', '.join(COLOUR_GEOMETRIES)}{beyond}"


def _parameters(fit: xr.Dataset, model: xr.Dataset | None) -> pd.DataFrame:
    vocabulary.validate(fit, "bsdf")
    frame = pd.DataFrame({title: fit[name].values for name, title in _LAMBERT_GAUSS_COLUMNS.items()})
    if model is None:
        return frame
    reduced, theta_i = nonspectral(model), fit["theta_i"].values
    mirrored = representation(reduced).specular(theta_i, np.zeros_like(theta_i), None)[0][:, 0]
    return frame.assign(specular_reflectance=mirrored) if mirrored.any() else frame


def _material(dataset: xr.Dataset) -> str:
    return str(dataset.attrs.get("material", "a material"))


def _write(frame: pd.DataFrame, path: str | os.PathLike[str], title: str, source: xr.Dataset) -> None:
    header = f"# {title}\n# digest of the source {source.attrs.get('digest', 'unknown')}\n"
    body = frame.to_csv(index=False, float_format="%.9g", lineterminator="\n")
    store.write_text(path, header + str(body))
