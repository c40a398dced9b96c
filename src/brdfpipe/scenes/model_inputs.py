"""What a predicted BSDF follows from."""

from __future__ import annotations

from dataclasses import dataclass

import xarray as xr

from brdfpipe.scenes.ladders import Candidate, structures
from brdfpipe.spectra import colorimetry

ONE_WAVELENGTH = 555.0
"""Wavelength at which a material is judged, and of a single band [nm]."""


@dataclass(frozen=True)
class ModelInputs:
    """What a predicted BSDF follows from."""

    index: xr.Dataset
    """Kind ``index``"""
    spectrum: xr.Dataset | None = None
    """Kind ``spectrum``"""
    facets: xr.Dataset | None = None
    """Kind ``facets``"""
    psd: xr.Dataset | None = None
    """Kind ``psd``"""
    surface: xr.Dataset | None = None
    """Kind ``surface``, the first scan of the facets"""

    @property
    def luminous_reflectance(self) -> float:
        """Total reflectance weighted with V(λ)·D65; 0 without a spectrum."""
        if self.spectrum is None:
            return 0.0
        weight = colorimetry.luminous_weight(self.spectrum["wavelength"].values)
        return float(weight @ self.spectrum["total_reflectance"].values / weight.sum())

    @property
    def lay(self) -> bool:
        """Whether the slopes have a lay."""
        return self.facets is not None and self.facets["slope_density"].ndim == 2

    @property
    def structures(self) -> tuple[Candidate, ...]:
        """The treatments of the surface that differ for this material."""
        slopes = self.facets is not None and self.facets["slope_density"].size > 0
        return structures(
            surface=slopes,
            heights=slopes and self.surface is not None,
            spectrum_known=self.spectrum is not None,
            lay=slopes and self.lay,
            waves=self.psd is not None,
        )
