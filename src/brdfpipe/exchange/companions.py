"""Small tables that travel beside a BRDF file: the total reflectance spectrum, and the Lambert + Gaussian parameters."""

from __future__ import annotations

import os

import pandas as pd
import xarray as xr

from brdfpipe import store, vocabulary
from brdfpipe.bsdf import representations

_LAMBERT_GAUSS_COLUMNS = {
    "theta_i": "theta_i_deg",
    "lambert": "lambert_reflectance",
    "gauss_peak": "gauss_peak_per_sr",
    "gauss_fwhm_parallel": "fwhm_parallel_deg",
    "gauss_fwhm_perpendicular": "fwhm_perpendicular_deg",
    "gauss_reflectance": "gauss_reflectance",
    "fit_residual": "relative_residual",
}


def write_total_reflectance(bsdf: xr.Dataset, path: str | os.PathLike[str]) -> None:
    """Write the total reflectance at 8° that the BSDF integrates to, as a commented CSV of nm and fraction.

    Together with the non-spectral ``.astm`` it makes the "ASTM form" of the patent US 9,395,299.
    """
    vocabulary.validate(bsdf, "bsdf")
    wavelength, reflectance = representations.total_reflectance(bsdf)
    frame = pd.DataFrame({"wavelength_nm": wavelength, "total_reflectance": reflectance})
    _write(
        frame, path, f"total reflectance of {_material(bsdf)} at 8 degree incidence, specular included, fraction", bsdf
    )


def write_lambert_gauss(fit: xr.Dataset, path: str | os.PathLike[str]) -> None:
    """Write the parameters of a Lambert + Gaussian fit, a row an incidence, as a commented CSV."""
    vocabulary.validate(fit, "bsdf")
    frame = pd.DataFrame({title: fit[name].values for name, title in _LAMBERT_GAUSS_COLUMNS.items()})
    title = (
        f"Lambert + Gaussian fit of {_material(fit)}: BRDF = lambert/pi + G0 exp(-d_par^2/(2 s_par^2) - d_perp^2/(2 s_perp^2)) about the "
        "mirror direction, FWHM = 2.3548 s; weighted with V(lambda) and D65"
    )
    _write(frame, path, title, fit)


def _material(dataset: xr.Dataset) -> str:
    return str(dataset.attrs.get("material", "a material"))


def _write(frame: pd.DataFrame, path: str | os.PathLike[str], title: str, source: xr.Dataset) -> None:
    header = f"# {title}\n# digest of the source {source.attrs.get('digest', 'unknown')}\n"
    body = frame.to_csv(index=False, float_format="%.9g", lineterminator="\n")
    store.write_text(path, header + str(body))
