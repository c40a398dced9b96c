"""The light that a BSDF reflects, to which closed forms are fitted and with which they are compared; each part is evaluated once."""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np
import xarray as xr

from brdfpipe.appearance import colours
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.table_error import Evaluate, Pairs, fresh_pairs, fresh_pairs_at, relative_errors
from brdfpipe.exchange.gridded import linear_rgb
from brdfpipe.exchange.registry import ExchangeError
from brdfpipe.flakes.geometries import Directions, named_directions
from brdfpipe.geometry import Array
from brdfpipe.optics.fresnel_equations import fresnel
from brdfpipe.spectra import colorimetry

COLOUR_GEOMETRIES = ("45:0", "45as75", "45as110")
"""Geometries off the lobe at which the colour of a fit is compared."""
INCIDENCES = np.array([0.0, 20.0, 40.0, 60.0, 75.0])
"""At which the reflectance of a fit to all incidences is compared [degree]."""
LEAST_REFLECTANCE = 1e-3
"""Below which the error of a reflectance is relative to this [1]."""
_FITTED, _COMPARED = 5, 7
"""Seeds of the directions of the fits, and of those at which their errors are stated."""


class Sampled(NamedTuple):
    """BRDF at pairs of directions above the surface, weighted with V(λ) and D65."""

    pairs: Pairs
    brdf: Array
    """(n,) [sr-1]"""

    def errors(self, evaluate: Evaluate) -> Array:
        """|fit − BSDF|·cos θ_o over the larger of BSDF·cos θ_o and 0.001 sr⁻¹, (n,) [1]."""
        read = evaluate(*self.pairs, None)
        return relative_errors(read, self.brdf[:, None], self.pairs.theta_o)[:, 0]


class ReflectedLight:
    """The reflected light of a BSDF without a lay.

    Parameters
    ----------
    bsdf : kind ``bsdf``

    Raises
    ------
    ExchangeError : the surface has a lay.
    """

    def __init__(self, bsdf: xr.Dataset) -> None:
        if not representation(bsdf).isotropic:
            raise ExchangeError("a surface with a lay has no such parameters: use the format of a table")
        self.bsdf, self.reduced = bsdf, nonspectral(bsdf)
        """As given, and weighted with V(λ) and D65"""
        self._fitted, self._compared = dict[float | None, Sampled](), dict[float | None, Sampled]()
        self._reflectance = dict[float, float]()

    def fitted(self, theta_i: float | None = None) -> Sampled:
        """For a fit, at one incidence [degree] or, with None, at all.

        Raises ExchangeError: no direction has light.
        """
        if theta_i not in self._fitted:
            self._fitted[theta_i] = self._sampled(theta_i, _FITTED)
        if not self._fitted[theta_i].brdf.any():
            raise ExchangeError(
                "the BSDF scatters no light back, so that there is nothing to fit: use the format of a table"
            )
        return self._fitted[theta_i]

    def compared(self, theta_i: float | None = None) -> Sampled:
        """For the error of a fit, at other directions than :meth:`fitted`."""
        if theta_i not in self._compared:
            self._compared[theta_i] = self._sampled(theta_i, _COMPARED)
        return self._compared[theta_i]

    def _sampled(self, theta_i: float | None, seed: int) -> Sampled:
        if theta_i is None:
            pairs = fresh_pairs(self.reduced, seed)
        else:
            pairs = fresh_pairs_at(self.reduced, np.array([theta_i]), seed)
        return self._at(pairs.chosen(pairs.theta_o < 90))

    def _at(self, pairs: Pairs) -> Sampled:
        return Sampled(pairs, representation(self.reduced).evaluate(*pairs, None)[:, 0])

    def mirrored(self, theta_i: Array) -> Sampled:
        """In the mirror directions of incidences (n,) [degree]."""
        plane = np.zeros_like(theta_i)
        return self._at(Pairs(theta_i, plane, theta_i, plane + 180.0))

    def reflectance(self, theta_i: Array) -> Array:
        """Directional reflectance (n,) of incidences [degree], weighted with V(λ) and D65, without the light mirrored into a single direction."""
        if missing := [angle for angle in theta_i.tolist() if angle not in self._reflectance]:
            model, at = representation(self.reduced), (np.array(missing), np.zeros(len(missing)))
            values = (model.albedo(*at, None) - model.specular(*at, None)[0])[:, 0]
            self._reflectance |= dict(zip(missing, values.tolist(), strict=True))
        return np.array([self._reflectance[angle] for angle in theta_i.tolist()])

    @cached_property
    def colour(self) -> Array:
        """(incidences, 3) reflectance at :data:`INCIDENCES` in linear sRGB; without the light mirrored into a single direction, unless the face is smooth."""
        model, azimuth = representation(self.bsdf), np.zeros_like(INCIDENCES)
        albedo = model.albedo(INCIDENCES, azimuth, None)
        if not self.is_smooth:
            albedo = albedo - model.specular(INCIDENCES, azimuth, None)[0]
        return np.asarray(linear_rgb(self.bsdf).convert(albedo))

    @cached_property
    def is_smooth(self) -> bool:
        """Whether the surface mirrors most of what it reflects without entering the material into a single direction."""
        return is_smooth(self.bsdf)

    def delta_e(self, rgb: Evaluate) -> float:
        """Largest CIEDE2000 of a fit in linear sRGB at :data:`COLOUR_GEOMETRIES`, D65 and 2 degree."""
        white, at = colorimetry.weights("D65", 2).white, _colour_directions()
        xyz = colours.xyz_of(self.bsdf, representation(self.bsdf).evaluate(*at, None), "D65", 2)
        of_fit = rgb(*at, None) * np.pi @ np.linalg.inv(colorimetry.srgb_from_xyz(white)).T
        return _largest_difference(xyz, of_fit, white)


