"""Light that leaves a surface after more than one reflection between its facets."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr

from brdfpipe.bsdf.microfacet.microsurface import Microsurface
from brdfpipe.bsdf.microfacet.model import without_lay
from brdfpipe.bsdf.microfacet.second_reflection import SecondReflection, mean_share


class MultipleScattering(NamedTuple):
    """Light reflected more than once [1], mean over the hemisphere of incidence."""

    mode: str
    """Of :data:`brdfpipe.masking.modes.MODES`: ``none`` loses this light."""
    share: float
    """Share of the incident light, for this material."""
    mirrors: float
    """Share of the incident light, if the facets were perfect mirrors; negative where the masking gains energy."""


def multiple_scattering(bsdf: xr.Dataset, wavelength: float = 550.0) -> MultipleScattering | None:
    """Light that leaves the facets after two or more reflections, at the wavelength [nm] nearest to ``wavelength``.

    Returns
    -------
    None where a BSDF does not contain the albedo of its facets as perfect mirrors

    Notes
    -----
    Of the modes ``directional`` and ``measured`` the table is integrated. Of ``compensated``, with Ē₁ the mean albedo of perfect mirrors and F̄ = 2 ∫ F μ dμ:
    F̄² Ē₁ (1 − Ē₁) / (1 − F̄ (1 − Ē₁)), a geometric series. Of ``none``, the light that two and three facets of Smith's surface
    would reflect, to about 10 %; of a surface with a lay, of its slopes averaged over azimuth.

    References
    ----------
    Kulla & Conty 2017.
    """
    if "mean_furnace_albedo" not in bsdf or "slope_density" not in bsdf:
        return None
    mode, mirrors = str(bsdf.attrs["multiple_scattering"]), 1 - float(bsdf["mean_furnace_albedo"])
    if mode == "compensated":
        return MultipleScattering(mode, float(_at(bsdf["compensation"], wavelength)) * mirrors, mirrors)
    if mode in ("directional", "measured"):
        table = SecondReflection.of(bsdf, _at(bsdf["second_reflection"], wavelength).values[..., None])
        return MultipleScattering(mode, float(table.mean_albedo()[0]), mirrors)
    n, k = (np.atleast_1d(_at(bsdf[name], wavelength)) for name in ("n", "k"))
    share = float(mean_share(without_lay(Microsurface.of(bsdf)), n, k)[0])
    return MultipleScattering(mode, share, mirrors)


def _at(values: xr.DataArray, wavelength: float) -> xr.DataArray:
    return values.sel(wavelength=wavelength, method="nearest") if "wavelength" in values.dims else values
