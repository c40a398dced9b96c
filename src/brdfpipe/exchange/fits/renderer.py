"""What the formats of renderers share: the fit of their shading model, its limits and its record."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import xarray as xr

from brdfpipe.appearance.origin import METAL_EXTINCTION
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.registry import representation
from brdfpipe.exchange import records
from brdfpipe.exchange.fits.fitting import Fit, Form, checked, fit
from brdfpipe.exchange.fits.forms import Lobe, dielectric, nothing, schlick
from brdfpipe.exchange.fits.light import ReflectedLight, index_of, is_smooth
from brdfpipe.exchange.gridded import linear_rgb
from brdfpipe.exchange.registry import Format
from brdfpipe.geometry import Array
from brdfpipe.optics.fresnel_equations import fresnel


class Fitted:
    """A material of a renderer."""

    def __init__(self, bsdf: xr.Dataset, found: Fit, colour: Array, is_metal: bool) -> None:
        self.bsdf, self.fit = bsdf, found
        self.colour = colour
        """(3,) linear red, green and blue of the base, or of a metal's reflectance"""
        self.is_metal, self.is_smooth = is_metal, is_smooth(bsdf)

    @property
    def roughness(self) -> float:
        """The renderer's, of which the square is the width of GGX."""
        return 0.0 if self.is_smooth else float(np.sqrt(self.fit.material.lobe.alpha))

    def record(self, format: Format, form: str) -> records.Record:
        """Material, digest, parameters, error and losses."""
        found = self.fit
        left_out = records.left_out(self.bsdf, format, "rgb")
        if not self.is_smooth and (shares := records.specular_shares(representation(self.bsdf))):
            left_out["specular"] = shares
        return {
            **records.identity(self.bsdf),
            "parameters": {
                "base_colour": [float(f"{value:.4f}") for value in self.colour],
                "roughness": float(f"{self.roughness:.4f}"),
                "index": float(f"{self.fit.index:.4f}"),
                "metal": self.is_metal,
            },
            "error": {
                "reading": f"evaluated as {form}",
                "median": records.three_digits(found.median),
                "percentile_95": records.three_digits(found.percentile_95),
                "albedo": records.three_digits(found.albedo),
                "delta_e_00": records.three_digits(found.delta_e),
                "directions": found.directions,
            },
            "left_out": left_out,
        }


def fitted(
    bsdf: xr.Dataset,
    form: str,
    under_lobe: Callable[[Lobe, Array, Array, Array, Array], Array],
    *,
    exact_fresnel: bool,
    compensated: bool,
    largest_error: float,
    largest_delta_e: float,
) -> Fitted:
    """The parameters of a shading model with GGX, for a dielectric with a diffuse base or for a metal.

    Parameters
    ----------
    bsdf : kind ``bsdf``
    form : name of the shading model, for messages
    under_lobe : see :class:`brdfpipe.exchange.fits.forms.Material`
    exact_fresnel : Fresnel's equations for a dielectric; false: Schlick's approximation
    compensated : see :attr:`brdfpipe.exchange.fits.forms.Lobe.compensated`
    largest_error, largest_delta_e : limits of the median error and of CIEDE2000

    Raises
    ------
    ExchangeError : the fit is beyond a limit, the surface has a lay, or no light is reflected.
    """
    n, k = index_of(bsdf)
    light = ReflectedLight(bsdf)
    if k > METAL_EXTINCTION:
        normal = _reflectance_of_metal(bsdf)
        found = fit(light, Form("ggx", lambda _: schlick(normal), nothing, n, compensated))
        return Fitted(bsdf, checked(found, largest_error, largest_delta_e, form), normal, is_metal=True)
    found = fit(light, Form("ggx", dielectric if exact_fresnel else _schlick_of_index, under_lobe, n, compensated))
    checked(found, largest_error, largest_delta_e, form)
    return Fitted(bsdf, found, found.material.base, is_metal=False)


def _schlick_of_index(index: float) -> Callable[[Array], Array]:
    return schlick(np.full(3, float(fresnel(1.0, index).mean)))


def _reflectance_of_metal(bsdf: xr.Dataset) -> Array:
    """(3,) linear red, green and blue at normal incidence."""
    source = bsdf if "wavelength" in bsdf["n"].dims or "wavelength" in bsdf["k"].dims else nonspectral(bsdf)
    n, k = np.broadcast_arrays(source["n"].values, source["k"].values)
    values = np.atleast_1d(fresnel(1.0, n, k).mean)
    if "mixed" in source["n"].dims:
        values = np.atleast_1d(values @ source["mixture"].values)
    if "wavelength" in bsdf.coords and values.size == 1:
        values = np.repeat(values, bsdf.sizes["wavelength"])
    return np.clip(np.asarray(linear_rgb(bsdf).convert(values[None]))[0], 0.0, 1.0)
