"""Integrals of the light of a surface over the lobe of one incidence, by compiled code: what closes its energy, and its reflectance."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from brdfpipe.bsdf.microfacet import evaluation_kernel
from brdfpipe.bsdf.wave import halo_kernel
from brdfpipe.bsdf.wave.halo import Halo
from brdfpipe.bsdf.wave.halo_kernel import Body, Lobe, Sums
from brdfpipe.bsdf.wave.two_scale import Angles, RoughSurface, tilted_share
from brdfpipe.geometry import Array

Corners = Iterable[tuple[NDArray[np.int64], Array]]
"""Nodes of the closure about each outgoing direction, and their shares of it, (directions,) each"""


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
        corners : of these directions
        closes : compute the sums of perfect mirrors
        scatters : compute those of the body
        """
        halo, relief = self._halo, self.surface.relief
        assert relief is not None
        pair, azimuths = evaluation_kernel.half_vectors(*angles), (angles[1], angles[3])
        visible = relief.surface.visibility(pair, *azimuths, relief.masking)
        slope, column = halo.slope_and_azimuth(pair, azimuths)
        cosines, none = pair.cos_i + pair.cos_o, np.zeros(weight.size)
        node, share = (np.stack(part, axis=1) for part in zip(*corners, strict=True))
        lobe = Lobe(
            weight,
            slope,
            np.sqrt(pair.slope_squared),
            column if column.size else none,
            cosines,
            pair.cos_i * pair.cos_o,
            tilted_share(pair, visible),
            relief.surface.mirrors(pair, visible, *azimuths) if scatters else none,
            node,
            share,
        )
        body = None
        if scatters:
            facet_share = self.surface.facet_share(cosines, self.wavelength)
            further = relief.facets.further_light(*angles, self.wavelength) if facet_share.any() else None
            body = Body(
                facet_share,
                halo_kernel.polarisation_factor(pair, angles[3] - angles[1], self.n, self.k),
                halo_kernel.reflectance(pair.cos_zeta, self.n, self.k),
                np.empty((0, 0))
                if further is None
                else np.ascontiguousarray(np.broadcast_to(further, facet_share.shape)),
            )
        fine = halo_kernel.NO_TABLE if relief.fine is None else relief.fine.by_order_table
        generalised = halo.form == "ghs"
        return halo_kernel.lobe_sums(
            lobe, halo.by_order_table, fine, self.wavelength, self.nodes, body, closes=closes, generalised=generalised
        )

    @cached_property
    def _halo(self) -> Halo:
        assert self.surface.halo is not None
        return self.surface.halo
