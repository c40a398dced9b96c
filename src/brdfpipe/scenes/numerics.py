"""Numbers of rays, facets and nodes with which a model is computed: fine, or fewer where a scene accepts the error of that."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

from brdfpipe.bsdf.microfacet import second_reflection, traced_reflections
from brdfpipe.bsdf.wave import builder as wave
from brdfpipe.bsdf.wave import height_transform

QUICK, FEWER_LAY_NODES, FINE = "quick", "fewer lay nodes", "fine"
"""Names of :data:`NUMERICS`."""


class Use(NamedTuple):
    """Numerics that are not fine, where they may be used."""

    numerics: str
    error: float
    """In the unit of the metric: above that of all random materials that were tried (``benchmarks/quick_numerics.py``)"""


USES: Mapping[str, Mapping[str, Use]] = {
    "no lay": {"gloss": Use(QUICK, 0.15)},
    "lay": {"colour": Use(FEWER_LAY_NODES, 0.02), "glare": Use(FEWER_LAY_NODES, 0.003)},
}
"""By lay and metric. Others have fine numerics."""

MOST_OF_TOLERANCE = 0.15
"""Share of the tolerance that the error of numerics may be."""


@dataclass(frozen=True)
class Numerics:
    """Numbers of rays, facets and nodes."""

    compares_all: bool
    """Whether all facets are compared to choose the masking, and not only as many as make the choice clear"""
    rays: int
    """Of each incidence, for light that is reflected more than once"""
    reflection_nodes: tuple[int, int]
    """Angles and azimuths of the table of that light"""
    phase_step: float
    """Of the logarithm of the phase variance in tables of the halo [1]"""
    lay_energy_nodes: wave.EnergyNodes
    """Of the integrals that close the energy of waves, of a surface with a lay"""


_FINE = Numerics(
    compares_all=True,
    rays=traced_reflections.RAYS,
    reflection_nodes=second_reflection.NODES,
    phase_step=height_transform.PHASE_STEP,
    lay_energy_nodes=wave.LAY_ENERGY_NODES,
)
NUMERICS = {
    QUICK: replace(_FINE, compares_all=False, rays=2**13, reflection_nodes=(12, 9), phase_step=0.12),
    FEWER_LAY_NODES: replace(
        _FINE, lay_energy_nodes=wave.EnergyNodes(17, 4, 3, closure_arcs=8, arcs_a_half=7, arcs_a_turn=15)
    ),
    FINE: _FINE,
}


def numerics_for(metric: str, tolerance: float, lay: bool) -> tuple[str, float]:
    """Name of the numerics of a material, and their error in the unit of the metric."""
    use = USES["lay" if lay else "no lay"].get(metric)
    if use is None or use.error > MOST_OF_TOLERANCE * tolerance:
        return FINE, 0.0
    return use