def delta_e_of_greys(reduced: xr.Dataset, evaluate: Evaluate) -> float:
    """Largest CIEDE2000 at :data:`COLOUR_GEOMETRIES` of a fit without colour: greys of both luminances.

    Parameters
    ----------
    reduced : kind ``bsdf``, weighted with V(λ)
    evaluate : the fit
    """
    white, at = colorimetry.weights("D65", 2).white, _colour_directions()
    one, other = (np.pi * values(*at, None)[:, :1] * white for values in (representation(reduced).evaluate, evaluate))
    return _largest_difference(one, other, white)


def _largest_difference(one: Array, other: Array, white: Array) -> float:
    labs = (colorimetry.xyz_to_lab(np.maximum(values, 0.0), white) for values in (one, other))
    return float(np.max(colorimetry.delta_e_00(*labs)))


def _colour_directions() -> Pairs:
    named: dict[str, Directions] = {}
    for name in COLOUR_GEOMETRIES:
        named |= named_directions(name)
    return Pairs(*colours.angles(named))


def is_smooth(bsdf: xr.Dataset) -> bool:
    """Whether the surface mirrors most of what it reflects without entering the material into a single direction."""
    normal = np.zeros(1)
    mirrored = representation(bsdf).specular(normal, normal, None)[0].mean()
    n, k = index_of(bsdf)
    return bool(n is not None and mirrored > 0.5 * fresnel(1.0, n, k).mean)


def index_of(bsdf: xr.Dataset) -> tuple[float | None, float]:
    """n and k, weighted with V(λ) and D65; None where the BSDF states no index, and 0 where it states no k."""
    named = next((name for name in ("n", "clear_coat_index") if name in bsdf), None)
    return None if named is None else _luminous_mean(bsdf, named), _luminous_mean(bsdf, "k") if "k" in bsdf else 0.0


def _luminous_mean(bsdf: xr.Dataset, name: str) -> float:
    values = bsdf[name]
    if "mixed" in values.dims:
        # A mean over wavelengths has its own weights.
        return float(values @ bsdf["mixture"])
    if "wavelength" not in values.dims:
        return float(values.mean())
    return float(values @ xr.DataArray(colorimetry.luminous_weight(values["wavelength"].values), dims="wavelength"))


def luminance_of_rgb() -> Array:
    """(3,) luminance of linear red, green and blue; 1 for white."""
    return np.asarray(np.linalg.inv(colorimetry.srgb_from_xyz(colorimetry.weights("D65", 2).white) * 100)[1])
