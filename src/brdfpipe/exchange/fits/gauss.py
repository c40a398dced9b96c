"""Lambert + Gaussian by incidence, as illumination programs take it, and its error as of the other fits."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.bsdf.lambert_gauss_fit import fit_lambert_gauss
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.representations.lambert_gauss import FWHM, LambertGauss
from brdfpipe.bsdf.table_error import Evaluate
from brdfpipe.exchange.fits.light import INCIDENCES, ReflectedLight
from brdfpipe.exchange.fits.scatter import LISTED_INCIDENCES, ScatterError, error_of_fit

NAMES = ("G0", "s_par", "s_perp", "L")
"""Peak of the lobe [sr-1], its widths σ along and across the plane of incidence [degree], and the reflectance of the base [1]."""
WORDS = (
    "G0 exp(-d_par^2 / (2 s_par^2) - d_perp^2 / (2 s_perp^2)) + L / pi, d_par and d_perp the longitude and latitude about the mirror direction in degree, along "
    "and across the plane of incidence; parameters interpolated linearly in theta_i"
)


def fit_gauss(light: ReflectedLight) -> tuple[dict[float, dict[str, float]], ScatterError]:
    """Parameters by incidence [degree], see :func:`brdfpipe.bsdf.lambert_gauss_fit.fit_lambert_gauss`, and the error of the whole list."""
    fit = fit_lambert_gauss(light.reduced, LISTED_INCIDENCES)
    rows = {
        float(one["theta_i"]): {
            "G0": float(one["gauss_peak"]),
            "s_par": float(one["gauss_fwhm_parallel"]) / FWHM,
            "s_perp": float(one["gauss_fwhm_perpendicular"]) / FWHM,
            "L": float(one["lambert"]),
        }
        for one in (fit.isel(theta_i=row) for row in range(fit.sizes["theta_i"]))
    }
    reflectance = representation(fit).albedo(INCIDENCES, np.zeros_like(INCIDENCES), None)[:, 0]
    return rows, error_of_fit(light, evaluation(rows), reflectance)


def evaluation(rows: Mapping[float, Mapping[str, float]]) -> Evaluate:
    """The BRDF of parameters by increasing incidence [degree]."""
    scale, parallel, perpendicular, base = (np.array([row[name] for row in rows.values()]) for name in NAMES)
    fields = {
        "lambert": base,
        "gauss_peak": scale,
        "gauss_fwhm_parallel": FWHM * parallel,
        "gauss_fwhm_perpendicular": FWHM * perpendicular,
    }
    dataset = xr.Dataset(
        {name: ("theta_i", values) for name, values in fields.items()},
        coords={"theta_i": list(rows)},
        attrs={"representation": LambertGauss.name},
    )
    return LambertGauss(vocabulary.label(dataset, "bsdf")).evaluate
