"""Integrals of the light of a surface over the lobe of one incidence, by compiled code: what closes its energy, and its reflectance."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from brdfpipe.bsdf.microfacet import evaluation_kernel
from brdfpipe.bsdf.wave import halo_kernel
from brdfpipe.bsdf.wave.halo import Azimuths, Halo
from brdfpipe.bsdf.wave.halo_kernel import Body, Lobe, Sums
from brdfpipe.bsdf.wave.two_scale import Angles, RoughSurface
from brdfpipe.geometry import Array, HalfVector
from brdfpipe.masking.modes import PHYSICAL_MASKINGS

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
        cosines, none = pair.cos_i + pair.cos_o, np.zeros(weight.size)
        visible_mirrors = self._visible_mirrors(pair, azimuths)
        slope, column = halo.slope_and_azimuth(pair, azimuths)
        node, share = (np.stack(part, axis=1) for part in zip(*corners, strict=True))
        lobe = Lobe(
            weight,
            slope,
            np.sqrt(pair.slope_squared),
            column if column.size else none,
            cosines,
            pair.cos_i * pair.cos_o,
            visible_mirrors * cosines**2,
            relief.surface.p22(pair, *azimuths) * visible_mirrors if scatters else none,
            node,
            share,
        )
        body = None
        if scatters:
            facet_share = halo_kernel.facet_share(self._passage, cosines, self.wavelength)
            further = relief.facets.further_light(*angles, self.wavelength) if facet_share.any() else None
            body = Body(
                facet_share,
                halo_kernel.polarisation_factor(pair, angles[3] - angles[1], self.n, self.k),
                evaluation_kernel.reflectances(pair.cos_zeta, self.n, self.k),
                np.empty((0, 0))
                if further is None
                else np.ascontiguousarray(np.broadcast_to(further, facet_share.shape)),
            )
        fine = halo_kernel.NO_TABLE if relief.fine is None else relief.fine.by_order_table
        generalised = halo.form == "ghs"
        return halo_kernel.lobe_sums(
            lobe, halo.by_order_table, fine, self.wavelength, self.nodes, body, closes=closes, generalised=generalised
        )

    def _visible_mirrors(self, pair: HalfVector, azimuths: Azimuths) -> Array:
        """(1 + s²)² G2 / (4 cos θ_i cos θ_o) of the facets of pairs, (directions,)."""
        relief = self.surface.relief
        assert relief is not None
        if self._facets is not None:
            return evaluation_kernel.visible_mirrors(self._facets, pair)
        spread = 1 + pair.slope_squared
        return np.asarray(spread * spread * relief.surface.visibility(pair, *azimuths, relief.masking) / 4)

    @cached_property
    def _facets(self) -> evaluation_kernel.FacetTables | None:
        """Tables of the facets, where compiled code covers their masking."""
        relief = self.surface.relief
        assert relief is not None
        if not (relief.surface.isotropic and relief.masking in PHYSICAL_MASKINGS):
            return None
        return evaluation_kernel.FacetTables.of(relief.surface, relief.masking)

    @cached_property
    def _passage(self) -> halo_kernel.Passage:
        return self.surface.passage_of_pairs

    @cached_property
    def _halo(self) -> Halo:
        assert self.surface.halo is not None
        return self.surface.halo
