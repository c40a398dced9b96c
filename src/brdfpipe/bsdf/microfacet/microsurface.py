"""Rough interface: slope density of the facets that mirror one direction into another, and their visibility."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeAlias

import numpy as np
import xarray as xr

from brdfpipe.errors import BrdfpipeError
from brdfpipe.facets.planar_density import PlanarDensity
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.geometry import Array, HalfVector, slope_towards
from brdfpipe.masking.liu import LiuMasking, Marginal, attenuation
from brdfpipe.masking.smith import PlanarSmith, Smith, cotangent
from brdfpipe.masking.visibility import VISIBILITY, SingleVisibility, VisibilityRatio

Azimuth: TypeAlias = "Array | float"

NOT_PHYSICAL = {
    "crf": "hides facets from the viewer alone, so it is not reciprocal and does not conserve energy",
    "none": "hides no facet, so it does not conserve energy",
    "liu": "does not vanish at grazing",
}
"""Masking modes of the sources that violate energy conservation or reciprocity, with the reason; they cause a warning."""


class ModelError(BrdfpipeError):
    """A BSDF cannot be built from the given input."""


@dataclass(frozen=True)
class Microsurface:
    """Slope density and Smith masking of a surface, isotropic or with a lay."""

    density: RadialDensity | PlanarDensity
    smith: Smith | PlanarSmith
    ratio: VisibilityRatio | None = None
    """Visibility from both directions traced on the heights over Smith's, of masking ``measured``"""
    single: SingleVisibility | None = None
    """The same from one direction"""

    @classmethod
    def of(cls, dataset: xr.Dataset) -> Microsurface:
        """The surface of a ``facets`` or microfacet ``bsdf`` dataset."""
        if dataset["slope_density"].ndim == 1:
            ratio = VisibilityRatio.of(dataset) if "visibility_ratio" in dataset else None
            single = SingleVisibility.of(dataset) if "single_ratio" in dataset else None
            return cls(RadialDensity.of(dataset), Smith.of(dataset), ratio, single)
        return cls(PlanarDensity.of(dataset), PlanarSmith.of(dataset))

    def with_density(self, dataset: xr.Dataset) -> Microsurface:
        """The surface with the slope density and Smith's masking of another dataset; isotropic."""
        return replace(self, density=RadialDensity.of(dataset), smith=Smith.of(dataset))

    @property
    def isotropic(self) -> bool:
        return isinstance(self.density, RadialDensity)

    @property
    def typical_slope(self) -> float:
        """Median slope; with a lay, the geometric mean of the two principal rms slopes."""
        if isinstance(self.density, RadialDensity):
            return self.density.median_slope
        _, _, covariance = self.density.moments
        return float(np.linalg.det(covariance) ** 0.25)

    def density_at(self, slope_x: Array, slope_y: Array) -> Array:
        """P22 at slopes along x and y."""
        if isinstance(self.density, RadialDensity):
            return self.density(slope_x * slope_x + slope_y * slope_y)
        return self.density(slope_x, slope_y)

    def p22(self, pair: HalfVector, phi_i: Azimuth, phi_o: Azimuth) -> Array:
        """P22 of the facets that mirror one direction into the other."""
        if isinstance(self.density, RadialDensity):
            return self.density(pair.slope_squared)
        return self.density(*slope_towards(pair, phi_i, phi_o))

    def excess(self, cos: Array, sin: Array, phi: Azimuth) -> Array:
        """Mean excess slope g(cot θ) towards directions of azimuth φ [degree]."""
        return self.smith.excess(cotangent(cos, sin), phi)

    def visibility(self, pair: HalfVector, phi_i: Azimuth, phi_o: Azimuth, masking: str) -> Array:
        """G2 / (cos θ_i cos θ_o) of the facets that mirror one direction into the other; ``masking`` is a mode of :mod:`brdfpipe.masking.modes`."""
        if masking == "liu":
            return attenuation(pair, phi_i, phi_o, self.liu) / (pair.cos_i * pair.cos_o)
        if np.ndim(pair.cos_i) == np.ndim(pair.cos_o) == 0:
            # One call for both directions takes half the time.
            cos, sin = np.array([pair.cos_i, pair.cos_o]), np.array([pair.sin_i, pair.sin_o])
            excess_i, excess_o = self.excess(cos, sin, np.array([phi_i, phi_o]))
        else:
            excess_i, excess_o = self.excess(pair.cos_i, pair.sin_i, phi_i), self.excess(pair.cos_o, pair.sin_o, phi_o)
        if masking == "measured":
            assert self.ratio is not None
            return self.ratio.visibility(pair, excess_i, excess_o, self.typical_slope)
        return VISIBILITY[masking](pair, excess_i, excess_o)

    @cached_property
    def liu(self) -> LiuMasking:
        """Liu's attenuation for one direction, of an isotropic surface."""
        assert isinstance(self.density, RadialDensity)
        return LiuMasking.of(Marginal.of(self.density))

    def reflected(self, pair: HalfVector, phi_i: Azimuth, phi_o: Azimuth, masking: str) -> Array:
        """D G2 / (4 cos θ_i cos θ_o), the BRDF of perfectly mirroring facets [sr-1]."""
        return self.mirrors(pair, self.visibility(pair, phi_i, phi_o, masking), phi_i, phi_o)

    def mirrors(self, pair: HalfVector, visible: Array, phi_i: Azimuth, phi_o: Azimuth) -> Array:
        """The same with a known :meth:`visibility`."""
        spread = 1 + pair.slope_squared
        spread *= spread
        return self.p22(pair, phi_i, phi_o) * spread * visible / 4
