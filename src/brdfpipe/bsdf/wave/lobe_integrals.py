"""Integrals of the light of a surface over the lobe of one incidence, by compiled code: what closes its energy, and its reflectance."""

from __future__ import annotations

from dataclasses import dataclass

from brdfpipe.bsdf.microfacet import evaluation_kernel
from brdfpipe.bsdf.wave import halo_kernel
from brdfpipe.bsdf.wave.halo_kernel import Lobe, Sums
from brdfpipe.bsdf.wave.two_scale import Angles, Corners, RoughSurface
from brdfpipe.geometry import Array


@dataclass(frozen=True)
class LobeIntegrals:
    """Of a surface of waves and facets, at some wavelengths."""

    surface: RoughSurface
    """Its halo is of all orders"""
    wavelength: Array
    """[nm]"""
    n: Array
    k: Array
    nodes: int
    """Of the closure"""

    def __call__(
        self, weight: Array, angles: Angles, corners: Corners, *, closes: bool = False, scatters: bool = False
    ) -> Sums:
        """Over directions above the surface, of one incidence.

        Parameters
        ----------
        weight : cos θ_o dω_o (directions,) [sr]
        angles : θ_i, φ_i, θ_o and φ_o, (directions,) degree each; of one incidence
        corners : of the outgoing directions
        closes : compute the sums of perfect mirrors
        scatters : compute those of the body
        """
        surface = self.surface
        assert surface.halo is not None
        pair = evaluation_kernel.half_vectors(*angles)
        lobe = Lobe(surface.compiled_pairs(pair, angles), weight, *corners)
        body = surface.compiled_body(pair, angles, self.wavelength, self.n, self.k) if scatters else None
        return halo_kernel.lobe_sums(
            lobe,
            *surface.order_tables,
            self.wavelength,
            self.nodes,
            body,
            closes=closes,
            generalised=surface.halo.form == "ghs",
        )
