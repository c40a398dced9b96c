"""A prediction in which waves reflect light, built with other inputs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import xarray as xr

from brdfpipe.bsdf.wave.builder import build
from brdfpipe.comparison.prediction import NOMINAL, PredictionInputs, with_base
from brdfpipe.facets import scaling
from brdfpipe.psd.scaling import scaled


@dataclass(frozen=True)
class WavePredictionInputs:
    """The inputs of a prediction by waves, and by facets where waves do not reflect."""

    of_facets: PredictionInputs
    spectrum_of_heights: xr.Dataset
    """Kind ``psd``"""
    attributes: Mapping[str, str]
    """``optics``, ``form`` and ``diffuse_mode`` of the prediction"""

    @classmethod
    def of(cls, bsdf: xr.Dataset, of_facets: PredictionInputs, psd: xr.Dataset) -> WavePredictionInputs:
        """The inputs of a ``bsdf`` dataset, representation ``wave``."""
        return cls(of_facets, psd, {name: str(bsdf.attrs[name]) for name in ("optics", "form", "diffuse_mode")})

    def bsdf(self, inputs: Mapping[str, float]) -> xr.Dataset:
        """The BSDF built with other inputs; ``slope`` scales all heights."""
        given = self.of_facets
        built = build(
            scaled(self.spectrum_of_heights, inputs["slope"]),
            index=given.index.assign(n=given.shifted(given.index["n"], inputs["index"])),
            spectrum=given.spectrum,
            facets=scaling.scaled(given.facets, inputs["slope"]),
            predicted=given.bsdf({**inputs, "diffuse": NOMINAL["diffuse"]}),
            visibility=given.visibility,
            states_cut_error=False,
            optics=self.attributes["optics"],
            form=self.attributes["form"],
            diffuse=self.attributes["diffuse_mode"],
        )
        return with_base(built, inputs["diffuse"])
